"""Scenes whose truth is known (`inference.studies.scenes`), and keys."""

import jax

from inference.studies.scenes import (
    ALL_BUT_AN_ARM,
    camera,
    hidden,
    motion_scene,
    prior_scene,
    scene,
)

__all__ = ["ALL_BUT_AN_ARM", "camera", "hidden", "key", "motion_scene", "prior_scene", "scene"]


def key(seed: int) -> jax.Array:
    """A JAX key."""
    return jax.random.key(seed)
