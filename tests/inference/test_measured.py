"""Measures of results, and what draws on a line and on a circle say, against SciPy and ArviZ."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import poseterior as pt
from poseterior.inference import Item, Result, measure_intervals, measures, sample_frames
from poseterior.inference.summaries import (
    centre,
    density_of,
    deviation,
    interval,
    modes,
    summarised,
)
from poseterior.probmodel import BadInput, Estimate, PoseModel
from poseterior.probmodel.datasets import body_height
from poseterior.probmodel.measures import MEASURES
from tests.scenes import key

KNEE = "right_knee_flexion"
SPAN = "distance(left_wrist,right_wrist)"


# --- one number


@pytest.mark.parametrize("middle", [0.0, 90.0, 179.0, -135.0])
def test_mean_and_deviation_on_a_circle_are_scipys(middle: float) -> None:
    draws = np.random.default_rng(1).normal(middle, 40, 500)
    turned = (draws + 180) % 360 - 180
    wanted = stats.circmean(turned, 180, -180)
    assert centre(turned, True) == pytest.approx(wanted, abs=1e-9)
    assert deviation(turned, True) == pytest.approx(stats.circstd(turned, 180, -180), abs=1e-9)
    assert centre(turned, False) == pytest.approx(turned.mean())
    assert deviation(turned, False) == pytest.approx(turned.std())


def test_mean_on_a_circle_is_arvizs() -> None:
    from arviz_stats.base import array_stats

    turned = np.random.default_rng(2).vonmises(3, 1, 400)
    wanted = np.degrees(array_stats.circular_mean(turned))
    assert centre(np.degrees(turned), True) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("shift", [0.0, 75.0, 180.0, -90.0])
def test_an_interval_turns_with_its_draws(shift: float) -> None:
    """Wherever the circle is cut; on a line it is that of NumPy."""
    draws = np.random.default_rng(3).gamma(2, 20, 999)
    plain = np.quantile(draws, [0.05, 0.95])
    np.testing.assert_allclose(interval(draws, 0.9, False), plain)
    draws = draws[draws < 150]
    still = interval(draws, 0.9, True)
    turned = interval((draws + shift + 180) % 360 - 180, 0.9, True)
    off = turned - still - shift
    np.testing.assert_allclose(off, np.round(off[0] / 360) * 360, atol=1e-9)
    assert turned[0] < turned[1]


def test_an_interval_holds_its_share_of_a_circle() -> None:
    """Also of draws all around, of which any mean is as good."""
    draws = np.random.default_rng(4).uniform(-180, 180, 2000)
    low, high = interval(draws, 0.8, True)
    held = (draws - low) % 360 <= high - low
    assert held.mean() == pytest.approx(0.8, abs=2e-3)


@pytest.mark.parametrize("circular", [False, True])
def test_a_density_is_one(circular: bool) -> None:
    draws = np.random.default_rng(5).normal(170, 15, 20_000)
    draws = (draws + 180) % 360 - 180 if circular else draws
    at, density = density_of(draws, circular)
    step = at[1] - at[0]
    assert density.sum() * step == pytest.approx(1.0)
    wide = np.hypot(15, 0.9 * 15 * 200**-0.2)
    wanted = stats.norm(0, wide).pdf((at - 170 + 180) % 360 - 180)
    assert np.abs(density - wanted).max() < 0.06 * wanted.max()
    assert np.abs(at.mean()) <= 180 or not circular


def effective(draws: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """2,000 draws that are worth as many as were given, as of weighted roots."""
    return rng.choice(draws, 2000)


SHAPES = {
    "normal": (False, lambda rng, n: rng.normal(0, 1, n)),
    "skewed": (False, lambda rng, n: rng.gamma(1.5, 1, n)),
    "von Mises": (True, lambda rng, n: np.degrees(rng.vonmises(3, 2, n))),
    "flat": (False, lambda rng, n: rng.uniform(0, 1, n)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_one_mode_is_no_two(shape: str) -> None:
    """Of 60 samples worth 300 draws none but one may say two: where one in a hundred does, this
    fails once in eight."""
    circular, drawn = SHAPES[shape]
    rng = np.random.default_rng(6)
    found = [len(modes(effective(drawn(rng, 300), rng), circular)) for _ in range(60)]
    assert found.count(2) <= 1


@pytest.mark.parametrize("circular", [False, True])
@pytest.mark.parametrize("share", [0.5, 0.25])
def test_two_modes_are_two(share: float, circular: bool) -> None:
    """Six deviations apart, in 60 samples worth 300 draws: 58 at least, with their places and
    masses."""
    rng = np.random.default_rng(7)
    number = round(300 * share)
    good = 0
    for _ in range(60):
        both = np.concatenate([rng.normal(150, 15, number), rng.normal(240, 15, 300 - number)])
        found = modes(effective((both + 180) % 360 - 180 if circular else both, rng), circular)
        if len(found) == 2:
            places = sorted(one.value % 360 for one in found)
            near = np.abs(np.array(places) - [150, 240]).max() < 12
            masses = {round(one.value % 360, 9): one.mass for one in found}
            first = masses[round(places[0], 9)]
            good += bool(near and abs(first - share) < 0.12)
            assert sum(one.mass for one in found) == pytest.approx(1.0)
    assert good >= 58


@pytest.mark.parametrize("circular", [False, True])
def test_draws_in_one_place_have_no_spread(circular: bool) -> None:
    found = summarised(np.full(20, 30.0), 0.95, circular)
    assert found[:4] == pytest.approx((30.0, 0.0, 30.0, 30.0), abs=1e-5)
    assert found.modes[0] == pytest.approx((30.0, 1.0), abs=0.5)  # a place of the grid
    assert len(found.modes) == 1


def test_nothing_is_said_of_nothing() -> None:
    assert np.isnan(summarised(np.array([np.nan, np.nan]), 0.95, True)[:4]).all()
    assert summarised(np.array([]), 0.95, False).modes == ()
    assert summarised(np.array([1.0, np.nan, 3.0]), 0.95, False).mean == 2.0


# --- results


def test_measures_of_a_result(example_result: Result) -> None:
    joints = example_result.tree["posterior"].joints.values
    found = pt.measures(example_result)
    assert list(found) == list(MEASURES)
    for name, one in MEASURES.items():
        assert found[name].dims == ("chain", "draw")
        np.testing.assert_array_equal(found[name], one.of(joints))
        assert found[name].attrs["units"] == one.unit
        assert found[name].attrs["convention"] == one.convention
    assert found.attrs["seed"] == example_result.tree.attrs["seed"]
    for part in (example_result.tree, example_result.tree["posterior"].to_dataset()):
        xr.testing.assert_equal(measures(part, KNEE), found[[KNEE]])


def test_a_height_makes_millimetres_of_lengths_alone(example_result: Result) -> None:
    joints = example_result.tree["posterior"].joints.values
    plain = measures(example_result, KNEE, SPAN, KNEE)
    known = measures(example_result, KNEE, SPAN, height=1.8)
    assert list(plain) == [KNEE, SPAN]
    xr.testing.assert_equal(plain[KNEE], known[KNEE])
    assert plain[SPAN].attrs["units"] == "body units"
    assert known[SPAN].attrs["units"] == "mm"
    np.testing.assert_allclose(known[SPAN], plain[SPAN] * 1800 / body_height(joints))


def test_a_file_has_what_its_result_has(example_result: Result, tmp_path: Path) -> None:
    example_result.save(tmp_path / "posterior.nc", double=True)
    found = measures(example_result, KNEE)
    for path in (tmp_path, str(tmp_path / "posterior.nc")):
        np.testing.assert_array_equal(measures(path, KNEE)[KNEE], found[KNEE])


def test_intervals_of_a_result(example_result: Result) -> None:
    found = measures(example_result, KNEE, "trunk_rotation", SPAN)
    summed = measure_intervals(found, 0.9)
    assert dict(summed.sizes) == {"measure": 3, "mode": 2}
    knee = summed.sel(measure=KNEE)
    wanted = np.quantile(found[KNEE], [0.05, 0.95])
    np.testing.assert_allclose([knee.low, knee.high], wanted)
    assert float(knee["mean"]) == pytest.approx(float(found[KNEE].mean()))
    assert summed.units.values.tolist() == ["degrees", "degrees", "body units"]
    assert summed.attrs["probability"] == 0.9


@pytest.fixture(scope="module")
def stream(example_estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames with a pose, one without."""
    folder = tmp_path_factory.mktemp("stream") / "s"
    items = [
        Item("f0/0", example_estimate),
        Item("f1/0", "f1 has no torso; choose another"),
        Item("f2/0", example_estimate),
    ]
    given = {"num_samples": 30, "k": 2, "keep": 20, "root": "candidates"}
    sample_frames(PoseModel(), items, key=key(0), out=folder, **given)
    return folder


