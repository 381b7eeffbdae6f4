"""Faults that nobody thought of: cosmic-ray's, drawn by a seed from the statistical core.

    make drawn-mutants                                   40 of them
    MUTANTS_NUMBER=200 MUTANTS_SEED=3 make drawn-mutants
    MUTANTS_SECONDS=600 make drawn-mutants               as many as are begun in that time
    MUTANTS_NAMES=modes,verdict make drawn-mutants       of files whose names hold such a word

Each is planted in a copy, as ours are (`tests.mutants`), and is killed where one of the quick tests
of its file fails. Tests that do not end say nothing where the machine is busy: those faults are
listed apart. A survivor is either as good as the product (a bound that may be
generous, a message) or a hole; they are listed by file, with the line. The exit code is 0 as long
as there was something to judge: who reads the list decides."""

import difflib
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from tests.mutants import ROOT
from tests.mutants.__main__ import Copy
from tests.mutants.server import TIME_UP

BY_HAND = "tests/inference/test_importance_by_hand.py"
STATISTICS = "tests/inference/test_statistics_by_hand.py"
ROOTS = "tests/inference/test_uncertain_root.py"
COMPARISON = "tests/inference/test_comparison.py"
CALIBRATION = "tests/inference/test_calibration.py"
CORE: dict[str, tuple[str, ...]] = {
    "inference/importance/weighted.py": (BY_HAND, ROOTS),
    "inference/importance/rejection.py": (
        BY_HAND,
        "tests/inference/test_uncertain_rejection.py",
    ),
    "inference/importance/two_stage.py": (
        BY_HAND,
        "tests/inference/test_uncertain_two_stage.py",
        ROOTS,
    ),
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
LONGEST = 300.0
"""Seconds after which tests are given up."""
KILLED = "killed"
OUTCOMES = {0: "SURVIVED", TIME_UP: "no end"}
"""What the exit codes of tests say of a fault; any other one killed it."""
QUICK = ("-x", "-m", "not slow and not sweep")
"""What pytest is told beside."""


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


def main() -> int:
    """Draws, plants, tells."""
    number = int(os.environ.get("MUTANTS_NUMBER", "40"))
    seed = int(os.environ.get("MUTANTS_SEED", "0"))
    ends = time.monotonic() + float(os.environ.get("MUTANTS_SECONDS", "inf"))
    words = os.environ.get("MUTANTS_NAMES", "").split(",")
    files = [file for file in CORE if any(word in file for word in words)]
    every = [one for file in files for one in all_of(file)]
    chosen = random.Random(seed).sample(every, min(number, len(every)))
    said: dict[Drawn, str] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(Path(folder))
        try:
            for count, fault in enumerate(chosen):
                if time.monotonic() > ends:
                    break
                with copy.planted(fault, count):
                    code, used = copy.run([*CORE[fault.file], *QUICK], LONGEST)
                said[fault] = OUTCOMES.get(code, KILLED)
                print(f"{fault.file} | {fault.line} | {said[fault]} | {used:.0f} s", flush=True)
        finally:
            copy.close()
    counted = (f"{number} {word}" for word, number in Counter(said.values()).items())
    print(f"{len(said)} of {len(every)} were planted: {', '.join(counted)}")
    for file in files:
        own = {fault: word for fault, word in said.items() if fault.file == file}
        killed = [*own.values()].count(KILLED)
        print(f"{file}: {killed} of {len(own)} killed")
        for one, word in own.items():
            if word != KILLED:
                print(f"    {word}: {one.line}")
    return 0 if said else 2


if __name__ == "__main__":
    sys.exit(main())
