"""Every table that the compiled loops share, its columns named here and nowhere else.

A table that is looked up row by row, in no order, is a structured array:
`cells[i].mass` finds all of a row in one or two lines of the cache. A table that a
vectorised loop runs over is one record whose fields are columns: `block.end0[n]`.
Columns that are copied together have a name for all of them as well (`hinge`), which
shares their memory.

Measured with the four kernels of `blocks` on blocks of 512 (one core, time relative to
a plain array with numbered columns): such a record 1.00–1.05; a NamedTuple of arrays
1.01–1.09, and two to three times as long to compile; a structured array of rows
1.14–1.35, and 3.4 where the compiler gave up vector instructions."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from poseterior.inference.exact.loops.vectors import Reference

if TYPE_CHECKING:
    from poseterior.probmodel.directions.hinges import Hinge

Record = Any
"""A row, or a block of columns, of one of the structured arrays below."""


def _rows(names: tuple[str, ...], **together: tuple[str, ...]) -> np.dtype:
    """A row of numbers; each name of `together` covers several that follow one
    another."""
    return _layout(names, 1, (), together)


def _columns(names: tuple[str, ...], size: int, **together: tuple[str, ...]) -> np.dtype:
    """A record of columns of `size` numbers. From column to column it is not a power of
    two, or all would want the same place in the nearest cache."""
    stride = size + 8
    return _layout(names, stride, (stride,), together)


def _layout(
    names: tuple[str, ...], stride: int, shape: tuple[int, ...], together: dict[str, tuple]
) -> np.dtype:
    offsets = {name: 8 * stride * place for place, name in enumerate(names)}
    formats: list[Any] = [(float, shape)] * len(names)
    for whole, parts in together.items():
        offsets[whole] = offsets[parts[0]]
        formats.append((float, (len(parts), *shape)))
    fields: Any = {
        "names": list(offsets),
        "formats": formats,
        "offsets": list(offsets.values()),
        "itemsize": 8 * stride * len(names),
    }
    return np.dtype(fields, align=True)


TRIPLE = tuple(f"{row}{axis}" for row in ("normal", "second", "third") for axis in range(3))
LIMITS = ("offset", "low2", "high2", "low3", "high3")
HINGE = TRIPLE + LIMITS
"""Where a lower bone may point: normal · u + offset < 0, second · u in [low2, high2],
third · u in [low3, high3]."""
BOX = ("box_low", "box_high", "box_first", "box_last")
"""The hinge's box: range of second · u, and of the angle around that axis (radians)."""

CELLS = _rows((*HINGE, *BOX, "area", "mass"), hinge=HINGE, triple=TRIPLE)
"""The upper bone's 7200 cells, row `column · 60 + line`: the lower bone's hinge under
each, its box and area, and the prior mass of the cell."""

AZIMUTHS = _rows(("sine", "cosine"))
"""Middle azimuths of sub-cells, column by column."""
ELEVATIONS = _rows(("sine", "cosine", "bottom", "top", "chord", "share"))
"""Elevations of sub-cells, line by line: the middle's sine and cosine, the sines at the
edges, how far as a chord a corner is from the middle, and the share of a cell's
surface."""

_ANGLES = ("sin_azimuth", "cos_azimuth", "lift", "fall")
SUBS = np.dtype([("cell", np.uint64), *((name, float) for name in _ANGLES)])
"""Sub-cells: their cell, the middle azimuth, and of elevation sine and cosine of the
middle or, where the upper measure is "area", the sines at the edges."""

ALIAS = np.dtype([("share", float), ("partner", np.int64)])
"""Walker's alias table: an entry's own share of its column, and who has the rest."""
ROOT_CELLS = np.dtype(
    [
        ("share", float),
        ("partner", np.uint32),
        ("code", np.uint32),
        ("low", float),
        ("span", float),
    ],
    align=True,
)
"""Cells in which a root may be: of the alias table of their masses an entry's own share
and who has the rest; the number of torso and cell, and of the inverse scale to its
`power` the lowest and how far it goes from there."""
ENTRIES = np.dtype([("region", float), ("sub", np.uint32), ("mask", np.uint8)], align=True)
"""Strata in order of their bins: bound on the area of a piece of the lower bone's
region (or the area of the hinge's box), the sub-cell, and which pieces are kept (0 for
the box)."""

