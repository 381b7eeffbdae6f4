"""Files that are written whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from probmodel.failures import BadInput

UNFINISHED: set[Path] = set()
"""What is being written, for whoever ends the process at once to remove."""


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
