"""One person's posterior as a page: photo, scene, marginals of every joint, and what there is to
say in words."""

import base64
import io
from collections.abc import Iterable, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
import xarray as xr
from PIL import Image

from poseterior.inference.draws import COMPLETE
from poseterior.inference.hypothesis import Hypothesis
from poseterior.inference.measured import measure_intervals, measures
from poseterior.inference.results import Result
from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from poseterior.reports.figures.colours import LIMB_OF, hypothesis_colours
from poseterior.reports.figures.window import Window, cropped, window_of
from poseterior.reports.interactive.page import assemble, packed, rounded
from poseterior.reports.tables.measures import measures_table
from poseterior.reports.tables.posterior import (
    candidates_table,
    facing_sentences,
    heaviest,
    hypotheses_table,
    posterior_table,
    projected,
    still,
    summary_lines,
    values,
)
from poseterior.reports.tables.sheet import percent, signed
from poseterior.reports.tables.words import facing_words, pose_facing, spoken, undetected

MAX_DRAWS = 1000
"""Draws that a page holds, evenly, since those of a chain follow each other; marginals are of all
that are shown."""
BINS = 48
LONGEST_SIDE, QUALITY = 1400, 85
"""Of the photo: pixels, and JPEG's."""
AXES: dict[str, tuple[int, int]] = {"depth": (2, 1), "across": (0, 1), "height": (1, -1)}
"""The directions whose marginals are shown: which camera axis, and its sign."""


def person_page(
    result: Result,
    hypotheses: Sequence[Hypothesis],
    *,
    image: np.ndarray | None = None,
    truth: np.ndarray | None = None,
    warnings: Iterable[str] = (),
) -> str:
    """The page of a result with at least one draw.

    Parameters
    ----------
    result
        Of any sampler, with torso and camera fixed or uncertain.
    hypotheses
        Of its draws, the heaviest first.
    image
        `(H, W, 3)` bytes, under the detections.
    truth
        `(15, 3)` in camera axes and body units.
    warnings
        Sentences; what the result itself has to warn of is added.

    Raises
    ------
    BadInput
        Where the image is not one, or shows none of the detected joints.
    """
    tree = result.shown.tree
    window = window_of(tree, image)
    shown = evenly(len(values(tree, "posterior", "joints")), MAX_DRAWS)
    points = values(tree, "observed_data", "keypoints")
    data = {
        "draws": packed(values(tree, "posterior", "joints")[shown]),
        "projected": packed(values(tree, "posterior", "keypoints")[shown]),
        "hypotheses": _hypotheses(tree, hypotheses),
        "truth": None if truth is None else rounded(truth),
        "detection": {
            "points": [None if None in point else point for point in rounded(points)],
            "radius": rounded(values(tree, "constant_data", "radius")[heaviest(tree)]),
        },
        "window": rounded(np.concatenate(window)),
        "photo": None if image is None else _photo(image, window),
        "marginals": _marginals(tree, truth),
        "start": _widest(tree),
    }
    attrs = tree.attrs
    return assemble(
        "person",
        f"{PurePath(str(attrs['source'])).name}, person {attrs['person']}",
        data,
        facts=[f"{attrs['source']} · " + " · ".join(summary_lines(result))],
        warnings=[*warnings, *_doubts(result)],
        sentences=_sentences(tree, hypotheses),
        sheets=[
            candidates_table(tree),
            hypotheses_table(hypotheses),
            posterior_table(tree),
            measures_table(measure_intervals(measures(tree))),
        ],
    )


def _hypotheses(tree: xr.DataTree, hypotheses: Sequence[Hypothesis]) -> list[dict[str, Any]]:
    """Each with its own projection: its camera may be its own."""
    colours = hypothesis_colours(len(hypotheses))
    return [
        {
            "joints": rounded(one.joints),
            "projected": rounded(points),
            "weight": float(one.weight),
            "colour": colour,
            "words": f"{percent(one.weight)}, {facing_words(pose_facing(one.joints))}",
        }
        for one, points, colour in zip(
            hypotheses, projected(tree, hypotheses), colours, strict=True
        )
    ]


