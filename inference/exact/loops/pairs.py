"""What the weighted proposals for a group of limbs come to under many roots: the
group's evidence and draws. Given the lengths limbs are independent, so the mean over
the lengths of the products of the limbs' means is the evidence. Compiled."""

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.tables import AcceptedRows, Bodies


@compiled
def combine_rows(
    states: np.ndarray,
    first: AcceptedRows,
    second: AcceptedRows,
    lengths: np.ndarray,
    per_length: int,
    draws: Bodies,
) -> np.ndarray:
    """Draws of a group of two limbs under every root, and the group's evidence. A group
    of one has a second limb that explains everything, of which nothing is drawn.

    Parameters
    ----------
    states : `(n, 4)` of each root's random numbers, written on
    first, second : of the limbs
    lengths : `(2, n, draws)` of the bones
    per_length : proposals under each draw of the lengths
    draws : `(n · most, ...)` written on: as many of each root, alike in weight; left as
        they are where there is no evidence

    Returns
    -------
    `(n,)` the evidence under every root.
    """
    number = lengths.shape[2]
    most = len(draws.length) // len(states)
    pair = draws.upper.shape[1] == 2
    evidence = np.zeros(len(states))
    weight1 = np.empty(number)
    weight2 = np.empty(number)
    cumulated = np.empty(number)
    starts1 = np.empty(number + 1, np.int64)
    starts2 = np.empty(number + 1, np.int64)
    begin1 = begin2 = 0
    for row in range(len(states)):
        _sums(first.rows, begin1, first.ends[row], weight1, starts1)
        _sums(second.rows, begin2, second.ends[row], weight2, starts2)
        begin1 = first.ends[row]
        begin2 = second.ends[row]
        total = 0.0
        for draw in range(number):
            total += weight1[draw] * weight2[draw]
            cumulated[draw] = total
        evidence[row] = total / (number * float(per_length) ** 2)
        if total <= 0:
            continue
        stream = load(states[row])
        draw = 0
        # Systematic resampling: one random number, and levels at equal distances from
        # there on.
        offset, stream = uniform(stream)
        for n in range(most):
            while cumulated[draw] < total * (n + offset) / most and draw < number - 1:
                draw += 1
            while weight1[draw] * weight2[draw] <= 0:  # rounding, at the very end
                draw -= 1
            test, stream = uniform(stream)
            place = _picked(first.rows, starts1[draw], starts1[draw + 1], test * weight1[draw])
            _copy_limb(first.rows, place, draws, row * most + n, 0)
            # Drawn even where it is not used: a seed gives every group the same stream.
            test, stream = uniform(stream)
            if pair:
                place = _picked(second.rows, starts2[draw], starts2[draw + 1], test * weight2[draw])
                _copy_limb(second.rows, place, draws, row * most + n, 1)
            for bone in range(2):
                draws.length[row * most + n, bone] = lengths[bone, row, draw]
        store(states[row], stream)
    return evidence


@inlined
def _copy_limb(accepted: np.ndarray, place: int, draws: Bodies, row: int, limb: int) -> None:
    """Copies the directions of one limb's proposal into a draw."""
    entry = accepted[place]
    for axis in range(3):
        draws.upper[row, limb, axis] = entry.upper[axis]
        draws.lower[row, limb, axis] = entry.lower[axis]


@compiled
def _sums(accepted: np.ndarray, begin: int, end: int, sums: np.ndarray, starts: np.ndarray) -> None:
    """The sum of the weights under each draw of the lengths, and where in `accepted`
    each draw begins."""
    sums[:] = 0.0
    place = begin
    for draw in range(sums.size):
        starts[draw] = place
        while place < end and accepted[place].draw == draw:
            sums[draw] += accepted[place].weight
            place += 1
    starts[sums.size] = place


@compiled
def _picked(accepted: np.ndarray, begin: int, end: int, level: float) -> int:
    """Where the sum of the weights from `begin` on passes a level."""
    last = begin
    for place in range(begin, end):
        weight = accepted[place].weight
        if weight > 0:
            last = place
            if level < weight:
                return place
        level -= weight
    return last
