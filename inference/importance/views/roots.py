"""Bodies in the world, their bones' lengths among them, proposed by a robust fit to all views.

With every torso of the dictionary root, lengths and the limbs' joints are fitted by Gauss's and
Newton's steps, whose weights fall for keypoints far off; a Student's t around its fit then proposes
root and lengths. The fit decides nothing but how many proposals are wasted: their density is known,
and everything is weighed exactly.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import gammaln, logsumexp

from poseterior.inference.resampling import effective
from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.errors.faults import LIMB_INDEX, MOVES_TORSO, NUM_EXCHANGES, ORDERS
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.instant import InstantPosterior
from poseterior.probmodel.root_priors import MEDIAN_SIZE, SIZE_SD
from poseterior.probmodel.roots import WorldPoint
from poseterior.probmodel.sessions.session import joints_seen
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS, TORSO_INDEX

FIT_STEPS = 8
ODD_FIT = 2.5
"""Standard deviations beyond which a keypoint counts less and less in a fit."""
FREEDOM_OF_ROOTS = 20.0
"""Degrees of freedom of the proposals."""
WIDER = 1.2
"""How much wider than the covariance that is known they are."""
NARROWER = 0.8
"""The covariance of a posterior over that of its fit, as a rule: of what refined proposals are if
few bodies refine them."""
RIGID = 5.0
"""How many effective bodies a coordinate it takes until these say as much of the covariance."""
KEPT_OF_FIT = 0.1
"""What proposals keep of the first ones when a pilot run has refined them."""
EVEN_TORSOS = 1.0
"""How many effective bodies a torso it takes until these say as much of the torsos' shares as that
all are alike: one that was hardly tried is not known to be a bad one."""
OF_PRIOR_EXCHANGES = 0.1
"""What proposals of exchanges keep of the prior."""
CERTAIN_ODDS = 3.0
"""Log odds from which an exchange of the torso's sides is taken for certain by a fit."""
FEWEST_JOINTS = 3
"""Of the torso, that two cameras must see."""
TURN, SIZE, PLACE, LENGTHS_STEP = slice(0, 3), 3, slice(4, 7), slice(7, 12)
"""The coordinates of a step away from a fit: a rotation vector, log size, mm, and body units. Then
come, where they are uncertain, the shifts of the images in their standard deviations."""
NUM_ROOT, NUM_BODY = 7, 12
SHIFTS_STEP = slice(NUM_BODY, None)
WIDEST = np.array([0.5] * 3 + [0.2] + [300.0] * 3 + [0.3] * 5)
"""The longest step of a fit, and the widest proposal, in each coordinate of a body."""
WIDEST_SHIFT = 2.0
"""The same of an image, in its standard deviations."""
NARROWEST = 1e-8
"""The least variance of a proposal, over that of the widest."""
STIFF = 0.01
"""Body units, by which bones may be off in a fit."""
LOOSE = 2.0
"""Body units, within which a joint lies that hardly any view sees."""


