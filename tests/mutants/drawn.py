"""Faults that nobody thought of: cosmic-ray's, drawn by a seed from the statistical core.

    make drawn-mutants                                   40 of them
    MUTANTS_NUMBER=200 MUTANTS_SEED=3 make drawn-mutants
    MUTANTS_SECONDS=600 make drawn-mutants               as many as are begun in that time
    MUTANTS_NAMES=modes,verdict make drawn-mutants       of files whose names hold such a word
    MUTANTS_SLOW=1 make drawn-mutants                    the slow tests see what quick ones do not
    MUTANTS_EARLIER=37fc945 make drawn-mutants           tests that this commit had go first
    MUTANTS_SAID=said.txt make drawn-mutants             goes on where a run ended that said this

Each is planted in a copy, as ours are (`tests.mutants`), and is seen where a test of its file
fails, or where the tests take many times the processor's seconds that they should. What sees a
fault must pass without it. Tests that an earlier commit had are those of today by its names. A
survivor is either as good as the product (a bound that may be generous, a message) or a hole; they
are listed by file, with the line. The exit code is 0 as long as there was something to judge: who
reads the list decides."""

import difflib
import functools
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from tests.mutants import ROOT, tests_of
from tests.mutants.__main__ import Copy
from tests.mutants.server import TIME_UP

BY_HAND = "tests/inference/test_importance_by_hand.py"
STATISTICS = "tests/inference/test_statistics_by_hand.py"
ORACLE = "tests/inference/test_oracle.py"
ROOTS = "tests/inference/test_uncertain_root.py"
LIMBS = "tests/inference/test_uncertain_limbs.py"
TWO_STAGE = "tests/inference/test_uncertain_two_stage.py"
REJECTION = "tests/inference/test_rejection.py"
STRATA = "tests/inference/test_strata.py"
COMPARISON = "tests/inference/test_comparison.py"
CALIBRATION = "tests/inference/test_calibration.py"
ERRORS = ("tests/probmodel/test_errorlaws.py", "tests/probmodel/test_likelihood.py")
DIRECTIONS = ("tests/probmodel/test_distributions.py", "tests/probmodel/test_regions.py")
CORE: dict[str, tuple[str, ...]] = {
    "probmodel/errors/laws.py": (*ERRORS, ORACLE),
    "probmodel/errors/likelihood.py": (*ERRORS, ORACLE),
    "probmodel/errors/faults.py": (*ERRORS, "tests/inference/test_uncertain_faults.py", ORACLE),
    "probmodel/directions/cells.py": DIRECTIONS,
    "probmodel/directions/hinges.py": DIRECTIONS,
    "probmodel/root_priors.py": (BY_HAND, "tests/probmodel/test_posterior.py", ROOTS),
    "inference/exact/mixture.py": (REJECTION, STRATA, ORACLE),
    "inference/exact/rates.py": (REJECTION, STRATA, ORACLE),
    "inference/exact/groups.py": (REJECTION, STRATA, ORACLE),
    "inference/films/coupling.py": ("tests/inference/test_films.py",),
    "inference/films/sides.py": ("tests/inference/test_sides.py",),
    "inference/importance/views/weighted.py": ("tests/inference/test_views.py",),
    "inference/importance/weighted.py": (BY_HAND, ROOTS),
    "inference/importance/rejection.py": (BY_HAND, "tests/inference/test_uncertain_rejection.py"),
    "inference/importance/two_stage.py": (BY_HAND, TWO_STAGE, ROOTS),
    "inference/importance/fault_patterns.py": (BY_HAND, TWO_STAGE, ORACLE),
    "inference/importance/limbs.py": (BY_HAND, LIMBS, TWO_STAGE, ORACLE),
    "inference/importance/torso_proposals.py": (
        BY_HAND,
        "tests/inference/test_uncertain_gaussian.py",
        ROOTS,
    ),
    "inference/resampling.py": (STATISTICS, ROOTS, "tests/inference/test_benchmark.py"),
    "inference/studies/comparison/modes.py": (STATISTICS, COMPARISON),
    "inference/studies/comparison/mixing.py": (STATISTICS, COMPARISON),
    "inference/studies/comparison/permutation.py": (STATISTICS, COMPARISON),
    "inference/studies/comparison/power.py": (STATISTICS, COMPARISON),
    "inference/studies/comparison/ranks.py": (STATISTICS, COMPARISON),
    "inference/studies/calibration/uniformity.py": (STATISTICS, CALIBRATION),
    "inference/studies/calibration/verdict.py": (STATISTICS, CALIBRATION),
}
"""Files, and the tests that should see what is wrong with them, quick ones first."""
DULL = ("Decorator", "Number", "NoOp", "Bit", "Shift", "Floor", "Mod", "Pow", "Is", "_Not")
"""What is in the names of operators whose faults say little: of caches and tuning constants, or
that no array survives, whatever tests look at."""
QUICK, SLOW = "not slow and not sweep", "slow and not sweep"
"""What pytest takes for the marks of tests."""
LONGEST = {QUICK: 200.0, SLOW: 900.0}
"""Seconds of the processor after which tests are given up: several times what those of any file
take."""
PASSED = (0, 5)
"""Pytest's exit codes where all tests passed, and where there was none."""
UNSEEN = "not seen"
"""What is said where no test sees a fault."""
NO_END = "no end"
"""What saw a fault under which tests do not end, or their process dies."""


