"""The slopes of every program and of every density that samplers follow, against central
differences of the same program's values, which need no derivative: with joints missing, faults,
biases and lenses. A joint that does not count has an infinite spread, and zero times infinity is
no number.

Each slope is held to 1e-5 of the largest. The detection is data of one compiled function a program,
law and camera."""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from numpyro.handlers import condition, seed
from numpyro.infer.util import log_density, potential_energy, unconstrain_fn

from poseterior.inference.baselines.rooted import RootedTarget
from poseterior.inference.baselines.target import Target
from poseterior.probmodel import Lens, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import (
    EXCHANGE_INDEX,
    LIMB_INDEX,
    ORDERS,
    FaultPrior,
    Faults,
)
from poseterior.probmodel.errors.laws import LAWS
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Estimate, Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.rotations import rotation_of
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS, TORSO_INDEX
from poseterior.probmodel.summed import SummedFaults
from poseterior.probmodel.transport import CUBE_DIM, from_cube
from tests.inference.test_uncertain_faults import learned
from tests.scenes import camera, scene

STEP = 1e-6
MISSING: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "an ankle": ("right_ankle",),
    "an arm, a hip and the head": ("left_elbow", "left_wrist", "right_hip", "head"),
    "all limbs but an arm": tuple(
        name
        for name in JOINTS
        if name.endswith(("knee", "ankle")) or name in ("head", "left_elbow", "left_wrist")
    ),
}
FAULTS: dict[str, tuple[tuple[str, ...], str]] = {
    "none": ((), "none"),
    "outliers": (("right_wrist", "thorax"), "none"),
    "legs exchanged": ((), "legs"),
    "a body exchanged, and an outlier": (("right_wrist",), "body"),
}
"""Which keypoints are outliers, and which are exchanged."""
LENS = Lens(1000.0, np.array([300.0, 260.0]))
LIKELIHOODS = {name: Likelihood(law(), factor=0.6) for name, law in LAWS.items()} | {
    "learned": Likelihood.of(learned(sigma=np.linspace(0.4, 0.9, NUM_JOINTS)))
}
"""The last has a bias for every joint."""


class Case(NamedTuple):
    """A detection with the root, the pose and the faults that it was made of."""

    frame: Estimate
    point: RootPoint
    pose: Pose
    faults: Faults


@functools.cache
def model(lens: bool) -> PoseModel:
    whole = PoseModel()
    torsos = np.asarray(whole.torsos)[:3]
    return PoseModel(whole.limits, whole.lengths, torsos, lens=LENS if lens else None)


@functools.cache
def case(law: str, missing: str, faults: str | None) -> Case:
    """Somebody seen with these faults; None where the detector has none."""
    rng, torso, view = np.random.default_rng(5), np.asarray(model(False).torsos)[1], camera(30, 10)
    pose = Pose(*map(np.asarray, from_cube(model(False), jnp.asarray(rng.uniform(size=CUBE_DIM)))))
    joints = np.asarray(model(False).joints(torso, *pose))
    frame = scene(torso, view, joints, rng=rng, missing=MISSING[missing])
    outliers, exchange = FAULTS[faults or "none"]
    order = ORDERS[EXCHANGE_INDEX[exchange]]
    keypoints, score = frame.detection.keypoints[order], frame.detection.score[order]
    detection = dataclasses.replace(frame.detection, keypoints=keypoints, score=score)
    prior = FaultPrior() if faults is None else FaultPrior.of(0.1, 0.1)
    likelihood = dataclasses.replace(LIKELIHOODS[law], faults=prior)
    frame = dataclasses.replace(frame, detection=detection, likelihood=likelihood)
    point = RootPoint(
        np.int64(1), np.asarray(view.rotation), np.log(view.scale), np.asarray(view.translation)
    )
    flags = np.isin(JOINTS, outliers) & (score > 0)
    return Case(frame, point, pose, Faults(np.int64(EXCHANGE_INDEX[exchange]), flags))


class Prepared(NamedTuple):
    """A density whose slopes are looked at: `log(data, at)`, what a case brings, and its numbers,
    which may move freely; all but `log` pytrees."""

    log: Callable[[Any, Any], jax.Array]
    data: Any
    at: Any


