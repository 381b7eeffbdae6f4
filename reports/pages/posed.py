"""Bodies of the prior before simulated cameras, and where the truth lies among what is drawn from
their views: of posteriors that are right, and of some that have to fail. For reports/cameras.md.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior.inference.draws import place
from poseterior.inference.importance.views.weighted import NUM_BODIES, WeighedRoots, weigh_refined
from poseterior.inference.importance.weighted import FEWEST_EFFECTIVE
from poseterior.inference.studies.calibration.uniformity import uniformity
from poseterior.probmodel import Detection, DetectorErrors, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import ORDERS
from poseterior.probmodel.instant import CameraView, Instant
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.root_priors import MEDIAN_SIZE, SIZE_SD
from poseterior.probmodel.roots import WorldPoint
from poseterior.probmodel.sessions import Pinhole
from poseterior.probmodel.sessions.pinhole import NO_DISTORTION
from poseterior.probmodel.sessions.session import ASSUMED_POINTING
from poseterior.probmodel.skeleton import NUM_JOINTS
from poseterior.reports.pages.page import kept_json
from poseterior.reports.tables import Column, Sheet, sheet_of

POSED, MISPOSED = {2: 100, 4: 80}, 40
"""Bodies by the number of cameras, and those of each wrong posterior, with four."""
POSED_DRAWS, POSED_AT_ONCE = 400, 20
POSED_SCORE, EVERY = 0.8, range(NUM_JOINTS)
AROUND, WANDERING = np.array([0.0, 0.0, 950.0]), 150.0
"""Millimetres: the mean of where bodies are, and the standard deviation."""
FAR_OFF, HIGH_UP = 3500.0, 1700.0
"""Millimetres: how far from there cameras stand, and how high."""
PHONE = np.full(2, 1500.0), np.array([540.0, 960.0])
"""Focal lengths and principal point, pixels."""
ACTION_LENS = (-0.3, 0.1, 0.0, 0.0, 0.0)
TURNED_BY = 3.0
"""Degrees."""


class PosedBody(NamedTuple):
    """A body before cameras: its joints `world` `(15, 3)`, the log of its size, mm, and where the
    `cameras` detect it, `(C, 15, 2)` pixels of images that their lenses distort."""

    world: np.ndarray
    log_size: float
    cameras: tuple[Pinhole, ...]
    pixels: np.ndarray


def camera_turned(camera: Pinhole, axis: str, degrees: float) -> Pinhole:
    """A camera that is turned about one of its own axes."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return dataclasses.replace(camera, rotation=turn @ camera.rotation)


def _turned(body: PosedBody) -> PosedBody:
    first, *others = body.cameras
    return body._replace(cameras=(camera_turned(first, "y", TURNED_BY), *others))


def _undistorted(body: PosedBody) -> PosedBody:
    plain = (dataclasses.replace(one, distortion=NO_DISTORTION) for one in body.cameras)
    return body._replace(cameras=tuple(plain))


def _doubled(body: PosedBody) -> PosedBody:
    return body._replace(cameras=body.cameras * 2, pixels=np.tile(body.pixels, (2, 1, 1)))


MISBELIEVED: dict[str, Callable[[PosedBody], PosedBody]] = {
    f"one camera turned by {TURNED_BY:g}°": _turned,
    "distortion left out": _undistorted,
    "views counted twice": _doubled,
}
"""What posteriors believe that have to fail."""


def circle(number: int) -> tuple[Pinhole, ...]:
    """So many cameras round the person, who look at where bodies are."""
    found = []
    for angle in np.linspace(0.3, 0.3 + 2 * np.pi, number, endpoint=False):
        centre = np.array([FAR_OFF * np.cos(angle), FAR_OFF * np.sin(angle), HIGH_UP])
        away = (AROUND - centre) / np.linalg.norm(AROUND - centre)
        right = np.cross(away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        found.append(
            Pinhole(np.stack([right, np.cross(away, right), away]), centre, *PHONE, ACTION_LENS)
        )
    return tuple(found)


def posed(
    model: PoseModel, likelihood: Likelihood, cameras: tuple[Pinhole, ...], seed: int
) -> PosedBody:
    """A body of the prior, whose place is Gaussian, as these cameras detect it: with errors and
    faults of the likelihood, and images that are shifted by as much as is assumed."""
    rng = np.random.default_rng([len(cameras), seed])
    pose = jax.tree.map(np.asarray, model.draw(jax.random.key(seed), 1))
    torso = np.asarray(model.torsos)[rng.integers(len(model.torsos))]
    turn = Rotation.random(rng=rng).as_matrix()
    log_size = rng.normal(np.log(MEDIAN_SIZE), SIZE_SD)
    joints = np.asarray(model.joints(torso @ turn.T, *(part[0] for part in pose)))
    world = AROUND + WANDERING * rng.standard_normal(3) + np.exp(log_size) * joints
    pixels = [_detected(one, world, log_size, likelihood, rng) for one in cameras]
    return PosedBody(world, float(log_size), cameras, np.stack(pixels))


def _detected(
    camera: Pinhole,
    world: np.ndarray,
    log_size: float,
    likelihood: Likelihood,
    rng: np.random.Generator,
) -> np.ndarray:
    """`(15, 2)` pixels at which a camera detects joints, by the names of keypoints."""
    straight = camera.straight
    prior, seen = likelihood.faults, np.ones(NUM_JOINTS, bool)
    fault = jax.tree.map(np.asarray, prior.draw(seen, jax.random.key(int(rng.integers(2**32)))))
    order = ORDERS[int(fault.exchange)]
    unit = straight.focal[0] * np.exp(log_size) / straight.view(world)[order, 2]
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    blank = Detection(np.zeros((NUM_JOINTS, 2)), np.full(NUM_JOINTS, POSED_SCORE), "", "", 0)
    near = likelihood.spread(blank, 1.0, EVERY) * np.asarray(
        likelihood.law.distance(rng.uniform(size=NUM_JOINTS))
    )
    far = prior.reach * np.sqrt(rng.uniform(size=NUM_JOINTS))
    away = np.where(fault.outlier, far, near)[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)], -1
    )
    bias = np.where(fault.outlier[:, None], 0.0, likelihood.bias)
    shift = straight.focal[0] * np.tan(np.radians(ASSUMED_POINTING)) * rng.standard_normal(2)
    image = straight.project(world)[order] + shift + unit[:, None] * (bias + away)
    ray = np.column_stack([(image - straight.principal) / straight.focal, np.ones(NUM_JOINTS)])
    return camera.project(camera.centre + ray @ camera.rotation)


