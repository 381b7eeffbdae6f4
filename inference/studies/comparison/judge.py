"""The verdict on a sampler: tests against exact draws, each with its sample size and what it takes
for granted.

Tests that need independent draws are given draws thinned by their measured autocorrelation. The
verdict holds all of them to one level (Holm's procedure): "differs", "agrees" (no difference was
found, and `power` says how large one would have been caught), "unmixed" where no test rejects but
the chains are still apart, so that their starts agree rather than they, or "cannot tell" where
there are too few effective draws to see anything. Chains that did not move differ without a test. A
stated evidence is judged beside the draws: it is another number, with an error of its own, and
neither makes the other right or wrong."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from poseterior.inference.studies.comparison.distances import (
    sliced_wasserstein,
    wasserstein,
)
from poseterior.inference.studies.comparison.mixing import CHAINS_APART, Mixing, mean_ess, mixing
from poseterior.inference.studies.comparison.modes import Modes, counts_by_mode, modes, same_shares
from poseterior.inference.studies.comparison.permutation import (
    PERMUTATIONS,
    classifier_test,
    permutation_tests,
)
from poseterior.inference.studies.comparison.power import SmallestSeen, seen
from poseterior.inference.studies.comparison.ranks import all_together, each_coordinate
from poseterior.inference.studies.comparison.sample import NAMES, Sample
from poseterior.inference.studies.intervals import permuted
from poseterior.probmodel.body import MILLIMETRES

JUDGE_LEVEL = 0.01
"""Chance that a sampler without fault is said to differ."""
FEWEST_EFFECTIVE_DRAWS = 100
"""Effective draws below which no agreement is claimed: a shift of 0.3 standard deviations would go
unseen."""
INDEPENDENT = 0.5
"""Draws are taken as independent if no autocorrelation is seen between neighbours and the worst
estimate of the effective size, which is noisy, is at least this share of their number."""
DIFFERS, AGREES, UNMIXED, CANNOT_TELL = "differs", "agrees", "unmixed", "cannot tell"


class Test(NamedTuple):
    """One test: its statistic, the p-value, the effective number of draws behind it, what it takes
    for granted, and how many permutations the p-value is from, where it is from any."""

    name: str
    statistic: float
    p_value: float
    size: float
    assumption: str
    permutations: int = 0

    @property
    def p_words(self) -> str:
        """The p-value in words."""
        if self.permutations:
            return permuted(self.p_value, self.permutations)
        return f"= {self.p_value:.2g}"


class Judgement(NamedTuple):
    """All that the judge found. `tests` of draws decide the verdict; `others` stand beside it.
    `evidence` is the test of the stated one, None where none was stated with its error; `seen` what
    these tests could have seen, None where there are none.
    `coordinate_p` `(c, 2)`: rank tests of shift and spread; `joint_w1` `(9,)`: W1 of the joints'
    depth in body units (× 350: millimetres of a person of 1.7 m); `distance`: sliced Wasserstein in
    standard deviations; `sentence` says why."""

    verdict: str
    sentence: str
    tests: tuple[Test, ...]
    others: tuple[Test, ...]
    mixing: Mixing
    modes: Modes
    coordinate_p: np.ndarray
    joint_w1: np.ndarray
    distance: float
    evidence: Test | None = None
    seen: SmallestSeen | None = None

    @property
    def beside(self) -> tuple[Test, ...]:
        """The tests that do not decide."""
        return self.others if self.evidence is None else (*self.others, self.evidence)

    @property
    def worst_millimetres(self) -> float:
        """The largest W1 of a joint's depth, for a person of 1.7 m."""
        return float(self.joint_w1.max() * MILLIMETRES)


