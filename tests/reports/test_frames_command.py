"""`poseterior frames`: a folder of detections as one stream; refusals, and that a second call goes
on."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference import draws_of, open_stream
from poseterior.probmodel import Detection, PoseModel, write_detections
from poseterior.probmodel.distance import farthest, nearest
from poseterior.reports import figures
from poseterior.reports.commands import frames
from poseterior.reports.options import Detected
from poseterior.reports.settings import FramesSettings
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
        detection = prior_scene(PoseModel(), index, factor=0.8, missing=(*FEW, *torso)).detection
        write_detections(path / f"frame_{index}.json", [detection])
    return path


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a page nor a figure, for what is said beside them."""
    for module, name in ((frames, "film_page"), (frames, "write_page"), (figures, "film_figure")):
        monkeypatch.setattr(module, name, lambda *_, **__: None)
    monkeypatch.setattr(figures, "save_figure", lambda *_: None)


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
    assert f"50 draws are kept of each person: at most 32.4 kB in {out}" in again.out
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
        scene = prior_scene(PoseModel(), seed, factor=0.8, missing=FEW).detection
        points, score = np.full((15, 2), np.nan), np.zeros(15)
        points[[2, 3]], score[[2, 3]] = [[1.0, 2.0], [3.0, 4.0]], 0.5
        part = Detection(points, score, scene.layout, scene.source, 1)
        both = [scene, part] if index < 2 else [part]
        write_detections(walk / f"frame_{index}.json", both)
    run = poseterior("frames", walk, "--out", tmp_path / "out", *OPTIONS)
    assert run.code == 0, run
    assert run.out.count("2 fragments of people left out: ") == run.out.count("left out") == 1
    assert "3 frames of 1 person: 1 bad input, 2 complete" in run.out
    assert "(the first: frame_0, number 1 there)" in run.out
    frames = open_stream(tmp_path / "out")["summary"].frame.values.tolist()
    assert frames[:2] == ["frame_0/0", "frame_1/0"]
    assert len(frames) == 3, "where nobody else is, the fragment says why there is no pose"


def film(path: Path, names: list[str], *, tracked: bool = True) -> Path:
    """One file, sorted by tracks: somebody in all frames, and a bystander, two metres to the right,
    in all but the last, who comes first in the file."""
    model = PoseModel()
    one, other = (prior_scene(model, seed, factor=0.8, missing=FEW).detection for seed in (0, 2))
    people = []
    for track, person, seen in (("9", other, names[:-1]), ("4", one, names)):
        aside = 1500.0 * (track == "9")
        for at, name in enumerate(seen):
            keypoints = person.keypoints + [aside + 2.0 * at, 0.0]  # noqa: RUF005
            carried = track if tracked else None
            moved = dataclasses.replace(person, keypoints=keypoints, face=None, image_id=name)
            people.append(dataclasses.replace(moved, track=carried))
    write_detections(path, people)
    return path


NAMES = ["walk_08.png", "walk_09.png", "walk_12.png"]


@pytest.mark.usefixtures("without_pictures")
def test_a_film_in_one_file_is_as_long_as_it_is_and_a_bystander_costs_nothing(
    poseterior: Cli, tmp_path: Path
) -> None:
    path, out = film(tmp_path / "film.json", NAMES), tmp_path / "out"
    options = ("--root", "fixed", *OPTIONS)
    run = poseterior("frames", path, "--out", out, "--person", 1, *options)
    assert (run.code, run.err) == (0, ""), run
    assert "3 frames of 1 person: 3 complete" in run.out
    assert open_stream(out)["summary"].frame.values.tolist() == [f"{name}/1" for name in NAMES]
    assert "people" not in run.out.replace("People", "")
    exported = poseterior("export", out, "--to", "npz", "--rate", 10, "--out", tmp_path / "x.npz")
    assert "3 of 5 frames, 3 with a pose" in exported.out
    with np.load(tmp_path / "x.npz") as found:
        assert found["times"] == pytest.approx([0, 0.1, 0.4])


@pytest.mark.parametrize("tracked", [True, False])
def test_everyone_is_described_and_who_is_not_there_named(
    poseterior: Cli, tmp_path: Path, tracked: bool, request: pytest.FixtureRequest
) -> None:
    if not tracked:
        request.getfixturevalue("without_pictures")
    path = film(tmp_path / "film.json", NAMES, tracked=tracked)
    run = poseterior("frames", path, "--person", 2, "--out", tmp_path / "no", *OPTIONS)
    assert run.code == 2
    ways = ("track 9, ", "track 4, ") if tracked else ("", "")
    described = f"2 people: 0 ({ways[0]}2 frames), 1 ({ways[1]}3 frames)"
    assert f"there is no person 2 in these frames, but {described}; choose one of them" in run.err
    run = poseterior("frames", path, "--out", tmp_path / "out", "--root", "fixed", *OPTIONS)
    assert f"{described}; --person draws one of them alone" in run.out
    assert "3 frames of 2 people, 5 times somebody: 5 complete" in run.out
    assert ("who is who is told by where people are" in run.err) != tracked


@pytest.mark.usefixtures("without_pictures")
def test_records_without_frames_and_names_without_numbers_are_said(
    poseterior: Cli, tmp_path: Path
) -> None:
    path = film(tmp_path / "film.json", ["left", "right"])
    few = ("--root", "fixed", "--person", 1, *OPTIONS)
    run = poseterior("frames", path, "--out", tmp_path / "out", *few)
    assert "the names of the frames (left, right, …) do not count them" in run.err
    document = json.loads(film(tmp_path / "film.json", NAMES).read_text())
    document["people"] = document["people"][2:]
    for person in document["people"]:
        del person["image_id"], person["track"]
    path.write_text(json.dumps(document))
    run = poseterior("frames", path, "--out", tmp_path / "2", "--root", "fixed", *OPTIONS)
    assert "3 frames of 1 person: 3 complete" in run.out
    assert "name no frames; each lies where the one before does, and they are read as 3" in run.err


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
    assert "its root is 'uncertain', not 'candidates'" in other.err


@pytest.mark.usefixtures("without_pictures")
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


def test_all_frames_say_how_near_the_camera_was(tmp_path: Path) -> None:
    """Who comes near in the last of twelve frames counts."""
    far = prior_scene(PoseModel(), 0, factor=0.8).detection
    near = dataclasses.replace(far, keypoints=3 * far.keypoints)
    for index, detection in enumerate([far] * 11 + [near]):
        write_detections(tmp_path / f"frame_{index}.json", [detection])
    settings = FramesSettings(path=tmp_path, detected=Detected(image_size="640x480"))
    lengths = settings.prior.anatomy().lengths
    metres = nearest(frames._everyone(settings), settings.size, lengths)
    assert metres == pytest.approx(farthest(near, (640, 480), lengths), rel=1e-6)
    assert metres < farthest(far, (640, 480), lengths) / 2
