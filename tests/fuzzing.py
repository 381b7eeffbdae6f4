"""Damaged files through every reader: `make fuzz`.

    FUZZ_CASES=100000 FUZZ_SEED=1 make fuzz          so many cases
    FUZZ_SECONDS=600 make fuzz                       or so long
    python -m tests.fuzzing 1 4711                   one case again: its seed and its number

A case is a file of `targets`, damaged (its inside too, where it is packed), or a damaged command
line, of which every option and every file is read and nothing computed. It may be read or refused
with `BadInput`, one sentence; it must not raise anything else, warn, take longer than `SLOWEST` or
more memory than `MEMORY`. Case n of a seed is the same for ever. Workers are processes
of their own, so that what crashes or hangs one is found as well."""

import contextlib
import dataclasses
import functools
import io
import json
import multiprocessing
import os
import re
import resource
import shlex
import signal
import struct
import sys
import tempfile
import time
import traceback
import types
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer
from typer.models import OptionInfo

from poseterior.inference.baselines.run import _checksum
from poseterior.inference.baselines.run import _Save as SavedRun
from poseterior.inference.estimators.external import read_poses
from poseterior.inference.store import Block, Store
from poseterior.inference.stream import draws_of, open_stream
from poseterior.inference.studies.calibration.posteriors import _read as read_draws
from poseterior.probmodel import Anatomy, BadInput, Likelihood, read_frames
from poseterior.probmodel.datasets import from_motions, read_data_set, write_plain
from poseterior.probmodel.datasets.cases import DataSet
from poseterior.probmodel.errors.detector import DetectorErrors, ScoreFactor
from poseterior.probmodel.example import example
from poseterior.probmodel.formats import read_detections
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.sessions.calibrations import read_cameras
from poseterior.probmodel.sessions.triangulation import triangulate
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports import cli, console
from poseterior.reports.commands import check
from poseterior.reports.commands.detect import read_boxes
from poseterior.reports.exports.results import Wanted, read_clip
from poseterior.reports.figures import read_image
from poseterior.reports.figures.files import photo_focal
from poseterior.reports.options import Detected
from tests.filmed import cameras as filmed_by
from tests.filmed import moving, write_qualisys, write_toml
from tests.probmodel import test_motion
from tests.probmodel.test_datasets import MOTIONS, human36m
from tests.probmodel.test_formats_fuzz import FILES, SIZE, hdf5, npy, npz
from tests.probmodel.test_markers import trc, write_c3d
from tests.probmodel.test_published import write_model

MEMORY = 2 << 30
"""Bytes of address space beyond what the imports take."""
SLOWEST, DEAD = 10, 120
"""Seconds of the processor after which a case has failed, and of the clock after which its process
is ended."""
LONGEST = 600
SHARED = Path(__file__).parents[2] / "shared" / "data"
LARGEST_SEED = 120_000
"""Bytes; of larger real files only the beginning is taken, where that is a file."""


class Target(NamedTuple):
    """A reader, undamaged files for it, and what lies beside them unharmed."""

    file: str
    read: Callable[[Path], object]
    corpus: list[bytes]
    beside: dict[str, bytes] = {}  # noqa: RUF012 — never written to