def sites(one: Any, at: dict[str, Any]) -> dict[str, Any]:
    """What a program draws, where root and pose are at these numbers."""
    upper, lower = (
        bones / jnp.linalg.norm(bones, axis=-1, keepdims=True)
        for bones in (at["upper"], at["lower"])
    )
    return one["discrete"] | {
        "rotation": rotation_of(jnp.append(1.0, at["turn"])) @ one["rotation"],
        "log_scale": at["log_scale"],
        "translation": at["place"],
        "bone_length": at["length"],
        "upper": upper,
        "lower": lower,
    }


def discrete(one: Case) -> dict[str, Any]:
    """The sites without slopes."""
    torso = one.faults.outlier[list(TORSO_INDEX)]
    return {
        "root": np.int64(0),
        "torso": one.point.torso,
        "exchange": one.faults.exchange,
        "torso_outlier": np.int64(1 + np.argmax(torso) if torso.any() else 0),
        "limb_outlier": one.faults.outlier[list(LIMB_INDEX)].astype(int),
    }


def program_of(posterior: Callable[[PoseModel, Case], Any], *cached: str) -> "Prepare":
    """The program of a posterior; what that keeps of the detection, `cached`, is data."""

    def prepare(known: PoseModel, one: Case) -> Prepared:
        found = posterior(known, one)

        def log(data: Any, at: Any) -> jax.Array:
            own = dataclasses.replace(found)
            vars(own).update(data["kept"])
            program = condition(own.program, data=sites(data, at))
            return log_density(program, (), {}, {})[0]

        kept = {name: getattr(found, name) for name in cached}
        root = {"log_scale": one.point.log_scale, "place": one.point.translation}
        data = {"kept": kept, "discrete": discrete(one), "rotation": one.point.rotation}
        return Prepared(log, data, root | {"turn": np.zeros(3)} | one.pose._asdict())

    return prepare


def mixture(known: PoseModel, one: Case) -> Posterior:
    twice = dataclasses.replace(one.frame, candidates=one.frame.candidates * 2)
    return twice.posterior(known)


def potential(known: PoseModel, one: Case) -> Prepared:
    """What NUTS follows: the program of an uncertain root on R^d."""
    found = one.frame.posterior(known)

    def program(data: Any) -> Callable[[], jax.Array]:
        own = dataclasses.replace(found)
        vars(own).update(detected=data["detected"])
        return condition(own.program, data=data["discrete"])

    def log(data: Any, at: Any) -> jax.Array:
        return -potential_energy(program(data), (), {}, at)

    fixed = {name: value for name, value in discrete(one).items() if name != "root"}
    data = {"detected": found.detected, "discrete": fixed}
    point, pose = one.point, one.pose
    truth = {
        "rotation": point.rotation,
        "log_scale": point.log_scale,
        "translation": point.translation,
        "bone_length": pose.length,
        "upper": pose.upper,
        "lower": pose.lower,
    }
    truth = jax.tree.map(jnp.asarray, truth)
    return Prepared(log, data, unconstrain_fn(seed(program(data), 0), (), {}, truth))


def summed(known: PoseModel, one: Case) -> Prepared:
    """Faults summed out, by root and joints."""
    posterior = one.frame.posterior(known)
    likelihood = SummedFaults(posterior.detected, posterior.faults, posterior.root_prior)

    def log(data: Any, at: Any) -> jax.Array:
        point = data["point"]._replace(log_scale=at["log_scale"], translation=at["place"])
        return data["likelihood"].log_likelihood(point, at["joints"])

    joints = known.joints(posterior.root_prior.root(one.point).view, *one.pose)
    at = {"joints": joints, "log_scale": one.point.log_scale, "place": one.point.translation}
    return Prepared(log, {"likelihood": likelihood, "point": one.point}, at)


