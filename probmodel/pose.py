"""A pose as the prior has it: bone lengths and local directions, without the torso it hangs on."""

from typing import Any, NamedTuple

import numpy as np

from poseterior.probmodel.skeleton import NUM_LENGTHS, NUM_LOWER, NUM_UPPER, Limb


class Pose(NamedTuple):
    """One record for a pose, or for a batch of poses.

    Attributes
    ----------
    length : `(..., 5)`, the length groups' bone lengths in body units; arrays of NumPy or JAX, as
        are all three.
    upper : `(..., 5, 3)`, unit vectors of the upper bones in the torso's local axes.
    lower : `(..., 4, 3)`, unit vectors of the lower bones in their parents' local axes.
    """

    length: Any
    upper: Any
    lower: Any

    @classmethod
    def blank(cls, *batch: int) -> "Pose":
        """Poses of zeros, to be filled limb by limb; the joints of a limb left blank lie at its
        start."""
        return cls(
            np.zeros((*batch, NUM_LENGTHS)),
            np.zeros((*batch, NUM_UPPER, 3)),
            np.zeros((*batch, NUM_LOWER, 3)),
        )


class GroupDraws(NamedTuple):
    """Draws of one group of limbs (`skeleton.GROUPS`): the part of a pose that they decide.

    Attributes
    ----------
    length : `(n, bones)`, shared by the group's limbs, body units.
    upper, lower : `(n, limbs, 3)`, local directions; `lower` is unused where limbs have one bone.
    """

    length: np.ndarray
    upper: np.ndarray
    lower: np.ndarray

    def fill(self, poses: Pose, limbs: tuple[Limb, ...]) -> None:
        """Writes the first draws into the limbs of `poses` `(n, ...)`."""
        number = len(poses.length)
        for column, bone in enumerate(limbs[0].bones):
            poses.length[:, bone.length_group] = self.length[:number, column]
        for row, limb in enumerate(limbs):
            poses.upper[:, limb.upper] = self.upper[:number, row]
            if limb.lower is not None:
                poses.lower[:, limb.lower] = self.lower[:number, row]

    @classmethod
    def of(cls, poses: Pose, limbs: tuple[Limb, ...]) -> "GroupDraws":
        """What poses `(n, ...)` say of a group's limbs."""
        upper = poses.upper[:, [limb.upper for limb in limbs]]
        lowers = [limb.lower for limb in limbs if limb.lower is not None]
        lower = poses.lower[:, lowers] if lowers else np.zeros_like(upper)
        return cls(poses.length[:, [bone.length_group for bone in limbs[0].bones]], upper, lower)
