"""Measures of poses: by hand on constructed ones, left and right, and against rotation matrices
that are built from the text of the ISB's recommendations, turned into angles by other packages."""

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.measures import FUNCTIONS, MEASURES, USUAL, measure_of, wrapped
from poseterior.probmodel.measures.catalogue import Measure
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, MIRROR

HUNDREDTH = 0.01
"""Degrees."""
CAMERA = np.diag([1.0, -1.0, -1.0])
"""From axes right, up, towards the camera to the camera's; of somebody who looks away from it."""


def standing(**moved: tuple[float, float, float]) -> np.ndarray:
    """`(15, 3)`: somebody who stands with hanging arms, back to the camera, in camera axes. Places
    are given as (right, up, forward), and may be moved."""
    places: dict[str, tuple[float, float, float]] = {
        "pelvis": (0, 0, 0),
        "thorax": (0, 1.5, 0),
        "head": (0, 2.2, 0),
    }
    for side, sign in (("right", 1.0), ("left", -1.0)):
        places |= {
            f"{side}_shoulder": (0.5 * sign, 1.4, 0),
            f"{side}_elbow": (0.5 * sign, 0.5, 0),
            f"{side}_wrist": (0.5 * sign, -0.3, 0),
            f"{side}_hip": (0.3 * sign, -0.1, 0),
            f"{side}_knee": (0.3 * sign, -1.3, 0),
            f"{side}_ankle": (0.3 * sign, -2.5, 0),
        }
    places |= moved
    # Forward is away from the camera: z of camera axes; up is -y.
    return np.array([[right, -up, ahead] for right, up, ahead in map(places.__getitem__, JOINTS)])


def value(name: str, joints: np.ndarray) -> float:
    return float(measure_of(name).of(joints))


SHOULDER = np.array([0.5, 1.4, 0.0])
HIP = np.array([0.3, -0.1, 0.0])


def arm(upper: tuple, fore: tuple) -> np.ndarray:
    """Somebody whose right arm and forearm point somewhere (right, up, forward)."""
    elbow = SHOULDER + 0.9 * np.array(upper)
    return standing(right_elbow=tuple(elbow), right_wrist=tuple(elbow + 0.8 * np.array(fore)))


def leg(thigh: tuple, shank: tuple) -> np.ndarray:
    """The same of the right leg."""
    knee = HIP + 1.2 * np.array(thigh)
    return standing(right_knee=tuple(knee), right_ankle=tuple(knee + 1.2 * np.array(shank)))


DOWN, UP, AHEAD, BACK, RIGHT, LEFT = (
    (0, -1, 0),
    (0, 1, 0),
    (0, 0, 1),
    (0, 0, -1),
    (1, 0, 0),
    (-1, 0, 0),
)
HALF = 2**-0.5
BY_HAND = [
    ("elbow_flexion", arm(DOWN, DOWN), 0.0),
    ("elbow_flexion", arm(DOWN, AHEAD), 90.0),
    ("elbow_flexion", arm(AHEAD, (0, HALF, -HALF)), 135.0),
    ("shoulder_elevation", arm(DOWN, DOWN), 0.0),
    ("shoulder_elevation", arm(RIGHT, RIGHT), 90.0),
    ("shoulder_elevation", arm(UP, UP), 180.0),
    ("shoulder_plane", arm(RIGHT, RIGHT), 0.0),
    ("shoulder_plane", arm(AHEAD, AHEAD), 90.0),
    ("shoulder_plane", arm((HALF, 0, HALF), UP), 45.0),
    # A raised arm whose forearm points up is turned outwards, one that points down inwards.
    ("shoulder_rotation", arm(RIGHT, UP), -90.0),
    ("shoulder_rotation", arm(RIGHT, AHEAD), 0.0),
    ("shoulder_rotation", arm(RIGHT, DOWN), 90.0),
    ("hip_flexion", leg(DOWN, DOWN), 0.0),
    ("hip_flexion", leg(AHEAD, DOWN), 90.0),
    ("hip_flexion", leg((0, -HALF, -HALF), BACK), -45.0),
    ("hip_adduction", leg((HALF, -HALF, 0), DOWN), -45.0),
    ("hip_adduction", leg((-0.5, -(0.75**0.5), 0), DOWN), 30.0),
    # Of a thigh that points ahead, the foot goes outwards as it turns inwards.
    ("hip_rotation", leg(AHEAD, DOWN), 0.0),
    ("hip_rotation", leg(AHEAD, (HALF, -HALF, 0)), 45.0),
    ("hip_rotation", leg(AHEAD, (-HALF, -HALF, 0)), -45.0),
    ("knee_flexion", leg(DOWN, DOWN), 0.0),
    ("knee_flexion", leg(AHEAD, DOWN), 90.0),
    ("upper_arm_elevation", arm(AHEAD, UP), 90.0),
    ("thigh_elevation", leg(AHEAD, DOWN), 90.0),
    ("shank_elevation", leg(DOWN, BACK), 90.0),
    ("hand_height", arm(AHEAD, AHEAD), 3.9),
    ("reach", arm(AHEAD, AHEAD), (0.5**2 + 1.7**2) ** 0.5),
]


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("name", "joints", "wanted"), BY_HAND)
def test_by_hand(name: str, joints: np.ndarray, wanted: float, side: str) -> None:
    if side == "left":  # the same in a mirror
        joints = joints[list(MIRROR)] * np.array([-1.0, 1.0, 1.0])
    found = value(f"{side}_{name}", joints)
    assert float(wrapped(np.asarray(found - wanted))) == pytest.approx(0.0, abs=HUNDREDTH)


