"""Sessions whose truth is known: a person who moves, seen by calibrated cameras that err."""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel import Detection
from poseterior.probmodel.layouts import BODY_25B, Layout
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.sessions import Pinhole, Session
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

UNIT = 340.0
"""Millimetres."""
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From axes with y up to those of the world, z up."""
DISTORTION = (-0.05, 0.1, 0.001, -0.0005, 0.01)


def moving(frames: int, seed: int = 0) -> np.ndarray:
    """Joints `(frames, 15, 3)` of the world, mm; thorax and pelvis are midpoints, as detectors have
    them."""
    rng = np.random.default_rng(seed)
    way = np.linspace(0, 2 * np.pi, frames)[:, None, None]
    sway = 60 * np.sin(way + rng.uniform(0, 6, (NUM_JOINTS, 3)))
    body = UNIT * PoseDictionary.default().mean @ UPRIGHT.T
    joints = body + sway
    for middle, ends in (("thorax", "shoulder"), ("pelvis", "hip")):
        sides = [joints[:, JOINT_INDEX[f"{side}_{ends}"]] for side in ("right", "left")]
        joints[:, JOINT_INDEX[middle]] = sum(sides) / 2
    return joints + np.array([100.0, -50.0, 950.0])


def cameras(number: int = 4) -> list[Pinhole]:
    """So many round the person, at 3.5 m, a little above."""
    found = []
    for angle in np.linspace(0.3, 0.3 + 2 * np.pi, number, endpoint=False):
        centre = np.array([3500 * np.cos(angle), 3500 * np.sin(angle), 1700.0])
        away = np.array([0.0, 0.0, 950.0]) - centre
        away /= np.linalg.norm(away)
        right = np.cross(away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(away, right), away])
        inner = np.array([1500.0, 1490.0]), np.array([540.0, 960.0])
        found.append(Pinhole(rotation, centre, *inner, DISTORTION))
    return found


def detected(pixels: np.ndarray, source: str) -> Detection:
    """A person whose joints are all seen with score 0.5."""
    return Detection(pixels, np.full(NUM_JOINTS, 0.5), "simulated", source, 0)


def filmed(joints: np.ndarray, errors: np.ndarray, views: list[Pinhole] | None = None) -> Session:
    """A session of joints `(F, 15, 3)` with errors `(C, F, 15, 2)` in mm where the person's hips
    are, added to the straightened image."""
    views = cameras() if views is None else views
    people = []
    for camera, error in zip(views, errors, strict=True):
        hips = joints[:, [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]].mean(axis=1)
        scale = camera.focal.mean() / camera.view(hips)[:, 2]
        straight = camera.straight.project(joints) + scale[:, None, None] * error
        plane = (straight - camera.principal) / camera.straight.focal
        pixels = camera.focal * camera._distorted(plane) + camera.principal
        people.append(tuple(detected(one, f"frame {n}") for n, one in enumerate(pixels)))
    labels = tuple(f"cam{number}" for number in range(1, len(views) + 1))
    return Session("simulated", tuple(views), labels, tuple(range(len(joints))), tuple(people))


def write_session(
    session: Session,
    folder: Path,
    calibration: str = "calibration.qca.txt",
    layout: Layout = BODY_25B,
) -> None:
    """Writes a session in Pose2Sim's layout: one of the two calibrations, and detections in
    OpenPose's envelope."""
    for label, people in zip(session.labels, session.people, strict=True):
        (folder / "pose" / f"{label}_json").mkdir(parents=True)
        for number, person in zip(session.numbers, people, strict=True):
            path = folder / "pose" / f"{label}_json" / f"{label}_{number:06}.json"
            path.write_text(json.dumps(openpose([person.keypoints], layout)))
    write = write_toml if calibration.endswith(".toml") else write_qualisys
    if calibration == "intri.yml":
        write = write_easymocap
    (folder / "calibration").mkdir()
    write(session.cameras, folder / "calibration" / calibration)


