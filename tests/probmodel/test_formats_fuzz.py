"""Damaged files of every format: each is read, or refused in a sentence; none crashes, hangs, or is
unpickled."""

import csv
import io
import json
import pickle
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import h5py
import numpy as np
import pytest

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats import FORMATS, Content, format_of, read_content
from poseterior.probmodel.formats.named_points import VISION
from poseterior.probmodel.layouts import (
    BODY_25,
    BODY_25B,
    COCO_17,
    COCO_18,
    H36M_17,
    HALPE_26,
    HALPE_136,
    MEDIAPIPE_33,
    MPII_16,
    Layout,
)
from tests.probmodel.test_formats import STANDING, annotations, flat, native_with, openpose, results

SIZE = (200, 200)
SLOWEST = 5.0
"""Seconds that one file of a few thousand bytes may take, on a busy machine."""


def points(layout: Layout, score: float = 0.5) -> np.ndarray:
    """`(count, 3)` of `STANDING`; points that it lacks lie on the pelvis."""
    return np.array(
        [[*STANDING.get(name, STANDING["pelvis"]), score] for name in layout.points], float
    )


def npy(array: np.ndarray, *, pickled: bool = False) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=pickled)
    return file.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def hdf5(write: Callable[[h5py.File], object]) -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as opened:
        write(opened)
    return file.getvalue()


def lines(*records: object) -> bytes:
    """JSON lines."""
    return "\n".join(map(json.dumps, records)).encode() + b"\n"


def landmarks(layout: Layout = MEDIAPIPE_33, visibility: float = 0.9) -> list[dict[str, float]]:
    xy = points(layout)[:, :2] / SIZE
    return [{"x": float(x), "y": float(y), "z": -0.1, "visibility": visibility} for x, y in xy]


def landmark_text(visibility: float = 0.9) -> str:
    rows = landmarks(visibility=visibility)
    inner = "\n".join(
        "  landmark {\n" + "\n".join(f"    {k}: {v}" for k, v in row.items()) + "\n  }"
        for row in rows
    )
    return f"# proto-message: LandmarksDetectionResult\nlandmarks {{\n{inner}\n}}\n"


