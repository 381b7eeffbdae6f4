"""`poseterior check`: which bones of 3D poses break which limit, and by how many degrees."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.arrays import HDF5, ArrayFile, read_array
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import opened
from poseterior.probmodel.motion import KINDS, READERS, read_motion
from poseterior.probmodel.motion.recording import require_depth
from poseterior.probmodel.skeleton import BONE_NAMES, BONES, JOINTS, NUM_JOINTS
from poseterior.reports import console, tables
from poseterior.reports.options import Screen, anatomy_of, map_of_names
from poseterior.reports.settings import CheckSettings

FEW = 20
"""Up to so many impossible poses are listed one by one, more are counted by bone."""
_VARIABLES = ("posterior/joints", "prior/joints")
LARGEST_COORDINATE = 1e9
"""No coordinate may be larger: the squares of larger numbers overflow."""


class PosesToCheck(NamedTuple):
    """Poses `joints` `(n, 15, 3)` of a file, what each is called, and the embedded limits that
    they are to keep: those that a result of ours was made with."""

    joints: np.ndarray
    names: list[str]
    limits: str = "default"


def run(settings: CheckSettings, screen: Screen) -> None:
    """Checks every pose of a file: results of ours, motion capture, or arrays of joints."""
    path = settings.file
    with console.progress("reading and checking", screen.quiet):
        poses = read_poses(path, map_of_names(settings.names))
        _require_poses(poses, path)
        limits = anatomy_of(settings.limits or poses.limits).limits
        check = limits.check(poses.joints)
    if screen.json:
        console.show_json(tables.check_json(check, poses.names))
        return
    broken = np.flatnonzero(~check.pose_valid)
    if len(broken) > FEW:
        console.OUT.print(tables.broken_table(check))
    elif len(broken):
        from poseterior.probmodel.anatomy.limits import Check

        listed = Check(*(part[broken] for part in check))
        console.OUT.print(tables.check_table(listed, [poses.names[pose] for pose in broken]))
    console.say(
        f"{check.pose_valid.sum():,} of {len(poses.names):,} poses in {path} are possible"
        f" (limits {limits.name})."
    )


def read_poses(path: Path, names: Mapping[str, str] | None = None) -> PosesToCheck:
    """The poses of a file: posterior.nc, prior.nc, hypotheses.json, motion capture, a plain data
    set, or an array `(…, 15, 3)` in .npy or .npz (motion capture's `(…, 17, 3)` too); `names` are
    of motion capture. Raises `BadInput` on anything else."""
    suffix = path.suffix.lower()
    if not path.exists():
        raise BadInput(f"there is no file {path}; give one with 3D poses")
    from poseterior.probmodel.datasets.plain import is_plain  # takes a while

    if not is_plain(path) and (path.is_dir() or suffix in READERS):
        return _from_motion(path, names)
    if names is not None:
        raise BadInput(f"{path} is no motion capture, whose joints have names; leave them out")
    if is_plain(path):
        return _from_data_set(path)
    readers = {".nc": _from_tree, ".json": _from_json, ".npy": _from_array}
    if suffix not in readers:
        raise BadInput(
            f"{path} is not a file of 3D poses; check reads poseterior's .nc and .json, .npy,"
            f" {KINDS}"
        )
    return readers[suffix](path)


def _from_data_set(path: Path) -> PosesToCheck:
    from poseterior.probmodel.datasets.plain import read_plain

    data = read_plain(path)
    return PosesToCheck(
        data.corrected(data.poses),
        [f"case {row}, {recording}" for row, recording in enumerate(data.recording)],
    )


def _from_motion(path: Path, names: Mapping[str, str] | None) -> PosesToCheck:
    motions = read_motion(path, names=names)
    frames = [
        f"{motion.name}, frame {frame}" for motion in motions for frame in range(len(motion.joints))
    ]
    return PosesToCheck(np.concatenate([motion.joints for motion in motions]), frames)


def _from_tree(path: Path) -> PosesToCheck:
    what, advice = "file of poses of poseterior", "write one with `poseterior sample`"
    with opened(path, what, advice) as content:
        file = ArrayFile(content, str(path), what, advice)
        file.require(HDF5)
        found, limits = file.read(list(_VARIABLES)), file.own_attributes().get("limits")
    if not found:
        raise BadInput(f"{path} holds no poses of poseterior; {advice}")
    joints = next(found[name] for name in _VARIABLES if name in found)
    return _numbered(joints, "draw", path)._replace(limits=_embedded(limits))


def _from_json(path: Path) -> PosesToCheck:
    advice = "give a hypotheses.json of poseterior, or a .nc"
    content = read_json(path, "hypotheses.json of poseterior", advice)
    try:
        poses = [[pose["joints"][name] for name in JOINTS] for pose in content["hypotheses"]]
        joints = np.array(poses, float)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise BadInput(
            f"{path} is not a hypotheses.json of poseterior ({type(error).__name__}); give one, or"
            " a .nc"
        ) from None
    found = _numbered(joints, "hypothesis", path, first=1)
    return found._replace(limits=_embedded(content.get("limits")))


def _embedded(said: object) -> str:
    """The embedded limits that a result says it was made with; the default where it names none."""
    from poseterior.probmodel.anatomy.limits import EMBEDDED

    name = str(said).partition(" ")[0]
    return name if name in EMBEDDED else "default"


def _from_array(path: Path) -> PosesToCheck:
    joints = read_array(path, "NumPy array of numbers", "save joints with numpy.save")
    return _numbered(joints, "pose", path)


def _numbered(joints: np.ndarray, kind: str, path: Path, *, first: int = 0) -> PosesToCheck:
    if joints.ndim < 2 or joints.shape[-2:] != (NUM_JOINTS, 3) or joints.dtype.kind not in "fiu":
        raise BadInput(
            f"{path} has shape {joints.shape} and type {joints.dtype}; it needs numbers (…, 15, 3)"
        )
    joints = joints.reshape(-1, NUM_JOINTS, 3).astype(float)
    require_depth(joints, path)
    return PosesToCheck(joints, [f"{kind} {first + number}" for number in range(len(joints))])


def _require_poses(poses: PosesToCheck, path: Path) -> None:
    """Raises `BadInput`, naming pose and joint or bone, where a pose has no direction to check."""
    joints, names = poses.joints, poses.names
    if not len(joints):
        raise BadInput(f"{path} holds no pose; give a file with one at least")
    for pose, joint in np.argwhere(~(np.abs(joints) <= LARGEST_COORDINATE).all(axis=-1))[
        :1
    ]:  # NaN compares false
        raise BadInput(
            f"{JOINTS[joint]} of {names[pose]} in {path} is {joints[pose, joint].tolist()}; the"
            " check needs finite numbers for all fifteen joints"
        )
    ends, starts = [bone.end for bone in BONES], [bone.start for bone in BONES]
    for pose, bone in np.argwhere((joints[:, ends] == joints[:, starts]).all(axis=-1))[:1]:
        raise BadInput(
            f"the bone {BONE_NAMES[bone]} of {names[pose]} in {path} has length zero, so no"
            " direction; leave it out"
        )
