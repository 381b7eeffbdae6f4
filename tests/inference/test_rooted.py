"""Baselines on the posterior of torso, camera and pose: its density on R^d against the posterior's
own and against NumPyro's program, its chart against derivatives, draws against rejection; and
charts without a factor, which must be told apart.

False alarms: the judge's, 0.01 a sampler; seeds are fixed."""

import dataclasses
import functools
import itertools
import math
from pathlib import Path

import arviz as az
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.handlers import substitute
from numpyro.infer.util import potential_energy

from poseterior import inference
from poseterior.inference.baselines import rooted
from poseterior.inference.baselines.catalogue import BASELINES, ROOTED, draws_of
from poseterior.inference.baselines.hamiltonian import _log_weights
from poseterior.inference.baselines.rooted import ROOT_COORDINATES, RootedTarget
from poseterior.inference.baselines.run import Allowance, run
from poseterior.inference.draws import COMPLETE, OUT_OF_BUDGET
from poseterior.inference.importance.weighted import weigh_roots
from poseterior.inference.results import Result, tree_of
from poseterior.inference.saved import read_result
from poseterior.inference.studies.comparison import compare
from poseterior.inference.studies.comparison.contest import ENDLESS
from poseterior.inference.studies.comparison.judge import AGREES, DIFFERS
from poseterior.probmodel import BadInput, Estimate, PoseModel, RootPoint
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, FaultPrior, Faults
from poseterior.probmodel.errors.laws import LAWS, ErrorLaw, Student
from poseterior.probmodel.failures import OutOfBudget
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.rotations import RotationTransform, rodrigues
from poseterior.probmodel.skeleton import JOINTS, TORSO_INDEX
from poseterior.probmodel.summed import States, SummedFaults
from poseterior.probmodel.transport import CUBE_DIM
from tests.inference import test_uncertain_faults as faulty
from tests.inference import test_uncertain_root as sound
from tests.scenes import key, prior_scene

ANGLES = 8 * math.pi**2
"""The volume of SO(3), by angles."""
EVALUATIONS = 1_000_000
"""After which random walks have what the judge needs on the small case."""
CAYLEY = RotationTransform()
SWEEP = pytest.mark.sweep


@functools.cache
def case() -> tuple[PoseModel, Estimate, RootedTarget]:
    """The small case under a prior of upright people, and its target."""
    plain, frame = sound.small_case()
    model = PoseModel(plain.limits, plain.lengths, plain.torsos, upright=2.0)
    return model, frame, RootedTarget.of(frame.posterior(model))


@functools.cache
def drawn() -> tuple[RootPoint, Pose]:
    """Draws of roots and poses of the small case."""
    model, frame, _ = case()
    roots = weigh_roots(frame.posterior(model), key=key(1), num_roots=100)
    return roots.draw(np.random.default_rng(0), 60)[:2]


def anywhere(number: int) -> np.ndarray:
    """Points of R^d, whatever the density is there."""
    return np.random.default_rng(2).normal(scale=1.5, size=(number, case()[2].dim))


def placed(target: RootedTarget, x: np.ndarray) -> tuple[RootPoint, Pose]:
    """Roots and poses at points."""
    return target.roots(x), target.limbs.poses(key(3), x[:, : target.limbs.dim])