def targets() -> dict[str, Target]:
    """Every reader, by name."""
    joints = MOTIONS[0].joints[:3]
    few = from_motions(MOTIONS, "few", frames=6)
    kept = {
        f"2D joints: {name}": Target(
            "a.bin", partial(_detections, format=name), several + _real(name)
        )
        for name, several in FILES.items()
    }
    return kept | {
        "frames": Target("a.bin", _frames, [data for files in FILES.values() for data in files]),
        "limits": Target("a.npz", Anatomy.load, [_written(Anatomy.default().save)]),
        "limits .mat": Target("a.mat", Anatomy.load, [_mat()]),
        "dictionary": Target(
            "a.npz", PoseDictionary.load, [_written(PoseDictionary.default().save)]
        ),
        "motion .npz": Target("a.npz", _motion, [npz(**{"a/b": joints})]),
        "motion .bvh": Target("a.bvh", _motion, _bvh()),
        "motion .trc": Target("a.trc", _motion, [trc().encode()]),
        "motion .c3d": Target("a.c3d", _motion, [_written(write_c3d)]),
        "motion .asf": Target("07.asf", _subject, [_asf()], {"07_01.amc": _amc()}),
        "motion .amc": Target("07_01.amc", _motion, [_amc()], {"07.asf": _asf()}),
        "data set": Target(
            "a.npz",
            _data_set,
            [_written(partial(write_plain, few), few), _plain(few), _doubtful(few)],
        ),
        **_human36m(),
        "poses": Target("a.npz", read_poses, [npz(joints=joints, names=np.array(JOINTS))]),
        "poses .npy": Target("a.npy", read_poses, [npy(joints)]),
        "draws": Target("a.npz", read_draws, [npz(joints=joints[None])]),
        "draws .nc": Target("a.nc", read_draws, [_tree()]),
        "check .nc": Target("a.nc", _checked, [_tree()]),
        "check .json": Target("a.json", _checked, [_hypotheses()]),
        "check .npy": Target("a.npy", _checked, [npy(joints)]),
        "check .npz": Target("a.npz", _checked, [npz(**{"a/b": joints})]),
        "error law": Target("a.json", _error_law, _laws()),
        "calibration .qca.txt": Target("a.qca.txt", _calibration, [_written(_qualisys)]),
        "calibration .toml": Target("a.toml", _calibration, [_written(_toml)]),
        "boxes": Target("a.json", lambda path: read_boxes(path, 0.5), [_boxes()]),
        "names": Target("a.json", _names, [b'{"LHip": "left_hip", "RHip": "right_hip"}']),
        "image": Target("a.png", read_image, _images()),
        "focal length of a photo": Target("a.jpg", photo_focal, _images()),
        "export .json": Target("a.json", _exported, [_hypotheses()]),
        "export .nc": Target("a.nc", _exported, [_tree()]),
        "saved run": Target("a.npz", _taken_up, [_saved()]),
        "block of a stream": Target("block-000000.nc", _stream, [_block()], {"run.json": _RUN}),
        "settings of a stream": Target("run.json", _stream, [_RUN], {"block-000000.nc": _block()}),
        **{
            f"command line: {name}": Target(
                "words",
                _command,
                _lines(name),
                {"frame.json": example().path.read_bytes(), "few.npz": _plain(few)},
            )
            for name in cli.COMMANDS
        },
    }


def _detections(path: Path, format: str) -> object:
    auto = path.stat().st_size % 3 > 0
    return read_detections(path, "auto" if auto else format, image_size=SIZE)


def _frames(path: Path) -> object:
    return list(read_frames(path, image_size=SIZE))


def _motion(path: Path) -> object:
    return [motion.without_jumps().at_rate(30.0) for motion in read_motion(path)]


def _subject(path: Path) -> object:
    return _motion(path.with_name("07_01.amc"))


def _data_set(path: Path) -> object:
    data = read_data_set(path if path.name == "a.npz" else path.parent)
    return [data.case(0).hiding(2).turned(30.0), data.spread(3), data.sha256]


def _checked(path: Path) -> object:
    poses = check.read_poses(path)
    check._require_poses(poses, path)
    return poses


def _error_law(path: Path) -> object:
    """The law, and what it makes of a detection."""
    likelihood = Likelihood.of(DetectorErrors.read(path))
    return [likelihood.sha256, likelihood.spread(example().detection, 100.0)]


def _laws() -> list[bytes]:
    scored = dataclasses.replace(
        DetectorErrors.default(), score=ScoreFactor((0.3, 0.6), (2.0, 1.0, 0.8))
    )
    return [_written(one.write) for one in (DetectorErrors.default(), scored)]


def _calibration(path: Path) -> object:
    """The cameras, and where they see a person who stands before the undamaged ones."""
    cameras = read_cameras(path)
    straight = [camera.straight for camera in cameras]
    xy = [camera.straighten(camera.project(moving(1)[0])) for camera in filmed_by(4)]
    number = min(len(cameras), len(xy))
    trust = np.ones((number, len(JOINTS)))
    return triangulate(straight[:number], np.stack(xy[:number]), trust, 0.4 * trust)