class WorldBodies(NamedTuple):
    """Roots in the world and the bones' `length` `(..., 5)`, body units; a pytree."""

    point: WorldPoint
    length: np.ndarray

    def take(self, rows: Any) -> "WorldBodies":
        """Some of a batch."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], self)


class BodySteps(NamedTuple):
    """Bodies as steps away from the fit of their torso.

    Attributes
    ----------
    torso : `(n,)`
        Which of the dictionary.
    step : `(n, D)`
        Standard deviations of the fit, by the Cholesky factor of its covariance.
    exchange : `(n, C)`
        The views' exchanges.
    """

    torso: np.ndarray
    step: np.ndarray
    exchange: np.ndarray


@dataclass(frozen=True, eq=False)
class BodyProposal:
    """A mixture of K Student's t in the steps from J torsos' fits.

    Attributes
    ----------
    fit
        Leaves start with `(J,)`.
    factor : `(J, D, D)`
        Lower Cholesky factors of the fits' covariances.
    share : `(K, J)`
        With sum one.
    centre, spread : `(K, D)`, `(K, D, D)`
        Of the steps: where each is, and the lower Cholesky factors of their scale matrices.
    exchange : `(C, 6)`
        By which the views' exchanges are proposed, each for itself.
    """

    fit: WorldBodies
    factor: np.ndarray
    share: np.ndarray
    centre: np.ndarray
    spread: np.ndarray
    exchange: np.ndarray

    def draw(self, rng: np.random.Generator, number: int) -> BodySteps:
        """So many bodies."""
        flat = np.searchsorted(np.cumsum(self.share), rng.random(number))
        kind, torso = np.divmod(np.minimum(flat, self.share.size - 1), self.share.shape[1])
        normal = rng.standard_normal((number, self.centre.shape[1]))
        stretch = np.sqrt(FREEDOM_OF_ROOTS / rng.chisquare(FREEDOM_OF_ROOTS, number))
        away = np.einsum("nab,nb->na", self.spread[kind], normal) * stretch[:, None]
        places = rng.random((number, len(self.exchange), 1))
        exchange = np.sum(np.cumsum(self.exchange, axis=1)[:, :-1] < places, axis=-1)
        return BodySteps(torso, self.centre[kind] + away, exchange)

    def bodies(self, steps: BodySteps) -> WorldBodies:
        """Where steps lead."""
        return _moved(self.fit.take(steps.torso), self._plain(steps))

    def log_density(self, steps: BodySteps) -> np.ndarray:
        """`(n,)`: of bodies by the base measure of roots × lengths, and of exchanges."""
        turn = self._plain(steps)[:, TURN]
        stretch = np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(axis=1)
        return self.log_steps(steps) - stretch[steps.torso] - log_haar(turn)

    def log_steps(self, steps: BodySteps) -> np.ndarray:
        """`(n,)`: log density of torsos, steps and exchanges."""
        parts = []
        for share, centre, spread in zip(self.share, self.centre, self.spread, strict=True):
            normal = solve_triangular(spread, (steps.step - centre).T, lower=True).T
            level = np.log(share[steps.torso]) - np.log(np.diagonal(spread)).sum()
            parts.append(level + _log_student(normal))
        views = np.arange(len(self.exchange))
        of_exchanges = np.log(self.exchange[views, steps.exchange]).sum(axis=1)
        return np.logaddexp.reduce(parts) + of_exchanges

    def _plain(self, steps: BodySteps) -> np.ndarray:
        """`(n, D)`: steps in radians, logs, mm, body units and pixels."""
        return np.einsum("nab,nb->na", self.factor[steps.torso], steps.step)

    def refined(self, steps: BodySteps, share: np.ndarray) -> "BodyProposal":
        """Proposals as these bodies scatter, which have such shares `(n,)` of the posterior, beside
        the first ones: fewer bodies move them less, and turn and stretch them still less."""
        worth, number = effective(share), self.centre.shape[1]
        mean = share @ steps.step
        off = steps.step - mean
        # One body alone does not scatter.
        scatter = (off.T * share) @ off / max(1 - 1 / worth, np.finfo(float).eps)
        trust, rigid = worth / (worth + number), worth / (worth + RIGID * number)
        scatter = WIDER * (rigid * scatter + (1 - rigid) * NARROWER * np.eye(number))
        even = self.share[0] / self.share[0].sum()
        own = np.bincount(steps.torso, share, minlength=len(even))
        known = worth / (worth + EVEN_TORSOS * len(even))
        own = known * own + (1 - known) * even
        seen = np.stack(
            [np.bincount(column, share, minlength=NUM_EXCHANGES) for column in steps.exchange.T]
        )
        return dataclasses.replace(
            self,
            share=np.stack([KEPT_OF_FIT * even, (1 - KEPT_OF_FIT) * own]),
            centre=np.stack([self.centre[0], trust * mean]),
            spread=np.stack([self.spread[0], np.linalg.cholesky(scatter)]),
            exchange=(1 - KEPT_OF_FIT) * seen + KEPT_OF_FIT * self.exchange,
        )


def log_haar(turn: np.ndarray) -> np.ndarray:
    """`(n,)`: log density of rotation vectors `(n, 3)` under Haar's measure, which is 1 in all;
    infinite beyond a half turn, where a rotation has another vector."""
    angle = np.linalg.norm(turn, axis=1)
    safe = np.where(angle > 1e-4, angle, 1.0)
    ratio = np.where(angle > 1e-4, 2 * (1 - np.cos(safe)) / safe**2, 1 - angle**2 / 12)
    inside = np.log(np.maximum(ratio, 1e-300) / (8 * np.pi**2))
    return np.where(angle < np.pi, inside, -np.inf)


def _log_student(step: np.ndarray) -> np.ndarray:
    """`(n,)`: log density of a standard Student's t at steps `(n, D)`."""
    nu, half = FREEDOM_OF_ROOTS, step.shape[1] / 2
    level = gammaln(nu / 2 + half) - gammaln(nu / 2) - half * np.log(nu * np.pi)
    return level - (nu / 2 + half) * np.log1p(np.sum(step**2, axis=1) / nu)


