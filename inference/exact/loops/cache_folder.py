"""The cache folder of the compiled loops: one for each state of their sources, found
without importing what compiles them."""

import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterable
from pathlib import Path

SOURCES = (
    "inference/exact/loops/bins.py",
    "inference/exact/loops/blocks.py",
    "inference/exact/loops/bounds.py",
    "inference/exact/loops/cache_folder.py",
    "inference/exact/loops/first_stage.py",
    "inference/exact/loops/gaussian.py",
    "inference/exact/loops/line_of_sight.py",
    "inference/exact/loops/numbers.py",
    "inference/exact/loops/pairs.py",
    "inference/exact/loops/placing.py",
    "inference/exact/loops/proposals.py",
    "inference/exact/loops/rectangles.py",
    "inference/exact/loops/roots.py",
    "inference/exact/loops/seeds.py",
    "inference/exact/loops/series.py",
    "inference/exact/loops/strata.py",
    "inference/exact/loops/tables.py",
    "inference/exact/loops/vectors.py",
    "inference/exact/loops/weighted_limbs.py",
    "probmodel/kinematics.py",
    "probmodel/skeleton.py",
    "probmodel/anatomy/limits.py",
)
"""All files whose text ends in the compiled loops, as functions or as constants."""


def digest(texts: Iterable[bytes]) -> str:
    """A short name for a state of the sources."""
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


def _places() -> list[Path]:
    """Where the cache folder may be, best first: where the user says, beside the
    package, in the user's cache."""
    said = [Path(own)] if (own := os.environ.get("NUMBA_CACHE_DIR")) else []
    cache = Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache"))
    home = [cache / "poseterior"] if cache.is_absolute() else []  # a user may have no home
    return [*said, Path(__file__).parent / "__pycache__", *home]


def _usable(folder: Path) -> bool:
    """Whether the folder is there, or can be made, and can be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def temporary() -> Path | None:
    """This user's own folder among the temporary ones. Compiled loops are code: nobody
    else may be able to put any there."""
    try:
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = Path(tempfile.gettempdir()) / f"poseterior-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = found.st_uid == user and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if private and folder.is_dir() and not folder.is_symlink() else None


def _kept_in(name: str) -> Path | None:
    """The folder of compiled loops; None where there is none. Numba compiles a function
    anew where its own file has changed, but not where a function or a constant of
    another file has that was compiled into it: after an update old and new loops would
    work on each other's tables. So each state of the sources has a folder of its own,
    its `name`."""
    for place in _places():
        if _usable(place / name):
            return place / name
    begin = "neither the package's folder nor the home folder can be written to"
    end = "NUMBA_CACHE_DIR can name another folder"
    own = temporary()
    if own is None or not _usable(own / name):
        warnings.warn(
            f"{begin}, so every process compiles the sampling loops anew, which takes up to a "
            f"minute; {end}.",
            stacklevel=2,
        )
        return None
    for place in _places():  # an image may bring loops that were compiled before it was sealed
        if (place / name).is_dir():
            _take_along(place / name, own / name)
    warnings.warn(
        f"{begin}, so the compiled sampling loops are kept in {own}; {end}.", stacklevel=2
    )
    return own / name


def _take_along(sealed: Path, folder: Path) -> None:
    """Copies files, but not that nobody may write beside them."""
    for path in sealed.rglob("*"):
        if path.is_file():
            target = folder / path.relative_to(sealed)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)


def _source_state() -> str:
    root = Path(__file__).parents[3]
    return digest((root / source).read_bytes() for source in SOURCES)


FOLDER = _kept_in(f"loops-{_source_state()}")
"""None where there is no place for them."""
