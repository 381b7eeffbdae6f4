"""Who is who in a film, and which frame is when: over every reader whose files can hold one."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from poseterior.probmodel import BadInput, Detection, read_detections, read_frames
from poseterior.probmodel.detections import pick_person
from poseterior.probmodel.formats import FORMATS
from poseterior.probmodel.formats.common import track_of
from poseterior.probmodel.formats.frames import DetectedFrame, frame_numbers, named_by
from poseterior.probmodel.formats.point_arrays import NUMBERS_A_PERSON
from poseterior.probmodel.layouts import BODY_25, COCO_17, COCO_18, H36M_17, MEDIAPIPE_33, MPII_16
from poseterior.probmodel.people import Cast, cast_of, distances
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from tests.probmodel.test_formats_fuzz import (
    PARTS,
    SIZE,
    SWIFT,
    blobs,
    hdf5,
    npy,
    npz,
    points,
    table,
)

CASES = "cases"
NUMBERED = (3, 4, 5, 9, 10, 11)
"""Frames of a film with a gap."""
ASIDE = 120.0
"""Pixels between two people."""
Moved = Callable[[np.ndarray], np.ndarray]
"""Points `(n, 2 or more)` of a person in a frame, from those of `STANDING`."""


def moved(frame: int, aside: float = 0.0) -> Moved:
    """One who walks to the right."""
    return lambda rows: rows + np.eye(rows.shape[-1])[0] * (3.0 * frame + aside)


ALONE = [moved(frame) for frame in range(len(NUMBERED))]


def rows_of(layout: Any, move: Moved) -> np.ndarray:
    return move(points(layout))


def flat_of(layout: Any, move: Moved) -> list[float]:
    return rows_of(layout, move).ravel().tolist()


def visible(move: Moved) -> list[float]:
    """COCO's points as annotations have them, all labelled and seen."""
    return (rows_of(COCO_17, move) * [1, 1, 4]).ravel().tolist()


def named_row(move: Moved) -> list[float]:
    return move(np.array([(*points_of(name), 0.5) for name in PARTS.values()])).ravel().tolist()


def points_of(name: str) -> tuple[float, float]:
    from tests.probmodel.test_formats import STANDING

    return STANDING[name]


def dumped(value: object) -> bytes:
    return json.dumps(value).encode()


# --- films of one person in one file, by format


def _instance(move: Moved, **more: object) -> dict[str, object]:
    rows = rows_of(COCO_17, move)
    return {"keypoints": rows[:, :2].tolist(), "keypoint_scores": rows[:, 2].tolist()} | more


def _native(move: Moved, **more: object) -> dict[str, object]:
    joints = dict(zip(COCO_17.points, rows_of(COCO_17, move), strict=True))
    kept = {name: row.tolist() for name, row in joints.items() if name in JOINT_INDEX}
    return {"keypoints": kept} | more


def _landmarks(move: Moved) -> list[dict[str, float]]:
    rows = rows_of(MEDIAPIPE_33, move)[:, :2] / SIZE
    return [{"x": x, "y": y, "z": 0.0, "visibility": 0.9} for x, y in rows.tolist()]


def _landmark_text(move: Moved) -> str:
    inner = "".join(
        f"landmark {{ x: {mark['x']} y: {mark['y']} visibility: 0.9 }}\n"
        for mark in _landmarks(move)
    )
    return f"landmarks {{\n{inner}}}\n"


def _vision(move: Moved) -> dict[str, object]:
    places = {theirs: move(np.array([points_of(ours)]))[0] for theirs, ours in SWIFT.items()}
    return {
        name: {"x": x / SIZE[0], "y": 1 - y / SIZE[1], "confidence": 0.8}
        for name, (x, y) in places.items()
    }


def _listed(move: Moved) -> dict[str, object]:
    rows = zip(COCO_17.points, rows_of(COCO_17, move).tolist(), strict=True)
    return {"keypoints": [{"x": x, "y": y, "score": s, "name": name} for name, (x, y, s) in rows]}


def _yolo(move: Moved, **more: object) -> dict[str, object]:
    x, y, visible = rows_of(COCO_17, move).T.tolist()
    return {"name": "person", "keypoints": {"x": x, "y": y, "visible": visible}} | more


