"""What a pickle of arrays, texts, lists and dictionaries holds, found out without unpickling it.

VideoPose3D's files are object arrays: pickles, whose opcodes can call anything. Here `pickletools`
splits the bytes into opcodes, and a small machine follows those that build plain data; of names it
knows the four with which NumPy spells an array, and nothing is ever imported or called for the
file. Whatever else a pickle asks for is refused."""

import math
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from poseterior.probmodel.arrays import LONGEST_NAME, ArrayFile
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import opened

MOST_STEPS = 1_000_000
"""Opcodes of a pickle; VideoPose3D's files have some ten thousand. Each may make an object."""
_MARK = object()


class _Array:
    """An array whose shape, type and bytes are still to come."""

    value: np.ndarray | None = None


class _Type:
    """A dtype whose byte order is still to come."""

    def __init__(self, code: str) -> None:
        self.value = np.dtype(code)


def read_object(path: Path, name: str) -> Any:
    """The object that the array `name` of an .npz holds: dictionaries, lists and tuples of texts,
    numbers and arrays.

    Raises `BadInput` where there is no such array, it is damaged, or it holds anything else.
    """
    what, advice = f"file of {name}", "check that it is complete, as VideoPose3D wrote it"
    with opened(path, what, advice) as file:
        data = ArrayFile(file, str(path), what, advice).pickled(name)
    if data is None:
        raise BadInput(
            f"{name} of {path} is an array of numbers, not the dictionary that VideoPose3D writes"
        )
    return follow(data, f"{name} of {path}")


def follow(data: bytes, where: str) -> Any:
    """Plain data out of a pickle. Raises `BadInput` where it holds anything else, or is damaged."""
    machine = _Machine(len(data))
    try:
        for number, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if number > MOST_STEPS:
                raise BadInput(
                    f"{where} has more than {MOST_STEPS:,} parts; keep arrays as arrays, not lists"
                )
            if opcode.name == "STOP":
                return _settled(machine.stack[-1], {})
            step = _STEPS.get(opcode.name)
            if step is None:
                raise BadInput(
                    f"{where} uses {opcode.name}, which plain data does not need, and is not read"
                )
            step(machine, argument)
    except BadInput as error:
        raise BadInput(f"{where}: {error}" if where not in str(error) else str(error)) from None
    except (
        Exception
    ) as error:  # a damaged pickle asks the machine for what is not on its stack, in many ways
        raise BadInput(
            f"{where} is damaged ({type(error).__name__}); check that the file is complete"
        ) from None
    raise BadInput(f"{where} is cut short; check that the file is complete")


def _settled(value: Any, known: dict[int, tuple[Any, Any]]) -> Any:
    """What was built, with finished arrays in place of `_Array`. What is met twice (`known`: by
    identity, itself and its outcome) is one object: nested repetitions, which a pickle of a few
    bytes can ask for, cost nothing."""
    if not isinstance(value, (_Array, dict, list, tuple)):
        return value
    if id(value) not in known:
        known[id(value)] = value, _settle(value, known)
    return known[id(value)][1]


def _settle(value: Any, known: dict[int, tuple[Any, Any]]) -> Any:
    if isinstance(value, dict):
        return {key: _settled(item, known) for key, item in value.items()}
    if isinstance(value, _Array):
        if value.value is None or not value.value.dtype.hasobject:
            return value.value
        return _settled(value.value.tolist(), known)
    return [_settled(item, known) for item in value]


class _Machine:
    """The stack and the memory of a pickle of `size` bytes."""

    def __init__(self, size: int) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}
        self.budget = size
        """Bytes of texts that may still be turned into bytes: each stands in the file itself."""

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def since_mark(self) -> list[Any]:
        """What lies above the last mark, which goes with it."""
        place = next(i for i in reversed(range(len(self.stack))) if self.stack[i] is _MARK)
        above = self.stack[place + 1 :]
        del self.stack[place:]
        return above

    def take(self, number: int) -> list[Any]:
        """The upper `number` of the stack."""
        if number > len(self.stack):
            raise IndexError
        above = self.stack[len(self.stack) - number :]
        del self.stack[len(self.stack) - number :]
        return above

    def name(self, module: str, name: str) -> None:
        known = _KNOWN.get((module.replace("numpy._core", "numpy.core"), name))
        if known is None:
            raise BadInput(
                f"a pickle asks for {shown(f'{module}.{name}')}, which plain data does not need; it"
                " is not read"
            )
        self.push(known)

    def extend(self, items: list[Any]) -> None:
        _expected(self.stack[-1], list).extend(items)

    def update(self, items: list[Any]) -> None:
        target = _expected(self.stack[-1], dict)
        for key in items[::2]:
            if not _is_label(key):
                raise BadInput(
                    f"a name in a dictionary is {shown(key)}, not a short printable text"
                )
        target.update(zip(items[::2], items[1::2], strict=True))

    def reduce(self) -> None:
        maker, arguments = self.take(2)
        made = _MAKERS[maker](*_expected(arguments, tuple))
        self.budget -= len(made) if isinstance(made, bytes) else 0
        if self.budget < 0:
            raise BadInput("a pickle builds more bytes than it has; it is not read")
        self.push(made)

    def build(self) -> None:
        target, state = self.take(2)
        if isinstance(target, _Type):
            target.value = target.value.newbyteorder(_expected(state[1], str))
        else:
            _fill(_expected(target, _Array), state)
        self.push(target)


