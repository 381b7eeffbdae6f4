"""`poseterior check`: which bones of 3D poses break which limit, and by how many degrees."""

import json
from pathlib import Path

import numpy as np
import xarray as xr

from probmodel.failures import BadInput
from probmodel.limits import Check
from probmodel.motion import read_motion
from probmodel.skeleton import JOINTS, NUM_JOINTS
from reports import console, tables
from reports.options import Belief

MOTION = (".amc", ".bvh")
ARRAYS = (".npy", ".npz")


def run(path: Path, belief: Belief, *, as_json: bool) -> None:
    """Checks every pose of a file: results of ours, motion capture, or arrays of joints."""
    joints = read_poses(path)
    check = belief.anatomy().limits.check(joints)
    if as_json:
        console.show_json(tables.check_json(check))
        return
    console.OUT.print(tables.check_table(check))
    if len(joints) <= FEW:
        _say(check)


FEW = 10
"""Up to so many poses, every broken limit gets its own sentence."""


def _say(check: Check) -> None:
    for number in range(len(check.valid)):
        one = Check(check.valid[number], check.limit[number], check.excess[number])
        verdict = "; ".join(one.sentences()) or "possible"
        console.OUT.print(f"pose {number}: {verdict}")


def read_poses(path: Path) -> np.ndarray:
    """Poses `(n, 15, 3)` of a file: posterior.nc, prior.nc, hypotheses.json, .amc, .bvh, or an array `(…, 15, 3)` in
    .npy or .npz (motion capture's `(…, 17, 3)` too). Raises `BadInput` on anything else."""
    suffix = path.suffix.lower()
    if not path.exists():
        raise BadInput(f"there is no file {path}; give one with 3D poses")
    if suffix == ".nc":
        return _from_tree(path)
    if suffix == ".json":
        return _from_json(path)
    if suffix == ".npy":
        return _from_array(path)
    if suffix == ".npz" or suffix in MOTION or path.is_dir():
        return np.concatenate([motion.joints for motion in read_motion(path)])
    raise BadInput(
        f"{path} is not a file of 3D poses; check reads .nc and hypotheses.json of poseterior, .amc, .bvh, .npy and .npz"
    )


def _from_tree(path: Path) -> np.ndarray:
    try:
        with xr.open_datatree(path, engine="netcdf4") as tree:
            group = next(name for name in ("posterior", "prior") if name in tree.children)
            joints = tree[group]["joints"].values
    except (OSError, ValueError, KeyError, StopIteration) as error:
        raise BadInput(f"{path} holds no poses of poseterior ({type(error).__name__}); write one with its sample") from None
    return joints.reshape(-1, *joints.shape[-2:])


def _from_json(path: Path) -> np.ndarray:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        poses = [[pose["joints"][name] for name in JOINTS] for pose in content["hypotheses"]]
        joints = np.array(poses, float)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(f"{path} is not a hypotheses.json of poseterior ({type(error).__name__}); give one, or a .nc") from None
    if joints.shape[1:] != (NUM_JOINTS, 3):
        raise BadInput(f"{path}: a pose has shape {joints.shape[1:]}, it needs ({NUM_JOINTS}, 3)")
    return joints


def _from_array(path: Path) -> np.ndarray:
    try:
        joints = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise BadInput(f"{path} is not a NumPy array of numbers ({error}); save joints with numpy.save") from None
    if joints.ndim < 2 or joints.shape[-2:] != (NUM_JOINTS, 3) or joints.dtype.kind not in "fiu":
        raise BadInput(f"{path} has shape {joints.shape} and type {joints.dtype}; it needs numbers (…, {NUM_JOINTS}, 3)")
    return joints.reshape(-1, NUM_JOINTS, 3).astype(float)
