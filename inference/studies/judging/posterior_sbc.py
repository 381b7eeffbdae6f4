"""Is a sampler right *here*, on the data at hand, and not on average over the prior? Posterior SBC
(Säilynoja, Schmitt, Bürkner & Vehtari 2025, arXiv 2502.03279).

    found = posterior_sbc(program, {"y": y})          # a NumPyro model, by NUTS
    found = posterior_sbc(pt.PoseModel(), frame)      # ours, torso and camera held fixed

Draws of the posterior take the place of the prior's: each is a truth, data are simulated of it once
more, and its rank among draws of the posterior of both data is uniform if the sampler is right
about all of them. A sampler that is wrong in the same way always, as under another prior, agrees
with itself, and is not found."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from poseterior.inference.sampler import sample
from poseterior.inference.studies.calibration.quantities import MOVING, OF_POSE
from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.judge import Judged, judge_brought
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES

NUM_REPLICATES = 100
SAMPLED = 500
"""Draws of a replicate, of a NumPyro model."""
WARM_UP = 500
DRAWN_TWICE = 4000
"""Draws of a replicate of ours, which are weighted: nine joints leave a twelfth or so."""
Program = Callable[[Mapping[str, Any] | None], None]
"""A NumPyro program that is given the data of a replicate, or none."""
ProgramSampler = Callable[[Program, jax.Array, Mapping[str, Any] | None], Mapping[str, Any]]
"""A program, a key and a replicate's data → independent draws by site, `(n, ...)`."""


def posterior_sbc(
    model: Any,
    data: Any,
    sampler: ProgramSampler | str | None = None,
    *,
    seed: int = 0,
    num_replicates: int = NUM_REPLICATES,
    num_samples: int | None = None,
) -> Judged:
    """Judges a sampler on one data set.

    Parameters
    ----------
    model
        A NumPyro model without arguments, whose observed sites are those of `data`; or a
        `PoseModel`.
    data
        What was observed, by site; or an `Estimate` or `Detection` of a person, whose best torso
        and camera are held fixed.
    sampler
        A function `(program, key, replicate)`: draws from `program(replicate)` by site, independent
        ones; NUTS, thinned, if none is given. Of a `PoseModel` a name, as `sample` takes it.
    seed
        Of everything.
    num_replicates
        How many truths; at least 20.
    num_samples
        Draws for each.

    Returns
    -------
    Judged
        As of `judge_coverage`.

    Raises
    ------
    BadInput
        On fewer replicates, data that the model does not know, or a likelihood with faults.
    """
    if num_replicates < 1:
        raise BadInput(f"the number of replicates must be at least 1, not {num_replicates}")
    if isinstance(model, PoseModel):
        if not (sampler is None or isinstance(sampler, str)):
            raise BadInput("the sampler of a PoseModel is given by its name")
        brought = _of_pose(model, data, sampler, seed, num_replicates, num_samples or DRAWN_TWICE)
    else:
        draw = _nuts(num_samples or SAMPLED) if sampler is None else sampler
        if isinstance(draw, str):
            raise BadInput("the sampler of a NumPyro model is a function, not a name")
        brought = _of_program(model, data, draw, seed, num_replicates)
    return judge_brought(brought, seed=seed)


def _of_program(
    model: Callable[[], Any],
    data: Mapping[str, Any],
    draw: ProgramSampler,
    seed: int,
    number: int,
) -> Brought:
    from numpyro.infer import Predictive

    program = observed_twice(model, data)
    key, truth_key, seen_key = jax.random.split(jax.random.key(seed), 3)
    first = {name: np.asarray(values) for name, values in draw(program, truth_key, None).items()}
    rows = np.linspace(0, len(next(iter(first.values()))) - 1, number).astype(int)
    truth = {name: values[rows] for name, values in first.items()}
    again = Predictive(model, truth)(seen_key)
    if unknown := set(data) - set(again):
        raise BadInput(
            f"the model has no observed site {', '.join(sorted(unknown))}; it draws"
            f" {', '.join(sorted(again)) or 'nothing'} beside its parameters"
        )
    found = []
    for row in range(number):
        replicate = {name: again[name][row] for name in data}
        found.append(draw(program, jax.random.fold_in(key, row), replicate))
    fewest = min(len(next(iter(one.values()))) for one in found)
    draws = {name: np.stack([np.asarray(one[name])[:fewest] for one in found]) for name in truth}
    return Brought.of(draws, truth)


