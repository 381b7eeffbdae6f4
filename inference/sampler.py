"""The one face of all samplers: `sample(model, frame, sampler=…, key=…, num_samples=…)` →
`Result`."""

import functools
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from poseterior.inference.baselines.catalogue import (
    BASELINES,
    ROOTED,
    sample_baseline,
    sample_rooted,
)
from poseterior.inference.drawers import sampler_under
from poseterior.inference.exact import warm_up
from poseterior.inference.exact.mixture import (
    MAX_PROPOSALS,
    ON_DEVICE,
    PROPOSALS,
    Progress,
    mixture_blocks,
)
from poseterior.inference.importance.routes import ROUTES, draw_uncertain
from poseterior.inference.importance.tree import uncertain_tree
from poseterior.inference.importance.weighted import NUM_ROOTS
from poseterior.inference.joined import joined
from poseterior.inference.results import FIXED, UNCERTAIN, Result, build_tree, key_words
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, Posterior
from poseterior.probmodel.uncertain import UncertainPosterior

SAMPLERS = tuple(sorted((*PROPOSALS, *BASELINES), key=lambda name: name == ON_DEVICE))
"""Every sampler under a fixed root by its name: exact rejection first, then the baselines. Keys of
draws go by the places, so that what came later stands at the end. Under an uncertain root there are
`ROOTED_SAMPLERS`."""
ROOTED_SAMPLERS = (*ROUTES, *ROOTED)
"""Every sampler of torso, camera and pose together: weighted roots, rejection, then baselines."""


def sample(
    model: PoseModel,
    frame: Estimate,
    *,
    key: jax.Array,
    sampler: str | None = None,
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    chains: int = 1,
    root: str = FIXED,
    num_roots: int = NUM_ROOTS,
    most_roots: int | None = None,
    progress: Progress | None = None,
) -> Result:
    """Draws from the posterior of a detection.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates, as `estimate_torso` gives it.
    key
        Of all draws: the same key, the same draws.
    sampler
        One of `SAMPLERS`, "rejection" if none is named: exact rejection draws independently from
        the posterior itself; a baseline draws chains under one candidate, started in exact draws.
        Under an uncertain root one of `ROOTED_SAMPLERS`: "weighted-roots" if none is named;
        "rejection", a few dozen draws a second, which are independent; or a baseline, started in
        draws from weighted roots.
    num_samples
        How many draws, of all chains together; each chain gets as many as the others.
    max_proposals
        Most proposals, or evaluations of the density. Where they end first, or where no pose is
        possible, the result says so in `status` and `sentence`, and holds what there is.
    chains
        How many independent runs of exact rejection, each with a key and its share of the proposals
        of its own, so that diagnostics which compare chains have some.
    root
        One of `drawers.ROOTS`. "fixed" is the paper's method, a mixture over the candidates;
        "uncertain" draws torso and camera too, and takes no more of the candidates than the names
        of the sides.
    num_roots
        From how many roots draws are made where the root is uncertain; by rejection: those of the
        pilot run that finds its bound; by a baseline: those that it is started in.
    most_roots
        From how many roots at most, where `num_roots` weighted roots are worth fewer than 20: then
        as many as would do are drawn in their place. By default no more.
    progress
        Called now and then with the draws (or roots) made and wanted.

    Returns
    -------
    Result
        The draws, and whether they are as many as were wanted.

    Raises
    ------
    BadInput
        On an unknown sampler or root, a sampler or several chains that need another root, a number
        of samples or chains that cannot be, and where the torso's seen joints do not determine a
        camera.
    """
    sampler = sampler_under(root, sampler, ROOTED_SAMPLERS)
    if root == UNCERTAIN:
        if num_samples < 1:
            raise BadInput(f"the number of samples must be at least 1, not {num_samples}")
        if chains != 1:
            raise BadInput(
                f"several chains are runs under fixed roots; leave their number out, or choose the"
                f" root {FIXED!r}"
            )
        posterior = frame.uncertain(model)
        given: dict[str, Any] = {
            "key": key,
            "num_samples": num_samples,
            "num_roots": num_roots,
            "max_proposals": max_proposals,
            "progress": progress,
        }
        if sampler in ROOTED:
            return sample_rooted(posterior, sampler=sampler, **given)
        given |= {"most_roots": most_roots, "block": num_samples}
        (result,) = uncertain_blocks(posterior, sampler, **given)
        return result
    if sampler not in PROPOSALS and sampler not in BASELINES:
        raise BadInput(f"there is no sampler {sampler!r}; choose one of {', '.join(SAMPLERS)}")
    if chains != 1:
        return _several(
            functools.partial(sample, model, frame, sampler=sampler),
            key=key,
            sampler=sampler,
            chains=chains,
            num_samples=num_samples,
            max_proposals=max_proposals,
            progress=progress,
        )
    mixture = frame.posterior(model)
    if sampler in BASELINES and num_samples > 0:
        return sample_baseline(
            mixture,
            functools.partial(sample, model, frame, key=jax.random.fold_in(key, 0)),
            key=key,
            sampler=sampler,
            num_samples=num_samples,
            max_evaluations=max_proposals,
            progress=progress,
        )
    (result,) = exact_blocks(
        mixture,
        sampler,
        key=key,
        num_samples=num_samples,
        max_proposals=max_proposals,
        progress=progress,
        block=num_samples,
    )
    return result


