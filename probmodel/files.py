"""Files: read only where they are regular files of a credible size, written whole or not at all."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from poseterior.probmodel.failures import BadInput

UNFINISHED: set[Path] = set()
"""What is being written, for whoever ends the process at once to remove."""
LARGEST_FILE = 1_000_000_000
"""Bytes; larger files would fill the memory before anything could be said about them."""
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def opened(
    path: str | os.PathLike, what: str, advice: str, *, largest: int | None = None
) -> BinaryIO:
    """A regular file, open for reading bytes.

    Pipes, devices, sockets and folders are refused before they are opened: opening them can block
    for ever or change something.

    Parameters
    ----------
    path
        The file; links are followed.
    what, advice
        What the file should be, and what to do where it is not: both go into the sentence.
    largest
        Bytes that it may have; any number by default.

    Raises
    ------
    BadInput
        Where there is no such file, it is not a regular one, is too large, or cannot be opened.
    """
    try:
        _require_regular(os.stat(path), path, advice)
        # Should the file be swapped for a pipe meanwhile, this does not wait for its other end.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        raise BadInput(f"there is no {what} at {path}; {advice}") from None
    except (OSError, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{path} cannot be read ({reason}); {advice}") from None
    file = os.fdopen(descriptor, "rb")
    try:
        found = os.fstat(descriptor)
        _require_regular(found, path, advice)
        if largest is not None and found.st_size > largest:
            raise BadInput(
                f"{path} has {found.st_size:,} bytes, more than {largest:,}; split it into smaller"
                " files"
            )
    except BaseException:
        file.close()
        raise
    return file


def read_bytes(
    path: str | os.PathLike, what: str, advice: str, *, largest: int = LARGEST_FILE
) -> bytes:
    """The content of a regular file of at most `largest` bytes. Raises `BadInput` as `opened`."""
    with opened(path, what, advice, largest=largest) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            data = file.read(size + 1) or b""
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error.strerror}); {advice}") from None
    if len(data) != size:
        raise BadInput(f"{path} changed while it was read; {advice}")
    return data


def _require_regular(found: os.stat_result, path: str | os.PathLike, advice: str) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise BadInput(f"{path} is {kind}, not a file; {advice}")


@contextlib.contextmanager
def replacing(
    path: str | os.PathLike, advice: str = "choose a folder that can be written to"
) -> Iterator[Path]:
    """A place beside `path` to write to: what is there in the end takes its name, so that no reader
    ever meets half a file. Where anything is raised, nothing is left, and what was at `path` stays.
    A link stays a link.

    Raises `BadInput`, a sentence that ends in the advice, where the system says no or no file can
    have that name."""
    try:
        target = Path(os.path.realpath(path))
        partial = target.with_name(target.name + ".partial")
    except ValueError as error:
        raise BadInput(f"cannot write {path} ({error}); {advice}") from None
    UNFINISHED.add(partial)
    try:
        # What a killed process left, or a link that somebody laid there: never written through. The
        # new file is this process's own, before anything is written.
        partial.unlink(missing_ok=True)
        os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        yield partial
        os.replace(partial, target)
    except (OSError, RuntimeError) as error:
        # netCDF says no more than that, whatever the system said.
        if isinstance(error, RuntimeError) and "NetCDF: " not in str(error):
            raise
        reason = getattr(error, "strerror", None) or f"{error}: is the disk full?"
        raise BadInput(f"cannot write {path} ({reason}); {advice}") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        UNFINISHED.discard(partial)
