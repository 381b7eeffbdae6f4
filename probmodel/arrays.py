"""Arrays in files: NumPy's .npy and .npz, HDF5 (netCDF4 too) and MATLAB's .mat, read as plain
numbers and text: nothing is unpickled, no other file is followed, and nothing is unpacked beyond a
budget.

The usual ways in: `read_tables(path, what, advice)` for an .npz, `read_array` for an .npy,
`read_netcdf` and `read_mat`; `ArrayFile` for whoever must look before reading. A file is known by
its content, never by its name."""

import io
import math
import os
import re
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from poseterior.probmodel import matlab
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import opened, read_bytes, replacing

NPY, ZIP, HDF5 = b"\x93NUMPY", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n"
_EMPTY_ZIP = b"PK\x05\x06"
MAGIC = {NPY: NPY, ZIP: ZIP, _EMPTY_ZIP: ZIP, HDF5: HDF5}
"""How .npy, .npz and HDF5 begin, and what each beginning stands for."""
LARGEST = 4_000_000_000
"""Bytes; the arrays that are read from one file may not be larger, all together."""
FREE, BEST_RATIO = 256_000_000, 50
"""Arrays of more than `FREE` bytes must not be more than `BEST_RATIO` times larger than their file:
numbers of poses do not pack so well, and what claims to is a bomb, or damaged."""
MOST_NUMBERS = 150_000_000
"""Numbers that may be brought to double precision at once."""
LONGEST_NAME = 200
MOST_TEXTS = 2000
"""Names of points or tracks in a file; no skeleton has more."""
_CHUNK = 1 << 20
_DEFLATE, _SUMS = 1, 3
_FILTERS = {_DEFLATE, 2, _SUMS, 32000}
"""The filters of HDF5 that are read: deflate, shuffle, Fletcher's sums, and h5py's own LZF."""
_TREE, _HEAP = b"TREE", b"GCOL\1"
"""What a node of a tree and a heap of texts begin with in an HDF5 file."""
_HEAPS = 16
"""Heaps lie beside each other; words in the data that look like heaps may take so many times the
file."""


