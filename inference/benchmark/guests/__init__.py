"""Samplers on a frozen target that are not among the product's baselines: those of other libraries
as they come, and parallel tempering of our own (`ladder`), as none of them has a non-reversible
one.

    outcome = GUESTS["dynesty"].run(load("arm"), 3, Allowance(seconds=10))

All of them climb the graded likelihood from the prior, because an indicator gives nested and
tempered samplers nothing to climb (`graded`). Libraries are an extra
(`pip install '.[guests]'`); UltraNest, which is compiled where it is installed, is one of
its own."""

from typing import NamedTuple

from poseterior.inference.benchmark.guests.graded import Guest
from poseterior.inference.benchmark.guests.ladder import nrpt
from poseterior.inference.benchmark.guests.nested import dynesty, ultranest
from poseterior.inference.benchmark.guests.tempered import reddemcee


class Row(NamedTuple):
    """A guest: how it is run, how it is set up, and the package that it needs, if any, with the
    extra that brings it."""

    run: Guest
    note: str
    package: str = ""
    extra: str = "guests"


GUESTS: dict[str, Row] = {
    "dynesty": Row(dynesty, "dynesty's static sampler, 500 live points", "dynesty"),
    "ultranest": Row(
        ultranest,
        "UltraNest's reactive sampler, MLFriends, vectorised",
        "ultranest",
        extra="ultranest",
    ),
    "reddemcee": Row(reddemcee, "reddemcee's parallel tempering, ten temperatures", "reddemcee"),
    "nrpt": Row(
        nrpt,
        "non-reversible parallel tempering, ours: 4 × 24 levels, random-walk Metropolis, swaps of"
        " even and odd pairs in turn, levels spaced by the rejections of swaps",
    ),
}
"""Each guest by its name."""