class Drawn(NamedTuple):
    """A fault: an operator of cosmic-ray at its so manyth place in a file."""

    file: str
    operator: str
    occurrence: int

    def applied(self, root: Path) -> str:
        """The file's text with the fault."""
        text = (root / self.file).read_text(encoding="utf-8")
        return mutate_code(text, get_operator(self.operator)(), self.occurrence)

    @property
    def line(self) -> str:
        """What stands there now, and what did."""
        before = (ROOT / self.file).read_text(encoding="utf-8").splitlines()
        after = self.applied(ROOT).splitlines()
        changed = [line for line in difflib.ndiff(before, after) if line[:2] in ("- ", "+ ")]
        return " → ".join(line[2:].strip() for line in changed[:2])


class Stage(NamedTuple):
    """Tests that faults are shown to together: the name, the marks, and by file of the core what
    pytest is to run."""

    name: str
    marks: str
    tests: Mapping[str, tuple[str, ...]]

    def sees(self, copy: Copy, fault: Drawn, number: int) -> str:
        """The first test that sees a fault, or `UNSEEN`."""
        with copy.planted(fault, number):
            test = _failing(copy, self.marks, self.tests[fault.file])
        if test not in (UNSEEN, NO_END):
            _require_passed(copy, self.marks, test)
        return test


@functools.cache
def _require_passed(copy: Copy, marks: str, test: str) -> None:
    """Raises `RuntimeError` where a test fails without a fault."""
    if _failing(copy, marks, (test,)) != UNSEEN:
        raise RuntimeError(f"{test} does not pass where there is no fault")


def _failing(copy: Copy, marks: str, tests: tuple[str, ...]) -> str:
    """The first of some tests that fails, or `UNSEEN`. Raises `RuntimeError` where pytest says
    anything else."""
    report = copy.root / "report.xml"
    report.unlink(missing_ok=True)
    code, _ = copy.run(["-x", "-m", marks, *tests], LONGEST[marks]) if tests else (0, 0.0)
    if code in PASSED:
        return UNSEEN
    if code == TIME_UP or code < 0:
        return NO_END
    for case in ElementTree.parse(report).iter("testcase"):
        if case.find("failure") is not None or case.find("error") is not None:
            return _named(case.get("classname"), case.get("name") or "")
    raise RuntimeError(copy.said)


def _named(module: str | None, name: str) -> str:
    """A test of a module, or a file of tests that could not be read, as pytest names them."""
    path = (module or name).replace(".", "/") + ".py"
    return f"{path}::{name}" if module else path