@pytest.mark.slow
def test_the_density_is_the_posterior_s_own() -> None:
    """Of root, pose and detection, whose unseen limbs follow the prior: to 1e-8, and minus infinity
    at the same places."""
    model, frame, target = case()
    x = target.points_at(*drawn())
    x = np.concatenate([x, x + np.random.default_rng(1).normal(scale=0.05, size=x.shape)])
    roots, poses = placed(target, x)
    own = np.asarray(frame.posterior(model).log_joint(roots, poses)) - model.log_prior(*poses)
    chart = target.limbs.log_base(jnp.asarray(x[:, : target.limbs.dim])) + target.log_volume(x)
    found = np.asarray(target.log_density(x))
    inside = np.isfinite(found)
    assert len(x) // 2 < inside.sum() < len(x)
    np.testing.assert_array_equal(inside, np.isfinite(own))
    np.testing.assert_array_equal(inside, np.asarray(target.misfit(x)) <= 1)
    np.testing.assert_allclose(found[inside], (own + chart)[inside], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_density_is_that_of_the_program() -> None:
    """NumPyro's potential in its own coordinates, whose rotations are turned from elsewhere and
    whose places are in pixels."""
    (model, frame, some), (points, poses) = case(), drawn()
    limbs = dataclasses.replace(some.limbs, active=tuple(range(CUBE_DIM)))
    target = dataclasses.replace(some, limbs=limbs)
    x = target.points_at(points, poses)
    program = frame.posterior(model).program

    @jax.jit
    def potential(torso: jax.Array, x: jax.Array, root: RootPoint) -> jax.Array:
        sites = {
            "bone_length": x[:5],
            "upper": x[5:15].reshape(5, 2),
            "lower": x[15:CUBE_DIM].reshape(4, 2),
            "rotation": rodrigues(root.rotation),
            "log_scale": root.log_scale,
            "translation": root.translation,
        }
        given = substitute(program, data={"torso": torso})
        return potential_energy(given, (), {}, sites)

    for row in range(0, 20, 4):
        root = RootPoint(*(jnp.asarray(part[row]) for part in points))
        theirs = -potential(root.torso, jnp.asarray(x[row]), root)
        turn = CAYLEY.log_abs_det_jacobian(rodrigues(root.rotation), root.rotation)
        by_hand = theirs - turn + target.log_volume(x[row])
        assert float(target.log_density(x[row])) == pytest.approx(float(by_hand), abs=1e-8)


def test_the_volume_of_the_chart_is_its_derivative_s() -> None:
    """Turns by their angles in the body's axes, scale and place by their own derivatives; a torso
    has a J-th of the unit interval."""
    target, number = case()[2], len(case()[0].torsos)

    def moved(own: jax.Array) -> tuple[jax.Array, jax.Array]:
        rest = jnp.zeros(target.limbs.dim)
        root = target.roots(jnp.concatenate([rest, own]))
        return root.rotation, jnp.append(root.log_scale, root.translation)

    @jax.jit
    def by_derivative(own: jax.Array) -> jax.Array:
        rotation, (turned, rest) = moved(own)[0], jax.jacfwd(moved)(own)
        skew = jnp.einsum("ji,jkx->ikx", rotation, turned[..., 1:4])
        angles = jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
        fraction = jax.nn.sigmoid(own[0])
        return (
            jnp.log(number * fraction * (1 - fraction))
            + jnp.linalg.slogdet(angles)[1]
            - math.log(ANGLES)
            + jnp.linalg.slogdet(rest[:, 4:])[1]
        )

    for x in anywhere(8):
        own = jnp.asarray(x[target.limbs.dim :])
        assert float(target.log_volume(x)) == pytest.approx(float(by_derivative(own)), abs=1e-8)


def test_points_are_roots_and_poses_and_back() -> None:
    """But for the place in a torso's part; and a torso has as much of the interval as the next."""
    target, x = case()[2], anywhere(60)
    where = target.limbs.dim
    assert x.shape[1] == where + len(ROOT_COORDINATES) == where + 7
    found = target.points_at(*placed(target, x))
    np.testing.assert_allclose(np.delete(found, where, 1), np.delete(x, where, 1), atol=1e-6)
    again = target.roots(found).torso
    np.testing.assert_array_equal(again, target.roots(x).torso)
    parts = np.linspace(-3, 3, 601)
    swept = np.tile(x[0], (601, 1))
    swept[:, where] = parts
    torso = np.asarray(target.roots(swept).torso)
    np.testing.assert_array_equal(np.unique(torso), np.arange(3))
    share = (1 / (1 + np.exp(-parts)) * 3).astype(int)
    np.testing.assert_array_equal(torso, np.asarray(target.order)[share])


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [Student, *(pytest.param(law, marks=SWEEP) for law in LAWS.values() if law is not Student)],
)
def test_soft_walls_have_slopes_of_the_root_and_weights_undo_them(law: type[ErrorLaw]) -> None:
    """Under discs the density is flat in turn, scale and place but for the walls and the prior."""
    model, frame, _ = case()
    frame = dataclasses.replace(frame, likelihood=dataclasses.replace(frame.likelihood, law=law()))
    target, x = RootedTarget.of(frame.posterior(model)), case()[2].points_at(*drawn())
    x = np.concatenate([x, x + np.random.default_rng(1).normal(scale=0.5, size=x.shape)])
    inside = np.asarray(target.misfit(x)) <= 1
    assert len(x) // 2 <= inside.sum() < len(x)
    walls = np.asarray(target.log_smooth(x, 8.0) - target.log_density(x))[inside]
    np.testing.assert_allclose(walls, np.asarray(target.log_walls(x, 8.0))[inside], atol=1e-9)
    weights = _log_weights(target, np.asarray(x))
    np.testing.assert_allclose(walls, -weights[inside], atol=1e-9)
    assert np.isneginf(weights[~inside]).all()
    slopes = np.asarray(
        jax.vmap(jax.grad(lambda point: target.log_smooth(point, 8.0)))(jnp.asarray(x))
    )
    assert np.isfinite(slopes).all()
    np.testing.assert_array_equal(slopes[:, target.limbs.dim + 1 :] != 0, True)
    step = 1e-6 * np.eye(target.dim)[target.limbs.dim + 4]
    rise = np.asarray(target.log_smooth(x + step, 8.0) - target.log_smooth(x - step, 8.0)) / 2e-6
    np.testing.assert_allclose(slopes[:, target.limbs.dim + 4], rise, rtol=1e-4, atol=1e-4)


