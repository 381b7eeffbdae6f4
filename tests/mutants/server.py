"""Runs tests on request, in forks of a process that has the heavy libraries loaded: that is most of
what a short test waits for. `python -m tests.mutants.server` in the tree to be tested, which it
imports nothing of.

A request is a line of JSON, tests and seconds; the answer a line of JSON too, pytest's exit code
(124 where the time was up) and the seconds of the processor. What pytest said is in `said.txt`,
what came out in `report.xml`."""

import importlib
import json
import os
import signal
import sys
import time

PRELOADED = (
    *("arviz", "emcee", "jax", "netCDF4", "numba", "numpyro.infer", "pytest"),
    *("scipy.optimize", "scipy.stats", "sklearn.cluster", "xarray"),
)
TIME_UP = 124
OPTIONS = ("-q", "--tb=line", "-p", "no:cacheprovider", "--junitxml=report.xml")


def answer(tests: list[str], seconds: float) -> tuple[int, float]:
    """Pytest's exit code for the tests, run in a fork, and the seconds of the processor."""
    child = os.fork()
    if not child:
        run(tests)
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return TIME_UP, seconds


def run(tests: list[str]) -> None:
    """Runs the tests in this process, and ends it."""
    import pytest

    os.setpgid(0, 0)
    said = os.open("said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(said, 1)
    os.dup2(said, 2)
    code = int(pytest.main([*OPTIONS, *tests]))
    sys.stdout.flush()
    os._exit(code)


def main() -> None:
    """Answers until there are no more requests."""
    for name in PRELOADED:
        importlib.import_module(name)
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("a library has started a thread, which no fork would have")
    for line in sys.stdin:
        print(json.dumps(answer(**json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
