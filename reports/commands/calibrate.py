"""`poseterior calibrate`: how a detector errs, learned from what it says beside the truth."""

from poseterior.inference.studies.errorlaws import (
    Definitions,
    Learned,
    Pairs,
    definitions_of_data,
    definitions_of_session,
    learn,
    pairs_of_data,
    pairs_of_session,
    seen_offsets,
    times_of_session,
)
from poseterior.probmodel import BadInput
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.sessions.turning import said_of
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.errorlaws import residuals_figure
from poseterior.reports.options import Screen
from poseterior.reports.settings import CalibrateSettings
from poseterior.reports.tables.errorlaws import (
    definitions_table,
    errors_table,
    summary_lines,
    times_lines,
)


def run(settings: CalibrateSettings, screen: Screen) -> None:
    """Writes the law, and beside it a picture of residuals against it. Raises `BadInput` on bad
    input, and where pairs are too few."""
    out = console.output_file(settings.out)
    picture = out.with_suffix(".png")
    if picture == out:
        raise BadInput(f"{out} would be overwritten by its own picture; name it NAME.json")
    console.output_file(picture)
    times = times_of(settings)
    definitions = definitions_of(settings)
    pairs, truth = pairs_of(settings, definitions)
    with console.progress("fits", screen.quiet) as step:
        found = learn(
            pairs,
            law=settings.law,
            truth=truth,
            about=settings.described(),
            definitions=definitions,
            times=times,
            progress=step,
        )
    found.errors.write(out)
    save_figure(residuals_figure(found), picture)
    if not found.fit.converged:
        console.warn("the fit did not come to rest; its last step is written: take more frames")
    for sentence in said_of(settings.data) if isinstance(settings.data, Session) else ():
        console.warn(sentence)
    show(found, screen)
    if not screen.json:
        console.say(f"Written to {out} and {picture}")


def show(found: Learned, screen: Screen) -> None:
    """The law on stdout, and how long errors last where that is known."""
    times = found.errors.times
    lines = summary_lines(found) + ([] if times is None else times_lines(times))
    sheets = errors_table(found), definitions_table(found)
    console.show(screen.json, found.errors.document(), *sheets, *lines)


def times_of(settings: CalibrateSettings) -> ErrorTimes | None:
    """How long errors last, where the rate is given. Raises `BadInput` on one that cannot be, and
    on too short a film."""
    if settings.fps is None or not isinstance(settings.data, Session):
        return None
    return times_of_session(settings.data, settings.fps, perspective=settings.perspective)


def definitions_of(settings: CalibrateSettings) -> Definitions:
    """Where the detector's points lie beside the skeleton's joints. Raises `BadInput` on too short
    a film."""
    if isinstance(settings.data, Session):
        return definitions_of_session(settings.data)
    return definitions_of_data(settings.data)


def pairs_of(settings: CalibrateSettings, definitions: Definitions) -> tuple[Pairs, Pairs | None]:
    """The pairs, and those that say how far the truth errs where they are others. Raises `BadInput`
    where perspective is asked of data that have no calibrated cameras."""
    if isinstance(settings.data, Session):
        exact = pairs_of_session(settings.data, perspective=True)
        rows = evenly(len(exact), settings.frames)
        if settings.perspective:
            return exact.take(rows), None
        return pairs_of_session(settings.data).take(rows), exact.take(rows)
    if settings.perspective:
        raise BadInput(
            f"--perspective needs calibrated cameras, which {settings.dataset} has not; leave it"
            " out"
        )
    pairs = pairs_of_data(settings.data, seen_offsets(definitions, settings.data))
    return pairs.take(evenly(len(pairs), settings.frames)), None