def sampled(name: str, **settings: int) -> Result:
    model, frame = sound.small_case()
    settings = {"num_samples": 1500, "num_roots": 300} | settings
    return inference.sample(model, frame, key=key(5), root="uncertain", sampler=name, **settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["emcee", *(pytest.param(name, marks=SWEEP) for name in ROOTED if name != "emcee")]
)
def test_every_draw_has_its_root(name: str, tmp_path: Path) -> None:
    result = sampled(name)
    assert (result.status, result.sentence) == (COMPLETE, "")
    attributes, draws = result.tree.attrs, result.tree["posterior"]
    number = result.num_draws
    assert 1500 <= number < 1500 + draws.sizes["chain"]
    assert attributes["num_roots"] == number
    assert 20 < attributes["effective_roots"] <= number
    assert attributes["rhat"] > 0.99
    assert attributes["starts"] == "1000 draws from 300 weighted roots"
    assert attributes["root"] == "uncertain"
    lp = result.tree["sample_stats"].lp.values
    assert lp.shape == draws.torso.shape
    assert np.isfinite(lp).all()
    model, frame = sound.small_case()
    target = RootedTarget.of(frame.posterior(model))
    chain = draws.to_dataset().isel(chain=slice(1))
    assert np.asarray(target.misfit(target.points_in(chain))).max() <= 1
    seen = [JOINTS.index(joint) for joint in sound.SEEN]
    off = draws.keypoints.values[..., seen, :] - frame.detection.keypoints[seen]
    reach = np.asarray(frame.posterior(model).detected.spread)[seen]
    distance = np.linalg.norm(off, axis=-1) / draws.scale.values[..., None]
    assert (distance <= reach * (1 + 1e-9)).all()
    result.save(tmp_path / "p.nc")
    assert read_result(tmp_path / "p.nc").num_draws == number


@pytest.mark.slow
def test_the_same_key_the_same_draws_and_few_are_no_answer() -> None:
    few = sampled("emcee", num_samples=8)
    assert few.status == few.tree.attrs["status"] == OUT_OF_BUDGET
    assert "too few for an answer (at least 20); ask for more draws" in few.sentence
    again = sampled("emcee", num_samples=8)
    np.testing.assert_array_equal(few.tree["posterior"].joints, again.tree["posterior"].joints)
    with pytest.raises(OutOfBudget, match="emcee has nowhere to start: no root was attempted"):
        sampled("emcee", max_proposals=1)


@pytest.mark.parametrize("name", ["smc", "nss", "nautilus", "nuts", "hmc"])
def test_who_needs_more_than_a_density_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match=f"no sampler '{name}' draws torso and camera; choose"):
        sampled(name)


def test_what_is_no_density_on_r_d_is_refused() -> None:
    model, _ = sound.small_case()
    limbs = tuple(name for row, name in enumerate(JOINTS) if row not in TORSO_INDEX)
    bare = prior_scene(model, 11, missing=limbs)
    with pytest.raises(BadInput, match="has no seen limb joint"):
        RootedTarget.of(bare.posterior(model))
    with pytest.raises(BadInput, match="keeps 49,152 draws at most"):
        sampled("random-walk", num_samples=100_000)


def judged(
    samplers: list[str], seed: int, case: tuple[PoseModel, Estimate] | None = None
) -> list[str]:
    """Verdicts by 1,200 draws of rejection, by default on the small case."""
    model, frame = case or sound.small_case()
    found = compare(
        model,
        frame,
        samplers,
        seed=seed,
        seconds=None,
        max_evaluations=EVALUATIONS,
        exact_draws=1200,
    )
    return [entry.verdict for entry in found.entries]


