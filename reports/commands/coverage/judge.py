"""`poseterior coverage judge`: anybody's draws beside truths: the verdict, and where they fail."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from poseterior.inference.results import save_tree, versions
from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.files import (
    Levels,
    joined,
    of_some_alone,
    read_judged,
)
from poseterior.inference.studies.judging.judge import Judged, judge_brought, judge_levels
from poseterior.inference.studies.judging.repair import NO_POSTERIOR, recalibrate
from poseterior.probmodel import BadInput
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.judging import judged_figure
from poseterior.reports.options import Screen
from poseterior.reports.settings import CoverageJudgeSettings
from poseterior.reports.tables.judging import covered_table, judged_json, map_table

TOGETHER = "together"
"""What several files are called that are judged as one."""


def run(settings: CoverageJudgeSettings, screen: Screen) -> None:
    """One file after the other, or all together. Raises `BadInput` where one cannot be judged."""
    found = {}
    for name, brought in _brought(settings):
        with console.progress(f"tests of {name}", screen.quiet):
            found[name] = _judged(settings, name, brought)
    if screen.json:
        console.show_json({name: judged_json(one) for name, one in found.items()})
        return
    for name, one in found.items():
        _say(name, one)
    if settings.recalibrate:
        console.say(f"Written to {settings.recalibrate}: {NO_POSTERIOR}")


def _brought(settings: CoverageJudgeSettings) -> Iterator[tuple[str, Brought | Levels]]:
    """What is judged, by name: each file, or all of them as one."""
    circular = tuple(settings.circular or ())
    each = ((name, read_judged(path, circular)) for name, path in settings.named.items())
    if settings.together:
        files = dict(each)
        whole = joined(files)
        if some := of_some_alone(files):
            console.warn(f"not all of the files have {', '.join(some)}; judged is what all have")
        yield TOGETHER, whole
    else:
        yield from each


def _judged(settings: CoverageJudgeSettings, name: str, brought: Brought | Levels) -> Judged:
    asked: dict[str, Any] = {"seed": settings.seed, "false_alarm": settings.false_alarm}
    if isinstance(brought, Brought):
        found = judge_brought(brought, **asked)
        covariates = brought.covariates
    else:
        level, covariates = brought
        found = judge_levels(level, covariates, **asked)
    source = ", ".join(settings.named) if settings.together else settings.named[name].name
    about = asked | {"source": source, "versions": versions()}
    if settings.recalibrate:
        if settings.by and settings.by not in covariates:
            known = ", ".join(covariates) or "none"
            raise BadInput(f"{name} has no covariate {settings.by}; known are: {known}")
        if settings.by and len(np.unique(covariates[settings.by])) == 1:
            raise BadInput(f"all of {name} have one {settings.by}; leave --by out")
        judged = found.level.notnull().any("quantity").values
        by = (settings.by, covariates[settings.by][judged]) if settings.by else None
        own = found.level.sel(quantity=found.quantities)[judged]
        recalibrate(own, by).save(settings.recalibrate, about)
    if settings.out:
        out = console.output_folder(settings.out)
        tree = found.tree
        tree.attrs.update(about)
        save_tree(tree, out / f"{name}.nc")
        save_figure(judged_figure(found), out / f"{name}.png")
    return found


def _say(name: str, found: Judged) -> None:
    console.OUT.print(covered_table(found))
    if found.map is not None:
        console.OUT.print(map_table(found))
    console.say(f"{name}: {found.verdict}: {found.sentence}")
    for note in found.notes:
        console.warn(note)
