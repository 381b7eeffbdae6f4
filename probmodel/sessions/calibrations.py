"""Files of calibrated cameras: Qualisys's `.qca.txt` (XML), the `.toml` of Pose2Sim, anipose and
caliscope, and EasyMocap's `intri.yml` and `extri.yml`.

Qualisys: with R the nine numbers r11 … r33 row by row, a point X of the world (mm) is at
diag(1, -1, -1) R (X - c) in camera axes; `intrinsic` is in 64ths of a pixel. The others: OpenCV's
conventions, a Rodrigues vector and a translation in metres from the world to the camera."""

import itertools
import re
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.documents import read_text
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.frames import natural_order
from poseterior.probmodel.sessions.pinhole import Pinhole

LARGEST_CALIBRATION = 1_000_000
"""Bytes; a calibration has some thousand for each camera."""
DEEPEST_KEY = 16
"""Parts of a dotted key of TOML, of which the parser keeps a table each, and all their prefixes."""
_PART = r"""[ \t]*+(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\."""
_LONG_KEY = re.compile(rf"(?<![\w \t-])(?:{_PART}){{{DEEPEST_KEY}}}")
NEAREST_CAMERA, FARTHEST_CAMERA = 1.0, 1e6
"""Millimetres between cameras: less is one place, from which no depth is seen, and a kilometre is
no room."""
OBLONG = 2.0
"""How much longer than wide a pixel may be, or wider than long; those of cameras are square, or by
a third off."""
SUFFIXES = (".qca.txt", ".toml", "intri.yml")
EXTRINSICS = "extri.yml"
"""Beside `intri.yml`: where its cameras stand."""
_MATRIX = re.compile(
    r"^(\w[\w.-]*):\s*!!opencv-matrix\s+rows:\s*(\d+)\s+cols:\s*(\d+)\s+dt:\s*\w+\s+"
    r"data:\s*\[([^\]]*)\]",
    re.MULTILINE,
)
_NAMES = re.compile(r"^names:\s*\n((?:[ \t]*-[^\n]*(?:\n|\Z))+)", re.MULTILINE)
SUBPIXELS = 64
FLIP = np.array([1.0, -1.0, -1.0])
_PLACES = [f"r{row}{column}" for row, column in itertools.product("123", "123")]
_WHAT = "calibration"
_ADVICE = "give a Qualisys .qca.txt, a Pose2Sim .toml, or EasyMocap's intri.yml and extri.yml"


def is_calibration(path: Path) -> bool:
    """Whether it is called like one."""
    return path.name.lower().endswith(SUFFIXES)


def read_cameras(path: Path) -> list[Pinhole]:
    """The cameras of a calibration, in its order.

    Raises
    ------
    BadInput
        Where it cannot be read, is none, or a camera's numbers are none of a camera.
    """
    text = read_text(path, _WHAT, _ADVICE, largest=LARGEST_CALIBRATION)
    name = path.name.lower()
    readers = zip(SUFFIXES, (_qualisys, _toml, _easymocap), strict=True)
    cameras = next(read for suffix, read in readers if name.endswith(suffix))(text, path)
    if len(cameras) < 2:
        raise BadInput(
            f"{path} calibrates {len(cameras)} cameras; two at least are needed to see depth"
        )
    _require_room(cameras, path)
    return cameras


def _require_room(cameras: list[Pinhole], path: Path) -> None:
    """Raises `BadInput` where cameras stand at one place, or one stands where no other can see
    what it sees."""
    centres = np.stack([camera.centre for camera in cameras])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    if nearest.max() > FARTHEST_CAMERA:
        far = int(np.argmax(nearest))
        raise BadInput(
            f"camera {far + 1} of {path} stands {nearest[far] / 1e6:,.0f} km from every other;"
            " check its position, and that lengths are in the calibration's unit (of .toml and .yml"
            " metres)"
        )
    if nearest.min() < NEAREST_CAMERA:
        one = int(np.argmin(nearest))
        other = int(np.argmin(apart[one]))
        raise BadInput(
            f"cameras {one + 1} and {other + 1} of {path} stand at one place, from where nobody"
            " sees depth; check their positions, or leave one of them out"
        )


def _qualisys(text: str, path: Path) -> list[Pinhole]:
    if "<!" in text:  # entities, which could grow without end
        raise BadInput(f"{path} holds a declaration that a calibration does not need; {_ADVICE}")
    try:
        root = ElementTree.fromstring(text)  # decoded, whatever encoding it says it is in
    except (ElementTree.ParseError, RecursionError) as error:
        raise BadInput(f"{path} is no XML ({error}); {_ADVICE}") from None
    return [
        _qualisys_camera(camera, f"camera {number} of {path}")
        for number, camera in enumerate(root.iter("camera"), start=1)
    ]


def _qualisys_camera(camera: ElementTree.Element, where: str) -> Pinhole:
    place = _numbers(camera, "transform", [*_PLACES, *"xyz"], where)
    names = ["focalLengthU", "focalLengthV", "centerPointU", "centerPointV"]
    inner = _numbers(camera, "intrinsic", names, where) / SUBPIXELS
    bends = ["radialDistortion1", "radialDistortion2", "tangentalDistortion1"]
    bends += ["tangentalDistortion2", "radialDistortion3"]
    k1, k2, p1, p2, k3 = _numbers(camera, "intrinsic", bends, where, missing="0").tolist()
    rotation = FLIP[:, None] * place[:9].reshape(3, 3)
    return _camera(rotation, place[9:], inner[:2], inner[2:], (k1, k2, p1, p2, k3), where)


