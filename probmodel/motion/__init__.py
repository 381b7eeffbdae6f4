"""Readers of motion capture: ASF/AMC, BVH, TRC, C3D and .npz files become `Motion`s of fifteen
joints in millimetres.

All axes are right-handed. Whatever the format, a recording is a hierarchy of segments with an
offset and a rotation each (`recording.Rig`); forward kinematics runs over all frames at once.
Glitches are dropped by a stated rule (`Motion.without_jumps`). The usual way in:
`read_motion(path)`."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NoReturn

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion.archive import read_archive
from poseterior.probmodel.motion.asf import Asf, asf_beside, parse_asf, read_amc, read_amc_alone
from poseterior.probmodel.motion.bvh import read_bvh
from poseterior.probmodel.motion.markers import read_c3d, read_trc
from poseterior.probmodel.motion.recording import CMU_UNIT, FROM_SEVENTEEN, Motion

MOST_ENTRIES = 100_000
"""Files and folders that are looked through."""
NAMED = {".bvh": read_bvh, ".trc": read_trc, ".c3d": read_c3d}
"""By the end of a file's name, those whose joints have names that the user may give."""
READERS = {".amc": read_amc_alone, **NAMED, ".npz": read_archive}
"""All, by the end of a file's name."""
KINDS = ".amc, .bvh, .trc, .c3d or .npz"

__all__ = ["CMU_UNIT", "FROM_SEVENTEEN", "Motion", "read_motion"]


def read_motion(path: str | os.PathLike, *, names: Mapping[str, str] | None = None) -> list[Motion]:
    """Recordings at a path, glitches included (see `Motion.without_jumps`), in a fixed order.

    Parameters
    ----------
    path
        An .amc file with its subject's .asf beside it; a .bvh file; a .trc or .c3d with markers at
        the joints; an .npz of one subject, whose keys (`<action>/<sequence>`) hold `(T, 15, 3)` or
        `(T, 17, 3)` millimetres at 30 Hz; or a folder of any of these, with its folders.
    names
        A file's names of joints or markers → ours, where they are not known (`rigs`); of BVH, TRC
        and C3D.

    Returns
    -------
    list of Motion
        One for each recording.

    Raises
    ------
    BadInput
        Where a file is none of these, or is damaged.
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path, names)
    if not path.exists():
        raise BadInput(
            f"there is no motion capture at {path}; give an {KINDS} file, or a folder of them"
        )
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise BadInput(
            f"{path} is no motion capture that can be read; give an {KINDS} file, or a folder"
        )
    if names is None:
        return reader(path)
    if path.suffix.lower() not in NAMED:
        raise BadInput(f"{path} has joints in an order, which names do not change; leave them out")
    return NAMED[path.suffix.lower()](path, names)


def holds_motion(folder: Path) -> bool:
    """Whether a folder, or a folder in it, has a file of motion capture."""
    return next(_files_in(folder), None) is not None


def _files_in(folder: Path) -> Iterator[Path]:
    """Files of motion capture in a folder and its folders; closed ones are refused."""
    entries = 0
    for place, _, names in os.walk(folder, onerror=_refuse_folder):
        entries += 1 + len(names)
        if entries > MOST_ENTRIES:
            raise BadInput(
                f"{folder} holds more than {MOST_ENTRIES:,} files and folders; give the folder of"
                " motion capture itself"
            )
        for name in names:
            if Path(name).suffix.lower() in READERS:
                yield Path(place, name)


def _read_folder(folder: Path, names: Mapping[str, str] | None) -> list[Motion]:
    files = sorted(_files_in(folder))
    if not files:
        raise BadInput(f"{folder} holds no {KINDS} file; give a folder of motion capture")
    skeletons: dict[Path, Asf] = {}
    motions: list[Motion] = []
    for file in files:
        if file.suffix.lower() == ".amc":
            asf = asf_beside(file)
            if asf not in skeletons:
                skeletons[asf] = parse_asf(asf)
            motions.append(read_amc(file, skeletons[asf]))
        else:
            motions += read_motion(file, names=names if file.suffix.lower() in NAMED else None)
    return motions


def _refuse_folder(error: OSError) -> NoReturn:
    raise BadInput(
        f"cannot look into the folder {error.filename} ({error.strerror}); give a folder of motion"
        " capture alone"
    ) from None
