"""Files that were made to hurt: pipes that never answer, bombs, links to other files, pickles that
grow, headers that lie. Each is refused in a sentence, without the memory or the time it asks for.

Memory is counted by `tracemalloc`, which sees what Python, NumPy and zlib take."""

import contextlib
import io
import json
import os
import pickle
import re
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from poseterior.inference.estimators.external import read_poses
from poseterior.inference.studies.calibration.posteriors import _read as read_draws
from poseterior.probmodel import Anatomy, BadInput, matlab
from poseterior.probmodel import arrays as arrays_of_files
from poseterior.probmodel.arrays import read_array, read_mat, read_netcdf, read_tables
from poseterior.probmodel.datasets import pickles, read_data_set
from poseterior.probmodel.datasets.pickles import follow
from poseterior.probmodel.documents import FREE as FREE_OBJECTS
from poseterior.probmodel.documents import cost, parsed, read_json, require_modest
from poseterior.probmodel.files import opened, read_bytes
from poseterior.probmodel.formats import Content, read_content, read_detections
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import read_motion
from poseterior.reports.commands.check import read_poses as read_checked
from poseterior.reports.commands.detect import read_boxes
from poseterior.reports.figures import read_image
from tests.probmodel.test_formats_fuzz import hdf5, npy, npz

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "detections": ("a.json", read_detections),
    "limits": ("a.npz", Anatomy.load),
    "published limits": ("a.mat", Anatomy.load),
    "dictionary": ("a.npz", PoseDictionary.load),
    "motion .npz": ("a.npz", read_motion),
    "motion .bvh": ("a.bvh", read_motion),
    "data set": ("a.npz", read_data_set),
    "poses .npy": ("a.npy", read_poses),
    "poses .npz": ("a.npz", read_poses),
    "draws .npy": ("a.npy", read_draws),
    "draws .nc": ("a.nc", read_draws),
    "check .nc": ("a.nc", read_checked),
    "check .npy": ("a.npy", read_checked),
    "check .json": ("a.json", read_checked),
    "boxes": ("a.json", lambda path: read_boxes(path, 0.5)),
    "image": ("a.png", read_image),
}
"""Every reader of a path, with a name of a file that it takes."""


def taken(call: Callable[[], object]) -> int:
    """The most memory, bytes, that a call holds at once; it may refuse."""
    tracemalloc.start()
    try:
        with contextlib.suppress(BadInput):
            call()
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return most


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()


# Files that are none.


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_before_it_blocks(tmp_path: Path, name: str) -> None:
    file, read = READERS[name]
    os.mkfifo(tmp_path / file)
    with pytest.raises(BadInput, match="is a named pipe, not a file"):
        read(tmp_path / file)


