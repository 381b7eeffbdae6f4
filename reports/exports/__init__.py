"""Results for other people's software: BVH, C3D, TRC, glTF, CSV, .npz, .mot and .sto.

`results.read_clip` reads a result, `clip.Clip` is what all writers take, and each format is one
file. All formats have the same axes: x to the right of the image, y up, z towards the camera,
right-handed, the pelvis at the origin."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from poseterior.probmodel.failures import BadInput
from poseterior.reports.exports.bvh import write_bvh
from poseterior.reports.exports.c3d import write_c3d
from poseterior.reports.exports.clip import UNITS, Clip
from poseterior.reports.exports.gltf import write_gltf
from poseterior.reports.exports.measures import write_motion
from poseterior.reports.exports.tables import write_csv, write_npz
from poseterior.reports.exports.trc import write_trc

Writer = Callable[[Clip, Path, str], None]


class Exporter(NamedTuple):
    """A format: who writes it, the `suffix` of its files, and the units it may be in, the usual one
    first."""

    write: Writer
    suffix: str
    units: tuple[str, ...]


TARGETS = {
    "bvh": Exporter(write_bvh, ".bvh", ("m", "mm")),
    "c3d": Exporter(write_c3d, ".c3d", ("mm", "m")),
    "trc": Exporter(write_trc, ".trc", ("mm", "m")),
    "gltf": Exporter(write_gltf, ".glb", ("m",)),
    "csv": Exporter(write_csv, ".csv", ("mm", "m")),
    "npz": Exporter(write_npz, ".npz", ("mm", "m")),
    "mot": Exporter(write_motion, ".mot", ("m", "mm")),
    "sto": Exporter(write_motion, ".sto", ("m", "mm")),
}
"""Every format by its name; glTF is in metres by definition."""
OF_MEASURES = ("mot", "sto")
"""Formats of joint angles, lengths and steps alone."""
WITH_MEASURES = ("csv", *OF_MEASURES)
"""Formats that have room for them."""


def unit_of(to: str, unit: str | None) -> str:
    """The unit in which a format is written: its usual one, or the one asked for. Raises `BadInput`
    where the format cannot be in it."""
    allowed = TARGETS[to].units
    if unit is None:
        return allowed[0]
    if unit not in allowed:
        raise BadInput(f"{to} is in {allowed[0]} by definition; leave --unit {unit} out")
    return unit


__all__ = ["OF_MEASURES", "TARGETS", "UNITS", "WITH_MEASURES", "Clip", "Exporter", "unit_of"]
