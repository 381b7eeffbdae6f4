"""Zhou's relaxation: its proximal map, its optimum against a general convex solver, what its
iterations must do, and the poses that come of it."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from poseterior.inference.estimators import zhou
from poseterior.inference.estimators.points import Points
from poseterior.inference.studies.errors import mean_joint_error, similarity_aligned
from poseterior.probmodel import BadInput, Detection
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS, NUM_JOINTS
from tests.scenes import camera
from tests.sweeps import sweep

DICTIONARY = PoseDictionary.default()
VIEWS = [(yaw, tilt) for yaw in (0, 60, 135, 250) for tilt in (-10, 20)]


def detection(
    pose: np.ndarray, missing: tuple[int, ...] = (), score: float | np.ndarray = 0.8
) -> Detection:
    """A pose `(15, 3)` in camera axes, at 100 pixels a body unit, with one score or one each."""
    scores = np.full(NUM_JOINTS, score)
    scores[list(missing)] = 0
    return Detection(
        np.where(scores[:, None] > 0, pose[:, :2] * 100 + 300, np.nan),
        scores,
        "synthetic",
        "a pose",
        0,
    )


def seen(pose: np.ndarray, yaw: float, tilt: float) -> np.ndarray:
    return np.asarray(camera(yaw, tilt).view(pose))


def problems(number: int, *, missing: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points `(number, 15, 2)` of noisy poses and weights `(number, 15)` with `missing` zeros
    each."""
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0, 1, (number, len(DICTIONARY.atoms))) * (
        rng.uniform(size=(number, 128)) < 0.05
    )
    poses = DICTIONARY.mean + np.einsum("nk,kja->nja", weights, DICTIONARY.atoms)
    turned = poses @ Rotation.random(number, rng=rng).as_matrix().swapaxes(1, 2)
    xy = turned[..., :2] + rng.normal(size=(number, NUM_JOINTS, 2)) * 0.05
    weight = rng.uniform(0.5, 1.5, (number, NUM_JOINTS))
    for row in weight:
        row[rng.choice(NUM_JOINTS, missing, replace=False)] = 0
    return xy - xy.mean(axis=1, keepdims=True), weight


# --- the proximal map


def shrunk_by_svd(blocks: np.ndarray, amount: float) -> np.ndarray:
    """The proximal map by its definition: singular values less their projection onto the ℓ1 ball
    (Moreau)."""
    u, size, vt = np.linalg.svd(blocks, full_matrices=False)
    large, small = size[:, 0], size[:, 1]
    level = np.where(large - small >= amount, amount, (large + small + amount) / 2 - small)
    ball = np.where(
        (large + small <= amount)[:, None], size, np.stack([level, amount - level], axis=1)
    )
    return (u * (size - ball)[:, None]) @ vt


def test_shrinking_is_the_proximal_map_of_the_spectral_norm():
    rng = np.random.default_rng(0)
    blocks = rng.normal(size=(500, 2, 3)) * rng.uniform(0, 3, (500, 1, 1))
    blocks[:20, 1] = 2 * blocks[:20, 0]  # rank one
    blocks[20:40] = Rotation.random(20, rng=rng).as_matrix()[:, :2] * rng.uniform(
        0.1, 2, (20, 1, 1)
    )  # equal values
    blocks[40] = 0
    for amount in (0.01, 0.3, 1.0, 5.0):
        found = zhou.shrink_spectral(blocks, np.full(500, amount))
        assert found == pytest.approx(shrunk_by_svd(blocks, amount), abs=1e-10)


def test_what_was_shrunk_is_least():
    """½|M' − M|² + a |M'|₂ is larger at a thousand places around, and at the nuclear norm's map (a
    control)."""
    rng = np.random.default_rng(1)
    block, amount = rng.normal(size=(2, 3)), 0.7
    found = zhou.shrink_spectral(block, np.array(amount))

    def cost(other: np.ndarray) -> np.ndarray:
        return np.sum((other - block) ** 2, axis=(-2, -1)) / 2 + amount * np.linalg.norm(
            other, ord=2, axis=(-2, -1)
        )

    around = found + rng.normal(size=(1000, 2, 3)) * np.geomspace(1e-4, 1, 1000)[:, None, None]
    assert (cost(around) >= cost(found)).all()
    u, size, vt = np.linalg.svd(block, full_matrices=False)
    assert cost((u * np.maximum(size - amount, 0)) @ vt) > cost(found) + 1e-3


