"""The embedded example: a pose of motion capture, projected, with a detector's noise and one wrist
missing; its truth is known.

`example()` reads it; `python -m poseterior.probmodel.example MOTION` makes it again, by
`make_example`."""

import json
import sys
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.body import body_unit
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.formats import read_detections
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS

RECIPE: dict[str, Any] = {
    "sequence": "soccer/soccer_1",
    "frame": 120,
    "yaw": 15.0,
    "tilt": 12.0,
    "scale": 110.0,
    "noise": 0.05,
    "missing": ["right_wrist"],
    "image_size": [480, 640],
    "seed": 7,
}
"""Which pose, seen how: yaw and tilt of the camera in degrees, pixels per body unit, standard
deviation of the noise in body units, joints taken away."""


class Example(NamedTuple):
    """A `detection` and the pose behind it: `joints` `(15, 3)` in camera axes, body units, pelvis
    at the origin."""

    detection: Detection
    joints: np.ndarray
    path: Path


def example() -> Example:
    """The example that comes with the product."""
    path = Path(str(resources.files("poseterior.probmodel.data") / "example.json"))
    truth = json.loads(path.read_text(encoding="utf-8"))["truth"]["joints"]
    return Example(read_detections(path)[0], np.array([truth[name] for name in JOINTS]), path)


def make_example(joints: np.ndarray, recipe: dict[str, Any]) -> dict[str, Any]:
    """The native JSON of a pose `(15, 3)` (y up) seen as a recipe like `RECIPE` says. Scores fall
    with the noise, as a detector's do."""
    rng = np.random.default_rng(recipe["seed"])
    body = (joints - joints[0]) / body_unit(joints)
    turn = Rotation.from_euler("yx", [recipe["yaw"], recipe["tilt"]], degrees=True).as_matrix()
    view = body @ (np.diag([1.0, -1.0, -1.0]) @ turn).T
    width, height = recipe["image_size"]
    camera = WeakPerspective(recipe["scale"], np.eye(3), np.array([width / 2, height * 0.45]))
    noise = rng.normal(size=(len(JOINTS), 2)) * recipe["noise"]
    keypoints = np.asarray(camera.image(view)) + recipe["scale"] * noise
    score = 0.9 * np.exp(-np.linalg.norm(noise, axis=1) / 0.5)
    people = {
        name: [round(float(u), 2), round(float(v), 2), round(float(c), 3)]
        for name, (u, v), c in zip(JOINTS, keypoints, score, strict=True)
        if name not in recipe["missing"]
    }
    truth = {name: [round(float(value), 5) for value in view[JOINT_INDEX[name]]] for name in JOINTS}
    about = (
        "Made by probmodel.example from one pose of the CMU motion capture database. The data used"
        " in this project was obtained from mocap.cs.cmu.edu. The database was created with funding"
        " from NSF EIA-0196217."
    )
    return {
        "format": "poseterior-detections",
        "version": 1,
        "about": about,
        "people": [{"keypoints": people, "image_size": recipe["image_size"]}],
        "truth": {
            "joints": truth,
            "axes": "camera: x right, y down, z away",
            "unit": "body units",
            "recipe": recipe,
        },
    }


if __name__ == "__main__":
    motion = next(
        motion for motion in read_motion(sys.argv[1]) if RECIPE["sequence"] in motion.name
    )
    made = make_example(motion.joints[int(RECIPE["frame"])], RECIPE)
    out = Path(str(resources.files("poseterior.probmodel.data") / "example.json"))
    out.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
