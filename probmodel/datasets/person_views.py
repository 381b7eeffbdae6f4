"""Views of people whose truth is known in part: what each camera detected, and where some joints
truly are, in the camera's axes. Legs may be missing, and truths err.

An .npz with arrays, a row a view: `detection` (N, P, 3), pixels and scores in the order of a
detector's layout, 0 where missing; `truth` (N, J, 3) mm, axes of the view's camera (x right, y
down, z away), NaN where nobody knows, of the `joints` (J,) by name, of which those that the
skeleton does not have are left out; `focal` and `principal` (N, 2), pixels; `person` (N,), and
`day` (N,) where numbers of people are used again. Optional: `truth_residual` (N, J) pixels, how far
off truths are seen; `layout`, else coco_17; `image_size` (2,), else twice the mean principal point.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.arrays import npz_names, read_tables
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.layouts import LAYOUTS, corrected
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

NEEDED = ("detection", "truth", "joints", "focal", "principal", "person")
_WHAT, _ADVICE = "set of views of people", f"give an .npz with {', '.join(NEEDED)}"


class PersonView(NamedTuple):
    """One view of a person.

    Attributes
    ----------
    detection
        What was detected.
    truth
        `(15, 3)` mm, axes of the camera, its centre the origin; NaN where nobody knows.
    sigma
        `(15,)` mm: how far each truth may be off, each way.
    lens
        Of the camera.
    longer
        The longer side of the image, pixels.
    person
        Who it is.
    """

    detection: Detection
    truth: np.ndarray
    sigma: np.ndarray
    lens: Lens
    longer: float
    person: str

    def believed(self, camera: str) -> Lens | None:
        """What is believed of the camera: nothing beyond "weak" perspective, the "known" lens, or
        one whose focal length is "unknown"."""
        if camera == "weak":
            return None
        return self.lens if camera == "known" else Lens.unknown(self.longer, self.lens.principal)


def is_person_views(path: Path) -> bool:
    """Whether it is an .npz with `detection` and `truth`."""
    return {"detection", "truth"} <= npz_names(path, _WHAT, _ADVICE)


def read_person_views(path: Path) -> list[PersonView]:
    """The views in a file.

    Parameters
    ----------
    path
        An .npz, as above.

    Returns
    -------
    list of PersonView
        In the file's order.

    Raises
    ------
    BadInput
        Where an array is missing, or not of its kind.
    """
    arrays = read_tables(path, _WHAT, _ADVICE, NEEDED)
    layout = LAYOUTS.get(str(arrays.get("layout", "coco_17")))
    if layout is None:
        raise BadInput(f"{path}: there is no layout {shown(str(arrays['layout']))}")
    number, names = len(arrays["person"]), [str(name) for name in arrays["joints"]]
    _require_shapes(arrays, number, layout.count, len(names), path)
    known = [(row, JOINT_INDEX[name]) for row, name in enumerate(names) if name in JOINT_INDEX]
    rows, joints = (list(column) for column in zip(*known, strict=True)) if known else ([], [])
    truth = np.full((number, NUM_JOINTS, 3), np.nan)
    truth[:, joints] = arrays["truth"][:, rows]
    residual = np.zeros((number, NUM_JOINTS))
    if "truth_residual" in arrays:
        residual[:, joints] = np.nan_to_num(arrays["truth_residual"][:, rows])
    focal = np.asarray(arrays["focal"], float)
    with np.errstate(invalid="ignore"):
        sigma = np.where(np.isfinite(truth[..., 2]), residual * truth[..., 2] / focal[:, :1], 0.0)
    days = np.asarray(arrays.get("day", np.zeros(number, int)))
    people = np.char.add(
        np.char.add(days.astype(str), " "), np.asarray(arrays["person"]).astype(str)
    )
    principal = np.asarray(arrays["principal"], float)
    longer = float(np.max(arrays.get("image_size", 2 * principal.mean(axis=0))))
    found = []
    for row in range(number):
        points = np.asarray(arrays["detection"][row], float)
        person = layout.detection(points, 0.0, f"view {row} of {path.name}", 0)
        lens = Lens(float(focal[row].mean()), principal[row])
        view = corrected(person), truth[row], sigma[row], lens, longer, str(people[row])
        found.append(PersonView(*view))
    return found


def _require_shapes(
    arrays: dict[str, np.ndarray], number: int, points: int, joints: int, path: Path
) -> None:
    shapes = {
        "detection": (number, points, 3),
        "truth": (number, joints, 3),
        "focal": (number, 2),
        "principal": (number, 2),
    }
    for name, wanted in shapes.items():
        if arrays[name].shape != wanted or arrays[name].dtype.kind not in "fiu":
            raise BadInput(
                f"{path}: {name} has shape {shown(arrays[name].shape)}, where numbers {wanted} are"
                " needed"
            )
