"""What attempts at the limbs of a group come to under many roots: the group's evidence and draws.
Given the lengths limbs are independent, so the mean over the lengths of the products of their means
is the evidence. Compiled."""

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.tables import Bodies


@compiled
def combine_rows(
    states: np.ndarray,
    first: np.ndarray,
    ends1: np.ndarray,
    second: np.ndarray,
    ends2: np.ndarray,
    lengths: np.ndarray,
    each: int,
    evidence: np.ndarray,
    draws: Bodies,
) -> None:
    """The evidence of a group of two limbs under every root, and draws of it. A group of one has a
    second limb that explains everything, of which nothing is drawn.

    Parameters
    ----------
    states : `(n, 4)` of each root's random numbers, written on
    first, ends1, second, ends2 : of both limbs, as `attempt_rows` left them
    lengths : `(2, n, trials)` of the bones
    each : attempts under each of the lengths
    evidence : `(n,)` written on
    draws : `(n · most, ...)` written on: as many of each root, alike in weight; left as they are
        where there is no evidence
    """
    trials, most, pair = (
        lengths.shape[2],
        len(draws.length) // len(states),
        draws.upper.shape[1] == 2,
    )
    one, two, product = np.empty(trials), np.empty(trials), np.empty(trials)
    from1, from2 = np.empty(trials + 1, np.int64), np.empty(trials + 1, np.int64)
    begin1, begin2 = 0, 0
    for row in range(len(states)):
        _sums(first, begin1, ends1[row], one, from1)
        _sums(second, begin2, ends2[row], two, from2)
        begin1, begin2 = ends1[row], ends2[row]
        total = 0.0
        for trial in range(trials):
            total += one[trial] * two[trial]
            product[trial] = total
        evidence[row] = total / (trials * float(each) ** 2)
        if total <= 0:
            continue
        stream, trial = load(states[row]), 0
        offset, stream = uniform(stream)
        for n in range(most):
            while product[trial] < total * (n + offset) / most and trial < trials - 1:
                trial += 1
            while one[trial] * two[trial] <= 0:  # rounding, at the very end
                trial -= 1
            test, stream = uniform(stream)
            place = _picked(first, from1[trial], from1[trial + 1], test * one[trial])
            _hand_over(first, place, draws, row * most + n, 0)
            test, stream = uniform(stream)
            if pair:
                place = _picked(second, from2[trial], from2[trial + 1], test * two[trial])
                _hand_over(second, place, draws, row * most + n, 1)
            for bone in range(2):
                draws.length[row * most + n, bone] = lengths[bone, row, trial]
        store(states[row], stream)


@inlined
def _hand_over(found: np.ndarray, place: int, draws: Bodies, row: int, limb: int) -> None:
    """Writes the directions of one limb's attempt into a draw."""
    entry, upper, lower = found[place], draws.upper, draws.lower
    for axis in range(3):
        upper[row, limb, axis] = entry.upper[axis]
        lower[row, limb, axis] = entry.lower[axis]


@compiled
def _sums(found: np.ndarray, begin: int, end: int, sums: np.ndarray, starts: np.ndarray) -> None:
    """The weights of each trial, summed, and where in `found` each begins."""
    sums[:] = 0.0
    place = begin
    for trial in range(sums.size):
        starts[trial] = place
        while place < end and found[place].trial == trial:
            sums[trial] += found[place].weight
            place += 1
    starts[sums.size] = place


@compiled
def _picked(found: np.ndarray, begin: int, end: int, level: float) -> int:
    """Where the sum of the weights from `begin` on passes a level."""
    place, last = begin, begin
    while place < end:
        weight = found[place].weight
        if weight > 0:
            last = place
            if level < weight:
                return place
        level -= weight
        place += 1
    return last
