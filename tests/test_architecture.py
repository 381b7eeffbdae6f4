"""Which package may know which: probmodel ← inference ← reports, `poseterior` names what the first
two export, nobody knows the tests; and what importing costs."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("probmodel", "inference", "reports", "poseterior")
FORBIDDEN = {
    "probmodel": {"inference", "reports", "poseterior", "tests"},
    "inference": {"reports", "poseterior", "tests"},
    "reports": {"poseterior", "tests"},
    "poseterior": {"reports", "tests"},
}
"""By package, the others that it must not import."""
FILES = [
    path.relative_to(ROOT)
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
]
COMMAND = Path("poseterior", "__main__.py")
"""The door of the command, which is one of the reports'."""


def imported(source: str, package: str = "") -> set[str]:
    """Packages that a source imports anywhere, inside functions and by name too: one of ours by its
    own name, without `poseterior.` in front."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {_package(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level:
            found.add(package)
        elif isinstance(node, ast.ImportFrom) and node.module == "poseterior":
            found |= {_package(f"poseterior.{alias.name}") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(_package(node.module or ""))
        elif isinstance(node, ast.Call) and _imports_by_name(node.func):
            found |= {
                _package(str(arg.value)) for arg in node.args if isinstance(arg, ast.Constant)
            }
    return found


def _package(module: str) -> str:
    first, _, rest = module.partition(".")
    second = rest.partition(".")[0]
    return second if first == "poseterior" and second in FORBIDDEN else first


def _imports_by_name(function: ast.expr) -> bool:
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    return name in ("import_module", "__import__")


def offences(source: str, package: str) -> set[str]:
    """What a file of `package` imports and must not."""
    return imported(source, package) & FORBIDDEN[package]


def waited_for(source: str, own: str) -> set[str]:
    """Modules of ours that the module `own` imports while it is imported itself: those named at the
    top, and the packages around them that are not around `own` as well."""
    found = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    around = {
        ".".join(parts[:depth])
        for parts in (name.split(".") for name in found)
        for depth in range(2, len(parts) + 1)
    }
    return {name for name in around if not f"{own}.".startswith(f"{name}.")}


def module_of(path: Path) -> str:
    """The name of a file's module, or of its package."""
    parts = path.with_suffix("").parts
    return ".".join(["poseterior", *(parts[:-1] if parts[-1] == "__init__" else parts)])


def circle(sources: dict[str, str]) -> list[str]:
    """Modules that wait for each other, the first ones that are found."""
    graph = {own: waited_for(source, own) & sources.keys() for own, source in sources.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_module_waits_for_itself() -> None:
    """So that each can be imported first. The control is a circle that was here."""
    files = [path for path in FILES if path.parts[0] != "poseterior"]
    assert not circle({module_of(path): (ROOT / path).read_text("utf-8") for path in files})
    package = "poseterior.inference.studies.calibration"
    there = {
        "poseterior.inference.studies.measured": f"from {package}.levels import rank_level",
        package: f"from {package}.assess import assess",
        f"{package}.levels": "",
        f"{package}.assess": "from poseterior.inference.studies.measured import standings_of",
    }
    assert len(circle(there)) == 4


def test_there_are_files_to_look_at() -> None:
    assert {path.parts[0] for path in FILES} == set(PACKAGES)


@pytest.mark.parametrize("path", FILES, ids=str)
def test_dependencies_point_one_way(path: Path) -> None:
    package = "reports" if path == COMMAND else path.parts[0]
    found = offences((ROOT / path).read_text(encoding="utf-8"), package)
    assert not found, f"{path} imports {', '.join(sorted(found))}"


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("probmodel", "from poseterior import inference"),
        ("probmodel", "def late():\n    from poseterior.reports.console import say"),
        ("probmodel", "import numpy as np, poseterior.inference.sampler as s"),
        ("probmodel", "if TYPE_CHECKING:\n    from poseterior.inference import Frame"),
        ("probmodel", "importlib.import_module('poseterior.inference.sampler')"),
        ("inference", "from poseterior.reports import tables"),
        ("inference", "from tests.scenes import camera"),
        ("reports", "import tests.goodness"),
        ("probmodel", "import poseterior as pt"),
        ("poseterior", "from poseterior.reports.cli import main"),
    ],
)
def test_an_offender_is_caught(package: str, source: str) -> None:
    assert offences(source, package)


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("probmodel", "from poseterior.probmodel import limits\nimport numpy"),
        ("inference", "import poseterior.probmodel.anatomy.limits\n# import reports"),
        ("reports", "from poseterior.inference import sample\nwords = 'from tests import x'"),
        ("probmodel", "from . import limits"),
    ],
)
def test_the_innocent_pass(package: str, source: str) -> None:
    assert not offences(source, package)


