"""Baseline samplers: one face for all, draws inside the support, same bits after an interruption,
and right laws.

The target is checked against NumPyro's own potential of the model. Two libraries are shown to
sample other laws where the product steps aside: emcee's snooker move (≤ 3.1.6) and NumPyro's
sample-adaptive MCMC (≤ 0.22), at a hard wall and with a dense covariance."""

import dataclasses
import functools
import importlib.util
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.distributions.util import cholesky_update
from numpyro.infer import MCMC, NUTS, SA, init_to_value
from numpyro.infer.util import potential_energy

from poseterior import inference
from poseterior.inference.baselines.catalogue import (
    BASELINES,
    DISPERSED,
    ONE_FLIP,
    draws_of,
    starting_points,
)
from poseterior.inference.baselines.ensemble import snooker
from poseterior.inference.baselines.hamiltonian import _log_weights
from poseterior.inference.baselines.run import Allowance, Baseline, Drawn, run
from poseterior.inference.baselines.target import Target
from poseterior.inference.baselines.tempering import next_multiple
from poseterior.inference.draws import COMPLETE, OUT_OF_BUDGET
from poseterior.inference.resampling import systematic
from poseterior.inference.results import tree_of
from poseterior.inference.studies.comparison import compare, contest
from poseterior.inference.studies.comparison.judge import DIFFERS
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.errors.laws import LAWS, Gaussian, Student
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.model import log_joint
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.probmodel.transport import CUBE_DIM
from tests.scenes import ALL_BUT_AN_ARM, key, prior_scene

QUICK = ("emcee",)
ENOUGH = {
    "emcee": 200_000,
    "emcee-de": 200_000,
    "aies": 200_000,
    "ess": 600_000,
    "random-walk": 400_000,
    "sa": 200_000,
    "smc": 900_000,
    "nss": 1_000_000,
    "nautilus": 60_000,
}
"""Evaluations after which each has what the judge needs on one arm."""
LONGEST = ("aies", "emcee-de", "ess", "nautilus", "nss", "sa")
"""Those that take half a minute or more for it, or are relatives of one that is judged anyhow."""
NEEDED = {
    "emcee": 40_000,
    "emcee-de": 40_000,
    "aies": 30_000,
    "ess": 250_000,
    "nuts": 600_000,
    "hmc": 200_000,
    "random-walk": 150_000,
    "sa": 60_000,
    "smc": 600_000,
    "nss": 1_000_000,
    "nautilus": 40_000,
}
"""Evaluations that bring some draws on one arm; nested slice sampling ends by itself."""
HEAVY = [pytest.param(name, marks=pytest.mark.slow) for name in BASELINES if name not in QUICK]


@functools.cache
def low():
    """One arm seen: model, frame, target, exact tree and starting points."""
    model = PoseModel()
    frame = prior_scene(model, 1, missing=ALL_BUT_AN_ARM)
    target = Target.of(frame.posterior(model, CANDIDATES))
    tree = inference.sample(model, frame, key=key(21), num_samples=4000, root="candidates").tree
    return model, frame, target, tree, starting_points(target, tree, DISPERSED)


@functools.cache
def whole():
    """All limbs seen: target and exact points."""
    model = PoseModel()
    frame = prior_scene(model, 1)
    target = Target.of(frame.posterior(model, CANDIDATES))
    tree = inference.sample(model, frame, key=key(22), num_samples=200, root="candidates").tree
    return target, starting_points(target, tree, DISPERSED)


def draw(name: str, evaluations: int, **options):
    """A run on one arm."""
    _, _, target, _, starts = low()
    options = {"key": key(5), "starts": starts, "num_samples": 10**9, **options}
    return run(
        BASELINES[name], name, target, allowance=Allowance(evaluations=evaluations), **options
    )


