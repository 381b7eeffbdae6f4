"""Whose posterior is judged: exact rejection, a baseline thinned until its draws are independent,
or draws in a file.

Each is a `Sampler`: an instance and its key → `Answer`. Failures are part of the answer, never
left out."""

import functools
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from poseterior.inference.baselines.catalogue import (
    BASELINES,
    DISPERSED,
    STARTING,
    draws_of,
    starting_points,
)
from poseterior.inference.baselines.run import Allowance, check_packages, run
from poseterior.inference.baselines.target import Target
from poseterior.inference.draws import COMPLETE, MAX_PROPOSALS, place
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.importance.weighted import APART, WeightedRoots, verdict, weigh_roots
from poseterior.inference.resampling import WEIGHTS, counting, let_pass, merged, weights_of
from poseterior.inference.sampler import MANY_ROOTS, DetectionSampler, sample
from poseterior.inference.sampler import sampler_of as core_sampler_of
from poseterior.inference.studies.calibration.assess import FAILED, Answer
from poseterior.inference.studies.calibration.quantities import of_pose
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.inference.studies.comparison.mixing import mean_ess, mixing
from poseterior.probmodel.arrays import read_array, read_netcdf, read_tables
from poseterior.probmodel.failures import BadInput, require_some, shown
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.skeleton import NUM_JOINTS

Sampler = Callable[[int, Instance, jax.Array], Answer]
"""The number of the instance, the instance, a key of its own."""
DRAWS_SUFFIXES = (".nc", ".npz", ".npy")


def sampler_of(
    name: str | None,
    model: PoseModel,
    num_samples: int,
    *,
    max_proposals: int = MAX_PROPOSALS,
    start: str = DISPERSED,
    root: str = UNCERTAIN,
    num_roots: int = MANY_ROOTS,
) -> Sampler:
    """The sampler of that name, or the draws of a file. Raises `BadInput` where there is none such,
    its package is missing, or it holds the root fixed where it shall be uncertain."""
    require_some(num_samples, "samples")
    if name is not None and Path(name).suffix.lower() in DRAWS_SUFFIXES:
        return FromFile.read(Path(name))
    if name in BASELINES and root == CANDIDATES:
        check_packages(name, BASELINES[name])
        return functools.partial(_baseline, name, model, num_samples, max_proposals, start)
    try:
        chosen = core_sampler_of(root, name, num_roots=num_roots, max_proposals=max_proposals)
    except BadInput as error:
        raise BadInput(f"{error}, or a file of draws ({', '.join(DRAWS_SUFFIXES)})") from None
    return functools.partial(_drawn, DetectionSampler(model, root, chosen, num_samples))


def _drawn(draw: DetectionSampler, index: int, instance: Instance, key: jax.Array) -> Answer:
    draws = draw(instance.frame, key)
    told = draws.log_evidence, draws.status, draws.sentence
    if draw.root == UNCERTAIN:
        return Answer(draws.joints, *told, draws.points)
    # Candidates differ in scale: all in the first one's body units.
    scale = draws.scale / float(instance.frame.best.camera.scale)
    return Answer(draws.joints * scale[:, None, None], *told)


ROOT_FACTORS = (1, 4, 16, 64)
"""How many times as many roots are tried where fewer bring too few effective ones."""
Reweigh = Callable[[WeightedRoots], WeightedRoots]


def independent_roots(
    model: PoseModel,
    num_samples: int,
    num_roots: int = MANY_ROOTS,
    *,
    max_proposals: int = MAX_PROPOSALS,
    reweigh: Reweigh = lambda roots: roots,
) -> Sampler:
    """Draws with an uncertain root that ranks can be made of: as many as there are independent
    ones, at most `num_samples`, hardly ever two of one root.

    Where `num_roots` are worth too few, as under a detection that hardly any root explains, all is
    drawn anew from four times as many, with as many times `max_proposals`, and again. `reweigh` is
    for controls that have to fail.
    """

    def draw(index: int, instance: Instance, key: jax.Array) -> Answer:
        posterior = instance.frame.posterior(model)
        for round_key, times in zip(
            jax.random.split(key, len(ROOT_FACTORS)), ROOT_FACTORS, strict=True
        ):
            roots_key, draws_key = jax.random.split(round_key)
            roots = reweigh(
                weigh_roots(
                    posterior,
                    key=roots_key,
                    num_roots=times * num_roots,
                    max_proposals=times * max_proposals,
                )
            )
            status, sentence = verdict(roots)
            if status == COMPLETE:
                break
        rng = np.random.default_rng(words_of(draws_key))
        points, poses, _ = roots.draw(rng, min(num_samples, int(roots.effective / APART)))
        joints, _ = place(posterior, points, poses, size=PLACED)
        return Answer(joints, roots.log_evidence, status, sentence, points)

    return draw


PLACED = 256
"""Draws placed at a time: there are hardly ever more."""


