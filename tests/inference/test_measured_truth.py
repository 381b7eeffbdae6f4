"""Measures against the truth: levels that are uniform where they should be, and not where a
convention's sign is turned; scores by hand and by other packages."""

import jax
import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import roc_auc_score

from poseterior.inference.studies.calibration.posteriors import sampler_of
from poseterior.inference.studies.calibration.simulations import simulate
from poseterior.inference.studies.calibration.uniformity import uniformity
from poseterior.inference.studies.calibration.verdict import holm
from poseterior.inference.studies.measured import (
    ALL_MEASURES,
    area_of,
    levels_of,
    scores_of_measures,
    standings_of,
    values_of,
)
from poseterior.probmodel import PoseModel
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.root_priors import CANDIDATES
from tests.probmodel.test_measures import standing

TURNED = "right_hip_rotation"
COLUMN = [*MEASURES].index(TURNED)
ALARM = 1e-3
"""Chance that right levels are said to be wrong, over all measures together."""


def with_sign_turned(values: np.ndarray) -> np.ndarray:
    """As if somebody counted external rotation positive."""
    found = values.copy()
    found[..., COLUMN] = -found[..., COLUMN]
    return found


def p_values(levels: np.ndarray) -> np.ndarray:
    """Holm's, of levels `(n, q)`; of those that nothing is asked of, 1."""
    known = np.isfinite(levels).all(axis=0)
    found = np.ones(levels.shape[1])
    found[known] = holm(np.array([uniformity(column).p_value for column in levels[:, known].T]))
    return found


@pytest.fixture(scope="module")
def toys() -> tuple[np.ndarray, np.ndarray]:
    """Levels `(300, q)` of truths that are one more draw, and of those whose sign is turned; poses
    all around, so that many measures lie at the ends of their circle."""
    rng = np.random.default_rng(46)
    right, wrong = [], []
    for _ in range(300):
        seen = standing() + rng.normal(scale=0.5, size=(15, 3))
        poses = seen + rng.normal(scale=0.25, size=(31, 15, 3))
        values = values_of(poses)
        right.append(levels_of(values[0], values[1:], rng))
        wrong.append(levels_of(with_sign_turned(values[0]), values[1:], rng))
    return np.array(right), np.array(wrong)


def test_a_truth_that_is_one_more_draw_has_uniform_levels(toys: tuple) -> None:
    assert p_values(toys[0]).min() > ALARM


def test_a_turned_sign_fails(toys: tuple) -> None:
    """And nothing else does."""
    found = p_values(toys[1])
    assert found[COLUMN] < 1e-6
    assert np.delete(found, COLUMN).min() > ALARM


@pytest.mark.sweep
def test_measures_are_calibrated_under_the_model() -> None:
    """1,000 simulations, exact draws; and a convention whose sign is turned is not."""
    model = PoseModel()
    draw = sampler_of("rejection", model, 100, root=CANDIDATES)
    right, wrong = [], []
    for first in range(0, 1000, 50):
        for index, one in enumerate(simulate(model, 46, first, 50), first):
            rng = np.random.default_rng([46, index])
            joints = draw(index, one, jax.random.key(index)).joints
            truth, values = values_of(one.joints), values_of(joints)
            given = np.ptp(values, axis=0) < 1e-9
            for levels, known in ((right, truth), (wrong, with_sign_turned(truth))):
                levels.append(np.where(given, np.nan, levels_of(known, values, rng)))
    assert p_values(np.array(right)).min() > ALARM
    assert p_values(np.array(wrong))[COLUMN] < 1e-6


def test_standings_by_hand() -> None:
    """An error the short way round, a width of the draws without the truth's errors, and nothing of
    what was given."""
    truth = standing()
    rng = np.random.default_rng(1)
    draws = np.tile(truth, (500, 1, 1))
    turn = stats.norm(170, 20).ppf(
        (np.arange(500) + 0.5) / 500
    )  # of the right arm's plane; the truth's is at -170
    for pose, angle in zip(draws, np.radians(turn), strict=True):
        pose[3] = pose[2] + 0.9 * np.array([np.cos(angle), 0, np.sin(angle)])
    aim = np.radians(-170)
    truth[3] = truth[2] + 0.9 * np.array([np.cos(aim), 0, np.sin(aim)])
    found = standings_of(truth, draws + 0.0, draws, rng)
    place = [*MEASURES].index("right_shoulder_plane")
    assert found.error[place] == pytest.approx(-20, abs=0.1)
    assert found.width[place] == pytest.approx(2 * 1.96 * 20, rel=0.02)
    assert found.level[place] == pytest.approx(stats.norm.cdf(1), abs=0.01)
    for name in ("trunk_inclination", "left_knee_flexion", "step_width"):
        given = [*MEASURES].index(name)
        assert np.isnan([part[given] for part in found]).all()


def test_scores_by_hand() -> None:
    """Half of the truths lie in their intervals, widths tell large errors."""
    number, columns = 40, len(ALL_MEASURES)
    level = np.where(np.arange(number) % 2, 0.5, 0.99)[:, None] * np.ones(columns)
    error = np.linspace(-20, 20, number)[:, None] * np.ones(columns)
    width = np.abs(error) * 3
    level[:, 3] = np.nan
    found = scores_of_measures(level, error, width, np.arange(number) // 10)
    assert [one.name for one in found] == [n for i, n in enumerate(MEASURES) if i != 3]
    one = found[0]
    assert (one.size, one.unit) == (number, "degrees")
    assert one.covered.value == 0.5
    assert one.error == pytest.approx(10.0, abs=0.3)
    assert one.width == pytest.approx(30.0, abs=1)
    assert one.rank == pytest.approx(1.0)
    assert one.area == 1.0
    step = next(score for score in found if score.name == "step_length")
    assert step.unit == "mm"
    assert np.isnan(step.area)


def test_the_area_is_scikit_learns() -> None:
    rng = np.random.default_rng(2)
    values, wrong = rng.integers(0, 9, 300), rng.uniform(size=300) < 0.3
    assert area_of(values, wrong) == pytest.approx(roc_auc_score(wrong, values))
    assert np.isnan(area_of(values, np.zeros(300, bool)))
