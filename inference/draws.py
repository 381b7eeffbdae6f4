"""What a sampler is, and what every sampler returns.

A `Sampler` draws from a posterior; its fields are its settings, and `sampler.sampler_of` finds one
by its name. `Draws` are the same whoever made them, so that nobody who uses them needs to know.

    draws = sampler_of("uncertain", "weighted").draw(posterior, jax.random.key(0), 1000)
    draws.joints
"""

import abc
import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.placing import place_shared
from poseterior.probmodel.chunks import CHUNK, in_chunks
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.failures import BadInput, require_some, shown
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import Candidates, RootPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS

COMPLETE, OUT_OF_BUDGET, IMPOSSIBLE = "complete", "out of budget", "impossible"
"""The status of draws."""
MAX_PROPOSALS = 1_000_000_000
"""Most proposals for one detection, where nothing else is said."""
Progress = Callable[[int, int], None]
"""Called with the draws (or roots) made, and wanted."""


class KnownRoots(NamedTuple):
    """What is known of the roots that draws come from: of candidates, or of all that were weighed.

    Attributes
    ----------
    points
        As the root's prior has them, leaves start with m.
    share : `(m,)`
        Of the posterior, that each of them stands for.
    evidence
        Log evidence of the roots in some rows together, with its standard error; NaN where there
        is none.
    columns
        What else is said of each, `(m,)` by name.
    """

    points: Any
    share: np.ndarray
    evidence: Callable[[np.ndarray], tuple[float, float]]
    columns: Mapping[str, np.ndarray] = {}


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of root, pose and faults, in random order; of several chains, one after the other.

    Attributes
    ----------
    posterior
        What they were drawn from.
    points
        The roots, as the posterior's `root_prior` has them, leaves start with n.
    poses
        The poses, leaves start with n.
    faults
        Which detections are faults, leaves start with n.
    known
        What is known of the roots.
    attributes
        What the draws cost, and what they are worth: plain values, the evidence among them.
    status, sentence
        `COMPLETE`, or why not, and what to do.
    chains
        How many chains, each as long as the others.
    root_index : `(n,)`
        Which of `known` each draw's root is, where that says something.
    """

    posterior: Posterior
    points: Any
    poses: Pose
    faults: Faults
    known: KnownRoots
    attributes: dict[str, Any]
    status: str = COMPLETE
    sentence: str = ""
    chains: int = 1
    root_index: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.poses.length)

    def take(self, rows: Any) -> "Draws":
        """Some of them, of one chain."""
        parts = self.points, self.poses, self.faults, self.root_index
        points, poses, faults, index = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], parts)
        return dataclasses.replace(
            self, points=points, poses=poses, faults=faults, root_index=index, chains=1
        )

    @property
    def prior(self) -> RootPrior:
        """The prior of the roots."""
        return self.posterior.root_prior

    @functools.cached_property
    def cameras(self) -> RootPoint:
        """`(n, ...)`: each draw's root as a point."""
        return self.prior.points(self.points)

    @property
    def scale(self) -> np.ndarray:
        """`(n,)`: pixels a body unit, of each draw's root."""
        return np.exp(self.cameras.log_scale)

    @property
    def bone_length(self) -> np.ndarray:
        """`(n, 5)` body units."""
        return self.poses.length

    @property
    def joints(self) -> np.ndarray:
        """`(n, 15, 3)`: camera axes, the pelvis at the origin, body units of each draw's root."""
        return self.placed[0]

    @property
    def keypoints(self) -> np.ndarray:
        """`(n, 15, 2)` pixels: where the draws' joints fall in the image."""
        return self.placed[1]

    @functools.cached_property
    def placed(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints and keypoints."""
        return place(self.posterior, self.points, self.poses)

    @property
    def log_evidence(self) -> float:
        """Log of the density of the detection; NaN where the sampler does not know it."""
        return float(self.attributes["log_evidence"])

    @property
    def log_evidence_se(self) -> float:
        """Its standard error."""
        return float(self.attributes["log_evidence_se"])

    @property
    def effective_roots(self) -> float:
        """Of how many equally good roots the draws are; NaN where roots are candidates."""
        return float(self.attributes.get("effective_roots", math.nan))


def place(
    posterior: Posterior, points: Any, poses: Pose, *, size: int = CHUNK
) -> tuple[np.ndarray, np.ndarray]:
    """Joints `(n, 15, 3)` in camera axes and keypoints `(n, 15, 2)`, or `(n, C, 15, 2)` of several
    views, of draws `(n, ...)`, `size` of them at a time."""
    if not len(poses.length):
        return np.empty((0, NUM_JOINTS, 3)), np.empty((0, *posterior.detection.keypoints.shape))
    if isinstance(posterior.root_prior, Candidates):
        return place_shared(posterior.model, posterior.root_prior.roots, points, poses)
    return over_draws(_place, (posterior.model, posterior.root_prior), points, poses, size=size)


def over_draws(function: Callable, given: tuple, *draws: Any, size: int = CHUNK) -> Any:
    """A function of what is `given` and of pytrees of draws whose leaves start with n, chunk by
    chunk: compiled once, and in bounded memory."""
    leaves, tree = jax.tree.flatten(draws)

    def chunk(*rows: np.ndarray) -> Any:
        return function(*given, *jax.tree.unflatten(tree, rows))

    return in_chunks(chunk, *map(np.asarray, leaves), size=size)


@kept
def _place(
    model: PoseModel, prior: RootPrior, points: Any, poses: Pose
) -> tuple[jax.Array, jax.Array]:
    def one(point: Any, pose: Pose) -> tuple[jax.Array, jax.Array]:
        root = prior.root(point)
        joints = model.joints(root.view, *pose)
        return joints, root.camera.image(joints)

    return jax.vmap(one)(points, poses)


@dataclass(frozen=True)
class Sampler(abc.ABC):
    """What draws from a posterior. Fields are settings; failures are a status, never fewer draws
    without a word.

    Attributes
    ----------
    name
        That it is asked for by.
    max_proposals
        Most proposals, or evaluations of the density.
    """

    name: str
    max_proposals: int = MAX_PROPOSALS

    @property
    def settings(self) -> dict[str, Any]:
        """What draws depend on beside posterior, key and number: plain JSON values."""
        given = dataclasses.asdict(self)
        found = {"sampler": given.pop("name")} | given
        return {name: value for name, value in found.items() if value is not None}

    def draw(
        self, posterior: Posterior, key: jax.Array, number: int, progress: Progress | None = None
    ) -> Draws:
        """Draws from a posterior.

        Parameters
        ----------
        posterior
            Whose root has the prior that this sampler draws under.
        key
            Of all random numbers: the same key, the same draws.
        number
            How many draws, of all chains together.
        progress
            Called now and then.

        Returns
        -------
        Draws
            As many as the status says.

        Raises
        ------
        BadInput
            On a number below one, and on a detection that the sampler cannot draw from.
        """
        (draws,) = self.blocks(posterior, key, number, block=number, progress=progress)
        return draws

    def blocks(
        self,
        posterior: Posterior,
        key: jax.Array,
        number: int,
        *,
        block: int,
        progress: Progress | None = None,
    ) -> Iterator[Draws]:
        """As `draw`, `block` draws at a time where the sampler can: each is a sample of the
        posterior, and forgotten once it has been given; what its attributes say is of all until
        then. There is one block at least, and the last one is the one that is not complete."""
        require_some(number, "samples")
        started = time.perf_counter()
        for draws in self._blocks(posterior, key, number, block, progress):
            about = {
                "sampler": self.name,
                "seed": key_words(key),
                "num_samples": number,
                "wall_time_s": time.perf_counter() - started,
                "status": draws.status,
            }
            yield dataclasses.replace(draws, attributes=about | draws.attributes)

    @abc.abstractmethod
    def _blocks(
        self,
        posterior: Posterior,
        key: jax.Array,
        number: int,
        block: int,
        progress: Progress | None,
    ) -> Iterator[Draws]:
        """As `blocks`, of a number that can be."""


def key_of(key: jax.Array | int) -> jax.Array:
    """A key, or that of a number: what `jax.random.key` makes of it. Raises `BadInput` on what is
    neither, and where JAX has no 64-bit floats: limits are decided to the last bits, and draws
    would be others."""
    if not jax.config.jax_enable_x64:
        raise BadInput(
            "draws need 64-bit floats, which are switched off; take JAX_ENABLE_X64 out of the"
            " environment, or call jax.config.update('jax_enable_x64', True) first"
        )
    if not isinstance(key, int | np.integer | np.ndarray | jax.Array):
        raise BadInput(f"a key is a whole number, or jax.random.key of one, not {shown(key)}")
    return jax.random.key(key) if isinstance(key, int | np.integer) else key


def key_words(key: jax.Array) -> str:
    """A key as the attribute `seed` has it."""
    return " ".join(map(str, words_of(key)))


def joined(runs: list[Draws]) -> Draws:
    """Independent runs as chains, in their order; where one has fewer draws than the others, all
    are as short. Evidences are averaged, costs added; the status is that of the first run that is
    not complete."""
    draws = min(map(len, runs))
    points, poses, faults = (
        jax.tree.map(lambda *rows: np.concatenate([row[:draws] for row in rows]), *parts)
        for parts in zip(*((one.points, one.poses, one.faults) for one in runs), strict=True)
    )
    found = [one.attributes for one in runs]
    evidence = mean_evidence([(one.log_evidence, one.log_evidence_se) for one in runs])
    proposals = sum(one["num_proposals"] for one in found)
    about = found[0] | {
        "num_proposals": proposals,
        "acceptance_rate": len(runs) * draws / max(proposals, 1),
        "log_evidence": evidence[0],
        "log_evidence_se": evidence[1],
    }
    known = KnownRoots(
        runs[0].known.points,
        np.mean([one.known.share for one in runs], axis=0),
        lambda rows: mean_evidence([one.known.evidence(rows) for one in runs]),
    )
    first = next((one for one in runs if one.status != COMPLETE), runs[0])
    return dataclasses.replace(
        first,
        points=points,
        poses=poses,
        faults=faults,
        known=known,
        attributes={name: about[name] for name in about if name not in OF_ONE_RUN},
        chains=len(runs),
    )


OF_ONE_RUN = ("sampler", "seed", "num_samples", "wall_time_s", "status")


def mean_evidence(found: list[tuple[float, float]]) -> tuple[float, float]:
    """Log of the mean over runs of evidences, each a log and its standard error, and the standard
    error of that."""
    logs, errors = np.array(found).T
    total = float(np.logaddexp.reduce(logs))
    if not math.isfinite(total):
        return total, math.inf
    share = np.exp(logs - total)
    error = math.sqrt(float(np.sum((share * np.where(share > 0, errors, 0.0)) ** 2)))
    return total - math.log(len(found)), error
