"""Error laws: how the error of one detected joint is spread in the plane, in units of its spread.

The paper's is `Disc`. `LAWS` is the registry: command line, law files, tests and pages take their
lists from it. To add a law, write one subclass of `ErrorLaw`, name it in `errors.LAW_NAMES` and
enter it in `LAWS`. Samplers propose by its envelope, or uniformly within its reach, and correct
what they found by `log_over`: nothing else asks which law it is.
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.errors import LAW_NAMES
from poseterior.probmodel.failures import BadInput, shown


class ErrorLaw(abc.ABC):
    """The isotropic law of an error e in the plane, in units of a joint's spread.

    Its density falls with the length of e and ends at `reach`. Formulas take arrays of NumPy or of
    JAX, and return the like.

    Attributes
    ----------
    reach
        The largest length of e that has any density.
    log_peak
        Log density at e = 0, per squared spread.
    precision
        Of the envelope, a Gaussian that has the law's peak and is nowhere below it within the
        reach: exp(-precision · `|e|²`/2). At 0 it is a disc, which bounds every law.
    exact
        Whether within the reach the law is its envelope.
    """

    reach: float
    log_peak: float
    precision: float = 0.0
    exact: bool = False

    @property
    def name(self) -> str:
        """That of the registry."""
        return type(self).__name__.lower()

    @property
    def parameters(self) -> dict[str, float]:
        """What a law file says beside the name: the fields of the class."""
        return dataclasses.asdict(self)  # type: ignore[call-overload]

    @abc.abstractmethod
    def log_ratio(self, square: ArrayLike) -> Any:
        """`(...)`: log f(e)/f(0) at squared lengths of e `(...)`; -inf beyond the reach."""

    @abc.abstractmethod
    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(...)`: the quantiles of the length of e at numbers `(...)` in [0, 1)."""

    def follows(self, precision: ArrayLike) -> bool:
        """Whether errors proposed within the reach by Gaussians of this precision (0: uniformly)
        follow the law as they are."""
        return self.exact and bool(np.all(np.asarray(precision) == self.precision))

    def log_over(self, square: ArrayLike, precision: ArrayLike) -> Any:
        """What corrects errors that were proposed by an envelope, for limbs and torsos alike.

        Parameters
        ----------
        square : `(...)`
            Squared lengths of proposed errors, all within the reach but for rounding.
        precision
            Of the Gaussians by which they were proposed: the law's, or 0 where uniformly.

        Returns
        -------
        Array
            `(...)`: the log of the law over the envelope, both over their peak; at most 0.
        """
        xp = _namespace(square)
        within = xp.minimum(xp.asarray(square), xp.asarray(self.reach**2))
        return self.log_ratio(within) + precision * within / 2

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        """Errors.

        Parameters
        ----------
        key
            Of the draws.
        shape
            How many.

        Returns
        -------
        Array
            `(*shape, 2)`, in spreads.
        """
        for_distance, for_angle = jax.random.split(key)
        distance = self.distance(jax.random.uniform(for_distance, shape))
        angle = jax.random.uniform(for_angle, shape, maxval=2 * jnp.pi)
        return distance[..., None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Disc(ErrorLaw):
    """Uniform in the disc of radius one: the paper's law, an indicator."""

    reach = 1.0
    log_peak = float(-np.log(np.pi))
    exact = True

    def log_ratio(self, square: ArrayLike) -> Any:
        """0 in the disc, -inf outside."""
        xp = _namespace(square)
        return xp.where(xp.asarray(square) <= 1.0, 0.0, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """The square root."""
        return jnp.sqrt(jnp.asarray(uniform))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Gaussian(ErrorLaw):
    """A Gaussian whose standard deviation each way is half a spread, that of the disc, cut at three
    of them: 1.1 % of its mass lies beyond, and is left out."""

    precision = 4.0
    exact = True
    reach = 1.5
    log_peak = float(-np.log(2 * np.pi * 0.5**2 * (1 - np.exp(-(1.5**2) / (2 * 0.5**2)))))

    def log_ratio(self, square: ArrayLike) -> Any:
        """`-|e|²/2σ²` within the reach."""
        xp = _namespace(square)
        within = xp.asarray(square) <= self.reach**2
        return xp.where(within, -xp.asarray(square) * self.precision / 2, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`|e|²/2σ²` is exponential, cut at 4.5."""
        most = -jnp.expm1(-(self.reach**2) * self.precision / 2)
        return jnp.sqrt(-2 / self.precision * jnp.log1p(-most * jnp.asarray(uniform)))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Student(ErrorLaw):
    """A bivariate Student's t of scale σ, half a spread, cut where as much of its mass lies beyond
    as beyond three σ of a Gaussian, which is its limit.

    With r = `|e|/σ` the mass beyond is (1 + r²/df)^(-df/2): it ends at r² = df (e^(9/df) - 1).

    Attributes
    ----------
    df
        Degrees of freedom, 1 at least; of samplers, which end at `LONGEST_REACH`, 2.

    Raises
    ------
    BadInput
        On fewer.
    """

    df: float = 5.0
    log_peak = Gaussian.log_peak

    def __post_init__(self) -> None:
        if not self.df >= FEWEST_DF:  # true for NaN too
            raise BadInput(
                f"a student law has {FEWEST_DF:g} degree of freedom or more, not {self.df:g}"
            )

    @property
    def reach(self) -> float:  # type: ignore[override]
        """In spreads."""
        return 0.5 * math.sqrt(self.df * math.expm1(9 / self.df))

    @property
    def precision(self) -> float:  # type: ignore[override]
        """Log t is convex in `|e|²`, so it lies below its chord from the peak to the reach, where
        it is -(df + 2)/2 · 9/df: a Gaussian."""
        return 9 * (1 + 2 / self.df) / self.reach**2

    def log_ratio(self, square: ArrayLike) -> Any:
        """`-(df + 2)/2 · log(1 + |e|²/(σ² df))` within the reach."""
        xp = _namespace(square)
        inside = -(self.df + 2) / 2 * xp.log1p(4 * xp.asarray(square) / self.df)
        return xp.where(xp.asarray(square) <= self.reach**2, inside, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(1 + |e|²/(σ² df))^(-df/2)` is uniform, cut at e^-4.5."""
        beyond = 1 + math.expm1(-4.5) * jnp.asarray(uniform)
        return 0.5 * jnp.sqrt(self.df * jnp.expm1(-2 / self.df * jnp.log(beyond)))


FEWEST_DF = 1.0
LAWS: dict[str, type[ErrorLaw]] = dict(zip(LAW_NAMES, (Disc, Gaussian, Student), strict=True))
"""Error laws by name; the disc is the paper's."""


def law_of(name: str, parameters: Mapping[str, float]) -> ErrorLaw:
    """The law that a file says.

    Parameters
    ----------
    name
        One of `LAWS`.
    parameters
        By name: all that the law has, and no other.

    Returns
    -------
    ErrorLaw
        The law.

    Raises
    ------
    BadInput
        On another name, parameters of other names, or a value that the law has not.
    """
    law: Any = LAWS.get(name) if isinstance(name, str) else None
    if law is None:
        raise BadInput(f"there is no error law {shown(name)}; choose among {', '.join(LAWS)}")
    wanted = [field.name for field in dataclasses.fields(law)]
    if set(wanted) != set(parameters):
        said, given = (", ".join(names) or "no parameter" for names in (wanted, parameters))
        raise BadInput(f"the error law {name} is given with {said}, not with {given}")
    return law(**parameters)


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=("outlier",), meta_fields=("inlier",)
)
@dataclasses.dataclass(frozen=True, eq=False)
class WithOutliers(ErrorLaw):
    """Of several joints each its own law: outliers are uniform in a disc of one spread, and all
    others have the `inlier` law. Numbers of this law are arrays, one for each joint.

    Attributes
    ----------
    inlier
        The law of the others.
    outlier : `(..., joints)` bool
        Which are outliers.
    """

    inlier: ErrorLaw
    outlier: np.ndarray | jax.Array

    @property
    def reach(self) -> Any:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.reach, self.inlier.reach)

    @property
    def log_peak(self) -> jax.Array:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.log_peak, self.inlier.log_peak)

    @property
    def precision(self) -> Any:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.precision, self.inlier.precision)

    @property
    def exact(self) -> bool:  # type: ignore[override]
        """Whether the inliers' law is."""
        return self.inlier.exact

    def log_ratio(self, square: ArrayLike) -> Any:
        """`(..., joints)`."""
        return self._each(Disc().log_ratio(square), self.inlier.log_ratio(square))

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(..., joints)`."""
        return self._each(Disc().distance(uniform), self.inlier.distance(uniform))

    def _each(self, outliers: Any, others: Any) -> Any:
        xp = _namespace(self.outlier, outliers, others)
        return xp.where(xp.asarray(self.outlier), outliers, others)


def _namespace(*arrays: Any) -> Any:
    """NumPy, or `jax.numpy` where one of the arrays is of JAX."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np
