"""Faults of a detector: a joint found somewhere else altogether, left and right exchanged.

They are discrete: a detection has a pattern of faults, and under each pattern the likelihood is
what it was without (docs/model.md § 9). A keypoint is an *outlier* where it says next to nothing
of its joint: it lies anywhere within some body units of it. In an *exchange* the keypoints of one
side stand under the names of the other.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, MIRROR, NUM_JOINTS, TORSO_INDEX

OUTLIER_REACH = 8.0
"""Body units: how far from its joint an outlier may lie, where nothing else is said; more than the
height of a person."""
_ARMS, _LEGS = ("elbow", "wrist"), ("knee", "ankle")
EXCHANGES: dict[str, tuple[str, ...]] = {
    "none": (),
    "arms": _ARMS,
    "legs": _LEGS,
    "upper half": ("shoulder", *_ARMS),
    "lower half": ("hip", *_LEGS),
    "body": ("shoulder", *_ARMS, "hip", *_LEGS),
}
"""What is exchanged, by its name: the joints without their side."""
NUM_EXCHANGES = len(EXCHANGES)
EXCHANGE_INDEX = {name: index for index, name in enumerate(EXCHANGES)}


def _order(parts: tuple[str, ...]) -> list[int]:
    """Which keypoint stands for each joint."""
    moved = {JOINT_INDEX[f"{side}_{part}"] for part in parts for side in ("left", "right")}
    return [MIRROR[joint] if joint in moved else joint for joint in range(NUM_JOINTS)]


ORDERS = np.array([_order(parts) for parts in EXCHANGES.values()])
"""`(6, 15)`: under each exchange, the keypoint that stands for each joint."""
MOVES_TORSO = np.array([set(parts) & {"shoulder", "hip"} != set() for parts in EXCHANGES.values()])
"""`(6,)`: whether joints of the torso are exchanged."""
LIMB_INDEX = tuple(joint for joint in range(NUM_JOINTS) if joint not in TORSO_INDEX)
"""The joints that are not the torso's: head, elbows, wrists, knees, ankles."""


class Faults(NamedTuple):
    """A pattern of faults, or a batch of them; a pytree.

    Attributes
    ----------
    exchange : `(...)`
        Index into `EXCHANGES`.
    outlier : `(..., 15)` bool
        Which keypoints are outliers, by the joint they are named after.
    """

    exchange: Any
    outlier: Any

    @classmethod
    def none(cls, *batch: int) -> "Faults":
        """No fault at all."""
        return cls(np.zeros(batch, np.int64), np.zeros((*batch, NUM_JOINTS), bool))

    def take(self, rows: Any) -> "Faults":
        """Some of a batch."""
        return Faults(*(np.asarray(part)[rows] for part in self))


