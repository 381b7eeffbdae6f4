"""Sessions of calibrated cameras: what is known in 3D is found again within its covariance, files
are read as they were written, and calibrations that do not fit are refused."""

import dataclasses
import itertools
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from poseterior.probmodel import BadInput, Detection
from poseterior.probmodel.body import body_unit
from poseterior.probmodel.camera import Perspective, WeakPerspective
from poseterior.probmodel.datasets import (
    brings_detections,
    from_session,
    read_data_set,
    write_plain,
)
from poseterior.probmodel.datasets.sessions import judged_views
from poseterior.probmodel.detections import LIMB_JOINTS
from poseterior.probmodel.layouts import (
    BODY_25,
    COCO_17,
    CROWDPOSE_14,
    HALPE_26,
    Layout,
    corrected,
    without_midpoints,
)
from poseterior.probmodel.sessions import Pinhole, Session, is_session, read_session
from poseterior.probmodel.sessions.calibrations import read_cameras
from poseterior.probmodel.sessions.session import HIPS, MOST_COMBINATIONS, _choices
from poseterior.probmodel.sessions.timing import lags_of
from poseterior.probmodel.sessions.triangulation import triangulate
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from tests.filmed import (
    cameras,
    filmed,
    moving,
    openpose,
    write_easymocap,
    write_qualisys,
    write_session,
    write_toml,
)

HEAD = JOINT_INDEX["head"]
JOINTS_3D = moving(30)
MIDWAY = 1.5
"""Millimetres: readers take midpoints in the distorted image."""
EXACT = np.zeros((4, 30, NUM_JOINTS, 2))


@pytest.fixture(scope="module")
def exact() -> Session:
    return filmed(JOINTS_3D, EXACT)