SIGHT_FRAMES = np.dtype(
    [
        ("axes", float, (3, 3)),
        ("target", float, (2,)),
        ("reach", float),
        ("spread", float),
        ("deviation", float),
        ("start", float),
        ("slope", float, (3,)),
        ("stretch", float, (3,)),
        ("outlier", bool),
    ],
    align=True,
)
"""One joint of a limb in a frame of its own, whose third axis is the line of sight to
where the joint was detected; body units.

`axes` are the upper bone's local frame in this one, and the `target` is the detection
minus the limb's start, across the line of sight. The joint may fall within its `reach`,
infinite where nothing was seen; the `spread` is that of its errors, whose envelope is
Gaussian with this `deviation` or, where that is 0, uniform.

The joint's distance from the camera over the pelvis' is `start` + `slope` · what of the
limb leads to it, in the upper bone's local frame; under weak perspective 1. What lies
beside the line of sight becomes what lies beside it in a plane parallel to the image by
a symmetric matrix, the `stretch` xx, xy, yy; where the line runs straight on, the
identity."""
ACCEPTED = np.dtype(
    [
        ("draw", np.int64),
        ("weight", float),
        ("square", float, (2,)),
        ("upper", float, (3,)),
        ("lower", float, (3,)),
    ],
    align=True,
)
"""Proposals that explain their detections: under which draw of the lengths, the weight,
the squared distances of the joints from their targets, directions in local frames (the
lower one zero in limbs of one bone)."""
ROOTS = np.dtype(
    [
        ("torso", np.int64),
        ("angles", float, (3,)),
        ("inverse", float),
        ("plane", float, (2,)),
        ("number", np.int64),
        ("log_weight", float),
    ],
    align=True,
)
"""Roots: the torso's number, roll, tilt and yaw, the inverse scale, the translation
over the scale, the number of the proposal, and the log of what it counts (0 where all
count alike)."""
ROTATION_CELLS = np.dtype(
    [
        ("torso", np.int64),
        ("corner", float, (3,)),
        ("width", float, (3,)),
        ("least", float),
        ("top", float),
        ("star", float),
        ("share", float),
        ("partner", np.int64),
    ],
    align=True,
)
"""Cells of rotations in which a torso may fit: its number, the least roll, tilt and
yaw, the widths of these; a lower bound on χ² and an upper bound on the best inverse
scale, or approximations; where the tangent of v^m touches; and the columns of the alias
table of their masses."""

SLICES = _rows(("start", "width", "floor", "envelope"))
"""Slices of bins of lengths: start and width as fractions of the range, lower bound
over envelope, envelope of the density."""

SUB_BLOCK = 256
"""Sub-cells in a block."""
_GEOMETRY = ("image0", "image1", "spread", "chord", "turn", "mass", *HINGE, "box_area")
GEOMETRY = _rows(_GEOMETRY, known=_GEOMETRY, triple=TRIPLE)
"""What is known of a sub-cell: the upper bone's image and its length, the chord, the
frame's turn, the prior mass over the hinge's area, the hinge in camera axes (turned to
point from the lower bone's start to its end), the area of its box."""
REGIONS = _columns((*_GEOMETRY, "weight", "region", "mask"), SUB_BLOCK, known=_GEOMETRY)
"""A block of sub-cells and what is found for a bin of lengths: the stratum's weight, 0
where nothing is possible, and the columns of `ENTRIES`."""

BLOCK = 512
"""Proposals in a block: what a core keeps at hand."""
_RANDOM = (*_ANGLES, "across", "along", "test")
_UPPER = ("length1", "length2", "u0", "u1", "u2", "end0", "end1", "bound", "passed")
_LOWER = ("centre0", "centre1", "distance", "radius", "width", "low", "height", "side")
PROPOSAL_ROWS = _columns((*_RANDOM, *_UPPER, *_LOWER, "q0", "q1", "q2", *HINGE), BLOCK, hinge=HINGE)
"""A block of proposals for a limb: the sub-cell's angles and random numbers; the upper
bone `u`, its image `end`, what the stratum bounds, and a number positive where the
proposal goes on; the next joint's disc and the rectangle around it; the lower bone `q`
and its hinge."""


class LimbProblem(NamedTuple):
    """A limb in front of a camera.

    Attributes
    ----------
    axes : `(3, 3)` the limb's local frame in camera axes
    target : `(2, 2)` the detected joints minus the limb's start, body units
    reach : `(2,)` radii of their discs, body units, infinite where nothing was seen
    """

    axes: np.ndarray
    target: np.ndarray
    reach: np.ndarray


class LimbTables(NamedTuple):
    """What the model says of a limb.

    Attributes
    ----------
    cells : `(7200,)` `CELLS`
    reference : of the lower frame
    by_area : whether the upper measure is "area"
    flat : whether the lower measure is "box"
    bones : one or two
    """

    cells: np.ndarray
    reference: Reference
    by_area: bool
    flat: bool
    bones: int


class AcceptedRows(NamedTuple):
    """The proposals for one limb that explain its detections under many roots: `rows`
    `(m,)` `ACCEPTED`, and where in these the rows of each root end, `ends` `(n,)`."""

    rows: np.ndarray
    ends: np.ndarray