@jax.tree_util.register_static
@dataclass(frozen=True)
class FaultPrior:
    """How often a detector errs in these ways.

    Of the torso's keypoints one at most is an outlier, and none where joints of the torso are
    exchanged; all else is independent.

    Attributes
    ----------
    outlier
        15 prior probabilities that a keypoint is an outlier; for the torso's, what each had
        if it were independent of the others.
    exchange
        5 prior probabilities of the exchanges but the first, "none".
    reach
        Body units, how far from its joint an outlier may lie.

    Raises
    ------
    BadInput
        Where a number is no probability, or those of the exchanges leave nothing for "none".
    """

    outlier: tuple[float, ...] = (0.0,) * NUM_JOINTS
    exchange: tuple[float, ...] = (0.0,) * (NUM_EXCHANGES - 1)
    reach: float = OUTLIER_REACH

    def __post_init__(self) -> None:
        for joint, probability in enumerate(self.outlier):
            if not 0 <= probability < 1:  # false for NaN too
                raise BadInput(
                    f"the probability of an outlier must lie between 0 and 1, below 1, not"
                    f" {probability} for the {JOINTS[joint].replace('_', ' ')}"
                )
        if not (all(0 <= one < 1 for one in self.exchange) and sum(self.exchange) < 1):
            raise BadInput(
                f"the probabilities of exchanges must not be negative, and below 1 together, not"
                f" {', '.join(map(str, self.exchange))}"
            )

    @classmethod
    def of(cls, outlier: float = 0.0, exchange: float = 0.0) -> "FaultPrior":
        """The same for all joints.

        Parameters
        ----------
        outlier
            The probability that a keypoint is an outlier, for every joint.
        exchange
            That sides are exchanged, whatever is; each kind of exchange as likely as the others.

        Returns
        -------
        FaultPrior
            The prior.

        Raises
        ------
        BadInput
            Where a number is no probability.
        """
        kinds = NUM_EXCHANGES - 1
        return cls((outlier,) * NUM_JOINTS, (exchange / kinds,) * kinds)

    @property
    def any(self) -> bool:
        """Whether there may be faults."""
        return any(self.outlier) or any(self.exchange)

    @property
    def exchange_probabilities(self) -> np.ndarray:
        """`(6,)`: of all exchanges, "none" first."""
        return np.array([1 - sum(self.exchange), *self.exchange])

    @property
    def exchanges(self) -> np.ndarray:
        """`(e,)`: those that there may be, as indices into `EXCHANGES`."""
        return np.flatnonzero(self.exchange_probabilities)

    def none(self, *batch: int) -> Faults:
        """No fault at all, in patterns `(*batch, ...)`."""
        return Faults.none(*batch)

    def compose(self, counts: ArrayLike, step: Callable[[str, Any], Any]) -> Faults:
        """The prior, written once.

        Parameters
        ----------
        counts : `(15,)` bool
            Which keypoints there are: others cannot be outliers.
        step
            `step(site, law)` says what becomes of each law in turn.

        Returns
        -------
        Faults
            Made of what `step` returned.
        """
        from numpyro.distributions import BernoulliProbs, CategoricalProbs

        outlier = jnp.where(jnp.asarray(counts), jnp.asarray(self.outlier), 0.0)
        exchange = step("exchange", CategoricalProbs(jnp.asarray(self.exchange_probabilities)))
        odds = outlier[jnp.array(TORSO_INDEX)] / (1 - outlier[jnp.array(TORSO_INDEX)])
        moved = jnp.asarray(MOVES_TORSO)[exchange]
        one = jnp.append(1.0, jnp.where(moved, 0.0, odds))
        torso = step("torso_outlier", CategoricalProbs(one / one.sum()))
        limbs = step("limb_outlier", BernoulliProbs(outlier[jnp.array(LIMB_INDEX)]).to_event(1))
        return faults_of(exchange, torso, limbs)

    def draw(self, counts: ArrayLike, key: jax.Array) -> Faults:
        """One pattern.

        Parameters
        ----------
        counts : `(15,)` bool
            Which keypoints there are.
        key
            Of the draw.

        Returns
        -------
        Faults
            A pattern of the prior.
        """
        sites = ("exchange", "torso_outlier", "limb_outlier")
        keys = dict(zip(sites, jax.random.split(key, len(sites)), strict=True))
        return self.compose(counts, lambda site, law: law.sample(keys[site]))

    def log_prob(self, counts: ArrayLike, faults: Faults) -> jax.Array:
        """Log prior probability of one pattern.

        Parameters
        ----------
        counts : `(15,)` bool
            Which keypoints there are.
        faults
            The pattern.

        Returns
        -------
        Array
            `()`; -inf where there is no such pattern.
        """
        if not self.any:
            return jnp.where(
                jnp.any(jnp.asarray(faults.outlier)) | (jnp.asarray(faults.exchange) > 0),
                -jnp.inf,
                0.0,
            )
        outlier = jnp.asarray(faults.outlier)
        torso = outlier[jnp.array(TORSO_INDEX)]
        at = {
            "exchange": jnp.asarray(faults.exchange),
            "torso_outlier": jnp.where(jnp.any(torso), jnp.argmax(torso) + 1, 0),
            "limb_outlier": outlier[jnp.array(LIMB_INDEX)].astype(int),
        }
        terms: list[jax.Array] = []

        def step(site: str, law: Any) -> jax.Array:
            terms.append(law.log_prob(at[site]))
            return at[site]

        self.compose(counts, step)
        possible = (torso.sum() <= 1) & jnp.all(jnp.asarray(counts) | ~outlier)
        return jnp.where(possible, terms[0] + terms[1] + terms[2], -jnp.inf)


def faults_of(exchange: ArrayLike, torso: ArrayLike, limbs: ArrayLike) -> Faults:
    """The pattern of one exchange; the torso's outlier, 0 for none or 1 + its place among the
    torso's joints; and whether each of `LIMB_INDEX` `(9,)` is an outlier."""
    of_torso = jnp.arange(1, len(TORSO_INDEX) + 1) == jnp.asarray(torso)
    outlier = jnp.zeros(NUM_JOINTS, bool).at[jnp.array(TORSO_INDEX)].set(of_torso)
    outlier = outlier.at[jnp.array(LIMB_INDEX)].set(jnp.asarray(limbs).astype(bool))
    return Faults(jnp.asarray(exchange), outlier)


NO_FAULTS = FaultPrior()
"""The paper's: a detector that errs by a little only."""
