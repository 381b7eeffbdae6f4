"""Do intervals hold for people and cameras that were never seen? Posteriors of views of people,
judged by what is known of the truth, coordinate by coordinate; shares with intervals over people.

Joints are placed about the midpoint of hips, and again of shoulders: whoever knows the truth may
mean other hips than the skeleton has, and then all that is placed about them is off by as much.
Without a lens depth is along the line of sight to there, since weak perspective knows no other
axis; with one it is along the optical axis.
"""

import contextlib
import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior import inference
from poseterior.inference.studies.calibration.record import detected_columns
from poseterior.probmodel import Estimate, Likelihood, PoseModel
from poseterior.probmodel.body import bone_lengths
from poseterior.probmodel.datasets.person_views import PersonView
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.sessions.session import turn_to_sight
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, JOINTS, NUM_JOINTS

MIDDLES = {
    "hips": [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]],
    "shoulders": [JOINT_INDEX["right_shoulder"], JOINT_INDEX["left_shoulder"]],
}
"""Between which two joints the others are placed, by what it is called."""
JUDGED = tuple(
    JOINT_INDEX[f"{side}_{part}"]
    for part in ("elbow", "wrist", "knee", "ankle")
    for side in ("right", "left")
)
"""The joints whose coordinates are counted: of limbs."""
LEVELS = 0.5, 0.95
ANOTHER = 250.0
"""Millimetres between a detection and where a person is beyond which it is of somebody else."""
BOOTSTRAPS = 2000


class ViewLevels(NamedTuple):
    """A view's truth among its draws: `level` `(15, 3)`, the share of draws below it, `width`
    `(2, 15, 3)` of the intervals of `LEVELS`, mm, and `error` `(15, 3)` of the mean, mm; NaN where
    nobody knows the truth, or there are no draws."""

    level: np.ndarray
    width: np.ndarray
    error: np.ndarray


class Honesty(NamedTuple):
    """What all views together say.

    Attributes
    ----------
    covered, low, high
        Coverage by level and axis `(2, 3)`, with the ends of 95 % intervals over people.
    width, error, ece
        By axis `(3,)`: the width of 95 % intervals, mm; the root mean square error of the mean, mm;
        the expected calibration error.
    views, people, silent
        Of how many views and people; and how many views brought no draws.
    """

    covered: np.ndarray
    low: np.ndarray
    high: np.ndarray
    width: np.ndarray
    error: np.ndarray
    ece: np.ndarray
    views: int
    people: int
    silent: int


def units_of(views: Sequence[PersonView], model: PoseModel) -> dict[str, float]:
    """Millimetres of every person's body unit: the median over views of known bones' lengths over
    what the model's people have there; of somebody without any known bone, the median of the
    others. Raises `BadInput` where nobody has one."""
    low, high, alpha, beta = (np.asarray(part) for part in model.lengths)
    mean = low + (high - low) * alpha / (alpha + beta)
    usual = mean[[bone.length_group for bone in BONES]]
    found: dict[str, list[float]] = {}
    for view in views:
        with np.errstate(invalid="ignore"):
            own = bone_lengths(view.truth)
        limbs = [row for row, bone in enumerate(BONES) if bone.name != "head"]
        known = [row for row in limbs if np.isfinite(own[row])]
        if known:
            ratio = own[known].sum() / usual[known].sum()
            found.setdefault(view.person, []).append(float(ratio))
    if not found:
        raise BadInput("no bone of these people is known, so that nobody knows how large they are")
    units = {person: float(np.median(ratios)) for person, ratios in found.items()}
    usually = float(np.median(list(units.values())))
    return {view.person: units.get(view.person, usually) for view in views}


