"""Markers at the joints: TRC and C3D files made by hand, and what is refused."""

import warnings
from collections.abc import Callable
from pathlib import Path

import c3d
import numpy as np
import pytest

from poseterior.probmodel import BadInput
from poseterior.probmodel.example import example
from poseterior.probmodel.layouts import MIDPOINTS
from poseterior.probmodel.motion import markers, read_motion
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from poseterior.reports.exports.clip import Clip
from poseterior.reports.exports.trc import write_trc

POSE = 1000.0 * example().joints
"""`(15, 3)`: some pose, in what may be millimetres."""
NAMES = {joint: joint for joint in JOINTS}
SPOKEN = {joint: "".join(word.title() for word in joint.split("_")) for joint in JOINTS}


def moved(frame: int) -> np.ndarray:
    return np.array([frame, 0.0, 0.0])


def trc(names: dict[str, str] = NAMES, unit: str = "mm", frames: int = 3) -> str:
    """Frame n is the pose moved by n along x."""
    labels = [*names.values(), "C7"]
    lines = ["PathFileType\t4\t(X/Y/Z)\ta.trc"]
    lines += ["DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate"]
    lines += [f"60\t60\t{frames}\t{len(labels)}\t{unit}\t60"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(labels)]
    lines += ["\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(labels)) for axis in "XYZ")]
    for frame in range(frames):
        rows = [POSE[JOINT_INDEX[joint]] + moved(frame) for joint in names] + [np.zeros(3)]
        cells = [f"{number:.6f}" for number in np.ravel(rows)]
        lines += ["\t".join([str(frame + 1), f"{frame / 60:.6f}", *cells])]
    return "\n".join([*lines[:5], "", *lines[5:]]) + "\n"


def write_c3d(path: Path, names: dict[str, str] = NAMES, unit: str = "mm", hide: int = -1) -> Path:
    """Three frames; in one of them the first point is invalid."""
    writer = c3d.Writer(point_rate=60.0, analog_rate=0.0, point_scale=-0.1, point_units=unit)
    writer.set_point_labels([*names.values(), "C7"])
    for frame in range(3):
        rows = np.zeros((len(names) + 1, 5), np.float32)
        rows[:-1, :3] = [POSE[JOINT_INDEX[joint]] + moved(frame) for joint in names]
        if frame == hide:
            rows[0, 3] = -1
        writer.add_frames([(rows, np.empty((0, 0)))])
    with path.open("wb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        writer.write(file)
    return path


@pytest.mark.parametrize(("unit", "size"), [("mm", 1), ("cm", 10), ("m", 1000)])
@pytest.mark.parametrize("names", [NAMES, SPOKEN, {j: f"ann:{j}" for j in JOINTS}])
def test_both_formats(tmp_path: Path, unit: str, size: int, names: dict[str, str]) -> None:
    (tmp_path / "walk.trc").write_text(trc(names, unit))
    for path in (tmp_path / "walk.trc", write_c3d(tmp_path / "walk.c3d", names, unit)):
        (motion,) = read_motion(path)
        assert (motion.frame_rate, motion.name, len(motion.joints)) == (60, "walk", 3)
        for frame in range(3):
            wanted = size * (POSE + moved(frame))
            np.testing.assert_allclose(motion.joints[frame], wanted, atol=size * 1e-3)


def test_thorax_and_pelvis_may_be_midpoints(tmp_path: Path) -> None:
    few = {joint: joint for joint in JOINTS if joint not in MIDPOINTS}
    (tmp_path / "a.trc").write_text(trc(few))
    (motion,) = read_motion(tmp_path / "a.trc")
    for middle, sides in MIDPOINTS.items():
        wanted = np.mean([POSE[JOINT_INDEX[side]] for side in sides], axis=0)
        np.testing.assert_allclose(motion.joints[0, JOINT_INDEX[middle]], wanted, atol=1e-3)


def test_frames_without_a_joint_are_left_out(tmp_path: Path) -> None:
    (motion,) = read_motion(write_c3d(tmp_path / "a.c3d", hide=1))
    assert len(motion.joints) == 2
    lines = trc().splitlines()
    lines[7] = "\t".join(["2", "0", "", "", "", *lines[7].split("\t")[5:]])
    (tmp_path / "a.trc").write_text("\n".join(lines))
    assert len(read_motion(tmp_path / "a.trc")[0].joints) == 2


def _line(number: int, text: str) -> Callable[[str], str]:
    def change(content: str) -> str:
        lines = content.splitlines()
        lines[number] = text
        return "\n".join(lines)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "Path" + text, "is no TRC file, or is cut short"),
        (lambda text: text[:100], "is no TRC file, or is cut short"),
        (lambda text: text.replace("Units", "Ells"), "the header of .* says nothing of Units"),
        (lambda text: text.replace("\tmm\t", "\tinch\t"), "lengths of .* are in 'inch'"),
        (_line(2, "x\t60\t3\t16\tmm\t60"), "the frame rate of .* is 'x'"),
        (lambda text: text.replace("left_wrist", "LWRA"), "has no marker at left_wrist, but at"),
        (lambda text: text.replace("left_wrist", "LeftElbow"), "several markers at left_elbow"),
        (_line(6, "1\t0\tx"), "frame 0 of .* where the place of pelvis is needed"),
        (lambda text: "\n".join([*text.splitlines()[:6], " "]), "has 0 frames; from 1 to 500,000"),
    ],
)
def test_damaged_trc(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    path = tmp_path / "a.trc"
    path.write_text(change(trc()))
    with pytest.raises(BadInput, match=message):
        read_motion(path)


@pytest.mark.parametrize("cut", [1, 300, 600, 2000])
def test_damaged_c3d(tmp_path: Path, cut: int) -> None:
    path = write_c3d(tmp_path / "a.c3d")
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(BadInput, match=r"is no C3D file, or is damaged|no marker at"):
        read_motion(path)


def test_c3d_that_claims_more_frames_than_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that believed what the header counts would count for hours."""
    monkeypatch.setattr(markers, "MOST_FRAMES", 2)
    with pytest.raises(BadInput, match="has 3 frames; from 1 to 2 can be read"):
        read_motion(write_c3d(tmp_path / "a.c3d"))


def test_an_export_is_read_as_motion_capture(tmp_path: Path) -> None:
    """What `export` writes has markers for standard deviations too, which are no joints."""
    poses = np.stack([POSE, POSE]) / 1000
    clip = Clip(poses, ["a", "b"], spread=np.full(poses.shape, 0.1))
    write_trc(clip, tmp_path / "a.trc", "m")
    (motion,) = read_motion(tmp_path / "a.trc")
    np.testing.assert_allclose(motion.joints, np.stack([POSE, POSE]), atol=1e-2)
