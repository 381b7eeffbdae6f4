"""What pages of costs share: frames, seconds, and tables and pictures of them."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from poseterior.inference.studies.scenes import motion_frames, prior_frames
from poseterior.probmodel import Estimate, PoseModel
from poseterior.reports.figures.style import tidy
from poseterior.reports.tables import Column, Sheet, sheet_of

EVERY_FRAME = slice(None)


def timed(action: Callable[[], object], repeats: int = 3) -> float:
    """Seconds of the fastest of some runs."""
    found = []
    for _ in range(repeats):
        started = time.perf_counter()
        action()
        found.append(time.perf_counter() - started)
    return min(found)


def frames_of(model: PoseModel, data: Path, rows: slice = EVERY_FRAME) -> dict[str, list[Estimate]]:
    """Frames by what they are of: poses of the prior, and of motion capture where it is at hand."""
    found = {"Poses of the prior, by their seeds": list(prior_frames(model))[rows]}
    archive = data / "cmu" / "actions_train.npz"
    if archive.exists():
        found["Poses of CMU motion capture"] = list(motion_frames(archive))[rows]
    return found


def digits(value: float) -> str:
    """A number in three digits, or as a whole."""
    return f"{value:,.3g}" if value < 1000 else f"{value:,.0f}"


def quartiles(head: str, lines: Mapping[str, np.ndarray]) -> Sheet:
    """By line: smallest, quartiles, largest."""
    rows = [(what, *np.quantile(line, [0, 0.25, 0.5, 0.75, 1])) for what, line in lines.items()]
    ends = ("min", "¼", "median", "¾", "max")
    return sheet_of([head, *(Column(name, form=digits) for name in ends)], rows)


def titled(tables: Mapping[str, Sheet]) -> str:
    """Tables below each other, each under its title."""
    return "\n\n".join(f"## {title}\n\n{own.markdown()}" for title, own in tables.items())


def finish(axes: Sequence[Axes]) -> None:
    """Panels of curves with a faint grid."""
    for axis in axes:
        axis.grid(alpha=0.3)
        tidy(axis)
