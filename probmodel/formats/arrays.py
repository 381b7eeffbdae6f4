"""Arrays in files: NumPy's .npy and .npz and HDF5, read as plain numbers and text, never as pickled
objects.

`arrays(content)` is the one way in; sizes are checked before anything is read, since a small
damaged file can claim any."""

import io
import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from probmodel.detections import LARGEST_NUMBER
from probmodel.failures import BadInput
from probmodel.formats.common import ARRAY_MAGIC, Content, shown

LARGEST_ARRAY = 4_000_000_000
"""Bytes; no array, unpacked, may be larger."""
LONGEST_NAME = 200
MOST_RATIO = 1100
"""An array of numbers does not pack better than this (deflate's own limit is 1032); one that claims
to is damaged."""
_NPY, _ZIP, _HDF5 = ARRAY_MAGIC


def is_numpy(content: Content) -> bool:
    """A .npy or a .npz."""
    return content.data.startswith((_NPY, _ZIP))


def is_hdf5(content: Content) -> bool:
    """An HDF5 file."""
    return content.data.startswith(_HDF5)


def names(content: Content) -> list[str]:
    """The names of the arrays of a .npz (without .npy) or HDF5 file (paths); of a .npy one empty
    name.

    Empty for other files, and for damaged ones, which `arrays` refuses.
    """
    try:
        if content.data.startswith(_NPY):
            return [""]
        return (
            list(_members(content))
            if is_numpy(content)
            else _datasets(content)
            if is_hdf5(content)
            else []
        )
    except BadInput:
        return []


def arrays(content: Content, wanted: list[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays by name, all or those of `wanted` that are there.

    Raises `BadInput` where the file is damaged, or an array is of objects, which only unpickling
    could read."""
    if content.data.startswith(_NPY):
        return {"": _npy(io.BytesIO(content.data), len(content.data), content.source)}
    if is_hdf5(content):
        return _hdf5(content, wanted)
    members = _members(content)
    chosen = [name for name in members if wanted is None or name in wanted]
    return {name: _member(content, members[name], f"{name} of {content.source}") for name in chosen}


def plain(array: np.ndarray, where: str) -> np.ndarray:
    """Numbers as float64, all finite or NaN and within ±`LARGEST_NUMBER`. Raises `BadInput`
    otherwise."""
    if array.dtype.kind not in "fiu":
        raise BadInput(f"{where} holds {array.dtype} where numbers are needed.")
    with np.errstate(
        all="ignore"
    ):  # of damaged bytes; what cannot be told is refused here, or is NaN
        values = np.asarray(array, dtype=np.float64)
    if (np.abs(values) > LARGEST_NUMBER).any():  # false for NaN
        raise BadInput(
            f"{where} holds a number beyond ±{LARGEST_NUMBER:g}; give finite pixels and scores."
        )
    return values


def first_text(array: np.ndarray) -> str:
    """The first entry of an array of texts; empty where it has none."""
    first = next(iter(array.ravel()[:1].tolist()), "")
    return first.decode("utf-8", errors="replace") if isinstance(first, bytes) else str(first)


def _members(content: Content) -> dict[str, zipfile.ZipInfo]:
    with (
        _damage(content.source, "NumPy archive"),
        zipfile.ZipFile(io.BytesIO(content.data)) as archive,
    ):
        infos = [info for info in archive.infolist() if not info.is_dir()]
    return {_printable(info.filename.removesuffix(".npy"), content.source): info for info in infos}


def _printable(name: str | bytes, source: str) -> str:
    """A name that may stand in a message. Raises `BadInput` where it cannot."""
    if not isinstance(name, str) or not name.isprintable() or len(name) > LONGEST_NAME:
        raise BadInput(f"{source} has an array named {shown(name)}; name it in plain letters.")
    return name


def _member(content: Content, info: zipfile.ZipInfo, where: str) -> np.ndarray:
    if info.file_size > min(LARGEST_ARRAY, MOST_RATIO * max(info.compress_size, 1)):
        raise BadInput(
            f"{where} claims {info.file_size} bytes, more than can be; check that the file is"
            " complete."
        )
    with _damage(where, "NumPy array"), zipfile.ZipFile(io.BytesIO(content.data)) as archive:
        data = archive.read(info)
    return _npy(io.BytesIO(data), len(data), where)


def _npy(file: io.BytesIO, size: int, where: str) -> np.ndarray:
    with _damage(where, "NumPy array"):
        version = np.lib.format.read_magic(file)
        header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = header(file)
        if not dtype.hasobject and math.prod(shape) * dtype.itemsize > size:
            raise BadInput(f"{where} is cut short: its header speaks of an array of shape {shape}.")
        if dtype.hasobject:
            raise BadInput(
                f"{where} holds pickled Python objects, which could run any code and are not read;"
                " save it as plain arrays, one for each name."
            )
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


@contextmanager
def _damage(where: str, kind: str) -> Iterator[None]:
    try:
        yield
    except BadInput:
        raise
    # Damaged bytes meet zipfile, zlib and NumPy with errors of many kinds.
    except Exception as error:
        raise BadInput(
            f"{where} is no {kind} that can be read ({type(error).__name__}); check the file."
        ) from None


def _datasets(content: Content) -> list[str]:
    found: list[str] = []
    with _opened(content) as file:
        file.visititems(lambda name, item: found.append(name) if hasattr(item, "dtype") else None)
    return [_printable(name, content.source) for name in found]


def _hdf5(content: Content, wanted: list[str] | None) -> dict[str, np.ndarray]:
    chosen = [name for name in _datasets(content) if wanted is None or name in wanted]
    with _opened(content) as file:
        return {
            name: _dataset(file[name], f"{name} of {content.source}", len(content.data))
            for name in chosen
        }


def _dataset(item: Any, where: str, file_size: int) -> np.ndarray:
    """An HDF5 dataset whose size is credible. Raises `BadInput` otherwise, or where it is of no
    fixed size."""
    if item.dtype.kind not in "fiuSVb" or item.dtype.hasobject:
        raise BadInput(
            f"{where} holds {item.dtype}, not plain numbers; save it as an array of numbers."
        )
    if item.size * item.dtype.itemsize > min(LARGEST_ARRAY, MOST_RATIO * file_size):
        raise BadInput(
            f"{where} claims the shape {item.shape}, more than the file can hold; check that it is"
            " complete."
        )
    if item.external or item.is_virtual:
        raise BadInput(f"{where} lies in another file; copy it into this one.")
    return np.asarray(item[()])


@contextmanager
def _opened(content: Content) -> Iterator[Any]:
    import h5py

    with _damage(content.source, "HDF5 file"), h5py.File(io.BytesIO(content.data), "r") as file:
        yield file


def attributes(content: Content) -> Mapping[str, Mapping[str, Any]]:
    """The attributes of an HDF5 file's groups and datasets that are plain bytes or text, by path
    and name."""
    found: dict[str, dict[str, Any]] = {}
    with _opened(content) as file:

        def visit(name: str, item: Any) -> None:
            found[name] = {
                key: value for key in item.attrs if (value := _attribute(item, key)) is not None
            }

        file.visititems(visit)
    return found


def _attribute(item: Any, key: str) -> str | None:
    try:
        value = item.attrs[key]
    except (OSError, TypeError, ValueError):  # kinds that h5py does not read
        return None
    return (
        value.decode("utf-8", errors="replace")
        if isinstance(value, bytes)
        else value
        if isinstance(value, str)
        else None
    )
