"""A page of HTML from its parts: scripts, style, numbers and words in one file.

Words come escaped, numbers as JSON in which no tag can begin, and the page's own policy lets a
browser run the one script that is ours, and load nothing.
"""

import base64
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.figures.colours import COLOURS, LEFT_LIMBS, SEGMENTS
from poseterior.reports.tables.sheet import Sheet
from poseterior.reports.tables.words import spoken

PLACES = 6
"""Digits of numbers that are written out."""


def assemble(
    kind: str,
    title: str,
    data: dict[str, Any],
    *,
    facts: Iterable[str],
    warnings: Iterable[str],
    sentences: Iterable[str],
    sheets: Sequence[Sheet],
) -> str:
    """A whole page.

    Parameters
    ----------
    kind
        "person" or "film": which scene, and what it does.
    title, facts, warnings, sentences
        Plain words, of any origin; they are escaped here.
    data
        What the scene shows, as JSON has it.
    sheets
        The tables below it.
    """
    script = "".join(
        ['(() => {\n"use strict";\n', _asset("scene.js"), _asset(f"{kind}.js"), "})();\n"]
    )
    style = _asset("style.css")
    return Template(_asset("page.html")).substitute(
        title=escape(title),
        style=style,
        style_hash=_fingerprint(style),
        script=script,
        script_hash=_fingerprint(script),
        facts=_paragraphs(facts, "facts"),
        warnings=_box(warnings),
        scene=_asset(f"{kind}.html"),
        words="\n".join([_paragraphs(sentences), *(sheet.html() for sheet in sheets)]),
        data=_harmless(data | _BODY),
    )


def write_page(page: str, path: str | os.PathLike) -> None:
    """Writes a page, whole or not at all. Raises `BadInput` where it cannot."""
    with replacing(path) as partial:
        Path(partial).write_text(page, encoding="utf-8")


def packed(numbers: np.ndarray) -> str:
    """Numbers as text: little-endian floats of 32 bits in base64, of which JavaScript makes an
    array at once."""
    return base64.b64encode(np.ascontiguousarray(numbers, "<f4").tobytes()).decode("ascii")


def rounded(numbers: np.ndarray) -> list[Any]:
    """Numbers as JSON has them: None for what is not finite."""
    plain = np.round(np.asarray(numbers, float), PLACES).astype(object)
    plain[~np.isfinite(np.asarray(numbers, float))] = None
    return plain.tolist()


_BODY: dict[str, Any] = {
    "joints": [spoken(name) for name in JOINTS],
    "bones": [list(pair) for pair in SEGMENTS],
    "left": sorted(LEFT_LIMBS),
    "colours": COLOURS,
}
"""What every page knows of a body."""


def _asset(name: str) -> str:
    return (resources.files("poseterior.reports.interactive") / "assets" / name).read_text(
        encoding="utf-8"
    )


def _fingerprint(text: str) -> str:
    """How a content security policy names a script or style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def _harmless(data: dict[str, Any]) -> str:
    """JSON in which no tag begins or ends, so that it can stand in a page."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _paragraphs(sentences: Iterable[str], name: str = "") -> str:
    opening = f'<p class="{name}">' if name else "<p>"
    return "\n".join(f"{opening}{escape(sentence)}</p>" for sentence in sentences)


def _box(warnings: Iterable[str]) -> str:
    inside = _paragraphs(warnings)
    return f'<section class="warnings" role="note">\n{inside}\n</section>' if inside else ""
