"""What goes wrong with files of every detector, and is to go wrong with none: fractions, missing
points, orders and names of joints. Each over every reader and every form that it reads; and the
files that users brought, in the data pack."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from poseterior.probmodel import BadInput, Detection, read_detections, read_frames
from poseterior.probmodel.formats import FORMATS, Content, read_content, write_detections
from poseterior.probmodel.formats.units import Unit, in_pixels, unit_of
from poseterior.probmodel.layouts import (
    BODY_25,
    COCO_17,
    COCO_18,
    H36M_17,
    HALPE_26,
    LAYOUTS,
    MEDIAPIPE_33,
    MPII_16,
    Layout,
    corrected,
    layout_of_names,
)
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from tests.probmodel.test_formats import STANDING, native, openpose, results
from tests.probmodel.test_formats_fuzz import (
    FILES,
    SIZE,
    files,
    landmarks,
    listed_points,
    mmpose,
    named_columns,
    npy,
    npz,
    points,
    standing,
    table,
    vision,
)
from tests.probmodel.test_formats_readers import named_annotations

FORMS = [(name, number) for name, several in FILES.items() for number in range(len(several))]
"""Every form of file that is read."""
WRITTEN_AS_FRACTIONS = {("st-gcn", 0), ("tensorflow.js", 1), ("ultralytics", 1)}
"""Those of `FILES` that are fractions already."""
LOOKED_AT = [
    (name, number)
    for name, number in FORMS
    if FORMATS[name].unit is None and (name, number) not in WRITTEN_AS_FRACTIONS
]
"""Files of pixels of which it is looked at what they count in."""
with standing(**{name: (x / SIZE[0], y / SIZE[1]) for name, (x, y) in STANDING.items()}):
    FRACTIONS = files()
"""The same files, their coordinates as fractions of the image."""


def read(data: bytes, format: str = "auto", **known: Any) -> list[Detection]:
    return read_content(Content(data, "a file", **known), format)


def at(person: Detection, joint: str) -> list[float]:
    return person.keypoints[JOINT_INDEX[joint]].tolist()


def missing(person: Detection) -> set[str]:
    return {name for name, seen in zip(JOINTS, person.seen, strict=True) if not seen}


# Pixels or fractions.


@pytest.mark.parametrize(("name", "number"), LOOKED_AT)
def test_fractions_are_no_pixels_whoever_wrote_them(name: str, number: int) -> None:
    """Every reader asks for the size of the image, or has it of the file, and gives the pixels."""
    pixels = read(FILES[name][number], image_size=SIZE)
    said = pixels[0].image_size is not None
    fractions = FRACTIONS[name][number]
    if not said:
        with pytest.raises(BadInput, match=r"fractions of an image .* give image_size"):
            read(fractions)
    for one, other in zip(read(fractions, image_size=SIZE), pixels, strict=True):
        assert one.image_size == SIZE
        np.testing.assert_allclose(one.keypoints, other.keypoints, atol=1e-3)
        if one.face is not None and other.face is not None:
            np.testing.assert_allclose(one.face, other.face, atol=1e-3)


@pytest.mark.parametrize("name", ["a", "b"])
def test_our_own_files_are_looked_at_unless_we_wrote_them(tmp_path: Path, name: str) -> None:
    document = native(**{joint: [*np.divide(STANDING[joint], SIZE), 0.5] for joint in JOINTS})
    data = json.dumps(document).encode()
    if name == "a":
        with pytest.raises(BadInput, match="fractions of an image"):
            read(data)
        assert at(read(data, image_size=SIZE)[0], "head") == pytest.approx(STANDING["head"])
        return
    tiny = COCO_17.detection(points(COCO_17) / [200, 200, 1], 0.0, "a file", 0)
    write_detections(tmp_path / "tiny.json", [tiny])
    (again,) = read_detections(tmp_path / "tiny.json")
    np.testing.assert_array_equal(again.keypoints, tiny.keypoints)


def test_fractions_of_an_array() -> None:
    rows = points(COCO_17)[None, :, :2]
    (pixels,) = read(npy(rows), layout="coco_17")
    with pytest.raises(BadInput, match="fractions of an image"):
        read(npy(rows / SIZE), layout="coco_17")
    (person,) = read(npy(rows / SIZE), layout="coco_17", image_size=SIZE)
    np.testing.assert_allclose(person.keypoints, pixels.keypoints)


def test_a_canvas_that_the_file_names_is_the_image() -> None:
    rows = points(COCO_18) / [*SIZE, 1]
    document = openpose(rows.ravel().tolist()) | {"canvas_width": 800, "canvas_height": 600}
    (person,) = read(json.dumps(document).encode(), image_size=(10, 10))
    assert person.image_size == (800, 600)
    assert at(person, "left_wrist") == pytest.approx(
        [STANDING["left_wrist"][0] / 200 * 800, STANDING["left_wrist"][1] / 200 * 600]
    )


def scaled(layout: Layout, low: float, high: float) -> bytes:
    rows = points(layout)
    rows[:, :2] = low + (high - low) * rows[:, :2] / SIZE
    return json.dumps(openpose(rows.ravel().tolist())).encode()


@pytest.mark.parametrize("layout", [BODY_25, COCO_18, COCO_17, HALPE_26], ids=lambda one: one.name)
@pytest.mark.parametrize("low", [0.0, -1.0])
def test_both_scales_of_openpose(layout: Layout, low: float) -> None:
    """--keypoint_scale 3 writes 0 to 1, and 4 writes −1 to 1."""
    with pytest.raises(BadInput, match="fractions of an image"):
        read(scaled(layout, low, 1.0))
    (person,) = read(scaled(layout, low, 1.0), image_size=SIZE)
    (pixels,) = read(json.dumps(openpose(points(layout).ravel().tolist())).encode())
    np.testing.assert_allclose(person.keypoints, pixels.keypoints, atol=1e-9)


def test_a_folder_decides_once_what_its_files_count_in(tmp_path: Path) -> None:
    """A frame in which three points lie in the corner is one of pixels, where the others are."""
    corner = np.zeros((18, 3))
    corner[:3] = [[0.4, 0.7, 0.3], [1.1, 0.9, 0.3], [0.2, 1.2, 0.3]]
    (tmp_path / "0.json").write_text(json.dumps(openpose(corner.ravel().tolist())))
    with pytest.raises(BadInput, match="fractions of an image"):
        list(read_frames(tmp_path))
    (tmp_path / "1.json").write_text(json.dumps(openpose(points(COCO_18).ravel().tolist())))
    first, second = read_frames(tmp_path)
    assert float(np.nanmax(first.people[0].keypoints)) == 1.2
    assert at(second.people[0], "left_wrist") == [*STANDING["left_wrist"]]


def person_at(scale: float, shift: float = 0.0) -> Detection:
    rows = points(COCO_17)
    rows[:, :2] = rows[:, :2] * scale + shift
    return COCO_17.detection(rows, 0.0, "a file", 0)


@pytest.mark.parametrize(
    ("people", "unit"),
    [
        ([person_at(1.0)], Unit.PIXELS),
        ([person_at(0.05, 300.0)], Unit.PIXELS),  # 8 pixels tall
        ([person_at(1 / 200)], Unit.FRACTIONS),
        ([person_at(1 / 200), person_at(1.0)], Unit.PIXELS),
        ([person_at(1 / 200, 0.4)], Unit.FRACTIONS),  # half outside of the image
        ([], Unit.PIXELS),
    ],
)
def test_units_by_hand(people: list[Detection], unit: Unit) -> None:
    assert unit_of(people) is unit


@pytest.mark.parametrize("person", [person_at(0.01, 1.2), person_at(0.01, 250.0)])
def test_metres_are_neither(person: Detection) -> None:
    with pytest.raises(BadInput, match=r"larger than 1\.5, which can be neither pixels nor"):
        unit_of([person])


def test_metres_about_an_origin_are_neither() -> None:
    with pytest.raises(BadInput, match="on both sides of zero, which are neither pixels nor"):
        unit_of([person_at(0.01, -0.8)])


def test_people_behind_the_first_are_not_held_in_memory() -> None:
    """Of pixels, one person is looked at; of fractions a hundred."""
    taken = 0

    def many(scale: float) -> Any:
        nonlocal taken
        for _ in range(1000):
            taken += 1
            yield person_at(scale)

    next(in_pixels(many(1.0), None, None))
    assert taken == 1
    next(in_pixels(many(1 / 200), None, SIZE))
    assert taken == 101


def test_a_table_of_places_in_space_is_no_table_of_an_image() -> None:
    names = ("nose", "left_hip", "right_hip", "left_knee", "right_knee")
    header = [f"{name}_{axis}" for name in names for axis in "xyz"]
    for scale in (0.001, 1.0):
        row = [scale * n for name in names for n in (*STANDING[name], 30)]
        with pytest.raises(BadInput, match="NAME_z and no scores, as a table of 3D positions"):
            read(table([header, row]).encode(), image_size=SIZE)
    depths = named_columns().replace("frame", "nose_z", 1)
    with pytest.raises(BadInput, match="NAME_z and no scores"):
        read(depths.replace("nose_score", "nose_other").encode())
    assert len(read(depths.encode())) == 2  # a depth beside a score
    with pytest.raises(BadInput, match="NAME_z and errors of a triangulation"):  # anipose
        read(depths.replace("LHip_x", "nose_error", 1).encode())


@pytest.mark.parametrize("wrap", [lambda rows: rows, lambda rows: {"landmarks": [rows]}])
def test_landmarks_in_space_are_no_fractions_of_an_image(wrap: Callable[[Any], Any]) -> None:
    """MediaPipe's world landmarks lie about the hips; somebody half out of the image does not."""
    rows = landmarks()
    hips = [np.mean([rows[23][axis], rows[24][axis]]) for axis in "xy"]
    world = [row | {"x": row["x"] - hips[0], "y": row["y"] - hips[1]} for row in rows]
    with pytest.raises(BadInput, match="on both sides of zero, as those in space do"):
        read(json.dumps(wrap(world)).encode(), image_size=SIZE)
    outside = [row | {"x": row["x"] - hips[0]} for row in rows]
    assert len(read(json.dumps(wrap(outside)).encode(), image_size=SIZE)) == 1


