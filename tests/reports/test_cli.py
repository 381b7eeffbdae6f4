"""The command line from outside: every refusal in a table, what is written, and what is said while
it works."""

import copy
import dataclasses
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import arviz
import numpy as np
import pytest
import rich.console
import typer
import xarray as xr

from poseterior.inference.exact.mixture import PROPOSALS
from poseterior.probmodel import Anatomy, PoseModel
from poseterior.probmodel.anatomy.limits import CELL, LIMITS
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.example import example
from poseterior.probmodel.formats import write_detections
from poseterior.probmodel.formats.openpose import BODY_25
from poseterior.probmodel.kinematics import direction
from poseterior.probmodel.skeleton import (
    JOINT_INDEX,
    JOINTS,
    LENGTH_GROUPS,
    NUM_JOINTS,
    NUM_LENGTHS,
)
from poseterior.reports import cli, console
from tests.conftest import Cli, Run
from tests.reports.test_interactive import Parsed
from tests.scenes import camera
from tests.sweeps import sweep

EXAMPLE = example().path
DOCUMENT = json.loads(EXAMPLE.read_text(encoding="utf-8"))
RESULTS = ["hypotheses.html", "hypotheses.json", "hypotheses.png", "posterior.nc"]
"""What the main job leaves in its folder."""
PNG = b"\x89PNG\r\n\x1a\n"


