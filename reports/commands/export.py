"""`poseterior export`: a result as a file of other people's software."""

from pathlib import Path

from poseterior.reports import console
from poseterior.reports.exports import TARGETS, Clip, unit_of
from poseterior.reports.exports.results import Wanted, read_clip
from poseterior.reports.options import Screen
from poseterior.reports.settings import ExportSettings


def run(settings: ExportSettings, screen: Screen) -> None:
    """Writes the file. Raises `BadInput` where the result has not what is wanted, or the format
    cannot hold it."""
    to = settings.to.value
    unit = unit_of(to, settings.unit.value if settings.unit else None)
    out = console.output_file(settings.out or _beside(settings.result, to))
    wanted = Wanted(settings.height, settings.k, settings.draws, settings.person)
    with console.progress("reading the result", screen.quiet):
        clip = read_clip(settings.result, wanted).at_rate(settings.rate)
    with console.progress(f"writing {to}", screen.quiet):
        TARGETS[to].write(clip, out, unit)
    missing = int((~clip.there).sum())
    if missing and to == "bvh":
        console.warn(
            f"{missing} of {len(clip.names)} frames have no pose; BVH cannot say so, and they"
            " repeat the one before"
        )
    if screen.json:
        console.show_json(_as_json(clip, unit, out))
    else:
        console.say(f"Written to {out}: {_words(clip)}, in {unit}, y up, the pelvis at the origin.")


def _beside(result: Path, to: str) -> Path:
    """A name like the result's, in the folder where the command was given."""
    return Path(f"{result.resolve().stem}{TARGETS[to].suffix}")


def _words(clip: Clip) -> str:
    count = len(clip.names)
    if clip.film:
        return f"{count:,} frames, {int(clip.there.sum()):,} with a pose"
    kind = clip.names[0].split()[0]
    plural = {"hypothesis": "hypotheses", "draw": "draws"}[kind]
    return f"1 {kind}" if count == 1 else f"{count:,} {plural}"


def _as_json(clip: Clip, unit: str, out: Path) -> dict:
    return {
        "out": str(out),
        "unit": unit,
        "rate": clip.rate,
        "poses": clip.names,
        "missing": int((~clip.there).sum()),
        "weights": None if clip.weights is None else clip.weights.tolist(),
    }
