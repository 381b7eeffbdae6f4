"""Bone lengths from poses: ranges and Beta distributions of the five length groups."""

import numpy as np

from poseterior.probmodel.anatomy.population import LengthPrior
from poseterior.probmodel.body import bone_lengths
from poseterior.probmodel.learning.poses import Poses
from poseterior.probmodel.skeleton import BONES, LENGTH_GROUPS, NUM_LENGTHS

SPREAD_FLOOR = 0.05
"""Least standard deviation of a bone length, as a share of its mean. Tables of human proportions
(segment lengths over stature) give some 3–6 %, more than a handful of subjects can show."""
ALLOWANCE = 2.0
"""The range reaches this many standard deviations beyond the shortest and the longest person."""
CENTRAL = (0.05, 0.95)
"""Quantiles of a length over a subject's frames between which it is that person's: recordings have
stretches in which a chain of bones is folded up, and the head a third as far away as it is."""
_LIMBS = [group for group, name in enumerate(LENGTH_GROUPS) if name != "head"]


def learn_lengths(poses: Poses) -> LengthPrior:
    """The lengths' prior by moments, every subject counting alike.

    Limb bones of a recording are rigid, so a limb length's spread is between subjects. The head's
    bone is a chain, whose length varies with the pose as well; its spread includes that."""
    lengths = _by_group(bone_lengths(poses.joints))
    by_subject = [lengths[poses.subject == subject] for subject in np.unique(poses.subject)]
    means = _distinct(np.stack([length.mean(axis=0) for length in by_subject]))
    mean = means.mean(axis=0)
    within = np.mean([length.var(axis=0) for length in by_subject], axis=0)
    between = means.var(axis=0, ddof=1) if len(means) > 1 else np.zeros(NUM_LENGTHS)
    spread = np.maximum(np.sqrt(within + between), SPREAD_FLOOR * mean)
    usual = np.stack([np.quantile(length, CENTRAL, axis=0) for length in by_subject])
    low = usual[:, 0].min(axis=0) - ALLOWANCE * spread
    high = usual[:, 1].max(axis=0) + ALLOWANCE * spread
    low = np.maximum(low, 0.1 * mean)
    share, variance = (mean - low) / (high - low), (spread / (high - low)) ** 2
    strength = np.maximum(share * (1 - share) / variance - 1, 2.0)
    return LengthPrior(low, high, share * strength, (1 - share) * strength)


def _by_group(lengths: np.ndarray) -> np.ndarray:
    """Lengths `(N, 5)` of the groups from those `(N, 9)` of the bones: means of left and right."""
    groups = [
        [i for i, bone in enumerate(BONES) if bone.length_group == group]
        for group in range(NUM_LENGTHS)
    ]
    return np.stack([lengths[:, group].mean(axis=-1) for group in groups], axis=-1)


def _distinct(means: np.ndarray) -> np.ndarray:
    """Subjects `(S, 5)` whose limbs differ from every earlier one's by 0.1 % or more: some data
    sets share a skeleton."""
    keep: list[np.ndarray] = []
    for mean in means:
        if all(np.abs(mean[_LIMBS] / other[_LIMBS] - 1).max() > 1e-3 for other in keep):
            keep.append(mean)
    return np.stack(keep)