def test_scores_and_frames_of_tables_as_programs_call_them() -> None:
    """A score by its first letter is none of 1; SLEAP's frame_idx, with a row a track."""
    head, *rows = named_columns(score="_c").splitlines()
    (first, *rest) = [f"{track},{row}" for row in rows for track in ("track_0", "track_1")]
    text = "\n".join(["track," + head.replace("frame", "frame_idx"), first, *rest])
    people = read(text.encode())
    assert [one.image_id for one in people] == ["0", "0", "1", "1"]
    assert {one.track for one in people} == {"track_0", "track_1"}
    assert people[0].score.max() == 0.5


def test_lists_of_points_are_arrays() -> None:
    rows = points(COCO_17)
    for listed in (rows.tolist(), rows[None].repeat(2, 0).tolist()):
        people = read(json.dumps(listed).encode(), layout="coco_17")
        (same,) = read(npy(rows), layout="coco_17")
        np.testing.assert_array_equal(people[-1].keypoints, same.keypoints)
        with pytest.raises(BadInput, match="holds 17 points of a person; name their order"):
            read(json.dumps(listed).encode())
    with pytest.raises(BadInput, match="not all numbers of one shape"):
        read(json.dumps([rows.tolist(), rows[:16].tolist()]).encode(), layout="coco_17")