def table(rows: list[list[object]]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows(rows)
    return file.getvalue()


def long_landmarks() -> str:
    return table([["x", "y", "z", "visibility"], *[list(row.values()) for row in landmarks()]])


def wide_landmarks(frames: int = 2) -> str:
    header = [
        "frame",
        *[
            f"{name}_{part}"
            for name in MEDIAPIPE_33.points
            for part in ("x", "y", "z", "visibility")
        ],
    ]
    body = [value for row in landmarks() for value in row.values()]
    return table([header, *[[frame, *body] for frame in range(frames)]])


def mmpose_instance(layout: Layout) -> dict[str, object]:
    rows = points(layout).tolist()
    return {
        "keypoints": [row[:2] for row in rows],
        "keypoint_scores": [row[2] for row in rows],
        "bbox": [[0, 0, 9, 9]],
        "bbox_score": 1.0,
    }


def mmpose(layout: Layout, **meta: object) -> dict[str, object]:
    frames = [{"frame_id": number, "instances": [mmpose_instance(layout)]} for number in (0, 1)]
    return {"meta_info": meta, "instance_info": frames}


PARTS = {
    "LeftShoulder": "left_shoulder",
    "right_shoulder": "right_shoulder",
    "l_elbow": "left_elbow",
    "r_elbow": "right_elbow",
    "wrist_left": "left_wrist",
    "Right-Wrist": "right_wrist",
    "LHip": "left_hip",
    "RHip": "right_hip",
    "LKnee": "left_knee",
    "RKnee": "right_knee",
    "left ankle": "left_ankle",
    "R_Ankle": "right_ankle",
    "nose": "nose",
}
"""Body parts as people name them, and what they are."""


def deeplabcut_rows(
    individuals: tuple[str, ...] = (), parts: dict[str, str] = PARTS
) -> list[list[object]]:
    who = individuals or ("",)
    columns = [
        (name, part, coord) for name in who for part in parts for coord in ("x", "y", "likelihood")
    ]
    body = [value for _ in who for part in parts.values() for value in (*STANDING[part], 0.5)]
    rows: list[list[object]] = [["scorer", *["net"] * len(columns)]]
    rows += [["individuals", *[c[0] for c in columns]]] if individuals else []
    rows += [["bodyparts", *[c[1] for c in columns]], ["coords", *[c[2] for c in columns]]]
    return rows + [[frame, *body] for frame in (0, 1)]


def deeplabcut_fixed(file: h5py.File) -> None:
    """The form that pandas calls fixed."""
    group = file.create_group("df_with_missing")
    group.attrs["pandas_type"] = np.bytes_("frame")
    levels = (["net"], list(PARTS), ["x", "y", "likelihood"])
    codes = np.array([(0, part, coord) for part in range(len(PARTS)) for coord in range(3)])
    for number, names in enumerate(levels):
        group[f"block0_items_level{number}"] = np.array(names, dtype="S20")
        group[f"block0_items_label{number}"] = codes[:, number].astype("i1")
    group["axis1"] = np.arange(2)
    group["block0_values"] = np.tile(
        [value for part in PARTS.values() for value in (*STANDING[part], 0.5)], (2, 1)
    )


def deeplabcut_table(file: h5py.File) -> None:
    """The form that pandas calls table, whose labels are a pickle in text form."""
    group = file.create_group("df_with_missing")
    group.attrs["pandas_type"] = np.bytes_("frame_table")
    body = [value for part in PARTS.values() for value in (*STANDING[part], 0.5)]
    rows = np.zeros(2, dtype=[("index", "<i8"), ("values_block_0", "<f8", (len(body),))])
    rows["index"], rows["values_block_0"] = [0, 1], body
    group["table"] = rows
    labels = [("net", part, coord) for part in PARTS for coord in ("x", "y", "likelihood")]
    group["table"].attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(labels, protocol=0))


def blobs(layout: Layout = MPII_16, width: float = 2.0) -> np.ndarray:
    """Heatmaps `(J, 48, 48)` of `STANDING` at a quarter of its size."""
    y, x = np.mgrid[:48, :48]
    centre = points(layout)[:, :2] / 4
    square = (x - centre[:, 0, None, None]) ** 2 + (y - centre[:, 1, None, None]) ** 2
    return np.exp(-square / 2 / width**2)


BOX = np.array([[-2.0, -2.0, 192.0, 192.0]])
"""What makes four pixels of an image of one of `blobs`, its centres falling on multiples of
four."""


def yolo_text(width: int, *more: float) -> str:
    rows = points(COCO_17) / [*SIZE, 1]
    numbers = [0.5, 0.5, 0.3, 0.8, *rows[:, :width].ravel(), *more]
    return " ".join(["0", *(f"{number:g}" for number in numbers)]) + "\n"


def yolo(scale: tuple[float, float] = (1, 1), **more: object) -> dict[str, object]:
    x, y, visible = (points(COCO_17) / [*scale, 1]).T.tolist()
    keypoints = {"x": x, "y": y, "visible": visible}
    box = {"x1": 1, "y1": 2, "x2": 3, "y2": 4}
    return {"name": "person", "class": 0, "box": box, "keypoints": keypoints} | more


def named_columns(parts: dict[str, str] = PARTS, score: str = "_score") -> str:
    ends = ["_x", "_y", score] if score else ["_x", "_y"]
    header = ["frame", *[name + end for name in parts for end in ends]]
    row = [n for name in parts.values() for n in (*STANDING[name], 0.5)[: len(ends)]]
    return table([header, [0, *row], [1, *row]])


