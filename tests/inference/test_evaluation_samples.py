"""What the field asks of samples, against implementations of its definitions that share no code
with the product; normal samples that are right, and controls that are not.

False alarms: 1e-3 or less for each comparison of shares (binomial, written beside it); seeds are
fixed.
"""

import dataclasses
import functools
from typing import Any
from unittest import mock

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from poseterior import inference
from poseterior.inference.studies.evaluation.conditions import Condition, alike, conditions
from poseterior.inference.studies.evaluation.outcome import Protocol, judge_block
from poseterior.inference.studies.evaluation.samples import (
    BESTS,
    JUDGED_JOINTS,
    SAMPLE_SHAPES,
    first_bests,
    of_predictions,
    of_samples,
)
from poseterior.inference.studies.evaluation.scores import SampleScores, sample_scores
from poseterior.inference.studies.measured import no_standings
from poseterior.probmodel import Anatomy, BadInput
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.datasets import DataSet, from_motions
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.skeleton import LIMB_JOINTS, TORSO_INDEX

POSES, SAMPLES = 120, 200
ERROR = 0.007
"""Standard error of a coverage of 95 % by as many poses."""
SPREAD = np.array([30.0, 40.0, 90.0])
"""mm, of the normal posterior in x, y and depth."""


@functools.cache
def normal() -> tuple[np.ndarray, np.ndarray]:
    """Truths `(n, 15, 3)` and samples `(n, 200, 15, 3)` of one law given the middle of each pose,
    pelvis at the origin."""
    rng = np.random.default_rng(3)
    middle = rng.normal(0, 300, (POSES, 1, 15, 3))
    both = middle + SPREAD * rng.normal(size=(POSES, 1 + SAMPLES, 15, 3))
    both[..., 0, :] = 0.0
    return both[:, 0], both[:, 1:]


WITHOUT_MEASURES = mock.patch(
    "poseterior.inference.studies.evaluation.samples.standings_of",
    mock.Mock(return_value=no_standings()),
)
"""Joint angles and lengths are most of the work, and asked for by
`test_predictions_are_scored_as_samples`."""


@WITHOUT_MEASURES
def scored(samples: np.ndarray, recordings: int = 50) -> SampleScores:
    truths = normal()[0]
    rows = [
        of_samples(
            joints,
            (joints - truth)[..., :2],
            truth,
            np.ones(15, bool),
            np.random.default_rng([7, number]),
        )
        for number, (joints, truth) in enumerate(zip(samples, truths, strict=True))
    ]
    values = {name: np.array([row[name] for row in rows]) for name in SAMPLE_SHAPES}
    return sample_scores(values, np.arange(len(rows)) % recordings)


@functools.cache
def right() -> SampleScores:
    return scored(normal()[1])


def procrustes_error(pose: np.ndarray, truth: np.ndarray) -> float:
    """Written out: centred, turned by SciPy, scaled by least squares."""
    moved, aim = pose - pose.mean(axis=0), truth - truth.mean(axis=0)
    turned = Rotation.align_vectors(aim, moved)[0].apply(moved)
    scale = np.sum(turned * aim) / np.sum(turned**2)
    return float(np.mean([np.linalg.norm(scale * a - b) for a, b in zip(turned, aim, strict=True)]))


def test_best_of_n_as_a_reader_of_the_definition_would_write_it() -> None:
    truths, samples = normal()
    for number in range(3):
        truth, joints = truths[number], samples[number] + 5.0  # moved as a whole: nothing changes
        rng = np.random.default_rng(0)
        found = of_samples(joints, (joints - truth)[..., :2], truth, np.ones(15, bool), rng)
        plain = [
            float(np.mean([np.linalg.norm(one[j] - one[0] - truth[j]) for j in range(15)]))
            for one in joints
        ]
        turned = [procrustes_error(one, truth) for one in joints]
        for index, best in enumerate(BESTS):
            assert found["best_root"][index] == pytest.approx(min(plain[:best]))
            assert found["best_procrustes"][index] == pytest.approx(min(turned[:best]))
    means = [interval.value for interval in right().best_root]
    assert means == sorted(means, reverse=True)
    both = zip(right().best_root, right().best_procrustes, strict=True)
    assert all(root.value > turned.value for root, turned in both)


