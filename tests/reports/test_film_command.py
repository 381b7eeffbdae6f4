"""`poseterior film`: paths of one person, gaps, times, refusals before anything is drawn, and that
a second call goes on."""

import json
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference import film_draws
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX
from tests.conftest import Cli
from tests.filmed import filmed, moving, write_session
from tests.reports.test_frames_command import film

OPTIONS = ("--num-samples", 12, "--k", 2, "--root", "fixed", "--errors", "disc", "--quiet")
NAMES = ["walk_08.png", "walk_10.png", "walk_16.png"]


def lengths(joints: np.ndarray) -> np.ndarray:
    """Of all bones of poses `(..., 15, 3)`."""
    ends = np.array([(bone.start, bone.end) for bone in BONES])
    return np.linalg.norm(joints[..., ends[:, 0], :] - joints[..., ends[:, 1], :], axis=-1)


def test_a_film_is_whole_paths_and_a_second_call_goes_on(poseterior: Cli, tmp_path: Path) -> None:
    """Two of five frames are not there, every second one is numbered, and a bystander is seen."""
    path, out = film(tmp_path / "film.json", NAMES), tmp_path / "out"
    run = poseterior("film", path, "--fps", 20, "--out", out, *OPTIONS, "--json")
    assert run.code == 0, run
    assert "2 people in" in run.err
    assert "this film is of person 1, who is seen most: --person chooses another" in run.err
    assert "numbered by 2: at 20 numbers a second they are 10 frames a second" in run.err
    said = json.loads(run.out)
    assert said["status"] == {"complete": 3, "filled": 2}
    assert [frame["frame"] for frame in said["frames"]][2:4] == [
        "walk_12.png/1",
        "walk_14.png/1",
    ]
    assert "nobody was detected there" in said["frames"][2]["sentence"]
    found = film_draws(out)
    assert found.joints.shape == (1, 12, 5, 15, 3)
    assert found.time.values == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    bones = lengths(found.joints.values[0].astype(float))
    assert np.ptp(bones, axis=1).max() < 1e-5, "a path is of one body"
    block, drawn = out / "block-000000.nc", out / "frames" / "block-000000.nc"
    before = drawn.stat().st_mtime_ns
    block.write_bytes(block.read_bytes()[:1000])
    again = poseterior("film", path, "--fps", 20, "--out", out, *OPTIONS)
    assert again.code == 0, again
    assert drawn.stat().st_mtime_ns == before
    np.testing.assert_array_equal(film_draws(out).joints.values, found.joints.values)
    assert "5 frames of 1 person: 3 complete, 2 filled" in again.out
    assert "12 paths" in again.out
    assert "–" not in again.out, "the evidence is that of frames with a pose of their own"

    exported = poseterior("export", out, "--to", "npz", "--out", tmp_path / "x.npz")
    assert "5 with a pose" in exported.out, exported
    with np.load(tmp_path / "x.npz") as arrays:
        assert arrays["times"] == pytest.approx(found.time.values)
    alone = poseterior(
        "export", out, "--to", "npz", "--path-number", 7, "--out", tmp_path / "7.npz"
    )
    assert "path 7" in alone.out, alone
    with np.load(tmp_path / "7.npz") as arrays:
        bones_of_path = lengths(arrays["joints"])
    wanted = bones[7] / bones[7, :, :1]
    np.testing.assert_allclose(bones_of_path / bones_of_path[:, :1], wanted, rtol=1e-5)
    for arguments, words in [
        ((path, "--cutoff", 3, "--out", out, *OPTIONS), "holds another run (its cutoff is 4"),
        ((out, "--out", tmp_path / "y"), "is a film already"),
        ((out / "frames", "--person", 3, "--out", tmp_path / "y"), "no person 3"),
        ((out / "frames", "--out", out / "frames"), "would replace"),
        ((out / "frames", "--out", tmp_path / "y", *OPTIONS), "--errors is of what is drawn, and"),
    ]:
        refused = poseterior("film", *arguments, "--fps", 20, "--quiet")
        assert refused.code == 2, refused
        assert words in refused.err, refused
        assert refused.err.count("\n") == 1
    for arguments, words in [
        ((out, "--path-number", 12), "has no path 12; choose one from 0 to 11"),
        ((out, "--path-number", -1), "has no path -1; choose one from 0 to 11"),
        (
            (out, "--path-number", 1, "--what", "mean"),
            "a path is whole; leave --what or --path-number out",
        ),
        ((out / "frames", "--person", 1, "--path-number", 1), "make a film of it"),
    ]:
        refused = poseterior("export", *arguments, "--to", "npz", "--out", tmp_path / "no.npz")
        assert refused.code == 2, refused
        assert words in refused.err, refused


def test_the_focal_lengths_of_paths_are_said(poseterior: Cli, tmp_path: Path) -> None:
    """With how many of the paths have each; where the focal length is known, nothing is."""
    path = film(tmp_path / "film.json", NAMES[:2])
    for focal, said in (("unknown", True), (900, False)):
        out = tmp_path / str(focal)
        words = ("--focal", focal, "--image-size", "640x480", "--fps", 20, "--out", out)
        run = poseterior("film", path, *words, "--num-samples", 12, "--roots", 60, "--quiet")
        assert run.code == 0, run
        assert ("Each path has one focal length, the film's:" in run.out) is said, run.out
        lengths, counts = np.unique(film_draws(out).focal.values, return_counts=True)
        assert (len(lengths) > 1) is said
        for length, count in zip(lengths, counts, strict=True):
            words_of_it = f"{length:,.0f} pixels {count / counts.sum():.0%}"
            assert (words_of_it in " ".join(run.out.split())) is said
        again = poseterior("film", path, *words, "--num-samples", 12, "--roots", 60, "--json")
        told = json.loads(again.out)["focal"]
        assert told == [
            [one, pytest.approx(part / 12)] for one, part in zip(lengths, counts, strict=True)
        ]


