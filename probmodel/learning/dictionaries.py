"""Pose dictionaries: whole poses as few terms, learned from motion capture, for estimators of 3D
pose from 2D.

Poses are bone-length normalised (every person gets one body), aligned by their torsos (Procrustes),
and then described twice: by principal directions per class of action, concatenated and thus
overcomplete, around one mean (Akhter & Black 2015); and by atoms of which every pose is a sparse
non-negative sum (Zhou et al. 2015). The usual way in: `PoseDictionary.default()`,
`PoseDictionary.load(path)`, `learn_dictionary(motions)`."""

import dataclasses
import os
import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from probmodel.arrays import doubles, possible, read_tables, write_tables
from probmodel.failures import BadInput
from probmodel.learning.learning import (
    LEARNING_RATE,
    align_torsos,
    body_unit,
    mean_torso,
    mirror_pose,
    single,
)
from probmodel.motion import Motion
from probmodel.skeleton import JOINTS, MIRROR, NUM_JOINTS, PARENTS, TORSO_INDEX

EXPLAINED = 0.99
"""Share of a class's variance that its principal directions keep, `MOST` of them at most."""
MOST = 12
NUM_ATOMS = 128
POSES_PER_ACTION = 600
"""The sparse dictionary is learned from so many poses of each action, evenly spread, so that long
ones do not rule."""
SPARSITY = 0.6
"""Weight of the sum of coefficients against half the squared error, in body units, while atoms are
learned."""