def exact_blocks(
    posterior: Posterior,
    sampler: str,
    *,
    key: jax.Array,
    num_samples: int,
    max_proposals: int,
    progress: Progress | None,
    block: int,
) -> Iterator[Result]:
    """The results of exact rejection under a fixed root, block by block, as `mixture_blocks` has
    them."""
    started = time.perf_counter()
    mixtures = mixture_blocks(
        posterior,
        key=key,
        sampler=sampler,
        num_samples=num_samples,
        max_proposals=max_proposals,
        progress=progress,
        block=block,
    )
    for number, mixture in enumerate(mixtures):
        attributes = {
            **mixture.attributes,
            "wall_time_s": time.perf_counter() - started,
            "status": mixture.status,
        }
        warm_up.finish()
        tree = build_tree(posterior, mixture.parts, attributes, mixture.rng, number)
        yield Result(tree, mixture.status, mixture.sentence)


def _several(
    run: Callable[..., Result],
    *,
    key: jax.Array,
    sampler: str,
    chains: int,
    num_samples: int,
    max_proposals: int,
    progress: Progress | None,
) -> Result:
    """Independent runs as the chains of one result. Raises `BadInput` where there cannot be so
    many."""
    if sampler in BASELINES:
        raise BadInput(
            f"{sampler} decides itself how many chains it runs; leave the number of chains out"
        )
    if not 1 <= chains <= num_samples:
        raise BadInput(
            f"{num_samples:,} samples cannot be in {chains} chains; choose from 1 to one a sample"
        )
    each = -(-num_samples // chains)
    results = []
    for chain, own in enumerate(jax.random.split(key, chains)):
        done = chain * each

        def report(made: int, _wanted: int, done: int = done) -> None:
            if progress:
                progress(done + made, chains * each)

        results.append(
            run(
                key=own,
                num_samples=each,
                max_proposals=max(1, max_proposals // chains),
                progress=report,
            )
        )
    whole = joined(results)
    whole.tree.attrs["seed"] = key_words(key)
    return whole


def uncertain_blocks(
    posterior: UncertainPosterior,
    sampler: str,
    *,
    key: jax.Array,
    num_samples: int,
    num_roots: int,
    most_roots: int | None,
    max_proposals: int,
    progress: Progress | None,
    block: int,
) -> Iterator[Result]:
    """The results of a route to an uncertain root, block by block: its roots are made once, and
    each block is a sample of them. There is one block at least, and no other where that one has no
    draw."""
    started = time.perf_counter()
    roots, status, sentence, about = draw_uncertain(
        posterior,
        sampler,
        key=jax.random.fold_in(key, 0),
        num_samples=num_samples,
        num_roots=num_roots,
        most_roots=most_roots,
        max_proposals=max_proposals,
        progress=progress,
    )
    rng = np.random.default_rng(np.asarray(jax.random.key_data(jax.random.fold_in(key, 1))))
    attributes = {"sampler": sampler, "seed": key_words(key), "num_samples": num_samples} | about
    done = 0
    for number, start in enumerate(range(0, num_samples, block)):
        size = min(block, num_samples - start)
        tree = uncertain_tree(roots, rng, size, attributes, number)
        done += tree["posterior"].sizes["draw"]
        tree.attrs.update(
            acceptance_rate=done / max(roots.proposals, 1),
            wall_time_s=time.perf_counter() - started,
            status=status,
        )
        yield Result(tree, status, sentence)
        if not done:
            return