def test_measures_of_a_stream(stream: Path) -> None:
    found = measures(stream, KNEE, SPAN)
    assert dict(found.sizes) == {"frame": 3, "draw": 20}
    drawn = pt.draws_of(stream, "f2/0").joints.values[0].astype(float)
    np.testing.assert_allclose(found[KNEE].sel(frame="f2/0"), MEASURES[KNEE].of(drawn))
    summed = measure_intervals(found)
    assert np.isfinite(summed["mean"].sel(measure=KNEE)).values.tolist() == [True, False, True]
    assert summed.frame.values.tolist() == ["f0/0", "f1/0", "f2/0"]


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"wanted": ("right_knee",)}, "there is no measure 'right_knee'"),
        ({"height": 17.0}, "17 is not the height of a person"),
        ({"height": np.nan}, "nan is not the height of a person"),
        ({"of": "nowhere.nc"}, "there is no result at nowhere.nc"),
        ({"of": xr.Dataset()}, "there are no joints"),
    ],
)
def test_what_cannot_be_measured(example_result: Result, given: dict, match: str) -> None:
    of = given.pop("of", example_result)
    with pytest.raises(BadInput, match=match):
        measures(of, *given.pop("wanted", ()), **given)


@pytest.mark.parametrize("probability", [0.0, 1.0, 95.0, np.nan])
def test_an_interval_has_a_probability(example_result: Result, probability: float) -> None:
    with pytest.raises(BadInput, match="is none; give a probability between 0 and 1"):
        measure_intervals(measures(example_result, KNEE), probability)