# --- the optimum

FEW = DICTIONARY.atoms[::8]
PENALTY = 0.2


def by_cvxpy(xy: np.ndarray, weight: np.ndarray, threshold: float = np.inf) -> float:
    """The least objective by a general solver, in the words of the paper: M_i, T and, where robust,
    E."""
    import cvxpy

    blocks = [cvxpy.Variable((2, 3)) for _ in FEW]
    shift, error = cvxpy.Variable((2, 1)), cvxpy.Variable((2, NUM_JOINTS))
    left = (
        xy.T
        - sum(block @ atom.T for block, atom in zip(blocks, FEW, strict=True))
        - shift @ np.ones((1, NUM_JOINTS))
    )
    robust = np.isfinite(threshold)
    cost = 0.5 * cvxpy.sum_squares((left - error if robust else left) @ np.diag(np.sqrt(weight)))
    if robust:
        cost += threshold * cvxpy.sum(cvxpy.abs(error) @ np.diag(weight))
    cost += PENALTY * sum(cvxpy.sigma_max(block) for block in blocks)
    return float(cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver="CLARABEL"))


@pytest.mark.filterwarnings(
    "ignore:Solution may be inaccurate"
)  # how accurate it is, the comparison says
@pytest.mark.parametrize(
    ("missing", "threshold"), sweep([(0, np.inf), (2, np.inf), (1, 0.15)], [(0, np.inf)])
)
def test_the_optimum_is_that_of_a_general_convex_solver(missing, threshold):
    """Ten problems with every joint, ten with two missing, and the robust variant: to 1e-4 of the
    objective."""
    number = 10 if np.isinf(threshold) else 4
    xy, weight = problems(number, missing=missing, seed=missing)
    ours = zhou.relax(
        xy, weight, FEW, penalty=PENALTY, threshold=threshold, tolerance=1e-7, max_iterations=20_000
    )
    assert ours.converged.all()
    theirs = [
        by_cvxpy(points, weights, threshold) for points, weights in zip(xy, weight, strict=True)
    ]
    assert ours.objective == pytest.approx(theirs, rel=1e-4)
    # A control: the tolerance is narrow enough to tell λ from 1.01 λ.
    other = zhou.relax(xy, weight, FEW, penalty=1.01 * PENALTY, threshold=threshold, tolerance=1e-6)
    assert (np.abs(other.objective / theirs - 1) > 1e-4).all()


def huber_by_hand(error: float, weight: float, threshold: float) -> float:
    """The least ½ α (r − e)² + κ α |e| over e, on a fine grid."""
    taken = np.linspace(-3, 3, 60_001)
    return float(np.min(weight * ((error - taken) ** 2 / 2 + threshold * np.abs(taken))))


def test_the_robust_loss_is_what_the_best_error_leaves():
    """Without blocks the objective is the loss of the points themselves; and ADMM's step onto the
    points is least in loss and distance, by a grid. Weights are not one."""
    xy, weight = problems(2, missing=1, seed=8)
    robust = zhou.ConvexProblem.build(xy, weight, FEW, PENALTY, 0.15)
    splitting = zhou.Splitting(robust)
    nothing = splitting.start(PENALTY)
    by_hand = [
        sum(huber_by_hand(x, w, 0.15) for joint, w in zip(*row, strict=True) for x in joint)
        for row in zip(xy, weight, strict=True)
    ]
    found = robust.objective(nothing.blocks, np.zeros((2, 2)))
    assert found == pytest.approx(by_hand, rel=1e-4)
    away = np.random.default_rng(1).normal(size=(2, 2, NUM_JOINTS)) * 0.5
    _, points = splitting.shrink(nothing._replace(points=robust.xy + away))
    places = np.linspace(-2, 2, 4001)
    for index in np.ndindex(2, 2, NUM_JOINTS):
        alpha = weight[index[0], index[2]]
        loss = np.where(np.abs(places) > 0.15, 0.15 * (np.abs(places) - 0.075), places**2 / 2)
        pull = PENALTY * zhou.GRAPH * (places - away[index]) ** 2 / 2
        wanted = places[np.argmin(alpha * loss + pull)]
        assert points[index] - robust.xy[index] == pytest.approx(wanted, abs=2e-3)


