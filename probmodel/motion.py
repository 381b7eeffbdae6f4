"""Readers of motion capture: ASF/AMC, BVH and .npz files become `Motion`s of fifteen joints in millimetres.

All axes are right-handed. Whatever the format, a recording is a hierarchy of segments with an offset and a rotation
each (`_Rig`); forward kinematics runs over all frames at once. Glitches are dropped by a stated rule (`without_jumps`).
The usual way in: `read_motion(path)`.
"""

import dataclasses
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probmodel.failures import BadInput
from probmodel.limits import read_tables
from probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, PARENTS

INCH = 25.4
CMU_UNIT = INCH / 0.45
"""Millimetres in one unit of the CMU files (`length 0.45` in the ASF; the BVH conversions kept it)."""
CMU_RATE = 120.0
NPZ_RATE = 30.0
MAX_TURN = 1500.0
"""Degrees a second. A football kick turns the lower leg by some 1,100 in the CMU recordings; what is faster there are
swapped or lost markers, at 1,700 to 12,000."""
GUARD = 0.05
"""Seconds before and after a jump that are not trusted."""
FROM_SEVENTEEN = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15)
"""Where the fifteen joints are among Akhter & Black's seventeen, which have feet (12 and 16)."""

_ASF_ENDS = {
    "pelvis": "root", "thorax": "thorax", "right_shoulder": "rclavicle", "right_elbow": "rhumerus",
    "right_wrist": "rradius", "left_shoulder": "lclavicle", "left_elbow": "lhumerus", "left_wrist": "lradius",
    "head": "head", "right_hip": "rhipjoint", "right_knee": "rfemur", "right_ankle": "rtibia",
    "left_hip": "lhipjoint", "left_knee": "lfemur", "left_ankle": "ltibia",
}  # fmt: skip
"""The ASF bone in whose end each joint lies."""
_BVH_NAMES = (
    {
        "pelvis": "Hips", "thorax": "Neck", "right_shoulder": "RightArm", "right_elbow": "RightForeArm",
        "right_wrist": "RightHand", "left_shoulder": "LeftArm", "left_elbow": "LeftForeArm", "left_wrist": "LeftHand",
        "head": "Head end", "right_hip": "RightUpLeg", "right_knee": "RightLeg", "right_ankle": "RightFoot",
        "left_hip": "LeftUpLeg", "left_knee": "LeftLeg", "left_ankle": "LeftFoot",
    },
    {
        "pelvis": "Hips", "thorax": "lowerneck", "right_shoulder": "RightShoulder", "right_elbow": "RightElbow",
        "right_wrist": "RightWrist", "left_shoulder": "LeftShoulder", "left_elbow": "LeftElbow",
        "left_wrist": "LeftWrist", "head": "Head end", "right_hip": "RightHip", "right_knee": "RightKnee",
        "right_ankle": "RightAnkle", "left_hip": "LeftHip", "left_knee": "LeftKnee", "left_ankle": "LeftAnkle",
    },
)  # fmt: skip
"""The BVH joints that are ours, in the two naming schemes of the CMU conversions. "Head end" is the head's End Site;
"thorax" is where the neck starts. The conversions lack the ASF's thorax bone: their trunks are some 117 mm short."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """A recording: `joints` `(T, 15, 3)` float64, millimetres, right-handed axes; `frame_rate` in Hz; `name` of the
    recording; `subject`, equal for recordings of the same skeleton."""

    joints: np.ndarray
    frame_rate: float
    name: str
    subject: str

    def at_rate(self, rate: float) -> "Motion":
        """Every k-th frame, k being the nearest to `frame_rate / rate` and at least 1; frames are never made up."""
        step = max(1, round(self.frame_rate / rate))
        return dataclasses.replace(self, joints=self.joints[::step], frame_rate=self.frame_rate / step)

    def without_jumps(self, max_turn: float = MAX_TURN) -> "Motion":
        """Without the frames at a jump, where a bone (from joint to parent) turns faster than `max_turn` degrees a
        second. The frames within `GUARD` seconds of it go: a T-pose before the first frame, a marker lost for a moment.
        """
        bones = self.joints[:, 1:] - self.joints[:, list(PARENTS[1:])]
        bones = bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), np.finfo(float).tiny)
        chord = np.linalg.norm(np.diff(bones, axis=0), axis=-1).max(axis=-1, initial=0.0)
        turn = np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))
        jumps = np.flatnonzero(turn * self.frame_rate > max_turn) + 1
        guard = max(1, round(GUARD * self.frame_rate))
        keep = np.ones(len(self.joints), bool)
        for jump in jumps:
            keep[max(0, jump - guard) : jump + guard] = False
        return dataclasses.replace(self, joints=self.joints[keep])


def read_motion(path: str | os.PathLike) -> list[Motion]:
    """Recordings at `path`, glitches included (see `Motion.without_jumps`), in a fixed order.

    `path` is an .amc file with its subject's .asf beside it, a folder of them or of such folders, a .bvh file or a
    folder of them, or an .npz whose keys hold `(T, 15, 3)` or `(T, 17, 3)` millimetres at 30 Hz (`<action>/<sequence>`;
    one subject a file). Raises `BadInput` where a file is none of these or is damaged.
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path)
    if not path.exists():
        raise BadInput(f"there is no motion capture at {path}; give an .amc, .bvh or .npz file, or a folder of them")
    readers = {".amc": _read_amc_alone, ".bvh": _read_bvh, ".npz": _read_npz}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise BadInput(f"{path} is no motion capture that can be read; give an .amc, .bvh or .npz file, or a folder")
    return reader(path)