def openpose(people: list[np.ndarray], layout: Layout = BODY_25B) -> dict:
    """OpenPose's document of people `(15, 2)`, whose order is any."""
    flat = []
    for keypoints in people:
        rows = np.zeros((layout.count, 3))
        for row, name in enumerate(layout.points):
            if name in JOINT_INDEX:
                rows[row] = [*keypoints[JOINT_INDEX[name]], 0.5]
        flat.append({"pose_keypoints_2d": rows.ravel().tolist()})
    return {"version": 1.3, "people": flat}


def write_qualisys(views: tuple[Pinhole, ...], path: Path, flip: tuple = (1, -1, -1)) -> None:
    """Qualisys's XML, written from its description: R = diag(1, -1, -1) W row by row."""
    lines = ['<?xml version="1.0"?>', "<calibration><cameras>"]
    for camera in views:
        turned = np.diag(flip) @ camera.rotation
        place = {f"r{i + 1}{j + 1}": turned[i, j] for i in range(3) for j in range(3)}
        place |= dict(zip("xyz", camera.centre, strict=True))
        inner = {"focalLengthU": camera.focal[0], "focalLengthV": camera.focal[1]}
        inner |= {"centerPointU": camera.principal[0], "centerPointV": camera.principal[1]}
        inner = {name: 64 * value for name, value in inner.items()}
        names = ["radialDistortion1", "radialDistortion2", "tangentalDistortion1"]
        names += ["tangentalDistortion2", "radialDistortion3"]
        inner |= dict(zip(names, camera.distortion, strict=True))
        texts = [
            " ".join(f'{k}="{v!r}"' for k, v in part.items())
            for part in (
                {name: float(value) for name, value in place.items()},
                {name: float(value) for name, value in inner.items()},
            )
        ]
        lines.append(f"<camera><transform {texts[0]}/><intrinsic {texts[1]}/></camera>")
    path.write_text("\n".join([*lines, "</cameras></calibration>"]))


def write_toml(views: tuple[Pinhole, ...], path: Path) -> None:
    """Pose2Sim's TOML: OpenCV's conventions, metres."""
    lines = []
    for number, camera in enumerate(views):
        matrix = np.diag([*camera.focal, 1.0])
        matrix[:2, 2] = camera.principal
        vector = Rotation.from_matrix(camera.rotation).as_rotvec()
        shift = -camera.rotation @ camera.centre / 1000
        lines += [
            f"[cam{number}]",
            f'name = "cam{number}"',
            "size = [1080.0, 1920.0]",
            f"matrix = {matrix.tolist()}",
            f"distortions = {list(camera.distortion)}",
            f"rotation = {vector.tolist()}",
            f"translation = {shift.tolist()}",
            "fisheye = false",
        ]
    path.write_text("\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0"]))


def write_easymocap(views: tuple[Pinhole, ...], path: Path) -> None:
    """EasyMocap's two files, written from its description: RX + T, metres, as OpenCV's FileStorage
    writes them; every second camera has its rotation as a matrix."""
    names = [f"cam{number}" for number in range(1, len(views) + 1)]
    head = ["%YAML:1.0", "---", "names:", *(f'  - "{name}"' for name in names)]
    inner, outer = list(head), list(head)
    for number, (name, camera) in enumerate(zip(names, views, strict=True)):
        matrix = np.diag([*camera.focal, 1.0])
        matrix[:2, 2] = camera.principal
        inner += _opencv(f"K_{name}", matrix)
        inner += _opencv(f"dist_{name}", np.array([camera.distortion]))
        vector = Rotation.from_matrix(camera.rotation).as_rotvec()
        turn = ("Rot", camera.rotation) if number % 2 else ("R", vector[:, None])
        outer += _opencv(f"{turn[0]}_{name}", turn[1])
        outer += _opencv(f"T_{name}", -camera.rotation @ camera.centre[:, None] / 1000)
    path.write_text("\n".join(inner) + "\n")
    path.with_name("extri.yml").write_text("\n".join(outer) + "\n")


def _opencv(name: str, matrix: np.ndarray) -> list[str]:
    rows, columns = matrix.shape
    numbers = ", ".join(repr(float(one)) for one in matrix.ravel())
    return [
        f"{name}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {numbers} ]",
    ]
