"""Files are written whole or not at all."""

import os
import stat
from pathlib import Path

import pytest

from poseterior.probmodel import BadInput
from poseterior.probmodel.files import replacing


def write(path, text: str, error: BaseException | None = None, **options) -> None:
    """Writes a text, and may fail at it."""
    with replacing(path, **options) as place:
        place.write_text(text)
        if error:
            raise error


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with replacing(path) as place:
        place.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyError("what"), KeyboardInterrupt(), BadInput("a sentence")])
def test_what_is_raised_in_between_is_raised_and_the_old_file_stays(tmp_path, error):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(type(error)):
        write(path, "half", error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_the_system_refuses_is_a_sentence(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("old")
    with pytest.raises(
        BadInput, match=r"cannot write .*out.txt \(No space left on device\); free some"
    ):
        write(path, "half", OSError(28, "No space left on device"), advice="free some")
    assert path.read_text() == "old"
    for bad in (tmp_path, tmp_path / "none" / "out.txt", tmp_path / ("long" * 100), "a\0b"):
        with pytest.raises(
            BadInput, match=r"cannot write .*; choose a folder that can be written to$"
        ):
            write(bad, "new")
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link_and_others_may_read(tmp_path):
    path, link, plain = tmp_path / "out.txt", tmp_path / "link.txt", tmp_path / "plain"
    link.symlink_to(path)
    with replacing(link) as place:
        place.write_text("new")
    assert link.is_symlink()
    assert os.path.samefile(path, link)
    plain.touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_a_link_laid_where_something_will_be_written_is_not_followed(tmp_path: Path) -> None:
    victim, place = tmp_path / "victim", tmp_path / "result.txt"
    victim.write_text("mine")
    (tmp_path / "result.txt.partial").symlink_to(victim)
    with replacing(place) as partial:
        partial.write_text("new")
    assert victim.read_text() == "mine"
    assert place.read_text() == "new"
    assert not place.is_symlink()


def test_a_link_laid_meanwhile_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By somebody who waits for the moment in which the name is free."""
    victim, place = tmp_path / "victim", tmp_path / "result.txt"
    victim.write_text("mine")
    taken_away = Path.unlink

    def laid(path: Path, missing_ok: bool = False) -> None:
        taken_away(path, missing_ok)
        if not path.exists():
            path.symlink_to(victim)

    monkeypatch.setattr(Path, "unlink", laid)
    with pytest.raises(BadInput, match=r"cannot write .*result.txt \(File exists\)"):
        write(place, "new")
    assert victim.read_text() == "mine"
