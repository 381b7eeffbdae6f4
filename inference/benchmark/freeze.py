"""How the targets were made: `python -m poseterior.inference.benchmark.freeze targets` writes
them and says their checksums, `… reference` measures them and writes what is known of them and some
exact draws.

It is kept for whoever asks where the numbers come from, and for new targets. Run after a change of
the product, it may write other ones: then the targets stay, and the change is what is new."""

import argparse
import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from poseterior.inference.benchmark.anatomy import FrozenAnatomy
from poseterior.inference.benchmark.catalogue import CHECKSUMS, load, targets
from poseterior.inference.benchmark.draws import measured, shipped_file
from poseterior.inference.studies.scenes import (
    ALL_BUT_AN_ARM,
    foreshortened,
    low_scores,
    prior_scene,
)
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.files import replacing
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.skeleton import GROUPS, JOINTS, TORSO_INDEX

DATA = Path(__file__).with_name("data")
SMALL_FACTOR = 0.08
"""The factor of tiny discs."""
PICTURE = (640, 480)
"""Pixels: in which the pelvis lies where the camera is uncertain."""
SCALES = (50.0, 200.0)
"""Pixels a body unit, between which somebody is 250 or 1,000 high."""
ASIDE = (-45.0, 30.0)
"""Pixels by which the person stands beside the middle of the picture."""
Scene = Callable[[PoseModel], Estimate]


def all_but(group: str) -> tuple[str, ...]:
    """The limb joints, and the head, of the other groups."""
    others = (limb for name, limbs in GROUPS.items() if name != group for limb in limbs)
    return tuple(JOINTS[bone.end] for limb in others for bone in limb.bones)


def _scene(seed: int, **options: Any) -> Scene:
    return functools.partial(prior_scene, seed=seed, **options)


def in_a_picture(scene: Scene, seed: int) -> Scene:
    """A scene whose torso is detected with errors too, with the person elsewhere in the picture
    than where scenes have them, so that the middle of the prior tells nothing."""

    def seen(model: PoseModel) -> Estimate:
        frame = scene(model)
        rng = np.random.default_rng(seed)
        radius = frame.likelihood.factor * float(frame.best.camera.scale)
        number = len(TORSO_INDEX)
        distance = radius * np.sqrt(rng.uniform(size=number))
        angle = rng.uniform(0, 2 * np.pi, number)
        keypoints = frame.detection.keypoints + np.array(ASIDE)
        keypoints[list(TORSO_INDEX)] += (distance * np.array([np.cos(angle), np.sin(angle)])).T
        detection = dataclasses.replace(frame.detection, keypoints=keypoints)
        return dataclasses.replace(frame, detection=detection)

    return seen


FIXED_ROOT: dict[str, tuple[str, Scene]] = {
    "single": ("one arm, all of it in one mode", _scene(16, missing=ALL_BUT_AN_ARM)),
    "arm": ("one arm, three modes", _scene(1, missing=ALL_BUT_AN_ARM)),
    "arms": ("both arms, coupled by their lengths", _scene(3, missing=all_but("arms"))),
    "legs": ("both legs, coupled by their lengths", _scene(2, missing=all_but("legs"))),
    "four-missing": (
        "arms and legs, four joints of them missing",
        _scene(2, missing=("head", "left_wrist", "right_elbow", "left_knee", "right_ankle")),
    ),
    "one-missing": ("arms and legs, one wrist missing", _scene(4, missing=("head", "right_wrist"))),
    "settled": ("arms and legs, of forty scenes that with the fewest flips", _scene(215)),
    "foreshortened": ("arms and legs, pointing along the camera's axis", foreshortened),
    "low-scores": ("arms and legs, wrists and ankles hardly seen", _scene(5, scores=low_scores())),
    "flips": ("arms and legs, of forty scenes that with the most flips", _scene(222)),
    "tiny": ("arms and legs, discs a third as wide as usual", _scene(1, factor=SMALL_FACTOR)),
    "whole": ("the whole body, head too", _scene(6, missing=())),
    "cruel": (
        "the whole body, tiny discs of all sizes, hundreds of flips",
        _scene(222, missing=(), factor=SMALL_FACTOR, scores=low_scores()),
    ),
}
"""What each target is under one torso and camera, and how it came about."""
UNCERTAIN_ROOT: dict[str, tuple[str, Scene]] = {
    "scene": ("the whole body, its torso, and the camera", in_a_picture(_scene(7, missing=()), 0)),
}
"""Those of which torso and camera are a part."""
HARD_ONLY = ("settled", "scene")
"""Targets without a version with soft walls: a block of their exact draws would take a quarter of
an hour, or far longer."""


