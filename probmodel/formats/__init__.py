"""Files of 2D joints: `read_detections` reads them all, `write_detections` writes this project's
own.

`FORMATS` is the table of readers; adding a format is one module and one row. A format is recognised
by its content, never by the name of the file. Folders and long files are read frame by frame:
`read_frames`."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import LARGEST_FILE, read_bytes, replacing
from poseterior.probmodel.formats import (
    alphapose,
    coco,
    deeplabcut,
    easy_vitpose,
    hourglass,
    instances,
    mediapipe,
    mmpose,
    mpii,
    named_points,
    named_table,
    native,
    opencv,
    openpose,
    planar_trc,
    point_arrays,
    sleap,
    st_gcn,
    ultralytics,
    videopose3d,
)
from poseterior.probmodel.formats.common import Content, at_least_one_joint
from poseterior.probmodel.formats.kinds import seeming
from poseterior.probmodel.formats.units import Unit, in_pixels
from poseterior.probmodel.heatmaps import THRESHOLD as HEATMAP_THRESHOLD
from poseterior.probmodel.layouts import BODY_25, BODY_25B, COCO_18

__all__ = [
    "FORMATS",
    "Content",
    "Format",
    "content_of",
    "format_of",
    "people_of",
    "read_content",
    "read_detections",
    "write_detections",
]


class Format(NamedTuple):
    """A row of `FORMATS`: `recognises` is None for a format that is read only where it is asked for
    by name. A joint with a score up to `threshold` is missing, where no other threshold is given.
    Coordinates are counted in `unit`, or in what they look like (`units`): from the image's middle
    too, where the detector can be asked for that (`centred`)."""

    name: str
    about: str
    recognises: Callable[[Content], bool] | None
    read: Callable[[Content, float], Iterator[Detection]]
    threshold: float = 0.0
    unit: Unit | None = None
    centred: bool = False


_LANDMARKS: Any = {"threshold": mediapipe.MISSING_VISIBILITY, "unit": Unit.FRACTIONS}
_ROWS = (
    Format(
        "movenet",
        "MoveNet .npy",
        point_arrays.recognises_movenet,
        point_arrays.read_movenet,
        unit=Unit.FRACTIONS,
    ),
    Format(
        "freemocap",
        "FreeMoCap .npy",
        point_arrays.recognises_freemocap,
        point_arrays.read_freemocap,
    ),
    Format(
        "points", "a .npy of points (with a layout)", point_arrays.recognises, point_arrays.read
    ),
    Format(
        "heatmaps",
        "heatmaps",
        hourglass.recognises_heatmaps,
        hourglass.read_heatmaps,
        HEATMAP_THRESHOLD,
        unit=Unit.PIXELS,
    ),
    Format(
        "hourglass",
        "Stacked Hourglass preds",
        hourglass.recognises_points,
        hourglass.read_points,
    ),
    Format("sleap", "SLEAP analysis HDF5", sleap.recognises, sleap.read),
    Format("deeplabcut-hdf5", "DeepLabCut HDF5", deeplabcut.recognises_hdf5, deeplabcut.read_hdf5),
    Format("rtmlib", "RTMLib .npz", point_arrays.recognises_rtmlib, point_arrays.read_rtmlib),
    Format("videopose3d", "VideoPose3D .npz", videopose3d.recognises, videopose3d.read),
    Format("deeplabcut-csv", "DeepLabCut CSV", deeplabcut.recognises_csv, deeplabcut.read_csv),
    Format(
        "mediapipe-text",
        "MediaPipe text",
        mediapipe.recognises_text,
        mediapipe.read_text,
        **_LANDMARKS,
    ),
    Format(
        "mediapipe-csv",
        "MediaPipe CSV",
        mediapipe.recognises_table,
        mediapipe.read_table,
        **_LANDMARKS,
    ),
    Format("csv", "a table of named columns", named_table.recognises, named_table.read),
    Format("trc", "Sports2D TRC in pixels", planar_trc.recognises, planar_trc.read),
    Format("opencv", "OpenPose YAML, JSON or XML of OpenCV", opencv.recognises, opencv.read),
    Format(
        "ultralytics-text",
        "Ultralytics YOLO-pose text",
        ultralytics.recognises_text,
        ultralytics.read_text,
        unit=Unit.FRACTIONS,
    ),
    Format("poseterior", "poseterior JSON", native.recognises, native.read, unit=Unit.PIXELS),
    Format("openpose", "OpenPose JSON", openpose.recognises, openpose.read, centred=True),
    *(
        Format(
            f"openpose-{layout.name.replace('_', '')}",
            f"OpenPose JSON, {layout.name} for certain",
            None,
            openpose.reader(layout),
            centred=True,
        )
        for layout in (BODY_25, BODY_25B, COCO_18)
    ),
    Format(
        "coco-annotations", "COCO annotations", coco.recognises_annotations, coco.read_annotations
    ),
    Format(
        "ultralytics",
        "Ultralytics YOLO-pose JSON",
        ultralytics.recognises_json,
        ultralytics.read_json,
    ),
    Format("easy-vitpose", "easy_ViTPose JSON", easy_vitpose.recognises, easy_vitpose.read),
    Format("st-gcn", "ST-GCN Kinetics JSON", st_gcn.recognises, st_gcn.read),
    Format(
        "tensorflow.js",
        "TensorFlow.js, PoseNet or ML Kit JSON",
        named_points.recognises_listed,
        named_points.read_listed,
    ),
    Format(
        "vision",
        "Apple Vision JSON",
        named_points.recognises_vision,
        named_points.read_vision,
        unit=Unit.FRACTIONS,
    ),
    Format(
        "named-points",
        "JSON of points by name",
        named_points.recognises_named,
        named_points.read_named,
    ),
    Format(
        "lists",
        "lists of points in JSON (with a layout)",
        point_arrays.recognises_lists,
        point_arrays.read_lists,
    ),
    Format("mpii", "MPII annotations", mpii.recognises, mpii.read),
    Format("mmpose", "MMPose or RTMPose JSON", mmpose.recognises, mmpose.read),
    Format(
        "mediapipe",
        "MediaPipe JSON",
        mediapipe.recognises_json,
        mediapipe.read_json,
        **_LANDMARKS,
    ),
    Format(
        "coco-results",
        "COCO results, AlphaPose, OpenPifPaf or Detectron2",
        coco.recognises_results,
        coco.read_results,
    ),
    Format(
        "instances",
        "MMPose 0.x, ViTPose, RTMLib, EasyMocap or Detectron2 instances",
        instances.recognises,
        instances.read,
    ),
    Format("alphapose", "AlphaPose by image", alphapose.recognises, alphapose.read),
)
FORMATS = {row.name: row for row in _ROWS}
"""By name; the first whose `recognises` says yes is the one that `auto` takes. Those that look at
the first bytes come first."""


def read_detections(
    path: str | os.PathLike[str],
    format: str = "auto",
    threshold: float | None = None,
    *,
    image_size: tuple[int, int] | None = None,
    names: Mapping[str, str] | Sequence[str] | None = None,
    layout: str | None = None,
) -> list[Detection]:
    """Every person in a file of 2D joints, in the order of the file.

    A person of whom nothing is seen stays in the list, so that the numbers of the others do not
    change.

    Parameters
    ----------
    path
        A regular file.
    format
        "auto", or a name of `FORMATS`.
    threshold
        Joints with a score up to this are missing; None for the format's own, usually 0.
    image_size
        (width, height) in pixels, needed where coordinates are fractions of the image.
    names
        A detector's names of points → ours, where it names them freely; or ours in its order.
    layout
        The order of the joints, a name of `layouts.LAYOUTS`, for files that do not say it.

    Returns
    -------
    list of Detection
        Numbered from 0.

    Raises
    ------
    BadInput
        One sentence, for whatever is wrong with the file.
    """
    content = content_of(Path(path), image_size, names, layout)
    return read_content(content, format, threshold)


def read_content(
    content: Content, format: str = "auto", threshold: float | None = None
) -> list[Detection]:
    """`read_detections` of bytes that are in memory already."""
    row = format_of(content, format)
    return at_least_one_joint(
        list(people_of(content, row, threshold)), content.source, _threshold(row, threshold)
    )


def people_of(content: Content, row: Format, threshold: float | None) -> Iterator[Detection]:
    """The people of a file one by one, in pixels; there may be none."""
    people = row.read(content, _threshold(row, threshold))
    return in_pixels(people, row.unit or content.unit, content.image_size, centred=row.centred)


def _threshold(row: Format, threshold: float | None) -> float:
    chosen = row.threshold if threshold is None else threshold
    if not (math.isfinite(chosen) and chosen >= 0):
        raise BadInput(f"the threshold of the scores must be 0 or a positive number, not {chosen}.")
    return chosen


def write_detections(path: str | os.PathLike[str], detections: Sequence[Detection]) -> None:
    """Writes this project's JSON; a file that was there is replaced as a whole or, on any failure,
    not at all.

    Parameters
    ----------
    path
        The file.
    detections
        The people, in this order.

    Raises
    ------
    BadInput
        Where there is nothing to write, or it cannot be written there.
    """
    text = native.write(detections)
    with replacing(path, "choose another place") as partial:
        partial.write_text(text, encoding="utf-8")


def content_of(
    path: Path,
    image_size: tuple[int, int] | None = None,
    names: Mapping[str, str] | Sequence[str] | None = None,
    layout: str | None = None,
) -> Content:
    """The content of a file, with what the user knows of it beside. Raises `BadInput` where it
    cannot be read."""
    advice = "give the path of a file of 2D joints."
    data = read_bytes(path, "file of 2D joints", advice, largest=LARGEST_FILE)
    return Content(data, str(path), image_size, {} if names is None else names, layout)


def format_of(content: Content, name: str = "auto") -> Format:
    """The row of `FORMATS` of that name, or the one that recognises the content. Raises `BadInput`
    where none does."""
    if name in FORMATS:
        return FORMATS[name]
    if name != "auto":
        raise BadInput(f"there is no format {name!r}; choose auto or one of {', '.join(FORMATS)}.")
    if not content.data.strip():
        raise BadInput(f"{content.source} is empty; check what wrote it.")
    kind = seeming(content)
    if kind is not None and not any(one.recognises(content) for one in (planar_trc, opencv)):
        raise BadInput(f"{content.source} looks like {kind}.")
    for row in FORMATS.values():
        if row.recognises is not None and row.recognises(content):
            return row
    known = ", ".join(row.name for row in FORMATS.values() if row.recognises is not None)
    raise BadInput(
        f"{content.source} is of a shape that is not known here; the known ones are: {known}."
    )
