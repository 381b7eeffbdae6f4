"""`poseterior learn`: limits, bone lengths and torsos from motion capture, in one file."""

from pathlib import Path

import numpy as np

from probmodel.learning import learn_from
from reports import console


def run(paths: list[Path], out: Path, *, mirror: bool, quiet: bool, as_json: bool) -> None:
    """Learns from files and folders of ASF/AMC, BVH and .npz, and writes the tables."""
    console.output_file(out)
    with console.progress("learning", quiet) as step:
        anatomy = learn_from(paths, lambda what, done, wanted: step(done, wanted), mirror=mirror)
    anatomy.save(out)
    found = {
        "out": str(out),
        "sha256": anatomy.limits.sha256,
        "torsos": len(anatomy.torsos),
        "occupied_cells": np.asarray(anatomy.limits.occupied).sum(axis=(1, 2)).tolist(),
        "length_low": np.round(anatomy.lengths.low, 4).tolist(),
        "length_high": np.round(anatomy.lengths.high, 4).tolist(),
    }
    if as_json:
        console.show_json(found)
    else:
        console.say(f"Learned limits {found['sha256'][:12]}, {found['torsos']} torsos and five ranges of bone lengths.")
        console.say(f"Written to {out}")
