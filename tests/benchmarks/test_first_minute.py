"""How long somebody waits who has just met us: `make bench`.

Every command is a process of its own, measured in processor time (its second process included) and
as a ratio to an import of JAX, numba, xarray and matplotlib beside it: what any such tool costs
before it has done anything. So a busy machine, or another one, says the same."""

import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
IMPORTS = "import jax, numba, xarray, matplotlib.figure"
COMMAND = "from poseterior.reports.cli import command; command()"
SKIER = str(ROOT / "examples" / "skier.json")


def spent(code: str, *words: str, place: Path, code_is: int = 0) -> float:
    """Seconds of processor time of a process and of those that it started."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(place / "loops")}
    for name in ("JAX_COMPILATION_CACHE_DIR", "POSETERIOR_PROGRAMS"):
        environment.pop(name, None)  # as the session has set them
    environment["XDG_CACHE_HOME"] = str(place / "cache")
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *words],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == code_is, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Job(NamedTuple):
    """What is called on which machine, its exit code, how often, and at most how many times the
    imports it may take."""

    machine: str
    words: tuple[str, ...]
    code: int
    rounds: int
    most: float


CALL = ("hypotheses", SKIER, "--quiet", "--out", "out")
PAPER = (*CALL, "--root", "fixed")
JOBS = {
    "the first call": Job("one", CALL, 0, 1, 20.0),
    "a later call": Job("one", CALL, 0, 3, 5.0),
    "the first call, roots fixed": Job("other", PAPER, 0, 1, 16.0),
    "a later call, roots fixed": Job("other", PAPER, 0, 3, 3.0),
    "a refusal": Job("one", ("hypotheses", "no.json"), 2, 3, 0.5),
    "--version": Job("one", ("--version",), 0, 3, 0.3),
}


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two on which nothing has been compiled, until the first job on each has run."""
    return {name: tmp_path_factory.mktemp(name) for name in ("one", "other")}


@pytest.mark.parametrize("job", JOBS)
def test_the_first_minute(benchmark, machines: dict[str, Path], job: str) -> None:
    machine, words, code, rounds, most = JOBS[job]
    place = machines[machine]
    spent(IMPORTS, place=place)  # from here on they are in the system's memory
    imports = min(spent(IMPORTS, place=place) for _ in range(3))
    seconds: list[float] = []
    benchmark.pedantic(
        lambda: seconds.append(spent(COMMAND, *words, place=place, code_is=code)), rounds=rounds
    )
    ratio = min(seconds) / imports
    benchmark.extra_info.update(processor_s=min(seconds), imports_s=imports, ratio=ratio)
    print(f"{job}: {min(seconds):.2f} s of processor time, {ratio:.2f} times the imports")
    assert ratio < most
