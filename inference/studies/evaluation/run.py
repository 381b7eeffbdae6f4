"""An evaluation from end to end: every frame of a data set under every condition, written as it
comes.

A run that was stopped, or whose workers died, goes on where it was and ends with the same bits.

    results = evaluate(data, conditions(("zhou",), (0, 1, 2), (0,)), protocol, Path("out"), workers=2)
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inference.results import versions
from inference.studies.evaluation.conditions import Condition
from inference.studies.evaluation.outcome import Protocol
from inference.studies.evaluation.store import BLOCK, Store
from inference.studies.evaluation.workers import Work, client, judge
from probmodel.datasets import DataSet
from probmodel.learning.dictionaries import PoseDictionary

STORE = "frames.zarr"
Progress = Callable[[int, int], None]
Results = dict[Condition, dict[str, np.ndarray]]
"""What came out of every frame, by condition and field (`Protocol.fields`)."""


def evaluate(
    data: DataSet,
    conditions: Sequence[Condition],
    protocol: Protocol,
    out: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    cache: str | None = None,
    progress: Progress | None = None,
) -> Results:
    """Judges every frame under every condition, and writes it to `out`; what is there already is
    kept.

    `workers` processes of this machine do it, or the cluster at the address `scheduler`; `cache` is
    a folder for compiled code. `progress(done, wanted)` counts frames. Raises `BadInput` where
    `out` holds another run, or there is no scheduler."""
    store = Store.open(out / STORE, settings(data, protocol), len(data), protocol.fields())
    gaps = {condition: store.missing(condition) for condition in conditions}
    wanted = len(conditions) * len(data)
    done = wanted - sum(_frames(store, block) for blocks in gaps.values() for block in blocks)
    if progress:
        progress(done, wanted)
    if any(gaps.values()):
        with client(workers, scheduler, cache) as found:
            for condition, block, values in judge(found, protocol, _work(data, store, gaps)):
                store.write(condition, block, values)
                done += _frames(store, block)
                if progress:
                    progress(done, wanted)
    return {condition: store.read(condition) for condition in conditions}


def _frames(store: Store, block: int) -> int:
    rows = store.rows(block)
    return rows.stop - rows.start


def _work(data: DataSet, store: Store, gaps: dict[Condition, list[int]]) -> Iterator[Work]:
    for condition, blocks in gaps.items():
        for block in blocks:
            rows = store.rows(block)
            yield Work(condition, block, rows.start, data.take(np.arange(rows.start, rows.stop)))


def settings(data: DataSet, protocol: Protocol) -> dict[str, Any]:
    """What makes one run's numbers comparable with another's."""
    return {
        "data set": f"{data.name} {data.sha256}",
        "frames": len(data),
        "block": BLOCK,
        "limits": f"{protocol.anatomy.limits.name} {protocol.anatomy.limits.sha256}",
        "measures": f"upper {protocol.upper}, lower {protocol.lower}",
        "pose dictionaries": _digest(protocol.dictionary),
        "candidates": protocol.candidates,
        "likelihood": repr(protocol.likelihood),
        "num_samples": protocol.num_samples,
        "k": list(protocol.ks),
        "max_proposals": protocol.max_proposals,
        "seed": protocol.seed,
        "versions": versions(),
    }


def _digest(dictionary: PoseDictionary) -> str:
    digest = hashlib.sha256()
    for table in (
        dictionary.mean,
        dictionary.bases,
        dictionary.atoms,
        dictionary.lengths,
        dictionary.torso,
    ):
        digest.update(np.ascontiguousarray(table, "<f8").tobytes())
    return digest.hexdigest()
