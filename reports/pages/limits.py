"""How the embedded limits compare with the published ones, and how far they hold for people and
recordings that they were not learned from: writes reports/limits.md and its picture.

    python -m poseterior.reports.pages.limits ../shared/data

Ten minutes.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from poseterior.probmodel.anatomy.limits import GRID, AnatomicalLimits
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.body import mirror_pose
from poseterior.probmodel.kinematics import articulation
from poseterior.probmodel.learning.limits import learn_limits
from poseterior.probmodel.learning.occupancy import occupancy
from poseterior.probmodel.learning.overlap import Overlap, overlap
from poseterior.probmodel.learning.poses import Poses, gather
from poseterior.probmodel.learning.sphere import cell_areas, cells_of
from poseterior.probmodel.learning.tolerance import Tolerance
from poseterior.probmodel.motion import Motion, read_motion
from poseterior.probmodel.skeleton import BONE_NAMES, UPPER_BONES
from poseterior.reports.figures.limits import limits_figure
from poseterior.reports.pages.page import Data, Page, run
from poseterior.reports.tables import Column, Sheet, sheet_of, spoken

LIMIT_SOURCES = ("cmu/asfamc", "cmu/actions_train.npz", "bvh")
LIMIT_SUBJECTS = {
    "01": ("01",),
    "02 and the action set": ("02", "actions_train"),
    "03": ("03",),
    "131": ("cmu_131_03",),
}
FOLDS = 5
RADII = (0, 2, 4, 6, 8, 10, 12, 15)
"""Degrees of tolerance that are tried for upper bones."""
LOWER = ((10, 4), (25, 0), (25, 4), (25, 8), (35, 4))
"""Neighbourhoods and margins, degrees, that are tried for lower bones."""


def percent(value: float | None) -> str:
    """A share in percent; nothing for one that is not known."""
    return "" if value is None else f"{100 * value:.1f} %"


def both(pair: tuple[float, float]) -> str:
    """Two shares in percent, with a stroke between."""
    return " / ".join(map(percent, pair))


def comparison(limits: AnatomicalLimits, published: AnatomicalLimits) -> Sheet:
    """Areas of the tables, and what they have in common."""
    given = overlap(limits, published)
    joint = overlap(limits, published, joint=True)
    rows = [
        (
            spoken(bone),
            float(given.area[i]),
            float(given.other_area[i]),
            *shares(given, i),
            *(shares(joint, i) if i >= len(UPPER_BONES) else (None, None)),
        )
        for i, bone in enumerate(BONE_NAMES)
    ]
    areas = [Column(head, form="{:.2f}".format) for head in ("ours (sr)", "published (sr)")]
    heads = ("covered", "outside", "covered, with parent", "outside, with parent")
    return sheet_of(["bone", *areas, *(Column(head, form=percent) for head in heads)], rows)


def shares(measure: Overlap, bone: int) -> tuple[float, float]:
    """What is covered and what is outside."""
    return float(measure.covered[bone]), float(measure.outside[bone])


def upper_frontier(poses: Poses, published: AnatomicalLimits) -> Sheet:
    """Covered and outside of upper bones, for several radii."""
    upper = upper_directions(poses.joints)
    area = cell_areas()
    rows = []
    for radius in RADII:
        cells = [
            occupancy(upper[:, bone], radius, Tolerance.closing) for bone in range(len(UPPER_BONES))
        ]
        pairs = zip(cells, np.asarray(published.occupied), strict=True)
        found = (covered_and_outside(ours, theirs, area) for ours, theirs in pairs)
        rows.append((f"{radius}°", *found))
    bones = (Column(spoken(bone.name), form=both) for bone in UPPER_BONES)
    return sheet_of(["radius", *bones], rows)


def lower_frontier(poses: Poses, published: AnatomicalLimits) -> Sheet:
    """Covered and outside of lower bones, for several margins and neighbourhoods."""
    rows = []
    for neighbourhood, margin in LOWER:
        tolerance = dataclasses.replace(Tolerance(), neighbourhood=neighbourhood, lower=margin)
        measure = overlap(learn_limits(poses.joints, tolerance), published)
        found = (shares(measure, i) for i in range(len(UPPER_BONES), len(BONE_NAMES)))
        rows.append((f"{neighbourhood}°", f"{margin}°", *found))
    bones = (Column(spoken(name), form=both) for name in BONE_NAMES[len(UPPER_BONES) :])
    return sheet_of(["neighbourhood", "margin", *bones], rows)


def covered_and_outside(
    ours: np.ndarray, theirs: np.ndarray, area: np.ndarray
) -> tuple[float, float]:
    """The share of their area that our cells cover, and the share of ours that lies outside of
    theirs, from tables of cells and the cells' areas."""
    common = area[ours & theirs].sum()
    return common / area[theirs].sum(), 1 - common / area[ours].sum()


