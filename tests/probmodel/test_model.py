"""The NumPyro programs: densities by hand, handlers, and NumPyro's own samplers on the
posterior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.distributions import biject_to
from numpyro.handlers import condition, seed, substitute, trace, uncondition
from numpyro.infer import MCMC, NUTS, Predictive, init_to_value, log_likelihood
from numpyro.infer.util import initialize_model, log_density, potential_energy, unconstrain_fn

from poseterior.probmodel.anatomy.lengths import BoneLength
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection
from poseterior.probmodel.errors.laws import Disc
from poseterior.probmodel.model import PoseModel, log_joint
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.roots import Root
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS, NUM_JOINTS
from tests.instances import random_triple

KEY = jax.random.key(2)
SITES = ("bone_length", "upper", "lower")
MISSING = JOINT_INDEX["left_wrist"]


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


@pytest.fixture(scope="module")
def truth(model) -> dict[str, jax.Array]:
    """A draw of the prior."""
    return {name: value[0] for name, value in Predictive(model.prior, num_samples=1)(KEY).items()}


@pytest.fixture(scope="module")
def observation(model, truth) -> Observation:
    """The draw, seen from somewhere: all limb joints but one detected, up to 20 pixels off, radius
    30 pixels."""
    rng = np.random.default_rng(1)
    camera = WeakPerspective(100.0, random_triple(rng), np.array([300.0, 200.0]))
    joints = np.asarray(truth["joints"])
    torso = np.asarray(model.torsos)[int(truth["torso"])]
    spread = np.full(NUM_JOINTS, np.inf)
    spread[list(LIMB_JOINTS)] = 30.0 / 100.0
    spread[MISSING] = np.inf
    keypoints = np.asarray(camera.project(joints)) + rng.uniform(-14, 14, (NUM_JOINTS, 2))
    target = np.where(np.isfinite(spread)[:, None], camera.to_plane(keypoints), 0.0)
    return Observation(Root(torso, camera), target, spread, Disc())


@pytest.fixture(scope="module")
def latents(truth) -> dict[str, jax.Array]:
    return {name: truth[name] for name in SITES}


@jax.jit
def density(model: PoseModel, observation: Observation, latents: dict) -> jax.Array:
    """Log density of NumPyro's posterior program, compiled once, with the model as an argument."""
    return log_density(model.posterior, (observation,), {}, latents)[0]


@jax.jit
def energy(model: PoseModel, observation: Observation, x: dict) -> jax.Array:
    return potential_energy(model.posterior, (observation,), {}, x)


def by_hand(model: PoseModel, latents: dict, observation: Observation) -> float:
    """Prior of each site from its distribution, and -log πτ² for every joint seen, term by term."""
    value = BoneLength(model.lengths).log_prob(latents["bone_length"])
    value = value + OccupiedDirection(model.cells).log_prob(latents["upper"]).sum()
    value = (
        value + HingedDirection(model.hinges_at(latents["upper"])).log_prob(latents["lower"]).sum()
    )
    joints = model.joints(
        observation.root.torso @ observation.root.camera.rotation.T,
        *(latents[name] for name in SITES),
    )
    for joint in LIMB_JOINTS:
        if joint == MISSING:
            continue
        camera = observation.root.camera
        at = camera.scale * joints[joint, :2] + camera.translation
        detected = camera.scale * observation.target[joint] + camera.translation
        inside = np.sum((at - detected) ** 2) <= 30.0**2
        value = value - np.log(np.pi * 30.0**2) if inside else -np.inf
    return float(value)


def test_prior_sites(model) -> None:
    sites = trace(seed(model.prior, KEY)).get_trace()
    assert list(sites) == ["torso", *SITES, "joints"]
    assert sites["joints"]["value"].shape == (NUM_JOINTS, 3)


def test_prior_density_is_that_of_the_sites(model, truth, latents) -> None:
    found, _ = log_density(model.prior, (), {}, latents | {"torso": truth["torso"]})
    expected = model.log_prior(*(latents[name] for name in SITES)) - np.log(len(model.torsos))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_posterior_density_equals_the_sum_by_hand(model, latents, observation) -> None:
    found, sites = log_density(model.posterior, (observation,), {}, latents)
    assert np.isfinite(found)
    np.testing.assert_allclose(found, by_hand(model, latents, observation), rtol=1e-12)
    batch = [np.asarray(latents[name])[None] for name in SITES]
    np.testing.assert_allclose(log_joint(model, observation, *batch), found, rtol=1e-12)
    np.testing.assert_allclose(
        sites["joints"]["value"],
        observation.root.camera.view(
            PoseModel.joints(model, observation.root.torso, *(latents[name] for name in SITES))
        ),
        atol=1e-12,
    )