def rotations_of(turn: np.ndarray) -> np.ndarray:
    """`(..., 3, 3)`: the rotations of vectors `(..., 3)` (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    cross = _crossed(turn)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.eye(3) + first * cross + second * cross @ cross


def _crossed(vector: np.ndarray) -> np.ndarray:
    """`(..., 3, 3)`: what makes of a vector its cross product with `vector`."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _moved(start: WorldBodies, step: np.ndarray) -> WorldBodies:
    """Bodies `(n, ...)` after steps `(n, 12)`."""
    point = WorldPoint(
        start.point.torso,
        rotations_of(step[:, TURN]) @ start.point.rotation,
        start.point.log_size + step[:, SIZE],
        start.point.place + step[:, PLACE],
        start.point.pointing + step[:, SHIFTS_STEP].reshape(start.point.pointing.shape),
    )
    return WorldBodies(point, start.length + step[:, LENGTHS_STEP])


def fitted(posterior: InstantPosterior) -> BodyProposal:
    """The first proposal. Raises `BadInput` where two cameras do not see enough of the torso, or it
    is behind one of them."""
    turned, (points, *beside) = _turned(posterior)
    _require_torso(posterior, points)
    torsos = np.asarray(posterior.model.torsos)
    start = _aligned(torsos, points, posterior.root_prior.pointing.shape)
    fit, factor = _Fit(posterior, torsos, turned).run(start, points)
    # Evenly: what chooses among torsos are the limits, of which a fit knows nothing. By the fits'
    # own evidence, even tempered, fewer roots were effective.
    share = np.full(len(torsos), 1 / len(torsos))
    number = factor.shape[-1]
    spread = np.sqrt(WIDER) * np.eye(number)[None]
    middle, exchanges = np.zeros((1, number)), _exchanges(posterior, points, beside)
    return BodyProposal(fit, factor, share[None], middle, spread, exchanges)


def _turned(posterior: InstantPosterior) -> tuple[np.ndarray, np.ndarray]:
    """`(C,)`: the exchanges of views in which sides of the torso are plainly exchanged, which would
    lead a fit astray: view by view, first where the keypoints come nearest to what the others see.
    Of two views nobody says which it is. And what is `_triangulated` under them."""
    found = np.zeros(len(posterior.detected.views), int)
    joints = _triangulated(posterior, found)
    for _ in found if len(found) > 2 else ():
        score = _scores(posterior, list(joints[1:]))
        best = np.argmax(score, axis=1)
        gain = score[np.arange(len(found)), best] - score[:, 0]
        gain[(found > 0) | ~MOVES_TORSO[best]] = 0.0
        view = int(np.argmax(gain))
        if gain[view] < CERTAIN_ODDS:
            break
        found[view] = best[view]
        joints = _triangulated(posterior, found)
    return found, joints


def _triangulated(posterior: InstantPosterior, exchange: np.ndarray) -> np.ndarray:
    """`(1 + C, 15, 3)` mm: the joints as all views see them under exchanges `(C,)`, and as all but
    each do; NaN where fewer than two see one."""
    instant = posterior.detection
    order = ORDERS[exchange]
    spread = np.stack([view.spread for view in posterior.detected.views])
    spread = np.take_along_axis(spread, order, axis=1)
    counts, number = np.isfinite(spread), len(spread)
    keypoints = np.take_along_axis(instant.keypoints, order[..., None], axis=1)
    xy = np.where(counts[..., None], keypoints, np.nan)
    trust = np.where(counts, 1 / spread, 0.0)
    used = np.column_stack([np.ones(number), 1 - np.eye(number)])
    every = np.repeat(xy[:, None], 1 + number, axis=1)
    cameras = [view.camera for view in instant.views]
    return joints_seen(cameras, every, used[..., None] * trust[:, None]).points


