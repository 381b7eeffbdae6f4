"""Stacked Hourglass and other heatmap networks: arrays of heatmaps, or of the points that were
found in them.

    heatmaps   (J, H, W) or (n, J, H, W); .npy, or an array of that name in .npz or HDF5
    preds      (n, J, 2) or (n, J, 3): x, y (pixels of the image) and perhaps a score; .npz or HDF5

Beside them may stand `center` `(n, 2)` and `scale` `(n,)` (MPII's; the box is 200 · scale wide) or
`box` `(n, 4)` (x, y, width, height), and `layout`, a name of `layouts.LAYOUTS`. Sixteen channels
are MPII's, seventeen COCO's."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, chosen_layout
from poseterior.probmodel.heatmaps import Crop, Decoded, decode
from poseterior.probmodel.layouts import Layout

LARGEST_SCORE = 100.0
"""Detectors' scores are probabilities, per cents, or a few times 1."""
_BESIDE = ["center", "scale", "box", "layout"]


def recognises_heatmaps(content: Content) -> bool:
    """A .npy, or `heatmaps` in a .npz or HDF5 file."""
    return bool({"", "heatmaps"} & set(content.arrays.names()))


def recognises_points(content: Content) -> bool:
    """`preds` in a .npz or HDF5 file."""
    return "preds" in content.arrays.names()


def read_heatmaps(content: Content, threshold: float) -> Iterator[Detection]:
    """One person for each set of heatmaps."""
    return (decoded.detection for decoded in decoded_heatmaps(content, threshold))


def decoded_heatmaps(content: Content, threshold: float) -> Iterator[Decoded]:
    """The same with the alternatives of each joint."""
    found = content.arrays.read(["", "heatmaps", *_BESIDE])
    maps = found.get("heatmaps", found.get(""))
    if maps is None or maps.ndim not in (3, 4):
        shape = "none" if maps is None else str(maps.shape)
        raise BadInput(
            f"{content.source} holds no heatmaps (joints, height, width) but {shape}; save them so."
        )
    maps = maps[None] if maps.ndim == 3 else maps
    layout = _layout(found, maps.shape[1], content)
    for person, (heatmaps, crop) in enumerate(
        zip(maps, _crops(found, len(maps), content.source), strict=True)
    ):
        where = f"person {person} of {content.source}"
        values = arrays.plain(heatmaps, f"the heatmaps of {where}")
        decoded = decode(
            values, layout, crop, threshold=threshold, source=content.source, person=person
        )
        yield decoded


def read_points(content: Content, threshold: float) -> Iterator[Detection]:
    """One person for each row of `preds`; without scores, all are 1."""
    found = content.arrays.read(["preds", *_BESIDE])
    if "preds" not in found:
        raise BadInput(f"{content.source} has no array 'preds'; give a file of predictions.")
    points = arrays.plain(found["preds"], f"'preds' of {content.source}")
    points = points[None] if points.ndim == 2 else points
    if points.ndim != 3 or points.shape[2] not in (2, 3):
        raise BadInput(
            f"'preds' of {content.source} has the shape {points.shape}, not (people, joints, 2"
            " or 3)."
        )
    layout = _layout(found, points.shape[1], content)
    for person, rows in enumerate(points):
        yield layout.detection(
            scored(rows, f"person {person} of {content.source}"), threshold, content.source, person
        )


def scored(rows: FloatArray, where: str) -> FloatArray:
    """`(J, 3)` rows of x, y, score: score 1 where `rows` has none, 0 where a number is missing."""
    points = np.column_stack(
        [rows[:, :2], rows[:, 2] if rows.shape[1] == 3 else np.ones(len(rows))]
    )
    points[np.isnan(points).any(axis=1)] = 0.0
    if (points[:, 2] < 0).any():
        raise BadInput(f"a score of {where} is negative; give 0 for a joint that was not detected.")
    if points[:, 2].max(initial=0.0) > LARGEST_SCORE:
        raise BadInput(
            f"the third numbers of {where} run to {points[:, 2].max():g}, which are no scores, but"
            " perhaps depths; give x, y and, if there is one, a score (3D poses are for check,"
            " learn and evaluate)."
        )
    return points


def _layout(found: Mapping[str, np.ndarray], count: int, content: Content) -> Layout:
    """The layout that the user names, or else the file, or that of so many channels."""
    if content.layout is None and "layout" in found:
        content = replace(content, layout=arrays.first_text(found["layout"]))
    return chosen_layout(count, content, content.source)


def _crops(found: Mapping[str, np.ndarray], count: int, source: str) -> list[Crop | None]:
    """The box of each person; None where the file says nothing."""
    if "box" in found:
        box = _beside(found, "box", (count, 4), source)
        return [Crop(row[:2], row[2:]) for row in box]
    if "center" in found and "scale" in found:
        centre, scale = (
            _beside(found, "center", (count, 2), source),
            _beside(found, "scale", (count,), source),
        )
        return [
            Crop.around(middle, float(size)) for middle, size in zip(centre, scale, strict=True)
        ]
    return [None] * count


def _beside(
    found: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], source: str
) -> FloatArray:
    values = arrays.plain(found[name], f"'{name}' of {source}")
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise BadInput(
            f"'{name}' of {source} has the shape {values.shape}, not {shape}, or is not finite."
        )
    sizes = {"box": values.reshape(shape)[..., 2:], "scale": values}.get(name, np.ones(1))
    if not (sizes > 0).all():
        raise BadInput(
            f"'{name}' of {source} holds a size that is not positive; give pixels of the image."
        )
    return values.reshape(shape)