def test_the_best_of_more_than_there_are_is_unknown() -> None:
    assert np.isnan(first_bests(np.arange(7.0)[::-1])).tolist() == [False, False, True, True, True]


def published_ece(truths: np.ndarray, samples: np.ndarray) -> float:
    """As the authors compute it: quantiles of the samples' distances from their coordinate-wise
    median at 21 levels, how often each lies beyond the truth's distance, median over joints."""
    levels = np.arange(0, 1.05, 0.05)
    held = np.zeros((len(levels), len(JUDGED_JOINTS)))
    for truth, joints in zip(truths[:, JUDGED_JOINTS], samples[:, :, JUDGED_JOINTS], strict=True):
        middle = np.median(joints, axis=0)
        quantiles = np.quantile(np.linalg.norm(joints - middle, axis=-1), levels, axis=0)
        held += quantiles > np.linalg.norm(truth - middle, axis=-1)
    return float(np.mean(np.abs(np.median(held / len(truths), axis=1) - levels)))


def narrower(samples: np.ndarray, factor: tuple[float, float, float]) -> np.ndarray:
    middle = samples.mean(axis=1, keepdims=True)
    return middle + factor * (samples - middle)


@pytest.mark.parametrize("factor", [1.0, 0.5, 2.0])
def test_the_calibration_error_is_the_published_one(factor: float) -> None:
    """Their quantiles are interpolated between 200 samples, ours are shares of them: 1/200 apart at
    most in every level, and more only by truths that lie in between."""
    truths, samples = normal()
    spoilt = narrower(samples, (factor,) * 3)
    found = right() if factor == 1 else scored(spoilt)
    assert found.ece is not None
    assert found.ece.whole.value == pytest.approx(published_ece(truths, spoilt), abs=0.006)
    if factor == 1:
        assert found.ece.whole.value < 2 * found.ece.floor_95
    else:  # negative control
        assert found.ece.whole.low > 5 * found.ece.floor


def test_coverage_by_axis_tells_the_axes_apart() -> None:
    """Eight joints of 120 poses: 960 independent trials an axis, so that 95 % has a standard error
    of 0.7 %, and 3.5 of them a false alarm of 5e-4. Control: depth alone half as wide."""
    found = right()
    assert found.axes is not None
    assert [axis.value for axis in found.axes] == pytest.approx([0.95] * 3, abs=3.5 * ERROR)
    assert [axis.half for axis in found.axes] == pytest.approx([1.96 * ERROR] * 3, rel=0.4)
    assert found.width == pytest.approx(2 * 1.96 * SPREAD, rel=0.05)
    assert found.beyond == pytest.approx(2 / (SAMPLES + 1), abs=4 * 0.0019)
    spoilt = scored(narrower(normal()[1], (1.0, 1.0, 0.5)))
    assert spoilt.axes is not None
    assert spoilt.axes[:2] == found.axes[:2]
    assert spoilt.axes[2].high < 0.8


def test_coverage_is_right_with_few_samples_too() -> None:
    """Twenty samples have no quantile of 2.5 %: plain shares would hold nine truths in ten."""
    found = scored(normal()[1][:, :20])
    assert found.axes is not None
    assert [axis.value for axis in found.axes] == pytest.approx([0.95] * 3, abs=3.5 * ERROR)


