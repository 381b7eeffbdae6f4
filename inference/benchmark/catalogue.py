"""The frozen targets by name, read from data whose checksums stand here.

    target = load("arm")
    target.log_density(points)

A target never changes: whoever needs another one adds it under another name."""

import functools
import hashlib
import json
from importlib import resources
from typing import Any

import numpy as np

from poseterior.inference.benchmark.anatomy import FrozenAnatomy
from poseterior.inference.benchmark.root import BoxedRoot, FrozenRoot, GivenRoot
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.probmodel.failures import BadInput

CHECKSUMS = {
    "anatomy.npz": "98b700b6c6ffc56f76ae16f723a2cddeb37050ace3262a521c39880a27d13e6a",
    "targets.json": "a417aaccf079a8e11c1e129510bd88f04f0ab5e488691a1a77a85982aedd381c",
}
"""SHA-256 of the files in `inference.benchmark.data` that targets are made of."""


@functools.cache
def targets() -> dict[str, FrozenTarget]:
    """Every target by its name, easy ones first. Raises `BadInput` where a file is not the frozen
    one."""
    for name, wanted in CHECKSUMS.items():
        if (found := hashlib.sha256(_content(name)).hexdigest()) != wanted:
            raise BadInput(
                f"{name} of the benchmark has the checksum {found[:12]}…, not {wanted[:12]}…, so"
                " its targets are not the frozen ones; install poseterior anew"
            )
    records = json.loads(_content("targets.json"))
    return {record["name"]: _target(record) for record in records}


def load(name: str) -> FrozenTarget:
    """The target of that name. Raises `BadInput` that says which there are."""
    found = targets()
    if name not in found:
        raise BadInput(f"there is no target {name!r}; choose one of {', '.join(found)}")
    return found[name]


def _content(name: str) -> bytes:
    return (resources.files("poseterior.inference.benchmark.data") / name).read_bytes()


def _target(record: dict[str, Any]) -> FrozenTarget:
    return FrozenTarget(
        name=record["name"],
        about=record["about"],
        root=_root(record),
        seen_at=np.array(record["seen_at"], float),
        score=np.array(record["score"], float),
        factor=record["factor"],
        law=record["law"],
    )


def _root(record: dict[str, Any]) -> FrozenRoot:
    if "view" in record:
        return GivenRoot(np.array(record["view"], float))
    torsos = FrozenAnatomy.default().torsos[record["torsos"]]
    return BoxedRoot(torsos, np.array(record["scale"]), np.array(record["place"], float))
