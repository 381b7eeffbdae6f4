"""The two moons, a task of simulation-based inference (Lueckmann et al. 2021), in NumPy.

    parameters, seen = simulated(100, rng)
    draws = exact_moons(seen[0], 1000, rng)     # of the posterior, in closed form

Two parameters are uniform from -1 to 1."""

import numpy as np

NAMES, SEEN, EDGE = ("first", "second"), ("seen 0", "seen 1"), 1.0
RADIUS, SPREAD, AHEAD = 0.1, 0.01, 0.25
"""Of the crescent: its normal radius, and how far ahead its centre lies."""
Rng = np.random.Generator


def simulated(number: int, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `(number, 2)` of the prior, and data `(number, 2)` of each."""
    parameters = rng.uniform(-EDGE, EDGE, (number, 2))
    return parameters, _turned(parameters) + _crescent(number, rng)


def _turned(parameters: np.ndarray) -> np.ndarray:
    """Parameters `(n, 2)` turned by 45 degrees, of the first coordinate the size alone."""
    first, second = parameters.T
    return np.stack([-np.abs(first + second), second - first], axis=1) / np.sqrt(2)


def _crescent(number: int, rng: Rng) -> np.ndarray:
    angle = rng.uniform(-np.pi / 2, np.pi / 2, number)
    radius = rng.normal(RADIUS, SPREAD, number)
    return np.stack([radius * np.cos(angle) + AHEAD, radius * np.sin(angle)], axis=1)


def exact_moons(seen: np.ndarray, number: int, rng: Rng) -> np.ndarray:
    """`(number, 2)`: exact draws given data `(2,)`: a point of the crescent and a sign that was
    lost, turned back, and rejected outside the box."""
    found = np.empty((0, 2))
    while len(found) < number:
        size, across = (seen - _crescent(4 * number, rng)).T
        signed = rng.choice([-1, 1], len(size)) * size
        parameters = np.stack([signed - across, signed + across], axis=1) / np.sqrt(2)
        kept = (size <= 0) & (np.abs(parameters) <= EDGE).all(axis=1)
        found = np.concatenate([found, parameters[kept]])
    return found[:number]


def moons_radius(parameters: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """`(n,)`: the radius in the crescent that explains data `(2,)` by parameters `(n, 2)`; NaN
    behind the crescent."""
    ahead, beside = (seen - _turned(parameters)).T
    return np.where(ahead > AHEAD, np.hypot(ahead - AHEAD, beside), np.nan)


def log_likelihood_moons(parameters: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """`(n,)`: log density of data `(2,)` up to a constant, of parameters `(n, 2)`."""
    radius = moons_radius(parameters, seen)
    density = -0.5 * ((radius - RADIUS) / SPREAD) ** 2 - np.log(radius)
    return np.where(np.isnan(radius), -np.inf, density)
