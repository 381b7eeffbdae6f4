"""Exact draws that stay where they are made, on JAX's device: for a GPU, whose results would take
longer to bring home than to draw.

    draws = resident_draws(model, frame, key=key, num_samples=10_000_000)
    joints = model.joints(view, *draws.poses)     # on the device too
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from poseterior.inference.draws import MAX_PROPOSALS, key_of
from poseterior.inference.exact.device.group import device_groups, place_group
from poseterior.inference.exact.mixture import RootSampler
from poseterior.inference.exact.rates import Budget
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES


class Resident(NamedTuple):
    """Exact draws under one candidate, on the device.

    Attributes
    ----------
    poses
        `(n, ...)`, JAX arrays in double precision, independent and in random order.
    log_evidence, log_evidence_se
        As in `inference.evidences.Evidence`.
    num_proposals
        Attempts at groups of limbs.
    """

    poses: Pose
    log_evidence: float
    log_evidence_se: float
    num_proposals: int


def resident_draws(
    model: PoseModel,
    frame: Estimate,
    *,
    key: jax.Array | int,
    num_samples: int,
    candidate: int = 0,
    max_proposals: int = MAX_PROPOSALS,
) -> Resident:
    """Draws from the posterior of a detection under one candidate, and leaves them on the device.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates.
    key
        Of all draws: the same key, the same draws, on one kind of device.
    num_samples
        How many draws.
    candidate
        Which candidate.
    max_proposals
        Most attempts at groups of limbs; where they end first, there are fewer draws.

    Returns
    -------
    Resident
        The draws. What is computed from them stays in double precision where JAX is set so
        (`jax_enable_x64`).

    Raises
    ------
    BadInput
        On a number of samples below one, and on a candidate that there is not.
    """
    require_some(num_samples, "samples")
    posterior = frame.posterior(model, CANDIDATES)
    if not 0 <= candidate < len(posterior.candidates):
        raise BadInput(
            f"there is no candidate {candidate}; choose from 0 to {len(posterior.candidates) - 1}"
        )
    observation, budget = posterior.observations[candidate], Budget(max_proposals)
    groups = device_groups(key_of(key), model, observation)
    body = RootSampler(model, observation, groups)
    body.more(num_samples, budget)
    with jax.enable_x64(True):
        rooms = {group.name: group.room for group in groups}
        poses = _assembled(rooms, min(num_samples, body.held))
    return Resident(poses, body.log_evidence, body.log_evidence_se, budget.spent)


@functools.partial(jax.jit, static_argnums=1)
def _assembled(rooms: dict[str, jax.Array], number: int) -> Pose:
    """The first so many whole bodies of the groups' rooms."""
    poses = Pose(*map(jnp.asarray, Pose.blank(number)))
    for name, room in rooms.items():
        poses = place_group(poses, room[:, :number], name)
    return poses
