"""Where a posterior fails: do the levels of its truths depend on covariates?

    found = locally(levels, {"angle": angle, "score": score})
    found.sentence          # "wrist depth: 50 % intervals hold 31 % … where angle > 61 …"

If a posterior is right given what was seen, levels are uniform and independent of everything that
what was seen decides. So they may be exchanged between instances at will, and that is the test:
the largest deviation over the leaves of all trees of one or two splits, against the same after
permutations of the instances. It is exact at every size, whatever the quantities do with each
other, and needs independent instances. `curves` has the map: coverage by bins of one covariate."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import stats

from poseterior.inference.studies.intervals import Interval, permuted
from poseterior.probmodel.failures import BadInput

PERMUTATIONS = 999
SPLITS = (1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6)
"""Quantiles of a covariate at which it is split; of the two of a tree of two splits the middle
three."""
MOST_CLASSES = 6
"""A covariate with no more values, or of words, is split by value."""
SMALLEST_LEAF = 0.05
"""Of the instances; a smaller leaf would say nothing. At least `FEWEST_IN_LEAF`."""
FEWEST_IN_LEAF = 10
MOST_LEAVES = 400
"""Above, two splits are tried at the medians only."""
BINS = 5
SHOWN = (0.5, 0.8, 0.95)
"""Nominal coverage of the map's curves."""
NAMED = 0.05
"""Chance at which a quantity's deviation is large enough for it to be named before others."""
TOGETHER = 32
"""Permutations at a time."""
Columns = Mapping[str, np.ndarray]
"""Covariates `(n,)` by name, numbers or words."""


class Leaf(NamedTuple):
    """A part of the instances, in words and as a mask `(n,)`."""

    words: str
    inside: np.ndarray


class Locally(NamedTuple):
    """What the test of where says.

    Attributes
    ----------
    p_value, p_words
        Of all leaves and quantities together, by permutations; the same in words.
    leaf
        The part of the instances that deviates most.
    quantity
        What deviates there.
    covered, elsewhere
        What central intervals of 50 % hold there, and of all others.
    sentence
        The same in words.
    """

    p_value: float
    p_words: str
    leaf: Leaf
    quantity: str
    covered: Interval
    elsewhere: Interval
    sentence: str


def locally(
    levels: xr.DataArray, covariates: Columns, seed: int = 0, foremost: Sequence[str] = ()
) -> Locally:
    """Tests whether levels (simulation, quantity) depend on covariates; rows of NaN are left out.
    Where single levels are missing, a leaf is compared with the others that are known; the test is
    exact as long as which are missing does not depend on covariates.

    One of the quantities `foremost` is named where any of them deviates by itself too. Raises
    `BadInput` where a covariate has one value alone, a NaN or another length, or where there are
    too few instances to be parted."""
    columns = checked(covariates, levels.sizes["simulation"])
    levels = levels.dropna("quantity", how="all")
    known = np.isfinite(levels.values).any(axis=1)
    columns = {name: column[known] for name, column in columns.items()}
    values = levels.values[known]
    leaves = list(leaves_of(columns))
    if not leaves:
        raise BadInput(
            f"{len(values)} instances are too few to say where; parts of fewer than"
            f" {FEWEST_IN_LEAF} say nothing, so give at least {4 * FEWEST_IN_LEAF}"
        )
    score = np.concatenate([_sides(values), _widths(values)], axis=1)
    inside = np.stack([leaf.inside for leaf in leaves])
    deviation = _deviation(inside, _unit(score), np.isfinite(score))
    if not deviation.any():
        raise BadInput(
            "no part of the instances can be compared with the others: too few of the same"
            " quantities are known in both"
        )
    largest = _after_permutations(inside, score, np.random.default_rng(seed))
    p_value = (1 + (largest >= deviation.max() * (1 - 1e-6)).sum()) / (1 + len(largest))
    first = np.tile(np.isin(levels.quantity.values, list(foremost)), 2)
    if (deviation[:, first] > np.quantile(largest, 1 - NAMED)).any():
        deviation = np.where(first, deviation, 0.0)
    row, column = (int(at) for at in np.unravel_index(np.argmax(deviation), deviation.shape))
    quantity = column % values.shape[1]
    name = str(levels.quantity.values[quantity])
    sided = column < values.shape[1]
    words = permuted(float(p_value), len(largest))
    covered, elsewhere, said = _told(leaves[row], values[:, quantity], sided)
    sentence = f"{name}: {said} (p {words} over all parts and quantities)"
    return Locally(
        p_value=float(p_value),
        p_words=words,
        leaf=leaves[row],
        quantity=name,
        covered=covered,
        elsewhere=elsewhere,
        sentence=sentence,
    )


