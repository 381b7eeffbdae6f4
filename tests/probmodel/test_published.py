"""The importer of the published tables, against the shares of valid frames that came with the data,
against poses that were published with it, and against a second checker that shares no code with the
package."""

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion import FROM_SEVENTEEN, read_motion
from poseterior.probmodel.skeleton import BONE_NAMES
from tests.independent_check import valid_bones

COLUMNS = ("head", "R-Uarm", "L-Uarm", "R-Uleg", "L-Uleg", "R-Larm", "L-Larm", "R-Lleg", "L-Lleg")
NEEDED = ("jmp", "chlds", "prnts", "angleSprd", "sepPlane", "E2", "bounds", "a", "di")


@pytest.fixture(scope="module")
def mat_path(shared_data: Path) -> Path:
    return shared_data / "akhter_black" / "jointAngleModel_v2.mat"


@pytest.fixture(scope="module")
def published(mat_path: Path) -> AnatomicalLimits:
    return read_published(mat_path)


@pytest.fixture(scope="module")
def actions(shared_data: Path) -> dict[str, np.ndarray]:
    """Frames `(N, 15, 3)` by class of action."""
    classes = defaultdict(list)
    for motion in read_motion(shared_data / "cmu" / "actions_train.npz"):
        classes[motion.name.split("/")[0]].append(motion.joints)
    return {name: np.concatenate(frames) for name, frames in classes.items()}


def expected_shares(shared_data: Path) -> dict[str, dict[str, str]]:
    with open(shared_data / "cmu" / "validity.csv", newline="") as file:
        return {
            row["set"]: row
            for row in csv.DictReader(line for line in file if not line.startswith("#"))
        }


def assert_shares(shares: np.ndarray, all_nine: float, row: dict[str, str]) -> None:
    expected = [float(row[column]) for column in COLUMNS]
    np.testing.assert_allclose(shares, expected, atol=1e-3, err_msg=str(row))
    assert all_nine == pytest.approx(float(row["all9"]), abs=1e-3), row


def test_cells_and_name(published: AnatomicalLimits) -> None:
    assert published.name == "akhter-black"
    assert np.asarray(published.occupied).sum(axis=(1, 2)).tolist() == [870, 4477, 4473, 3321, 3290]
    assert np.array_equal(np.asarray(published.occupied)[1:], published.has_plane)


def test_valid_shares_of_the_action_set(
    published: AnatomicalLimits, actions: dict[str, np.ndarray], shared_data: Path
) -> None:
    rows = expected_shares(shared_data)
    check = published.check(np.concatenate(list(actions.values())))
    ends = np.cumsum([len(frames) for frames in actions.values()])[:-1]
    parts = zip(actions, np.split(check.valid, ends), strict=True)
    for name, valid in [*parts, ("ALL", check.valid)]:
        assert_shares(valid.mean(axis=0), valid.all(axis=-1).mean(), rows[f"train {name}"])


@pytest.mark.slow
def test_valid_shares_of_every_recording(published: AnatomicalLimits, shared_data: Path) -> None:
    rows = expected_shares(shared_data)
    motions = [motion.at_rate(30) for motion in read_motion(shared_data / "cmu" / "asfamc")]
    check = published.check(np.concatenate([motion.joints for motion in motions]))
    ends = np.cumsum([len(motion.joints) for motion in motions])[:-1]
    assert len(motions) == 21
    for motion, valid in zip(motions, np.split(check.valid, ends), strict=True):
        assert len(valid) == int(rows[motion.name]["frames_30fps"])
        assert_shares(valid.mean(axis=0), valid.all(axis=-1).mean(), rows[motion.name])


@pytest.mark.parametrize(("file", "variable"), [("staticPose.mat", "Si"), ("testPose.mat", "S1")])
def test_published_poses_are_valid_and_their_mirror_system_is_not(
    published: AnatomicalLimits, shared_data: Path, file: str, variable: str
) -> None:
    left_handed = scipy.io.loadmat(shared_data / "akhter_black" / file)[variable][
        :, list(FROM_SEVENTEEN)
    ].T
    assert published.check(left_handed[:, [0, 2, 1]]).pose_valid
    assert not published.check(left_handed).pose_valid


@pytest.mark.slow
def test_agrees_with_an_independent_checker(
    published: AnatomicalLimits, mat_path: Path, actions: dict[str, np.ndarray]
) -> None:
    frames = np.concatenate(list(actions.values()))[::9]
    ours, theirs = published.check(frames).valid, valid_bones(frames, mat_path)
    different = ours != theirs
    assert not different.any(), dict(zip(BONE_NAMES, different.sum(axis=0), strict=True))
    assert 0.5 < theirs.all(axis=-1).mean() < 0.95


@pytest.mark.slow
def test_agrees_with_an_independent_checker_on_random_poses(
    published: AnatomicalLimits, mat_path: Path
) -> None:
    """Real poses are nearly all valid; these break every limit."""
    rng = np.random.default_rng(0)
    frames = rng.normal(size=(1500, 15, 3))
    ours, theirs = published.check(frames).valid, valid_bones(frames, mat_path)
    assert np.array_equal(ours, theirs)
    assert (theirs.mean(axis=0) > 0.01).all()
    assert (theirs.mean(axis=0) < 0.9).all()


