"""How the embedded limits compare with the published ones, and how far they hold for people from
whom they were not learned: writes reports/limits.md and its picture.

    python -m poseterior.reports.pages.limits ../shared/data work

Half an hour; `work` keeps what is done, and a run that was stopped goes on there.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from poseterior import inference
from poseterior.inference import benchmark
from poseterior.probmodel import Detection
from poseterior.probmodel.anatomy.limits import GRID, AnatomicalLimits
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.body import mirror_pose
from poseterior.probmodel.datasets import from_motions
from poseterior.probmodel.kinematics import articulation
from poseterior.probmodel.learning.limits import learn_limits
from poseterior.probmodel.learning.overlap import Overlap, overlap
from poseterior.probmodel.learning.poses import gather, read_all
from poseterior.probmodel.learning.sphere import cell_areas, cells_of
from poseterior.probmodel.learning.tolerance import DEFAULT, Tolerance
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.skeleton import BONE_NAMES, UPPER_BONES
from poseterior.reports.figures.limits import limits_figure
from poseterior.reports.pages.page import Data, Page, Work, kept_json, run
from poseterior.reports.pages.people import CAPTURED_FILES, UNUSUAL
from poseterior.reports.pages.real import ERRORS
from poseterior.reports.tables import Column, Sheet, sheet_of, spoken

FIVE = Tolerance(arm=10, lower=4, neighbourhood=25, company=0)
TOLERANCES = {
    "as of five people: all counts": FIVE,
    "odd frames left out": dataclasses.replace(FIVE, company=5),
    "default": DEFAULT,
    "1.5 times the margins": DEFAULT.wider(1.5),
    "wide": DEFAULT.wider(2),
}
"""What is tried on people who are left out; the tables of five people were learned by the first."""
LEFT_OUT = (
    ("05", "90"),
    ("49", "69"),
    ("127", "14"),
    ("29", "01"),
    ("06", "07", "08", "09", "11", "16", "17", "26", "27", "32", "35"),
    ("02", "actions_train"),
    ("03", "cmu_12_01_walk", "cmu_131_03"),
)
"""Subjects, each learned from all others' recordings; the action set is on the skeleton of 02."""
OF_FIVE = ("01", *LEFT_OUT[-2], *LEFT_OUT[-1])
"""From whom the tables of five people were learned."""
MOST_UNUSUAL = ("05", "14", "29", "49", "69", "90", "127")
DEPTH_POSES, DEPTH_DRAWS, DEPTH_ROOTS = 24, 1500, 600
"""By which widths of depth are compared."""


def percent(value: float | None) -> str:
    """A share in percent; nothing for one that is not known."""
    return "" if value is None else f"{100 * value:.1f} %"


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


def upper_directions(joints: np.ndarray) -> np.ndarray:
    """`(2N, 5, 3)`: local directions of the upper bones in poses `(N, 15, 3)` and their mirror
    images."""
    limits = AnatomicalLimits.default()
    both_sides = np.concatenate([joints, mirror_pose(joints)])
    return np.asarray(articulation(both_sides, limits.reference, limits.fallback).upper)


def seen_beyond(poses: np.ndarray, published: AnatomicalLimits) -> Sheet:
    """The area of cells in which a direction was seen, and the share of it that the published
    tables do not have."""
    upper = upper_directions(poses)
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


Poses = Mapping[str, np.ndarray]
"""By subject, `(N, 15, 3)` body units."""


def poses_of(data: Path) -> dict[str, np.ndarray]:
    """All that was learned from, by subject."""
    motions = read_all([data / source for source in CAPTURED_FILES])
    subjects = list(dict.fromkeys(motion.subject for motion in motions))
    return {who: gather([one for one in motions if one.subject == who]).joints for who in subjects}


def possible(poses: Poses, tolerance: Tolerance) -> dict[str, list[float]]:
    """By subject, the share of poses possible under limits that were learned from others, and of
    each bone."""
    found: dict[str, list[float]] = {}
    for out in LEFT_OUT:
        rest = np.concatenate([joints for who, joints in poses.items() if who not in out])
        limits = learn_limits(rest, tolerance)
        found |= {who: valid(limits, poses[who]) for who in out}
    return found


def valid(limits: AnatomicalLimits, joints: np.ndarray) -> list[float]:
    """Share of poses valid, and of each bone."""
    check = limits.check(joints)
    return [float(check.pose_valid.mean()), *check.valid.mean(axis=0).tolist()]


def worth(poses: Poses, data: Path, tolerance: Tolerance) -> dict[str, float]:
    """Of limits learned from all: the share of these poses that is possible, how much room they
    leave beside the tables of five people, and how wide depth is then."""
    limits = learn_limits(np.concatenate([*poses.values()]), tolerance)
    five = benchmark.frozen_model().limits
    measure = overlap(limits, five, joint=True)
    free = [0, *range(len(UPPER_BONES), len(BONE_NAMES))]
    return {
        "own": valid(limits, np.concatenate([*poses.values()]))[0],
        "room": float(np.prod(measure.area[free] / measure.other_area[free])),
        "depth": depth(limits, data) / _depth_under_five(data),
    }