def test_the_order_of_an_array_is_asked_for_unless_videopose3d_named_it() -> None:
    rows = points(COCO_17)[None]
    with pytest.raises(BadInput, match="holds 17 points of a person; name their order"):
        read(npz(keypoints=rows))
    assert read(npz(keypoints=rows), layout="coco_17")[0].layout == "coco_17"


def test_a_broken_line_of_json_is_named() -> None:
    data = FILES["coco-results"][-2] + b'{"image_id": 1,\n'
    with pytest.raises(BadInput, match="line 3 of a file is not valid JSON"):
        read(data)


@pytest.mark.parametrize("form", [npy, lambda rows: npz(walk=rows), lambda rows: npz(preds=rows)])
def test_depths_are_no_scores(form: Callable[[np.ndarray], bytes]) -> None:
    """Places in space, millimetres, in the place of x, y and score."""
    rows = np.tile(points(H36M_17, 900.0), (2, 1, 1))
    with pytest.raises(BadInput, match="run to 900, which are no scores, but perhaps depths"):
        read(form(rows), layout="h36m_17")


# Missing.


def hidden(name: str) -> bool:
    """Whether a format cannot say (0, 0) by a point of `STANDING`."""
    return name in ("heatmaps", "vision", "poseterior")


@pytest.mark.parametrize("nowhere", [(0, 0), (-1, -1)])
@pytest.mark.parametrize("name", [name for name in FILES if not hidden(name)])
def test_a_point_nowhere_is_missing_whoever_wrote_it(name: str, nowhere: tuple[int, int]) -> None:
    """And so is a midpoint that needs it; all others stay."""
    if nowhere == (-1, -1) and (FORMATS[name].unit is Unit.FRACTIONS or name == "trc"):
        pytest.skip("written as another number there")
    with standing(right_wrist=nowhere, left_hip=nowhere):
        made = files()[name]
    for number, data in enumerate(made):
        if nowhere == (-1, -1) and (name, number) in WRITTEN_AS_FRACTIONS:
            continue
        was = read(FILES[name][number], image_size=SIZE)[0]
        person = read(data, image_size=SIZE)[0]
        gone = {"right_wrist", "left_hip"}
        assert gone <= missing(person), number
        assert missing(person) <= missing(was) | gone | {"pelvis"}, number


