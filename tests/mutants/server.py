"""Runs tests on request, in forks of a process that has the heavy libraries loaded: that is most of
what a short test waits for. `python -m tests.mutants.server` in the tree to be tested, which it
imports nothing of.

A request is a line of JSON, tests and seconds; the answer a line of JSON too, pytest's exit code
(124 where the time was up) and the seconds of the processor. It is the processor's time that is
limited, so that a busy machine makes no difference. What pytest said is in `said.txt`, what came
out in `report.xml`."""

import importlib
import json
import os
import resource
import signal
import sys
import time

PRELOADED = (
    *("arviz", "emcee", "jax", "netCDF4", "numba", "numpyro.infer", "pytest"),
    *("scipy.optimize", "scipy.stats", "sklearn.cluster", "xarray"),
)
TIME_UP = 124
PATIENCE = 4
"""How many times as long as the processor's seconds tests may last by the clock."""
OPTIONS = (
    *("-q", "--tb=line", "-p", "no:cacheprovider"),
    *("--junitxml=report.xml", "-o", "junit_duration_report=call"),
)


def answer(tests: list[str], seconds: float) -> tuple[int, float]:
    """Pytest's exit code for the tests, run in a fork, and the seconds of the processor."""
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
        run(tests)
    ends = time.monotonic() + PATIENCE * seconds
    while time.monotonic() < ends:
        done, status, used = os.wait4(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            spent = used.ru_utime + used.ru_stime
            return TIME_UP if code == -signal.SIGXCPU else code, spent
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
