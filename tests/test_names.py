"""One meaning a name: constants and classes at the top of a module, over the whole house.

A class has its name alone. So has a constant that other files import. One that is its file's own
may have a namesake of another value in one file more, and in no third. What has one value in
several files has one meaning."""

import ast
import functools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("probmodel", "inference", "reports")
CONVENTIONAL = {
    "_ADVICE": "what the refusals of a file's reader advise",
    "_WHAT": "what a file's reader calls it",
    "_KEYS": "the names that a reader or writer asks for in its own format",
}
"""Constants that may have several meanings, and why."""
NOT_YET = frozenset(
    [
        "BLOCK",
        "EXCHANGES",
        "Fit",
        "LEVELS",
        "LIMITS",
        "NAMES",
        "ROOTED",
        "SAMPLERS",
        "SMALLEST",
        "UNITS",
    ]
)
"""Names that still have several meanings; none may be added."""


class Use(NamedTuple):
    """A name at the top of a file: what it is, as it is written there."""

    file: str
    name: str
    value: str


def constants_of(file: str, tree: ast.Module) -> Iterator[Use]:
    """Names in capitals that are assigned at the top of a module."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            pairs = [pair for target in node.targets for pair in _pairs(target, node.value)]
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            pairs = [(node.target, node.value)]
        else:
            continue
        for target, value in pairs:
            if isinstance(target, ast.Name) and target.id.strip("_").isupper():
                yield Use(file, target.id, ast.unparse(value))


def _pairs(target: ast.expr, value: ast.expr) -> Iterable[tuple[ast.expr, ast.expr]]:
    if not isinstance(target, ast.Tuple):
        return [(target, value)]
    if isinstance(value, ast.Tuple) and len(value.elts) == len(target.elts):
        return zip(target.elts, value.elts, strict=True)
    return [(part, value) for part in target.elts]


def classes_of(file: str, tree: ast.Module) -> Iterator[Use]:
    """Classes at the top of a module; each is another one."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield Use(file, node.name, file)


def imported_by(tree: ast.Module) -> set[tuple[str, str]]:
    """Files and names that a module imports from ours, by `from … import …`."""
    return {
        (node.module.removeprefix("poseterior.").replace(".", "/"), alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("poseterior.")
        for alias in node.names
    }


def twins(uses: Iterable[Use]) -> dict[str, list[Use]]:
    """By name, the files that give it different values."""
    named: dict[str, list[Use]] = defaultdict(list)
    for use in uses:
        named[use.name].append(use)
    return {name: found for name, found in named.items() if len({use.value for use in found}) > 1}


def offenders(trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    """Names that have more meanings than they may, with the files that give them one."""
    imported = set().union(*(imported_by(tree) for tree in trees.values()))
    found = twins(use for file, tree in trees.items() for use in classes_of(file, tree))
    constants = twins(use for file, tree in trees.items() for use in constants_of(file, tree))
    for name, uses in constants.items():
        shared = any((Path(use.file).with_suffix("").as_posix(), name) in imported for use in uses)
        if name not in CONVENTIONAL and (shared or len(uses) > 2):
            found[name] = uses
    return {name: sorted(use.file for use in uses) for name, uses in found.items()}


@functools.cache
def house() -> dict[str, ast.Module]:
    return {
        path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


@functools.cache
def offenders_here() -> dict[str, list[str]]:
    return offenders(house())


def test_a_name_has_one_meaning() -> None:
    found = offenders_here()
    new = {name: files for name, files in found.items() if name not in NOT_YET}
    assert not new, "\n".join(f"{name}: {', '.join(files)}" for name, files in new.items())


def test_what_is_excused_needs_to_be() -> None:
    """An excuse that nobody needs any more is taken out of the lists."""
    found = offenders_here()
    assert sorted(NOT_YET - set(found)) == []
    every = {use.name for file, tree in house().items() for use in constants_of(file, tree)}
    assert set(CONVENTIONAL) <= every


@pytest.mark.parametrize(
    "sources",
    [
        {"a": "class Draws: ...", "b": "class Draws: ..."},
        {"a": "MOST = 1", "b": "MOST = 2", "c": "from poseterior.a import MOST"},
        {"a": "MOST = 1", "b": "MOST: int = 2", "c": "FEW, MOST = 3, 3"},
    ],
)
def test_a_name_of_several_meanings_is_caught(sources: dict[str, str]) -> None:
    trees = {f"{file}.py": ast.parse(text) for file, text in sources.items()}
    assert offenders(trees)


@pytest.mark.parametrize(
    "sources",
    [
        {"a": "class Draws: ...", "b": "class _Draws: ..."},
        {"a": "MOST = 1", "b": "MOST = 1", "c": "from poseterior.a import MOST"},
        {"a": "MOST = 1", "b": "MOST = 2", "c": "def most():\n    MOST = 3"},
        {"a": "most = 1", "b": "most = 2", "c": "most = 3"},
    ],
)
def test_a_name_of_one_meaning_passes(sources: dict[str, str]) -> None:
    trees = {f"{file}.py": ast.parse(text) for file, text in sources.items()}
    assert not offenders(trees)