def movenet(people: int) -> np.ndarray:
    """What MoveNet returns of one image, for one person or for six of whom some are there."""
    rows = points(COCO_17)[:, [1, 0, 2]] / [SIZE[1], SIZE[0], 1]
    if people == 1:
        return rows[None, None].astype("f4")
    found = np.zeros((1, 6, 56), "f4")
    found[0, :people] = [*rows.ravel(), 0, 0, 1, 1, 0.9]
    return found


def freemocap(cameras: int = 2, frames: int = 2) -> np.ndarray:
    """MediaPipe's points in pixels, those of hands and face after those of the body."""
    body = np.concatenate([points(MEDIAPIPE_33, -0.3), np.full((520, 3), np.nan)])
    return np.broadcast_to(body, (cameras, frames, *body.shape)).copy()


def sleap(file: h5py.File, dims: bool = True) -> None:
    """Two tracks, of whom the second is in one of two frames; without dims as SLEAP itself wrote
    it."""
    tracks = np.full((2, 2, len(PARTS), 2), np.nan)  # frame, track, node, xy
    tracks[:] = [STANDING[name] for name in PARTS.values()]
    tracks[1, 1] = np.nan
    scores = np.where(np.isnan(tracks[..., 0]), np.nan, 0.5)
    names = list(PARTS)
    if dims:
        file.create_dataset("tracks", data=tracks, compression="gzip")
        file["tracks"].attrs["dims"] = json.dumps(["frame", "track", "node", "xy"])
        file.create_dataset("point_scores", data=scores.astype("f4"))
        file["point_scores"].attrs["dims"] = json.dumps(["frame", "track", "node"])
        file.create_dataset("node_names", data=names, dtype=h5py.string_dtype())
    else:
        file.create_dataset("tracks", data=np.transpose(tracks, (1, 3, 2, 0)))
        file.create_dataset("point_scores", data=np.transpose(scores, (1, 2, 0)))
        file.create_dataset("node_names", data=np.array(names, "S"))
    file.create_dataset("track_occupancy", data=~np.isnan(tracks[..., 0, 0]))


def vitpose(kept: int = 17) -> list[list[dict[str, object]]]:
    """Two images, of one and of two people; the first `kept` points alone have their labels."""
    person = {
        "keypoints": points(COCO_17)[:kept, :2].tolist(),
        "scores": points(COCO_17)[:kept, 2].tolist(),
        "labels": list(range(kept)),
        "bbox": [0.0, 0.0, 200.0, 200.0],
    }
    return [[person], [person, person]]


def mpii(**fields: object) -> dict[str, object]:
    record = {"joints": points(MPII_16)[:, :2].tolist(), "joints_vis": [1] * MPII_16.count}
    return {**record, "image": "005808361.jpg", "scale": 4.7, "center": [966, 340], **fields}


def listed_points(layout: Layout, scale: tuple[int, int] = (1, 1)) -> dict[str, object]:
    """A pose of TensorFlow.js."""
    rows = zip(layout.points, points(layout, 0.9), strict=True)
    named = [
        {"x": x / scale[0], "y": y / scale[1], "score": score, "name": name}
        for name, (x, y, score) in rows
    ]
    return {"score": 0.8, "keypoints": named}


SWIFT = {
    "root": "pelvis",
    "neck": "thorax",
    **{
        f"{side}{part.title()}": f"{side}_{part}"
        for side in ("left", "right")
        for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "eye", "ear")
    },
}
"""Vision's names of joints in Swift."""


def vision(names: dict[str, str]) -> dict[str, object]:
    """A person of Apple's Vision: fractions from the lower left."""
    return {
        theirs: {
            "x": STANDING[ours][0] / SIZE[0],
            "y": 1 - STANDING[ours][1] / SIZE[1],
            "confidence": 0.8,
        }
        for theirs, ours in names.items()
    }


def semicolons(text: str) -> str:
    """A table as a European spreadsheet writes it."""
    return text.replace(",", ";").replace(".", ",")


def tabs(text: str) -> str:
    return text.replace(",", "\t")


def envelope(layout: Layout, **more: object) -> dict[str, object]:
    """OpenPose's, of two people in any order."""
    return {**openpose(*[points(layout).ravel().tolist()] * 2), **more}