@functools.cache
def _depth_under_five(data: Path) -> float:
    return depth(benchmark.frozen_model().limits, data)


@functools.cache
def _detections(data: Path) -> list[Detection]:
    motions = read_all([data / UNUSUAL])
    some = from_motions(motions, "CMU", frames=DEPTH_POSES, noise=ERRORS["detector"])
    return [case.detection for case in some]


def depth(limits: AnatomicalLimits, data: Path) -> float:
    """Mean standard deviation of joints' depth beside the pelvis, body units, over detections of
    captured people; lengths and torsos are the embedded ones."""
    known = Anatomy.default()
    model = PoseModel(limits, known.lengths, known.torsos)
    spread = []
    for number, detection in enumerate(_detections(data)):
        drawn = inference.sample(
            model, detection, key=number, num_samples=DEPTH_DRAWS, num_roots=DEPTH_ROOTS
        )
        joints = drawn.tree["posterior"].joints.values[0]
        spread.append((joints - joints[:, :1])[:, 1:, 2].std(axis=0).mean())
    return float(np.mean(spread))


def tolerances(
    found: Mapping[str, Mapping[str, list[float]]], worths: Mapping[str, Mapping[str, float]]
) -> Sheet:
    """A line for each tolerance: what it allows of people left out, and what it costs."""
    rows = []
    for name, tolerance in TOLERANCES.items():
        own, cost = found[name], worths[name]
        margins = (tolerance.head, tolerance.arm, tolerance.leg, tolerance.lower)
        rows.append(
            (
                name,
                " / ".join(f"{margin:g}" for margin in margins) + "°",
                f"{tolerance.neighbourhood:g}°",
                _mean(own, list(own)),
                _mean(own, MOST_UNUSUAL),
                cost["own"],
                cost["room"],
                cost["depth"],
            )
        )
    shares = ("people left out", "the most unusual seven", "those learned from")
    return sheet_of(
        [
            *("tolerance", "head / arm / leg / lower", "neighbourhood"),
            *(Column(head, form=percent) for head in shares),
            Column("room, times", form="{:.1f}".format),
            Column("width of depth, times", form="{:.3f}".format),
        ],
        rows,
    )


def _mean(found: Mapping[str, list[float]], who: Sequence[str]) -> float:
    return float(np.mean([found[one][0] for one in who]))


def by_subject(poses: Poses, found: Mapping[str, Mapping[str, list[float]]]) -> Sheet:
    """A line for each subject: what is possible of its poses under limits that were learned from
    others, and which bone breaks them most often."""
    five = benchmark.frozen_model().limits
    rows = []
    for who in sorted(poses, key=lambda name: found["default"][name][0]):
        own = found["default"][who]
        worst = int(np.argmin(own[1:]))
        rows.append(
            (
                who.replace("_", " "),
                len(poses[who]),
                None if who in OF_FIVE else valid(five, poses[who])[0],
                own[0],
                found["wide"][who][0],
                ""
                if own[1 + worst] == 1
                else f"{spoken(BONE_NAMES[worst])}, {percent(1 - own[1 + worst])}",
            )
        )
    heads = ("tables of five people", "default", "wide")
    return sheet_of(
        [
            "subject",
            Column("poses", form="{:,}".format),
            *(Column(head, form=percent) for head in heads),
            Column("under default most often broken by", left=True),
        ],
        rows,
    )


def main(data: Data, work: Work) -> Page:
    """Learns and compares, and writes the page and its picture."""
    poses = poses_of(data)
    found, worths = {}, {}
    for number, (name, tolerance) in enumerate(TOLERANCES.items()):
        found[name] = kept_json(work / f"possible-{number}.json", possible, poses, tolerance)
        worths[name] = kept_json(work / f"worth-{number}.json", worth, poses, data, tolerance)
        print(name, flush=True)
    # The tables of joint limits as they are embedded; the others are learned here.
    limits = Anatomy.default().limits
    published = read_published(data / "akhter_black" / "jointAngleModel_v2.mat")
    everything = np.concatenate([*poses.values()])
    values: dict[str, str | int | Sheet] = {
        "frames": f"{len(everything):,}",
        "subjects": len(poses) - 1,  # The action set is on the skeleton of 02.
        "comparison": comparison(limits, published),
        "seen": seen_beyond(everything, published),
        "tolerances": tolerances(found, worths),
        "by_subject": by_subject(poses, found),
        "published": percent(valid(published, everything)[0]),
        "depth_poses": DEPTH_POSES,
    }
    return Page("limits", values, {"limits": limits_figure(limits, upper_directions(everything))})


if __name__ == "__main__":
    run(main)
