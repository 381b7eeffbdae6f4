"""The low-pass filter of biomechanics: what moves quicker than people do is noise."""

import math

import numpy as np

_TWICE = (math.sqrt(2) - 1) ** 0.25
"""By how much a Butterworth filter of second order that runs there and back lowers the (analogue)
frequency at which half of the power is left."""
_ORDER = 2


def butterworth(values: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Second order, there and back: no lag, and half of the power is left at `cutoff` Hz."""
    from scipy.signal import butter, sosfiltfilt

    once = rate / math.pi * math.atan(math.tan(math.pi * cutoff / rate) / _TWICE)
    sections = butter(_ORDER, once, fs=rate, output="sos")
    padding = min(3 * (2 * len(sections) + 1), len(values) - 1)
    return sosfiltfilt(sections, values, axis=0, padlen=padding)
