"""Local axes of the bones, azimuth and elevation in them, and forward kinematics
(docs/model.md § 2).

Conventions are Akhter & Black's, so that their published tables and ours are read by the same code.
A bone vector is *parent minus child*. Their tables live in a left-handed system; poses here are
right-handed, so the axes of upper bones are left-handed triples (w = -u × v) and poses need no
exchange of coordinates. Among local axes all cross products are plain ones. The usual way in:
`pose` (directions → joints) and `articulation` (joints → directions)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.skeleton import (
    BONES,
    JOINT_INDEX,
    LOWER_BONES,
    NUM_JOINTS,
    TORSO_INDEX,
    UPPER_BONES,
)

_IS_LEG = np.array(
    [bone.start in (JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]) for bone in UPPER_BONES], int
)
PARALLEL = 1e-8
"""Below this sine of the angle between a parent bone and the reference direction, the fallback
direction is used."""


class Articulation(NamedTuple):
    """A pose in its own axes: `torso` `(..., 6, 3)`, local unit vectors `upper` `(..., 5, 3)` and
    `lower` `(..., 4, 3)` (parent minus child), `length` `(..., 9)` of each of `skeleton.BONES`."""

    torso: jax.Array
    upper: jax.Array
    lower: jax.Array
    length: jax.Array


def unit(vector: ArrayLike) -> jax.Array:
    """Vectors `(..., 3)` over their lengths; the zero vector stays zero, with a finite gradient."""
    vector = jnp.asarray(vector)
    square = jnp.sum(vector**2, axis=-1, keepdims=True)
    positive = square > 0
    return jnp.where(positive, vector / jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def direction(azimuth: ArrayLike, elevation: ArrayLike) -> jax.Array:
    """Unit vectors `(..., 3)` from azimuth in (-π, π] and elevation in [-π/2, π/2] (radians)."""
    azimuth, elevation = jnp.asarray(azimuth), jnp.asarray(elevation)
    planar = jnp.cos(elevation)
    return jnp.stack(
        [planar * jnp.cos(azimuth), planar * jnp.sin(azimuth), jnp.sin(elevation)], axis=-1
    )


def azimuth_elevation(vector: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Azimuth and elevation (radians) of unit vectors `(..., 3)`; the paper's polar angle is π/2
    minus elevation."""
    x, y, z = jnp.moveaxis(jnp.asarray(vector), -1, 0)
    return jnp.arctan2(y, x), jnp.arctan2(z, jnp.hypot(x, y))


def _left_handed(u: jax.Array, v: jax.Array) -> jax.Array:
    """Gram–Schmidt on (u, v), completed to a left-handed triple; columns of `(..., 3, 3)`."""
    u = unit(u)
    v = unit(v - jnp.sum(u * v, axis=-1, keepdims=True) * u)
    return jnp.stack([u, v, -jnp.cross(u, v)], axis=-1)


def upper_axes(torso: ArrayLike) -> jax.Array:
    """Local axes of the upper bones: u along the shoulders (arms, head) or the hips (legs), v along
    the back.

    Parameters
    ----------
    torso : `(..., 6, 3)`
        In the order of `skeleton.TORSO_JOINTS`.

    Returns
    -------
    axes : `(..., 5, 3, 3)`
        Columns u, v, w of each, a left-handed triple, in the axes of the torso.
    """
    pelvis, thorax, right_shoulder, left_shoulder, right_hip, left_hip = jnp.moveaxis(
        jnp.asarray(torso), -2, 0
    )
    back = pelvis - thorax
    # Differences of two parent-minus-child bones that share their parent: the parent drops out.
    axes = jnp.stack(
        [
            _left_handed(right_shoulder - left_shoulder, back),
            _left_handed(right_hip - left_hip, back),
        ]
    )
    return jnp.moveaxis(axes[jnp.asarray(_IS_LEG)], 0, -3)


