"""The verdict on anybody's draws beside truths: right where it must be, silent where nothing is
wrong, and a sentence for what cannot be judged."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from poseterior.inference.studies.calibration.uniformity import uniformity
from poseterior.inference.studies.calibration.verdict import CALIBRATED, MISCALIBRATED
from poseterior.inference.studies.judging import judge_coverage, recalibrate, where
from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.files import joined, of_some_alone, read_brought
from poseterior.inference.studies.judging.judge import judge_brought, judge_levels
from poseterior.inference.studies.judging.repair import read_recalibration
from poseterior.inference.studies.judging.where import leaves_of, locally
from poseterior.inference.studies.judging.wrong import WRONGS, locally_wrong, told
from poseterior.inference.studies.levels import (
    cut_open,
    effective_number,
    rank_level,
)
from poseterior.probmodel import BadInput

RARE = 1e-4
"""Chance of a false alarm of each statistical test below; seeds are fixed."""
POSTERIORS = Path(__file__).parents[2] / "examples" / "posteriors"
"""Others' draws of the two moons, whose posterior is known."""


def test_equal_weights_are_no_weights() -> None:
    rng = np.random.default_rng(0)
    truth, draws = rng.normal(size=3), rng.normal(size=(50, 3)).round(1)
    bare = rank_level(truth.round(1), draws, np.random.default_rng(1))
    weighted = rank_level(truth.round(1), draws, np.random.default_rng(1), np.full(50, 0.3))
    assert weighted == pytest.approx(bare, rel=1e-12)
    assert effective_number(np.full(50, 0.3)) == pytest.approx(50)


def weighted_levels(number: int, use: bool) -> np.ndarray:
    """Levels of truths N(0, 1) among draws N(0.5, 1.5²) with importance weights, or without."""
    rng = np.random.default_rng(2)
    found = []
    for truth in rng.normal(size=number):
        draws = rng.normal(0.5, 1.5, size=400)
        weights = np.exp(stats.norm.logpdf(draws) - stats.norm.logpdf(draws, 0.5, 1.5))
        found.append(rank_level(truth, draws, rng, weights if use else None))
    return np.array(found)


def test_ranks_of_weighted_draws_are_uniform() -> None:
    assert uniformity(weighted_levels(700, True)).p_value > RARE
    assert uniformity(weighted_levels(700, False)).p_value < RARE  # the control


def test_angles_are_ranked_by_arcs() -> None:
    """Von Mises about ±π: arcs are uniform whichever way the circle is turned; the numbers
    themselves, whose posterior is cut in two there, tell nothing of how far off a truth is."""
    rng = np.random.default_rng(3)
    centre = rng.uniform(-np.pi, np.pi, 1500)
    truth = np.angle(np.exp(1j * (centre + rng.vonmises(0, 4, 1500))))
    draws = np.angle(np.exp(1j * (centre[:, None] + rng.vonmises(0, 4, (1500, 60)))))
    for shift, right in ((0.0, True), (0.3, False)):
        found = []
        for one, many in zip(truth, draws + shift, strict=True):
            arc, arcs = cut_open(one[None], many[:, None])
            assert np.abs(arcs).max() <= np.pi + 1e-9
            found.append(float(rank_level(arc, arcs, rng)[0]))
        assert (uniformity(np.array(found)).p_value > RARE) is right
    turned = cut_open(truth[:1] + 1.0, draws[0][:, None] + 1.0)
    plain = cut_open(truth[:1], draws[0][:, None])
    np.testing.assert_allclose(turned[1], plain[1], atol=1e-9)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_right_posterior_is_not_accused(weighted: bool) -> None:
    case = told("right", 120, 60, np.random.default_rng(4))
    weights = np.ones(case.draws.shape[:2]) if weighted else None
    found = judge_coverage(
        case.draws, case.truth, weights, case.log_density, covariates=case.seen, false_alarm=RARE
    )
    assert found.verdict == CALIBRATED
    assert found.local is not None
    assert set(found.covered) == {"quantity 0", "quantity 1", "quantity 2"}
    assert all(one.low <= 0.5 <= one.high for one, _, _ in found.covered.values())


