"""MATLAB's files (.mat of version 5 to 7.2): arrays of real numbers, and cells of them.

Read here, not by SciPy, whose reader of damaged files can end the whole process. Everything else
that such a file can hold (text, structures, objects, sparse and complex arrays) is passed over.
The usual way in: `arrays.read_mat(path, …)`. Format: "MAT-File Format", The MathWorks."""

import math
import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LARGEST_UNPACKED = 150_000_000
"""Bytes, unpacked; the published model has 58 million in a file of 1.6."""
_HEADER = 128
_MATRIX, _COMPRESSED, _CELL = 14, 15, 1
_NUMBERS = range(6, 16)
"""Classes of arrays of numbers, from double to uint64."""
_COMPLEX = 0x800
_STORED = dict(enumerate(["i1", "u1", "i2", "u2", "i4", "u4", "f4"], start=1))
_STORED |= {9: "f8", 12: "i8", 13: "u8"}
"""How numbers are stored, by the type of an element."""


class _Element(NamedTuple):
    """One element: its type, its content, and where the next begins."""

    kind: int
    content: memoryview
    end: int


def variables(data: bytes, wanted: Sequence[str]) -> dict[str, np.ndarray]:
    """Those of the `wanted` variables that are there: numbers as they are stored, cells as arrays
    of objects, None for whatever is neither. Raises `ValueError` where the file is damaged, is of
    another version, or unpacks to more than `LARGEST_UNPACKED`."""
    order = {b"IM": "<", b"MI": ">"}.get(data[_HEADER - 2 : _HEADER])
    if order is None:
        raise ValueError("it does not begin as a MATLAB file of version 5")
    found: dict[str, np.ndarray] = {}
    place, left, whole = _HEADER, LARGEST_UNPACKED, memoryview(data)
    while place < len(data):
        element = _element(whole, place, order, padded=False)
        place = element.end
        if element.kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(element.content, left + 1)
            left -= len(unpacked)
            if left < 0:
                raise ValueError(f"it unpacks to more than {LARGEST_UNPACKED:,} bytes")
            element = _element(memoryview(unpacked), 0, order)
        if element.kind == _MATRIX:
            name, value = _matrix(element.content, order, cells=True)
            if name in wanted:
                found[name] = value
    return found


def _element(data: memoryview, place: int, order: str, *, padded: bool = True) -> _Element:
    """The element at a place; but for those that stand alone in the file, they fill eight bytes."""
    if place + 8 > len(data):
        raise ValueError("it is cut short")
    kind, length = struct.unpack_from(f"{order}II", data, place)
    start = place + 8
    if kind >> 16:  # four bytes or fewer stand within the tag
        kind, length, start = kind & 0xFFFF, kind >> 16, place + 4
        if length > 4:
            raise ValueError("an element is longer than it can be")
    if start + length > len(data):
        raise ValueError("it is cut short")
    end = start + length
    return _Element(kind, data[start:end], place + -(-(end - place) // 8) * 8 if padded else end)


def _matrix(data: memoryview, order: str, *, cells: bool) -> tuple[str, np.ndarray]:
    """Name and value of an array; of cells, only where they may stand."""
    flags, sizes, name = _three(data, order)
    (bits,) = struct.unpack_from(f"{order}I", flags.content)
    shape = tuple(np.frombuffer(sizes.content, f"{order}i4").tolist())
    if min(shape, default=-1) < 0:
        raise ValueError("an array has no shape")
    label, kind = bytes(name.content).decode("latin-1"), bits & 0xFF
    if kind in _NUMBERS and not bits & _COMPLEX:
        stored = _element(data, name.end, order)
        code = _STORED.get(stored.kind)
        if code is None:
            raise ValueError("numbers are stored in a way that is not known")
        return label, np.frombuffer(stored.content, order + code).reshape(shape, order="F")
    if kind == _CELL and cells:
        return label, _cells(data[name.end :], shape, order)
    return label, np.array(None)


def _three(data: memoryview, order: str) -> tuple[_Element, _Element, _Element]:
    """Flags, shape and name, with which every array begins."""
    flags = _element(data, 0, order)
    sizes = _element(data, flags.end, order)
    return flags, sizes, _element(data, sizes.end, order)


def _cells(data: memoryview, shape: tuple[int, ...], order: str) -> np.ndarray:
    """An array of objects; each takes eight bytes at least."""
    count, place = math.prod(shape), 0
    if 8 * count > len(data):
        raise ValueError("it is cut short")
    values = np.empty(count, object)
    for number in range(count):
        element = _element(data, place, order)
        place = element.end
        if element.kind == _MATRIX and len(element.content):
            values[number] = _matrix(element.content, order, cells=False)[1]
    return values.reshape(shape, order="F")