def _read_folder(folder: Path) -> list[Motion]:
    files = sorted(entry for entry in folder.rglob("*") if entry.suffix.lower() in (".amc", ".bvh", ".npz"))
    if not files:
        raise BadInput(f"{folder} holds no .amc, .bvh or .npz file; give a folder of motion capture")
    skeletons: dict[Path, _Asf] = {}
    motions: list[Motion] = []
    for file in files:
        if file.suffix.lower() == ".amc":
            asf = _asf_beside(file)
            if asf not in skeletons:
                skeletons[asf] = _parse_asf(asf)
            motions.append(_read_amc(file, skeletons[asf]))
        else:
            motions += read_motion(file)
    return motions


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise BadInput(f"cannot read {path} ({error.strerror}); check the path and its permissions") from None


class _Rig(NamedTuple):
    """Segments, parents first. A segment starts where its parent ends, turned by its own rotation."""

    names: list[str]
    parents: list[int]
    offsets: np.ndarray
    """`(S, 3)`: from a segment's start to its end, in the segment's own axes."""


def _forward(rig: _Rig, wanted: Iterable[int], root: np.ndarray, rotations: Sequence[Rotation | None]) -> np.ndarray:
    """Ends `(T, len(wanted), 3)` of segments, given root positions `(T, 3)` and each segment's local rotation (None:
    not turned). Segments that `wanted` does not need are skipped."""
    wanted = list(wanted)
    needed = set(wanted)
    for segment in reversed(range(len(rig.names))):
        if segment in needed and rig.parents[segment] >= 0:
            needed.add(rig.parents[segment])
    ends: dict[int, np.ndarray] = {}
    turns: dict[int, Rotation] = {}
    for segment in sorted(needed):
        parent, local = rig.parents[segment], rotations[segment]
        if parent < 0:
            turns[segment] = local if local is not None else Rotation.identity(len(root))
        else:
            turns[segment] = turns[parent] if local is None else turns[parent] * local
        ends[segment] = (root if parent < 0 else ends[parent]) + turns[segment].apply(rig.offsets[segment])
    return np.stack([ends[segment] for segment in wanted], axis=1)


# --- ASF/AMC ---------------------------------------------------------------------------------------------------------


