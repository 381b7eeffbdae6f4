"""The one resumable store: a run's results as a folder of numbered blocks.

`run.json` says what the run was asked for; `block-000000.nc` and so on, netCDF, hold what came out,
each written whole or not at all. Every group of a block carries the run's settings, what the block
was made of, and a checksum, so that a block that is damaged, or not of this run, is noticed.

    with locked(folder):
        store = Store.begin(folder, {"seed": 0})
        fill(store, Machines(), task, blocks, take)     # makes what is not there yet
        store.finish(3)
    Store.open(folder).read(0, "summary")
"""

import contextlib
import dataclasses
import datetime
import errno
import fcntl
import hashlib
import json
import logging
import os
import re
import socket
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.machines import Machines
from poseterior.inference.results import save_tree
from poseterior.probmodel.arrays import ArrayFile
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import opened, replacing

LOG = logging.getLogger("poseterior")
SETTINGS, LOCK = "run.json", "run.lock"
Groups = dict[str, xr.Dataset]
_BLOCK = re.compile(r"block-(\d{6,})\.nc")
_LONGEST_NAME = 60
"""Characters of a setting's name that a message gives as it is."""
_NOTED = ("run", "number", "size", "made_of", "sha256")


class Damaged(BadInput):
    """A block is missing, cannot be read, or does not hold what was written."""


class Block(NamedTuple):
    """A block to be made: its number, what it is made of in words (for sentences) and in short
    (`made_of`, to recognise it), how many things are in it, and the `payload` its task gets; `part`
    is the folder within the store."""

    number: int
    words: str
    made_of: Mapping[str, Any]
    size: int
    payload: Any
    part: str = ""