def _baseline(
    name: str,
    model: PoseModel,
    number: int,
    budget: int,
    start: str,
    index: int,
    instance: Instance,
    key: jax.Array,
) -> Answer:
    given = instance.frame.posterior(model, CANDIDATES)
    target = Target.of(given)
    baseline = BASELINES[name]
    places = None
    if baseline.starts:
        exact = _exact_tree(model, instance, jax.random.fold_in(key, 0))
        places = starting_points(target, exact, start)
    done = run(
        baseline,
        name,
        target,
        key=key,
        starts=places,
        num_samples=number,
        allowance=Allowance(evaluations=budget),
    )
    if not done.num_draws:
        return Answer(np.empty((0, NUM_JOINTS, 3)), done.log_evidence, done.status, done.sentence)
    draws = draws_of(given, target, done, key)
    joints = independent(draws.joints.reshape(draws.chains, -1, NUM_JOINTS, 3))
    if not len(joints):
        return Answer(joints, done.log_evidence, FAILED, f"the chains of {name} did not move")
    return Answer(joints, done.log_evidence, COMPLETE, done.sentence)


def _exact_tree(model: PoseModel, instance: Instance, key: jax.Array) -> xr.DataTree:
    return sample(model, instance.frame, key=key, root=CANDIDATES, num_samples=STARTING).tree


def independent(joints: np.ndarray) -> np.ndarray:
    """`(n, 15, 3)`: draws of chains `(chain, draw, 15, 3)` thinned to their effective number, that
    of the worst quantity of the pose; none where the chains did not move."""
    chains, draws = joints.shape[:2]
    values = of_pose(joints.reshape(-1, *joints.shape[2:])).reshape(chains, draws, -1)
    flips = np.all((values == 0) | (values == 1), axis=(0, 1))
    smooth = values[..., ~flips]
    mixed = mixing(smooth, smooth.std(axis=(0, 1)))
    if mixed.stuck:
        return joints[:, :0].reshape(0, *joints.shape[2:])
    sizes = [float(np.nanmin(mixed.bulk)) if np.isfinite(mixed.bulk).any() else 1.0]
    sizes += [mean_ess(values[..., column]) for column in np.flatnonzero(flips)]
    stride = max(1, math.ceil(chains * draws / min(sizes)))
    return joints[:, ::stride].reshape(-1, *joints.shape[2:])


@dataclass(frozen=True)
class FromFile:
    """Draws made elsewhere.

    Attributes
    ----------
    path
        The file.
    joints : `(instances, draws, 15, 3)`
        Camera axes, body units, pelvis at the origin; an instance with NaN in a draw that counts
        has failed.
    log_weights : `(instances, draws)`
        Of independent draws; None where they are of equal weight.
    """

    path: Path
    joints: np.ndarray
    log_weights: np.ndarray | None = None

    @property
    def sha256(self) -> str:
        """Of the draws, and of their weights."""
        digest = hashlib.sha256(np.ascontiguousarray(self.joints, "<f8").data)
        if self.log_weights is not None:
            digest.update(np.ascontiguousarray(self.log_weights, "<f8").data)
        return digest.hexdigest()

    @classmethod
    def read(cls, path: Path) -> "FromFile":
        """Raises `BadInput` on a file without such joints, or with weights that cannot be any."""
        arrays = _read(path)
        joints = arrays["joints"]
        if (
            joints.ndim != 4
            or joints.shape[2:] != (NUM_JOINTS, 3)
            or joints.dtype.kind not in "fiu"
        ):
            raise BadInput(
                f"the joints in {path} have shape {joints.shape}; they need (simulations, draws,"
                f" {NUM_JOINTS}, 3)"
            )
        return cls(path, joints.astype(float), weights_of(arrays, joints.shape[:2], str(path)))

    def __call__(self, index: int, instance: Instance, key: jax.Array) -> Answer:
        if index >= len(self.joints):
            raise BadInput(
                f"{self.path} has draws for {len(self.joints)} simulations; ask for as many, not"
                " for more"
            )
        draws = self.joints[index]
        if self.log_weights is not None:
            log_weights = self.log_weights[index]
            counts = counting(log_weights)
            if not counts.any():
                said = f"all weights of simulation {index} in {self.path.name} are zero"
                return Answer(draws[:0], np.nan, FAILED, said)
            draws, log_weights = merged(draws[counts], log_weights[counts])
            draws = draws[let_pass(log_weights, np.random.default_rng(words_of(key)))]
        given = np.isfinite(draws).all(axis=(1, 2))
        if given.all():
            return Answer(draws)
        said = f"{int((~given).sum())} of {len(draws)} draws in {self.path.name} are not finite"
        return Answer(draws[:0], np.nan, FAILED, said)


_ADVICE = "write one with numpy.savez(path, joints=joints)"


def _read(path: Path) -> dict[str, np.ndarray]:
    """The joints of a file, and weights where it has any."""
    what, suffix = "file of draws", path.suffix.lower()
    if suffix not in (".nc", ".npz"):
        return {"joints": read_array(path, what, _ADVICE)}
    names = {name: name for name in ("joints", *WEIGHTS)}
    if suffix == ".nc":
        names = {name: f"posterior/{name}" for name in names}
        found = read_netcdf(path, list(names.values()), what, _ADVICE)
    else:
        found = read_tables(path, what, _ADVICE)
    if names["joints"] not in found:
        raise BadInput(f"{path} has no array `{names['joints']}`; {_ADVICE}")
    unknown = sorted(set(found) - set(names.values()))
    if unknown:
        raise BadInput(
            f"{path} has an array {shown(unknown[0])}; it may have {', '.join(names.values())}"
        )
    return {name: found[inside] for name, inside in names.items() if inside in found}
