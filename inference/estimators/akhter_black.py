"""Akhter & Black (2015): 3D pose from 2D joints by matching pursuit over an overcomplete dictionary
of poses.

    min over ω, s, R, t of  C_r + C_p + β C_l
    C_r = Σ α_i |x̂_i − s R₂ X_i − t|²,   X = μ + Σ ω_k B_k

C_r weighs with the scores α, zero where a joint is missing (eqs. 1 and 4 of Jahangiri & Yuille
2017). C_p counts the bones that break a joint limit; C_l = Σ (|bone|² − l²)², with the bone lengths
l of the dictionary. The camera comes from the torso first, from both of its mirror twins; then
terms are added one by one, of those that correlate best with what is left the one that helps most,
and after each pose and camera are adjusted together. The objective never rises."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.inference.estimators.adjustment import Penalty, adjust, centred, mirror_twin
from poseterior.inference.estimators.points import Points, require_camera
from poseterior.inference.estimators.twins import Outcome, candidates_both_ways
from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.body import bone_vectors
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.roots import Candidate

BONES_WEIGHT = 1.0
"""β of C_l, for image points of size one (`Points`)."""
LIMIT_WEIGHT = 0.05
"""What each bone that breaks a limit costs (C_p)."""
MOST_TERMS = 10
TRIED = 8
"""Terms that are tried at each step: those that correlate best with what is left."""
LEAST_GAIN = 0.05
"""Share of the objective that a further term must gain."""
SETTLED = 1e-4
"""Share of its objective that the last step of an adjustment may still gain where it counts as
converged."""
EXPLAINED = 1e-8
"""Where the objective is below this nothing is left to explain."""


class PursuitFit(NamedTuple):
    """A batch of fits: `terms` `(n, k)` (indices into `PursuitProblem.shapes`; 0 is the mean pose,
    again where a fit has fewer terms), `coefficient` `(n, k)` (zero there), `rotation` `(n, 3,
    3)`, and `(n,)` each `objective`, `converged`."""

    terms: np.ndarray
    coefficient: np.ndarray
    rotation: np.ndarray
    objective: np.ndarray
    converged: np.ndarray

    def take(self, rows: np.ndarray) -> "PursuitFit":
        """Some of the fits."""
        return PursuitFit(*(part[rows] for part in self))

    def padded(self) -> "PursuitFit":
        """With room for one more term."""
        return self._replace(
            terms=np.pad(self.terms, ((0, 0), (0, 1))),
            coefficient=np.pad(self.coefficient, ((0, 0), (0, 1))),
        )

    def where(self, chosen: np.ndarray, other: "PursuitFit") -> "PursuitFit":
        """These fits where `chosen` `(n,)`, the other ones elsewhere."""
        pairs = zip(self, other, strict=True)
        return PursuitFit(
            *(np.where(chosen.reshape(-1, *[1] * (one.ndim - 1)), one, two) for one, two in pairs)
        )


class PursuitProblem(NamedTuple):
    """What all fits of a batch share: mean pose and principal directions `(1 + B, 15, 3)`, lengths
    `(14,)`, limits, and the weights of the two terms beside C_r."""

    shapes: np.ndarray
    lengths: np.ndarray
    limits: AnatomicalLimits
    bones_weight: float
    limit_weight: float

    def bone_penalty(self, terms: np.ndarray) -> Penalty:
        """√β (|bone|² − s² l²), with s the mean pose's coefficient, for fits of `terms` `(n,
        k)`."""
        bones, root = bone_vectors(self.shapes)[terms], np.sqrt(self.bones_weight)
        square = self.lengths**2

        def penalty(coefficient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            whole = np.einsum("nk,nkba->nba", coefficient, bones)
            residual = np.sum(whole**2, axis=-1) - coefficient[:, :1] ** 2 * square
            slope = 2 * np.einsum("nba,nkba->nbk", whole, bones)
            slope[..., 0] -= 2 * coefficient[:, :1] * square
            return root * residual, root * slope

        return penalty

    def limit_cost(self, fit_terms: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
        """C_p `(n,)`: the bones that break a limit, weighted."""
        if not self.limit_weight:
            return np.zeros(len(coefficient))
        joints = np.einsum("nk,nkja->nja", coefficient, self.shapes[fit_terms])
        return self.limit_weight * np.sum(~self.limits.check(joints).valid, axis=1)


def start_rotations(points: Points) -> np.ndarray:
    """Starts `(n, 24, 3, 3)` over the sphere of views, rolled so that the back lies as it does in
    the image."""
    upright = np.diag(
        [1.0, -1.0, -1.0]
    )  # body axes (left, up, forward) to camera axes, facing the camera
    views = np.stack(
        [
            (
                Rotation.from_euler("xy", [tilt, yaw], degrees=True) * Rotation.from_matrix(upright)
            ).as_matrix()
            for tilt in (-30, 30)
            for yaw in range(0, 360, 30)
        ]
    )
    up = points.back()
    roll = np.arctan2(up[:, 0], -up[:, 1])
    return Rotation.from_euler("z", roll[:, None]).as_matrix()[:, None] @ views


def torso_cameras(points: Points, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations `(2n, 3, 3)` and scales `(2n,)` that put the mean torso on the torso joints: the
    best, and its twin."""
    starts = start_rotations(points)
    number, many = starts.shape[:2]
    each = points.repeat(many)
    terms = np.broadcast_to(mean, (number * many, 1, *mean.shape))
    first = adjust(
        each.xy,
        each.torso_weight,
        terms,
        starts.reshape(-1, 3, 3),
        np.full((number * many, 1), 0.7),
        iterations=12,
    )
    best = np.arange(number) * many + first.objective.reshape(number, many).argmin(axis=1)
    rotation = np.stack([first.rotation[best], mirror_twin(first.rotation[best])], axis=1).reshape(
        -1, 3, 3
    )
    twice = points.repeat(2)
    both = adjust(
        twice.xy,
        twice.torso_weight,
        terms[: 2 * number],
        rotation,
        np.repeat(first.coefficient[best], 2, axis=0),
        iterations=30,
    )
    rotation, scale = _positive(both.rotation, both.coefficient)
    return rotation, scale[:, 0]


def _positive(rotation: np.ndarray, coefficient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same image from a positive scale: a body turned inside out looks like its proper self
    after half a turn."""
    negative = coefficient[:, 0] < 0
    half = np.where(negative[:, None], np.array([-1.0, -1.0, 1.0]), 1.0)
    return half[:, :, None] * rotation, np.where(negative[:, None], -coefficient, coefficient)


def pursue(
    points: Points,
    problem: PursuitProblem,
    rotation: np.ndarray,
    scale: np.ndarray,
    *,
    most_terms: int = MOST_TERMS,
    least_gain: float = LEAST_GAIN,
) -> PursuitFit:
    """Matching pursuit from given cameras, one a row of `points`: `rotation` `(n, 3, 3)`, `scale`
    `(n,)`."""
    fit = _at(points, problem, np.zeros((len(rotation), 1), int), scale[:, None], rotation.copy())
    going = np.ones(len(rotation), bool)
    for _ in range(most_terms):
        rows = np.flatnonzero(going & (fit.objective > EXPLAINED))
        if not len(rows):
            break
        longer = _extended(points.take(rows), problem, fit.take(rows))
        gained = longer.objective <= (1 - least_gain) * fit.objective[rows]
        going[rows[~gained]] = False
        fit = fit.padded()
        for part, new in zip(fit, longer, strict=True):
            part[rows[gained]] = new[gained]
    return _settled(points, problem, fit)


def _settled(points: Points, problem: PursuitProblem, fit: PursuitFit) -> PursuitFit:
    """What has not converged is adjusted on, fits of as many terms together; with nothing left to
    explain it has."""
    count = np.count_nonzero(fit.terms, axis=1)
    for terms in np.unique(count[~fit.converged]):
        rows = np.flatnonzero(~fit.converged & (count == terms))
        some = fit.take(rows)
        some = some._replace(
            terms=some.terms[:, : terms + 1], coefficient=some.coefficient[:, : terms + 1]
        )
        found = _adjusted(points.take(rows), problem, some, 200)
        fit.coefficient[rows, : terms + 1] = found.coefficient
        for part, new in zip(fit[2:], found[2:], strict=True):
            part[rows] = new
    return fit._replace(converged=fit.converged | (fit.objective <= EXPLAINED))


def _at(
    points: Points,
    problem: PursuitProblem,
    terms: np.ndarray,
    coefficient: np.ndarray,
    rotation: np.ndarray,
) -> PursuitFit:
    """Fits as given, with their objectives."""
    still = adjust(
        points.xy,
        points.weight,
        problem.shapes[terms],
        rotation,
        coefficient,
        problem.bone_penalty(terms),
        iterations=0,
    )
    objective = still.objective + problem.limit_cost(terms, coefficient)
    return PursuitFit(terms, coefficient, rotation, objective, still.converged)


def _adjusted(
    points: Points, problem: PursuitProblem, fit: PursuitFit, iterations: int
) -> PursuitFit:
    """Fits with camera and coefficients adjusted together, where that lowers the objective."""
    found = adjust(
        points.xy,
        points.weight,
        problem.shapes[fit.terms],
        fit.rotation,
        fit.coefficient,
        problem.bone_penalty(fit.terms),
        iterations=iterations,
        tolerance=SETTLED,
    )
    rotation, coefficient = _positive(found.rotation, found.coefficient)
    objective = found.objective + problem.limit_cost(fit.terms, coefficient)
    new = PursuitFit(fit.terms, coefficient, rotation, objective, found.converged)
    # Where the end of an adjustment breaks a limit that its start keeps, the start is the better
    # fit, and the last.
    return new.where(new.objective <= fit.objective, fit)._replace(converged=found.converged)


def _extended(points: Points, problem: PursuitProblem, fit: PursuitFit) -> PursuitFit:
    """Every fit with the one further term, of the `TRIED` most promising ones, that lowers its
    objective most."""
    promising = _promising(points, problem, fit)
    number, tried = promising.shape
    each = PursuitFit(*(np.repeat(part, tried, axis=0) for part in fit)).padded()
    each.terms[:, -1] = promising.ravel()
    every = _adjusted(points.repeat(tried), problem, each, 3)
    best = np.arange(number) * tried + every.objective.reshape(number, tried).argmin(axis=1)
    return _adjusted(points, problem, every.take(best), 10)


def _promising(points: Points, problem: PursuitProblem, fit: PursuitFit) -> np.ndarray:
    """Terms `(n, TRIED)` whose projections correlate best with what a fit leaves unexplained (OMP's
    criterion)."""
    root = np.sqrt(points.weight)[:, :, None]
    rows = fit.rotation[:, :2].swapaxes(1, 2)
    pose = np.einsum("nk,nkja->nja", fit.coefficient, problem.shapes[fit.terms])
    left = (centred(points.xy - pose @ rows, points.weight) * root).reshape(len(pose), -1)
    seen = np.einsum("bja,nau->nbju", problem.shapes, rows)
    seen = (centred(seen, points.weight) * root[:, None]).reshape(
        len(pose), len(problem.shapes), -1
    )
    size = np.linalg.norm(seen, axis=2)
    score = np.abs(np.einsum("nbr,nr->nb", seen, left)) / np.maximum(size, 1e-9)
    np.put_along_axis(score, fit.terms, -1.0, axis=1)
    score[:, 0] = -1.0  # the mean pose is in every fit
    return np.argsort(-score, axis=1, kind="stable")[:, :TRIED]


def fit_akhter_black(
    detections: Sequence[Detection],
    dictionary: PoseDictionary,
    limits: AnatomicalLimits,
    *,
    bones_weight: float = BONES_WEIGHT,
    limit_weight: float = LIMIT_WEIGHT,
    most_terms: int = MOST_TERMS,
    least_gain: float = LEAST_GAIN,
) -> list[tuple[Candidate, ...]]:
    """The fits from both mirror twins of the torso's camera, for each detection, best objective
    first.

    Raises `BadInput` where too little is seen to tell a pose, or of the torso to tell a camera.
    """
    points = Points.gather(detections)
    for detection in detections:
        require_camera(detection)
    shapes = np.concatenate([dictionary.mean[None], dictionary.bases])
    problem = PursuitProblem(shapes, dictionary.lengths, limits, bones_weight, limit_weight)
    rotation, scale = torso_cameras(points, dictionary.mean)
    fit = pursue(
        points.repeat(2), problem, rotation, scale, most_terms=most_terms, least_gain=least_gain
    )
    joints = points.repeat(2).pixels(fit.rotation, fit.coefficient, shapes[fit.terms])
    steps = np.count_nonzero(fit.terms, axis=1)
    return candidates_both_ways(
        detections, joints, Outcome(fit.objective, steps, fit.converged), dictionary.torso
    )
