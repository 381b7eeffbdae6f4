"""One body in several views: the log joint against projections written anew, one view against a
known focal length, the weights' evidence by a route that draws limbs from the prior, and, of
simulated bodies, whether posteriors hold the truth as often as they say."""

import dataclasses
import math
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior.inference.draws import COMPLETE, place
from poseterior.inference.importance.views import roots, weighted
from poseterior.inference.importance.views.aims import (
    Reach,
    SpatialAim,
    aimed_density,
    draw_direction,
    modes_of,
)
from poseterior.inference.importance.views.limbs import PER_LIMB, _resampled, _spread
from poseterior.inference.importance.views.roots import (
    FREEDOM_OF_ROOTS,
    NARROWER,
    WIDER,
    BodyProposal,
    BodySteps,
    WorldBodies,
    _turned,
    fitted,
    log_haar,
    rotations_of,
)
from poseterior.inference.importance.views.weighted import WeightedViews, pooled, weigh_refined
from poseterior.inference.resampling import effective, shares, tempered
from poseterior.probmodel import (
    BadInput,
    Detection,
    DetectorErrors,
    FaultPrior,
    Gaussian,
    Likelihood,
    PoseModel,
)
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, ORDERS, Faults
from poseterior.probmodel.instant import CameraView, Instant
from poseterior.probmodel.root_priors import MEDIAN_SIZE, SIZE_SD
from poseterior.probmodel.roots import RootPoint, WorldPoint
from poseterior.probmodel.sessions import Pinhole
from poseterior.probmodel.skeleton import NUM_JOINTS
from tests.filmed import cameras

FAULTY = Likelihood(Gaussian(), factor=0.2, faults=FaultPrior.of(outlier=0.05, exchange=0.05))
CENTRE = np.array([0.0, 0.0, 950.0])
WANDER = 150.0
"""Millimetres: the standard deviation of where simulated bodies are."""
DEFINED = np.zeros((NUM_JOINTS, 3))
DEFINED[[2, 5, 9, 12]] = [[-0.3, 0.1, 0.0], [0.3, 0.1, 0.0], [0.0, 0.3, 0.2], [0.0, 0.3, 0.2]]
"""A detector's shoulders and hips beside the skeleton's."""


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


def bodies(model: PoseModel, number: int, seed: int) -> tuple[WorldPoint, object, np.ndarray]:
    """Roots, poses, and joints `(number, 15, 3)` of the world, mm; places are Gaussian."""
    rng = np.random.default_rng(seed)
    poses = model.draw(jax.random.key(seed), number)
    poses = jax.tree.map(np.asarray, poses)
    turns = stats.special_ortho_group.rvs(3, size=number, random_state=rng).reshape(-1, 3, 3)
    points = WorldPoint(
        rng.integers(0, len(model.torsos), number),
        turns,
        rng.normal(math.log(MEDIAN_SIZE), SIZE_SD, number),
        CENTRE + WANDER * rng.standard_normal((number, 3)),
        np.zeros((number, 0, 2)),
    )
    views = np.einsum("nab,njb->nja", turns, np.asarray(model.torsos)[points.torso])
    joints = np.asarray(model.joints(views, *poses))
    return points, poses, points.place[:, None] + np.exp(points.log_size)[:, None, None] * joints


