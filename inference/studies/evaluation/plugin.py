"""What gets a worker ready. Imported only where dask.distributed is at hand, one of whose classes
it extends."""

from typing import Any

from distributed import WorkerPlugin

from inference.studies.evaluation import workers
from inference.studies.evaluation.outcome import Protocol


class Prepare(WorkerPlugin):
    """Tells a worker, whenever it joins, what to do with frames."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol

    def setup(self, worker: Any) -> None:
        workers.prepare(self.protocol)
