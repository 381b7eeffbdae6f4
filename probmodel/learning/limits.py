"""Joint limits from poses: occupied cells of upper bones, planes and boxes of lower ones.

The criterion is Akhter & Black's (CVPR 2015): what was seen is possible, but for what was seen by
itself alone, once among thousands of frames: a marker that slipped. What was not seen is possible
as far as a stated tolerance goes. The way in: `learn_limits(joints, tolerance)`."""

import jax
import numpy as np

from poseterior.probmodel.anatomy.limits import GRID, NUM_AZIMUTH, AnatomicalLimits
from poseterior.probmodel.arrays import single
from poseterior.probmodel.body import mirror_pose
from poseterior.probmodel.kinematics import articulation
from poseterior.probmodel.learning.hinges import FALLBACK, REFERENCE, Observations, fit_cell
from poseterior.probmodel.learning.occupancy import occupancy
from poseterior.probmodel.learning.poses import Progress
from poseterior.probmodel.learning.sphere import in_company
from poseterior.probmodel.learning.tolerance import Tolerance
from poseterior.probmodel.skeleton import LOWER_BONES, NUM_LOWER, NUM_UPPER

_TABLES: dict[str, tuple[int, ...]] = {
    "normal": (3,),
    "tangent": (3,),
    "offset": (),
    "bounds": (4,),
}


def learn_limits(
    joints: np.ndarray,
    tolerance: Tolerance,
    *,
    mirror: bool = True,
    name: str = "learned",
    progress: Progress | None = None,
) -> AnatomicalLimits:
    """Limits under which some poses are valid, all but the odd ones.

    Parameters
    ----------
    joints : `(N, 15, 3)`
    tolerance
    mirror
        Whether the poses' mirror images are valid too, and the tables of the left side are the
        mirror images of those of the right.
    name
        Name of the limits.
    progress
    """
    if mirror:
        joints = np.concatenate([joints, mirror_pose(joints)])
    fallback = np.tile(FALLBACK, (NUM_LOWER, 1))
    with jax.enable_x64(True):
        local = articulation(joints, REFERENCE, fallback)
        upper, lower = np.asarray(local.upper), np.asarray(local.lower)
    tables = {key: np.full((NUM_LOWER, *GRID, *shape), np.nan) for key, shape in _TABLES.items()}
    occupied = np.zeros((NUM_UPPER, *GRID), bool)
    for bone, radius in enumerate(tolerance.upper):
        seen = upper[:, bone]
        regular = in_company(seen, others=tolerance.company, degrees=tolerance.within)
        occupied[bone] = occupancy(seen[regular], radius, tolerance.closing)
    for bone, part in enumerate(LOWER_BONES):
        if progress is not None:
            progress(f"limits of the {part.name.replace('_', ' ')}", bone, NUM_LOWER)
        if mirror and part.name.startswith("left"):
            _mirror_tables(occupied, tables, bone)
        else:
            both = Observations.gather(upper[:, bone + 1], lower[:, bone], tolerance)
            _fit_cells(tables, bone, occupied[bone + 1], both, tolerance)
    if mirror:
        occupied[0] |= _mirror_cells(occupied[0])
    if progress is not None:
        progress("limits", NUM_LOWER, NUM_LOWER)
    return AnatomicalLimits(
        occupied=occupied,
        **{key: single(table) for key, table in tables.items()},
        reference=REFERENCE,
        fallback=fallback,
        name=name,
    )


def _fit_cells(
    tables: dict[str, np.ndarray],
    bone: int,
    occupied: np.ndarray,
    seen: Observations,
    tolerance: Tolerance,
) -> None:
    for column, row in np.argwhere(occupied):
        fit = fit_cell(seen.around(column, row, tolerance), tolerance.lower)
        for key, table in tables.items():
            table[bone, column, row] = getattr(fit, key)


def _mirror_cells(table: np.ndarray) -> np.ndarray:
    """A table `(120, 60, ...)` of the other side: mirrored directions have azimuth 180° minus the
    azimuth."""
    return table[(NUM_AZIMUTH // 2 - 1 - np.arange(NUM_AZIMUTH)) % NUM_AZIMUTH]


def _mirror_tables(occupied: np.ndarray, tables: dict[str, np.ndarray], left: int) -> None:
    """Fills a left limb's tables from those of the right limb, which come one before them.

    Mirrored, the axes (u, v, w) of a lower bone become (u, v, −w), since v = reference × u and the
    reference is the mirrored axis. So third components change their sign, and with the handedness
    of the plane's triple so does e3."""
    occupied[left + 1] = _mirror_cells(occupied[left])
    for table in tables.values():
        table[left] = _mirror_cells(table[left - 1])
    for key in ("normal", "tangent"):
        tables[key][left, ..., 2] *= -1
    tables["bounds"][left] = tables["bounds"][left][..., [0, 1, 3, 2]] * np.array([1, 1, -1, -1])