def _yolo_line(move: Moved, *more: float) -> str:
    rows = rows_of(COCO_17, move) / [*SIZE, 1]
    numbers = [0.5, 0.5, 0.3, 0.8, *rows.ravel(), *more]
    return " ".join(["0", *(f"{number:g}" for number in numbers)]) + "\n"


def _stack(layout: Any) -> np.ndarray:
    return np.stack([rows_of(layout, move) for move in ALONE])


def _deeplabcut(film: list[list[tuple[str, Moved]]]) -> bytes:
    who = [name for name, _ in film[0]]
    columns = [(name, part, coord) for name in who for part in PARTS
               for coord in ("x", "y", "likelihood")]  # fmt: skip
    head: list[list[object]] = [["scorer", *["net"] * len(columns)]]
    head += [["individuals", *[one[0] for one in columns]]] if who != [""] else []
    head += [["bodyparts", *[one[1] for one in columns]], ["coords", *[one[2] for one in columns]]]
    body = [
        [number, *(value for _, move in people for value in named_row(move))]
        for number, people in zip(NUMBERED, film, strict=True)
    ]
    return table(head + body).encode()


def _deeplabcut_hdf5(file: h5py.File) -> None:
    group = file.create_group("df_with_missing")
    group.attrs["pandas_type"] = np.bytes_("frame")
    codes = np.array([(0, part, coord) for part in range(len(PARTS)) for coord in range(3)])
    for number, names in enumerate((["net"], list(PARTS), ["x", "y", "likelihood"])):
        group[f"block0_items_level{number}"] = np.array(names, dtype="S20")
        group[f"block0_items_label{number}"] = codes[:, number].astype("i1")
    group["axis1"] = np.array(NUMBERED)
    group["block0_values"] = np.array([named_row(move) for move in ALONE])


def _sleap(film: list[list[Moved]]) -> bytes:
    tracks = np.array(
        [[np.reshape(named_row(move), (-1, 3))[:, :2] for move in people] for people in film]
    )

    def write(file: h5py.File) -> None:
        file.create_dataset("tracks", data=np.transpose(tracks, (1, 3, 2, 0)))
        file.create_dataset("node_names", data=np.array(list(PARTS), "S"))

    return hdf5(write)


def _wide(move: Moved) -> list[float]:
    return [value for mark in _landmarks(move) for value in mark.values()]


def _movenet(move: Moved) -> np.ndarray:
    return rows_of(COCO_17, move)[:, [1, 0, 2]] / [SIZE[1], SIZE[0], 1]


WIDE_HEAD = [f"{name}_{part}" for name in MEDIAPIPE_33.points for part in ("x", "y", "z", "visibility")]  # fmt: skip  # noqa: E501
CSV_HEAD = [name + end for name in PARTS for end in ("_x", "_y", "_score")]
_IMAGES = [f"{number}.jpg" for number in NUMBERED]
_PAIRS = list(zip(NUMBERED, ALONE, strict=True))


def _opencv(move: Moved) -> bytes:
    data = flat_of(COCO_18, move)
    return dumped({"pose_0": {"type_id": "opencv-nd-matrix", "sizes": [1, 18, 3], "data": data}})


def _trc() -> bytes:
    head = ["PathFileType\t4", "DataRate\tUnits", "30\tpx"]
    head += ["Frame#\tTime\t" + "\t\t\t".join(COCO_17.points), "", ""]
    rows = [
        [n, 0.0, *(value for x, y, _ in rows_of(COCO_17, move) for value in (x, -y, 0.0))]
        for n, move in _PAIRS
    ]
    return "\n".join([*head, *("\t".join(map(str, row)) for row in rows)]).encode()