CANVAS = {"canvas_width": SIZE[0], "canvas_height": SIZE[1]}


def flat_record(layout: Layout) -> dict[str, object]:
    return {"keypoints": points(layout).ravel().tolist(), "score": 2.9, "category_id": 1}


def mlkit() -> dict[str, object]:
    rows = zip(COCO_17.points, points(COCO_17), strict=True)
    return {
        "landmarks": [
            {
                "type": name.upper(),
                "position": {"x": x, "y": y, "z": 0.0},
                "inFrameLikelihood": score,
            }
            for name, (x, y, score) in rows
        ]
    }


def posenet() -> dict[str, object]:
    """One pose of the older TensorFlow.js."""
    rows = zip(COCO_17.points, points(COCO_17), strict=True)
    camel = {name: re.sub("_(.)", lambda m: m[1].upper(), name) for name in COCO_17.points}
    listed = [
        {"part": camel[name], "position": {"x": x, "y": y}, "score": score}
        for name, (x, y, score) in rows
    ]
    return {"score": 0.9, "keypoints": listed}


def easy_vitpose() -> dict[str, object]:
    rows = points(COCO_17)[:, [1, 0, 2]].tolist()
    return {
        "keypoints": [{"0": rows}, {"0": rows, "3": rows}],
        "skeleton": {str(i): name for i, name in enumerate(COCO_17.points)},
    }


def st_gcn() -> dict[str, object]:
    rows = points(COCO_18)
    person = {"pose": (rows[:, :2] / SIZE).ravel().tolist(), "score": rows[:, 2].tolist()}
    return {"data": [{"frame_index": 1, "skeleton": [person, person]}], "label": "walking"}


def opencv(layout: Layout = BODY_25) -> str:
    numbers = ", ".join(f"{number:e}" for number in points(layout).ravel())
    return (
        f"%YAML:1.0\n---\npose_0:\n   sizes: [ 1, {layout.count}, 3 ]\n"
        f"   type_id: opencv-nd-matrix\n   dt: f\n   data: [ {numbers} ]\n"
    )


def opencv_json(layout: Layout = COCO_18) -> str:
    data = points(layout).ravel().tolist()
    array = {"type_id": "opencv-nd-matrix", "sizes": [1, layout.count, 3], "dt": "f", "data": data}
    return json.dumps({"pose_0": array})


def opencv_xml(layout: Layout = BODY_25) -> str:
    numbers = " ".join(f"{number:g}" for number in points(layout).ravel())
    return (
        '<?xml version="1.0"?>\n<opencv_storage>\n<pose_0 type_id="opencv-nd-matrix">\n'
        f"  <sizes>\n    1 {layout.count} 3</sizes>\n  <dt>f</dt>\n  <data>\n"
        f"    {numbers}</data></pose_0>\n</opencv_storage>\n"
    )


def pixel_trc(layout: Layout = HALPE_26) -> str:
    """Sports2D's, whose y counts upwards."""
    lines = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
    ]
    lines += [f"30\t30\t2\t{layout.count}\tpx", "Frame#\tTime\t" + "\t\t\t".join(layout.points)]
    lines += ["\t\tX1\tY1\tZ1", ""]
    cells = "\t".join(f"{x:g}\t{-y:g}\t0.0" for x, y, _ in points(layout))
    return "\n".join([*lines, f"1\t0.0\t{cells}", f"2\t0.033\t{cells}"]) + "\n"


def by_name(*, scored: bool) -> dict[str, object]:
    rows = zip(COCO_17.points, points(COCO_17), strict=True)
    return {name: row[: 2 + scored].tolist() for name, row in rows}


