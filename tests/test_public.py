"""`import poseterior`: every name is there and is the original, the import is light, and a stranger
of the name of one of our packages is told apart."""

import importlib
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import inference
import poseterior
import probmodel

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
    heavy = ("jax", "numpy", "numba", "numpyro", "scipy", "xarray", "probmodel", "inference")
    code = f"import poseterior; print([name for name in {heavy} if name in sys.modules])"
    assert python(code, ROOT, cwd=tmp_path).stdout.strip() == "[]"


def test_the_version_brings_nothing_along(tmp_path: Path) -> None:
    heavy = ("jax", "numpy", "numba", "scipy", "xarray", "matplotlib")
    code = (
        "from reports.cli import main; sys.argv[1:] = ['--version']\n"
        "try: main()\n"
        f"finally: print([name for name in {heavy} if name in sys.modules])"
    )
    assert python(code, ROOT, cwd=tmp_path).stdout.splitlines()[1] == "[]"


@pytest.mark.parametrize("name", ["inference", "probmodel"])
def test_a_stranger_of_our_name_is_told_apart(tmp_path: Path, name: str) -> None:
    (tmp_path / "strange" / name).mkdir(parents=True)
    (tmp_path / "strange" / name / "__init__.py").touch()
    done = python("import poseterior", tmp_path / "strange", ROOT, cwd=tmp_path)
    assert done.returncode == 1
    said = done.stderr.splitlines()[-1]
    assert said.startswith(f"ImportError: poseterior needs its own package '{name}'")
    assert "strange" in said
    assert "sys.path" in said


def test_without_our_packages_it_says_so(tmp_path: Path) -> None:
    (tmp_path / "poseterior").mkdir()
    (tmp_path / "poseterior" / "__init__.py").write_text(
        Path(poseterior.__file__).read_text(encoding="utf-8")
    )
    code = "sys.meta_path = [one for one in sys.meta_path if 'editable' not in repr(one)]\n"
    done = python(code + "import poseterior", tmp_path, cwd=tmp_path)
    assert "ImportError: poseterior needs its own package 'probmodel'" in done.stderr