@pytest.mark.parametrize("joint", LIMB_JOINTS)
def test_a_joint_that_leaves_its_disc_is_impossible_and_a_missing_one_has_no_factor(
    model, latents, observation, joint
) -> None:
    """Each limb joint's target moved by 1,000 pixels: -inf, but for the missing one, which
    changes nothing."""
    target = np.array(observation.target)
    target[joint] += 10.0
    moved = observation._replace(target=target)
    found = density(model, moved, latents)
    assert found == (density(model, observation, latents) if joint == MISSING else -np.inf)


def test_joints_without_a_spread_have_no_factor(model, latents, observation) -> None:
    target = np.array(observation.target)
    target[JOINT_INDEX["head"]] += 1e4
    found = density(model, observation._replace(target=target), latents)
    np.testing.assert_allclose(found, by_hand(model, latents, observation), rtol=1e-12)


@pytest.mark.slow
def test_predictive_draws_the_prior_and_the_keypoints(model, observation) -> None:
    """Posterior program with the keypoints unconditioned: new keypoints lie in the discs around the
    new poses."""
    sample = Predictive(uncondition(model.posterior), num_samples=50)(KEY, observation)
    offset = np.linalg.norm(
        np.asarray(sample["detection"]) - np.asarray(sample["keypoints"]), axis=-1
    )
    seen = np.asarray(observation.seen)
    assert seen.sum() == len(LIMB_JOINTS) - 1
    assert (offset[:, seen] <= 30.0).all()
    assert (offset[:, seen] > 15.0).any()
    log_prior = model.log_prior(sample["bone_length"], sample["upper"], sample["lower"])
    assert np.isfinite(log_prior).all()


def test_every_part_of_a_drawn_pose_has_a_key_of_its_own() -> None:
    """Lengths, upper and lower bones are drawn in turn, no two of them with one key, nor with the
    key that was given."""
    used = [KEY]

    class Recorder:
        """Stands for a model, and for its laws."""

        def compose(self, step):
            return [step(site, self) for site in SITES]

        def sample(self, key, sample_shape):
            used.append(key)

    PoseModel.draw(Recorder(), KEY, 3)
    words = {tuple(jax.random.key_data(key).tolist()) for key in used}
    assert len(words) == len(used) == 4


def test_condition_and_substitute_hold_a_site(model, latents, observation) -> None:
    for handler in (condition, substitute):
        sites = trace(seed(handler(model.posterior, {"upper": latents["upper"]}), KEY)).get_trace(
            observation
        )
        np.testing.assert_array_equal(sites["upper"]["value"], latents["upper"])
    assert trace(seed(condition(model.prior, latents), KEY)).get_trace()["lower"]["is_observed"]


def test_log_likelihood_of_numpyro(model, latents, observation) -> None:
    stacked = {name: value[None] for name, value in latents.items()}
    found = log_likelihood(model.posterior, stacked, observation)["detection"].sum()
    np.testing.assert_allclose(found, observation.log_peak, rtol=1e-12)


def test_explains_agrees_with_the_discs(model, observation) -> None:
    sample = Predictive(model.posterior, num_samples=100)(KEY, observation)
    wide = observation._replace(spread=np.asarray(observation.spread) * 8)
    inside = np.asarray(wide.explains(sample["joints"]))
    detected = np.asarray(observation.root.camera.to_pixels(observation.target))
    offset = np.linalg.norm(np.asarray(sample["keypoints"]) - detected, axis=-1)
    offset = np.where(np.asarray(observation.seen), offset, 0.0)
    np.testing.assert_array_equal(inside, (offset[:, list(LIMB_JOINTS)] <= 240.0).all(axis=1))


def test_turning_the_person_before_a_turned_camera_changes_nothing(
    model, latents, observation
) -> None:
    turn = random_triple(np.random.default_rng(9))
    torso, camera = observation.root
    camera = camera._replace(rotation=camera.rotation @ turn.T)
    turned = observation._replace(root=Root(torso @ turn.T, camera))
    pair = [density(model, o, latents) for o in (observation, turned)]
    np.testing.assert_allclose(*pair, rtol=1e-12)


