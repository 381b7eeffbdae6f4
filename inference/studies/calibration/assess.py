"""One instance: where its truth stands among the draws of its posterior, and how sharp that
posterior is."""

from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.draws import COMPLETE
from poseterior.inference.studies.calibration.quantities import (
    ENERGY_BALL,
    MOVING,
    OF_MODEL,
    OF_POSE,
    OF_ROOT,
    QUANTITIES,
    TARP,
    of_both,
    of_pose,
    of_root,
    of_rooted,
)
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.inference.studies.levels import (
    distance_level,
    energy_level,
    median_levels,
    rank_level,
    stand_in_levels,
)
from poseterior.inference.studies.measured import MeasureStandings, no_standings, standings_of
from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.camera import Perspective
from poseterior.probmodel.datasets.cases import strays
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.roots import Candidate, RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS

FAILED = "failed"
FEWEST_DRAWS = 9
"""Independent draws below which an instance counts as failed: the ranks would say next to
nothing."""


ECE_STAND_INS = 10
"""Draws of each posterior that stand in for the truth, to see what a right posterior would look
like."""


class Answer(NamedTuple):
    """What a sampler says of an instance: independent draws `joints` `(n, 15, 3)` in camera axes
    and body units, the log evidence or NaN; `status` as in `inference.results`, and where it is not
    complete a `sentence` that says why; the roots `points` `(n, ...)` of the draws where these are
    uncertain."""

    joints: np.ndarray
    log_evidence: float = np.nan
    status: str = COMPLETE
    sentence: str = ""
    points: RootPoint | None = None


_UNKNOWN = np.full(len(MOVING), np.nan)
"""What is said of the joints that move, where nothing can be."""


class Standing(NamedTuple):
    """The truth of one instance among its draws.

    `level` `(len(QUANTITIES),)`: uniform if the posterior is right; NaN where a quantity was not
    looked at. `whole`, `lateral`, `depth` `(9,)`: share of draws nearer to the draws' median than
    the truth is, by joint that moves, over all axes, in the image plane, in depth; `stand_in` `(10,
    9)`: as `whole`, of draws. `spread_lateral`, `spread_depth` `(9,)`: standard deviations of the
    draws, body units. `measures`: of joint angles, lengths and steps, lengths in body units.
    `nearest_limit`: degrees from the bone that is nearest to a limit of its own to that limit, the
    median over draws and truth together, which therefore says nothing of which is the truth. NaN
    throughout, and by default, where `status` is "failed" or the sampler's own word for it: the
    posterior brought too few draws.
    """

    status: str
    sentence: str
    num_draws: int = 0
    log_evidence: float = np.nan
    nearest_limit: float = np.nan
    level: np.ndarray = np.full(len(QUANTITIES), np.nan)
    whole: np.ndarray = _UNKNOWN
    lateral: np.ndarray = _UNKNOWN
    depth: np.ndarray = _UNKNOWN
    stand_in: np.ndarray = np.full((ECE_STAND_INS, len(MOVING)), np.nan)
    spread_lateral: np.ndarray = _UNKNOWN
    spread_depth: np.ndarray = _UNKNOWN
    measures: MeasureStandings = no_standings()