def _require_torso(posterior: InstantPosterior, points: np.ndarray) -> None:
    """Raises `BadInput` where joints `(15, 3)` that cameras triangulate do not place a torso."""
    known = np.isfinite(points[list(TORSO_INDEX)]).all(axis=1)
    where = posterior.detection.where
    if known.sum() < FEWEST_JOINTS:
        raise BadInput(
            f"two cameras see {known.sum()} joints of the torso of {where} together, and"
            f" {FEWEST_JOINTS} at least are needed; add cameras, or take one view by itself"
        )
    depth = np.asarray(posterior.detection.rig.view(points[list(TORSO_INDEX)][known]))[..., 2]
    # One of two joints may be an outlier, and anywhere.
    if (behind := np.flatnonzero(np.median(depth, axis=0) <= 0)).size:
        label = posterior.detection.views[behind[0]].label
        raise BadInput(
            f"{where} is behind the camera {label}: its calibration does not fit what it saw;"
            " check the order of the cameras, and which way its rotation is meant"
        )


def _aligned(torsos: np.ndarray, points: np.ndarray, shifts: tuple[int, ...]) -> WorldPoint:
    """Every torso on triangulated joints `(15, 3)`, NaN where not known, at the usual size; no
    shifts of so many images."""
    points = points[list(TORSO_INDEX)]
    known = np.isfinite(points).all(axis=1)
    middle = points[known].mean(axis=0)
    own = torsos[:, known]
    own = own - own.mean(axis=1, keepdims=True)
    turn = align_torsos(own, points[known] - middle)
    place = middle - MEDIAN_SIZE * np.einsum("jab,jb->ja", turn, torsos[:, known].mean(axis=1))
    number = len(torsos)
    size, none = np.full(number, np.log(MEDIAN_SIZE)), np.zeros((number, *shifts))
    return WorldPoint(np.arange(number), turn, size, place, none)


def _factor(covariance: np.ndarray, widest: np.ndarray) -> np.ndarray:
    """Lower Cholesky factors of covariances `(J, D, D)`, none wider than `widest` `(D,)`."""
    level, axes = np.linalg.eigh(covariance / widest / widest[:, None])
    level = np.clip(level, NARROWEST, 1.0)
    return widest[:, None] * np.linalg.cholesky((axes * level[:, None]) @ np.swapaxes(axes, 1, 2))