def process(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Runs the command as a process of its own."""
    command = [sys.executable, "-m", "poseterior", *map(str, arguments)]
    options = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "timeout": 300,
    } | options
    return subprocess.run(command, cwd=Path(__file__).parents[2], check=False, **options)


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, with its content."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


# --- files to begin with


def native(**joints: list[Any] | None) -> str:
    """The example with some joints replaced, or left out where None is given."""
    document = copy.deepcopy(DOCUMENT)
    keypoints = document["people"][0]["keypoints"]
    keypoints.update(joints)
    document["people"][0]["keypoints"] = {
        name: row for name, row in keypoints.items() if row is not None
    }
    return json.dumps(document)


def openpose(change: Callable[[list[float]], Any] = lambda flat: flat, people: int = 1) -> str:
    """The example's person as OpenPose's BODY_25 would write it, after a change of the flat
    list."""
    keypoints = DOCUMENT["people"][0]["keypoints"]
    flat = [number for name in BODY_25.points for number in keypoints.get(name, [0.0, 0.0, 0.0])]
    return json.dumps(
        {"version": 1.3, "people": [{"pose_keypoints_2d": change(list(flat))}] * people}
    )


def with_score(value: float) -> Callable[[list[float]], list[float]]:
    """Sets the score of the right elbow."""
    at = 3 * BODY_25.points.index("right_elbow") + 2
    return lambda flat: [*flat[:at], value, *flat[at + 1 :]]


FEW = {
    name: None
    for name in JOINTS
    if name not in ("pelvis", "thorax", "left_shoulder", "right_hip", "left_elbow")
}
"""Only a torso and one elbow are seen: quick to explain, whatever the sampler."""
FAR = [3000.0, 250.0, 0.9]


def standing() -> np.ndarray:
    """A possible pose `(15, 3)`: the truth of the example."""
    return example().joints.copy()


def broken_elbow() -> np.ndarray:
    """The example with its left forearm turned back behind the upper arm."""
    joints = standing()
    shoulder, elbow, wrist = (
        JOINT_INDEX[f"left_{name}"] for name in ("shoulder", "elbow", "wrist")
    )
    upper, length = joints[elbow] - joints[shoulder], np.linalg.norm(joints[wrist] - joints[elbow])
    joints[wrist] = joints[elbow] - length * upper / np.linalg.norm(upper)
    return joints


def npy(array: Any) -> bytes:
    """An array as the bytes of a .npy file."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npz(**arrays: Any) -> bytes:
    """Arrays as the bytes of an .npz file."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def default_limits(**changed: Any) -> bytes:
    """The embedded limits file with some arrays changed, or left out where None is given."""
    stored = dict(np.load(Path(cli.__file__).parents[1] / "probmodel/data/limits.npz")) | changed
    return npz(**{key: value for key, value in stored.items() if value is not None})


def pose(joint: str, value: float) -> np.ndarray:
    """A possible pose with one number spoilt."""
    joints = standing()
    joints[JOINT_INDEX[joint], 1] = value
    return joints


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT LeftUpLeg
  {
    OFFSET 1 0 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 -5 0
    }
  }
}
MOTION
Frames: 1
Frame Time: 0.0083333
0 0 0 0 0 0 0 0 0
"""

# --- refusals


class Refusal(NamedTuple):
    """A command line, with `@name` for a file of `given`, its exit code, and a pattern of the
    sentence."""

    name: str
    arguments: str
    given: dict[str, str | bytes]
    match: str
    code: int = 2


def bad(
    name: str, content: str | bytes, match: str, arguments: str = "hypotheses @f.json --out @out"
) -> Refusal:
    return Refusal(name, arguments, {"f.json": content}, match)


GOOD = {"f.json": native()}
HYPOTHESES = "hypotheses @f.json --out @out "
REFUSALS = [
    bad("empty file", "", "f.json is empty; check what wrote it"),
    bad("not JSON", "keypoints: 1", r"f.json is of a shape that is not known here"),
    bad("cut JSON", native()[:-40], "f.json is not valid JSON"),
    bad("not text", b"{\x80binary", "f.json is not UTF-8 text"),
    bad("other text", b"\xff\xfe\x00binary", "f.json looks like UTF-16 text; save it as UTF-8"),
    bad(
        "another shape",
        '{"detections": []}',
        "of a shape that is not known here; the known ones are",
    ),
    bad("a number", "3", "of a shape that is not known"),
    bad(
        "native without people",
        '{"format": "poseterior-detections", "version": 1}',
        "'people' of .*f.json is None",
    ),
    bad(
        "native with another joint",
        native(tail=[1, 2, 0.5]),
        "has a joint 'tail', which is none of pelvis",
    ),
    bad(
        "native with two numbers",
        native(head=[1, 2]),
        r"head of person 0 .* where \[x, y, score\] is needed",
    ),
    bad(
        "too few keypoints",
        openpose(lambda flat: flat[:-3]),
        r"holds 24 points of a person; no order known here has so many",
    ),
    bad("too many keypoints", openpose(lambda flat: [*flat, 1.0]), "holds 76 numbers"),
    bad(
        "NaN score",
        openpose(with_score(np.nan)),
        "score of right_elbow in person 0 of .* is nan, .* not finite",
    ),
    bad(
        "infinite score",
        openpose(with_score(np.inf)),
        "score of right_elbow in person 0 of .* is inf, .* not finite",
    ),
    bad(
        "negative score",
        openpose(with_score(-0.5)),
        "score of right_elbow in person 0 of .* is -0.5, .* negative",
    ),
    bad("nobody", openpose(people=0), "f.json has no person in it"),
    bad(
        "nothing seen",
        openpose(lambda flat: [0] * len(flat)),
        "no joint of any person|too few are seen",
    ),
    bad(
        "one joint",
        native(**dict.fromkeys(JOINTS[1:])),
        "too few torso joints .*: it shows pelvis; needed",
    ),
    bad(
        "no hips",
        native(pelvis=None, left_hip=None, right_hip=None),
        "too few torso joints for a camera in person 0 of .*: it shows thorax, right_shoulder,"
        " left_shoulder; needed are at least three of .*, one of them a shoulder or the thorax and"
        " one a hip or the pelvis",
    ),
    Refusal(
        "missing file",
        "hypotheses @nope.json --out @out",
        {},
        "there is no file of 2D joints at .*nope.json; give the path",
    ),
    Refusal(
        "folder as file",
        "hypotheses @d --out @out",
        {"d/x.json": "{}"},
        "d is a folder, not a file; give the path",
    ),
    Refusal(
        "missing argument",
        "hypotheses --out @out",
        {},
        "missing argument 'file'; see `poseterior hypo",
    ),
    Refusal("no such option", HYPOTHESES + "--bogus 1", GOOD, "no such option: --bogus"),
    Refusal(
        "no such command", "frobnicate", {}, "no such command 'frobnicate'; see `poseterior --help`"
    ),
    Refusal(
        "person out of range",
        HYPOTHESES + "--person 1",
        GOOD,
        "has 1 person, .*; person 1 is not among them",
    ),
    Refusal(
        "negative person",
        HYPOTHESES + "--person -1",
        GOOD,
        "person -1 is not among them, choose one that is",
    ),
    Refusal("no hypotheses", HYPOTHESES + "--k 0", GOOD, "at least 1, not 0; give another --k"),
    Refusal(
        "more hypotheses than draws",
        HYPOTHESES + "--k 9 --num-samples 8",
        GOOD,
        "--k 9 .* raise --num-samples",
    ),
    Refusal(
        "no samples", HYPOTHESES + "--num-samples 0", GOOD, "invalid value for '--num-samples'"
    ),
    Refusal(
        "absurdly many",
        HYPOTHESES + "--num-samples 99999999999",
        GOOD,
        "invalid value for '--num-samples'",
    ),
    Refusal(
        "a word for a number",
        HYPOTHESES + "--num-samples many",
        GOOD,
        "invalid value for '--num-samples'",
    ),
    Refusal(
        "no candidates", HYPOTHESES + "--candidates 0", GOOD, "invalid value for '--candidates'"
    ),
    Refusal(
        "no proposals",
        HYPOTHESES + "--max-proposals 0",
        GOOD,
        "invalid value for '--max-proposals'",
    ),
    Refusal("negative seed", HYPOTHESES + "--seed -1", GOOD, "invalid value for '--seed'"),
    Refusal(
        "huge seed", HYPOTHESES + "--seed 99999999999999999999", GOOD, "invalid value for '--seed'"
    ),
    Refusal(
        "unknown estimator",
        HYPOTHESES + "--root fixed --estimator magic",
        GOOD,
        "no estimator 'magic'; choose one of",
    ),
    Refusal(
        "unknown format",
        HYPOTHESES + "--format xml",
        GOOD,
        "no format 'xml'; choose auto or one of movenet, .*heatmaps",
    ),
    Refusal(
        "wrong format",
        HYPOTHESES + "--format coco-results",
        GOOD,
        "f.json is .* where a JSON array is needed",
    ),
    Refusal("unknown measure", HYPOTHESES + "--upper volume", GOOD, "invalid value for '--upper'"),
    Refusal(
        "zero factor",
        HYPOTHESES + "--factor 0",
        GOOD,
        "--factor must lie between 1e-06 and 1e.06, not 0;",
    ),
    Refusal(
        "negative factor", HYPOTHESES + "--factor -1", GOOD, "--factor must lie between .*, not -1;"
    ),
    Refusal(
        "NaN factor", HYPOTHESES + "--factor nan", GOOD, "--factor must lie between .*, not nan;"
    ),
    Refusal(
        "tiny factor",
        HYPOTHESES + "--factor 1e-300",
        GOOD,
        "--factor must lie between .*, not 1e-300;",
    ),
    Refusal(
        "name of no letters",
        "hypotheses @\udcff.json --out @out",
        {},
        "is not UTF-8, .*; rename it",
    ),
    Refusal(
        "NaN threshold",
        HYPOTHESES + "--threshold nan",
        GOOD,
        "the threshold of the scores must be 0 or",
    ),
    Refusal(
        "threshold above all",
        HYPOTHESES + "--threshold 9",
        GOOD,
        "above the threshold 9; lower the threshold",
    ),
    Refusal(
        "missing image",
        HYPOTHESES + "--image @no.png",
        GOOD,
        "there is no image at .*no.png; check its name",
    ),
    Refusal(
        "not an image",
        HYPOTHESES + "--image @f.json",
        GOOD,
        "f.json is no image that can be read .*; give a PNG",
    ),
    Refusal("folder as image", HYPOTHESES + "--image @.", GOOD, "is a folder, not a file"),
    Refusal(
        "out is a file",
        "hypotheses @f.json --out @f.json",
        GOOD,
        "would replace what is read from",
    ),
    Refusal(
        "out below a file",
        "hypotheses @f.json --out @f.json/x",
        GOOD,
        "cannot make the folder .*; choose",
    ),
    Refusal(
        "out in /proc", "hypotheses @f.json --out /proc", GOOD, "cannot write to the folder /proc"
    ),
    Refusal(
        "unknown sampler",
        "sample @f.json --sampler gibbs --out @p.nc",
        GOOD,
        "no sampler 'gibbs' draws torso and camera; choose weighted-roots, .* or the root"
        " 'candidates' .on the command line --root fixed",
    ),
    Refusal(
        "unknown sampler of fixed roots",
        "sample @f.json --root fixed --sampler gibbs --out @p.nc",
        GOOD,
        "no sampler 'gibbs'; choose one of rejection,",
    ),
    Refusal(
        "estimator of an uncertain root",
        HYPOTHESES + "--estimator zhou",
        GOOD,
        "--estimator means nothing where torso and camera are uncertain; .* --root fixed",
    ),
    Refusal(
        "candidates of an uncertain root",
        HYPOTHESES + "--candidates 1",
        GOOD,
        "--candidates means nothing where torso and camera are uncertain; .* --root fixed",
    ),
    Refusal(
        "chains of an uncertain root",
        "sample @f.json --chains 4 --out @p.nc",
        GOOD,
        "--chains means nothing where torso and camera are uncertain; .* --root fixed",
    ),
    Refusal(
        "most fixed roots",
        HYPOTHESES + "--root fixed --most-roots 9",
        GOOD,
        "--most-roots means nothing where torso and camera are fixed; .* --root uncertain",
    ),
    Refusal(
        "number of fixed roots",
        HYPOTHESES + "--root fixed --roots 9",
        GOOD,
        "--roots means nothing where torso and camera are fixed; .* --root uncertain",
    ),
    Refusal(
        "sample into a folder",
        "sample @f.json --out @.",
        GOOD,
        "is a folder; --out needs the name of a file",
    ),
    Refusal(
        "sample into nowhere",
        "sample @f.json --out @no/p.nc",
        GOOD,
        "the folder .*no does not exist; make it",
    ),
    Refusal(
        "sample below a file",
        "sample @f.json --out @f.json/p.nc",
        GOOD,
        "the folder .*f.json does not exist",
    ),
    Refusal(
        "sample into a device",
        "sample @f.json --out /dev/full",
        GOOD,
        "/dev/full is not a regular file; choose",
    ),
    Refusal(
        "sample into /proc",
        "sample @f.json --out /proc/p.nc",
        GOOD,
        "cannot write to the folder /proc",
    ),
    Refusal(
        "prior into nowhere",
        "prior --num-samples 5 --out @no/p.nc",
        {},
        "the folder .*no does not exist",
    ),
    Refusal(
        "prior of nothing",
        "prior --num-samples 0 --out @p.nc",
        {},
        "invalid value for '--num-samples'",
    ),
]

LIMITED = HYPOTHESES + "--limits @l"


def limits(name: str, content: bytes, match: str, ending: str = ".npz") -> Refusal:
    return Refusal(f"limits: {name}", f"{LIMITED}{ending}", {**GOOD, f"l{ending}": content}, match)


REFUSALS += [
    Refusal(
        "limits: missing",
        LIMITED + ".npz",
        GOOD,
        "no limits file at .*l.npz; write one with `poseterior learn`",
    ),
    Refusal(
        "limits: missing .mat",
        LIMITED + ".mat",
        GOOD,
        "there is no MATLAB file at .*l.mat; give the path of the published",
    ),
    limits("text", b"hello", "l.npz is no limits file, or is truncated"),
    limits("truncated", default_limits()[:5000], "l.npz is no limits file, or is truncated"),
    limits(
        "of other things",
        npz(a=np.zeros(3)),
        "l.npz lacks occupied, .* so it is no limits file; write one with",
    ),
    limits(
        "of another shape",
        default_limits(occupied=np.zeros(9, np.uint8)),
        "occupied has shape .*9,",
    ),
    limits(
        "half an anatomy",
        default_limits(torsos=None),
        "l.npz lacks torsos, so it is damaged; write one with",
    ),
    limits(
        "other torsos", default_limits(torsos=np.zeros((2, 5, 3))), r"torsos has shape \(2, 5, 3\)"
    ),
    limits("text as .mat", b"hello", "l.mat is not a MATLAB file, or is truncated", ".mat"),
    limits(
        "an .npz as .mat", default_limits(), "l.mat is not a MATLAB file, or is truncated", ".mat"
    ),
]


def check(name: str, file: str, content: str | bytes, match: str) -> Refusal:
    return Refusal(f"check: {name}", f"check @{file}", {file: content}, match)


REFUSALS += [
    Refusal(
        "check: missing", "check @no.npy", {}, "there is no file .*no.npy; give one with 3D poses"
    ),
    Refusal(
        "check: empty folder",
        "check @.",
        {},
        "holds no .amc, .bvh, .trc, .c3d or .npz file; give a folder of motion capture",
    ),
    check("another kind", "p.txt", "hello", "p.txt is not a file of 3D poses; check reads"),
    check("not an array", "p.npy", "hello", "p.npy is no NumPy array of numbers"),
    check("empty array file", "p.npy", b"", "p.npy is no NumPy array of numbers"),
    check("cut array", "p.npy", npy(standing())[:-20], "p.npy is no NumPy array of numbers"),
    check("objects", "p.npy", npy(np.array([None])), "p.npy holds pickled Python objects"),
    check(
        "an archive by another name",
        "p.npy",
        npz(a=standing()),
        "p.npy is an archive of arrays; name it .npz",
    ),
    check(
        "wrong shape",
        "p.npy",
        npy(np.zeros((4, 17, 2))),
        r"p.npy has shape \(4, 17, 2\) .*; it needs numbers",
    ),
    check("words", "p.npy", npy(np.full((15, 3), "a")), "it needs numbers"),
    check("no pose", "p.npy", npy(np.zeros((0, 15, 3))), "p.npy holds no pose"),
    check(
        "NaN",
        "p.npy",
        npy(pose("head", np.nan)),
        r"head of pose 0 in .*p.npy is \[.*nan.*\]; the check needs",
    ),
    check(
        "infinite",
        "p.npy",
        npy(pose("head", -np.inf)),
        "head of pose 0 in .* the check needs finite numbers",
    ),
    check(
        "overflow",
        "p.npy",
        npy(pose("head", 1e300)),
        "head of pose 0 in .* the check needs finite numbers",
    ),
    check(
        "no length",
        "p.npy",
        npy(np.zeros((15, 3))),
        "the bone head of pose 0 in .*p.npy has length zero",
    ),
    check("no hypotheses", "p.json", native(), "p.json is not a hypotheses.json of poseterior"),
    check("text as .nc", "p.nc", "hello", "p.nc is no file of poses of poseterior"),
    check(
        "wrong shape in .npz",
        "p.npz",
        npz(walk=np.zeros((5, 14, 3))),
        r"'walk' has shape \(5, 14, 3\)",
    ),
    check(
        "bones missing in .bvh",
        "p.bvh",
        BVH,
        "p.bvh: the skeleton has no joint that is known as thorax",
    ),
    Refusal(
        "learn: nothing",
        "learn --out @l.npz",
        {},
        "missing argument 'mocap'; see `poseterior learn --help`",
    ),
    Refusal(
        "learn: missing",
        "learn @no.bvh --out @l.npz",
        {},
        "there is no motion capture at .*no.bvh; give",
    ),
    Refusal(
        "learn: no margin",
        "learn @f.bvh --out @l.npz --wider nan",
        {"f.bvh": BVH},
        "margins cannot be nan times as wide; give 0 to 11",
    ),
    Refusal(
        "learn: another kind",
        "learn @f.json --out @l.npz",
        GOOD,
        "f.json is no motion capture that can be read",
    ),
    Refusal(
        "learn: bones missing",
        "learn @f.bvh --out @l.npz",
        {"f.bvh": BVH},
        "the skeleton has no joint that is known as",
    ),
    Refusal(
        "learn: no hierarchy",
        "learn @f.bvh --out @l.npz",
        {"f.bvh": "walk"},
        "f.bvh is not a BVH file",
    ),
    Refusal("learn: cut", "learn @f.bvh --out @l.npz", {"f.bvh": BVH[:-20]}, "f.bvh"),
    Refusal(
        "learn: no skeleton",
        "learn @1_1.amc --out @l.npz",
        {"1_1.amc": "1\nroot 0\n"},
        "needs its skeleton",
    ),
    Refusal(
        "learn: not recordings",
        "learn @f.npz --out @l.npz",
        {"f.npz": npz(a=np.zeros(4))},
        "'a' has shape",
    ),
    Refusal(
        "learn: out is a folder",
        "learn @f.bvh --out @.",
        {"f.bvh": BVH},
        "is a folder; --out needs",
    ),
]


@pytest.mark.parametrize("case", REFUSALS, ids=lambda case: case.name)
def test_refusals(case: Refusal, poseterior: Cli, tmp_path: Path) -> None:
    refused(case, poseterior, tmp_path)


def refused(case: Refusal, poseterior: Cli, folder: Path) -> None:
    for name, content in case.given.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    before = files(folder)
    words = [
        str(folder / word[1:]) if word.startswith("@") else word for word in case.arguments.split()
    ]
    known = {name.split()[0] for name in cli.COMMANDS}
    run = poseterior(*words, *(["--quiet"] if words[0] in known else []))
    assert run.code == case.code, run
    assert re.fullmatch(rf"poseterior: [^\n]*(?:{case.match})[^\n]*\n", run.err), run.err
    assert run.out == ""
    assert files(folder) == before, "something was left behind"


def test_a_frame_of_motion_capture_that_is_cut_off(
    shared_data: Path, poseterior: Cli, tmp_path: Path
) -> None:
    source = shared_data / "cmu" / "asfamc" / "01"
    (tmp_path / "01.asf").write_bytes((source / "01.asf").read_bytes())
    lines = (source / "01_01.amc").read_text().splitlines()
    (tmp_path / "01_01.amc").write_text("\n".join(lines[: 3 + 30 * 5 + 12]))
    match = (
        r"01_01.amc: the recording is truncated, its last frame is not complete; cut that frame off"
    )
    refused(Refusal("", "learn @01_01.amc --out @l.npz", {}, match), poseterior, tmp_path)


# --- nothing explains the detection, or the budget ends


@pytest.mark.parametrize(
    ("root", "said"),
    [
        pytest.param("fixed", "no pose explains", marks=pytest.mark.slow),
        ("uncertain", "none of 1,000 roots that explain the torso of"),
    ],
)
def test_a_wrist_out_of_reach(root: str, said: str, poseterior: Cli, tmp_path: Path) -> None:
    started = time.process_time()
    given = {"f.json": native(right_wrist=FAR)}
    match = (
        rf"{said} person 0 of .*: right_wrist was detected \d{{4}} px \(\d+\.\d\d limb"
        r" lengths\) farther than"
    )
    camera = " --focal weak" if root == "uncertain" else ""
    words = f"{HYPOTHESES} --root {root}{camera} --num-samples 100"
    refused(Refusal("", words, given, match, 3), poseterior, tmp_path)
    assert time.process_time() - started < 60


def conflict(folder: Path) -> tuple[Path, Path]:
    """Detections and limits under which the right arm must be long and the left arm short, though
    arms are as long as each other; each alone is possible. Upper arms may point sideways only, so
    that their length shows in the image."""
    anatomy = Anatomy.default()
    occupied = np.array(anatomy.limits.occupied)
    model = PoseModel.from_anatomy(anatomy)
    torso, view = np.asarray(anatomy.torsos)[0], camera(0.0)
    upper = np.zeros((5, 3))
    for bone in range(5):
        cells = np.argwhere(occupied[bone])
        vectors = np.asarray(
            direction(
                cells[:, 0] * CELL + CELL / 2 - np.pi, cells[:, 1] * CELL + CELL / 2 - np.pi / 2
            )
        )
        every = np.zeros((len(cells), 5, 3)) + upper
        every[:, bone] = vectors
        chosen = _flattest(model, np.asarray(view.view(torso)), every, bone)
        upper[bone] = vectors[chosen]
        if bone in (1, 2):
            alone = np.zeros_like(occupied[bone])
            alone[tuple(cells[chosen])] = True
            occupied[bone] = alone
    length = (np.asarray(anatomy.lengths.low) + np.asarray(anatomy.lengths.high)) / 2
    short, long = length.copy(), length.copy()
    arm = LENGTH_GROUPS.index("upper_arm")
    span = float(anatomy.lengths.high[arm] - anatomy.lengths.low[arm])
    short[arm], long[arm] = (
        anatomy.lengths.low[arm] + 0.2 * span,
        anatomy.lengths.high[arm] - 0.2 * span,
    )
    lower = np.tile([1.0, 0.0, 0.0], (4, 1))
    joints = np.asarray(model.joints(torso, short, upper, lower)).copy()
    right = JOINT_INDEX["right_elbow"]
    joints[right] = np.asarray(model.joints(torso, long, upper, lower))[right]
    score = np.zeros(NUM_JOINTS)
    score[[i for i, name in enumerate(JOINTS) if not re.search("wrist|knee|ankle|head", name)]] = (
        0.8
    )
    keypoints = np.where(score[:, None] > 0, np.asarray(view.project(joints)), np.nan)
    write_detections(folder / "f.json", [Detection(keypoints, score, "made", "made", 0)])
    narrowed = dataclasses.replace(anatomy.limits, occupied=occupied, name="sideways")
    dataclasses.replace(anatomy, limits=narrowed).save(folder / "l.npz")
    return folder / "f.json", folder / "l.npz"


def _flattest(model: PoseModel, torso: np.ndarray, upper: np.ndarray, bone: int) -> int:
    """Which of the directions runs most nearly across the image."""
    bones = [
        JOINT_INDEX[name]
        for name in ("head", "right_elbow", "left_elbow", "right_knee", "left_knee")
    ]
    lengths, lower = (
        np.ones((len(upper), NUM_LENGTHS)),
        np.tile([1.0, 0.0, 0.0], (len(upper), 4, 1)),
    )
    starts = [1, 2, 5, 9, 12]
    joints = np.asarray(
        model.joints(
            torso, lengths, np.where(upper.any(-1, keepdims=True), upper, [0, 0, 1.0]), lower
        )
    )
    return int(np.argmin(np.abs(joints[:, bones[bone], 2] - joints[:, starts[bone], 2])))


@pytest.mark.slow
def test_two_arms_that_no_shared_length_explains(poseterior: Cli, tmp_path: Path) -> None:
    detections, limits_file = conflict(tmp_path)
    options = (
        "--limits",
        limits_file,
        "--root",
        "fixed",
        "--candidates",
        1,
        "--num-samples",
        50,
        "--quiet",
        "--out",
        tmp_path / "p.nc",
    )
    alone = poseterior("sample", detections, "--factor", 0.2, *options)
    assert alone.code == 0, "the limits leave no way at all"
    (tmp_path / "p.nc").unlink()
    started = time.process_time()
    run = poseterior("sample", detections, "--factor", 0.02, "--max-proposals", 300_000, *options)
    assert run.code == 3, run
    assert re.fullmatch(
        r"poseterior: no pose explains person 0 .*: the bounds leave no possible arms for their"
        r" detections .*\n",
        run.err,
    )
    assert time.process_time() - started < 120
    assert not (tmp_path / "p.nc").exists()


@pytest.mark.slow
def test_what_a_budget_sufficed_for_is_saved(poseterior: Cli, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = poseterior(
        "hypotheses",
        EXAMPLE,
        "--root",
        "fixed",
        "--num-samples",
        500_000,
        "--max-proposals",
        1_200_000,
        "--out",
        out,
        "--quiet",
    )
    assert run.code == 3, run
    assert re.fullmatch(
        rf"poseterior: \d+ of 500000 draws after .* \(what there is, is saved in {out}\)\n", run.err
    )
    assert sorted(files(out)) == RESULTS
    with xr.open_datatree(out / "posterior.nc", engine="netcdf4") as tree:
        assert 0 < tree["posterior"].sizes["draw"] < 500_000
        assert tree.attrs["status"] == "out of budget"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("root", "said"),
    [("fixed", "0 of 10 draws after 0 proposals"), ("uncertain", "no root was attempted for")],
)
def test_a_budget_below_the_first_proposals(
    root: str, said: str, poseterior: Cli, tmp_path: Path
) -> None:
    options = f"--root {root} --num-samples 10 --max-proposals 1"
    refused(Refusal("", HYPOTHESES + options, GOOD, said, 3), poseterior, tmp_path)


# --- what is written

NUM = 150
GROUPS: dict[str, dict[str, tuple[str, ...]]] = {
    "posterior": {
        "joints": ("chain", "draw", "joint", "axis"),
        "bone_length": ("chain", "draw", "length_group"),
        "torso": ("chain", "draw"),
        "candidate": ("chain", "draw"),
        "keypoints": ("chain", "draw", "joint", "uv"),
    },
    "sample_stats": {"lp": ("chain", "draw")},
    "observed_data": {"keypoints": ("joint", "uv"), "score": ("joint",)},
    "constant_data": {
        "radius": ("candidate", "joint"),
        "scale": ("candidate",),
        "rotation": ("candidate", "axis", "body_axis"),
        "translation": ("candidate", "uv"),
        "log_evidence": ("candidate",),
    },
}
ATTRIBUTES = {
    "sampler",
    "seed",
    "num_proposals",
    "acceptance_rate",
    "log_evidence",
    "log_evidence_se",
    "wall_time_s",
    "limits",
    "measures",
    "versions",
}


@pytest.fixture(scope="module")
def written(cache: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `hypotheses` makes of the example, the paper's way."""
    out = tmp_path_factory.mktemp("made") / "new" / "folder"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["poseterior", *hypotheses_of_example(out)])
        with pytest.raises(SystemExit, match=r"^0$"):
            cli.main()
    return out


def hypotheses_of_example(out: Path, seed: int = 3) -> list[str]:
    words = [
        "hypotheses",
        EXAMPLE,
        "--root",
        "fixed",
        "--num-samples",
        NUM,
        "--k",
        4,
        "--seed",
        seed,
        "--out",
        out,
        "--quiet",
    ]
    return [str(word) for word in words]


def test_three_files_are_written(written: Path) -> None:
    assert sorted(files(written)) == RESULTS
    assert (written / "hypotheses.png").read_bytes().startswith(PNG)


def test_the_posterior_is_as_promised(written: Path) -> None:
    with xr.open_datatree(written / "posterior.nc", engine="netcdf4") as tree:
        assert tree.attrs.keys() >= ATTRIBUTES
        for group, variables in GROUPS.items():
            for name, dims in variables.items():
                assert tree[group][name].dims == dims, f"{group}/{name}"
        posterior = tree["posterior"]
        assert dict(posterior.sizes) == {
            "chain": 1,
            "draw": NUM,
            "joint": 15,
            "axis": 3,
            "length_group": 5,
            "uv": 2,
        }
        assert posterior["joint"].values.tolist() == list(JOINTS)
        assert posterior["axis"].values.tolist() == ["x", "y", "z"]
        assert posterior["length_group"].values.tolist() == list(LENGTH_GROUPS)
        assert np.isfinite(posterior["joints"]).all()
        assert not posterior["joints"].sel(joint="pelvis").any()
        assert re.fullmatch("default [0-9a-f]{64}", tree.attrs["limits"])
        wrist = tree["observed_data"].sel(joint="right_wrist")
        assert np.isnan(wrist["keypoints"]).all()
        assert wrist["score"] == 0


def test_keypoints_follow_from_joints_and_lie_in_their_discs(written: Path) -> None:
    with xr.open_datatree(written / "posterior.nc", engine="netcdf4") as tree:
        posterior, constant = tree["posterior"].dataset.isel(chain=0), tree["constant_data"].dataset
        chosen = constant.isel(candidate=posterior["candidate"])
        flat = (
            posterior["joints"].sel(axis=["x", "y"]).rename(axis="uv").assign_coords(uv=["u", "v"])
        )
        projected = (chosen["scale"] * flat + chosen["translation"]).transpose(
            "draw", "joint", "uv"
        )
        assert np.allclose(projected, posterior["keypoints"])
        offset = posterior["keypoints"] - tree["observed_data"]["keypoints"]
        distance = np.sqrt((offset**2).sum("uv", skipna=False))
        inside = (distance <= chosen["radius"] * (1 + 1e-9)) | chosen["radius"].isnull()
        assert inside.all()


def test_arviz_reads_the_posterior(written: Path) -> None:
    with xr.open_datatree(written / "posterior.nc", engine="netcdf4") as tree:
        table = arviz.summary(tree, var_names=["bone_length"], kind="stats", round_to="none")
        mean = tree["posterior"]["bone_length"].mean(("chain", "draw"))
        assert list(table["mean"].astype(float)) == pytest.approx(list(mean.values))


def test_the_hypotheses_are_draws(written: Path) -> None:
    content = json.loads((written / "hypotheses.json").read_text(encoding="utf-8"))
    assert content["seed"] == 3
    assert content["source"] == str(EXAMPLE)
    found = content["hypotheses"]
    assert len(found) == 4
    assert sum(row["weight"] for row in found) == pytest.approx(1)
    assert [row["weight"] for row in found] == sorted(
        (row["weight"] for row in found), reverse=True
    )
    with xr.open_datatree(written / "posterior.nc", engine="netcdf4") as tree:
        for row in found:
            draw = tree["posterior"]["joints"].isel(chain=0, draw=row["draw"])
            assert np.array([row["joints"][name] for name in JOINTS]) == pytest.approx(
                draw.values, abs=1e-6
            )


def test_composed_hypotheses_are_possible_and_read_back(poseterior: Cli, tmp_path: Path) -> None:
    """They are no draws, have keypoints of their own, and `check` and `show` take them."""
    out = tmp_path / "out"
    run = poseterior(*hypotheses_of_example(out), "--composed")
    assert run.code == 0, run
    assert "Composed of limbs of draws" in run.out
    content = json.loads((out / "hypotheses.json").read_text(encoding="utf-8"))
    joints = np.array([[one["joints"][name] for name in JOINTS] for one in content["hypotheses"]])
    points = np.array(
        [[one["keypoints"][name] for name in JOINTS] for one in content["hypotheses"]]
    )
    away = np.linalg.norm(joints_of(out / "posterior.nc")[0] - joints[:, None], axis=(2, 3))
    assert (away.min(axis=1) > 1e-2).all()
    assert [one["draw"] for one in content["hypotheses"]] == away.argmin(axis=1).tolist()
    with xr.open_datatree(out / "posterior.nc", engine="netcdf4") as tree:
        off = points - tree["observed_data"]["keypoints"].values
        radius = tree["constant_data"]["radius"].max("candidate").values
        assert (np.linalg.norm(off, axis=2) <= radius + 1e-3)[:, np.isfinite(radius)].all()
    checked = poseterior("check", out / "hypotheses.json")
    assert f"{len(joints)} of {len(joints)} poses" in checked.out
    before = Parsed((out / "hypotheses.html").read_text(encoding="utf-8")).data["hypotheses"]
    assert poseterior("show", out).code == 0
    after = Parsed((out / "hypotheses.html").read_text(encoding="utf-8")).data["hypotheses"]
    for one, other in zip(before, after, strict=True):
        assert np.array(one["projected"]) == pytest.approx(np.array(other["projected"]), abs=1e-3)
        assert np.array(one["joints"]) == pytest.approx(np.array(other["joints"]), abs=1e-5)
    content["hypotheses"][0]["joints"]["head"][2] = float("nan")
    (out / "hypotheses.json").write_text(json.dumps(content))
    assert poseterior("show", out).code == 2
    content["hypotheses"][0]["joints"]["head"][2] = 5.0  # nearer to another draw
    (out / "hypotheses.json").write_text(json.dumps(content))
    refused = poseterior("show", out)
    assert refused.code == 2
    assert "is not of the draws beside it" in refused.err


def joints_of(path: Path) -> np.ndarray:
    with xr.open_datatree(path, engine="netcdf4") as tree:
        return np.asarray(tree["posterior"]["joints"].values)


def test_the_seed_decides(written: Path, poseterior: Cli, tmp_path: Path) -> None:
    for seed in (3, 4):
        assert poseterior(*hypotheses_of_example(tmp_path / str(seed), seed)).code == 0
    first = joints_of(written / "posterior.nc")
    assert np.array_equal(joints_of(tmp_path / "3" / "posterior.nc"), first)
    assert (
        not np.isclose(joints_of(tmp_path / "4" / "posterior.nc"), first)[..., 1:, :]
        .any(axis=(0, 2, 3))
        .all()
    )
    same = json.loads((tmp_path / "3" / "hypotheses.json").read_text(encoding="utf-8"))
    assert same == json.loads((written / "hypotheses.json").read_text(encoding="utf-8"))


def strict_json(text: str) -> Any:
    """Parses what any JSON parser would, so neither NaN nor Infinity."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_hypotheses_as_json(poseterior: Cli, tmp_path: Path) -> None:
    run = poseterior(*hypotheses_of_example(tmp_path / "out"), "--json")
    assert run.code == 0
    said = strict_json(run.out)
    assert said.keys() == {"hypotheses", "candidates", "joints", "summary", "out"}
    assert said["summary"]["num_draws"] == NUM
    assert run.err == ""


def test_hypotheses_as_a_table(poseterior: Cli, tmp_path: Path) -> None:
    run = poseterior(*hypotheses_of_example(tmp_path / "out"))
    assert f"{NUM} draws by rejection" in run.out
    for heading in ("Hypotheses", "Candidates", "Posterior, joint by joint"):
        assert heading in run.out
    assert (
        f"Written to {tmp_path / 'out'}: posterior.nc, hypotheses.json, hypotheses.png,"
        " hypotheses.html\n" in run.out
    )


def test_an_image_is_drawn_behind(written: Path, poseterior: Cli, tmp_path: Path) -> None:
    image = written / "hypotheses.png"
    assert poseterior(*hypotheses_of_example(tmp_path / "out"), "--image", image).code == 0
    assert (tmp_path / "out" / "hypotheses.png").read_bytes().startswith(PNG)


@pytest.mark.slow
def test_a_person_of_a_coco_or_openpose_file(poseterior: Cli, tmp_path: Path) -> None:
    (tmp_path / "two.json").write_text(openpose(people=2))
    out = tmp_path / "p.nc"
    run = poseterior(
        "sample",
        tmp_path / "two.json",
        "--person",
        1,
        "--num-samples",
        20,
        "--out",
        out,
        "--quiet",
        "--json",
    )
    assert run.code == 0, run
    assert strict_json(run.out)["person"] == 1


@pytest.mark.parametrize("sampler", sweep(PROPOSALS, ["rejection"]))
def test_every_sampler_draws(sampler: str, poseterior: Cli, tmp_path: Path) -> None:
    (tmp_path / "f.json").write_text(native(**FEW))
    out = tmp_path / "posterior.nc"
    options = ("--num-samples", 100, "--factor", 1, "--out", out, "--quiet", "--json")
    by = ("--root", "fixed", "--sampler", sampler)
    run = poseterior("sample", tmp_path / "f.json", *by, *options)
    assert run.code == 0, run
    assert strict_json(run.out)["sampler"] == sampler
    assert joints_of(out).shape == (1, 100, 15, 3)
    assert sorted(files(tmp_path)) == ["f.json", "posterior.html", "posterior.nc"]


@pytest.mark.slow
def test_samplers_say_the_same(poseterior: Cli, tmp_path: Path) -> None:
    """Log evidences of all ways of proposing agree to five standard errors of their
    difference."""
    (tmp_path / "f.json").write_text(native(**FEW))
    found = []
    for seed, sampler in enumerate(PROPOSALS):
        options = (
            "--root",
            "fixed",
            "--num-samples",
            1000,
            "--factor",
            1,
            "--seed",
            seed,
            "--out",
            tmp_path / "p.nc",
            "--quiet",
            "--json",
        )
        said = strict_json(
            poseterior("sample", tmp_path / "f.json", "--sampler", sampler, *options).out
        )
        found.append((said["log_evidence"], said["log_evidence_se"]))
    for value, error in found[1:]:
        assert abs(value - found[0][0]) < 5 * np.hypot(error, found[0][1]), found


@pytest.mark.slow
def test_prior_is_possible(poseterior: Cli, tmp_path: Path) -> None:
    out = tmp_path / "prior.nc"
    run = poseterior("prior", "--num-samples", 300, "--out", out, "--quiet", "--json")
    assert run.code == 0
    assert strict_json(run.out)["num_samples"] == 300
    with xr.open_datatree(out, engine="netcdf4") as tree:
        assert tree["prior"]["joints"].shape == (1, 300, 15, 3)
    verdict = strict_json(poseterior("check", out, "--json").out)
    assert len(verdict) == 300
    assert all(row["possible"] for row in verdict)


# --- check and learn


@pytest.mark.parametrize(("name", "count"), [("posterior.nc", NUM), ("hypotheses.json", 4)])
def test_draws_are_possible(name: str, count: int, written: Path, poseterior: Cli) -> None:
    run = poseterior("check", written / name, "--quiet")
    assert run == Run(
        0, f"{count} of {count} poses in {written / name} are possible (limits default).\n", ""
    )


def test_a_broken_elbow_is_named(poseterior: Cli, tmp_path: Path) -> None:
    file = tmp_path / "poses.npy"
    np.save(file, np.stack([standing(), broken_elbow()]))
    run = poseterior("check", file, "--quiet")
    assert run.code == 0
    row = next(line for line in run.out.splitlines() if "left forearm" in line)
    assert re.search(
        r"pose 1\s+left forearm\s+(bends|turns) beyond the joint's (plane|range)\s+\d+\.\d", row
    )
    assert f"1 of 2 poses in {file} are possible (limits default)." in run.out
    fine, spoilt = strict_json(poseterior("check", file, "--quiet", "--json").out)
    assert fine == {"pose": "pose 0", "possible": True, "broken": []}
    assert [broken["bone"] for broken in spoilt["broken"]] == ["left_forearm"]
    assert spoilt["broken"][0]["limit"] in LIMITS[1:]
    assert 1 < spoilt["broken"][0]["excess_degrees"] < 180


def test_many_broken_poses_are_counted_by_bone(poseterior: Cli, tmp_path: Path) -> None:
    file = tmp_path / "poses.npz"
    np.savez(file, walk=np.tile(broken_elbow(), (50, 1, 1)))
    run = poseterior("check", file, "--quiet")
    assert run.code == 0
    assert re.search(r"left forearm\s+(plane|box)\s+50\s+\d+\.\d", run.out)
    assert f"0 of 50 poses in {file} are possible (limits default)." in run.out
    assert len(run.out.splitlines()) < 20


def test_names_with_brackets_are_printed_as_they_are(poseterior: Cli, tmp_path: Path) -> None:
    file = tmp_path / "poses [bold] :smile:.npz"
    np.savez(file, **{"walk[red]": broken_elbow()[None]})
    run = poseterior("check", file, "--quiet")
    assert "walk[red]" in run.out
    assert str(file) in run.out


def test_a_folder_that_must_not_be_looked_into(
    poseterior: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As in `learn /`; permissions alone would not stop an administrator who runs the tests."""
    (tmp_path / "shut").mkdir()
    look = os.scandir

    def scandir(path: Any = ".") -> Any:
        if str(path).endswith("shut"):
            raise PermissionError(13, "Permission denied", str(path))
        return look(path)

    monkeypatch.setattr(os, "scandir", scandir)
    run = poseterior("learn", tmp_path, "--out", tmp_path / "l.npz", "--quiet")
    assert run.code == 2
    assert f"cannot look into the folder {tmp_path}/shut (Permission denied); give" in run.err


@pytest.mark.slow
def test_what_was_learned_is_used(shared_data: Path, poseterior: Cli, tmp_path: Path) -> None:
    limits_file = tmp_path / "limits.npz"
    walk = shared_data / "bvh" / "cmu_12_01_walk.bvh"
    learned = poseterior("learn", walk, "--out", limits_file, "--quiet", "--json")
    assert learned.code == 0, learned
    sha256 = strict_json(learned.out)["sha256"]
    out = tmp_path / "out"
    options = ("--num-samples", 20, "--factor", 1, "--no-head", "--quiet", "--json")
    (tmp_path / "f.json").write_text(native(**FEW))
    run = poseterior(
        "hypotheses", tmp_path / "f.json", "--limits", limits_file, "--out", out, *options
    )
    assert run.code == 0, run
    assert strict_json(run.out)["summary"]["limits_sha256"] == sha256
    verdict = poseterior("check", out / "posterior.nc", "--limits", limits_file, "--quiet")
    assert verdict.out.startswith("20 of 20 poses")


# --- help, progress, processes


HELPS = """
import contextlib, io, json, sys, time
from poseterior.reports.cli import main
for command in json.load(sys.stdin):
    sys.argv[1:], said, began = [*command.split(), "--help"], io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        main()
    heavy = sorted({"jax", "scipy", "matplotlib"} & set(sys.modules))
    print(json.dumps([said.getvalue(), heavy, time.process_time() - began]))
"""
"""Says the help of one command after the other, what heavy libraries that has loaded, and the
seconds of the processor."""


@pytest.fixture(scope="module")
def helps() -> dict[str, tuple[str, list[str], float]]:
    """What a fresh interpreter says of each command."""
    commands = ["", *cli.COMMANDS]
    done = subprocess.run(
        [sys.executable, "-c", HELPS],
        cwd=Path(__file__).parents[2],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "COLUMNS": "80", "TERM": "dumb"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    return dict(zip(commands, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("command", ["", *cli.COMMANDS])
def test_help_is_quick_and_has_an_example(
    command: str, helps: dict[str, tuple[str, list[str], float]]
) -> None:
    said, heavy, seconds = helps[command]
    assert not heavy
    assert seconds < 1.5
    if command:
        assert re.search(rf"^ *Examples?:\s+poseterior {command}\b", said, re.MULTILINE), said
    else:
        named = {name.split()[0] for name in cli.COMMANDS}
        assert all(re.search(rf"│ {name} ", said) for name in named)


def test_without_arguments_it_helps(poseterior: Cli) -> None:
    run = poseterior()
    assert (run.code, run.err) == (0, "")
    assert "Usage: poseterior" in run.out


def test_progress_in_a_log(
    poseterior: Cli, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shown: list[str] = []

    class Told(console._Log):
        """A log that knows what it was opened for, however fast that was over."""

        def __enter__(self) -> "Told":
            shown.append(self._what)
            super().__enter__()
            return self

    monkeypatch.setattr(console, "_Log", Told)
    words = [word for word in hypotheses_of_example(tmp_path / "out") if word != "--quiet"]
    assert poseterior(*words).code == 0
    stages = ["reading", "torso and camera", "exact draws", "hypotheses and their pictures"]
    assert shown == stages
    assert poseterior(*words, "--quiet").err == ""
    assert shown == stages, "quiet opens none"


def test_a_log_hears_of_what_takes_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "PATIENCE", 0.02)
    heard = ""
    with console.progress("walking", quiet=False) as step:
        step(3, 10_000)
        while not heard:  # however busy the machine is
            time.sleep(0.01)
            heard += capsys.readouterr().err
    heard += capsys.readouterr().err
    assert re.match(r"walking: 3 of 10,000, \d+ s\n", heard)
    monkeypatch.setattr(console, "PATIENCE", 600.0)
    with console.progress("running", quiet=False) as step:
        step(1, 2)
    assert capsys.readouterr().err == ""


def test_a_terminal_has_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(
        console, "ERR", rich.console.Console(file=screen, force_terminal=True, width=80)
    )
    with console.progress("walking", quiet=False) as step:
        step(3, 10)
    assert "walking" in screen.getvalue()
    assert "3/10" in screen.getvalue()


class Ending(NamedTuple):
    error: BaseException
    code: int
    sentence: str


@pytest.mark.parametrize(
    "ending",
    [
        Ending(KeyboardInterrupt(), 130, "poseterior: interrupted\n"),
        Ending(typer.Abort(), 130, "poseterior: interrupted\n"),
        Ending(
            MemoryError(),
            2,
            "poseterior: the memory does not suffice; ask for fewer samples with --num-samples\n",
        ),
    ],
    ids=lambda ending: type(ending.error).__name__,
)
def test_endings(ending: Ending, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        console.guarded(failing(ending.error))
    assert ended.value.code == ending.code
    assert capsys.readouterr().err == ending.sentence


def failing(error: BaseException) -> Any:
    def app(*_: object, **__: object) -> None:
        raise error

    return app


def test_a_bug_is_shown_as_one() -> None:
    with pytest.raises(ZeroDivisionError):
        console.guarded(failing(ZeroDivisionError()))
    with pytest.raises(FileNotFoundError):
        console.guarded(failing(FileNotFoundError(2, "No such file", "somewhere")))


def test_as_a_process(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", standing())
    good = process("check", tmp_path / "p.npy", "--json", "--quiet")
    assert (good.returncode, good.stderr) == (0, "")
    assert strict_json(good.stdout)[0]["possible"]
    refusal = process("check", tmp_path / "no.npy", "--quiet")
    assert (refusal.returncode, refusal.stdout) == (2, "")
    assert (
        refusal.stderr
        == f"poseterior: there is no file {tmp_path / 'no.npy'}; give one with 3D poses\n"
    )


def test_a_reader_that_has_gone() -> None:
    read, write = os.pipe()
    os.close(read)
    done = process("--help", stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_disk_that_is_full() -> None:
    with open("/dev/full", "w") as full:
        done = process("--help", stdout=full)
    assert done.returncode == 2
    assert re.fullmatch(
        r"poseterior: cannot write the output \(.*\); make room, or send it elsewhere\n",
        done.stderr,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code", "sentence"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
@pytest.mark.parametrize(
    ("stage", "much"),
    [
        ("draws by rejection", ["--root", "fixed", "--num-samples", 10_000_000]),
        ("roots and their limbs", ["--roots", 100_000]),
    ],
)
def test_a_signal_in_the_midst_of_compiled_loops(
    stage: str, much: list[Any], number: int, code: int, sentence: str, tmp_path: Path
) -> None:
    words = ["sample", EXAMPLE, *much, "--out", tmp_path / "p.nc"]
    # Where the tests run in the background of a shell, SIGINT is ignored from the start; a
    # terminal's is not.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [
        sys.executable,
        "-c",
        f"{heed}; from poseterior.reports.cli import main; main()",
        *map(str, words),
    ]
    with subprocess.Popen(
        command, cwd=Path(__file__).parents[2], stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stderr is not None
        while stage not in (line := running.stderr.readline()):
            assert line, "it ended before it could be interrupted"
        running.send_signal(number)
        try:
            rest = running.communicate(timeout=60)[1]
        finally:
            running.kill()  # of no effect on what has ended
    assert running.returncode == code
    assert rest.splitlines()[-1] == f"poseterior: {sentence}"
    assert "Traceback" not in rest
    assert files(tmp_path) == {}


@pytest.mark.slow
def test_demo(poseterior: Cli, tmp_path: Path) -> None:
    run = poseterior("demo", "--out", tmp_path / "demo", "--quiet", "--json")
    assert run.code == 0
    said = strict_json(run.out)["summary"]
    assert (said["num_draws"], said["sampler"]) == (10_000, "rejection")
    assert sorted(files(tmp_path / "demo")) == RESULTS
    check = poseterior("check", tmp_path / "demo" / "posterior.nc", "--quiet")
    assert check.out.startswith("10,000 of 10,000 poses")
