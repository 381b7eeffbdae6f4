"""Tables of a detector's error law."""

import numpy as np

from poseterior.inference.studies.errorlaws import Learned
from poseterior.probmodel.errors.detector import Exchange
from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.layouts import MIDPOINTS
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from poseterior.reports.tables.sheet import Column, Sheet, sheet_of

FILM_SECONDS = (1.0, 10.0)
"""Of films, of which it is said what they are worth."""


def errors_table(found: Learned) -> Sheet:
    """A line a joint: spread, share of inliers and bias, with standard errors."""
    errors = found.errors
    rows = []
    for joint in np.flatnonzero(errors.known):
        values = (errors.sigma[joint], errors.inlier[joint], *errors.bias[joint])
        cells = [_with_error(*one) for one in zip(values, errors.se[joint], strict=True)]
        rows.append([JOINTS[joint], int(errors.pairs[joint]), *cells])
    head = ["joint", "pairs", "sigma", "inliers", "bias right", "bias down"]
    caption = (
        f"{errors.law.name}; lengths in body units (the mean limb bone is 1). In parentheses the"
        " standard errors of the last digits, from leaving recordings out in turn."
    )
    columns = [Column(one) for one in head]
    return sheet_of(columns, rows, name="errors", title="The error law", caption=caption)


def definitions_table(found: Learned) -> Sheet:
    """A line a joint that is not where the skeleton has it: by how much, with standard errors."""
    errors = found.errors
    rows = [
        [JOINTS[joint], *(_with_error(*one) for one in zip(*parts, strict=True))]
        for joint in np.flatnonzero(errors.definition_sd.any(axis=1))
        for parts in [(errors.definition[joint], errors.definition_sd[joint])]
    ]
    columns = [Column(one) for one in ("joint", "to the left", "up", "forward")]
    caption = (
        "Where the detector's points lie beside the skeleton's joints, in the axes of the person's"
        " torso; body units."
    )
    title = "What the detector calls a joint"
    return sheet_of(columns, rows, name="definitions", title=title, caption=caption)


def _with_error(value: float, error: float) -> str:
    """Such as 0.059(17): the standard error is of the last digits."""
    return f"{value:.3f}({1000 * error:.0f})".replace("-", "−")


def summary_lines(found: Learned) -> list[str]:
    """What holds for all joints, in sentences."""
    errors = found.errors
    lines = []
    if isinstance(errors.law, Student):
        fitted = found.fit.mixture.df
        of_fit = f"{fitted:.1f} ± {found.df_se:.1f}" if np.isfinite(fitted) else "a Gaussian's"
        lines.append(
            f"Degrees of freedom: {errors.law.df:.1f}; of the errors learned from {of_fit}, the"
            " fewer the recordings the less is that known"
        )
    shares = zip(Exchange._fields, errors.exchange, found.exchange_se, strict=True)
    said = ", ".join(f"{name} {100 * p:.1f} ± {100 * se:.1f} %" for name, p, se in shares)
    lines.append(f"Exchanged sides: {said}")
    for right, _ in MIDPOINTS.values():
        common = found.common[JOINT_INDEX[right]]
        if round(common, 2):
            lines.append(
                f"Both {right.removeprefix('right_')}s err together (correlation {common:.2f}):"
                f" their sigma is {np.sqrt(1 + common):.2f} times as large as their errors, to be"
                " right about the point between them"
            )
    if errors.score.edges:
        edges = ", ".join(f"{edge:.3g}" for edge in errors.score.edges)
        factors = ", ".join(f"{factor:.2f}" for factor in errors.score.sigma_factor)
        lines.append(f"Scores cut at {edges}: sigma times {factors}")
    return lines


def times_lines(times: ErrorTimes) -> list[str]:
    """How long errors last, and what a film is worth, in sentences."""
    parts = zip(("constant", "slow", "quick"), times[:3], times.se, strict=False)
    said = ", ".join(f"{name} {100 * share:.0f} ± {100 * se:.0f} %" for name, share, se in parts)
    worth = " and ".join(
        f"{seconds:g} s {times.worth(round(seconds * times.rate), times.rate):.1f}"
        for seconds in FILM_SECONDS
    )
    lasts = f"{times.seconds:.2f} ± {times.se[3]:.2f} s"
    if times.seconds >= times.longest:
        lasts = f"{times.longest:.2f} s at least, and a longer film may count them as constant"
    return [
        f"Of the errors' variance: {said}; slow errors last {lasts}",
        f"Frames with errors of their own that a film is worth, to the mean of a joint at rest:"
        f" {worth}",
    ]