def unconstrained(model: PoseModel, latents: dict) -> dict:
    supports = {
        "bone_length": BoneLength(model.lengths).support,
        "upper": OccupiedDirection(model.cells).support,
        "lower": HingedDirection(model.hinges_at(latents["upper"])).support,
    }
    return {name: biject_to(supports[name]).inv(latents[name]) for name in SITES}


def test_potential_energy_by_hand(model, latents, observation) -> None:
    """The support of `lower` depends on `upper`. Potential = -(log density + Σ log|Jacobian|), the
    transforms written out; and NumPyro unconstrains to the same numbers."""
    x = unconstrained(model, latents)
    numpyros = unconstrain_fn(model.posterior, (observation,), {}, latents)
    for name in SITES:
        np.testing.assert_allclose(numpyros[name], x[name], atol=1e-8)
    found = energy(model, observation, x)
    logistic = sum(
        float(np.sum(-np.logaddexp(0, x[name]) - np.logaddexp(0, -x[name])))
        for name in ("upper", "lower")
    )
    low, high = model.lengths.low, model.lengths.high
    fraction = (np.asarray(latents["bone_length"]) - low) / (high - low)
    lengths = float(BoneLength(model.lengths).log_prob(latents["bone_length"]))
    lengths += float(np.sum(np.log((high - low) * fraction * (1 - fraction))))
    # In the directions' coordinates the prior is flat: only the logistic functions remain.
    np.testing.assert_allclose(
        found, -(logistic + lengths + float(observation.log_peak)), rtol=1e-9
    )


def test_potential_is_infinite_outside(model, latents, observation) -> None:
    moved = observation._replace(target=np.asarray(observation.target) + 5.0)
    assert energy(model, moved, unconstrained(model, latents)) == np.inf


@pytest.mark.slow
def test_gradient_of_the_potential_is_finite(model, latents, observation) -> None:
    gradient = jax.grad(energy, argnums=2)(model, observation, unconstrained(model, latents))
    assert all(np.isfinite(part).all() for part in gradient.values())


@pytest.mark.slow
def test_nuts_runs_from_a_possible_start(model, latents, observation) -> None:
    """With wide discs, and 100 steps to find the step size: the chain moves, and every draw is
    possible."""
    wide = observation._replace(spread=np.asarray(observation.spread) * 10)
    kernel = NUTS(
        model.posterior,
        init_strategy=init_to_value(values=latents),
        adapt_mass_matrix=False,
        max_tree_depth=3,
    )
    mcmc = MCMC(kernel, num_warmup=100, num_samples=20, progress_bar=False)
    mcmc.run(jax.random.key(0), wide)
    sample = mcmc.get_samples()
    assert sample["joints"].shape == (20, NUM_JOINTS, 3)
    assert len(np.unique(np.asarray(sample["bone_length"])[:, 0])) > 5
    parts = [np.asarray(sample[name]) for name in SITES]
    assert np.isfinite(log_joint(model, wide, *parts)).all()


@pytest.mark.slow
def test_initialise_without_values_where_discs_are_wide(model, observation) -> None:
    wide = observation._replace(spread=np.full(NUM_JOINTS, 100.0))
    info = initialize_model(KEY, model.posterior, model_args=(wide,))
    assert np.isfinite(info.param_info.potential_energy)


def test_model_is_a_pytree(model, latents, observation) -> None:
    leaves, structure = jax.tree.flatten(model)
    back = jax.tree.unflatten(structure, leaves)
    assert back.measures == model.measures == {"upper": "angle", "lower": "area"}

    expected = log_density(model.posterior, (observation,), {}, latents)[0]
    np.testing.assert_allclose(density(back, observation, latents), expected, rtol=1e-12)


def test_measures_are_named_choices(model) -> None:
    other = PoseModel(model.limits, model.lengths, model.torsos, upper="area", lower="box")
    assert other.measures == {"upper": "area", "lower": "box"}
    with pytest.raises(ValueError, match="upper bones"):
        PoseModel(model.limits, model.lengths, model.torsos, upper="uniform")
    with pytest.raises(ValueError, match="lower bones"):
        PoseModel(model.limits, model.lengths, model.torsos, lower="recipe")


@pytest.mark.slow
def test_log_prior_in_batches(model) -> None:
    sample = Predictive(model.prior, num_samples=6)(KEY)
    parts = [jnp.asarray(sample[name]) for name in SITES]
    batch = model.log_prior(*(part.reshape(2, 3, *part.shape[1:]) for part in parts))
    each = [model.log_prior(*(part[k] for part in parts)) for k in range(6)]
    np.testing.assert_allclose(batch.ravel(), each, rtol=1e-12)
