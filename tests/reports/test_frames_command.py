"""`poseterior frames`: a folder of detections as one stream; refusals, and that a second call goes
on."""

import json
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference import draws_of, open_stream
from poseterior.probmodel import Detection, PoseModel, write_detections
from tests.conftest import Cli
from tests.scenes import prior_scene

OPTIONS = ("--num-samples", 50, "--k", 3, "--keep", 50, "--quiet")
FEW = ("head", "right_elbow", "right_wrist", "left_knee", "left_ankle")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames; in the second one nothing of the torso is seen but the hips."""
    path = tmp_path_factory.mktemp("walk")
    for index in range(3):
        torso = ("thorax", "right_shoulder", "left_shoulder", "pelvis") if index == 1 else ()
        detection = prior_scene(
            PoseModel.paper(), index, factor=0.8, missing=(*FEW, *torso)
        ).detection
        write_detections(path / f"frame_{index}.json", [detection])
    return path


def test_a_folder_becomes_a_stream_and_a_second_call_goes_on(
    poseterior: Cli, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = poseterior("frames", folder, "--out", out, *OPTIONS, "--json")
    assert run.code == 0, run
    said = json.loads(run.out)
    assert said["status"] == {"bad input": 1, "complete": 2}
    assert [frame["num_draws"] for frame in said["frames"]] == [50, 0, 50]
    assert "frame_1" in said["frames"][1]["sentence"]
    names = [frame["frame"] for frame in said["frames"]]
    assert names == [f"frame_{index}/0" for index in range(3)]
    tree = open_stream(out)
    assert np.isfinite(tree["hypotheses"].joints.values[[0, 2]]).all()
    assert draws_of(out, names[0]).joints.shape == (1, 50, 15, 3)
    page = (out / "hypotheses.html").read_bytes()
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.nc")}
    again = poseterior("frames", folder, "--out", out, *OPTIONS)
    assert again.code == 0, again
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.nc")} == before
    assert (out / "hypotheses.html").read_bytes() == page
    assert (out / "depth.png").exists()
    assert "3 frames of 1 person: 1 bad input, 2 complete" in again.out
    assert f"50 draws are kept of each person: at most 30.0 kB in {out}" in again.out
    assert "frame_1/0: " in again.out
    assert "left out" not in again.out
    assert poseterior("show", out, "--quiet").code == 0


@pytest.mark.slow
def test_a_fragment_of_a_second_person_is_left_out_in_one_line(
    poseterior: Cli, tmp_path: Path
) -> None:
    walk = tmp_path / "walk"
    walk.mkdir()
    for index, seed in enumerate((0, 2, 0)):
        scene = prior_scene(PoseModel.paper(), seed, factor=0.8, missing=FEW).detection
        points, score = np.full((15, 2), np.nan), np.zeros(15)
        points[[2, 3]], score[[2, 3]] = [[1.0, 2.0], [3.0, 4.0]], 0.5
        part = Detection(points, score, scene.layout, scene.source, 1)
        both = [scene, part] if index < 2 else [part]
        write_detections(walk / f"frame_{index}.json", both)
    run = poseterior("frames", walk, "--out", tmp_path / "out", *OPTIONS)
    assert run.code == 0, run
    assert run.out.count("2 fragments of people left out: ") == run.out.count("left out") == 1
    assert "3 frames of 1 person: 1 bad input, 2 complete" in run.out
    assert "(the first: frame_0/1)" in run.out
    frames = open_stream(tmp_path / "out")["summary"].frame.values.tolist()
    assert frames[:2] == ["frame_0/0", "frame_1/0"]
    assert len(frames) == 3, "where nobody else is, the fragment says why there is no pose"


def test_a_film_in_which_nobody_can_be_estimated_has_no_page(
    poseterior: Cli, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = poseterior("frames", folder / "frame_1.json", "--out", out, *OPTIONS)
    assert run.code == 0, run
    assert "without depth.png, hypotheses.html: no frame has a pose" in run.out
    assert not (out / "hypotheses.html").exists()


@pytest.mark.slow
def test_an_uncertain_root_is_said_with_its_number(
    poseterior: Cli, folder: Path, tmp_path: Path
) -> None:
    few = ("--root", "uncertain", "--roots", 40, "--num-samples", 50, "--k", 3, "--quiet")
    run = poseterior("frames", folder, "--out", tmp_path / "out", *few, "--json")
    assert run.code == 0, run
    frames = json.loads(run.out)["frames"]
    assert [frame["effective_roots"] is None for frame in frames] == [False, True, False]
    again = poseterior("frames", folder, "--out", tmp_path / "out", *few)
    assert "effective roots of a frame: " in again.out
    fixed = ("--root", "fixed", *OPTIONS)
    other = poseterior("frames", folder, "--out", tmp_path / "out", *fixed)
    assert other.code == 2
    assert "its root is 'uncertain', not 'fixed'" in other.err


def test_refusals(poseterior: Cli, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert poseterior("frames", folder, "--out", out, *OPTIONS).code == 0
    for arguments, said in [
        ((folder, "--out", out, *OPTIONS, "--seed", 1), "holds another run"),
        ((folder, "--out", tmp_path / "x", "--num-samples", 2, "--k", 3), "do not go together"),
        ((folder, "--out", tmp_path / "x", "--factor", 0), "--factor must lie between"),
        ((tmp_path / "nothing", "--out", tmp_path / "x"), "nothing"),
    ]:
        run = poseterior("frames", *arguments)
        assert run.code == 2, run
        assert said in run.err
        assert run.err.count("\n") == 1