def test_wild_points_are_heeded_as_hubers_loss_pulls():
    """Nothing explained: a point four thresholds away keeps a quarter of its weight, one within the
    threshold all of it."""
    points = Points.gather([detection(seen(DICTIONARY.mean, 40, 10))])
    nothing = zhou.Relaxed(
        np.zeros((1, len(FEW), 2, 3)), np.zeros((1, 2)), np.zeros(1), np.ones(1), np.ones(1, bool)
    )
    far = np.linalg.norm(points.xy[0], axis=1)
    threshold = far.max() / 4
    found = zhou.heeded(points, nothing, FEW, threshold).weight[0] / points.weight[0]
    assert found[far.argmax()] == pytest.approx(0.25)
    assert (found[far < threshold] == 1).all()
    assert (found[far > threshold] < 1).all()


def test_refinement_ends_where_its_own_objective_is_least():
    """SciPy's minimiser, started there, finds nothing that is lower by 2 %."""
    pose = seen(DICTIONARY.mean + 0.5 * DICTIONARY.bases[2], 40, 10)
    points = Points.gather([detection(pose)])
    rotation, coefficient = zhou.rounded(
        zhou.relax(points.xy, points.weight, DICTIONARY.atoms, penalty=PENALTY).blocks
    )
    support = np.argsort(-coefficient, axis=1)[:, :4]
    terms, start = DICTIONARY.atoms[support], np.take_along_axis(coefficient, support, 1)
    fit = zhou.refine(points, terms, rotation, start, penalty=PENALTY)

    def cost(x: np.ndarray) -> float:
        turn = Rotation.from_rotvec(x[:3]).as_matrix() @ fit.rotation[0]
        image = np.einsum("k,kja->ja", x[5:], terms[0]) @ turn[:2].T + x[3:5]
        square = np.sum((points.xy[0] - image) ** 2, axis=1)
        return float(points.weight[0] @ square / 2 + PENALTY * np.abs(x[5:]).sum())

    there = np.concatenate([np.zeros(5), fit.coefficient[0]])
    image = np.einsum("k,kja->ja", there[5:], terms[0]) @ fit.rotation[0, :2].T
    there[3:5] = np.average(points.xy[0] - image, axis=0, weights=points.weight[0])
    assert cost(there) == pytest.approx(fit.objective[0], rel=1e-6)
    least = minimize(cost, there, method="Powell").fun
    assert least > 0.98 * cost(there)


@pytest.mark.slow
def test_the_tolerance_in_use_is_near_the_optimum():
    xy, weight = problems(32, missing=1, seed=5)
    exact = zhou.relax(xy, weight, DICTIONARY.atoms, tolerance=1e-6, max_iterations=20_000)
    quick = zhou.relax(xy, weight, DICTIONARY.atoms)
    assert quick.converged.all()
    assert quick.objective == pytest.approx(exact.objective, rel=1e-2)
    assert np.median(quick.objective / exact.objective - 1) < 1e-3


def test_a_missing_joint_says_nothing():
    """Whatever stands where a joint is missing, the optimum is the same to the last bit."""
    xy, weight = problems(6, missing=3, seed=2)
    other = np.where(weight[..., None] > 0, xy, 77.0)
    one, two = (
        zhou.relax(points, weight, FEW, penalty=PENALTY, tolerance=1e-6) for points in (xy, other)
    )
    assert one.objective == pytest.approx(two.objective, rel=1e-4)


def test_frames_do_not_depend_on_their_batch():
    xy, weight = problems(5, missing=1, seed=3)
    whole = zhou.relax(xy, weight, FEW)
    for row in range(5):
        alone = zhou.relax(xy[row : row + 1], weight[row : row + 1], FEW)
        assert alone.blocks[0] == pytest.approx(whole.blocks[row], abs=1e-9)
        assert alone.iterations[0] == whole.iterations[row]


