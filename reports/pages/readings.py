"""How often a wrong reading of a file is noticed, and a right one doubted: writes
reports/readings.md and its picture.

    python -m poseterior.reports.pages.readings ../shared/data

Poses of motion capture with every mistake (`inference.studies.misreadings`), and real detections,
read rightly and wrongly. Some twenty minutes.
"""

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.readings import (
    ASPECTS,
    BETTER_BY,
    FACE_THRESHOLD,
    READINGS,
    SIZE_THRESHOLD,
    Judge,
    Verdict,
    together,
)
from poseterior.inference.studies.misreadings import (
    READ_RIGHT,
    Study,
    evidences,
    exchanges,
    study,
    views,
)
from poseterior.probmodel import Anatomy, BadInput, Detection, PoseModel, read_detections
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import INK
from poseterior.reports.figures.style import page as blank_page
from poseterior.reports.pages.page import Data, Page, Values, run
from poseterior.reports.tables import Column, Sheet, sheet_of

FRESH = 200
"""Poses of another seed, for the thresholds were chosen on the first."""
READ_POSES, MISREAD_POSES = 500, 150
"""Poses in all, and those that are also misread in ways that are no exchange."""
ASYMMETRY_BINS = (0, 30, 60, 90)
WORDS = {
    "arms": "arms exchanged",
    "legs": "legs exchanged",
    "limbs": "arms and legs exchanged",
    "halves": "upper body exchanged",
    "shoulders": "shoulders exchanged",
    "hips": "hips exchanged",
    "whole": "everything exchanged",
    "mirrored": "image mirrored",
    "upside down": "y counted upwards",
    "order": "COCO's 17 points read as Human3.6M's",
    "reversed": "COCO's 17 points read backwards",
    **{f"x{factor:.2f}": f"image {factor:.2f} times too wide" for factor in ASPECTS},
}


def share(verdicts: Sequence[Verdict], people: int = 1) -> tuple[int, int]:
    """How many files of `people` are doubted, of how many."""
    starts = range(0, len(verdicts) - people + 1, people)
    files = [together(list(verdicts[start : start + people])) for start in starts]
    return sum(bool(file.noticed) for file in files), len(files)


def percent(counts: tuple[int, int]) -> str:
    """A count of how many, in percent."""
    count, whole = counts
    return f"{count / whole:.1%} ({count} of {whole})" if whole else "–"


def _with_error(found: Study) -> str:
    """How many people who were read rightly are doubted, with its standard error."""
    count, whole = share(found.verdicts[READ_RIGHT])
    doubted = count / whole
    return f"{doubted:.1%} ± {np.sqrt(doubted * (1 - doubted) / whole):.1%}"


def _percent_only(counts: tuple[int, int]) -> str:
    count, whole = counts
    return f"{count / max(whole, 1):.1%}"


def table(found: Study) -> Sheet:
    """Shares of doubted files by mistake, for files of one person, by view, and of ten."""
    bins = list(itertools.pairwise(ASYMMETRY_BINS))
    rows = []
    for kind, verdicts in found.verdicts.items():
        pairs = list(zip(verdicts, found.angles, strict=False))
        inside = [[one for one, angle in pairs if low <= angle < high] for low, high in bins]
        by_view = map(share, inside)
        rows.append((WORDS.get(kind, kind), share(verdicts), *by_view, share(verdicts, 10)))
    one = Column("one person", form=percent)
    ten = Column("ten people", form=percent)
    angles = (Column(f"view {low}–{high}°", form=_percent_only) for low, high in bins)
    return sheet_of(["read", one, *angles, ten], rows)


