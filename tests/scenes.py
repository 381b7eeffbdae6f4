"""Scenes whose truth is known (`inference.studies.scenes`), and keys."""

import dataclasses

import jax
import numpy as np

from poseterior.inference.studies.scenes import (
    ALL_BUT_AN_ARM,
    camera,
    hidden,
    motion_scene,
    prior_scene,
    scene,
)
from poseterior.probmodel import Estimate
from poseterior.probmodel.skeleton import JOINT_INDEX

__all__ = [
    "ALL_BUT_AN_ARM",
    "camera",
    "hidden",
    "key",
    "motion_scene",
    "moved",
    "prior_scene",
    "scene",
]


def key(seed: int) -> jax.Array:
    """A JAX key."""
    return jax.random.key(seed)


def moved(frame: Estimate, joint: str, offset: tuple[float, float]) -> Estimate:
    """The same, its keypoint of one joint moved by so many pixels."""
    keypoints = np.array(frame.detection.keypoints)
    keypoints[JOINT_INDEX[joint]] += offset
    detection = dataclasses.replace(frame.detection, keypoints=keypoints)
    return dataclasses.replace(frame, detection=detection)