def _is_label(key: Any) -> bool:
    return isinstance(key, str) and key.isprintable() and 0 < len(key) <= LONGEST_NAME


def _expected(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise TypeError
    return value


def _fill(array: _Array, state: tuple) -> None:
    """What an array's state says: (version, shape, dtype, Fortran order, bytes or list of
    objects)."""
    _, shape, kind, fortran, content = state
    dtype = _expected(kind, _Type).value
    if dtype.hasobject:
        array.value = np.empty(len(content), object)
        array.value[:] = _expected(content, list)
        array.value = array.value.reshape(shape)
    else:
        if math.prod(shape) * dtype.itemsize != len(content):
            raise ValueError
        array.value = np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C")


def _plain_type(code: str, *_: object) -> _Type:
    if code[:1] not in "fiubUSO":
        raise BadInput(
            f"a pickle holds an array of {shown(code)}; arrays must hold numbers or texts"
        )
    return _Type(code)


_KNOWN = {
    ("numpy.core.multiarray", "_reconstruct"): "reconstruct",
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    ("_codecs", "encode"): "encode",
}
_MAKERS: dict[str, Callable[..., Any]] = {
    "reconstruct": lambda *_: _Array(),
    "dtype": _plain_type,
    "encode": lambda text, coding: (
        _expected(text, str).encode("latin-1") if coding == "latin1" else None
    ),
}
"""What the known names stand for; bytes are a text's latin-1 in pickles of protocol 2."""


def _tuple(number: int) -> Callable[[_Machine, Any], None]:
    return lambda machine, _: machine.push(tuple(machine.take(number)))


def _memoize(machine: _Machine, place: int | None) -> None:
    machine.memory[len(machine.memory) if place is None else place] = machine.stack[-1]


_VALUES = (
    "BININT",
    "BININT1",
    "BININT2",
    "INT",
    "LONG",
    "LONG1",
    "LONG4",
    "BINFLOAT",
    "BINUNICODE",
    "SHORT_BINUNICODE",
    "BINUNICODE8",
    "BINBYTES",
    "SHORT_BINBYTES",
    "BINBYTES8",
    "BINSTRING",
    "SHORT_BINSTRING",
)
_STEPS: dict[str, Callable[[_Machine, Any], None]] = {
    **{name: lambda machine, value: machine.push(value) for name in _VALUES},
    **dict.fromkeys(("PROTO", "FRAME"), lambda machine, _: None),
    **dict.fromkeys(("BINPUT", "LONG_BINPUT", "PUT", "MEMOIZE"), _memoize),
    **{
        name: lambda machine, place: machine.push(machine.memory[place])
        for name in ("BINGET", "LONG_BINGET", "GET")
    },
    "NONE": lambda machine, _: machine.push(None),
    "NEWTRUE": lambda machine, _: machine.push(True),
    "NEWFALSE": lambda machine, _: machine.push(False),
    "MARK": lambda machine, _: machine.push(_MARK),
    "EMPTY_TUPLE": _tuple(0),
    "TUPLE1": _tuple(1),
    "TUPLE2": _tuple(2),
    "TUPLE3": _tuple(3),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.since_mark())),
    "EMPTY_LIST": lambda machine, _: machine.push([]),
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "LIST": lambda machine, _: machine.push(machine.since_mark()),
    "APPEND": lambda machine, _: machine.extend(machine.take(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.since_mark()),
    "SETITEM": lambda machine, _: machine.update(machine.take(2)),
    "SETITEMS": lambda machine, _: machine.update(machine.since_mark()),
    "GLOBAL": lambda machine, both: machine.name(*both.split(" ")),
    "STACK_GLOBAL": lambda machine, _: machine.name(*machine.take(2)),
    "REDUCE": lambda machine, _: machine.reduce(),
    "BUILD": lambda machine, _: machine.build(),
}
