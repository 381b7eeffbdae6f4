"""The measures that have a name, and what fifteen joints cannot give.

Angles of shoulders and hips are the joint coordinates that the International Society of
Biomechanics recommends (Wu et al. 2002, 2005), with joints in the place of bony landmarks. What
needs a segment's turn about itself is given only where the next segment shows it: the humerus' by
the bent elbow, the femur's by the bent knee. Fifteen joints do not tell the pelvis' tilt against
the lumbar spine (so that hips are counted against the trunk), varus and valgus and the tibia's
rotation at the knee, pro- and supination, wrists, ankles, feet, shoulder blades, the spine's shape,
or the head's turn: no such thing is in the registry. Nor can a flexion of an elbow or a knee be
told from a hyperextension by as much, as the plane of the two bones is all there is."""

import functools
from collections.abc import Callable

import numpy as np

from poseterior.probmodel.measures.axes import (
    SIDES,
    UPWARD,
    across,
    angle_between,
    between,
    components,
    pelvis_axes,
    place,
    standing_axes,
    thorax_axes,
    unit_vector,
)
from poseterior.probmodel.measures.measure import Kind, Measure

WU_2002 = "Wu et al. 2002, J. Biomech. 35:543 (ISB: ankle, hip, spine)"
WU_2005 = "Wu et al. 2005, J. Biomech. 38:981 (ISB: shoulder, elbow, wrist, hand)"
GROOD = "Grood & Suntay 1983, J. Biomech. Eng. 105:136"
WATERS = "Waters et al. 1993, Ergonomics 36:749 (revised NIOSH lifting equation)"
PLAIN = "angle with the vertical of the camera"
WINTER = "Winter 2009, Biomechanics and Motor Control of Human Movement, 4th ed."
Sided = Callable[[np.ndarray, str], np.ndarray]
"""Joints `(..., 15, 3)` and a side → numbers `(...)`."""


def _turn(sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(sine, cosine))


# --- elbows and knees


def _flexion(joints: np.ndarray, side: str, upper: str, hinge: str, end: str) -> np.ndarray:
    above = between(joints, f"{side}_{upper}", f"{side}_{hinge}")
    return angle_between(above, between(joints, f"{side}_{hinge}", f"{side}_{end}"))


# --- shoulders


def _humerus(joints: np.ndarray, side: str) -> np.ndarray:
    """`(..., 3)`: from shoulder to elbow, in the thorax' axes."""
    axes = thorax_axes(joints, side)
    return components(unit_vector(between(joints, f"{side}_shoulder", f"{side}_elbow")), axes)


def _plane_of_elevation(joints: np.ndarray, side: str) -> np.ndarray:
    forward, _, lateral = np.moveaxis(_humerus(joints, side), -1, 0)
    return _turn(forward, lateral)


def _elevation(joints: np.ndarray, side: str) -> np.ndarray:
    return angle_between(_humerus(joints, side), np.array([0.0, -1.0, 0.0]))


def _humeral_rotation(joints: np.ndarray, side: str) -> np.ndarray:
    """The third angle of the sequence Y-X-Y. The humerus' lateral axis is perpendicular to the
    plane of arm and forearm (the second option of Wu et al.), its forward axis to both."""
    axes = thorax_axes(joints, side)
    arm = components(unit_vector(between(joints, f"{side}_elbow", f"{side}_shoulder")), axes)
    forearm = components(between(joints, f"{side}_wrist", f"{side}_elbow"), axes)
    lateral = unit_vector(np.cross(arm, forearm))
    forward = np.cross(arm, lateral)
    return _turn(-forward[..., 1], lateral[..., 1])


# --- hips


def _femur(joints: np.ndarray, side: str) -> np.ndarray:
    """`(..., 3)`: from hip to knee, in the pelvis' axes."""
    axes = pelvis_axes(joints, side)
    return components(unit_vector(between(joints, f"{side}_hip", f"{side}_knee")), axes)


def _hip_flexion(joints: np.ndarray, side: str) -> np.ndarray:
    forward, up, _ = np.moveaxis(_femur(joints, side), -1, 0)
    return _turn(forward, -up)


