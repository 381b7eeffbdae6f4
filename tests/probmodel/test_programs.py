"""Kept programs: they compute what JAX would, are found again, and never where they are not those
of the function, of its sources or of its arguments."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from poseterior.probmodel import programs
from poseterior.probmodel.errors.laws import Disc, ErrorLaw, Gaussian
from poseterior.probmodel.programs import VARIABLE, kept
from poseterior.reports.options import PROGRAMS

TRACES: list[str] = []


def squares(law: ErrorLaw, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
    TRACES.append("squares")
    return law.log_ratio(rows**2), rows + 1


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "programs"))
    TRACES.clear()
    return tmp_path / "programs"


ROWS = np.linspace(0, 2, 7)


def check(law: ErrorLaw = Disc(), rows: np.ndarray = ROWS) -> None:  # noqa: B008
    """Asks as a new process would, and compares with JAX."""
    ratio, more = kept(squares)(law, rows)
    assert np.array_equal(ratio, jax.jit(squares)(law, rows)[0])
    assert np.array_equal(more, rows + 1)


def traced(law: ErrorLaw = Disc(), rows: np.ndarray = ROWS) -> int:  # noqa: B008
    """How often the function is traced for a new process's call."""
    TRACES.clear()
    kept(squares)(law, rows)
    return len(TRACES)


def test_the_command_line_names_the_same_variable() -> None:
    assert PROGRAMS == VARIABLE


def test_a_program_is_traced_once_and_computes_the_same(folder: Path) -> None:
    assert traced() == 1
    assert traced() == 0
    check()
    assert len(list(folder.iterdir())) == 1


def test_without_a_folder_nothing_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    check()
    assert not folder.exists()


def test_other_arguments_are_another_program(folder: Path) -> None:
    assert traced() == traced(Gaussian()) == traced(rows=ROWS[1:]) == 1
    assert traced(rows=ROWS.astype(np.float32)) == 1
    check(Gaussian())
    check(rows=ROWS[1:])


def test_other_sources_are_another_program(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert traced() == 1
    monkeypatch.setattr(programs, "_state", lambda own: "another")
    assert traced() == 1


def test_a_class_of_somebody_else_is_not_kept(folder: Path) -> None:
    """It may change while its name stays."""

    @jax.tree_util.register_static
    @dataclasses.dataclass(frozen=True)
    class Own(Disc):
        pass

    assert traced(Own()) == 1
    assert not folder.exists()


@pytest.mark.parametrize("damage", [b"", b"short", bytes(5000)])
def test_a_damaged_file_is_made_anew(folder: Path, damage: bytes) -> None:
    assert traced() == 1
    (path,) = folder.iterdir()
    path.write_bytes(damage)
    assert traced() == 1
    assert traced() == 0
    check()


def test_a_folder_that_cannot_be_written_to_is_done_without(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.write_text("a file")
    assert traced() == traced() == 1
    check()


def test_inside_another_program_it_is_a_part_of_that(folder: Path) -> None:
    inner = kept(squares)
    outer = jax.jit(lambda rows: inner(Disc(), rows)[1] * 2)
    assert np.array_equal(outer(ROWS), 2 * (ROWS + 1))
    assert jax.grad(lambda x: jnp.sum(inner(Gaussian(), x)[1]))(ROWS).shape == ROWS.shape
    assert not folder.exists()


@pytest.mark.parametrize("where", ["programs", ""])
def test_what_has_no_file_is_refused_everywhere(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where no folder is named, as in tests."""
    monkeypatch.setenv(VARIABLE, where and str(tmp_path / where))

    class Pair(NamedTuple):
        one: jax.Array
        other: jax.Array

    def nested(rows: jax.Array) -> tuple[jax.Array, Pair]:
        return rows, Pair(rows, rows)

    with pytest.raises(TypeError, match="nested returns a Pair, whose program cannot be kept"):
        kept(nested)(ROWS)