def judge(
    sample: Sample,
    exact: Sample,
    *,
    seed: int = 0,
    evidence: tuple[float, float] = (math.nan, math.nan),
    exact_evidence: tuple[float, float] = (math.nan, math.nan),
    level: float = JUDGE_LEVEL,
    permutations: int = PERMUTATIONS,
    mode_counts: Mapping[int, float] | None = None,
) -> Judgement:
    """Judges draws against exact, independent ones of the same posterior.

    Parameters
    ----------
    evidence, exact_evidence
        Log evidence and its standard error, NaN where there is none; an evidence without an error
        is not judged.
    level
        Chance that a sampler without fault is said to differ.
    permutations
        Of the tests by energy distance and MMD.
    mode_counts
        As of `modes.counts_by_mode`.
    """
    rng = np.random.default_rng(seed)
    mixed = mixing(sample.values, exact.flat.std(axis=0))
    worst = _worst(sample, mixed)
    coordinate_p, ess = each_coordinate(sample.values, exact.flat)
    found = modes(
        sample.away.reshape(-1, sample.away.shape[-1]),
        exact.away.reshape(-1, exact.away.shape[-1]),
        worst,
    )
    tests: list[Test] = []
    others: list[Test] = []
    power = None
    if not mixed.stuck and worst >= FEWEST_EFFECTIVE_DRAWS:
        thinned = sample if _independent(sample, worst) else sample.rows(_stride(sample, worst))
        counts = counts_by_mode(
            thinned.away.reshape(thinned.num_draws, -1),
            exact.away.reshape(exact.num_draws, -1),
            mode_counts,
        )
        tests, others = _tests(thinned, exact, rng, permutations, counts)
        tests.append(_coordinates(coordinate_p, ess, sample.names))
        varying = np.where(np.isfinite(coordinate_p), ess, np.nan)
        power = seen(varying, exact.num_draws, counts, float(found.exact[0]), len(tests), level)
    verdict, sentence = _verdict(tests, mixed, worst, found, sample.num_draws, level, power)
    depth = [column for column, name in enumerate(NAMES) if name.endswith(" z")]
    joint_w1 = wasserstein(sample.flat[:, depth], exact.flat[:, depth])
    distance = sliced_wasserstein(sample.flat, exact.flat)
    return Judgement(
        verdict=verdict,
        sentence=sentence,
        tests=tuple(tests),
        others=tuple(others),
        mixing=mixed,
        modes=found,
        coordinate_p=coordinate_p,
        joint_w1=joint_w1,
        distance=distance,
        evidence=_evidence(evidence, exact_evidence),
        seen=power,
    )


def _worst(sample: Sample, mixed: Mixing) -> float:
    """The smallest effective size: of any coordinate, and of how often any bone points away."""
    if mixed.stuck or not np.isfinite(mixed.bulk).any():
        return 1.0
    flips = [
        mean_ess(sample.away[..., bone].astype(float)) for bone in range(sample.away.shape[-1])
    ]
    return float(min(np.nanmin(mixed.bulk), *flips))


def _independent(sample: Sample, worst: float) -> bool:
    number = sample.num_draws
    spread = sample.flat.std(axis=0)
    scaled = (sample.values - sample.flat.mean(axis=0)) / np.where(spread > 0, spread, np.inf)
    neighbours = (
        np.mean(scaled[:, 1:] * scaled[:, :-1], axis=(0, 1)) if scaled.shape[1] > 1 else np.ones(1)
    )
    return bool(neighbours.max() < 4 / math.sqrt(number) and worst >= INDEPENDENT * number)


def _stride(sample: Sample, worst: float) -> int:
    """Twice the autocorrelation time: what is left between neighbours is some percent."""
    return math.ceil(2 * sample.num_draws / worst)


