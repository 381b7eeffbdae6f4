"""A population's anatomy: joint limits, ranges of bone lengths, and a dictionary of torsos, in one
file.

All three are learned together (`learning.learner`) and stored together; lengths and torsos are in
body units (the mean length of a subject's limb bones is one). The usual way in:
`Anatomy.default()`, `Anatomy.load(path)`."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from poseterior.probmodel.anatomy.limits import FILE, AnatomicalLimits, embedded_file
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.arrays import compact, doubles, possible, read_tables, write_tables
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import NUM_LENGTHS, TORSO_JOINTS


class LengthPrior(NamedTuple):
    """Ranges `low`, `high` (body units) and Beta parameters `alpha`, `beta` of the groups, `(5,)`
    each."""

    low: np.ndarray | jax.Array
    high: np.ndarray | jax.Array
    alpha: np.ndarray | jax.Array
    beta: np.ndarray | jax.Array


_LENGTH_KEYS = tuple(f"length_{field}" for field in LengthPrior._fields)
_KEYS = (*_LENGTH_KEYS, "torsos")


@dataclasses.dataclass(frozen=True)
class Anatomy:
    """What is learned of a population.

    Parameters
    ----------
    limits
        Which directions are possible.
    lengths
        Arrays `(5,)`, body units.
    torsos : `(J, 6, 3)`
        In body axes (x to the person's left, y up, z forward; right-handed) and body units, pelvis
        at the origin, joints in the order of `skeleton.TORSO_JOINTS`.
    """

    limits: AnatomicalLimits
    lengths: LengthPrior
    torsos: np.ndarray

    @classmethod
    def default(cls) -> "Anatomy":
        """The embedded anatomy, learned from CMU motion capture; `probmodel/data/PROVENANCE.md`
        says how."""
        return cls.embedded("default")

    @classmethod
    def embedded(cls, name: str) -> "Anatomy":
        """One of those that come with the package: "default"; or "wide", of the same recordings
        with twice the margins around what was seen, for people who do what nobody there did.

        Parameters
        ----------
        name
            One of `EMBEDDED`.

        Returns
        -------
        Anatomy
            Lengths and torsos are the same in all.

        Raises
        ------
        BadInput
            On another name.
        """
        with embedded_file(name) as path:
            anatomy = cls.load(path)
        return dataclasses.replace(anatomy, limits=dataclasses.replace(anatomy.limits, name=name))

    @classmethod
    def load(cls, path: str | os.PathLike) -> "Anatomy":
        """Reads what `save` wrote. Limits alone (`AnatomicalLimits.save`, or the published .mat of
        Akhter & Black) get the default lengths and torsos.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        Anatomy
            What is in it.

        Raises
        ------
        BadInput
            On anything else.
        """
        path = Path(path)
        if path.suffix.lower() == ".mat":
            return dataclasses.replace(cls.default(), limits=read_published(path))
        arrays = read_tables(path, *FILE)
        limits = AnatomicalLimits.unpack(arrays, path)
        present = [key for key in _KEYS if key in arrays]
        if not present:
            return dataclasses.replace(cls.default(), limits=limits)
        if len(present) < len(_KEYS):
            missing = ", ".join(key for key in _KEYS if key not in arrays)
            raise BadInput(
                f"{path} lacks {missing}, so it is damaged; write one with `poseterior learn`"
            )
        return cls(limits, _lengths(arrays, path), _torsos(arrays["torsos"], path))

    def save(self, path: str | os.PathLike) -> None:
        """Writes one .npz, whole or not at all and without loss.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        BadInput
            Where it cannot be written.
        """
        tables = dict(zip(_LENGTH_KEYS, self.lengths, strict=True)) | {"torsos": self.torsos}
        write_tables(
            path,
            self.limits.pack() | {key: compact(np.asarray(value)) for key, value in tables.items()},
        )


def _finite(value: np.ndarray, key: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    if value.dtype.kind != "f" or value.shape != shape:
        raise BadInput(
            f"{path}: {key} has shape {value.shape}, an anatomy has {shape}; is it another model?"
        )
    numbers = doubles(value)
    if not possible(numbers):
        raise BadInput(f"{path}: {key} holds a number that is not finite; write the file anew")
    return numbers


def _lengths(arrays: Mapping[str, np.ndarray], path: Path) -> LengthPrior:
    low, high, alpha, beta = (
        _finite(arrays[key], key, (NUM_LENGTHS,), path) for key in _LENGTH_KEYS
    )
    if not (np.all(low > 0) and np.all(high > low)):
        raise BadInput(
            f"{path}: a range of bone lengths is empty or reaches below zero; write the file anew"
        )
    if not (np.all(alpha > 0) and np.all(beta > 0)):
        raise BadInput(
            f"{path}: a Beta distribution of bone lengths has a parameter that is not positive"
        )
    return LengthPrior(low, high, alpha, beta)


def _torsos(value: np.ndarray, path: Path) -> np.ndarray:
    torsos = _finite(value, "torsos", (len(value) if value.ndim else 0, len(TORSO_JOINTS), 3), path)
    if not len(torsos):
        raise BadInput(f"{path}: the dictionary of torsos is empty; write the file anew")
    return torsos
