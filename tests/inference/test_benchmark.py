"""The benchmark: frozen targets are what the product says they are, in every form; exact draws and
evidences hold by a second route; wrong draws are caught, and what cannot be draws is refused.

The forms in NumPy share no code with the model, so that a change of either shows: the negative
controls change the model a little."""

import dataclasses
import functools
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.infer import AIES
from numpyro.infer.util import potential_energy
from scipy import stats

from poseterior.inference import benchmark
from poseterior.inference.baselines.chains import Kernel, Walk
from poseterior.inference.baselines.ensemble import NumPyroKernel
from poseterior.inference.baselines.metropolis import ADAPTIVE_WALKERS, AdaptiveKernel
from poseterior.inference.baselines.run import Allowance
from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark import catalogue, draws, entrants, references
from poseterior.inference.benchmark.draws import Blocks, blocks_of, exact_block
from poseterior.inference.benchmark.external import ladder
from poseterior.inference.benchmark.external.entries import external_sampler, external_samplers
from poseterior.inference.benchmark.programs import in_jax
from poseterior.inference.benchmark.references import SHIPPED, sample_at, shipped_points
from poseterior.inference.benchmark.root import GivenRoot
from poseterior.inference.benchmark.target import CUBE_DIM, FrozenTarget
from poseterior.inference.benchmark.verdicts import exact_sample
from poseterior.inference.studies.comparison.judge import AGREES, CANNOT_TELL, DIFFERS
from poseterior.inference.studies.comparison.sample import NAMES, ROOT_NAMES, Sample
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.model import log_joint
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import JOINTS
from poseterior.probmodel.transport import from_fractions
from tests.wrong_samplers import DenseAdaptiveKernel, HalfUpdatedAIES

ROOT = Path(__file__).parents[2]
TARGETS = tuple(benchmark.targets())
FIXED = tuple(name for name in TARGETS if isinstance(benchmark.load(name).root, GivenRoot))
"""Those with one torso and camera; the others have tests of their own beside these."""
AGREEMENT = 1e-10
ODDS = 1e-4
"""How seldom a sound benchmark fails one of these tests."""


pytestmark = pytest.mark.usefixtures("cache")
"""Exact draws are kept with what tests compile."""


@functools.cache
def exact(name: str) -> Sample:
    return exact_sample(benchmark.load(name))


@functools.cache
def drawn(name: str, index: int = 5) -> np.ndarray:
    """Exact points of a block that neither the judge nor the reference has seen."""
    return exact_block(benchmark.load(name), index).points


def verdict(name: str, **arrays: Any) -> benchmark.Assessment:
    target = benchmark.load(name)
    return benchmark.verdict(target, benchmark.submit(target, **arrays), exact(name))


# --- frozen


def test_a_dozen_targets_from_six_dimensions_on() -> None:
    dims = [target.dim for target in benchmark.targets().values()]
    assert len(dims) >= 24
    assert (min(dims), max(dims)) == (6, CUBE_DIM + 7)
    hard = {name for name, target in benchmark.targets().items() if target.law == "disc"}
    soft = {name for name, target in benchmark.targets().items() if target.law == "gaussian"}
    assert soft == {f"{name}-soft" for name in hard - {"settled", "scene"}}


HARD = (
    *("single", "arm", "arms", "legs", "four-missing", "one-missing", "foreshortened"),
    *("low-scores", "flips", "tiny", "whole", "cruel"),
)
FIRST = (*HARD, *(f"{name}-soft" for name in HARD), "settled")
"""The first twenty-five targets that were published."""
FIRST_SHA256 = "1dab438bbf67fae15599a18cc11b6899f7929ddd18897434d27978a2e0647152"
"""Of their records, line by line."""


def test_the_first_targets_are_what_they_were() -> None:
    """Whatever has come before, between or behind them since."""
    lines = catalogue._content("targets.json").decode().splitlines()[1:-1]
    records = {json.loads(line.rstrip(","))["name"]: line.rstrip(",") for line in lines}
    first = "\n".join(records[name] for name in FIRST)
    assert hashlib.sha256(first.encode()).hexdigest() == FIRST_SHA256


def test_changed_data_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    content = catalogue._content

    def changed(name: str) -> bytes:
        return content(name).replace(b"0.25", b"0.26", 1)

    monkeypatch.setattr(catalogue, "_content", changed)
    catalogue.targets.cache_clear()
    with pytest.raises(BadInput, match=r"targets\.json of the benchmark has the checksum"):
        catalogue.targets()
    monkeypatch.undo()
    catalogue.targets.cache_clear()


def test_a_target_that_does_not_exist() -> None:
    with pytest.raises(BadInput, match="there is no target 'leg'; choose one of single, single-"):
        benchmark.load("leg")


# --- the forms


def test_forms_need_neither_jax_nor_a_compiler() -> None:
    code = """
import sys
import numpy as np
from poseterior.inference.benchmark import load, submit
target = load("whole")
cube = np.random.default_rng(0).uniform(size=(3, target.dim))
points = target.prior_transform(cube)
target.log_density(points), target.log_graded(points, 1.0), target.log_density_in_box(cube)
print([name for name in ("jax", "numba", "numpyro", "xarray", "scipy") if name in sys.modules])
"""
    assert printed(code) == "['scipy']", "for the quantiles of Beta distributions"