def judge(
    view: PersonView,
    unit: float,
    model: PoseModel,
    likelihood: Likelihood,
    seed: int,
    num_samples: int = 1000,
    num_roots: int = 400,
) -> dict[str, ViewLevels]:
    """A view's truth among draws of its posterior, about each of `MIDDLES`.

    Parameters
    ----------
    view
        What was seen, and what is true.
    unit
        Millimetres of the person's body unit.
    model
        With what is believed of the camera.
    likelihood
        How detections err.
    seed
        Of draws and of the errors that they are given, those of the truth.
    num_samples, num_roots
        How many draws, from how many roots.
    """
    frame = Estimate(view.detection, (), likelihood)
    draws = np.zeros((0, NUM_JOINTS, 3))
    with contextlib.suppress(BadInput):
        result = inference.sample(
            model,
            frame,
            key=jax.random.key(seed),
            num_samples=num_samples,
            root=UNCERTAIN,
            num_roots=num_roots,
        )
        if result.num_draws:
            joints = result.tree["posterior"].to_dataset()["joints"]
            draws = joints.values[0].astype(float) * unit
    rng = np.random.default_rng([seed, 7])
    draws = draws + rng.normal(size=draws.shape) * view.sigma[:, None]
    along = model.lens is None
    return {name: levels_about(view, draws, pair, along) for name, pair in MIDDLES.items()}


def levels_about(
    view: PersonView, draws: np.ndarray, pair: Sequence[int], along_sight: bool
) -> ViewLevels:
    """A view's truth among draws `(n, 15, 3)`, mm, both about the midpoint of a pair of joints,
    with depth along the line of sight to there, or along the optical axis."""
    centre = view.truth[pair].mean(axis=0)
    if not (len(draws) and np.isfinite(centre).all()):
        nothing = np.full((NUM_JOINTS, 3), np.nan)
        return ViewLevels(nothing, np.stack([nothing, nothing]), nothing)
    truth = view.truth - centre
    if along_sight:
        truth = truth @ turn_to_sight(centre).T
    draws = draws - draws[:, pair].mean(axis=1, keepdims=True)
    low = np.quantile(draws, [(1 - level) / 2 for level in LEVELS], axis=0)
    high = np.quantile(draws, [(1 + level) / 2 for level in LEVELS], axis=0)
    known = np.isfinite(truth)
    return ViewLevels(
        np.where(known, (draws < truth).mean(axis=0), np.nan),
        np.where(known, high - low, np.nan),
        np.where(known, draws.mean(axis=0) - truth, np.nan),
    )


def beside(view: PersonView) -> np.ndarray:
    """`(15, 2)` mm, to the right and down: how far beside the truth, as the camera sees it, joints
    are detected; no model has a part in it. NaN where either is not known."""
    depth, focal = view.truth[:, 2:], float(np.mean(view.lens.focal))
    seen = focal * view.truth[:, :2] / depth + view.lens.principal
    return (view.detection.keypoints - seen) * depth / focal


def beside_truth(views: Sequence[PersonView], pair: Sequence[int]) -> np.ndarray:
    """`(2,)` mm: `beside` of the midpoint of a pair of joints, the median over views."""
    return np.nanmedian([beside(view)[pair].mean(axis=0) for view in views], axis=0)


def of_the_person(view: PersonView) -> bool:
    """Whether a view shows the person at all, and not somebody beside: whether the median joint is
    detected within `ANOTHER` of where it truly is."""
    apart = np.linalg.norm(beside(view), axis=-1)
    return bool(np.isfinite(apart).any() and np.nanmedian(apart) < ANOTHER)


def even(views: Sequence[PersonView], number: int) -> list[PersonView]:
    """At most so many views of which something is known, as many of each person as of any other
    while there are that many, evenly over theirs. Raises `BadInput` where nothing is known of any,
    or so many are fewer than one of each."""
    own: dict[str, list[PersonView]] = {}
    for view in views:
        joints = view.truth[list(JUDGED)]
        placed = np.isfinite([view.truth[pair] for pair in MIDDLES.values()]).all(axis=(1, 2))
        if placed.any() and np.isfinite(joints).all(axis=1).any():
            own.setdefault(view.person, []).append(view)
    counts = sorted(map(len, own.values()))
    if not counts:
        raise BadInput(
            "no view shows a limb's joint and a pair of hips or shoulders whose truth is known"
        )
    if number < len(own):
        raise BadInput(
            f"{number} views are fewer than one of each of {len(own)} people; ask for more (on the"
            " command line --frames)"
        )
    most = next(n for n in range(counts[-1], 0, -1) if sum(min(n, c) for c in counts) <= number)
    return [some[row] for some in own.values() for row in evenly(len(some), most)]


