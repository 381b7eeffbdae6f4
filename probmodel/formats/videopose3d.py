"""VideoPose3D's 2D joints, as plain arrays: a .npz with one array `(frames, 17, 2 or 3)` a camera.

Its own data_2d_*.npz pickle a dictionary, and pickles are not read. Whoever made or trusts such a
file saves it anew:

    z = numpy.load(file, allow_pickle=True)["positions_2d"].item()
    cameras = ((f"{s}/{a}/{c}", xy) for s in z for a in z[s] for c, xy in enumerate(z[s][a]))
    numpy.savez(new, **dict(cameras))

Human3.6M's 17 joints, where an array is named like these; others have the order that an array
`layout` or the user names. Without a third column all scores are 1."""

from collections.abc import Iterator
from dataclasses import replace

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, chosen_layout, said_layout
from poseterior.probmodel.formats.hourglass import scored
from poseterior.probmodel.layouts import H36M_17, Layout


def recognises(content: Content) -> bool:
    """A .npz that holds neither heatmaps nor predictions."""
    found = set(content.arrays.names())
    return (
        content.arrays.magic in (arrays.NPY, arrays.ZIP)
        and bool(found)
        and not found & {"", "heatmaps", "preds"}
    )


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Every frame of every camera, camera after camera; frames are named `<array>/<index>`."""
    found = content.arrays.names()
    if "positions_2d" in found or "metadata" in found:
        raise BadInput(
            f"{content.source} pickles its arrays in a dictionary, and pickles, which could run any"
            " code, are not read; save each camera as an array of its own (see the reader's"
            " documentation for the lines that do)."
        )
    if content.layout is None and "layout" in found:
        name = arrays.first_text(content.arrays.read(["layout"])["layout"])
        content = replace(content, layout=name)
    person = 0
    for name in (name for name in found if name != "layout"):
        where = f"{name} of {content.source}"
        points = arrays.plain(content.arrays.read([name])[name], where)
        layout = _layout(name, points.shape, content, where)
        if points.ndim != 3 or points.shape[1] != layout.count or points.shape[2] not in (2, 3):
            raise BadInput(
                f"{where} has the shape {points.shape}, not (frames, {layout.count}, 2 or 3) of"
                f" {layout.name}; give a layout that fits, and pixels of 2D joints only."
            )
        for frame, rows in enumerate(points):
            place = f"frame {frame} of {where}"
            yield layout.detection(
                scored(rows, place), threshold, content.source, person, f"{name}/{frame}"
            )
            person += 1


def _layout(name: str, shape: tuple[int, ...], content: Content, where: str) -> Layout:
    """Human3.6M's, for an array that bears subject, action and camera; else the one that is said,
    which 17 points do not tell."""
    said = said_layout(content) or (H36M_17 if name.count("/") == 2 or len(shape) != 3 else None)
    return said or chosen_layout(shape[1], content, where, ())
