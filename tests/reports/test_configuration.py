"""A file of options: keys are options' names, the command line wins, and what a command has not is
refused by name."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from poseterior.reports import cli
from tests.conftest import Cli


def config(folder: Path, text: str | bytes) -> Path:
    path = folder / "options.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def drawn(path: Path) -> np.ndarray:
    with xr.open_datatree(path) as tree:
        return tree["prior"].joints.values


def test_a_file_says_what_the_command_line_would(tmp_path: Path, poseterior: Cli) -> None:
    path = config(tmp_path, 'num-samples = 3\nquiet = true\nseed = 7\nlower = "box"\n')
    typed = ("--num-samples", 3, "--quiet", "--seed", 7, "--lower", "box")
    asked = {"said": ("--config", path), "typed": typed, "wins": ("--config", path, "--seed", 8)}
    for name, words in asked.items():
        run = poseterior("prior", *words, "--out", tmp_path / f"{name}.nc")
        assert run.code == 0, run.err
    said, same, other = (drawn(tmp_path / f"{name}.nc") for name in asked)
    np.testing.assert_array_equal(said, same)
    assert said.shape == other.shape
    assert not np.array_equal(said, other), "the command line wins"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("num-sampels = 3", "has the key 'num-sampels', but `poseterior prior` has no such option"),
        ("config = 'x'", "has the key 'config'"),
        ("json = 1", "json in"),
        ("seed = true", "seed in"),
        ("seed = 2.5", "seed"),
        ("seed = [1]", "must be a number or a text"),
        ("[seed]\na = 1", "must be a number or a text"),
        ("seed = 1979-05-27", "must be a number or a text"),
        ("seed = -1", "seed"),
        ("seed", "is not TOML"),
        (b"\xff", "is not TOML"),
        ("a = " + "[" * 5000, "is not TOML"),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path, poseterior: Cli, text: str | bytes, words: str
) -> None:
    path = config(tmp_path, text)
    run = poseterior("prior", "--config", path, "--out", tmp_path / "a.nc")
    assert run.code == 2
    assert words in run.err
    assert not (tmp_path / "a.nc").exists()


def test_a_file_that_is_not_there_is_refused(tmp_path: Path, poseterior: Cli) -> None:
    run = poseterior("prior", "--config", tmp_path / "no.toml", "--out", tmp_path / "a.nc")
    assert run.code == 2
    assert "no.toml" in run.err


def test_v_is_the_version(poseterior: Cli) -> None:
    assert poseterior("-v").out == poseterior("--version").out != ""


def test_a_shell_completes_every_command(poseterior: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_POSETERIOR_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_CWORD", "1")
    monkeypatch.setenv("COMP_WORDS", "poseterior ")
    offered = set(poseterior("").out.split())
    assert {name.split(" ")[0] for name in cli.COMMANDS} <= offered
