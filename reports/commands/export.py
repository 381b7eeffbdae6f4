"""`poseterior export`: a result as a file of other people's software."""

from collections.abc import Iterator
from pathlib import Path

from poseterior.reports import console
from poseterior.reports.exports import TARGETS, Clip, unit_of
from poseterior.reports.exports.results import Wanted, read_clip
from poseterior.reports.options import ExportFormat, FilmPose, Screen
from poseterior.reports.settings import ExportSettings


def run(settings: ExportSettings, screen: Screen) -> None:
    """Writes the file. Raises `BadInput` where the result has not what is wanted, or the format
    cannot hold it."""
    to = settings.to.value
    unit = unit_of(to, settings.unit.value if settings.unit else None)
    out = console.output_file(settings.out or _beside(settings.result, to))
    wanted = Wanted(
        height=settings.height,
        k=settings.k,
        draws=settings.draws,
        person=settings.person,
        what=settings.what.value if settings.what else None,
        path=settings.path_number,
        smoother=settings.smoother,
        rate=settings.rate,
        measures=settings.measures,
    )
    with console.progress("reading the result", screen.quiet):
        clip = read_clip(settings.result, wanted)
    with console.progress(f"writing {to}", screen.quiet):
        TARGETS[to].write(clip, out, unit)
    for sentence in _doubts(clip, settings):
        console.warn(sentence)
    what = _what(settings) if clip.film else ""
    console.show(
        screen.json,
        _as_json(clip, unit, out),
        f"Written to {out}: {_words(clip)}{what}, in {unit}, y up, the {clip.origin} at the origin,"
        f" {clip.rate:g} a second.",
    )


def _doubts(clip: Clip, settings: ExportSettings) -> Iterator[str]:
    """What a file does not say of a film."""
    if not clip.film:
        return
    if not clip.timed:
        yield (
            f"nobody says how many frames a second this film has; {clip.rate:g} are assumed, and"
            " all times and speeds hang on it: give --rate"
        )
    if clip.numbers is None and len(clip.names) > 1:
        yield (
            f"the names of the frames ({clip.names[0]}, …) do not count them: they follow each"
            " other without gaps"
        )
    gaps = clip.regular()
    missing, count = int((~gaps.there).sum()), len(gaps.names)
    if missing and settings.to == ExportFormat.bvh:
        yield (
            f"{missing} of {count} frames have no pose; BVH cannot say so, and they repeat the one"
            " before"
        )


def _what(settings: ExportSettings) -> str:
    """Of what a film is made, in words."""
    what = (settings.what or FilmPose.mean).value
    made = {"mean": "the mean of the draws made a body", "hypothesis": "the heaviest hypothesis"}
    smooth = f", smoothed by {settings.smoother}" if settings.smoother else ""
    words = made[what] if settings.path_number is None else f"path {settings.path_number}"
    return f" ({words}{smooth})"


def _beside(result: Path, to: str) -> Path:
    """A name like the result's, in the folder where the command was given."""
    return Path(f"{result.resolve().stem}{TARGETS[to].suffix}")


def _words(clip: Clip) -> str:
    count = len(clip.names)
    if clip.film:
        span = len(clip.regular().names)
        missing = f" of {span:,}" if span > count else ""
        frames = "1 frame" if span == 1 else f"{count:,}{missing} frames"
        return f"{frames}, {int(clip.there.sum()):,} with a pose"
    kind = clip.names[0].split()[0]
    plural = {"hypothesis": "hypotheses", "draw": "draws"}[kind]
    return f"1 {kind}" if count == 1 else f"{count:,} {plural}"


def _as_json(clip: Clip, unit: str, out: Path) -> dict:
    return {
        "out": str(out),
        "unit": unit,
        "rate": clip.rate,
        "poses": clip.names,
        "frames": clip.frames,
        "missing": int((~clip.regular().there).sum()),
        "weights": None if clip.weights is None else clip.weights.tolist(),
    }
