"""Conditions: which estimator, how many limb joints missing, how far the image is turned."""

from collections.abc import Sequence
from typing import NamedTuple

from inference.roots import ESTIMATORS
from probmodel.failures import BadInput
from probmodel.skeleton import LIMB_JOINTS


class Condition(NamedTuple):
    """What a data set is evaluated under. `missing`: limb joints, at random; `rotate`: degrees, in
    the image."""

    estimator: str
    missing: int = 0
    rotate: float = 0.0

    @property
    def name(self) -> str:
        """As files call it."""
        return f"{self.estimator}-missing-{self.missing}-rotate-{self.rotate:g}"


def conditions(
    estimators: Sequence[str], missing: Sequence[int], rotate: Sequence[float]
) -> list[Condition]:
    """Every estimator with every number of missing joints (the image turned by the first angle),
    and turned by every angle (with the first number missing).

    Raises
    ------
    BadInput
        On an unknown estimator, a number of joints that cannot be missing, an angle beyond a full
        turn, or where something is named twice or not at all.
    """
    for name, listed in (("estimators", estimators), ("missing", missing), ("rotate", rotate)):
        if not listed or len(set(listed)) != len(listed):
            raise BadInput(
                f"{name} must name at least one, and none twice, not"
                f" {', '.join(map(str, listed)) or 'none'}"
            )
    unknown = [name for name in estimators if name not in ESTIMATORS]
    if unknown:
        raise BadInput(
            f"there is no estimator {unknown[0]!r} to evaluate; choose among"
            f" {', '.join(ESTIMATORS)}"
        )
    for number in missing:
        if not 0 <= number <= len(LIMB_JOINTS):
            raise BadInput(f"{number} limb joints cannot be missing; there are {len(LIMB_JOINTS)}")
    for angle in rotate:
        if not -360 <= angle <= 360:  # false for NaN too
            raise BadInput(f"the image cannot be turned by {angle:g} degrees; give -360 to 360")
    own = [(number, rotate[0]) for number in missing] + [
        (missing[0], angle) for angle in rotate[1:]
    ]
    return [Condition(estimator, *one) for estimator in estimators for one in own]
