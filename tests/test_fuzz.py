"""A short, seeded part of `make fuzz`, and that what it looks for would be found."""

from pathlib import Path

import pytest

from poseterior.probmodel import BadInput
from tests import fuzzing


@pytest.fixture(scope="module")
def kinds() -> dict[str, fuzzing.Target]:
    return fuzzing.targets()


def test_damaged_files_are_read_or_refused(
    kinds: dict[str, fuzzing.Target], tmp_path: Path
) -> None:
    """Both must occur, or nothing was tested."""
    outcomes = [fuzzing.run_case(4, number, kinds, tmp_path) for number in range(8 * len(kinds))]
    assert min(outcomes.count(word) for word in ("read", "refused")) > len(kinds) / 2


def test_undamaged_files_are_read(kinds: dict[str, fuzzing.Target], tmp_path: Path) -> None:
    for kind, target in kinds.items():
        # Of a folder of films, and of a file of draws, which are not there.
        if kind in ("command line: calibrate", "command line: benchmark judge"):
            continue
        for name, data in target.beside.items():
            (tmp_path / name).write_bytes(data)
        (tmp_path / target.file).write_bytes(target.corpus[0])
        target.read(tmp_path / target.file)


def _refuse(words: str) -> None:
    raise BadInput(words)


@pytest.mark.parametrize(
    "read",
    [
        lambda path: {}[path],
        lambda path: _refuse("two\nlines"),
        lambda path: _refuse("long" * 200),
        lambda path: _refuse("\x1b[31m"),
    ],
)
def test_a_reader_that_falls_is_found_out(read, tmp_path: Path) -> None:
    target = {"bad": fuzzing.Target("a", read, [b"hello"])}
    with pytest.raises((KeyError, AssertionError)):
        fuzzing.run_case(0, 0, target, tmp_path)
