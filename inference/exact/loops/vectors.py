"""Vectors of three numbers and axes of three vectors, as tuples, for the compiled
loops.

Tuples, because an array would be read anew at every step and would keep a loop from
becoming vector instructions. A bone points from child to parent, an image from the
limb's start outwards: hence the minus signs where one becomes the other."""

import math

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.probmodel.kinematics import PARALLEL

Vector = tuple[float, float, float]
Axes = tuple[Vector, Vector, Vector]
"""Three vectors: the rows of a matrix."""
Plane = tuple[float, float]
"""A vector in a plane parallel to the image."""
Reference = tuple[float, float, float, float, float, float]
"""Reference direction of the lower frames and its fallback."""


@compiled
def axes_of(matrix: np.ndarray) -> Axes:
    """The rows of a matrix `(3, 3)`."""
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


Rows = tuple[float, float, float, float, float, float, float, float, float]
"""A matrix (3, 3), row by row."""


@compiled
def rows_of(matrix: np.ndarray) -> Rows:
    """A matrix `(3, 3)` as numbers."""
    first, second, third = axes_of(matrix)
    return first + second + third


@inlined
def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def minus(a: Vector) -> Vector:
    """The opposite vector."""
    return -a[0], -a[1], -a[2]


@inlined
def into(axes: Axes, vector: Vector) -> Vector:
    """A vector's coordinates along three axes."""
    return dot(axes[0], vector), dot(axes[1], vector), dot(axes[2], vector)


@inlined
def out_of(axes: Axes, part: Vector) -> Vector:
    """The vector that has such coordinates along three axes."""
    a, b, c = axes
    return (
        a[0] * part[0] + b[0] * part[1] + c[0] * part[2],
        a[1] * part[0] + b[1] * part[1] + c[1] * part[2],
        a[2] * part[0] + b[2] * part[1] + c[2] * part[2],
    )


@inlined
def image_of(axes: Axes, bone: Vector) -> Plane:
    """What a bone of length one moves across the line of sight, from joint to joint."""
    return -dot(axes[0], bone), -dot(axes[1], bone)


@inlined
def lower_axes(u: Vector, reference: Reference) -> tuple[Vector, Vector, float]:
    """`kinematics.lower_axes` below one upper bone `u`: the second and the third axis,
    and the sine of its angle to the reference direction."""
    a0, a1, a2, f0, f1, f2 = reference
    usual = cross((a0, a1, a2), u)
    other = cross(u, (f0, f1, f2))
    square = dot(usual, usual)
    parallel = square < PARALLEL**2
    # Number by number: a choice between tuples would be a branch.
    v0 = other[0] if parallel else usual[0]
    v1 = other[1] if parallel else usual[1]
    v2 = other[2] if parallel else usual[2]
    scale = 1 / math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v = v0 * scale, v1 * scale, v2 * scale
    return v, cross(u, v), math.sqrt(square)
