"""The ways to say no: one sentence each, that says what is wrong, where, and what to do.

Raised anywhere below the command line; the command line prints the sentence and turns it into an
exit code."""


class BadInput(ValueError):
    """What was given cannot be used. The message is one sentence for the person who gave it (exit
    code 2)."""


class OutOfBudget(RuntimeError):
    """A sampler's budget ended, or can never suffice, before it had what was asked for (exit code
    3)."""
