"""What a posterior of several views says, as tables: where each joint is, and what each view is
held to have got wrong."""

import numpy as np
import xarray as xr

from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.tables.posterior import values
from poseterior.reports.tables.sheet import Column, Sheet, fixed, percent

NOTICED = 0.05
"""Probability of being wrong from which a detection is listed."""


def places_table(tree: xr.DataTree) -> Sheet:
    """By joint: mean and standard deviations along the world's axes, mm."""
    joints = values(tree, "posterior", "joints")
    mean, sd = joints.mean(axis=0), joints.std(axis=0)
    axes = [(name, f"{name}_sd") for name in "xyz"]
    columns = [Column("joint", left=True)]
    for name, spread in axes:
        columns += [Column(f"{name} (mm)", name, fixed(0)), Column("±", spread, fixed(0))]
    records = [
        {"joint": joint.replace("_", " ")}
        | {name: float(mean[row, axis]) for axis, (name, _) in enumerate(axes)}
        | {spread: float(sd[row, axis]) for axis, (_, spread) in enumerate(axes)}
        for row, joint in enumerate(JOINTS)
    ]
    return Sheet(columns, records)


def views_table(tree: xr.DataTree) -> Sheet:
    """By view: how far seen joints are from where the draws have them, and which detections are
    probably wrong."""
    keypoints = values(tree, "observed_data", "keypoints")
    drawn = values(tree, "posterior", "keypoints").mean(axis=0)
    off = np.linalg.norm(keypoints - drawn, axis=-1)
    columns = [
        Column("view", left=True),
        Column("joints seen", "seen", fixed(0)),
        Column("median error (px)", "error", fixed(1)),
        Column("sides exchanged", "exchanged", percent),
        Column("probably wrong", "wrong", left=True),
    ]
    labels = [str(label) for label in tree["posterior"].coords["view"].values]
    records = [
        {
            "view": label,
            "seen": int(np.isfinite(off[row]).sum()),
            "error": float(np.nanmedian(off[row])) if np.isfinite(off[row]).any() else None,
            **_faults(tree, row),
        }
        for row, label in enumerate(labels)
    ]
    return Sheet(columns, records)


def _faults(tree: xr.DataTree, row: int) -> dict[str, object]:
    """A view's faults, where the error law knows any."""
    if "outlier" not in tree["posterior"].dataset:
        return {"exchanged": None, "wrong": None}
    share = values(tree, "posterior", "outlier")[:, row].mean(axis=0)
    found = [
        f"{JOINTS[joint].replace('_', ' ')} {percent(float(share[joint]))}"
        for joint in np.argsort(-share)
        if share[joint] > NOTICED
    ]
    exchanged = values(tree, "posterior", "exchange")[:, row] > 0
    return {"exchanged": float(exchanged.mean()), "wrong": ", ".join(found) or None}