FILMS: dict[str, bytes | list[bytes]] = {
    "movenet": npy(np.stack([_movenet(move)[None, None] for move in ALONE])),
    "freemocap": npy(_stack(MEDIAPIPE_33)[None]),
    "points": npy(_stack(COCO_17)),
    "lists": dumped(_stack(COCO_17).tolist()),
    "heatmaps": npz(
        heatmaps=np.stack([blobs()] * 6), box=np.array([[2.0 + k, 0, 192, 192] for k in range(6)])
    ),
    "hourglass": npz(preds=_stack(MPII_16)[..., :2]),
    "sleap": _sleap([[move] for move in ALONE]),
    "deeplabcut-hdf5": hdf5(_deeplabcut_hdf5),
    "rtmlib": npz(keypoints=_stack(COCO_17)[..., :2], scores=_stack(COCO_17)[..., 2]),
    "videopose3d": npz(**{"S1/walk/0": _stack(H36M_17)[..., :2]}),
    "deeplabcut-csv": _deeplabcut([[("", move)] for move in ALONE]),
    "mediapipe-text": "".join(map(_landmark_text, ALONE)).encode(),
    "mediapipe-csv": table([WIDE_HEAD, *[_wide(move) for move in ALONE]]).encode(),
    "csv": table([CSV_HEAD, *[named_row(move) for move in ALONE]]).encode(),
    "ultralytics-text": [_yolo_line(move).encode() for move in ALONE],
    "poseterior": dumped({"format": "poseterior-detections", "version": 1,
        "people": [_native(move, image_id=str(n)) for n, move in _PAIRS]}),
    "openpose": [dumped({"people": [{"person_id": [-1],
        "pose_keypoints_2d": flat_of(BODY_25, move)}]}) for move in ALONE],
    "coco-annotations": dumped({"annotations": [{"image_id": n, "category_id": 1,
        "keypoints": visible(move)} for n, move in _PAIRS]}),
    "ultralytics": dumped([_yolo(move) for move in ALONE]),
    "tensorflow.js": dumped([_listed(move) for move in ALONE]),
    "vision": dumped([_vision(move) for move in ALONE]),
    "mpii": dumped([{"joints": rows_of(MPII_16, move)[:, :2].tolist(), "image": f"{n:09d}.jpg"}
        for n, move in _PAIRS]),
    "mmpose": dumped({"meta_info": {"dataset_name": "coco"}, "instance_info": [
        {"frame_id": n, "instances": [_instance(move)]} for n, move in _PAIRS]}),
    "mediapipe": dumped([_landmarks(move) for move in ALONE]),
    "coco-results": dumped([{"image_id": f"{n}.jpg", "category_id": 1, "idx": [0.0],
        "keypoints": flat_of(COCO_17, move)} for n, move in _PAIRS]),
    "instances": dumped([{"keypoints": rows_of(COCO_17, move).tolist()} for move in ALONE]),
    "alphapose": dumped({f"{n}.jpg": {"version": 1, "people": [
        {"pose_keypoints_2d": flat_of(COCO_18, move)}]} for n, move in _PAIRS}),
    "st-gcn": dumped({"data": [{"frame_index": n, "skeleton": [{
        "pose": (rows_of(COCO_18, move)[:, :2] / SIZE).ravel().tolist(),
        "score": rows_of(COCO_18, move)[:, 2].tolist()}]} for n, move in _PAIRS]}),
    "easy-vitpose": dumped({"skeleton": {}, "keypoints": [
        {"7": rows_of(COCO_17, move)[:, [1, 0, 2]].tolist()} for move in ALONE]}),
    "named-points": dumped({f"{n}.jpg": dict(zip(COCO_17.points,
        rows_of(COCO_17, move).tolist(), strict=True)) for n, move in _PAIRS}),
    "opencv": [_opencv(move) for move in ALONE],
    "trc": _trc(),
}  # fmt: skip
"""Six frames of one person as each format has them: a file, or a folder where it has a file for
each frame."""
GAPS = {
    *("deeplabcut-hdf5", "deeplabcut-csv", "ultralytics-text", "poseterior", "openpose"),
    *("coco-annotations", "mpii", "mmpose", "coco-results", "alphapose"),
    *("st-gcn", "named-points", "opencv", "trc"),
}
"""Formats whose frames have numbers of their own."""


