"""The main job on real input: detectors' files, motion capture, the published limits. Needs the
shared data pack."""

from pathlib import Path

import arviz_stats
import jax
import numpy as np
import pytest
import xarray as xr

from poseterior import inference
from poseterior.inference.draws import COMPLETE
from poseterior.probmodel import Anatomy, PoseModel, read_detections
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.skeleton import LENGTH_GROUPS
from poseterior.reports.pages import skier
from tests.conftest import Cli
from tests.independent_check import valid_bones
from tests.scenes import motion_scene

FILES = [
    ("openpose/body25_spin_im1010_keypoints.json", 0),
    ("openpose/coco18_hmr_random_keypoints.json", 0),
    ("openpose/coco18_hmr_random_keypoints.json", 1),
    ("openpose/body25_openposer_du_wohn_wo_000000000030_keypoints.json", 0),
    ("coco/test_coco.json", 0),
]


@pytest.fixture(scope="module", params=["published", "default"])
def model(request, shared_data) -> PoseModel:
    published = shared_data / "akhter_black" / "jointAngleModel_v2.mat"
    return PoseModel.from_anatomy(
        Anatomy.load(published) if request.param == "published" else Anatomy.default()
    )


@pytest.mark.parametrize(("name", "person"), FILES)
def test_real_files_give_exact_draws(model, shared_data, name, person):
    """Every draw possible, every seen joint inside its disc, left and right equally long."""
    frame = inference.estimate_torso(read_detections(shared_data / "detections" / name)[person])
    result = inference.sample(
        model, frame, key=jax.random.key(0), num_samples=1000, root="candidates"
    )
    assert result.status == COMPLETE
    check_draws(model, result)


def check_draws(model: PoseModel, result: inference.Result) -> None:
    posterior, constant = result.tree["posterior"], result.tree["constant_data"]
    assert model.limits.check(posterior.joints.values).valid.all()
    offset = np.linalg.norm(
        posterior.keypoints.values - result.tree["observed_data"].keypoints.values, axis=-1
    )
    radius = constant.radius.values[posterior.candidate.values]
    assert np.all(np.isnan(radius) | (offset <= radius * (1 + 1e-12)))
    joints = posterior.joints
    for right, left, group in [
        (("right_shoulder", "right_elbow"), ("left_shoulder", "left_elbow"), "upper_arm"),
        (("right_knee", "right_ankle"), ("left_knee", "left_ankle"), "lower_leg"),
    ]:
        lengths = [
            np.linalg.norm(joints.sel(joint=a).values - joints.sel(joint=b).values, axis=-1)
            for a, b in (right, left)
        ]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-9)
        assert lengths[0] == pytest.approx(
            posterior.bone_length.values[..., LENGTH_GROUPS.index(group)], abs=1e-9
        )


def test_the_walker_faces_left(shared_data):
    """SPIN's person, without any face joint, under the published limits: some 15 to 1 by the limbs'
    evidence."""
    anatomy = Anatomy.load(shared_data / "akhter_black" / "jointAngleModel_v2.mat")
    frame = inference.estimate_torso(read_detections(shared_data / "detections" / FILES[0][0])[0])
    result = inference.sample(
        PoseModel.from_anatomy(anatomy),
        frame,
        key=jax.random.key(0),
        num_samples=4000,
        root="candidates",
    )
    constant = result.tree["constant_data"]
    left = int(np.argmin([candidate.facing[0] for candidate in frame.candidates]))
    odds = constant.log_evidence.values[left] - constant.log_evidence.values[1 - left]
    assert frame.candidates[left].facing[0] < -0.8
    assert 2.2 < odds < 4.0
    assert constant.weight.values[left] > 0.9


def test_results_open_in_xarray_and_arviz(model, shared_data, tmp_path):
    frame = inference.estimate_torso(read_detections(shared_data / "detections" / FILES[0][0])[0])
    result = inference.sample(
        model, frame, key=jax.random.key(0), num_samples=400, root="candidates"
    )
    result.save(tmp_path / "posterior.nc", double=True)
    with xr.open_datatree(tmp_path / "posterior.nc", engine="netcdf4") as tree:
        assert set(tree.children) == {
            *("posterior", "sample_stats", "posterior_predictive"),
            *("observed_data", "constant_data"),
        }
        assert np.array_equal(tree["posterior"].joints, result.tree["posterior"].joints)
        assert tree.attrs["seed"] == "0 0"
        assert model.limits.sha256 in tree.attrs["limits"]
        summary = arviz_stats.summary(tree, var_names=["bone_length"])
        assert len(summary) == 5


@pytest.mark.slow
def test_fifty_poses_of_motion_capture(model, shared_data):
    """50 poses, cameras all around: every draw explains every seen joint and has equal sides; under
    the published tables every draw is possible by a check that shares no code with the product."""
    published = shared_data / "akhter_black" / "jointAngleModel_v2.mat"
    joints = np.concatenate(
        [motion.joints[::5] for motion in read_motion(shared_data / "cmu" / "actions_train.npz")]
    )
    rng = np.random.default_rng(3)
    poses = joints[rng.choice(len(joints), 50, replace=False)]
    drawn, complete = [], 0
    for number, pose in enumerate(poses):
        missing = [("head",), ("head", "right_wrist"), ("head", "left_knee", "left_ankle")][
            number % 3
        ]
        frame = motion_scene(
            pose, rng.uniform(0, 360), rng.uniform(-20, 20), number, missing=missing
        )
        result = inference.sample(
            model,
            frame,
            key=jax.random.key(number),
            num_samples=150,
            max_proposals=60_000_000,
            root="candidates",
        )
        complete += result.status == COMPLETE
        if result.num_draws:
            check_draws(model, result)
            drawn.append(result.tree["posterior"].joints.values[0])
    assert complete >= 45, f"only {complete} of 50 poses could be explained within the budget"
    if model.limits.name == "akhter-black":
        assert valid_bones(np.concatenate(drawn)[::5], published).all()


@pytest.mark.sweep
def test_the_first_page_shows_what_its_command_draws(tmp_path: Path, poseterior: Cli) -> None:
    folder = skier.PICTURE.parent
    image = ("--image", folder / "skier.jpg")
    run = poseterior("hypotheses", folder / "skier.json", *image, "--out", tmp_path / "result")
    assert run.code == 0, run.err
    assert skier.shares_of(tmp_path / "result") == skier.drawn_shares()