@pytest.mark.parametrize(
    ("name", "moved", "wanted"),
    [
        ("trunk_inclination", {"thorax": (0, HALF, HALF)}, 45.0),
        ("trunk_forward_lean", {"thorax": (0, HALF, HALF)}, 45.0),
        ("trunk_forward_lean", {"thorax": (0, 0.75**0.5, -0.5)}, -30.0),
        ("trunk_side_lean", {"thorax": (0.5, 0.75**0.5, 0)}, 30.0),
        ("trunk_side_lean", {"thorax": (-0.5, 0.75**0.5, 0)}, -30.0),
        ("trunk_rotation", {"right_shoulder": (0, 1.4, 0.5), "left_shoulder": (0, 1.4, -0.5)}, 90),
        ("trunk_rotation", {"right_shoulder": (0, 1.4, -0.5), "left_shoulder": (0, 1.4, 0.5)}, -90),
        ("head_inclination", {"head": (0.7, 1.5, 0)}, 90.0),
        ("neck_bend", {"head": (0, 1.5 - HALF, HALF)}, 135.0),
        ("step_length", {"right_ankle": (0.3, -2.5, 0.8)}, 0.8),
        ("step_length", {"left_ankle": (-0.3, -2.5, 0.8)}, -0.8),
        ("step_width", {"right_ankle": (-0.5, -2.5, 0.8)}, -0.2),
        ("angle(right_hip,right_knee,right_ankle)", {"right_ankle": (0.3, -1.3, -1)}, 90.0),
        ("inclination(pelvis,thorax)", {}, 0.0),
        ("distance(left_wrist,right_wrist)", {}, 1.0),
        ("level(left_wrist, right_wrist)", {"left_wrist": (-0.5, 3, 0)}, 1.0),
        ("height(head)", {}, 4.7),
        ("depth(left_wrist,right_wrist)", {"right_wrist": (0.5, 0, 0.4)}, 0.4),
    ],
)
def test_by_hand_of_the_whole(name: str, moved: dict, wanted: float) -> None:
    assert value(name, standing(**moved)) == pytest.approx(wanted, abs=HUNDREDTH)


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    """`(500, 15, 3)`: any shapes, turned any way, no smaller than a grain."""
    rng = np.random.default_rng(46)
    return standing() + rng.normal(scale=0.4, size=(500, 15, 3))


# --- a second route: matrices from the text, angles by SciPy or Kinetics Toolkit


def frame(first: str, vector: np.ndarray, second: str, near: np.ndarray) -> np.ndarray:
    """`(n, 3, 3)`, columns X, Y, Z, right-handed: one axis along a vector, another in the plane of
    that and a second vector, the third perpendicular to both."""
    order = "XYZ"
    i, j = order.index(first), order.index(second)
    k = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    one = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    third = sign * np.cross(one, near)
    third /= np.linalg.norm(third, axis=1, keepdims=True)
    axes = np.empty((len(vector), 3, 3))
    axes[:, :, i], axes[:, :, k] = one, third
    axes[:, :, j] = sign * np.cross(third, one)
    return axes