def test_what_can_be_no_film_is_said_before_anything_is_drawn(
    poseterior: Cli, tmp_path: Path
) -> None:
    path, out = film(tmp_path / "film.json", NAMES), tmp_path / "out"
    for arguments, words in [
        (("--fps", 0), "0 frames a second are no film"),
        (("--fps", "nan"), "nan frames a second are no film"),
        (("--fps", 1e9), "at most 10000"),
        (("--fps", 20, "--cutoff", -1), "cannot be cut off at -1 Hz"),
        (("--fps", 20, "--k", 13), "13 hypotheses cannot be chosen among 12 paths"),
    ]:
        run = poseterior("film", path, "--out", out, *OPTIONS, *arguments)
        assert run.code == 2, run
        assert words in run.err, run
        assert run.err.count("\n") == 1
        assert not out.exists()


@pytest.mark.slow
def test_a_stream_is_made_a_film_if_its_draws_were_kept(poseterior: Cli, tmp_path: Path) -> None:
    """One frame is a film of one; without --keep there are no draws to be put in order."""
    path = film(tmp_path / "film.json", NAMES[:1])
    for keep, name in ((12, "kept"), (0, "none")):
        drawn = ("--keep", keep, "--out", tmp_path / name)
        assert poseterior("frames", path, *drawn, *OPTIONS).code == 0
    out = tmp_path / "out"
    kept = ("film", tmp_path / "kept", "--fps", 20, "--quiet", "--out", out)
    run = poseterior(*kept, "--k", 13)
    assert run.code == 2
    assert "13 hypotheses cannot be chosen among 12 paths" in run.err
    run = poseterior(*kept, "--k", 2, "--focal", 1650)
    assert run.code == 2
    assert "--focal is of what is drawn, and" in run.err
    run = poseterior(*kept, "--k", 2)
    assert run.code == 0, run
    assert film_draws(out).joints.shape == (1, 12, 1, 15, 3)
    run = poseterior("film", tmp_path / "none", "--fps", 20, "--out", out / "none", "--quiet")
    assert run.code == 2
    assert "no draws were kept" in run.err
    assert "--keep" in run.err


def test_what_calibrated_cameras_do_not_know_is_refused(poseterior: Cli, tmp_path: Path) -> None:
    """One sentence, before anything is drawn."""
    folder, out = tmp_path / "session", tmp_path / "out"
    write_session(filmed(moving(2), np.zeros((4, 2, 15, 2))), folder)
    plain = film(tmp_path / "film.json", NAMES)
    seen = "is not of calibrated cameras"
    for arguments, words in [
        (("film", folder, "--fps", 30, "--roots", 50), f"--roots {seen}"),
        (("film", folder, "--fps", 30, "--person", 0), f"--person {seen}"),
        (("film", folder, "--fps", 30, "--candidates", 1), f"--candidates {seen}"),
        (("frames", folder, "--focal", 1650), f"--focal {seen}"),
        (("frames", folder, "--composed"), f"--composed {seen}"),
        (("hypotheses", folder, "--upright", 20), f"--upright {seen}"),
        (("frames", folder, "--cameras", "1,9"), "it has those from 1 to 4"),
        (("frames", folder, "--cameras", "1,1"), "each of which counts once"),
        (("frames", folder, "--cameras", "a"), "--cameras a is no list of numbers"),
        (("frames", plain, "--cameras", "1"), "--cameras is of calibrated cameras"),
    ]:
        run = poseterior(*arguments, "--out", out, "--quiet")
        assert run.code == 2, run
        assert words in run.err, run
        assert run.err.count("\n") == 1
        assert not out.exists()


@pytest.mark.slow
def test_a_film_of_calibrated_cameras_stands_in_their_world(
    poseterior: Cli, tmp_path: Path
) -> None:
    """In millimetres, where the person is; measured and exported without a height."""
    joints, out = moving(3), tmp_path / "out"
    errors = np.random.default_rng(3).normal(0, 8, (4, 3, 15, 2))
    write_session(filmed(joints, errors), tmp_path / "session")
    options = ("--cameras", "1,2", "--num-samples", 40, "--k", 2, "--out", out)
    run = poseterior("film", tmp_path / "session", "--fps", 30, *options)
    assert run.code == 0, run
    assert "3 frames of 1 person: 3 complete" in run.out
    assert (
        "40 paths, each of one body; film_draws opens them. A frame says as much as in" in run.out
    )
    assert "1 body unit = " in run.out
    assert (out / "depth.png").stat().st_size > 10_000
    page = (out / "hypotheses.html").read_text()
    assert "standard deviation from the pelvis" in page
    assert '"in_world":true' in page.replace(": ", ":")
    kept = poseterior("export", out, "--to", "npz", "--out", tmp_path / "x.npz")
    assert "the origin of the calibration at the origin" in kept.out, kept
    with np.load(tmp_path / "x.npz") as arrays:
        pelvis = arrays["joints"][:, JOINT_INDEX["pelvis"]]
    hips = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
    middle = joints[:, hips].mean(axis=1)[:, [0, 2, 1]] * [1, 1, -1]
    assert np.abs(pelvis - middle).max() < 200, "where the person stands, y up"
    measured = poseterior(
        "measure", out, "--measure", "right_knee_flexion", "--out", tmp_path / "m.csv"
    )
    assert measured.code == 0, measured
    assert "the calibration's axis z" in " ".join(measured.out.split())
