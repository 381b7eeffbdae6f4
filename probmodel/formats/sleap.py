"""SLEAP's analysis files (HDF5): `tracks` of freely named nodes, and `point_scores`.

The dimensions stand in an attribute `dims`; files without it have the older order, that of MATLAB:
(track, xy, node, frame). Names are matched as people write them (`layouts.spoken_name`); others
need a map of names. A point that is NaN is missing; one without a score was labelled by hand."""

import json
from collections.abc import Iterator

import numpy as np

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import Content, named_layout

DIMS = ("track", "xy", "node", "frame")


def recognises(content: Content) -> bool:
    """An HDF5 file with tracks and the names of nodes."""
    return content.arrays.magic == arrays.HDF5 and {"tracks", "node_names"} <= set(
        content.arrays.names()
    )


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Every track of every frame, frame after frame; a track that is not in a frame is left out."""
    source = content.source
    found = content.arrays.read(["tracks", "point_scores"])
    if "tracks" not in found:
        raise BadInput(f"{source} has no array 'tracks'; export an analysis file from SLEAP.")
    places = _ordered(found, content, "tracks", DIMS)
    layout = named_layout(content.arrays.texts("node_names"), content)
    nodes, width = places.shape[2:]
    if nodes != layout.count or width != 2:
        raise BadInput(
            f"'tracks' of {source} has {nodes} nodes of {width} numbers, but there are"
            f" {layout.count} names."
        )
    scores = np.ones(places.shape[:3])
    if "point_scores" in found:
        scores = _ordered(found, content, "point_scores", ("track", "node", "frame"))
        if scores.shape != places.shape[:3]:
            raise BadInput(f"'point_scores' of {source} has another shape than its tracks.")
    scores = np.nan_to_num(scores, nan=1.0)
    if (scores < 0).any():
        raise BadInput(f"a score of {source} is negative; give 0 or more.")
    there = np.isfinite(places).all(axis=-1)
    points = np.concatenate([places, scores[..., None]], axis=-1)
    points[~there] = 0.0
    for person, (frame, track) in enumerate(np.argwhere(there.any(axis=-1))):
        yield layout.detection(
            points[frame, track], threshold, source, person, str(frame), track=str(track)
        )


def _ordered(
    found: dict[str, np.ndarray], content: Content, name: str, usual: tuple[str, ...]
) -> FloatArray:
    """An array with its dimensions as frame, track, node and, where it has it, xy."""
    values = arrays.plain(found[name], f"'{name}' of {content.source}")
    said = content.arrays.attributes().get(name, {}).get("dims")
    dims = usual if said is None else _parsed(said)
    if values.ndim != len(usual) or sorted(dims) != sorted(usual):
        raise BadInput(
            f"'{name}' of {content.source} has the shape {values.shape} and the dimensions"
            f" {shown(list(dims))}, not {', '.join(usual)}."
        )
    order = [one for one in ("frame", "track", "node", "xy") if one in usual]
    return np.transpose(values, [dims.index(one) for one in order])


def _parsed(text: str) -> tuple[str, ...]:
    """The names of dimensions; none where the text is no list of them."""
    try:
        dims = json.loads(text)
    except (ValueError, RecursionError):
        return ()
    listed = isinstance(dims, list) and all(isinstance(one, str) for one in dims)
    return tuple(dims) if listed else ()
