"""Faults planted in the product, each with the tests that must fail: `make mutants` (`__main__`).

The faults are data, a file of TOML a room of the house:

    [[fault]]
    name = "cell-area"
    why = "the mass of a cell is divided by the area of the hinge twice"
    file = "inference/exact/loops/strata.py"
    old = "geometry.mass /= cell.area"
    new = "geometry.mass /= cell.area**2"
    tests = ["tests/inference/test_strata.py::test_where_nothing_is_seen…[angle-area-False]"]

`old` occurs once in `file`, and every one of `tests` fails with `new` in its place. `slow = true`
says that one of them is a test of the slow run."""

import ast
import functools
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


class Fault(NamedTuple):
    """A text of a file that is replaced by another one, and the tests that notice."""

    name: str
    why: str
    file: str
    old: str
    new: str
    tests: list[str]
    slow: bool = False

    def applied(self, root: Path) -> str:
        """The file's text with the fault. Raises `ValueError` where the old text does not occur
        exactly once, or the new one says the same."""
        text = (root / self.file).read_text(encoding="utf-8")
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: its old text occurs {count} times in {self.file}")
        if self.old == self.new:
            raise ValueError(f"{self.name}: its new text is the old one")
        return text.replace(self.old, self.new)


def read_faults() -> list[Fault]:
    """All faults, file by file."""
    return [
        Fault(**entry)
        for path in sorted(HERE.glob("*.toml"))
        for entry in tomllib.loads(path.read_text(encoding="utf-8"))["fault"]
    ]


def problems(faults: list[Fault], root: Path = ROOT) -> Iterator[str]:
    """What is wrong with the faults as data, a sentence each: names that occur twice, texts that no
    longer apply, tests that are not there, and slow tests that are not called slow."""
    names = [fault.name for fault in faults]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"{name}: there are several faults of this name"
    for fault in faults:
        try:
            ast.parse(fault.applied(root))
        except (OSError, SyntaxError, ValueError) as error:
            yield str(error)
        known = [_slow(root, test) for test in fault.tests]
        if not known or None in known:
            yield f"{fault.name}: a test that it names does not exist"
        elif fault.slow != any(known):
            yield f"{fault.name}: slow must be {str(any(known)).lower()}"


def _slow(root: Path, test: str) -> bool | None:
    """Whether a test is one of the slow run, parameters marked one by one aside; None where there
    is no such test."""
    path, _, name = test.partition("::")
    return tests_of(root / path).get(name.partition("[")[0])


@functools.cache
def tests_of(path: Path) -> dict[str, bool]:
    """The functions of a file, and whether each is marked slow."""
    if not path.is_file():
        return {}
    return {
        node.name: any(ast.unparse(mark) == "pytest.mark.slow" for mark in node.decorator_list)
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
    }
