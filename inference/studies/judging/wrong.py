"""Posteriors in closed form that are wrong in a known way, on which tests of coverage are tried:
three correlated Gaussian numbers seen with Gaussian noise (`calibration.toy`).

Nine are of the kinds of reports/coverage.md; three are right on average only: every quantity's
levels are uniform over all instances, and nowhere."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

from poseterior.inference.studies.calibration.toy import Toy

LOCALLY_WRONG = 0.8
"""How far the density of the levels strays from 1 where a posterior is wrong locally; less than
1."""


class Instances(NamedTuple):
    """What a test is given: `truth` `(n, 3)`, `draws` `(n, d, 3)`, log densities of both, and what
    was `seen` `(n, 3)`."""

    truth: np.ndarray
    draws: np.ndarray
    log_density: tuple[np.ndarray, np.ndarray]
    seen: np.ndarray


Fault = Callable[[Toy, np.random.Generator], np.ndarray]
"""Spoilt draws `(n, d, 3)`."""


def scaled(factor: float, *some: int) -> Fault:
    """Deviations of some quantities (all, where none is named) times a factor."""

    def spoil(toy: Toy, rng: np.random.Generator) -> np.ndarray:
        scale = np.ones(3)
        scale[list(some or range(3))] = factor
        return toy.mean[:, None] + scale * _off(toy)

    return spoil


def _off(toy: Toy) -> np.ndarray:
    return toy.draws - toy.mean[:, None]


def _exchanged(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    ratio = np.sqrt(np.diag(toy.covariance))
    return toy.mean[:, None] + 0.7 * _off(toy)[..., [2, 1, 0]] + 0.1 * ratio


def _uncorrelated(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    return rng.permuted(toy.draws, axis=1)


def _prior(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    return toy.prior_draws


def _shifted(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    return toy.draws + 0.3 * np.sqrt(np.diag(toy.covariance))


def _without_tails(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    limit = 1.3 * np.sqrt(np.diag(toy.covariance))
    return toy.mean[:, None] + np.clip(_off(toy), -limit, limit)


def _one_side(toy: Toy, rng: np.random.Generator) -> np.ndarray:
    off = _off(toy)
    return toy.mean[:, None] + np.where(off[..., :1] < 0, -off, off)


def locally_wrong(width: bool, sign: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Too narrow or too wide (or shifted to either side) by the sign of what was seen: the levels
    of a quantity have the density 1 ± `LOCALLY_WRONG` times a Legendre polynomial, and are uniform
    over both."""

    def spoil(toy: Toy, rng: np.random.Generator) -> np.ndarray:
        spread = np.sqrt(np.diag(toy.covariance))
        share = stats.norm.cdf(_off(toy) / spread)
        part = 2 * share**3 - 3 * share**2 + share if width else share**2 - share
        moved = share + LOCALLY_WRONG * sign(toy.seen)[:, None, None] * part
        return toy.mean[:, None] + spread * stats.norm.ppf(np.clip(moved, 1e-12, 1 - 1e-12))

    return spoil


WRONGS: dict[str, Fault] = {
    "right": scaled(1.0),
    "spread × 0.8": scaled(0.8),
    "spread × 1.25": scaled(1.25),
    "two axes exchanged": _exchanged,
    "one of three ten times too narrow": scaled(0.1, 1),
    "uncorrelated": _uncorrelated,
    "ignores what was seen": _prior,
    "shifted by 0.3 sd": _shifted,
    "without tails": _without_tails,
    "one of two sides": _one_side,
    "width wrong by one covariate": locally_wrong(True, lambda seen: np.sign(seen[:, 0])),
    "place wrong by one covariate": locally_wrong(False, lambda seen: np.sign(seen[:, 1])),
    "width wrong by two together": locally_wrong(
        True, lambda seen: np.sign(seen[:, 1] * seen[:, 2])
    ),
}
"""By name; the last three are right on average only: numbers 1 and 2 are seen independently of each
other, so that either sign of their product is as likely."""


def told(fault: str, number: int, draws: int, rng: np.random.Generator) -> Instances:
    """So many instances with so many draws of a posterior of `WRONGS`. The log density is that of
    the right posterior, which whoever is wrong would be wrong about too."""
    toy = Toy(number, draws, rng)
    spoilt = WRONGS[fault](toy, rng)
    inverse = np.linalg.inv(toy.covariance)
    both = np.concatenate([toy.truth[:, None], spoilt], axis=1) - toy.mean[:, None]
    density = -0.5 * np.einsum("nki,ij,nkj->nk", both, inverse, both)
    return Instances(toy.truth, spoilt, (density[:, 0], density[:, 1:]), toy.seen)
