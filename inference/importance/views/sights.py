"""What several views say of the joints of a placed body: formulas of JAX for one event.

Under an exchange in each view every joint has a keypoint there; an outlier's disc is summed out,
joint by joint and view by view, so that the cost is linear in both.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from poseterior.probmodel.errors.faults import MOVES_TORSO, ORDERS
from poseterior.probmodel.errors.laws import Disc, ErrorLaw
from poseterior.probmodel.instant import DetectedInstant, ViewFaults
from poseterior.probmodel.rig import CameraRig
from poseterior.probmodel.roots import WorldRoot
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX


class Sights(NamedTuple):
    """What the views say of joints, a pytree; arrays are `(C, 15, ...)`, or `(C, ...)` of one.

    Attributes
    ----------
    keypoint : `(..., 2)`
        Pixels, 0 where it does not count.
    spread
        Body units, 1 where it does not count.
    bias : `(..., 2)`
        Body units.
    outlier
        The prior probability that it is an outlier, as if all were independent.
    counts
        Whether there is one.
    definition : `(..., 3)`
        Body units, body axes: how far from the joint lies what the detector calls so.
    """

    keypoint: jax.Array
    spread: jax.Array
    bias: jax.Array
    outlier: jax.Array
    counts: jax.Array
    definition: jax.Array

    def of(self, joint: jax.Array | int) -> "Sights":
        """One joint's, or some joints'."""
        return Sights(*(part[:, joint] for part in self))

    def sought(self, root: WorldRoot) -> jax.Array:
        """`(C, 6, 3)`: what each view's detector looks for of a torso, in the world, mm."""
        beside = root.camera.view(self.definition[:, jnp.array(TORSO_INDEX)])
        return root.camera.world(root.view[None] + beside)


def sights_of(detected: DetectedInstant, faulty: ViewFaults, exchange: jax.Array) -> Sights:
    """What the views say under exchanges `(C,)`."""
    found = []
    for number, (view, prior) in enumerate(zip(detected.views, faulty.views, strict=True)):
        order = jnp.asarray(ORDERS)[exchange[number]]
        counts = view.counts[order]
        defined = jnp.zeros((NUM_JOINTS, 3)) if view.definition is None else view.definition
        found.append(
            Sights(
                jnp.asarray(view.keypoints)[order],
                jnp.where(counts, jnp.asarray(view.spread)[order], 1.0),
                jnp.asarray(view.bias)[order],
                jnp.where(counts, jnp.asarray(prior.outlier)[order], 0.0),
                counts,
                jnp.asarray(defined),
            )
        )
    return jax.tree.map(lambda *parts: jnp.stack(parts), *found)


class ViewJudge(NamedTuple):
    """What joints are judged by: cameras, the laws of the views, and how far outliers reach there,
    body units; a pytree."""

    rig: CameraRig
    laws: tuple[ErrorLaw, ...]
    far: jax.Array

    @classmethod
    def of(cls, rig: CameraRig, detected: DetectedInstant) -> "ViewJudge":
        """Those of an instant."""
        far = jnp.stack([jnp.asarray(view.far, float) for view in detected.views])
        return cls(
            CameraRig(*map(jnp.asarray, rig)), tuple(view.law for view in detected.views), far
        )

    def log_densities(
        self, sights: Sights, point: jax.Array, size: Any
    ) -> tuple[jax.Array, jax.Array]:
        """`(C,)`, `(C,)`: log density of one joint's keypoints per square pixel, if they are none
        and if they are outliers, where the joint is at a `point` `(3,)` of the world, or at one
        `(C, 3)` for each view; 0 where there is none."""
        arm = jnp.broadcast_to(point, self.rig.centre.shape) - self.rig.centre
        view = jnp.einsum("cab,cb->ca", self.rig.rotation, arm)
        ahead = view[:, 2] > 0
        depth = jnp.where(ahead, view[:, 2], 1.0)
        image = self.rig.focal[:, None] * view[:, :2] / depth[:, None] + self.rig.principal
        unit = self.rig.focal * size / depth
        error = (sights.keypoint - image) / unit[:, None]
        square = jnp.sum((error - sights.bias) ** 2, axis=-1) / sights.spread**2
        ratio = jnp.stack([law.log_ratio(one) for law, one in zip(self.laws, square, strict=True)])
        peak = jnp.array([law.log_peak for law in self.laws])
        level = -2 * jnp.log(unit)
        usual = peak + ratio - 2 * jnp.log(sights.spread) + level
        gone = Disc().log_ratio(jnp.sum(error**2, axis=-1) / self.far**2)
        stray = Disc.log_peak + gone - 2 * jnp.log(self.far) + level
        counts, behind = sights.counts, jnp.where(ahead, 0.0, -jnp.inf)
        return jnp.where(counts, usual + behind, 0.0), jnp.where(counts, stray + behind, 0.0)

    def log_limb(self, sights: Sights, point: jax.Array, size: Any) -> jax.Array:
        """`()`: log density of one joint's keypoints in all views, outliers summed out; not of the
        torso's."""
        usual, stray = self.log_densities(sights, point, size)
        share = sights.outlier
        return jnp.sum(jnp.log((1 - share) * jnp.exp(usual) + share * jnp.exp(stray)))

    def torso_options(
        self, sights: Sights, points: jax.Array, size: Any, exchange: jax.Array
    ) -> jax.Array:
        """`(C, 7)`: log probability with density of the torso's keypoints in each view, if none and
        if each of them is an outlier, where the torso is as `Sights.sought` has it."""
        seen = sights.of(jnp.array(TORSO_INDEX))
        usual, stray = jax.vmap(self.log_densities, (1, 1, None), 1)(seen, points, size)
        share = seen.outlier
        moved = jnp.asarray(MOVES_TORSO)[exchange][:, None]
        odds = jnp.where(moved, 0.0, share / (1 - share))
        itself = jnp.eye(len(TORSO_INDEX), dtype=bool)[None]
        others = jnp.sum(jnp.where(itself, 0.0, usual[:, None]), axis=-1)
        options = jnp.concatenate(
            [usual.sum(axis=1, keepdims=True), jnp.log(odds) + stray + others], axis=1
        )
        return options - jnp.log1p(odds.sum(axis=1, keepdims=True))


def log_exchange(faulty: ViewFaults, exchange: jax.Array) -> jax.Array:
    """`()`: log prior probability of exchanges `(C,)`."""
    shares = jnp.stack([jnp.asarray(view.exchange_probabilities) for view in faulty.views])
    return jnp.sum(jnp.log(jnp.take_along_axis(shares, exchange[:, None], axis=1)))