@pytest.mark.slow
def test_the_target_is_numpyro_s_own_potential():
    """Same density in the same unconstrained space, inside; minus infinity at the same places
    outside."""
    target, points = whole()
    everything = dataclasses.replace(target, active=tuple(range(CUBE_DIM)))
    x = everything.points_of(target.poses(key(1), points))

    def potential(x):
        parameters = {
            "bone_length": x[:5],
            "upper": x[5:15].reshape(5, 2),
            "lower": x[15:].reshape(4, 2),
        }
        return potential_energy(target.model.posterior, (target.observation,), {}, parameters)

    theirs = jax.jit(jax.vmap(lambda x: -potential(x)))
    ours = everything.log_density(x) + target.observation.log_peak
    np.testing.assert_allclose(ours, theirs(x), rtol=0, atol=1e-9)
    away = x + np.random.default_rng(0).normal(scale=0.02, size=x.shape)
    inside = np.isfinite(everything.log_density(away))
    assert 0 < inside.sum() < len(away)
    assert np.array_equal(inside, np.isfinite(theirs(away)))


@pytest.mark.slow
def test_the_charts_of_a_target_agree():
    """Cube and R^d give the same misfit; poses → points → poses comes back; exact draws are
    inside."""
    target, points = whole()
    assert target.dim == 20
    assert np.all(np.asarray(target.misfit(points)) <= 1)
    cube = np.random.default_rng(1).uniform(size=(200, target.dim))
    poses = target.poses_in_cube(key(2), cube)
    np.testing.assert_allclose(
        target.misfit(target.points_of(poses)), target.misfit_in_cube(cube), atol=1e-10
    )
    assert np.isinf(target.misfit_in_cube(cube + 1)).all()
    again = target.poses(key(3), points)
    joints = target.model.joints(target.observation.view, *again)
    np.testing.assert_allclose(
        target.points_of(target.model.pose_of(joints, again.length)), points, atol=1e-6
    )


@pytest.mark.slow
def test_unseen_limbs_follow_the_prior_and_seen_ones_do_not():
    _, _, target, _, points = low()
    assert target.dim == 6
    rest = target.poses(key(4), points[:1000]).lower[:, 1]
    prior = target.poses_in_cube(key(5), np.random.default_rng(0).uniform(size=(1000, 6)))
    assert np.abs(np.mean(rest, axis=0) - np.mean(prior.lower[:, 1], axis=0)).max() < 0.1
    assert (
        np.abs(
            np.mean(target.poses(key(4), points[:1000]).upper[:, 1] - prior.upper[:, 1], axis=0)
        ).max()
        > 0.1
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [pytest.param(law, marks=[] if law is Student else pytest.mark.sweep) for law in LAWS.values()],
)
def test_soft_walls_have_gradients_and_weights_undo_them(law):
    """Whatever the law of errors: a draw's weight is its density over what it was drawn from."""
    target, points = whole()
    target = dataclasses.replace(target, observation=target.observation._replace(law=law()))
    slope = jax.vmap(jax.grad(lambda point: target.log_smooth(point, 8.0)))(
        jnp.asarray(points[:20])
    )
    assert np.isfinite(slope).all()
    walls = np.asarray(target.log_smooth(points, 8.0)) - np.asarray(target.log_density(points))
    np.testing.assert_allclose(walls, target.log_walls(points, 8.0), atol=1e-9)
    np.testing.assert_allclose(walls, -_log_weights(target, points), atol=1e-9)
    seen = int(np.sum(target.observation.seen))
    assert np.all((walls <= 0) & (walls >= -seen * math.log(2) - 1e-9))


@pytest.mark.parametrize("name", ["smc", "nss", "nautilus"])
def test_who_shrinks_discs_is_refused_under_another_law(name):
    """By `sample`, by `compare` before any work is done, and where a target is run."""
    model = PoseModel()
    frame = prior_scene(model, 1)
    frame = dataclasses.replace(frame, likelihood=Likelihood(law=Gaussian()))
    refused = pytest.raises(BadInput, match=f"the sampler {name} shrinks discs, and knows of no")
    with refused:
        inference.sample(
            model,
            frame,
            key=key(0),
            sampler=name,
            num_samples=10,
            max_proposals=1000,
            root="candidates",
        )
    with refused:
        compare(model, frame, [name], root="candidates")
    with refused:
        run(BASELINES[name], name, Target.of(frame.posterior(model, CANDIDATES)), key=key(0))


