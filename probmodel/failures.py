"""The ways to say no: one sentence each, that says what is wrong, where, and what to do.

Raised anywhere below the command line; the command line prints the sentence and turns it into an
exit code."""

import reprlib


class BadInput(ValueError):
    """What was given cannot be used. The message is one sentence for the person who gave it (exit
    code 2)."""


class OutOfBudget(RuntimeError):
    """A sampler's budget ended, or can never suffice, before it had what was asked for (exit code
    3)."""


def require_some(number: int, what: str) -> None:
    """Raises `BadInput` where a number of something is below one."""
    if number < 1:
        raise BadInput(f"the number of {what} must be at least 1, not {number}")


def installing(extra: str) -> str:
    """How an extra of this package is installed, for a message. It is on no index, so that its name
    alone would install nothing."""
    return f"pip install '.[{extra}]' in a clone of poseterior, or 'WHEEL[{extra}]' of its wheel"


LONGEST_SHOWN = 120


def shown(value: object) -> str:
    """A short form of any value for a message: never long, never recursing deeply, no control
    character as it is."""
    text = reprlib.repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"
