"""A posterior in closed form, on which the tests themselves are tried: three correlated Gaussian
numbers, seen with Gaussian noise."""

import numpy as np

from poseterior.inference.studies.calibration.uniformity import uniformity
from poseterior.inference.studies.levels import distance_level, energy_level, rank_level

TESTS = ("ranks", "highest density", "energy balls", "TARP")
TOY_SEED = 7


class Toy:
    """`number` simulations with `draws` of the posterior each."""

    mix = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.3, -0.4, np.sqrt(0.75)]])
    noise = 0.7

    def __init__(self, number: int, draws: int, rng: np.random.Generator) -> None:
        prior = self.mix @ self.mix.T
        gain = prior @ np.linalg.inv(prior + self.noise**2 * np.eye(3))
        self.covariance = prior - gain @ prior
        self.truth = rng.normal(size=(number, 3)) @ self.mix.T
        self.seen = self.truth + self.noise * rng.normal(size=(number, 3))
        root = np.linalg.cholesky(self.covariance)
        self.mean = self.seen @ gain.T
        self.draws = self.mean[:, None] + rng.normal(size=(number, draws, 3)) @ root.T
        self.prior_draws = rng.normal(size=(number, draws, 3)) @ self.mix.T

    def p_values(self, draws: np.ndarray, rng: np.random.Generator) -> dict[str, float]:
        """Of the four kinds of tests: ranks of a coordinate, highest density, energy balls,
        TARP."""
        inverse = np.linalg.inv(self.covariance)
        levels: dict[str, list[float]] = {name: [] for name in TESTS}
        for truth, cloud, mean, seen in zip(self.truth, draws, self.mean, self.seen, strict=True):
            both = np.vstack([truth, cloud])
            density = -np.einsum("ni,ij,nj->n", both - mean, inverse, both - mean)
            levels["ranks"].append(float(rank_level(truth[0], cloud[:, 0], rng)))
            levels["highest density"].append(float(rank_level(density[0], density[1:], rng)))
            levels["energy balls"].append(float(energy_level(truth, cloud, rng)))
            levels["TARP"].append(float(distance_level(truth, cloud, seen + 0.5, rng)))
        return {name: uniformity(np.array(found)).p_value for name, found in levels.items()}


def sizes(repetitions: int, number: int, draws: int) -> dict[str, np.ndarray]:
    """p-values `(repetitions,)` of right posteriors, by kind of test."""
    found: dict[str, list[float]] = {}
    for repetition in range(repetitions):
        rng = np.random.default_rng([TOY_SEED, repetition])
        toy = Toy(number, draws, rng)
        for name, p_value in toy.p_values(toy.draws, rng).items():
            found.setdefault(name, []).append(p_value)
    return {name: np.array(values) for name, values in found.items()}
