"""Which detections of several views are wrong: outliers of each view given body, pose and
exchanges, which the weights have summed out."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.importance.views.sights import ViewJudge, sights_of
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import ORDERS, Faults
from poseterior.probmodel.instant import DetectedInstant, InstantPosterior, ViewFaults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import WorldPrior
from poseterior.probmodel.roots import WorldPoint
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX


def drawn_faults(
    posterior: InstantPosterior,
    points: WorldPoint,
    poses: Pose,
    exchange: np.ndarray,
    rng: np.random.Generator,
) -> Faults:
    """Patterns of faults `(n, C, ...)`, given all else: exchanges `(n, C)`, and outliers of their
    law there."""
    views = len(posterior.faults.views)
    if not len(exchange) or not posterior.faults.any:
        return Faults(exchange, np.zeros((len(exchange), views, NUM_JOINTS), bool))
    given = posterior.model, posterior.detected, posterior.faults, posterior.root_prior
    shares = functools.partial(_shares, *given)
    limbs, options = in_chunks(shares, *map(np.asarray, (*points, *poses)), exchange)
    outlier = rng.random(limbs.shape) < limbs
    sums = np.cumsum(options, axis=-1)
    torso = np.sum(sums[..., :-1] < rng.random((*sums.shape[:-1], 1)), axis=-1)
    outlier[..., list(TORSO_INDEX)] = torso[..., None] == 1 + np.arange(len(TORSO_INDEX))
    # By the names of keypoints: an exchange undoes itself.
    return Faults(exchange, np.take_along_axis(outlier, ORDERS[exchange], axis=-1))


@kept
def _shares(
    model: PoseModel,
    detected: DetectedInstant,
    faulty: ViewFaults,
    prior: WorldPrior,
    *rows: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Probabilities that joints' keypoints are outliers: `(n, C, 15)`, those that are not the
    torso's, and `(n, C, 7)`, that none and that each of the torso's is."""
    judge = ViewJudge.of(prior.rig, detected)
    parts = len(WorldPoint._fields)

    def one(point: WorldPoint, pose: Pose, exchange: jax.Array) -> tuple[jax.Array, jax.Array]:
        root, sights = prior.root(point), sights_of(detected, faulty, exchange)
        own = judge._replace(rig=root.camera.rig)
        world, size = root.camera.world(model.joints(root.view, *pose)), root.camera.size
        usual, stray = jax.vmap(own.log_densities, (1, 0, None), 1)(sights, world, size)
        odds = jnp.log(sights.outlier) + stray - jnp.log1p(-sights.outlier) - usual
        torso = own.torso_options(sights, sights.sought(root), size, exchange)
        return jax.nn.sigmoid(odds), jax.nn.softmax(torso, axis=-1)

    return jax.vmap(one)(WorldPoint(*rows[:parts]), Pose(*rows[parts:-1]), rows[-1])
