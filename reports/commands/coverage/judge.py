"""`poseterior coverage judge`: anybody's draws beside truths: the verdict, and where they fail."""

from pathlib import Path
from typing import Any

from poseterior.inference.results import save_tree, versions
from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.files import read_judged
from poseterior.inference.studies.judging.judge import Judged, judge_brought, judge_levels
from poseterior.inference.studies.judging.repair import NO_POSTERIOR, recalibrate
from poseterior.probmodel import BadInput
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.judging import judged_figure
from poseterior.reports.options import Screen
from poseterior.reports.settings import CoverageJudgeSettings
from poseterior.reports.tables.judging import covered_table, judged_json, map_table


def run(settings: CoverageJudgeSettings, screen: Screen) -> None:
    """One file after the other. Raises `BadInput` where one cannot be judged."""
    found = {}
    for path in settings.files:
        with console.progress(f"tests of {path.name}", screen.quiet):
            found[path.stem] = _judged(settings, path)
    if screen.json:
        console.show_json({name: judged_json(one) for name, one in found.items()})
        return
    for name, one in found.items():
        _say(name, one)
    if settings.recalibrate:
        console.say(f"Written to {settings.recalibrate}: {NO_POSTERIOR}")


def _judged(settings: CoverageJudgeSettings, path: Path) -> Judged:
    brought = read_judged(path, tuple(settings.circular or ()))
    asked: dict[str, Any] = {"seed": settings.seed, "false_alarm": settings.false_alarm}
    if isinstance(brought, Brought):
        found = judge_brought(brought, **asked)
        covariates = brought.covariates
    else:
        level, covariates = brought
        found = judge_levels(level, covariates, **asked)
    about = asked | {"source": path.name, "versions": versions()}
    if settings.recalibrate:
        if settings.by and settings.by not in covariates:
            known = ", ".join(covariates) or "none"
            raise BadInput(f"{path} has no covariate {settings.by}; known are: {known}")
        by = (settings.by, covariates[settings.by]) if settings.by else None
        own = found.level.sel(quantity=found.quantities)
        recalibrate(own, by).save(settings.recalibrate, about)
    if settings.out:
        out = console.output_folder(settings.out)
        tree = found.tree
        tree.attrs.update(about)
        save_tree(tree, out / f"{path.stem}.nc")
        save_figure(judged_figure(found), out / f"{path.stem}.png")
    return found


def _say(name: str, found: Judged) -> None:
    console.OUT.print(covered_table(found))
    if found.map is not None:
        console.OUT.print(map_table(found))
    console.say(f"{name}: {found.verdict}: {found.sentence}")
    for note in found.notes:
        console.warn(note)
