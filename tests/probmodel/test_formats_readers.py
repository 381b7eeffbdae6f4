"""Readers of every detector's files: the same person out of each, real files by hand, folders,
corrections."""

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from scipy.spatial.transform import Rotation

from poseterior import probmodel
from poseterior.probmodel import (
    Anatomy,
    BadInput,
    Detection,
    formats,
    read_detections,
    read_frames,
    write_detections,
)
from poseterior.probmodel.detections import FACE
from poseterior.probmodel.formats import Content, read_content
from poseterior.probmodel.formats.frames import PROBES
from poseterior.probmodel.formats.named_points import VISION
from poseterior.probmodel.layouts import (
    BEHIND,
    BODY_25,
    COCO_17,
    COCO_18,
    H36M_17,
    HALPE_26,
    LAYOUTS,
    MEDIAPIPE_33,
    MIDPOINTS,
    MPII_16,
    STRAY,
    TOWARDS_THE_OTHER,
    Layout,
    corrected,
    layout_of_names,
    spoken_name,
    without_midpoints,
)
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX
from tests.probmodel.test_formats import (
    ALPHAPOSE,
    HMR,
    POSE2SIM,
    SPIN,
    STANDING,
    detections,
    flat,
    openpose,
    results,
    same,
)
from tests.probmodel.test_formats_fuzz import (
    FILES,
    PARTS,
    SIZE,
    deeplabcut_rows,
    freemocap,
    hdf5,
    landmark_text,
    landmarks,
    listed_points,
    long_landmarks,
    mmpose,
    mmpose_instance,
    movenet,
    mpii,
    named_columns,
    npy,
    npz,
    points,
    sleap,
    table,
    vision,
    vitpose,
    yolo,
    yolo_text,
)

MMPOSE = "detections/mmpose/mmpose_inferencer_000000000785.json"
COCO = "detections/coco/test_coco.json"
LUNGE = "detections/mediapipe/pose_landmarks.pbtxt"
WEBCAM = "detections/mediapipe/pose_landmarks_webcam.json"
HAS_NO_HEAD = {"head"}


def read(data: bytes, format: str = "auto", **known: Any) -> list[Detection]:
    return read_content(Content(data, "a file", **({"image_size": SIZE} | known)), format)


def missing(detection: Detection) -> set[str]:
    return {name for name, seen in zip(JOINTS, detection.seen, strict=True) if not seen}


# One person, every format.


@pytest.mark.parametrize(
    ("format", "number"),
    [
        (name, i)
        for name, several in FILES.items()
        if name != "poseterior"
        for i in range(len(several))
    ],
)
def test_every_format_reads_the_same_person(format: str, number: int) -> None:
    """`STANDING` stands behind every file; rounding and the pixels of heatmaps aside, it must come
    out of each."""
    person = read(FILES[format][number])[0]
    near = 2.0 if format == "heatmaps" else 1e-3
    shown = set(JOINTS) - missing(person)
    assert shown >= {"right_wrist", "left_ankle", "right_knee", "left_elbow", "thorax", "pelvis"}
    unscaled = 4 if format == "heatmaps" and number != 1 else 1
    for name in shown:
        xy = person.keypoints[JOINT_INDEX[name]] * unscaled
        if name in STANDING:
            np.testing.assert_allclose(xy, STANDING[name], atol=near, err_msg=name)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_no_layout_swaps_left_and_right(layout: probmodel.layouts.Layout) -> None:
    """The person faces the camera: left is right of right in the image, in the body and in the
    face."""
    person = layout.detection(points(layout), 0.0, "a file", 0)
    for name in [
        name for name in JOINTS if name.startswith("left") and person.seen[JOINT_INDEX[name]]
    ]:
        other = JOINT_INDEX[name.replace("left", "right")]
        assert person.keypoints[JOINT_INDEX[name], 0] > person.keypoints[other, 0], name
    assert len(set(layout.points)) == layout.count
    if layout.has_face:
        assert person.face is not None
        for name, row in zip(FACE, person.face, strict=True):
            np.testing.assert_array_equal(row[:2], STANDING[name], err_msg=name)


def test_layouts_without_eyes_and_ears_have_no_face() -> None:
    assert {layout.name for layout in LAYOUTS.values() if not layout.has_face} == {
        "mpii_16",
        "h36m_17",
        "crowdpose_14",
        "aic_14",
    }
    assert MPII_16.detection(points(MPII_16), 0.0, "a file", 0).face is None


# MediaPipe.


def test_mediapipe_visibility_may_be_a_logit() -> None:
    probability = read(json.dumps(landmarks(visibility=0.9)).encode())[0]
    logit = read(json.dumps(landmarks(visibility=float(np.log(9)))).encode())[0]
    np.testing.assert_allclose(logit.score, probability.score)
    hidden = json.dumps([*landmarks(visibility=2.0)[:32], landmarks(visibility=-2.0)[32]]).encode()
    assert len(missing(read(hidden)[0])) == 1  # the head; the hidden foot is no joint


