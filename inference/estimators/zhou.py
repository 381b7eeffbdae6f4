"""Zhou et al. (2015): 3D pose from 2D joints by a convex relaxation, solved with ADMM, rounded and
refined.

A pose is a non-negative sum of atoms seen by a rotation, x = R₂ Σ c_i B_i + T. With M_i = c_i R₂
relaxed to any 2 × 3 matrix, and c_i to the spectral norm of M_i, what remains is convex:

    min over M, T of  ½ |(W − Σ M_i B_i − T 1ᵀ) diag(√α)|² + λ Σ |M_i|₂

with the scores as weights α, zero where a joint is missing (Jahangiri & Yuille 2017, § 2). The
robust variant puts an error E with an ℓ1 norm between, ½ |(W − … − E) diag(√α)|² + κ |E diag(α)|₁;
the best E put in, that is Huber's loss."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from poseterior.inference.estimators.adjustment import Adjusted, Penalty, adjust, mirror_twin
from poseterior.inference.estimators.points import Points
from poseterior.inference.estimators.twins import Outcome, candidates_both_ways
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.roots import Candidate

PENALTY = 0.03
"""λ, for image points of size one (`Points`)."""
TOLERANCE = 1e-3
"""ADMM ends where both residuals are below this share of what they are differences of; the
objective is then within some 1e-4 of its least value."""
MAX_ITERATIONS = 2000
RELAXATION = 1.6
GRAPH = 10.0
"""Weight of "the projected points are what the blocks project to" against "the blocks are what is
shrunk" in ADMM's quadratic terms."""
ADAPTED = 400
"""Iterations in which the step size may change; with a fixed one ADMM converges whatever it is."""
SUPPORT = 16
"""Most atoms that are kept after rounding."""
REFINING_ROUNDS = 100
SETTLED = 1e-3
"""Refinement ends where a round lowers the objective by less than this share of it."""
SMALLEST = 1e-9


class Relaxed(NamedTuple):
    """Optima of the relaxation: `blocks` `(n, K, 2, 3)`, `translation` `(n, 2)`, and `(n,)` each
    `objective`, `iterations`, `converged`."""

    blocks: np.ndarray
    translation: np.ndarray
    objective: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray


class ConvexProblem(NamedTuple):
    """Points `xy` `(n, 2, 15)` with `weight` `(n, 1, 15)`, atoms side by side `(3K, 15)`, λ and
    κ."""

    xy: np.ndarray
    weight: np.ndarray
    atoms: np.ndarray
    penalty: float
    threshold: float

    @classmethod
    def build(
        cls,
        xy: np.ndarray,
        weight: np.ndarray,
        atoms: np.ndarray,
        penalty: float,
        threshold: float = np.inf,
    ) -> "ConvexProblem":
        """From points `(n, 15, 2)`, weights `(n, 15)` and atoms `(K, 15, 3)`."""
        side_by_side = atoms.swapaxes(1, 2).reshape(3 * len(atoms), -1)
        return cls(xy.swapaxes(1, 2), weight[:, None], side_by_side, penalty, threshold)

    def objective(self, blocks: np.ndarray, translation: np.ndarray) -> np.ndarray:
        """`(n,)`: what is minimised, at blocks `(n, 2, 3K)` and translations `(n, 2)`."""
        error = np.abs(self.xy - blocks @ self.atoms - translation[..., None])
        # Huber's loss: what is left when the best E is taken out.
        loss = np.where(
            error > self.threshold, self.threshold * (error - self.threshold / 2), error**2 / 2
        )
        norms = np.linalg.norm(_apart(blocks), ord=2, axis=(-2, -1))
        return np.sum(self.weight * loss, axis=(1, 2)) + self.penalty * norms.sum(axis=1)


class State(NamedTuple):
    """ADMM in its shortest form, that of Douglas and Rachford: `v` = variable less scaled
    multiplier, for the blocks `(n, 2, 3K)` and for the projected points `(n, 2, 15)`; `rho`
    `(n,)`."""

    blocks: np.ndarray
    points: np.ndarray
    rho: np.ndarray


def _apart(blocks: np.ndarray) -> np.ndarray:
    """Blocks `(n, K, 2, 3)` from blocks side by side `(n, 2, 3K)`."""
    return blocks.reshape(len(blocks), 2, -1, 3).swapaxes(1, 2)


