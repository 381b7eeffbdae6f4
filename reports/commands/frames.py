"""`poseterior frames`: draws and hypotheses of everyone in many frames, a stream that is resumed
where it was stopped, and its film as a page."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.filesize import decimal

from poseterior.inference.films.sides import with_sides
from poseterior.inference.footage import Item
from poseterior.inference.measured import measures
from poseterior.inference.stream import DRAW_BYTES, People, open_stream, sample_frames
from poseterior.probmodel import Detection, PoseModel
from poseterior.probmodel.distance import nearest
from poseterior.probmodel.level import doubtful
from poseterior.probmodel.measures import USUAL
from poseterior.probmodel.sessions.turning import said_of
from poseterior.reports import console, doubts, figures, tables
from poseterior.reports.interactive.film import film_page
from poseterior.reports.interactive.page import write_page
from poseterior.reports.options import Screen
from poseterior.reports.settings import FilmSettings, FramesSettings


def run(settings: FramesSettings, screen: Screen) -> None:
    """Writes the stream. Raises `BadInput` on a bad file, or where the folder holds another run;
    frames that cannot be estimated are counted, and their reasons written."""
    out = settings.out
    console.output_folder(out)
    fragments, warnings = draw(settings, out, screen, composed=settings.composed)
    show(settings, fragments, screen)
    for sentence in warnings:
        console.warn(sentence)


def draw(
    settings: FramesSettings | FilmSettings,
    out: Path,
    screen: Screen,
    *,
    composed: bool = False,
    rate: float | None = None,
) -> tuple[list[str], list[str]]:
    """Writes the draws of everyone; or of one person alone, where frames come at a `rate` and so
    are a film. Says whom it left out, and what is doubtful about the others."""
    if settings.is_session:
        return [], _draw_session(settings, out, screen)
    with console.progress("limits and torsos", screen.quiet):
        size, exif, viewing = settings.size, settings.detected.photo_focal, settings.rooting
        model, metres = viewing.model(settings.prior), np.inf
        if viewing.asks_how_near:
            metres = nearest(_everyone(settings), size, model.lengths)
        model = viewing.seen_by(model, metres, size, exif)
        first = list(itertools.islice(_everyone(settings), doubts.MOST_PEOPLE))
        said = settings.detected.size
        others = (one for person in first for one in doubts.about_the_image(person, said))
        warnings = [
            *itertools.islice(others, 1),
            *doubts.about_the_size(first, settings.detected, model),
            *doubts.about_the_camera(metres, size, model, viewing, exif),
        ]
    estimating = settings.estimation.estimating(model)
    person = settings.person
    with console.progress("who is who", screen.quiet):
        people = People(lambda: settings.detected.frames(settings.path), estimating.require, person)
        seen = people.cast.frames
        if rate is not None and person is None and len(seen) > 1:
            person = seen.index(max(seen))
            people = people.of(person)
            warnings.append(
                f"there are {len(seen)} people in {settings.path}; this film is of person"
                f" {person}, who is seen most: --person chooses another"
            )
    warnings += settings.doubts(people.cast)
    if len(seen) > 1 and person is None and not screen.json:
        console.say(f"{people.described()}; --person draws one of them alone")
    _fill(
        model,
        people if rate is None else with_sides(people, rate, estimating.likelihood),
        len(people),
        settings,
        out,
        screen,
        estimating=estimating,
        root=settings.rooting.root.prior,
        num_roots=settings.rooting.roots,
        most_roots=settings.rooting.most,
        composed=composed,
    )
    return people.fragments, warnings


def _draw_session(settings: FramesSettings | FilmSettings, out: Path, screen: Screen) -> list[str]:
    """Writes the draws of what calibrated cameras saw; says what is doubtful about them."""
    with console.progress("the session", screen.quiet):
        model, footage = settings.prior.model(), settings.footage
        session = footage.session
        warnings = said_of(session, list(footage.world.views))
    if session.left_out:
        warnings.append(
            f"{session.left_out} of {session.left_out + len(session)} frames of {settings.path} are"
            " not drawn: not all cameras of the session (also those not chosen) see the person"
            " there, or their views do not agree"
        )
    _fill(model, footage, len(footage), settings, out, screen)
    return [*warnings, *doubtful(*footage.first.up)]


def _fill(
    model: PoseModel,
    items: Iterable[Item],
    number: int,
    settings: FramesSettings | FilmSettings,
    out: Path,
    screen: Screen,
    **own: Any,
) -> None:
    """Draws so many items into the stream, with what is their `own` for `sample_frames`."""
    import jax

    sampling = settings.sampling
    kept = min(settings.keep, sampling.num_samples)
    if kept > 0 and not screen.json:
        size = decimal(number * kept * DRAW_BYTES)
        console.say(f"{kept:,} draws are kept of each person: at most {size} in {out}")
    with console.progress("people", screen.quiet) as step:
        sample_frames(
            model,
            items,
            key=jax.random.key(sampling.seed),
            out=out,
            num_samples=sampling.num_samples,
            k=settings.k,
            keep=settings.keep,
            max_proposals=sampling.max_proposals,
            machines=settings.workforce.machines(),
            progress=lambda done: step(done, number),
            **own,
        )


def show(
    settings: FramesSettings | FilmSettings,
    fragments: Sequence[str],
    screen: Screen,
    about: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """The tables, the picture and the page of the stream in `settings.out`; what there is to say
    `about` it besides goes into the JSON."""
    out = settings.out
    with console.progress("the film", screen.quiet):
        tree = open_stream(out)
        summary, page = tree["summary"].to_dataset(), out / "hypotheses.html"
        filmed = bool((summary.num_draws > 0).any())
        if filmed:
            measured = measures(out, *USUAL) if tree.attrs["keep"] else None
            film = film_page(tree, settings.path.name, fragments=fragments, measured=measured)
            write_page(film, page)
            figures.save_figure(figures.film_figure(summary), out / "depth.png")
    pictures = "depth.png, hypotheses.html"
    said = f": {pictures}" if filmed else f", without {pictures}: no frame has a pose"
    opens = "open_stream opens it" + (", draws_of its draws" if tree.attrs["keep"] else "")
    console.show(
        screen.json,
        tables.stream_json(summary) | {"fragments": list(fragments), "out": str(out), **about},
        *tables.stream_lines(summary, fragments),
        tables.people_of_film(summary),
        tables.film_table(summary),
        f"Written to {out}{said}; poseterior.{opens}",
    )
    if settings.open and filmed:
        console.open_page(page)


def _everyone(settings: FramesSettings | FilmSettings) -> Iterator[Detection]:
    """Those by whom the size of all images, and how near the camera was, is judged."""
    return (one for frame in settings.detected.frames(settings.path) for one in frame.people)