@dataclasses.dataclass(frozen=True)
class Store:
    """The blocks in `folder`, of a run with these settings (plain JSON values)."""

    folder: Path
    settings: Mapping[str, Any]

    @classmethod
    def begin(cls, folder: Path, settings: Mapping[str, Any]) -> "Store":
        """The store to write a run to, made if there is none.

        Raises
        ------
        BadInput
            Where the folder, or a block in it, is of another run, or cannot be written to.
        """
        store = cls(folder, json.loads(json.dumps(settings)))
        path = folder / SETTINGS
        if path.exists():
            store._same_settings(folder, _read_settings(path)["settings"])
            return store
        for block in sorted(folder.rglob("block-*.nc")):  # the settings were lost, blocks have them
            if block.parent == folder or not (block.parent / SETTINGS).exists():
                cls(block.parent, store.settings)._read(block, None)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(
                f"cannot make {folder} ({error.strerror}); choose another folder"
            ) from None
        with replacing(path) as partial:
            _write_settings(partial, store.settings, None)
        return store

    @classmethod
    def open(cls, folder: Path, what: str) -> "Store":
        """The store of a finished or stopped run, which a sentence would call `what`.

        Raises
        ------
        BadInput
            Where there is no store, or blocks are missing between others or at the end.
        """
        path = folder / SETTINGS
        if not path.is_file():
            raise BadInput(f"{folder} is not {what} (it has no {SETTINGS}); give the folder of one")
        found = _read_settings(path)
        store = cls(folder, found["settings"])
        store.whole(found["blocks"] or 0)
        return store

    def part(self, name: str) -> "Store":
        """The blocks of a folder within this one, of the same run."""
        return dataclasses.replace(self, folder=self.folder / name) if name else self

    def path(self, number: int) -> Path:
        """Where a block is."""
        return self.folder / f"block-{number:06d}.nc"

    def numbers(self) -> list[int]:
        """The numbers of the blocks that are there, whole or not."""
        names = (_BLOCK.fullmatch(path.name) for path in self.folder.glob("block-*.nc"))
        return sorted(int(name[1]) for name in names if name)

    def whole(self, least: int) -> list[int]:
        """The numbers of the blocks. Raises `Damaged` where one is missing, of the first `least` or
        before another."""
        there = self.numbers()
        missing = max([least - 1, *there]) + 1 - len(there)
        if missing:
            first = next((n for n, number in enumerate(there) if n != number), len(there))
            raise Damaged(
                f"{self.folder} lacks {missing} blocks, the first of them {self.path(first).name};"
                " run again to make them"
            )
        return there

    def find(self, block: Block) -> Groups | None:
        """What a block holds; None where it is not there, damaged (which is said in the log), or
        shorter than `block.size`.

        Raises
        ------
        BadInput
            Where it is of another run, or made of other things.
        """
        path = self.path(block.number)
        if not path.exists():
            return None
        try:
            found, noted = self._read(path, None)
        except Damaged as error:
            LOG.warning("%s; it is made anew", str(error).partition(";")[0])
            return None
        made_of = json.loads(noted["made_of"])
        for name, value in json.loads(json.dumps(block.made_of)).items():
            if made_of.get(name) != value:
                raise BadInput(
                    f"{path} was made of other {name} than those given now; choose another folder,"
                    " or delete that block"
                )
        return found if int(noted["size"]) >= block.size else None

    def read(self, number: int, group: str) -> xr.Dataset:
        """One group of a block. Raises `Damaged` where it is missing or damaged, `BadInput` where
        it is of another run."""
        return self._read(self.path(number), group)[0][group]

    def write(self, block: Block, groups: Mapping[str, xr.Dataset]) -> None:
        """Writes a block, whole or not at all. Raises `BadInput` where it cannot."""
        noted = {
            "run": _canonical(self.settings),
            "number": block.number,
            "size": block.size,
            "made_of": _canonical(block.made_of),
        }
        path = self.path(block.number)
        plain = {name: _plain_texts(group) for name, group in groups.items()}
        tree = xr.DataTree.from_dict(
            {
                name: group.assign_attrs(noted, sha256=_checksum(name, group, noted))
                for name, group in plain.items()
            }
        )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            save_tree(tree, path)
        except (OSError, RuntimeError) as error:  # RuntimeError: how netCDF says that there is none
            reason = getattr(error, "strerror", None) or error
            raise BadInput(f"cannot write {path} ({reason}); make room, and run again") from None

    def finish(self, blocks: int) -> None:
        """Notes that the run has so many blocks. Raises `BadInput` where there are more: then they
        are of a longer run, and would be taken for this one's."""
        stale = [number for number in self.numbers() if number >= blocks]
        if stale:
            raise BadInput(
                f"{self.folder} holds {len(stale)} more blocks than this run has, of a longer one,"
                f" {self.path(stale[0]).name} and after; choose another folder, or delete them"
            )
        path = self.folder / SETTINGS
        if _read_settings(path)["blocks"] != blocks:
            with replacing(path) as partial:
                _write_settings(partial, self.settings, blocks)

    def _read(self, path: Path, group: str | None) -> tuple[Groups, dict[str, Any]]:
        """Groups of a block (or one) and what is noted with them, both checked."""
        if not path.exists():
            raise Damaged(f"{path} is missing; run again to make it")
        _require_block(path)
        try:
            with xr.open_datatree(path, engine="netcdf4") as tree:
                wanted = tree.children if group is None else [group]
                found = {name: tree[name].to_dataset().load() for name in wanted}
            noted = {
                name: {key: one.attrs.pop(key) for key in _NOTED} for name, one in found.items()
            }
            whole = bool(found) and all(
                noted[name]["sha256"] == _checksum(name, one, noted[name])
                for name, one in found.items()
            )
        except (MemoryError, PermissionError) as error:
            raise BadInput(f"{path} cannot be read ({error}); see to it, and run again") from None
        except Exception as error:  # netCDF meets damage with errors of many unrelated kinds
            raise Damaged(
                f"{path} is damaged, or no block of a run ({type(error).__name__}); delete it, and"
                " run again to make it anew"
            ) from None
        if not whole:
            raise Damaged(
                f"{path} is damaged (it is not what its checksum says); delete it, and run again to"
                " make it anew"
            )
        first = next(iter(noted.values()))
        self._same_settings(path, json.loads(first["run"]))
        if self.path(int(first["number"])).name != path.name:
            raise BadInput(
                f"{path} is block {first['number']} of its run under another name; delete it, and"
                " run again"
            )
        return found, first

    def _same_settings(self, where: Path, found: Mapping[str, Any]) -> None:
        names = [*self.settings, *(name for name in found if name not in self.settings)]
        changed = [name for name in names if found.get(name) != self.settings.get(name)]
        if changed:
            name = changed[0]
            what = name if name.isidentifier() and len(name) <= _LONGEST_NAME else shown(name)
            raise BadInput(
                f"{where} holds another run (its {what} is {shown(found.get(name))}, not"
                f" {shown(self.settings.get(name))}); choose another folder, or delete that one"
            )


