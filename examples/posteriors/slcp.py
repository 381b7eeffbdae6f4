"""SLCP, a task of simulation-based inference with a simple likelihood and a complex posterior
(Papamakarios, Sterratt & Murray 2019; Lueckmann et al. 2021), in NumPy.

    parameters, seen = simulated(100, rng)
    draws = exact_slcp(seen[0], 1000, rng)      # of the posterior, in closed form

Five parameters are uniform from -3 to 3: the middle of four Gaussian points in the plane, the
roots of their two standard deviations (either sign will do: four modes), and the inverse
hyperbolic tangent of their correlation. What is seen is what suffices: the points' middle, the
logarithms of their standard deviations, and the inverse hyperbolic tangent of their correlation."""

import numpy as np

POINTS, EDGE = 4, 3.0
NAMES = ("middle across", "middle up", "root across", "root up", "angle")
SEEN = ("across", "up", "spread across", "spread up", "slant")
FREEDOM = 2.5
"""Of the inverse Wishart law: the prior has the density ``|S|^(-5/4) (1 - r^2)^(1/4)`` in the
covariance."""
Rng = np.random.Generator


def simulated(number: int, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `(number, 5)` of the prior, and data `(number, 5)` of each."""
    parameters = rng.uniform(-EDGE, EDGE, (number, 5))
    spread = parameters[:, None, 2:4] ** 2
    slant = np.tanh(parameters[:, 4, None])
    first, second = rng.normal(size=(2, number, POINTS))
    second = slant * first + np.sqrt(1 - slant**2) * second
    points = parameters[:, None, :2] + spread * np.stack([first, second], axis=2)
    return parameters, _seen(points)


def _seen(points: np.ndarray) -> np.ndarray:
    """`(n, 5)` of points `(n, POINTS, 2)`."""
    off = points - points.mean(axis=1, keepdims=True)
    spread = np.sqrt((off**2).mean(axis=1))
    slant = np.arctanh(off.prod(axis=2).mean(axis=1) / spread.prod(axis=1))
    return np.column_stack([points.mean(axis=1), np.log(spread), slant])


def exact_slcp(seen: np.ndarray, number: int, rng: Rng) -> np.ndarray:
    """`(number, 5)`: exact draws given data `(5,)`: covariances of an inverse Wishart law, middles
    given these, and signs that were lost, rejected outside the box and by what the prior of the
    correlation lacks."""
    spread = np.exp(seen[2:4])
    scatter = POINTS * np.outer(spread, spread)
    scatter[[0, 1], [1, 0]] *= np.tanh(seen[4])
    whiten = np.linalg.inv(np.linalg.cholesky(scatter))
    found = np.empty((0, 5))
    while len(found) < number:
        tried = 16 * number
        lower = np.zeros((tried, 2, 2))  # Bartlett's factor of a standard Wishart law
        lower[:, [0, 1], [0, 1]] = np.sqrt(rng.chisquare([FREEDOM, FREEDOM - 1], (tried, 2)))
        lower[:, 1, 0] = rng.normal(size=tried)
        root = np.linalg.inv(whiten.T @ lower)
        sizes = np.sqrt((root**2).sum(axis=1))
        slant = root.prod(axis=2).sum(axis=1) / sizes.prod(axis=1)
        slant *= 1 - 1e-12  # rounding must not bring it to 1
        off = np.einsum("nji,nj->ni", root, rng.normal(size=(tried, 2)))
        middle = seen[:2] + off / np.sqrt(POINTS)
        signed = rng.choice([-1, 1], (tried, 2)) * np.sqrt(sizes)
        parameters = np.column_stack([middle, signed, np.arctanh(slant)])
        kept = rng.uniform(size=tried) < (1 - slant**2) ** 0.25
        kept &= (np.abs(parameters) <= EDGE).all(axis=1)
        found = np.concatenate([found, parameters[kept]])
    return found[:number]
