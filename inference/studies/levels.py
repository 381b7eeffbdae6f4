"""Where the truth stands among draws, as one number from 0 to 1 that is uniform if truth and draws
have one law.

Three ways to line draws up, for one simulation each; whatever the way, truth and draws are
exchangeable given what was seen, so the truth's rank is uniform (Cook, Gelman & Rubin 2006; Talts
et al. 2018; Modrák et al. 2023): by a quantity, by the distance from a point that what was seen
decides (TARP, Lemos et al. 2023), or by how far out in the cloud of the draws (energy balls). Plain
arrays throughout; nothing here knows what a pose is."""

import numpy as np
from scipy.spatial.distance import cdist

from poseterior.inference.resampling import effective

CENTRES = 100
"""Draws of which energy balls are made, at most a third; the others are ranked."""


def rank_level(
    truth: np.ndarray,
    draws: np.ndarray,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
) -> np.ndarray:
    """`(q,)`: the rank of values `(q,)` among those of the draws `(n, q)`, spread evenly over its
    step.

    Ties are broken at random, so that also discrete quantities have uniform levels. NaN counts as a
    value below all. Draws with `weights` `(n,)` count by them, and all together for as many as
    their effective number (`effective_number`), of which the truth is one more. Raises `ValueError`
    where the shapes do not fit."""
    truth = np.asarray(truth, float)
    draws = np.asarray(draws, float)
    if draws.ndim != truth.ndim + 1 or draws.shape[1:] != truth.shape or not len(draws):
        raise ValueError(f"draws of shape {draws.shape} cannot rank a truth of shape {truth.shape}")
    truth, draws = (np.where(np.isnan(part), -np.inf, part) for part in (truth, draws))
    if weights is None:
        number = float(len(draws))
        below = (draws < truth).sum(axis=0)
        ties = (draws == truth).sum(axis=0)
    else:
        number = effective_number(weights)
        each = number * weights / weights.sum()
        below = np.tensordot(each, draws < truth, axes=1)
        ties = np.tensordot(each, draws == truth, axes=1)
    level = (below + rng.uniform(size=truth.shape) * (ties + 1)) / (number + 1)
    return np.minimum(level, 1.0)  # sums of weights are rounded


def effective_number(weights: np.ndarray) -> float:
    """How many draws of equal weight are worth as much as those of these weights (Kish 1965)."""
    return effective(weights / weights.sum())


def cut_open(
    truth: np.ndarray, draws: np.ndarray, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Angles `(q,)` and `(n, q)`, radians, as signed arcs from the mean direction of draws and
    truth together, of which the truth is one: the circle is cut where they are rarest, by a rule
    that does not tell the truth from the draws, so that ranks of arcs are uniform."""
    weights = np.ones(len(draws)) if weights is None else weights
    each = effective_number(weights) * weights / weights.sum()
    towards = np.tensordot(each, np.exp(1j * draws), axes=1) + np.exp(1j * truth)
    arcs = np.angle(np.exp(1j * np.vstack([truth, draws])) * np.conj(towards))
    return arcs[0], arcs[1:]


def distance_level(
    truth: np.ndarray,
    draws: np.ndarray,
    reference: np.ndarray,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
) -> float:
    """TARP: the rank of the distance from a `reference` `(d,)`, which may depend on what was seen,
    never on truth or draws; `truth` `(d,)`, `draws` `(n, d)`."""
    far = np.linalg.norm(np.vstack([truth, draws]) - reference, axis=1)
    return float(rank_level(far[0], far[1:], rng, weights))


def energy_level(
    truth: np.ndarray,
    draws: np.ndarray,
    rng: np.random.Generator,
    weights: np.ndarray | None = None,
) -> float:
    """The rank of the mean distance to some of the draws (they make the ball, the others are
    ranked): the share of the posterior in the smallest ball {x: E|x - X| ≤ r} that holds the truth.
    `draws` `(n, d)`, three at least, and their `weights` `(n,)` where they have any."""
    number = min(CENTRES, len(draws) // 3)
    order = rng.permutation(len(draws))
    ball = order[:number]
    rest = order[number:]
    far = cdist(np.vstack([truth, draws[rest]]), draws[ball])
    if weights is None:
        mean = far.mean(axis=1)
        return float(rank_level(mean[0], mean[1:], rng))
    mean = np.average(far, axis=1, weights=weights[ball])
    return float(rank_level(mean[0], mean[1:], rng, weights[rest]))


def median_levels(truth: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """`(j,)`: for each joint the share of draws `(n, j, a)` nearer to the draws' coordinate-wise
    median than the truth `(j, a)` is: the quantile at which the truth begins to be covered
    (Pierzchlewicz et al. 2022)."""
    middle = np.median(draws, axis=0)
    return np.mean(
        np.linalg.norm(draws - middle, axis=-1) < np.linalg.norm(truth - middle, axis=-1), axis=0
    )


def stand_in_levels(draws: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """`(rows, j)`: what `median_levels` gives when draws of some rows stand in for the truth: how
    calibrated a right posterior would look with so many instances."""
    far = np.linalg.norm(draws - np.median(draws, axis=0), axis=-1)
    return np.mean(far[None] < far[rows][:, None], axis=1) * len(draws) / (len(draws) - 1)