@pytest.mark.parametrize("path", FILES, ids=str)
def test_every_module_says_what_it_is(path: Path) -> None:
    assert ast.get_docstring(ast.parse((ROOT / path).read_text(encoding="utf-8"))), (
        f"{path} has no docstring"
    )


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[0] != "reports"], ids=str)
def test_messages_to_python_users_speak_python(path: Path) -> None:
    """An option is named only where it is said to be one of the command line."""
    assert list(foreign((ROOT / path).read_text(encoding="utf-8"))) == []


def foreign(source: str) -> Iterator[str]:
    """Texts of `raise` statements that name options of the command line as if there were nothing
    else."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Raise):
            texts = [str(part.value) for part in ast.walk(node) if isinstance(part, ast.Constant)]
            said = "".join(texts)
            if re.search(r"(^|[ (])--[a-z]", said) and "command line" not in said:
                yield said


def test_a_message_that_speaks_of_options_is_caught() -> None:
    assert list(foreign("raise BadInput(f'{name} is unknown; choose another --person')"))
    assert not list(foreign("raise BadInput('give one (on the command line --person 1)')"))


def test_the_command_line_starts_without_jax() -> None:
    heavy = ("jax", "numpyro", "scipy", "xarray", "matplotlib", "sklearn")
    code = (
        "import sys, poseterior.reports.cli\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_a_refusal_waits_for_nothing_heavy(tmp_path: Path) -> None:
    """One command after the other in one process: none has loaded anything heavy."""
    refused = [
        "hypotheses no.json",
        "sample no.json",
        "show no.json",
        "compare no.json",
        "frames none",
        "check no.bvh",
        "learn none",
        "hypotheses --no-such-option",
    ]
    code = f"""
import sys
from poseterior.reports.cli import main
for words in {refused}:
    sys.argv[1:] = words.split()
    try:
        main()
    except SystemExit as ended:
        print(words, ended.code)
heavy = ("jax", "numba", "numpyro", "arviz", "matplotlib", "sklearn", "xarray")
print([name for name in heavy if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == [*(f"{words} 2" for words in refused), "[]"], done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("root", ["uncertain", pytest.param("fixed", marks=pytest.mark.sweep)])
def test_the_main_job_waits_for_no_more_than_it_needs(tmp_path: Path, root: str) -> None:
    """The second call, which finds all programs: NumPyro, ArviZ, scikit-learn, `scipy.stats` and
    Dask, which xarray imports where it is installed, take seconds to import, and nothing that it
    does needs them."""
    heavy = (
        "numpyro",
        "arviz",
        "dask",
        "sklearn",
        "scipy.stats",
        "scipy.optimize",
        "poseterior.inference.stream",
    )
    code = f"""
import sys
from poseterior.reports import cli
cli.signals.depart = sys.exit
try:
    cli.command()
finally:
    print([name for name in {heavy} if sys.modules.get(name)], file=sys.stderr)
"""
    skier = str(ROOT / "examples" / "skier.json")
    words = ("hypotheses", skier, "--root", root, "--quiet", "--out", "out")
    said = []
    for programs in (str(tmp_path), str(tmp_path), ""):
        done = subprocess.run(
            [sys.executable, "-c", code, *words],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT), "POSETERIOR_PROGRAMS": programs},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stderr.splitlines()[-1])
    assert said[1] == "[]"
    assert said[2] == "['numpyro']"  # the control: without kept programs it traces, by NumPyro


@pytest.mark.slow
@pytest.mark.parametrize("first", ["poseterior.probmodel.programs", "jax"])
def test_tracing_compiles_nothing_anew(first: str) -> None:
    """NumPyro, imported after JAX has compiled something, has it compiled again: so where programs
    are traced it comes with the model, and not with the first trace. The control is without."""
    code = f"""
import {first}, jax
twice = jax.jit(lambda x: x + x)
twice(1.0)
import poseterior.probmodel.anatomy.lengths
twice(1.0)
print(twice._cache_size())
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1" if first == "poseterior.probmodel.programs" else "2"]


def test_types_are_declared() -> None:
    assert (ROOT / "poseterior" / "py.typed").exists()


def by_bare_name(source: str) -> set[str]:
    """Our packages that a source imports without `poseterior.`: as a second copy of themselves."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add((node.module or "").partition(".")[0])
    return found & {"probmodel", "inference", "reports"}


def test_nothing_is_imported_twice_under_two_names() -> None:
    tests = sorted((ROOT / "tests").rglob("*.py"))
    for path in [*(ROOT / file for file in FILES), *tests]:
        assert not by_bare_name(path.read_text(encoding="utf-8")), path
    assert by_bare_name("import os\nfrom inference.sampler import sample") == {"inference"}