@pytest.fixture(scope="module")
def folder(exact: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short session in Pose2Sim's layout."""
    place = tmp_path_factory.mktemp("film")
    write_session(exact.take(range(6)), place)
    return place


@pytest.fixture
def copied(folder: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(folder, tmp_path / "film"))


# --- one camera


def test_a_camera_sees_right_below_and_ahead():
    """By hand: from 2 m in front, a point 0.5 m to its right and 0.2 m down."""
    rotation = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    camera = Pinhole(rotation, np.array([2000.0, 0, 1000]), np.full(2, 1000.0), np.full(2, 500.0))
    assert camera.project(np.array([0.0, 500.0, 800.0])) == pytest.approx([750.0, 600.0])


def test_distortion_is_taken_away_again_and_is_opencvs():
    """By hand for one point; back and forth for all of the image."""
    camera = cameras()[0]
    k1, k2, p1, p2, k3 = camera.distortion
    view = np.array([0.2, -0.1, 1.0])
    square = 0.05
    radial = 1 + k1 * square + k2 * square**2 + k3 * square**3
    x = 0.2 * radial + 2 * p1 * 0.2 * -0.1 + p2 * (square + 2 * 0.04)
    y = -0.1 * radial + p1 * (square + 2 * 0.01) + 2 * p2 * 0.2 * -0.1
    seen = camera.project(camera.centre + camera.rotation.T @ view * 2000)
    assert seen == pytest.approx(camera.focal * [x, y] + camera.principal)
    grid = np.stack(np.meshgrid(np.linspace(0, 1080, 9), np.linspace(0, 1920, 9)), axis=-1)
    straight = camera.straighten(grid)
    plane = (straight - camera.principal) / camera.straight.focal
    rays = np.concatenate([plane, np.ones((9, 9, 1))], -1)
    assert camera.project(camera.centre + rays @ camera.rotation) == pytest.approx(grid, abs=1e-6)
    assert np.abs(straight - grid).max() > 5


def test_the_slope_is_the_projections_derivative():
    camera, points = cameras()[1].straight, JOINTS_3D[0]
    step = 0.01
    by_differences = np.stack(
        [
            (camera.project(points + step * axis) - camera.project(points - step * axis)) / step / 2
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    assert camera.slope(points) == pytest.approx(by_differences, abs=1e-6)


# --- orders of joints


@pytest.mark.parametrize("layout", [HALPE_26, COCO_17, BODY_25], ids=lambda one: one.name)
def test_sessions_in_the_orders_that_pose2sim_writes(
    exact: Session, tmp_path: Path, layout: Layout
) -> None:
    """Told by the number of points; the joints are those of the cameras' truth."""
    write_session(exact.take(range(3)), tmp_path, layout=layout)
    session = read_session(tmp_path)
    assert {person.layout for view in session.people for person in view} == {layout.name}
    limbs = list(LIMB_JOINTS)
    assert session.world.points[:, limbs] == pytest.approx(JOINTS_3D[:3, limbs], abs=MIDWAY)


def test_sessions_take_a_layout(exact: Session, tmp_path: Path) -> None:
    write_session(exact.take(range(3)), tmp_path, layout=CROWDPOSE_14)
    with pytest.raises(BadInput, match=r"holds 14 points of a person; name their order"):
        read_session(tmp_path)
    session = read_session(tmp_path, layout="crowdpose_14")
    limbs = list(LIMB_JOINTS)
    assert session.world.points[:, limbs] == pytest.approx(JOINTS_3D[:3, limbs], abs=MIDWAY)
    assert len(read_data_set(tmp_path, layout="crowdpose_14"))
    with pytest.raises(BadInput, match="is no session of detections, which have a layout"):
        read_data_set(tmp_path / "pose", layout="crowdpose_14")


def test_a_frame_of_nobody_but_nan_is_left_out(exact: Session, tmp_path: Path) -> None:
    """As Pose2Sim writes it where it did not find the person."""
    write_session(exact.take(range(4)), tmp_path, layout=HALPE_26)
    file = next((tmp_path / "pose" / "cam1_json").glob("*_000002.json"))
    file.write_text(json.dumps({"people": [{"pose_keypoints_2d": [float("nan")] * 78}]}))
    session = read_session(tmp_path)
    assert (session.numbers, session.left_out) == ((0, 1, 3), 1)


# --- triangulation


def test_without_errors_the_truth_is_found(exact: Session):
    assert exact.world.points == pytest.approx(JOINTS_3D, abs=1e-6)
    assert exact.without(2).points == pytest.approx(JOINTS_3D, abs=1e-6)
    assert exact.apart.max() < 1e-6


def test_errors_of_known_size_leave_errors_of_the_covariance_that_is_said():
    """Squared distances in units of the covariance against chi² with three degrees of freedom:
    1,500 points, errors of 3 mm; false alarm 1e-3. A covariance half as large must fail."""
    joints = moving(100)
    rng = np.random.default_rng(1)
    found = filmed(joints, 3.0 * rng.normal(size=(4, 100, NUM_JOINTS, 2))).world
    apart = (found.points - joints)[..., None]
    square = np.swapaxes(apart, -1, -2) @ np.linalg.inv(9.0 * found.covariance) @ apart
    assert stats.kstest(square.ravel(), "chi2", args=(3,)).pvalue > 1e-3
    assert stats.kstest(2 * square.ravel(), "chi2", args=(3,)).pvalue < 1e-9


def test_a_wild_detection_is_not_trusted(exact: Session):
    errors = EXACT.copy()
    errors[1, :, 7] = 800.0
    found = filmed(JOINTS_3D, errors).world
    assert np.linalg.norm(found.points - JOINTS_3D, axis=-1).max() < 12
    assert found.weight[1, :, 7].max() < 0.01
    # Without it the joint is less sure.
    assert (
        np.linalg.det(found.covariance)[:, 7] > 1.5 * np.linalg.det(exact.world.covariance)[:, 7]
    ).all()


def test_a_joint_that_one_camera_alone_sees_is_not_known(exact: Session):
    people = [list(views) for views in exact.people]
    for views in people[1:]:
        keypoints, score = views[0].keypoints.copy(), views[0].score.copy()
        keypoints[4], score[4] = np.nan, 0.0
        views[0] = dataclasses.replace(views[0], keypoints=keypoints, score=score)
    found = dataclasses.replace(exact, people=tuple(map(tuple, people))).world
    assert np.argwhere(np.isnan(found.points).any(axis=-1)).tolist() == [[0, 4]]
    assert np.isnan(found.covariance[0, 4]).all()


def test_along_the_line_of_sight_depth_is_away_from_the_camera(exact: Session):
    turned = exact.along_sight(1, JOINTS_3D)
    assert turned[:, HIPS].mean(axis=1) == pytest.approx(0.0, abs=1e-9)
    far = np.linalg.norm(JOINTS_3D - exact.cameras[1].centre, axis=-1)
    middle = np.linalg.norm(JOINTS_3D[:, HIPS].mean(axis=1) - exact.cameras[1].centre, axis=-1)
    along = turned + np.array([0.0, 0.0, 1.0]) * middle[:, None, None]
    assert np.linalg.norm(along, axis=-1) == pytest.approx(far)
    assert exact.unit == pytest.approx(np.median([body_unit(one[None]) for one in JOINTS_3D]))
    axes = exact.sight_axes(1, JOINTS_3D)
    from_middle = JOINTS_3D - JOINTS_3D[:, HIPS].mean(axis=1, keepdims=True)
    assert np.einsum("fab,fjb->fja", axes, from_middle) == pytest.approx(turned)


# --- files


@pytest.mark.parametrize("name", ["calibration.qca.txt", "Calib_scene.toml", "intri.yml"])
def test_a_session_that_is_written_is_read(name: str, exact: Session, tmp_path: Path):
    write_session(exact.take(range(4)), tmp_path, name)
    assert is_session(tmp_path)
    assert brings_detections(tmp_path)
    found = read_session(tmp_path)
    assert found.labels == ("cam1_json", "cam2_json", "cam3_json", "cam4_json")
    assert (len(found), found.numbers, found.left_out) == (4, (0, 1, 2, 3), 0)
    assert found.world.points == pytest.approx(JOINTS_3D[:4], abs=MIDWAY)
    for one, other in zip(found.cameras, exact.cameras, strict=True):
        assert one.rotation == pytest.approx(other.rotation)
        assert one.centre == pytest.approx(other.centre)
        assert one.distortion == pytest.approx(other.distortion)


def test_the_persons_views_are_matched_where_files_name_another_first(exact: Session, copied: Path):
    """A bystander, two metres away, is the first person of two cameras in one frame."""
    beside = filmed(JOINTS_3D + np.array([0.0, 2000.0, 0.0]), EXACT)
    for camera in (0, 2):
        both = [beside.people[camera][3].keypoints, exact.people[camera][3].keypoints]
        path = copied / "pose" / f"cam{camera + 1}_json" / f"cam{camera + 1}_000003.json"
        path.write_text(json.dumps(openpose(both)))
    found = read_session(copied)
    assert [found.people[camera][3].person for camera in range(4)] == [1, 0, 1, 0]
    assert found.world.points == pytest.approx(JOINTS_3D[:6], abs=MIDWAY)


def test_a_frame_without_the_person_is_left_out(copied: Path):
    (copied / "pose" / "cam2_json" / "cam2_000004.json").write_text(json.dumps(openpose([])))
    found = read_session(copied)
    assert (found.numbers, found.left_out) == ((0, 1, 2, 3, 5), 1)


def test_a_folder_may_be_a_string(folder: Path) -> None:
    assert read_session(str(folder), 2).numbers == read_session(folder, 2).numbers


def test_frames_are_thinned_evenly(folder: Path):
    assert read_session(folder, frames=3).numbers == (0, 2, 5)


def test_a_session_is_a_data_set(folder: Path):
    """Poses are the truth's, turned; the camera's own axes are near. Midpoints, which a detector
    has for thorax and pelvis, are where the skeleton has these joints, in detections too."""
    data = read_data_set(folder, frames=12)
    assert (len(data), len(set(data.recording.tolist()))) == (12, 4)
    whole = read_data_set(folder)
    assert len(whole) == 24
    truth = without_midpoints(JOINTS_3D[0], ("thorax", "pelvis"))
    assert 100 < np.linalg.norm(truth[0] - JOINTS_3D[0, 0]) < 160
    truth = truth - truth[0]
    case = whole.case(0)
    seen = case.pose
    assert np.linalg.norm(seen, axis=-1) == pytest.approx(
        np.linalg.norm(truth, axis=-1), abs=MIDWAY
    )
    person = corrected(read_session(folder).people[0][0])
    assert person.moved == case.detection.moved == ("thorax", "pelvis")
    assert case.detection.keypoints[:2] == pytest.approx(person.keypoints[:2], abs=3)
    assert (
        np.abs(case.detection.keypoints[0] - read_session(folder).people[0][0].keypoints).max() > 10
    )
    upright = cameras()[0].rotation @ truth.T
    assert np.linalg.norm(upright.T - seen, axis=-1).max() < 150
    # What weak perspective leaves of a person at 3.5 m.
    left = whole.keypoints - whole.scale[:, None, None] * whole.poses[..., :2]
    left = (left - whole.translation[:, None]) / whole.scale[:, None, None]
    assert 3 < np.median(np.linalg.norm(left, axis=-1)) < 60


def test_how_far_detections_stray_is_found():
    """Within 20 % of what was put in, by joint, from 100 frames; the common error of a camera that
    points elsewhere is no joint's own."""
    size = np.linspace(4.0, 9.0, NUM_JOINTS)
    rng = np.random.default_rng(1)
    errors = size[:, None] * rng.normal(size=(4, 100, NUM_JOINTS, 2))
    session = filmed(moving(100), errors)
    assert session.stray == pytest.approx(size, rel=0.2)
    elsewhere = filmed(moving(100), errors + 10 * rng.normal(size=(4, 1, 1, 2)))
    assert elsewhere.stray == pytest.approx(session.stray, rel=0.1)


def test_where_cameras_point_is_said_by_what_their_views_have_in_common() -> None:
    """Of cameras that point by 0.2 degrees beside, anew in each of 300 frames: the mean square that
    is found is what they say and what is assumed, five numbers and two, to within a tenth (four
    standard errors); exact cameras leave what is assumed."""
    joints = moving(300)
    far = np.linalg.norm(joints[0, HIPS].mean(axis=0) - cameras()[0].centre)
    beside = np.random.default_rng(3).standard_normal((4, 300, 1, 2))
    errors = far * np.tan(np.radians(0.2)) * np.tile(beside, (1, 1, NUM_JOINTS, 1))
    square = filmed(joints, errors).pointing ** 2
    assert square == pytest.approx((5 * 0.2**2 + 2 * 0.3**2) / 7, rel=0.1)
    exact = filmed(joints[:1], np.zeros((4, 1, NUM_JOINTS, 2)))
    assert exact.pointing == pytest.approx(0.3 * np.sqrt(2 / 7), rel=1e-3)
    assert exact.instant(exact.numbers[0]).pointing == exact.pointing


@pytest.mark.parametrize("read", [False, True])
def test_a_truth_errs_as_its_doubt_says(read: bool, tmp_path: Path):
    """Squared distances of 120 people's joints from where they truly are, in units of the
    covariances, against chi² with three degrees of freedom, joint by joint: detections err by 8 mm,
    and have a thorax and pelvis of their own, or (read from files) midpoints. Those are taken in
    the image, where the thorax, which hardly errs, is beside its place: it is not asked. False
    alarm 1e-3 for all joints; a quarter of the covariances must fail."""
    joints = moving(120)
    session = filmed(joints, 8.0 * np.random.default_rng(5).normal(size=(4, 120, NUM_JOINTS, 2)))
    if read:
        write_session(session, tmp_path / "film")
        session = read_session(tmp_path / "film")
    data = from_session(session, perspective=True)
    assert bool(data.midpoints) == read
    truths = session.straight[0].view(without_midpoints(joints, data.midpoints))
    squares = []
    for truth, case in zip(
        truths, data, strict=False
    ):  # of the first camera: errors of others are alike
        apart = case.pose - (truth - truth[0])
        assert case.doubt is not None
        own = np.einsum("jjxy->jxy", case.doubt) + case.doubt[0, 0]
        rooted = own - case.doubt[0] - case.doubt[:, 0]
        squares.append(np.einsum("jx,jxy,jy->j", apart, np.linalg.pinv(rooted), apart)[1:])
    errors = case.strays(np.random.default_rng(0), 20000)
    found = np.einsum("njx,njy->jxy", errors, errors) / len(errors)
    assert found == pytest.approx(rooted, abs=0.05 * rooted.max())
    for square in np.transpose(squares)[int(read) :]:
        assert stats.kstest(square, "chi2", args=(3,)).pvalue > 1e-3 / NUM_JOINTS
        assert stats.kstest(4 * square, "chi2", args=(3,)).pvalue < 1e-6


def test_known_lenses_explain_what_weak_perspective_does_not(exact: Session):
    """What is seen of the truth, by the data set's own formula, by the model's camera and by the
    calibrated one, whose pixels are not square."""
    session = exact.take(range(6))
    data = from_session(session, perspective=True)
    for number, case in enumerate(data):
        assert case.lens is not None
        camera, joints = session.straight[number // 6], JOINTS_3D[number % 6]
        truth = camera.view(joints)
        assert case.pose == pytest.approx(truth - truth[0], abs=1e-3)
        square = camera.focal.mean() / camera.focal
        seen = camera.principal + (camera.project(joints) - camera.principal) * square
        assert case.pixels[:, :2] == pytest.approx(seen, abs=1e-3)
        assert case.detection.keypoints == pytest.approx(seen, abs=1e-3)
        weak = WeakPerspective(340 * case.scale, np.eye(3), case.translation)
        model = Perspective(weak, case.lens)
        assert np.asarray(model.image(case.pose / 340)) == pytest.approx(case.pixels[:, :2])
        larger = np.asarray(model.magnification(case.pose / 340))
        assert larger == pytest.approx(case.magnification(case.pose))
    without = dataclasses.replace(data, lens=None)
    assert np.abs(without.case(0).pixels - data.case(0).pixels).max() > 20
    far = from_session(session)
    assert np.linalg.norm(far.poses, axis=-1) == pytest.approx(
        np.linalg.norm(data.poses, axis=-1), abs=1e-3
    )
    assert (far.lens, far.sha256 == data.sha256) == (None, False)


def test_cases_with_lenses_are_chosen_turned_and_hidden(exact: Session):
    """A turned image shows the turned pose as the other showed the other."""
    data = from_session(exact.take(range(6)), perspective=True)
    some = data.take(np.array([23, 2]))
    assert [float(column) for column in some.case(0).lens[:1]] == [1495.0]
    assert some.case(1).lens[1] == pytest.approx(data.case(2).lens[1])
    case = data.case(8)
    turned = case.hiding(2).turned(70.0)
    seen = turned.detection.score > 0
    assert seen.sum() == NUM_JOINTS - 2
    assert turned.detection.keypoints[seen] == pytest.approx(turned.pixels[seen, :2], abs=1e-3)
    assert np.abs(turned.pixels - case.pixels).max() > 50
    kept = dataclasses.replace(turned, lens=case.lens)
    assert np.abs(kept.pixels - turned.pixels).max() > 1, "the principal point is turned, too"


def test_known_lenses_need_calibrated_cameras(folder: Path, tmp_path: Path):
    path = tmp_path / "plain.npz"
    with pytest.raises(BadInput, match="has no room for lenses"):
        write_plain(read_data_set(folder, perspective=True), path)
    write_plain(read_data_set(folder), path)
    with pytest.raises(BadInput, match=r"perspective needs calibrated cameras, which .*plain.npz"):
        read_data_set(path, perspective=True)


def test_a_joint_that_no_camera_sees_leaves_pairs_but_no_data_set(exact: Session):
    people = tuple(tuple(map(headless, views)) for views in exact.people)
    session = dataclasses.replace(exact, people=people)
    assert np.isnan(session.world.points[:, HEAD]).all()
    assert len(list(judged_views(session))) == 4
    with pytest.raises(
        BadInput, match=r"simulated has no frame in which two cameras beside the ju"
    ):
        from_session(session)


def headless(person: Detection) -> Detection:
    """Without the head, which many detectors do not have."""
    keypoints, score = person.keypoints.copy(), person.score.copy()
    keypoints[HEAD], score[HEAD] = np.nan, 0.0
    return dataclasses.replace(person, keypoints=keypoints, score=score)


def test_two_cameras_judge_nobody(exact: Session):
    two = dataclasses.replace(
        exact, cameras=exact.cameras[:2], labels=exact.labels[:2], people=exact.people[:2]
    )
    with pytest.raises(BadInput, match="has 2 cameras; to judge one of them by the others needs 3"):
        from_session(two)


# --- refusals


def test_a_wrong_sign_is_refused(exact: Session, copied: Path):
    """The camera's axes without the flip, or with another, look away from the person."""
    path = copied / "calibration" / "calibration.qca.txt"
    for flip in ((1, 1, 1), (-1, -1, 1)):
        write_qualisys(exact.cameras, path, flip)
        with pytest.raises(BadInput, match=r"in 6 of 6 frames .* no person is where the cameras'"):
            read_session(copied)


def test_cameras_in_another_order_are_refused(exact: Session, copied: Path):
    write_qualisys(exact.cameras[::-1], copied / "calibration" / "calibration.qca.txt")
    with pytest.raises(
        BadInput, match=r"calibration\.qca\.txt does not fit them|no person is where"
    ):
        read_session(copied)


def test_other_frame_counts_are_refused(copied: Path):
    (copied / "pose" / "cam3_json" / "cam3_000005.json").unlink()
    words = "cam3_json has 5 frames and cam1_json has 6, and frame 5 is only in one of them"
    with pytest.raises(BadInput, match=words):
        read_session(copied)


def test_other_numbers_of_cameras_are_refused(copied: Path):
    shutil.rmtree(copied / "pose" / "cam4_json")
    with pytest.raises(BadInput, match=r"has 3 folders of detections, but .* calibrates 4 cameras"):
        read_session(copied)


def test_two_calibrations_are_refused(copied: Path):
    shutil.copy(copied / "calibration" / "calibration.qca.txt", copied / "old.qca.txt")
    with pytest.raises(BadInput, match=r"must hold one calibration, but has old\.qca\.txt, calibr"):
        read_session(copied)


def test_frames_without_numbers_are_refused(copied: Path):
    place = copied / "pose" / "cam1_json"
    (place / "cam1_000005.json").rename(place / "last.json")
    with pytest.raises(BadInput, match="the frame 'last' has no number in its name"):
        read_session(copied)


QUALISYS = [
    ("", "is no XML"),
    ("<calibration>", "is no XML"),
    ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "holds a declaration that a calibration does not"),
    ("<calibration/>", "calibrates 0 cameras; two at least"),
    ("<c><camera/></c>", "camera 1 of .* has no <transform>"),
    ("<c><camera><transform r11='1'/></camera></c>", "<transform> lacks r12"),
]
CAMERA = """[c]
matrix = [[1500.0, 0.0, 500.0], [0.0, 1500.0, 900.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.1, 0.2, 0.3]
translation = [0.0, 0.0, 4.0]
"""
TOML = [
    ("a = [", "is no TOML"),
    ("a = 1", "calibrates 0 cameras"),
    (CAMERA, "calibrates 1 cameras"),
    (CAMERA + "fisheye = true", "is a fisheye camera, which this program does not know"),
    (CAMERA.replace("[0.1, 0.2, 0.3]", "[0.1, 0.2]"), "rotation must be 3 numbers"),
    (CAMERA.replace("[0.1, 0.2, 0.3]", "'text'"), "rotation must be 3 numbers"),
    (CAMERA.replace("[0.0, 0.0, 4.0]", "[0.0, 0.0, inf]"), "has a number that is not finite"),
    (CAMERA.replace("[[1500.0", "[[-1500.0"), "a focal length that is not positive"),
    (CAMERA.replace("[0.0, 0.0, 0.0, 0.0]", "[0.0]"), "distortions must be four or five numbers"),
    (CAMERA.replace("[[1500.0, 0.0, 500.0]", "[[1500.0, 0.0]"), "matrix must be 3 × 3 numbers"),
    (CAMERA.replace("[[1500.0, 0.0, 500.0]", "[[1500.0, 9.0, 500.0]"), "a skew is not known"),
    (CAMERA.replace("[0.0, 0.0, 1.0]]", "[0.0, 0.0, 2.0]]"), "a skew is not known"),
]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [("c.qca.txt", *case) for case in QUALISYS] + [("c.toml", *case) for case in TOML],
)
def test_what_is_no_calibration_is_refused(name: str, text: str, words: str, tmp_path: Path):
    (tmp_path / name).write_text(text)
    with pytest.raises(BadInput, match=words):
        read_session(tmp_path)


def test_numbers_that_are_no_rotation_are_refused(exact: Session, tmp_path: Path):
    mirrored = [dataclasses.replace(one, rotation=-one.rotation) for one in exact.cameras]
    write_qualisys(tuple(mirrored), tmp_path / "c.qca.txt")
    with pytest.raises(BadInput, match="its rotation is none"):
        read_session(tmp_path)


def with_camera(exact: Session, number: int, **changes: object) -> tuple[Pinhole, ...]:
    """The cameras, one of them changed."""
    views = list(exact.cameras)
    views[number] = dataclasses.replace(views[number], **changes)
    return tuple(views)


ABSURD: dict[str, tuple[Callable[[Session], tuple[Pinhole, ...]], str]] = {
    "pixels as long as roads": (
        lambda exact: with_camera(exact, 1, focal=exact.cameras[1].focal * [1e5, 1.0]),
        "has focal lengths of 1.5e[+]08 pixels across and 1490 down",
    ),
    "pixels three times as tall as wide": (
        lambda exact: with_camera(exact, 1, focal=exact.cameras[1].focal * [1.0, 1 / 3]),
        r"as if its pixels were 3\.02 times as long as wide",
    ),
    "on the moon": (
        lambda exact: with_camera(exact, 2, centre=np.array([1e9, 0.0, 0.0])),
        r"camera 3 of .* stands 1,000 km from every other",
    ),
    "all at one place": (
        lambda exact: tuple(
            dataclasses.replace(one, centre=exact.cameras[0].centre) for one in exact.cameras
        ),
        r"cameras \d and \d of .* stand at one place",
    ),
    "two at one place": (
        lambda exact: with_camera(exact, 3, centre=exact.cameras[1].centre + 1e-3),
        "cameras 2 and 4 of .* stand at one place",
    ),
}


@pytest.mark.parametrize("write", [write_qualisys, write_toml])
@pytest.mark.parametrize("case", ABSURD)
def test_cameras_that_cannot_be_are_refused(
    case: str, write: Callable, exact: Session, tmp_path: Path
) -> None:
    cameras_of, words = ABSURD[case]
    path = tmp_path / ("c.toml" if write is write_toml else "c.qca.txt")
    write(exact.cameras, path)
    assert len(read_cameras(path)) == 4
    write(cameras_of(exact), path)
    with pytest.raises(BadInput, match=words):
        read_cameras(path)


@pytest.mark.parametrize("ratio", [0.75, 4 / 3])
def test_pixels_that_are_not_square_leave_no_trace(ratio: float):
    """Errors of the same size each way are found to be so, whatever a camera's pixels are: as large
    as with square ones, to the last digits."""
    errors = 5.0 * np.random.default_rng(3).normal(size=(4, 30, NUM_JOINTS, 2))
    views = [dataclasses.replace(one, focal=np.array([1500.0, 1500.0])) for one in cameras()]
    oblong = [dataclasses.replace(one, focal=np.array([1500 * ratio, 1500.0])) for one in views]
    squeezed = [dataclasses.replace(one, focal=np.array([750 * (ratio + 1)] * 2)) for one in views]
    found, wanted = filmed(JOINTS_3D, errors, oblong), filmed(JOINTS_3D, errors, squeezed)
    assert found.world.points == pytest.approx(wanted.world.points, abs=1e-6)
    assert found.stray == pytest.approx(wanted.stray, rel=1e-9)


def test_a_point_between_two_cameras_is_not_known():
    """Two cameras that look at each other see a point on the line between them from one line: it is
    NaN, and the others are found."""
    left, right = (
        Pinhole(np.array(turn, float), np.array([0.0, 0.0, place]), np.full(2, 1e3), np.zeros(2))
        for turn, place in (
            ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], -3e3),
            ([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], 3e3),
        )
    )
    points = np.array([[0.0, 0.0, 100.0], [300.0, 200.0, 100.0]])
    xy = np.stack([one.project(points) for one in (left, right)])
    found = triangulate([left, right], xy, np.ones((2, 2)), np.full((2, 2), 0.4))
    assert np.isnan(found.points[0]).all()
    assert np.isnan(found.covariance[0]).all()
    assert found.points[1] == pytest.approx(points[1])