def assess(
    instance: Instance,
    posterior: Answer,
    rng: np.random.Generator,
    *,
    model: PoseModel | None = None,
    reference: np.ndarray | None = None,
    limits: AnatomicalLimits | None = None,
) -> Standing:
    """Ranks the truth among the draws in every way; a truth that errs among draws with such errors.

    Parameters
    ----------
    model
        Where the frame has one candidate, the true one: to rank by log density and misfit too, and
        by numbers of the root where the draws have one each.
    reference
        A pose `(15, 3)` that depends on what was seen alone: to rank by the distance from it too.
    limits
        To say how near the draws are to one of these.

    Raises
    ------
    BadInput
        On draws of other dimensions, or not finite.
    """
    draws = check_draws(posterior.joints, instance.frame.detection.where)
    if len(draws) < FEWEST_DRAWS:
        status = FAILED if posterior.status == COMPLETE else posterior.status
        said = (
            posterior.sentence
            or f"{len(draws)} independent draws, at least {FEWEST_DRAWS} are needed"
        )
        return Standing(status, said, len(draws), posterior.log_evidence)
    level = dict.fromkeys(QUANTITIES, np.nan)
    both = np.concatenate([instance.joints[None], draws])
    seen = both.copy()  # as the truth is known: with its errors
    seen[1:] += strays(instance.doubt, rng, len(draws))
    values = of_pose(seen)
    level.update(zip(OF_POSE, rank_level(values[0], values[1:], rng), strict=True))
    if model is not None and posterior.points is None:
        values = of_both(model, instance.frame.observation, both)
        level.update(zip(OF_MODEL, rank_level(values[0], values[1:], rng), strict=True))
    elif model is not None and posterior.points is not None:
        points = _with_truth(instance.frame.best, posterior.points, model)
        values = of_rooted(instance.frame.posterior(model), points, both)
        level.update(zip(OF_MODEL, rank_level(values[0], values[1:], rng), strict=True))
        values = of_root(points)
        level.update(zip(OF_ROOT, rank_level(values[0], values[1:], rng), strict=True))
    moving = seen[:, MOVING]
    flat = moving.reshape(len(moving), -1)
    level[ENERGY_BALL] = energy_level(flat[0], flat[1:], rng)
    if reference is not None:
        level[TARP] = distance_level(flat[0], flat[1:], reference[list(MOVING)].ravel(), rng)
    truth = moving[0]
    cloud = moving[1:]
    spread = draws[:, MOVING].std(axis=0)
    stand_in = stand_in_levels(cloud, rng.integers(0, len(cloud), ECE_STAND_INS))
    return Standing(
        status=posterior.status,
        sentence=posterior.sentence,
        num_draws=len(draws),
        log_evidence=posterior.log_evidence,
        nearest_limit=np.nan if limits is None else _nearest(limits, seen),
        level=np.array([*level.values()]),
        whole=median_levels(truth, cloud),
        lateral=median_levels(truth[:, :2], cloud[..., :2]),
        depth=median_levels(truth[:, 2:], cloud[..., 2:]),
        stand_in=stand_in,
        spread_lateral=np.sqrt(np.mean(spread[:, :2] ** 2, axis=1)),
        spread_depth=spread[:, 2],
        measures=standings_of(seen[0], seen[1:], draws, rng),
    )


def _nearest(limits: AnatomicalLimits, joints: np.ndarray) -> float:
    """Degrees, of poses `(n, 15, 3)` as `Standing.nearest_limit` has them."""
    return float(np.median(np.nanmin(limits.margin(joints), axis=1)))


def _with_truth(candidate: Candidate, points: RootPoint, model: PoseModel) -> RootPoint:
    """The true root before those of the draws."""
    camera, lens = candidate.camera, None
    log_scale = np.log(float(camera.scale))
    if points.lens is not None:
        assert isinstance(camera, Perspective)
        assert model.lens is not None
        lens = int(np.argmin(np.abs(np.asarray(model.lens.focal) - camera.lens.focal)))
    truth = RootPoint(candidate.torso_index, camera.rotation, log_scale, camera.translation, lens)
    return jax.tree.map(
        lambda one, rest: np.concatenate([np.asarray(one)[None], rest]), truth, points
    )


def check_draws(joints: np.ndarray, where: str) -> np.ndarray:
    """The draws `(n, 15, 3)` as numbers. Raises `BadInput` on another shape, and on numbers that
    are not finite."""
    joints = np.asarray(joints, float)
    if joints.ndim != 3 or joints.shape[1:] != (NUM_JOINTS, 3):
        raise BadInput(
            f"the draws for {where} have shape {joints.shape}; they need (draws, {NUM_JOINTS}, 3)"
        )
    if not np.isfinite(joints).all():
        raise BadInput(
            f"the draws for {where} hold numbers that are not finite; drop those draws, or run anew"
        )
    return joints