def _numbers(
    camera: ElementTree.Element,
    part: str,
    names: list[str],
    where: str,
    missing: str | None = None,
) -> np.ndarray:
    """Attributes of a camera's part, as numbers; `missing` stands for those that are not there."""
    found = camera.find(part)
    if found is None:
        raise BadInput(f"{where} has no <{part}>; {_ADVICE}")
    texts = [found.get(name, missing) for name in names]
    if None in texts:
        raise BadInput(f"{where}: <{part}> lacks {names[texts.index(None)]}; {_ADVICE}")
    try:
        return np.array([float(str(text)) for text in texts])
    except ValueError:
        raise BadInput(f"{where}: <{part}> holds a text where a number must stand") from None


def _toml(text: str, path: Path) -> list[Pinhole]:
    if _LONG_KEY.search(text):
        raise BadInput(f"{path} has a key of more than {DEEPEST_KEY} parts; {_ADVICE}")
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise BadInput(f"{path} is no TOML ({shown(str(error))}); {_ADVICE}") from None
    return [
        _toml_camera(table, f"{shown(name)} of {path}")
        for name, table in tables.items()
        if isinstance(table, dict) and "matrix" in table
    ]


def _easymocap(text: str, path: Path) -> list[Pinhole]:
    """In the order of their names, as folders are sorted."""
    beside = path.with_name(EXTRINSICS)
    held = _matrices(text, path)
    held |= _matrices(read_text(beside, _WHAT, _ADVICE, largest=LARGEST_CALIBRATION), beside)
    listed = _NAMES.search(text)
    if listed is None:
        raise BadInput(f"{path} does not name its cameras (names); {_ADVICE}")
    names = [line.strip(" \t-\"'\r") for line in listed[1].splitlines()]
    return [
        _toml_camera(_as_table(name, held), f"camera {shown(name)} of {path}")
        for name in sorted(names, key=natural_order)
    ]


def _matrices(text: str, path: Path) -> dict[str, np.ndarray]:
    """The matrices of a file that OpenCV's FileStorage wrote, by their names."""
    found = {}
    for name, rows, columns, data in _MATRIX.findall(text):
        try:
            found[name] = np.array([float(one) for one in data.split(",")]).reshape(
                int(rows), int(columns)
            )
        except (ValueError, OverflowError):
            raise BadInput(
                f"{path}: {shown(name)} does not hold {rows} × {columns} numbers; {_ADVICE}"
            ) from None
    return found


def _as_table(name: str, held: dict[str, np.ndarray]) -> dict[str, Any]:
    """A camera's matrices as the entries of a `.toml`; what is missing is left out."""
    wanted = {"matrix": "K", "rotation": "R", "translation": "T", "distortions": "dist"}
    found = {ours: held.get(f"{own}_{name}") for ours, own in wanted.items()}
    turn = held.get(f"Rot_{name}")
    if found["rotation"] is None and turn is not None and turn.shape == (3, 3):
        found["rotation"] = Rotation.from_matrix(turn).as_rotvec()
    return {
        ours: matrix if ours == "matrix" else matrix.ravel()
        for ours, matrix in found.items()
        if matrix is not None
    }


def _toml_camera(table: dict[str, Any], where: str) -> Pinhole:
    if table.get("fisheye", False):
        raise BadInput(
            f"{where} is a fisheye camera, which this program does not know; undistort its videos"
            " first"
        )
    matrix = _array(table, "matrix", (3, 3), where)
    turn, shift = (_array(table, name, (3,), where) for name in ("rotation", "translation"))
    with np.errstate(all="ignore"):  # `_camera` refuses what is not finite
        rotation = Rotation.from_rotvec(turn).as_matrix()
        centre = -1000 * rotation.T @ shift
    if not np.array_equal(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1]):
        raise BadInput(
            f"{where}: matrix must be [[f, 0, u], [0, g, v], [0, 0, 1]], focal lengths and"
            " principal point in pixels; a skew is not known"
        )
    bends = np.atleast_1d(np.asarray(table.get("distortions", [0.0] * 4), object))
    if bends.shape not in ((4,), (5,)):
        raise BadInput(f"{where}: distortions must be four or five numbers")
    padded = {"distortions": [*bends.tolist(), 0.0][:5]}
    k1, k2, p1, p2, k3 = _array(padded, "distortions", (5,), where).tolist()
    focal, principal = np.diag(matrix)[:2], matrix[:2, 2]
    return _camera(rotation, centre, focal, principal, (k1, k2, p1, p2, k3), where)


def _array(table: dict[str, Any], name: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    try:
        found = np.array(table.get(name), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != shape:
        wanted = " × ".join(map(str, shape))
        raise BadInput(f"{where}: {name} must be {wanted} numbers; {_ADVICE}")
    return found


def _camera(
    rotation: np.ndarray,
    centre: np.ndarray,
    focal: np.ndarray,
    principal: np.ndarray,
    distortion: tuple[float, float, float, float, float],
    where: str,
) -> Pinhole:
    """Raises `BadInput` on numbers that are none of a camera."""
    every = np.concatenate([rotation.ravel(), centre, focal, principal, distortion])
    if not (np.abs(every) <= LARGEST_NUMBER).all() or not (focal > 0).all():  # true for NaN too
        raise BadInput(
            f"{where} has a number that is not finite, or a focal length that is not positive;"
            " calibrate anew"
        )
    if max(focal) > OBLONG * min(focal):
        raise BadInput(
            f"{where} has focal lengths of {focal[0]:g} pixels across and {focal[1]:g} down, as if"
            f" its pixels were {max(focal) / min(focal):,.3g} times as long as wide; calibrate anew"
        )
    proper = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
    if not proper or np.linalg.det(rotation) < 0:
        raise BadInput(f"{where}: its rotation is none (orthogonal, determinant 1); {_ADVICE}")
    return Pinhole(rotation, centre, focal, principal, distortion)