def test_people_are_tried_in_the_order_of_files():
    """All combinations, once each, by how far down the files they stand: against all of them,
    sorted."""
    for numbers in ([2, 2], [3, 1, 2], [4, 4, 4], [1, 1], [2] * 8):
        found = list(_choices(numbers))
        every = sorted(itertools.product(*map(range, numbers)), key=sum)
        assert sorted(found) == sorted(every)
        assert [sum(one) for one in found] == [sum(one) for one in every]


def test_many_cameras_cost_no_more_than_their_views():
    """Of 10^120 combinations the first 256 are there at once."""
    found = list(itertools.islice(_choices([2] * 400), MOST_COMBINATIONS))
    assert len(set(found)) == MOST_COMBINATIONS
    assert found[0] == (0,) * 400
    assert max(map(sum, found)) == 1


@pytest.mark.slow
def test_twenty_six_cameras_with_a_bystander(tmp_path: Path):
    """Of 67 million combinations in a frame the right one is the cheapest but the first."""
    views = cameras(26)
    errors = np.zeros((26, 2, NUM_JOINTS, 2))
    session, beside = (filmed(moving(2) + shift, errors, views) for shift in (0.0, 700.0))
    write_session(session, tmp_path)
    for camera, label in enumerate(session.labels):
        own, other = (one.people[camera][1].keypoints for one in (session, beside))
        people = [other, own] if camera == 7 else [own, other]
        path = tmp_path / "pose" / f"{label}_json" / f"{label}_000001.json"
        path.write_text(json.dumps(openpose(people)))
    found = read_session(tmp_path)
    assert [view[1].person for view in found.people] == [int(n == 7) for n in range(26)]


