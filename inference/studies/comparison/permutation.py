"""Permutation tests that two sets of independent draws have one law, by energy distance and by MMD;
and C2ST.

They are exact for independent draws: draws of a chain have to be thinned first until they are
nearly so."""

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from poseterior.inference.studies.comparison.distances import (
    energy,
    in_spreads,
    mmd,
    pairwise,
)

PERMUTATIONS = 999
MOST_PERMUTED = 2000
"""Draws of either side that take part at most; the cost grows with the square."""


def permutation_tests(
    draws: np.ndarray, exact: np.ndarray, rng: np.random.Generator, permutations: int = PERMUTATIONS
) -> dict[str, tuple[float, float]]:
    """By name ("energy", "mmd"): the statistic and its p-value, for draws `(n, c)` and `(m, c)`.

    Both are divided by the standard deviation of both together, which does not know whose is whose:
    of one side alone, permutations would be no equals of what was observed."""
    one, other = _some(draws, rng), _some(exact, rng)
    one, other = in_spreads(one, other, np.concatenate([one, other]).std(axis=0))
    distance = pairwise(one, other)
    labels = np.arange(len(distance)) < len(one)
    shuffled = np.stack([labels, *(rng.permutation(labels) for _ in range(permutations))])
    found = {}
    for name, statistic in (("energy", energy), ("mmd", mmd)):
        values = statistic(distance, shuffled)
        found[name] = (float(values[0]), float(np.mean(values >= values[0])))
    return found


def classifier_test(
    draws: np.ndarray, exact: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """C2ST: how often a classifier trained on half of the draws tells the other half apart, and the
    binomial p-value (Lopez-Paz & Oquab 2017). Weak in many dimensions; reported for those who know
    it."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    number = min(len(draws), len(exact), MOST_PERMUTED)
    rows = np.concatenate([_some(draws, rng, number), _some(exact, rng, number)])
    labels = np.arange(len(rows)) < number
    order = rng.permutation(len(rows))
    train, held_out = np.split(order, [len(order) // 2])
    classifier = HistGradientBoostingClassifier(max_iter=50, random_state=int(rng.integers(2**31)))
    # For so small a problem, many threads spend their time waiting for each other.
    with threadpool_limits(1, user_api="openmp"):
        classifier.fit(rows[train], labels[train])
        found = classifier.predict(rows[held_out])
    right = int(np.sum(found == labels[held_out]))
    # Guessing the commoner label of the other half cannot help: it is the rarer one here.
    return right / len(held_out), float(stats.binom.sf(right - 1, len(held_out), 0.5))


def _some(draws: np.ndarray, rng: np.random.Generator, most: int = MOST_PERMUTED) -> np.ndarray:
    return draws if len(draws) <= most else draws[rng.choice(len(draws), most, replace=False)]