def test_the_shares_of_shrinking_discs_are_not_flattered():
    """Fresh particles at every stage, misfits uniform up to the last multiple: ten stages 2,000
    times, the true probability known each time. The mean of estimate over truth is 1 within four
    standard errors (6e-5); with one more particle counted at every stage, the negative control, it
    is 1.08."""
    rng = np.random.default_rng(0)
    ratio = np.ones((2000, 2))
    step = jax.jit(jax.vmap(next_multiple))
    for _ in range(10):
        misfit = 1e9 * rng.uniform(size=(2000, 256))
        multiple, inside = (np.asarray(part) for part in step(misfit))
        ratio *= (inside.sum(axis=1)[:, None] + [0, 1]) / 256 / (multiple / 1e9)[:, None]
    error = ratio.std(axis=0) / np.sqrt(2000)
    off = np.abs(ratio.mean(axis=0) - 1) / error
    assert off[0] < 4
    assert off[1] > 10


def test_systematic_resampling_follows_the_weights():
    weight = np.array([0.5, 0.0, 1.5, 2.0])
    each = [
        np.bincount(systematic(weight, 8, u), minlength=4) for u in np.linspace(0.001, 0.999, 400)
    ]
    counts = np.mean(each, axis=0)
    np.testing.assert_allclose(counts, 8 * weight / 4, atol=0.05)


@pytest.mark.sweep
@pytest.mark.parametrize("name", [*QUICK, *HEAVY])
def test_every_baseline_has_the_same_face(name, tmp_path):
    """Draws in chains, all inside; cost; a tree of the contract; and a run that was broken off and
    taken up again equals the whole one bit for bit."""
    model, frame, *_ = low()
    enough = NEEDED[name]
    done = draw(name, enough)
    assert done.status == OUT_OF_BUDGET
    assert done.num_draws > 0
    assert done.cost.num_proposals >= enough or name == "nss"
    assert done.cost.wall_time > 0
    posterior = frame.posterior(model, CANDIDATES)
    tree = tree_of(draws_of(posterior, Target.of(posterior), done, key(5)))
    posterior = tree["posterior"]
    assert posterior.joints.dims == ("chain", "draw", "joint", "axis")
    assert posterior.sizes["chain"] * posterior.sizes["draw"] == done.num_draws
    offset = np.linalg.norm(posterior.keypoints - tree["observed_data"].keypoints, axis=-1)
    radius = tree["constant_data"].radius.values[0]
    assert np.all((offset <= radius * (1 + 1e-9)) | np.isnan(radius))
    assert model.limits.check(posterior.joints.values.reshape(-1, 15, 3)[:500]).valid.all()
    # The chains are in the order in which they were drawn.
    np.testing.assert_allclose(posterior.bone_length.values, done.poses.length)
    part = draw(name, enough // 3, save_to=tmp_path / "run.npz")
    assert part.num_draws < done.num_draws or name == "nss"
    rest = draw(name, enough, save_to=tmp_path / "run.npz")
    assert np.array_equal(rest.poses.upper, done.poses.upper)
    assert rest.cost.num_proposals == done.cost.num_proposals


@pytest.mark.slow
def test_another_key_gives_other_draws():
    one, other = (draw("emcee", 20_000, key=key(seed)) for seed in (5, 6))
    assert min(one.num_draws, other.num_draws) > 100
    assert not np.isin(one.poses.upper[..., 1, 0], other.poses.upper[..., 1, 0]).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["emcee", *(pytest.param(name, marks=pytest.mark.sweep) for name in ("hmc", "nuts"))]
)
def test_a_run_ends_when_it_has_enough(name):
    """What counts are draws that are handed over: of soft walls, those after weighting."""
    done = draw(name, 10**9, num_samples=500)
    assert done.status == COMPLETE
    assert done.num_draws >= 500
    assert done.history[-1].held == done.num_draws


@pytest.mark.slow
def test_what_a_short_run_holds_is_what_it_hands_over():
    """Though weights are looked at now and then only."""
    short = draw("hmc", NEEDED["hmc"])
    assert short.status == OUT_OF_BUDGET
    assert f"hmc holds {short.num_draws} of 1000000000 draws" in short.sentence
    assert short.num_draws > 0


