"""`poseterior calibrate`: what it writes, says and refuses; sessions in the other studies."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference.studies.errorlaws import learn, pairs_of_session
from poseterior.inference.studies.evaluation.run import open_evaluation
from poseterior.probmodel import DetectorErrors
from poseterior.probmodel.errors.detector import FORMAT
from poseterior.probmodel.sessions import read_session
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from poseterior.reports.tables.errorlaws import summary_lines
from tests.conftest import Cli
from tests.filmed import filmed, moving, write_session


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of 24 frames with errors of 10 mm."""
    place = tmp_path_factory.mktemp("session")
    rng = np.random.default_rng(3)
    write_session(filmed(moving(24), 10 * rng.normal(size=(4, 24, NUM_JOINTS, 2))), place)
    return place


def test_it_writes_a_law_and_a_picture_and_says_what_it_found(
    film: Path, poseterior: Cli, tmp_path: Path
) -> None:
    out = tmp_path / "errors.json"
    run = poseterior("calibrate", film, "--perspective", "--fps", "60", "--out", out, "--quiet")
    assert (run.code, run.err) == (0, "")
    lasting = "Of the errors' variance: constant"
    for words in ("The error law", "left_wrist", "Exchanged sides: legs 0.0", lasting, f"{out}"):
        assert words in run.out.replace("\n", "")
    errors = DetectorErrors.read(out)
    assert errors.learned["detector"] == "body_25b"
    assert errors.learned["people"] == 96
    wrist = JOINT_INDEX["left_wrist"]
    assert errors.sigma[wrist] * 305 == pytest.approx(10, rel=0.3)
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")


def test_it_says_what_hips_have_in_common(film: Path) -> None:
    """The film's errors know nothing of each other, so that by chance little is in common; where
    one hip's are the other's too, all is."""
    found = learn(pairs_of_session(read_session(film), perspective=True))
    hips = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
    assert found.common[hips[0]] < 0.3
    left = found.fit.expected.left.copy()
    left[..., hips[1], :] = left[..., hips[0], :]
    expected = dataclasses.replace(found.fit.expected, left=left)
    same = dataclasses.replace(found, fit=dataclasses.replace(found.fit, expected=expected))
    (line,) = (line for line in summary_lines(same) if "hips" in line)
    assert "(correlation 1.00): their sigma is 1.41 times" in line


@pytest.mark.slow
def test_json_is_the_file(film: Path, poseterior: Cli, tmp_path: Path) -> None:
    out = tmp_path / "errors.json"
    run = poseterior("calibrate", film, "--frames", "40", "--out", out, "--json", "--quiet")
    assert run.code == 0
    assert json.loads(run.out) == json.loads(out.read_text())
    assert json.loads(run.out)["format"] == FORMAT


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "no/folder.json"), "the folder no does not exist"),
        (("--out", "law.png"), "would be overwritten by its own picture"),
        (("--frames", "12"), "has 12 detections of a joint at most; a law needs 20"),
        (("--law", "disc"), "'disc' is not one of"),
        (("--fps", "0"), "from 1 to 1000 frames a second, not 0"),
    ],
)
def test_what_cannot_be_done_is_refused(
    options: tuple[str, str], words: str, film: Path, poseterior: Cli, monkeypatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    run = poseterior("calibrate", film, *options, "--quiet")
    assert run.code == 2
    assert words in run.err
    assert list(tmp_path.iterdir()) == []


def test_perspective_needs_cameras(poseterior: Cli, tmp_path: Path) -> None:
    from poseterior.probmodel.datasets import from_motions, write_plain
    from poseterior.probmodel.motion import Motion

    motion = Motion(moving(30)[..., [0, 2, 1]] * [1, 1, -1], 30.0, "walking/one", "a")
    write_plain(from_motions([motion], "x", frames=20), tmp_path / "x.npz")
    run = poseterior("calibrate", tmp_path / "x.npz", "--perspective", "--quiet")
    assert run.code == 2
    assert "--perspective needs calibrated cameras" in run.err
    run = poseterior("calibrate", tmp_path / "x.npz", "--fps", "30", "--quiet")
    assert run.code == 2
    assert "--fps is of a session of calibrated cameras" in run.err


def test_the_embedded_law_knows_every_joint() -> None:
    errors = DetectorErrors.default()
    assert errors.known.all()
    assert 0.03 < errors.sigma.min() < errors.sigma.max() < 0.15
    assert errors.learned["inlier"].startswith("Chang")


@pytest.mark.slow
def test_the_embedded_law_is_rebuilt(shared_data: Path) -> None:
    from poseterior.inference.studies.errorlaws.embedded import embedded
    from poseterior.probmodel.sessions import read_session

    found = embedded(read_session(shared_data / "multicamera"))
    assert found.sigma == pytest.approx(DetectorErrors.default().sigma, abs=0.0011)
    assert found.exchange == DetectorErrors.default().exchange


# --- sessions in the other studies


@pytest.mark.parametrize(
    "words",
    [
        "evaluate FILM --perspective --root fixed --estimator akhter-black",
        "evaluate FILM --perspective --root fixed,uncertain --estimator akhter-black",
        "coverage --dataset FILM --perspective --root fixed --noise none",
    ],
)
def test_known_lenses_need_an_uncertain_root(
    words: str, film: Path, poseterior: Cli, tmp_path: Path
) -> None:
    run = poseterior(
        *words.replace("FILM", str(film)).split(), "--frames", 4, "--out", tmp_path / "x", "--quiet"
    )
    assert run.code == 2
    assert re.search("needs torso and camera to be uncertain; choose .*uncertain", run.err)
    assert run.err.count("\n") == 1


def test_known_lenses_without_calibrated_cameras(poseterior: Cli, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", poses=np.zeros((1, 15, 3)), keypoints=np.zeros((1, 15, 2)))
    run = poseterior("evaluate", tmp_path / "a.npz", "--root", "uncertain", "--perspective")
    assert (run.code, run.out) == (2, "")
    assert "perspective needs calibrated cameras, which" in run.err


@pytest.mark.sweep
def test_known_lenses_bring_the_truth_nearer(film: Path, poseterior: Cli, tmp_path: Path) -> None:
    """Samples lie nearer to the truth in the image: what weak perspective leaves is no error."""
    few = ("--frames", 12, "--roots", 300, "--num-samples", 400)
    by = ("--root", "uncertain", "--estimator", "akhter-black", "--no-bias")
    found = {}
    for name in ("known", "unknown"):
        out, lens = tmp_path / name, ("--perspective",) * (name == "known")
        run = poseterior("evaluate", film, "--out", out, *by, *few, *lens, "--quiet")
        assert run.code == 0, run
        found[name] = open_evaluation(out)
    known, unknown = (
        found[name][next(iter(found[name].children))].to_dataset() for name in ("known", "unknown")
    )
    assert np.isfinite([known.across, unknown.across]).all()
    assert known.across.mean() < unknown.across.mean()
    assert "focal lengths known" in (tmp_path / "known" / "evaluation.md").read_text()
    assert "focal lengths known" not in (tmp_path / "unknown" / "evaluation.md").read_text()
    study = ("--root", "uncertain", "--noise", "none", "--frames", 4, "--roots", 100)
    run = poseterior(
        *("coverage", "--dataset", film, "--perspective", *study),
        *("--num-samples", 100, "--out", tmp_path / "cover", "--quiet", "--json"),
    )
    assert run.code == 0, run
    assert json.loads(run.out)["poses"] == 4
