"""What the judge sees of a sampler: named coordinates of its draws, chain by chain, and the depth
flips of the limbs.

Coordinates are the five lengths and the joints that limbs end in, in camera axes and body units:
together they are the whole pose, whatever a sampler walked in."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inference.studies.flips import away
from probmodel.failures import BadInput
from probmodel.skeleton import BONES, JOINTS, LENGTH_GROUPS, NUM_LENGTHS

if TYPE_CHECKING:
    import xarray as xr

NAMES = (
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"{JOINTS[bone.end]} {axis}" for bone in BONES for axis in "xyz"),
)


@dataclass(frozen=True)
class Sample:
    """Draws of one sampler: `values` `(chain, draw, 32)` in the order of `NAMES`, `away` `(chain,
    draw, 8)` bool, whether a bone of `flips.FLIPPING` points away from the camera."""

    values: np.ndarray
    away: np.ndarray

    @property
    def num_draws(self) -> int:
        """Draws of all chains."""
        return int(np.prod(self.values.shape[:2]))

    @property
    def flat(self) -> np.ndarray:
        """`(n, 32)`: draws, chain after chain."""
        return self.values.reshape(-1, self.values.shape[-1])

    @property
    def lengths(self) -> slice:
        """Where the lengths stand in `values`."""
        return slice(0, NUM_LENGTHS)

    def rows(self, every: int) -> "Sample":
        """Every so many draws of each chain."""
        return Sample(self.values[:, ::every], self.away[:, ::every])

    def first(self, share: float) -> "Sample":
        """The first share of every chain."""
        number = int(np.ceil(share * self.values.shape[1]))
        return Sample(self.values[:, :number], self.away[:, :number])


def sample_of(joints: np.ndarray, bone_length: np.ndarray, where: str = "the draws") -> Sample:
    """From joints `(chain, draw, 15, 3)` in camera axes and lengths `(chain, draw, 5)`, body units.
    Raises `BadInput` where a number is not finite or there is no draw."""
    joints, bone_length = np.asarray(joints, float), np.asarray(bone_length, float)
    if not joints.size:
        raise BadInput(f"{where} are none; allow the sampler more")
    broken = ~(np.isfinite(joints).all(axis=(-1, -2)) & np.isfinite(bone_length).all(axis=-1))
    if broken.any():
        raise BadInput(
            f"{where} are not finite in {int(broken.sum())} of {broken.size} cases; drop those, or"
            " run anew"
        )
    ends = joints[:, :, [bone.end for bone in BONES]].reshape(*joints.shape[:2], -1)
    return Sample(np.concatenate([bone_length, ends], axis=-1), away(joints))


def read_sample(tree: "xr.DataTree", where: str = "the draws") -> Sample:
    """From a tree with the group `posterior` of the contract. Raises `BadInput` where it has none,
    or bad numbers."""
    try:
        posterior = tree["posterior"]
        return sample_of(
            np.asarray(posterior["joints"]), np.asarray(posterior["bone_length"]), where
        )
    except KeyError as error:
        raise BadInput(
            f"{where} lack {error}; they need posterior/joints and posterior/bone_length"
        ) from None
