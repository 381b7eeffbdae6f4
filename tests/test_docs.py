"""The mathematics in docs/model.md: what code cites of it is there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SECTIONS = set(
    re.findall(r"^## § (\d+)", (ROOT / "docs/model.md").read_text(encoding="utf-8"), re.M)
)
CITATION = re.compile(r"docs/model\.md\s+§§?\s+(\d+)")
FILES = [
    path.relative_to(ROOT)
    for package in ("probmodel", "inference", "reports")
    for path in sorted((ROOT / package).rglob("*.py"))
]


def cited(text: str) -> set[str]:
    """Numbers of the sections that a text cites, with a line's end anywhere in the citation."""
    return set(CITATION.findall(text))


def test_every_cited_section_is_written() -> None:
    found = {path: cited((ROOT / path).read_text(encoding="utf-8")) for path in FILES}
    assert set().union(*found.values()), "nothing cites the model any more"
    wrong = {str(path): numbers - SECTIONS for path, numbers in found.items() if numbers - SECTIONS}
    assert not wrong


@pytest.mark.parametrize("text", ["(docs/model.md § 99)", "docs/model.md\n    § 99."])
def test_a_wrong_citation_is_caught(text: str) -> None:
    assert cited(text) - SECTIONS == {"99"}
