"""Anatomical limits: which bone directions a body can take, after Akhter & Black (CVPR 2015).

Upper bones have a table of occupied cells (azimuth × elevation in the torso's axes, 3° each).
Lower bones have, for each cell of their parent, a plane and a box: a local unit vector u is
possible iff n·u + d < 0 and bnd1 ≤ e2·u ≤ bnd2 and bnd3 ≤ e3·u ≤ bnd4, with (n, e2, e3) an
orthonormal triple (docs/model.md § 2). The usual way in: `AnatomicalLimits.default()`,
`.load(path)`, `.check(joints)`.
"""

import dataclasses
import functools
import hashlib
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from scipy.spatial import cKDTree

from poseterior.probmodel.arrays import compact, doubles, possible, read_tables, write_tables
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.kinematics import Articulation, articulation, azimuth_elevation, direction
from poseterior.probmodel.skeleton import BONE_NAMES, NUM_JOINTS, NUM_LOWER, NUM_UPPER

CELL = np.pi / 60
"""Side of a cell: 3° in azimuth and in elevation."""
NUM_AZIMUTH, NUM_ELEVATION = 120, 60
GRID = (NUM_AZIMUTH, NUM_ELEVATION)

_SHAPES = {
    "occupied": (NUM_UPPER, *GRID),
    "normal": (NUM_LOWER, *GRID, 3),
    "tangent": (NUM_LOWER, *GRID, 3),
    "offset": (NUM_LOWER, *GRID),
    "bounds": (NUM_LOWER, *GRID, 4),
    "reference": (3,),
    "fallback": (NUM_LOWER, 3),
}
_PLANES = ("normal", "tangent", "offset", "bounds")
_BITS = {"occupied": "occupied", "has_plane": "offset"}
"""Arrays stored as packed bits, and the table whose shape each has."""
WRITER = "`poseterior learn`"
EMBEDDED = {"default": "limits.npz", "wide": "limits_wide.npz"}
"""Files in `probmodel.data`, by the names that commands know them by."""
FILE = ("limits file", f"write one with {WRITER}, or take one of {', '.join(EMBEDDED)}")
"""What a file of limits is called, and what to do where there is none."""
LIMITS = ("none", "occupancy", "parent", "plane", "box")
"""What a bone can break. `parent`: its parent bone points into a cell without a plane, where no
lower bone was ever seen."""


def embedded_file(name: str) -> AbstractContextManager[Path]:
    """Where the embedded tables of this name are. Raises `BadInput` where there are none."""
    if name not in EMBEDDED:
        raise BadInput(f"no embedded limits are called {shown(name)}; take {' or '.join(EMBEDDED)}")
    return resources.as_file(resources.files("poseterior.probmodel.data") / EMBEDDED[name])