def instant_of(body: PosedBody, likelihood: Likelihood) -> Instant:
    """What is believed to have been seen."""
    score, views = np.full(NUM_JOINTS, POSED_SCORE), []
    for number, (camera, pixels) in enumerate(zip(body.cameras, body.pixels, strict=True), 1):
        person = Detection(camera.straighten(pixels), score, "simulated", "a simulation", 0)
        views.append(CameraView(f"camera {number}", camera.straight, person, likelihood))
    return Instant("a simulation", tuple(views), ASSUMED_POINTING)


def where_it_is(
    body: PosedBody, model: PoseModel, likelihood: Likelihood, seed: int
) -> list[float]:
    """Effective roots, and where coordinates and log size lie among the draws, from 0 to 1: `46`
    levels, uniform if the posterior is right. Draws count for as many as there are such roots."""
    posterior = instant_of(body, likelihood).posterior(model)
    roots = weigh_refined(posterior, jax.random.key(seed), NUM_BODIES)
    roots = _where_bodies_are(roots, body.cameras)
    rng = np.random.default_rng(seed)
    points, poses, _, _ = roots.draw_whole(rng, POSED_DRAWS)
    if not len(points.log_size):
        return [0.0, *[np.nan] * (3 * NUM_JOINTS + 1)]
    return [roots.effective, *_levels(roots, points, poses, body, rng).tolist()]


def _levels(
    roots: WeighedRoots, points: WorldPoint, poses: Pose, body: PosedBody, rng: np.random.Generator
) -> np.ndarray:
    size = np.exp(points.log_size)[:, None, None]
    world = points.place[:, None] + size * place(roots.posterior, points, poses)[0]
    drawn = np.column_stack([world.reshape(len(world), -1), points.log_size])
    below = (drawn < [*body.world.ravel(), body.log_size]).mean(axis=0)
    return (roots.effective * below + rng.uniform(size=len(below))) / (roots.effective + 1)


def _where_bodies_are(roots: WeighedRoots, cameras: tuple[Pinhole, ...]) -> WeighedRoots:
    """The prior's places are flat in the images: roots weighed anew by where bodies are."""
    found = roots.bodies.point.place
    depth = np.stack([one.view(found)[:, 2] for one in cameras])
    level = stats.norm.logpdf(found, AROUND, WANDERING).sum(axis=1)
    flat = -3 * np.log(np.maximum(depth, 1.0)).mean(axis=0)
    return dataclasses.replace(roots, log_weight=roots.log_weight + level - flat)


def some_levels(number: int, first: int, belief: str) -> list[list[float]]:
    """Of so many cameras the bodies from `first` on."""
    model, likelihood = PoseModel(), Likelihood.of(DetectorErrors.default())
    cameras, believe = circle(number), MISBELIEVED.get(belief, lambda body: body)
    seeds = range(first, first + POSED_AT_ONCE)
    every = [believe(posed(model, likelihood, cameras, seed)) for seed in seeds]
    return [
        where_it_is(body, model, likelihood, seed) for body, seed in zip(every, seeds, strict=True)
    ]


def levels_of(work: Path, number: int, bodies: int, belief: str) -> np.ndarray:
    """`(bodies, 47)`: `where_it_is`, from the files of a folder; what is not there yet is drawn."""
    name = f"posed-{number}-{belief.replace(' ', '-').replace('°', '')}"
    blocks = [
        kept_json(work / f"{name}-{first:04}.json", some_levels, number, first, belief)
        for first in range(0, bodies, POSED_AT_ONCE)
    ]
    return np.concatenate([np.array(block, float) for block in blocks])


def posed_table(work: Path) -> Sheet:
    """How often posteriors hold simulated bodies, by cameras, and how often wrong ones do."""
    right = "what is so"
    cases = [(number, bodies, right) for number, bodies in POSED.items()]
    cases += [(4, MISPOSED, belief) for belief in MISBELIEVED]
    rows = []
    for number, bodies, belief in cases:
        found = levels_of(work, number, bodies, belief)
        enough = found[:, 0] >= FEWEST_EFFECTIVE
        level = found[enough, 1:]
        inside = [np.abs(level - 0.5) < within / 2 for within in (0.5, 0.95)]
        errors = [1.96 * part.mean(axis=1).std() / np.sqrt(len(part)) for part in inside]
        share = [
            f"{100 * part.mean():.1f} ± {100 * error:.1f}"
            for part, error in zip(inside, errors, strict=True)
        ]
        p_value = min(1.0, level.shape[1] * min(uniformity(one).p_value for one in level.T))
        cells = [f"{bodies:,}", str(np.count_nonzero(~enough)), *share, f"{p_value:.2g}"]
        rows.append([str(number), belief, *cells])
    head = ["bodies", "too few roots", "50 %", "95 %", "smallest p of 46, times 46"]
    return sheet_of([Column("cameras"), Column("believed", left=True), *map(Column, head)], rows)