def written(film: bytes | list[bytes], folder: Path) -> Path:
    """A film, as a file or a folder."""
    if isinstance(film, bytes):
        (folder / "film").write_bytes(film)
        return folder / "film"
    (folder / "walk").mkdir()
    for number, data in zip(NUMBERED, film, strict=True):
        (folder / "walk" / f"v2_{number:012d}_keypoints.json").write_bytes(data)
    return folder / "walk"


def frames_of(film: bytes | list[bytes], folder: Path, layout: str | None = None) -> list[Any]:
    return list(read_frames(written(film, folder), image_size=SIZE, layout=layout))


def cast(frames: list[DetectedFrame]) -> Cast:
    return cast_of((frame.name, frame.people) for frame in frames)


def test_there_is_a_film_in_every_format() -> None:
    assert set(FILMS) == {name for name, row in FORMATS.items() if row.recognises}


@pytest.mark.parametrize("name", FILMS)
def test_a_film_of_one_person_is_of_one_person(name: str, tmp_path: Path) -> None:
    frames = frames_of(FILMS[name], tmp_path, "coco_17" if name in ("points", "lists") else None)
    assert [len(frame.people) for frame in frames] == [1] * 6
    found = cast(frames)
    assert found.numbers == [[0]] * 6
    assert found.frames == [6]
    assert found.doubts == []
    numbers = frame_numbers([frame.name for frame in frames])
    assert numbers == (list(NUMBERED) if name in GAPS else list(range(6)))
    x = [frame.people[0].keypoints[JOINT_INDEX["left_wrist"], 0] for frame in frames]
    assert np.diff(x) == pytest.approx([1.0 if name == "heatmaps" else 3.0] * 5, abs=1e-3)


@pytest.mark.parametrize("name", FILMS)
def test_nobody_is_said_to_be_six_people(name: str, tmp_path: Path) -> None:
    """Where a person is asked for who is not there; but for records that name no frame, which are
    people of one for whoever asks for one of them."""
    film = FILMS[name]
    if isinstance(film, list):
        pytest.skip("a file is a frame")
    path = written(film, tmp_path)
    layout = "coco_17" if name in ("points", "lists") else None
    people = read_detections(path, image_size=SIZE, layout=layout)
    with pytest.raises(BadInput) as error:
        pick_person(people, 6)
    named = people[0].image_id is not None
    assert ("6 detections of people in 6 frames" in str(error.value)) == named
    assert ("6 people" in str(error.value)) != named


# --- two people who change their order


def two(order: Callable[[int], bool]) -> list[list[tuple[str, Moved]]]:
    """Tracks 7 and 4, 7 to the left; the other way round in frames where `order` says so."""
    film = []
    for frame in range(len(NUMBERED)):
        people = [("7", moved(frame)), ("4", moved(frame, ASIDE))]
        film.append(people[::-1] if order(frame) else people)
    return film


SWAPPED = two(lambda frame: frame >= 3)


def _records(write: Callable[[int, str | None, Moved], Any]) -> Callable[[bool], list[Any]]:
    """Records of all people of all frames, with their tracks or without."""
    return lambda tracked: [
        write(number, track if tracked else None, move)
        for number, people in zip(NUMBERED, SWAPPED, strict=True)
        for track, move in people
    ]


def _images(write: Callable[[str | None, Moved], Any]) -> Callable[[bool], list[list[Any]]]:
    return lambda tracked: [
        [write(track if tracked else None, move) for track, move in people] for people in SWAPPED
    ]


def _with(key: str, track: str | None, form: Callable[[str], Any] = int) -> dict[str, Any]:
    return {} if track is None else {key: form(track)}


def _openpose(tracked: bool) -> list[bytes]:
    write = _images(lambda track, move: {"person_id": [int(track or -1)],
        "pose_keypoints_2d": flat_of(BODY_25, move)})  # fmt: skip
    return [dumped({"version": 1.3, "people": people}) for people in write(tracked)]


def _yolo_texts(tracked: bool) -> list[bytes]:
    write = _images(lambda track, move: _yolo_line(move, 0.9, *([int(track)] if track else [])))
    return ["".join(people).encode() for people in write(tracked)]


def _csv(tracked: bool) -> bytes:
    write = _records(lambda n, track, move: [f"img_{n}.png", track or "", *named_row(move)])
    return table([["image", "person_id", *CSV_HEAD], *write(tracked)]).encode()