@pytest.mark.slow
def test_one_flip_is_one_flip():
    _, _, target, tree, _ = low()
    from poseterior.inference.studies.flips import away

    poses = target.poses(key(1), starting_points(target, tree, ONE_FLIP))
    joints = target.model.joints(target.observation.view, *poses)
    seen = away(joints)[:, [0, 4]]  # right upper arm and forearm; the others are drawn anew
    assert len(np.unique(seen, axis=0)) == 1


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (
            lambda: contest.check_names(["emcee", "magic"]),
            "no sampler 'magic'; choose from rejection",
        ),
        (lambda: contest.check_names([]), "choose from"),
        (lambda: draw("emcee", 1000, starts=None), "none of the 0 starting points of emcee"),
        (
            lambda: draw("emcee", 1000, starts=np.full((9, 6), 40.0)),
            "none of the 9 starting points",
        ),
        (
            lambda: draw("emcee", 1000, starts=np.full((9, 6), np.nan)),
            "none of the 9 starting points",
        ),
        (lambda: starting_points(low()[2], low()[3], "anywhere"), "no start 'anywhere'"),
        (
            lambda: inference.sample(
                *low()[:2], key=key(0), sampler="emcee", num_samples=50_000, root="candidates"
            ),
            (
                "emcee keeps 49,152 draws at most, spread over its whole run, not 50,000; ask for"
                " fewer"
            ),
        ),
    ],
)
def test_what_cannot_be_run_is_refused(call, match):
    with pytest.raises(BadInput, match=match):
        call()


def test_several_candidates_or_nothing_seen_are_refused():
    model, frame, *_ = low()
    twice = dataclasses.replace(frame, candidates=frame.candidates * 2)
    with pytest.raises(BadInput, match="2 torso-and-camera candidates"):
        Target.of(twice.posterior(model, CANDIDATES))
    with pytest.raises(BadInput, match="no seen limb joint"):
        Target.of(
            prior_scene(
                model, 1, missing=(*ALL_BUT_AN_ARM, "right_elbow", "right_wrist")
            ).posterior(model, CANDIDATES)
        )


def test_a_missing_package_is_one_sentence(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        BadInput, match=r"needs blackjax, which is not installed; pip install '\.\[samplers\]'"
    ):
        draw("smc", 1000)


@pytest.mark.slow
def test_the_model_runs_under_numpyro_s_mcmc_untouched():
    """As the README says: `MCMC(NUTS(model.posterior), …)`, discs as they are, begun at an exact
    draw. Every draw is possible, the chain moves, and the density that NumPyro followed is the one
    that the draws are saved with."""
    model, _, target, tree, _ = low()
    posterior = tree["posterior"]
    start = model.pose_of(posterior.joints.values[0, :1], posterior.bone_length.values[0, :1])
    values = {"bone_length": start.length[0], "upper": start.upper[0], "lower": start.lower[0]}
    kernel = NUTS(model.posterior, init_strategy=init_to_value(values=values), max_tree_depth=5)
    mcmc = MCMC(kernel, num_warmup=100, num_samples=100, progress_bar=False)
    mcmc.run(key(0), target.observation, extra_fields=("potential_energy",))
    found = mcmc.get_samples()
    parts = [np.asarray(found[name]) for name in ("bone_length", "upper", "lower")]
    assert np.isfinite(log_joint(model, target.observation, *parts)).all()
    assert np.isfinite(mcmc.get_extra_fields()["potential_energy"]).all()
    assert len(np.unique(parts[0][:, 1])) > 20


@pytest.mark.slow
def test_too_small_a_budget_says_so():
    done = draw("random-walk", 1)
    assert done.num_draws == 0
    assert "not one draw" in done.sentence


def test_draws_that_are_not_finite_are_refused():
    """Whatever a method returns: here one whose draws are not numbers."""

    class Broken:
        evaluations = held = 1

        def __init__(self, target, key, starts):
            pass

        def more(self):
            return False

        def drawn(self, key):
            return Drawn(np.full((1, 3, 6), np.nan), math.nan, math.nan, {"steps": 3})

        def state(self):
            return {}

        def restore(self, state):
            pass

    with pytest.raises(
        BadInput, match="broken returned draws that are not finite; use other starts"
    ):
        run(Baseline(Broken, 0, "a note"), "broken", low()[2], key=key(0))


