"""Readers of 2D joints: real files by hand, every refusal in a table, and arbitrary or damaged
content."""

import copy
import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from poseterior.probmodel import files, formats
from poseterior.probmodel.detections import LONGEST_LABEL, Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats import (
    FORMATS,
    Content,
    read_content,
    read_detections,
    write_detections,
)
from poseterior.probmodel.layouts import BODY_25, BODY_25B, COCO_17, COCO_18
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS

OPENPOSE = "detections/openpose/"
SPIN = OPENPOSE + "body25_spin_im1010_keypoints.json"
SIGNER = OPENPOSE + "body25_openposer_du_wohn_wo_000000000030_keypoints.json"
HMR = OPENPOSE + "coco18_hmr_random_keypoints.json"
POSE2SIM = OPENPOSE + "body25b_pose2sim_cam02.0022.json"
COCO = "detections/coco/test_coco.json"
ALPHAPOSE = "detections/alphapose/alphapose-results_halpe26.json"

STANDING = {
    "nose": (50, 12),
    "left_eye": (52, 10),
    "right_eye": (48, 10),
    "left_ear": (56, 11),
    "right_ear": (44, 11),
    "head": (50, 0),
    "upper_neck": (50, 22),
    "thorax": (50, 30),
    "pelvis": (50, 80),
    "left_shoulder": (66, 30),
    "right_shoulder": (34, 30),
    "left_elbow": (72, 56),
    "right_elbow": (28, 56),
    "left_wrist": (74, 80),
    "right_wrist": (26, 80),
    "left_hip": (60, 80),
    "right_hip": (40, 80),
    "left_knee": (61, 120),
    "right_knee": (39, 120),
    "left_ankle": (61, 160),
    "right_ankle": (39, 160),
    "left_heel": (61, 167),
    "right_heel": (39, 167),
    "left_big_toe": (64, 170),
    "right_big_toe": (36, 170),
    "left_small_toe": (70, 169),
    "right_small_toe": (30, 169),
}
"""A person who stands upright and faces the camera, so that their right is on the left of the
image."""


def flat(points: tuple[str, ...], score: float = 0.5, missing: tuple[str, ...] = ()) -> list[float]:
    """`STANDING` in the order of `points`, as a flat list."""
    return [
        n for name in points for n in ((0, 0, 0) if name in missing else (*STANDING[name], score))
    ]


def openpose(*people: list[Any], key: str = "pose_keypoints_2d") -> dict[str, Any]:
    return {"version": 1.3, "people": [{key: person} for person in people]}


def native(**keypoints: Any) -> dict[str, Any]:
    return {"format": "poseterior-detections", "version": 1, "people": [{"keypoints": keypoints}]}


def annotations(*records: dict[str, Any], **other: Any) -> dict[str, Any]:
    return {
        "annotations": [{"image_id": 7, "category_id": 1} | record for record in records]
    } | other


def results(*lists: list[Any]) -> list[dict[str, Any]]:
    return [
        {"image_id": "a.jpg", "category_id": 1, "keypoints": keypoints, "score": 3.1}
        for keypoints in lists
    ]


def read(document: Any, format: str = "auto", threshold: float | None = None) -> list[Detection]:
    data = document if isinstance(document, bytes) else json.dumps(document).encode()
    return read_content(Content(data, "a.json"), format, threshold)


def point(detection: Detection, name: str) -> list[float]:
    """x, y and score."""
    joint = JOINT_INDEX[name]
    return [*detection.keypoints[joint].tolist(), float(detection.score[joint])]


def missing(detection: Detection) -> set[str]:
    return {name for name, seen in zip(JOINTS, detection.seen, strict=True) if not seen}


def same(one: Detection, other: Detection) -> bool:
    return (
        np.array_equal(one.keypoints, other.keypoints, equal_nan=True)
        and np.array_equal(one.score, other.score)
        and (one.face is None) == (other.face is None)
        and (one.face is None or np.array_equal(one.face, other.face, equal_nan=True))
        and (one.person, one.image_id, one.image_size)
        == (other.person, other.image_id, other.image_size)
    )


