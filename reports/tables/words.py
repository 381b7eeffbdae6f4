"""How joints, directions and times are called."""

import math

import numpy as np

from poseterior.probmodel.skeleton import JOINT_INDEX

STEEP = math.cos(math.radians(30))
"""A chest that points closer than 30° to the vertical faces up or down rather than anywhere
sideways."""
NEAR = 30
"""Degrees around a cardinal direction that are called by its name alone."""
CARDINAL = ("towards camera", "right", "away", "left")


def spoken(name: str) -> str:
    """A joint's or bone's name as words."""
    return name.replace("_", " ")


def undetected(name: str) -> str:
    """A joint that was not detected, as words: of the head that is its end, which eyes and ears do
    not tell."""
    return "head's end" if name == "head" else spoken(name)


def facing_words(vector: np.ndarray) -> str:
    """Where a chest `(3,)` in camera axes points, as the picture shows it: "left", "away, right",
    "up" …"""
    x, y, z = (float(value) for value in vector)
    if abs(y) > STEEP * math.hypot(x, y, z):
        return "down" if y > 0 else "up"
    angle = math.degrees(math.atan2(x, -z)) % 360
    nearest = round(angle / 90)
    if abs(angle - 90 * nearest) <= NEAR:
        return CARDINAL[nearest % 4]
    sideways = "right" if x > 0 else "left"
    depth = "away" if z > 0 else "towards camera"
    return f"{depth}, {sideways}"


def pose_facing(joints: np.ndarray) -> np.ndarray:
    """`(..., 3)`: where the chests of poses `(..., 15, 3)` point, in right-handed axes: leftwards ×
    upwards."""
    at = {name: joints[..., index, :] for name, index in JOINT_INDEX.items()}
    left = at["left_shoulder"] - at["right_shoulder"] + at["left_hip"] - at["right_hip"]
    return np.cross(left, at["thorax"] - at["pelvis"])


def duration(seconds: float) -> str:
    """A time in the unit that suits it: "3.5 s", "12.0 min", "4.2 h", "2.1 days"."""
    for size, name in ((86_400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.1f} s"
