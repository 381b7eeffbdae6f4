"""How far beyond what was seen a bone may go: the one choice that motion capture does not make."""

import dataclasses

import numpy as np

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import UPPER_BONES


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """Margins around what was seen, in degrees (0 to 90) but for `samples` and
    `company`.

    Parameters
    ----------
    head, arm, leg
        An upper bone's direction this close to a seen one is possible.
    closing
        Gaps between possible directions narrower than twice this are filled (dilation, then
        erosion), and so are holes without a way out.
    neighbourhood
        A lower bone is judged by what was seen while its parent was this close.
    samples
        Where fewer distinct observations than this are that close, the nearest ones count.
    lower
        Margin around planes and boxes.
    company
        What was seen with fewer distinct others than this around it is odd, and does not count (at
        most one in a hundred); with 0 everything counts.
    within
        How far from it they may lie.

    Raises
    ------
    BadInput
        Where a value is out of its range.
    """

    head: float = 4.0
    arm: float = 6.0
    leg: float = 8.0
    closing: float = 10.0
    neighbourhood: float = 20.0
    samples: int = 30
    lower: float = 6.0
    company: int = 5
    within: float = 15.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            low, high = {"samples": (1, np.inf), "company": (0, np.inf)}.get(name, (0, 90))
            if not low <= value <= high:  # true for NaN too
                raise BadInput(
                    f"the tolerance {name} is {value}; degrees are 0 to 90, samples at least 1,"
                    " company at least 0"
                )

    def wider(self, factor: float) -> "Tolerance":
        """With so many times the margins of bones; gaps and neighbourhoods stay as they are.

        Parameters
        ----------
        factor
            Below one for narrower margins.

        Raises
        ------
        BadInput
            Where a margin would not lie between 0 and 90 degrees.
        """
        names = ("head", "arm", "leg", "lower")
        most = 90 / max(getattr(self, name) for name in names)
        if not 0 <= factor <= most:  # true for NaN too
            raise BadInput(f"margins cannot be {factor:g} times as wide; give 0 to {most:g}")
        return dataclasses.replace(self, **{name: factor * getattr(self, name) for name in names})

    @property
    def upper(self) -> tuple[float, ...]:
        """`head`, `arm` or `leg`, in the order of `skeleton.UPPER_BONES`."""
        return tuple(getattr(self, bone.name.rsplit("_", 1)[-1]) for bone in UPPER_BONES)


DEFAULT = Tolerance()
"""That of the embedded limits."""
