"""Workers: processes of this machine, or of a cluster somebody else has started, that judge blocks
of frames.

dask.distributed gives each block to a worker, and to another one when that one dies. What is done
with frames (`Protocol`) reaches every worker once, those that come later included."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from inference.studies.evaluation.conditions import Condition
from inference.studies.evaluation.outcome import Protocol, judge_block
from probmodel.datasets import DataSet
from probmodel.failures import BadInput

PATIENCE = "15s"
"""How long a scheduler may take to answer."""
DEATHS = 10
"""So many workers may die over one block before it is given up: it is the block that kills them
then."""
WAITING = 3
"""Blocks that lie ready for each worker; more would only fill the scheduler's memory."""
ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"}
"""A worker is one thread: as many of them as there are cores share nothing, and sums are in one
order everywhere."""


class Work(NamedTuple):
    """A block of frames under a condition; `data` are its cases alone, `first` the number of the
    first of them."""

    condition: Condition
    block: int
    first: int
    data: DataSet


class Done(NamedTuple):
    """A block that has been judged."""

    condition: Condition
    block: int
    values: dict[str, np.ndarray]


@contextmanager
def client(workers: int, scheduler: str | None, cache: str | None) -> Iterator[Any]:
    """A client of `workers` processes of this machine, or of the cluster at the address
    `scheduler`; they keep compiled code in the folder `cache`. Raises `BadInput` where there is no
    scheduler, or dask.distributed is not installed."""
    if workers < 1:
        raise BadInput(f"the number of workers must be at least 1, not {workers}")
    distributed = _library()
    if scheduler is None:
        environment = ONE_THREAD | ({"JAX_COMPILATION_CACHE_DIR": cache} if cache else {})
        with (
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=":0",
                env=environment,
                silence_logs="CRITICAL",
                scheduler_kwargs={"allowed_failures": DEATHS},
            ) as cluster,
            distributed.Client(cluster) as found,
        ):
            yield found
        return
    try:
        found = distributed.Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError, TimeoutError, ImportError) as error:
        raise BadInput(
            f"no scheduler answers at {scheduler!r} ({type(error).__name__}); start one with `dask"
            " scheduler`, and give its address, such as tcp://host:8786"
        ) from None
    with found:
        if not found.scheduler_info()["workers"]:
            raise BadInput(
                f"the scheduler at {scheduler} has no workers; start some with `dask worker"
                f" {scheduler}`"
            )
        yield found


def judge(found: Any, protocol: Protocol, work: Iterable[Work]) -> Iterator[Done]:
    """Blocks as they are done, in no order. Raises `BadInput` where one kills every worker that it
    is given to."""
    distributed = _library()
    from inference.studies.evaluation.plugin import Prepare

    found.register_plugin(Prepare(protocol), name="poseterior-protocol")
    waiting = iter(work)
    ready = distributed.as_completed([], with_results=False, raise_errors=False)
    submitted: dict[str, Work] = {}

    def submit(number: int) -> None:
        for _, one in zip(range(number), waiting, strict=False):
            future = found.submit(_judged, *one, pure=False)
            submitted[future.key] = one
            ready.add(future)

    submit(WAITING * max(1, len(found.scheduler_info()["workers"])))
    for future in ready:
        one = submitted.pop(future.key)
        try:
            values = future.result()
        except distributed.scheduler.KilledWorker:
            raise BadInput(
                f"{DEATHS} workers died over frames {one.first} to {one.first + len(one.data) - 1} "
                f"({one.condition.name}); give them more memory, or leave those frames out"
            ) from None
        yield Done(one.condition, one.block, values)
        submit(1)


_HELD: list[Protocol] = []
"""What this worker has been told to do."""


def _judged(condition: Condition, block: int, first: int, data: DataSet) -> dict[str, np.ndarray]:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return judge_block(_HELD[-1], condition, data, first)


def prepare(protocol: Protocol) -> None:
    """Makes this process a worker for `protocol`: 64-bit floats before anything is compiled."""
    import jax

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    _HELD[:] = [protocol]


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise BadInput(
            "evaluation needs zarr and distributed; pip install 'poseterior[evaluate]'"
        ) from None
    return distributed
