"""Pose dictionaries: whole poses as few terms, for estimators of 3D pose from 2D.

Poses are bone-length normalised (every person gets one body), aligned by their torsos (Procrustes),
and then described twice: by principal directions of each class of action, concatenated and thus
overcomplete, around one mean (Akhter & Black 2015); and by atoms of which every pose is a sparse
non-negative sum (Zhou et al. 2015). The usual way in: `PoseDictionary.default()`,
`PoseDictionary.load(path)`, `learn_dictionary(motions)`."""

import dataclasses
import functools
import hashlib
import os
import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from poseterior.probmodel.arrays import doubles, possible, read_tables, single, write_tables
from poseterior.probmodel.body import aligned, bone_vectors, mean_torso, mirror_pose, with_lengths
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.learning.poses import in_body_units, usable
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.skeleton import JOINTS, MIRROR, NUM_JOINTS, TORSO_INDEX

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
    """Whole poses in body axes and body units, pelvis at the origin.

    Parameters
    ----------
    mean : `(15, 3)`
    bases : `(B, 15, 3)`
        Principal directions of the classes of action, each of length one.
    atoms : `(K, 15, 3)`
        Of length one each.
    lengths : `(14,)`
        Lengths of `body.bone_vectors` to which all poses were normalised.
    torso : `(6, 3)`
        The mean torso, which defines the axes.
    """

    mean: np.ndarray
    bases: np.ndarray
    atoms: np.ndarray
    lengths: np.ndarray
    torso: np.ndarray

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of the tables themselves, however they were stored."""
        digest = hashlib.sha256()
        for table in (self.mean, self.bases, self.atoms, self.lengths, self.torso):
            digest.update(np.ascontiguousarray(table, "<f8").tobytes())
        return digest.hexdigest()

    @classmethod
    def default(cls) -> "PoseDictionary":
        """The embedded dictionary, learned from CMU motion capture; `probmodel/data/PROVENANCE.md`
        says how."""
        with resources.as_file(resources.files("poseterior.probmodel.data") / "poses.npz") as path:
            return cls.load(path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "PoseDictionary":
        """Reads what `save` wrote. Raises `BadInput` on anything else, or another skeleton."""
        path = Path(path)
        advice = "write one with `poseterior learn --poses`"
        fields = [field.name for field in dataclasses.fields(cls)]
        arrays = read_tables(path, "file of pose dictionaries", advice, ("joints", *fields))
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


def learn_dictionary(motions: Sequence[Motion], *, num_atoms: int = NUM_ATOMS) -> PoseDictionary:
    """Learns a dictionary from recordings; every pose counts as it is and mirrored.

    The class of a recording is its name up to a slash (`walking/walking_1`), or its subject.

    Raises
    ------
    BadInput
        Where no usable frame is left, a bone has length zero, or there are fewer poses than atoms.
    """
    classes = _by_action(motions)
    lengths = _reference_lengths(classes)
    classes = [with_lengths(joints, lengths) for joints in classes]
    classes = [np.concatenate([joints, mirror_pose(joints)]) for joints in classes]
    torso = mean_torso(np.concatenate([joints[:, list(TORSO_INDEX)] for joints in classes]))
    classes = [aligned(joints, torso) for joints in classes]
    mean = np.mean([joints.mean(axis=0) for joints in classes], axis=0)
    bases = np.concatenate([principal_directions(joints) for joints in classes])
    atoms = _learn_atoms(np.concatenate([_spread(joints) for joints in classes]), num_atoms)
    return PoseDictionary(*(single(table) for table in (mean, bases, atoms, lengths, torso)))


def _by_action(motions: Sequence[Motion]) -> list[np.ndarray]:
    """Poses `(n, 15, 3)` of each class, every recording in its own body units."""
    classes: dict[str, list[np.ndarray]] = {}
    for motion in usable(motions):
        action = motion.name.split("/")[0] if "/" in motion.name else motion.subject
        classes.setdefault(action, []).append(in_body_units(motion.joints))
    return [np.concatenate(parts) for parts in classes.values()]


def _reference_lengths(classes: list[np.ndarray]) -> np.ndarray:
    """Mean lengths `(14,)` of the bones over classes, the same for left and right."""
    means = [np.linalg.norm(bone_vectors(joints), axis=-1).mean(axis=0) for joints in classes]
    mean = np.concatenate([[0.0], np.mean(means, axis=0)])
    return (0.5 * (mean + mean[list(MIRROR)]))[1:]


def principal_directions(joints: np.ndarray) -> np.ndarray:
    """Principal directions `(b, 15, 3)` of poses `(N, 15, 3)`, those of large variance first.

    A direction's sign means nothing, and linear algebra libraries choose it as the processor has
    it; here the sum of its coordinates, each times its number, is positive.
    """
    flat = joints.reshape(len(joints), -1)
    variance, directions = np.linalg.eigh(np.cov(flat, rowvar=False, bias=True))
    variance, directions = variance[::-1], directions[:, ::-1]
    keep = min(MOST, 1 + int(np.searchsorted(np.cumsum(variance) / variance.sum(), EXPLAINED)))
    kept = directions[:, :keep].T
    # Weights that all differ: a mirror-symmetric direction cannot bring the sum to zero.
    numbers = np.arange(1, kept.shape[1] + 1)
    signed = kept * np.where(kept @ numbers < 0, -1.0, 1.0)[:, None]
    return signed.reshape(keep, NUM_JOINTS, 3)


def _spread(joints: np.ndarray) -> np.ndarray:
    """At most `POSES_PER_ACTION` of the poses, evenly spread."""
    return joints[:: max(1, -(-len(joints) // POSES_PER_ACTION))]


def _learn_atoms(joints: np.ndarray, number: int) -> np.ndarray:
    """At most `number` atoms `(k, 15, 3)` that make Σ ½|pose − Σ c atom|² + SPARSITY Σ c small over
    coefficients c ≥ 0 (Mairal et al. 2009)."""
    # A second to import, and only learning needs it.
    from sklearn.decomposition import MiniBatchDictionaryLearning
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
        # Single steps on the way need not converge.
        warnings.simplefilter("ignore", ConvergenceWarning)
        learner.fit(joints.reshape(len(joints), -1))
    size = np.linalg.norm(learner.components_, axis=1, keepdims=True)
    used = size[:, 0] > 0
    return (learner.components_[used] / size[used]).reshape(-1, NUM_JOINTS, 3)
