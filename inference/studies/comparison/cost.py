"""What draws cost: effective draws a second, and seconds until the draws are within a distance of
the exact ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.comparison.distances import sliced_wasserstein
from poseterior.inference.studies.comparison.sample import Sample

SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Parts of a run at which its distance is measured."""
EPSILON = 0.1
"""The distance to reach: sliced Wasserstein, standard deviations of the exact draws."""


class Course(NamedTuple):
    """`distance` `(p,)`: sliced Wasserstein to the exact draws after `seconds` `(p,)`; `kept`: the
    share of the work that brought draws."""

    seconds: np.ndarray
    distance: np.ndarray
    kept: float

    def seconds_to(self, epsilon: float = EPSILON) -> float:
        """When the distance came below `epsilon` and stayed there; infinite where it did not."""
        above = np.flatnonzero(self.distance > epsilon)
        first = 0 if not len(above) else above[-1] + 1
        return float(self.seconds[first]) if first < len(self.seconds) else np.inf


def course(
    sample: Sample, exact: Sample, seconds: float, kept: float, shares: Sequence[float] = SHARES
) -> Course:
    """The distance after the first parts of every chain, of a run of `seconds` in which the last
    share `kept` of the work brought these draws, evenly; the work before it counts from the
    start. `shares` are the parts, the last of them 1."""
    distance = [sliced_wasserstein(sample.first(share).flat, exact.flat) for share in shares]
    before = seconds * (1 - kept)
    return Course(before + np.array(shares) * seconds * kept, np.array(distance), kept)
