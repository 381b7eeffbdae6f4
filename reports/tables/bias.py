"""Tables of the bias of motion capture: how likely actions are, and how much of the prior is ever
visited."""

import math
from collections.abc import Iterable

from poseterior.inference.studies.evaluation.bias import ANGLES, Bias
from poseterior.reports.tables.sheet import Sheet, sheet_of

VISITS_CAPTION = (
    "Share of the prior's draws for which some pose of the data set has all bones of the part"
    " pointing within the angle; and for which one of as many other draws of the prior has."
)


def actions_table(bias: Bias) -> Sheet:
    """How likely each action is under the mixture and under the uniform prior."""
    rows = [
        [one.action, one.poses, one.mixture, one.uniform, 100 * one.possible]
        for one in bias.actions
    ]
    mixture = _range(one.mixture.value for one in bias.actions)
    uniform = _range(one.uniform.value for one in bias.actions)
    caption = (
        "Mean log likelihood, nats a pose above the mean of the actions. Gaussian mixture:"
        f" {bias.components} components fitted to the other half of {bias.poses:,} poses; from the"
        f" least to the most likely action it spans {mixture:.1f} nats, the uniform prior (by"
        f" area) {uniform:.1f}, of the poses it holds possible."
    )
    head = ["action", "poses", "Gaussian mixture", "uniform prior", "possible %"]
    title = "Bias: how likely the actions are"
    return sheet_of(head, rows, name="bias", title=title, caption=caption)


def _range(values: Iterable[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return max(known) - min(known) if known else math.nan


def visits_table(bias: Bias) -> Sheet:
    """How much of the prior some pose of the data set comes close to, part by part."""
    rows = [[one.part, *(100 * share for share in (*one.data, *one.prior))] for one in bias.visits]
    whose = ("data", "prior itself")
    head = ["part", *(f"{who} within {angle:.0f}° %" for who in whose for angle in ANGLES)]
    title = "Bias: how much of the prior is ever visited"
    return sheet_of(head, rows, name="visits", title=title, caption=VISITS_CAPTION)