# Real files, values copied by hand.


def test_openpose_side_view_with_one_arm_hidden(shared_data: Path) -> None:
    (person,) = read_detections(shared_data / SPIN)
    assert missing(person) == {"right_elbow", "right_wrist", "head"}
    assert (person.layout, person.person, person.image_id, person.image_size) == (
        "body_25",
        0,
        None,
        None,
    )
    assert person.source == str(shared_data / SPIN)
    assert point(person, "thorax") == [78.5691, 57.8892, 0.628322]
    assert point(person, "pelvis") == [77.7931, 96.9218, 0.588614]
    assert point(person, "left_wrist") == [77.7917, 97.9535, 0.769904]
    assert point(person, "right_ankle") == [35.916, 151.465, 0.627472]


@pytest.mark.parametrize("frame", [30, 31, 32])
def test_openpose_upper_body(shared_data: Path, frame: int) -> None:
    (person,) = read_detections(shared_data / SIGNER.replace("030", f"0{frame}"))
    assert missing(person) == {"right_knee", "right_ankle", "left_knee", "left_ankle", "head"}
    assert person.layout == "body_25"


def test_threshold_hides_the_joints_up_to_it(shared_data: Path) -> None:
    """The signer's hips (0.08) and pelvis (0.0999) lie under the table; the wrists have 0.154268
    and 0.159902."""
    (person,) = read_detections(shared_data / SIGNER, threshold=0.154268)
    lower_body = {
        f"{side}_{name}" for side in ("right", "left") for name in ("hip", "knee", "ankle")
    }
    assert missing(person) == lower_body | {"pelvis", "head", "right_wrist"}


def test_openpose_old_key_two_people_seen_from_behind(shared_data: Path) -> None:
    first, second = read_detections(shared_data / HMR)
    assert (first.layout, first.person, second.person) == ("coco_18", 0, 1)
    assert missing(first) == {"head"}
    assert missing(second) == {"head", "right_knee", "right_ankle", "left_knee", "left_ankle"}
    assert point(first, "right_wrist") == [
        629.549,
        141.459,
        0.900523,
    ]  # from behind: right is right
    assert point(first, "pelvis") == pytest.approx(
        [(469.953 + 419.844) / 2, (358.601 + 354.921) / 2, 0.59669]
    )


def test_openpose_of_another_layout_than_the_one_asked_for() -> None:
    with pytest.raises(
        BadInput,
        match=r"person 0 of a.json holds 18 points of a person, but body_25 has 25; name",
    ):
        read(openpose(flat(COCO_18.points)), "openpose-body25")


def test_openpose_body_25b_is_not_taken_for_body_25(shared_data: Path) -> None:
    first, second = read_detections(shared_data / POSE2SIM)
    assert {first.layout, second.layout} == {"body_25b"}
    assert not missing(first)
    assert not missing(second)
    assert point(first, "head") == [652.564, 426.414, 0.602801]
    assert point(first, "right_wrist") == [389.51, 526.378, 0.627155]
    assert point(first, "left_ankle") == [573.468, 1072.95, 0.677409]
    assert point(first, "thorax") == pytest.approx(
        [(689.27 + 563.134) / 2, (589.34 + 526.339) / 2, 0.659958]
    )


def test_coco_annotations(shared_data: Path) -> None:
    people = read_detections(shared_data / COCO)
    assert [person.person for person in people] == list(
        range(12)
    )  # 14 annotations, two of them without keypoints
    assert [person.image_id for person in people] == ["785"] + ["40083"] * 2 + ["196141"] * 4 + [
        "197388"
    ] * 5
    skier = people[0]
    assert (skier.layout, skier.image_size) == ("coco_17", (640, 425))
    assert missing(skier) == {"head"}
    assert point(skier, "right_wrist") == [309, 178, 1]  # she faces the camera, pole to the left
    assert point(skier, "left_ankle") == [466, 362, 1]
    assert point(skier, "thorax") == [378.5, 118.5, 1]
    assert point(skier, "pelvis") == [408.5, 208.5, 1]