@pytest.mark.parametrize("encoding", ["nonsense", "utf-16", "ebcdic-cp-us", "x" * 1000, "utf-7"])
def test_a_qualisys_file_is_text_whatever_it_says_of_itself(
    encoding: str, exact: Session, tmp_path: Path
):
    path = tmp_path / "c.qca.txt"
    write_qualisys(exact.cameras, path)
    text = path.read_text().replace('version="1.0"', f'version="1.0" encoding="{encoding}"')
    path.write_text(text)
    assert len(read_cameras(path)) == 4
    path.write_bytes(text.encode("utf-16"))
    with pytest.raises(BadInput, match="is not UTF-8 text"):
        read_cameras(path)


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * 20_000) + " = 1",
        "[" + ".".join(["a"] * 20_000) + "]",
        "[[" + " . ".join(['"a"'] * 20_000) + "]]",
        "x = {" + ".".join(["a"] * 20_000) + " = 1}",
        "a = " + "[" * 20_000,
        "a = " + "{b = " * 20_000,
    ],
)
def test_keys_without_end_are_refused_at_once(text: str, tmp_path: Path):
    (tmp_path / "c.toml").write_text(CAMERA + "\n" + text)
    started = time.process_time()
    with pytest.raises(BadInput, match=r"has a key of more than 16 parts|is no TOML"):
        read_cameras(tmp_path / "c.toml")
    assert time.process_time() - started < 2