def test_the_last_three_are_right_on_average(monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels of 6,000 instances are uniform in every number (chance of a false alarm 1e-3 over all
    nine), and so are not those of the control: a width that is wrong by the product of two numbers
    which are seen together, so that it is positive in 68 %."""

    def least(fault: str) -> float:
        case = told(fault, 6000, 39, np.random.default_rng(11))
        below = (case.draws < case.truth[:, None]).sum(axis=1)
        counts = [np.bincount(rank // 5, minlength=8) for rank in below.T]
        return min(stats.chisquare(count).pvalue for count in counts)

    for fault in [*WRONGS][-3:]:
        assert least(fault) > 1e-3 / 9, fault
    spoilt = locally_wrong(True, lambda seen: np.sign(seen[:, 0] * seen[:, 1]))
    monkeypatch.setitem(WRONGS, "control", spoilt)
    assert least("control") < 1e-6


def test_what_is_wrong_everywhere_and_right_on_average_is_found_where_it_is() -> None:
    case = told("width wrong by one covariate", 300, 60, np.random.default_rng(5))
    seen = {"angle": case.seen[:, 0], "score": case.seen[:, 1]}
    blind = judge_coverage(case.draws, case.truth)
    assert min(float(blind.calibration.p_value(name)) for name in blind.quantities) > 0.01
    found = judge_coverage(case.draws, case.truth, covariates=seen)
    assert found.verdict == MISCALIBRATED
    assert found.local is not None
    assert found.local.p_value <= 0.002
    assert "angle" in found.local.leaf.words
    assert found.local.leaf.words in found.sentence
    low, high = sorted([found.local.covered.value, found.local.elsewhere.value])
    assert low < 0.45 < 0.55 < high  # 35 and 65 % by construction, in halves


def test_the_test_of_where_holds_its_level_whatever_quantities_do_together() -> None:
    """100 tables of uniform levels, all quantities alike: rejections at 0.2 are binomial."""
    rejected = 0
    for seed in range(100):
        rng = np.random.default_rng([6, seed])
        level = rng.uniform(size=(60, 1)).repeat(3, axis=1)
        table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": [*"abc"]})
        columns = {"x": rng.normal(size=60), "kind": rng.choice(["a", "b"], 60)}
        rejected += locally(table, columns, seed).p_value <= 0.2
    assert stats.binomtest(rejected, 100, 0.2).pvalue > RARE


def partly_known(seed: int, wrong: bool) -> float:
    """The p-value of where, of three quantities each of which a third of 200 instances does not
    know; the first, if `wrong`, too narrow where x is positive."""
    rng = np.random.default_rng([12, seed])
    level, x = rng.uniform(size=(200, 3)), rng.normal(size=200)
    if wrong:
        off = 2 * level[:, 0] - 1
        level[:, 0] = np.where(x > 0, (1 + np.sign(off) * np.abs(off) ** 0.2) / 2, level[:, 0])
    level[rng.uniform(size=level.shape) < 1 / 3] = np.nan
    table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": [*"abc"]})
    return locally(table, {"x": x}, seed).p_value


def test_levels_that_are_known_in_part_are_compared_with_those_that_are_known() -> None:
    """60 tables: rejections at 0.2 are binomial, and what is wrong in a half is found in each."""
    rejected = sum(partly_known(seed, False) <= 0.2 for seed in range(60))
    assert stats.binomtest(rejected, 60, 0.2).pvalue > RARE
    assert max(partly_known(seed, True) for seed in range(5)) <= 0.005


def test_what_nobody_knows_of_a_part_is_not_compared() -> None:
    """Of b nothing is known where x is positive, of a everything: the part has no b to name."""
    rng = np.random.default_rng(13)
    x = rng.normal(size=100)
    level = rng.uniform(size=(100, 2))
    level[x > 0, 1] = np.nan
    table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": [*"ab"]})
    sign = np.where(x > 0, "up", "down")
    assert locally(table, {"sign": sign}).quantity == "a"


def test_a_level_that_is_missing_is_as_if_its_instance_were() -> None:
    """Deviations of a quantity that 60 of 100 instances know are those of these 60 alone; of a leaf
    that knows nine of them there is none."""
    rng = np.random.default_rng(15)
    score = rng.normal(size=(100, 2))
    score[60:, 1] = np.nan
    inside = np.stack([np.arange(100) % 2 == 0, np.arange(100) >= 51])
    found = where._deviation(inside, where._unit(score), np.isfinite(score))
    alone = score[:60, 1:]
    expected = where._deviation(inside[:, :60], where._unit(alone), np.isfinite(alone))
    np.testing.assert_allclose(found[:, 1:], expected)
    assert found[0, 1] > 0
    assert found[1].tolist() == [pytest.approx(found[1, 0]), 0.0]


def test_files_of_coverage_are_judged_as_one_that_knows_them_apart() -> None:
    """A width that is right on average over two detectors, and of neither."""
    rng = np.random.default_rng(14)
    off = 2 * rng.uniform(size=(2, 150)) - 1
    parts = {}
    for name, own, power in zip(("one", "other"), off, (0.5, 2.0), strict=True):
        level = (1 + np.sign(own) * np.abs(own) ** power)[:, None] / 2
        table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": ["a"]})
        parts[name] = table, {"detector": np.repeat(name.upper(), 150), name: np.arange(150)}
    level, columns = joined(parts)
    assert level.simulation.values.tolist() == list(range(300))
    assert list(columns) == ["detector", "file"]
    assert of_some_alone(parts) == ["one", "other"]
    found = judge_levels(level, columns)
    assert found.verdict == MISCALIBRATED
    assert found.local is not None
    assert found.local.leaf.words in ("detector is ONE", "detector is OTHER")


def test_what_has_nothing_in_common_is_not_judged_as_one() -> None:
    case = told("right", 30, 20, np.random.default_rng(8))
    level = xr.DataArray(case.truth, dims=("simulation", "quantity"), coords={"quantity": [*"abc"]})
    other = level.assign_coords(quantity=[*"def"])
    with pytest.raises(BadInput, match="one and other have no quantity in common"):
        joined({"one": (level, {}), "other": (other, {})})
    with pytest.raises(BadInput, match="mine has draws; only what `coverage` wrote"):
        joined({"one": (level, {}), "mine": Brought.of(case.draws, case.truth)})
    numbers, words = {"x": np.arange(30)}, {"x": np.repeat("side", 30)}
    for covariates in ((numbers, words), (file := {"file": np.arange(30)}, file)):
        one, two = ((level, columns) for columns in covariates)
        with pytest.raises(BadInput, match="of one and two is not one"):
            joined({"one": one, "two": two})


def test_failures_of_one_file_are_said_to_be_its_own() -> None:
    level = np.random.default_rng(16).uniform(size=(60, 1))
    level[30:40] = np.nan
    table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": ["a"]})
    both = joined({"good": (table[:30], {}), "bad": (table[30:], {})})
    assert "failed are 10 of 30 of bad, 0 of 30 of good" in judge_levels(*both).notes


def test_what_no_part_shares_with_the_others_is_not_said_to_be_the_same() -> None:
    """Of one detector's instances only a is known, of the other's only b."""
    level = np.random.default_rng(17).uniform(size=(60, 2))
    level[:30, 1] = level[30:, 0] = np.nan
    table = xr.DataArray(level, dims=("simulation", "quantity"), coords={"quantity": [*"ab"]})
    found = judge_levels(table, {"detector": np.repeat(["one", "other"], 30)})
    assert found.local is None
    assert any("no part of the instances can be compared" in note for note in found.notes)
    assert "with 30 simulations" in found.sentence


def test_leaves_are_of_words_numbers_and_both() -> None:
    rng = np.random.default_rng(0)
    columns = {"x": rng.normal(size=200), "kind": rng.choice(["side", "front"], 200)}
    words = [leaf.words for leaf in leaves_of(columns)]
    assert "kind is side" in words
    assert any(" and kind is side" in one for one in words)


def test_draws_from_files_are_judged_as_they_are(tmp_path: Path) -> None:
    case = told("right", 30, 20, np.random.default_rng(8))
    names = ["a", "b", "c"]
    np.savez(tmp_path / "ours.npz", draws=case.draws, truth=case.truth, names=np.array(names))
    swapped = np.swapaxes(case.draws, 0, 1)
    np.savez(tmp_path / "sbi.npz", posterior_samples=swapped, thetas=case.truth)
    estimates = {f"estimates.{name}": case.draws[..., at] for at, name in enumerate(names)}
    targets = {f"targets.{name}": case.truth[:, at] for at, name in enumerate(names)}
    np.savez(tmp_path / "bayesflow.npz", **estimates, **targets)
    chains = case.draws.reshape(30, 2, 10, 3)
    tree = xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset({"p": (("instance", "chain", "draw", "part"), chains)}),
            "truth": xr.Dataset({"p": (("instance", "part"), case.truth)}, {"part": names}),
            "covariates": xr.Dataset({"x": ("instance", case.seen[:, 0])}),
        }
    )
    tree.to_netcdf(tmp_path / "tree.nc")
    for name in ("ours.npz", "sbi.npz", "bayesflow.npz", "tree.nc"):
        read = read_brought(tmp_path / name)
        np.testing.assert_array_equal(read.one(17).draws, case.draws[17], err_msg=name)
        np.testing.assert_array_equal(read.truth, case.truth)
    assert read.names == ("p a", "p b", "p c")
    assert set(read.covariates) == {"x"}


def test_recalibrated_intervals_hold_what_they_say(tmp_path: Path) -> None:
    """Far too narrow draws of two kinds; per kind, 90 % intervals hold 90 % of new truths, and not
    much more; those of the draws themselves hold far less."""
    rng = np.random.default_rng(9)
    kind = rng.choice(["easy", "hard"], 2000)
    spread = np.where(kind == "hard", 3.0, 1.5)[:, None]
    truth = spread * rng.normal(size=(2000, 1))
    draws = rng.normal(size=(2000, 400, 1))
    level = np.array([rank_level(*one, rng) for one in zip(truth, draws, strict=True)])
    table = xr.DataArray(
        level[:1000], dims=("simulation", "quantity"), coords={"quantity": ["depth"]}
    )
    repair = recalibrate(table, by=("kind", kind[:1000]))
    repair.save(tmp_path / "wider.json", {"seed": 0})
    repair = read_recalibration(tmp_path / "wider.json")
    for name in ("easy", "hard"):
        rows = np.flatnonzero(kind == name)
        rows = rows[rows >= 1000]
        for nominal in (0.3, 0.5):
            ends = [repair.interval(draws[row, :, 0], "depth", nominal, name) for row in rows]
            held = sum(
                low <= truth[row, 0] <= high for row, (low, high) in zip(rows, ends, strict=True)
            )
            assert stats.binomtest(held, len(rows), nominal).pvalue > RARE
            own = np.mean(np.abs(2 * level[rows, 0] - 1) <= nominal)
            assert own < nominal - 0.08
    assert repair.interval(draws[0, :, 0], "depth", 0.95, "hard") == (-np.inf, np.inf)


def arrays(**changed: object) -> dict[str, object]:
    rng = np.random.default_rng(0)
    return {"draws": rng.normal(size=(30, 20, 2)), "truth": rng.normal(size=(30, 2))} | changed


NORMAL = np.random.default_rng(0).normal
REFUSED = {
    "shapes": (arrays(truth=NORMAL(size=(29, 2))), "do not agree"),
    "no number": (arrays(truth=np.full((30, 2), np.nan)), "30 of 30 truths are not finite"),
    "negative": (arrays(weights=-np.ones((30, 20))), "600 of 600 weights are negative"),
    "zero": (arrays(weights=np.zeros((30, 20))), "all weights are zero"),
    "few": (
        arrays(draws=NORMAL(size=(12, 20, 2)), truth=NORMAL(size=(12, 2))),
        "12 instances are too few for a verdict.*21% to 79%",
    ),
    "constant": (arrays(draws=np.ones((30, 20, 2))), "all 20 draws of instance 0 are the same"),
    "one value": (arrays(covariates={"x": np.ones(30)}), "covariate x has one value, 1.0"),
    "few draws": (arrays(draws=NORMAL(size=(30, 4, 2))), "4 draws an instance are too few"),
    "no such angle": (arrays(circular=["heading"]), "heading shall be circular"),
    "density": (arrays(log_density=np.ones(30)), "log densities have shapes"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_judged_is_refused_in_a_sentence(name: str) -> None:
    given, said = REFUSED[name]
    with pytest.raises(BadInput, match=said):
        judge_coverage(**given)


def test_copies_and_lost_instances_are_said() -> None:
    draws = NORMAL(size=(30, 20, 2)).repeat(2, axis=1)
    draws[3, 5, 1] = np.nan
    found = judge_coverage(draws, NORMAL(size=(30, 2)))
    assert any("copies of others" in note for note in found.notes)
    assert any("instance 3 is not judged: 1 draws are not finite" in note for note in found.notes)
    assert np.isnan(found.level.values[3]).all()


def test_discrete_quantities_have_uniform_levels() -> None:
    rng = np.random.default_rng(10)
    chance = rng.uniform(size=1200)[:, None]
    draws = (rng.uniform(size=(1200, 40)) < chance).astype(float)
    truth = (rng.uniform(size=(1200, 1)) < chance).astype(float)
    level = [rank_level(*one, rng) for one in zip(truth, draws[..., None], strict=True)]
    assert uniformity(np.array(level)[:, 0]).p_value > RARE


def test_quantities_that_nobody_looked_at_are_none_of_the_users() -> None:
    level = xr.DataArray(
        np.column_stack([np.random.default_rng(11).uniform(size=100), np.full(100, np.nan)]),
        dims=("simulation", "quantity"),
        coords={"quantity": ["wrist z", "log scale"]},
    )
    assert judge_levels(level, {}).quantities == ["wrist z"]


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """A module of a task, as the scripts beside it see it."""
    monkeypatch.syspath_prepend(str(POSTERIORS))
    return importlib.import_module


@pytest.fixture
def moons(beside: Callable[[str], Any]) -> Any:
    return beside("two_moons")


def test_exact_moons_follow_their_density(moons: Any) -> None:
    """Chance of each part of the box, summed over a grid of the likelihood; of a crescent a tenth
    wider it is not."""
    seen = np.array([-0.3, 0.1])
    draws = moons.exact_moons(seen, 4000, np.random.default_rng(0))
    axis = np.linspace(-1, 1, 1001)[:-1] + 0.001
    grid = np.stack(np.meshgrid(axis, axis), axis=2).reshape(-1, 2)
    edges = [np.linspace(-1, 1, 41)] * 2

    def p_value(points: np.ndarray) -> float:
        weights = np.exp(moons.log_likelihood_moons(points, seen))
        chance = np.histogram2d(*grid.T, edges, weights=weights)[0] / weights.sum()
        often = chance > 0.002
        counts = np.histogram2d(*draws.T, edges)[0][often]
        return stats.chisquare(counts, chance[often] / chance[often].sum() * counts.sum()).pvalue

    assert p_value(grid) > RARE
    assert p_value(grid / 1.1) < RARE


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("two_moons_barely_trained", MISCALIBRATED),
        ("two_moons_trained", MISCALIBRATED),
        ("two_moons_nested", CALIBRATED),
        ("slcp_barely_trained", MISCALIBRATED),
        ("slcp_trained", CALIBRATED),
    ],
)
def test_others_posteriors_are_judged(name: str, verdict: str) -> None:
    """Networks of sbi, of which the better one is wrong by its log density alone, weighted draws of
    dynesty, a network of bayesflow that hardly looks at what is seen, and one of sbi that does."""
    found = judge_brought(read_brought(POSTERIORS / f"{name}.npz"))
    assert found.verdict == verdict
    by_ranks = found.calibration.families["ranks (SBC)"] < 0.01
    assert by_ranks is (name == "two_moons_barely_trained")


@pytest.mark.slow
def test_a_well_trained_network_is_nearly_right(beside: Callable[[str], Any]) -> None:
    """A classifier that learns from 100 instances tells the network's draws of SLCP from exact ones
    in 55 % of 50 others, exact ones from exact ones in 50 %."""
    slcp = beside("slcp")
    brought = read_brought(POSTERIORS / "slcp_trained.npz")
    seen = np.stack([brought.covariates[name] for name in slcp.SEEN], axis=1).astype(float)
    rng = np.random.default_rng(0)
    exact, again = (np.stack([slcp.exact_slcp(one, 100, rng) for one in seen]) for _ in range(2))

    def told_apart(draws: np.ndarray) -> float:
        x = []
        for one in (draws, exact):
            folded = one.copy()
            folded[..., 2:4] = np.abs(folded[..., 2:4])  # either sign will do
            off = (folded - exact.mean(axis=1, keepdims=True)) / exact.std(axis=1, keepdims=True)
            x.append(np.concatenate([folded, off, np.repeat(seen[:, None], 100, axis=1)], axis=2))
        table = np.stack(x).reshape(2, len(seen), 100, -1)
        learned, judged = (table[:, part].reshape(-1, 15) for part in (slice(100), slice(100, 150)))
        which = [np.repeat([0, 1], len(part) // 2) for part in (learned, judged)]
        network = MLPClassifier((64, 64), max_iter=60, random_state=0, early_stopping=True)
        scaled = make_pipeline(StandardScaler(), network).fit(learned, which[0])
        return float(scaled.score(judged, which[1]))

    assert told_apart(np.asarray(brought.draws, float)) == pytest.approx(0.55, abs=0.02)
    assert told_apart(again) == pytest.approx(0.5, abs=0.015)  # three standard errors


def test_exact_draws_of_slcp_are_calibrated(
    beside: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truths of the simulator among draws of the closed form; one degree of freedom more is
    noticed."""
    slcp = beside("slcp")
    rng = np.random.default_rng(0)
    truth, seen = slcp.simulated(120, rng)
    context = dict(zip(slcp.SEEN, seen.T, strict=True))

    def verdict(false_alarm: float) -> str:
        draws = np.stack([slcp.exact_slcp(one, 60, rng) for one in seen])
        return judge_coverage(draws, truth, covariates=context, false_alarm=false_alarm).verdict

    assert verdict(RARE) == CALIBRATED
    monkeypatch.setattr(slcp, "FREEDOM", slcp.FREEDOM + 1)
    assert verdict(0.01) == MISCALIBRATED


def test_exact_draws_of_the_same_data_are_calibrated(moons: Any) -> None:
    brought = read_brought(POSTERIORS / "two_moons_trained.npz")
    rng = np.random.default_rng(0)
    seen = np.column_stack([*brought.covariates.values()])
    exact = np.stack([moons.exact_moons(one, 100, rng) for one in seen])
    found = judge_coverage(exact, brought.truth, covariates=brought.covariates, false_alarm=RARE)
    assert found.verdict == CALIBRATED
