"""What came out of every frame, in a Zarr store that grows block by block and can be gone on with.

One group a condition, one array a field, first axis the frame; a block of frames is a chunk of each
array. A block's mark in `done` is written last, and every chunk at once or not at all, so that a
store that was left at any moment holds whole blocks and blocks to be done again. It is opened by
`zarr.open_group` and by xarray."""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from inference.studies.evaluation.conditions import Condition
from probmodel.failures import BadInput

BLOCK = 32
"""Frames that are estimated together, sent to a worker together, and lost together when it dies."""
_TEXT = "the folder of a finished or stopped evaluation"


class Store:
    """The store in the folder `path`: `settings` say what was asked for, `fields` what is kept of a
    frame."""

    def __init__(
        self, path: Path, group: Any, frames: int, fields: Mapping[str, tuple[tuple[int, ...], str]]
    ) -> None:
        self.path, self._group, self.frames, self.fields = path, group, frames, fields

    @classmethod
    def open(
        cls,
        path: Path,
        settings: Mapping[str, Any],
        frames: int,
        fields: Mapping[str, tuple[tuple[int, ...], str]],
    ) -> "Store":
        """The store at `path`, made if there is none. Raises `BadInput` where it is another run's,
        or no store."""
        zarr = library()
        wanted = json.loads(json.dumps(settings))
        if not path.exists():
            partial = path.with_name(f"{path.name}.partial")
            shutil.rmtree(partial, ignore_errors=True)
            try:
                zarr.open_group(partial, mode="w-", attributes={"settings": wanted})
                os.replace(partial, path)
            except OSError as error:
                raise BadInput(
                    f"cannot write {path} ({error.strerror}); choose another folder"
                ) from None
        group = _opened(path)
        found = group.attrs.get("settings")
        if not isinstance(found, dict):
            raise BadInput(f"{path} is not {_TEXT}; choose another folder, or delete that one")
        changed = [name for name in wanted if found.get(name) != wanted[name]]
        if changed:
            raise BadInput(
                f"{path} holds another run (its {changed[0]} is {found.get(changed[0])!r}, not "
                f"{wanted[changed[0]]!r}); choose another folder, or delete that one"
            )
        return cls(path, group, frames, fields)

    @property
    def blocks(self) -> int:
        """How many blocks a condition has."""
        return -(-self.frames // BLOCK)

    def rows(self, block: int) -> slice:
        """The frames of a block."""
        return slice(block * BLOCK, min((block + 1) * BLOCK, self.frames))

    def missing(self, condition: Condition) -> list[int]:
        """The blocks of a condition that are not there yet."""
        return np.flatnonzero(~self._arrays(condition)["done"][:]).tolist()

    def write(self, condition: Condition, block: int, values: Mapping[str, np.ndarray]) -> None:
        """Writes a block. Raises `BadInput` where the disk is full."""
        arrays = self._arrays(condition)
        try:
            for name in self.fields:
                arrays[name][self.rows(block)] = values[name]
            arrays["done"][block] = True
        except OSError as error:
            raise BadInput(
                f"cannot write to {self.path} ({error.strerror}); make room, and run it again"
            ) from None

    def read(self, condition: Condition) -> dict[str, np.ndarray]:
        """All frames of a condition, by field; blank where they are not there yet."""
        arrays = self._arrays(condition)
        return {name: np.asarray(arrays[name][:]) for name in self.fields}

    def _arrays(self, condition: Condition) -> Any:
        """The group of a condition, made if need be: whole arrays of blanks, so that none is half
        there."""
        name = condition.name
        if name not in self._group:
            self._group.require_group(name)
        group = self._group[name]
        for field, (shape, kind) in {"done": ((), "?"), **self.fields}.items():
            if field not in group:
                size, chunk = (
                    (self.blocks, 1) if field == "done" else (self.frames, min(BLOCK, self.frames))
                )
                group.create_array(
                    field,
                    shape=(size, *shape),
                    chunks=(chunk, *shape),
                    dtype=kind,
                    fill_value=np.nan if kind[0] == "f" else 0,
                )
        return group


def library() -> Any:
    """Zarr. Raises `BadInput` where it is not installed."""
    try:
        import zarr
    except ImportError:
        raise BadInput(
            "evaluation needs zarr and distributed; pip install 'poseterior[evaluate]'"
        ) from None
    return zarr


def _opened(path: Path) -> Any:
    zarr = library()
    try:
        return zarr.open_group(path, mode="r+")
    except Exception as error:  # what is no store is met with errors of many kinds
        raise BadInput(
            f"{path} is not {_TEXT} ({type(error).__name__}); choose another folder"
        ) from None
