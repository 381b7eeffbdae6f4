"""Text and JSON from outside: decoded and parsed only where the outcome fits into memory.

The usual way in: `read_json(path, what, advice)`; the readers of 2D joints hold their bytes already
and use `decoded`, `require_modest` and `json_failures`."""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, SupportsFloat

import numpy as np

from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import LARGEST_FILE, read_bytes

LARGEST_IN_MEMORY = 1_500_000_000
"""Bytes of memory that a text may take; one character beyond Latin-1 makes all of them wider."""
MOST_OBJECTS = 1_900_000_000
"""Bytes of memory that the objects of a document may take, by `cost`."""
FREE, DENSEST = 256_000_000, 20
"""A document that needs more than `FREE` bytes must not need more than `DENSEST` times its length.

Files of poses need 4 to 16 times theirs: they are numbers. One of empty objects needs 80 times."""
_COSTS = {"{": 200, "[": 64, ",": 34, '"': 25}
"""Bytes of memory in Python for what stands behind a character."""


def shortest(number: SupportsFloat) -> str:
    """A number in the fewest digits that are this double and no other, such as "30"."""
    return repr(float(number)).removesuffix(".0")


def decoded(data: bytes, source: str, advice: str) -> str:
    """UTF-8 text, without its byte-order mark. Raises `BadInput` where it is none, or too long."""
    highest = int(np.frombuffer(data, np.uint8).max(initial=0))
    width = 1 if highest < 0xC4 else 2 if highest < 0xF0 else 4
    if width * len(data) > LARGEST_IN_MEMORY:
        raise BadInput(f"{source} is too long a text ({len(data):,} bytes); split it into parts.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{source} is not UTF-8 text (byte {error.start} is not){advice}") from None


def cost(text: str) -> int:
    """Bytes of memory, roughly and rather too many, that a JSON document takes once parsed."""
    return 2 * len(text) + sum(text.count(mark) * each for mark, each in _COSTS.items())


def require_modest(text: str, source: str) -> None:
    """Raises `BadInput` where the document would take far more memory than a file of poses does."""
    needed = cost(text)
    if needed > MOST_OBJECTS or needed > max(FREE, DENSEST * len(text)):
        raise BadInput(
            f"{source} would take some {needed / 1e9:.1f} GB of memory as objects, more than a file"
            " of its kind; split it, or check what wrote it."
        )


@contextmanager
def json_failures(source: str) -> Iterator[None]:
    """Turns what the parser raises into `BadInput`."""
    try:
        yield
    except json.JSONDecodeError as error:
        raise BadInput(
            f"{source} is not valid JSON: {error.msg} at line {error.lineno}, column"
            f" {error.colno}; check that the file is complete."
        ) from None
    except RecursionError:
        raise BadInput(
            f"{source} is nested too deeply for a file of its kind; check what wrote it."
        ) from None
    except BadInput:
        raise
    except ValueError:  # an integer of more digits than Python converts
        raise BadInput(
            f"{source} holds a whole number of thousands of digits; check what wrote it."
        ) from None


Pairs = list[tuple[str, Any]]


def parsed(text: str, source: str, pairs: Callable[[Pairs], dict[str, Any]] = dict) -> Any:
    """The document, objects made of their `pairs`. Raises `BadInput` where it is not JSON, nested
    too deeply, or too large."""
    require_modest(text, source)
    with json_failures(source):
        return json.loads(text, object_pairs_hook=None if pairs is dict else pairs)


def read_text(
    path: str | os.PathLike, what: str, advice: str, *, largest: int = LARGEST_FILE
) -> str:
    """A text file. Raises `BadInput` as `files.opened` and `decoded`."""
    return decoded(read_bytes(path, what, advice, largest=largest), str(path), f"; {advice}")


def read_json(path: str | os.PathLike, what: str, advice: str) -> Any:
    """The document in a file. Raises `BadInput` where it cannot be read, is no JSON, or an object
    has a name twice, of which a reader would forget one without a word."""

    def once(pairs: Pairs) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            number = Counter(name for name, _ in pairs)
            raise BadInput(
                f"{path} has {shown(number.most_common(1)[0][0])} twice in one object; keep one of"
                " them"
            )
        return found

    return parsed(read_text(path, what, advice), str(path), once)