class _Fit:
    """Robust least squares of all keypoints in all views, for every torso at once: of a step of the
    body, of the images' shifts, and of the limbs' joints, which hang on bones that are nearly
    stiff; under exchanges `(C,)`."""

    def __init__(
        self, posterior: InstantPosterior, torsos: np.ndarray, exchange: np.ndarray
    ) -> None:
        views, lengths = posterior.detected.views, posterior.model.lengths
        low, high, alpha, beta = (np.asarray(part) for part in lengths)
        self.mean = low + (high - low) * alpha / (alpha + beta)
        self.sd = (high - low) * np.sqrt(alpha * beta / (alpha + beta + 1)) / (alpha + beta)
        self.torsos = torsos
        self.cameras = [view.camera for view in posterior.detection.views]
        seen = [(view, ORDERS[own]) for view, own in zip(views, exchange, strict=True)]
        self.detected = np.stack([np.asarray(view.keypoints)[own] for view, own in seen])
        self.spread = np.stack([np.asarray(view.spread)[own] for view, own in seen])
        self.bias = np.stack([np.asarray(view.bias)[own] for view, own in seen])
        self.defined = [view.definition for view in views]
        self.shift = np.asarray(posterior.root_prior.pointing).ravel()
        self.widest = np.append(WIDEST, WIDEST_SHIFT * self.shift)

    def run(self, start: WorldPoint, seen: np.ndarray) -> tuple[WorldBodies, np.ndarray]:
        """From roots and triangulated joints `(15, 3)` the fits, and factors `(J, D, D)` of their
        covariances."""
        body = WorldBodies(start, np.tile(self.mean, (len(self.torsos), 1)))
        limbs = np.tile(seen[list(LIMB_INDEX)], (len(self.torsos), 1, 1))
        limbs = np.where(np.isfinite(limbs), limbs, start.place[:, None])
        number = len(self.widest)
        for _ in range(FIT_STEPS):
            slope, off = self._rows(body, limbs)
            turned = np.swapaxes(slope, 1, 2)
            step = np.linalg.solve(turned @ slope, turned @ off[..., None])[..., 0]
            far = np.abs(step[:, :number] / self.widest).max(axis=1, keepdims=True)
            step *= np.minimum(1.0, 1 / np.maximum(far, 1e-9))
            body = _moved(body, step[:, :number])
            limbs = limbs + step[:, number:].reshape(limbs.shape)
        slope, _ = self._rows(body, limbs)
        covariance = np.linalg.pinv(np.swapaxes(slope, 1, 2) @ slope, hermitian=True)
        return body, _factor(covariance[:, :number, :number], self.widest)

    def _rows(self, body: WorldBodies, limbs: np.ndarray) -> "_Part":
        """The slopes `(J, rows, D + 27)` and residuals `(J, rows)` of least squares."""
        number, size = len(limbs), np.exp(body.point.log_size)[:, None]
        arm = size[..., None] * self.torsos @ np.swapaxes(body.point.rotation, 1, 2)
        world = np.empty((number, NUM_JOINTS, 3))
        world[:, list(TORSO_INDEX)] = body.point.place[:, None] + arm
        world[:, list(LIMB_INDEX)] = limbs
        moves = np.zeros((number, NUM_JOINTS, 3, len(self.widest) + 3 * len(LIMB_INDEX)))
        # A turn moves a joint by its cross product with where it is.
        identity = np.broadcast_to(np.eye(3), (*arm.shape, 3))
        of_root = np.concatenate([-_crossed(arm), arm[..., None], identity], axis=-1)
        moves[:, list(TORSO_INDEX), :, :NUM_ROOT] = of_root
        for row, joint in enumerate(LIMB_INDEX):
            first = len(self.widest) + 3 * row
            moves[:, joint, :, first : first + 3] = np.eye(3)
        parts = [self._seen(index, body, world, moves) for index in range(len(self.cameras))]
        parts += [self._stiff(body, world, moves, size), self._believed(body, world, moves, size)]
        slope, off = zip(*parts, strict=True)
        return np.concatenate(slope, axis=1), np.concatenate(off, axis=1)

    def _seen(self, index: int, body: WorldBodies, world: np.ndarray, moves: np.ndarray) -> "_Part":
        """What one camera sees."""
        camera, spread, size = self.cameras[index], self.spread[index], np.exp(body.point.log_size)
        if (beside := self.defined[index]) is not None:
            turn = size[:, None, None] * np.swapaxes(body.point.rotation, 1, 2)
            world = world + np.asarray(beside) @ turn
        unit = camera.focal[0] * size[:, None] / camera.view(world)[..., 2]
        sd = np.where(np.isfinite(spread), unit * spread / 2, np.inf)[..., None]
        target = self.detected[index] - self.bias[index] * unit[..., None]
        slope = camera.slope(world) @ moves
        if len(self.shift):
            target = target - body.point.pointing[:, index, None]
            first = NUM_BODY + 2 * index
            slope[..., first : first + 2] = np.eye(2)
        off = (target - camera.project(world)) / sd
        square = np.sum(off**2, axis=-1) / ODD_FIT**2
        weight = np.sqrt(1 / (1 + square))[..., None]
        slope = slope / sd[..., None] * weight[..., None]
        return _flat(slope), (off * weight).reshape(len(world), -1)

    def _stiff(
        self, body: WorldBodies, world: np.ndarray, moves: np.ndarray, size: np.ndarray
    ) -> "_Part":
        """That bones are as long as they are."""
        starts, ends = [bone.start for bone in BONES], [bone.end for bone in BONES]
        groups = [bone.length_group for bone in BONES]
        bone = world[:, ends] - world[:, starts]
        long = np.linalg.norm(bone, axis=-1)
        along = bone / np.maximum(long, 1e-9)[..., None]
        slope = np.einsum("jba,jbam->jbm", along, moves[:, ends] - moves[:, starts])
        wanted = size * body.length[:, groups]
        slope[:, :, SIZE] -= wanted
        slope[:, range(len(BONES)), [LENGTHS_STEP.start + group for group in groups]] -= size
        scale = STIFF * size
        off = (wanted - long) / scale
        return slope / scale[..., None], off

    def _believed(
        self, body: WorldBodies, world: np.ndarray, moves: np.ndarray, size: np.ndarray
    ) -> "_Part":
        """The priors of size, lengths and shifts, and that limbs are about where the body is."""
        number = len(world)
        means = np.concatenate([[np.log(MEDIAN_SIZE)], self.mean, 0 * self.shift])
        sds = np.concatenate([[SIZE_SD], self.sd, self.shift])
        shift = body.point.pointing.reshape(number, -1)
        found = np.concatenate([body.point.log_size[:, None], body.length, shift], axis=1)
        columns = [SIZE, *range(LENGTHS_STEP.start, len(self.widest))]
        own = np.zeros((number, len(sds), moves.shape[-1]))
        own[:, range(len(sds)), columns] = 1 / sds
        off = (means - found) / sds
        joints, scale = list(LIMB_INDEX), LOOSE * size[..., None]
        loose = moves[:, joints] / scale[..., None]
        away = (body.point.place[:, None] - world[:, joints]) / scale
        off = np.concatenate([off, away.reshape(number, -1)], axis=1)
        return np.concatenate([own, _flat(loose)], axis=1), off


