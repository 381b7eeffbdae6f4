"""How a page is made: a template, the values that fill it, and pictures.

A template `NAME.md` stands beside the module of its page; what the module fills in is a word
between two pairs of braces. Numbers are written by the modules alone, words by the templates.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import jax
from matplotlib.figure import Figure

from poseterior.probmodel.files import replacing
from poseterior.reports.figures import save_figure
from poseterior.reports.tables import Sheet

REPORTS = Path(__file__).parents[1]
PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")
Values = Mapping[str, str | int | Sheet]


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
    wanted, given = set(placeholders(template)), set(values)
    if wanted != given:
        raise ValueError(f"placeholders without one value: {', '.join(sorted(wanted ^ given))}")
    texts = {
        name: value.markdown() if isinstance(value, Sheet) else str(value)
        for name, value in values.items()
    }
    return PLACEHOLDER.sub(lambda found: texts[found[1]], template)


def write_page(name: str, values: Values, pictures: Mapping[str, Figure]) -> str:
    """Writes `NAME.md` and pictures by the names of their files, each whole or not at all.

    Returns
    -------
    str
        The text of the page.
    """
    text = render(template_of(name), values)
    for file, picture in pictures.items():
        save_figure(picture, REPORTS / f"{file}.png")
    with replacing(REPORTS / f"{name}.md") as partial:
        partial.write_text(text, encoding="utf-8")
    return text
