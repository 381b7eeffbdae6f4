"""What is known of the targets: evidence, masses of the modes, moments, each with its error, and
ten thousand exact draws. All of it is data in the package, and needs neither JAX nor a compiler.

    known = reference("arm")             # evidence, modes, moments
    points = shipped_points("arm")       # (10000, 6), exact and independent

How they came about, and where there are more of them: `inference.benchmark.draws`."""

import functools
import hashlib
import io
import json
import math
from dataclasses import dataclass, fields
from importlib import resources
from typing import Any

import numpy as np

from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.studies.comparison.sample import Sample, sample_of
from poseterior.inference.studies.flips import codes
from poseterior.probmodel.failures import BadInput

SHIPPED = 10_000
"""Draws of a target in the package, in single precision."""
DATA_FOLDER = "poseterior.inference.benchmark.data"


@dataclass(frozen=True)
class Reference:
    """What exact draws say of a target.

    Attributes
    ----------
    log_evidence, log_evidence_se : the log of the prior's mean of the likelihood over its peak.
    modes : masses of the depth flips, by one letter a bone of `flips.FLIPPING`: t(owards) the
        camera or a(way) from it, a dot where no seen joint depends on the bone; those below
        `draws.MODES` together are what is missing to one.
    mean, mean_se, sd, sd_se : `(c,)`, moments of the coordinates that `sample_at` names, body
        units; what no seen joint depends on has no spread.
    number : how many draws these are from.
    blocks : checksums of the blocks that these are.
    shipped : checksum of the file of draws in the package.
    cut_off : the share of the posterior that exact draws lack, estimated: where the root is
        uncertain, the bound of their rejection is that of a pilot run.
    """

    log_evidence: float
    log_evidence_se: float
    modes: dict[str, float]
    mean: np.ndarray
    mean_se: np.ndarray
    sd: np.ndarray
    sd_se: np.ndarray
    number: int
    blocks: tuple[str, ...]
    shipped: str
    cut_off: float = 0.0


@dataclass(frozen=True)
class Moments:
    """Means and standard deviations of independent draws, with their standard errors."""

    mean: np.ndarray
    mean_se: np.ndarray
    sd: np.ndarray
    sd_se: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "Moments":
        """Those of draws `(n, ...)`."""
        sd = values.std(axis=0)
        fourth = np.mean((values - values.mean(axis=0)) ** 4, axis=0)
        # The delta method: var(s²) = (μ₄ - σ⁴)/n, and var(s) = var(s²)/4σ².
        varies = np.where(sd > 0, sd, 1.0)
        sd_se = np.sqrt(np.maximum(fourth - sd**4, 0) / len(values)) / (2 * varies)
        return cls(values.mean(axis=0), sd / math.sqrt(len(values)), sd, sd_se)


def reference(name: str) -> Reference:
    """What is known of the target of that name."""
    record = _records()[name]
    moments = {field.name: np.array(record[field.name]) for field in fields(Moments)}
    return Reference(**record | moments | {"blocks": tuple(record["blocks"])})


@functools.cache
def _records() -> dict[str, dict[str, Any]]:
    return json.loads((resources.files(DATA_FOLDER) / "reference.json").read_text("utf-8"))


def shipped_points(name: str) -> np.ndarray:
    """`(10000, d)`: exact draws of the target of that name as points of R^d. They are those of the
    last block, which nobody comes to who takes some of the first. Raises `BadInput` where the file
    is damaged."""
    content = (resources.files(DATA_FOLDER) / f"{name}.npy").read_bytes()
    if hashlib.sha256(content).hexdigest() != reference(name).shipped:
        raise BadInput(f"the exact draws of {name} are damaged; install poseterior anew")
    return np.load(io.BytesIO(content), allow_pickle=False).astype(float)


def mode_counts(known: Reference, exact: Sample) -> dict[int, float]:
    """How many of the draws that a target is known from fell into each mode, by `flips.codes`: -1
    are those of no mode of its own. A bone that no seen joint depends on points where it does in
    `exact`."""
    still = exact.away[0, 0]
    counts = {-1: known.number * max(0.0, 1 - sum(known.modes.values()))}
    for letters, mass in known.modes.items():
        own = np.array(list(letters))
        counts[int(codes(np.where(own == ".", still, own == "a")))] = known.number * mass
    return counts


def sample_at(target: FrozenTarget, points: np.ndarray) -> Sample:
    """What the judge sees of points `(chain, draw, d)` of R^d, with their roots where these are
    uncertain. What no seen joint depends on stands still in it: no sampler walked there."""
    chains, draws, dim = points.shape
    flat = points.reshape(-1, dim)
    joints, lengths = target.decided(flat)
    joints = joints.reshape(chains, draws, *joints.shape[1:])
    sample = sample_of(joints, lengths.reshape(chains, draws, -1))
    if not target.root.coordinates:
        return sample
    _, scale, place = target.root_at(flat)
    return sample.with_roots(joints, scale.reshape(chains, draws), place.reshape(chains, draws, 2))
