"""Results of calibrated cameras in level axes: measured and exported as what they are."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from poseterior.inference import Result, measures
from poseterior.inference.results import NAMES, save_tree
from poseterior.probmodel import BadInput
from poseterior.probmodel.level import doubtful, level_axes, up_of
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.reports.exports.results import Wanted, read_clip
from tests.filmed import cameras

WORLDS = {
    "x": ([0, 1, 0], [0, 0, 1], [1, 0, 0]),
    "y": ([0, 0, 1], [1, 0, 0], [0, 1, 0]),
    "z": ([1, 0, 0], [0, 1, 0], [0, 0, 1]),
    "-y": ([1, 0, 0], [0, 0, 1], [0, -1, 0]),
}
"""By what is up: two axes on the level and the one upwards, right-handed, in the world's."""
SIZE, PLACE = 340.0, np.array([1200.0, -700.0, 300.0])
"""Millimetres."""


def in_world(joints: np.ndarray, up: str, turn: float) -> np.ndarray:
    """Poses in camera axes, whose y is down, put into a world: turned about the vertical by an
    angle, mm."""
    east, north, above = (np.array(axis, float) for axis in WORLDS[up])
    ahead = np.cos(turn) * east + np.sin(turn) * north
    aside = np.cross(ahead, above)
    x, y, z = np.moveaxis(joints, -1, 0)[..., None]
    return SIZE * (x * aside - y * above + z * ahead) + PLACE


def tree_of(joints: np.ndarray, up: str) -> xr.DataTree:
    dims = ("chain", "draw", "joint", "axis")
    coords = {"joint": NAMES["joint"], "axis": NAMES["axis"]}
    posterior = xr.Dataset({"joints": (dims, joints[None], {"units": "mm"})}, coords)
    tree = xr.DataTree.from_dict({"posterior": posterior})
    tree.attrs.update(root="world", up=up, source="s", sampler="s", seed="0", limits="wide")
    tree.attrs.update(measures="m", status="complete", num_proposals=1, wall_time_s=1.0)
    tree.attrs.update(acceptance_rate=1.0, log_evidence=0.0, log_evidence_se=0.0)
    return tree


@pytest.fixture(scope="module")
def poses(example_result: Result) -> np.ndarray:
    """In camera axes, body units."""
    return example_result.tree["posterior"].joints.values[0, :50].astype(float)


@pytest.mark.parametrize("up", WORLDS)
def test_a_world_is_measured_as_a_camera_that_stands_level(poses: np.ndarray, up: str) -> None:
    """In whatever axes: angles are the same, lengths in millimetres. Taken for upright along
    another axis, what is counted from the vertical is not."""
    joints = in_world(poses, up, 0.7)
    found, plain = measures(tree_of(joints, up)), measures(_alone(poses))
    other = measures(tree_of(joints, next(name for name in WORLDS if name[-1] != up[-1])))
    for name, one in MEASURES.items():
        scale = SIZE if one.kind == "length" else 1.0
        apart = found[name].values[0] - scale * plain[name].values[0]
        if one.circular:
            apart = (apart + 180) % 360 - 180
        np.testing.assert_allclose(apart, 0, atol=1e-6)
        assert found[name].attrs["units"] == ("mm" if one.kind == "length" else "degrees")
    lean = "trunk_inclination"
    assert np.abs(other[lean].values - found[lean].values).max() > 10
    assert f"axis {up}," in found[lean].attrs["source"]


def _alone(poses: np.ndarray) -> xr.Dataset:
    return xr.Dataset({"joints": (("chain", "draw", "joint", "axis"), poses[None])})


def test_a_file_is_measured_and_exported_as_its_result(poses: np.ndarray, tmp_path: Path) -> None:
    """Metres, y up, where the person stands; also hypotheses, in the file of their own."""
    joints = in_world(poses, "z", 0.7)
    tree = tree_of(joints, "z")
    save_tree(tree, tmp_path / "posterior.nc")
    xr.testing.assert_allclose(measures(tmp_path), measures(tree))
    wanted = joints[..., [0, 2, 1]] * [1, 1, -1] / 1000
    clip = read_clip(tmp_path, Wanted(draws=50))
    np.testing.assert_allclose(clip.joints, wanted, atol=1e-9)
    assert clip.origin == "origin of the calibration"
    named = [dict(zip(JOINT_INDEX, one.tolist(), strict=True)) for one in joints[:2]]
    chosen = {"hypotheses": [{"joints": one, "weight": 0.5} for one in named], "up": "z"}
    (tmp_path / "hypotheses.json").write_text(json.dumps(chosen))
    for path in (tmp_path, tmp_path / "hypotheses.json"):
        np.testing.assert_allclose(read_clip(path, Wanted()).joints, wanted[:2], atol=1e-9)


def test_what_cameras_know_or_cannot_is_not_asked_of_them(
    poses: np.ndarray, tmp_path: Path
) -> None:
    tree = tree_of(in_world(poses, "z", 0.0), "z")
    save_tree(tree, tmp_path / "posterior.nc")
    with pytest.raises(BadInput, match="leave the height out"):
        measures(tree, height=1.8)
    with pytest.raises(BadInput, match="leave the height out"):
        read_clip(tmp_path, Wanted(height=1.8))
    with pytest.raises(BadInput, match=r"ask for level\(head,pelvis\)"):
        measures(tree, "depth(head, pelvis)")
    with pytest.raises(BadInput, match="which way is up"):
        measures(tree["posterior"].to_dataset())
    tree.attrs["up"] = "w"
    with pytest.raises(BadInput, match="no axis that points up"):
        measures(tree)


def test_cameras_say_which_way_is_up() -> None:
    """Those around a person, in every world; also where all look down a little."""
    rotation = np.stack([camera.rotation for camera in cameras()])
    for up, axes in WORLDS.items():
        found, tilt = up_of(rotation @ np.array(axes, float))
        assert found == up
        assert tilt == pytest.approx(0, abs=1e-5)
        np.testing.assert_allclose(level_axes(up) @ np.array(axes[2]), [0, -1, 0])
        assert np.linalg.det(level_axes(up)) == pytest.approx(1)
    for degrees, sentences in ((20, 0), (40, 1)):
        down = Rotation.from_euler("x", -degrees, degrees=True).as_matrix()
        found = up_of((down @ level_axes("z"))[None])
        assert found == ("z", pytest.approx(degrees))
        assert len(doubtful(*found)) == sentences
