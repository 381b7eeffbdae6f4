"""Some of many rows, evenly."""

import numpy as np


def evenly(number: int, wanted: int) -> np.ndarray:
    """Rows of `number`, so many as are wanted or all there are, evenly over them."""
    return np.linspace(0, number - 1, min(wanted, number)).round().astype(int)


def shares(frames: int, parts: int) -> list[int]:
    """`frames` shared out evenly."""
    return [frames // parts + (part < frames % parts) for part in range(parts)]
