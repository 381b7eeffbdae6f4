"""The one way to use many processors: blocks of work given to worker processes of this machine, or
by dask.distributed to those of a cluster that somebody else has started.

Without them (`Machines()`) work is done in this process, by threads. The task reaches every worker
once, those that come later included; a block whose worker dies goes to another one. Workers of this
machine hear of their work through pipes: nobody else can reach them.

    for label, result in Machines(workers=4).each(task, [(label, "block 0", payload), …]):
        …
"""

import functools
import itertools
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

import jax

from poseterior.probmodel.failures import BadInput, installing, require_some

SCHEDULER_PATIENCE = "15s"
"""How long a scheduler may take to answer."""
DEATHS = 10
"""After so many deaths of workers over one block it is given up: the block kills them."""
WAITING = 3
"""Blocks that lie ready for each worker; more would only fill the scheduler's memory."""
ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"}
"""A worker is one thread: as many workers as there are cores share nothing, and sums have one order
everywhere."""
_TASK: list[Callable[[Any], Any]] = []
"""What this process does as a worker; empty where it is none."""


@dataclass(frozen=True)
class Machines:
    """Who does the work.

    Parameters
    ----------
    workers
        Processes of this machine; one means this process itself.
    scheduler
        The address of a dask scheduler whose workers do it instead, such as ``tcp://host:8786``,
        or ``tls://host:8786`` with the certificates that dask is configured with.
    """

    workers: int = 1
    scheduler: str | None = None

    def each[Label, Payload, Result](
        self,
        task: Callable[[Payload], Result],
        work: Iterable[tuple[Label, str, Payload]],
        *,
        apart: bool = False,
    ) -> Iterator[tuple[Label, Result]]:
        """The task's results, as they come.

        Parameters
        ----------
        task
            A function of one argument; where processes do it, one that they can import.
        work
            A label, words for sentences, and what the task gets; read as it is needed. Where there
            is none, no worker is asked for.
        apart
            Whether even a single worker is a process of its own, with one thread, so that results
            have the same bits however many workers there are.

        Yields
        ------
        label, result
            In the order of `work` in this process, in any order elsewhere.

        Raises
        ------
        BadInput
            Where a block kills every worker that gets it; of a scheduler, where there is none, it
            has no worker or dies, or dask.distributed is not installed.
        """
        require_some(self.workers, "workers")
        waiting = iter(work)
        if self.workers == 1 and self.scheduler is None and not apart:
            for label, _, payload in waiting:
                yield label, task(payload)
            return
        first = next(waiting, None)
        if first is None:
            return
        if self.scheduler is None:
            yield from _here(self.workers, task, first, waiting)
            return
        with self._client() as client:
            yield from _spread(client, task, first, waiting)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        distributed = _library()
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what fails becomes a sentence
        try:
            client = distributed.Client(self.scheduler, timeout=SCHEDULER_PATIENCE)
        except (OSError, ValueError, TimeoutError, ImportError) as error:
            raise BadInput(
                f"no scheduler answers at {self.scheduler!r} ({type(error).__name__}); start one"
                " with `dask scheduler`, and give its address, such as tcp://host:8786"
            ) from None
        with client:
            if not client.nthreads():
                raise BadInput(
                    f"the scheduler at {self.scheduler} has no workers; start some with `dask"
                    f" worker {self.scheduler}`"
                )
            yield client


HERE = Machines()
"""This process."""


def in_threads[Result](function: Callable[..., Result], *rows: Iterable[Any]) -> list[Result]:
    """The function of every row, by all cores; by one thread in a worker process, which shares the
    machine with others."""
    with ThreadPoolExecutor(1 if _TASK else os.cpu_count()) as threads:
        return list(threads.map(function, *rows))


_blas = threading.Lock()
_limits: list[Any] = []
"""One for each thread that is within `calm_blas`; the first holds what was found."""


@contextmanager
def calm_blas() -> Iterator[None]:
    """Keeps BLAS to one thread, for problems so small that many would spend their time waiting for
    each other. The number is the process's own: whoever comes first sets it and whoever goes last
    sets it back, or a thread that comes second would find, and leave behind, the first one's."""
    with _blas:
        _limits.append(_limits[0] if _limits else _libraries().limit(limits=1))
    try:
        yield
    finally:
        with _blas:
            limit = _limits.pop()
            if not _limits:
                limit.restore_original_limits()