def files() -> dict[str, list[bytes]]:
    """Undamaged files of `STANDING` as it is, by the name of their format."""
    return {
        "trc": [pixel_trc().encode()],
        "opencv": [
            text.encode() for text in (opencv(), opencv(COCO_18), opencv_json(), opencv_xml())
        ],
        "easy-vitpose": [json.dumps(easy_vitpose()).encode()],
        "st-gcn": [json.dumps(st_gcn()).encode()],
        "named-points": [
            json.dumps(by_name(scored=False)).encode(),
            json.dumps([by_name(scored=True)] * 2).encode(),
            json.dumps({"a.jpg": by_name(scored=True)}).encode(),
        ],
        "movenet": [npy(movenet(1)), npy(movenet(2)), npy(np.stack([movenet(1)] * 2))],
        "freemocap": [npy(freemocap()), npy(freemocap()[..., :2].astype("f4"))],
        "sleap": [hdf5(sleap), hdf5(lambda file: sleap(file, dims=False))],
        "rtmlib": [
            npz(keypoints=points(layout)[None, :, :2], scores=points(layout)[None, :, 2])
            for layout in (COCO_17, HALPE_26)
        ],
        "mpii": [json.dumps([mpii(), mpii()]).encode()],
        "instances": [
            json.dumps(
                [{"bbox": [0, 0, 9, 9, 1], "keypoints": points(COCO_17).tolist()}] * 2
            ).encode(),
            json.dumps(vitpose()).encode(),
            json.dumps(
                {
                    "keypoints": [points(HALPE_26)[:, :2].tolist()] * 2,
                    "scores": [points(HALPE_26)[:, 2].tolist()] * 2,
                }
            ).encode(),
            json.dumps(
                {"scores": [0.99], "pred_keypoints": [points(COCO_17, 0.2).tolist()]}
            ).encode(),
            json.dumps({"image": "a.jpg", "keypoints": points(COCO_17)[:, :2].tolist()}).encode(),
            json.dumps({"keypoints": points(COCO_17).ravel().tolist()}).encode(),
            *(
                json.dumps(
                    [{key: [points(COCO_17).tolist()] * 2, "bboxes": [[0] * 4] * 2}]
                ).encode()
                for key in ("preds", "bodyparts", "keypoints")
            ),
            json.dumps(
                {
                    "filename": "a.jpg",
                    "width": SIZE[0],
                    "height": SIZE[1],
                    "annots": [{"personID": 0, "keypoints": points(BODY_25).tolist()}],
                }
            ).encode(),
        ],
        "tensorflow.js": [
            json.dumps([listed_points(COCO_17)] * 2).encode(),
            json.dumps([listed_points(MEDIAPIPE_33, SIZE)]).encode(),
            json.dumps([mlkit()] * 2).encode(),
            json.dumps(posenet()).encode(),
            json.dumps({"frames": [{"poses": [listed_points(COCO_17)]}] * 2}).encode(),
        ],
        "vision": [
            json.dumps(vision(VISION)).encode(),
            json.dumps([{"joints": vision(SWIFT)}, {"joints": vision(SWIFT)}]).encode(),
        ],
        "poseterior": [
            json.dumps(
                native_with(image_id="a", image_size=[9, 9], face={"nose": [1, 2, 1]})
            ).encode()
        ],
        "openpose": [
            json.dumps(one).encode()
            for one in (
                envelope(BODY_25),
                envelope(BODY_25B),
                envelope(COCO_18),
                envelope(COCO_17),
                envelope(HALPE_26),
                [envelope(COCO_18, **CANVAS)] * 2,
                {"bodies": [{"joints": flat(COCO_18.points)}]},
                openpose([points(COCO_18)[:, 1::-1].ravel().tolist()]),
            )
        ],
        "coco-annotations": [
            json.dumps(annotations({"keypoints": flat(COCO_17.points, 2)})).encode(),
            json.dumps(
                annotations(
                    {"keypoints": points(HALPE_136, 2).ravel().tolist()},
                    categories=[{"id": 1, "name": "person", "keypoints": []}],
                )
            ).encode(),
        ],
        "coco-results": [
            *(
                json.dumps(results(*[points(layout).ravel().tolist()] * 2)).encode()
                for layout in (COCO_17, HALPE_26, MPII_16)
            ),
            json.dumps([flat_record(COCO_17)] * 2).encode(),
            lines(*results(*[points(COCO_17).ravel().tolist()] * 2)),
            lines(*({"frame": n, "predictions": [flat_record(COCO_17)]} for n in (1, 2))),
        ],
        "alphapose": [
            json.dumps(
                {
                    "1.jpg": {
                        "version": "0.3",
                        "people": [{"pose_keypoints_2d": flat(COCO_18.points)}],
                    }
                }
            ).encode(),
            json.dumps(
                {"1.jpg": {"version": "0.3", "bodies": [{"joints": flat(COCO_18.points)}] * 2}}
            ).encode(),
            json.dumps({"0.jpg": [flat_record(HALPE_26)], "1.jpg": []}).encode(),
        ],
        "mmpose": [
            json.dumps([mmpose_instance(COCO_17)]).encode(),
            json.dumps(mmpose(H36M_17, dataset_name="h36m")).encode(),
            json.dumps(
                mmpose(
                    COCO_18,
                    keypoint_id2name={str(i): name for i, name in enumerate(COCO_18.points)},
                )
            ).encode(),
        ],
        "mediapipe": [
            json.dumps(landmarks()).encode(),
            json.dumps([landmarks(), landmarks(visibility=4.0)]).encode(),
            json.dumps({"pose_landmarks": [landmarks()]}).encode(),
            json.dumps([{"frame": n, "landmarks": landmarks()} for n in (3, 5)]).encode(),
            json.dumps(
                {"frames": [{"poseLandmarks": landmarks()}, {"poseLandmarks": []}]}
            ).encode(),
        ],
        "mediapipe-text": [landmark_text().encode()],
        "mediapipe-csv": [
            long_landmarks().encode(),
            wide_landmarks().encode(),
            semicolons(wide_landmarks()).encode(),
            tabs(long_landmarks()).encode(),
        ],
        "csv": [
            named_columns().encode(),
            named_columns(score="").encode(),
            named_columns(score="c").encode(),
            semicolons(named_columns()).encode(),
            tabs(named_columns()).encode(),
        ],
        "ultralytics-text": [
            yolo_text(3).encode(),
            (yolo_text(3, 0.9) + yolo_text(3, 0.8)).encode(),
            yolo_text(2, 0.9, 4).encode(),
        ],
        "ultralytics": [
            json.dumps([yolo(), yolo(track_id=4)]).encode(),
            json.dumps([yolo(SIZE)]).encode(),
            json.dumps([[yolo(), yolo()], [yolo()]]).encode(),
        ],
        "deeplabcut-csv": [
            table(deeplabcut_rows()).encode(),
            table(deeplabcut_rows(("ann", "bob"))).encode(),
            semicolons(table(deeplabcut_rows())).encode(),
            tabs(table(deeplabcut_rows())).encode(),
        ],
        "deeplabcut-hdf5": [hdf5(deeplabcut_fixed), hdf5(deeplabcut_table)],
        "videopose3d": [npz(**{"S1/Walking/0": points(H36M_17)[None, :, :2].repeat(2, 0)})],
        "heatmaps": [
            npy(blobs().astype("f4")),
            npz(heatmaps=blobs(COCO_17)[None].astype("f4"), box=BOX),
            hdf5(
                lambda file: file.create_dataset(
                    "heatmaps", data=blobs()[None].astype("f4"), compression="gzip"
                )
            ),
        ],
        "hourglass": [
            hdf5(lambda file: file.create_dataset("preds", data=points(MPII_16)[None, :, :2]))
        ],
    }


