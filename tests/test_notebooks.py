"""Every notebook runs to its end from a fresh folder, small, with warnings as errors; its stored
outputs are small, show its pictures, and are not stale."""

from pathlib import Path

import nbformat
import pytest

from tests.notebooks import execute, fingerprint, is_stale, load, names, product

NOTEBOOKS = names()
LARGEST = 1_900_000
"""Bytes of all notebooks together."""


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stored_and_not_stale(path: Path) -> None:
    notebook = load(path)
    nbformat.validate(notebook)
    shown = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    assert any("image/png" in one.get("data", {}) for one in shown)
    assert not [one for one in shown if "/tmp" in str(one.get("text", ""))]
    assert not [one for one in shown if one.output_type == "error" or one.get("name") == "stderr"]
    assert not is_stale(path, product()), f"{path.name} has changed: run `make notebooks`"


def test_notebooks_are_small() -> None:
    assert sum(path.stat().st_size for path in NOTEBOOKS) < LARGEST


def test_another_cell_or_product_makes_outputs_stale() -> None:
    notebook = load(NOTEBOOKS[0])
    one = fingerprint(notebook, "a product")
    assert fingerprint(notebook, "another") != one
    code = next(cell for cell in notebook.cells if cell.cell_type == "code")
    code.source += "\nx = 1"
    assert fingerprint(notebook, "a product") != one
    words = nbformat.v4.new_markdown_cell("words")
    spoken = nbformat.v4.new_notebook(cells=[*notebook.cells, words])
    assert fingerprint(spoken, "a product") == fingerprint(notebook, "a product")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # of nbclient and zmq in this process; the kernel is strict
def test_notebook_runs(
    path: Path, cache: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSETERIOR_SMALL", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = execute(load(path), tmp_path)
    shown = [
        output for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output
    ]
    assert any("image/png" in output.data for output in shown)


@pytest.mark.slow
def test_a_warning_in_a_notebook_fails_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    cell = nbformat.v4.new_code_cell("import warnings\nwarnings.warn('look', stacklevel=1)")
    with pytest.raises(Exception, match="look"):
        execute(nbformat.v4.new_notebook(cells=[cell]), tmp_path)