@dataclasses.dataclass(frozen=True)
class PoseDictionary:
    """Whole poses in body axes (x to the person's left, y up, z forward), body units, pelvis at the
    origin.

    `mean` `(15, 3)`; `bases` `(B, 15, 3)`, principal directions of the action classes, each of
    length one; `atoms` `(K, 15, 3)`, of length one; `lengths` `(14,)`, those of the bones from each
    joint but the pelvis to its parent, to which all poses were normalised; `torso` `(6, 3)`, the
    mean torso, which defines the axes."""

    mean: np.ndarray
    bases: np.ndarray
    atoms: np.ndarray
    lengths: np.ndarray
    torso: np.ndarray

    @classmethod
    def default(cls) -> "PoseDictionary":
        """The embedded dictionary, learned from CMU motion capture; `probmodel/data/PROVENANCE.md`
        says how."""
        with resources.as_file(resources.files("probmodel.data") / "poses.npz") as path:
            return cls.load(path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "PoseDictionary":
        """Reads what `save` wrote. Raises `BadInput` on anything else, and on a dictionary for
        another skeleton."""
        path = Path(path)
        advice = "write one with `poseterior learn --poses`"
        arrays = read_tables(path, "file of pose dictionaries", advice)
        fields = [field.name for field in dataclasses.fields(cls)]
        missing = [name for name in ("joints", *fields) if name not in arrays]
        if missing:
            raise BadInput(
                f"{path} is no file of pose dictionaries, it lacks {', '.join(missing)}; {advice}"
            )
        if tuple(arrays["joints"].tolist()) != JOINTS:
            raise BadInput(
                f"{path} holds pose dictionaries for another skeleton, of {arrays['joints'].size}"
                f" joints; needed are the {NUM_JOINTS} joints {', '.join(JOINTS)}: {advice}"
            )
        return cls(**{name: _checked(arrays[name], name, path) for name in fields})

    def save(self, path: str | os.PathLike) -> None:
        """Writes one .npz, atomically. Raises `BadInput` where it cannot be written."""
        arrays = {
            name: np.asarray(value, np.float32) for name, value in dataclasses.asdict(self).items()
        }
        write_tables(path, {"joints": np.array(JOINTS)} | arrays)


_ITEM = {
    "mean": (NUM_JOINTS, 3),
    "bases": (NUM_JOINTS, 3),
    "atoms": (NUM_JOINTS, 3),
    "lengths": (NUM_JOINTS - 1,),
    "torso": (len(TORSO_INDEX), 3),
}


def _checked(value: np.ndarray, name: str, path: Path) -> np.ndarray:
    wanted = _ITEM[name]
    shape = value.shape[1:] if name in ("bases", "atoms") else value.shape
    if value.dtype.kind != "f" or shape != wanted or not len(value):
        raise BadInput(
            f"{path}: {name} has shape {value.shape}, where each is {wanted}; is it for another"
            " skeleton?"
        )
    numbers = doubles(value)
    if not possible(numbers) or (name == "lengths" and not (numbers > 0).all()):
        raise BadInput(
            f"{path}: {name} holds a number that is not finite or a length that is not positive"
        )
    return numbers


# --- learning
# --------------------------------------------------------------------------------------------------------


def learn_dictionary(motions: Sequence[Motion], *, num_atoms: int = NUM_ATOMS) -> PoseDictionary:
    """Learns all of it from recordings; every pose counts as it is and mirrored.

    The class of a recording is its name up to a slash (`walking/walking_1`), or its subject. Raises
    `BadInput` where no usable frame is left, a bone has length zero, or there are fewer poses than
    atoms."""
    blocks = _by_action(motions)
    lengths = reference_lengths(blocks)
    blocks = {action: with_lengths(joints, lengths) for action, joints in blocks.items()}
    blocks = {
        action: np.concatenate([joints, mirror_pose(joints)]) for action, joints in blocks.items()
    }
    torso = mean_torso(np.concatenate([joints[:, list(TORSO_INDEX)] for joints in blocks.values()]))
    blocks = {action: aligned(joints, torso) for action, joints in blocks.items()}
    mean = np.mean([joints.mean(axis=0) for joints in blocks.values()], axis=0)
    bases = np.concatenate([principal_directions(joints) for joints in blocks.values()])
    atoms = _learn_atoms(np.concatenate([_spread(joints) for joints in blocks.values()]), num_atoms)
    return PoseDictionary(*(single(table) for table in (mean, bases, atoms, lengths, torso)))


def _by_action(motions: Sequence[Motion]) -> dict[str, np.ndarray]:
    """Poses `(n, 15, 3)` of each class, millimetres turned into body units, glitches dropped, 30
    Hz."""
    blocks: dict[str, list[np.ndarray]] = {}
    for motion in motions:
        joints = motion.without_jumps().at_rate(LEARNING_RATE).joints
        if not (np.linalg.norm(bone_vectors(joints), axis=-1) > 0).all():
            raise BadInput(
                f"{motion.name} has a bone of length zero in a frame; leave that recording out"
            )
        if len(joints):
            action = motion.name.split("/")[0] if "/" in motion.name else motion.subject
            blocks.setdefault(action, []).append((joints - joints[:, :1]) / body_unit(joints))
    if not blocks:
        raise BadInput(
            "the motion capture holds no usable frame; give recordings of at least a tenth of a"
            " second"
        )
    return {action: np.concatenate(block) for action, block in blocks.items()}


def bone_vectors(joints: np.ndarray) -> np.ndarray:
    """`(..., 14, 3)`: from each joint's parent to the joint, for all joints but the pelvis."""
    return joints[..., 1:, :] - joints[..., list(PARENTS[1:]), :]


def reference_lengths(blocks: dict[str, np.ndarray]) -> np.ndarray:
    """Mean lengths `(14,)` of the bones over classes, the same for left and right."""
    means = [
        np.linalg.norm(bone_vectors(joints), axis=-1).mean(axis=0) for joints in blocks.values()
    ]
    mean = np.concatenate([[0.0], np.mean(means, axis=0)])
    return (0.5 * (mean + mean[list(MIRROR)]))[1:]


def with_lengths(joints: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Poses `(..., 15, 3)` whose bones keep their directions and get new `lengths` `(..., 14)`; the
    pelvis stays.

    A bone of length zero has no direction; raises `BadInput`.
    """
    vectors = bone_vectors(joints)
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (size > 0).all():
        bone = JOINTS[1 + int(np.argwhere(~(size > 0))[0][-2])]
        raise BadInput(
            f"a pose has its {bone} on the joint before it, so that this bone has no direction"
        )
    vectors = vectors / size * np.asarray(lengths)[..., None]
    found = joints.copy()
    for joint, parent in enumerate(PARENTS[1:], start=1):  # parents come before their children
        found[..., joint, :] = found[..., parent, :] + vectors[..., joint - 1, :]
    return found


def aligned(joints: np.ndarray, torso: np.ndarray) -> np.ndarray:
    """Poses `(N, 15, 3)`, moved and turned so that their torsos lie on `torso` `(6, 3)`, pelvis at
    the origin."""
    joints = joints - joints[:, :1]
    return np.einsum("nab,njb->nja", align_torsos(joints[:, list(TORSO_INDEX)], torso), joints)


def principal_directions(joints: np.ndarray) -> np.ndarray:
    """Principal directions `(b, 15, 3)` of poses `(N, 15, 3)`, those of large variance first."""
    flat = joints.reshape(len(joints), -1)
    variance, directions = np.linalg.eigh(np.cov(flat, rowvar=False, bias=True))
    variance, directions = variance[::-1], directions[:, ::-1]
    keep = min(MOST, 1 + int(np.searchsorted(np.cumsum(variance) / variance.sum(), EXPLAINED)))
    return directions[:, :keep].T.reshape(keep, NUM_JOINTS, 3)


def _spread(joints: np.ndarray) -> np.ndarray:
    """At most `POSES_PER_ACTION` of the poses, evenly spread."""
    return joints[:: max(1, -(-len(joints) // POSES_PER_ACTION))]


def _learn_atoms(joints: np.ndarray, number: int) -> np.ndarray:
    """Atoms `(number, 15, 3)` with Σ ½|pose − Σ c atom|² + SPARSITY Σ c least over coefficients c ≥
    0 (Mairal 2009)."""
    from sklearn.decomposition import (
        MiniBatchDictionaryLearning,
    )  # a second to import, and only learning needs it
    from sklearn.exceptions import ConvergenceWarning

    if len(joints) < number:
        raise BadInput(
            f"{len(joints)} poses are too few for a dictionary of {number}; give more motion"
            " capture"
        )
    learner = MiniBatchDictionaryLearning(
        number,
        alpha=SPARSITY,
        fit_algorithm="cd",
        positive_code=True,
        batch_size=128,
        max_iter=10,
        random_state=0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", ConvergenceWarning
        )  # of single steps on the way, which need not converge
        learner.fit(joints.reshape(len(joints), -1))
    atoms = learner.components_.reshape(number, NUM_JOINTS, 3)
    size = np.linalg.norm(atoms, axis=(1, 2), keepdims=True)
    atoms = atoms[size[:, 0, 0] > 0] / size[size[:, 0, 0] > 0]
    return atoms