def test_draws_are_thinned_along_paths():
    """Two chains of three walkers with ten steps each: every third step of each, in order."""
    points = np.arange(60.0).reshape(2, 30, 1)
    few = Drawn(points, math.nan, math.nan, {"steps": 10}).thinned(20)
    assert few.info["steps"] == 4
    assert few.points[0, :, 0].tolist() == [0, 3, 6, 9, 10, 13, 16, 19, 20, 23, 26, 29]
    assert Drawn(points, math.nan, math.nan, {"steps": 1}).thinned(20).points.shape == (2, 30, 1)
    assert Drawn(points, math.nan, math.nan, {"steps": 10}).thinned(60).points.shape == (2, 30, 1)


@pytest.mark.slow
def test_a_broken_or_foreign_file_is_refused(tmp_path):
    path = tmp_path / "run.npz"
    draw("emcee", 1000, save_to=path)
    with pytest.raises(BadInput, match="another run"):
        draw("emcee", 1000, save_to=path, key=key(99))
    with np.load(path) as file:
        content = dict(file)
    for name, changed in {
        "_history": content["_history"].ravel(),
        "kept": content["kept"][:, :-1],
        "counts": content["counts"] + 1,
    }.items():
        np.savez(path, **content | {name: changed})
        with pytest.raises(BadInput, match="not what its checksum says"):
            draw("emcee", 1000, save_to=path)
    np.savez(path, **content)
    draw("emcee", 1000, save_to=path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(BadInput, match="truncated"):
        draw("emcee", 1000, save_to=path)


def normal_variance(move) -> float:
    """Variance that an emcee move makes of a standard normal law in ten dimensions, started in
    it."""
    import emcee

    rng = np.random.default_rng(0)
    sampler = emcee.EnsembleSampler(
        64, 10, lambda x: -0.5 * np.sum(x**2, axis=1), moves=move, vectorize=True
    )
    state = emcee.State(
        rng.normal(size=(64, 10)), random_state=np.random.RandomState(1).get_state()
    )
    return float(
        sampler.run_mcmc(state, 1500, store=True)
        and sampler.get_chain(discard=500, flat=True).var()
    )


def test_walkers_in_one_place_stay_there_and_say_nothing_untrue():
    """Starts that were found come several times where they are few: no line leads through two
    walkers in one place, which emcee would end the run for ("At least one parameter value was
    NaN")."""
    few = np.random.default_rng(0).normal(size=(2, 3))[np.arange(20) % 2]
    proposal, log_ratio = snooker().get_proposal(few, [few, few, few], np.random.RandomState(0))
    assert np.isfinite(proposal).all()
    assert np.isfinite(log_ratio).all()
    still = (proposal == few).all(axis=1)
    assert still.any()
    assert not still.all()
    np.testing.assert_array_equal(log_ratio[still], 0)


@pytest.mark.slow
def test_our_snooker_keeps_a_normal_law_and_emcee_s_does_not():
    """Autocorrelation times of about 90 leave 700 effective draws × 10 coordinates: standard error
    0.017. The second half is the negative control; once it fails, emcee has been mended (its pull
    request 531), and ours can go."""
    import emcee

    assert abs(normal_variance(snooker()) - 1) < 0.08
    assert normal_variance(emcee.moves.DESnookerMove()) < 0.75


@pytest.mark.slow
def test_sample_adaptive_mcmc_leaves_a_hard_wall_unless_it_is_finite():
    """A box: with density zero outside, NumPyro's SA returns points from outside; with a high but
    finite wall none."""

    def share_outside(wall: float) -> float:
        def potential(x):
            return jnp.where(jnp.all(jnp.abs(x) < 1), 0.0, wall)

        kernel = SA(potential_fn=potential, adapt_state_size=10)
        mcmc = MCMC(kernel, num_warmup=500, num_samples=500, progress_bar=False)
        with jax.numpy_rank_promotion("allow"):
            mcmc.run(key(0), init_params=jnp.zeros(3))
        return float(np.mean(np.abs(np.asarray(mcmc.get_samples())).max(axis=1) > 1))

    assert share_outside(1e6) == 0
    assert share_outside(jnp.inf) > 0.5


def adaptive_variance(dense: bool) -> tuple[float, float]:
    """Variance, and its standard error over 16 chains, that sample-adaptive MCMC makes of a
    standard normal law in five dimensions."""
    kernel = SA(potential_fn=lambda x: 0.5 * jnp.sum(x**2), dense_mass=dense)
    mcmc = MCMC(
        kernel,
        num_warmup=2000,
        num_samples=4000,
        num_chains=16,
        chain_method="vectorized",
        progress_bar=False,
    )
    with jax.numpy_rank_promotion("allow"):
        mcmc.run(key(0), init_params=jnp.zeros((16, 5)))
    each = np.asarray(mcmc.get_samples(group_by_chain=True)).var(axis=1).mean(axis=1)
    return float(each.mean()), float(each.std() / 4)


@pytest.mark.slow
def test_sample_adaptive_mcmc_keeps_a_normal_law_with_a_diagonal_covariance_only():
    """Four standard errors (6e-5, taken as normal). The second half is the negative control, and
    the third its reason; once they fail, NumPyro has been mended, and ours can be dense."""
    variance, error = adaptive_variance(dense=False)
    assert error < 0.02
    assert abs(variance - 1) < 4 * error
    assert adaptive_variance(dense=True)[0] < 0.85
    root, step = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([1.0, -1.0])
    updated = np.asarray(cholesky_update(jnp.asarray(root), jnp.asarray(step)))
    assert np.abs(updated @ updated.T - root @ root.T - np.outer(step, step)).max() > 0.1


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.sweep if name in LONGEST else pytest.mark.slow)
        for name in ENOUGH
    ],
)
def test_correct_samplers_pass_on_one_arm(name):
    """From dispersed starts or the prior; judged by 10,000 exact draws at 0.1 %, on 100 effective
    draws at least. NUTS and HMC have some 20 after a million gradients, hardly more than their
    chains: the judge cannot tell, and says so in reports/samplers.md."""
    model, frame, *_ = low()
    known = contest.truth(model, frame, key=key(31), number=10_000)
    start, allowance = contest.starts_of(name)[0], Allowance(evaluations=ENOUGH[name])
    entry, _ = contest.enter_baseline(
        model, known, name, start, key=key(32), allowance=allowance, num_samples=contest.ENDLESS
    )
    assert entry.judgement is not None
    assert entry.judgement.mixing.worst > 100
    p_values = [test.p_value for test in entry.judgement.tests]
    smallest = min(p_values, default=1.0) * len(p_values)
    assert entry.verdict != DIFFERS or smallest > 1e-3, entry.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["smc", *(pytest.param(name, marks=pytest.mark.sweep) for name in ("nss", "nautilus"))]
)
def test_evidence_is_within_three_standard_errors(name):
    _, _, _, tree, _ = low()
    done = draw(name, ENOUGH[name])
    error = math.hypot(done.log_evidence_se, tree.attrs["log_evidence_se"])
    assert abs(done.log_evidence - tree.attrs["log_evidence"]) < 3 * error
    assert error < 0.3


@pytest.mark.slow
def test_the_active_coordinates_are_those_that_matter():
    """Moving an inactive coordinate moves no seen joint; moving any active one moves some."""
    target, points = whole()
    everything = dataclasses.replace(target, active=tuple(range(CUBE_DIM)))
    x = np.asarray(everything.points_of(target.poses(key(1), points[:1])))
    before = np.asarray(everything.misfit(x))
    for coordinate in range(CUBE_DIM):
        moved = x.copy()
        moved[0, coordinate] += 0.3
        poses = [everything.poses(key(0), place) for place in (x, moved)]
        joints = [target.model.joints(target.observation.view, *pose) for pose in poses]
        seen = np.flatnonzero(np.asarray(target.observation.seen))
        changed = np.abs(np.asarray(joints[1] - joints[0]))[0, seen].max() > 1e-6
        assert changed == (coordinate in target.active)
    assert before.shape == (1,)
    assert JOINT_INDEX["head"] not in seen
