"""`poseterior show` and the overlay: every joint has its name where it is, and doubts are said in
sentences."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from poseterior.inference.readings import BODY, exchanged
from poseterior.probmodel import Detection, Likelihood, read_detections, write_detections
from poseterior.probmodel.detections import FACE
from poseterior.probmodel.layouts import COCO_17
from poseterior.probmodel.skeleton import BONES, JOINTS
from poseterior.reports.doubts import about_the_image
from poseterior.reports.figures import read_image
from poseterior.reports.figures.colours import LIMB_COLOURS
from poseterior.reports.figures.overlay import _spread, overlay_figure
from poseterior.reports.options import Detected
from tests.conftest import Cli
from tests.probmodel.test_formats_fuzz import deeplabcut_rows, landmarks, points, table


def person(**missing: bool) -> Detection:
    rows = points(COCO_17)
    rows[:, 0] = 50 + (rows[:, 0] - 50) * 1.2
    rows[[COCO_17.points.index(name) for name in missing], 2] = 0
    return COCO_17.detection(rows, 0.0, "a file", 0)


def gids(figure: Figure) -> dict[str, object]:
    return {artist.get_gid(): artist for artist in figure.findobj() if artist.get_gid()}


def test_every_joint_is_drawn_where_it_is_with_name_score_and_disc() -> None:
    detection = person(right_wrist=True)
    spread = Likelihood().spread(detection, 30.0)
    radius = np.where(np.isfinite(spread), spread, np.nan)
    drawn = gids(overlay_figure(detection, radius))
    for joint, name in enumerate(JOINTS):
        seen = bool(detection.seen[joint])
        assert (f"joint {name}" in drawn) == seen
        assert any(gid.startswith(f"name {name.replace('_', ' ')} ") for gid in drawn) == seen
        assert (f"disc {name}" in drawn) == (seen and joint in {bone.end for bone in BONES})
        if seen:
            np.testing.assert_allclose(
                drawn[f"joint {name}"].get_xydata()[0], detection.keypoints[joint]
            )
    assert drawn["disc left_wrist"].radius == pytest.approx(radius[JOINTS.index("left_wrist")])
    assert "not detected: right wrist, head's end" in drawn["note"].get_text()
    assert "face nose" in drawn


def test_sides_have_their_colours_and_the_image_lies_behind() -> None:
    drawn = gids(overlay_figure(person(), image=np.zeros((200, 100, 3), np.uint8)))
    assert drawn["bone left_knee"].get_color() == LIMB_COLOURS["left leg"]
    assert drawn["bone right_elbow"].get_color() == LIMB_COLOURS["right arm"]
    assert drawn["image"].get_extent() == [-0.5, 99.5, 199.5, -0.5]


def test_names_do_not_lie_on_each_other() -> None:
    places = np.random.default_rng(0).uniform(size=(200, 7))
    for row in places:
        spread = _spread(sorted(row.tolist(), reverse=True), 0.05)
        assert (np.diff(spread) <= -0.05 + 1e-9).all()
        assert min(spread) > -0.2
        assert max(spread) <= 1


def test_a_file_that_is_read_rightly_is_shown_without_a_word(
    tmp_path: Path, poseterior: Cli
) -> None:
    write_detections(tmp_path / "a.json", [person()])
    done = poseterior("show", tmp_path / "a.json", "--out", tmp_path / "a.png", "--quiet")
    assert (done.code, done.err) == (0, "")
    assert "right wrist" in done.out
    assert read_image(tmp_path / "a.png").shape[1] == 1600


def test_a_doubted_reading_is_one_sentence_and_a_field_of_the_json(
    tmp_path: Path, poseterior: Cli
) -> None:
    write_detections(tmp_path / "a.json", [exchanged(person(), *BODY)])
    done = poseterior("show", tmp_path / "a.json", "--out", tmp_path / "a.png", "--quiet", "--json")
    assert done.code == 0
    assert re.fullmatch(
        r"poseterior: left and right seem to be exchanged, or the image mirrored[^\n]*\n", done.err
    )
    said = json.loads(done.out)
    assert said["noticed"] == ["whole"]
    assert said["warnings"] == [done.err.removeprefix("poseterior: ").strip()]
    assert said["gains"]["whole"] > 2.5


def test_the_image_says_its_size(tmp_path: Path) -> None:
    """Fractions become pixels of the image that is given; an image that does not fit the detection
    is spoken of."""
    (tmp_path / "a.json").write_text(json.dumps(landmarks()))
    Image.new("RGB", (200, 200)).save(tmp_path / "a.png")
    (found,) = Detected(image=tmp_path / "a.png").people(tmp_path / "a.json")
    assert found.keypoints[JOINTS.index("right_wrist")] == pytest.approx([26, 80])
    assert about_the_image(found, (200, 200)) == []
    (said,) = about_the_image(found, (300, 400))
    assert said == "the detection was made on an image of 200x200 pixels, but this one has 300x400"
    (said,) = about_the_image(person(), (30, 30))
    assert re.match(r"\d+ of 14 joints lie outside the image of 30x30: is it the", said)


@pytest.mark.parametrize(("layout", "said"), [("skeleton_15", 1), ("mediapipe_33", 0)])
def test_joints_outside_the_image_are_spoken_of(layout: str, said: int) -> None:
    """Two that lie far outside, by a detector that finds none there: one, or near it, may stray."""
    keypoints = np.full((15, 2), 50.0)
    keypoints[:2] = 50.0, 130.0
    seen = Detection(keypoints, np.ones(15), layout, "made here", 0)
    assert len(about_the_image(seen, (100, 100))) == said
    assert about_the_image(seen, (100, 130)) == []
    keypoints[1] = 50.0
    one = Detection(keypoints, np.ones(15), layout, "made here", 0)
    assert about_the_image(one, (100, 100)) == []


def test_a_map_of_names_and_the_correction(tmp_path: Path) -> None:
    odd = {"a": "right_hip", "b": "left_hip", "c": "right_shoulder", "d": "left_shoulder"}
    (tmp_path / "a.csv").write_text(table(deeplabcut_rows(parts=odd)))
    (tmp_path / "names.json").write_text(json.dumps(odd))
    mapped = Detected(names=tmp_path / "names.json").people(tmp_path / "a.csv")[0]
    assert mapped.seen.sum() == 6  # thorax and pelvis are their midpoints
    (tmp_path / "b.json").write_text(json.dumps(landmarks()))
    usual, moved = (
        Detected(image_size="200x200", correct=correct).people(tmp_path / "b.json")[0]
        for correct in (False, True)
    )
    assert usual.keypoints[0] == pytest.approx([50, 80])
    assert moved.keypoints[0] == pytest.approx([50, 80 - 0.194 * 50])


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--image-size", "640"), "--image-size must look like 640x480"),
        (("--image-size", "0x480"), "--image-size must look like 640x480"),
        (("--estimator", "magic"), "no estimator 'magic'; choose one of"),
        (("--factor", "0"), "--factor must lie between"),
        (("--names", "{tmp}/a.json"), "must hold an object of names, or a list of them"),
        (("--names", "{tmp}/none.json"), "there is no map of names at"),
        (("--person", "3"), "person 3 is not among them"),
        (("--image", "{tmp}/a.json"), "is no image that can be read"),
    ],
)
def test_what_show_refuses(
    tmp_path: Path,
    poseterior: Cli,
    words: tuple[str, ...],
    match: str,
) -> None:
    write_detections(tmp_path / "a.json", [person()])
    (tmp_path / "a.json").write_text((tmp_path / "a.json").read_text())
    done = poseterior(
        "show", tmp_path / "a.json", *(word.format(tmp=tmp_path) for word in words), "--quiet"
    )
    assert done.code == 2
    assert match in done.err


REAL_FILES = {
    "openpose/body25_openposer_du_wohn_wo_000000000030_keypoints.json": (),
    "openpose/body25_openposer_du_wohn_wo_000000000031_keypoints.json": (),
    "openpose/body25_openposer_du_wohn_wo_000000000032_keypoints.json": (),
    "openpose/body25_spin_im1010_keypoints.json": (),
    "openpose/body25b_pose2sim_cam02.0022.json": (),
    "openpose/coco18_hmr_random_keypoints.json": (),
    "coco/test_coco.json": (),
    "alphapose/alphapose-results_halpe26.json": (),
    "mmpose/mmpose_inferencer_000000000785.json": (),
    "mediapipe/pose_landmarks.pbtxt": ("--image-size", "1000x667"),
    # Seated in front of a webcam: the hips lie outside the image, and are used only where that is
    # asked for.
    "mediapipe/pose_landmarks_webcam.json": (
        "--image-size",
        "640x480",
        "--threshold",
        "0.001",
        "--factor",
        "0.5",
    ),
}


COMMANDS = {
    "show": ("show",),
    "hypotheses": ("hypotheses", "--num-samples", "20", "--k", "2"),
    "sample": ("sample", "--num-samples", "20"),
    "frames": ("frames", "--num-samples", "20", "--k", "2"),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("size", "doubted"), [("1000x667", False), ("1778x667", True)])
def test_a_wrong_size_for_fractions_is_doubted(
    shared_data: Path, tmp_path: Path, poseterior: Cli, command: str, size: str, doubted: bool
) -> None:
    """Four lunges, arms spread, as YOLO writes them, on an image that is said to be 16/9 times too
    wide."""
    lunge = shared_data / "detections" / "mediapipe" / "pose_landmarks.pbtxt"
    (person,) = read_detections(lunge, image_size=(1000, 667))
    joints = dict(zip(JOINTS, person.keypoints, strict=True))
    joints |= dict(zip(FACE, person.face[:, :2], strict=True))
    rows = [[*(joints[name] / (1000, 667)), 1.0] for name in COCO_17.points]
    line = " ".join(f"{number:.6f}" for number in np.ravel(rows))
    (tmp_path / "a.txt").write_text(4 * f"0 0.5 0.5 1 1 {line}\n")
    out = tmp_path / {"show": "a.png", "sample": "a.nc"}.get(command, "out")
    words = ("--image-size", size, "--out", out, "--quiet")
    done = poseterior(*COMMANDS[command], tmp_path / "a.txt", *words)
    assert done.code == 0
    assert ("too wide or too narrow" in " ".join(done.err.split())) == doubted


def test_an_image_that_is_another_one_is_spoken_of(tmp_path: Path, poseterior: Cli) -> None:
    Image.new("RGB", (320, 200)).save(tmp_path / "a.png")
    words = ("--image", tmp_path / "a.png", "--num-samples", "20", "--k", "2")
    skier = Path(__file__).parents[2] / "examples" / "skier.json"
    done = poseterior("hypotheses", skier, *words, "--out", tmp_path / "out", "--quiet")
    assert done.code == 0
    assert "the detection was made on an image of 640x425 pixels" in " ".join(done.err.split())


@pytest.mark.sweep
@pytest.mark.parametrize("file", REAL_FILES)
def test_every_real_file_runs_through_hypotheses(
    shared_data: Path,
    tmp_path: Path,
    poseterior: Cli,
    file: str,
) -> None:
    words = ("--num-samples", "50", "--k", "2", "--out", tmp_path, "--quiet", *REAL_FILES[file])
    done = poseterior("hypotheses", shared_data / "detections" / file, *words)
    assert done.code == 0, done.err
    assert (tmp_path / "hypotheses.png").exists()