# --- shared data


def test_real_cameras_meet_where_the_person_is(shared_data: Path):
    """Five frames of a real film: some 12 pixels (median), bones of a grown person."""
    session = read_session(shared_data / "multicamera", frames=5)
    pixels = session.apart * session.scale[..., None]
    assert 5 < np.median(pixels) < 20
    assert 300 < session.unit < 380


# --- cameras that are out of step


def walking(late: int = 0, seed: int = 0, number: int = 4) -> Session:
    """Joints that sway at 12 mm a frame or less for 120 frames, with errors of 8 mm that are new in
    each; the second camera shows what the others showed so many frames before."""
    rng = np.random.default_rng(seed)
    joints = np.tile(moving(30, seed), (5, 1, 1))
    errors = 8 * rng.standard_normal((number, len(joints), NUM_JOINTS, 2))
    whole = filmed(joints, errors, cameras(number))
    kept = range(15, 135)
    shift = [late if row == 1 else 0 for row in range(number)]
    people = [
        tuple(view[frame - back] for frame in kept)
        for view, back in zip(whole.people, shift, strict=True)
    ]
    return dataclasses.replace(whole, numbers=tuple(kept), people=tuple(people))


@pytest.mark.parametrize(
    "late", [3, *(pytest.param(late, marks=pytest.mark.slow) for late in (-5, 1))]
)
def test_a_camera_that_is_out_of_step_is_named(late: int) -> None:
    lags = lags_of(walking(late))
    assert lags is not None
    np.testing.assert_array_equal(lags.sure, [False, True, False, False])
    assert lags.frames[1] == pytest.approx(late, abs=0.15)
    np.testing.assert_allclose(lags.frames[[0, 2, 3]], 0, atol=0.15)
    [said] = lags.said(["a", "b", "c", "d"])
    words = "behind the other" if late > 0 else "ahead of the other"
    assert said.startswith(f"b is {abs(lags.frames[1]):.1f} frames {words} cameras")
    assert lags.said(["a", "b", "c", "d"], ["b", "c"]) == [said]
    assert not lags.said(["a", "b", "c", "d"], ["a", "c"]), "one that is left out already"


