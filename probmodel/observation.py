"""What a detection says, before any root and under one: where each joint was seen on the camera's
plane, and how far from there it may fall.

Here pixels become body units, once, and a joint that does not count is one thing: it may fall
infinitely far.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import ORDERS, Faults
from poseterior.probmodel.errors.laws import ErrorLaw, WithOutliers
from poseterior.probmodel.skeleton import NUM_JOINTS

if TYPE_CHECKING:
    from poseterior.probmodel.root_priors import RootPrior
    from poseterior.probmodel.roots import Root


class Observation(NamedTuple):
    """A detection under one root, a pytree.

    Attributes
    ----------
    root
        The torso and camera.
    target : `(15, 2)`
        The detected joints on the camera's plane, body units; 0 where a joint does not count.
    spread : `(15,)`
        The spread of each joint's error, body units; infinite where a joint does not count.
    law
        The errors' law, in spreads.
    bias : `(15, 2)`
        What was taken off the detected joints for `target`. Errors, spread and bias, are as large
        as things appear where the joint is; the target has the bias of a joint at the pelvis'
        depth.
    definition : `(15, 3)`
        How far from each joint, camera axes, lies what the detector calls so; None where it is the
        joint.
    """

    root: "Root"
    target: np.ndarray | jax.Array
    spread: np.ndarray | jax.Array
    law: "ErrorLaw"
    bias: float | np.ndarray | jax.Array = 0.0
    definition: jax.Array | None = None

    @property
    def seen(self) -> jax.Array:
        """`(15,)` bool: the joints that count."""
        return jnp.isfinite(jnp.asarray(self.spread))

    @property
    def reach(self) -> np.ndarray:
        """`(15,)`: how far each joint may fall from its target, body units; infinite where it does
        not count."""
        return self.law.reach * np.asarray(self.spread)

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in camera axes."""
        return self.root.view

    @property
    def log_peaks(self) -> jax.Array:
        """`(15,)`: the log likelihood of each joint where it projects onto its target at the
        pelvis' depth, per square pixel; for discs -log πτ². 0 where a joint does not count."""
        # An unseen joint's spread is infinite, and would make the slope along the scale NaN.
        pixels = jnp.where(self.seen, jnp.asarray(self.spread), 1.0) * self.root.camera.scale
        return jnp.where(self.seen, self.law.log_peak - 2 * jnp.log(pixels), 0.0)

    @property
    def log_peak(self) -> jax.Array:
        """`()`: the log likelihood of a pose that projects onto every target, all of it at the
        pelvis' depth, per square pixel and joint seen."""
        return jnp.sum(self.log_peaks)

    def defined(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15, 3)`: what the detector looks for in poses of such joints, camera axes."""
        joints = jnp.asarray(joints)
        return joints if self.definition is None else joints + self.definition

    def offsets(self, joints: jax.Array) -> jax.Array:
        """`(15, 2)`: where the joints `(15, 3)` of one pose, in camera axes, fall beside their
        targets, in body units at the joint's own depth."""
        camera, joints = self.root.camera, self.defined(joints)
        larger = camera.magnification(joints)[:, None]
        return (camera.flatten(joints) - self.target - self.bias * (1 - larger)) / larger

    def distances(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: how far the joints `(..., 15, 3)` of poses, in camera axes, fall from their
        targets, body units."""

        def one(joints: jax.Array) -> jax.Array:
            return jnp.linalg.norm(self.offsets(joints), axis=-1)

        return jnp.vectorize(one, signature="(j,x)->(j)")(joints)

    def squares(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: the same distances squared, in spreads; 0 where a joint does not count, and
        infinite where one that does is behind the camera, which has not seen it there."""

        def one(joints: jax.Array) -> jax.Array:
            square = jnp.sum(self.offsets(joints) ** 2, axis=-1) / jnp.asarray(self.spread) ** 2
            depth = self.root.camera.relative_depth(self.defined(joints))
            behind = self.seen & (depth <= 0)
            return jnp.where(behind, jnp.inf, square)

        return jnp.vectorize(one, signature="(j,x)->(j)")(joints)

    def squares_in_reaches(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: the same in reaches: more than 1 where a joint is not explained."""
        return self.squares(joints) / self.law.reach**2

    def log_ratios(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: for each joint, the log of the likelihood over its peak: at most 0, and 0
        where a joint does not count."""
        return jnp.where(self.seen, self.law.log_ratio(self.squares(joints)), 0.0)

    def log_graded(self, joints: ArrayLike, hardness: ArrayLike) -> jax.Array:
        """As `log_ratios`, with slopes for walls: beyond its reach a joint's ratio falls from what
        it is there.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            Of poses, in camera axes.
        hardness
            It falls by `hardness` · (d²/reach² - 1).

        Returns
        -------
        Array
            `(..., 15)`.
        """
        squares, reach = self.squares(joints), self.law.reach**2
        within = jnp.minimum(squares, reach)
        slope = hardness * (squares - within) / reach
        return jnp.where(self.seen, self.law.log_ratio(within) - slope, 0.0)

    def log_walls(self, joints: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """Soft walls Π σ(sharpness · (1 - d²/reach²)) where joints end to be explained, for
        samplers that need slopes.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            Of poses, in camera axes.
        sharpness
            How steep they are.

        Returns
        -------
        Array
            `(...)`: the log of the walls, at most 0.
        """
        inwards = 1 - self.squares_in_reaches(joints)
        walls = jnp.where(self.seen, jax.nn.log_sigmoid(sharpness * inwards), 0.0)
        return jnp.sum(walls, axis=-1)

    def log_smooth(self, joints: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """The sum of `log_ratios`, with soft walls in place of the ends of reaches.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            Of poses, in camera axes.
        sharpness
            How steep the walls are, as of `log_walls`.

        Returns
        -------
        Array
            `(...)`.
        """
        within = jnp.sum(self.log_graded(joints, 0.0), axis=-1)
        return within + self.log_walls(joints, sharpness)

    def log_units(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: what makes of each of `log_ratios` a density per square pixel: the peak,
        less where a joint is nearer to the camera and its spread covers more pixels."""
        magnification = self.root.camera.magnification(self.defined(joints))
        return self.log_peaks - 2 * jnp.where(self.seen, jnp.log(magnification), 0.0)

    def log_unit(self, joints: ArrayLike) -> jax.Array:
        """`(...)`: the sum of `log_units`."""
        return jnp.sum(self.log_units(joints), axis=-1)

    def log_densities(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: the log likelihood of each joint of poses `(..., 15, 3)` in camera axes, per
        square pixel; 0 where a joint does not count."""
        return self.log_units(joints) + self.log_ratios(joints)

    def log_density(self, joints: ArrayLike) -> jax.Array:
        """`(...)`: the log likelihood of poses `(..., 15, 3)` in camera axes, per square pixel and
        joint seen."""
        return jnp.sum(self.log_densities(joints), axis=-1)

    def condition(self, joints: jax.Array) -> None:
        """The sites of a NumPyro model for the joints `(15, 3)` of one pose, in camera axes: where
        they fall (`keypoints`), and what was detected (`detection`)."""
        import numpyro
        from numpyro.handlers import mask

        from poseterior.probmodel.errors.keypoints import DetectedKeypoint

        camera, seen = self.root.camera, self.seen
        numpyro.deterministic("keypoints", camera.image(joints))
        points = self.defined(joints)
        keypoints, larger = camera.image(points), camera.magnification(points)
        target = self.target + self.bias * (1 - larger[:, None])
        detected = jnp.where(seen[:, None], camera.to_pixels(target), keypoints)
        # An unseen joint's spread is infinite, and would make the slope along the scale NaN.
        spread = jnp.where(seen, jnp.asarray(self.spread), 1.0) * camera.scale * larger
        behind = seen & (camera.relative_depth(points) <= 0)
        place = jnp.where(behind[:, None], jnp.inf, keypoints)
        with numpyro.plate("joint", len(seen)), mask(mask=seen):
            law = DetectedKeypoint(self.law, place, spread, validate_args=False)
            numpyro.sample("detection", law, obs=detected)

    def misfit(self, joints: ArrayLike) -> jax.Array:
        """`(...)`: the largest distance of a seen joint from its target, in reaches."""
        return jnp.sqrt(jnp.max(self.squares_in_reaches(joints), axis=-1))

    def within(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)` bool: which joints of poses `(..., 15, 3)` in camera axes lie within their
        reach; all that do not count do."""
        return self.squares(joints) <= self.law.reach**2

    def explains(self, joints: ArrayLike) -> jax.Array:
        """`(...)` bool: whether poses `(..., 15, 3)` in camera axes put every seen joint within its
        reach."""
        return jnp.all(self.within(joints), axis=-1)


class DetectedJoints(NamedTuple):
    """A detection before any root: what `Observation` is made of once there is one; a pytree.

    Attributes
    ----------
    keypoints
        `(15, 2)` pixels, 0 where a joint does not count.
    spread
        `(15,)` of each joint's error in body units, the same under every root; infinite where
        a joint does not count.
    bias
        `(15, 2)` of each keypoint, body units.
    far
        How far from its joint an outlier may lie, body units.
    law
        The errors' law.
    definition
        `(people, 15, 3)` body units, body axes: how far from each joint lies what the detector
        calls so, whatever sides it exchanges, of each torso of the dictionary, or of all alike;
        None where it is the joint.
    """

    keypoints: np.ndarray | jax.Array
    spread: np.ndarray | jax.Array
    bias: np.ndarray | jax.Array
    far: float | jax.Array
    law: "ErrorLaw"
    definition: np.ndarray | jax.Array | None = None

    @property
    def counts(self) -> jax.Array:
        """`(15,)` bool: the keypoints that count."""
        return jnp.isfinite(jnp.asarray(self.spread))

    def read(self, faults: Faults) -> "DetectedJoints":
        """The detection as a pattern of faults has it: what is exchanged put back, outliers with
        their own spread and law; a formula of JAX."""
        order = jnp.asarray(ORDERS)[faults.exchange]
        spread = jnp.asarray(self.spread)[order]
        outlier = jnp.asarray(faults.outlier)[order] & jnp.isfinite(spread)
        return DetectedJoints(
            jnp.asarray(self.keypoints)[order],
            jnp.where(outlier, self.far, spread),
            jnp.where(outlier[:, None], 0.0, jnp.asarray(self.bias)[order]),
            self.far,
            WithOutliers(self.law, outlier),
            self.definition,
        )

    def rays(self, lens: Lens | None) -> np.ndarray | jax.Array:
        """`(15, 2)`: of each joint's line of sight, how far it runs to the side for one in depth; 0
        without a lens, and where a joint does not count."""
        if lens is None:
            return np.zeros((NUM_JOINTS, 2))
        slope = (jnp.asarray(self.keypoints) - jnp.asarray(lens.principal)[None]) / lens.focal
        return jnp.where(self.counts[:, None], slope, 0.0)

    def under(self, prior: "RootPrior", point: Any, faults: Faults | None = None) -> "Observation":
        """The detection under one root of a prior and a pattern of faults, or none; a formula of
        JAX."""
        alike = self.definition is None or len(self.definition) == 1
        return self.at(prior.root(point), faults, None if alike else point.torso)

    def definition_of(self, torso: Any = None) -> Any:
        """`(15, 3)`: the definitions of the dictionary's torso of that index, or their mean; None
        where there are none."""
        if self.definition is None:
            return None
        if torso is None:
            return self.definition.mean(axis=0)
        return jnp.asarray(self.definition)[torso]

    def at(self, root: "Root", faults: Faults | None = None, torso: Any = None) -> "Observation":
        """The detection under a torso and camera: numbers where those are, else a formula of
        JAX. Joints are defined as they are of the dictionary's `torso` of that index."""
        read = self if faults is None else self.read(faults)
        target = root.camera.to_plane(read.keypoints) - read.bias
        xp = jnp if isinstance(target, jax.Array) else np
        seen = xp.isfinite(read.spread)[:, None]
        definition = self.definition_of(torso)
        turned = None if definition is None else root.camera.view(definition)
        target = xp.where(seen, target, 0.0)
        return Observation(root, target, read.spread, read.law, read.bias, turned)

    def log_peak(self) -> jax.Array:
        """`()`: log likelihood of a pose that projects onto every target under a root of scale 1;
        under one of scale s it is lower by 2 log s for every joint that counts."""
        spread = jnp.where(self.counts, jnp.asarray(self.spread), 1.0)
        return jnp.sum(jnp.where(self.counts, self.law.log_peak - 2 * jnp.log(spread), 0.0))