def fill(
    store: Store | None,
    machines: Machines,
    task: Callable[[Any], Groups],
    blocks: Iterable[Block],
    take: Callable[[Block, Groups], None],
    *,
    apart: bool = False,
) -> None:
    """Takes every block: from the store where it is there, else made of its payload by `task`, on
    any machine and in any order, and written to the store (None: kept nowhere).

    Parameters
    ----------
    blocks
        Read as they are needed, however many there are.
    take
        Called with every block and its groups, kept and made ones alike.
    apart
        As in `Machines.each`.

    Raises
    ------
    BadInput
        As `Store.find`, `Store.write` and `Machines.each` do.
    """

    def to_be_made() -> Iterator[tuple[Block, str, Any]]:
        for block in blocks:
            kept = store.part(block.part).find(block) if store else None
            if kept is None:
                yield block, block.words, block.payload
            else:
                take(block, kept)

    for block, groups in machines.each(task, to_be_made(), apart=apart):
        if store:
            store.part(block.part).write(block, groups)
        take(block, groups)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps every other run out of `folder`, which is made if there is none; a process that dies
    lets go of it. Raises `BadInput`, naming who holds it, where somebody does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = _lock(folder / LOCK)
    except BlockingIOError:
        raise BadInput(
            f"{folder} is being written to by {_holder(folder / LOCK)}; wait until it has ended, or"
            " choose another folder"
        ) from None
    except OSError as error:
        raise BadInput(
            f"cannot write to {folder} ({error.strerror}); choose another folder"
        ) from None
    try:
        now = datetime.datetime.now().astimezone().isoformat(" ", "seconds")
        os.truncate(file, 0)
        os.write(file, f"process {os.getpid()} on {socket.gethostname()} since {now}".encode())
        yield
    finally:
        (folder / LOCK).unlink(missing_ok=True)
        os.close(file)


def _lock(path: Path) -> int:
    """A descriptor of the file at `path` with a lock on it. Raises `BlockingIOError` where another
    one has it."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise OSError(errno.EINVAL, f"{path.name} in it is no file")
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        except OSError:
            os.close(file)
            raise
        os.close(file)  # whoever held it has just taken the file away


def _require_block(path: Path) -> None:
    """Raises `BadInput` where netCDF could wait for ever or fill the memory with what is there: a
    store may be given by somebody else, to be shown. `Damaged` where it is no whole file."""
    with opened(path, "block of a run", "delete it, and run again to make it anew") as file:
        try:
            ArrayFile(file, str(path)).require_credible()
        except BadInput:
            raise Damaged(
                f"{path} is damaged, or no block of a run; delete it, and run again to make it anew"
            ) from None


def _holder(path: Path) -> str:
    try:
        return path.read_bytes()[:200].decode("utf-8", "replace") or "another process"
    except OSError:
        return "another process"


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path, "settings of a run", "choose another folder")
        settings = dict(found["settings"])
        blocks = found["blocks"]
        if blocks is not None and not (isinstance(blocks, int) and blocks >= 0):
            raise ValueError
        return {"settings": settings, "blocks": blocks}
    except (BadInput, ValueError, KeyError, TypeError):
        raise BadInput(
            f"{path} cannot be read, or is not that of a run; choose another folder, or delete it"
        ) from None


def _write_settings(path: Path, settings: Mapping[str, Any], blocks: int | None) -> None:
    text = json.dumps({"settings": dict(settings), "blocks": blocks}, indent=1)
    path.write_text(text, encoding="utf-8")


def _canonical(value: Mapping[str, Any]) -> str:
    return json.dumps(dict(value), sort_keys=True)


def _plain_texts(group: xr.Dataset) -> xr.Dataset:
    """The group with texts that any file can hold: without NUL and lone surrogates."""
    texts = {
        name: variable.copy(data=_each_text(variable.values))
        for name, variable in group.variables.items()
        if variable.dtype.kind in "OTU"
    }
    return group.assign(texts) if texts else group


def _each_text(values: np.ndarray) -> np.ndarray:
    flat = [
        str(value).replace("\0", "\\0").encode("utf-8", "backslashreplace").decode("utf-8")
        for value in values.ravel()
    ]
    return np.array(flat, dtype=object).reshape(values.shape)


def _checksum(name: str, group: xr.Dataset, noted: Mapping[str, Any]) -> str:
    """Of all values of a group and what is noted with it, whatever the file does to text types and
    to the signs of NaN."""
    digest = hashlib.sha256()
    about = [name, *(str(noted[key]) for key in _NOTED if key != "sha256")]
    digest.update(json.dumps(about).encode())
    for key in sorted(map(str, group.variables)):
        values = group.variables[key].values
        digest.update(json.dumps([key, [*map(str, group.variables[key].dims)]]).encode())
        if values.dtype.kind in "OTU":
            digest.update(json.dumps(values.tolist()).encode())
            continue
        if values.dtype.kind == "f" and np.isnan(values).any():
            values = np.where(np.isnan(values), values.dtype.type(np.nan), values)
        digest.update(json.dumps([values.dtype.kind, values.shape]).encode())
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()