@dataclass(frozen=True)
class ArrayFile:
    """An open file that may hold arrays; `source` names it in messages, `what` and `advice` say
    what it should be and what to do where it is not."""

    file: BinaryIO
    source: str
    what: str = "file of arrays"
    advice: str = "check that the file is complete."

    @cached_property
    def magic(self) -> bytes:
        """The one of `MAGIC` with which it begins; empty where it is another kind of file."""
        self.file.seek(0)
        head = self.file.read(8)
        return next((kind for start, kind in MAGIC.items() if head.startswith(start)), b"")

    @cached_property
    def size(self) -> int:
        """Bytes of the file."""
        return self.file.seek(0, io.SEEK_END)

    def require(self, magic: bytes) -> None:
        """Raises `BadInput` unless the file begins so."""
        if self.magic != magic:
            raise BadInput(f"{self.source} is no {self.what}, or is truncated; {self.advice}")

    def names(self) -> list[str]:
        """The names of the arrays of an .npz (without .npy) or HDF5 file (paths); of an .npy one
        empty name. Empty for other files, and for damaged ones, which `read` refuses."""
        try:
            if self.magic == ZIP:
                return list(self._members())
            if self.magic == HDF5:
                return self._datasets()
        except BadInput:
            return []
        return [""] if self.magic == NPY else []

    def read(self, wanted: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Arrays by name, all or those of `wanted` that are there; an .npy's is named "".

        Raises `BadInput` where the file is damaged or is none of arrays, where they are larger than
        can be, or one is of objects, which only unpickling could read."""
        if self.magic == NPY:
            size = self.size
            self.file.seek(0)
            return {"": self._npy(self.file, size, self.source)}
        if self.magic == HDF5:
            return self._hdf5(wanted)
        members = self._members()
        chosen = {name: members[name] for name in members if wanted is None or name in wanted}
        self._require_budget(sum(info.file_size for info in chosen.values()), "its arrays")
        return {name: self._member(name, info) for name, info in chosen.items()}

    def require_credible(self) -> None:
        """Raises `BadInput` where something in an HDF5 file lies elsewhere or claims more than the
        file can hold: for one that another library is going to read."""
        self.require(HDF5)
        chosen = self._datasets()
        with self._hdf5_file() as file:
            self._require_credible({name: file[name] for name in chosen})

    def shape(self) -> tuple[int, ...]:
        """The shape that an .npy's header declares; empty for other files, and for damaged ones."""
        if self.magic != NPY:
            return ()
        self.file.seek(0)
        try:
            with self._damage(self.source):
                return _header(self.file)[0]
        except BadInput:
            return ()

    def texts(self, name: str) -> list[str]:
        """The texts of an HDF5 dataset, of fixed or of any length. Raises `BadInput` where it holds
        none, or too many."""
        import h5py

        with self._hdf5_file() as file:
            item = file[name]
            of_texts = h5py.check_string_dtype(item.dtype) is not None and item.ndim == 1
            if not of_texts or item.external or item.is_virtual:
                raise BadInput(f"{name} of {self.source} is no list of texts; {self.advice}")
            if item.size > MOST_TEXTS:
                raise BadInput(
                    f"{name} of {self.source} has {item.size:,} texts, more than {MOST_TEXTS:,};"
                    f" {self.advice}"
                )
            _require_honest(item, f"{name} of {self.source}")
            return [self._printable(first_text(np.array(item[row]))) for row in range(item.size)]

    def pickled(self, name: str) -> bytes | None:
        """The pickle of an .npz's array of one object, as bytes; None where the array is there but
        is not of that kind. Raises `BadInput` where there is no such array, or it is damaged."""
        info = self._members().get(name)
        if info is None:
            raise BadInput(f"{self.source} has no array {name}; {self.advice}")
        self._require_budget(info.file_size, name)
        with self._unzipped(name, info) as member:
            shape, _, dtype = _header(member)
            if not dtype.hasobject or shape != ():
                return None
            return member.read(info.file_size)

    def attributes(self) -> Mapping[str, Mapping[str, str]]:
        """The attributes of an HDF5 file's groups and datasets that are one text, by path and
        name."""
        found: dict[str, dict[str, str]] = {}
        with self._hdf5_file() as file:

            def visit(name: str, item: Any) -> None:
                values = {key: _attribute(item, key) for key in item.attrs}
                found[name] = {key: value for key, value in values.items() if value is not None}

            file.visititems(visit)
        return found

    def own_attributes(self) -> dict[str, str | int | float]:
        """The attributes of an HDF5 file itself that are one text or one number, by name."""
        with self._hdf5_file() as file:
            values = {key: _single(file, key) for key in file.attrs}
        return {key: value for key, value in values.items() if value is not None}

    @contextmanager
    def _damage(self, where: str) -> Iterator[None]:
        """Turns what damaged bytes make zipfile, zlib, NumPy, h5py and SciPy raise into
        `BadInput`: errors of many unrelated kinds, and warnings of headers that NumPy mends."""
        try:
            yield
        except BadInput:
            raise
        except Exception as error:
            raise BadInput(
                f"{where} is no {self.what}, or is truncated ({type(error).__name__});"
                f" {self.advice}"
            ) from None

    def _require_budget(self, size: int, name: str) -> None:
        if size > min(LARGEST, max(FREE, BEST_RATIO * self.size)):
            raise BadInput(
                f"{name} of {self.source} would take {size:,} bytes, more than can be in a file of"
                f" {self.size:,}; {self.advice}"
            )

    def strangers(self) -> list[str]:
        """What is in a ZIP archive of which nothing is an array; empty for all others."""
        if self.magic != ZIP:
            return []
        try:
            names = [info.filename for info in self._infos()]
        except BadInput:
            return []
        return [] if any(name.endswith(".npy") for name in names) else names

    def _infos(self) -> list[zipfile.ZipInfo]:
        with self._damage(self.source):
            self.require(ZIP)
            with zipfile.ZipFile(self.file) as archive:
                return [info for info in archive.infolist() if not info.is_dir()]

    def _members(self) -> dict[str, zipfile.ZipInfo]:
        return {self._printable(info.filename.removesuffix(".npy")): info for info in self._infos()}

    def _printable(self, name: str | bytes) -> str:
        """A name that may stand in a message. Raises `BadInput` where it cannot."""
        if not isinstance(name, str) or not name.isprintable() or len(name) > LONGEST_NAME:
            raise BadInput(f"{self.source} has an array named {shown(name)}; name it in letters.")
        return name

    @contextmanager
    def _unzipped(self, name: str, info: zipfile.ZipInfo) -> Iterator[BinaryIO]:
        where = f"{name} of {self.source}"
        if info.flag_bits & 1:
            raise BadInput(f"{where} is encrypted; save it without a password.")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise BadInput(
                f"{where} is packed in a way that NumPy does not write; save it with numpy.savez."
            )
        with (
            self._damage(where),
            zipfile.ZipFile(self.file) as archive,
            archive.open(info) as member,
        ):
            yield member  # type: ignore[misc]

    def _member(self, name: str, info: zipfile.ZipInfo) -> np.ndarray:
        with self._unzipped(name, info) as member:
            return self._npy(member, info.file_size, f"{name} of {self.source}")

    def _npy(self, file: BinaryIO, size: int, where: str) -> np.ndarray:
        """The array of an .npy of `size` bytes, headers included."""
        with self._damage(where):
            shape, fortran, dtype = _header(file)
            if dtype.kind == "V":
                raise BadInput(f"{where} is a table of several columns; save each as an array.")
            if dtype.hasobject:
                raise BadInput(
                    f"{where} holds pickled Python objects, which could run any code and are not"
                    " read; save it as plain arrays, one for each name."
                )
            count = math.prod(shape)
            needed = count * dtype.itemsize
            if min(shape, default=0) < 0 or max(count, needed) > size:
                raise BadInput(
                    f"{where} is cut short: its header speaks of an array of shape {shown(shape)};"
                    f" {self.advice}"
                )
            self._require_budget(_weight(dtype, count), where)
            data = bytearray()
            while len(data) < needed and (chunk := file.read(min(_CHUNK, needed - len(data)))):
                data += chunk
            if file.read(1):  # a zip's sums, too, are looked at where its end is reached
                raise ValueError("more than one array")
            flat = np.frombuffer(data, dtype) if needed else np.zeros(count, dtype)
            if dtype.kind == "U" and flat.view(dtype.str[0] + "u4").max(initial=0) > sys.maxunicode:
                raise ValueError
            return flat.reshape(shape, order="F" if fortran else "C")

    @contextmanager
    def _hdf5_file(self) -> Iterator[Any]:
        import h5py

        with self._damage(self.source):
            _require_ends(self.file)
            self.file.seek(0)
            with h5py.File(self.file, "r") as file:
                yield file

    def _datasets(self) -> list[str]:
        """The datasets of the file itself: soft and external links are not followed."""
        found: list[str] = []

        def visit(name: str, item: Any) -> None:
            if hasattr(item, "dtype"):
                found.append(name)

        with self._hdf5_file() as file:
            file.visititems(visit)
        return [self._printable(name) for name in found]

    def _hdf5(self, wanted: Sequence[str] | None) -> dict[str, np.ndarray]:
        chosen = [name for name in self._datasets() if wanted is None or name in wanted]
        with self._hdf5_file() as file:
            items = {name: file[name] for name in chosen}
            for name, item in items.items():
                _require_plain(item, f"{name} of {self.source}")
            self._require_credible(items)
            return {name: np.asarray(item[()]) for name, item in items.items()}

    def _require_credible(self, items: dict[str, Any]) -> None:
        """Raises `BadInput` where a dataset lies elsewhere or claims more than the file can
        hold."""
        for name, item in items.items():
            _require_own(item, f"{name} of {self.source}")
        weights = [
            _weight(item.dtype, max(item.size, math.prod(item.chunks or ())))
            for item in items.values()
        ]
        self._require_budget(sum(weights), "its arrays")
        for name, item in items.items():
            _require_honest(item, f"{name} of {self.source}")


def _header(file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether in Fortran's order, and type of an .npy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that Python 2 wrote
        if np.lib.format.read_magic(file) == (1, 0):
            return np.lib.format.read_array_header_1_0(file)
        return np.lib.format.read_array_header_2_0(file)


def _require_ends(file: BinaryIO) -> None:
    """Raises `ValueError` where the library would walk through an HDF5 file for ever."""
    file.seek(0)
    head = file.read(16)
    widths = head[13:15] if head[8] < 2 else head[9:11]
    addresses, lengths = widths[0], widths[1]  # the bytes of each
    places = _found(file, (_TREE, _HEAP))
    _require_trees_end(file, places[_TREE], addresses)
    _require_heaps_end(file, places[_HEAP], lengths)


def _require_trees_end(file: BinaryIO, places: Sequence[int], width: int) -> None:
    """Raises `ValueError` where a node of a tree comes after itself: the library goes from each
    node to the next."""
    after: dict[int, int] = {}
    for place in places:
        file.seek(place + 8 + width)
        after[place] = int.from_bytes(file.read(width), "little")
    ends: set[int] = set()
    for start in after:
        chain: dict[int, None] = {}
        place = start
        while place in after and place not in ends:
            if place in chain:
                raise ValueError("a tree without an end")
            chain[place] = None
            place = after[place]
        ends.update(chain)


def _require_heaps_end(file: BinaryIO, places: Sequence[int], width: int) -> None:
    """Raises `ValueError` where an object in a heap of texts leads no step forward: the library
    goes by the sizes of the objects. Number 0 is free space, and its size is that of the step."""
    end = file.seek(0, 2)
    left = _HEAPS * end
    for place in places:
        file.seek(place + 8)
        size = int.from_bytes(file.read(width), "little")
        if place + size > end:  # no heap, but a word in the data
            continue
        left -= size
        if left < 0:
            raise ValueError("heaps that lie within each other")
        file.seek(place)
        _walk(file.read(size), width)


def _walk(heap: bytes, width: int) -> None:
    head = _aligned(8 + width)  # of the heap, and of each object
    at = head
    while at + head <= len(heap):
        size = int.from_bytes(heap[at + 8 : at + 8 + width], "little")
        step = head + _aligned(size) if any(heap[at : at + 2]) else size
        step %= 2 ** (8 * width)  # as the library adds
        if not 0 < step < 2 ** (8 * width - 1):
            raise ValueError("a heap without an end")
        at += step


def _aligned(size: int) -> int:
    return -(-size // 8) * 8


def _found(file: BinaryIO, words: Sequence[bytes]) -> dict[bytes, list[int]]:
    """Where words stand in a file, in their order, by one reading."""
    places: dict[bytes, list[int]] = {word: [] for word in words}
    pattern, start, rest = re.compile(b"|".join(map(re.escape, words))), 0, b""
    file.seek(0)
    while chunk := file.read(_CHUNK):
        text = rest + chunk
        for match in pattern.finditer(text):
            if match.end() > len(rest):  # else it was found before
                places[match[0]].append(start + match.start())
        rest = text[1 - max(map(len, words)) :]
        start += len(text) - len(rest)
    return places


def _weight(dtype: np.dtype, count: int) -> int:
    """Bytes of so many entries; small whole numbers count as the doubles that they will become."""
    return count * (max(8, dtype.itemsize) if dtype.kind in "iub" else dtype.itemsize)


def _require_plain(item: Any, where: str) -> None:
    """Raises `BadInput` unless an HDF5 dataset is one of plain entries."""
    if item.dtype.kind not in "fiuSVb" or item.dtype.hasobject:
        raise BadInput(
            f"{where} holds {shown(str(item.dtype))}, not plain numbers; save it as an array of"
            " numbers."
        )


def _require_own(item: Any, where: str) -> None:
    """Raises `BadInput` unless an HDF5 dataset lies in this very file."""
    if item.external or item.is_virtual:
        raise BadInput(f"{where} lies in another file; copy it into this one.")


def _require_honest(item: Any, where: str) -> None:
    """Raises `BadInput` where a chunk of an HDF5 dataset is packed in a way that is not known, or
    unpacks to more than it says: the library would unpack it whole."""
    creation = item.id.get_create_plist()
    codes = [creation.get_filter(place)[0] for place in range(creation.get_nfilters())]
    packing = [place for place, code in enumerate(codes) if code == _DEFLATE]
    if not set(codes) <= _FILTERS or any(set(codes[place + 1 :]) - {_SUMS} for place in packing):
        raise BadInput(f"{where} is packed in a way that is not read; save it with gzip, or plain.")
    if not packing:
        return
    most = math.prod(item.chunks) * item.dtype.itemsize + 64
    chunks: list[Any] = []
    item.id.chunk_iter(chunks.append)
    for chunk in chunks:
        if chunk.filter_mask & 1 << packing[0]:  # it did not pack well, and stands as it is
            continue
        unpacking = zlib.decompressobj()
        unpacking.decompress(item.id.read_direct_chunk(chunk.chunk_offset)[1], most)
        if not unpacking.eof and unpacking.unconsumed_tail:
            raise BadInput(f"{where} unpacks to more than it says; check that it is complete.")


def _attribute(item: Any, key: str) -> str | None:
    try:
        if item.attrs.get_id(key).shape:  # an array of texts, of any size
            return None
        value = item.attrs[key]
    except (OSError, TypeError, ValueError, KeyError, RuntimeError):  # what h5py does not read
        return None
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace")
    return value if isinstance(value, str) else None


def _single(item: Any, key: str) -> str | int | float | None:
    """An attribute that is a text or a number; netCDF writes a number as an array of one."""
    try:
        known = item.attrs.get_id(key)
        if known.shape in ((), (1,)) and known.dtype.kind in "fiu":
            return np.asarray(item.attrs[key]).ravel()[0].item()
    except (OSError, TypeError, ValueError, KeyError, RuntimeError):  # what h5py does not read
        return None
    return _attribute(item, key)


def doubles(array: np.ndarray) -> np.ndarray:
    """Numbers as float64, without a warning: what damaged bytes become, the caller looks at."""
    with np.errstate(all="ignore"):
        return array.astype(np.float64)


def possible(numbers: np.ndarray) -> bool:
    """Whether all are finite and so small that their squares keep their meaning."""
    return bool((np.abs(numbers) <= LARGEST_NUMBER).all())  # false for NaN too


def plain(array: np.ndarray, where: str) -> np.ndarray:
    """Numbers as float64, all finite or NaN and within ±`LARGEST_NUMBER`. Raises `BadInput`
    otherwise."""
    if array.dtype.kind not in "fiu":
        raise BadInput(f"{where} holds {shown(str(array.dtype))} where numbers are needed.")
    if array.size > MOST_NUMBERS:
        raise BadInput(f"{where} holds more than {MOST_NUMBERS:,} numbers; split it into parts.")
    values = doubles(array)
    with np.errstate(all="ignore"):
        highest = max(
            float(np.fmax.reduce(values, axis=None, initial=0.0)),
            -float(np.fmin.reduce(values, axis=None, initial=0.0)),
        )
    if highest > LARGEST_NUMBER:
        raise BadInput(
            f"{where} holds a number beyond ±{LARGEST_NUMBER:g}; give finite pixels and scores."
        )
    return values


def plain_numbers(array: ArrayLike, where: str) -> np.ndarray:
    """Numbers as float64, whatever they are. Raises `BadInput` where they are something else."""
    found = np.asarray(array)
    if found.dtype.kind not in "fiu":
        raise BadInput(f"{where} holds {shown(str(found.dtype))} where numbers are needed")
    return found.astype(float)


def first_text(array: np.ndarray) -> str:
    """The first entry of an array of texts; empty where it has none."""
    first = next(iter(array.ravel()[:1].tolist()), "")
    return first.decode("utf-8", errors="replace") if isinstance(first, bytes) else str(first)


def npz_names(path: str | os.PathLike, what: str, advice: str) -> set[str]:
    """What the arrays of an .npz are called; nothing where the file is no such one."""
    try:
        with opened(path, what, advice) as file:
            found = ArrayFile(file, str(path))
            return set(found.names()) if found.magic == ZIP else set()
    except BadInput:
        return set()


def read_tables(
    path: str | os.PathLike, what: str, advice: str, needed: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """All arrays of an .npz.

    Parameters
    ----------
    path
        The file, whatever its name.
    what, advice
        What it should be, and what to do where it is not: both go into the sentence.
    needed
        Arrays that it must have.

    Raises
    ------
    BadInput
        Where there is no such file, it is not an .npz, is damaged, holds more than can be, or lacks
        an array.
    """
    with opened(path, what, advice) as file:
        found = ArrayFile(file, str(path), what, advice)
        if found.magic == NPY:
            raise BadInput(f"{path} is a single array, not an .npz of named ones; {advice}")
        found.require(ZIP)
        arrays = found.read()
    if missing := [name for name in needed if name not in arrays]:
        raise BadInput(f"{path} is no {what}, it lacks {', '.join(missing)}; {advice}")
    return arrays


def read_array(path: str | os.PathLike, what: str, advice: str) -> np.ndarray:
    """The array of an .npy. Raises `BadInput` as `read_tables`."""
    with opened(path, what, advice) as file:
        found = ArrayFile(file, str(path), what, advice)
        if found.magic == ZIP:
            raise BadInput(f"{path} is an archive of arrays; name it .npz, or {advice}")
        found.require(NPY)
        return found.read()[""]


def read_netcdf(
    path: str | os.PathLike, wanted: Sequence[str] | None, what: str, advice: str
) -> dict[str, np.ndarray]:
    """Those of the `wanted` variables (`group/variable`; None for all) that a netCDF4 file has.
    Raises `BadInput` as `read_tables`, and where one lies in another file."""
    with opened(path, what, advice) as file:
        found = ArrayFile(file, str(path), what, advice)
        found.require(HDF5)
        return found.read(wanted)


def netcdf_attributes(
    path: str | os.PathLike, what: str, advice: str
) -> dict[str, str | int | float]:
    """The attributes of a netCDF4 file itself that are one text or one number, by name. Raises
    `BadInput` as `read_netcdf`."""
    with opened(path, what, advice) as file:
        found = ArrayFile(file, str(path), what, advice)
        found.require(HDF5)
        return found.own_attributes()


def read_mat(
    path: str | os.PathLike, wanted: Sequence[str], what: str, advice: str
) -> dict[str, np.ndarray]:
    """Those of the `wanted` variables that a MATLAB file (version 5 to 7.2) has. Raises `BadInput`
    as `read_tables`."""
    data = read_bytes(path, what, advice, largest=matlab.LARGEST_UNPACKED)
    try:
        return matlab.variables(data, wanted)
    except Exception as error:  # damaged bytes, in many ways
        reason = str(error) or type(error).__name__
        raise BadInput(f"{path} is not a {what}, or is truncated ({reason}); {advice}") from None


def write_tables(path: str | os.PathLike, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes an .npz, whole or not at all. Raises `BadInput` where it cannot be written."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def compact(values: np.ndarray) -> np.ndarray:
    """float32 where that loses nothing, float64 otherwise."""
    short = values.astype(np.float32)
    exact = np.array_equal(short.astype(np.float64), values)
    return short if exact else np.asarray(values, np.float64)


def single(values: ArrayLike) -> np.ndarray:
    """Values as float64, rounded to what float32 can hold, so that storing them loses nothing."""
    return np.asarray(values).astype(np.float32).astype(np.float64)
