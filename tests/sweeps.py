"""Parameters of which the quick run takes some, and `make test-all` the rest."""

from collections.abc import Iterable
from typing import Any

import pytest


def sweep(values: Iterable[Any], quick: Iterable[Any]) -> list[Any]:
    """The values, those that are not in `quick` marked slow: tests whose cost is compilation look
    at the smallest instance of each kind, and at all others with the statistical sweeps."""
    chosen = list(quick)
    return [
        value if value in chosen else pytest.param(*_several(value), marks=pytest.mark.slow)
        for value in values
    ]


def _several(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