@functools.cache
def _libraries() -> Any:
    """The libraries of linear algebra that are loaded: to look for them takes milliseconds."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


class _Worker(NamedTuple):
    """A process of this machine, and the pipe to it."""

    process: Any
    pipe: Connection

    @classmethod
    def start(cls, task: bytes) -> "_Worker":
        """One that makes itself ready for a pickled task."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        cache = jax.config.jax_compilation_cache_dir
        process = context.Process(target=_serve, args=(theirs, task, cache), daemon=True)
        process.start()
        theirs.close()
        return cls(process, ours)

    def give(self, payload: Any) -> None:
        """Hands over a block; whether it was taken, the answer says."""
        with suppress(OSError):
            self.pipe.send(payload)

    def answer(self) -> tuple[bool, Any] | None:
        """Whether the block is done, and its result or the failure; None where it has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def stop(self) -> None:
        """Ends it, whatever it does."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _serve(pipe: Connection, task: bytes, cache: str | None) -> None:
    """What a worker of this machine does, until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it ends it
    os.environ.update(ONE_THREAD)
    if cache:
        jax.config.update("jax_compilation_cache_dir", cache)
    prepare(task)
    with suppress(EOFError, OSError):  # whoever started it has gone
        while True:
            payload = pipe.recv()
            try:
                answer = (True, _do(payload))
            except Exception as error:
                answer = (False, error)
            pipe.send(answer)


def _here(number: int, task: Any, first: Any, rest: Iterator[Any]) -> Iterator[tuple[Any, Any]]:
    """Results as they are done, by processes of this machine, each of which has one block."""
    data, deaths = pickle.dumps(task), Counter[Any]()
    working: dict[Connection, tuple[_Worker, Any]] = {}

    def set_to_work(one: Any, worker: _Worker | None = None) -> None:
        worker = worker or _Worker.start(data)
        worker.give(one[2])
        working[worker.pipe] = worker, one

    try:
        for one in itertools.islice(itertools.chain([first], rest), number):
            set_to_work(one)
        while working:
            for pipe in wait(list(working)):
                worker, one = working.pop(pipe)  # type: ignore[call-overload]
                found = worker.answer()
                if found is None:
                    worker.stop()
                    deaths[one[1]] += 1
                    if deaths[one[1]] > DEATHS:
                        raise _deadly(one[1])
                    set_to_work(one)
                    continue
                done, result = found
                if not done:
                    worker.stop()
                    raise result
                following = next(rest, None)
                if following is None:
                    worker.stop()
                else:
                    set_to_work(following, worker)
                yield one[0], result
    finally:
        for worker, _ in working.values():
            worker.stop()


def _deadly(words: str) -> BadInput:
    return BadInput(
        f"more than {DEATHS} workers died over {words}; give them more memory, or leave that out"
    )


def _spread(client: Any, task: Any, first: Any, rest: Iterator[Any]) -> Iterator[tuple[Any, Any]]:
    """Results as they are done, by the workers of a scheduler."""
    distributed = _library()
    running: dict[str, Any] = {}
    with _reached(client):
        client.register_plugin(_preparing(task), name="poseterior-task")
        ready = distributed.as_completed([], with_results=False, raise_errors=False)

    def submit(one: Any) -> None:
        with _reached(client):
            future = client.submit(_do, one[2], pure=False)
        running[future.key] = one
        ready.add(future)

    def places() -> int:
        with _reached(client):
            return WAITING * max(1, len(client.nthreads()))

    submit(first)
    for one in itertools.islice(rest, places() - 1):
        submit(one)
    for future in ready:
        label, words, _ = running.pop(future.key)
        try:
            with _reached(client):
                result = future.result()
        except distributed.scheduler.KilledWorker:
            raise _deadly(words) from None
        yield label, result
        for one in itertools.islice(rest, max(0, places() - len(running))):
            submit(one)


@contextmanager
def _reached(client: Any) -> Iterator[None]:
    """Turns what dask says where its scheduler has died into `BadInput`."""
    distributed = _library()
    try:
        yield
    except (distributed.client.FutureCancelledError, distributed.comm.CommClosedError):
        raise BadInput(
            f"the scheduler at {client.scheduler.address} is gone; start it anew, and run again:"
            " what is done is kept"
        ) from None


def _preparing(task: Any) -> Any:
    """A plugin that makes every process that joins a worker for `task`."""
    from distributed import WorkerPlugin
    from distributed.protocol.pickle import dumps

    class Prepare(WorkerPlugin):
        """Carries the task in bytes: its arrays must not be made before 64-bit floats are set."""

        def __init__(self, data: bytes) -> None:
            self.data = data

        def setup(self, worker: Any) -> None:
            from poseterior.inference import machines

            machines.prepare(self.data)

    return Prepare(dumps(task))


def prepare(data: bytes) -> None:
    """Makes this process a worker for a pickled task: 64-bit floats before anything is compiled."""
    from distributed.protocol.pickle import loads

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    _TASK[:] = [loads(data)]


def _do(payload: Any) -> Any:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return _TASK[-1](payload)


def _library() -> Any:
    if sys.modules.get("dask", sys) is None:  # a command hides it from xarray
        del sys.modules["dask"]
    try:
        import distributed
    except ImportError:
        raise BadInput(
            f"a scheduler needs distributed; {installing('evaluate')}; or leave the scheduler out:"
            " workers of this machine need none"
        ) from None
    return distributed