def at(poses: np.ndarray, name: str) -> np.ndarray:
    return poses[:, JOINT_INDEX[name]] @ CAMERA  # right, up, towards the camera: right-handed


def thorax(poses: np.ndarray) -> np.ndarray:
    right = at(poses, "right_shoulder") - at(poses, "left_shoulder")
    return frame("Y", at(poses, "thorax") - at(poses, "pelvis"), "Z", right)


def pelvis(poses: np.ndarray) -> np.ndarray:
    up = at(poses, "thorax") - at(poses, "pelvis")
    return frame("Z", at(poses, "right_hip") - at(poses, "left_hip"), "Y", up)


def humerus(poses: np.ndarray) -> np.ndarray:
    """Yh2 from elbow to shoulder; Zh2 perpendicular to the plane of Yh2 and Yf; Xh2 to both."""
    arm = at(poses, "right_shoulder") - at(poses, "right_elbow")
    forearm = at(poses, "right_elbow") - at(poses, "right_wrist")
    return frame("Y", arm, "Z", np.cross(arm, forearm))


def femur(poses: np.ndarray) -> np.ndarray:
    """y from knee to hip, z perpendicular to the plane of thigh and shank, to the right."""
    thigh = at(poses, "right_hip") - at(poses, "right_knee")
    shank = at(poses, "right_knee") - at(poses, "right_ankle")
    return frame("Y", thigh, "Z", np.cross(shank, thigh))


AnglesOf = Callable[[np.ndarray, str], np.ndarray]


def by_scipy(matrices: np.ndarray, sequence: str) -> np.ndarray:
    return Rotation.from_matrix(matrices).as_euler(sequence, degrees=True)


def by_kineticstoolkit(matrices: np.ndarray, sequence: str) -> np.ndarray:
    try:
        ktk = importlib.import_module("kineticstoolkit.lab")
    except ImportError:
        pytest.skip("Kinetics Toolkit is not installed")
    whole = np.tile(np.eye(4), (len(matrices), 1, 1))
    whole[:, :3, :3] = matrices
    return ktk.geometry.get_angles(whole, sequence, degrees=True)


def shoulders(angles: np.ndarray) -> dict[str, np.ndarray]:
    """Y-X-Y: plane of elevation, elevation (negative), rotation; the other solution where the
    second angle is positive."""
    flip = angles[:, 1] > 0
    plane = angles[:, 0] + 180 * flip
    return {
        "plane": plane,
        "elevation": np.abs(angles[:, 1]),
        "rotation": angles[:, 2] + 180 * flip,
    }


@pytest.mark.parametrize("angles_of", [by_scipy, by_kineticstoolkit])
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.filterwarnings("ignore")  # of the other package
def test_against_matrices_from_the_text(poses: np.ndarray, angles_of: AnglesOf, side: str) -> None:
    mirrored = poses if side == "right" else poses[:, list(MIRROR)] * np.array([-1.0, 1, 1])
    turns = angles_of(np.swapaxes(thorax(poses), 1, 2) @ humerus(poses), "YXY")
    wanted = {f"shoulder_{name}": angle for name, angle in shoulders(turns).items()}
    turns = angles_of(np.swapaxes(pelvis(poses), 1, 2) @ femur(poses), "ZXY")
    wanted |= dict(zip(("hip_flexion", "hip_adduction", "hip_rotation"), turns.T, strict=True))
    for name, angle in wanted.items():
        off = wrapped(MEASURES[f"{side}_{name}"].of(mirrored) - angle)
        assert np.abs(off).max() < HUNDREDTH, name


def test_a_turned_sign_is_noticed(poses: np.ndarray) -> None:
    """The control of the witness: it tells inner from outer rotation, and left from right."""
    turns = by_scipy(np.swapaxes(pelvis(poses), 1, 2) @ femur(poses), "ZXY")[:, 2]
    off = wrapped(-MEASURES["right_hip_rotation"].of(poses) - turns)
    assert np.median(np.abs(off)) > 10
    other = wrapped(MEASURES["left_hip_rotation"].of(poses) - turns)
    assert np.median(np.abs(other)) > 10