def _tests(
    thinned: Sample,
    exact: Sample,
    rng: np.random.Generator,
    permutations: int,
    counts: np.ndarray,
) -> tuple[list[Test], list[Test]]:
    draws = thinned.flat
    known = exact.flat
    number = thinned.num_draws
    lengths = thinned.lengths
    rest = slice(lengths.stop, None)
    independent = "thinned draws are independent"
    tests = [
        Test(name, *found, number, independent, permutations)
        for name, found in permutation_tests(draws, known, rng, permutations).items()
    ]
    for name, part in (("ranks of lengths", lengths), ("ranks of joints", rest)):
        tests.append(
            Test(
                name,
                *all_together(draws[:, part], known[:, part]),
                number,
                f"{independent}; normal scores",
            )
        )
    tests.append(
        Test("modes", *same_shares(counts), number, f"{independent}; rare modes put together")
    )
    return tests, [Test("C2ST", *classifier_test(draws, known, rng), number, independent)]


def _coordinates(p_values: np.ndarray, ess: np.ndarray, names: tuple[str, ...]) -> Test:
    """The worst of all rank tests of single coordinates, corrected for their number."""
    worst = np.unravel_index(np.nanargmin(p_values), p_values.shape)
    number = int(np.isfinite(p_values).sum())
    name = f"ranks of {names[worst[0]]}, {('shift', 'spread')[worst[1]]}"
    corrected = min(1.0, float(p_values[worst] * number))
    assumption = (
        "means of ranks are normal, with the effective size measured on them; corrected for"
        f" {number} tests"
    )
    return Test(
        name, float(stats.norm.isf(p_values[worst] / 2)), corrected, float(ess[worst]), assumption
    )


def _evidence(evidence: tuple[float, float], exact: tuple[float, float]) -> Test | None:
    """Of log evidences with their standard errors; None where one of the four is not known."""
    if not np.isfinite([*evidence, *exact]).all():
        return None
    z = (evidence[0] - exact[0]) / math.hypot(evidence[1], exact[1])
    assumption = "log evidences are normal with the standard errors that they state"
    return Test("evidence", z, float(2 * stats.norm.sf(abs(z))), math.nan, assumption)


def _verdict(
    tests: list[Test],
    mixed: Mixing,
    worst: float,
    found: Modes,
    number: int,
    level: float,
    power: SmallestSeen | None = None,
) -> tuple[str, str]:
    if mixed.stuck:
        return (
            DIFFERS,
            (
                f"the chains did not move: {mixed.unique:.1%} of the draws are distinct, or a"
                " coordinate stood still"
            ),
        )
    worse = sorted(tests, key=lambda test: test.p_value)
    if (
        worse and worse[0].p_value * len(worse) < level
    ):  # Holm's first step decides whether anything differs
        test = worse[0]
        return DIFFERS, f"{test.name}: p {test.p_words} of {len(worse)} tests{_missed(found)}"
    if worst < FEWEST_EFFECTIVE_DRAWS:
        return (
            CANNOT_TELL,
            (
                f"only {worst:.0f} effective draws in the worst coordinate; at least"
                f" {FEWEST_EFFECTIVE_DRAWS} are needed: run some {_more(number, worst):,} more"
            ),
        )
    said = (
        f"no difference found by {len(worse)} tests at {level:g} with {worst:.0f} effective draws"
    )
    if power is not None:
        said += f"; {power.sentence}"
    if mixed.worst_rhat > CHAINS_APART:
        apart = f"R-hat {mixed.worst_rhat:.2f} says that the chains are still apart, run longer"
        return UNMIXED, f"{said}; but {apart}{_missed(found)}"
    return AGREES, f"{said}{_missed(found)}"


def _more(number: int, worst: float) -> int:
    """How many draws more would be effective enough, if they are worth what the first ones are: two
    digits, rounded up."""
    more = number * (FEWEST_EFFECTIVE_DRAWS / worst - 1)
    unit = 10 ** max(0, math.floor(math.log10(more)) - 1)
    return unit * math.ceil(more / unit)


def _missed(found: Modes) -> str:
    """What was never visited, beside what so few independent draws would have to leave out."""
    if not found.missed:
        return ""
    return (
        f"; {found.missed:.1%} of the mass in modes never visited, where as many independent draws"
        f" would miss {found.expected_missed:.1%}"
    )
