"""The two routes to draws with an uncertain root, by the names of samplers: from weighted roots,
which is fast, and by rejection, which judges it."""

from typing import Any, NamedTuple

import jax

from poseterior.inference.exact.mixture import MAX_PROPOSALS, Progress
from poseterior.inference.importance import rejection, weighted
from poseterior.inference.importance.weighted import NUM_ROOTS, WeightedRoots
from poseterior.probmodel.uncertain import UncertainPosterior

WEIGHTED, REJECTION = "weighted-roots", "rejection"
ROUTES = (WEIGHTED, REJECTION)
"""By the sampler's name; the first is the one that is meant where none is named."""


class Route(NamedTuple):
    """What a route brought: roots with draws of their limbs, the status of draws from them, the
    sentence that goes with it, and attributes of its own."""

    roots: WeightedRoots
    status: str
    sentence: str
    attributes: dict[str, Any]


def draw_uncertain(
    posterior: UncertainPosterior,
    sampler: str,
    *,
    key: jax.Array,
    num_samples: int,
    num_roots: int = NUM_ROOTS,
    most_roots: int | None = None,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> Route:
    """Roots by one of `ROUTES`, enough for `num_samples` draws; the rest as `weigh_enough_roots`
    and `reject_roots` take it. Raises `BadInput` as they do."""
    if sampler == WEIGHTED:
        weighed = weighted.weigh_enough_roots(
            posterior,
            key=key,
            num_roots=num_roots,
            most_roots=most_roots,
            max_proposals=max_proposals,
            progress=progress,
        )
        return Route(weighed, *weighted.verdict(weighed), {})
    rejected = rejection.reject_roots(
        posterior,
        key=key,
        num_samples=num_samples,
        num_roots=num_roots,
        max_proposals=max_proposals,
        progress=progress,
    )
    about = {"num_roots": rejected.tried, "cut_off": rejected.cut_off}
    return Route(rejected, *rejection.verdict(rejected), about)