def cell_table(mass: np.ndarray, hinge: "Hinge | None" = None) -> np.ndarray:
    """The table of a limb's cells.

    Parameters
    ----------
    mass : `(120, 60)` prior mass of the upper bone's cells
    hinge : leaves `(120, 60, …)` of the lower bone, or None where the limb has one bone

    Returns
    -------
    `(7200,)` `CELLS`; a cell below which nothing is possible has no mass.
    """
    cells = np.zeros(mass.size, CELLS)
    cells["mass"] = mass.ravel()
    if hinge is not None:
        for names, leaf in (
            (TRIPLE, hinge.triple),
            (LIMITS[:1], hinge.offset),
            (LIMITS[1:], hinge.bounds),
            (BOX, hinge.box),
            (("area",), hinge.total),
        ):
            for name, column in zip(names, np.reshape(leaf, (mass.size, -1)).T, strict=True):
                cells[name] = column
        cells["mass"][cells["area"] <= 0] = 0.0
    return cells


class Grid(NamedTuple):
    """Trigonometry of cells cut into `sub` × `sub`: `azimuth` `(120 · sub,)`
    `AZIMUTHS`, `elevation` `(60 · sub,)` `ELEVATIONS`."""

    azimuth: np.ndarray
    elevation: np.ndarray
    sub: int


class Strata(NamedTuple):
    """The strata of one limb.

    Attributes
    ----------
    subs : `(s,)` `SUBS`
    alias, entries : `(n,)` `ALIAS` (within the bin) and `ENTRIES`
    starts, ends : `(bins,)` the entries [start, end) of each bin; between bins there
        may be room that nothing was written on
    totals : `(bins,)` weight of each bin
    """

    subs: np.ndarray
    alias: np.ndarray
    entries: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    totals: np.ndarray

    @property
    def size(self) -> int:
        """How many strata there are."""
        return int(np.sum(self.ends - self.starts))


class CutLimb(NamedTuple):
    """All that a proposal for a limb depends on."""

    problem: LimbProblem
    tables: LimbTables
    strata: Strata


class LengthLaw(NamedTuple):
    """Lengths low + span · Beta(alpha, beta), body units."""

    low: float
    span: float
    alpha: float
    beta: float


class LengthBins(NamedTuple):
    """Bins of one length group.

    Attributes
    ----------
    law : of the lengths
    mass : `(bins,)` prior probability
    proposed : `(bins,)` the envelope's, which is more
    edges : `(bins + 1,)` body units
    alias, slices : `(bins · slices,)` `ALIAS` (within the bin) and `SLICES`
    """

    law: LengthLaw
    mass: np.ndarray
    proposed: np.ndarray
    edges: np.ndarray
    alias: np.ndarray
    slices: np.ndarray


class Bodies(NamedTuple):
    """Draws of a group of limbs.

    Attributes
    ----------
    length : `(n, 2)` of their bones, body units; of limbs of one bone the second says
        nothing
    upper, lower : `(n, limbs, 3)` directions in their local frames; lower ones of one
        bone are zero
    """

    length: np.ndarray
    upper: np.ndarray
    lower: np.ndarray


def blank_bodies(number: int, limbs: int) -> Bodies:
    """Room for so many draws; memory that nothing is written on is not taken."""
    return Bodies(np.empty((number, 2)), np.empty((number, limbs, 3)), np.empty((number, limbs, 3)))


class Workspace(NamedTuple):
    """What one thread writes on; made once, since memory that is new to a process is
    slow.

    Attributes
    ----------
    length1, length2, bins : `(most,)` of each proposal
    rows : `(most,)` the proposals that have come to the limb
    accepted : `(most,)` places in `rows` of those that passed it
    upper, lower : `(most, 3)` their directions
    pieces, boxes : `(1,)` `PROPOSAL_ROWS`, one block each
    entry, place, left, slot : `(BLOCK,)` of each proposal of a block
    """

    length1: np.ndarray
    length2: np.ndarray
    bins: np.ndarray
    rows: np.ndarray
    accepted: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    pieces: np.ndarray
    boxes: np.ndarray
    entry: np.ndarray
    place: np.ndarray
    left: np.ndarray
    slot: np.ndarray


def workspace(most: int) -> Workspace:
    """A workspace for up to `most` proposals at a time."""

    def places(size: int) -> np.ndarray:
        return np.zeros(size, np.int64)

    return Workspace(
        length1=np.ones(most),
        length2=np.ones(most),
        bins=places(most),
        rows=places(most),
        accepted=places(most),
        upper=np.zeros((most, 3)),
        lower=np.zeros((most, 3)),
        pieces=np.zeros(1, PROPOSAL_ROWS),
        boxes=np.zeros(1, PROPOSAL_ROWS),
        entry=places(BLOCK),
        place=places(BLOCK),
        left=places(BLOCK),
        slot=places(BLOCK),
    )


def workspace_pair(most: int) -> tuple[Workspace, Workspace]:
    """Workspaces for a group's first limb and for its second, whose rows are those that
    the first has accepted, with the same lengths."""
    first = workspace(most)
    second = first._replace(
        rows=first.accepted,
        accepted=np.zeros_like(first.accepted),
        upper=np.zeros_like(first.upper),
        lower=np.zeros_like(first.lower),
    )
    return first, second