def test_a_verdict_needs_neither_jax_nor_a_compiler() -> None:
    code = """
import sys
from poseterior.inference import benchmark
target = benchmark.load("arm")
draws = benchmark.submit(target, points=benchmark.shipped_points("arm")[:300])
print(benchmark.verdict(target, draws).judgement.verdict)
print([name for name in ("jaxlib", "numba", "poseterior.inference.exact") if name in sys.modules])
"""
    assert printed(code) == "agrees\n[]"


def printed(code: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


@jax.jit
def product_squares(model: PoseModel, observation: Observation, fractions: jax.Array) -> jax.Array:
    """Squared distances in spreads as the product has them."""
    joints = model.joints(observation.view, *from_fractions(model, fractions))
    return observation.squares(joints)


def disagreement(target: FrozenTarget, model: PoseModel) -> float:
    """The largest difference between the two forms' squared distances: at draws of the prior, where
    they reach hundreds, and at draws of the target."""
    prior = target.prior_points(np.random.default_rng(0), 400)
    points = np.concatenate([prior, near(target)])
    fractions = np.full((len(points), CUBE_DIM), 0.5)
    fractions[:, target.active] = target.box_of(points)
    observation = benchmark.estimate(target).posterior(model, CANDIDATES).observations[0]
    theirs = product_squares(model, observation, jnp.asarray(fractions))
    difference = np.abs(target.squares(points) - np.asarray(theirs)[:, target.seen])
    return float(np.max(difference / (1 + target.squares(points))))


def near(target: FrozenTarget) -> np.ndarray:
    """Points with every arm and leg near its detections: the best draws of the prior."""
    points = target.prior_points(np.random.default_rng(1), 2000)
    return points[np.argsort(target.misfit(points))[:200]]


@pytest.mark.parametrize("name", FIXED)
def test_numpy_and_the_model_say_the_same(name: str) -> None:
    assert disagreement(benchmark.load(name), benchmark.frozen_model()) < AGREEMENT


def test_the_targets_keep_their_anatomy_when_the_products_changes() -> None:
    """The tables of version 0.2, by whose draws entrants are judged; the product has since learned
    from more people, whose poses these allow less often."""
    frozen, now = benchmark.frozen_model(), PoseModel()
    assert frozen.measures == now.measures
    assert frozen.limits.sha256.startswith("7793d399517d")
    ours, theirs = (float(np.nansum(model.hinges.total)) for model in (frozen, now))
    assert ours < theirs


def widened(model: PoseModel) -> PoseModel:
    """The same model with bones that may be a millionth longer."""
    lengths = model.lengths._replace(high=model.lengths.high * (1 + 1e-6))
    return PoseModel(model.limits, lengths, model.torsos)


@pytest.mark.parametrize(
    "change",
    [
        widened,
        pytest.param(
            lambda model: PoseModel(model.limits, model.lengths, model.torsos, upper="area"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            lambda model: PoseModel(model.limits, model.lengths, model.torsos, lower="box"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_change_of_the_model_is_caught(change: Callable[[PoseModel], PoseModel]) -> None:
    changed = change(benchmark.frozen_model())
    assert disagreement(benchmark.load("arm"), changed) > 100 * AGREEMENT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", "arm-soft", "cruel"])
def test_the_density_in_jax(name: str) -> None:
    target = benchmark.load(name)
    density = in_jax(target)
    assert density.active == tuple(target.active)
    points = np.concatenate([drawn(name)[:200], near(target)])
    ours, theirs = target.log_density(points), np.asarray(density.log_density(points))
    # An exact draw may lie within rounding of a disc's rim: both forms need not see it inside.
    decided = np.abs(target.misfit(points) - 1) > AGREEMENT
    assert np.array_equal(np.isfinite(ours[decided]), np.isfinite(theirs[decided]))
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert both.sum() >= 190
    np.testing.assert_allclose(ours[both], theirs[both], rtol=0, atol=AGREEMENT)
    graded = np.asarray(density.log_graded(points, 10.0))
    np.testing.assert_allclose(target.log_graded(points, 10.0), graded, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole", "cruel"])
def test_the_density_is_numpyro_s(name: str) -> None:
    """With all coordinates active: its own potential of the program, in its unconstrained space,
    and its joint density of whole poses, in the constrained one."""
    target, model = benchmark.load(name), benchmark.frozen_model()
    observation = benchmark.estimate(target).observation
    points = drawn(name)[:100]

    def potential(x: jax.Array) -> jax.Array:
        sites = {
            "bone_length": x[:5],
            "upper": x[5:15].reshape(5, 2),
            "lower": x[15:].reshape(4, 2),
        }
        return potential_energy(model.posterior, (observation,), {}, sites)

    theirs = -np.asarray(jax.jit(jax.vmap(potential))(points))
    ours = target.log_density(points) + float(observation.log_peak)
    inside = np.isfinite(ours) & np.isfinite(theirs)
    assert inside.sum() >= 95
    np.testing.assert_allclose(ours[inside], theirs[inside], rtol=0, atol=1e-9)
    poses = from_fractions(model, jnp.asarray(target.box_of(points)))
    joint = np.asarray(log_joint(model, observation, *poses))
    assert np.array_equal(np.isfinite(joint), np.isfinite(theirs))


@pytest.mark.parametrize("name", ["arm", "arm-soft"])
def test_the_charts_are_one_density(name: str) -> None:
    target = benchmark.load(name)
    points = near(target)
    box = target.box_of(points)
    jacobian = np.sum(np.log(box) + np.log1p(-box), axis=-1)
    density = target.log_density(points)
    assert np.isfinite(density).sum() > 20
    np.testing.assert_allclose(target.log_density_in_box(box) + jacobian, density, atol=1e-9)
    np.testing.assert_allclose(target.points_of_box(box), points, atol=1e-6)
    one = target.log_density(points[0])
    assert one.shape == ()
    assert one == pytest.approx(density[0], rel=1e-12)
    assert target.log_density_in_box(box[0] + np.eye(target.dim)[0]) == -np.inf


@pytest.mark.parametrize("name", ["arm", "arm-soft"])
def test_the_graded_likelihood_has_the_target_for_a_limit(name: str) -> None:
    target = benchmark.load(name)
    points = near(target)
    limit = target.log_likelihood(points)
    inside = np.isfinite(limit)
    assert 0 < inside.sum() < len(points)
    graded = np.stack([target.log_graded(points, hardness) for hardness in (0, 1, 1e3, 1e12)])
    np.testing.assert_allclose(graded[:, inside], np.tile(limit[inside], (4, 1)), atol=1e-5)
    assert np.all(np.diff(graded, axis=0) <= 0)
    assert np.all(graded[-1, ~inside] < -1e3)
    assert np.isfinite(graded).all()


# --- what is known


def test_the_evidence_by_plain_monte_carlo() -> None:
    """One in three hundred draws of the prior explains one arm: the forms in NumPy alone, with no
    proposal but the prior, find the evidence of the engine."""
    hard, soft = benchmark.load("arm"), benchmark.load("arm-soft")
    cube = np.random.default_rng(3).uniform(size=(100_000, hard.dim))
    points = hard.prior_transform(cube)
    for target in (hard, soft):
        likelihood = np.exp(target.log_likelihood(points))
        known = benchmark.reference(target.name)
        error = np.hypot(
            likelihood.std() / np.sqrt(len(points)),
            np.exp(known.log_evidence) * known.log_evidence_se,
        )
        z = (likelihood.mean() - np.exp(known.log_evidence)) / error
        assert abs(z) < stats.norm.isf(ODDS / 2)
        doubled = (likelihood.mean() - 1.1 * np.exp(known.log_evidence)) / error
        assert target is soft or abs(doubled) > 1.5, "the test would see a tenth"


@pytest.mark.parametrize("name", TARGETS)
def test_every_evidence_is_known_to_half_a_hundredth(name: str) -> None:
    known = benchmark.reference(name)
    assert 0 < known.log_evidence_se < 0.005
    assert 0 < sum(known.modes.values()) <= 1 + 1e-9
    target = benchmark.load(name)
    bones = {bone for limb in target.limbs for bone in limb.bones if bone.name != "head"}
    assert all(len(letters.replace(".", "")) == len(bones) for letters in known.modes)


@pytest.mark.parametrize("name", TARGETS)
def test_shipped_draws_have_the_moments_that_are_known(name: str) -> None:
    """They are of another block than those that the moments are from."""
    points = shipped_points(name)
    target = benchmark.load(name)
    assert points.shape == (min(SHIPPED, blocks_of(target).size), target.dim)
    worst_mean, worst_sd = off(name, points)
    asked = 2 * (len(NAMES) + len(ROOT_NAMES))  # means and deviations
    assert max(worst_mean, worst_sd) < stats.norm.isf(ODDS / len(TARGETS) / 2 / asked)
    assert off(name, points[:1000] + 0.2)[0] > 20, "the test would see a shift"
    assert benchmark.submit(target, points=points).given == len(points)


def test_damaged_draws_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    known = benchmark.reference("arm")
    other = dataclasses.replace(known, shipped="0" * 64)
    monkeypatch.setattr(references, "reference", lambda name: other)
    with pytest.raises(BadInput, match="the exact draws of arm are damaged; install poseterior"):
        shipped_points("arm")


@pytest.mark.slow
def test_another_block_has_the_moments_that_are_known() -> None:
    worst_mean, worst_sd = off("arm", drawn("arm"))
    assert worst_mean < stats.norm.isf(ODDS / 2 / len(NAMES))
    assert worst_sd < stats.norm.isf(ODDS / 2 / len(NAMES))


def off(name: str, points: np.ndarray) -> tuple[float, float]:
    """How far draws are off in their coordinates' means and in their spreads, in standard errors,
    at worst."""
    target, known = benchmark.load(name), benchmark.reference(name)
    values = sample_at(target, points[None]).flat
    varies = known.sd > 0
    error = np.hypot(known.mean_se, known.sd / np.sqrt(len(values)))[varies]
    means = (values.mean(axis=0) - known.mean)[varies] / error
    spread = np.hypot(known.sd_se, known.sd_se * np.sqrt(known.number / len(values)))[varies]
    sds = (values.std(axis=0) - known.sd)[varies] / spread
    return float(np.abs(means).max()), float(np.abs(sds).max())


def test_blocks_are_drawn_to_the_same_bits_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(draws.BLOCKS, ("disc", GivenRoot), Blocks(500, 20, 4))
    target = benchmark.load("single")
    first = exact_block(target, 0, tmp_path)
    assert first.points.shape == (500, 6)
    assert draws.draw_block(target, 0).sha256 == first.sha256
    assert exact_block(target, 1, tmp_path).sha256 != first.sha256
    path = tmp_path / "single-00.npz"
    path.write_bytes(path.read_bytes()[:-2000])
    assert exact_block(target, 0, tmp_path).sha256 == first.sha256, "a damaged block is drawn anew"
    assert not draws.same_bits(target, tmp_path), "the reference's blocks are longer"
    blocked = tmp_path / "single-00.npz"
    assert draws.draw_block(target, 0).sha256 == exact_block(target, 0, blocked).sha256
    steps: list[tuple[int, int]] = []
    points = benchmark.exact_points(
        target, 700, tmp_path, progress=lambda done, wanted: steps.append((done, wanted))
    )
    assert np.array_equal(points[:500], first.points)
    assert steps == [(500, 1000), (1000, 1000)]
    with pytest.raises(BadInput, match="single has 1 to 10,000 exact draws, not 10,001"):
        benchmark.exact_points(target, 500 * 20 + 1, tmp_path)


# --- verdicts


@pytest.mark.slow
def test_exact_draws_agree_and_shifted_ones_do_not() -> None:
    points = drawn("arm")
    known = benchmark.reference("arm")
    found = verdict(
        "arm",
        points=points[:1500],
        log_evidence=np.array(known.log_evidence + 0.01),
        log_evidence_se=np.array(0.01),
        evaluations=np.array(3000),
        seconds=np.array(2.0),
    )
    assert found.judgement.verdict == AGREES
    assert found.evidence_error == pytest.approx(0.01)
    assert found.per_second == pytest.approx(found.judgement.mixing.worst / 2)
    assert found.per_evaluation == pytest.approx(found.judgement.mixing.worst / 3000)
    assert found.worst_w1 < 0.15
    one_mode = points[sample_at(benchmark.load("arm"), points[None]).away[0, :, 0]]
    lost = verdict("arm", points=one_mode[:1500])
    assert lost.judgement.verdict == DIFFERS
    assert lost.judgement.modes.missed > 0.1
    assert lost.worst_w1 > 3 * found.worst_w1
    few = verdict("arm", points=points[:60])
    assert few.judgement.verdict == CANNOT_TELL


def test_an_evidence_that_is_off_is_caught() -> None:
    stated = benchmark.reference("arm").log_evidence + 0.2
    found = verdict(
        "arm",
        points=drawn("arm")[:300],
        log_evidence=np.array(stated),
        log_evidence_se=np.array(0.02),
    )
    assert found.judgement.verdict == AGREES  # the draws are right, whatever is said of them
    assert found.judgement.evidence is not None
    assert found.judgement.evidence.p_value < 1e-10


def test_an_evidence_without_its_error_is_not_judged() -> None:
    found = verdict("arm", points=drawn("arm")[:300], log_evidence=np.array(-1.0))
    assert found.judgement.verdict == AGREES
    assert found.judgement.evidence is None


@pytest.mark.parametrize("verdict_of_draws", [AGREES, CANNOT_TELL, DIFFERS])
def test_the_evidence_decides_nothing_about_draws(verdict_of_draws: str) -> None:
    """A wrong one and a right one leave the same verdict and sentence, whatever it is."""
    points = {
        AGREES: drawn("arm")[:300],
        CANNOT_TELL: drawn("arm")[:60],
        DIFFERS: np.repeat(drawn("arm")[:4], 60, axis=0)[None],
    }[verdict_of_draws]
    known = benchmark.reference("arm").log_evidence
    found = [
        verdict("arm", points=points, log_evidence=known + off, log_evidence_se=0.01).judgement
        for off in (0.0, 2.0)
    ]
    assert [one.verdict for one in found] == [verdict_of_draws] * 2
    assert found[0].sentence == found[1].sentence
    right, wrong = (one.evidence for one in found)
    assert right is not None
    assert wrong is not None
    assert wrong.p_value < 1e-10 < 0.5 < right.p_value


@functools.cache
def weighed(number: int = 50_000) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the prior of `arm-soft` and their log likelihood, those outside too."""
    target = benchmark.load("arm-soft")
    points = target.prior_points(np.random.default_rng(7), number)
    return points, target.log_likelihood(points)


ORDERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sorted, as nested samplers do": np.argsort,
    "falling": lambda log_weights: np.argsort(-log_weights),
    "shuffled": lambda log_weights: np.random.default_rng(3).permutation(len(log_weights)),
    "backwards": lambda log_weights: np.arange(len(log_weights))[::-1],
}


@pytest.mark.parametrize("order", ORDERS)
def test_weighted_draws_have_no_order(order: str) -> None:
    """Whatever order, chains, kind or unit of weights, the judge gets the same draws in the same
    order. Negative control: draws without weights keep theirs."""
    points, log_weights = weighed()
    target, rows = benchmark.load("arm-soft"), ORDERS[order](log_weights)
    plain = benchmark.submit(target, points=points, log_weights=log_weights)
    assert 150 < plain.points.shape[1] < plain.given == np.isfinite(log_weights).sum()
    for arrays in (
        {"points": points[rows], "log_weights": log_weights[rows]},
        {"points": points[rows], "log_weights": log_weights[rows] - 1000},
        {"points": points[rows], "weights": 3 * np.exp(log_weights[rows])},
        {
            "points": points[rows].reshape(4, -1, target.dim),
            "log_weights": log_weights[rows].reshape(4, -1),
        },
    ):
        found = benchmark.submit(target, **arrays)
        assert found.given == plain.given
        assert np.array_equal(found.points, plain.points)
    inside = rows[np.isfinite(log_weights[rows])]
    assert np.array_equal(benchmark.submit(target, points=points[inside]).points[0], points[inside])


def test_no_order_is_left_in_weighted_draws() -> None:
    """The lag-1 correlation of sorted draws is that of independent ones; as a chain it is not.

    A false alarm in a million at five standard errors."""
    points, log_weights = weighed()
    rows = np.argsort(log_weights)
    target = benchmark.load("arm-soft")
    found = benchmark.submit(target, points=points[rows], log_weights=log_weights[rows])
    size = target.misfit(found.points[0])
    assert abs(np.corrcoef(size[1:], size[:-1])[0, 1]) < 5 / np.sqrt(len(size))
    size = np.sort(size)
    assert np.corrcoef(size[1:], size[:-1])[0, 1] > 0.9


def test_a_draw_twice_is_one_of_twice_the_weight() -> None:
    """Four copies in pieces are what one of their sum is, so that copies are never counted as
    independent draws."""
    points, log_weights = weighed()
    target = benchmark.load("arm-soft")
    plain = benchmark.submit(target, points=points, log_weights=log_weights)
    found = benchmark.submit(
        target,
        points=np.repeat(points, 4, axis=0),
        log_weights=np.repeat(log_weights - np.log(4), 4),
    )
    assert np.array_equal(found.points, plain.points)


@pytest.mark.parametrize("nothing", [-np.inf, -1e300, -1e30, -1e10, -1e5])
def test_draws_of_no_weight_do_not_count(nothing: float) -> None:
    """Nested samplers say of points without likelihood that its log is -1e300, or another number of
    which nothing is left beside the others. Outside of the support they are nobody's draws;
    negative control: with a weight they are refused."""
    points, log_weights = weighed()
    target, outside = benchmark.load("arm-soft"), np.isneginf(log_weights)
    plain = benchmark.submit(target, points=points, log_weights=log_weights)
    filled = np.where(outside, nothing, log_weights)
    found = benchmark.submit(target, points=points, log_weights=filled)
    assert (found.given, found.points.tolist()) == (plain.given, plain.points.tolist())
    with pytest.raises(BadInput, match="lie outside of the support"):
        benchmark.submit(target, points=points, log_weights=np.where(outside, -20.0, log_weights))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"),
    [("dynesty_raw", AGREES), ("is_sorted", AGREES), ("is_random", AGREES)],
)
def test_files_of_nested_and_importance_samplers(name: str, expected: str, cases: Path) -> None:
    target = benchmark.load("arm-soft")
    found = benchmark.read_submission(cases / f"{name}.npz", target)
    assert benchmark.verdict(target, found).judgement.verdict == expected


def test_draws_pass_as_often_as_their_weights_say() -> None:
    """A thousand draws of weight one all pass; of a thousand of weight a quarter 250 do, by five
    standard errors of 14. By the root of the weights it would be 500."""
    points = drawn("arm")[:2000]
    log_weights = np.log(np.repeat([1.0, 0.25], 1000))
    found = benchmark.submit(benchmark.load("arm"), points=points, log_weights=log_weights)
    assert abs(found.points.shape[1] - 1250) < 70


@pytest.mark.slow
def test_draws_with_weights_are_taken_as_they_are() -> None:
    """Draws of the prior with the likelihood as weights are draws of the target; without weights
    they are not."""
    target = benchmark.load("arm-soft")
    points = target.prior_points(np.random.default_rng(4), 200_000)
    log_weights = target.log_likelihood(points)
    found = verdict("arm-soft", points=points, log_weights=log_weights)
    assert found.draws == np.isfinite(log_weights).sum()
    assert 200 < found.judged < found.draws
    assert found.judgement.verdict == AGREES
    without = verdict("arm-soft", points=points[np.isfinite(log_weights)])
    assert without.judgement.verdict == DIFFERS


def good(name: str = "arm", number: int = 400) -> np.ndarray:
    return drawn(name)[:number].copy()


def with_nan() -> np.ndarray:
    points = good()
    points[3, 0] = np.nan
    return points


REFUSED: dict[str, tuple[Callable[[], dict[str, Any]], str]] = {
    "another shape": (
        lambda: {"points": good()[:, :5]},
        r"points of it has shape \(400, 5\); arm needs \(draws, 6\) or \(chains, draws, 6\)",
    ),
    "three draws": (lambda: {"points": good(number=3)}, "come to 3 draws a chain"),
    "no draws": (lambda: {"points": np.empty((0, 6))}, r"has shape \(0, 6\)"),
    "texts": (lambda: {"points": np.full((4, 6), "a")}, "holds '<U1' where numbers are needed"),
    "no chart": (lambda: {"weights": np.ones(4)}, "must have one of points, box, cube, but has no"),
    "two charts": (
        lambda: {"points": good(), "cube": np.full((4, 6), 0.5)},
        "but has points and cube",
    ),
    "not a number": (lambda: {"points": with_nan()}, "1 of 400 draws of it have a coordinate that"),
    "outside": (
        lambda: {"points": benchmark.load("arm").prior_points(np.random.default_rng(0), 50)},
        r"50 of 50 draws of it lie outside of the support: right_\w+ lies up to [\d.]+ times its",
    ),
    "outside of the box": (
        lambda: {"box": np.full((4, 6), 1.5)},
        "4 of 4 draws of it lie outside of the unit box",
    ),
    "standing still": (
        lambda: {"points": np.tile(good()[:2, None], (1, 30, 1))},
        r"chain 0 of it stands still: its 30 draws are one and the same \(2 of 2 chains do\)",
    ),
    "negative weights": (
        lambda: {"points": good(), "weights": np.linspace(-1, 1, 400)},
        "200 of 400 weights of it are negative",
    ),
    "weights of zero": (
        lambda: {"points": good(), "weights": np.zeros(400)},
        "all weights of it are zero",
    ),
    "too few weights": (
        lambda: {"points": good(), "weights": np.ones(3)},
        "weights of it are 3 for 400 draws",
    ),
    "infinite weights": (
        lambda: {"points": good(), "log_weights": np.full(400, np.inf)},
        "hold a number that is not finite",
    ),
    "both weights": (
        lambda: {"points": good(), "weights": np.ones(400), "log_weights": np.ones(400)},
        "has both weights and log_weights",
    ),
    "evidence without a value": (
        lambda: {"points": good(), "log_evidence": np.nan, "log_evidence_se": 0.1},
        "log_evidence of it is nan; give a finite number, or leave it out",
    ),
    "evidence of nothing": (
        lambda: {"points": good(), "log_evidence": -np.inf},
        "log_evidence of it is -inf; give a finite number",
    ),
    "an error that is none": (
        lambda: {"points": good(), "log_evidence": -1.0, "log_evidence_se": np.inf},
        "log_evidence_se of it is inf; give a finite number",
    ),
    "free of charge": (
        lambda: {"points": good(), "seconds": np.array(0.0)},
        "seconds of it is 0; it must be a number above 0",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_draws_is_refused(case: str) -> None:
    arrays, words = REFUSED[case]
    with pytest.raises(BadInput, match=words):
        benchmark.submit(benchmark.load("arm"), where="it", **arrays())


def test_draws_of_single_precision_are_taken() -> None:
    target = benchmark.load("arm")
    points = drawn("arm")[:400].astype(np.float32)
    assert benchmark.submit(target, points=points).given == 400


# --- wrong samplers


def ensemble(move: emcee.moves.Move) -> np.ndarray:
    """`(walker, step, 6)`: emcee with one move on one arm, four ensembles started in exact
    draws."""
    target, chains = benchmark.load("arm"), []
    for run in range(4):
        starts = drawn("arm", 6)[32 * run : 32 * (run + 1)]
        state = emcee.State(starts, random_state=np.random.RandomState(run).get_state())
        sampler = emcee.EnsembleSampler(32, 6, target.log_density, moves=move, vectorize=True)
        sampler.run_mcmc(state, 1500)
        # An ensemble is one chain: its walkers are not independent of each other.
        chains.append(sampler.get_chain(thin=5).transpose(1, 0, 2).reshape(-1, 6))
    return np.stack(chains)


@pytest.mark.sweep
def test_emcee_s_snooker_move_is_caught_and_its_stretch_move_is_not() -> None:
    snooker = verdict("arm", points=ensemble(emcee.moves.DESnookerMove()))
    assert snooker.judgement.verdict == DIFFERS
    stretch = verdict("arm", points=ensemble(emcee.moves.StretchMove()))
    assert stretch.judgement.verdict != DIFFERS


def walked(kernel: Callable[[Target], Kernel], starts: int, **options: Any) -> np.ndarray:
    """`(chain, draw, 6)`: 64 rounds of a kernel on one arm, started in so many exact draws."""
    points = drawn("arm", 6)[:starts]
    walk = Walk(kernel(in_jax(benchmark.load("arm"))), jax.random.key(1), points, **options)
    for _ in range(64):
        walk.more()
    found = walk.drawn(jax.random.key(0)).points
    return found[:, :: max(1, found.shape[0] * found.shape[1] // 20_000)]


def ensembles(made: type[AIES]) -> np.ndarray:
    """Four ensembles of 64 walkers."""

    def kernel(target: Target) -> Kernel:
        def potential(point: jax.Array) -> jax.Array:
            return -target.log_density(point)

        return NumPyroKernel(made(potential_fn=potential), 64, 0, lambda *_: jnp.asarray(64))

    return walked(kernel, 4 * 64, runs=4, ensemble=True, steps=32)


@pytest.mark.sweep
def test_the_half_updated_ensembles_of_numpyro_are_caught_and_the_mended_ones_are_not() -> None:
    wrong = verdict("arm", points=ensembles(HalfUpdatedAIES))
    assert wrong.judgement.verdict == DIFFERS
    mended = verdict("arm", points=ensembles(AIES))
    assert mended.judgement.verdict != DIFFERS


@pytest.mark.sweep
def test_a_dense_sample_adaptive_chain_is_caught_and_a_diagonal_one_is_not() -> None:
    wrong = verdict("arm", points=adaptive(DenseAdaptiveKernel))
    assert wrong.judgement.verdict == DIFFERS
    assert verdict("arm", points=adaptive(AdaptiveKernel)).judgement.verdict != DIFFERS


def adaptive(kernel: type[AdaptiveKernel]) -> np.ndarray:
    """Its sixteen chains, each with a cloud of twice as many draws as there are dimensions."""
    return walked(kernel, ADAPTIVE_WALKERS * 2 * 6, runs=1, ensemble=False, steps=256)


def test_a_gibbs_that_redraws_only_wrists_is_caught() -> None:
    """It keeps the law of its start, and elbows where they were: no test of laws could tell."""
    target, rng = benchmark.load("arm"), np.random.default_rng(5)
    wrists = [name.startswith("right_forearm") for name in target.coordinates]
    points, path = drawn("arm", 6)[:40].copy(), []
    for _ in range(50):
        proposal = points.copy()
        proposal[:, wrists] = target.prior_points(rng, len(points))[:, wrists]
        inside = target.misfit(proposal) <= 1
        points = np.where(inside[:, None], proposal, points)
        path.append(points)
    chains = np.stack(path, axis=1)
    moved = (chains != chains[:, :1]).any(axis=(1, 2))  # those that stand still are refused
    assert moved.sum() >= 20
    found = verdict("arm", points=chains[moved])
    assert found.judgement.verdict == DIFFERS
    assert "a coordinate stood still" in found.judgement.sentence


def splitting(misfit: np.ndarray, count_the_setter: bool, rng: np.random.Generator) -> float:
    """Log evidence by multilevel splitting with 64 independent particles a level, drawn from sorted
    misfits; the particle that sets a level is no part of what is kept, or is counted."""
    log_evidence, inside = 0.0, len(misfit)
    while True:
        particles = np.sort(misfit[rng.integers(inside, size=64)])
        level = max(particles[32], 1.0)
        below = "right" if count_the_setter and level > 1 else "left"
        log_evidence += np.log(np.searchsorted(particles, level, side=below) / 64)
        if level == 1.0:
            return float(log_evidence)
        inside = int(np.searchsorted(misfit, level))


@pytest.mark.sweep
@pytest.mark.parametrize(("count_the_setter", "words"), [(True, DIFFERS), (False, AGREES)])
def test_counting_the_particle_that_sets_a_level_is_caught(
    count_the_setter: bool, words: str
) -> None:
    target = benchmark.load("arm")
    misfit = np.sort(target.misfit(target.prior_points(np.random.default_rng(6), 400_000)))
    rng = np.random.default_rng(7)
    runs = np.exp([splitting(misfit, count_the_setter, rng) for _ in range(3000)])
    share = float(np.mean(misfit <= 1))
    # Of the runs, and of the draws of the prior that they all take their particles from.
    error = np.hypot(
        runs.std() / runs.mean() / np.sqrt(len(runs)), 1 / np.sqrt(share * len(misfit))
    )
    found = verdict(
        "arm",
        points=drawn("arm")[:1500],
        log_evidence=np.log(runs.mean()),
        log_evidence_se=error,
    )
    assert found.judgement.verdict == words


ENOUGH = {"ultranest": 100_000, "nrpt": 1_500_000}
"""Evaluations of those that need more than the others to be through, or to be judged at all."""


@pytest.mark.sweep
@pytest.mark.parametrize("name", external_samplers())
def test_external_samplers_draw_from_the_target(name: str) -> None:
    sampler = external_sampler(name)
    if sampler.needs:
        pytest.importorskip(sampler.needs)
    target = benchmark.load("single")
    outcome = sampler.run(name, target, 3, Allowance(evaluations=ENOUGH.get(name, 20_000)))
    assert outcome is not None
    found = outcome.submission
    assert found.evaluations >= 5_000
    assert (target.misfit(found.points.reshape(-1, target.dim)) <= 1 + 1e-9).all()
    judged = benchmark.verdict(target, found, exact("single"))
    assert judged.judgement.verdict != DIFFERS


@pytest.mark.sweep
def test_a_ladder_whose_neighbours_always_swap_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under soft walls: with hard ones every level has the target's law inside of them, and swaps
    could not spoil it."""

    def always(gain: jax.Array) -> jax.Array:
        return jnp.where(gain > -jnp.inf, 1.0, 0.0)

    verdicts = []
    for chance in (ladder.chance_of, always):
        monkeypatch.setattr(ladder, "chance_of", chance)
        ladder._sweeps.clear_cache()
        outcome = ladder.nrpt(benchmark.load("arm-soft"), 3, Allowance(evaluations=2_000_000))
        assert outcome is not None
        found = benchmark.verdict(benchmark.load("arm-soft"), outcome.submission, exact("arm-soft"))
        verdicts.append(found.judgement.verdict)
    ladder._sweeps.clear_cache()
    assert verdicts[0] != DIFFERS
    assert verdicts[1] == DIFFERS


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["arm", "cruel"])
def test_exact_draws_are_seldom_said_to_differ(name: str) -> None:
    """Of 200 verdicts at the judge's level of 1 %, more than eleven wrong ones have odds of 10⁻⁶.
    Each is on other draws; the judge's are the same."""
    points = np.concatenate([drawn(name, 6), drawn(name, 7)])
    verdicts = [
        verdict(name, points=points[first : first + 500]).judgement.verdict
        for first in range(0, 200 * 500, 500)
    ]
    differ = verdicts.count(DIFFERS)
    print(f"{name}: {differ} of 200, {verdicts.count(CANNOT_TELL)} cannot tell")
    assert differ <= 11


# --- entrants


def test_who_cannot_be_held_to_a_target_is_not_run() -> None:
    arm, soft, scene = (benchmark.load(name) for name in ("arm", "arm-soft", "scene"))
    for name in ("exact", "smc", "nuts", "nrpt"):
        assert entrants.entrant(name).cannot(arm) == ""
    assert "soft walls are none" in entrants.entrant("nss").cannot(soft)
    assert "one torso and camera only" in entrants.entrant("smc").cannot(scene)
    assert not entrants.entrant("emcee").cannot(scene)
    with pytest.raises(BadInput, match="there is no sampler 'mcmc'; choose from exact, emcee"):
        entrants.entrant("mcmc")


@pytest.mark.slow
def test_a_baseline_pays_for_its_way_from_the_prior() -> None:
    """Both starts, on one arm: what was given is told, and evaluations are those of both."""
    target, allowance = benchmark.load("arm"), Allowance(evaluations=60_000)
    emcee = entrants.entrant("emcee")
    given = emcee.run(target, entrants.GIFT, allowance)
    own = emcee.run(target, entrants.PRIOR, allowance)
    assert given is not None
    assert own is not None
    assert given.given > 0
    assert own.given == 0
    assert 0 < own.kept < given.kept + 1e-9
    for outcome in (given, own):
        assert 50_000 < outcome.submission.evaluations < 90_000
        points = outcome.submission.points.reshape(-1, outcome.steps, target.dim)
        assert points.shape[0] * points.shape[1] == outcome.submission.given
        assert (target.misfit(points) <= 1).all()


@pytest.mark.slow
def test_exact_draws_are_timed_without_what_sets_them_up() -> None:
    outcome = entrants.entrant("exact").run(benchmark.load("single"), "", Allowance())
    assert outcome is not None
    assert 0 < outcome.kept < 1
    assert outcome.submission.given == entrants.TIMED_DRAWS


# --- the inference gym

of_the_gym = pytest.mark.filterwarnings("ignore::DeprecationWarning")
"""TensorFlow Probability uses what JAX means to drop, and promotes ranks."""


@pytest.fixture(params=["arm-soft", "legs-soft", "four-missing"])
def in_gym(request: pytest.FixtureRequest) -> Iterator[tuple[str, Any]]:
    pytest.importorskip("inference_gym", reason="the extra gym is not installed")
    with jax.numpy_rank_promotion("allow"):
        yield request.param, benchmark.gym_model(request.param, hardness=50.0)


@of_the_gym
@pytest.mark.slow
def test_the_gym_s_own_checks(in_gym: tuple[str, Any]) -> None:
    """Its test case for targets, as its own targets are held to it."""
    from inference_gym.dynamic.backend_jax.internal import test_util

    name, model = in_gym
    target = benchmark.load(name)
    ends = sum(len(limb.bones) for limb in target.limbs)
    test_util.InferenceGymTestCase().validate_log_prob_and_transforms(
        model,
        sample_transformation_shapes={"identity": (target.dim,), "joints": (ends, 3)},
        check_ground_truth_mean=True,
        check_ground_truth_mean_standard_error=True,
        check_ground_truth_standard_deviation=True,
        check_ground_truth_standard_deviation_standard_error=True,
        seed=jax.random.key(0),
    )


@of_the_gym
@pytest.mark.slow
def test_the_gym_s_density_is_the_target_s(in_gym: tuple[str, Any]) -> None:
    name, model = in_gym
    target, points = benchmark.load(name), shipped_points(name)[:200]
    box = jnp.asarray(target.box_of(points))
    ours = target.log_density_in_box(np.asarray(box))
    inside = np.isfinite(ours)  # single precision leaves some outside
    assert inside.sum() > 190
    found = np.asarray(model.unnormalized_log_prob(box))
    np.testing.assert_allclose(found[inside], ours[inside], rtol=0, atol=1e-9)
    hard = benchmark.gym_model(name)
    np.testing.assert_allclose(np.asarray(hard.log_likelihood(box)), target.log_likelihood(points))
    truth = model.sample_transformations["joints"].ground_truth_mean
    known = benchmark.reference(name)
    wrist = [NAMES.index(f"{JOINTS[target.limbs[0].bones[0].end]} {axis}") for axis in "xyz"]
    error = np.hypot(known.mean_se, known.sd / np.sqrt(SHIPPED))[wrist]
    assert np.all(np.abs(truth[0] - known.mean[wrist]) < stats.norm.isf(ODDS / 6) * error)