class _Asf(NamedTuple):
    path: Path
    rig: _Rig
    dofs: list[str]
    """Per segment, its AMC channels: some of "xyz" for bones; the root's order, "TXTYTZRXRYRZ"-like, for the root."""
    axes: list[Rotation]
    millimetres: float


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ROOT_ORDER = ("TX", "TY", "TZ", "RX", "RY", "RZ")


def _asf_beside(amc: Path) -> Path:
    """`01_05.amc` belongs to `01.asf` in the same folder, or to the only .asf there."""
    candidates = sorted(entry for entry in amc.parent.iterdir() if entry.suffix.lower() == ".asf")
    named = [entry for entry in candidates if entry.stem == amc.stem.split("_")[0]]
    if named or len(candidates) == 1:
        return (named or candidates)[0]
    raise BadInput(f"{amc} needs its skeleton {amc.stem.split('_')[0]}.asf in the same folder; put it there")


def _sections(path: Path) -> dict[str, list[tuple[int, str]]]:
    """Lines with their numbers, by ":section" of an ASF file."""
    sections: dict[str, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] = []
    for number, line in enumerate(_read_text(path).splitlines(), 1):
        line = line.split("#")[0].strip()
        if line.startswith(":"):
            name = line[1:].split()[0].lower() if line[1:].split() else ""
            current = sections.setdefault(name, [])
        elif line:
            current.append((number, line))
    missing = [name for name in ("units", "root", "bonedata", "hierarchy") if name not in sections]
    if missing:
        raise BadInput(f"{path} is not an ASF skeleton, or is truncated: it has no :{missing[0]} section")
    return sections


def _parse_asf(path: Path) -> _Asf:
    sections = _sections(path)
    units = dict(line.split(None, 1) for _, line in sections["units"] if " " in line)
    try:
        millimetres = INCH / float(units.get("length", "1"))
    except (ValueError, ZeroDivisionError):
        raise BadInput(f"{path}: 'length {units['length']}' in :units is not a number to divide by") from None
    if not units.get("angle", "deg").lower().startswith("deg"):
        raise BadInput(f"{path}: angles in {units['angle']} are not supported, only degrees")
    order = next((line.split()[1:] for _, line in sections["root"] if line.lower().startswith("order")), [])
    if sorted(token.upper() for token in order) != sorted(_ROOT_ORDER):
        raise BadInput(f"{path}: the root's order is '{' '.join(order)}', which is not TX TY TZ RX RY RZ in some order")
    bones = _parse_bones(sections["bonedata"], path)
    parents = _parse_hierarchy(sections["hierarchy"], bones, path)
    names = list(parents)
    missing = sorted(set(_ASF_ENDS.values()) - set(names))
    if missing:
        raise BadInput(
            f"{path}: the skeleton lacks the bones {', '.join(missing)}; fifteen joints cannot be found in it"
        )
    root = _AsfBone(np.zeros(3), Rotation.identity(), "".join(order).upper())
    all_bones = [bones.get(name, root) for name in names]
    rig = _Rig(names, [-1 if parent is None else names.index(parent) for parent in parents.values()],
               np.array([bone.offset for bone in all_bones]))  # fmt: skip
    return _Asf(path, rig, [bone.dof for bone in all_bones], [bone.axis for bone in all_bones], millimetres)


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
        if direction.shape != (3,) or not fields["name"]:
            raise ValueError
        offset = direction * float(fields["length"][0])
        *angles, order = fields["axis"]
        axis = Rotation.from_euler(order.lower(), [float(value) for value in angles], degrees=True)
        dof = "".join(token.lower().removeprefix("r") for token in fields.get("dof", []) if token.lower() != "l")
        if not set(dof) <= set("xyz"):
            raise ValueError
    except (KeyError, ValueError, IndexError):
        raise BadInput(
            f"{path}, line {line}: the bone that ends here lacks a readable name, direction, length, axis or dof"
        ) from None
    return _AsfBone(offset, axis, dof)