def seen(
    views: list[Pinhole], world: np.ndarray, size: float, likelihood: Likelihood, seed: int
) -> Instant:
    """What cameras detect of joints `(15, 3)`, with errors and faults of the likelihood: written
    from its description."""
    rng, found = np.random.default_rng(seed), []
    for number, camera in enumerate(views):
        spread = likelihood.factor
        unit = camera.focal[0] * size / camera.view(world)[:, 2]
        error = spread * np.asarray(
            likelihood.law.sample(jax.random.key(seed * 100 + number), (NUM_JOINTS,))
        )
        counts = np.ones(NUM_JOINTS, bool)
        faults = likelihood.faults.draw(counts, jax.random.key(seed * 100 + number + 50))
        order = ORDERS[int(faults.exchange)]
        angle, far = 2 * np.pi * rng.random(NUM_JOINTS), np.sqrt(rng.random(NUM_JOINTS))
        gone = likelihood.faults.reach * far[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        wrong = np.asarray(faults.outlier)[order]
        pixels = camera.project(world) + unit[:, None] * np.where(wrong[:, None], gone, error)
        named = pixels[order]  # an exchange undoes itself
        person = Detection(named, np.full(NUM_JOINTS, 0.5), "simulated", "a simulation", 0)
        found.append(CameraView(f"cam{number + 1}", camera, person, likelihood))
    return Instant("a simulation", tuple(found))


def straight(number: int) -> list[Pinhole]:
    return [camera.straight for camera in cameras(number)]


# --- the log joint


@pytest.mark.slow
def test_the_log_joint_is_that_of_its_description(model: PoseModel) -> None:
    """Prior of the place and of where cameras point, peaks, pixels a body unit and cut Gaussians,
    written anew in NumPy."""
    points, poses, world = bodies(model, 3, seed=1)
    views = straight(2)
    plain = dataclasses.replace(FAULTY, faults=FaultPrior())
    instant = seen(views, world[0], math.exp(points.log_size[0]), plain, seed=4)
    instant = dataclasses.replace(instant, pointing=0.4)
    far = math.tan(math.radians(0.4)) * views[0].focal[0]
    shift = np.random.default_rng(5).normal(0, 0.1 * far, (3, 2, 2))
    points = points._replace(pointing=shift)
    wanted = []
    for row in range(3):
        size = math.exp(points.log_size[row])
        total = -math.log(len(model.torsos))
        total += stats.norm.logpdf(points.log_size[row], math.log(MEDIAN_SIZE), SIZE_SD)
        total += float(model.log_prior(*(part[row] for part in poses)))
        total += stats.norm.logpdf(shift[row], 0, far).sum()
        for camera, view, beside in zip(views, instant.views, shift[row], strict=True):
            total -= 3 / 2 * math.log(camera.view(points.place[row])[2])
            sd = plain.factor / 2 * camera.focal[0] * size / camera.view(world[row])[:, 2]
            off = (view.detection.keypoints - camera.project(world[row]) - beside) / sd[:, None]
            square = np.sum(off**2, axis=1)
            level = -square / 2 - np.log(2 * np.pi * sd**2 * -math.expm1(-4.5))
            total += np.where(square <= 9, level, -np.inf).sum()
        wanted.append(total)
    found = np.asarray(instant.posterior(model).log_joint(points, poses))
    assert np.isfinite(wanted[0])
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


@pytest.mark.slow
def test_one_view_is_a_known_focal_length(model: PoseModel) -> None:
    """The two log joints differ by the prior of the size and the unit of the place alone."""
    points, poses, world = bodies(model, 4, seed=2)
    (camera,) = straight(1)
    instant = seen([camera], world[0], math.exp(points.log_size[0]), FAULTY, seed=6)
    posterior = instant.posterior(model)
    place_in_view = camera.view(points.place)
    scale = camera.focal[0] * np.exp(points.log_size) / place_in_view[:, 2]
    translation = camera.principal + camera.focal[0] * place_in_view[:, :2] / place_in_view[:, 2:]
    alone = RootPoint(points.torso, camera.rotation @ points.rotation, np.log(scale), translation)
    faults = Faults.none(4)
    one = np.asarray(posterior.alone.log_joint(alone, poses, faults))
    several = np.asarray(
        posterior.log_joint(points, poses, Faults(*(part[:, None] for part in faults)))
    )
    size = stats.norm.logpdf(points.log_size, math.log(MEDIAN_SIZE), SIZE_SD)
    volume = 3 * np.log(place_in_view[:, 2])
    assert np.isfinite(one[0])
    np.testing.assert_allclose(several[0], (one + size - volume)[0], rtol=1e-10)


# --- the proposal's density


def test_rotation_vectors_have_haars_density() -> None:
    """Its integral over the ball of half turns is one, and rotations have their vectors back."""
    rng = np.random.default_rng(0)
    turn = rng.uniform(-np.pi, np.pi, (200_000, 3))
    mass = np.exp(log_haar(turn)) * (2 * np.pi) ** 3
    error = mass.std() / math.sqrt(len(mass))
    assert abs(mass.mean() - 1) < 4 * error < 0.02
    some = turn[np.linalg.norm(turn, axis=1) < np.pi][:100]
    found = Rotation.from_matrix(rotations_of(some)).as_rotvec()
    np.testing.assert_allclose(found, some, atol=1e-9)


def test_rows_come_as_often_as_their_weights_say() -> None:
    """Averaged over all offsets, and never more than one too many or too few; a row without weight
    never comes."""
    log_weight = np.log(np.array([0.1, 1e-300, 2.0, 0.4, 0.5]))
    offsets = (np.arange(2000) + 0.5) / 2000
    level, rows = jax.vmap(_resampled, (None, None, 0))(log_weight, jax.numpy.zeros(5), offsets)
    np.testing.assert_allclose(level, np.log(0.6), rtol=1e-12)
    times = np.stack([np.bincount(one, minlength=5) for one in np.asarray(rows)])
    wanted = np.exp(log_weight) / 0.6
    np.testing.assert_allclose(times.mean(axis=0), wanted, atol=2e-3)
    assert np.abs(times - wanted).max() < 1
    nothing, _ = _resampled(np.full(5, -np.inf), jax.numpy.zeros(5), 0.5)
    assert np.isneginf(nothing).all()


def test_numbers_of_proposals_are_uniform_and_leave_fewer_gaps() -> None:
    """Each by itself over 400 keys (Kolmogorov and Smirnov's p above 0.001, which is the rate of
    false alarms; of a lattice that is not moved it is below), and their means scatter less than
    half as those of independent numbers do."""
    keys = jax.random.split(jax.random.key(3), 400)
    found = np.asarray(jax.vmap(_spread, (0, None, None))(keys, 1, 2))[:, 0]
    assert found.shape == (400, PER_LIMB, 2, 3)
    assert stats.kstest(found[:, 7, 1, 2], "uniform").pvalue > 0.001
    assert stats.kstest(np.tile(found[0, 7, 1, 2], 400), "uniform").pvalue < 0.001
    hill = np.exp(-np.sum((found - 0.5) ** 2, axis=-1) / 0.1)
    alone = np.exp(-np.sum((np.random.default_rng(3).random(found.shape) - 0.5) ** 2, -1) / 0.1)
    assert hill.mean(axis=1).std() < alone.mean(axis=1).std() / 2
    np.testing.assert_allclose(hill.mean(), alone.mean(), rtol=0.02)


def test_weights_are_tempered_until_enough_count() -> None:
    log_weight = np.append(np.random.default_rng(2).normal(0, 5, 400), -np.inf)
    few, more = shares(log_weight), tempered(log_weight, 50)
    assert effective(few) < 10
    assert effective(more) == pytest.approx(50, rel=1e-6)
    assert more[-1] == 0
    np.testing.assert_array_equal(np.argsort(more), np.argsort(few))
    np.testing.assert_array_equal(tempered(log_weight, 1.0), few)
    np.testing.assert_array_equal(tempered(np.full(3, -np.inf), 2), np.zeros(3))


@pytest.fixture(scope="module")
def refined(model: PoseModel) -> tuple[BodyProposal, BodyProposal]:
    """A fit's proposal, and one that bodies of it have refined by weights of no meaning."""
    points, _, world = bodies(model, 1, seed=3)
    instant = seen(straight(2), world[0], math.exp(points.log_size[0]), FAULTY, seed=1)
    first = fitted(dataclasses.replace(instant, pointing=0.4).posterior(model))
    rng = np.random.default_rng(5)
    steps = first.draw(rng, 300)
    return first, first.refined(steps, tempered(rng.normal(0, 3, 300), 50))


def test_refined_proposals_are_drawn_by_their_density(
    refined: tuple[BodyProposal, BodyProposal],
) -> None:
    """By the mean ratio of the first proposal's density to theirs, which is one, within four
    standard errors (false alarms: 6 in 100,000). The control draws from narrower ones."""
    first, second = refined

    def mass(drawn_from: BodyProposal) -> tuple[float, float]:
        drawn = drawn_from.draw(np.random.default_rng(1), 5_000)
        ratio = np.exp(first.log_density(drawn) - second.log_density(drawn))
        return ratio.mean(), ratio.std() / math.sqrt(len(ratio))

    found, error = mass(second)
    assert abs(found - 1) < 4 * error < 0.1
    wrong, error = mass(dataclasses.replace(second, spread=0.8 * second.spread))
    assert abs(wrong - 1) > 4 * error


def test_densities_are_those_of_scipys_students_at_the_bodies(
    refined: tuple[BodyProposal, BodyProposal],
) -> None:
    """Of root and lengths as they are, not of steps: rotation vectors and Haar's measure by
    formulas of their own."""
    _, second = refined
    steps = second.draw(np.random.default_rng(2), 40)
    bodies_, wanted = second.bodies(steps), []
    for row, torso in enumerate(steps.torso):
        fit, body = second.fit.take(torso), bodies_.take(row)
        turn = Rotation.from_matrix(body.point.rotation @ fit.point.rotation.T).as_rotvec()
        step = [
            turn,
            [body.point.log_size - fit.point.log_size],
            body.point.place - fit.point.place,
        ]
        shift = (body.point.pointing - fit.point.pointing).ravel()
        step = np.concatenate([*step, body.length - fit.length, shift])
        factor, total = second.factor[torso], 0.0
        for share, centre, spread in zip(second.share, second.centre, second.spread, strict=True):
            wide = factor @ spread
            law = stats.multivariate_t(factor @ centre, wide @ wide.T, df=FREEDOM_OF_ROOTS)
            total += share[torso] * law.pdf(step)
        angle = np.linalg.norm(turn)
        total /= (1 - math.cos(angle)) / (4 * math.pi**2 * angle**2)
        total *= np.prod(second.exchange[range(2), steps.exchange[row]])
        wanted.append(math.log(total))
    np.testing.assert_allclose(second.log_density(steps), wanted, rtol=0, atol=1e-8)


def test_refined_proposals_follow_where_bodies_are() -> None:
    """Those of a Gaussian that lies elsewhere and scatters otherwise, as far as so many tell; a
    torso that was hardly tried keeps most of its share."""
    number, rng = 12, np.random.default_rng(3)
    even = np.full((1, 4), 0.25)
    point = WorldPoint(np.arange(4), np.tile(np.eye(3), (4, 1, 1)), *np.zeros((2, 4)), np.zeros(4))
    first = BodyProposal(
        WorldBodies(point, np.zeros((4, 5))),
        np.tile(np.eye(number), (4, 1, 1)),
        even,
        np.zeros((1, number)),
        np.eye(number)[None],
        np.full((2, 6), 1 / 6),
    )
    deviation = np.linspace(0.5, 1.5, number)
    step = 0.7 + deviation * rng.normal(size=(4000, number))
    torso, exchange = rng.integers(0, 3, 4000), np.zeros((4000, 2), int)
    even_share = np.full(4000, 1 / 4000)
    found = first.refined(BodySteps(torso, step, exchange), even_share)
    np.testing.assert_allclose(found.centre[1], 0.7, atol=0.1)
    scatter = found.spread[1] @ found.spread[1].T
    np.testing.assert_allclose(np.sqrt(np.diag(scatter) / WIDER), deviation, rtol=0.1)
    assert found.share[1, 3] < 0.01
    few = first.refined(BodySteps(torso[:8], step[:8], exchange[:8]), np.full(8, 1 / 8))
    assert few.share[1, 3] > 0.05
    assert np.linalg.norm(few.centre[1]) < 0.6 * np.linalg.norm(found.centre[1])
    alone = first.refined(BodySteps(torso[:8], step[:8], exchange[:8]), np.eye(8)[0])
    np.testing.assert_allclose(np.diag(alone.spread[1]), math.sqrt(WIDER * NARROWER), rtol=0.01)


def test_directions_towards_a_place_have_the_density_that_is_said() -> None:
    """Over the sphere it is one in all, and a mean of draws is that by the density, both within
    four standard errors (13 in 100,000). The control draws from the other mode alone."""
    aim = SpatialAim(np.array([40.0, 30.0, 250.0]), np.eye(3), np.array([1e-4, 4e-4, 9e-4]))
    modes, rng = jax.jit(modes_of)(aim, np.zeros(3), 300.0), np.random.default_rng(0)
    normal = rng.standard_normal((200_000, 3))
    even = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    density = 4 * np.pi * np.asarray(jax.vmap(aimed_density, (None, 0))(modes, even))

    def apart(values: np.ndarray, wanted: float) -> float:
        return abs(values.mean() - wanted) / (values.std() / math.sqrt(len(values)))

    assert apart(density, 1.0) < 4
    means = density @ even / len(even)
    which = (rng.random(20_000) >= modes.share[0]).astype(int)
    draw = jax.vmap(draw_direction, (None, 0, 0))
    drawn = np.asarray(draw(modes, which, rng.random((20_000, 2))))
    assert max(map(apart, drawn.T, means)) < 4
    wrong = np.asarray(draw(modes, 0 * which + 1, rng.random((20_000, 2))))
    assert max(map(apart, wrong.T, means)) > 4


def test_pilot_runs_together_are_weighed_by_all_their_proposals(
    refined: tuple[BodyProposal, BodyProposal],
) -> None:
    """A target that is known: a third proposal's density. The weights are its density over the
    mean of both proposals', of bodies as they are; their mean is one within four standard errors
    (6 in 100,000), and they scatter less than each run's by its own proposal."""
    first, second = refined
    target = dataclasses.replace(second, spread=0.8 * second.spread)
    runs = []
    for seed, one in enumerate((first, second)):
        steps = one.draw(np.random.default_rng(seed), 4000)
        level = target.log_density(steps) - one.log_density(steps)
        runs.append((one, SimpleNamespace(steps=steps, log_weight=level)))
    steps, log_weight = pooled(runs)
    both = np.logaddexp(first.log_density(steps), second.log_density(steps)) - math.log(2)
    np.testing.assert_allclose(log_weight, target.log_density(steps) - both, atol=1e-9)
    weight = np.exp(log_weight)
    error = weight.std() / math.sqrt(len(weight))
    assert abs(weight.mean() - 1) < 4 * error
    alone = np.exp(np.concatenate([run.log_weight for _, run in runs]))
    assert weight.std() < 0.9 * alone.std()


def test_looking_ahead_leaves_the_evidence_of_a_chain_as_it_is() -> None:
    """An elbow that is resampled by where the wrist may be, in the plane: the mean of the estimates
    is the integral on a grid, within four standard errors (6 in 100,000). The control does
    not divide by what was multiplied."""
    grid = np.linspace(-4, 4, 2001)
    wanted = np.mean(np.exp(-((grid - 1) ** 2)) * np.exp(-np.abs(grid))) * 8
    rng = np.random.default_rng(0)
    reach = Reach(np.array([3.0, 0.0, 0.0]), np.array(2.0), np.array(0.5))
    elbow, offset = rng.uniform(-4, 4, (400, PER_LIMB)), rng.random(400)
    place_ = np.stack([elbow, 0 * elbow, 0 * elbow], axis=-1)
    ahead = jax.vmap(jax.vmap(reach.log_share))(place_)
    level, rows = map(np.asarray, jax.vmap(_resampled)(-((elbow - 1) ** 2), ahead, offset))
    after = -np.abs(np.take_along_axis(elbow, rows, axis=1))
    right = 8 * np.mean(np.exp(level + after), axis=1)
    kept = np.take_along_axis(np.asarray(ahead), rows, axis=1)
    wrong = 8 * np.mean(np.exp(level + kept + after), axis=1)
    error = np.std(right) / math.sqrt(len(right))
    assert abs(np.mean(right) - wanted) < 4 * error < 0.1 * wanted
    assert abs(np.mean(wrong) - wanted) > 4 * error


# --- what is refused


def test_what_cannot_be_is_refused_in_a_sentence(model: PoseModel) -> None:
    points, _, world = bodies(model, 1, seed=3)
    instant = seen(straight(2), world[0], math.exp(points.log_size[0]), FAULTY, seed=1)
    with pytest.raises(BadInput, match="cameras 1, 3 of a simulation cannot be chosen"):
        instant.seen_by([0, 2])
    with pytest.raises(BadInput, match="2 error laws were given for 1 views"):
        instant.seen_by([0]).judged_by(FAULTY, FAULTY)
    with pytest.raises(BadInput, match="point by 7 degrees beside their calibration"):
        dataclasses.replace(instant, pointing=7.0)
    with pytest.raises(BadInput, match="which way is up"):
        instant.posterior(PoseModel(upright=10.0))
    hidden = instant.views[1].detection
    score = np.where(np.arange(NUM_JOINTS) > 1, 0.0, 0.5)
    keypoints = np.where(score[:, None] > 0, hidden.keypoints, np.nan)
    few = dataclasses.replace(hidden, score=score, keypoints=keypoints)
    views = instant.views[0], dataclasses.replace(instant.views[1], detection=few)
    with pytest.raises(BadInput, match="two cameras see 2 joints of the torso"):
        fitted(Instant("a simulation", views).posterior(model))


# --- the sampler


def test_no_draws_of_several_views_have_keypoints_of_each(model: PoseModel) -> None:
    points, poses, world = bodies(model, 1, seed=3)
    instant = seen(straight(2), world[0], math.exp(points.log_size[0]), FAULTY, seed=1)
    none = jax.tree.map(lambda leaf: np.asarray(leaf)[:0], (points, poses))
    joints, keypoints = place(instant.posterior(model), *none)
    assert (joints.shape, keypoints.shape) == ((0, 15, 3), (0, 2, 15, 2))


@dataclasses.dataclass(frozen=True)
class Run:
    """What is asked of weighed roots."""

    log_weight: np.ndarray
    proposals: int
    steps: None = None

    @property
    def effective(self) -> float:
        return effective(shares(self.log_weight))


@pytest.mark.parametrize(
    ("heavy", "most", "numbers"),
    [(50.0, None, [60, 240]), (0.0, None, [60]), (50.0, 100, [60]), (50.0, 200, [60, 140])],
)
def test_too_few_roots_are_a_pilot_run_for_more(
    heavy: float, most: int | None, numbers: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where one root has all the weight, and where the budget has room; it all counts as spent."""
    asked: list[int] = []

    def weigh(posterior: object, proposal: object, key: object, number: int, *_: object) -> Run:
        asked.append(number)
        alone = heavy if number == 60 else 0.0
        return Run(np.where(np.arange(number) == 0, alone, 0.0), number)

    proposal = SimpleNamespace(refined=lambda steps, share: proposal)
    monkeypatch.setattr(weighted, "fitted", lambda posterior: proposal)
    monkeypatch.setattr(weighted, "pooled", lambda pilots: (None, np.zeros(200)))
    monkeypatch.setattr(weighted, "weigh", weigh)
    found = weigh_refined(SimpleNamespace(), jax.random.key(0), 60, most=most)
    assert asked == [weighted.PILOT_BODIES, *numbers]
    assert len(found.log_weight) == numbers[-1]
    assert found.proposals == sum(asked)


@pytest.mark.parametrize(("weighed", "wanted"), [(120, 40), (600, 100)])
def test_pilot_runs_refine_by_forty_bodies_or_a_sixth_of_all(
    weighed: int, wanted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def tempered(log_weight: np.ndarray, least: float) -> np.ndarray:
        asked.append(least)
        return shares(log_weight)

    proposal = SimpleNamespace(refined=lambda steps, share: proposal)
    monkeypatch.setattr(weighted, "fitted", lambda posterior: proposal)
    monkeypatch.setattr(weighted, "pooled", lambda pilots: (None, np.zeros(weighed)))
    monkeypatch.setattr(weighted, "tempered", tempered)
    monkeypatch.setattr(weighted, "weigh", lambda *given: Run(np.zeros(given[3]), given[3]))
    weigh_refined(SimpleNamespace(), jax.random.key(0), 60)
    assert asked == [pytest.approx(wanted)]


def test_a_body_weighs_by_its_torso_and_the_means_of_its_limbs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As many bodies as two programs take."""
    number, rng = weighted.BODIES_AT_ONCE + 10, np.random.default_rng(0)
    torso, density = rng.normal(size=(2, number))
    limbs = rng.normal(size=(number, 5, PER_LIMB))
    nothing = np.zeros((number, 5, PER_LIMB, 3))

    def weigh_bodies(*given: np.ndarray) -> tuple:
        rows = given[-1]
        return torso[rows], (limbs[rows], nothing[rows], nothing[rows])

    proposal = SimpleNamespace(
        draw=lambda rng, number: SimpleNamespace(exchange=np.arange(number)),
        bodies=lambda steps: SimpleNamespace(
            take=lambda rows: SimpleNamespace(point=(rows,), length=rows)
        ),
        log_density=lambda steps: density,
    )
    monkeypatch.setattr(weighted, "weigh_bodies", weigh_bodies)
    posterior = SimpleNamespace(**dict.fromkeys(("model", "detected", "faults", "root_prior")))
    found = weighted.weigh(posterior, proposal, jax.random.key(0), number).log_weight
    weight = np.exp(torso - density) * np.exp(limbs).mean(axis=-1).prod(axis=-1)
    np.testing.assert_allclose(np.exp(found), weight)


def test_roots_of_one_view_stand_in_the_world_where_it_sees_them() -> None:
    """The pelvis, the size and the way that a body faces, of the last of four cameras."""
    camera, number = straight(4)[3], 6
    rng = np.random.default_rng(0)
    roots = RootPoint(
        np.arange(number),
        stats.special_ortho_group.rvs(3, size=number, random_state=rng),
        rng.normal(4.0, 0.3, number),
        camera.principal + rng.normal(scale=200.0, size=(number, 2)),
    )
    found = weighted._in_the_world(camera, roots, rng)
    np.testing.assert_allclose(camera.project(found.place), roots.translation)
    pixels = camera.focal[0] * np.exp(found.log_size) / camera.view(found.place)[:, 2]
    np.testing.assert_allclose(pixels, np.exp(roots.log_scale))
    np.testing.assert_allclose(camera.rotation @ found.rotation, roots.rotation, atol=1e-12)


def evidence_by_the_prior(posterior, key: int, number: int) -> tuple[float, float]:
    """The evidence by importance sampling with the program's log joint: root and lengths as the
    product proposes them, directions from the prior. Log, and its standard error."""
    model, proposal = posterior.model, fitted(posterior)
    steps = proposal.draw(np.random.default_rng(key), number)
    drawn = proposal.bodies(steps)
    poses = model.draw(jax.random.key(key), number)
    poses = jax.tree.map(np.asarray, poses)
    whole = poses._replace(length=drawn.length)
    from poseterior.probmodel.anatomy.lengths import BoneLength

    inside = np.isfinite(np.asarray(BoneLength(model.lengths).log_prob(drawn.length)))
    directions = np.asarray(model.log_prior(*poses))
    directions = directions - np.asarray(BoneLength(model.lengths).log_prob(poses.length))
    weight = np.asarray(posterior.log_joint(drawn.point, whole)) - directions
    weight = np.where(inside, weight - proposal.log_density(steps), -np.inf)
    share = shares(weight)
    level = np.logaddexp.reduce(weight) - math.log(number)
    return float(level), math.sqrt(float(np.sum(share**2)))


def only(instant: Instant, joints: set[int]) -> Instant:
    """An instant of which some joints alone were detected."""
    views = []
    for view in instant.views:
        score = np.where([joint in joints for joint in range(NUM_JOINTS)], 0.5, 0.0)
        keypoints = np.where(score[:, None] > 0, view.detection.keypoints, np.nan)
        person = dataclasses.replace(view.detection, keypoints=keypoints, score=score)
        views.append(dataclasses.replace(view, detection=person))
    return dataclasses.replace(instant, views=tuple(views))


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("joints", "pointing"),
    [({3}, 0.0), ({3, 4}, 0.0), ({10}, 0.0), ({3, 4}, 2.0)],
    ids=["elbow", "arm", "knee", "arm, cameras that point beside"],
)
def test_the_evidence_is_that_of_another_route(
    model: PoseModel, joints: set[int], pointing: float
) -> None:
    """Of the torso and one limb; both estimates are unbiased, and agree within four standard
    errors (false alarms: 8 in 100,000). The control counts one view twice. (Of a whole leg the
    other route says too little: few of a million of the prior fall where this one is seen.)"""
    law = DetectorErrors(
        Gaussian(), np.full(15, 0.2), np.ones(15), np.zeros((15, 2)), definition=DEFINED
    )
    points, _, world = bodies(model, 1, seed=11)
    simple = Likelihood(Gaussian(), factor=0.4)
    likelihood = Likelihood.of(law) if pointing else simple
    instant = seen(straight(2), world[0], math.exp(points.log_size[0]), simple, seed=2)
    instant = dataclasses.replace(instant, pointing=pointing).judged_by(likelihood)
    posterior = only(instant, {0, 1, 2, 5, 9, 12} | joints).posterior(model)
    wanted, wanted_se = evidence_by_the_prior(posterior, key=5, number=1_500_000)
    roots = weigh_refined(posterior, jax.random.key(1), 6000)
    found, found_se = roots.evidence_of(np.arange(6000))
    error = math.hypot(wanted_se, found_se)
    assert error < 0.15
    assert abs(found - wanted) < 4 * error, (found, wanted, error)
    twice = Instant("twice", (*instant.views, instant.views[1]), pointing)
    control = only(twice, {0, 1, 2, 5, 9, 12} | joints).posterior(model)
    other = weigh_refined(control, jax.random.key(1), 6000).evidence_of(np.arange(6000))[0]
    assert abs(other - wanted) > 4 * error


def ranks(
    model: PoseModel, views: list[Pinhole], number: int, believed: list[Pinhole] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """`(number, 46)`: where true coordinates and sizes lie among draws, from 0 to 1; and effective
    roots `(number,)`. The prior of the place is flat, so draws are weighed anew by where simulated
    bodies are."""
    points, _, world = bodies(model, number, seed=7)
    found, worth = [], []
    for row in range(number):
        size = math.exp(points.log_size[row])
        instant = seen(views, world[row], size, FAULTY, seed=row)
        if believed is not None:
            taken = zip(instant.views, believed, strict=True)
            wrong = [dataclasses.replace(view, camera=camera) for view, camera in taken]
            instant = dataclasses.replace(instant, views=tuple(wrong))
        posterior = instant.posterior(model)
        roots = weigh_refined(posterior, jax.random.key(row), weighted.NUM_BODIES)
        place_ = roots.bodies.point.place
        depth = np.stack([camera.view(place_)[:, 2] for camera in views])
        where = -np.sum((place_ - CENTRE) ** 2, axis=1) / (2 * WANDER**2)
        level = roots.log_weight + where + 3 * np.log(np.maximum(depth, 1)).mean(axis=0)
        roots = dataclasses.replace(roots, log_weight=level)
        worth.append(roots.effective)
        rng = np.random.default_rng(row)
        if not roots.effective:
            found.append(np.full(3 * NUM_JOINTS + 1, np.nan))
            continue
        at, poses, _, _ = roots.draw_whole(rng, 400)
        joints = (
            at.place[:, None] + np.exp(at.log_size)[:, None, None] * place(posterior, at, poses)[0]
        )
        below = (joints < world[row]).mean(axis=0).ravel()
        found.append([*below, (at.log_size < points.log_size[row]).mean()])
    return np.array(found), np.array(worth)


@pytest.mark.sweep
@pytest.mark.parametrize("number", [2, 4])
def test_simulated_bodies_are_covered(model: PoseModel, number: int) -> None:
    """Kolmogorov and Smirnov's test of 46 quantities, the smallest p times 46 above 0.001, which is
    the rate of false alarms. The control believes a camera turned by three degrees."""
    views = straight(number)
    place_of, worth = ranks(model, views, 60)
    enough = worth > 5
    p = [stats.kstest(column, "uniform").pvalue for column in place_of[enough].T]
    inside = ((place_of > 0.025) & (place_of < 0.975))[enough].mean()
    print(f"{number} views: p {min(p) * 46:.3g}, covered {inside:.3f}, effective {worth}")
    assert enough.mean() > 0.8
    assert min(p) * 46 > 0.001
    assert 0.92 < inside < 0.98
    turn = rotations_of(np.array([0.0, math.radians(3), 0.0]))
    off = [dataclasses.replace(views[0], rotation=turn @ views[0].rotation), *views[1:]]
    wrong, worth = ranks(model, views, 20, off)
    wrong = wrong[worth > 0]
    assert min(stats.kstest(column, "uniform").pvalue for column in wrong.T) * 46 < 0.001


@pytest.mark.sweep
def test_the_same_key_gives_the_same_draws_and_faults_are_found(model: PoseModel) -> None:
    """Four views, a wrist moved by half a body unit in one of them."""
    points, _, world = bodies(model, 1, seed=11)
    size = math.exp(points.log_size[0])
    clean = dataclasses.replace(FAULTY, faults=FaultPrior())
    instant = seen(straight(4), world[0], size, clean, seed=2)
    camera = instant.views[1].camera
    keypoints = instant.views[1].detection.keypoints.copy()
    keypoints[4, 0] += 0.5 * camera.focal[0] * size / camera.view(world[0])[4, 2]
    moved = dataclasses.replace(instant.views[1].detection, keypoints=keypoints)
    views = list(instant.views)
    views[1] = dataclasses.replace(views[1], detection=moved)
    posterior = Instant("moved", tuple(views)).judged_by(FAULTY).posterior(model)
    draws = WeightedViews(num_roots=400).draw(posterior, jax.random.key(0), 500)
    again = WeightedViews(num_roots=400).draw(posterior, jax.random.key(0), 500)
    np.testing.assert_array_equal(draws.joints, again.joints)
    outlier = draws.faults.outlier.mean(axis=0)
    assert outlier[1, 4] > 0.95
    assert np.sort(outlier.ravel())[-2] < 0.5
    log_joint = posterior.log_joint(
        *jax.tree.map(lambda leaf: leaf[:8], (draws.points, draws.poses, draws.faults))
    )
    assert np.isfinite(np.asarray(log_joint)).all()


def exchanged(instant: Instant, view: int, what: str) -> Instant:
    """With sides exchanged in one view."""
    views, order = list(instant.views), ORDERS[EXCHANGE_INDEX[what]]
    person = views[view].detection
    turned = dataclasses.replace(person, keypoints=person.keypoints[order])
    views[view] = dataclasses.replace(views[view], detection=turned)
    return dataclasses.replace(instant, views=tuple(views))


@pytest.mark.parametrize("number", [3, 4])
def test_a_view_whose_torso_is_turned_round_is_known_before_a_fit(
    model: PoseModel, number: int
) -> None:
    """In each view of five bodies that stand anyhow, some of them so that hips hide each other: at
    least nine of ten, in no other view, and nobody where nothing is exchanged."""
    points, _, world = bodies(model, 5, seed=3)
    clean = dataclasses.replace(FAULTY, faults=FaultPrior())
    hits = 0
    for row, size in enumerate(np.exp(points.log_size)):
        instant = seen(straight(number), world[row], size, clean, seed=row).judged_by(FAULTY)
        assert not _turned(instant.posterior(model))[0].any()
        for view in range(number):
            found, _ = _turned(exchanged(instant, view, "body").posterior(model))
            assert not np.delete(found, view).any()
            hits += found[view] == EXCHANGE_INDEX["body"]
    assert hits >= 0.9 * 5 * number


@pytest.mark.slow
def test_a_body_is_found_though_one_view_turns_it_round(
    model: PoseModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three cameras. A fit that takes all views as they are is led astray: on this body it
    misses by 30 nats."""
    points, _, world = bodies(model, 6, seed=11)
    clean = dataclasses.replace(FAULTY, faults=FaultPrior())
    instant = seen(straight(3), world[4], math.exp(points.log_size[4]), clean, seed=5)
    posterior = exchanged(instant.judged_by(FAULTY), 1, "body").posterior(model)
    sampler = WeightedViews(num_roots=200)
    draws = sampler.draw(posterior, jax.random.key(0), 200)
    assert draws.status == COMPLETE
    body = draws.faults.exchange == EXCHANGE_INDEX["body"]
    np.testing.assert_array_equal(body.mean(axis=0) > 0.95, [False, True, False])
    far = np.linalg.norm(np.asarray(draws.points.place) - points.place[4], axis=1)
    assert np.median(far) < 150, "mm"
    as_it_is = np.zeros(3, int), roots._triangulated(posterior, np.zeros(3, int))
    monkeypatch.setattr(roots, "_turned", lambda posterior: as_it_is)
    astray = sampler.draw(posterior, jax.random.key(0), 200)
    assert astray.log_evidence < draws.log_evidence - 20