def records() -> Iterator[dict[str, Any]]:
    """The targets as they are written, each but `HARD_ONLY` with its version with soft walls behind
    it."""
    model = PoseModel()
    for name, (about, scene) in (FIXED_ROOT | UNCERTAIN_ROOT).items():
        record = uncertain_record if name in UNCERTAIN_ROOT else fixed_record
        frame = scene(model)
        yield record(name, about, frame)
        if name in HARD_ONLY:
            continue
        soft = dataclasses.replace(frame.likelihood, law=Gaussian())
        about = f"{about}; Gaussian errors, soft walls"
        yield record(f"{name}-soft", about, dataclasses.replace(frame, likelihood=soft))


def fixed_record(name: str, about: str, frame: Estimate) -> dict[str, Any]:
    """A frame with one root as a target: in camera axes and body units."""
    root = frame.best.root
    plane = root.camera.to_plane(frame.detection.keypoints)
    view = {"view": np.asarray(root.view).tolist()}
    return _record(name, about, frame, plane, view)


def uncertain_record(name: str, about: str, frame: Estimate) -> dict[str, Any]:
    """A frame as a target in which the root is uncertain: in pixels, with all torsos, in the order
    of their first principal component, in front of any camera of the box."""
    torsos = FrozenAnatomy.default().torsos.reshape(-1, 18)
    centred = torsos - torsos.mean(axis=0)
    component = np.linalg.svd(centred, full_matrices=False)[2][0]
    place = [[0.0, 0.0], list(map(float, PICTURE))]
    box = {
        "torsos": np.argsort(centred @ component).tolist(),
        "scale": list(SCALES),
        "place": place,
    }
    return _record(name, about, frame, frame.detection.keypoints, box)


def _record(
    name: str, about: str, frame: Estimate, seen_at: np.ndarray, root: dict[str, Any]
) -> dict[str, Any]:
    score = frame.detection.score
    return {
        "name": name,
        "about": about,
        "law": type(frame.likelihood.law).__name__.lower(),
        "factor": frame.likelihood.factor,
        "score": score.tolist(),
        **root,
        "seen_at": np.where(score[:, None] > 0, seen_at, 0.0).tolist(),
    }


def write_targets() -> None:
    """Writes `targets.json`, and prints the checksums that belong into `catalogue`."""
    text = ",\n".join(json.dumps(one) for one in records())
    with replacing(DATA / "targets.json") as partial:
        partial.write_text(f"[\n{text}\n]\n", encoding="utf-8")
    for name in CHECKSUMS:
        print(name, hashlib.sha256((DATA / name).read_bytes()).hexdigest())


def write_reference(names: list[str]) -> None:
    """Measures targets anew, all where no names are given, and writes `reference.json` and the
    exact draws that are in the package."""
    path = DATA / "reference.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in names or targets():
        known[name] = measured(load(name))
        with replacing(DATA / f"{name}.npy") as partial:
            partial.write_bytes(shipped_file(load(name)))
        in_order = {one: known[one] for one in targets() if one in known}
        with replacing(path) as partial:
            partial.write_text(json.dumps(in_order, indent=1) + "\n", encoding="utf-8")
        print(name, known[name]["log_evidence"], known[name]["log_evidence_se"], flush=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("what", choices=("targets", "reference"))
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.what == "targets":
        write_targets()
    else:
        write_reference(options.names)


if __name__ == "__main__":
    main()