def real_people(data: Path) -> list[Detection]:
    """The people of the data pack of whom enough is seen; of AlphaPose's twenty frames of one
    person the first."""
    folder = data / "detections"
    files = sorted(
        [
            *folder.glob("openpose/*.json"),
            folder / "coco" / "test_coco.json",
            *folder.glob("mmpose/*.json"),
            folder / "mediapipe" / "pose_landmarks.pbtxt",
        ]
    )
    people = [person for file in files for person in read_detections(file, image_size=(1000, 667))]
    return [*people, read_detections(folder / "alphapose" / "alphapose-results_halpe26.json")[0]]


def real_table(judge: Judge, people: Sequence[Detection]) -> Sheet:
    """How many real people are doubted, read rightly and wrongly."""
    verdicts: dict[str, list[Verdict]] = {}
    for person in people:
        try:
            found = evidences(judge, person)
        except BadInput:
            continue  # too little of the torso is seen
        for kind, verdict in exchanges(person, found).items():
            verdicts.setdefault(kind, []).append(verdict)
    rows = [
        (WORDS.get(kind, kind), share(several), _names(several))
        for kind, several in verdicts.items()
    ]
    return sheet_of(["read", Column("doubted", form=percent), Column("as", left=True)], rows)


def _names(verdicts: Sequence[Verdict]) -> str:
    noticed = Counter(name for verdict in verdicts for name in verdict.noticed)
    return ", ".join(f"{name} {count}" for name, count in noticed.most_common())


def picture(found: Study) -> Figure:
    """Gains of the right readings and of the wrong ones, by kind: where they overlap, nothing can
    be told."""
    kinds = ["whole", *(reading.name for reading in READINGS)]
    figure = blank_page(8, 4.2, dpi=150)
    axes = figure.add_subplot()
    for row, kind in enumerate(kinds):
        column = found.verdicts[READ_RIGHT][0].names.index(kind)
        right = np.array([verdict.gains[0, column] for verdict in found.verdicts[READ_RIGHT]])
        for values, colour, shift in ((right, PALETTE[0], 0.17), (-right, PALETTE[1], -0.17)):
            at = row + shift + np.random.default_rng(row).uniform(-0.12, 0.12, len(values))
            axes.plot(np.clip(values, -60, 60), at, ".", ms=2, color=colour, alpha=0.5)
    axes.axvline(BETTER_BY, ymin=1 / len(kinds), color=INK, lw=0.8)
    axes.axvline(FACE_THRESHOLD, ymax=1 / len(kinds), color=INK, lw=0.8)
    axes.set_xscale("symlog", linthresh=5)
    axes.set_yticks(range(len(kinds)), [WORDS[kind] for kind in kinds], fontsize=8)
    words = "nats by which the exchange explains one person better; right of the line a file is"
    axes.set_xlabel(f"{words} doubted", fontsize=8)
    axes.set_title("Blue: read rightly. Orange: read with this exchange", loc="left", fontsize=9)
    return figure


def main(data: Data) -> Page:
    """Runs the study and writes page and picture."""
    judge = Judge(PoseModel.from_anatomy(Anatomy.default()))
    motions = data / "cmu" / "actions_train.npz"
    found = study(judge, views(motions, READ_POSES, seed=5), first=MISREAD_POSES)
    fresh = study(judge, views(motions, FRESH, seed=6), first=0)
    spread = np.abs(found.asymmetry)
    values: Values = {
        "table": table(found),
        "fresh_table": table(fresh),
        "fresh": FRESH,
        "others": MISREAD_POSES,
        "poses": READ_POSES,
        "right": _with_error(found),
        "right_fresh": _with_error(fresh),
        "size_threshold": f"{SIZE_THRESHOLD:g}",
        "better_by": f"{BETTER_BY:g}",
        "face_threshold": f"{FACE_THRESHOLD:g}",
        "real": real_table(judge, real_people(data)),
        "symmetry": (
            f"{np.median(spread):.2f} nats in the median, {np.quantile(spread, 0.95):.1f} for 95 %"
        ),
    }
    return Page("readings", values, {"readings": picture(found)})


if __name__ == "__main__":
    run(main)
