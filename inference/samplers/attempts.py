"""The draw–project–test loop over strata. Compiled; in body units.

Bins of lengths are visited in order, so that their tables stay in the nearest cache; in each bin all attempts draw
lengths, then the first limb, then, where that explains its detections, the second. An attempt draws a stratum, an upper
direction in its sub-cell, asks whether the joint lies in its disc, draws a lower direction in the stratum's region, and
asks for the rest. What passes is a draw of the prior that passes the indicator: no step is made again after a later
one has failed.
"""

import math

import numpy as np

from inference.samplers.bins import LengthBins, draw_lengths
from inference.samplers.numbers import Stream, compiled, load, store, uniform
from inference.samplers.strata import (
    BOUNDS,
    BOX,
    COUNT,
    OFFSET,
    PICK,
    ROWS,
    Build,
    Sight,
    Strata,
    lower_axes,
    rectangle,
)
from probmodel.limits import CELL

Limb = tuple[Sight, Build, Strata]


@compiled
def attempt_bodies(state: np.ndarray, counts: np.ndarray, bins1: LengthBins, bins2: LengthBins,
                   limbs: tuple[Limb, Limb], sub: int, draws: np.ndarray) -> tuple[int, int]:  # fmt: skip
    """Attempts at a group of limbs, `counts` `(bins,)` of them in each bin of the lengths; of one limb, given twice,
    where `draws` has eight columns only.

    Fills rows of `draws` `(counts.sum(), 2 + 6 · limbs)`: the lengths, then each limb's upper and lower direction in
    their local frames. Returns how many rows it filled, and how many attempts passed the first limb.
    """
    most = counts.max()
    length1, length2 = np.empty(most), np.zeros(most)
    rows, kept = np.empty(most, np.int64), np.empty(most, np.int64)
    num_limbs = (draws.shape[1] - 2) // 6
    found = np.empty((num_limbs, most, 6))
    done = passed = 0
    number2 = bins2.mass.size
    for index in range(counts.size):
        number = counts[index]
        if number == 0:
            continue
        draw_lengths(bins1.shape, bins1.slices, index // number2, state, length1[:number])
        if limbs[0][1].bones == 2:
            draw_lengths(bins2.shape, bins2.slices, index % number2, state, length2[:number])
        for n in range(number):
            rows[n] = n
        for l in range(num_limbs):
            sight, build, strata = limbs[l]
            number = _attempt_limb(
                state, sight, build, strata, index, sub, length1, length2, rows[:number], kept, found[l]
            )
            rows[:number] = kept[:number]
            if l == 0:
                passed += number
        for n in range(number):
            row = rows[n]
            draws[done, 0], draws[done, 1] = length1[row], length2[row]
            for l in range(num_limbs):
                draws[done, 2 + 6 * l : 8 + 6 * l] = found[l, row]
            done += 1
    return done, passed


@compiled
def _small_sine_cosine(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle within ±0.03, to the last bit but one: their series, without divisions."""
    square = angle * angle
    sine = angle * (1 - square * (1 / 6 - square * (1 / 120 - square * (1 / 5040))))
    return sine, 1 - square * (1 / 2 - square * (1 / 24 - square * (1 / 720 - square * (1 / 40320))))


@compiled
def _attempt_limb(state: np.ndarray, sight: Sight, build: Build, strata: Strata, index: int, sub: int,
                  lengths1: np.ndarray, lengths2: np.ndarray, rows: np.ndarray, kept: np.ndarray,
                  found: np.ndarray) -> int:  # fmt: skip
    """One attempt at a limb for each of `rows`, with the lengths there. Writes the rows that pass to `kept` and their
    directions to `found` `(…, 6)`; returns how many."""
    stream = load(state)
    cells, axes, by_area, flat, two = build.cells, build.axes, build.by_area, build.flat, build.bones == 2
    subs, entries, pieces = strata.subs, strata.entries, strata.pieces
    frame, target = sight.frame, sight.target
    first, size = strata.starts[index], strata.starts[index + 1] - strata.starts[index]
    square1, radius2 = sight.radius[0] ** 2, sight.radius[1]
    half, passed = CELL / sub / 2, 0
    for row in rows:
        place, stream = uniform(stream)
        place *= size
        entry = int(place)
        if place - entry >= entries[first + entry, 0]:
            entry = int(entries[first + entry, 1])
        entry += first
        s = int(entries[entry, 2])
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        sine, cosine = _small_sine_cosine((2 * across - 1) * half)
        sin_azimuth, cos_azimuth = subs[s, 1] * cosine + subs[s, 2] * sine, subs[s, 2] * cosine - subs[s, 1] * sine
        if by_area:
            u2 = subs[s, 3] + along * (subs[s, 4] - subs[s, 3])
            planar = math.sqrt(max(0.0, 1 - u2 * u2))
        else:
            sine, cosine = _small_sine_cosine((2 * along - 1) * half)
            u2, planar = subs[s, 3] * cosine + subs[s, 4] * sine, subs[s, 4] * cosine - subs[s, 3] * sine
        u0, u1 = planar * cos_azimuth, planar * sin_azimuth
        length1 = lengths1[row]
        end0 = -length1 * (frame[0, 0] * u0 + frame[0, 1] * u1 + frame[0, 2] * u2)
        end1 = -length1 * (frame[1, 0] * u0 + frame[1, 1] * u1 + frame[1, 2] * u2)
        if (end0 - target[0, 0]) ** 2 + (end1 - target[0, 1]) ** 2 > square1:
            continue
        found[row, 0], found[row, 1], found[row, 2] = u0, u1, u2
        if two:
            shrink = 1 / lengths2[row]
            centre0, centre1 = (target[1, 0] - end0) * shrink, (target[1, 1] - end1) * shrink
            radius = radius2 * shrink
            cell, mask = int(subs[s, 0]), pieces[entry]
            v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, axes)
            if mask:
                inside, stream, d0, d1, d2 = _in_piece(stream, entries[entry, 3], mask, centre0, centre1, radius)
                if not inside:
                    continue
                # Into the local frame; bones are parent minus child, hence the sign.
                p0 = -(frame[0, 0] * d0 + frame[1, 0] * d1 + frame[2, 0] * d2)
                p1 = -(frame[0, 1] * d0 + frame[1, 1] * d1 + frame[2, 1] * d2)
                p2 = -(frame[0, 2] * d0 + frame[1, 2] * d1 + frame[2, 2] * d2)
                q0, q1, q2 = u0 * p0 + u1 * p1 + u2 * p2, v0 * p0 + v1 * p1 + v2 * p2, w0 * p0 + w1 * p1 + w2 * p2
            else:
                stream, h1, h2, h3 = _in_box(stream, cells[cell, BOX], cells[cell, BOX + 1], cells[cell, BOX + 2],
                                             cells[cell, BOX + 3])  # fmt: skip
                q0 = cells[cell, 0] * h1 + cells[cell, 3] * h2 + cells[cell, 6] * h3
                q1 = cells[cell, 1] * h1 + cells[cell, 4] * h2 + cells[cell, 7] * h3
                q2 = cells[cell, 2] * h1 + cells[cell, 5] * h2 + cells[cell, 8] * h3
                p0, p1, p2 = u0 * q0 + v0 * q1 + w0 * q2, u1 * q0 + v1 * q1 + w1 * q2, u2 * q0 + v2 * q1 + w2 * q2
                d0 = -(frame[0, 0] * p0 + frame[0, 1] * p1 + frame[0, 2] * p2)
                d1 = -(frame[1, 0] * p0 + frame[1, 1] * p1 + frame[1, 2] * p2)
            if (d0 - centre0) ** 2 + (d1 - centre1) ** 2 > radius * radius:
                continue
            h1 = cells[cell, 0] * q0 + cells[cell, 1] * q1 + cells[cell, 2] * q2
            h2 = cells[cell, 3] * q0 + cells[cell, 4] * q1 + cells[cell, 5] * q2
            h3 = cells[cell, 6] * q0 + cells[cell, 7] * q1 + cells[cell, 8] * q2
            if h1 + cells[cell, OFFSET] >= 0 or h2 < cells[cell, BOUNDS] or h2 > cells[cell, BOUNDS + 1]:
                continue
            if h3 < cells[cell, BOUNDS + 2] or h3 > cells[cell, BOUNDS + 3]:
                continue
            if flat:
                test, stream = uniform(stream)
                if test >= abs(h1):
                    continue
            found[row, 3], found[row, 4], found[row, 5] = q0, q1, q2
        kept[passed] = row
        passed += 1
    store(state, stream)
    return passed


@compiled
def _in_piece(stream: Stream, bound: float, mask: int, centre0: float, centre1: float,
              radius: float) -> tuple[bool, Stream, float, float, float]:  # fmt: skip
    """A direction in one of the pieces of the rectangle around a disc's directions, camera axes, kept in proportion to
    the piece's area: x across, √(1-x²) sin α towards the disc's centre."""
    distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
    width, low, high = rectangle(distance, radius)
    test, stream = uniform(stream)
    height = (high - low) / ROWS
    if test * bound >= 2 * width * height:
        return False, stream, 0.0, 0.0, 0.0
    which, stream = uniform(stream)
    piece = PICK[mask, int(which * COUNT[mask])]
    across, stream = uniform(stream)
    along, stream = uniform(stream)
    x = width * (2 * across - 1)
    rest = 1 - x * x
    t = math.sqrt(max(0.0, rest)) * math.sin(low + height * (piece % ROWS + along))
    z = math.sqrt(max(0.0, rest - t * t))
    if piece >= ROWS:
        z = -z
    scale = 1 / max(distance, 1e-300)
    towards0, towards1 = (centre0 * scale, centre1 * scale) if distance > 0 else (1.0, 0.0)
    return True, stream, towards0 * t - towards1 * x, towards1 * t + towards0 * x, z


@compiled
def _in_box(stream: Stream, low: float, high: float, first: float, last: float) -> tuple[Stream, float, float, float]:
    """A direction by area in the box around all that a hinge allows, as (u1, u2, u3) in the hinge's triple."""
    across, stream = uniform(stream)
    along, stream = uniform(stream)
    u2 = min(1.0, max(-1.0, low + (high - low) * across))
    rho = math.sqrt(max(0.0, 1 - u2 * u2))
    angle = first + min(last - first, 2 * math.pi) * along
    return stream, -rho * math.cos(angle), u2, rho * math.sin(angle)
