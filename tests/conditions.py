"""The quick tests as other machines would run them: `make conditions`.

    python -m tests.conditions                       under all conditions, one after the other
    python -m tests.conditions "one core" order      under those whose names hold one of these words
    taskset -c 1 python -m tests.conditions          with one worker, and so on

No verdict may hang on the processor, on the order of tests or on what else the machine does. Of
every run the tests that failed are listed, with the slowest."""

import multiprocessing
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
QUICK = "not slow and not sweep"
UNOPTIMISED = "--xla_backend_optimization_level=0"
"""As `make test` has it."""
SLOWEST = 15


class Condition(NamedTuple):
    """What is set in the environment, on how many cores at most the tests run, and how many other
    processes keep the machine busy."""

    environment: dict[str, str] = {}  # noqa: RUF012 — never written to
    cores: int | None = None
    load: int = 0


def _xla(*flags: str) -> dict[str, str]:
    return {"XLA_FLAGS": " ".join(flags)}


CONDITIONS = {
    "as make test has it": Condition(),
    "optimised": Condition(_xla()),
    "any processor": Condition({"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}),
    "XLA limited to SSE4": Condition(_xla(UNOPTIMISED, "--xla_cpu_max_isa=SSE4_2")),
    "XLA limited to AVX2": Condition(_xla(UNOPTIMISED, "--xla_cpu_max_isa=AVX2")),
    "both limited": Condition(
        {**_xla("--xla_cpu_max_isa=SSE4_2"), "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    ),
    "one core": Condition(cores=1),
    "another order": Condition({"TESTS_SHUFFLED": "1"}),
    "a third order": Condition({"TESTS_SHUFFLED": "2"}),
    "beside a load of four": Condition(load=4),
}


class Outcome(NamedTuple):
    """How a run ended: whether all tests passed, its seconds, and the lines that matter."""

    green: bool
    seconds: float
    lines: list[str]


def under(condition: Condition) -> Outcome:
    """Runs the quick tests under a condition."""
    cores = sorted(os.sched_getaffinity(0))[: condition.cores]
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [
        *(sys.executable, "-m", "pytest", "-q", "-n", str(len(cores)), "--dist", "loadfile"),
        *("-m", QUICK, f"--durations={SLOWEST}", "-p", "no:cacheprovider"),
    ]
    began = time.monotonic()
    with _busy(condition.load):
        run = subprocess.run(
            command,
            cwd=ROOT,
            env={**os.environ, **threads, **_xla(UNOPTIMISED), **condition.environment},
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )
    matters = re.compile(r"^(FAILED|ERROR|=+ .*(passed|failed)|\d+ (passed|failed)|\s*[\d.]+s )")
    lines = [line for line in run.stdout.splitlines() if matters.match(line)]
    return Outcome(run.returncode == 0, time.monotonic() - began, lines or [run.stderr])


@contextmanager
def _busy(processes: int) -> Iterator[None]:
    """So many processes that do nothing but take time."""
    started = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(processes)]
    for one in started:
        one.start()
    try:
        yield
    finally:
        for one in started:
            one.kill()
            one.join()


def _spin() -> None:
    while True:
        pass


def main() -> int:
    """The conditions that are asked for; 1 where one of them ends in red."""
    words = sys.argv[1:] or [""]
    asked = [name for name in CONDITIONS if any(word in name for word in words)]
    if not asked:
        print(f"there is no such condition; choose among {', '.join(CONDITIONS)}")
        return 2
    red = 0
    for name in asked:
        outcome = under(CONDITIONS[name])
        red += not outcome.green
        print(f"{name}: {'green' if outcome.green else 'RED'}, {outcome.seconds:.0f} s")
        print("\n".join(f"    {line}" for line in outcome.lines), flush=True)
    return int(red > 0)


if __name__ == "__main__":
    sys.exit(main())
