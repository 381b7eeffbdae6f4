"""How long a command keeps its user waiting: in a place where nothing has been compiled, later, and
where Python may not write byte code, as in many containers."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from poseterior.reports.pages.clocks import digits
from poseterior.reports.tables import Column, Sheet, sheet_of

LIBRARIES = "import jax, matplotlib.figure, netCDF4, numba, xarray"
CACHES = "NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "MPLCONFIGDIR"
"""Variables of the environment that say where compiled loops, compiled programs and a list of fonts
are kept."""
SEALED = {"PYTHONDONTWRITEBYTECODE": "1"}
SKIER = Path(__file__).resolve().parents[2] / "examples" / "skier.json"
REPEATS = 3


class Wait(NamedTuple):
    """Seconds by the clock, and those of all processors together."""

    seconds: float
    processor: float


def waits() -> Sheet:
    """Of `poseterior hypotheses`, each in a process of its own: the first, and the shortest of some
    later ones, beside what importing its libraries takes."""
    with tempfile.TemporaryDirectory() as folder:
        caches = dict.fromkeys(CACHES, str(Path(folder, "caches")))
        job = ["-P", "-m", "poseterior", "hypotheses", str(SKIER), "--quiet", "--out", folder]
        found = {
            "JAX, Numba, xarray and Matplotlib are imported": shortest(["-c", LIBRARIES], caches),
            "`hypotheses`, where nothing is compiled yet": waited(job, caches),
            "`hypotheses`, later": shortest(job, caches),
            "`hypotheses`, later, no byte code written": shortest(job, caches | SEALED),
        }
    return waits_table(found)


def shortest(words: Sequence[str], environment: dict[str, str]) -> Wait:
    """The shortest of `REPEATS` waits."""
    return min(waited(words, environment) for _ in range(REPEATS))


def waited(words: Sequence[str], environment: dict[str, str]) -> Wait:
    """What a Python with these words takes, in this environment with some variables more."""
    before, started = _of_children(), time.perf_counter()
    quiet = subprocess.DEVNULL
    whole = os.environ | environment
    subprocess.run([sys.executable, *words], env=whole, check=True, stdout=quiet, stderr=quiet)
    return Wait(time.perf_counter() - started, _of_children() - before)


def _of_children() -> float:
    """Seconds of the processor that processes took which have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def waits_table(found: dict[str, Wait]) -> Sheet:
    """Waits, and how much work each is, as a multiple of the first of them: work hardly depends on
    what else the machine does."""
    floor = next(iter(found.values())).processor
    rows = [(what, *wait, wait.processor / floor) for what, wait in found.items()]
    heads = "seconds", "seconds of all processors", "times those of the first line"
    return sheet_of(["one process each", *(Column(head, form=digits) for head in heads)], rows)