def test_alphapose_halpe_26(shared_data: Path) -> None:
    people = read_detections(shared_data / ALPHAPOSE)
    records = json.loads((shared_data / ALPHAPOSE).read_text())
    assert (len(people), people[0].layout, people[0].image_id, missing(people[0])) == (
        20,
        "halpe_26",
        "92.jpg",
        set(),
    )
    assert point(people[0], "left_shoulder") == records[0]["keypoints"][15:18]
    assert point(people[0], "head") == [172.09703063964844, 125.73633575439453, 0.9713329672813416]
    short = read(
        [record | {"keypoints": record["keypoints"][:51]} for record in records]
    )  # Halpe begins with COCO's
    assert {person.layout for person in short} == {"coco_17"}
    assert missing(short[0]) == {"head"}


@pytest.mark.parametrize(
    ("file", "match"),
    [
        (
            "detections/coco/test_coco_det_AP_H_56.json",
            "record 0 of .* has no 'keypoints', but .* not one of boxes",
        ),
        ("detections/coco/000000000785.jpg", "looks like a photo .JPEG.; run a detector on it"),
        ("bvh/cmu_131_03.bvh", "looks like motion capture .BVH.; 3D poses are for check"),
        ("cmu/asfamc/01/01.asf", "looks like a skeleton of motion capture .ASF."),
        ("cmu/asfamc/01/01_01.amc", "looks like motion capture .AMC."),
        ("akhter_black/testPose.mat", "looks like a MATLAB file"),
        (
            "detections/mediapipe/pose_landmarks_webcam.json",
            "fractions of an image whose size .*--image-size 640x480",
        ),
        ("detections/mediapipe/pose_landmarks.pbtxt", "fractions of an image whose size"),
        ("detections/README.md", "is of a shape that is not known here"),
        ("detections", "is a folder, not a file"),
        ("detections/none.json", "there is no file of 2D joints at"),
    ],
)
def test_real_files_of_other_kinds(shared_data: Path, file: str, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        read_detections(shared_data / file)


# Layouts.


@pytest.mark.parametrize(
    ("document", "layout", "joints"),
    [
        (openpose(flat(BODY_25.points)), "body_25", set(JOINTS) - {"head"}),
        (openpose(flat(BODY_25B.points)), "body_25b", set(JOINTS)),
        (openpose(flat(COCO_18.points), key="pose_keypoints"), "coco_18", set(JOINTS) - {"head"}),
        (results(flat(COCO_17.points)), "coco_17", set(JOINTS) - {"head"}),
        (annotations({"keypoints": flat(COCO_17.points, 1)}), "coco_17", set(JOINTS) - {"head"}),
        (native(**{name: [*STANDING[name], 0.5] for name in JOINTS}), "poseterior", set(JOINTS)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_every_layout_reads_the_same_person(document: Any, layout: str, joints: set[str]) -> None:
    (person,) = read(document)
    assert person.layout == layout
    assert missing(person) == set(JOINTS) - joints
    for name in joints:
        assert point(person, name) == [*STANDING[name], 0.5], name


@pytest.mark.parametrize("layout", [BODY_25, BODY_25B, COCO_18, COCO_17])
def test_left_and_right_are_not_swapped(layout: Any) -> None:
    document = results(flat(layout.points)) if layout is COCO_17 else openpose(flat(layout.points))
    keypoints = read(document)[0].keypoints
    for name in JOINTS:
        if name.startswith("left"):
            assert (
                keypoints[JOINT_INDEX[name], 0]
                > keypoints[JOINT_INDEX[name.replace("left", "right")], 0]
            )


def test_missed_neck_and_hip_centre_are_midpoints() -> None:
    (person,) = read(openpose(flat(BODY_25.points, missing=("thorax", "pelvis", "left_hip"))))
    assert point(person, "thorax") == [50, 30, 0.5]
    assert {"pelvis", "left_hip"} < missing(person)


def test_midpoint_has_the_smaller_score_and_obeys_the_threshold() -> None:
    keypoints = flat(COCO_17.points, 0.9)
    keypoints[3 * 5 + 2] = 0.2  # the left shoulder
    assert point(read(results(keypoints))[0], "thorax")[2] == 0.2
    assert "thorax" in missing(read(results(keypoints), threshold=0.2)[0])


def test_visibility_of_annotations_becomes_a_score() -> None:
    keypoints = flat(COCO_17.points, 2)
    keypoints[3 * 9 + 2], keypoints[3 * 10 + 2] = 1, 0  # wrists: occluded, not labelled
    (person,) = read(annotations({"keypoints": keypoints}))
    assert point(person, "left_wrist")[2] == 0.5
    assert point(person, "left_elbow")[2] == 1
    assert "right_wrist" in missing(person)


# BODY_25 or BODY_25B?

WRONG = {"body_25": BODY_25B, "body_25b": BODY_25}


@pytest.mark.parametrize("layout", [BODY_25, BODY_25B])
def test_a_name_forces_the_order(layout: Any) -> None:
    document = openpose(flat(layout.points))
    wrong = WRONG[layout.name]
    assert read(document, f"openpose-{wrong.name.replace('_', '')}")[0].layout == wrong.name
    assert read(document, "openpose")[0].layout == layout.name


def test_too_few_points_to_tell_the_order_are_refused_unless_named() -> None:
    arm = ("right_shoulder", "right_elbow", "right_wrist")
    document = openpose(flat(BODY_25.points, missing=tuple(set(BODY_25.points) - set(arm))))
    with pytest.raises(
        BadInput,
        match=r"a\.json has 25 points a person, but too few are seen .* openpose-body25 or",
    ):
        read(document)
    assert set(JOINTS) - missing(read(document, "openpose-body25")[0]) == set(arm)


def test_people_who_are_clear_decide_for_those_who_are_not() -> None:
    hand = flat(BODY_25.points, missing=tuple(set(BODY_25.points) - {"right_wrist"}))
    assert [person.layout for person in read(openpose(hand, flat(BODY_25.points)))] == [
        "body_25"
    ] * 2


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from([BODY_25, BODY_25B]),
    st.sets(st.integers(0, 24), max_size=18),
    st.integers(0, 999),
)
def test_the_order_is_never_mistaken_whatever_is_missing(
    layout: Any, gone: set[int], seed: int
) -> None:
    """With noise of 1 pixel (the person is 170 tall) and any points missing: the right order, or a
    refusal."""
    points = np.array(flat(layout.points)).reshape(25, 3)
    points[:, :2] += np.random.default_rng(seed).normal(size=(25, 2))
    points[sorted(gone)] = 0
    try:
        assert read(openpose(points.ravel().tolist()))[0].layout == layout.name
    except BadInput:
        assert len(gone) > 4


# Refusals.

REAL_25, REAL_17 = flat(BODY_25.points), flat(COCO_17.points)
LABELLED = flat(COCO_17.points, 2)
PERSON_CATEGORY = {"id": 1, "name": "person", "keypoints": list(COCO_17.points)}


def put(values: list[Any], index: int, value: Any) -> list[Any]:
    return [*values[:index], value, *values[index + 1 :]]


def native_with(**fields: Any) -> dict[str, Any]:
    document = native(head=[1, 2, 3])
    document["people"][0] |= fields
    return document


REFUSALS: list[tuple[Any, str]] = [
    (b" \n", "a.json is empty; check what wrote it"),
    (b'{"people": [\n  1,,]}', "not valid JSON: .* at line 2, column 5"),
    (b"\xff{\x00}\x00", "not UTF-8 text"),
    (b"[" * 200_000 + b"]" * 200_000, "nested too deeply"),
    (b'{"a":' * 200_000, "nested too deeply"),
    (b'{"people": [' + b"9" * 5000 + b"]}", "thousands of digits"),
    (None, "of a shape that is not known"),
    (3, "of a shape that is not known"),
    ({}, "the known ones are: .*openpose.*coco"),
    ([1], "of a shape that is not known"),
    ([{}], "of a shape that is not known"),
    ([], r"a\.json has no person in it"),
    # OpenPose
    (openpose(), "has no person in it"),
    (
        openpose([]),
        r"person 0 of a\.json holds 0 numbers, where x, y and score of each point are needed",
    ),
    (openpose(REAL_25[:-1]), "person 0 of .* holds 74 numbers, where x, y and score"),
    (
        openpose(REAL_25, REAL_25[:45]),
        "person 1 of .* holds 15 points of a person; no order known here",
    ),
    (openpose([0] * 75), "no joint of any person .* above the threshold 0"),
    (openpose([0] * 54), "no joint of any person .* above the threshold 0"),
    (
        openpose(put(REAL_25, 7, "12")),
        "y of right_shoulder in person 0 of .* is '12' where a number",
    ),
    (
        openpose(put(REAL_25, 7, None)),
        "y of right_shoulder in person 0 of .* is None where a number",
    ),
    (
        openpose(put(REAL_25, 7, True)),
        "y of right_shoulder in person 0 of .* is True where a number",
    ),
    (openpose(put(REAL_25, 7, [1])), r"is \[1\] where a number"),
    (openpose(put(REAL_25, 7, float("nan"))), "y of right_shoulder .* is nan, which is not finite"),
    (
        openpose(put(REAL_25, 7, float("-inf"))),
        "y of right_shoulder .* is -inf, which is not finite",
    ),
    (openpose(put(REAL_25, 7, 10**400)), r"y of right_shoulder .* which is beyond ±1e\+09"),
    (openpose(put(REAL_25, 7, 1e12)), r"which is beyond ±1e\+09"),
    (
        openpose(put(REAL_25, 8, -0.1)),
        "score of right_shoulder in person 0 of .* is -0.1, which is negative",
    ),
    ({"people": None}, "'people' of a.json is None where a JSON array"),
    ({"people": [[]]}, r"person 0 of a.json is \[\] where a JSON object"),
    ({"people": [{}]}, "person 0 of a.json has neither 'pose_keypoints_2d' nor 'pose_keypoints'"),
    (
        {"people": [{"pose_keypoints_2d": {}}]},
        "'pose_keypoints_2d' of person 0 .* where a JSON array",
    ),
    # COCO results
    (
        results(REAL_17, REAL_17[:-1]),
        "'keypoints' of record 1 of .* holds 50 numbers, where x, y and score of each point are",
    ),
    (results(put(REAL_17, 2, -1)), "score of nose in record 0 of .* is -1, which is negative"),
    (results(put(REAL_17, 0, float("nan"))), "x of nose in record 0 .* not finite"),
    (results([0] * 51), "no joint of any person"),
    ([*results(REAL_17), 5], "record 1 of a.json is 5 where a JSON object"),
    (
        [{"image_id": 1, "bbox": [1, 2, 3, 4]}],
        "record 0 of a.json has no 'keypoints', but .* not one of boxes",
    ),
    (
        [{"image_id": 1, "keypoints": None}],
        "'keypoints' of record 0 of a.json is None where a JSON array",
    ),
    (
        [{"image_id": 1, "category_id": 3, "keypoints": REAL_17}],
        "record 0 .* of the category 3, .* not a person",
    ),
    (
        [{"image_id": [], "keypoints": REAL_17}],
        r"image_id of record 0 .* is \[\] where a whole number or a name",
    ),
    # COCO annotations
    (annotations(), "has no person in it"),
    (annotations({}), "no annotation in a.json has keypoints"),
    (annotations({"keypoints": [0] * 51}), "no annotation in a.json has keypoints"),
    (
        annotations({"keypoints": put(LABELLED, 2, 3)}),
        "visibility of nose in annotation 0 .* is 3, but .* 0, 1 or 2",
    ),
    (
        annotations({"keypoints": put(LABELLED, 2, 0.7)}),
        "visibility of nose in annotation 0 of .* is 0.7",
    ),
    (
        annotations({"keypoints": LABELLED}, {"category_id": 18}),
        "annotation 1 of .* of the category 18",
    ),
    (
        annotations({"keypoints": LABELLED, "category_id": []}),
        r"annotation 0 .* of the category \[\]",
    ),
    (
        annotations({"keypoints": LABELLED, "category_id": True}),
        "annotation 0 .* of the category True",
    ),
    (
        annotations({"keypoints": LABELLED}, categories=[{"id": 1, "name": "dog"}]),
        "category 1, .* not a person",
    ),
    (
        annotations(
            {"keypoints": LABELLED},
            categories=[PERSON_CATEGORY | {"keypoints": list(COCO_18.points)}],
        ),
        "'keypoints' of annotation 0 of a.json holds 17 points of a person, but named has 18",
    ),
    (
        annotations({"keypoints": LABELLED}, categories=3),
        "'categories' of a.json is 3 where a JSON array",
    ),
    (
        annotations({"keypoints": LABELLED}, images=[{"id": 7, "width": 0, "height": 2}]),
        "'width' of image 0",
    ),
    (
        annotations({"keypoints": LABELLED}, images=[{"id": 7, "width": 9, "height": 2.5}]),
        "'height' of image 0",
    ),
    ({"annotations": {}}, "'annotations' of a.json is {} where a JSON array"),
    # Native
    (native(), "no joint of any person"),
    (
        native(right_toe=[1, 2, 1]),
        "person 0 of a.json has a joint 'right_toe', which is none of pelvis, thorax",
    ),
    (
        native(head=[1, 2]),
        r"head of person 0 of a.json is \[1, 2\] where \[x, y, score\] is needed",
    ),
    (native(head=7), "head of person 0 of a.json is 7 where a JSON array"),
    (native(head=[1, 2, -3]), "score of head in person 0 of a.json is -3, which is negative"),
    (native(head=[1, False, 3]), "y of head in person 0 of a.json is False where a number"),
    (native(head=[1, 2, 3]) | {"version": 2}, "'version' of a.json is 2, but version 1"),
    (native(head=[1, 2, 3]) | {"version": True}, "'version' of a.json is True, but version 1"),
    (native(head=[1, 2, 3]) | {"people": []}, "has no person in it"),
    (
        native(head=[1, 2, 3]) | {"people": [{}]},
        "'keypoints' of person 0 of a.json is None where a JSON object",
    ),
    (
        native_with(face={"nose": [1, 2]}),
        r"nose of person 0 of a.json is \[1, 2\] where \[x, y, score\]",
    ),
    (
        native_with(face={"chin": [1, 2, 1]}),
        "has a point of the face 'chin', which is none of nose, left_eye",
    ),
    (native(head=[1, 2, 3]) | {"format": "poseterior"}, "of a shape that is not known"),
]


REFUSALS += [
    (
        native_with(image_id=1.5),
        "'image_id' of person 0 of a.json is 1.5 where a whole number or a name",
    ),
    (native_with(image_id=True), "'image_id' of person 0 of a.json is True where"),
    (
        native_with(image_size=[640]),
        r"'image_size' of person 0 of a.json is \[640\] where \[width, height\]",
    ),
    (
        native_with(image_size=[640, -1]),
        "'image_size' of person 0 of a.json is -1 where a positive whole number",
    ),
]


@pytest.mark.parametrize(("document", "match"), REFUSALS, ids=range(len(REFUSALS)))
def test_refusals_are_one_sentence_that_says_what_and_where(document: Any, match: str) -> None:
    with pytest.raises(BadInput, match=match) as error:
        read(document)
    message = str(error.value)
    assert "a.json" in message
    assert message.endswith(".")
    assert "\n" not in message
    assert len(message) < 450


@pytest.mark.parametrize(
    ("format", "threshold", "match"),
    [
        (
            "yaml",
            None,
            "there is no format 'yaml'; choose auto or one of .*heatmaps, .*poseterior, openpose",
        ),
        (
            "openpose-coco18",
            None,
            "person 0 of .* holds 25 points of a person, but coco_18 has 18",
        ),
        ("coco-results", None, "where a JSON array is needed"),
        ("coco-annotations", None, "'annotations' of a.json is None"),
        ("poseterior", None, "'format' of a.json is None, not 'poseterior-detections'"),
        ("auto", -1, "threshold of the scores must be 0 or a positive number, not -1"),
        ("auto", float("nan"), "threshold of the scores must be 0 or"),
        ("auto", 0.5, "no joint of any person in a.json has a score above the threshold 0.5"),
    ],
)
def test_refused_options(format: str, threshold: float | None, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        read(openpose(REAL_25), format, threshold)


def test_what_is_accepted_although_odd() -> None:
    duplicate = (
        b'{"people": [], "people": ' + json.dumps(openpose(REAL_25)["people"]).encode() + b"}"
    )
    assert len(read(duplicate)) == 1
    assert (
        len(read(b"\xef\xbb\xbf" + json.dumps(openpose(REAL_25)).encode())) == 1
    )  # a byte-order mark
    assert read(native_with(image_id=785, image_size=[640.0, 425], truth=[1]))[0].image_size == (
        640,
        425,
    )
    boxed, one = read(
        openpose([0] * 54, flat(COCO_18.points))
    )  # nobody is seen, yet the next keeps its number
    assert (boxed.seen.any(), one.person) == (False, 1)


def test_unreadable_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps(openpose(REAL_25)))
    monkeypatch.setattr(formats, "LARGEST_FILE", 10)
    with pytest.raises(BadInput, match=r"a\.json has \d+ bytes, more than 10"):
        read_detections(file)
    monkeypatch.undo()

    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(BadInput, match=r"a\.json cannot be read \(Permission denied\)"):
        read_detections(str(file))
    for path in ("a\0b.json", tmp_path / ("x" * 5000)):
        with pytest.raises(BadInput, match=r"there is no file|cannot be read"):
            read_detections(path)


# Writing.

LABEL = st.characters(exclude_categories=("Cs", "Cc"))


@st.composite
def detections(draw: st.DrawFn) -> list[Detection]:
    """One to three people with any joints seen, at least one of them."""
    people = []
    for person in range(draw(st.integers(1, 3))):
        seen = np.array(draw(st.lists(st.booleans(), min_size=NUM_JOINTS, max_size=NUM_JOINTS)))
        rows = draw(
            st.lists(
                st.tuples(
                    st.floats(-1e9, 1e9), st.floats(-1e9, 1e9), st.floats(0, 1e9, exclude_min=True)
                ),
                min_size=NUM_JOINTS,
                max_size=NUM_JOINTS,
            )
        )
        points = np.where(seen[:, None], np.array(rows), [np.nan, np.nan, 0])
        size = draw(st.none() | st.tuples(st.integers(1, 9999), st.integers(1, 9999)))
        image = draw(st.none() | st.text(LABEL, max_size=LONGEST_LABEL))
        face = draw(
            st.none() | st.just(np.where(seen[:5, None], np.array(rows[5:10]), [np.nan, np.nan, 0]))
        )
        people.append(
            Detection(points[:, :2], points[:, 2], "any", "drawn", person, image, size, face)
        )
    assume(any(person.seen.any() for person in people))
    return people


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(detections())
def test_written_and_read_again_is_the_same(tmp_path: Path, people: list[Detection]) -> None:
    file = tmp_path / "out.json"
    write_detections(file, people)
    again = read_detections(file)
    assert len(again) == len(people)
    assert all(same(one, other) for one, other in zip(people, again, strict=True))
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]


def test_a_real_file_survives_conversion(shared_data: Path, tmp_path: Path) -> None:
    people = read_detections(shared_data / COCO)
    write_detections(tmp_path / "out.json", people)
    again = read_detections(tmp_path / "out.json")
    assert len(again) == 12
    assert all(same(one, other) for one, other in zip(people, again, strict=True))


def test_a_failed_write_leaves_the_old_file_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "out.json"
    file.write_text("old")
    people = read(openpose(REAL_25))

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", fail)
    with pytest.raises(
        BadInput,
        match=r"cannot write .*out\.json \(No space left on device\); choose another place",
    ):
        write_detections(file, people)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    people = read(openpose(REAL_25))
    for place in (tmp_path, tmp_path / "none" / "out.json", "a\0b"):
        with pytest.raises(BadInput, match=r"cannot write .* choose another place"):
            write_detections(place, people)
    with pytest.raises(BadInput, match="nothing to write"):
        write_detections(tmp_path / "out.json", [])
    assert not list(tmp_path.iterdir())


def test_a_link_is_written_through_and_the_file_can_be_read_by_others(tmp_path: Path) -> None:
    file, link = tmp_path / "out.json", tmp_path / "link.json"
    link.symlink_to(file)
    write_detections(link, read(openpose(REAL_25)))
    assert link.is_symlink()
    assert len(read_detections(file)) == 1
    plain = tmp_path / "plain"
    plain.touch()
    assert stat.S_IMODE(file.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


# Arbitrary and damaged content.

KEYS = (
    "people",
    "pose_keypoints_2d",
    "pose_keypoints",
    "annotations",
    "images",
    "categories",
    "image_id",
    "category_id",
    "keypoints",
    "id",
    "name",
    "width",
    "height",
    "format",
    "version",
    "image_size",
    "head",
    "pelvis",
)
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["person", "poseterior-detections", 1, 10**400, REAL_25, REAL_17, LABELLED])
)
JSON = st.recursive(
    LEAVES,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
)
VALID = [
    openpose(REAL_25, flat(BODY_25.points)),
    openpose(flat(COCO_18.points)),
    results(REAL_17, REAL_17),
    annotations(
        {"keypoints": LABELLED},
        categories=[PERSON_CATEGORY],
        images=[{"id": 7, "width": 9, "height": 9}],
    ),
    native_with(image_id="a", image_size=[9, 9]),
]


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values inside a JSON document."""
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    return [path] + [place for key, inner in items for place in places(inner, (*path, key))]


@st.composite
def mutated(draw: st.DrawFn) -> Any:
    """A valid document of any format in which up to three values were replaced."""
    document = [copy.deepcopy(draw(st.sampled_from(VALID)))]
    for _ in range(draw(st.integers(1, 3))):
        *way, last = (0, *draw(st.sampled_from(places(document[0]))))
        inside: Any = document
        for key in way:
            inside = inside[key]
        inside[last] = copy.deepcopy(draw(JSON))  # the lists among its leaves are shared
    return document[0]


def read_or_refuse(data: bytes, format: str = "auto") -> None:
    """Any other exception than `BadInput` fails the test; so does a person without a valid
    number."""
    try:
        people = read(data, format)
    except BadInput as error:
        message = str(error)
        assert message.endswith(".")
        assert "\n" not in message
    else:
        assert [person.person for person in people] == list(range(len(people)))


def fuzz(documents: st.SearchStrategy[Any], examples: int) -> Callable[[], None]:
    @settings(max_examples=examples, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(documents, st.sampled_from(["auto", *FORMATS]))
    def check(document: Any, format: str) -> None:
        read_or_refuse(json.dumps(document).encode(), format)

    return check


@pytest.mark.parametrize("documents", [JSON, mutated()], ids=["arbitrary", "mutated"])
@pytest.mark.parametrize("examples", [100, pytest.param(1_500, marks=pytest.mark.slow)])
def test_any_json_is_read_or_refused(documents: st.SearchStrategy[Any], examples: int) -> None:
    fuzz(documents, examples)()


@pytest.mark.parametrize("examples", [300, pytest.param(2_500, marks=pytest.mark.slow)])
def test_damaged_bytes_are_read_or_refused(shared_data: Path, examples: int) -> None:
    originals = [(shared_data / file).read_bytes() for file in (SPIN, HMR, POSE2SIM, COCO)]

    @settings(max_examples=examples, deadline=None)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        content = bytearray(data.draw(st.sampled_from(originals)))
        for _ in range(data.draw(st.integers(0, 3))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
        cut = data.draw(st.just(len(content)) | st.integers(0, len(content)))
        read_or_refuse(bytes(content[:cut]))

    check()
