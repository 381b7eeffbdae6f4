"""Executes the notebooks and stores what they show: `make notebooks`.

    python -m tests.notebooks            those whose outputs are stale
    python -m tests.notebooks all        all of them
    python -m tests.notebooks check      none: says which are stale, and ends with 1 if any is

Outputs are stored small: pictures at `DPI`, and nothing that a run cannot repeat (times, paths,
counts of executions). Beside them stands a `fingerprint` of what they were made of: the code of the
cells, the version, the embedded tables and the sources of figures. `tests/test_notebooks.py` says
when it is another. A change of the rest between two versions does not make outputs stale: draws for
a seed change with the version, and the slow tests execute every notebook."""

import base64
import hashlib
import io
import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "notebooks"
KEY = "poseterior"
"""Where a notebook's metadata has the fingerprint."""
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
DPI = 80
WIDTH, COLOURS = 1200, 128
"""Of stored pictures."""
SETTINGS = f"""
import warnings
warnings.simplefilter("error")
# ipykernel warns of itself when it shuts down: its own shell does not yet do what it asks of
# others.
warnings.filterwarnings("ignore", category=PendingDeprecationWarning, module="ipykernel")
%matplotlib inline
%config InlineBackend.print_figure_kwargs = {{"dpi": {DPI}, "bbox_inches": "tight"}}
"""
COMMENT = re.compile(r"^\s*#.*$|\s+$", re.M)


def load(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def names() -> list[Path]:
    return sorted(FOLDER.glob("*.ipynb"))


def product() -> str:
    """A hash of the product's version, its tables, and what draws its figures, comments aside."""
    found = hashlib.sha256(VERSION.encode())
    for path in sorted((ROOT / "probmodel" / "data").glob("*.npz")):
        found.update(path.read_bytes())
    for path in sorted((ROOT / "reports" / "figures").glob("*.py")):
        found.update(COMMENT.sub("", path.read_text(encoding="utf-8")).encode())
    return found.hexdigest()


def fingerprint(notebook: nbformat.NotebookNode, of_product: str) -> str:
    """What the outputs of a notebook were made of, in one word."""
    cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\0".join([of_product, *cells]).encode()).hexdigest()[:16]


def execute(
    notebook: nbformat.NotebookNode, folder: Path, settings: str = SETTINGS
) -> nbformat.NotebookNode:
    """Runs it in a folder, with warnings as errors. Raises what a cell raises."""
    notebook.cells.insert(0, nbformat.v4.new_code_cell(settings, id="settings"))
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=900, kernel_name="python3", resources=where).execute()
    del notebook.cells[0]
    return notebook


TEMPORARY = re.compile(rf"{re.escape(tempfile.gettempdir())}/[^/\s]+/")
"""Folders that a run makes for itself."""


def tidy(notebook: nbformat.NotebookNode) -> None:
    """Leaves out of the outputs what differs from run to run, or what nobody sees, and makes
    pictures small."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.execution_count = None
            cell.outputs = _joined(one for one in cell.outputs if one.get("name") != "stderr")
            for output in cell.outputs:
                _tidy_output(output)
    notebook.metadata.language_info = {"name": "python"}


def _joined(outputs: Iterable[nbformat.NotebookNode]) -> list[nbformat.NotebookNode]:
    """Outputs, neighbouring texts of one stream as one: where a text is cut is up to the clock."""
    found: list[nbformat.NotebookNode] = []
    for output in outputs:
        if output.output_type == "stream" and found and found[-1].get("name") == output.name:
            found[-1].text += output.text
        else:
            found.append(output)
    return found


def _tidy_output(output: nbformat.NotebookNode) -> None:
    if "execution_count" in output:
        output.execution_count = None
    if "text" in output:
        output.text = TEMPORARY.sub("", output.text)
    data = output.get("data", {})
    if len(data) > 1:
        data.pop("text/plain", None)  # a picture or a table says it better
    if "image/png" in data:
        data["image/png"] = smaller(data["image/png"])


def smaller(picture: str) -> str:
    """A picture, in base64 as notebooks have it, of at most `WIDTH` pixels and `COLOURS`."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.LANCZOS)
    file = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


def store(path: Path, of_product: str) -> None:
    notebook = load(path)
    with tempfile.TemporaryDirectory() as folder:
        execute(notebook, Path(folder))
    tidy(notebook)
    notebook.metadata[KEY] = {"fingerprint": fingerprint(notebook, of_product)}
    nbformat.validate(notebook)
    nbformat.write(notebook, path)


def is_stale(path: Path, of_product: str) -> bool:
    """Whether the outputs were made of other code."""
    notebook = load(path)
    said = notebook.metadata.get(KEY, {}).get("fingerprint")
    return bool(said != fingerprint(notebook, of_product))


def main(wanted: list[str]) -> None:
    os.environ["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    )
    of_product = product()
    stale = [path for path in names() if is_stale(path, of_product)]
    if "check" in wanted:
        named = ", ".join(path.name for path in stale)
        sys.exit(f"stale: {named}; run `make notebooks`" if stale else 0)
    for path in names() if "all" in wanted else stale:
        print(f"executing {path.name}", flush=True)
        store(path, of_product)


if __name__ == "__main__":
    main(sys.argv[1:])