_coco = _records(lambda n, track, move: {"image_id": f"{n}.jpg", "category_id": 1,
    "keypoints": flat_of(COCO_17, move), **_with("idx", track, float)})  # fmt: skip
_annotated = _records(lambda n, track, move: {"image_id": n, "category_id": 1, "id": 100 + n,
    "keypoints": visible(move),
    **_with("track_id", track)})  # fmt: skip
_mpii = _records(lambda n, track, move: {"joints": rows_of(MPII_16, move)[:, :2].tolist(),
    "image": f"{n}.jpg", **_with("track_id", track)})  # fmt: skip
_own = _records(lambda n, track, move: _native(move, image_id=str(n), **_with("track", track, str)))
_mmpose = _images(lambda track, move: _instance(move, **_with("instance_id", track)))
_vitpose = _images(lambda track, move: {"keypoints": rows_of(COCO_17, move)[:, :2].tolist(),
    "scores": [0.5] * 17, **_with("track_id", track)})  # fmt: skip
_alphapose = _images(lambda track, move: {"pose_keypoints_2d": flat_of(COCO_18, move),
    **_with("idx", track)})  # fmt: skip

TWO: dict[str, Callable[[bool], bytes | list[bytes]]] = {
    "openpose": _openpose,
    "ultralytics-text": _yolo_texts,
    "csv": _csv,
    "coco-results": lambda tracked: dumped(_coco(tracked)),
    "coco-annotations": lambda tracked: dumped({"annotations": _annotated(tracked)}),
    "mpii": lambda tracked: dumped(_mpii(tracked)),
    "poseterior": lambda tracked: dumped(
        {"format": "poseterior-detections", "version": 1, "people": _own(tracked)}
    ),
    "mmpose": lambda tracked: dumped({"instance_info": [
        {"frame_id": n, "instances": people}
        for n, people in zip(NUMBERED, _mmpose(tracked), strict=True)]}),
    "instances": lambda tracked: dumped(_vitpose(tracked)),
    "alphapose": lambda tracked: dumped({
        f"{n}.jpg": {"people": people}
        for n, people in zip(NUMBERED, _alphapose(tracked), strict=True)}),
    "deeplabcut-csv": lambda tracked: _deeplabcut(two(lambda _: False)),
    "sleap": lambda tracked: _sleap([[m for _, m in people] for people in two(lambda _: False)]),
    "ultralytics": lambda tracked: [
        dumped(people) for people in _images(
            lambda track, move: _yolo(move, **_with("track_id", track)))(tracked)],
    "tensorflow.js": lambda tracked: [
        dumped(people) for people in _images(
            lambda track, move: _listed(move) | _with("track_id", track))(tracked)],
}  # fmt: skip
IN_COLUMNS = ("deeplabcut-csv", "sleap")
"""Formats whose people have columns of their own, and so an order and a track."""


def lefts(frames: list[DetectedFrame], found: Cast) -> dict[int, list[float]]:
    """By person, where the left wrist is from frame to frame, less the walk."""
    x: dict[int, list[float]] = {}
    for at, (frame, numbers) in enumerate(zip(frames, found.numbers, strict=True)):
        for number, person in zip(numbers, frame.people, strict=True):
            place = person.keypoints[JOINT_INDEX["left_wrist"], 0] - 3.0 * at
            x.setdefault(number, []).append(float(place))
    return x


@pytest.mark.parametrize("tracked", [True, False])
@pytest.mark.parametrize("name", TWO)
def test_people_keep_their_numbers(name: str, tracked: bool, tmp_path: Path) -> None:
    frames = frames_of(TWO[name](tracked), tmp_path)
    found = cast(frames)
    assert found.size == 2
    assert found.frames == [6, 6]
    places = lefts(frames, found)
    assert places[0] == pytest.approx([places[0][0]] * 6, abs=0.01)
    assert places[1] == pytest.approx([places[0][0] + ASIDE] * 6, abs=0.01)
    followed = tracked or name in IN_COLUMNS
    assert (found.tracks[0] is not None) == followed
    assert [("who is who is told by where" in said) for said in found.doubts] == (
        [] if followed else [True]
    )


