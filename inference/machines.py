"""The one way to use many machines: blocks of work given to worker processes by dask.distributed,
on this machine or on a cluster that somebody else has started.

Without them (`Machines()`) work is done in this process, by threads, and dask is not needed. The
task reaches every worker once, those that come later included; a block whose worker dies goes to
another one.

    for label, result in Machines(workers=4).each(task, [(label, "block 0", payload), …]):
        …
"""

import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax

from poseterior.probmodel.failures import BadInput

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
            Where there is no scheduler or no worker, dask.distributed is not installed, or a block
            kills every worker that gets it.
        """
        if self.workers < 1:
            raise BadInput(f"the number of workers must be at least 1, not {self.workers}")
        waiting = iter(work)
        if self.workers == 1 and self.scheduler is None and not apart:
            for label, _, payload in waiting:
                yield label, task(payload)
            return
        first = next(waiting, None)
        if first is not None:
            with self._client() as client:
                yield from _spread(client, task, first, waiting)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        distributed = _library()
        if self.scheduler is None:
            # Whoever reaches a worker may have it run anything, and other users of this machine
            # reach it: all sides show certificates that are made here, for this run alone.
            certificates = _certificates()
            cache = jax.config.jax_compilation_cache_dir or os.environ.get(
                "JAX_COMPILATION_CACHE_DIR"
            )
            with (
                distributed.LocalCluster(
                    n_workers=self.workers,
                    threads_per_worker=1,
                    processes=True,
                    # Nobody but this machine is listened to, and there is no dashboard: dask's
                    # pages ask nobody who they are.
                    protocol="tls://",
                    security=certificates,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    env=ONE_THREAD | ({"JAX_COMPILATION_CACHE_DIR": cache} if cache else {}),
                    silence_logs="CRITICAL",
                    scheduler_kwargs={"allowed_failures": DEATHS, "dashboard": False},
                ) as cluster,
                distributed.Client(cluster, security=certificates) as client,
            ):
                yield client
            return
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


def _spread(client: Any, task: Any, first: Any, rest: Iterator[Any]) -> Iterator[tuple[Any, Any]]:
    """Results as they are done."""
    distributed = _library()
    client.register_plugin(_preparing(task), name="poseterior-task")
    running: dict[str, Any] = {}
    ready = distributed.as_completed([], with_results=False, raise_errors=False)

    def submit(one: Any) -> None:
        future = client.submit(_do, one[2], pure=False)
        running[future.key] = one
        ready.add(future)

    def top_up() -> None:
        while len(running) < WAITING * max(1, len(client.nthreads())):
            one = next(rest, None)
            if one is None:
                return
            submit(one)

    submit(first)
    top_up()
    for future in ready:
        label, words, _ = running.pop(future.key)
        try:
            result = future.result()
        except distributed.scheduler.KilledWorker:
            raise BadInput(
                f"{DEATHS} workers died over {words}; give them more memory, or leave that out"
            ) from None
        yield label, result
        top_up()


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
    try:
        import distributed
    except ImportError:
        raise _not_installed("distributed") from None
    return distributed


def _certificates() -> Any:
    """Of dask's own kind: they never leave the memory of this process and of those it starts."""
    try:
        return _library().Security.temporary()
    except ImportError:
        raise _not_installed("cryptography") from None


def _not_installed(package: str) -> BadInput:
    return BadInput(f"worker processes need {package}; pip install 'poseterior[evaluate]'")