def test_static_pose_file_gives_the_same_frames(
    published: AnatomicalLimits, mat_path: Path
) -> None:
    other = read_published(mat_path, mat_path.with_name("staticPose.mat"))
    assert other.sha256 == published.sha256


def test_saved_and_loaded_without_loss(published: AnatomicalLimits, tmp_path: Path) -> None:
    published.save(tmp_path / "limits.npz")
    loaded = AnatomicalLimits.load(tmp_path / "limits.npz")
    assert loaded.sha256 == published.sha256
    assert loaded.name == "akhter-black"


def write_model(path: Path, **changes: object) -> Path:
    """A small file of the right structure, all numbers made up."""
    children = np.array([[3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 16]], np.uint8)
    spread, planes, tangents, bounds = (np.empty((1, 11), object) for _ in range(4))
    for entry in range(11):
        occupied = np.zeros((121, 61), np.uint8)
        occupied[:120, :60] = 1
        plane = np.full((121, 61, 4), np.nan)
        plane[:120, :60] = [1.0, 0.0, 0.0, -0.5]
        spread[0, entry], planes[0, entry] = occupied, plane
        tangents[0, entry] = np.broadcast_to([0.1, 1.0, 0.0], (121, 61, 3))
        bounds[0, entry] = np.broadcast_to([-1.0, 1.0, -1.0, 1.0], (121, 61, 4))
    model: dict[str, object] = {
        "jmp": np.array([[3]], np.uint8),
        "chlds": children,
        "prnts": np.array([[2, 3, 5, 6, 2, 9, 10, 11, 13, 14, 15]], np.uint8),
        "angleSprd": spread,
        "sepPlane": planes,
        "E2": tangents,
        "bounds": bounds,
        "a": np.array([[1.0], [0.0], [0.0]]),
        "di": np.tile([[0.0], [2.0], [0.0]], 16),
    }
    model |= changes
    scipy.io.savemat(path, {key: value for key, value in model.items() if value is not None})
    return path


def with_entry(value: np.ndarray) -> np.ndarray:
    """Cells of which every entry is `value`."""
    cells = np.empty((1, 11), object)
    for entry in range(11):
        cells[0, entry] = value
    return cells


def test_a_file_of_the_right_structure_is_read(tmp_path: Path) -> None:
    limits = read_published(write_model(tmp_path / "model.mat"))
    assert np.asarray(limits.occupied).all()
    np.testing.assert_array_equal(np.asarray(limits.fallback), np.tile([0.0, 1.0, 0.0], (4, 1)))


@pytest.mark.parametrize("missing", NEEDED)
def test_a_missing_variable_is_named(tmp_path: Path, missing: str) -> None:
    with pytest.raises(BadInput, match=rf"lacks {missing}\b"):
        read_published(write_model(tmp_path / "model.mat", **{missing: None}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"jmp": np.array([[5]], np.uint8)}, "cells of 3 degrees"),
        ({"chlds": np.arange(1, 11)[None]}, "11 bone numbers"),
        ({"chlds": np.full((1, 11), 3)}, "head 0 times"),
        ({"prnts": np.full((1, 11), 17)}, "from 1 to 16"),
        ({"angleSprd": with_entry(np.zeros((120, 60)))}, r"shape \(120, 60\)"),
        ({"angleSprd": with_entry(np.ones((121, 61)))}, "last row or column"),
        ({"sepPlane": np.zeros((121, 61, 4))}, "cell array of 11"),
        ({"sepPlane": with_entry(np.zeros((121, 61, 4)))}, "last row or column"),
        ({"bounds": with_entry(np.zeros((121, 61, 3)))}, "entry 2 of bounds has shape"),
        ({"angleSprd": with_entry(np.array(["text"]))}, "no real numbers"),
        ({"di": np.zeros((3, 4))}, "di has shape"),
        ({"a": np.zeros((2, 1))}, "reference has shape"),
        ({"bounds": with_entry(np.full((121, 61, 4), np.nan))}, "not finite"),
    ],
)
def test_other_models_are_refused(
    tmp_path: Path, changes: dict[str, np.ndarray], message: str
) -> None:
    with pytest.raises(BadInput, match=message):
        read_published(write_model(tmp_path / "model.mat", **changes))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"there is no MATLAB file at .*model\.mat"):
        read_published(tmp_path / "model.mat")
    with pytest.raises(BadInput, match="is a folder"):
        read_published(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a matlab file", b"PK\x03\x04", bytes(300)])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.mat"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"not a MATLAB file|lacks"):
        read_published(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path: Path, share: float) -> None:
    whole = write_model(tmp_path / "model.mat").read_bytes()
    path = tmp_path / "cut.mat"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(BadInput, match=r"cut\.mat"):
        read_published(path)
