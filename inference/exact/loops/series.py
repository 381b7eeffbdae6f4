"""Sine, arcsine and azimuth as polynomials, sine and cosine by a table, and the smaller
of two, for the compiled loops: no calls and no branches, so that loops over them become
vector instructions. Angles and sines are within 8e-16 of the true values."""

import math

import numpy as np

from poseterior.inference.exact.loops.numbers import inlined

_PARTS = 128
"""Of a turn: within half of one of them, `small_sine_cosine` holds."""
_middle = 2 * math.pi * (np.arange(_PARTS) + 0.5) / _PARTS
_CIRCLE = np.stack([np.sin(_middle), np.cos(_middle)], axis=1)


@inlined
def sine(angle: float) -> float:
    """Sine of an angle within ±π/2: its series."""
    s = angle * angle
    rest = 1 / 1307674368000 - s * (
        1 / 355687428096000 - s * (1 / 121645100408832000 - s * (1 / 51090942171709440000))
    )
    rest = 1 / 362880 - s * (1 / 39916800 - s * (1 / 6227020800 - s * rest))
    return angle * (1 - s * (1 / 6 - s * (1 / 120 - s * (1 / 5040 - s * rest))))


@inlined
def cosine(angle: float) -> float:
    """Cosine of an angle within ±π/2."""
    return sine(math.pi / 2 - math.fabs(angle))


@inlined
def small_sine_cosine(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle within ±0.03: the first terms."""
    s = angle * angle
    sine = angle * (1 - s * (1 / 6 - s * (1 / 120 - s * (1 / 5040))))
    return sine, 1 - s * (1 / 2 - s * (1 / 24 - s * (1 / 720 - s * (1 / 40320))))


@inlined
def circle(turns: float) -> tuple[float, float]:
    """Sine and cosine of an angle in turns, from those of the nearest of 128 angles: a
    look-up, and a third of the time that the library's take."""
    at = turns * _PARTS
    below = math.floor(at)
    turned, kept = small_sine_cosine((at - below - 0.5) * (2 * math.pi / _PARTS))
    part = int(below) & (_PARTS - 1)
    rise = _CIRCLE[part, 0]
    run = _CIRCLE[part, 1]
    return rise * kept + run * turned, run * kept - rise * turned


@inlined
def arcsine(value: float) -> float:
    """Arcsine of a number, taken as ±1 where it is beyond: up to ½ a polynomial in its
    square (interpolated in Chebyshev nodes), beyond by π/2 - 2 arcsin √((1-v)/2)."""
    size = math.fabs(value)
    size = size if size < 1 else 1.0
    z = 0.5 * (1 - size) if size > 0.5 else size * size
    s = math.sqrt(z) if size > 0.5 else size
    p = 0.01392965290232663 + z * (
        0.01187549438263692
        + z
        * (
            0.00780294947735332
            + z * (0.01603551434914883 + z * (-0.01074905033969781 + z * 0.02816921806088142))
        )
    )
    p = 0.03038194736709848 + z * (0.02237204763174451 + z * (0.01735525995578632 + z * p))
    p = s + s * z * (
        0.1666666666666665 + z * (0.07500000000020764 + z * (0.04464285710342365 + z * p))
    )
    found = math.pi / 2 - 2 * p if size > 0.5 else p
    return math.copysign(found, value)


@inlined
def azimuth(x: float, y: float) -> float:
    """The angle of a direction in the plane, -π to π; 0 where there is none."""
    length = math.sqrt(x * x + y * y)
    across = math.fabs(x)
    up = math.fabs(y)
    # Near ±1 an arcsine knows its angle badly.
    least = arcsine((up if up < across else across) / (length if length > 1e-300 else 1e-300))
    acute = least if up <= across else math.pi / 2 - least
    return math.copysign(acute if x >= 0 else math.pi - acute, y)


@inlined
def smaller(one: float, other: float) -> float:
    """The smaller of two numbers, neither of which is NaN; `min` would look."""
    return one if one < other else other
