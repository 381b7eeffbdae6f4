"""Is a sampler right *here*, on the data at hand, and not on average over the prior? Posterior SBC
(Säilynoja, Schmitt, Bürkner & Vehtari 2025, arXiv 2502.03279).

    found = posterior_sbc(program, {"y": y})          # a NumPyro model, by NUTS
    found = posterior_sbc(PoseModel(), detection)     # a sampler of poses (`seen_again`)

Draws of the posterior take the place of the prior's: each is a truth, data are simulated of it once
more, and its rank among draws of the posterior of both data is uniform if the sampler is right
about all of them. A sampler that is wrong in the same way always, as under another prior, agrees
with itself, and is not found."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from poseterior.inference.baselines.catalogue import BaselineSampler
from poseterior.inference.draws import Sampler, key_of
from poseterior.inference.sampler import estimated, sampler_of
from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.judge import Judged, judge_brought
from poseterior.inference.studies.judging.seen_again import seen_again
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.root_priors import UNCERTAIN

NUM_REPLICATES = 100
SAMPLED = 500
"""Draws of a replicate."""
WARM_UP = 500
Program = Callable[[Mapping[str, Any] | None], None]
"""A NumPyro program that is given the data of a replicate, or none."""
ProgramSampler = Callable[[Program, jax.Array, Mapping[str, Any] | None], Mapping[str, Any]]
"""A program, a key and a replicate's data → independent draws by site, `(n, ...)`."""


def posterior_sbc(
    model: Any,
    data: Any,
    sampler: ProgramSampler | Sampler | str | None = None,
    *,
    root: str = UNCERTAIN,
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
        What was observed, by site; for a `PoseModel` a `Detection`, or an `Estimate` of one.
    sampler
        A function `(program, key, replicate)`: draws from `program(replicate)` by site, independent
        ones; NUTS, thinned, if none is given. For a `PoseModel` the name of a sampler, or a
        `Sampler`, whose draws are no chains; that of `sample` if none is given.
    root
        For a `PoseModel` the prior of torso and camera, as of `sample`.
    seed
        Of everything.
    num_replicates
        How many truths; at least 20.
    num_samples
        Draws for each, 500 by default.

    Returns
    -------
    Judged
        As of `judge_coverage`.

    Raises
    ------
    BadInput
        On fewer replicates, on data that the model does not know, on a sampler that draws chains
        of poses, or fewer independent draws than there are replicates.
    """
    require_some(num_replicates, "replicates")
    number = num_samples or SAMPLED
    if isinstance(model, PoseModel):
        posterior = estimated(data).posterior(model, root)
        given = _independent(sampler, root), key_of(seed), num_replicates, number
        return judge_brought(seen_again(posterior, *given), seed=seed)
    draw = _nuts(number) if sampler is None else sampler
    if not callable(draw):
        raise BadInput("the sampler of a NumPyro model is a function, not a name")
    brought = _of_program(model, data, draw, seed, num_replicates)
    return judge_brought(brought, seed=seed)


def _independent(sampler: Any, root: str) -> Sampler:
    """A sampler of poses, itself or by its name. Raises `BadInput` where it draws chains."""
    found = sampler if isinstance(sampler, Sampler) else sampler_of(root, sampler)
    if isinstance(found, BaselineSampler):
        raise BadInput(
            f"{found.name} draws chains, and ranks need independent draws; judge a sampler that"
            " draws none, or bring thinned draws to judge_coverage"
        )
    return found


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
    """NUTS, of whose draws every fifth is kept."""
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