@pytest.mark.slow
def test_cameras_in_step_are_not_accused() -> None:
    """Of ten sessions none; and standard errors are as large as lags are, over them: their ratio's
    root mean square is within 0.7 and 1.4 (forty lags; of independent ones nine in ten thousand
    would be beyond)."""
    found = [lags_of(walking(seed=seed)) for seed in range(10)]
    ratios = np.array([one.frames / one.error for one in found if one])
    assert not any(one.sure.any() for one in found if one)
    assert len(ratios) == 10
    assert 0.7 < np.sqrt(np.mean(ratios**2)) < 1.4


def test_of_few_cameras_or_frames_nothing_is_said_of_their_step() -> None:
    assert lags_of(walking(3, number=2)) is None
    assert lags_of(walking(3).take(range(20))) is None


def test_easymocaps_files_that_are_none_are_refused(exact: Session, tmp_path: Path) -> None:
    """One sentence each: what, where, what to do."""
    inner, outer = tmp_path / "intri.yml", tmp_path / "extri.yml"
    write_easymocap(exact.cameras, inner)
    whole = {path: path.read_text() for path in (inner, outer)}
    assert len(read_cameras(inner)) == 4
    for path, old, new, words in [
        (inner, "names:", "cameras:", "does not name its cameras"),
        (inner, "K_cam2", "K_cam9", "camera 'cam2' of .*: matrix must be 3 × 3 numbers"),
        (outer, "T_cam3", "T_cam9", "camera 'cam3' of .*: translation must be 3 numbers"),
        (outer, "R_cam1", "Q_cam1", "camera 'cam1' of .*: rotation must be 3 numbers"),
        (outer, "rows: 3", "rows: 4", "'R_cam1' does not hold 4 × 1 numbers"),
        (outer, "rows: 3", f"rows: {10**30}", "does not hold"),
        (outer, "data: [ ", "data: [ nan, ", "does not hold"),
        (inner, "data: [ 1500.0", "data: [ inf", "not finite"),
    ]:
        path.write_text(whole[path].replace(old, new, 1))
        with pytest.raises(BadInput, match=words):
            read_cameras(inner)
        path.write_text(whole[path])
    outer.unlink()
    with pytest.raises(BadInput, match="extri"):
        read_cameras(inner)


@pytest.mark.parametrize("times", [0.1, 10.0])
def test_a_person_whom_a_wrong_unit_makes_too_large_is_refused(
    times: float, exact: Session, tmp_path: Path
) -> None:
    """Centimetres, where metres are meant, and the other way round."""
    cameras = [dataclasses.replace(one, centre=times * one.centre) for one in exact.cameras]
    session = dataclasses.replace(exact.take(range(3)), cameras=tuple(cameras))
    write_session(session, tmp_path)
    with pytest.raises(
        BadInput, match=r"limbs of the person are .* mm long .* scale its positions"
    ):
        read_session(tmp_path)


def test_a_camera_that_saw_nobody_is_named(exact: Session, tmp_path: Path) -> None:
    write_session(exact.take(range(3)), tmp_path)
    for path in sorted((tmp_path / "pose" / "cam3_json").iterdir())[:2]:
        path.write_text('{"version": 1.3, "people": []}')
    with pytest.raises(BadInput, match=r"cam3_json of .* saw nobody in 2 of 3 frames"):
        read_session(tmp_path)