# --- iterations


@pytest.mark.parametrize("threshold", sweep([np.inf, 0.15], [0.15]))
def test_the_distance_to_the_fixed_point_never_rises(threshold):
    """ADMM's objective may rise, but with a fixed step its state comes nearer to its limit with
    every iteration."""
    xy, weight = problems(6, missing=1, seed=4)
    splitting = zhou.Splitting(zhou.ConvexProblem.build(xy, weight, FEW, PENALTY, threshold))
    state = splitting.start(PENALTY)
    path = [state]
    for _ in range(4000):
        state = splitting.advance(state)[0]
        path.append(state)
    limit = path[-1]
    distance = np.stack(
        [zhou._size(s.blocks - limit.blocks, s.points - limit.points) for s in path[:1000]]
    )
    assert (np.diff(distance, axis=0) <= 1e-9).all()
    assert (distance[-1] < 0.1 * distance[0]).all()


def test_refinement_never_raises_its_objective():
    poses = [
        seen(DICTIONARY.mean + 0.7 * DICTIONARY.bases[i], *view) for i, view in enumerate(VIEWS)
    ]
    points = Points.gather([detection(pose, missing=(4, 10)) for pose in poses])
    rotation, coefficient = zhou.rounded(
        zhou.relax(points.xy, points.weight, DICTIONARY.atoms).blocks
    )
    support = np.argsort(-coefficient, axis=1)[:, : zhou.SUPPORT]
    start = np.take_along_axis(coefficient, support, 1)
    steps = [
        zhou.refine(points, DICTIONARY.atoms[support], rotation, start, rounds=n).objective
        for n in range(1, 8)
    ]
    assert (np.diff(steps, axis=0) <= 1e-12).all()
    assert (steps[-1] < steps[0]).any()


def test_rounding_finds_a_product():
    rng = np.random.default_rng(7)
    rotation = Rotation.random(5, rng=rng).as_matrix()
    coefficient = rng.uniform(0, 1, (5, 9)) * (rng.uniform(size=(5, 9)) < 0.6)
    turned, found = zhou.rounded(coefficient[..., None, None] * rotation[:, None, :2])
    assert turned == pytest.approx(rotation, abs=1e-9)
    assert found == pytest.approx(coefficient, abs=1e-9)


# --- poses


def relative_error(candidate: object, pose: np.ndarray) -> float:
    """Of pose and scale together: pixels against pixels."""
    found, true = candidate.pose * float(candidate.camera.scale), 100 * (pose - pose[0])
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


@pytest.mark.parametrize("dictionary", sweep(["embedded", "incoherent"], ["incoherent"]))
def test_a_pose_in_the_span_is_recovered(dictionary):
    """Noise-free, nearly without a penalty: one atom of the embedded dictionary; two of an
    incoherent one (random)."""
    rng = np.random.default_rng(11)
    atoms, terms = DICTIONARY.atoms, 1
    if dictionary == "incoherent":
        atoms = rng.normal(size=(40, NUM_JOINTS, 3))
        atoms, terms = atoms / np.linalg.norm(atoms, axis=(1, 2), keepdims=True), 2
    poses = []
    for view in VIEWS:
        chosen = rng.choice(len(atoms), terms, replace=False)
        pose = np.einsum("k,kja->ja", rng.uniform(2, 4, terms), atoms[chosen])
        poses.append(seen(pose, *view))
    own = dataclasses.replace(DICTIONARY, atoms=atoms)
    fits = zhou.fit_zhou(
        [detection(p) for p in poses], own, penalty=1e-4, tolerance=1e-5, max_iterations=5000
    )
    for (best, *_), pose in zip(fits, poses, strict=True):
        assert relative_error(best, pose) < 1e-3
        assert best.reprojection_error < 0.1
        turned = np.asarray(best.camera.rotation) @ best.torso.T * float(best.camera.scale)
        assert pytest.approx(100 * (pose - pose[0])[[0, 1, 2, 5, 9, 12]], abs=0.3) == turned.T