@WITHOUT_MEASURES
def test_a_truth_that_errs_stands_where_it_would_without_errors() -> None:
    """Truths from the samples' own law, told with errors twice as large: covered as often as is
    said where samples are given such errors, and in 62 % (by hand) of cases where they are not.
    Widths and best are the samples' own."""
    truths, joints = normal()
    rng = np.random.default_rng(8)
    errors = 2 * SPREAD * rng.normal(size=truths.shape)
    more = 2 * SPREAD * rng.normal(size=joints.shape)
    errors[:, 0] = more[:, :, 0] = 0.0  # the origin

    def covered(strays: np.ndarray | None) -> tuple[list[float], dict[str, Any]]:
        rows = []
        for row, truth in enumerate(truths + errors):
            off = np.zeros((len(joints[row]), 15, 2))
            own = 0.0 if strays is None else strays[row]
            rows.append(of_samples(joints[row], off, truth, np.ones(15, bool), rng, strays=own))
        standing = np.array([row["standing"] for row in rows])
        return np.mean((standing > 0.025) & (standing < 0.975), axis=(0, 1)).tolist(), rows[0]

    told, one = covered(more)
    assert told == pytest.approx([0.95] * 3, abs=3.5 * ERROR)
    untold, other = covered(None)
    assert untold == pytest.approx([0.619] * 3, abs=0.04)
    for name in ("width", "best_root", "best_procrustes"):
        np.testing.assert_array_equal(one[name], other[name])


def test_what_is_given_is_not_asked() -> None:
    truth, joints = normal()[0][0], normal()[1][0].copy()
    joints[:, TORSO_INDEX] = truth[list(TORSO_INDEX)]
    rng = np.random.default_rng(0)
    off = (joints - truth)[..., :2]
    found = of_samples(joints, off, truth, np.ones(15, bool), rng, given=TORSO_INDEX)
    told = [joint in TORSO_INDEX for joint in JUDGED_JOINTS]
    for name in ("level", "standing", "beyond", "width"):
        unknown = np.isnan(found[name]).reshape(len(JUDGED_JOINTS), -1)
        assert unknown.all(axis=1).tolist() == unknown.any(axis=1).tolist() == told


def test_the_error_in_the_image_is_of_seen_joints() -> None:
    truth = np.zeros((15, 3))
    joints = np.zeros((12, 15, 3))
    joints[:, 3] = [3.0, 4.0, 100.0]
    joints[:, 4] = 1e6
    seen = np.ones(15, bool)
    seen[4] = False
    rng = np.random.default_rng(0)
    found = of_samples(joints, (joints - truth)[..., :2], truth, seen, rng)
    assert found["across"] == pytest.approx(5.0 / 14)


# --- predictions of others


def moving(seed: int) -> np.ndarray:
    way = np.random.default_rng(seed).normal(size=(15, 3)) * 30
    return 330 * PoseDictionary.default().mean + np.linspace(0, 1, 30)[:, None, None] * way


@functools.cache
def data() -> DataSet:
    motions = [Motion(moving(0), 30.0, "walking/one", "a"), Motion(moving(1), 30.0, "run/one", "b")]
    return from_motions(motions, "two", frames=4)


def test_predictions_are_scored_as_samples() -> None:
    rng = np.random.default_rng(0)
    poses = data().poses[:, None] + rng.normal(0, 50, (4, 20, 15, 3))
    found = of_predictions(poses, data())
    case = data().case(2)
    own = of_samples(
        poses[2],
        (poses[2] - poses[2, :, :1] - case.pose)[..., :2],
        case.pose,
        case.detection.score > 0,
        np.random.default_rng([0, 3, 2]),
    )
    for name, values in own.items():
        np.testing.assert_allclose(found[name][2], values, rtol=1e-12)
    scores = sample_scores(found, data().recording)
    assert scores.best_root[0].value > 40
    assert np.isnan(scores.best_root[3].value)  # of fifty there are none
    assert scores.axes is not None


def test_one_prediction_a_frame_and_other_units() -> None:
    single = sample_scores(of_predictions(data().poses[:, None] + 0.0, data()), data().recording)
    assert single.best_root[0].value == pytest.approx(0, abs=1e-9)
    assert (single.ece, single.axes) == (None, None)
    metres = of_predictions(data().poses[:, None] / 1000, data())
    assert np.isnan(metres["best_root"]).all()
    assert metres["best_procrustes"][:, 0] == pytest.approx(0, abs=1e-6)


# --- roots


PROTOCOL = Protocol(
    Anatomy.default(), PoseDictionary.default(), num_samples=60, ks=(3,), num_roots=30
)


