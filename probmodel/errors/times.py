"""How long a detector's errors last: what of them stays over a film, what wanders, and what is new
in every frame. A single frame knows their sum alone."""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz

from poseterior.probmodel.failures import BadInput

PARTS_OF_ERRORS = ("constant", "slow", "quick")
WITH_SE = (*PARTS_OF_ERRORS, "seconds")
SHARES_SUM = 1e-6
"""By how much the sum of shares in a file may differ from one."""


class ErrorTimes(NamedTuple):
    """The three parts of the variance of a joint's errors.

    Attributes
    ----------
    constant, slow, quick
        Their shares, with sum one: of what stays over a film, of what wanders, with an
        autocorrelation of exp(-time / `seconds`), and of what is new in every frame.
    seconds
        How long slow errors last.
    deviation
        The standard deviation of all three together, in the unit of the errors.
    longest
        The longest time that the film tells from ever, seconds; where `seconds` is no shorter,
        slow errors last for so long at least, and pass over into constant ones.
    rate
        Frames a second of the film that they were learned from.
    se : `(4,)`
        Standard errors of shares and seconds, from leaving recordings out in turn; NaN where there
        is one alone.
    """

    constant: float
    slow: float
    quick: float
    seconds: float
    deviation: float
    longest: float
    rate: float
    se: np.ndarray

    def worth(self, frames: int, rate: float) -> float:
        """How many frames with errors of their own so many in succession are worth, to the mean of
        a joint that rests: the variance of one frame over that of the best linear mean.

        Parameters
        ----------
        frames
            How many.
        rate
            Of them in a second.

        Returns
        -------
        float
            1 for one frame.
        """
        covariance = self.constant + self.slow * np.exp(-np.arange(frames) / rate / self.seconds)
        covariance[0] += self.quick
        return float(solve_toeplitz(covariance, np.ones(frames)).sum())

    def check(self) -> None:
        """Raises `BadInput` on numbers that are no times."""
        shares = np.array(self[: len(PARTS_OF_ERRORS)])
        if not (np.all(shares >= 0) and abs(shares.sum() - 1) <= SHARES_SUM):  # false for NaN too
            said = ", ".join(f"{share:g}" for share in shares)
            raise BadInput(
                f"the times' {', '.join(PARTS_OF_ERRORS)} must be shares with sum 1, not {said}"
            )
        for name in ("seconds", "deviation", "longest", "rate"):
            if not 0 < getattr(self, name) < np.inf:
                raise BadInput(
                    f"the times' {name} must be a positive number, not {getattr(self, name):g}"
                )

    def document(self) -> dict[str, Any]:
        """As a law file has them; None for standard errors that are not known."""
        errors = (float(one) if np.isfinite(one) else None for one in self.se)
        numbers = {name: float(getattr(self, name)) for name in self._fields if name != "se"}
        return numbers | {"se": dict(zip(WITH_SE, errors, strict=True))}
