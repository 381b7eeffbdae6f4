"""What the pages show in Python runs as printed, each snippet by itself; links lead somewhere."""

import contextlib
import io
import re
import shutil
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import pytest

from poseterior.probmodel.example import example

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
"""Those of docs/how-to run in `tests/test_how_to.py`, with the commands between their snippets."""
SLOW = ("NUTS", "emcee", "Predictive", "judge")
"""Words of snippets that compile whole programs, or judge draws: some ten seconds each."""
FENCED = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")


class Snippet(NamedTuple):
    """A block of Python in a page."""

    page: str
    line: int
    code: str


def snippets_of(page: str, text: str) -> list[Snippet]:
    """The blocks of Python in a page, and the lines in which they start."""
    return [
        Snippet(page, text.count("\n", 0, found.start()) + 2, found[1])
        for found in FENCED.finditer(text)
    ]


SNIPPETS = [
    pytest.param(
        snippet,
        id=f"{snippet.page}:{snippet.line}",
        marks=[pytest.mark.slow] if any(word in snippet.code for word in SLOW) else [],
    )
    for page in PAGES
    for snippet in snippets_of(page.name, page.read_text(encoding="utf-8"))
]


def run(snippet: Snippet) -> str:
    """Runs it in this process; line numbers of errors are those of the page. Returns what it
    printed."""
    code = compile("\n" * (snippet.line - 1) + snippet.code, snippet.page, "exec")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, {"__name__": "__main__"})
    return said.getvalue()


def test_there_are_snippets_of_every_kind() -> None:
    codes = [param.values[0].code for param in SNIPPETS]
    for word in ("NUTS", "emcee", "arviz", "open_stream", "hypotheses", "Predictive"):
        assert any(word in code for code in codes), word


@pytest.mark.slow
@pytest.mark.parametrize("snippet", SNIPPETS)
def test_snippets_run(
    snippet: Snippet, cache: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(example().path, tmp_path / "frame_keypoints.json")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", lambda: None)
    run(snippet)
    plt.close("all")


def test_a_snippet_that_does_not_run_is_caught() -> None:
    (snippet,) = snippets_of("page.md", "# A\n\n```python\nx = 1\nprint(x)\nundefined\n```\n")
    assert snippet.line == 4
    with pytest.raises(NameError, match="undefined") as caught:
        run(snippet)
    assert caught.traceback[-1].lineno + 1 == 6


@pytest.mark.parametrize(
    "page",
    [
        *PAGES,
        *sorted(ROOT.glob("docs/*/*.md")),
        ROOT / "CONTRIBUTING.md",
        ROOT / "examples/README.md",
    ],
    ids=lambda page: page.name,
)
def test_links_lead_somewhere(page: Path) -> None:
    links = LINK.findall(page.read_text(encoding="utf-8"))
    lost = [link for link in links if not (page.parent / link).exists()]
    assert not lost
