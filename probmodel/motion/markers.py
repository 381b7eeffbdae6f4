"""Recordings of markers that lie at the joints: TRC, as OpenSim describes it, and C3D, which the
package `c3d` reads.

Markers are joints by their names as people write them (`layouts.spoken_name`), after a subject's
name and a colon, if there is one; others are passed over. A thorax or pelvis without a marker is
the midpoint of shoulders or hips. Frames in which a joint is missing are left out. Markers on the
skin are not joints: where a file has no others, it is refused, and the sentence says what is
missing."""

import io
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from poseterior.probmodel.arrays import doubles
from poseterior.probmodel.failures import BadInput, installing, shown
from poseterior.probmodel.files import read_bytes
from poseterior.probmodel.layouts import MIDPOINTS, spoken_name
from poseterior.probmodel.motion.recording import (
    LARGEST_TEXT,
    MOST_FRAMES,
    Motion,
    floats,
    positions,
    read_text,
    require_depth,
)
from poseterior.probmodel.skeleton import JOINTS

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Millimetres in the units that both formats name."""
_KEYS = ("DataRate", "NumMarkers", "Units")


def joint_of(marker: str, names: Mapping[str, str] | None = None) -> str | None:
    """The joint at which a marker of that name lies, if any, by the user's names first."""
    spoken = spoken_name(marker.rsplit(":", 1)[-1].strip())
    name = (names or {}).get(marker.strip(), spoken)
    return name if name in JOINTS else None


def read_trc(path: Path, names: Mapping[str, str] | None = None) -> list[Motion]:
    """The one recording of a .trc, whose cells tabs or commas separate. Raises `BadInput` where it
    is damaged, or joints are missing."""
    lines = read_text(path).splitlines()
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise BadInput(f"{path} is no TRC file, or is cut short; give the whole file")
    cut = "\t" if "\t" in lines[3] else ","
    keys, said = ([cell.strip() for cell in line.split(cut)] for line in lines[1:3])
    header = dict(zip(keys, said, strict=False))
    missing = [key for key in _KEYS if not header.get(key, "").strip()]
    if missing:
        raise BadInput(f"the header of {path} says nothing of {', '.join(missing)}; add it")
    markers = {
        column: cell for column, cell in enumerate(lines[3].split(cut)[2:], 2) if cell.strip()
    }
    columns = _columns(markers, path, names)
    rows = [line.split(cut) for line in lines[5:] if line.strip(f" \t{cut}")]
    _require_frames(len(rows), path)
    values = {name: np.empty((len(rows), 3)) for name in columns}
    for number, row in enumerate(rows):
        for name, column in columns.items():
            cells = [cell.strip() or "nan" for cell in row[column : column + 3]]
            place = floats(" ".join(cells))
            if place is None or len(place) != 3:
                raise BadInput(
                    f"frame {number} of {path} has {shown(' '.join(cells))} where the place of"
                    f" {name} is needed; check that the file is complete"
                )
            values[name][number] = place
    return [_motion(values, _rate(header["DataRate"], path), header["Units"], path)]


def read_c3d(path: Path, names: Mapping[str, str] | None = None) -> list[Motion]:
    """The one recording of a .c3d. Raises `BadInput` where it is damaged, joints are missing, or so
    is the package `c3d`."""
    try:
        import c3d
    except ImportError:
        raise BadInput(
            f"C3D files need the package c3d; {installing('export')}; or give TRC"
        ) from None
    data = read_bytes(path, "motion capture", "check the path", largest=LARGEST_TEXT)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of files that are cut short
            warnings.filterwarnings("ignore", message="No analog data", category=UserWarning)
            reader = c3d.Reader(io.BytesIO(data))
            labels = dict(enumerate(reader.point_labels[: reader.point_used]))
            _require_frames(reader.last_frame - reader.first_frame + 1, path)
            columns = _columns(labels, path, names)
            chosen = list(columns.values())
            places = np.array([points[chosen, :4] for _, points, _ in reader.read_frames()], float)
            rate, unit = float(reader.point_rate), reader.get("POINT:UNITS").string_value
    except BadInput:
        raise
    except Exception as error:  # damaged bytes, in many ways
        raise BadInput(
            f"{path} is no C3D file, or is damaged ({type(error).__name__}); check that it is"
            " complete"
        ) from None
    places = doubles(places).reshape(-1, len(chosen), 4)
    there = places[..., 3] >= 0  # a residual of −1 marks an invalid point
    values = np.where(there[..., None], places[..., :3], np.nan)
    markers = {name: values[:, place] for place, name in enumerate(columns)}
    return [_motion(markers, _rate(str(rate), path), unit, path)]


def _columns(
    markers: Mapping[int, str], path: Path, names: Mapping[str, str] | None
) -> dict[str, int]:
    """By joint, the place of its marker. Raises `BadInput` where joints have none, or several."""
    found: dict[str, int] = {}
    for place, marker in markers.items():
        joint = joint_of(marker, names)
        if joint in found:
            raise BadInput(f"{path} has several markers at {joint}; rename all but one")
        if joint is not None:
            found[joint] = place
    missing = [
        joint
        for joint in JOINTS
        if joint not in found and not set(MIDPOINTS.get(joint, (joint,))) <= set(found)
    ]
    if missing:
        raise BadInput(
            f"{path} has no marker at {', '.join(missing)}, but at {shown(list(markers.values()))};"
            " give joint centres, named as joints, or a map of names (on the command line --names)"
        )
    return found


def _motion(markers: Mapping[str, np.ndarray], rate: float, unit: str, path: Path) -> Motion:
    """The recording of markers `(T, 3)` by joint."""
    if unit.strip() == "px":
        raise BadInput(
            f"{path} has places in pixels of an image, not in space; give it to show or frames"
        )
    if unit.strip() not in UNITS:
        raise BadInput(f"lengths of {path} are in {shown(unit)}; give one of {', '.join(UNITS)}")
    middles = {
        middle: (markers[right] + markers[left]) / 2
        for middle, (right, left) in MIDPOINTS.items()
        if middle not in markers
    }
    joints = np.stack([{**middles, **markers}[joint] for joint in JOINTS], axis=1)
    joints = joints[np.isfinite(joints).all(axis=(1, 2))]
    if not len(joints):
        raise BadInput(f"{path} has no frame with all joints; give one that has")
    require_depth(joints, path)
    return Motion(positions(UNITS[unit.strip()] * joints, path), rate, path.stem, path.stem)


def _rate(text: str, path: Path) -> float:
    rate = floats(text)
    if rate is None or len(rate) != 1 or not 0.01 <= rate[0] <= 1e5:
        raise BadInput(f"the frame rate of {path} is {shown(text)}; give frames a second")
    return float(rate[0])


def _require_frames(count: int, path: Path) -> None:
    if not 0 < count <= MOST_FRAMES:
        raise BadInput(f"{path} has {count:,} frames; from 1 to {MOST_FRAMES:,} can be read")
