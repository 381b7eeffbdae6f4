"""Filters of films, and bodies of one size: by signals whose answer is known."""

import numpy as np
import pytest

from poseterior.probmodel import BadInput
from poseterior.probmodel.skeleton import PARENTS
from poseterior.reports.exports.bodies import Body, turns
from poseterior.reports.exports.smoothing import FILTERS, smoother_of

RATE = 50.0
TIMES = np.arange(400) / RATE


def wave(hertz: float) -> np.ndarray:
    """`(400, 1)` metres."""
    return np.sin(2 * np.pi * hertz * TIMES)[:, None]


def gain(text: str, hertz: float) -> tuple[float, float]:
    """Amplitude and lag (seconds) of a wave that a filter lets through, by least squares on sine
    and cosine away from the ends."""
    found = smoother_of(text)(wave(hertz), np.arange(400), RATE)[100:300, 0]
    angle = 2 * np.pi * hertz * TIMES[100:300]
    sine, cosine = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], 1), found)[0]
    return float(np.hypot(sine, cosine)), float(np.arctan2(-cosine, sine) / (2 * np.pi * hertz))


@pytest.mark.parametrize("cutoff", [3.0, 6.0, 10.0])
def test_butterworth_halves_the_power_at_its_cutoff_without_a_lag(cutoff: float) -> None:
    amplitude, lag = gain(f"butterworth:{cutoff}", cutoff)
    assert amplitude == pytest.approx(np.sqrt(0.5), abs=0.01)
    assert lag == pytest.approx(0, abs=1e-3)
    assert gain(f"butterworth:{cutoff}", cutoff / 6)[0] == pytest.approx(1, abs=0.01)
    assert gain(f"butterworth:{cutoff}", min(3 * cutoff, 20))[0] < 0.1


def test_savgol_keeps_parabolas_and_takes_noise() -> None:
    parabola = (TIMES**2 - 3 * TIMES)[:, None]
    assert smoother_of("savgol:15")(parabola, np.arange(400), RATE) == pytest.approx(parabola)
    noise = np.random.default_rng(0).normal(size=(400, 1))
    left = smoother_of("savgol:15")(noise, np.arange(400), RATE)
    # the sum of squares of the weights of a parabola through 15 points, at the middle: 167 / 1105
    assert left[20:-20].std() == pytest.approx(np.sqrt(167 / 1105), rel=0.15)


def test_one_euro_is_a_low_pass_that_opens_with_speed() -> None:
    """Of rest it is a filter of first order (the share of a step after a time constant is 1 - 1/e);
    a fast ramp it follows more closely than such a filter could."""
    step = np.concatenate([np.zeros(50), np.full(350, 1e-6)])[:, None]
    found = smoother_of("one-euro:1")(step, np.arange(400), RATE)[:, 0] / 1e-6
    constant = 50 + round(RATE / (2 * np.pi))
    assert found[constant] == pytest.approx(1 - np.exp(-1), abs=0.05)
    assert found[49] == 0, "nothing is known before"
    ramp = (4 * TIMES)[:, None]
    late = ramp[-1, 0] - smoother_of("one-euro:1")(ramp, np.arange(400), RATE)[-1, 0]
    assert late == pytest.approx(4 / (2 * np.pi * (1 + 2 * 4)), rel=0.05)
    assert late < 0.2 * 4 / (2 * np.pi)


@pytest.mark.parametrize("name", FILTERS)
def test_stretches_are_filtered_by_themselves(name: str) -> None:
    """What lies behind a gap, or behind a frame without a pose, moves nothing before it; single
    frames and pairs stay finite."""
    rng = np.random.default_rng(1)
    values = rng.normal(size=(60, 15, 3))
    values[30] = np.nan
    places = np.concatenate([np.arange(45), [50], [60, 61], np.arange(70, 82)])
    smoother = smoother_of(name)
    found = smoother(values, places, RATE)
    assert np.isnan(found[30]).all()
    assert np.isfinite(np.delete(found, 30, axis=0)).all()
    assert np.array_equal(found[45], values[45])
    other = values.copy()
    other[31:] += 5
    assert np.array_equal(smoother(other, places, RATE)[:30], found[:30])
    assert not np.allclose(found[:30], values[:30])
    assert np.ptp(found[:30], axis=0).mean() < np.ptp(values[:30], axis=0).mean()


@pytest.mark.parametrize("count", range(1, 25))
@pytest.mark.parametrize("name", FILTERS)
def test_a_film_of_any_length(name: str, count: int) -> None:
    still = np.full((count, 15, 3), 0.5)
    assert smoother_of(name)(still, np.arange(count), RATE) == pytest.approx(still)


def test_what_is_no_filter_is_refused() -> None:
    for text in ("", "gauss", "savgol:2", "savgol:1", "savgol:4", "savgol:nan", "butterworth:-1",
                 "butterworth:inf", "one-euro:", "one-euro:0", "one-euro:a"):  # fmt: skip
        with pytest.raises(BadInput):
            smoother_of(text)
    with pytest.raises(BadInput, match="less than"):
        smoother_of("butterworth:6").check(12.0)
    smoother_of("butterworth:6").check(12.1)


# --- bodies


def test_rotations_are_found_again() -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(2)
    points = rng.normal(size=(1, 5, 3))
    truth = Rotation.random(20, rng=rng).as_matrix()
    found = turns(points, points @ truth)
    assert found == pytest.approx(truth)
    flat = points * [1, 1, 0]  # of points in a plane the best turn is proper, too
    assert np.linalg.det(turns(flat, flat @ truth)) == pytest.approx(np.ones(20))
    mirrored = turns(points, points * [1, 1, -1])
    assert np.linalg.det(mirrored) == pytest.approx([1])


def test_a_body_in_its_own_poses_is_itself_and_no_other() -> None:
    """Poses of one body, turned and moved: found again to rounding, also of shrunken ones; NaN
    where there is none."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(3)
    poses, torso = np.zeros((6, 15, 3)), rng.normal(size=(15, 3))
    for joint, parent in enumerate(PARENTS[1:], 1):
        bone = rng.normal(size=(6, 3))
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        poses[:, joint] = poses[:, parent] + (0.2 + 0.01 * joint) * bone
    for joint in (1, 2, 5, 9, 12):
        poses[:, joint] = torso[joint]
    for joint in (3, 4, 6, 7, 8, 10, 11, 13, 14):  # hung on the torso anew
        bone = rng.normal(size=(6, 3))
        bone /= np.linalg.norm(bone, axis=1, keepdims=True)
        poses[:, joint] = poses[:, PARENTS[joint]] + (0.2 + 0.01 * joint) * bone
    turned = np.einsum("nij,nkj->nki", Rotation.random(6, rng=rng).as_matrix(), poses)
    body = Body.of(turned)
    assert body.posed(turned) == pytest.approx(turned)
    shifted = 0.8 * turned + rng.normal(size=(6, 1, 3))
    again = body.posed(shifted)
    assert again - again[:, :1] == pytest.approx(turned)
    assert again[:, 0] == pytest.approx(shifted[:, 0])
    assert body.grown(2).posed(turned) == pytest.approx(2 * turned)
    shifted[2] = np.nan
    assert np.isnan(body.posed(shifted)[2]).all()
    assert np.isfinite(np.delete(body.posed(shifted), 2, axis=0)).all()