@pytest.mark.parametrize(
    ("path", "words"),
    [("/dev/zero", "is a device, not a file"), ("/", "is a folder, not a file")],
)
def test_devices_and_folders_are_refused(path: str, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        opened(path, "file", "give another")


def test_a_file_that_becomes_a_pipe_does_not_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at it and its opening."""
    (tmp_path / "file").touch()
    before = os.stat(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(os, "stat", lambda *_, **__: before)
    with pytest.raises(BadInput, match="is a named pipe"):
        opened(tmp_path / "pipe", "file", "give another")


def test_a_file_is_no_larger_than_it_said(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(20))
    with pytest.raises(BadInput, match="20 bytes, more than 10"):
        read_bytes(tmp_path / "a", "file", "give another", largest=10)
    with pytest.raises(BadInput, match="changed while it was read"):  # its size is said to be 0
        read_bytes("/proc/self/status", "file", "give another")
    assert taken(lambda: read_bytes(tmp_path / "a", "file", "give another")) < 1_000_000


# Archives.


@pytest.mark.parametrize("name", [name for name in READERS if READERS[name][0] == "a.npz"])
@pytest.mark.parametrize(
    "data",
    [
        zipped({"joints": b"hello", "poses.npy": b"hello", "occupied.npy": b""}),
        zipped({"a.npy": npy(np.zeros(3))[:20]}),
        zipped({"a.npy": npy(np.zeros(3)).replace(b"descr", b"des\0r")}),
        zipped({"a.npy": npy(np.zeros(3)).replace(b"(3,)", b"(-3,)")}),
        zipped({"a.npy": npy(np.zeros(3))}, zipfile.ZIP_BZIP2),
        zipped({"a\x1b[31m.npy": npy(np.zeros(3))}),
        npz(a=np.array([{}], object)),
        npy(np.zeros(3)),
        hdf5(lambda file: file.create_dataset("a", data=np.zeros(3))),
    ],
    ids=["members", "cut", "NUL", "negative", "bzip2", "escape", "object", "npy", "hdf5"],
)
def test_damaged_archives_are_sentences(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(BadInput):
        READERS[name][1](tmp_path / "a.npz")


@pytest.mark.parametrize("data", [npz(a=np.zeros(3)), npy(np.zeros(3)).replace(b"'", b"\0"), b""])
def test_an_npy_that_is_none_is_a_sentence(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    for read in (read_poses, read_draws, read_checked):
        with pytest.raises(BadInput):
            read(tmp_path / "a.npy")


def test_an_encrypted_member_is_a_sentence(tmp_path: Path) -> None:
    data = bytearray(zipped({"positions_3d.npy": npy(np.zeros(3))}))
    for start, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(start) + place] |= 1
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(BadInput, match="is encrypted"):
        read_tables(tmp_path / "a.npz", "file", "give another")


def bomb(size: int) -> bytes:
    """An .npz of so many zeros."""
    header = npy(np.zeros(0, np.uint8)).replace(b"(0,), }", b"(%d,), }" % size)
    return zipped({"a.npy": header + bytes(size)})


def lying(size: int) -> bytes:
    """An .npz whose member says it is small, and is not."""
    data, true = bytearray(bomb(size)), size + len(npy(np.zeros(0, np.uint8)))
    said = struct.pack("<I", 200)
    place = data.index(b"PK\x01\x02")
    for at in (22, place + 24):
        assert data[at : at + 4] != said
        data[at : at + 4] = said
    assert struct.pack("<I", true) not in data[:30]
    return bytes(data)


FREE = 20_000_000


@pytest.fixture
def little(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller budget, so that bombs need not be large."""
    monkeypatch.setattr(arrays_of_files, "FREE", FREE)
    monkeypatch.setattr(matlab, "LARGEST_UNPACKED", FREE)


@pytest.mark.usefixtures("little")
@pytest.mark.parametrize("make", [bomb, lying])
def test_an_archive_that_unpacks_to_too_much_is_not_unpacked(
    tmp_path: Path, make: Callable[[int], bytes]
) -> None:
    (tmp_path / "a.npz").write_bytes(make(2 * FREE))
    most = taken(lambda: read_tables(tmp_path / "a.npz", "file", "give another"))
    assert most < FREE / 4


@pytest.mark.usefixtures("little")
def test_many_members_share_one_budget(tmp_path: Path) -> None:
    part = zipped({"0.npy": npy(np.zeros(FREE // 16, np.uint8))})  # weighs half as doubles
    arrays = {f"{number}.npy": npy(np.zeros(FREE // 3, np.uint8)) for number in range(4)}
    (tmp_path / "a.npz").write_bytes(zipped(arrays))
    with pytest.raises(BadInput, match=r"would take .* bytes, more than can be"):
        read_tables(tmp_path / "a.npz", "file", "give another")
    (tmp_path / "a.npz").write_bytes(part)
    assert len(read_tables(tmp_path / "a.npz", "file", "")["0"]) == FREE // 16


def mat(content: bytes) -> bytes:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(content, 9)
    return head + struct.pack("<II", 15, len(packed)) + packed


@pytest.mark.usefixtures("little")
def test_a_mat_that_unpacks_to_too_much_is_not_unpacked(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(mat(bytes(10 * FREE)))
    assert (tmp_path / "a.mat").stat().st_size < 1_000_000
    most = taken(lambda: read_mat(tmp_path / "a.mat", ["a"], "file", "give another"))
    assert most < 4 * FREE


# HDF5.


def outside(folder: Path, kind: str) -> bytes:
    """`posterior/joints` that lies in another file."""
    shape = (1, 2, 15, 3)
    with h5py.File(folder / "other.h5", "w") as other:
        other["secret"] = np.ones(shape)
    (folder / "raw").write_bytes(np.ones(shape).tobytes())

    def write(file: h5py.File) -> None:
        group = file.create_group("posterior")
        if kind == "external link":
            group["joints"] = h5py.ExternalLink(str(folder / "other.h5"), "secret")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape, "f8")
            layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "secret", shape)
            group.create_virtual_dataset("joints", layout)
        else:
            space = [(str(folder / "raw"), 0, 8 * 90)]
            group.create_dataset("joints", shape, "f8", external=space)

    return hdf5(write)


@pytest.mark.parametrize("kind", ["external link", "virtual", "raw"])
def test_no_other_file_is_read(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.nc").write_bytes(outside(tmp_path, kind))
    for read in (read_checked, read_draws):
        with pytest.raises(BadInput, match=r"lies in another file|holds no poses|has no array"):
            read(tmp_path / "a.nc")


def test_a_chunk_that_unpacks_to_more_than_it_says_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        made = file.create_dataset("a", (1000,), "f8", chunks=(1000,), compression="gzip")
        made.id.write_direct_chunk((0,), zlib.compress(bytes(100_000_000), 9))
    assert taken(lambda: read_netcdf(path, ["a"], "file", "give another")) < 20_000_000
    with pytest.raises(BadInput, match="unpacks to more than it says"):
        read_netcdf(path, ["a"], "file", "give another")


@pytest.mark.parametrize("steps", [1, 2])
def test_a_tree_that_goes_round_is_refused(tmp_path: Path, steps: int) -> None:
    """The library would go from node to node for ever."""
    path = tmp_path / "a.nc"
    with h5py.File(path, "w", libver="earliest") as file:
        for number in range(steps):
            file.create_group(f"group {number}")
    data = bytearray(path.read_bytes())
    nodes = [found.start() for found in re.finditer(b"TREE", data)]
    assert len(nodes) == 1 + steps
    chosen = nodes[:steps]
    for node, following in zip(chosen, chosen[1:] + chosen[:1], strict=True):
        data[node + 16 : node + 24] = struct.pack("<Q", following)
    path.write_bytes(data)
    with pytest.raises(BadInput, match="is no file, or is truncated"):
        read_netcdf(path, None, "file", "give another")


HEAPS = {
    "no step": (0, 0),
    "a step back": (1, 2**64 - 32),
    "a step around": (1, 2**64 - 16),
}


@pytest.mark.parametrize("what", HEAPS)
def test_a_heap_that_is_walked_for_ever_is_refused(tmp_path: Path, what: str) -> None:
    path = tmp_path / "a.nc"
    _file_with_texts(path)
    data = bytearray(path.read_bytes())
    (heap,) = (found.start() for found in re.finditer(b"GCOL", data))
    data[heap + 16 : heap + 40] = struct.pack(
        "<HHIQ", HEAPS[what][0], 0, 0, HEAPS[what][1]
    ) + bytes(8)
    path.write_bytes(data)
    with pytest.raises(BadInput, match="is no file, or is truncated"):
        read_netcdf(path, ["a"], "file", "give another")


def test_words_that_look_like_heaps_are_read_in_bounded_time(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    _file_with_texts(path)
    np.testing.assert_array_equal(read_netcdf(path, ["a"], "file", "")["a"], np.arange(3.0))
    with path.open("ab") as file:
        file.write(struct.pack("<5s3xQHHIQ", b"GCOL\1", 160_000, 1, 0, 0, 0) * 10_000)
    with pytest.raises(BadInput, match="is no file, or is truncated"):
        read_netcdf(path, ["a"], "file", "give another")


def _file_with_texts(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", data=np.arange(3.0))
        file["a"].attrs["texts"] = np.array(["one", "two"], object)


@pytest.mark.slow
def test_a_tree_of_many_nodes_is_read(tmp_path: Path) -> None:
    """Nodes that follow each other, and words in the data that look like nodes."""
    values = np.frombuffer(b"TREE" * 900_000, np.uint8)
    with h5py.File(tmp_path / "a.nc", "w", libver="earliest") as file:
        file.create_dataset("a", data=values, chunks=(1000,))
    assert (tmp_path / "a.nc").read_bytes().count(b"TREE") > 900_000
    np.testing.assert_array_equal(read_netcdf(tmp_path / "a.nc", ["a"], "file", "")["a"], values)


GZIP = {"compression": "gzip"}


def test_two_packings_on_each_other_are_refused(tmp_path: Path) -> None:
    """Each can make a thousand times more of what it is given."""
    with h5py.File(tmp_path / "a.nc", "w") as file:
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk((100,))
        creation.set_deflate(9)
        creation.set_deflate(9)
        space = h5py.h5s.create_simple((100,))
        h5py.h5d.create(file.id, b"a", h5py.h5t.NATIVE_DOUBLE, space, creation)
    with pytest.raises(BadInput, match="packed in a way that is not read"):
        read_netcdf(tmp_path / "a.nc", ["a"], "file", "give another")


def test_packed_hdf5_is_read(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(70, 30))
    with h5py.File(tmp_path / "a.nc", "w") as file:
        for name, ways in {
            "gzip": {"compression": "gzip", "shuffle": True, "fletcher32": True},
            "lzf": {"compression": "lzf"},
            "plain": {},
        }.items():
            file.create_dataset(name, data=values, **ways)
        skipped = file.create_dataset("as it is", values.shape, "f8", chunks=(70, 30), **GZIP)
        skipped.id.write_direct_chunk((0, 0), values.tobytes(), filter_mask=1)
        file.create_dataset("many", data=values, chunks=(1, 1), **GZIP)
    found = read_netcdf(tmp_path / "a.nc", None, "file", "")
    assert len(found) == 5
    for array in found.values():
        np.testing.assert_array_equal(array, values)


# Text and JSON.


@pytest.mark.parametrize("piece", ["{}", "[]", '{"":0}', "[[]]"])
def test_a_document_of_empty_objects_is_refused_before_it_is_parsed(piece: str) -> None:
    number = FREE_OBJECTS // 60
    text = "[" + ",".join([piece] * number) + "]"
    data = f'{{"people": {text}}}'.encode()
    for content in (data, text.encode()):
        assert taken(lambda content=content: read_content(Content(content, "a"))) < 4 * len(data)
        with pytest.raises(BadInput, match="GB of memory as objects"):
            read_content(Content(content, "a"))


def test_the_cost_of_a_document_is_not_too_little() -> None:
    for value in ([{}] * 5000, [[1.5, 2.5]] * 5000, [{"a": 1000, "b": [1e5]}] * 5000, ["ab"] * 99):
        text = json.dumps(value)
        assert taken(lambda text=text: json.loads(text)) < cost(text)


@pytest.mark.parametrize("width", [17, 133])
def test_ten_thousand_frames_are_modest(width: int) -> None:
    """In the densest of the forms: whole numbers, no spaces."""
    point = {"mmpose": "[123,456]", "mediapipe": '{"x":0.1,"y":0.2,"z":0,"visibility":1}'}
    for text in point.values():
        require_modest("[" + ",".join([text] * (10_000 * width)) + "]", "a")


def test_json_failures_are_sentences(tmp_path: Path) -> None:
    for text in ("", "[" * 100_000, "1" * 5000, "\ufeff[", "{]"):
        with pytest.raises(BadInput):
            parsed(text, "a")
    (tmp_path / "a.json").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="not UTF-8"):
        read_json(tmp_path / "a.json", "file", "give another")


@pytest.mark.parametrize("name", ["\ud800", "a\x1b[31mb", "a\nb", "x" * 401])
def test_a_name_that_cannot_be_shown_or_written_is_refused(name: str) -> None:
    person = {"keypoints": {"right_knee": [1, 2, 1]}, "image_id": name}
    document = {"format": "poseterior-detections", "version": 1, "people": [person]}
    flat = {"1.jpg": {"people": [{"pose_keypoints_2d": [1.0] * 54}]}}
    for content in (document, {name: flat["1.jpg"]}):
        with pytest.raises(BadInput, match="image_id"):
            read_content(Content(json.dumps(content).encode(), "a"))


def test_a_table_of_commas_is_refused_before_it_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("poseterior.probmodel.formats.common.MOST_CELLS", 1000)
    with pytest.raises(BadInput, match="more than 1,000 cells"):
        read_content(Content(b"scorer," + b"," * 2000, "a"))


# Pickles.


def encoded(times: int, size: int) -> bytes:
    """A pickle that turns one text into bytes again and again."""
    text = b"X" + struct.pack("<I", size) + b"a" * size + b"q\x00"
    latin = b"X\x06\x00\x00\x00latin1q\x01"
    again = b"c_codecs\nencode\nh\x00h\x01\x86R"
    return b"\x80\x02" + text + latin + b"]" + (again + b"a") * times + b"."


@pytest.mark.parametrize(
    "data",
    [encoded(6000, 1_000_000), b"\x80\x02" + b"]" * 200_000 + b".", b"(" * 200_000],
    ids=["bytes", "lists", "marks"],
)
def test_a_pickle_does_not_grow(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pickles, "MOST_STEPS", 100_000)
    with pytest.raises(BadInput):
        follow(data, "a")
    assert taken(lambda: follow(data, "a")) < 40_000_000


def test_bytes_of_protocol_2_are_read_still() -> None:
    value = [b"\xff" * 1000, b"\x00" * 1000, np.arange(1000.0)]
    found = follow(pickle.dumps(value, protocol=2), "a")
    assert found[:2] == value[:2]
    np.testing.assert_array_equal(found[2], value[2])


def test_arrays_of_any_kind_are_read_as_they_were_written(tmp_path: Path) -> None:
    arrays = {
        "a": np.arange(6.0).reshape(2, 3).T,
        "empty": np.zeros((0, 3)),
        "text": np.array(["", "ä"]),
        "none": np.array(""),
        "one": np.array(3),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    found = read_tables(tmp_path / "a.npz", "file", "")
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(read_array(tmp_path / "a.npy", "file", ""), array)
    found["a"][0] = 7  # not read-only