# --- what holds for all


@pytest.mark.parametrize("one", MEASURES.values(), ids=lambda one: one.name)
def test_sizes_and_sides(one: Measure, poses: np.ndarray) -> None:
    """Angles do not know how large a body is, lengths grow with it; a mirror exchanges the sides;
    whoever walks aside or turns about the vertical keeps all."""
    plain = one.of(poses)
    assert plain.shape == (500,)
    assert np.isfinite(plain).all()
    grown = one.of(3 * poses + np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(grown, 3 * plain if one.kind == "length" else plain, atol=1e-9)
    turn = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    off = one.of(poses @ turn.T) - plain
    assert np.abs(wrapped(off) if one.circular else off).max() < 1e-9
    mirrored = poses[:, list(MIRROR)] * np.array([-1.0, 1.0, 1.0])
    if one.name.startswith("right_"):
        left = MEASURES[one.name.replace("right_", "left_")]
        np.testing.assert_allclose(left.of(mirrored), plain, atol=1e-9)
    assert np.all(np.abs(plain) <= 180) or one.kind == "length"
    assert one.convention
    assert one.source
    assert one.unit == ("body units" if one.kind == "length" else "degrees")


def test_any_number_of_poses(poses: np.ndarray) -> None:
    many = poses.reshape(5, 100, 15, 3)
    for one in MEASURES.values():
        np.testing.assert_array_equal(one.of(many), one.of(poses).reshape(5, 100))


def test_what_a_pose_does_not_determine_is_no_number() -> None:
    """A straight elbow shows no turn of the humerus; a bone of no length has no direction."""
    assert np.isnan(value("right_shoulder_rotation", arm(RIGHT, RIGHT)))
    assert np.isnan(value("right_hip_rotation", leg(DOWN, DOWN)))
    assert np.isnan(value("right_knee_flexion", leg(DOWN, (0, 0, 0))))


def test_small_angles_keep_their_digits() -> None:
    """The arc cosine of a scalar product would be off by a thousandth of a degree."""
    tiny = np.radians(1e-6)
    bent = leg(DOWN, (0, -np.cos(tiny), -np.sin(tiny)))
    assert value("right_knee_flexion", bent) == pytest.approx(1e-6, rel=1e-6)


def test_the_registry_is_what_pages_name() -> None:
    assert set(USUAL) <= set(MEASURES)
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "measures.md").read_text("utf-8")
    sideless = {name.removeprefix("right_") for name in MEASURES if not name.startswith("left_")}
    assert [name for name in [*sideless, *FUNCTIONS] if name not in page] == []


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("right_knee_flexoin", "perhaps right_knee_flexion"),
        ("", "there is no measure"),
        ("__import__('os').system('true')", "there is no measure"),
        ("angle(right_hip,right_knee,right_ankle).real", "there is no measure"),
        ("distance(distance(a,b),c)", "there is no measure"),
        ("sine(right_hip)", "asks for sine"),
        ("angle(right_hip,right_knee)", "takes 3"),
        ("distance(right_hip,right_hip)", "each another"),
        ("distance(right_hip,tail)", "names a joint 'tail'"),
        ("height()", "names a joint ''"),
        ("height(head)" + " " * 300, None),
        ("height(" + " " * 300 + "head)", "there is no measure"),
    ],
)
def test_expressions_are_read_and_never_run(text: str, match: str | None) -> None:
    if match is None:
        text = text.strip()
        assert measure_of(text).name == "height(head)"
        return
    with pytest.raises(BadInput, match=match):
        measure_of(text)


def test_an_expression_is_the_function_of_its_joints(poses: np.ndarray) -> None:
    corner = measure_of(" angle ( right_hip , right_knee,right_ankle )")
    assert corner.name == "angle(right_hip,right_knee,right_ankle)"
    flexion = MEASURES["right_knee_flexion"].of(poses)
    np.testing.assert_allclose(corner.of(poses), 180 - flexion, atol=1e-9)
