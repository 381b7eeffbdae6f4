"""Levels by what a classifier has learned: it is shown truths and draws, with the covariates, of
half of the instances, and ranks truths among draws of the other half by how much they look like
truths.

Whatever it has learned, a right posterior's ranks are uniform on instances that it has not seen;
so the test is exact, where C2ST's own statistic (Linhart et al. 2023) needs a null by training many
times."""

from collections.abc import Sequence

import numpy as np

from poseterior.inference.studies.judging.brought import One
from poseterior.inference.studies.judging.where import Columns
from poseterior.inference.studies.levels import effective_number, rank_level

FEWEST_TO_LEARN_FROM = 50
TAUGHT_DRAWS = 8
"""Draws of an instance beside its truth, to learn from."""
RANKED_DRAWS = 200
"""Of an instance, at most."""
ROUNDS_OF_TREES = 60
LEAVES = 4
"""Of a tree; deeper ones learn the noise of some hundred instances."""
MOST_MULTIPLIED = 8
"""Quantities, the first of them, whose products are shown too: a tree does not see by itself what
two have in common."""


def learned_levels(shown: Sequence[np.ndarray | None], seed: int) -> np.ndarray:
    """`(instances,)` of `features` of each: NaN of those that were learned from, of those without
    any, and of all where the former are fewer than `FEWEST_TO_LEARN_FROM`."""
    rng = np.random.default_rng([seed, 1, 3])
    found = np.full(len(shown), np.nan)
    known = {row: part for row, part in enumerate(shown) if part is not None}
    taught, asked = np.split(rng.permutation(list(known)), [len(known) // 2])
    if len(taught) < FEWEST_TO_LEARN_FROM:
        return found
    from sklearn.ensemble import HistGradientBoostingClassifier

    lessons = [known[row][: 1 + TAUGHT_DRAWS] for row in taught]
    is_truth = np.concatenate([np.arange(len(lesson)) == 0 for lesson in lessons])
    learner = HistGradientBoostingClassifier(
        max_iter=ROUNDS_OF_TREES, max_leaf_nodes=LEAVES, random_state=seed, early_stopping=False
    )
    learner.fit(np.concatenate(lessons), is_truth)
    exams = [known[row] for row in asked]
    marks = learner.decision_function(np.concatenate(exams))
    ends = np.cumsum([len(exam) for exam in exams])[:-1]
    for row, mark in zip(asked, np.split(marks, ends), strict=True):
        found[row] = float(rank_level(mark[0], mark[1:], rng))
    return found


def features(one: One, context: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`(1 + RANKED_DRAWS or fewer, f)`: the truth, then draws as their weights have it: as they
    are, by mean and spread of all, and with the covariates `(c,)`. Nothing tells the truth from
    the draws."""
    weights = np.ones(len(one.draws)) if one.weights is None else one.weights
    share = weights / weights.sum()
    worth = effective_number(weights)
    rows = rng.choice(len(one.draws), min(RANKED_DRAWS, int(worth)), replace=False, p=share)
    each = np.concatenate([[1.0], worth * share])
    everything = np.vstack([one.truth, one.draws])
    middle = np.average(everything, axis=0, weights=each)
    spread = np.sqrt(np.average((everything - middle) ** 2, axis=0, weights=each))
    some = everything[np.concatenate([[0], 1 + rows])]
    alike = (some - middle) / np.where(spread > 0, spread, 1.0)
    left, right = np.triu_indices(min(alike.shape[1], MOST_MULTIPLIED))
    products = alike[:, left] * alike[:, right]
    return np.hstack([some, alike, products, np.broadcast_to(context, (len(some), len(context)))])


def as_numbers(covariates: Columns, size: int) -> np.ndarray:
    """`(size, c)`: words by their place in the alphabet."""
    columns = [
        column if column.dtype.kind in "biuf" else np.unique(column, return_inverse=True)[1]
        for column in covariates.values()
    ]
    return np.column_stack(columns).astype(float) if columns else np.empty((size, 0))