def test_a_turned_image_gives_a_turned_pose():
    """By 30° and 60° in the image plane: the aligned error changes by less than 1 %, pose by
    pose."""
    rng = np.random.default_rng(2)
    truths = [
        seen(DICTIONARY.mean + DICTIONARY.bases[3 * i] * 0.8, *view) for i, view in enumerate(VIEWS)
    ]
    noise = rng.normal(size=(len(truths), NUM_JOINTS, 3)) * 0.05
    errors = []
    for angle in (0, 30, 60):
        turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        fits = zhou.fit_zhou(
            [detection((truth + n) @ turn.T) for truth, n in zip(truths, noise, strict=True)],
            DICTIONARY,
        )
        errors.append(
            [mean_joint_error(fit[0].pose, truth) for fit, truth in zip(fits, truths, strict=True)]
        )
    assert errors[1] == pytest.approx(errors[0], rel=0.01)
    assert errors[2] == pytest.approx(errors[0], rel=0.01)


def test_the_robust_variant_heeds_a_wild_joint_less():
    """One wrist 2.5 body units away: robust, the pose of the other joints suffers less, over eight
    views."""
    suffered = np.zeros(2)
    for index, view in enumerate(VIEWS):
        pose = seen(DICTIONARY.mean + 0.5 * DICTIONARY.bases[index], *view)
        wild = pose.copy()
        wild[JOINT_INDEX["right_wrist"]] += [2.5, 0.0, 0.0]
        plain, robust = (
            zhou.fit_zhou([detection(wild)], DICTIONARY, threshold=kappa)[0][0]
            for kappa in (np.inf, 0.1)
        )
        rest = [joint for joint in range(NUM_JOINTS) if joint != JOINT_INDEX["right_wrist"]]
        suffered += [
            np.linalg.norm(
                similarity_aligned(fit.pose[rest], pose[rest]) - pose[rest], axis=1
            ).mean()
            for fit in (plain, robust)
        ]
    assert suffered[1] < 0.7 * suffered[0]


def test_limbs_that_are_missing_cost_little_where_the_rest_is_exact():
    """A pose of few atoms with one limb joint missing, each in its turn: the error stays below a
    fifth of a limb."""
    pose = seen(2 * DICTIONARY.atoms[5] + DICTIONARY.mean, 40, 10)
    detections = [detection(pose, missing=(joint,)) for joint in LIMB_JOINTS]
    errors = [mean_joint_error(fit[0].pose, pose) for fit in zhou.fit_zhou(detections, DICTIONARY)]
    assert np.mean(errors) < 0.2


@pytest.mark.slow
def test_the_penalty_at_which_nothing_is_left():
    """Just above it the optimum is nothing, just below it is not."""
    points = Points.gather([detection(seen(DICTIONARY.mean, 40, 10))])
    edge = float(zhou.vanishing_penalty(points, FEW)[0])
    above, below = (
        zhou.relax(
            points.xy,
            points.weight,
            FEW,
            penalty=share * edge,
            tolerance=1e-6,
            max_iterations=20_000,
        )
        for share in (1.05, 0.9)
    )
    assert np.linalg.norm(above.blocks) < 1e-3
    assert np.linalg.norm(below.blocks) > 0.05


def test_what_did_not_converge_says_so_and_is_there():
    pose = seen(DICTIONARY.mean + 0.5 * DICTIONARY.bases[2], 40, 10)
    fit = zhou.fit_zhou([detection(pose)], DICTIONARY, max_iterations=3)[0]
    assert not fit[0].converged
    assert fit[0].iterations == 3
    assert np.isfinite(fit[0].pose).all()
    assert zhou.fit_zhou([detection(pose)], DICTIONARY)[0][0].converged


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"penalty": 1e3}, "leaves a pose of scale zero for person 0"),
        ({"penalty": 0.0}, "penalty must be positive"),
        ({"threshold": float("nan")}, "threshold must be positive"),
    ],
)
def test_settings_that_leave_nothing_are_refused(settings, match):
    with pytest.raises(BadInput, match=match):
        zhou.fit_zhou([detection(seen(DICTIONARY.mean, 0, 0))], DICTIONARY, **settings)