@pytest.mark.slow
def test_a_detector_s_faults_are_summed_out_of_the_density() -> None:
    """Log density = log of the sum, over patterns, of the posterior's own; draws bring patterns
    that explain them, and the arm that is seen only if sides are exchanged has coordinates too."""
    model, frame = faulty.small_case()
    posterior = frame.posterior(model)
    target, roots = RootedTarget.of(posterior), faulty.weighed()
    points, poses, _ = roots.draw(np.random.default_rng(1), 400)
    assert target.dim == 2 + 4 * 2 + len(ROOT_COORDINATES)  # lengths and bones of both arms
    x = target.points_at(points, poses)
    roots_of, poses_of = placed(target, x)
    log_each = []
    for exchange, hip, shoulder, elbow, wrist in itertools.product(
        (0, EXCHANGE_INDEX["arms"]), *[(False, True)] * 4
    ):
        outlier = np.zeros(len(JOINTS), bool)
        named = dict(zip(faulty.OUTLIER, (shoulder, hip, elbow, wrist), strict=True))
        outlier[[JOINTS.index(name) for name, flag in named.items() if flag]] = True
        pattern = Faults(np.full(len(x), exchange), np.tile(outlier, (len(x), 1)))
        log_each.append(np.asarray(posterior.log_joint(roots_of, poses_of, pattern)))
    own = np.logaddexp.reduce(log_each) - np.asarray(model.log_prior(*poses_of))
    chart = target.limbs.log_base(jnp.asarray(x[:, : target.limbs.dim])) + target.log_volume(x)
    found = np.asarray(target.log_density(x))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, own + chart, rtol=0, atol=1e-8)
    assert (np.asarray(target.misfit(x)) <= 1).all()
    drawn = target.faults(key(4), x)
    assert np.isfinite(posterior.log_joint(roots_of, poses_of, drawn)).all()
    assert len(np.unique(drawn.outlier, axis=0)) > 1


def test_a_target_of_faults_has_no_slopes() -> None:
    model, frame = faulty.small_case()
    target = RootedTarget.of(frame.posterior(model))
    with pytest.raises(BadInput, match="a detector with faults has no slopes"):
        target.log_smooth(np.zeros(target.dim), 8.0)


@pytest.mark.sweep
def test_a_walk_finds_faults_as_often_as_weighted_roots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Probabilities of an outlier of the wrist and of the hip and of exchanged arms, and the mean
    log scale, within 4 standard errors (6e-5 each); where any joint is an outlier as probably as
    not, they are not."""
    model, frame = faulty.small_case()
    posterior, roots = frame.posterior(model), faulty.weighed()
    known = faulty.fast_moments(roots, roots.log_weight)
    target = RootedTarget.of(posterior)
    starts = target.points_at(*roots.draw(np.random.default_rng(1), 1000)[:2])

    def off(evaluations: int) -> float:
        done = run(
            *(BASELINES["random-walk"], "random-walk", target),
            key=key(6),
            starts=starts,
            num_samples=ENDLESS,
            allowance=Allowance(evaluations=evaluations),
        )
        draws = tree_of(draws_of(posterior, target, done, key(6)))["posterior"]
        values = [
            draws.outlier.values[..., JOINTS.index("right_wrist")],
            draws.outlier.values[..., JOINTS.index("left_hip")],
            draws.exchange.values == EXCHANGE_INDEX["arms"],
            np.log(draws.scale.values),
        ]
        mean = np.array([np.mean(one) for one in values])
        error = np.array([float(az.mcse(np.asarray(one, float))) for one in values])
        return float(np.max(np.abs(mean - known["mean"]) / np.hypot(error, known["mean_se"])))

    assert off(4_000_000) < 4
    right, often = SummedFaults._log_prior, FaultPrior.of(0.5)

    def wrong(self: SummedFaults) -> States:
        faults = dataclasses.replace(often, exchange=self.faults.exchange)
        return right(self._replace(faults=faults))

    monkeypatch.setattr(SummedFaults, "_log_prior", wrong)
    jax.clear_caches()
    assert off(1_000_000) > 8
    monkeypatch.undo()
    jax.clear_caches()


@pytest.mark.sweep
def test_the_judge_holds_walks_among_faults_against_rejection() -> None:
    assert judged(["random-walk", "emcee"], 3, faulty.small_case()) == [AGREES, AGREES]


@pytest.mark.sweep
def test_the_judge_holds_baselines_against_rejection(monkeypatch: pytest.MonkeyPatch) -> None:
    """They agree; a chart without the scale's factor of the area, and one without Haar's measure of
    its rotations, are caught."""
    assert judged(["random-walk", "emcee"], 1) == [AGREES, AGREES]
    right = RootedTarget._log_volume

    def without(self: RootedTarget, point: jax.Array, *, scale: bool) -> jax.Array:
        own = point[self.limbs.dim :]
        turn = CAYLEY.log_abs_det_jacobian(own[1:4], own[1:4])
        return right(self, point) - (2 * own[4] if scale else turn)

    for scale in (True, False):
        wrong = functools.partialmethod(without, scale=scale)
        monkeypatch.setattr(rooted.RootedTarget, "_log_volume", wrong)
        jax.clear_caches()
        assert judged(["random-walk"], 2) == [DIFFERS]
    monkeypatch.undo()
    jax.clear_caches()