def _parse_hierarchy(lines: list[tuple[int, str]], bones: Mapping[str, _AsfBone], path: Path) -> dict[str, str | None]:
    parents: dict[str, str | None] = {"root": None}
    for number, line in lines:
        parent, *children = line.split()
        if parent in ("begin", "end") and not children:
            continue
        if parent not in parents:
            raise BadInput(f"{path}, line {number}: '{parent}' has children before it is a child itself")
        for child in children:
            if child not in bones or child in parents:
                raise BadInput(f"{path}, line {number}: '{child}' is not in :bonedata, or has two parents")
            parents[child] = parent
    return parents


def _read_amc_alone(path: Path) -> list[Motion]:
    return [_read_amc(path, _parse_asf(_asf_beside(path)))]


def _read_amc(path: Path, asf: _Asf) -> Motion:
    channels = _parse_amc(path, asf)
    rotations: list[Rotation | None] = []
    root_dof = asf.dofs[0]
    order = [root_dof[i : i + 2] for i in range(0, len(root_dof), 2)]
    root = channels["root"]
    position = root[:, [order.index(token) for token in ("TX", "TY", "TZ")]]
    spins = [i for i, token in enumerate(order) if token[0] == "R"]
    # Lower-case letters are extrinsic axes: RX RY RZ means Rz·Ry·Rx for column vectors.
    turn = Rotation.from_euler("".join(order[i][1].lower() for i in spins), root[:, spins], degrees=True)
    for name, dof, axis in zip(asf.rig.names, asf.dofs, asf.axes, strict=True):
        if name == "root":
            rotations.append(turn)
        elif dof and name in channels:
            local = Rotation.from_euler(dof, channels[name], degrees=True)
            rotations.append(axis * local * axis.inv())
        else:
            rotations.append(None)
    wanted = [asf.rig.names.index(_ASF_ENDS[joint]) for joint in JOINTS]
    joints = _forward(asf.rig, wanted, position, rotations) * asf.millimetres
    return Motion(joints, CMU_RATE, path.stem, asf.path.stem)


def _parse_amc(path: Path, asf: _Asf) -> dict[str, np.ndarray]:
    """Channels `(T, C)` by bone. Every frame must name the same bones in the same order; numbers are read in bulk."""
    lines = _read_text(path).splitlines()
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
        raise BadInput(f"{path}: the recording is truncated, its last frame is not complete; cut that frame off")
    body = np.array(lines, dtype=object).reshape(-1, block)
    expected = sum(widths) + 1
    stripped = [line.removeprefix(name) for row in body for name, line in zip(["", *names], row, strict=True)]
    values = _floats(" ".join(stripped))
    if values is None or values.size != expected * len(body):
        raise _amc_fault(path, body, names, widths, start)
    values = values.reshape(len(body), expected)
    if not np.array_equal(values[:, 0], np.arange(1, len(body) + 1)):
        row = int(np.argmax(values[:, 0] != np.arange(1, len(body) + 1)))
        raise BadInput(f"{path}, line {start + row * block + 1}: frame number {row + 1} was expected here")
    if not np.isfinite(values).all():
        raise BadInput(f"{path}: a channel holds a number that is not finite")
    edges = np.cumsum([1, *widths])
    return {name: values[:, low:high] for name, low, high in zip(names, edges[:-1], edges[1:], strict=True)}


def _amc_widths(path: Path, names: list[str], first: list[str], asf: _Asf, start: int) -> list[int]:
    """Numbers a line has, by the skeleton's dofs."""
    widths = []
    for i, (name, line) in enumerate(zip(names, first, strict=True)):
        number = start + i + 2
        if name not in asf.rig.names:
            raise BadInput(f"{path}, line {number}: '{name}' is no bone of {asf.path.name}; is it another subject's?")
        dof = asf.dofs[asf.rig.names.index(name)]
        widths.append(6 if name == "root" else len(dof))
        if len(line.split()) - 1 != widths[-1]:
            raise BadInput(f"{path}, line {number}: '{name}' has {len(line.split()) - 1} numbers, not {widths[-1]}")
    if "root" not in names:
        raise BadInput(f"{path}, line {start + 1}: the frame does not place the root")
    return widths


