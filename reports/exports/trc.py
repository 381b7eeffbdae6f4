"""TRC: markers as OpenSim reads them (its TRCFileAdapter): three lines of header, names of markers,
X1 Y1 Z1 …, an empty line, then a row a frame with tabs between."""

from pathlib import Path

import numpy as np

from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.exports.clip import UNITS, Clip

_KEYS = (
    *("DataRate", "CameraRate", "NumFrames", "NumMarkers"),
    *("Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"),
)


def write_trc(clip: Clip, path: Path, unit: str) -> None:
    """The joints as markers of their names; where there are standard deviations, a marker
    JOINT_sd after each joint has them as its X, Y and Z, which no model matches. A missing pose is
    NaN. Frames have the numbers of the film."""
    clip = clip.regular()
    blocks = [clip.joints] if clip.spread is None else [clip.joints, clip.spread]
    markers = [name + end for name in JOINTS for end in ("", "_sd")[: len(blocks)]]
    values = UNITS[unit] * np.stack(blocks, axis=2)  # (n, 15, blocks, 3): a joint, then its sd
    rate, count, first = f"{clip.pace:.10g}", len(clip.joints), str(clip.frames[0])
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", _word(path.name)],
        [*_KEYS],
        [rate, rate, str(count), str(len(markers)), unit, rate, first, str(count)],
        ["Frame#", "Time", *(word for name in markers for word in (name, "", ""))][:-2],
        ["", "", *(f"{axis}{number + 1}" for number in range(len(markers)) for axis in "XYZ")],
        [],
    ]
    digits = 6 if unit == "m" else 3
    times, frames = clip.times, clip.frames
    for index, row in enumerate(values.reshape(count, -1)):
        numbers = [f"{number:.{digits}f}" if np.isfinite(number) else "NaN" for number in row]
        lines.append([str(frames[index]), f"{times[index]:.6f}", *numbers])
    text = "\n".join("\t".join(line) for line in lines) + "\n"
    with replacing(path, "choose another --out") as partial:
        partial.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def _word(name: str) -> str:
    """The file's name in one word: spaces and tabs separate."""
    return "_".join(name.split())
