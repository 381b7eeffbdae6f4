"""The store of all long runs: what it keeps, finds damaged, refuses, and who may write to it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from poseterior.inference.machines import HERE, Machines
from poseterior.inference.store import Block, Damaged, Groups, Store, fill, locked
from poseterior.probmodel import BadInput

SETTINGS = {"seed": 0, "k": (2, 5)}


def doubled(payload: list[float]) -> Groups:
    return {"numbers": xr.Dataset({"twice": ("row", 2.0 * np.array(payload))})}


def blocks(*sizes: int, made_of: str = "rows") -> list[Block]:
    return [
        Block(number, f"block {number}", {"rows": made_of}, size, [float(number)] * size)
        for number, size in enumerate(sizes)
    ]


def run(
    folder: Path, wanted: list[Block], settings: dict = SETTINGS, machines: Machines = HERE
) -> list:
    """The numbers of the blocks that were made; all are taken, and hold what they should."""
    made: list[list[float]] = []
    taken: dict[int, xr.Dataset] = {}

    def task(payload: list[float]) -> Groups:
        made.append(payload)
        return doubled(payload)

    with locked(folder):
        store = Store.begin(folder, settings)
        fill(
            store,
            machines,
            task,
            wanted,
            lambda block, groups: taken.update({block.number: groups["numbers"]}),
        )
        store.finish(len(wanted))
    for block in wanted:
        some = taken[block.number].twice.values[: block.size]
        assert some.tolist() == [2.0 * block.number] * block.size
    return [int(payload[0]) for payload in made]


def test_what_is_there_is_not_made_again(tmp_path):
    assert run(tmp_path, blocks(3, 3)) == [0, 1]
    assert run(tmp_path, blocks(3, 3)) == []
    assert run(tmp_path, blocks(3, 3, 1)) == [2]
    assert run(tmp_path, blocks(3, 3, 2)) == [2]  # a block that is too short grows
    assert run(tmp_path, blocks(3, 3, 1)) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *(f"block-00000{number}.nc" for number in range(3)),
        "run.json",
    ]


@pytest.mark.parametrize("at", range(0, 10_000, 811))
def test_no_byte_changes_unnoticed(at, tmp_path):
    """Whatever byte of a block is another one: made anew, or it was one that says nothing."""
    run(tmp_path, blocks(3))
    path = tmp_path / "block-000000.nc"
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= 0xFF
    path.write_bytes(bytes(data))
    assert run(tmp_path, blocks(3)) in ([0], [])  # `run` sees to it that the numbers are right


def test_zeroed_numbers_are_noticed(tmp_path):
    """A block that is a whole netCDF file with other numbers, as a disk may leave it."""
    run(tmp_path, blocks(3, 3))
    with netCDF4.Dataset(tmp_path / "block-000001.nc", "a") as file:
        file["numbers/twice"][:] = 0.0
    assert run(tmp_path, blocks(3, 3)) == [1]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"seed": 1, "k": (2, 5)}, "its seed is 0, not 1"),
        ({"seed": 0, "k": (5,)}, r"its k is \[2, 5\], not \[5\]"),
        ({"seed": 0}, r"its k is \[2, 5\], not None"),
    ],
)
@pytest.mark.parametrize("lost", [False, True])
def test_another_run_is_refused_even_where_its_settings_were_lost(lost, settings, words, tmp_path):
    run(tmp_path, blocks(3, 3))
    if lost:
        (tmp_path / "run.json").unlink()
        (tmp_path / "block-000000.nc").unlink()
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(BadInput, match=f"holds another run .{words}"):
        run(tmp_path, blocks(3, 3), settings)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert run(tmp_path, blocks(3, 3)) == ([0] if lost else [])


def test_a_damaged_block_of_an_unknown_run_is_left_alone(tmp_path):
    """It may be anybody's."""
    (tmp_path / "block-000000.nc").write_text("important")
    with pytest.raises(BadInput, match=r"block-000000.nc is damaged, or no block of a run"):
        run(tmp_path, blocks(3))
    assert (tmp_path / "block-000000.nc").read_text() == "important"


def test_other_contents_and_longer_runs_are_refused(tmp_path):
    run(tmp_path, blocks(3, 3, 3))
    with pytest.raises(BadInput, match=r"block-000000.nc was made of other rows"):
        run(tmp_path, blocks(3, 3, 3, made_of="others"))
    with pytest.raises(BadInput, match=r"holds 1 more blocks .* of a longer one, block-000002.nc"):
        run(tmp_path, blocks(3, 3))


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_block_that_is_lost_is_named_on_opening(lost, tmp_path):
    run(tmp_path, blocks(3, 3, 3))
    (tmp_path / f"block-00000{lost}.nc").unlink()
    with pytest.raises(Damaged, match=rf"lacks 1 blocks, the first of them block-00000{lost}.nc"):
        Store.open(tmp_path, "a run")