def upper_directions(joints: np.ndarray) -> np.ndarray:
    """`(2N, 5, 3)`: local directions of the upper bones in poses `(N, 15, 3)` and their mirror
    images."""
    limits = AnatomicalLimits.default()
    both_sides = np.concatenate([joints, mirror_pose(joints)])
    return np.asarray(articulation(both_sides, limits.reference, limits.fallback).upper)


def seen_beyond(poses: Poses, published: AnatomicalLimits) -> Sheet:
    """The area of cells in which a direction was seen, and the share of it that the published
    tables do not have."""
    upper = upper_directions(poses.joints)
    area = cell_areas()
    rows = []
    for index, bone in enumerate(UPPER_BONES):
        seen = np.zeros(GRID, bool)
        seen[cells_of(upper[:, index])] = True
        beyond = area[seen & ~np.asarray(published.occupied)[index]].sum()
        rows.append((spoken(bone.name), area[seen].sum(), beyond / area[seen].sum()))
    seen_area = Column("seen (sr)", form="{:.2f}".format)
    return sheet_of(
        ["bone", seen_area, Column("of it, outside the published table", form=percent)], rows
    )


def generalisation(
    motions: list[Motion], limits: AnatomicalLimits, published: AnatomicalLimits
) -> Sheet:
    """Share of frames valid, under limits learned with and without them."""
    everything = gather(motions).joints
    rows = [
        ("all, learned from", len(everything), *valid(limits, everything)),
        ("all, published limits", len(everything), *valid(published, everything)),
    ]
    for label, subjects in LIMIT_SUBJECTS.items():
        own = held_out(motions, lambda i, motion, who=subjects: motion.subject in who)
        rows.append((f"subject {label}", *own))
    folds = np.array(
        [held_out(motions, lambda i, motion, fold=fold: i % FOLDS == fold) for fold in range(FOLDS)]
    )
    means = folds[:, 0] @ folds[:, 1:] / folds[:, 0].sum()
    rows.append((f"recordings, {FOLDS} folds", folds[:, 0].sum(), *means))
    bones = (Column(head, form="{:.3f}".format) for head in ("all nine", *map(spoken, BONE_NAMES)))
    return sheet_of(["frames", Column("number", form="{:.0f}".format), *bones], rows)


def held_out(motions: list[Motion], out: Callable[..., bool]) -> list[float]:
    """Learns without some recordings and checks them: their number of frames, and shares valid."""
    kept = [motion for i, motion in enumerate(motions) if not out(i, motion)]
    left = gather([motion for i, motion in enumerate(motions) if out(i, motion)]).joints
    return [len(left), *valid(learn_limits(gather(kept).joints, Tolerance()), left)]


def valid(limits: AnatomicalLimits, joints: np.ndarray) -> list[float]:
    """Share of poses valid, and of each bone."""
    check = limits.check(joints)
    return [float(check.pose_valid.mean()), *check.valid.mean(axis=0).tolist()]


def main(data: Data) -> Page:
    """Learns and compares, and writes the page and its picture."""
    motions = [motion for source in LIMIT_SOURCES for motion in read_motion(data / source)]
    # The tables of joint limits as they are embedded; the others are learned here.
    limits = Anatomy.default().limits
    published = read_published(data / "akhter_black" / "jointAngleModel_v2.mat")
    poses = gather(motions)
    upper = upper_directions(poses.joints)
    values = {
        "comparison": comparison(limits, published),
        "seen": seen_beyond(poses, published),
        "upper": upper_frontier(poses, published),
        "lower": lower_frontier(poses, published),
        "generalisation": generalisation(motions, limits, published),
    }
    return Page("limits", values, {"limits": limits_figure(limits, upper)})


if __name__ == "__main__":
    run(main)
