"""What the judge sees of a sampler: named coordinates of its draws, chain by chain, and the depth
flips of the limbs.

Coordinates are the five lengths and the joints that limbs end in, in camera axes and body units:
together they are the whole pose, whatever a sampler walked in. Where torso and camera are drawn
too, the torso's joints, the scale and the place are there as well."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from poseterior.inference.studies.flips import away
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, JOINTS, LENGTH_GROUPS, NUM_LENGTHS, TORSO_INDEX

if TYPE_CHECKING:
    import xarray as xr

NAMES = (
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"{JOINTS[bone.end]} {axis}" for bone in BONES for axis in "xyz"),
)
_TORSO = tuple(joint for joint in TORSO_INDEX if JOINTS[joint] != "pelvis")
"""Its joints but the pelvis, where the origin is."""
ROOT_NAMES = (
    *(f"{JOINTS[joint]} {axis}" for joint in _TORSO for axis in "xyz"),
    "log scale",
    "pelvis u",
    "pelvis v",
)


@dataclass(frozen=True)
class Sample:
    """Draws of one sampler: `values` `(chain, draw, c)` in the order of `names`, `away` `(chain,
    draw, 8)` bool, whether a bone of `flips.FLIPPING` points away from the camera."""

    values: np.ndarray
    away: np.ndarray
    names: tuple[str, ...] = NAMES

    @property
    def num_draws(self) -> int:
        """Draws of all chains."""
        return int(np.prod(self.values.shape[:2]))

    @property
    def flat(self) -> np.ndarray:
        """`(n, c)`: draws, chain after chain."""
        return self.values.reshape(-1, self.values.shape[-1])

    @property
    def lengths(self) -> slice:
        """Where the lengths stand in `values`."""
        return slice(0, NUM_LENGTHS)

    def rows(self, every: int) -> "Sample":
        """Every so many draws of each chain."""
        return replace(self, values=self.values[:, ::every], away=self.away[:, ::every])

    def first(self, share: float) -> "Sample":
        """The first share of every chain."""
        number = int(np.ceil(share * self.values.shape[1]))
        return replace(self, values=self.values[:, :number], away=self.away[:, :number])

    def with_roots(self, joints: np.ndarray, scale: np.ndarray, place: np.ndarray) -> "Sample":
        """The same draws with their roots: joints `(chain, draw, 15, 3)`, scale `(chain, draw)` and
        the pelvis in the image `(chain, draw, 2)`."""
        torso = np.asarray(joints, float)[:, :, _TORSO].reshape(*self.values.shape[:2], -1)
        parts = [self.values, torso, np.log(scale)[..., None], np.asarray(place, float)]
        return replace(self, values=np.concatenate(parts, axis=-1), names=(*NAMES, *ROOT_NAMES))


def sample_of(joints: np.ndarray, bone_length: np.ndarray, where: str = "the draws") -> Sample:
    """From joints `(chain, draw, 15, 3)` in camera axes and lengths `(chain, draw, 5)`, body units.
    Raises `BadInput` where a number is not finite or there is no draw."""
    joints = np.asarray(joints, float)
    bone_length = np.asarray(bone_length, float)
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
    """From a tree with the group `posterior` of the contract, with the roots where they are drawn
    too. Raises `BadInput` where it has none, or bad numbers."""
    try:
        posterior = tree["posterior"]
        found = sample_of(
            np.asarray(posterior["joints"]), np.asarray(posterior["bone_length"]), where
        )
        if "translation" not in posterior:
            return found
        parts = (np.asarray(posterior[name]) for name in ("joints", "scale", "translation"))
        return found.with_roots(*parts)
    except KeyError as error:
        raise BadInput(
            f"{where} lack {error}; they need posterior/joints and posterior/bone_length"
        ) from None
