"""Depth flips: under weak perspective every bone of a limb may point towards the camera or away
from it, 2^k patterns.

They are the modes of a posterior that a local sampler finds hard to leave.
"""

import numpy as np

from poseterior.probmodel.skeleton import BONES, UPPER_BONES

FLIPPING = tuple(bone for bone in BONES if bone is not UPPER_BONES[0])
"""The eight bones of the limbs."""


def away(joints: np.ndarray) -> np.ndarray:
    """`(..., 8)` bool: which bones of poses `(..., 15, 3)` in camera axes point away from the
    camera."""
    depth = np.asarray(joints)[..., 2]
    return np.stack([depth[..., bone.end] > depth[..., bone.start] for bone in FLIPPING], axis=-1)


def codes(patterns: np.ndarray) -> np.ndarray:
    """`(...)`: patterns `(..., bones)` as numbers, one bit a bone."""
    return patterns @ (1 << np.arange(patterns.shape[-1]))
