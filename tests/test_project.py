"""What is said of the project in several places is the same in all of them."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from poseterior.inference.benchmark import targets

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
LOCKED = re.findall(
    r"^([a-z\d.-]+)==(\S+)(?: ; [^\\]+)?((?: \\\n    --hash=sha256:[0-9a-f]{64})+)$",
    (ROOT / "requirements.lock").read_text(encoding="utf-8"),
    re.MULTILINE,
)
"""Packages, versions, hashes."""


def read(path: str) -> Any:
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_one_version() -> None:
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert newest
    assert newest[1] == PROJECT["version"] == CITATION["version"]


def test_the_paper_is_cited() -> None:
    (paper,) = CITATION["references"]
    assert CITATION["license"] == PROJECT["license"]
    assert paper["title"] in " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert [one["family-names"] for one in paper["authors"]] == ["Jahangiri", "Yuille"]
    assert paper["year"] == 2017


def test_the_lock_has_every_requirement() -> None:
    """Of what `make` installs: others' samplers, which it does not, are not locked."""
    named = [*PROJECT["dependencies"]]
    for name, extra in PROJECT["optional-dependencies"].items():
        if name not in ("gym", "ultranest"):
            named += [one for one in extra if not one.startswith("poseterior")]
    packages = {re.match(r"[\w.-]+", one)[0].lower().replace("_", "-") for one in named}
    assert packages <= {package for package, _, _ in LOCKED}


def test_whatever_is_locked_has_hashes() -> None:
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert len(LOCKED) == text.count("==") - text.count(" == ") > 100


def test_the_hosted_workflow_calls_what_has_to_pass() -> None:
    jobs = read(".github/workflows/ci.yml")["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert commands == [".ci/run", "make docs", "make dist"]


def test_what_others_run_is_named_by_its_commit() -> None:
    """A tag may be moved to other code; the version stands beside for readers."""
    text = (ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8")
    used = re.findall(r"uses: (.*)", text)
    assert len(used) >= 3
    for one in used:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+", one), one


def test_hooks_are_those_of_make_lint() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for hook in read(".pre-commit-config.yaml")["repos"][0]["hooks"]:
        assert hook["language"] == "system"
        assert " ".join(hook["entry"].split()[:2]).replace(".venv/bin/", "$(BIN)/") in makefile


@pytest.mark.parametrize("name", ["bug", "reading", "idea"])
def test_issue_forms_have_what_forms_need(name: str) -> None:
    form = read(f".github/ISSUE_TEMPLATE/{name}.yml")
    assert {"name", "description", "body"} <= set(form)
    ids = [field["id"] for field in form["body"]]
    assert len(ids) == len(set(ids))
    assert all("label" in field["attributes"] for field in form["body"])


def test_classifiers_are_true() -> None:
    python = (ROOT / ".python-version").read_text(encoding="utf-8").strip()
    assert f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    assert (ROOT / "poseterior" / "py.typed").exists()


def test_no_page_promises_an_index_that_does_not_have_us() -> None:
    """What installs an extra is said by one function, and its extras are there."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    folders = ("probmodel", "inference", "reports", "docs", "examples")
    files = [
        path for one in folders for path in (ROOT / one).rglob("*") if path.suffix in (".py", ".md")
    ]
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *files)}
    assert [path for path, text in texts.items() if re.search(r"poseterior\[\w", text)] == []
    named = {
        one for text in texts.values() for one in re.findall(r"""installing\(["'](\w+)""", text)
    }
    assert named
    assert named <= extras.keys()


def test_pages_count_the_targets_that_there_are() -> None:
    found = targets()
    soft = sum(name.endswith("-soft") for name in found)
    first = f"{len(found)} frozen targets"
    assert first in (ROOT / "README.md").read_text(encoding="utf-8")
    page = (ROOT / "docs/benchmark.md").read_text(encoding="utf-8")
    assert (
        f"{first}: {len(found) - soft} posteriors over human poses with hard walls, {soft} of which"
        in page
    )
    board = (ROOT / "reports/leaderboard.md").read_text(encoding="utf-8")
    listed = re.findall(r"<summary>([\w-]+), \d+ dimensions: equal processor time", board)
    assert f"on {len(listed)} of the {len(found)} frozen targets" in board
    assert set(listed) <= found.keys()
    assert f"on {len(listed)} of them" in page
