"""How long a detector's errors last: parts that were put in are found, whatever the film's length;
errors without any memory are the control."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from poseterior.inference.studies.errorlaws import error_times, times_of_session
from poseterior.probmodel import BadInput
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.sessions import read_session
from poseterior.reports.tables.errorlaws import times_lines

FILM = Path(__file__).parents[3] / "shared" / "data" / "multicamera"
PARTS = np.array([0.4, 0.5, 0.1])
SECONDS, RATE = 0.15, 60.0


def simulated(parts: np.ndarray, recordings: int, frames: int, rate: float) -> np.ndarray:
    """Errors `(recordings, frames, 15, 2)` of variance one, by a filter of white noise."""
    rng = np.random.default_rng(20)
    shape = (recordings, frames, 15, 2)
    keep = np.exp(-1 / (SECONDS * rate))
    white = rng.normal(size=shape) * np.sqrt(1 - keep**2)
    white[:, 0] /= np.sqrt(1 - keep**2)
    slow = lfilter([1], [1, -keep], white, axis=1)
    constant, quick = rng.normal(size=(recordings, 1, 15, 2)), rng.normal(size=shape)
    return sum(
        np.sqrt(part) * one for part, one in zip(parts, (constant, slow, quick), strict=True)
    )


@pytest.mark.parametrize(("frames", "rate"), [(60, 60.0), (240, 60.0), (120, 25.0)])
def test_parts_are_found_at_any_rate_and_length(frames: int, rate: float) -> None:
    """Within four standard errors (of 40 recordings) each: false alarms once in 1,300 tests of
    four; shares that are off by 0.1 are found nearly always, since standard errors are below."""
    found = error_times(simulated(PARTS, 40, frames, rate), rate)
    values = np.array([*found[:3], found.seconds])
    assert (np.abs(values - [*PARTS, SECONDS]) < 4 * found.se).all(), (values, found.se)
    assert (found.se[:3] < 0.03).all()
    assert found.deviation == pytest.approx(1, abs=0.05)


def test_errors_without_memory_are_quick() -> None:
    found = error_times(simulated(np.array([0.0, 0.0, 1.0]), 40, 120, RATE), RATE)
    assert found.quick > 0.9  # the control: of the others, 0.1
    assert found.worth(100, RATE) > 40


def test_errors_that_stay_are_constant_and_outliers_left_out() -> None:
    errors = simulated(np.array([0.9, 0.0, 0.1]), 40, 60, RATE)
    errors[:, 7, 3] = 50.0
    errors[3, 20:30] = np.nan
    found = error_times(errors, RATE)
    assert found.constant == pytest.approx(0.9, abs=0.03)
    assert found.deviation == pytest.approx(1, abs=0.06)


def test_a_film_is_worth_what_its_best_mean_is() -> None:
    """By simulation: the variance of the mean that the worth is of, with 20,000 films, whose
    standard error is one in a hundred; a film of one frame is worth one."""
    rate, frames = 25.0, 12
    found = ErrorTimes(*PARTS, SECONDS, 1.0, 1.0, rate, np.zeros(4))
    errors = simulated(PARTS, 700, frames, rate)
    series = errors.transpose(0, 2, 3, 1).reshape(-1, frames)
    covariance = series.T @ series / len(series)
    weight = np.linalg.solve(covariance, np.ones(frames))
    assert found.worth(frames, rate) == pytest.approx(weight.sum(), rel=0.06)
    assert found.worth(1, rate) == pytest.approx(1)


@pytest.mark.parametrize(
    ("frames", "rate", "words"),
    [
        (60, 0.0, "not 0"),
        (60, np.nan, "not nan"),
        (60, 1e9, "frames a second"),
        (5, 60.0, "take a longer film"),
    ],
)
def test_what_cannot_be_is_refused(frames: int, rate: float, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        error_times(simulated(PARTS, 2, frames, RATE), rate)


def test_frames_apart_are_refused() -> None:
    errors = simulated(PARTS, 2, 40, RATE)
    errors[:, 1::2] = np.nan
    with pytest.raises(BadInput, match="succession"):
        error_times(errors, RATE)


def test_words_and_numbers_say_the_same() -> None:
    found = ErrorTimes(*PARTS, SECONDS, 0.07, 0.5, RATE, np.array([0.02, 0.03, 0.01, np.nan]))
    parts, worth = times_lines(found)
    assert "constant 40 ± 2 %, slow 50 ± 3 %, quick 10 ± 1 %" in parts
    assert f"10 s {found.worth(600, RATE):.1f}" in worth
    (unbounded, _) = times_lines(found._replace(longest=SECONDS))
    assert "slow errors last 0.15 s at least" in unbounded
    said = found.document()
    assert said["constant"] == 0.4
    assert said["se"]["seconds"] is None


@pytest.mark.skipif(not FILM.is_dir(), reason="needs the shared data pack")
def test_real_errors_hang_together() -> None:
    """Of four cameras' film of 100 frames: most of the variance does not go in a tenth of a
    second."""
    found = times_of_session(read_session(FILM), 60.0, perspective=True)
    assert found.quick < 0.15
    assert found.constant > 0.2
    assert 0.1 < found.seconds < 0.2
    assert found.worth(100, 60.0) < 4