def _photo(image: np.ndarray, window: Window) -> dict[str, Any]:
    """The part of the image that lies in the window, as a JPEG in text, and where it lies."""
    found = cropped(image, window)
    part = Image.fromarray(np.ascontiguousarray(found.pixels[..., :3]))
    part.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    file = io.BytesIO()
    part.save(file, "JPEG", quality=QUALITY)
    text = base64.b64encode(file.getvalue()).decode("ascii")
    return {
        "src": f"data:image/jpeg;base64,{text}",
        "box": rounded(found.corners.ravel()),
    }


# --- marginals


def _marginals(tree: xr.DataTree, truth: np.ndarray | None) -> dict[str, list[dict[str, Any]]]:
    """Histograms of all draws, joint by joint: of the heaviest candidate's, and of the others."""
    joints = values(tree, "posterior", "joints")
    light = values(tree, "posterior", "candidate") != heaviest(tree)
    fixed = still(tree)
    return {
        name: [
            _marginal(
                sign * joints[:, joint, axis],
                light,
                bool(fixed[joint]),
                [] if truth is None else [sign * float(truth[joint, axis])],
            )
            for joint in range(len(JOINTS))
        ]
        for name, (axis, sign) in AXES.items()
    }


def _marginal(
    sample: np.ndarray, light: np.ndarray, fixed: bool, beside: list[float]
) -> dict[str, Any]:
    """Of one coordinate; where it is held fixed, words alone. `beside` are values that are to be
    seen too."""
    if fixed:
        place = float(sample[0])
        return {"counts": None, "words": f"held fixed at {signed(place)} ({_millimetres(place)})"}
    ends = np.quantile(sample, [0.05, 0.95])
    low, high = min([sample.min(), *beside]), max([sample.max(), *beside])
    margin = 0.02 * (high - low) + 1e-3
    edges = np.linspace(low - margin, high + margin, BINS + 1)
    counts = [np.histogram(sample[which], edges)[0].tolist() for which in (~light, light)]
    mean, sd = float(sample.mean()), float(sample.std())
    words = (
        f"{signed(mean)} ± {sd:.2f} ({_millimetres(mean)} ± {sd * MILLIMETRES:.0f} mm), 90 %"
        f" between {signed(float(ends[0]))} and {signed(float(ends[1]))}"
    )
    return {
        "counts": counts,
        "low": float(edges[0]),
        "high": float(edges[-1]),
        "interval": ends.tolist(),
        "mean": mean,
        "sd": sd,
        "words": words,
    }


def _millimetres(value: float) -> str:
    return f"{value * MILLIMETRES:.0f}".replace("-", "−")


def _widest(tree: xr.DataTree) -> int:
    """The joint of a limb whose depth is known least."""
    spread = values(tree, "posterior", "joints")[:, :, 2].std(axis=0)
    return max(LIMB_OF, key=lambda joint: spread[joint])


# --- words


def _doubts(result: Result) -> list[str]:
    """What the result warns of by itself."""
    found = []
    if result.status != COMPLETE:
        found.append(f"{result.status}: {result.sentence or 'fewer draws than asked for'}")
    if not result.tree.attrs.get("converged", 1):
        found.append("The estimator of torso and camera did not converge; its best fit is used.")
    return found


def _sentences(tree: xr.DataTree, hypotheses: Sequence[Hypothesis]) -> list[str]:
    seen = values(tree, "observed_data", "score") > 0
    lost = [undetected(JOINTS[joint]) for joint in LIMB_OF if not seen[joint]]
    joint = _widest(tree)
    sd = float(values(tree, "posterior", "joints")[:, joint, 2].std())
    found = [
        *facing_sentences(tree),
        f"Least is known of the depth of the {spoken(JOINTS[joint])}: its standard deviation is"
        f" {sd:.2f} body units, {sd * MILLIMETRES:.0f} mm for a person of 1.7 m.",
    ]
    if lost:
        found.append(f"Not detected, so that anatomy alone says where: {', '.join(lost)}.")
    if not still(tree)[JOINT_INDEX["thorax"]] and tree.attrs.get("root") != "uncertain":
        found.append(
            "Under each candidate the torso is held fixed; the scatter of its joints is the"
            " difference of the candidates."
        )
    several = (
        f"{len(hypotheses)} hypotheses stand" if len(hypotheses) > 1 else "1 hypothesis stands"
    )
    return [
        *found,
        f"{several} for all draws, the heaviest for {percent(hypotheses[0].weight)} of them.",
    ]
