"""How a page is made: a template, the values that fill it, and pictures.

    def main(data: Data, work: Work) -> Page: ...

    if __name__ == "__main__":
        run(main)

A template `NAME.md` stands beside the module of its page; what the module fills in is a word
between two pairs of braces. Numbers are written by the modules alone, words by the templates. What
takes long is `kept` in a folder, and is there when the page is made again.
"""

import functools
import json
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import typer
import xarray as xr
from matplotlib.figure import Figure

from poseterior.inference.results import save_tree
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import replacing
from poseterior.reports.figures import save_figure
from poseterior.reports.tables import Sheet

REPORTS = Path(__file__).parents[1]
PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")
Values = Mapping[str, str | int | Sheet]
Data = Annotated[Path, typer.Argument(help="The shared data pack.")]
Work = Annotated[Path, typer.Argument(help="A folder for what is done; made if there is none.")]
People = Annotated[int, typer.Argument(help="How many people.")]
SHARED = Path("../shared/data")
"""Where the data pack is, if nothing else is said."""


class Page(NamedTuple):
    """What fills a page of that name, and its pictures by the names of their files."""

    name: str
    values: Values
    pictures: Mapping[str, Figure] = {}

    def write(self) -> str:
        """Writes `NAME.md` and the pictures, each whole or not at all; returns the page's text."""
        text = render(template_of(self.name), self.values)
        for file, picture in self.pictures.items():
            save_figure(picture, REPORTS / f"{file}.png")
        with replacing(REPORTS / f"{self.name}.md") as partial:
            partial.write_text(text, encoding="utf-8")
        return text


def run(main: Callable[..., Page | None]) -> None:
    """The command line of a page: its arguments are those of `main`, whose page is written, printed
    and timed; None where only a part was to be done. Bad input is said in its sentence."""

    @functools.wraps(main)
    def command(**given: Any) -> None:
        started = time.perf_counter()
        in_doubles()
        if "work" in given:
            given["work"].mkdir(parents=True, exist_ok=True)
        try:
            page = main(**given)
        except BadInput as error:
            typer.echo(error, err=True)
            raise typer.Exit(2) from None
        if page:
            print(page.write())
        print(f"{time.perf_counter() - started:,.0f} seconds", flush=True)

    typer.run(command)


def kept(path: Path, make: Callable[..., xr.DataTree], *given: Any) -> xr.DataTree:
    """The tree in a file, which is made, of what is given, where there is none."""
    if not path.exists():
        save_tree(make(*given), path)
        print(path.stem, flush=True)
    with xr.open_datatree(path) as tree:
        return tree.load()


def kept_json(path: Path, make: Callable[..., Any], *given: Any) -> Any:
    """As `kept`, of plain values."""
    if not path.exists():
        found = json.dumps(make(*given))
        with replacing(path) as partial:
            partial.write_text(found, encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def in_doubles() -> None:
    """64-bit floats, before anything is compiled: limits are decided to the last bits."""
    jax.config.update("jax_enable_x64", True)


def template_of(name: str) -> str:
    """The template of a page."""
    return Path(__file__).with_name(f"{name}.md").read_text(encoding="utf-8")


def placeholders(template: str) -> list[str]:
    """The names that a template wants filled in, as they come."""
    return PLACEHOLDER.findall(template)


def render(template: str, values: Values) -> str:
    """The template with every placeholder filled in; a sheet becomes a table.

    Raises
    ------
    ValueError
        Where a placeholder has no value, or a value no placeholder.
    """
    wanted = set(placeholders(template))
    given = set(values)
    if wanted != given:
        raise ValueError(f"placeholders without one value: {', '.join(sorted(wanted ^ given))}")
    texts = {
        name: value.markdown() if isinstance(value, Sheet) else str(value)
        for name, value in values.items()
    }
    return PLACEHOLDER.sub(lambda found: texts[found[1]], template)
