"""Every notebook runs to its end from a fresh folder, small, with warnings as errors, and is stored
without outputs."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
STRICT = """
import warnings
warnings.simplefilter("error")
# ipykernel warns of itself when it shuts down: its own shell does not yet do what it asks of
# others.
warnings.filterwarnings("ignore", category=PendingDeprecationWarning, module="ipykernel")
"""


def load(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def run(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    notebook.cells.insert(0, nbformat.v4.new_code_cell(STRICT, id="strict"))
    client = NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    return client.execute()


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path: Path) -> None:
    notebook = load(path)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # of nbclient and zmq in this process; the kernel is strict
def test_notebook_runs(
    path: Path, cache: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSETERIOR_SMALL", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = run(load(path), tmp_path)
    shown = [
        output for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output
    ]
    assert any("image/png" in output.data for output in shown)


def test_a_warning_in_a_notebook_fails_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    cell = nbformat.v4.new_code_cell("import warnings\nwarnings.warn('look', stacklevel=1)")
    with pytest.raises(Exception, match="look"):
        run(nbformat.v4.new_notebook(cells=[cell]), tmp_path)
