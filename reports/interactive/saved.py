"""The page of what was saved: a posterior.nc, its folder, or the folder of a stream."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from poseterior.inference.hypothesis import Hypothesis, hypotheses
from poseterior.inference.measured import measures
from poseterior.inference.results import Result
from poseterior.inference.saved import read_result
from poseterior.inference.store import SETTINGS
from poseterior.inference.stream import open_stream
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.measures import USUAL
from poseterior.probmodel.root_priors import WORLD
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.interactive.film import film_page
from poseterior.reports.interactive.person import person_page
from poseterior.reports.tables.posterior import values

K = 5
"""Hypotheses where none were saved beside the draws."""
_ADVICE = "give a posterior.nc, its folder, or that of a stream of `poseterior frames`"
_WRITTEN = 1e-6
"""Body units to which hypotheses.json has the joints."""
_AS_NEAR = 1e-5
"""Body units, over all joints, to which distances from draws are known."""


def page_of(path: Path, image: np.ndarray | None = None) -> str:
    """The page of a result.

    Parameters
    ----------
    path
        A posterior.nc, its folder, or that of a stream.
    image
        `(H, W, 3)` bytes, of the detection; a stream has no use for it.

    Raises
    ------
    BadInput
        Where there is no result, or it is damaged.
    """
    if path.is_dir() and (path / SETTINGS).exists():
        tree = open_stream(path)
        measured = measures(path, *USUAL) if tree.attrs.get("keep") else None
        return film_page(tree, path.resolve().name, measured=measured)
    drawn = path / "posterior.nc" if path.is_dir() else path
    if path.is_dir() and not drawn.exists():
        raise BadInput(f"{path} is a folder without a result; {_ADVICE}")
    result = read_result(drawn)
    if result.tree.attrs["root"] == WORLD:
        raise BadInput(
            f"{drawn} is of several cameras, of which there is no page; look at hypotheses.png"
            " beside it, or export it"
        )
    return person_page(result, _chosen(drawn.parent / "hypotheses.json", result), image=image)


def _chosen(path: Path, result: Result) -> list[Hypothesis]:
    """The hypotheses that were saved beside the draws; new ones where there are none."""
    if not path.exists():
        return hypotheses(result, min(K, result.num_draws))
    content = read_json(path, "hypotheses.json of poseterior", "give another folder")
    try:
        found = [
            Hypothesis(
                _points(one["joints"], 3),
                float(one["weight"]),
                int(one["draw"]),
                _points(one["keypoints"], 2) if "keypoints" in one else None,
            )
            for one in content["hypotheses"]
        ]
        joints = values(result.shown.tree, "posterior", "joints")
        theirs = [_is_of(joints, one) for one in found]
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise BadInput(
            f"{path} is not a hypotheses.json of poseterior ({type(error).__name__}); take it away,"
            " or put the right one there"
        ) from None
    if not (found and all(theirs) and all(0 <= one.weight <= 1 for one in found)):
        raise BadInput(
            f"{path} is not of the draws beside it; take it away, or put the right one there"
        )
    return [_of_draw(joints, one) for one in found]


def _points(written: Mapping[str, Any], size: int) -> np.ndarray:
    """`(15, size)`, as hypotheses.json has it. Raises `ValueError` where it is no such thing."""
    points = np.array([written[name] for name in JOINTS], float)
    if points.shape != (len(JOINTS), size) or not (np.abs(points) < LARGEST_NUMBER).all():
        raise ValueError(f"points of shape {points.shape}")
    return points


def _is_of(joints: np.ndarray, one: Hypothesis) -> bool:
    """Whether a hypothesis that was read is of draws `(n, 15, 3)`: its draw itself, or composed of
    their limbs, and no draw nearer to it than its own."""
    if one.keypoints is None:
        return bool((np.abs(joints[one.draw] - one.joints) <= _WRITTEN).all())
    away = np.linalg.norm((joints - one.joints).reshape(len(joints), -1), axis=1)
    return bool(away[one.draw] <= away.min() + _AS_NEAR)


def _of_draw(joints: np.ndarray, one: Hypothesis) -> Hypothesis:
    """With all digits, where it is a draw."""
    return one if one.keypoints is not None else one._replace(joints=joints[one.draw])
