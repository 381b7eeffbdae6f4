"""`poseterior show`: how a file was read, as a picture and a table, and what speaks against that
reading."""

from pathlib import Path

import numpy as np

from inference import estimate_torsos
from inference.readings import Judge, Verdict, together
from probmodel import BadInput, Detection, PoseModel
from probmodel.layouts import MEDIAPIPE_33
from probmodel.skeleton import JOINTS
from reports import console, figures, tables
from reports.options import Estimation, Screen
from reports.settings import ShowSettings

MOST_PEOPLE = 8
"""People of a file by whom its reading is judged, evenly spread, the one that is shown among
them."""


def run(settings: ShowSettings, screen: Screen) -> None:
    """Writes the picture and says what was read and what is doubted. Raises `BadInput` on a bad
    file or image."""
    out, shown = console.output_file(settings.out), settings.person.detected.photo
    with console.progress("reading", screen.quiet):
        people, person = settings.person.people, settings.person.detection
        model = settings.prior.model()
    with console.progress("weighing other readings", screen.quiet):
        judge, sizes = Judge(model), _size_is_open(person, settings)
        alone = judge.file([person], sizes=sizes)
        verdict = together([alone, judge.file(_others(people, person), sizes=sizes)])
    warnings = [*about_the_image(person, shown), *verdict.warnings]
    own = [sentence for sentence in alone.warnings if sentence not in warnings]
    warnings += [f"{sentence} (person {person.person} alone)" for sentence in own]
    radius = _radius(person, settings.estimation, model)
    picture = figures.overlay_figure(person, radius, image=shown, warned=bool(warnings))
    figures.save_figure(picture, out)
    if screen.json:
        console.show_json(_json(person, radius, verdict, warnings, out))
    else:
        console.OUT.print(tables.reading_table(person, radius))
        judged = len(verdict.gains)
        console.say(
            f"{person.layout}, {len(people)} in {person.source}, reading judged by {judged}."
            f" Written to {out}"
        )
    for sentence in warnings:
        console.warn(sentence)


def _size_is_open(person: Detection, settings: ShowSettings) -> bool:
    """Whether the image's size is what the user says, and the joints lie where they do because of
    it: MediaPipe's are fractions in any file, others' where they need a size."""
    given = settings.person.detected.image_size is not None and person.image_size is not None
    return given or person.layout == MEDIAPIPE_33.name


def _others(people: list[Detection], person: Detection) -> list[Detection]:
    others = [other for other in people if other.person != person.person and other.seen.any()]
    step = max(1, -(-len(others) // (MOST_PEOPLE - 1)))
    return others[::step]


def about_the_image(person: Detection, image: np.ndarray | None) -> list[str]:
    """What the image itself says: whether its size is the detection's, and whether the joints lie
    in it."""
    if image is None:
        return []
    size = (image.shape[1], image.shape[0])
    if person.image_size not in (None, size):
        was = "x".join(map(str, person.image_size or ()))
        return [
            f"the detection was made on an image of {was} pixels, but this one has"
            f" {size[0]}x{size[1]}"
        ]
    points = person.keypoints[person.seen]
    outside = ((points < 0) | (points > size)).any(axis=1)
    if outside.sum() > len(points) / 2:
        said = f"{outside.sum()} of {len(points)} joints lie outside the image"
        return [f"{said}: is it the right one, in its full size?"]
    return []


def _radius(person: Detection, estimation: Estimation, model: PoseModel) -> np.ndarray | None:
    """`(15,)` pixels; None where the torso is not seen well enough for a scale."""
    # Without anybody, so that only settings are refused.
    estimate_torsos([], estimation.estimator, **estimation.settings(model))
    try:
        frame = estimation.estimate(person, model)
    except BadInput:
        return None
    spread = frame.likelihood.spread(person, float(frame.candidates[0].camera.scale))
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
