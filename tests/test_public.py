"""`import poseterior`: every name is there and is the original, the import is light, and packages
of other people that are called as ours are within stand beside it."""

import importlib
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import poseterior
from poseterior import inference, probmodel

ROOT = Path(__file__).parents[1]


def python(code: str, *path: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Runs Python in another folder with these folders on its path, first to last."""
    folders = [str(folder) for folder in path]
    code = f"import sys; sys.path[:0] = {folders}\n{code}"
    return subprocess.run(
        [sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, check=False
    )


def homes(name: str) -> list[object]:
    """What the modules that export a name have under it."""
    modules = map(importlib.import_module, poseterior._HOMES)
    return [getattr(module, name) for module in modules if name in module.__all__]


@pytest.mark.parametrize("name", poseterior.__all__)
def test_every_name_is_the_original(name: str) -> None:
    if name == "__version__":
        assert poseterior.__version__ == metadata.version("poseterior")
        return
    (original,) = homes(name)
    assert getattr(poseterior, name) is original


def test_what_the_packages_export_is_all_there() -> None:
    assert {*probmodel.__all__, *inference.__all__} <= {*poseterior.__all__}
    assert dir(poseterior) == sorted(poseterior.__all__)


def test_another_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'poseterior' has no attribute 'smaple'"):
        poseterior.smaple  # noqa: B018


def test_the_import_brings_nothing_along(tmp_path: Path) -> None:
    heavy = ("jax", "numpy", "numba", "numpyro", "scipy", "xarray", "poseterior.probmodel")
    code = f"import poseterior; print([name for name in {heavy} if name in sys.modules])"
    assert python(code, ROOT, cwd=tmp_path).stdout.strip() == "[]"


def test_the_version_brings_nothing_along(tmp_path: Path) -> None:
    heavy = ("jax", "numpy", "numba", "scipy", "xarray", "matplotlib")
    code = (
        "from poseterior.reports.cli import main; sys.argv[1:] = ['--version']\n"
        "try: main()\n"
        f"finally: print([name for name in {heavy} if name in sys.modules])"
    )
    assert python(code, ROOT, cwd=tmp_path).stdout.splitlines()[1] == "[]"


@pytest.mark.parametrize("name", ["inference", "probmodel", "reports"])
def test_a_stranger_of_our_name_stands_beside_us(tmp_path: Path, name: str) -> None:
    """The index has an `inference` of its own, which many people have installed."""
    (tmp_path / "strange" / name).mkdir(parents=True)
    (tmp_path / "strange" / name / "__init__.py").write_text("OURS = False\n")
    code = (
        f"import {name}, poseterior.{name}\n"
        f"print({name}.OURS, poseterior.{name}.__doc__ is not None)"
    )
    done = python(code, tmp_path / "strange", ROOT, cwd=tmp_path)
    assert done.stdout.split() == ["False", "True"], done.stderr
