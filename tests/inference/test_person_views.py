"""Views of people whose truth is known in part: read, refused, and judged by the command line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from poseterior.inference.results import save_tree
from poseterior.inference.studies.judging.files import read_judged
from poseterior.inference.studies.person_views import JUDGED, ViewLevels, even, honesty, levels_tree
from poseterior.probmodel import BadInput
from poseterior.probmodel.datasets.person_views import is_person_views, read_person_views
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from tests.conftest import Cli

FOCAL, PRINCIPAL = 600.0, np.array([320.0, 240.0])


def arrays(**changed: Any) -> dict[str, np.ndarray]:
    """Two views of one standing person, 3 m away, seen as they are in COCO's order, of which the
    first five points are a face's; nobody knows where the left wrist is."""
    place = {
        "left_shoulder": (170, -450, 0),
        "right_shoulder": (-170, -450, 0),
        "left_elbow": (230, -170, 30),
        "right_elbow": (-230, -170, 30),
        "left_wrist": (240, 60, -60),
        "right_wrist": (-240, 60, -60),
        "left_hip": (90, 0, 0),
        "right_hip": (-90, 0, 0),
        "left_knee": (95, 420, -20),
        "right_knee": (-95, 420, -20),
        "left_ankle": (95, 830, 20),
        "right_ankle": (-95, 830, 20),
    }
    truth = np.array(list(place.values()), float)
    truth[:, 2] += 3000
    detection = np.zeros((2, 17, 3))
    detection[:, 5:, :2] = FOCAL * truth[:, :2] / truth[:, 2:] + PRINCIPAL
    detection[:, 5:, 2] = 0.9
    names = list(place)
    truth[names.index("left_wrist")] = np.nan
    return {
        "detection": detection,
        "truth": np.stack([truth, truth]),
        "joints": np.array(names),
        "focal": np.full((2, 2), FOCAL),
        "principal": np.tile(PRINCIPAL, (2, 1)),
        "person": np.array([0, 1]),
    } | changed


def written(folder: Path, **changed: Any) -> Path:
    path = folder / "views.npz"
    np.savez(path, **arrays(**changed))
    return path


def test_views_are_read_as_they_are(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert is_person_views(path)
    first, second = read_person_views(path)
    assert (first.person, second.person) == ("0 0", "0 1")
    np.testing.assert_allclose(first.truth[JOINT_INDEX["right_wrist"]], [-240, 60, 2940])
    assert np.isnan(first.truth[JOINT_INDEX["left_wrist"]]).all()
    seen = first.detection.keypoints[JOINT_INDEX["right_wrist"]]
    np.testing.assert_allclose(seen, FOCAL * np.array([-240, 60]) / 2940 + PRINCIPAL)
    assert first.believed("weak") is None
    assert float(first.believed("known").focal) == FOCAL


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"layout": np.array("coco_0")}, "no layout"),
        ({"truth": np.zeros((2, 5, 3))}, "truth"),
        ({"focal": np.zeros(2)}, "focal"),
    ],
)
def test_what_is_no_set_of_views_is_refused(
    changed: dict[str, np.ndarray], match: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match=match):
        read_person_views(written(tmp_path, **changed))


def test_intervals_are_counted_by_hand(tmp_path: Path) -> None:
    """Of two people, one wrist each: levels of 0.5 and 0.99 are in one interval of 95 % and in one
    of 50 %; what nobody knows does not count."""
    views = read_person_views(written(tmp_path))
    judged = []
    for at in (0.5, 0.99):
        level, width = np.full((len(JOINTS), 3), np.nan), np.full((2, len(JOINTS), 3), np.nan)
        level[JOINT_INDEX["right_wrist"]], width[:, JOINT_INDEX["right_wrist"]] = at, 100.0
        judged.append(ViewLevels(level, width, np.where(np.isfinite(level), 30.0, np.nan)))
    found = honesty(views, judged)
    np.testing.assert_allclose(found.covered, 0.5)
    np.testing.assert_allclose(found.width, 100.0)
    np.testing.assert_allclose(found.error, 30.0)
    assert (found.views, found.people, found.silent) == (2, 2, 0)
    np.testing.assert_allclose([found.low, found.high], [np.zeros((2, 3)), np.ones((2, 3))])


def test_views_are_as_many_of_each_person(tmp_path: Path) -> None:
    """Of two people, of whom two views are one each; one view is fewer."""
    views = read_person_views(written(tmp_path))
    assert [view.person for view in even([*views, *views], 3)] == ["0 0", "0 1"]
    assert len(even([*views, *views], 4)) == 4
    for number in (1, 0, -3):
        with pytest.raises(BadInput, match=f"{number} views are fewer than one of each of 2"):
            even(views, number)


def test_levels_of_views_are_named_by_joint_axis_and_middle(tmp_path: Path) -> None:
    """A view's row has its levels by joint and axis about each middle, and what was seen."""
    views = read_person_views(written(tmp_path))
    level = np.arange(len(JOINTS) * 3).reshape(-1, 3) / 100.0
    width = np.zeros((2, len(JOINTS), 3))
    one = ViewLevels(level, width, level)
    nothing = ViewLevels(np.full_like(level, np.nan), width, level)
    tree = levels_tree(views, {"hips": [one, nothing], "shoulders": [nothing, nothing]})
    save_tree(tree, tmp_path / "coverage.nc")
    found = read_judged(tmp_path / "coverage.nc")
    assert isinstance(found, tuple)
    table, columns = found
    knee = JOINT_INDEX["left_knee"]
    assert table.sel(quantity="left_knee z about the hips").values[0] == level[knee, 2]
    assert np.isfinite(table.values).sum() == 3 * len(JUDGED)
    assert columns["detector"].tolist() == [view.detection.layout for view in views]
    assert tree["simulation"].person.values.tolist() == ["0 0", "0 1"]


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["weak", "known", "unknown"])
def test_the_command_judges_them(camera: str, tmp_path: Path, poseterior: Cli) -> None:
    """What was seen as it is lies within what is believed: intervals of 95 % hold it."""
    path = written(tmp_path)
    words = ("--dataset", path, "--camera", camera, "--errors", "learned", "--roots", 200)
    run = poseterior("coverage", *words, "--out", tmp_path / "seen", "--json")
    assert run.code == 0, run.err
    found = json.loads(run.out)["shoulders"]
    np.testing.assert_allclose(found["beside_truth"], 0.0, atol=1e-9)
    assert (found["people"], found["silent"]) == (2, 0)
    assert np.min(found["covered"][1]) > 0.8
    assert {*found["by_person"]} == {"0 0", "0 1"}
    assert (tmp_path / "seen").is_dir()
