"""Plants every fault in turn, and runs the tests that must fail: `make mutants`.

    make mutants                              all of them
    MUTANTS_NAMES=root,alias make mutants     those whose names hold one of these words
    MUTANTS_SECONDS=600 make mutants          as many as are begun in that time

The checkout is left alone: faults are planted in a copy, one after the other. First the tests run
there without a fault, and must pass. A fault is killed where every test that it names fails;
anything else (a test passes, is skipped, is not found, does not end) is a survivor. The exit code
is 1 where one survives, 2 where nothing could be judged."""

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from tests.mutants import ROOT, Fault, problems, read_faults
from tests.mutants.server import TIME_UP

COPIED = ("inference", "poseterior", "probmodel", "reports", "tests", "pyproject.toml")
LONGEST = 600.0
"""Seconds after which the tests of one fault are given up."""
COMPILED = Path(".pytest_cache", "compiled")
"""What XLA compiled, kept by content, so that the copy may share it."""
FAILED = 1
"""Pytest's exit code where all tests began, and some failed."""


class Outcome(NamedTuple):
    """What the tests of a fault said: whether all of them failed, in words, the milliseconds that
    they took themselves, and the seconds of the processor with all that they need."""

    fault: Fault
    killed: bool
    words: str
    milliseconds: float
    seconds: float

    @property
    def row(self) -> str:
        """A line of the table."""
        tests = ", ".join(test.partition("::")[2] for test in self.fault.tests)
        times = f"{self.milliseconds:.0f} ms", f"{self.seconds:.0f} s"
        return " | ".join((self.fault.name, self.fault.file, tests, self.words, *times))


class Copy:
    """The tree in a folder of its own, and a server in it that runs tests there: on one core, and
    with compiled loops of its own, which the product keeps by the text of their sources. Links
    stay links: through them the package finds its parts, faults and all."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "copy"
        self.root.mkdir()
        unneeded = shutil.ignore_patterns("__pycache__", ".*")
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, self.root / name, symlinks=True, ignore=unneeded)
            else:
                shutil.copy2(ROOT / name, self.root / name)
        (ROOT / COMPILED).mkdir(parents=True, exist_ok=True)
        (self.root / COMPILED).parent.mkdir()
        (self.root / COMPILED).symlink_to(ROOT / COMPILED)
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        own = {"PYTHONPATH": str(self.root), "NUMBA_CACHE_DIR": str(self.root / "loops")}
        self._server = subprocess.Popen(
            [sys.executable, "-m", "tests.mutants.server"],
            cwd=self.root,
            env={**os.environ, **threads, **own},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        """Ends the server."""
        self._server.communicate()

    def run(self, tests: list[str], seconds: float) -> tuple[int, float]:
        """Pytest's exit code for some tests (124 where the time was up), and the seconds of the
        processor."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(json.dumps({"tests": tests, "seconds": seconds}) + "\n")
        self._server.stdin.flush()
        line = self._server.stdout.readline()
        if not line:
            raise RuntimeError("the server has ended; what it said stands above")
        code, used = json.loads(line)
        return code, used

    @property
    def said(self) -> str:
        """What pytest said last."""
        return (self.root / "said.txt").read_text(encoding="utf-8", errors="replace")

    def passes(self, faults: Iterable[Fault]) -> bool:
        """Whether the tests that faults name pass where there is none; says which do not."""
        tests = sorted({test for fault in faults for test in fault.tests})
        code, used = self.run(tests, LONGEST * len(tests))
        print(f"{len(tests)} tests without a fault: {used:.0f} s", flush=True)
        if code:
            print(self.said)
        return code == 0

    def judge(self, fault: Fault, number: int) -> Outcome:
        """What the tests of a fault say of it."""
        with self.planted(fault, number):
            code, used = self.run(fault.tests, LONGEST)
        killed, words, milliseconds = False, f"SURVIVED: no end within {LONGEST:g} s", math.nan
        if code == FAILED:
            left, milliseconds = self._passed()
            killed, words = not left, f"SURVIVED in {left}" if left else "killed"
        elif code != TIME_UP:
            words = f"SURVIVED: {(self.said.strip().splitlines() or ['no word'])[-1]}"
        return Outcome(fault, killed, words, milliseconds, used)

    @contextlib.contextmanager
    def planted(self, fault: Fault, number: int) -> Iterator[None]:
        """Puts a fault into the copy for a while. Compiled files are looked up by their source's
        time and size, so every fault has a time of its own, and the old text its old one."""
        path, text = self.root / fault.file, fault.applied(self.root)
        kept, stamp = path.read_bytes(), path.stat().st_mtime
        path.write_text(text, encoding="utf-8")
        os.utime(path, times=(stamp + 2 * number + 2,) * 2)
        try:
            yield
        finally:
            path.write_bytes(kept)
            os.utime(path, times=(stamp,) * 2)

    def _passed(self) -> tuple[int, float]:
        """How many of the last tests did not fail, and the milliseconds that all of them took."""
        suite = ElementTree.parse(self.root / "report.xml").getroot().find("testsuite")
        assert suite is not None
        tests, failures, errors = (
            int(suite.attrib[name]) for name in ("tests", "failures", "errors")
        )
        return tests - failures - errors, 1e3 * sum(
            float(case.attrib["time"]) for case in suite.iter("testcase")
        )


def main() -> int:
    """All faults that the environment asks for; 1 where one survives, 2 where none was judged."""
    faults = read_faults()
    wrong = list(problems(faults))
    words = [word for word in os.environ.get("MUTANTS_NAMES", "").split(",") if word]
    chosen = [fault for fault in faults if not words or any(word in fault.name for word in words)]
    if wrong or not chosen:
        print(*(wrong or ["no fault has such a name"]), sep="\n")
        return 2
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(Path(folder))
        try:
            if not copy.passes(chosen):
                print("nothing was judged: these tests must pass where there is no fault")
                return 2
            return told(judged(copy, chosen), len(chosen))
        finally:
            copy.close()


def judged(copy: Copy, faults: Iterable[Fault]) -> Iterator[Outcome]:
    """The outcomes of faults, as many as are begun within the time that the environment gives."""
    ends = time.monotonic() + float(os.environ.get("MUTANTS_SECONDS", "inf"))
    for number, fault in enumerate(faults):
        if time.monotonic() > ends:
            break
        yield copy.judge(fault, number)


def told(outcomes: Iterable[Outcome], number: int) -> int:
    """Says what came out, a line a fault, and the survivors last; the exit code."""
    found = []
    for one in outcomes:
        found.append(one)
        print(one.row, flush=True)
    survivors = [one for one in found if not one.killed]
    print(f"{len(found)} of {number} faults were planted, {len(survivors)} survived")
    for one in survivors:
        print(f"  {one.fault.name}: {one.fault.why}")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main())
