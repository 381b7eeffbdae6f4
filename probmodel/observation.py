"""What a detection says under one root: where each joint was seen on the camera's plane, and how
far from there it may fall.

Here pixels have become body units, once, and a joint that does not count is one thing: it may fall
infinitely far.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

if TYPE_CHECKING:
    from poseterior.probmodel.errors.laws import ErrorLaw
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
    """

    root: "Root"
    target: np.ndarray | jax.Array
    spread: np.ndarray | jax.Array
    law: "ErrorLaw"
    bias: float | np.ndarray | jax.Array = 0.0

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

    def offsets(self, joints: jax.Array) -> jax.Array:
        """`(15, 2)`: where the joints `(15, 3)` of one pose, in camera axes, fall beside their
        targets, in body units at the joint's own depth."""
        camera = self.root.camera
        larger = camera.magnification(joints)[:, None]
        return (camera.flatten(joints) - self.target - self.bias * (1 - larger)) / larger

    def distances(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: how far the joints `(..., 15, 3)` of poses, in camera axes, fall from their
        targets, body units."""

        def one(joints: jax.Array) -> jax.Array:
            return jnp.linalg.norm(self.offsets(joints), axis=-1)

        return jnp.vectorize(one, signature="(j,x)->(j)")(joints)

    def squares(self, joints: ArrayLike) -> jax.Array:
        """`(..., 15)`: the same distances squared, in spreads; 0 where a joint does not count."""

        def one(joints: jax.Array) -> jax.Array:
            offset = self.offsets(joints)
            return jnp.sum(offset**2, axis=-1) / jnp.asarray(self.spread) ** 2

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
        magnification = self.root.camera.magnification(jnp.asarray(joints))
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