@functools.cache
def judged(root: str) -> dict[str, np.ndarray]:
    return judge_block(PROTOCOL, Condition("dictionary", root=root), data().take(np.arange(2)), 0)


def test_roots_that_no_estimator_gives_stand_beside_the_first() -> None:
    found = conditions(("zhou", "dictionary"), (0, 1), (0.0,), ("candidates", "uncertain", "true"))
    assert [(one.way, one.missing) for one in found] == [
        *(("zhou", 0), ("zhou", 1), ("dictionary", 0), ("dictionary", 1)),
        *(("uncertain root", 0), ("uncertain root", 1), ("true root", 0), ("true root", 1)),
    ]
    assert [one.way for one in alike(found, found[1])] == [
        *("zhou", "dictionary", "uncertain root", "true root")
    ]
    assert len({one.name for one in found}) == len(found)
    with pytest.raises(BadInput, match="there is no root 'free'"):
        conditions(("zhou",), (0,), (0.0,), ("free",))


NEAR = Lens(1200.0, np.array([300.0, 250.0]))
"""A camera some two metres away."""


@pytest.mark.slow
@pytest.mark.parametrize("lens", [None, NEAR])
def test_an_uncertain_root_is_judged_by_the_same_scores(lens: Lens | None) -> None:
    """Second route: the public functions, one frame, in a row; and a pinhole camera by hand."""
    from poseterior.inference.studies.errors import aligned_errors, joint_errors

    some = data().take(np.arange(2))
    if lens is not None:
        columns = Lens(np.full(2, lens.focal), np.tile(lens.principal, (2, 1)))
        some = dataclasses.replace(some, lens=columns)
    found = judge_block(PROTOCOL, Condition("dictionary", root="uncertain"), some, 0)
    case = data().case(1)
    frame = inference.estimate_torso(case.detection, "dictionary", num_candidates=1)
    result = inference.sample(
        PROTOCOL.model.seen_by(lens),
        frame,
        key=jax.random.fold_in(jax.random.key(0), 1),
        num_samples=60,
        root="uncertain",
        num_roots=30,
    )
    draws = result.tree["posterior"]
    joints = draws.joints.values[0]
    assert found["effective_roots"][1] == pytest.approx(result.tree.attrs["effective_roots"])
    assert found["all"][1].mean() == pytest.approx(
        joint_errors(joints, case.pose).mean(axis=1).min(), abs=1e-3
    )
    assert found["best_procrustes"][1, 3] == pytest.approx(
        aligned_errors(joints[:50], case.pose).mean(axis=1).min(), abs=1e-3
    )
    seen = case.pixels[:, :2]
    if lens is not None:
        away = np.append((case.translation - lens.principal) / lens.focal, 1.0)
        world = case.pose + away * float(lens.focal) / case.scale
        seen = lens.principal + lens.focal * world[:, :2] / world[:, 2:]
    pixels = np.linalg.norm(draws.keypoints.values[0] - seen, axis=-1).mean()
    assert found["across"][1] == pytest.approx(pixels / case.scale)
    wrist = joints[:, LIMB_JOINTS[0]] * case.unit
    low, high = np.quantile(wrist, [0.025, 0.975], axis=0)
    assert found["width"][1, JUDGED_JOINTS.index(LIMB_JOINTS[0])] == pytest.approx(high - low)


def test_under_the_true_root_the_torso_is_the_truths() -> None:
    found = judged("true")
    told = [JUDGED_JOINTS.index(joint) for joint in TORSO_INDEX if joint in JUDGED_JOINTS]
    assert np.isnan(found["standing"][:, told]).all()
    assert np.isfinite(np.delete(found["standing"], told, axis=1)).all()
    assert np.isnan(found["effective_roots"]).all()
    assert (found["across"] < judged("fixed")["across"]).all()


def test_the_protocol_says_its_roots(tmp_path) -> None:
    from poseterior.inference.studies.evaluation.run import settings

    other = dataclasses.replace(PROTOCOL, num_roots=31)
    assert settings(data(), PROTOCOL) != settings(data(), other)
