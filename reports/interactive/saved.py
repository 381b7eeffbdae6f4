"""The page of what was saved: a posterior.nc, its folder, or the folder of a stream."""

from pathlib import Path

import numpy as np

from inference.hypothesis import Hypothesis, hypotheses
from inference.results import Result
from inference.saved import read_result
from inference.store import SETTINGS
from inference.stream import open_stream
from probmodel.documents import read_json
from probmodel.failures import BadInput
from probmodel.skeleton import JOINTS
from reports.interactive.film import film_page
from reports.interactive.person import person_page
from reports.tables.posterior import values

K = 5
"""Hypotheses where none were saved beside the draws."""
_ADVICE = "give a posterior.nc, its folder, or that of a stream of `poseterior frames`"
_WRITTEN = 1e-6
"""Body units to which hypotheses.json has the joints."""


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
        return film_page(open_stream(path), path.resolve().name)
    drawn = path / "posterior.nc" if path.is_dir() else path
    if path.is_dir() and not drawn.exists():
        raise BadInput(f"{path} is a folder without a result; {_ADVICE}")
    result = read_result(drawn)
    return person_page(result, _chosen(drawn.parent / "hypotheses.json", result), image=image)


def _chosen(path: Path, result: Result) -> list[Hypothesis]:
    """The hypotheses that were saved beside the draws; new ones where there are none."""
    if not path.exists():
        return hypotheses(result, min(K, result.num_draws))
    content = read_json(path, "hypotheses.json of poseterior", "give another folder")
    joints = values(result.tree, "posterior", "joints")
    try:
        found = [
            Hypothesis(joints[int(one["draw"])], float(one["weight"]), int(one["draw"]))
            for one in content["hypotheses"]
        ]
        written = np.array(
            [[one["joints"][name] for name in JOINTS] for one in content["hypotheses"]], float
        )
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise BadInput(
            f"{path} is not a hypotheses.json of poseterior ({type(error).__name__}); take it away,"
            " or put the right one there"
        ) from None
    drawn = np.array([one.joints for one in found])
    same = written.shape == drawn.shape and (np.abs(written - drawn) <= _WRITTEN).all()
    if not (found and same and all(0 <= one.weight <= 1 for one in found)):
        raise BadInput(
            f"{path} is not of the draws beside it; take it away, or put the right one there"
        )
    return found