def test_mediapipe_seen_means_more_likely_than_not() -> None:
    rows = landmarks()
    rows[16]["visibility"] = 0.5  # the right wrist
    assert missing(read(json.dumps(rows).encode())[0]) == {"head", "right_wrist"}
    assert missing(
        read_content(Content(json.dumps(rows).encode(), "a file", SIZE), threshold=0.2)[0]
    ) == {"head"}


def test_mediapipe_frames_of_tables() -> None:
    assert [person.image_id for person in read(FILES["mediapipe-csv"][1])] == ["0", "1"]
    twice = long_landmarks() + "".join(long_landmarks().splitlines(keepends=True)[1:])
    assert [person.image_id for person in read(twice.encode())] == ["0", "1"]


def test_real_mediapipe_files(shared_data: Path) -> None:
    (lunge,) = read_detections(shared_data / LUNGE, image_size=(1000, 667))
    assert missing(lunge) == HAS_NO_HEAD
    assert lunge.image_size == (1000, 667)
    right, left = (lunge.keypoints[JOINT_INDEX[f"{side}_wrist"]] for side in ("right", "left"))
    assert right[0] < left[0]  # she faces the camera
    (webcam,) = read_detections(shared_data / WEBCAM, image_size=(640, 480))
    assert set(JOINTS) - missing(webcam) == {
        "thorax",
        "right_shoulder",
        "left_shoulder",
    }  # all else lies outside


# MMPose and AlphaPose.


def test_mmpose_layout_stands_in_meta_info() -> None:
    by_name = {str(i): name for i, name in enumerate(H36M_17.points)}
    named = read(
        json.dumps(mmpose(H36M_17, dataset_name="mine", keypoint_id2name=by_name)).encode()
    )[0]
    known = read(json.dumps(mmpose(H36M_17, dataset_name="h36m")).encode())[0]
    assert (named.layout, known.layout) == ("named", "h36m_17")
    np.testing.assert_array_equal(named.keypoints, known.keypoints)
    assert [
        person.image_id
        for person in read(json.dumps(mmpose(COCO_17, dataset_name="coco")).encode())
    ] == ["0", "1"]


def test_real_mmpose_file_agrees_with_the_annotation(shared_data: Path) -> None:
    (person,) = read_detections(shared_data / MMPOSE)
    truth = read_detections(shared_data / COCO)[0]
    assert (person.layout, missing(person)) == ("coco_17", HAS_NO_HEAD)
    assert person.score.max() > 0.7
    distance = np.linalg.norm(person.keypoints - truth.keypoints, axis=1)
    assert np.nanmax(distance) < 15  # pixels; she is 320 tall


def test_alphapose_scores_run_to_six() -> None:
    high = results(points(COCO_17, 5.5).ravel().tolist())
    low = results(points(COCO_17, 0.5).ravel().tolist())
    one, other = (read(json.dumps(document).encode())[0] for document in (high, low))
    assert one.score.max() == 5.5
    np.testing.assert_array_equal(one.alpha(), other.alpha())


# DeepLabCut.


def test_deeplabcut_individuals_and_frames() -> None:
    people = read(FILES["deeplabcut-csv"][1])
    assert [(person.person, person.image_id) for person in people] == [
        (0, "0"),
        (1, "0"),
        (2, "1"),
        (3, "1"),
    ]
    assert missing(people[0]) == {"head"}


def test_deeplabcut_names_are_ours_or_mapped() -> None:
    odd = {f"part{number}": joint for number, joint in enumerate(PARTS.values())}
    data = table(deeplabcut_rows(parts=odd)).encode()
    with pytest.raises(
        BadInput, match=r"none of the body parts of a file .* is a joint known here; give a map"
    ):
        read(data)
    for names in (odd, list(odd.values())):
        assert missing(read(data, names=names)[0]) == {"head"}
    with pytest.raises(BadInput, match=r"list of names has 2, but a file has 13 body parts"):
        read(data, names=["nose", "head"])
    with pytest.raises(BadInput, match="several body parts that are left_hip"):
        read(data, names=dict.fromkeys(odd, "left_hip"))


def test_deeplabcut_without_likelihood_was_labelled_by_hand() -> None:
    rows = deeplabcut_rows()
    keep = [0] + [i for i in range(1, len(rows[0])) if i % 3]
    person = read(table([[row[i] for i in keep] for row in rows]).encode())[0]
    assert person.score.max() == 1
    rows[-1][1:3] = ["", ""]
    assert "left_shoulder" in missing(
        read(table([[row[i] for i in keep] for row in rows]).encode())[1]
    )


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("LeftShoulder", "left_shoulder"),
        ("r_knee", "right_knee"),
        ("Ankle-L", "left_ankle"),
        ("RWrist", "right_wrist"),
        ("MidHip", "pelvis"),
        ("HEAD_TOP", "head"),
        ("Nose", "nose"),
        ("hip1", "hip1"),
        ("neck", "neck"),
    ],
)
def test_names_as_people_write_them(written: str, name: str) -> None:
    assert spoken_name(written) == name
    assert layout_of_names([written], {written: "pelvis"}).points == ("pelvis",)