_Part = tuple[np.ndarray, np.ndarray]
"""Slopes `(J, rows, D + 27)` and residuals `(J, rows)`."""


def _flat(slope: np.ndarray) -> np.ndarray:
    """Slopes `(J, joints, axes, D + 27)` as rows."""
    return slope.reshape(len(slope), -1, slope.shape[-1])


def _exchanges(
    posterior: InstantPosterior, points: np.ndarray, beside: Sequence[np.ndarray]
) -> np.ndarray:
    """`(C, 6)`: by which exchanges are proposed: by how near each would bring a view's keypoints to
    what the others see, `beside` it, `(15, 3)` each; to what all see, `points`, where there are
    but two."""
    score = _scores(posterior, beside if len(beside) > 2 else [points] * len(beside))
    share = np.exp(score - logsumexp(score, axis=1, keepdims=True))
    prior = np.stack([own.exchange_probabilities for own in posterior.faults.views])
    return (1 - OF_PRIOR_EXCHANGES) * share + OF_PRIOR_EXCHANGES * prior


def _scores(posterior: InstantPosterior, points: Sequence[np.ndarray]) -> np.ndarray:
    """`(C, 6)`: about the log posterior of each view's exchanges, if joints are at `points`
    `(15, 3)`, for each view its own."""
    prior = np.stack([own.exchange_probabilities for own in posterior.faults.views])
    near = [_nearness(posterior, index, own) for index, own in enumerate(points)]
    with np.errstate(divide="ignore"):
        return np.stack(near) + np.log(prior)


def _nearness(posterior: InstantPosterior, index: int, points: np.ndarray) -> np.ndarray:
    """`(6,)`: about the log likelihood of a view's keypoints under each exchange, if joints are at
    `points` `(15, 3)`."""
    camera, view = posterior.detection.views[index].camera, posterior.detected.views[index]
    unit = camera.focal[0] * MEDIAN_SIZE / camera.view(points)[:, 2]
    order = np.asarray(ORDERS)
    off = np.asarray(view.keypoints)[order] - camera.project(points)
    # Twice the variance, since the points err as well.
    sd = unit * np.asarray(view.spread)[order] / np.sqrt(2)
    square = np.sum(off**2, axis=-1) / sd**2
    level = -(ODD_FIT**2) / 2 * np.log1p(square / ODD_FIT**2)
    return np.where(np.isfinite(square) & np.isfinite(sd), level, 0.0).sum(axis=1)
