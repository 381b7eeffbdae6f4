"""A short part of `make kills`, and that what it looks for would be found."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import kills

ROOT = Path(__file__).parents[1]


@pytest.mark.sweep
def test_a_killed_command_goes_on_to_the_same_bits() -> None:
    """In a process of its own: XLA's threads would not come along into forks of this one."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.kills", "learn"],
        cwd=ROOT,
        env={**os.environ, "KILLS": "3", "KILLS_SEED": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "learn: 3 kills, " in run.stdout


def test_other_bits_and_leftovers_are_found(tmp_path: Path) -> None:
    whole, other = tmp_path / "whole", tmp_path / "other"
    for folder in (whole, other):
        folder.mkdir()
        np.savez(folder / "a.npz", a=np.arange(3.0))
        (folder / "b.txt").write_text("text")
        (folder / "d.html").write_text(f"300 draws in 0.{len(folder.name)} s")
    wanted = kills.content(whole)
    assert kills.difference(kills.content(other), wanted) == ""
    np.savez(other / "a.npz", a=np.array([0.0, 1.0, np.nextafter(2.0, 3.0)]))
    (other / "b.txt").unlink()
    (other / "d.html").write_text("299 draws in 0.5 s")
    (other / "c.partial").write_text("")
    assert kills.difference(kills.content(other), wanted) == (
        "lacks ['b.txt']; holds beside ['c.partial']; holds otherwise ['a.npz', 'd.html']"
    )