HALF_SEEN = points(COCO_17)
HALF_SEEN[9] = [0, 0, 0.4]


def test_yolo_s_points_at_the_corner_are_missing() -> None:
    """Some versions move points with a score below one half there, and leave them their score."""
    columns = dict(zip(("x", "y", "visible"), HALF_SEEN.T.tolist(), strict=True))
    person = read(json.dumps([yolo(keypoints=columns)]).encode())[0]
    assert missing(person) >= {"left_wrist"}
    assert "right_wrist" not in missing(person)


def test_yolo_without_scores_has_one_for_every_point() -> None:
    record = yolo()
    del record["keypoints"]["visible"]
    assert read(json.dumps([record]).encode(), image_size=None)[0].score.max() == 1


def test_yolo_s_people_are_lines(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(yolo_text(3, 0.9) * 3)
    assert len(read_detections(tmp_path / "a.txt", image_size=SIZE)) == 3
    (frame,) = read_frames(tmp_path, image_size=SIZE)
    assert [one.person for one in frame.people] == [0, 1, 2]


MPII = ["head_top", "right_ankle", "r_knee", "RHip", "left_hip", "l_knee", "left_ankle", "root"]
MPII += ["chest", "r_shoulder", "r_elbow", "r_wrist", "left_shoulder", "left_elbow", "left_paw"]


def named_annotations(names: list[str], **category: Any) -> bytes:
    """A COCO file of another data set, whose category names its points."""
    known = {"left_paw": "left_wrist"}
    flat = [n for name in names for n in (*STANDING[known.get(name, spoken_name(name))], 2)]
    return json.dumps(
        {
            "annotations": [{"image_id": 7, "category_id": 3, "keypoints": flat}],
            "categories": [{"id": 3, "name": "person", "keypoints": names} | category],
        }
    ).encode()


def test_coco_files_that_name_their_points_are_read_by_their_names() -> None:
    person = read(named_annotations(MPII))[0]
    assert missing(person) == {"left_wrist"}
    person = read(named_annotations(MPII), names={"left_paw": "left_wrist"})[0]
    for name in set(JOINTS):
        np.testing.assert_array_equal(person.keypoints[JOINT_INDEX[name]], STANDING[name])


def test_coco_files_without_names_take_a_list_of_them() -> None:
    names = [*MPII[:-1], "left_wrist"]
    assert not missing(read(named_annotations(MPII, keypoints=None), names=names)[0])
    assert not missing(read(named_annotations(MPII), names=names)[0])


def test_a_table_of_named_columns_in_any_order() -> None:
    header = ["RWrist_conf", "left hip.x", "left hip.Y", "RWrist_y", "RWrist_x", "note"]
    header += ["hip_r x", "hip_r y", "tail_x", "tail_y", "l_shoulder_x", "l_shoulder_y"]
    rows = [
        [0.7, 1, 2, 4, 3, "a", 5, 6, 7, 8, 9, 10],
        [0.7, "", 2, 4, 3, "b", 5, 6, 7, 8, 9, "nan"],
    ]
    first, second = read(table([header, *rows]).encode())
    assert first.keypoints[JOINT_INDEX["right_wrist"]].tolist() == [3, 4]
    assert first.score[JOINT_INDEX["right_wrist"]] == 0.7
    assert first.score[JOINT_INDEX["left_hip"]] == 1
    assert {"left_hip", "left_shoulder"} <= missing(second)
    odd = table([["a_x", "a_y", "b_x", "b_y", "c_x", "c_y"], [1, 2, 3, 4, 5, 6]]).encode()
    with pytest.raises(BadInput, match=r"not known here|not valid JSON"):
        read(odd)
    named = read(odd, names={"a": "head", "b": "left_hip", "c": "right_hip"})[0]
    assert named.keypoints[JOINT_INDEX["head"]].tolist() == [1, 2]


def test_fractions_need_the_size_of_their_image() -> None:
    for data in (FILES["ultralytics-text"][0], FILES["ultralytics"][1]):
        with pytest.raises(
            BadInput, match=r"fractions of an image .* give image_size=\(640, 480\)"
        ):
            read(data, image_size=None)


def test_arrays_of_named_joints() -> None:
    """Any detector's array is read once its order of joints is named, and refused before."""
    rows = points(MPII_16)
    for array in (rows, rows[:, :2], np.stack([rows, rows])):
        first, *others = read(npy(array), layout="mpii_16")
        assert len(others) == (array.ndim == 3)
        assert not missing(first)
        np.testing.assert_array_equal(first.keypoints[JOINT_INDEX["head"]], STANDING["head"])
    rows[10] = np.nan
    assert missing(read(npy(rows), layout="mpii_16")[0]) == {"right_wrist"}
    with pytest.raises(BadInput, match=r"holds 16 points .* --layout\), such as mpii_16"):
        read(npy(rows))
    with pytest.raises(BadInput, match=r"holds 16 points of a person, but coco_17 has 17"):
        read(npy(rows), layout="coco_17")
    with pytest.raises(BadInput, match="there is no layout 'mpi'; choose one of coco_17"):
        read(npy(rows), layout="mpi")
    with pytest.raises(
        BadInput, match=r"lie between 0 and 1; give pixels or, .* the format movenet"
    ):
        read(npy(points(COCO_17) / 200), layout="coco_17")


def test_movenet_is_y_first_and_may_be_asked_for() -> None:
    squeezed = npy(movenet(1)[0, 0])
    with pytest.raises(BadInput, match=r"holds 17 points of a person; name their order"):
        read(squeezed)
    asked = read_content(Content(squeezed, "a file", SIZE), "movenet")[0]
    np.testing.assert_allclose(
        asked.keypoints[JOINT_INDEX["left_wrist"]], STANDING["left_wrist"], atol=1e-4
    )
    assert len(read(npy(movenet(2)))) == 2  # four of six were not found
    with pytest.raises(BadInput, match="a point 160 images from the corner, where fractions"):
        read(npy(movenet(1) * 200))


def test_freemocap_is_read_camera_by_camera() -> None:
    people = read(npy(freemocap()))
    assert [one.image_id for one in people] == ["0/0", "0/1", "1/0", "1/1"]
    assert {float(one.score.max()) for one in people} == {1.0}  # its third number is no score


def test_sleap_has_a_person_for_every_track_of_a_frame() -> None:
    for data in FILES["sleap"]:
        people = read(data)
        assert [one.image_id for one in people] == ["0", "0", "1"]
        assert people[0].score[JOINT_INDEX["left_hip"]] == pytest.approx(0.5)


def test_vitpose_keeps_the_places_of_points_that_it_left_out() -> None:
    (person, *others) = read(json.dumps(vitpose(kept=11)).encode())
    assert len(others) == 2
    assert missing(person) >= {"left_hip", "right_ankle"}
    np.testing.assert_array_equal(
        person.keypoints[JOINT_INDEX["right_wrist"]], STANDING["right_wrist"]
    )
    assert [one.image_id for one in (person, *others)] == ["0", "1", "1"]


def test_mpii_joints_that_were_not_labelled() -> None:
    seen = [1] * 16
    seen[10] = 0
    places = points(MPII_16)[:, :2].tolist()
    places[0], places[9] = [-1, -1], [0, 0]
    (person,) = read(json.dumps([mpii(joints=places, joints_vis=seen)]).encode())
    assert missing(person) == {"right_ankle", "right_wrist", "head"}
    bare = mpii()
    del bare["joints_vis"]
    assert not missing(read(json.dumps([bare]).encode())[0])


def test_detectron2_writes_coco_results() -> None:
    record = {"image_id": 9, "category_id": 1, "bbox": [0, 0, 9, 9], "score": 0.9}
    flat_points = points(COCO_17).ravel().tolist()
    (person,) = read(json.dumps([{**record, "keypoints": flat_points}]).encode())
    assert missing(person) == HAS_NO_HEAD


def test_vision_counts_y_from_below() -> None:
    person = read(json.dumps(vision(VISION)).encode())[0]
    assert person.keypoints[JOINT_INDEX["left_ankle"], 1] > person.keypoints[0, 1]
    with pytest.raises(BadInput, match=r"fractions of an image .* give image_size="):
        read(json.dumps(vision(VISION)).encode(), image_size=None)


def zipped(*names: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in names:
            archive.writestr(name, "{}")
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\xff\xd8\xff\xe0" + bytes(9), "a photo .JPEG.; run a detector"),
        (b"\x00\x00\x00\x18ftypmp42", "a video .MP4 or QuickTime."),
        (b"RIFF\x00\x00\x00\x00AVI LIST", "a video .AVI."),
        (b"PathFileType\t4\t(X/Y/Z)\ta.trc\n", "a TRC file of markers; 3D poses are for check"),
        (b"\x02\x50" + bytes(600), "a C3D file of markers; 3D poses are for check"),
        (pickle.dumps([1]), "a pickle; pickles, which could run any code"),
        ('{"people": []}'.encode("utf-16"), "UTF-16 text; save it as UTF-8"),
        (zipped("xl/workbook.xml"), "an Excel workbook; save its sheet as CSV"),
        (zipped("a/data.pkl", "a/version"), "a PyTorch checkpoint, which holds pickles; pickles,"),
        (zipped("1_keypoints.json"), "a ZIP archive; unpack it"),
        (b"<!DOCTYPE html><html>", "a web page, perhaps of a download that failed"),
    ],
)
def test_files_of_another_kind_say_what_they_seem_to_be(data: bytes, kind: str) -> None:
    with pytest.raises(BadInput, match=f"a file looks like {kind}"):
        read(data)


