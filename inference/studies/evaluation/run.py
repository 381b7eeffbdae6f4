"""An evaluation from end to end: every frame of a data set under every condition, written as it
comes.

A run that was stopped, or whose workers died, is resumed and ends with the same bits.

    results = evaluate(data, conditions(("zhou",), (0, 1, 2), (0,)), protocol, Path("out"),
                       machines=Machines(workers=2))
    tree = open_evaluation("out")       # the same, for xarray
"""

import functools
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.machines import HERE, Machines
from poseterior.inference.results import versions
from poseterior.inference.store import Block, Groups, Store, fill, locked
from poseterior.inference.studies.evaluation.conditions import Condition
from poseterior.inference.studies.evaluation.outcome import Protocol, judge_block
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.measures import MEASURES

STORE, FRAMES_GROUP = "frames", "frames"
"""The store's folder, with a folder in it for each condition, and what a block of it holds."""
FRAMES_PER_BLOCK = 32
"""Frames that are estimated together, sent to a worker together, and lost together when it dies."""
Progress = Callable[[int, int], None]
Results = dict[Condition, dict[str, np.ndarray]]
"""What came out of every frame, by condition and field (`Protocol.fields`)."""


def evaluate(
    data: DataSet,
    conditions: Sequence[Condition],
    protocol: Protocol,
    out: Path,
    *,
    machines: Machines = HERE,
    progress: Progress | None = None,
) -> Results:
    """Judges every frame under every condition, and writes it to `out`; what is there already is
    kept, what is damaged made anew.

    Parameters
    ----------
    machines
        Who does it: always worker processes, if only one, for the same bits everywhere.
    progress
        Called with the number of frames done, and of all of them.

    Raises
    ------
    BadInput
        Where `out` holds another run, or another process is writing to it; and as `Machines.each`
        does.
    """
    found: dict[tuple[str, int], xr.Dataset] = {}
    said = progress or (lambda done, wanted: None)
    wanted = len(conditions) * len(data)

    with locked(out):
        store = Store.begin(out / STORE, settings(data, protocol))
        there = {
            (one.name, number) for one in conditions for number in store.part(one.name).numbers()
        }
        done = sum(
            min(FRAMES_PER_BLOCK, len(data) - FRAMES_PER_BLOCK * number) for _, number in there
        )
        said(done, wanted)

        def take(block: Block, groups: Groups) -> None:
            nonlocal done
            found[block.part, block.number] = groups[FRAMES_GROUP]
            if (block.part, block.number) not in there:
                done += block.size
                said(done, wanted)

        task = functools.partial(_judged, protocol)
        fill(store, machines, task, _blocks(data, conditions), take, apart=True)
    return {
        condition: {
            name: np.concatenate([one[name].values for one in _in_order(found, condition)])
            for name in protocol.fields
        }
        for condition in conditions
    }


def open_evaluation(folder: str | os.PathLike) -> xr.DataTree:
    """What came out of every frame, a group for each condition, in the order of the data set; the
    settings are attributes.

    Raises
    ------
    BadInput
        Where there is no evaluation, or a block of it is missing, damaged or of another run.
    """
    root = Path(folder) / STORE
    store = Store.open(root, "an evaluation")
    blocks = -(-store.settings["frames"] // store.settings["block"])
    parts = [store.part(path.name) for path in sorted(root.iterdir()) if path.is_dir()]
    tree = xr.DataTree.from_dict(
        {
            part.folder.name: xr.concat(
                [part.read(number, FRAMES_GROUP) for number in part.whole(blocks)], dim="frame"
            )
            for part in parts
        }
    )
    tree.attrs.update(store.settings)
    return tree


def _in_order(found: dict[tuple[str, int], xr.Dataset], condition: Condition) -> list[xr.Dataset]:
    return [found[key] for key in sorted(found) if key[0] == condition.name]


class _Work(NamedTuple):
    """Frames under a condition; `data` are its cases alone, `first` the number of the first."""

    condition: Condition
    first: int
    data: DataSet


def _judged(protocol: Protocol, work: _Work) -> Groups:
    """What comes out of a block."""
    values = judge_block(protocol, work.condition, work.data, work.first)
    return {FRAMES_GROUP: protocol.dataset(values)}


def _blocks(data: DataSet, conditions: Sequence[Condition]) -> Iterator[Block]:
    for condition in conditions:
        for number, first in enumerate(range(0, len(data), FRAMES_PER_BLOCK)):
            rows = np.arange(first, min(first + FRAMES_PER_BLOCK, len(data)))
            words = f"frames {first} to {rows[-1]} ({condition.name})"
            work = _Work(condition, first, data.take(rows))
            yield Block(number, words, {}, len(rows), work, condition.name)


def settings(data: DataSet, protocol: Protocol) -> dict[str, Any]:
    """What makes one run's numbers comparable with another's."""
    return {
        "study": "evaluation",
        "data set": f"{data.name} {data.sha256}",
        "frames": len(data),
        "block": FRAMES_PER_BLOCK,
        "limits": f"{protocol.anatomy.limits.name} {protocol.anatomy.limits.sha256}",
        "measures": f"upper {protocol.upper}, lower {protocol.lower}",
        "pose dictionaries": protocol.dictionary.sha256,
        "candidates": protocol.candidates,
        "likelihood": f"{protocol.likelihood.words} {protocol.likelihood.sha256}",
        "num_samples": protocol.num_samples,
        "num_roots": protocol.num_roots,
        "k": list(protocol.ks),
        **({"composed": True} if protocol.composed else {}),
        **({"upright": protocol.upright} if protocol.upright else {}),
        "max_proposals": protocol.max_proposals,
        "seed": protocol.seed,
        "measured": len(MEASURES),
        "versions": versions(),
    }