def _hip_adduction(joints: np.ndarray, side: str) -> np.ndarray:
    forward, up, lateral = np.moveaxis(_femur(joints, side), -1, 0)
    return _turn(-lateral, np.hypot(forward, up))


def _hip_rotation(joints: np.ndarray, side: str) -> np.ndarray:
    """The third angle of the sequence Z-X-Y. The femur's lateral axis is perpendicular to the plane
    of thigh and shank, its forward axis to both."""
    axes = pelvis_axes(joints, side)
    thigh = components(unit_vector(between(joints, f"{side}_knee", f"{side}_hip")), axes)
    shank = components(between(joints, f"{side}_ankle", f"{side}_knee"), axes)
    lateral = unit_vector(np.cross(shank, thigh))
    forward = np.cross(thigh, lateral)
    return _turn(-forward[..., 2], lateral[..., 2])


# --- against the vertical


def _hanging(joints: np.ndarray, side: str, start: str, end: str) -> np.ndarray:
    return angle_between(between(joints, f"{side}_{start}", f"{side}_{end}"), -UPWARD)


def _inclination(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    return angle_between(between(joints, start, end), UPWARD)


def _lean(joints: np.ndarray, direction: int) -> np.ndarray:
    back = components(between(joints, "pelvis", "thorax"), standing_axes(joints))
    return _turn(back[..., direction], back[..., 1])


def _trunk_rotation(joints: np.ndarray) -> np.ndarray:
    """Of the shoulders against the hips, about the back."""
    back = unit_vector(between(joints, "pelvis", "thorax"))
    hips = across(between(joints, "left_hip", "right_hip"), back)
    shoulders = across(between(joints, "left_shoulder", "right_shoulder"), back)
    return _turn(
        np.sum(np.cross(hips, shoulders) * back, axis=-1), np.sum(hips * shoulders, axis=-1)
    )


def _neck_bend(joints: np.ndarray) -> np.ndarray:
    return angle_between(between(joints, "pelvis", "thorax"), between(joints, "thorax", "head"))


# --- lengths


def height_above_feet(joints: np.ndarray, name: str) -> np.ndarray:
    """`(...)`: of a joint above the lower ankle."""
    ankles = np.stack([place(joints, f"{side}_ankle") @ UPWARD for side in SIDES])
    return place(joints, name) @ UPWARD - ankles.min(axis=0)


def _hand_height(joints: np.ndarray, side: str) -> np.ndarray:
    return height_above_feet(joints, f"{side}_wrist")


def _reach(joints: np.ndarray, side: str) -> np.ndarray:
    feet = (place(joints, "right_ankle") + place(joints, "left_ankle")) / 2
    return np.linalg.norm(across(place(joints, f"{side}_wrist") - feet, UPWARD), axis=-1)


def _step(joints: np.ndarray, direction: int) -> np.ndarray:
    apart = between(joints, "left_ankle", "right_ankle")
    return components(apart, standing_axes(joints))[..., direction]


# --- the registry

_SIDED: tuple[tuple[str, Sided, Kind, str, str], ...] = (
    (
        "elbow_flexion",
        functools.partial(_flexion, upper="shoulder", hinge="elbow", end="wrist"),
        "angle",
        "0 where the arm is straight; in the plane of arm and forearm",
        WU_2005,
    ),
    (
        "shoulder_plane",
        _plane_of_elevation,
        "turn",
        "plane of elevation about the thorax' up axis: 0 is abduction, 90 forward flexion; open"
        " where the arm hangs or points up",
        WU_2005,
    ),
    (
        "shoulder_elevation",
        _elevation,
        "angle",
        "0 where the arm hangs along the thorax, 180 where it points up (negative in Wu et al.)",
        WU_2005,
    ),
    (
        "shoulder_rotation",
        _humeral_rotation,
        "turn",
        "about the humerus, internal positive, third of Y-X-Y; shown by the forearm, so open where"
        " the elbow is straight, or the arm hangs or points up",
        WU_2005,
    ),
    (
        "hip_flexion",
        _hip_flexion,
        "turn",
        "of the thigh against the trunk, about the line of the hips; flexion positive",
        WU_2002,
    ),
    (
        "hip_adduction",
        _hip_adduction,
        "angle",
        "of the thigh out of the plane across the hips' line; adduction positive, abduction"
        " negative",
        WU_2002,
    ),
    (
        "hip_rotation",
        _hip_rotation,
        "turn",
        "about the femur, internal positive, third of Z-X-Y; shown by the shank, so open where the"
        " knee is straight",
        WU_2002,
    ),
    (
        "knee_flexion",
        functools.partial(_flexion, upper="hip", hinge="knee", end="ankle"),
        "angle",
        "0 where the leg is straight; in the plane of thigh and shank",
        GROOD,
    ),
    (
        "upper_arm_elevation",
        functools.partial(_hanging, start="shoulder", end="elbow"),
        "angle",
        "0 where it hangs vertically, 180 where it points up",
        PLAIN,
    ),
    (
        "thigh_elevation",
        functools.partial(_hanging, start="hip", end="knee"),
        "angle",
        "0 where it hangs vertically, 90 where it is level",
        PLAIN,
    ),
    (
        "shank_elevation",
        functools.partial(_hanging, start="knee", end="ankle"),
        "angle",
        "0 where it hangs vertically, 90 where it is level",
        PLAIN,
    ),
    (
        "hand_height",
        _hand_height,
        "length",
        "of the wrist above the lower ankle, vertically",
        WATERS,
    ),
    (
        "reach",
        _reach,
        "length",
        "of the wrist from midway between the ankles, on the level",
        WATERS,
    ),
)
"""Of the right and the left: name, how, kind, convention, source."""
_WHOLE: tuple[Measure, ...] = (
    Measure(
        "trunk_inclination",
        functools.partial(_inclination, start="pelvis", end="thorax"),
        "angle",
        "of the back, from pelvis to thorax; 0 where it is vertical",
        PLAIN,
    ),
    Measure(
        "trunk_forward_lean",
        functools.partial(_lean, direction=0),
        "turn",
        "of the back in the vertical plane across the hips' line; forwards positive",
        PLAIN,
    ),
    Measure(
        "trunk_side_lean",
        functools.partial(_lean, direction=2),
        "turn",
        "of the back in the vertical plane of the hips' line; to the right positive",
        PLAIN,
    ),
    Measure(
        "trunk_rotation",
        _trunk_rotation,
        "turn",
        "of the shoulders against the hips, about the back; to the left positive",
        WU_2005,
    ),
    Measure(
        "head_inclination",
        functools.partial(_inclination, start="thorax", end="head"),
        "angle",
        "of the line from thorax to the head's end; 0 where it is vertical",
        PLAIN,
    ),
    Measure("neck_bend", _neck_bend, "angle", "of that line against the back", PLAIN),
    Measure(
        "step_length",
        functools.partial(_step, direction=0),
        "length",
        "between the ankles, along the way the pelvis faces; positive where the right one is ahead",
        WINTER,
    ),
    Measure(
        "step_width",
        functools.partial(_step, direction=2),
        "length",
        "between the ankles, across that way; negative where the legs cross",
        WINTER,
    ),
)


def _on(of: Sided, side: str, joints: np.ndarray) -> np.ndarray:
    return of(joints, side)


def _registry() -> dict[str, Measure]:
    sided = [
        Measure(f"{side}_{name}", functools.partial(_on, of, side), kind, convention, source)
        for name, of, kind, convention, source in _SIDED
        for side in SIDES
    ]
    return {one.name: one for one in (*sided, *_WHOLE)}


MEASURES = _registry()
"""Every measure by its name."""
_FLEXIONS = ("elbow_flexion", "shoulder_elevation", "hip_flexion", "knee_flexion")
USUAL = (
    *(f"{side}_{name}" for name in _FLEXIONS for side in SIDES),
    *("trunk_forward_lean", "trunk_rotation", "step_length", "step_width"),
)
"""Those that pictures have where nobody says which."""
