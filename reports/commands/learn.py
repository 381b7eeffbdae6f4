"""`poseterior learn`: limits, bone lengths and torsos from motion capture in one file, pose
dictionaries in another."""

import numpy as np

from poseterior.probmodel.learning.poses import read_all
from poseterior.probmodel.learning.tolerance import DEFAULT
from poseterior.reports import console
from poseterior.reports.options import Screen, map_of_names
from poseterior.reports.settings import LearnSettings


def run(settings: LearnSettings, screen: Screen) -> None:
    """Learns from files and folders of ASF/AMC, BVH and .npz; writes tables, and dictionaries where
    `poses` says."""
    out, poses = console.output_file(settings.out), settings.poses
    tolerance = DEFAULT.wider(settings.wider)
    if poses is not None:
        console.output_file(poses)
    with console.progress("learning", screen.quiet) as step:
        motions = read_all(
            settings.mocap,
            lambda what, done, wanted: step(done, wanted),
            names=map_of_names(settings.names),
        )
        # Only now: a refusal need not wait for them.
        from poseterior.probmodel.learning.dictionaries import learn_dictionary
        from poseterior.probmodel.learning.learner import learn

        anatomy = learn(
            motions,
            tolerance=tolerance,
            mirror=settings.mirror,
            progress=lambda what, done, wanted: step(done, wanted),
        )
        dictionary = None if poses is None else learn_dictionary(motions)
    anatomy.save(out)
    found = {
        "out": str(out),
        "sha256": anatomy.limits.sha256,
        "torsos": len(anatomy.torsos),
        "occupied_cells": np.asarray(anatomy.limits.occupied).sum(axis=(1, 2)).tolist(),
        "length_low": np.round(anatomy.lengths.low, 4).tolist(),
        "length_high": np.round(anatomy.lengths.high, 4).tolist(),
    }
    said = [
        f"Learned limits {found['sha256'][:12]}, {found['torsos']} torsos and five ranges of bone"
        " lengths."
    ]
    if poses is not None and dictionary is not None:
        dictionary.save(poses)
        found |= {
            "poses": str(poses),
            "directions": len(dictionary.bases),
            "atoms": len(dictionary.atoms),
        }
        said.append(
            f"Learned {found['directions']} principal directions and {found['atoms']} atoms of"
            " poses."
        )
    written = f"Written to {out}" if poses is None else f"Written to {out} and {poses}"
    console.show(screen.json, found, *said, written)