@pytest.mark.parametrize("nowhere", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("width", [2, 3])
def test_a_point_nowhere_of_an_array_is_missing(nowhere: float, width: int) -> None:
    rows = points(COCO_17)[None, :, :width]
    rows[0, 10, :2] = nowhere
    assert missing(read(npy(rows), layout="coco_17")[0]) == {"head", "right_wrist"}
    for data in (npz(walk=rows), npz(preds=rows)):
        assert missing(read(data, layout="coco_17")[0]) == {"head", "right_wrist"}


def test_vision_s_nowhere_is_the_file_s_own() -> None:
    from poseterior.probmodel.formats.named_points import VISION

    person = vision(VISION)
    person["right_hand_joint"] = {"x": 0.0, "y": 0.0, "confidence": 0.4}
    assert "right_wrist" in missing(read(json.dumps(person).encode(), image_size=SIZE)[0])


def test_somebody_of_nan_is_nobody(tmp_path: Path) -> None:
    """Pose2Sim writes so who was not found, after it has said who is who; one number is no way to
    say it."""
    for count in (17, 18, 25, 26):
        data = json.dumps(openpose([float("nan")] * 3 * count)).encode()
        with pytest.raises(BadInput, match=r"no joint of any person .* choose another frame"):
            read(data)
        (tmp_path / "0.json").write_bytes(data)
        assert [frame.people for frame in read_frames(tmp_path / "0.json")] == [[]]
        assert [frame.people for frame in read_frames(tmp_path)] == [[]]
    both = openpose([float("nan")] * 75, points(BODY_25).ravel().tolist())
    unseen, person = read(json.dumps(both).encode())
    assert (unseen.seen.any(), person.person, person.layout) == (False, 1, "body_25")
    (tmp_path / "0.json").write_text(json.dumps(both))
    assert [[one.person for one in frame.people] for frame in read_frames(tmp_path)] == [[1]]


# Orders of joints.


@pytest.mark.parametrize(("name", "number"), FORMS)
def test_every_reader_takes_a_layout(name: str, number: int) -> None:
    """One of another number of points is refused; that of the file changes nothing."""
    data = FILES[name][number]
    with pytest.raises(BadInput, match=r"points|of this count|names its joints|\(frames, 14"):
        read(data, image_size=SIZE, layout="crowdpose_14")
    with pytest.raises(BadInput, match=r"there is no layout 'coco'|names its joints"):
        read(data, image_size=SIZE, layout="coco")
    own = read(data, image_size=SIZE)[0]
    if own.layout in LAYOUTS:
        said = read(data, image_size=SIZE, layout=own.layout)[0]
        np.testing.assert_array_equal(said.keypoints, own.keypoints)
        assert said.layout == own.layout


@pytest.mark.parametrize("layout", [MPII_16, H36M_17], ids=lambda one: one.name)
def test_a_layout_that_is_named_comes_before_the_number_of_points(layout: Layout) -> None:
    flat = points(layout).ravel().tolist()
    for document in (openpose(flat), results(flat)):
        (person,) = read(json.dumps(document).encode(), layout=layout.name)
        assert person.layout == layout.name
        assert at(person, "left_ankle") == [*STANDING["left_ankle"]]


def test_points_without_names_of_joints_take_a_layout() -> None:
    names = {f"p{number}": name for number, name in enumerate(COCO_17.points)}
    data = named_columns(names).encode()
    (person, _) = read(data, layout="coco_17")
    assert at(person, "right_ankle") == [*STANDING["right_ankle"]]
    with pytest.raises(BadInput, match="names a point 'nose' where h36m_17 has pelvis"):
        read(named_columns({name: name for name in COCO_17.points}).encode(), layout="h36m_17")


@pytest.mark.parametrize(
    "layout",
    [layout for layout in LAYOUTS.values() if layout.count not in (14, 25)],
    ids=lambda one: one.name,
)
def test_layouts_are_told_by_their_number_of_points_in_openpose_s_envelope(layout: Layout) -> None:
    (person,) = read(json.dumps(openpose(points(layout).ravel().tolist())).encode())
    expected = "coco_17" if layout.count == 17 else layout.name
    assert person.layout == expected


# Names.

H36M_NAMES = [
    *("root", "right_hip", "right_knee", "right_foot", "left_hip", "left_knee", "left_foot"),
    *("spine", "thorax", "neck_base", "head"),
    *("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"),
]
"""As MMPose has them."""
BY_NAME: dict[str, Callable[[list[str], Layout], bytes]] = {
    "csv": lambda names, layout: table(
        [
            [f"{name}_{axis}" for name in names for axis in "xy"],
            [float(number) for row in placed(layout) for number in row[:2]],
        ]
    ).encode(),
    "coco-annotations": lambda names, layout: json.dumps(
        {
            "annotations": [
                {"image_id": 1, "category_id": 1, "keypoints": placed(layout).ravel().tolist()}
            ],
            "categories": [{"id": 1, "name": "person", "keypoints": names}],
        }
    ).encode(),
    "mmpose": lambda names, layout: json.dumps(
        {
            "meta_info": {
                "dataset_name": "mine",
                "keypoint_id2name": {str(i): name for i, name in enumerate(names)},
            },
            "instance_info": [
                {
                    "keypoints": placed(layout)[:, :2].tolist(),
                    "keypoint_scores": [1.0] * len(names),
                }
            ],
        }
    ).encode(),
    "tensorflow.js": lambda names, layout: json.dumps(
        [
            {
                "keypoints": [
                    {"x": x, "y": y, "name": name}
                    for name, (x, y, _) in zip(names, placed(layout).tolist(), strict=True)
                ]
            }
        ]
    ).encode(),
    "named-points": lambda names, layout: json.dumps(
        {name: row[:2] for name, row in zip(names, placed(layout).tolist(), strict=True)}
    ).encode(),
}
"""Readers of files that name their points."""


def placed(layout: Layout) -> np.ndarray:
    """`STANDING`, thorax and pelvis a little beside the midpoints."""
    rows = points(layout, 2.0)
    for middle in {"thorax", "pelvis"} & set(layout.points):
        rows[layout.points.index(middle), 0] += 3.0
    return rows


@pytest.mark.parametrize("format", BY_NAME)
def test_mpii_by_name_is_mpii(format: str) -> None:
    """Its thorax and pelvis are midpoints, and are moved as they are in its order."""
    by_order = corrected(MPII_16.detection(placed(MPII_16), 0.0, "a file", 0))
    for names in (MPII_16.points, [n.replace("head", "head_top") for n in MPII_16.points]):
        (person,) = read(BY_NAME[format](list(names), MPII_16))
        after = corrected(person)
        assert after.moved == ("thorax", "pelvis") == by_order.moved
        np.testing.assert_allclose(after.keypoints, by_order.keypoints, atol=1e-9)


@pytest.mark.parametrize("format", BY_NAME)
def test_human36m_s_feet_are_its_ankles(format: str) -> None:
    """And its pelvis alone is a midpoint."""
    by_order = corrected(H36M_17.detection(placed(H36M_17), 0.0, "a file", 0))
    (person,) = read(BY_NAME[format](H36M_NAMES, H36M_17))
    assert not missing(person)
    after = corrected(person)
    assert after.moved == ("pelvis",) == by_order.moved
    np.testing.assert_allclose(after.keypoints, by_order.keypoints, atol=1e-9)


def test_feet_beside_ankles_heels_or_toes_are_feet() -> None:
    for other in ("left_ankle", "left_heel", "left_big_toe"):
        assert layout_of_names(["left_foot", other]).points == ("left_foot", other)
    assert layout_of_names(["LFoot", "RKnee"]).points == ("left_ankle", "right_knee")


def test_what_is_a_midpoint_survives_our_own_file(tmp_path: Path) -> None:
    """The file does not name the detector's order, but which of thorax and pelvis it defines so."""
    for layout in (MPII_16, H36M_17, COCO_17, BODY_25):
        person = layout.detection(placed(layout), 0.0, "a file", 0)
        write_detections(tmp_path / "ours.json", [person])
        (again,) = read_detections(tmp_path / "ours.json")
        assert corrected(again).moved == corrected(person).moved == layout.midpoints
        write_detections(tmp_path / "ours.json", [corrected(person)])
        (again,) = read_detections(tmp_path / "ours.json")
        assert corrected(again).moved == ()
    broken = native(head=[1, 2, 3])
    broken["people"][0]["midpoints"] = ["head"]
    with pytest.raises(BadInput, match=r"'midpoints' of person 0 .* may be thorax and pelvis"):
        read(json.dumps(broken).encode())


# The files that users brought.

CASES = "cases"
RECORD = {"right_wrist": (15.454, 189.240), "left_ankle": (180.564, 498.292)}
"""Of the AlphaPose record of 92.jpg."""
BEHIND = {"right_wrist": (629.549, 141.459), "left_ankle": (393.798, 583.159)}
"""Of hmr's person, seen from behind."""
WALKER = {"left_ankle": (118.893, 155.601), "left_wrist": (77.792, 97.954)}
"""Of SPIN's person."""
SPIN_SIZE: dict[str, Any] = {"image_size": (153, 192)}
READ_AS: dict[str, tuple[dict[str, Any], int, str, dict[str, tuple[float, float]]]] = {
    "openpose_keypoint_scale3.json": (SPIN_SIZE, 1, "body_25", WALKER),
    "openpose_keypoint_scale4.json": (SPIN_SIZE, 1, "body_25", WALKER),
    "openpose_pixels_same.json": ({}, 1, "body_25", WALKER),
    "openpose_pose.yml": ({}, 1, "body_25", WALKER),
    "easymocap_annots.json": ({}, 1, "body_25", WALKER),
    "sdwebui_fractions.json": ({}, 2, "coco_18", BEHIND),
    "comfyui_dwpose_fractions_list.json": ({}, 2, "coco_18", BEHIND),
    "comfyui_dwpose_pixels.json": ({}, 2, "coco_18", BEHIND),
    "caffe_rtpose.json": ({}, 1, "coco_18", BEHIND),
    "stgcn_kinetics.json": ({"image_size": (800, 600)}, 1, "coco_18", BEHIND),
    "posenet_nested.json": ({}, 1, "coco_18", BEHIND),
    "pose2sim_halpe26_000000.json": ({}, 1, "halpe_26", RECORD),
    "pose2sim_coco17_000000.json": ({}, 1, "coco_17", RECORD),
    "halpe_annotation_min.json": ({}, 1, "halpe_136", RECORD),
    "openpifpaf_min.json": ({}, 1, "coco_17", RECORD),
    "one_person_rows.json": ({}, 1, "coco_17", RECORD),
    "one_person_rows3.json": ({}, 1, "coco_17", RECORD),
    "easy_vitpose.json": ({}, 2, "coco_17", RECORD),
    "alphapose_poseflow_tracked.json": ({}, 2, "coco_17", RECORD),
    "mlkit.json": ({}, 1, "named", RECORD),
    "dict_by_name_xy.json": ({}, 1, "named", RECORD),
    "csv_semicolon.csv": ({}, 3, "named", RECORD),
    "csv_tab.tsv": ({}, 3, "named", RECORD),
    "csv_pixels_named.csv": ({}, 3, "named", RECORD),
    "sports2d_px_person00.trc": ({}, 20, "named", RECORD),
    "gast_minus1_coco17.npy": ({"layout": "coco_17"}, 2, "coco_17", RECORD),
    "zeros_missing_coco17.npy": ({"layout": "coco_17"}, 1, "coco_17", RECORD),
}
"""By file: what is known beside it, how many people it has, in which order, and where some joints
are."""


@pytest.mark.parametrize("name", READ_AS)
def test_files_that_users_brought_are_read(shared_data: Path, name: str) -> None:
    known, count, layout, joints = READ_AS[name]
    people = read_detections(shared_data / CASES / name, **known)
    assert (len(people), people[0].layout) == (count, layout)
    for joint, place in joints.items():
        assert at(people[0], joint) == pytest.approx(place, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("gast_minus1_coco17.npy", {"left_wrist"}),
        ("zeros_missing_coco17.npy", {"left_wrist", "right_ankle"}),
    ],
)
def test_points_nowhere_that_users_brought_are_missing(
    shared_data: Path, name: str, joints: set[str]
) -> None:
    person = read_detections(shared_data / CASES / name, layout="coco_17")[0]
    assert missing(person) == joints | {"head"}


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("openpose_keypoint_scale3.json", "fractions of an image whose size .* give image_size"),
        ("openpose_keypoint_scale4.json", "fractions of an image whose size .* give image_size"),
        ("stgcn_kinetics.json", "fractions of an image whose size"),
        ("world3d_metres.csv", "NAME_z and no scores, as a table of 3D positions"),
        ("pose2sim_nan_body25.json", "no joint of any person"),
        ("sports2d_m_person00.trc", "a TRC file of markers"),
        ("spin_dataset_extras.npz", "a data set for training, such as SPIN's"),
    ],
)
def test_files_that_users_brought_are_refused_by_what_they_are(
    shared_data: Path, name: str, match: str
) -> None:
    with pytest.raises(BadInput, match=match):
        read_detections(shared_data / CASES / name)


def test_mediapipe_and_others_keep_their_names() -> None:
    """What names points and has MediaPipe's visibilities is MediaPipe's, with its threshold."""
    assert MEDIAPIPE_33.count == 33
    document = [listed_points(COCO_17)]
    assert read(json.dumps(document).encode())[0].layout == "named"
    assert read(json.dumps(mmpose(COCO_17, dataset_name="coco")).encode())[0].layout == "coco_17"
    assert read(named_annotations(["left_hip", "right_hip", "nose"]))[0].seen.sum() == 3
