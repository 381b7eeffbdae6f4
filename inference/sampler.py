"""The one face of all samplers: `sample(model, frame, sampler=…, key=…, num_samples=…)` →
`Result`.

Every sampler stands in one table, by the prior of torso and camera that it draws under."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax

from poseterior.inference.baselines.catalogue import BASELINES, ROOTED, BaselineSampler
from poseterior.inference.draws import MAX_PROPOSALS, Draws, Progress, Sampler, key_of
from poseterior.inference.estimators import estimate_torso
from poseterior.inference.exact import warm_up
from poseterior.inference.exact.mixture import ON_DEVICE, PROPOSALS, ExactRejection
from poseterior.inference.importance.rejection import TorsoRejection
from poseterior.inference.importance.views.weighted import WeightedViews
from poseterior.inference.importance.weighted import NUM_ROOTS, WeightedSampler
from poseterior.inference.results import Result, result_of
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.instant import Instant
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, require_root_prior
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN, WORLD

SAMPLERS = tuple(sorted((*PROPOSALS, *BASELINES), key=lambda name: name == ON_DEVICE))
"""Every sampler under candidates by its name: exact rejection first, then the baselines. Keys of
draws go by the places, so that what came later stands at the end. Under an uncertain root there are
`ROOTED_SAMPLERS`."""
WEIGHTED, REJECTION = "weighted-roots", "rejection"
ROOTED_SAMPLERS = (WEIGHTED, REJECTION, *ROOTED)
"""Every sampler of torso, camera and pose together: weighted roots, rejection, then baselines."""
_OF_POINTS: dict[str, type[Sampler]] = {
    WEIGHTED: WeightedSampler,
    REJECTION: TorsoRejection,
    **dict.fromkeys(ROOTED, BaselineSampler),
}
_OF_CANDIDATES: dict[str, type[Sampler]] = {
    **dict.fromkeys(PROPOSALS, ExactRejection),
    **dict.fromkeys(BASELINES, BaselineSampler),
}
_OF_BODIES: dict[str, type[Sampler]] = {WEIGHTED: WeightedViews}
MAKERS = {UNCERTAIN: _OF_POINTS, CANDIDATES: _OF_CANDIDATES, WORLD: _OF_BODIES}
"""What makes a sampler, by the root's prior and the sampler's name; the first is the one that is
meant where none is named."""
MANY_ROOTS = 200
"""Roots of each detection where there are many of them: about a second of one core."""


def sampler_of(root: str, name: str | None = None, **settings: Any) -> Sampler:
    """A sampler by its name.

    Parameters
    ----------
    root
        The prior of torso and camera, one of `MAKERS`.
    name
        One of those that draw under it; the first where none is named.
    settings
        Of the sampler: those that it does not have are left out, and so are those that are None.

    Returns
    -------
    Sampler
        With these settings.

    Raises
    ------
    BadInput
        On an unknown root or sampler, a sampler that draws under the other one, and settings that
        cannot be.
    """
    if root != WORLD:
        require_root_prior(root)
    makers = MAKERS[root]
    name = next(iter(makers)) if name is None else name
    _require_known(root, name)
    known = {field.name for field in dataclasses.fields(makers[name])}
    given = {one: value for one, value in settings.items() if one in known and value is not None}
    return makers[name](name=name, **given)


@dataclass(frozen=True)
class DetectionSampler:
    """Draws of many detections, one after the other: a stream, an evaluation, a study of coverage.

    Attributes
    ----------
    model
        The prior of poses.
    root
        The prior of torso and camera, one of `ROOT_PRIORS`; or of a body in the world.
    sampler
        Who draws.
    num_samples
        Draws of each detection.

    Raises
    ------
    BadInput
        On a number below one, and on a baseline: its chains start in the draws of another sampler,
        which are better.
    """

    model: PoseModel
    root: str
    sampler: Sampler
    num_samples: int

    def __post_init__(self) -> None:
        require_some(self.num_samples, "samples")
        if isinstance(self.sampler, BaselineSampler):
            own = [name for name, kind in MAKERS[self.root].items() if kind is not BaselineSampler]
            raise BadInput(
                f"there is no exact sampler {self.sampler.name!r} of many detections; choose one of"
                f" {', '.join(own)}"
            )

    @property
    def settings(self) -> dict[str, Any]:
        """What draws depend on beside model, detection and key: plain JSON values."""
        return {"root": self.root, "num_samples": self.num_samples} | self.sampler.settings

    def __call__(self, frame: Estimate | Instant, key: jax.Array) -> Draws:
        """Draws of one detection, those of `sample` for this key, of several views those of
        `sample_instant`, in the same order. Raises `BadInput` as these."""
        posterior = frame.posterior(self.model, self.root)
        return self.sampler.draw(posterior, key, self.num_samples)


def _require_known(root: str, name: str) -> None:
    """Raises `BadInput` where no sampler of that name draws under such a root."""
    if name in MAKERS[root]:
        return
    if root == WORLD:
        raise BadInput(
            f"no sampler {name!r} draws from several views; choose {', '.join(MAKERS[root])}"
        )
    if root == UNCERTAIN:
        *most, last = MAKERS[root]
        raise BadInput(
            f"no sampler {name!r} draws torso and camera; choose {', '.join(most)} or {last}, or"
            f" the root {CANDIDATES!r} (on the command line --root fixed)"
        )
    if name in MAKERS[UNCERTAIN]:
        raise BadInput(
            f"the sampler {name} needs torso and camera uncertain; choose another, or the root"
            f" {UNCERTAIN!r}"
        )
    raise BadInput(f"there is no sampler {name!r}; choose one of {', '.join(MAKERS[root])}")


def sample(
    model: PoseModel,
    frame: Estimate | Detection,
    *,
    key: jax.Array | int,
    sampler: str | None = None,
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    chains: int = 1,
    root: str = UNCERTAIN,
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
        The detection, or it with its candidates as `estimate_torso` gives them.
    key
        Of all draws: the same key, the same draws. A number stands for `jax.random.key` of it.
    sampler
        One of `ROOTED_SAMPLERS`: "weighted-roots" if none is named; "rejection", a few dozen draws
        a second, which are independent; or a baseline, started in draws from weighted roots. Under
        candidates one of `SAMPLERS`: exact rejection if none is named, whose draws are independent
        ones of the posterior itself; or a baseline, which draws chains under one candidate, started
        in exact draws.
    num_samples
        How many draws, of all chains together; each chain gets as many as the others.
    max_proposals
        Most proposals, or evaluations of the density. Where they end first, or where no pose is
        possible, the result says so in `status` and `sentence`, and holds what there is.
    chains
        How many independent runs of exact rejection, each with a key and its share of the proposals
        of its own, so that diagnostics which compare chains have some.
    root
        One of `ROOT_PRIORS`: "uncertain" draws torso and camera with the pose, and takes no more of
        the estimate's candidates than the names of the sides; "candidates" is the paper's method, a
        mixture over them.
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
        On what is no model, detection or key, an unknown sampler or root, a sampler or several
        chains that need another root, a number of samples or chains that cannot be, where the
        torso's seen joints do not determine a camera, and where JAX has no 64-bit floats.
    """
    chosen = sampler_of(
        root,
        sampler,
        max_proposals=max_proposals,
        num_roots=num_roots,
        most_roots=most_roots,
        chains=require_chains(root, sampler, chains),
    )
    if not isinstance(model, PoseModel):
        raise BadInput(
            "the prior of poses comes first, such as PoseModel(), and not"
            f" {type(model).__name__}; the detection is second"
        )
    posterior = estimated(frame).posterior(model, root)
    draws = chosen.draw(posterior, key_of(key), num_samples, progress)
    warm_up.finish()
    return result_of(draws)


def estimated(frame: Estimate | Detection) -> Estimate:
    """An estimate, or that of a detection. Raises `BadInput` on anything else, and where too little
    was detected."""
    if isinstance(frame, Detection):
        return estimate_torso(frame)
    if not isinstance(frame, Estimate):
        raise BadInput(
            f"one person's detection is needed, not {type(frame).__name__}: of a file"
            " read_detections(path)[0], of points detections_of(array)[0]"
        )
    return frame


def require_chains(root: str, sampler: str | None, chains: int) -> int:
    """The number of chains. Raises `BadInput` where there cannot be several."""
    if chains == 1:
        return chains
    if root == UNCERTAIN:
        raise BadInput(
            "several chains are runs under fixed roots; leave their number out, or choose the"
            f" root {CANDIDATES!r}"
        )
    if sampler in BASELINES:
        raise BadInput(
            f"{sampler} decides itself how many chains it runs; leave the number of chains out"
        )
    return chains
