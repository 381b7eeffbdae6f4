"""Worker processes: who listens where, what they are told, and what if there are none."""

import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from poseterior.inference import machines
from poseterior.inference.machines import HERE, Machines, calm_blas, in_threads
from poseterior.probmodel import BadInput


def what_it_is(payload: int) -> tuple[int, int, str]:
    import jax.numpy as jnp

    return payload, os.getpid(), str(jnp.zeros(1).dtype)


WORK = [(number, f"block {number}", 10 * number) for number in range(4)]


def test_work_is_done_here_in_order_unless_asked():
    assert list(HERE.each(lambda payload: payload + 1, WORK)) == [(0, 1), (1, 11), (2, 21), (3, 31)]
    assert in_threads(pow, [2, 3], [3, 2]) == [8, 9]


def blas_threads() -> list[int]:
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]


def test_threads_of_blas_are_given_back_by_whoever_goes_last():
    """Two threads within at once, the first of them out first: it must lift nothing for the other,
    and the other must not leave behind what it found."""
    with threadpool_limits(2, user_api="blas"):
        found = blas_threads()
        first, second = calm_blas(), calm_blas()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert set(blas_threads()) == {1} != set(found)
        second.__exit__(None, None, None)
        assert blas_threads() == found


def listening(pid: int) -> set[tuple[str, int]]:
    """The addresses and ports at which a process and its children listen, as /proc has them."""
    pids, sockets = {pid}, set()
    for path in sorted(Path("/proc").glob("[0-9]*/stat"), key=lambda path: int(path.parent.name)):
        try:
            parent = int(path.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        if parent in pids:
            pids.add(int(path.parent.name))
    for one in pids:
        for link in Path(f"/proc/{one}/fd").iterdir():
            try:
                sockets.add(os.readlink(link))
            except OSError:
                continue
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in sockets:
                address, port = fields[1].split(":")
                found.add((address, int(port, 16)))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="sockets are found through /proc")
def test_workers_of_this_machine_listen_nowhere() -> None:
    """Nobody else can reach them; negative control: a socket that listens is found. 64-bit floats
    are set before anything is made."""
    found, before = [], listening(os.getpid())
    for label, (payload, process, kind) in Machines(2).each(what_it_is, WORK):
        found.append((label, payload, kind))
        assert process != os.getpid()
        assert listening(os.getpid()) == before
    assert sorted(found) == [(number, 10 * number, "float64") for number in range(4)]
    with socket.create_server(("127.0.0.1", 0)):
        assert len(listening(os.getpid())) == len(before) + 1


def fails(payload: int) -> int:
    raise BadInput(f"{payload} is no good; choose another")


@pytest.mark.slow
def test_what_workers_refuse_is_refused_here() -> None:
    with pytest.raises(BadInput, match="0 is no good; choose another"):
        list(Machines(2).each(fails, WORK))


def dies(payload: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return payload


class Once(NamedTuple):
    """Kills the worker of each block the first time, and does it the second."""

    folder: Path

    def __call__(self, payload: int) -> int:
        seen = self.folder / str(payload)
        if not seen.exists():
            seen.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return payload + 1


def killed_at_their_start(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """So many workers die before they have begun."""
    left, start = [number], machines._Worker.start

    def killed(task: bytes) -> machines._Worker:
        worker = start(task)
        if left[0]:
            left[0] -= 1
            worker.process.kill()
        return worker

    monkeypatch.setattr(machines._Worker, "start", killed)


@pytest.mark.slow
def test_a_block_that_kills_its_workers_is_named(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(machines, "DEATHS", 1)
    with pytest.raises(BadInput, match="more than 1 workers died over block 0; give them more"):
        list(Machines(1).each(dies, WORK[:1], apart=True))
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_blocks_of_killed_workers_go_to_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    """Killed at their start, or within a block: all is done, once, and nothing is said."""
    killed_at_their_start(monkeypatch, 2)
    found = sorted(Machines(2).each(Once(tmp_path), WORK[:3]))
    assert found == [(number, 10 * number + 1) for number in range(3)]
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_workers_that_all_die_at_their_start_are_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(machines, "DEATHS", 2)
    killed_at_their_start(monkeypatch, 100)
    with pytest.raises(BadInput, match="more than 2 workers died over block"):
        list(Machines(2).each(what_it_is, WORK))
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_workers_end_with_whoever_started_them(tmp_path: Path) -> None:
    """Also where that one is killed, and where nobody asks for the rest."""
    some = Machines(2).each(what_it_is, WORK)
    pids = [next(some)[1][1]]
    some.close()
    script = tmp_path / "start.py"
    script.write_text(STARTS)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    starter = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert starter.stdout is not None
    pids.append(int(starter.stdout.readline()))
    starter.kill()
    starter.wait()
    starter.stdout.close()
    ends = time.monotonic() + 60
    while any(map(alive, pids)) and time.monotonic() < ends:
        time.sleep(0.1)
    assert not any(map(alive, pids))
    assert alive(os.getpid())


STARTS = """
import time

from poseterior.inference.machines import Machines
from tests.inference.test_machines import WORK, what_it_is

if __name__ == "__main__":
    some = Machines(2).each(what_it_is, WORK)
    print(next(some)[1][1], flush=True)
    time.sleep(600)
"""


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_a_scheduler_that_dies_is_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    distributed = pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
    options = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--port", "0"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen([*start, *options], **quiet)
    worker = None
    try:
        while not file.exists():
            assert scheduler.poll() is None
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        ours = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny"]
        worker = subprocess.Popen([*ours, "--no-dashboard"], **quiet)
        with distributed.Client(address) as client:
            client.wait_for_workers(1)
        work = iter(Machines(scheduler=address).each(sleeps, WORK))
        next(work)
        scheduler.kill()
        with pytest.raises(BadInput, match=f"the scheduler at {address} is gone"):
            list(work)
    finally:
        for process in (scheduler, worker):
            if process is not None:
                process.kill()
                process.wait()
    assert capfd.readouterr().err == ""


def sleeps(payload: int) -> int:
    time.sleep(0.3)
    return payload


def test_nobody_is_asked_where_there_is_nothing_to_do(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("poseterior.inference.machines.SCHEDULER_PATIENCE", "1s")
    nobody = Machines(scheduler="tcp://127.0.0.1:9")
    assert list(nobody.each(what_it_is, [])) == []
    with pytest.raises(BadInput, match=r"no scheduler answers at 'tcp://127.0.0.1:9'"):
        list(nobody.each(what_it_is, WORK))
    with pytest.raises(BadInput, match=r"workers must be at least 1, not 0"):
        list(Machines(0).each(what_it_is, WORK))


def test_dask_that_a_command_has_hidden_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands hide it from xarray, which would import all of it."""
    pytest.importorskip("distributed")
    monkeypatch.setitem(sys.modules, "dask", None)  # type: ignore[arg-type]
    assert machines._library() is sys.modules["distributed"]
    assert importlib.import_module("dask").__name__ == "dask"


@pytest.mark.slow
def test_without_dask_one_machine_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """By this process, and by one of its own; a scheduler is what needs dask."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert [label for label, _ in HERE.each(what_it_is, WORK)] == [0, 1, 2, 3]
    ((label, (payload, process, _)),) = HERE.each(what_it_is, WORK[1:2], apart=True)
    assert (label, payload) == (1, 10)
    assert process != os.getpid()
    with pytest.raises(
        BadInput, match=r"a scheduler needs distributed; .*pip install '\.\[evaluate\]'"
    ):
        list(Machines(scheduler="tcp://127.0.0.1:9").each(what_it_is, WORK))
