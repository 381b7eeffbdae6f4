"""A focal length that nobody knows: the posterior is a mixture over those that there may be, which
brute force takes one by one; and controls that must fail.

False alarms: every number is held to 4.5 standard errors, 7e-6 each; seeds are fixed.
"""

import functools
import math

import jax
import numpy as np
import pytest
from scipy import stats

from poseterior.inference.baselines.rooted import RootedTarget
from poseterior.inference.draws import Draws
from poseterior.inference.importance.torsos import require_distance
from poseterior.inference.results import focal_of, result_of
from poseterior.inference.sampler import REJECTION
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.camera import FOCAL_MEDIAN, FOCAL_SPREAD, Lens
from poseterior.probmodel.root_priors import TorsoCameraPrior
from tests import oracle
from tests.inference.test_oracle import Row, beliefs, case, model, scene
from tests.scenes import drawer, key

FOCAL = np.array([180.0, 320.0, 650.0])
"""Pixels: two, three and a half, and seven body units away."""
PRINCIPAL = np.array([250.0, 420.0])
ROW = Row("uncertain", "", "gaussian", lens=True)
NAMES = ("log scale", "chest z", "back z", "elbow z", "wrist x", "wrist z")
LIMIT = 4.5
EFFORT = oracle.Effort(pilot=60_000, proposed=60_000, taken=6_000, arms=40)


@functools.cache
def each() -> tuple[oracle.Moments, ...]:
    """The oracle's posterior under each focal length."""
    found = []
    for seed, focal in enumerate(FOCAL):
        one = case(True)._replace(lens=oracle.Lens(float(focal), PRINCIPAL))
        found.append(oracle.under_roots(one, {"": beliefs(ROW)}, seed, EFFORT)[""])
    return tuple(found)


def mixed(chosen: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of a mixture over the chosen focal lengths `(k,)`: log evidence, shares, and means of
    `NAMES`, with standard errors."""
    some = [each()[index] for index in chosen]
    log = np.array([one.log_evidence for one in some])
    error = np.array([one.log_evidence_se for one in some])
    total = np.logaddexp.reduce(log)
    share = np.exp(log - total)
    columns = [oracle.NAMES.index(name) for name in NAMES]
    mean = np.stack([one.mean[columns] for one in some])
    mean_se = np.stack([one.mean_se[columns] for one in some])
    whole = share @ mean
    scatter = share[:, None] ** 2 * (mean_se**2 + ((mean - whole) * error[:, None]) ** 2)
    jacobian = np.diag(share) - np.outer(share, share)
    return {
        "evidence": (total - math.log(len(some)), np.sqrt(share**2 @ error**2)),
        "shares": (share, np.sqrt(jacobian**2 @ error**2)),
        "means": (whole, np.sqrt(scatter.sum(axis=0))),
    }


def told(draws: Draws, lenses: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The same of draws; those of one root err together."""
    joints = draws.joints
    elbow, wrist = (joints[:, list(oracle.JOINTS).index(name)] for name in oracle.ARM)
    points = draws.points
    rotation = points.rotation
    values = [points.log_scale, rotation[:, 2, 2], rotation[:, 2, 1], elbow[:, 2]]
    values += [wrist[:, 0], wrist[:, 2]]
    flags = np.arange(lenses) == points.lens[:, None]
    _, mean, error = oracle.moments(
        np.ones(len(joints)), np.stack(values, axis=1), flags.astype(float), points.log_scale
    )
    number = len(NAMES)
    rare = np.sqrt(mean[2 * number :] * (1 - mean[2 * number :]) / draws.effective_roots)
    return {
        "evidence": (draws.log_evidence, draws.log_evidence_se),
        "shares": (mean[2 * number :], np.maximum(error[2 * number :], rare)),
        "means": (mean[:number], error[:number]),
    }


def apart(one: dict, other: dict) -> dict[str, float]:
    """The largest difference of each part, in standard errors."""
    return {
        name: float(np.max(np.abs(one[name][0] - other[name][0]) / np.hypot(one[name][1], other[name][1])))
        for name in one
    }


def ask(route: str, focal: np.ndarray = FOCAL, number: int = 4000, roots: int = 1500) -> Draws:
    people = PoseModel.paper(torsos=model().torsos).seen_by(Lens(focal, PRINCIPAL))
    draw = drawer(people, root="uncertain", sampler=route, num_samples=number, num_roots=roots)
    from tests.inference.test_oracle import likelihood
    import dataclasses
    return draw(dataclasses.replace(scene(), likelihood=likelihood(ROW)), key(3))

if __name__ == "__main__":
    import time
    t=time.time(); m=mixed(np.arange(3)); print(m, time.time()-t)
    for route, kw in (("weighted-roots",{}),(REJECTION,dict(number=700,roots=300))):
        t=time.time(); d=ask(route, **kw); x=told(d,3); print(route, x, time.time()-t); print(apart(x,m))
    print(apart(told(ask("weighted-roots"),3), mixed(np.arange(3))|{}))
