"""`poseterior film`: whole paths of one person in a film, a stream whose draws follow each other in
time, and its page."""

import math
from pathlib import Path

import numpy as np
import xarray as xr

from poseterior.inference.films.film import FRAMES_FOLDER, film_of
from poseterior.inference.stream import draws_of, open_stream
from poseterior.reports import console
from poseterior.reports.commands import frames
from poseterior.reports.options import Screen
from poseterior.reports.settings import FilmSettings


def run(settings: FilmSettings, screen: Screen) -> None:
    """Writes the film. Raises `BadInput` on a bad file, a rate that cannot be, several people of
    whom none is chosen, and where the folder holds another run."""
    out = settings.out
    console.output_folder(out)
    fragments: list[str] = []
    warnings: list[str] = []
    names, stream, person = None, settings.path, settings.person
    if not settings.drawn_before:
        stream, names, person = out / FRAMES_FOLDER, settings.names, None
        fragments, warnings = frames.draw(settings, stream, screen, rate=settings.fps)
    with console.progress("paths", screen.quiet) as step:
        film_of(
            stream,
            rate=settings.fps,
            out=out,
            person=person,
            frames=names,
            cutoff=settings.cutoff,
            k=settings.k,
            progress=step,
        )
    film = open_stream(out)
    lenses = _focal_lengths(out, film)
    frames.show(settings, fragments, screen, {"focal": lenses})
    about, number = film.attrs, film["summary"].sizes["frame"]
    if not screen.json:
        told = "Depth in a frame is as open" if "views" not in about else "A frame says as much"
        console.say(
            f"{about['keep']} paths, each of one body; film_draws opens them. {told} as"
            " in a single one: what paths add is how it changes, and gaps"
        )
        if len(lenses) > 1:
            said = ", ".join(f"{focal:,.0f} pixels {share:.0%}" for focal, share in lenses)
            console.say(f"Each path has one focal length, the film's: {said}")
        law = None if settings.drawn_before else settings.estimation.likelihood().learned
        if law is not None and number > 1:
            worth = law.worth(number, settings.fps / about["step"])
            console.say(
                f"Errors last: to the mean of a joint that rests the {number} frames are worth"
                f" {worth:.1f} with errors of their own"
            )
    if about["step"] > 1:
        warnings.append(
            f"the frames are numbered by {about['step']}: at {settings.fps:g} numbers a second they"
            f" are {settings.fps / about['step']:g} frames a second"
        )
    for sentence in warnings:
        console.warn(sentence)


def _focal_lengths(out: Path, film: xr.DataTree) -> list[tuple[float, float]]:
    """The focal lengths of the paths, pixels, and how many have each; none in weak perspective."""
    first = draws_of(out, str(film["summary"].frame.values[0]))
    found, counts = np.unique(first.focal.values, return_counts=True)
    some = zip(found.tolist(), (counts / counts.sum()).tolist(), strict=True)
    return [one for one in some if math.isfinite(one[0])]