def checked(covariates: Columns, size: int) -> dict[str, np.ndarray]:
    """The covariates as arrays `(size,)`. Raises `BadInput` as `locally`."""
    found = {}
    for name, values in covariates.items():
        column = np.asarray(values)
        if column.dtype.kind not in "biufUS":
            column = column.astype(str)
        if column.shape != (size,):
            raise BadInput(
                f"the covariate {name} has shape {column.shape} for {size} instances; give each"
                " instance one value"
            )
        if column.dtype.kind == "f" and not np.isfinite(column).all():
            raise BadInput(
                f"the covariate {name} is not finite for {int((~np.isfinite(column)).sum())} of"
                f" {size} instances; leave these out, or give them a value of their own"
            )
        if len(np.unique(column)) == 1:
            raise BadInput(
                f"the covariate {name} has one value, {column[0]}, for all instances; nothing can"
                " depend on it, so leave it out"
            )
        found[name] = column
    return found


def leaves_of(columns: Columns) -> Iterator[Leaf]:
    """The leaves of all trees of one and two splits, without those that are too small."""
    size = len(next(iter(columns.values())))
    fewest = max(FEWEST_IN_LEAF, int(np.ceil(SMALLEST_LEAF * size)))
    single = {name: list(_parts(name, column, SPLITS)) for name, column in columns.items()}
    pairs = list(_crossed(columns, SPLITS[1:-1]))
    if len(pairs) > MOST_LEAVES:
        pairs = list(_crossed(columns, SPLITS[2:3]))
    for leaf in [*(leaf for parts in single.values() for leaf in parts), *pairs]:
        if fewest <= leaf.inside.sum() <= size - fewest:
            yield leaf


def _crossed(columns: Columns, splits: tuple[float, ...]) -> Iterator[Leaf]:
    parts = {name: list(_parts(name, column, splits)) for name, column in columns.items()}
    for first, second in combinations(parts.values(), 2):
        for one in first:
            for other in second:
                both = one.inside & other.inside
                if not any((both == alone.inside).all() for alone in (one, other)):
                    yield Leaf(f"{one.words} and {other.words}", both)


def _parts(name: str, column: np.ndarray, splits: tuple[float, ...]) -> Iterator[Leaf]:
    """The two sides of each split; of few values or words, each value."""
    if by_value(column):
        for value in np.unique(column):
            yield Leaf(f"{name} is {value}", column == value)
        return
    for edge in np.unique(np.quantile(column, splits)):
        yield Leaf(f"{name} ≤ {edge:.3g}", column <= edge)
        yield Leaf(f"{name} > {edge:.3g}", column > edge)


def by_value(column: np.ndarray) -> bool:
    """Whether a covariate is split by value, not at quantiles."""
    return column.dtype.kind in "bUS" or len(np.unique(column)) <= MOST_CLASSES


def _sides(levels: np.ndarray) -> np.ndarray:
    """On which side of the draws' middle the truth lies: of mean 0 and variance 1 if uniform."""
    return np.sqrt(3) * (2 * levels - 1)


def _widths(levels: np.ndarray) -> np.ndarray:
    """How far out it lies: the next Legendre polynomial."""
    return np.sqrt(5) * (6 * levels**2 - 6 * levels + 1)


def _unit(score: np.ndarray) -> np.ndarray:
    """Columns of mean 0 and deviation 1 over what is known of them, 0 where nothing is."""
    centred = score - np.nanmean(score, axis=0)
    return np.nan_to_num(centred / np.maximum(np.nanstd(score, axis=0), 1e-12))