def test_without_tracks_and_continuity_the_order_is_who_is_who() -> None:
    """The negative control: what would be said of the film if people were numbered by place."""
    frames = [[move(points(COCO_17)) for _, move in people] for people in SWAPPED]
    assert frames[0][0][0, 0] != pytest.approx(frames[-1][0][0, 0], abs=ASIDE / 2)


@pytest.mark.parametrize("name", ["coco-results", "mpii", "csv"])
def test_a_file_sorted_by_tracks_has_as_many_frames(name: str, tmp_path: Path) -> None:
    """The later track first, which alone would begin the film with its first frame."""
    data = TWO[name](True)
    assert isinstance(data, bytes)
    if name == "csv":
        head, *rows = data.decode().splitlines()
        rows.sort(key=lambda row: row.split(",")[1])
        data = "\n".join([head, *rows[2:6], *rows[:2], *rows[6:]]).encode()
    else:
        records = json.loads(data)
        records.sort(key=lambda record: record.get("idx", record.get("track_id")))
        data = json.dumps(records[2:6] + records[:2] + records[6:]).encode()
    frames = frames_of(data, tmp_path)
    assert [len(frame.people) for frame in frames] == [2] * 6
    assert frame_numbers([frame.name for frame in frames]) == list(NUMBERED)
    assert lefts(frames, cast(frames))[0] == pytest.approx([lefts(frames, cast(frames))[0][0]] * 6)


def test_movenet_for_several_people_is_followed_by_continuity(tmp_path: Path) -> None:
    film = np.zeros((6, 1, 6, NUMBERS_A_PERSON), "f4")
    for at, people in enumerate(SWAPPED):
        for place, (_, move) in enumerate(people):
            film[at, 0, place, :51] = _movenet(move).ravel()
            film[at, 0, place, -1] = 0.9
    (tmp_path / "film").write_bytes(npy(film))
    frames = list(read_frames(tmp_path / "film", image_size=SIZE))
    found = cast(frames)
    assert found.numbers == [[0, 1]] * 3 + [[1, 0]] * 3


# --- tracks and continuity


def seen(x: float, track: str | None = None, size: float = 100.0) -> Detection:
    """A body of so many pixels at x."""
    rng = np.random.default_rng(0)
    keypoints = rng.uniform(0, size, (NUM_JOINTS, 2)) + np.array([x, 0])
    return Detection(keypoints, np.ones(NUM_JOINTS), "any", "a file", 0, track=track)


def cast_by(*frames: list[Detection]) -> Cast:
    return cast_of((str(at), people) for at, people in enumerate(frames))


def test_tracks_are_followed_wherever_people_go_and_a_change_of_bodies_is_said() -> None:
    far = cast_by([seen(0, "a")], [seen(900, "a")], [seen(0, "a")])
    assert far.numbers == [[0]] * 3
    assert "farther than a body's size" in far.doubts[0]
    swapped = cast_by(*[[seen(0, "a"), seen(300, "b")]] * 2, [seen(0, "b"), seen(300, "a")])
    assert swapped.numbers == [[0, 1], [0, 1], [1, 0]]
    assert "tracks seem to change bodies in frame 2" in swapped.doubts


def test_a_track_twice_in_a_frame_is_none() -> None:
    """AlphaPose without a tracker gives everybody the idx 0."""
    found = cast_by([seen(0, "0"), seen(300, "0")], [seen(302, "0"), seen(1, "0")])
    assert found.numbers == [[0, 1], [1, 0]]
    assert found.tracks == [None, None]
    assert "two people of frame 0 carry the same track, 0" in found.doubts[0]


def test_tracks_that_never_recur_number_records() -> None:
    found = cast_by(*([seen(at, str(at))] for at in range(5)))
    assert found.numbers == [[0]] * 5
    assert "no track recurs" in found.doubts[0]