def _amc_fault(path: Path, body: np.ndarray, names: list[str], widths: list[int], start: int) -> BadInput:
    """Says which line is wrong, once it is known that one is."""
    for row, frame in enumerate(body):
        for i, line in enumerate(frame):
            tokens = line.split()
            name, width = (None, 0) if i == 0 else (names[i - 1], widths[i - 1])
            good = len(tokens) == width + 1 and (name is None or tokens[0] == name)
            if not good or not all(re.fullmatch(_NUMBER, token) for token in tokens[name is not None :]):
                expected = "a frame number" if name is None else f"'{name}' and {width} numbers"
                return BadInput(f"{path}, line {start + row * len(frame) + i + 1}: {expected} expected here")
    return BadInput(f"{path}: the frames cannot be read as numbers")


def _floats(text: str) -> np.ndarray | None:
    """All numbers of a text, or None where a token is not one."""
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError:
        return None


# --- BVH -------------------------------------------------------------------------------------------------------------


class _BvhJoint(NamedTuple):
    name: str
    parent: int
    offset: np.ndarray
    channels: list[str]


_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")


def _read_bvh(path: Path) -> list[Motion]:
    text = _read_text(path)
    hierarchy, found, motion = text.partition("MOTION")
    if not found or not hierarchy.lstrip().startswith("HIERARCHY"):
        raise BadInput(f"{path} is not a BVH file, or is truncated: it needs a HIERARCHY and a MOTION section")
    joints = _parse_bvh_hierarchy(hierarchy, path)
    names = [joint.name for joint in joints]
    wanted = _bvh_wanted(names, path)
    rate, values = _parse_bvh_motion(motion, sum(len(joint.channels) for joint in joints), path)
    rotations: list[Rotation | None] = []
    position = np.zeros((len(values), 3))
    column = 0
    for i, joint in enumerate(joints):
        block = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        spins = [k for k, channel in enumerate(joint.channels) if channel.endswith("rotation")]
        axes = "".join(joint.channels[k][0] for k in spins)
        # Upper-case letters are intrinsic axes: Zrotation Yrotation Xrotation means Rz·Ry·Rx.
        rotations.append(Rotation.from_euler(axes, block[:, spins], degrees=True) if spins else None)
        places = [k for k, channel in enumerate(joint.channels) if channel.endswith("position")]
        if i == 0 and places:
            position[:, ["XYZ".index(joint.channels[k][0]) for k in places]] = block[:, places]
    # A BVH joint's rotation turns what hangs from it, not its own offset: as segments, offsets belong to the parent.
    rig = _Rig(names, [joint.parent for joint in joints], np.zeros((len(joints), 3)))
    ends = _bvh_forward(rig, [joint.offset for joint in joints], wanted, position, rotations)
    return [Motion(ends * CMU_UNIT, rate, path.stem, path.stem)]


def _bvh_forward(rig: _Rig, offsets: list[np.ndarray], wanted: list[int], root: np.ndarray,
                 rotations: list[Rotation | None]) -> np.ndarray:  # fmt: skip
    """As `_forward`, with every joint split in two segments: its offset in the parent's axes, then its rotation."""
    parents: list[int] = []
    shifts: list[np.ndarray] = []
    turns: list[Rotation | None] = []
    for parent, offset, turn in zip(rig.parents, offsets, rotations, strict=True):
        parents += [2 * parent + 1 if parent >= 0 else -1, len(parents)]
        shifts += [offset if parent >= 0 else np.zeros(3), np.zeros(3)]
        turns += [None, turn]
    split = _Rig([name for name in rig.names for _ in range(2)], parents, np.array(shifts))
    return _forward(split, [2 * segment for segment in wanted], root, turns)


