"""The documentation site: every page and every public name is in it, and it is built without a
warning."""

import importlib.util
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import poseterior

ROOT = Path(__file__).parents[1]
INDEX = ROOT / "docs" / "index.md"
API = sorted((ROOT / "docs" / "api").glob("*.md"))
TREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.M | re.S)
ENTRY = re.compile(r"^\.\. (?:autofunction|autoclass|py:data):: (\w+)$", re.M)
NEEDED = ("sphinx", "myst_nb", "furo", "latex2mathml")


def entries(page: Path) -> set[Path]:
    """The pages that a page's table of contents names, with those below them."""
    found: set[Path] = set()
    for tree in TREE.findall(page.read_text(encoding="utf-8")):
        for line in tree.splitlines():
            named = re.sub(r".*<(.*)>", r"\1", line.strip())
            if named and not named.startswith(":"):
                for ending in (".md", ".ipynb"):
                    found |= {one.resolve() for one in page.parent.glob(named + ending)}
    for one in {one for one in found if one.suffix == ".md"}:
        found |= entries(one)
    return found


def pages() -> set[Path]:
    """What is there to read."""
    patterns = ("*.md", "docs/**/*.md", "reports/*.md", "examples/**/*.md", "notebooks/*")
    found = {one for pattern in patterns for one in ROOT.glob(pattern)}
    return {one.resolve() for one in found if one.suffix in (".md", ".ipynb")} - {INDEX}


def test_every_page_is_in_the_navigation() -> None:
    assert pages() - entries(INDEX) == set()


def test_every_public_name_is_in_the_interface_once() -> None:
    named = [name for page in API for name in ENTRY.findall(page.read_text(encoding="utf-8"))]
    assert sorted(named) == sorted(poseterior.__all__)


def test_the_extra_names_what_the_build_imports() -> None:
    conf = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for name in NEEDED:
        assert name in conf
        assert f'"{name.replace("_", "-")}>=' in project


class Links(HTMLParser):
    """The addresses that a page refers to, and the places in it that have a name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name in ("href", "src") and value:
                self.addresses.append(value)
            if name in ("id", "name") and value:
                self.places.add(value)


def lost(site: Path) -> list[str]:
    """Links within a built site that lead nowhere."""
    found = {path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    missing = []
    for page, links in found.items():
        for address in links.addresses:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            place = unquote(parts.fragment)
            if not target.exists() or (
                target in found and place and place not in found[target].places
            ):
                missing.append(f"{page.relative_to(site)}: {address}")
    return missing


def test_a_lost_link_is_caught(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<p id="x"><a href="#x"></a><a href="b.html"></a>')
    assert lost(tmp_path) == ["a.html: b.html"]
    (tmp_path / "b.html").write_text('<a href="a.html#y"></a><a href="a.html#x"></a>')
    assert lost(tmp_path) == ["b.html: a.html#y"]


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """As `make docs` does, with warnings as errors; no page needs the network to be read."""
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if absent:
        pytest.skip(f"the extra docs is not installed ({', '.join(absent)} is missing)")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    done = subprocess.run(
        [*command, "-c", "docs", "-d", str(tmp_path / "trees"), ".", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    assert lost(site) == []
    for page in site.rglob("*.html"):
        addresses = Links(page.read_text(encoding="utf-8")).addresses
        fetched = [one for one in addresses if re.match(r"(https?:)?//.*\.(js|css|woff2?)", one)]
        assert not fetched, page
    assert "<math" in (site / "docs" / "model.html").read_text(encoding="utf-8")
    notebook = (site / "notebooks" / "01_from_one_detection_to_its_posterior.html").read_text()
    assert "<table" in notebook
    assert "| faces |" not in notebook
    shutil.rmtree(site)
