"""`import poseterior`: every name is there and is the original, the import is light, and packages
of other people that are called as ours are within stand beside it."""

import importlib
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import jax
import pytest

import poseterior
from poseterior import inference, probmodel
from poseterior.probmodel.example import example

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


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("import poseterior, jax", "True"),
        ("import jax, poseterior", "True"),
        ("import os; os.environ['JAX_ENABLE_X64'] = '0'; import poseterior, jax", "False"),
    ],
)
def test_doubles_are_switched_on_unless_the_environment_says_no(
    tmp_path: Path, before: str, after: str
) -> None:
    clean = "import os; os.environ.pop('JAX_ENABLE_X64', 0)"
    code = f"{clean}\n{before}\nprint(jax.config.jax_enable_x64)"
    done = python(code, ROOT, cwd=tmp_path)
    assert done.stdout.strip() == after, done.stderr


def test_a_number_is_a_key_and_single_precision_is_refused() -> None:
    from poseterior.inference.draws import key_of, key_words

    assert key_words(key_of(7)) == key_words(key_of(jax.random.key(7)))
    with jax.enable_x64(False), pytest.raises(poseterior.BadInput, match="64-bit floats"):
        key_of(7)
    for wrong in (1.5, "seed", None):
        with pytest.raises(poseterior.BadInput, match="a key is a whole number"):
            key_of(wrong)


def test_arguments_of_sample_in_another_order_are_said() -> None:
    with pytest.raises(poseterior.BadInput, match="the prior of poses comes first"):
        poseterior.sample(example().detection, poseterior.PoseModel, key=0)


def test_a_detection_is_estimated_on_the_way() -> None:
    from poseterior.inference.sampler import estimated

    detection = example().detection
    frame = estimated(detection)
    assert frame.detection is detection
    assert estimated(frame) is frame
    for wrong in ([detection], "frame.json", detection.keypoints, None, poseterior.PoseModel):
        with pytest.raises(poseterior.BadInput, match=r"read_detections\(path\)\[0\]"):
            estimated(wrong)