def _parse_bvh_hierarchy(text: str, path: Path) -> list[_BvhJoint]:
    joints: list[_BvhJoint] = []
    stack: list[int] = []
    pending: str | None = None
    for number, line in enumerate(text.splitlines(), 1):
        match line.split():
            case [] | ["HIERARCHY"]:
                continue
            case ["ROOT" | "JOINT", name]:
                pending = name
            case ["End", "Site"] if stack:
                pending = f"{joints[stack[-1]].name} end"
            case ["{"] if pending is not None:
                joints.append(_BvhJoint(pending, stack[-1] if stack else -1, np.zeros(3), []))
                stack.append(len(joints) - 1)
                pending = None
            case ["}"] if stack:
                stack.pop()
            case ["OFFSET", *numbers] if stack and len(numbers) == 3 and _floats(" ".join(numbers)) is not None:
                joints[stack[-1]].offset[:] = _floats(" ".join(numbers))
            case ["CHANNELS", count, *channels] if (
                stack and count == str(len(channels)) and set(channels) <= set(_CHANNELS)
            ):
                joints[stack[-1]].channels.extend(channels)
            case _:
                raise BadInput(f"{path}, line {number}: '{line.strip()}' cannot be read as part of a BVH hierarchy")
    if stack or not joints:
        raise BadInput(f"{path}: the hierarchy is not closed, so the file is truncated or damaged")
    return joints


def _bvh_wanted(names: list[str], path: Path) -> list[int]:
    """Indices of our fifteen joints, in the naming scheme that fits best."""
    table = min(_BVH_NAMES, key=lambda table: len(set(table.values()) - set(names)))
    missing = [name for name in table.values() if name not in names]
    if missing:
        raise BadInput(
            f"{path}: the skeleton lacks the joints {', '.join(missing)}; fifteen joints cannot be found in it"
        )
    return [names.index(table[joint]) for joint in JOINTS]


def _parse_bvh_motion(text: str, num_channels: int, path: Path) -> tuple[float, np.ndarray]:
    """Frame rate and channel values `(T, num_channels)`."""
    header = re.match(rf"\s*Frames:\s*(\d+)\s*Frame Time:\s*({_NUMBER})\s", text)
    if header is None or not float(header[2]) > 0:
        raise BadInput(f"{path}: MOTION does not start with 'Frames: <count>' and 'Frame Time: <seconds>'")
    count, rate = int(header[1]), 1 / float(header[2])
    values = _floats(text[header.end() :])
    if values is None or not np.isfinite(values).all():
        raise BadInput(f"{path}: a channel of the MOTION section is not a finite number")
    if count == 0 or values.size != count * num_channels:
        raise BadInput(
            f"{path}: {count} frames of {num_channels} channels are announced, but {values.size} numbers follow; "
            "the file is truncated or damaged"
        )
    return round(rate, 2), values.reshape(count, num_channels)


# --- .npz ------------------------------------------------------------------------------------------------------------


def _read_npz(path: Path) -> list[Motion]:
    arrays = read_tables(path, "file of recordings", "give an .npz of (T, 15, 3) or (T, 17, 3) positions")
    if not arrays:
        raise BadInput(f"{path} holds no recording; its keys must hold (T, 15, 3) or (T, 17, 3) positions")
    return [_npz_motion(path, key, value) for key, value in arrays.items()]


def _npz_motion(path: Path, key: str, value: np.ndarray) -> Motion:
    if value.dtype.kind not in "fiu" or value.ndim != 3 or value.shape[1:] not in ((NUM_JOINTS, 3), (17, 3)):
        raise BadInput(f"{path}: '{key}' has shape {value.shape}, a recording has (T, {NUM_JOINTS}, 3) or (T, 17, 3)")
    joints = value.astype(np.float64)
    if not np.isfinite(joints).all():
        raise BadInput(f"{path}: '{key}' has a coordinate that is not finite; leave such frames out")
    if len(joints) == 0:
        raise BadInput(f"{path}: '{key}' has no frames; leave it out")
    return Motion(joints if joints.shape[1] == NUM_JOINTS else joints[:, FROM_SEVENTEEN], NPZ_RATE, key, path.stem)


assert set(_ASF_ENDS) == set(JOINT_INDEX) == set(_BVH_NAMES[0]) == set(_BVH_NAMES[1])