def _qualisys(path: Path) -> None:
    write_qualisys(tuple(filmed_by(4)), path)


def _toml(path: Path) -> None:
    write_toml(tuple(filmed_by(4)), path)


def _names(path: Path) -> object:
    return Detected(names=path)._names()


def _exported(path: Path) -> object:
    return read_clip(path, Wanted(1.75, k=2))


def _taken_up(path: Path) -> object:
    taken: list[object] = []
    method: Any = types.SimpleNamespace(restore=taken.append)
    return [SavedRun(path, "fingerprint").load(method), taken]


def _saved() -> bytes:
    content = {
        "_fingerprint": np.array("fingerprint"),
        "_clock": np.array([2.0, 1.0]),
        "_history": np.ones((2, 3)),
        "leaf0": np.arange(9.0),
        "kept": np.ones((2, 4)),
    }
    return npz(**content, _sha256=np.array(_checksum(content)))


_RUN = b'{"settings": {"study": "stream of frames", "seed": "0 0", "k": 2, "keep": 3}, "blocks": 1}'


def _stream(path: Path) -> object:
    return [open_stream(path.parent), draws_of(path.parent, "one")]


@functools.cache
def _block() -> bytes:
    import xarray as xr

    names = {"frame": ["one", "two"]}
    joints = (("frame", "draw", "joint", "axis"), np.zeros((2, 3, 15, 3)))
    number = ("frame", np.array([3, 3]))
    groups = {
        "summary": xr.Dataset({"num_draws": number}, coords=names),
        "hypotheses": xr.Dataset({"joints": joints}, coords=names),
        "posterior": xr.Dataset({"joints": joints}, coords=names),
    }
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), json.loads(_RUN)["settings"])
        store.write(Block(0, "frames", {"frames": "some"}, 2, None), groups)
        return store.path(0).read_bytes()


def _lines(name: str) -> list[bytes]:
    """Command lines of a command, among them one with its options and their values."""
    kind = cli.COMMANDS[name]
    options = [
        f"{next(iter(info.param_decls), '--' + one.name.replace('_', '-'))} {one.default}"
        for one in cli.declared(kind)
        if isinstance(info := one.annotation.__metadata__[0], OptionInfo)
        and isinstance(one.default, int | float | str)
        and not isinstance(one.default, bool)
    ]
    lines = [
        re.sub(
            r"(?:actions_train|recordings)\.npz|h36m/|mocap/",
            "few.npz",
            re.sub(r"\S+\.json|walk/", "frame.json", line),
        )
        for line in kind.EXAMPLES
    ]
    return [line.encode() for line in [*lines, " ".join([lines[0], *options])]]


@functools.cache
def _application() -> Any:
    """The command line, put together once: that takes longer than all else that a case does."""
    return typer.main.get_command(cli.app)


