"""ASF/AMC: a subject's skeleton in one file, the angles of each trial in another (Acclaim; the CMU
originals)."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.motion.recording import (
    CMU_RATE,
    INCH,
    MOST_JOINTS,
    NUMBER,
    Motion,
    Rig,
    floats,
    forward,
    positions,
    read_text,
    require_frames,
)
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS

_ASF_ENDS = {
    "pelvis": "root",
    "thorax": "thorax",
    "right_shoulder": "rclavicle",
    "right_elbow": "rhumerus",
    "right_wrist": "rradius",
    "left_shoulder": "lclavicle",
    "left_elbow": "lhumerus",
    "left_wrist": "lradius",
    "head": "head",
    "right_hip": "rhipjoint",
    "right_knee": "rfemur",
    "right_ankle": "rtibia",
    "left_hip": "lhipjoint",
    "left_knee": "lfemur",
    "left_ankle": "ltibia",
}
"""The ASF bone in whose end each joint lies."""


class Asf(NamedTuple):
    path: Path
    rig: Rig
    dofs: list[str]
    """Per segment, its AMC channels: some of "xyz" for bones; the root's order,
    "TXTYTZRXRYRZ"-like, for the root."""
    axes: list[Rotation]
    millimetres: float


LONGEST = 1e6
"""No bone is longer, in units of its file, and no axis is turned by more degrees."""
_ROOT_ORDER = ("TX", "TY", "TZ", "RX", "RY", "RZ")


def asf_beside(amc: Path) -> Path:
    """`01_05.amc` belongs to `01.asf` in the same folder, or to the only .asf there."""
    candidates = sorted(entry for entry in amc.parent.iterdir() if entry.suffix.lower() == ".asf")
    named = [entry for entry in candidates if entry.stem == amc.stem.split("_")[0]]
    if named or len(candidates) == 1:
        return (named or candidates)[0]
    raise BadInput(
        f"{amc} needs its skeleton {amc.stem.split('_')[0]}.asf in the same folder; put it there"
    )


def _sections(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Lines with their numbers, by ":section" of an ASF file."""
    sections: dict[str, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        line = line.split("#")[0].strip()
        if line.startswith(":"):
            name = line[1:].split()[0].lower() if line[1:].split() else ""
            current = sections.setdefault(name, [])
        elif line:
            current.append((number, line))
    missing = [name for name in ("units", "root", "bonedata", "hierarchy") if name not in sections]
    if missing:
        raise BadInput(
            f"{path} is not an ASF skeleton, or is truncated: it has no :{missing[0]} section"
        )
    return sections


def parse_asf(path: Path) -> Asf:
    """The skeleton of an .asf file. Raises `BadInput` where it is damaged or lacks a bone."""
    sections = _sections(path)
    units = dict(line.split(None, 1) for _, line in sections["units"] if " " in line)
    try:
        millimetres = INCH / float(units.get("length", "1"))
        if not 1 / LONGEST <= millimetres <= LONGEST:
            raise ValueError
    except (ValueError, ZeroDivisionError):
        raise BadInput(
            f"{path}: 'length' in :units is {shown(units['length'])}, not a number to divide by"
        ) from None
    if not units.get("angle", "deg").lower().startswith("deg"):
        raise BadInput(f"{path}: angles in {shown(units['angle'])} are not supported, only degrees")
    order = next(
        (line.split()[1:] for _, line in sections["root"] if line.lower().startswith("order")), []
    )
    if sorted(token.upper() for token in order) != sorted(_ROOT_ORDER):
        raise BadInput(
            f"{path}: the root's order is {shown(' '.join(order))}, which is not TX TY TZ RX RY RZ"
            " in some order"
        )
    bones = _parse_bones(sections["bonedata"], path)
    parents = _parse_hierarchy(sections["hierarchy"], bones, path)
    names = list(parents)
    missing = sorted(set(_ASF_ENDS.values()) - set(names))
    if missing:
        raise BadInput(
            f"{path}: the skeleton lacks the bones {', '.join(missing)}; fifteen joints cannot be"
            " found in it"
        )
    root = _AsfBone(np.zeros(3), Rotation.identity(), "".join(order).upper())
    all_bones = [bones.get(name, root) for name in names]
    rig = Rig(
        names,
        [-1 if parent is None else names.index(parent) for parent in parents.values()],
        np.array([bone.offset for bone in all_bones]),
    )
    return Asf(
        path, rig, [bone.dof for bone in all_bones], [bone.axis for bone in all_bones], millimetres
    )


class _AsfBone(NamedTuple):
    offset: np.ndarray
    axis: Rotation
    dof: str


def _parse_bones(lines: list[tuple[int, str]], path: Path) -> dict[str, _AsfBone]:
    bones: dict[str, _AsfBone] = {}
    fields: dict[str, list[str]] = {}
    for number, line in lines:
        key, *values = line.split()
        if key == "begin":
            fields = {}
        elif key == "end":
            bone = _asf_bone(fields, number, path)
            bones[fields["name"][0]] = bone
        else:
            fields[key.lower()] = values
    return bones


def _asf_bone(fields: Mapping[str, list[str]], line: int, path: Path) -> _AsfBone:
    try:
        direction = np.array([float(value) for value in fields["direction"]])
        length = float(fields["length"][0])
        *angles, order = fields["axis"]
        turns = [float(value) for value in angles]
        numbers = np.array([*direction, length, *turns])
        if direction.shape != (3,) or not fields["name"] or not (np.abs(numbers) <= LONGEST).all():
            raise ValueError
        offset = direction * length
        axis = Rotation.from_euler(order.lower(), turns, degrees=True)
        dof = "".join(
            token.lower().removeprefix("r")
            for token in fields.get("dof", [])
            if token.lower() != "l"
        )
        if not set(dof) <= set("xyz") or len(dof) != len(set(dof)):
            raise ValueError
    except (KeyError, ValueError, IndexError, TypeError):
        raise BadInput(
            f"{path}, line {line}: the bone that ends here lacks a readable name, direction,"
            " length, axis or dof"
        ) from None
    return _AsfBone(offset, axis, dof)


def _parse_hierarchy(
    lines: list[tuple[int, str]], bones: Mapping[str, _AsfBone], path: Path
) -> dict[str, str | None]:
    parents: dict[str, str | None] = {"root": None}
    for number, line in lines:
        parent, *children = line.split()
        if parent in ("begin", "end") and not children:
            continue
        if parent not in parents:
            raise BadInput(
                f"{path}, line {number}: {shown(parent)} has children before it is a child itself"
            )
        for child in children:
            if child not in bones or child in parents:
                raise BadInput(
                    f"{path}, line {number}: {shown(child)} is not in :bonedata, or has two parents"
                )
            parents[child] = parent
    if len(parents) > MOST_JOINTS:
        raise BadInput(f"{path} has more than {MOST_JOINTS} bones; check what wrote it")
    return parents


def read_amc_alone(path: Path) -> list[Motion]:
    """The trial of an .amc file, with the .asf that lies beside it."""
    return [read_amc(path, parse_asf(asf_beside(path)))]


def read_amc(path: Path, asf: Asf) -> Motion:
    """The trial of an .amc file on a skeleton read before. Raises `BadInput` where a frame is
    damaged."""
    channels = _parse_amc(path, asf)
    rotations: list[Rotation | None] = []
    root_dof = asf.dofs[0]
    order = [root_dof[i : i + 2] for i in range(0, len(root_dof), 2)]
    root = channels["root"]
    position = root[:, [order.index(token) for token in ("TX", "TY", "TZ")]]
    spins = [i for i, token in enumerate(order) if token[0] == "R"]
    # Lower-case letters are extrinsic axes: RX RY RZ means Rz·Ry·Rx for column vectors.
    turn = Rotation.from_euler(
        "".join(order[i][1].lower() for i in spins), root[:, spins], degrees=True
    )
    for name, dof, axis in zip(asf.rig.names, asf.dofs, asf.axes, strict=True):
        if name == "root":
            rotations.append(turn)
        elif dof and name in channels:
            local = Rotation.from_euler(dof, channels[name], degrees=True)
            rotations.append(axis * local * axis.inv())
        else:
            rotations.append(None)
    wanted = [asf.rig.names.index(_ASF_ENDS[joint]) for joint in JOINTS]
    joints = forward(asf.rig, wanted, position, rotations) * asf.millimetres
    return Motion(positions(joints, path), CMU_RATE, path.stem, asf.path.stem)


def _parse_amc(path: Path, asf: Asf) -> dict[str, np.ndarray]:
    """Channels `(T, C)` by bone. Every frame must name the same bones in the same order; numbers
    are read in bulk."""
    lines = read_text(path).splitlines()
    start = next((i for i, line in enumerate(lines) if line.strip() == "1"), None)
    if start is None:
        raise BadInput(f"{path} is not an AMC recording: it has no frame 1")
    head = [line.lower().split()[0] for line in lines[:start] if line.startswith(":")]
    if ":radians" in head:
        raise BadInput(f"{path}: angles in radians are not supported, only degrees")
    lines = lines[start:]
    while lines and not lines[-1].strip():
        lines.pop()
    block = next((i for i, line in enumerate(lines[1:], 1) if line.strip().isdigit()), len(lines))
    names = [line.split(None, 1)[0] if line.strip() else "" for line in lines[1:block]]
    widths = _amc_widths(path, names, lines[1:block], asf, start)
    if len(lines) % block:
        raise BadInput(
            f"{path}: the recording is truncated, its last frame is not complete; cut that"
            " frame off"
        )
    require_frames(len(lines) // block, len(asf.rig.names), path)
    body = np.array(lines, dtype=object).reshape(-1, block)
    expected = sum(widths) + 1
    stripped = [
        line.removeprefix(name)
        for row in body
        for name, line in zip(["", *names], row, strict=True)
    ]
    values = floats(" ".join(stripped))
    if values is None or values.size != expected * len(body):
        raise _amc_fault(path, body, names, widths, start)
    values = values.reshape(len(body), expected)
    if not np.array_equal(values[:, 0], np.arange(1, len(body) + 1)):
        row = int(np.argmax(values[:, 0] != np.arange(1, len(body) + 1)))
        raise BadInput(
            f"{path}, line {start + row * block + 1}: frame number {row + 1} was expected here"
        )
    if not (np.abs(values) <= LARGEST_NUMBER).all():
        raise BadInput(f"{path}: a channel holds a number that is not finite")
    edges = np.cumsum([1, *widths])
    return {
        name: values[:, low:high]
        for name, low, high in zip(names, edges[:-1], edges[1:], strict=True)
    }


def _amc_widths(path: Path, names: list[str], first: list[str], asf: Asf, start: int) -> list[int]:
    """Numbers a line has, by the skeleton's dofs."""
    widths = []
    for i, (name, line) in enumerate(zip(names, first, strict=True)):
        number = start + i + 2
        if name not in asf.rig.names:
            raise BadInput(
                f"{path}, line {number}: {shown(name)} is no bone of {asf.path.name}; is it another"
                " subject's?"
            )
        dof = asf.dofs[asf.rig.names.index(name)]
        widths.append(6 if name == "root" else len(dof))
        if len(line.split()) - 1 != widths[-1]:
            raise BadInput(
                f"{path}, line {number}: {shown(name)} has {len(line.split()) - 1} numbers, not"
                f" {widths[-1]}"
            )
    if "root" not in names:
        raise BadInput(f"{path}, line {start + 1}: the frame does not place the root")
    return widths


def _amc_fault(
    path: Path, body: np.ndarray, names: list[str], widths: list[int], start: int
) -> BadInput:
    """Says which line is wrong, once it is known that one is."""
    for row, frame in enumerate(body):
        for i, line in enumerate(frame):
            tokens = line.split()
            name, width = (None, 0) if i == 0 else (names[i - 1], widths[i - 1])
            good = len(tokens) == width + 1 and (name is None or tokens[0] == name)
            if not good or not all(
                re.fullmatch(NUMBER, token) for token in tokens[name is not None :]
            ):
                expected = (
                    "a frame number" if name is None else f"{shown(name)} and {width} numbers"
                )
                return BadInput(
                    f"{path}, line {start + row * len(frame) + i + 1}: {expected} expected here"
                )
    return BadInput(f"{path}: the frames cannot be read as numbers")


assert set(_ASF_ENDS) == set(JOINT_INDEX)