def test_a_track_that_begins_later_goes_on_with_who_was_there() -> None:
    found = cast_by([seen(0), seen(300)], [seen(300, "9"), seen(0, "4")], [seen(0, "4")])
    assert found.numbers == [[0, 1], [1, 0], [0]]
    assert found.tracks == ["4", "9"]
    assert cast_by([seen(0, "4")], [seen(1)], [seen(2, "4")]).numbers == [[0]] * 3


def test_who_comes_is_somebody_else_and_who_comes_back_is_not() -> None:
    found = cast_by([seen(0)], [seen(0), seen(300)], [seen(300)], [seen(300), seen(3)])
    assert found.numbers == [[0], [0, 1], [1], [1, 0]]


def test_somebody_alone_is_one_person_and_a_leap_is_said() -> None:
    found = cast_by([seen(0)], [seen(5)], [], [seen(900)])
    assert found.numbers == [[0], [0], [], [0]]
    (doubt,) = found.doubts
    assert "in frame 3: is it the same person?" in doubt
    assert cast_by([seen(0)], [seen(5)], [seen(10)]).doubts == []


def test_two_who_are_near_each_other_are_doubted() -> None:
    near = cast_by([seen(0), seen(40)], [seen(20), seen(25)])
    assert "two people could be taken for each other in frame 1" in near.doubts
    assert not any("taken for" in said for said in cast_by(*[[seen(0), seen(300)]] * 2).doubts)


def test_a_film_without_anybody_has_no_cast() -> None:
    assert cast_by([], []) == Cast([[], []], [], [], [])


def test_distances_are_in_sizes_of_a_body() -> None:
    one, other = seen(0, size=100).keypoints, seen(50, size=100).keypoints
    size = np.linalg.norm(np.ptp(one, axis=0))
    assert distances([one], [one, other]) == pytest.approx(np.array([[0, 50 / size]]))
    upper, lower = one.copy(), one.copy()
    upper[7:], lower[:7] = np.nan, np.nan
    assert 0 < distances([upper], [lower])[0, 0] < 1.5
    assert distances([one], [np.full_like(one, np.nan)])[0, 0] == np.inf


@pytest.mark.parametrize(
    ("record", "track"),
    [
        ({"idx": [0.0]}, "0"),
        ({"idx": [[3]]}, "3"),
        ({"person_id": [-1]}, None),
        ({"person_id": [-1], "idx": 2}, "2"),
        ({"track_id": "12"}, "12"),
        ({"track_id": "left one"}, "left one"),
        ({"track_id": " "}, None),
        ({"track_id": True}, None),
        ({"track_id": 1.5}, None),
        ({"track_id": float("nan")}, None),
        ({"track_id": [1, 2]}, None),
        ({"track_id": 1699999999123456789}, "1699999999123456789"),
        ({"track_id": "1699999999123456789"}, "1699999999123456789"),
        ({"track_id": 10**200}, None),
        ({"track_id": "a\nb"}, None),
        ({"id": 5}, None),
    ],
    ids=str,
)
def test_what_is_a_track(record: dict[str, Any], track: str | None) -> None:
    assert track_of(record) == track


# --- numbers of frames


NANO = 1699999999123456789


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["92.jpg", "93.jpg", "97.jpg"], [92, 93, 97]),
        (["v2_000000000003", "v2_000000000011"], [3, 11]),
        (["cam01.0000", "cam01.0004"], [0, 4]),
        (["frame_12_coco17", "frame_13_coco17"], [12, 13]),
        (["0", "1", "10"], [0, 1, 10]),
        (["0.0", "1.0", "5.0"], [0, 1, 5]),
        (["S1/walk/0/7", "S1/walk/0/8"], [7, 8]),
        (["a2-05.png"], [5]),
        (["1699999999123456789", "1699999999123456790"], [NANO, NANO + 1]),
        (["1_58", "1_59", "2_60"], [58, 59, 60]),
        (["0.033", "0.067"], None),
        (["1_59", "2_0"], None),
        (["0/0", "0/1", "1/0", "1/1"], None),
        (["left", "right"], None),
        (["a1", "b2"], None),
        (["01", "1"], None),
        (["1699999999123456789", "1699999999156790122", "1699999999190123456"], None),
        (["9" * 300, "8" * 300], None),
    ],
    ids=str,
)  # fmt: skip
def test_numbers_are_read_from_names(names: list[str], numbers: list[int] | None) -> None:
    assert frame_numbers(names) == numbers