def _command(path: Path) -> None:
    """What the command line says is read, and every file that it names; its work is not done."""
    text = path.read_bytes().replace(b"\0", b"").decode("utf-8", "replace")
    try:
        words = shlex.split(text)
    except ValueError:  # no shell would take it
        words = text.split()
    # Files are the case's own, whatever the words say.
    words = [word for word in words if not word.startswith(("/", "~", ".."))]
    idle = types.SimpleNamespace(run=lambda wanted, screen: None)
    out, err, before = io.StringIO(), io.StringIO(), (sys.argv, cli.import_module)
    sys.argv, cli.import_module = ["poseterior", *words], lambda name: idle  # type: ignore[assignment]
    code: Any = 0
    try:
        with (
            contextlib.chdir(path.parent),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            console.guarded(_application())
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.argv, cli.import_module = before
    # On a busy machine a command says meanwhile what it is at.
    said = re.sub(r"^[a-z ]+: \d+ s\n", "", err.getvalue(), flags=re.MULTILINE).removesuffix("\n")
    assert code in (0, 2), said
    if code:
        assert said.startswith("poseterior: "), said
        raise BadInput(said.removeprefix("poseterior: "))


def _written(save: Callable[[Path], None], *_: object) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        save(Path(folder, "a.npz"))
        return Path(folder, "a.npz").read_bytes()


def _plain(data: DataSet) -> bytes:
    return npz(
        poses=data.poses.astype("f4"),
        keypoints=data.keypoints,
        action=data.action,
        subject=data.subject.astype("S"),
    )


def _doubtful(data: DataSet) -> bytes:
    """A data set whose truth errs and has midpoints."""
    doubt = np.tile(25.0 * np.eye(3), (len(data), len(JOINTS), 1, 1))
    more = dataclasses.replace(data, midpoints=("thorax", "pelvis"), doubt=doubt)
    return _written(partial(write_plain, more), more)


def _mat() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_model(Path(folder, "a.mat")).read_bytes()


def _human36m() -> dict[str, Target]:
    with tempfile.TemporaryDirectory() as folder:
        human36m(Path(folder), MOTIONS[0].joints[:2], 2)
        names = ("data_3d_h36m.npz", "data_2d_h36m_gt.npz")
        files = {name: Path(folder, name).read_bytes() for name in names}
    three, two = names
    return {
        "Human3.6M, 3D": Target(three, _data_set, [files[three]], {two: files[two]}),
        "Human3.6M, 2D": Target(two, _data_set, [files[two]], {three: files[three]}),
    }


def _tree() -> bytes:
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(1, 4, 15, 3))
    return hdf5(
        lambda file: file.create_dataset(
            "posterior/joints", data=draws, compression="gzip", shuffle=True, chunks=(1, 2, 15, 3)
        )
    )


def _hypotheses() -> bytes:
    poses = [dict(zip(JOINTS, pose.tolist(), strict=True)) for pose in MOTIONS[0].joints[:2]]
    return json.dumps({"hypotheses": [{"joints": pose, "weight": 0.5} for pose in poses]}).encode()


def _boxes() -> bytes:
    box = {"image_id": 7, "category_id": 1, "bbox": [25, 5, 100.5, 185], "score": 0.9}
    return json.dumps([box, box | {"image_id": "a.png"}]).encode()


def _images() -> list[bytes]:
    from PIL import ExifTags, Image

    image, kept = Image.new("RGB", (20, 30), (200, 10, 30)), []
    exif = image.getexif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 30
    for kind in ("PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP"):
        file = io.BytesIO()
        image.save(file, kind, exif=exif)
        kept.append(file.getvalue())
    return kept


def _asf() -> bytes:
    return test_motion.asf_text().encode()


def _amc() -> bytes:
    return test_motion.amc_text([{}, {}, {}]).encode()


def _bvh() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        found = [test_motion.write_bvh(Path(folder, "a.bvh"), [{}, {}]).read_bytes()]
    for path in sorted(SHARED.glob("bvh/*.bvh")):
        head, rows = path.read_text().split("Frame Time:")
        rows = "\n".join(rows.splitlines()[:4])
        found.append((re.sub(r"Frames:\s*\d+", "Frames: 3", head) + "Frame Time:" + rows).encode())
    return found


def _real(name: str) -> list[bytes]:
    """Real files of a format, from the data pack, where it is there."""
    folder = {"coco-annotations": "coco", "coco-results": "alphapose"}.get(name, name)
    paths = sorted((SHARED / "detections" / folder).glob("*")) if folder else []
    return [
        path.read_bytes()
        for path in paths
        if path.suffix in (".json", ".pbtxt", ".csv", ".h5") and path.stat().st_size < LARGEST_SEED
    ]


# Damage.