REFUSALS = {
    "instances: a number for a row": (
        json.dumps([{"keypoints": [[1, 2, 3], 4]}]).encode(),
        "point 1 of record 0 of a file is 4 where a JSON array",
    ),
    "instances: four numbers": (
        json.dumps([{"keypoints": [[1, 2, 3, 4]]}]).encode(),
        r"point 0 of record 0 .* where \[x, y\] or \[x, y, score\]",
    ),
    "instances: scores": (
        json.dumps({"keypoints": [[[1, 2]] * 17], "scores": [[1] * 16]}).encode(),
        "person 0 of a file has 17 keypoints but 16 scores",
    ),
    "instances: people": (
        json.dumps({"keypoints": [[[1, 2]] * 17], "scores": []}).encode(),
        "has 1 people but scores of 0",
    ),
    "instances: labels": (
        json.dumps([[{"keypoints": [[1, 2]] * 2, "scores": [1, 1], "labels": [3, 3]}]]).encode(),
        r"has 2 keypoints, but the labels \[3, 3\]",
    ),
    "instances: a label beyond": (
        json.dumps([[{"keypoints": [[1, 2]], "scores": [1], "labels": [99]}]]).encode(),
        "has the label 99, but coco_17 17 points",
    ),
    "mpii: fifteen": (
        json.dumps([mpii(joints=[[1, 2]] * 15)]).encode(),
        "has 15 joints and joints_vis of 16 where MPII's 16",
    ),
    "mpii: scores": (
        json.dumps([mpii(joints_vis=[0.5] * 16)]).encode(),
        "joints_vis of right_ankle in record 0 .* is 0.5 where 0 or 1",
    ),
    "tensorflow.js: no name": (
        json.dumps(
            [listed_points(COCO_17), {"keypoints": [{"x": 1, "y": 2, "score": 1}]}]
        ).encode(),
        "a point of record 1 of a file has no name",
    ),
    "vision: pixels": (
        json.dumps({"root": {"x": 300, "y": 2, "confidence": 1}}).encode(),
        "a point 300 images from the corner, where fractions of the image are",
    ),
    "vision: no y": (
        json.dumps({"root": {"x": 0.3, "confidence": 1}}).encode(),
        "y of root of person 0 of a file is None where a number",
    ),
    "rtmlib: shapes": (
        npz(keypoints=np.ones((2, 17, 2)), scores=np.ones((2, 16))),
        r"has keypoints \(2, 17, 2\) and scores \(2, 16\)",
    ),
    "sleap: dims": (
        hdf5(lambda f: (sleap(f), f["tracks"].attrs.__setitem__("dims", "[[1]]"))),
        "has the shape .* and the dimensions .* not track, xy, node, frame",
    ),
    "sleap: names": (
        hdf5(
            lambda f: (
                sleap(f),
                f.__delitem__("node_names"),
                f.create_dataset("node_names", data=np.arange(13)),
            )
        ),
        "node_names of a file is no list of texts",
    ),
    "ultralytics: fewer points": (
        json.dumps([yolo(keypoints={"x": [1, 2], "y": [3, 4]})]).encode(),
        "'x' of record 0 of a file has 2 numbers where COCO's 17 points are needed",
    ),
    "ultralytics: no y": (
        json.dumps([yolo(keypoints={"x": [1] * 17})]).encode(),
        "'y' of record 0 of a file is None where a JSON array",
    ),
    "ultralytics: boxes after a person": (
        json.dumps([yolo(), {"name": "dog", "class": 16}]).encode(),
        "'keypoints' of record 1 of a file is None where a JSON object",
    ),
    "ultralytics: a short line": (
        (yolo_text(3) + "0 0.5 0.5\n").encode(),
        "line 2 of a file has 3 numbers, but a person of 17 points has 39, 40, 41, 56",
    ),
    "ultralytics: a word": (
        (yolo_text(3) + yolo_text(3).replace("0.25", "left", 1)).encode(),
        "line 2 of a file holds 'left' where a number",
    ),
    "ultralytics: pixels in text": (
        yolo_text(3).replace("0.25", "250").encode(),
        "a point 250 images from the corner, where fractions of the image are",
    ),
    "coco: names that are none": (
        named_annotations(MPII, keypoints=[1, 2]),
        r"'keypoints' of category 0 of a file are \[1, 2\] where names are needed",
    ),
    "coco: one joint twice": (
        named_annotations([*MPII[:-1], "LHip"]),
        "several body parts that are left_hip; give a map of names",
    ),
    "coco: nothing known": (
        named_annotations(MPII, keypoints=[f"point {n}" for n in range(15)]),
        "none of the body parts of a file .* is a joint known here; give a map of names",
    ),
    "csv: a word": (
        named_columns().replace(",0.5", ",left", 1).encode(),
        "row 2 of a file holds 'left' where a number",
    ),
    "csv: a cell too few": (
        named_columns()[:-5].encode(),
        "row 3 of a file has .* cells, but the header",
    ),
    "csv: one joint twice": (
        named_columns({"LHip": "left_hip", "left_hip": "left_hip", **PARTS}).encode(),
        "several body parts that are left_hip",
    ),
    "mediapipe: pixels": (
        json.dumps([row | {"x": 300} for row in landmarks()]).encode(),
        "fractions of the image",
    ),
    "mediapipe: 32": (
        json.dumps(landmarks()[:-1]).encode(),
        "has 32 landmarks where 33 are needed",
    ),
    "mediapipe: text cut": (landmark_text()[:-3].encode(), "ends inside a block"),
    "mediapipe: rows cut": (long_landmarks().rsplit("\n", 2)[0].encode(), "32 rows of landmarks"),
    "mmpose: points": (
        json.dumps([mmpose_instance(COCO_17) | {"keypoints": [[0, 0]] * 15}]).encode(),
        "holds 15 points of a person; no order known here has so many",
    ),
    "mmpose: scores": (
        json.dumps([mmpose_instance(COCO_17) | {"keypoint_scores": [1] * 3}]).encode(),
        "17 keypoints but 3 scores",
    ),
    "mmpose: meta": (
        json.dumps(mmpose(COCO_17, keypoint_id2name={"1": "nose"})).encode(),
        "does not name the points",
    ),
    "alphapose: count": (
        json.dumps({"a.jpg": {"people": [{"pose_keypoints_2d": [1, 2, 3]}]}}).encode(),
        "holds 1 points of a person; no order known here",
    ),
    "deeplabcut: header": (
        table([["scorer", "a"], ["0", "1"]]).encode(),
        "no rows 'bodyparts' and 'coords'",
    ),
    "deeplabcut: word": (
        table([*deeplabcut_rows()[:-1], ["x"] * 40]).encode(),
        "holds 'x' where a number",
    ),
    "videopose3d: shape": (
        npz(**{"S1/walk/0": np.zeros((4, 16, 2))}),
        r"not \(frames, 17, 2 or 3\) of h36m_17",
    ),
    "videopose3d: own": (npz(positions_2d=np.zeros(3)), "pickles its arrays in a dictionary"),
    "heatmaps: layout": (
        npz(heatmaps=np.zeros((15, 8, 8))),
        "holds 15 points of a person; no order known here has so many",
    ),
    "heatmaps: nan": (npz(heatmaps=np.full((16, 8, 8), np.nan)), "not finite"),
    "heatmaps: box": (
        npz(heatmaps=np.ones((16, 8, 8)), box=np.zeros((1, 4))),
        "size that is not positive",
    ),
    "hourglass: shape": (
        hdf5(lambda f: f.create_dataset("preds", data=np.zeros(4))),
        "not .people, joints, 2 or 3",
    ),
    "hdf5: nothing known": (
        hdf5(lambda f: f.create_dataset("poses", data=np.zeros(4))),
        "not known here",
    ),
    "hdf5: cut": (FILES["hourglass"][0][:900], r"not known here|no file of arrays"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(name: str) -> None:
    data, match = REFUSALS[name]
    with pytest.raises(BadInput, match=match) as error:
        read(data)
    assert str(error.value).endswith(".")
    assert "\n" not in str(error.value)


# Folders and frames.


def test_a_folder_is_read_frame_by_frame_in_the_order_of_numbers(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        people = [flat(BODY_25.points)] * (number % 3)
        (tmp_path / f"walk_{number}_keypoints.json").write_text(json.dumps(openpose(*people)))
    (tmp_path / ".hidden").write_text("no")
    frames = list(read_frames(tmp_path))
    assert [(frame.name, len(frame.people)) for frame in frames] == [
        ("walk_1", 1),
        ("walk_2", 2),
        ("walk_10", 1),
    ]


def test_a_folder_decides_once_which_order_its_25_points_have(tmp_path: Path) -> None:
    hand = flat(BODY_25.points, missing=tuple(set(BODY_25.points) - {"right_wrist"}))
    (tmp_path / "0.json").write_text(json.dumps(openpose(hand)))
    with pytest.raises(BadInput, match="too few are seen to tell BODY_25 from BODY_25B"):
        list(read_frames(tmp_path))
    (tmp_path / "1.json").write_text(json.dumps(openpose(flat(BODY_25.points))))
    assert [frame.people[0].layout for frame in read_frames(tmp_path)] == ["body_25"] * 2


def test_a_frame_with_nobody_is_a_frame(tmp_path: Path) -> None:
    (tmp_path / "0.json").write_text(json.dumps(openpose()))
    (tmp_path / "1.json").write_text(json.dumps(openpose(flat(COCO_18.points))))
    assert [len(frame.people) for frame in read_frames(tmp_path)] == [0, 1]


def test_a_file_of_many_images_has_many_frames(shared_data: Path) -> None:
    frames = list(read_frames(shared_data / COCO))
    counts = {"785": 1, "40083": 2, "196141": 4, "197388": 5}
    assert {frame.name: len(frame.people) for frame in frames} == counts
    assert [frame.name for frame in read_frames(shared_data / ALPHAPOSE)][:2] == [
        "92.jpg",
        "93.jpg",
    ]


def test_a_long_list_that_is_broken_at_its_end_is_refused_before_its_first_frame(
    tmp_path: Path,
) -> None:
    records = json.dumps(results(flat(COCO_17.points))[0])
    (tmp_path / "a.json").write_text(f"[{records}, {records.replace('a.jpg', 'b.jpg')}, broken")
    frames = read_frames(tmp_path / "a.json")
    with pytest.raises(BadInput, match="not valid JSON"):
        next(frames)


def test_folders_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="holds no files"):
        read_frames(tmp_path)
    (tmp_path / "0.json").write_text(json.dumps(openpose(flat(COCO_18.points))))
    (tmp_path / "1.json").write_text(json.dumps(results(flat(COCO_17.points))))
    with pytest.raises(BadInput, match="differ in format"):
        read_frames(tmp_path)
    with pytest.raises(BadInput, match="there is no file of 2D joints at"):
        read_frames(tmp_path / "none")


def test_every_file_of_a_folder_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a few of them once more before, to tell the format; how long 10,000 take is measured by
    `make bench`."""
    text = json.dumps(openpose(flat(BODY_25.points)))
    for number in range(200):
        (tmp_path / f"{number:012d}_keypoints.json").write_text(text)
    opened: list[str] = []
    read = formats.read_bytes
    monkeypatch.setattr(
        formats, "read_bytes", lambda path, *_, **__: opened.append(path.name) or read(path, "", "")
    )
    frames = read_frames(tmp_path)
    probed = len(opened)
    assert sum(len(frame.people) for frame in frames) == 200
    assert probed == PROBES
    assert opened[probed:] == sorted(opened[probed:])
    assert len(opened) == probed + 200


# Where the joints are.


def test_correction_moves_midpoints_to_where_the_skeleton_has_them() -> None:
    """On the embedded torsos themselves: shoulders and hips given, midpoints corrected, thorax and
    pelvis nearer."""
    torsos = Anatomy.default().torsos  # pelvis, thorax, shoulders, hips
    shoulders, hips = (torsos[:, 2] + torsos[:, 3]) / 2, (torsos[:, 4] + torsos[:, 5]) / 2
    line = (hips - shoulders).mean(axis=0)
    for name, joint, midpoint, other in (
        ("thorax", torsos[:, 1], shoulders, hips),
        ("pelvis", torsos[:, 0], hips, shoulders),
    ):
        step = line if name == "thorax" else -line
        share = (joint - midpoint).mean(axis=0) @ step / (step @ step)
        assert share == pytest.approx(TOWARDS_THE_OTHER[name], abs=2e-3)
        left = joint - midpoint - TOWARDS_THE_OTHER[name] * (other - midpoint)
        stray = np.sqrt(np.mean(np.sum(left**2, axis=1)) / 3)
        assert stray == pytest.approx(STRAY[name], abs=1e-3)
    across = torsos[:, 3] - torsos[:, 2] + torsos[:, 5] - torsos[:, 4]
    size = np.linalg.norm(hips - shoulders, axis=1)
    back = np.cross(across, hips - shoulders)
    back *= (size / np.linalg.norm(back, axis=1))[:, None]
    for name, joint, midpoint in (
        ("thorax", torsos[:, 1], shoulders),
        ("pelvis", torsos[:, 0], hips),
    ):
        behind = np.mean(np.sum((joint - midpoint) * back, axis=1) / size**2)
        assert behind == pytest.approx(BEHIND[name], abs=1e-3)


def test_midpoints_in_space_are_moved_to_where_torsos_have_them() -> None:
    """Torsos of the package with midpoints for thorax and pelvis, turned any way round and of any
    size: moved, both lie within 24 mm of their own (root mean square, a body unit being 350 mm),
    the pelvis as far as it was before if it is moved to the other side of the line. What is no
    midpoint stays, and so do all other joints."""
    torsos = Anatomy.default().torsos
    joints = np.zeros((len(torsos), NUM_JOINTS, 3))
    joints[:, list(TORSO_INDEX)] = torsos
    turns = Rotation.random(len(torsos), rng=0).as_matrix()
    size = np.random.default_rng(0).uniform(0.5, 700.0, len(torsos))[:, None, None]
    truth = size * np.einsum("nij,nkj->nki", turns, joints) + 40.0
    halfway = truth.copy()
    for name, sides in MIDPOINTS.items():
        halfway[:, JOINT_INDEX[name]] = truth[:, [JOINT_INDEX[side] for side in sides]].mean(axis=1)

    def off(found: np.ndarray, name: str) -> float:
        gap = (found - truth)[:, JOINT_INDEX[name]] / size[:, 0]
        return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))

    moved = without_midpoints(halfway, BOTH)
    assert off(moved, "thorax") < 0.07 < 0.19 < off(halfway, "thorax")
    assert off(moved, "pelvis") < 0.1 < 0.3 < off(halfway, "pelvis")
    mirrored = without_midpoints(halfway * [-1, 1, 1], BOTH) * [-1, 1, 1]
    assert off(mirrored, "pelvis") > 0.22
    others = [row for row in range(NUM_JOINTS) if row not in map(JOINT_INDEX.get, BOTH)]
    np.testing.assert_array_equal(moved[:, others], halfway[:, others])
    half = without_midpoints(truth, ("pelvis",))
    np.testing.assert_array_equal(half[:, JOINT_INDEX["thorax"]], truth[:, JOINT_INDEX["thorax"]])
    np.testing.assert_array_equal(without_midpoints(truth, ()), truth)


BOTH = ("thorax", "pelvis")
OWN_17 = Layout("own", H36M_17.points)


def leaning(layout: Layout) -> Detection:
    """A person whose thorax and pelvis, if the layout has them, lie beside the midpoints."""
    rows = points(layout)
    for name in set(BOTH) & set(layout.points):
        rows[layout.points.index(name), 0] += 3.0
    return layout.detection(rows, 0.0, "a file", 0)


@pytest.mark.parametrize(
    ("layout", "moved"),
    [(COCO_17, BOTH), (MPII_16, BOTH), (HALPE_26, BOTH), (H36M_17, ("pelvis",)), (OWN_17, ())],
    ids=lambda value: value.name if isinstance(value, Layout) else "",
)
def test_correction_touches_midpoints_only(layout: Layout, moved: tuple[str, ...]) -> None:
    person = leaning(layout)
    after = corrected(person)
    different = [
        name
        for name, one, other in zip(JOINTS, person.keypoints, after.keypoints, strict=True)
        if not np.array_equal(one, other, equal_nan=True)
    ]
    assert after.moved == moved
    assert sorted(different) == sorted(moved)
    np.testing.assert_array_equal(corrected(after).keypoints, after.keypoints)


def test_correction_by_hand() -> None:
    person = corrected(COCO_17.detection(points(COCO_17), 0.0, "a file", 0))
    np.testing.assert_allclose(person.keypoints[JOINT_INDEX["thorax"]], [50, 30 + 0.124 * 50])
    np.testing.assert_allclose(person.keypoints[JOINT_INDEX["pelvis"]], [50, 80 - 0.194 * 50])


def test_a_missed_pelvis_is_a_midpoint_whatever_its_layout_says(tmp_path: Path) -> None:
    """And so it is in a file of ours, which does not name the detector's layout."""
    given = points(OWN_17)
    given[OWN_17.points.index("pelvis"), 2] = 0.0
    given[OWN_17.points.index("thorax"), 0] += 3.0
    person = OWN_17.detection(given, 0.0, "a file", 0)
    assert corrected(person).moved == ("pelvis",)
    write_detections(tmp_path / "ours.json", [person])
    (again,) = read_detections(tmp_path / "ours.json")
    assert corrected(again).moved == ("pelvis",)


def test_a_midpoint_without_its_counterpart_stays() -> None:
    given = points(COCO_17)
    given[COCO_17.points.index("left_hip"), 2] = 0.0
    person = COCO_17.detection(given, 0.0, "a file", 0)
    assert corrected(person) is person


# The face, and writing.


def test_the_face_is_read_where_there_is_one(shared_data: Path) -> None:
    (walker,) = read_detections(shared_data / SPIN)
    assert walker.face is not None
    assert [name for name, row in zip(FACE, walker.face, strict=True) if row[2] > 0] == [
        "nose",
        "left_eye",
        "right_eye",
        "left_ear",
    ]
    behind, _ = read_detections(shared_data / HMR)
    assert behind.face is not None
    assert (behind.face[:3, 2] == 0).all()  # seen from behind: neither nose nor eyes
    assert read_detections(shared_data / POSE2SIM)[0].face is not None


@settings(
    deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(detections())
def test_frames_and_file_are_the_same_after_writing(
    tmp_path: Path, people: list[Detection]
) -> None:
    write_detections(tmp_path / "out.json", people)
    again = [person for frame in read_frames(tmp_path / "out.json") for person in frame.people]
    again.sort(key=lambda person: person.person)  # frames come in the order of their numbers
    there = [person for person in people if person.seen.any()]  # nobody else is in a frame
    assert all(same(one, other) for one, other in zip(there, again, strict=True))


def test_mediapipe_has_the_points_it_says() -> None:
    assert MEDIAPIPE_33.count == 33
    assert MEDIAPIPE_33.points[11] == "left_shoulder"
    assert MEDIAPIPE_33.points[28] == "right_ankle"
