"""What the field asks of samples of a pose, whoever made them: the best of N, and where the truth
stands among them.

Poses are in millimetres and camera axes. "Root-aligned" puts both pelvises on one point;
"Procrustes" moves, turns and scales a sample onto the truth. Hypotheses are the samples in their
order: an exact posterior's are random, so that the first N are as good as any.
"""

from collections.abc import Collection
from typing import Any

import numpy as np

from poseterior.inference.studies.calibration.assess import ECE_STAND_INS, FEWEST_DRAWS
from poseterior.inference.studies.errors import aligned_errors
from poseterior.inference.studies.intervals import TAIL
from poseterior.inference.studies.levels import (
    median_levels,
    rank_level,
    stand_in_levels,
)
from poseterior.inference.studies.measured import MeasureStandings, standings_of
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.datasets.cases import SMALLEST, TALLEST, body_height
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS

BESTS = (1, 5, 10, 50, 200)
"""How many hypotheses the best is taken of."""
WITHOUT_UNIT = ("best_procrustes",)
"""What can be said of samples that are not in millimetres."""
ECE_SAMPLES = 200
"""Samples of which the field's calibration error is made."""
JUDGED_JOINTS = tuple(range(1, NUM_JOINTS))
"""All joints but the pelvis, which is the origin of both."""
JUDGED_NAMES = tuple(JOINTS[joint] for joint in JUDGED_JOINTS)
_BY_AXIS = {"judged": len(JUDGED_JOINTS), "axis": 3}
SAMPLE_SHAPES: dict[str, dict[str, int]] = {
    "best_root": {"best": len(BESTS)},
    "best_procrustes": {"best": len(BESTS)},
    "across": {},
    "level": {"judged": len(JUDGED_JOINTS)},
    "stand_in": {"replicate": ECE_STAND_INS, "judged": len(JUDGED_JOINTS)},
    "standing": _BY_AXIS,
    "beyond": _BY_AXIS,
    "width": _BY_AXIS,
    **{f"measure_{name}": {"measure": len(MEASURES)} for name in MeasureStandings._fields},
}
"""What `of_samples` returns, by name: sizes by dimension."""


def of_samples(
    joints: np.ndarray,
    off: np.ndarray,
    truth: np.ndarray,
    seen: np.ndarray,
    rng: np.random.Generator,
    *,
    given: Collection[int] = (),
    strays: np.ndarray | float = 0.0,
) -> dict[str, Any]:
    """Everything that tables of samples are made of, for one pose.

    Parameters
    ----------
    joints : `(n, 15, 3)` samples, mm.
    off : `(n, 15, 2)` how far from the truth they fall in the image, in mm at the person's
        distance.
    truth : `(15, 3)` mm.
    seen : `(15,)` bool, the joints that were detected.
    rng : breaks ties, and chooses the samples that stand in for the truth.
    given : joints that whoever sampled was told: nothing is asked of them.
    strays : `(n, 15, 3)` mm, errors that the truth may have (`Case.strays`), with which the samples
        are where the truth is ranked among them.

    Returns
    -------
    By the names of `SAMPLE_SHAPES`: `best_root` and `best_procrustes`, mm, the least mean joint
    error of the first N of `BESTS`; `across`, mm, the mean distance of samples of seen joints from
    the truth in the image; `level`, by joint, the share of samples nearer to their median than the
    truth is (Pierzchlewicz et al. 2022), and `stand_in`, the same of samples in place of the truth;
    `standing`, by joint and axis, the truth's rank among the samples, uniform if these are right;
    `beyond`, 1 where the truth lies beyond all of them; `width`, mm, of central intervals of 95 %;
    of joint angles, lengths and steps `MeasureStandings`, by names such as `measure_level`. NaN
    where samples are too few to say.
    """
    rooted = joints - joints[:, :1]
    truth = truth - truth[:1]
    far = np.linalg.norm(rooted - truth, axis=-1).mean(axis=-1)
    turned = aligned_errors(joints[: max(BESTS)], truth).mean(axis=-1)
    apart = np.linalg.norm(off, axis=-1)[:, seen]
    found = {
        "best_root": first_bests(far),
        "best_procrustes": first_bests(turned),
        "across": apart.mean(),
    }
    if len(joints) < FEWEST_DRAWS:
        return found | {
            name: np.full([*sizes.values()], np.nan)
            for name, sizes in SAMPLE_SHAPES.items()
            if name not in found
        }
    judged = (rooted + strays)[:, JUDGED_JOINTS]
    at = truth[list(JUDGED_JOINTS)]
    few = judged[:ECE_SAMPLES]
    low, high = np.quantile(rooted[:, JUDGED_JOINTS], [TAIL, 1 - TAIL], axis=0)
    standing = rank_level(at, judged, rng)
    found |= {
        "level": median_levels(at, few),
        "stand_in": stand_in_levels(few, rng.integers(0, len(few), ECE_STAND_INS)),
        "standing": standing,
        "beyond": ((at < judged.min(axis=0)) | (at > judged.max(axis=0))).astype(float),
        "width": high - low,
    }
    measured = standings_of(truth, rooted + strays, rooted, rng)
    found |= {f"measure_{name}": column for name, column in measured._asdict().items()}
    told = [JUDGED_JOINTS.index(joint) for joint in given if joint in JUDGED_JOINTS]
    for name in ("level", "stand_in"):
        found[name][..., told] = np.nan
    for name in ("standing", "beyond", "width"):
        found[name][told] = np.nan
    return found


def first_bests(errors: np.ndarray) -> np.ndarray:
    """The least of the first N of errors `(n,)`, for every N of `BESTS`; NaN where there are fewer
    than N."""
    least = np.minimum.accumulate(errors)
    return np.array([least[n - 1] if n <= len(least) else np.nan for n in BESTS])


def of_predictions(poses: np.ndarray, data: DataSet, seed: int = 0) -> dict[str, np.ndarray]:
    """`of_samples` of others' hypotheses `(N, H, 15, 3)` for the frames of a data set, in the
    skeleton's joints (`DataSet.corrected`), by name, a row a frame; the true camera says where they
    fall in the image. Where they are not in millimetres (no person would be so tall), only what has
    no unit is said."""
    metric = SMALLEST <= float(np.median(body_height(poses))) <= TALLEST
    rows = []
    for number, (joints, case) in enumerate(zip(poses, data, strict=True)):
        image = case.image(joints - joints[:, :1])
        off = (image - case.image(case.pose)) / case.scale
        rng = np.random.default_rng([seed, 3, number])
        seen = case.detection.score > 0
        errors = case.strays(rng, len(joints))
        rows.append(of_samples(joints, off, case.pose, seen, rng, strays=errors))
    found = {name: np.array([row[name] for row in rows]) for name in SAMPLE_SHAPES}
    if not metric:
        found |= {
            name: np.full_like(values, np.nan)
            for name, values in found.items()
            if name not in WITHOUT_UNIT
        }
    return found