def walked(free: bool, name: str, *more: float) -> "Prepare":
    """A density in which samplers of R^d walk."""

    def prepare(known: PoseModel, one: Case) -> Prepared:
        rows = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (one.point, one.pose))
        if free:
            rooted = RootedTarget.of(one.frame.posterior(known))
            return Prepared(log, rooted, rooted.points_at(*rows)[0])
        target = Target.of(one.frame.posterior(known))
        return Prepared(log, target, target.points_of(rows[1])[0])

    def log(target: Any, at: Any) -> jax.Array:
        return getattr(target, name)(at, *more)

    return prepare


Prepare = Callable[[PoseModel, Case], Prepared]
HELD: dict[str, Prepare] = {
    "program of a mixture": program_of(mixture, "detected"),
    "Target.log_density": walked(False, "log_density"),
    "Target.log_smooth": walked(False, "log_smooth", 20.0),
    "Target.log_graded": walked(False, "log_graded", 5.0),
    "Target.log_walls": walked(False, "log_walls", 20.0),
}
"""Under a root that is held, by detectors without faults."""
FREE: dict[str, Prepare] = {
    "program of an uncertain root": program_of(
        lambda known, one: one.frame.posterior(known), "detected"
    ),
    "potential of an uncertain root": potential,
    "faults summed out": summed,
    "RootedTarget.log_density": walked(True, "log_density"),
}
"""Under an uncertain root, with faults and without."""
FAULTLESS: dict[str, Prepare] = {
    "RootedTarget.log_smooth": walked(True, "log_smooth", 20.0),
    "RootedTarget.log_walls": walked(True, "log_walls", 20.0),
}
TABLE = [
    *((name, law, False, False) for name, law in itertools.product(HELD, LIKELIHOODS)),
    *itertools.product(FREE, LIKELIHOODS, (False, True), (False, True)),
    *((*rest, False) for rest in itertools.product(FAULTLESS, LIKELIHOODS, (False, True))),
]
QUICK = [
    ("program of a mixture", "gaussian", False, False),
    ("program of an uncertain root", "learned", True, True),
    *(("faults summed out", law, lens, True) for law in LIKELIHOODS for lens in (False, True)),
]
"""The rest take minutes to compile."""


def wrong(name: str, law: str, lens: bool, faulty: bool) -> list[str]:
    """Of every detection the slopes that are wrong, in words."""
    found, compiled = [], {}
    for missing, faults in itertools.product(MISSING, FAULTS if faulty else [None]):
        prepared = (HELD | FREE | FAULTLESS)[name](model(lens), case(law, missing, faults))
        flat, back = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), prepared.at))
        if len(flat) not in compiled:  # what no seen joint depends on is no coordinate of a target
            compiled[len(flat)] = with_slopes(prepared.log, back)
        gap, largest = compared(functools.partial(compiled[len(flat)], prepared.data), flat)
        if not gap <= 1e-5 * (1 + largest):  # true for NaN
            found.append(f"{missing}, {faults}: off by {gap} of {largest}")
    return found


def with_slopes(log: Callable[[Any, Any], jax.Array], back: Callable[[Any], Any]) -> Any:
    """Value and slopes of a density, compiled: of its data and its numbers in a row."""
    return jax.jit(jax.value_and_grad(lambda data, row: log(data, back(row)), argnums=1))


def compared(both: Callable[[Any], Any], flat: jax.Array) -> tuple[float, float]:
    """How far slopes are from central differences at most, and how large the largest is."""
    value, slopes = both(flat)
    assert np.isfinite(value)
    moves = STEP * np.eye(len(flat))
    wanted = np.array([float(both(flat + one)[0] - both(flat - one)[0]) for one in moves])
    wanted /= 2 * STEP
    return float(np.abs(np.asarray(slopes) - wanted).max()), float(np.abs(wanted).max())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "law", "lens", "faulty"), QUICK)
def test_slopes_are_those_of_the_values(name: str, law: str, lens: bool, faulty: bool) -> None:
    assert wrong(name, law, lens, faulty) == []


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "law", "lens", "faulty"), [row for row in TABLE if row not in QUICK]
)
def test_slopes_of_all_others(name: str, law: str, lens: bool, faulty: bool) -> None:
    assert wrong(name, law, lens, faulty) == []