_HURTING = (
    *(b"NaN", b"-1e999", b"null", b"{}", b"[]", b'"', b"\xff" * 8, b"\x00" * 8, b"9" * 40),
    *(b"1e-320", b"1e308", b"-1", b"0", b"9" * 5000, b"\\ud800", b"\x1b[31m", b"nan", b"1e9"),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The file with a few damages; where it is packed, mostly to what is inside."""
    if rng.random() < 0.75:
        if data.startswith(b"PK\x03\x04"):
            return _rezipped(data, rng)
        if data.startswith(b"MATLAB"):
            return _repacked_mat(data, rng)
    for _ in range(int(rng.integers(1, 5))):
        data = _hurt(data, rng)
    return data


def _hurt(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return data
    place = int(rng.integers(len(data)))
    if rng.random() < 0.3:  # at the head, where the lengths stand
        place = int(rng.integers(min(len(data), 200)))
    length = int(rng.integers(1, 64))
    piece = _HURTING[int(rng.integers(len(_HURTING)))]
    match int(rng.integers(9)):
        case 0:
            return data[:place] + bytes([int(rng.integers(256))]) + data[place + 1 :]
        case 1:
            return (
                data[:place] + bytes([data[place] ^ 1 << int(rng.integers(8))]) + data[place + 1 :]
            )
        case 2:
            return data[:place] if rng.random() < 0.3 else data[:place] + data[place + length :]
        case 3:
            return data[:place] + data[place : place + length] + data[place:]
        case 4:
            return data[:place] + piece + data[place + int(rng.integers(8)) :]
        case 5:
            return _lines_changed(data, rng)
        case 6:
            value = int(rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, int(rng.integers(2**32))]))
            return data[:place] + struct.pack("<I", value) + data[place + 4 :]
        case _:
            return _number_changed(data, piece, rng)


def _number_changed(data: bytes, piece: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(max(1, len(data) - 10_000)))
    found = [match.span() for match in _NUMBER.finditer(data, start, start + 20_000)]
    if not found:
        return data
    low, high = found[int(rng.integers(len(found)))]
    other = piece if rng.random() < 0.4 else b"%d" % int(rng.integers(100))
    return data[:low] + other + data[high:]


def _lines_changed(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    one, two = (int(rng.integers(len(lines))) for _ in range(2))
    match int(rng.integers(3)):
        case 0:
            lines.insert(two, lines[one])
        case 1:
            del lines[one]
        case _:
            lines[one], lines[two] = lines[two], lines[one]
    return b"\n".join(lines)


def _rezipped(data: bytes, rng: np.random.Generator) -> bytes:
    members = dict(_members(data))
    names = list(members)
    name = names[int(rng.integers(len(names)))]
    match int(rng.integers(8)):
        case 0:
            del members[name]
        case 1:
            members[name] = members[names[int(rng.integers(len(names)))]]
        case 2:
            members[f"{name}x"] = members.pop(name)
        case _:
            for _ in range(int(rng.integers(1, 4))):
                members[name] = _hurt(members[name], rng)
    file = io.BytesIO()
    packing = zipfile.ZIP_DEFLATED if rng.random() < 0.2 else zipfile.ZIP_STORED  # it takes time
    with zipfile.ZipFile(file, "w", packing, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


@functools.cache
def _members(data: bytes) -> dict[str, bytes]:
    """The members of an archive, unpacked once."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _repacked_mat(data: bytes, rng: np.random.Generator) -> bytes:
    """With one variable damaged, and packed or not."""
    place, parts = 128, []
    while place + 8 <= len(data):
        end = place + 8 + struct.unpack("<I", data[place + 4 : place + 8])[0]
        parts.append(data[place:end])
        place = end
    chosen = int(rng.integers(len(parts)))
    part = parts[chosen]
    if part[0] == 15:
        part = zlib.decompress(part[8:])
    for _ in range(int(rng.integers(1, 4))):
        head, tail = part[:300], part[300:]
        part = _hurt(head, rng) + tail if rng.random() < 0.7 else head + _hurt(tail, rng)
    if rng.random() < 0.2:
        part = zlib.compress(part, 1)
        part = struct.pack("<II", 15, len(part)) + part
    parts[chosen] = part
    return data[:128] + b"".join(parts)


# Cases.


class Slow(BaseException):
    """A case that took too long."""


def run_case(seed: int, number: int, kinds: dict[str, Target], folder: Path) -> str:
    """Reads one damaged file: "read" or "refused". Raises whatever else happens."""
    rng = np.random.default_rng([seed, number])
    target = list(kinds.values())[number % len(kinds)]
    original = target.corpus[int(rng.integers(len(target.corpus)))]
    path = folder / target.file
    for name, content in target.beside.items():
        (folder / name).write_bytes(content)
    path.write_bytes(damaged(original, rng))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            target.read(path)
    except BadInput as error:
        message = str(error).replace(str(folder), "")
        assert "\n" not in message, message
        assert len(message) <= LONGEST, message
        assert message.isprintable(), message
        return "refused"
    finally:
        for name in (target.file, *target.beside):
            (folder / name).unlink(missing_ok=True)
    return "read"


def worker(seed: int, numbers: range, at: Any, said: Any) -> None:
    """Runs cases one after another; `at` says which, `said` is told of failures and of the end."""
    kinds = targets()
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    signal.signal(signal.SIGPROF, _too_slow)
    with tempfile.TemporaryDirectory() as folder:
        counts = {"read": 0, "refused": 0}
        for number in numbers:
            at.value = number
            signal.setitimer(signal.ITIMER_PROF, SLOWEST)
            try:
                counts[run_case(seed, number, kinds, Path(folder))] += 1
            except (Exception, Slow):
                said.put((number, traceback.format_exc()))
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
        said.put((None, counts))


def _sayable(text: str) -> str:
    """A text as any stream takes it: half a surrogate pair is spelt out."""
    return text.encode("utf-8", "backslashreplace").decode()


def _too_slow(*_: object) -> None:
    raise Slow


def campaign(seed: int, cases: int, seconds: float, out: Callable[[str], None]) -> int:
    """Runs cases in worker processes until they are done or the time is up, and says what failed;
    the number of failures."""
    context, names = multiprocessing.get_context("spawn"), list(targets())
    ends, failures, number, block = time.monotonic() + seconds, 0, 0, 20_000
    total = {"read": 0, "refused": 0}
    while number < cases and time.monotonic() < ends:
        numbers = range(number, min(number + block, cases))
        at, said = context.Value("q", -1), context.Queue()
        process = context.Process(target=worker, args=(seed, numbers, at, said))
        process.start()
        number = numbers.stop
        for found, words in _heard(process, at, said):
            if found is None:
                total = {key: total[key] + words[key] for key in total}
                continue
            failures += 1
            out(f"case {seed} {found}, {names[found % len(names)]}:\n{_sayable(words)}")
            if process.exitcode is not None:
                number = found + 1  # the rest of the block is still to be done
        process.join()
        out(
            f"{number:,} cases: {total['read']:,} read, {total['refused']:,} refused,"
            f" {failures} failures"
        )
    return failures


def _heard(process: Any, at: Any, said: Any) -> Iterator[tuple[int | None, Any]]:
    """What a worker says, and where it died or hung."""
    from queue import Empty

    last, since = -1, time.monotonic()  # -1: the worker still imports
    while True:
        try:
            found = said.get(timeout=1.0)
            yield found
            if found[0] is None:
                return
        except Empty:
            if at.value != last:
                last, since = at.value, time.monotonic()
            elif not process.is_alive():
                yield last, f"the process died (exit code {process.exitcode})"
                return
            elif time.monotonic() - since > DEAD + 600 * (last == -1):
                process.kill()
                process.join()
                yield last, f"nothing was heard for {DEAD} seconds"
                return


def main() -> int:
    """One case of the command line, or a campaign by the environment; 1 where something failed."""
    if len(sys.argv) == 3:
        seed, number = map(int, sys.argv[1:])
        with tempfile.TemporaryDirectory() as folder:
            print(run_case(seed, number, targets(), Path(folder)))
        return 0
    seconds = float(os.environ.get("FUZZ_SECONDS", "inf"))
    cases = int(os.environ.get("FUZZ_CASES", "100000" if seconds == float("inf") else 10**9))
    seed = int(os.environ.get("FUZZ_SEED", "0"))
    return int(campaign(seed, cases, seconds, partial(print, flush=True)) > 0)


if __name__ == "__main__":
    sys.exit(main())
