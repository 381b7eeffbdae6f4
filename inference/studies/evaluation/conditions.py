"""Conditions: which estimator, how many limb joints missing, how far the image is turned, and what
torso and camera are."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from poseterior.inference.estimators import ESTIMATORS
from poseterior.inference.studies.calibration.real import TRUE
from poseterior.probmodel.documents import shortest
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.root_priors import CANDIDATES, ROOT_PRIORS, UNCERTAIN
from poseterior.probmodel.skeleton import LIMB_JOINTS

EVALUATED_ROOTS = (*ROOT_PRIORS, TRUE)
"""What torso and camera may be: the estimator's, drawn with the pose, or the truth's own."""


class Condition(NamedTuple):
    """What a data set is evaluated under. `missing`: limb joints, at random; `rotate`: degrees, in
    the image; `root`: one of `EVALUATED_ROOTS`."""

    estimator: str
    missing: int = 0
    rotate: float = 0.0
    root: str = CANDIDATES

    @property
    def way(self) -> str:
        """Whose draws these are: the estimator's, or those of a root that depends on none."""
        return self.estimator if self.root == CANDIDATES else f"{self.root} root"

    @property
    def name(self) -> str:
        """As files call it."""
        name = f"{self.estimator}-missing-{self.missing}-rotate-{shortest(self.rotate)}"
        return name if self.root == CANDIDATES else f"{name}-root-{self.root}"


def alike(some: Iterable[Condition], base: Condition) -> list[Condition]:
    """Those with as many joints missing, and turned as far, as the base: one for each way."""
    return [one for one in some if (one.missing, one.rotate) == (base.missing, base.rotate)]


def conditions(
    estimators: Sequence[str],
    missing: Sequence[int],
    rotate: Sequence[float],
    roots: Sequence[str] = (UNCERTAIN,),
) -> list[Condition]:
    """Every estimator with every number of missing joints (the image turned by the first angle),
    and turned by every angle (with the first number missing); the same under every root.

    Draws under a root that is not an estimator's do not depend on it: they stand beside the single
    estimate of the first.

    Raises
    ------
    BadInput
        On an unknown estimator or root, a number of joints that cannot be missing, an angle beyond
        a full turn, or where something is named twice or not at all.
    """
    for name, listed in (
        ("estimators", estimators),
        ("missing", missing),
        ("rotate", rotate),
        ("roots", roots),
    ):
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
    for root in roots:
        if root not in EVALUATED_ROOTS:
            raise BadInput(f"there is no root {root!r}; choose among {', '.join(EVALUATED_ROOTS)}")
    for number in missing:
        if not 0 <= number <= len(LIMB_JOINTS):
            raise BadInput(f"{number} limb joints cannot be missing; there are {len(LIMB_JOINTS)}")
    for angle in rotate:
        if not -360 <= angle <= 360:  # false for NaN too
            raise BadInput(f"the image cannot be turned by {angle:g} degrees; give -360 to 360")
    own = [(number, rotate[0]) for number in missing] + [
        (missing[0], angle) for angle in rotate[1:]
    ]
    return [
        Condition(estimator, *one, root)
        for root in roots
        for estimator in (estimators if root == CANDIDATES else estimators[:1])
        for one in own
    ]