def observed_twice(model: Callable[[], Any], data: Mapping[str, Any]) -> Program:
    """The model given its data, and given a replicate of them too where there is one."""
    import numpyro
    from numpyro import handlers

    def program(replicate: Mapping[str, Any] | None = None) -> None:
        with handlers.trace() as trace, handlers.condition(data=dict(data)):
            model()
        for name, values in (replicate or {}).items():
            site = trace[name]
            scale = 1.0 if site["scale"] is None else site["scale"]
            numpyro.factor(f"{name} once more", scale * site["fn"].log_prob(values).sum())

    return program


def _nuts(number: int) -> ProgramSampler:
    """NUTS, of whose draws every tenth is kept."""
    from numpyro.infer import MCMC, NUTS

    runs: dict[Program, MCMC] = {}

    def draw(
        program: Program, key: jax.Array, replicate: Mapping[str, Any] | None
    ) -> Mapping[str, Any]:
        kept = runs.get(program) if replicate else None
        if kept is None:
            kept = MCMC(
                NUTS(program),
                num_warmup=WARM_UP,
                num_samples=number * THINNED,
                thinning=THINNED,
                progress_bar=False,
                jit_model_args=True,
            )
            if replicate:
                runs[program] = kept
        kept.run(key, replicate)
        return kept.get_samples()

    return draw


THINNED = 5


def _of_pose(
    model: PoseModel,
    given: Estimate | Detection,
    sampler: str | None,
    seed: int,
    number: int,
    num_samples: int,
) -> Brought:
    """Detections of one pose under fixed torso and camera: the sampler draws given the mean of
    both, and weights make of it the posterior of both. What one law allows of two detections, it
    allows of their mean, since its reach is a disc."""
    from poseterior.inference.estimators import estimate_torso

    frame = estimate_torso(given) if isinstance(given, Detection) else given
    if frame.likelihood.faults.any:
        raise BadInput(
            "posterior SBC knows no faults of a detector; give a likelihood without outliers and"
            " exchanges"
        )
    frame = dataclasses.replace(frame, candidates=(frame.best,))
    keys = jax.random.split(jax.random.key(seed), number + 1)
    asked: dict[str, Any] = {"sampler": sampler, "root": CANDIDATES}
    first = sample(model, frame, key=keys[0], num_samples=number, **asked).tree
    truth = _ends(first)
    keypoints = frame.detection.keypoints
    seen = first["posterior_predictive"].keypoints.values.reshape(-1, *keypoints.shape)
    seen = np.where(np.isnan(seen), keypoints, seen)  # what does not count stays
    draws = []
    log_weights = []
    for row, key in enumerate(keys[1:]):
        mean = _detecting(frame, (keypoints + seen[row]) / 2)
        tree = sample(model, mean, key=key, num_samples=num_samples, **asked).tree
        draws.append(_ends(tree))
        joints = tree["posterior"].joints.values.reshape(-1, *first["posterior"].joints.shape[2:])
        once, again, both = (
            _log_likelihood(model, one, joints)
            for one in (frame, _detecting(frame, seen[row]), mean)
        )
        with np.errstate(invalid="ignore"):  # -inf - -inf: outside, as far as either says
            log_weights.append(np.nan_to_num(once + again - both, nan=-np.inf, neginf=-np.inf))
    names = OF_POSE[: truth.shape[1]]
    return Brought.of(np.stack(draws), truth, log_weights=np.stack(log_weights), names=names)


def _detecting(frame: Estimate, keypoints: np.ndarray) -> Estimate:
    return dataclasses.replace(
        frame, detection=dataclasses.replace(frame.detection, keypoints=keypoints)
    )


def _ends(tree: Any) -> np.ndarray:
    """`(n, 27)`: where the bones end."""
    joints = tree["posterior"].joints.values
    return joints.reshape(-1, *joints.shape[2:])[:, list(MOVING)].reshape(-1, 3 * len(MOVING))


def _log_likelihood(model: PoseModel, frame: Estimate, joints: np.ndarray) -> np.ndarray:
    observation = frame.posterior(model, CANDIDATES).observations[0]
    return np.asarray(observation.log_density(joints))