def all_of(file: str) -> list[Drawn]:
    """Every fault of a file."""
    nodes = list(ast_nodes(get_ast((ROOT / file).read_text(encoding="utf-8"))))
    found = []
    for name in operator_names():
        kind = get_operator(name)
        if kind.arguments() or any(word in name for word in DULL):
            continue
        places = sum(1 for node in nodes for _ in kind().mutation_positions(node))
        found += [Drawn(file, name, place) for place in range(places)]
    return found


def stages(earlier: str, slow: bool) -> list[Stage]:
    """What faults are shown to, one after the other: quick tests by names that a commit had, if one
    is given; all others; and slow ones, if they are wanted."""
    had: set[str] = set()
    found = []
    if earlier:
        command = ["git", "grep", "-h", "^def test_", earlier, "--", "tests"]
        lines = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        had = {line.removeprefix("def ").partition("(")[0] for line in lines.splitlines()}
        found.append(Stage(f"quick tests of {earlier}", QUICK, _tests(had.__contains__)))
    found.append(Stage("quick tests", QUICK, _tests(lambda name: name not in had)))
    return [*found, Stage("all tests", SLOW, CORE)] if slow else found


def _tests(wanted: Callable[[str], bool]) -> dict[str, tuple[str, ...]]:
    """By file of the core, the tests of wanted names."""
    return {
        file: tuple(
            f"{path}::{name}"
            for path in paths
            for name in tests_of(ROOT / path)
            if name.startswith("test_") and wanted(name)
        )
        for file, paths in CORE.items()
    }


def main() -> int:
    """Draws, plants, tells."""
    number = int(os.environ.get("MUTANTS_NUMBER", "40"))
    seed = int(os.environ.get("MUTANTS_SEED", "0"))
    ends = time.monotonic() + float(os.environ.get("MUTANTS_SECONDS", "inf"))
    words = os.environ.get("MUTANTS_NAMES", "").split(",")
    shown = stages(os.environ.get("MUTANTS_EARLIER", ""), "MUTANTS_SLOW" in os.environ)
    files = [file for file in CORE if any(word in file for word in words)]
    every = [one for file in files for one in all_of(file)]
    chosen = random.Random(seed).sample(every, min(number, len(every)))
    said: dict[Drawn, list[str]] = {fault: [] for fault in chosen}
    before = _said_before(os.environ.get("MUTANTS_SAID", os.devnull))
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(Path(folder))
        try:
            for stage in shown:
                for count, (fault, tests) in enumerate(said.items()):
                    if _seen(tests) or time.monotonic() > ends:
                        continue
                    about = f"{stage.name} | {fault.file} | {fault.line}"
                    word = before.get(about) or stage.sees(copy, fault, count)
                    print(f"{about} | {word}", flush=True)
                    tests.append(word)
        finally:
            copy.close()
    return told(shown, {fault: tests for fault, tests in said.items() if tests}, len(every))


def _seen(words: list[str]) -> bool:
    return any(word != UNSEEN for word in words)


def _said_before(path: str) -> dict[str, str]:
    """What a run has said of faults, by stage, file and line."""
    rows = (line.rpartition(" | ") for line in Path(path).read_text(encoding="utf-8").splitlines())
    return {about: word for about, _, word in rows}


def told(shown: list[Stage], said: Mapping[Drawn, list[str]], number: int) -> int:
    """Says how many faults were seen, by file and in all, and what survived; the exit code."""
    print(" | ".join(["file", "faults", *(f"seen by {stage.name}" for stage in shown)]))
    for file in [*CORE, ""]:
        own = [tests for fault, tests in said.items() if fault.file.startswith(file)]
        seen = [sum(_seen(tests[: count + 1]) for tests in own) for count in range(len(shown))]
        if own:
            print(" | ".join([file or f"of {number}", str(len(own)), *map(str, seen)]))
    for fault, tests in said.items():
        if not _seen(tests):
            print(f"SURVIVED {shown[len(tests) - 1].name} | {fault.file} | {fault.line}")
    return 0 if said else 2


if __name__ == "__main__":
    sys.exit(main())