def test_settings_that_are_none_are_refused(tmp_path):
    (tmp_path / "run.json").write_text("[1, 2")
    for call in (lambda: Store.open(tmp_path, "a run"), lambda: run(tmp_path, blocks(3))):
        with pytest.raises(BadInput, match=r"run.json cannot be read"):
            call()
    assert (tmp_path / "run.json").read_text() == "[1, 2"


def test_every_kind_of_number_comes_back(tmp_path):
    """Types that files change on the way do not count as damage."""
    every = xr.Dataset(
        {
            "float": ("row", np.array([-np.nan, np.nan, -0.0], np.float32)),
            "double": (("row", "column"), np.full((3, 2), -np.inf)),
            "whole": ("row", np.arange(3, dtype=np.int32)),
            "byte": ("row", np.arange(3, dtype=np.uint8)),
            "truth": ("row", np.array([True, False, True])),
            "text": ("row", np.array(["", "τ", "a\0b"], dtype=object)),
            "nothing": (("row", "none"), np.empty((3, 0))),
        },
        coords={"row": ["x", "y", "\ud800"]},
    )
    store = Store.begin(tmp_path, {})
    block = Block(0, "a block", {}, 3, None)
    store.write(block, {"one": every, "two": every})
    found = store.find(block)
    assert found is not None
    for name in ("float", "double", "whole", "byte", "truth"):
        np.testing.assert_array_equal(found["two"][name], every[name])
    assert found["one"].text.values.tolist() == ["", "τ", "a\\0b"]
    assert found["one"].row.values.tolist() == ["x", "y", "\\ud800"]


def test_a_full_disk_is_said(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr("poseterior.inference.store.save_tree", full)
    with pytest.raises(BadInput, match="make room, and run again"):
        run(tmp_path, blocks(1))


HOLDING = """
import sys, time
from pathlib import Path
from poseterior.inference.store import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_the_second_process_is_told_who_holds_the_folder_and_a_dead_one_lets_go(tmp_path):
    folder = tmp_path / "new"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDING, str(folder)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(BadInput, match=rf"written to by process {holder.pid} on .* since 20"):
            run(folder, blocks(1))
    finally:
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        holder.stdout.close()  # type: ignore[union-attr]
    assert run(folder, blocks(1)) == [0]
    assert not (folder / "run.lock").exists()


def test_a_folder_that_cannot_be_one_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot write to"):
        run(tmp_path / "file", blocks(1))


def test_a_pipe_in_the_place_of_a_block_is_not_waited_for(tmp_path):
    run(tmp_path, blocks(3, 3))
    (tmp_path / "block-000001.nc").unlink()
    os.mkfifo(tmp_path / "block-000001.nc")
    store = Store.open(tmp_path, "a run")
    with pytest.raises(BadInput, match=r"block-000001.nc is a named pipe, not a file; delete it"):
        store.read(1, "numbers")


def test_a_block_that_claims_to_be_huge_is_not_read(tmp_path):
    run(tmp_path, blocks(3, 3))
    with netCDF4.Dataset(tmp_path / "block-000001.nc", "a") as file:
        group = file["numbers"]
        group.createDimension("never", 10**9)
        group.createVariable("written", "f8", ("never",), zlib=True, chunksizes=(10**6,))
    store = Store.open(tmp_path, "a run")
    with pytest.raises(Damaged, match=r"block-000001.nc is damaged, or no block of a run"):
        store.read(1, "numbers")


@pytest.mark.parametrize("blocks", ['"two"', "-1", "1.5"])
def test_a_number_of_blocks_that_is_none_is_refused(blocks, tmp_path):
    (tmp_path / "run.json").write_text(f'{{"settings": {{}}, "blocks": {blocks}}}')
    with pytest.raises(BadInput, match=r"run.json cannot be read, or is not that of a run"):
        Store.open(tmp_path, "a run")


def test_a_million_million_missing_blocks_are_counted_only(tmp_path):
    (tmp_path / "run.json").write_text('{"settings": {}, "blocks": 1000000000000}')
    with pytest.raises(Damaged, match=r"lacks 1000000000000 blocks, the first .* block-000000.nc"):
        Store.open(tmp_path, "a run")


def test_a_lock_that_is_none_is_refused(tmp_path):
    os.mkfifo(tmp_path / "run.lock")
    words = r"cannot write to .* \(run.lock in it is no file\)"
    with pytest.raises(BadInput, match=words), locked(tmp_path):
        pass


def test_a_lock_of_any_bytes_is_spoken_of(tmp_path):
    with locked(tmp_path):
        (tmp_path / "run.lock").write_bytes(b"\xff\xfe")
        with pytest.raises(BadInput, match="is being written to by"), locked(tmp_path):
            pass