def _beside(blocks: np.ndarray) -> np.ndarray:
    return blocks.swapaxes(1, 2).reshape(len(blocks), 2, -1)


def shrink_spectral(blocks: np.ndarray, amount: np.ndarray) -> np.ndarray:
    """Proximal map of `amount` × spectral norm, for each of `blocks` `(..., 2, 3)`.

    The singular values go to argmin ½|σ' − σ|² + amount·max σ': the larger falls by the amount
    until it meets the smaller, then both share what is left. (a + b M Mᵀ) M has the new singular
    values in place of the old."""
    first, second = blocks[..., 0, :], blocks[..., 1, :]
    one, two, cross = (
        np.sum(a * b, axis=-1) for a, b in ((first, first), (second, second), (first, second))
    )
    mean, apart = (one + two) / 2, np.sqrt(((one - two) / 2) ** 2 + cross**2)
    large, small = np.sqrt(mean + apart), np.sqrt(np.maximum(mean - apart, 0.0))
    vanish = large + small <= amount
    separate = ~vanish & (large - small >= amount)
    meet = ~vanish & ~separate  # then neither is zero
    both = np.where(meet, (large + small - amount) / 2, 0.0)
    large, small_or_one = np.where(vanish, 1.0, large), np.where(meet, small, 1.0)
    slope = np.where(
        separate,
        -amount / np.where(separate, 2 * large * apart, 1.0),
        -both / (large * small_or_one * (large + small_or_one)),
    )
    level = np.where(separate, 1.0, both / small_or_one) - slope * small**2
    slope, level = slope[..., None], np.where(vanish, 0.0, level)[..., None]
    return np.stack(
        [
            (level + slope * one[..., None]) * first + slope * cross[..., None] * second,
            (level + slope * two[..., None]) * second + slope * cross[..., None] * first,
        ],
        axis=-2,
    )