def _deviation(inside: np.ndarray, unit: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`(leaf, column)`: sizes of the sums of columns of `_unit` in leaves, in deviations that they
    have where instances are exchanged; 0 where a leaf knows too few, or knows all."""
    inside = inside.astype(unit.dtype)
    if known.all():
        total, here = known.shape[0], inside.sum(axis=1, keepdims=True)
    else:
        total, here = known.sum(axis=0), inside @ known.astype(unit.dtype)
    spread = np.sqrt(np.maximum(here * (total - here) / total, 1))
    enough = np.minimum(here, total - here) >= FEWEST_IN_LEAF
    return np.where(enough, np.abs(inside @ unit) / spread, 0)


def _after_permutations(
    inside: np.ndarray, score: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """`(PERMUTATIONS,)`: the largest deviation when instances are exchanged."""
    unit, known = _unit(score).astype(np.float32), np.isfinite(score)
    found: list[np.ndarray] = []
    for first in range(0, PERMUTATIONS, TOGETHER):
        number = min(TOGETHER, PERMUTATIONS - first)
        order = np.stack([rng.permutation(len(unit)) for _ in range(number)], axis=1)
        shuffled = (one[order].reshape(len(unit), -1) for one in (unit, known))
        deviation = _deviation(inside, *shuffled)
        found.append(deviation.reshape(len(inside), number, -1).max(axis=(0, 2)))
    return np.concatenate(found)


def share_held(held: np.ndarray, tail: float = 0.05) -> Interval:
    """How often something holds, of independent trials `(n,)`, with the interval of Clopper and
    Pearson (1934) that misses with chance `tail` at most."""
    hits = int(held.sum())
    misses = len(held) - hits
    low = stats.beta.ppf(tail / 2, hits, misses + 1) if hits else 0.0
    high = stats.beta.isf(tail / 2, hits + 1, misses) if misses else 1.0
    return Interval(float(held.mean()), float(low), float(high))


def central(levels: np.ndarray, nominal: float) -> np.ndarray:
    """Whether central intervals of a nominal level hold the truth, of levels `(n,)`."""
    return np.abs(2 * levels - 1) <= nominal


def _told(leaf: Leaf, levels: np.ndarray, sided: bool) -> tuple[Interval, Interval, str]:
    """What intervals of 50 % hold in a leaf, and elsewhere; and what deviates there, in words."""
    known = np.isfinite(levels)
    here = levels[leaf.inside & known]
    there = levels[~leaf.inside & known]
    covered = share_held(central(here, 0.5))
    elsewhere = share_held(central(there, 0.5))
    if sided:
        said = (
            f"the truth lies below the draws' median in {_percent(share_held(here < 0.5))} of"
            f" {len(here)} instances where {leaf.words}, in {np.mean(there < 0.5):.0%} elsewhere"
        )
    else:
        width = "too narrow" if covered.value < 0.5 else "too wide"
        if covered.low <= 0.5 <= covered.high:
            width = "unlike elsewhere"
        said = (
            f"50 % intervals hold {_percent(covered)} of {len(here)} instances where {leaf.words},"
            f" {elsewhere.value:.0%} elsewhere: {width} there"
        )
    return covered, elsewhere, said


def _percent(share: Interval) -> str:
    return f"{share.value:.0%} ({share.low:.0%}–{share.high:.0%})"


def curves(levels: xr.DataArray, covariates: Columns) -> xr.Dataset:
    """The map: `share`, `low`, `high` of central intervals by (covariate, quantity, nominal, bin),
    with what each bin is in `words`; NaN where there are fewer bins. The bins of a curve keep 95 %
    all together (Bonferroni)."""
    columns = checked(covariates, levels.sizes["simulation"])
    shape = (len(columns), levels.sizes["quantity"], len(SHOWN), MOST_CLASSES)
    numbers = np.full((3, *shape), np.nan)
    words = np.full((len(columns), MOST_CLASSES), "", dtype="<U60")
    for row, (name, column) in enumerate(columns.items()):
        bins = list(bins_of(name, column))
        for place, one in enumerate(bins):
            words[row, place] = one.words
            for number, values in enumerate(levels.values[one.inside].T):
                values = values[np.isfinite(values)]
                for at, nominal in enumerate(SHOWN if len(values) else ()):
                    held = share_held(central(values, nominal), 0.05 / len(bins))
                    numbers[:, row, number, at, place] = held
    dims = ("covariate", "quantity", "nominal", "bin")
    data = {key: (dims, numbers[at]) for at, key in enumerate(("share", "low", "high"))}
    coords = {
        "covariate": list(columns),
        "quantity": levels.quantity.values,
        "nominal": list(SHOWN),
    }
    return xr.Dataset(data | {"words": (("covariate", "bin"), words)}, coords=coords)


def bins_of(name: str, column: np.ndarray) -> Iterator[Leaf]:
    """Values one by one (the commonest), or bins of as many instances each."""
    if by_value(column):
        known, count = np.unique(column, return_counts=True)
        for value in np.sort(known[np.argsort(-count, kind="stable")[:MOST_CLASSES]]):
            yield Leaf(f"{value}", column == value)
        return
    edges = np.unique(np.quantile(column, np.arange(1, BINS) / BINS))
    place = np.searchsorted(edges, column)  # a value on an edge lies below it
    ends = [f"≤ {edges[0]:.3g}", *(f"≤ {edge:.3g}" for edge in edges[1:]), f"> {edges[-1]:.3g}"]
    for number, words in enumerate(ends):
        if (place == number).any():
            yield Leaf(words, place == number)