@pytest.mark.parametrize(
    ("names", "number", "named"),
    [
        (["walk_08.png", "walk_16.png"], 12, "walk_12.png"),
        (["8.mp4", "12.mp4"], 9, "9.mp4"),
        (["0.0", "12.0"], 5, "5.0"),
        (["cam2_12_v12", "cam2_14_v12"], 13, "cam2_13_v12"),
        (["1_8", "2_9", "3_12"], 10, "1_10"),
    ],
)
def test_frames_that_are_not_there_have_names_that_count_them(
    names: list[str], number: int, named: str
) -> None:
    numbers = frame_numbers(names)
    assert numbers is not None
    assert named_by(number, names, numbers) == named


def test_names_in_a_folder_are_those_of_its_files(tmp_path: Path) -> None:
    """Whatever images they name: a frame's name is unlike any other's."""
    for number in (2, 10):
        one = _native(moved(0), image_id="0")
        other = _native(moved(0), image_id="1")
        document = {"format": "poseterior-detections", "version": 1, "people": [one]}
        (tmp_path / f"f{number}.json").write_bytes(dumped(document))
        clip = document | {"people": [one, other]}
        (tmp_path / f"g{number}.json").write_bytes(dumped(clip))
    names = [frame.name for frame in read_frames(tmp_path)]
    assert names == ["f2", "f10", "g2/0", "g2/1", "g10/0", "g10/1"]


def test_numbers_of_nineteen_digits_sort_and_read(tmp_path: Path) -> None:
    """Times in nanoseconds, as robots name their files."""
    for name in ("999999999999999999", "1000000000000000000", "1000000000000000001"):
        (tmp_path / f"{name}.json").write_bytes(FILMS["openpose"][0])  # type: ignore[arg-type]
    names = [frame.name for frame in read_frames(tmp_path)]
    assert names == ["999999999999999999", "1000000000000000000", "1000000000000000001"]
    records = [{"image_id": 1699999999123456789 + n, "category_id": 1,
        "keypoints": flat_of(COCO_17, moved(n))} for n in (1, 0)]  # fmt: skip
    (tmp_path / "a.txt").write_bytes(dumped(records))
    assert [frame.name for frame in read_frames(tmp_path / "a.txt")] == [
        "1699999999123456789",
        "1699999999123456790",
    ]


# --- files that people reported


@pytest.mark.parametrize(
    "name", ["tracked_two_swap.json", "tracked_two_bytrack.json", "openpose_swap"]
)
def test_reported_films_of_two(shared_data: Path, name: str) -> None:
    """Person 0 holds the arms up in all frames: wrists above the thorax."""
    frames = list(read_frames(shared_data / CASES / name))
    found = cast(frames)
    assert (len(frames), found.tracks, found.doubts) == (6, ["1", "2"], [])
    for frame, numbers in zip(frames, found.numbers, strict=True):
        arms = frame.people[numbers.index(0)].keypoints
        hanging = frame.people[numbers.index(1)].keypoints
        wrist, thorax = JOINT_INDEX["right_wrist"], JOINT_INDEX["thorax"]
        assert arms[wrist, 1] < arms[thorax, 1]
        assert hanging[wrist, 1] > hanging[thorax, 1]


def test_reported_individuals(shared_data: Path) -> None:
    frames = list(read_frames(shared_data / CASES / "madlc.csv"))
    found = cast(frames)
    assert (found.tracks, found.frames, found.doubts) == (["ind1", "ind2"], [3, 4], [])


def test_reported_films_with_somebody_missing_and_with_a_gap(shared_data: Path) -> None:
    frames = list(read_frames(shared_data / CASES / "tracked_two_missing.json"))
    assert cast(frames).frames == [5, 6]
    names = [frame.name for frame in read_frames(shared_data / CASES / "alphapose_gap.json")]
    assert frame_numbers(names) == [92, 93, 97]
    one = list(read_frames(shared_data / CASES / "alphapose_one_person_6frames.json"))
    assert (len(one), cast(one).size) == (6, 1)
