"""Are frames of a film found in which left and right are exchanged, and what does it change? Writes
reports/sides.md and its picture.

    python -m poseterior.reports.pages.sides ../shared/data work

Captured people of whom no limits were learned, filmed by a simulated detector that exchanges sides
for one frame, for five and for thirty. `work` keeps what is done, and a run that was stopped goes
on there; half an hour.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.estimators import Estimating
from poseterior.inference.films import sides
from poseterior.inference.films.film import FRAMES_FOLDER, NUM_PATHS, film_of, sample_film
from poseterior.inference.footage import Item
from poseterior.inference.stream import open_stream, sample_frames
from poseterior.probmodel import DetectorErrors, Likelihood
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, EXCHANGES, ORDERS
from poseterior.reports.figures.style import FAINT, INK, SMALL, TEXT, page, tidy
from poseterior.reports.pages.films import (
    FILM_WAY,
    PathsJudged,
    TrueFilm,
    captured,
    depth_of,
    held_of,
    judge,
    named,
    ways_of,
)
from poseterior.reports.pages.page import Data, Page, Work, run
from poseterior.reports.pages.people import Strangers, strangers, together
from poseterior.reports.tables import Sheet, sheet_of

SHORTEST_FILM, LONGEST_FILM = 4.0, 30.0
"""Seconds of the recordings that are taken, and of a film."""
RATES = (25.0, 30.0, 60.0, 120.0)
RUN_LENGTHS = (1, 5, 30)
"""Frames for which sides stay exchanged."""
PLANTED = tuple(EXCHANGE_INDEX[name] for name in ("arms", "legs", "body"))
BETWEEN = (1.0, 2.5)
"""Seconds from one exchange to the next, evenly drawn."""
DRAWN_FILMS, DRAWN_SECONDS, DRAWN_RATE = 3, 8.0, 30.0
TOLD, BY_ITSELF = "told by motion first", "every frame by itself"
NOTHING_TOLD = "control: motion weighs nothing"


class Misnamed(NamedTuple):
    """A film whose sides are exchanged in runs: which exchange `(frames,)` each frame has, and for
    how many frames its run lasts, 0 where there is none."""

    film: TrueFilm
    exchange: np.ndarray
    lasts: np.ndarray

    @property
    def items(self) -> list[Item]:
        """Its frames."""
        return named(self.film.alone)

    @property
    def subject(self) -> str:
        """Who it is of."""
        return self.film.name.split("-")[1]


def misnamed(film: TrueFilm, rng: np.random.Generator) -> Misnamed:
    """The film with exchanges planted."""
    number = len(film.alone)
    exchange, lasts = np.zeros(number, int), np.zeros(number, int)
    at = round(film.rate * rng.uniform(*BETWEEN))
    while at < number:
        some = slice(at, at + int(rng.choice(RUN_LENGTHS)))
        exchange[some], lasts[some] = rng.choice(PLANTED), some.stop - some.start
        at = some.stop + round(film.rate * rng.uniform(*BETWEEN))
    people = [
        dataclasses.replace(
            person, keypoints=person.keypoints[ORDERS[one]], score=person.score[ORDERS[one]]
        )
        for person, one in zip(film.alone, exchange, strict=True)
    ]
    return Misnamed(film._replace(name=f"{film.name}-misnamed", people=people), exchange, lasts)


def films_at(parts: Sequence[Strangers], law: DetectorErrors, rate: float) -> list[Misnamed]:
    """A film of every recording that is long enough."""
    motions, models = together(parts)
    long = [one for one in motions if len(one.joints) / one.frame_rate >= SHORTEST_FILM]
    found = []
    for number, motion in enumerate(long):
        seconds = min(LONGEST_FILM, len(motion.joints) / motion.frame_rate)
        film = captured(motion, law, rate, number, seconds)._replace(model=models[motion.subject])
        found.append(misnamed(film, np.random.default_rng([number, round(rate), 1])))
    return found


def told_by_motion(one: Misnamed, likelihood: Likelihood) -> np.ndarray:
    """`(frames, 6)`: the probabilities of exchanges before anything is drawn."""
    items = sides.with_sides(one.items, one.film.rate, likelihood)
    rest = np.array([item.exchange for item in items])
    return np.column_stack([1 - rest.sum(axis=1), rest])


def told_by_nothing(one: Misnamed, likelihood: Likelihood) -> np.ndarray:
    """The same, had motion no weight."""
    number = len(one.exchange)
    weight = np.ones((number - 2, *3 * [len(EXCHANGES)]))
    moments = np.arange(number) / one.film.rate
    return sides.in_chain(weight, moments, likelihood.faults.exchange_probabilities)


def shares(films: Sequence[Misnamed], probability: Sequence[np.ndarray]) -> list[str]:
    """By length of the run, in how many of the frames with sides exchanged the right exchange is
    the most probable; in how many of the others any is."""
    said = np.concatenate([one.argmax(axis=1) for one in probability])
    true = np.concatenate([one.exchange for one in films])
    lasts = np.concatenate([one.lasts for one in films])
    runs = [_share((said == true)[lasts == run if run else lasts > 0]) for run in (*RUN_LENGTHS, 0)]
    return [*runs, _share(said[lasts == 0] > 0)]


def _share(some: np.ndarray) -> str:
    return f"{100 * some.mean():.1f} % of {len(some):,}"


def drawn(one: Misnamed, likelihood: Likelihood, work: Path, told: bool) -> Path:
    """The folder of a film's paths, drawn where there is none."""
    film = one.film
    out = work / f"{film.name}-{'told' if told else 'alone'}"
    if (out / "run.json").exists():
        return out
    assert film.model is not None
    if told:
        sample_film(
            film.model,
            one.items,
            rate=film.rate,
            key=0,
            out=out,
            estimating=Estimating(likelihood=likelihood),
        )
    else:
        stream = sample_frames(
            film.model,
            one.items,
            key=0,
            out=out / FRAMES_FOLDER,
            estimating=Estimating(likelihood=likelihood),
            num_roots=NUM_PATHS,
            num_samples=NUM_PATHS,
            keep=NUM_PATHS,
            k=1,
        )
        film_of(stream, rate=film.rate, out=out)
    print(out.name, flush=True)
    return out