FILES = files()
"""Undamaged files, by the name of their format."""


@contextmanager
def standing(**places: tuple[float, float]) -> Iterator[None]:
    """Meanwhile `STANDING` has some of its points elsewhere."""
    before = dict(STANDING)
    STANDING.update(places)
    try:
        yield
    finally:
        STANDING.update(before)


class Bomb:
    """What must never be unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (_explode, ("unpickled",))


def _explode(word: str) -> None:
    raise AssertionError(word)


PICKLES = {
    "npy": npy(np.array([Bomb()], object), pickled=True),
    "npz": npz(positions_2d=np.array({"S1": Bomb()}, object)),
    "npz of heatmaps": npz(heatmaps=np.array([Bomb()], object)),
    "labels": hdf5(
        lambda file: (
            deeplabcut_table(file),
            file["df_with_missing/table"].attrs.__setitem__(
                "values_block_0_kind", np.bytes_(pickle.dumps([Bomb()], protocol=0))
            ),
        )
    ),
    "bare": pickle.dumps(Bomb()),
}


@pytest.mark.parametrize("name", PICKLES)
def test_no_pickle_is_ever_run(name: str) -> None:
    with pytest.raises(BadInput, match=r"pickle|not UTF-8|not valid JSON"):
        read_content(Content(PICKLES[name], "a file", SIZE))


_DIGITS = np.frombuffer(b"0123456789", np.uint8)


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes or bits changed, a part cut out, doubled, or swapped for a number that hurts;
    most often one digit for another, which leaves a file that can be read."""
    content = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(len(content))) if content else 0
        if not content:
            return b""
        kind = rng.integers(9)
        if kind == 0:
            content[place] = int(rng.integers(256))
        elif kind == 1:
            content[place] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del content[place:]
        elif kind == 3:
            del content[place : place + int(rng.integers(1, 64))]
        elif kind > 5:
            digits = np.flatnonzero(np.isin(np.frombuffer(bytes(content), np.uint8), _DIGITS))
            if len(digits):
                content[int(rng.choice(digits))] = int(rng.choice(_DIGITS))
        elif kind == 4:
            content[place:place] = content[place : place + int(rng.integers(1, 64))]
        else:
            hurting = (
                b"NaN",
                b"-1e999",
                b"null",
                b"{}",
                b"[]",
                b'"',
                b"\xff" * 8,
                b"\x00" * 8,
                b"9" * 40,
            )
            content[place : place + 2] = hurting[int(rng.integers(len(hurting)))]
    return bytes(content)