def cell_of(vector: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Indices (azimuth, elevation) of the cells in which local unit vectors `(..., 3)` lie."""
    azimuth, elevation = azimuth_elevation(vector)
    column = jnp.floor((azimuth + jnp.pi) / CELL).astype(int) % NUM_AZIMUTH
    row = jnp.clip(jnp.floor((elevation + jnp.pi / 2) / CELL).astype(int), 0, NUM_ELEVATION - 1)
    return column, row


class Check(NamedTuple):
    """Verdict on poses, for each of `skeleton.BONES`.

    Parameters
    ----------
    valid : `(..., 9)` bool
        Whether the bone is possible.
    limit : `(..., 9)` int
        Which of `LIMITS` the bone breaks.
    excess : `(..., 9)`
        How far beyond the limit the bone is, in degrees; NaN for `parent`.
    """

    valid: np.ndarray
    limit: np.ndarray
    excess: np.ndarray

    @property
    def pose_valid(self) -> np.ndarray:
        """`(...)`: whether all nine bones are possible."""
        return self.valid.all(axis=-1)

    def sentences(self) -> list[str]:
        """What a single pose breaks, one sentence for each bone that breaks a limit."""
        words = {
            "occupancy": "points {:.1f}° outside the directions this bone can take",
            "parent": "hangs from a bone whose own direction is impossible",
            "plane": "bends {:.1f}° beyond the joint's plane",
            "box": "turns {:.1f}° beyond the joint's range",
        }
        rows = zip(BONE_NAMES, self.valid, self.limit, self.excess, strict=True)
        return [
            f"{name} {words[LIMITS[code]].format(far)}" for name, ok, code, far in rows if not ok
        ]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AnatomicalLimits:
    """The tables, a pytree of arrays; those of lower bones are NaN where the parent's cell has no
    plane.

    Parameters
    ----------
    occupied : `(5, 120, 60)` bool
        Cells into which an upper bone can point.
    normal, tangent : `(4, 120, 60, 3)`
        Of a lower bone's plane, by the parent's cell: n, of length one, and a vector that becomes
        e2 when it is made orthogonal to n.
    offset : `(4, 120, 60)`
        d of the plane.
    bounds : `(4, 120, 60, 4)`
        The box: bounds of e2·u, then of e3·u.
    reference, fallback : `(3,)`, `(4, 3)`
        Directions that fix a lower bone's local axes (`kinematics.lower_axes`).
    name
        Kept in results, beside the hash.
    """

    occupied: ArrayLike
    normal: ArrayLike
    tangent: ArrayLike
    offset: ArrayLike
    bounds: ArrayLike
    reference: ArrayLike
    fallback: ArrayLike
    name: str = dataclasses.field(default="unnamed", metadata={"static": True})

    @classmethod
    def default(cls) -> "AnatomicalLimits":
        """The embedded tables, learned from CMU motion capture by `poseterior learn`."""
        return cls.embedded("default")

    @classmethod
    def embedded(cls, name: str) -> "AnatomicalLimits":
        """One of the tables of `Anatomy.embedded`.

        Parameters
        ----------
        name
            One of `EMBEDDED`.

        Returns
        -------
        AnatomicalLimits
            The tables.

        Raises
        ------
        BadInput
            On another name.
        """
        with embedded_file(name) as path:
            return dataclasses.replace(cls.load(path), name=name)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "AnatomicalLimits":
        """Reads a file that `save` wrote.

        Parameters
        ----------
        path
            The .npz.

        Returns
        -------
        AnatomicalLimits
            The tables.

        Raises
        ------
        BadInput
            Where it is not one, is truncated or has other shapes.
        """
        return cls.unpack(read_tables(path, *FILE), Path(path))

    @classmethod
    def unpack(cls, arrays: Mapping[str, np.ndarray], path: Path) -> "AnatomicalLimits":
        """Inverse of `pack`.

        Parameters
        ----------
        arrays
            Of the .npz; other keys are ignored.
        path
            Named in messages.

        Returns
        -------
        AnatomicalLimits
            The tables.

        Raises
        ------
        BadInput
            Where arrays are missing or have other shapes.
        """
        missing = [
            key
            for key in ("occupied", "has_plane", *_PLANES, "reference", "fallback")
            if key not in arrays
        ]
        if missing:
            raise BadInput(
                f"{path} lacks {', '.join(missing)}, so it is no limits file; write one with"
                f" {WRITER}"
            )
        occupied = _unpack_bits(arrays["occupied"], "occupied", path)
        has_plane = _unpack_bits(arrays["has_plane"], "has_plane", path)
        shapes = {key: _SHAPES[key] for key in ("reference", "fallback")}
        shapes |= {key: (int(has_plane.sum()), *_SHAPES[key][3:]) for key in _PLANES}
        tables: dict[str, Any] = {}
        for key, shape in shapes.items():
            if arrays[key].shape != shape or arrays[key].dtype.kind != "f":
                raise BadInput(
                    f"{path}: {key} has shape {arrays[key].shape}, not {shape}; is it another"
                    " model?"
                )
            tables[key] = doubles(arrays[key])
        for key in _PLANES:
            whole = np.full(_SHAPES[key], np.nan)
            whole[has_plane] = tables[key]
            tables[key] = whole
        name = str(arrays["name"]) if "name" in arrays else path.stem
        limits = cls(**tables, occupied=occupied, name=name)
        limits.verify(str(path))
        return limits

    def verify(self, source: str) -> None:
        """Makes sure that shapes, finiteness and orthonormality are those of limits.

        Parameters
        ----------
        source
            Named in the message.

        Raises
        ------
        BadInput
            Where they are not.
        """
        for key, shape in _SHAPES.items():
            found = np.shape(getattr(self, key))
            if found != shape:
                raise BadInput(
                    f"{source}: {key} has shape {found}, limits have {shape}; is it another model?"
                )
        has_plane = self.has_plane
        if not np.all(np.asarray(self.occupied)[1:] <= has_plane):
            raise BadInput(
                f"{source}: some occupied cells of upper bones have no plane for the lower bone"
            )
        values = [np.asarray(getattr(self, key))[has_plane] for key in _PLANES]
        if not all(
            possible(value)
            for value in [*values, np.asarray(self.reference), np.asarray(self.fallback)]
        ):
            raise BadInput(f"{source}: a plane or box holds a number that is not finite")
        normal, tangent, _, bounds = values
        if normal.size and np.abs(np.linalg.norm(normal, axis=-1) - 1).max() > 1e-4:
            raise BadInput(f"{source}: a plane's normal is not of length one")
        if tangent.size and np.linalg.norm(np.cross(normal, tangent), axis=-1).min() < 1e-6:
            raise BadInput(f"{source}: a plane's normal and tangent are parallel")
        if (bounds[:, 0] > bounds[:, 1]).any() or (bounds[:, 2] > bounds[:, 3]).any():
            raise BadInput(f"{source}: a box's lower bound exceeds its upper bound")
        if not np.asarray(self.occupied).any(axis=(1, 2)).all():
            raise BadInput(f"{source}: an upper bone has no occupied cell at all")

    def save(self, path: str | os.PathLike) -> None:
        """Writes a compact .npz, whole or not at all and without loss.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        BadInput
            Where it cannot be written.
        """
        write_tables(path, self.pack())

    def pack(self) -> dict[str, np.ndarray]:
        """The tables as compact arrays for an .npz; planes are kept for their cells only."""
        has_plane = self.has_plane
        packed = {key: compact(np.asarray(getattr(self, key))[has_plane]) for key in _PLANES}
        return packed | {
            "occupied": np.packbits(np.asarray(self.occupied)),
            "has_plane": np.packbits(has_plane),
            "reference": np.asarray(self.reference, float),
            "fallback": np.asarray(self.fallback, float),
            "name": np.array(self.name),
        }

    @property
    def has_plane(self) -> np.ndarray:
        """`(4, 120, 60)` bool: the parent's cells that have a plane and a box."""
        return ~np.isnan(np.asarray(self.offset))

    @cached_property
    def sha256(self) -> str:
        """Hash of the tables themselves, however they were stored."""
        digest = hashlib.sha256()
        for key, shape in _SHAPES.items():
            digest.update(key.encode() + str(shape).encode())
            digest.update(np.ascontiguousarray(np.asarray(getattr(self, key), "<f8")).tobytes())
        return digest.hexdigest()

    def triples(self) -> jax.Array:
        """Orthonormal triples `(4, 120, 60, 3, 3)`, rows n, e2 (Gram–Schmidt of normal and
        tangent), e3 = n × e2."""
        normal, tangent = jnp.asarray(self.normal), jnp.asarray(self.tangent)
        normal = normal / jnp.linalg.norm(normal, axis=-1, keepdims=True)
        second = tangent - jnp.sum(tangent * normal, axis=-1, keepdims=True) * normal
        second = second / jnp.linalg.norm(second, axis=-1, keepdims=True)
        return jnp.stack([normal, second, jnp.cross(normal, second)], axis=-2)

    def check(self, joints: ArrayLike) -> Check:
        """Says which bones of poses are possible, which limit the others break, and by how much.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            In any right-handed axes and any unit.

        Returns
        -------
        Check
            Leaves start with `...`: for each of the nine bones, whether it is possible, which limit
            it breaks, and by how many degrees.

        Raises
        ------
        BadInput
            On another shape, a coordinate that is not finite, or a bone of length zero.
        """
        joints = _credible(joints)
        if 0 in joints.shape:
            empty = np.zeros((*joints.shape[:-2], len(BONE_NAMES)))
            return Check(empty == 0, empty.astype(int), empty)
        upper, lower, column, row = self._located(joints)
        upper_limit, upper_excess = self._check_upper(upper, column, row)
        lower_limit, lower_excess = self._check_lower(lower, column[:, 1:], row[:, 1:])
        shape = (*joints.shape[:-2], len(BONE_NAMES))
        limit = np.concatenate([upper_limit, lower_limit], axis=-1).reshape(shape)
        excess = np.concatenate([upper_excess, lower_excess], axis=-1).reshape(shape)
        return Check(limit == 0, limit, excess)

    def margin(self, joints: ArrayLike) -> np.ndarray:
        """How far bones of poses are from what is impossible for them.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            As `check` takes them, at least one pose.

        Returns
        -------
        ndarray
            `(..., 9)`, degrees: the least turn by which the bone alone breaks a limit; where it
            breaks one, 0 less the excess of `check`.

        Raises
        ------
        BadInput
            As `check`.
        """
        joints = _credible(joints)
        found = self.check(joints)
        upper, lower, column, row = self._located(joints)
        free = [self._distance(bone, upper[:, bone], False) for bone in range(NUM_UPPER)]
        bent = self._lower_margin(lower, column[:, 1:], row[:, 1:])
        margin = np.column_stack([*free, bent]).reshape(found.excess.shape)
        return np.where(found.valid, margin, -found.excess)

    def _located(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Local directions `(n, 5, 3)` and `(n, 4, 3)` of all poses in a row, and the cells (two
        `(n, 5)`) of their upper bones. Raises `BadInput` on a bone of length zero."""
        locate = functools.partial(_locate, jnp.asarray(self.reference), jnp.asarray(self.fallback))
        local, column, row = in_chunks(locate, joints.reshape(-1, NUM_JOINTS, 3))
        if not np.all(local.length > 0):
            raise BadInput("a pose has a bone of length zero, which has no direction to check")
        return local.upper, local.lower, column, row

    def _check_upper(
        self, upper: np.ndarray, column: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        valid = np.asarray(self.occupied)[np.arange(NUM_UPPER), column, row]
        excess = np.zeros(valid.shape)
        for bone in range(NUM_UPPER):
            outside = ~valid[..., bone]
            if outside.any():
                excess[outside, bone] = self._distance(bone, upper[..., bone, :][outside], True)
        return np.where(valid, 0, LIMITS.index("occupancy")), excess

    def _distance(self, bone: int, vectors: np.ndarray, occupied: bool) -> np.ndarray:
        """Degrees from unit vectors `(n, 3)` to the nearest cell that is occupied, or is not, whose
        borders are sampled every 0.5°."""
        if (bone, occupied) not in self._trees:
            cells = np.asarray(self.occupied)[bone] == occupied
            self._trees[bone, occupied] = cKDTree(_cell_points(cells))
        chord, _ = self._trees[bone, occupied].query(vectors)
        return np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))

    @cached_property
    def _trees(self) -> dict[tuple[int, bool], cKDTree]:
        return {}

    def _check_lower(
        self, lower: np.ndarray, column: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        where = (np.arange(NUM_LOWER), column, row)
        coordinate = np.einsum("...ij,...j->...i", self._host_triples[where], lower)
        offset, bounds = np.asarray(self.offset)[where], np.asarray(self.bounds)[where]
        beyond_plane = coordinate[..., 0] + offset
        low, high = bounds[..., 0::2], bounds[..., 1::2]
        inside = np.clip(coordinate[..., 1:], low, high)
        no_plane = np.isnan(offset)
        broken = [no_plane, beyond_plane >= 0, (inside != coordinate[..., 1:]).any(axis=-1)]
        limit = np.select(broken, [LIMITS.index(name) for name in ("parent", "plane", "box")], 0)
        plane_excess = _arcsine(coordinate[..., 0]) - _arcsine(-offset)
        box_excess = np.abs(_arcsine(coordinate[..., 1:]) - _arcsine(inside)).max(axis=-1)
        return limit, np.select(
            broken, [np.full(no_plane.shape, np.nan), plane_excess, box_excess], 0.0
        )

    def _lower_margin(self, lower: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Degrees `(n, 4)` from a possible bone to its plane or the nearest side of its box."""
        where = (np.arange(NUM_LOWER), column, row)
        coordinate = _arcsine(np.einsum("...ij,...j->...i", self._host_triples[where], lower))
        bounds = np.asarray(self.bounds)[where]
        sides = np.where(np.abs(bounds) < 1, _arcsine(bounds), np.inf * np.sign(bounds))
        return np.min(
            [
                _arcsine(-np.asarray(self.offset)[where]) - coordinate[..., 0],
                *np.moveaxis(coordinate[..., 1:] - sides[..., 0::2], -1, 0),
                *np.moveaxis(sides[..., 1::2] - coordinate[..., 1:], -1, 0),
            ],
            axis=0,
        )

    @cached_property
    def _host_triples(self) -> np.ndarray:
        return np.asarray(self.triples())


def _credible(joints: ArrayLike) -> np.ndarray:
    """Poses `(..., 15, 3)` as numbers. Raises `BadInput` as `AnatomicalLimits.check`."""
    joints = np.asarray(joints, float)
    if joints.shape[-2:] != (NUM_JOINTS, 3):
        raise BadInput(f"poses have shape {joints.shape}; the check needs (..., {NUM_JOINTS}, 3)")
    if not np.isfinite(joints).all():
        raise BadInput(
            "a pose has a coordinate that is not finite; the check needs all fifteen joints"
        )
    return joints


def _unpack_bits(bits: np.ndarray, key: str, path: Path) -> np.ndarray:
    size = int(np.prod(_SHAPES[_BITS[key]]))
    if bits.dtype != np.uint8 or bits.shape != (size // 8,):
        raise BadInput(
            f"{path}: {key} has shape {bits.shape}, a limits file has ({size // 8},) bytes of bits"
        )
    return np.unpackbits(bits).reshape(_SHAPES[_BITS[key]]).astype(bool)


@jax.jit
def _locate(
    reference: jax.Array, fallback: jax.Array, joints: jax.Array
) -> tuple[Articulation, jax.Array, jax.Array]:
    """Local directions of a chunk of poses, and the cells of their upper bones."""
    local = articulation(joints, reference, fallback)
    return local, *cell_of(local.upper)


def _arcsine(value: np.ndarray) -> np.ndarray:
    return np.degrees(np.arcsin(np.clip(value, -1, 1)))


def _cell_points(occupied: np.ndarray) -> np.ndarray:
    """Points `(n, 3)` on a 0.5° mesh, borders included, of the occupied cells that have a free
    neighbour."""
    padded = np.pad(np.pad(occupied, ((1, 1), (0, 0)), mode="wrap"), ((0, 0), (1, 1)), mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    cells = np.argwhere(occupied & ~inner)
    steps = np.linspace(0, 1, 7)
    azimuth = (cells[:, 0, None, None] + steps[:, None]) * CELL - np.pi
    elevation = (cells[:, 1, None, None] + steps) * CELL - np.pi / 2
    return np.asarray(direction(*np.broadcast_arrays(azimuth, elevation))).reshape(-1, 3)