def longest(films: Sequence[Misnamed]) -> list[Misnamed]:
    """The first seconds of the longest films, each of another person."""
    ordered = sorted(films, key=lambda one: -len(one.exchange))
    people = {one.subject: one for one in reversed(ordered)}
    some = sorted(people.values(), key=lambda one: -len(one.exchange))[:DRAWN_FILMS]
    rows = slice(round(DRAWN_SECONDS * DRAWN_RATE))
    return [
        Misnamed(
            one.film._replace(
                people=one.film.alone[rows], truth=one.film.truth[rows], doubt=one.film.doubt[rows]
            ),
            one.exchange[rows],
            one.lasts[rows],
        )
        for one in some
    ]


class DrawnWay(NamedTuple):
    """What paths of a way are worth: the probabilities of exchanges of each film, and its paths
    judged."""

    probability: list[np.ndarray]
    judged: list[PathsJudged]


def drawn_way(films: list[Misnamed], likelihood: Likelihood, work: Path, told: bool) -> DrawnWay:
    """Of all films."""
    probability, judged = [], []
    for number, one in enumerate(films):
        out = drawn(one, likelihood, work, told)
        exchange = open_stream(out / FRAMES_FOLDER)["summary"].exchange.values
        probability.append(np.nan_to_num(exchange))
        ways, rows = ways_of(one.film, out)
        judged.append(judge(ways[FILM_WAY], one.film, rows, np.random.default_rng(number)))
    return DrawnWay(probability, judged)


def picture(one: Misnamed, ways: dict[str, np.ndarray]) -> Figure:
    """The probability of any exchange over time, and where there is one."""
    figure = page(11.0, 1.4 + 1.1 * len(ways))
    panels = figure.subplots(len(ways), 1, sharex=True, sharey=True)
    seconds = np.arange(len(one.exchange)) / one.film.rate
    for axis, (name, probability) in zip(panels, ways.items(), strict=True):
        axis.fill_between(seconds, one.exchange > 0, color=FAINT, alpha=0.5, lw=0, step="mid")
        axis.step(seconds, 1 - probability[:, 0], color=INK, lw=1.2, where="mid")
        axis.set_title(name, fontsize=TEXT, loc="left")
        axis.set_yticks([0, 1], ["0", "1"], fontsize=SMALL)
        tidy(axis)
    panels[-1].set_xlabel("seconds", fontsize=SMALL)
    return figure


def main(data: Data, work: Work) -> Page:
    """Runs the study and writes the page."""
    law = DetectorErrors.default()
    likelihood = Likelihood.of(law)
    parts = strangers(work, data)
    by_rate = {rate: films_at(parts, law, rate) for rate in RATES}
    lines = [
        (f"{rate:g} a second", *shares(films, [told_by_motion(one, likelihood) for one in films]))
        for rate, films in by_rate.items()
    ]
    usual = by_rate[DRAWN_RATE]
    control = shares(usual, [told_by_nothing(one, likelihood) for one in usual])
    some = longest(usual)
    ways = {
        TOLD: drawn_way(some, likelihood, work, told=True),
        BY_ITSELF: drawn_way(some, likelihood, work, told=False),
    }
    return Page(
        "sides",
        {
            "recordings": len(usual),
            "people": len({one.subject for one in usual}),
            "seconds": f"{sum(len(one.exchange) for one in usual) / DRAWN_RATE:,.0f}",
            "motion": sheet_of(HEAD, [*lines, (NOTHING_TOLD, *control)]),
            "films": len(some),
            "frames": f"{sum(len(one.exchange) for one in some):,}",
            "paths": NUM_PATHS,
            "told": sheet_of(
                HEAD, [(name, *shares(some, way.probability)) for name, way in ways.items()]
            ),
            "held": _held(ways),
        },
        {"sides": picture(some[0], _over_time(some[0], likelihood, ways))},
    )


HEAD = (
    "",
    *(f"runs of {run} frame{'s' * (run > 1)}" for run in RUN_LENGTHS),
    "all",
    "false alarms",
)


def _over_time(
    one: Misnamed, likelihood: Likelihood, ways: dict[str, DrawnWay]
) -> dict[str, np.ndarray]:
    return {
        "motion alone": told_by_motion(one, likelihood),
        **{f"drawn, {name}": way.probability[0] for name, way in ways.items()},
    }


def _held(ways: dict[str, DrawnWay]) -> Sheet:
    head = (
        *("paths", "coordinates", "changes in 0.1 s, and in 0.5 s", "95 % wide in depth, mm"),
        *("error of the mean, mm", "jitter, mm"),
    )
    return sheet_of(
        head,
        [
            (
                name,
                held_of(way.judged, slice(0, 1)),
                held_of(way.judged, slice(1, None)),
                depth_of(way.judged),
                f"{np.mean([one.error for one in way.judged]):.0f}",
                f"{np.mean([one.jitter for one in way.judged]):.1f}",
            )
            for name, way in ways.items()
        ],
    )


if __name__ == "__main__":
    run(main)