def by_person(views: Sequence[PersonView], judged: Sequence[ViewLevels]) -> dict[str, Honesty]:
    """What the views of each person say."""
    found = {}
    for person in dict.fromkeys(view.person for view in views):
        rows = [row for row, view in enumerate(views) if view.person == person]
        found[person] = honesty([views[row] for row in rows], [judged[row] for row in rows])
    return found


def honesty(views: Sequence[PersonView], judged: Sequence[ViewLevels]) -> Honesty:
    """What all views say together."""
    limbs = list(JUDGED)
    level = np.stack([one.level[limbs] for one in judged])
    width = np.stack([one.width[1][limbs] for one in judged])
    error = np.stack([one.error[limbs] for one in judged])
    people, owner = np.unique([view.person for view in views], return_inverse=True)
    counted = functools.partial(_by_person, owner, len(people))
    known = counted(np.isfinite(level))
    held = np.stack([counted(inside(level, one)) for one in LEVELS])
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(people), size=(BOOTSTRAPS, len(people)))
    again = held[:, chosen].sum(axis=2) / np.maximum(known[chosen].sum(axis=1), 1)
    low, high = np.quantile(again, [0.025, 0.975], axis=1)
    grid = np.linspace(0.05, 0.95, 19)
    share = [inside(level, one).sum(axis=(0, 1)) for one in grid]
    total = known.sum(axis=0)
    some = np.isfinite(level)
    with np.errstate(invalid="ignore"):  # where nothing is known there is no mean
        return Honesty(
            held.sum(axis=1) / total,
            low,
            high,
            np.where(some, width, 0.0).sum(axis=(0, 1)) / total,
            np.sqrt(np.where(some, error**2, 0.0).sum(axis=(0, 1)) / total),
            np.abs(np.array(share) / total - grid[:, None]).mean(axis=0),
            len(views),
            len(people),
            sum(not one.any() for one in some),
        )


def levels_tree(
    views: Sequence[PersonView], about: Mapping[str, Sequence[ViewLevels]]
) -> xr.DataTree:
    """What `coverage judge` reads: levels of the coordinates about each midpoint, as far as truths
    are known, and what was seen of every view."""
    limbs = list(JUDGED)
    level = np.stack([[one.level[limbs] for one in some] for some in about.values()], axis=1)
    names = [
        f"{JOINTS[joint]} {axis} about the {middle}"
        for middle in about
        for joint in limbs
        for axis in "xyz"
    ]
    table = {
        "level": (("simulation", "quantity"), level.reshape(len(views), -1)),
        "person": ("simulation", np.array([view.person for view in views])),
    }
    seen = detected_columns([view.detection for view in views])
    groups = {
        "simulation": xr.Dataset(table, coords={"quantity": names}),
        "covariates": xr.Dataset({name: ("simulation", one) for name, one in seen.items()}),
    }
    return xr.DataTree.from_dict(groups)


def inside(level: np.ndarray, nominal: float) -> np.ndarray:
    """Which truths, at such levels among their draws, lie in the central interval."""
    return np.abs(level - 0.5) <= nominal / 2  # false for NaN


def _by_person(owner: np.ndarray, number: int, counts: np.ndarray) -> np.ndarray:
    """`(people, 3)` sums of counts `(views, joints, 3)`."""
    return np.stack([np.bincount(owner, one, number) for one in counts.sum(axis=1).T], axis=1)
