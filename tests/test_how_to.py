"""The how-to pages: what they tell people to type and to run does run, page by page, in order, in a
folder with the files that they name."""

import dataclasses
import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest

from poseterior.probmodel import Detection, read_detections
from poseterior.probmodel.example import example
from poseterior.probmodel.layouts import COCO_17
from poseterior.probmodel.skeleton import JOINT_INDEX
from tests.conftest import SHARED, Cli
from tests.filmed import filmed, moving, write_session
from tests.probmodel.test_formats_fuzz import deeplabcut_rows, landmarks, npy, table
from tests.reports.test_judge_command import write_coverage
from tests.test_snippets import Snippet, run

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs" / "how-to").glob("*.md"))
ELSEWHERE = ("--scheduler",)
"""Options of commands that need other machines."""


class Step(NamedTuple):
    """A command line, or a block of Python, of a page."""

    command: str | None
    snippet: Snippet


def steps(page: str, text: str) -> list[Step]:
    found = []
    for match in re.finditer(r"^```python\n(.*?)^```|^ {4}poseterior ([^\n]*)$", text, re.M | re.S):
        line = text.count("\n", 0, match.start()) + 2
        found.append(Step(match[2], Snippet(page, line, match[1] or "")))
    return found


def coco(person: Detection) -> np.ndarray:
    """`(17, 3)`: the example's joints in COCO's order; the face is missing."""
    rows = np.zeros((COCO_17.count, 3))
    for row, name in zip(rows, COCO_17.points, strict=True):
        if name in JOINT_INDEX and person.seen[JOINT_INDEX[name]]:
            row[:] = [*person.keypoints[JOINT_INDEX[name]], 1]
    return rows


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With what the pages suppose that their reader has."""
    person = read_detections(example().path)[0]
    shutil.copy(example().path, tmp_path / "frame_keypoints.json")
    shutil.copytree(ROOT / "examples" / "posteriors", tmp_path / "examples" / "posteriors")
    (tmp_path / "walk").mkdir()
    for number in range(2):
        shutil.copy(example().path, tmp_path / "walk" / f"frame_{number}.json")
    (tmp_path / "landmarks.json").write_text(json.dumps(landmarks()))
    odd = {"paw_r": "right_wrist", "paw_l": "left_wrist", "LHip": "left_hip", "RHip": "right_hip"}
    odd |= {"LShoulder": "left_shoulder", "RShoulder": "right_shoulder"}
    (tmp_path / "video.csv").write_text(table(deeplabcut_rows(parts=odd)))
    (tmp_path / "names.json").write_text('{"paw_r": "right_wrist", "paw_l": "left_wrist"}')
    (tmp_path / "points.npy").write_bytes(npy(coco(person)[None]))
    session = filmed(moving(3), np.random.default_rng(0).normal(0, 8, (4, 3, 15, 2)))
    write_session(dataclasses.replace(session, numbers=(19, 20, 21)), tmp_path / "session")
    for detector in ("openpose", "mediapipe"):
        write_coverage(tmp_path / detector / "coverage.nc", detector)
    if SHARED.is_dir():
        shutil.copy(SHARED / "bvh" / "cmu_131_03.bvh", tmp_path / "walk.bvh")
    return tmp_path


def test_pages_have_steps() -> None:
    assert len(PAGES) >= 8
    for page in PAGES:
        assert steps(page.name, page.read_text(encoding="utf-8")), page


@pytest.mark.sweep
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
@pytest.mark.filterwarnings("ignore")  # of plots and samplers; commands and snippets may warn
def test_page_runs(
    page: Path, folder: Path, poseterior: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "walk.bvh" in page.read_text(encoding="utf-8") and not SHARED.is_dir():
        pytest.skip("the shared data pack, which has motion capture, is not beside the checkout")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(plt, "show", lambda: None)
    for command, snippet in steps(page.name, page.read_text(encoding="utf-8")):
        if command is None:
            run(snippet)
        elif not any(option in command for option in ELSEWHERE):
            done = poseterior(*shlex.split(command, comments=True), "--quiet")
            assert done.code == 0, f"{page.name}:{snippet.line}: {command}\n{done.err}"
        plt.close("all")


def test_a_step_that_fails_is_caught(
    tmp_path: Path, poseterior: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (step,) = steps("a.md", "# A\n\n    poseterior check nothing.bvh\n")
    assert step.command == "check nothing.bvh"
    assert poseterior(*shlex.split(step.command)).code == 2
