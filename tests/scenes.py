"""Scenes whose truth is known (`inference.studies.scenes`), and keys."""

import jax

from inference.studies.scenes import camera, hidden, motion_scene, prior_scene, scene

__all__ = ["camera", "hidden", "key", "motion_scene", "prior_scene", "scene"]


def key(seed: int) -> jax.Array:
    """A JAX key."""
    return jax.random.key(seed)
