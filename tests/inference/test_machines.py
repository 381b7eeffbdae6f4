"""Worker processes: who listens where, what they are told, and what if there are none."""

import os
import socket
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

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
def test_workers_are_listened_to_by_this_machine_alone_and_only_with_certificates():
    """Dask's pages ask nobody who they are: none is to be reached from elsewhere; and who shares
    the machine reaches every port, but is not let in."""
    pytest.importorskip("distributed")
    found, doors = [], set()
    for label, (payload, process, kind) in Machines(2).each(what_it_is, WORK):
        found.append((label, payload, kind))
        assert process != os.getpid()
        if not doors:
            doors = listening(os.getpid())
            said = [greeting(port) for _, port in doors if not is_locked(port)]
            assert len(doors) - len(said) >= 5  # a scheduler, two workers and their nannies
            assert {*said} <= {b"HTTP/"}  # pages of workers, which do nothing for anybody
    assert sorted(found) == [(number, 10 * number, "float64") for number in range(4)]
    assert {address for address, _ in doors} == {"0100007F"}


def greeting(port: int) -> bytes:
    """What somebody without a certificate is told at a port: dask's own words, a page, or (of who
    speaks TLS alone) nothing or an alert."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        try:
            line.sendall(b"GET / HTTP/1.0\r\n\r\n")
            return line.recv(5)
        except ConnectionError:
            return b""


def is_locked(port: int) -> bool:
    return greeting(port)[:1] in (b"", b"\x15")


def test_a_door_without_a_lock_is_found_out():
    """The same question put to dask without certificates."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=0,
        processes=False,
        host="127.0.0.1",
        protocol="tcp://",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
    ) as cluster:
        port = int(cluster.scheduler_address.rsplit(":", 1)[1])
        assert not is_locked(port)
        assert greeting(port) != b"HTTP/"


def fails(payload: int) -> int:
    raise BadInput(f"{payload} is no good; choose another")


@pytest.mark.slow
def test_what_workers_refuse_is_refused_here():
    pytest.importorskip("distributed")
    with pytest.raises(BadInput, match="0 is no good; choose another"):
        list(Machines(2).each(fails, WORK))


@pytest.mark.slow
def test_a_block_that_kills_its_workers_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("poseterior.inference.machines.DEATHS", 0)
    with pytest.raises(BadInput, match="workers died over block 0"):
        list(Machines(1).each(lambda payload: os._exit(1), WORK[:1], apart=True))


def test_nobody_is_asked_where_there_is_nothing_to_do(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("poseterior.inference.machines.SCHEDULER_PATIENCE", "1s")
    nobody = Machines(scheduler="tcp://127.0.0.1:9")
    assert list(nobody.each(what_it_is, [])) == []
    with pytest.raises(BadInput, match=r"no scheduler answers at 'tcp://127.0.0.1:9'"):
        list(nobody.each(what_it_is, WORK))
    with pytest.raises(BadInput, match=r"workers must be at least 1, not 0"):
        list(Machines(0).each(what_it_is, WORK))


def test_without_dask_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(BadInput, match=r"pip install 'poseterior\[evaluate\]'"):
        list(Machines(2).each(what_it_is, WORK))
