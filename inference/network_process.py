"""The process in which a network of unknown origin runs: it can be ended, and has only so much
memory.

Run as a script, so that nothing of this package is imported (it starts in a fraction of a second):

    python network_process.py MODEL MEMORY_BYTES

It says on its output what the network takes, then answers every image on its input with the
network's outputs, until its input ends. A message is its length (8 bytes), the length of its JSON
header (8 bytes), the header, and the bytes of the arrays that the header lists; nothing is
pickled."""

import json
import math
import os
import struct
import sys
from collections.abc import Sequence
from queue import Queue
from threading import Thread
from typing import Any, BinaryIO

import numpy as np

LENGTHS = struct.Struct("<QQ")


def send(file: BinaryIO, header: dict[str, Any], arrays: Sequence[np.ndarray] = ()) -> None:
    """Writes one message."""
    forms = [(array.dtype.str, array.shape) for array in arrays]
    text = json.dumps(header | {"arrays": forms}).encode()
    parts = [np.ascontiguousarray(array).tobytes() for array in arrays]
    file.write(LENGTHS.pack(len(text) + sum(map(len, parts)), len(text)))
    for part in (text, *parts):
        file.write(part)
    file.flush()


def receive(file: BinaryIO) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Reads one message. Raises `EOFError` where it is cut short."""
    total, length = LENGTHS.unpack(_exactly(file, LENGTHS.size))
    header, content = json.loads(_exactly(file, length)), _exactly(file, total - length)
    arrays, place = [], 0
    for code, shape in header.pop("arrays"):
        dtype, count = np.dtype(code), math.prod(shape)
        arrays.append(np.frombuffer(content, dtype, count, place).reshape(shape))
        place += count * dtype.itemsize
    return header, arrays


def _exactly(file: BinaryIO, length: int) -> bytes:
    data = file.read(length)
    if len(data) != length:
        raise EOFError
    return data


def _limit_memory(size: int) -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    resource.setrlimit(resource.RLIMIT_AS, (size, size))


def _images(file: BinaryIO, waiting: Queue) -> None:
    """Passes images on; once nobody is there to send any, ends the process, whatever it is at."""
    try:
        while True:
            waiting.put(receive(file)[1][0])
    except (EOFError, OSError):
        os._exit(0)


def main(model: str, memory: str) -> None:
    """Loads the network and answers until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever the network prints is no answer
    waiting: Queue = Queue()
    Thread(target=_images, args=(sys.stdin.buffer, waiting), daemon=True).start()
    _limit_memory(int(memory))
    try:
        import onnxruntime

        settings = onnxruntime.SessionOptions()
        settings.log_severity_level = 4
        session = onnxruntime.InferenceSession(model, settings, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own errors share no class but this
        send(answers, {"error": words(error)})
        return
    inputs = [(i.name, [_side(side) for side in i.shape], i.type) for i in session.get_inputs()]
    send(answers, {"inputs": inputs})
    while True:
        try:
            outputs = session.run(None, {inputs[0][0]: waiting.get()})
            arrays = [array for array in outputs if isinstance(array, np.ndarray)]
            send(answers, {}, [array for array in arrays if array.dtype.kind in "fiu"])
        except Exception as error:  # see above
            send(answers, {"error": words(error)})


def _side(side: object) -> int | str:
    return side if isinstance(side, int) else str(side)


def words(error: Exception) -> str:
    """What an error says, on one line and not for ever."""
    return (" ".join(str(error).split()) or type(error).__name__)[:200]


if __name__ == "__main__":
    main(*sys.argv[1:])