def lower_axes(parent: ArrayLike, reference: ArrayLike, fallback: ArrayLike) -> jax.Array:
    """Local axes of a lower bone: u is the parent, v = unit(reference × u), w = u × v.

    Source: Akhter & Black (2015), published model, variables `a` and `di`.

    Parameters
    ----------
    parent : `(3,)`
        The parent's direction in its own local axes.
    reference, fallback : `(3,)`
        Where the parent is parallel to the reference, v is unit(u × fallback) instead.

    Returns
    -------
    axes : `(3, 3)`
        Columns u, v, w in the local axes of the parent.
    """
    parent, reference, fallback = jnp.asarray(parent), jnp.asarray(reference), jnp.asarray(fallback)
    usual = jnp.cross(reference, parent)
    parallel = jnp.sum(usual**2) < PARALLEL**2
    v = unit(jnp.where(parallel, jnp.cross(parent, fallback), usual))
    return jnp.stack([parent, v, jnp.cross(parent, v)], axis=-1)


@jax.jit
def pose(
    torso: ArrayLike,
    upper: ArrayLike,
    lower: ArrayLike,
    length: ArrayLike,
    reference: ArrayLike,
    fallback: ArrayLike,
) -> jax.Array:
    """Forward kinematics.

    Parameters
    ----------
    torso : `(..., 6, 3)`
    upper, lower : `(..., 5, 3)`, `(..., 4, 3)`
        Local unit vectors, parent minus child.
    length : `(..., 9)`
        In the order of `skeleton.BONES`, in the unit of the torso.
    reference, fallback : `(3,)`, `(4, 3)`
        As in `AnatomicalLimits`.

    Returns
    -------
    joints : `(..., 15, 3)`, in the axes of the torso
    """
    one = jnp.vectorize(_pose, signature="(t,x),(u,x),(l,x),(b),(x),(l,x)->(j,x)")
    return one(
        *_same_rank((torso, 2), (upper, 2), (lower, 2), (length, 1), (reference, 1), (fallback, 2))
    )


def _same_rank(*arguments: tuple[ArrayLike, int]) -> list[jax.Array]:
    """Arrays, given with the number of their own axes, with as many batch axes each: ranks are
    promoted here only."""
    arrays = [(jnp.asarray(array), axes) for array, axes in arguments]
    batch = max(array.ndim - axes for array, axes in arrays)
    return [
        array.reshape((1,) * (batch + axes - array.ndim) + array.shape) for array, axes in arrays
    ]


def _pose(
    torso: jax.Array,
    upper: jax.Array,
    lower: jax.Array,
    length: jax.Array,
    reference: jax.Array,
    fallback: jax.Array,
) -> jax.Array:
    axes = upper_axes(torso)
    world_upper = jnp.einsum("nij,nj->ni", axes, upper)
    local = jax.vmap(lower_axes, (0, None, 0))(upper[1:], reference, fallback)
    world_lower = jnp.einsum("nij,njk,nk->ni", axes[1:], local, lower)
    joints = dict(zip(TORSO_INDEX, torso, strict=True))
    for bone, vector, size in zip(BONES, [*world_upper, *world_lower], length, strict=True):
        joints[bone.end] = joints[bone.start] - size * vector
    return jnp.stack([joints[joint] for joint in range(NUM_JOINTS)])


@jax.jit
def articulation(joints: ArrayLike, reference: ArrayLike, fallback: ArrayLike) -> Articulation:
    """Inverse of `pose`: joints `(..., 15, 3)` → torso, local directions and lengths. A bone of
    length zero has the zero vector as its direction."""
    one = jnp.vectorize(_articulation, signature="(j,x),(x),(l,x)->(t,x),(u,x),(l,x),(b)")
    return Articulation(*one(*_same_rank((joints, 2), (reference, 1), (fallback, 2))))


def _articulation(
    joints: jax.Array, reference: jax.Array, fallback: jax.Array
) -> tuple[jax.Array, ...]:
    torso = joints[jnp.array(TORSO_INDEX)]
    vectors = jnp.stack([joints[bone.start] - joints[bone.end] for bone in BONES])
    length = jnp.linalg.norm(vectors, axis=-1)
    axes = upper_axes(torso)
    upper = jnp.einsum("nji,nj->ni", axes, unit(vectors[: len(UPPER_BONES)]))
    local = jax.vmap(lower_axes, (0, None, 0))(upper[1:], reference, fallback)
    lower = jnp.einsum("nkj,nik,ni->nj", local, axes[1:], unit(vectors[-len(LOWER_BONES) :]))
    return torso, upper, lower, length
