"""Scenes whose truth is known (`inference.studies.scenes`), and keys."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np

from poseterior.inference.draws import place
from poseterior.inference.sampler import DetectionSampler, sampler_of
from poseterior.inference.studies.scenes import (
    ALL_BUT_AN_ARM,
    camera,
    hidden,
    motion_scene,
    prior_scene,
    scene,
)
from poseterior.probmodel import Estimate
from poseterior.probmodel.root_priors import TorsoCameraPrior
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


def placed(model, points, poses, **settings):
    """Joints and keypoints of poses under roots."""
    given = SimpleNamespace(model=model, root_prior=TorsoCameraPrior.of(model))
    return dict(zip(("joints", "keypoints"), place(given, points, poses, **settings), strict=True))


def drawer(model, *, root="uncertain", sampler=None, num_samples=10_000, **settings):
    """What draws so many poses of any detection."""
    return DetectionSampler(model, root, sampler_of(root, sampler, **settings), num_samples)