class Splitting:
    """One ADMM iteration for all problems of a batch: shrink, then project onto "points = Σ M_i B_i
    + T"."""

    def __init__(self, problem: ConvexProblem) -> None:
        self.problem = problem
        self._atoms = problem.atoms - problem.atoms.mean(
            axis=1, keepdims=True
        )  # the best T, taken out
        inner = GRAPH * self._atoms.T @ self._atoms + np.eye(self._atoms.shape[1])
        self._pull = GRAPH * np.linalg.solve(inner, self._atoms.T)

    def start(self, step: float) -> State:
        """Nothing but the points themselves."""
        blocks = np.zeros((*self.problem.xy.shape[:2], len(self._atoms)))
        return State(blocks, np.array(self.problem.xy), np.full(len(blocks), step))

    def shrink(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """The proximal maps: blocks of smaller norm, points nearer to the detected ones (Huber's
        loss)."""
        problem, rho = self.problem, state.rho[:, None, None]
        blocks = _beside(
            shrink_spectral(_apart(state.blocks), problem.penalty / state.rho[:, None])
        )
        offset, graph = state.points - problem.xy, rho * GRAPH
        most = np.where(problem.weight > 0, problem.threshold, 0.0) * problem.weight / graph
        return blocks, state.points - np.clip(
            problem.weight / (problem.weight + graph) * offset, -most, most
        )

    def project(self, blocks: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest blocks and points of which the points are what the blocks project to."""
        middle = points.mean(axis=2, keepdims=True)
        blocks = blocks + (points - middle - blocks @ self._atoms) @ self._pull
        return blocks, blocks @ self._atoms + middle

    def advance(self, state: State) -> tuple[State, np.ndarray, np.ndarray, np.ndarray]:
        """The next state, the shrunk blocks and points, and how far shrunk and projected are apart
        `(n,)`, relative to their size."""
        blocks, points = self.shrink(state)
        near = self.project(2 * blocks - state.blocks, 2 * points - state.points)
        moved = State(
            state.blocks + RELAXATION * (near[0] - blocks),
            state.points + RELAXATION * (near[1] - points),
            state.rho,
        )
        primal = _size(blocks - near[0], points - near[1]) / np.maximum(
            _size(blocks, points), 1e-12
        )
        return moved, blocks, points, primal

    def rescale(self, state: State, change: np.ndarray) -> State:
        """The same point of the iteration for `rho` times `change` `(n,)`: multipliers are divided
        by it."""
        blocks, points = self.shrink(state)
        by = change[:, None, None]
        return State(
            blocks - (blocks - state.blocks) / by,
            points - (points - state.points) / by,
            state.rho * change,
        )


def _size(blocks: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Norm `(n,)` of blocks and points together, in which ADMM is a sequence of averaged steps."""
    return np.sqrt(np.sum(blocks**2, axis=(1, 2)) + GRAPH * np.sum(points**2, axis=(1, 2)))


def relax(
    xy: np.ndarray,
    weight: np.ndarray,
    atoms: np.ndarray,
    *,
    penalty: float = PENALTY,
    threshold: float = np.inf,
    tolerance: float = TOLERANCE,
    max_iterations: int = MAX_ITERATIONS,
) -> Relaxed:
    """Solves the relaxation for points `xy` `(n, 15, 2)` with `weight` `(n, 15)` and `atoms` `(K,
    15, 3)`.

    `threshold` is κ of the robust variant. Frames leave the batch as they converge.
    """
    whole = ConvexProblem.build(xy, weight, atoms, penalty, threshold)
    found, translation = np.zeros((len(xy), 2, 3 * len(atoms))), np.zeros((len(xy), 2))
    iterations, converged = np.full(len(xy), max_iterations), np.zeros(len(xy), bool)
    left = np.arange(len(xy))
    splitting = Splitting(whole)
    state = splitting.start(penalty)
    before = splitting.shrink(state)
    for iteration in range(1, max_iterations + 1):
        state, blocks, points, primal = splitting.advance(state)
        multiplier = _size(blocks - state.blocks, points - state.points)
        dual = _size(blocks - before[0], points - before[1]) / np.maximum(multiplier, 1e-12)
        done = (primal < tolerance) & (dual < tolerance)
        found[left], translation[left] = blocks, np.mean(points - blocks @ whole.atoms, axis=2)
        iterations[left[done]], converged[left[done]] = iteration, True
        left, keep = left[~done], ~done
        if not len(left):
            break
        if done.any():
            splitting.problem = whole._replace(xy=whole.xy[left], weight=whole.weight[left])
            state = State(*(part[keep] for part in state))
        before = blocks[keep], points[keep]
        if iteration % 10 == 0 and iteration <= ADAPTED:
            up, down = primal[keep] > 5 * dual[keep], dual[keep] > 5 * primal[keep]
            state = splitting.rescale(state, np.where(up, 2.0, np.where(down, 0.5, 1.0)))
    # Out of iterations: blocks that do project to the points, even where all are still shrunk to
    # nothing.
    if len(left):
        found[left] = splitting.project(before[0], before[1])[0]
    return Relaxed(
        _apart(found), translation, whole.objective(found, translation), iterations, converged
    )


def rounded(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations `(n, 3, 3)` and coefficients `(n, K)`, not negative, of which c_i R₂ is nearest to
    `blocks` `(n, K, 2, 3)`: the best product of rank one first, then by turns."""
    flat = blocks.reshape(*blocks.shape[:2], 6)
    _, vectors = np.linalg.eigh(flat.swapaxes(1, 2) @ flat)
    coefficient = np.einsum("nki,ni->nk", flat, vectors[..., -1])
    coefficient *= np.where(coefficient.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    for _ in range(20):
        u, _, vt = np.linalg.svd(
            np.einsum("nk,nkab->nab", coefficient, blocks), full_matrices=False
        )
        rows = u @ vt
        coefficient = np.maximum(np.einsum("nkab,nab->nk", blocks, rows) / 2, 0.0)
    return np.concatenate([rows, np.cross(rows[:, 0], rows[:, 1])[:, None]], axis=1), coefficient


def refine(
    points: Points,
    terms: np.ndarray,
    rotation: np.ndarray,
    coefficient: np.ndarray,
    *,
    penalty: float = PENALTY,
    rounds: int = REFINING_ROUNDS,
) -> Adjusted:
    """Lowers ½ Σ α |x − R₂ Σ c B − T|² + λ Σ |c| over rotations and coefficients, from where
    rounding ended.

    Each round lowers a bound from above, |c| ≤ (c²/c₀ + c₀)/2, so the objective never rises.
    `terms` `(n, k, 15, 3)`."""
    number = len(rotation)
    rotation, coefficient = rotation.copy(), coefficient.copy()
    objective, converged = np.full(number, np.inf), np.zeros(number, bool)
    for _ in range(rounds):
        rows = np.flatnonzero(~converged)
        if not len(rows):
            break
        some = points.take(rows)
        bound = np.sqrt(penalty / np.maximum(np.abs(coefficient[rows]), SMALLEST))
        step = adjust(
            some.xy,
            some.weight,
            terms[rows],
            rotation[rows],
            coefficient[rows],
            _ridge(bound),
            iterations=6,
        )
        square = np.sum((bound * step.coefficient) ** 2, axis=1)
        now = (step.objective - square) / 2 + penalty * np.abs(step.coefficient).sum(axis=1)
        converged[rows] = objective[rows] - now <= SETTLED * now
        rotation[rows], coefficient[rows], objective[rows] = step.rotation, step.coefficient, now
    return Adjusted(rotation, coefficient, objective, converged)


def _ridge(root: np.ndarray) -> Penalty:
    slope = root[:, :, None] * np.eye(root.shape[1])
    return lambda coefficient: (root * coefficient, slope)


def fit_zhou(
    detections: Sequence[Detection],
    dictionary: PoseDictionary,
    *,
    penalty: float = PENALTY,
    threshold: float = np.inf,
    tolerance: float = TOLERANCE,
    max_iterations: int = MAX_ITERATIONS,
) -> list[tuple[Candidate, ...]]:
    """The refined optimum of the relaxation for each detection, and the local optimum around its
    mirror twin.

    `threshold` is κ of the robust variant, in units of the points' size. Raises `BadInput` where
    too little is seen, where the penalty leaves nothing, or it or κ is not positive."""
    for name, value in (("penalty", penalty), ("threshold", threshold)):
        if not value > 0:  # false for NaN too
            raise BadInput(f"the {name} must be positive, not {value}")
    points = Points.gather(detections)
    relaxed = relax(
        points.xy,
        points.weight,
        dictionary.atoms,
        penalty=penalty,
        threshold=threshold,
        tolerance=tolerance,
        max_iterations=max_iterations,
    )
    rotation, coefficient = rounded(relaxed.blocks)
    nothing = (coefficient.sum(axis=1) <= SMALLEST) | (
        penalty >= vanishing_penalty(points, dictionary.atoms)
    )
    for detection, empty in zip(detections, nothing, strict=True):
        if empty:
            raise BadInput(
                f"the penalty {penalty:g} leaves a pose of scale zero for {detection.where}; choose"
                " a smaller one"
            )
    support = np.argsort(-coefficient, axis=1, kind="stable")[:, :SUPPORT]
    terms, both = (
        dictionary.atoms[support],
        heeded(points, relaxed, dictionary.atoms, threshold).repeat(2),
    )
    fit = refine(
        both,
        np.repeat(terms, 2, axis=0),
        _with_twins(rotation),
        np.repeat(np.take_along_axis(coefficient, support, 1), 2, axis=0),
        penalty=penalty,
    )
    joints = both.pixels(fit.rotation, fit.coefficient, np.repeat(terms, 2, axis=0))
    iterations, converged = np.repeat(relaxed.iterations, 2), np.repeat(relaxed.converged, 2)
    outcome = Outcome(fit.objective, iterations, fit.converged & converged)
    return candidates_both_ways(detections, joints, outcome, dictionary.torso)


def vanishing_penalty(points: Points, atoms: np.ndarray) -> np.ndarray:
    """The least λ `(n,)` at which nothing but T is left: the largest nuclear norm of a block's
    gradient at zero."""
    gradient = np.einsum("nj,nja,kjb->nkab", points.weight, points.xy, atoms)
    return np.linalg.norm(gradient, ord="nuc", axis=(2, 3)).max(axis=1)


def heeded(points: Points, relaxed: Relaxed, atoms: np.ndarray, threshold: float) -> Points:
    """The points with weights under which squares pull as Huber's loss does: less where more than κ
    is left."""
    left = (
        points.xy - np.einsum("nkab,kjb->nja", relaxed.blocks, atoms) - relaxed.translation[:, None]
    )
    share = np.minimum(1.0, threshold / np.maximum(np.linalg.norm(left, axis=2), SMALLEST))
    return replace(points, weight=points.weight * share)


def _with_twins(rotation: np.ndarray) -> np.ndarray:
    """`(2n, 3, 3)`: every rotation followed by its mirror twin."""
    return np.stack([rotation, mirror_twin(rotation)], axis=1).reshape(-1, 3, 3)