def fuzz(count: int, seed: int) -> dict[str, int]:
    """Reads `count` damaged files and says how many were read and refused; anything else raises."""
    rng = np.random.default_rng(seed)
    originals = [(name, data) for name, several in FILES.items() for data in several]
    said = {"read": 0, "refused": 0}
    for number in range(count):
        name, data = originals[number % len(originals)]
        bytes_ = damaged(data, rng)
        format = "auto" if rng.random() < 0.7 else name
        started = time.thread_time()  # not the clock: other processes may be busy
        try:
            people = read_content(Content(bytes_, "a file", SIZE), format)
        except BadInput as error:
            message = str(error)
            assert message.endswith("."), message
            assert "\n" not in message, message
            assert len(message) < 600, message
            said["refused"] += 1
        else:
            assert [person.person for person in people] == list(range(len(people)))
            said["read"] += 1
        assert time.thread_time() - started < SLOWEST, name
    return said


@pytest.mark.parametrize("count", [2_000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_files_of_every_format(count: int) -> None:
    """Seeded, so that it finds the same every time; both outcomes must occur, or nothing was
    tested."""
    said = fuzz(count, seed=count)
    assert min(said.values()) > count // 20, said


@pytest.mark.parametrize("name", FILES)
def test_any_format_may_be_asked_for_any_file(name: str) -> None:
    refused = 0
    for several in FILES.values():
        for data in several:
            try:
                read_content(Content(data, "a file", SIZE), name)
            except BadInput:
                refused += 1
    assert refused > 0  # no file is of every format


@pytest.mark.parametrize("name", FILES)
def test_every_format_is_recognised_by_its_content(name: str) -> None:
    assert name in FORMATS
    for data in FILES[name]:
        assert format_of(Content(data, "a file", SIZE)).name == name
