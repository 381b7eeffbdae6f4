"""`poseterior show`: how a file was read, as a picture and a table, and what speaks against that
reading; or a result of ours as a page."""

from pathlib import Path

import numpy as np

from poseterior.inference.readings import Judge, Verdict, together
from poseterior.probmodel import BadInput, Detection, PoseModel
from poseterior.probmodel.detections import people_said
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports import console, doubts, figures, tables
from poseterior.reports.interactive.page import write_page
from poseterior.reports.options import Estimation, Screen
from poseterior.reports.settings import ShowSettings


def run(settings: ShowSettings, screen: Screen) -> None:
    """Shows what there is: a detection, or a result. Raises `BadInput` on a bad file or image."""
    out = (
        _show_result(settings, screen)
        if settings.person.is_result
        else _show_reading(settings, screen)
    )
    if settings.open:
        console.open_page(out)


def _show_result(settings: ShowSettings, screen: Screen) -> Path:
    """Writes the page of a result, and returns its name."""
    from poseterior.reports.interactive.saved import page_of

    path, photo = settings.person.file, settings.person.detected.photo
    beside = (path if path.is_dir() else path.parent) / "hypotheses.html"
    out = console.output_file(settings.out or beside)
    if out.suffix.lower() not in (".html", ".htm"):
        raise BadInput("the page of a result is HTML; give --out a name that ends in .html")
    with console.progress("the page", screen.quiet):
        write_page(page_of(path, photo), out)
    console.show(screen.json, {"out": str(out)}, f"Written to {out}")
    return out


def _show_reading(settings: ShowSettings, screen: Screen) -> Path:
    """Writes the picture, whose name it returns, and says what was read and what is doubted."""
    shown = settings.person.detected.photo
    out = console.output_file(settings.out or Path("overlay.png"))
    with console.progress("reading", screen.quiet):
        people, person = settings.person.people, settings.person.detection
        model = settings.prior.model()
        settings.estimation.estimating(model)([])  # of nobody: settings are refused at once
    with console.progress("weighing other readings", screen.quiet):
        judge, sizes = Judge(model), doubts.size_is_open(person, settings.person.detected)
        alone = judge.file([person], sizes=sizes)
        verdict = together([alone, judge.file(doubts.others(people, person), sizes=sizes)])
    warnings = [*doubts.about_the_image(person, settings.person.detected.size), *verdict.warnings]
    own = [sentence for sentence in alone.warnings if sentence not in warnings]
    warnings += [f"{sentence} (person {person.person} alone)" for sentence in own]
    radius = _radius(person, settings.estimation, model)
    picture = figures.overlay_figure(person, radius, image=shown, warned=bool(warnings))
    figures.save_figure(picture, out)
    console.show(
        screen.json,
        _json(person, radius, verdict, warnings, out),
        tables.reading_table(person, radius),
        f"{person.layout}, {people_said(people)} in {person.source}, reading judged by"
        f" {len(verdict.gains)}. Written to {out}",
    )
    for sentence in warnings:
        console.warn(sentence)
    return out


def _radius(person: Detection, estimation: Estimation, model: PoseModel) -> np.ndarray | None:
    """`(15,)` pixels; None where the torso is not seen well enough for a scale."""
    try:
        frame = estimation.estimate(person, model)
    except BadInput:
        return None
    spread = frame.likelihood.spread(person, float(frame.best.camera.scale))
    return np.where(np.isfinite(spread), frame.likelihood.law.reach * spread, np.nan)


def _json(
    person: Detection, radius: np.ndarray | None, verdict: Verdict, warnings: list[str], out: Path
) -> dict[str, object]:
    joints = {
        JOINTS[joint]: {
            "keypoint": person.keypoints[joint].tolist(),
            "score": float(person.score[joint]),
            "radius": None if radius is None or np.isnan(radius[joint]) else float(radius[joint]),
        }
        for joint in np.flatnonzero(person.seen)
    }
    gains = verdict.gains.sum(axis=0).tolist() if len(verdict.gains) else []
    return {
        "source": person.source,
        "person": person.person,
        "layout": person.layout,
        "image_id": person.image_id,
        "joints": joints,
        "noticed": list(verdict.noticed),
        "warnings": warnings,
        "judged": len(verdict.gains),
        "gains": dict(zip(verdict.names, gains, strict=True)),
        "out": str(out),
    }
