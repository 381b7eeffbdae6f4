"""What is known of the targets: a million exact draws, made on demand in blocks and kept, and what
the first of them say: evidence, masses of the modes, moments, each with its error.

    known = reference("arm")                     # evidence, modes, moments: from data, at once
    points = exact_points(load("arm"), 100_000)  # (100000, 6), the first of a million

A block has the same bits wherever the same compiled loops run on a processor of the same kind;
elsewhere it has the same law, and `same_bits` says which."""

import contextlib
import hashlib
import json
import math
import os
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from inference.baselines.target import Target
from inference.benchmark.programs import estimate, frozen_model
from inference.benchmark.target import FrozenTarget
from inference.exact.mixture import root_samplers
from inference.exact.rates import Budget
from inference.studies.comparison.sample import Sample, sample_of
from inference.studies.flips import FLIPPING
from probmodel.arrays import read_tables
from probmodel.failures import BadInput, OutOfBudget
from probmodel.files import replacing

BLOCK = 50_000
"""Draws of a block; a block is drawn as a whole, by a key of its own."""
BLOCKS = 20
"""Blocks of a target: a million draws."""
MEASURED = 4
"""Blocks from which a target is measured, and whose checksums are kept."""
MAX_PROPOSALS = 100_000_000_000
"""Proposals for a block; soft walls turn down most."""
MODES = 1e-4
"""Modes of less mass are not listed; their masses are put together."""


class DrawBlock(NamedTuple):
    """Some exact draws: `points` `(BLOCK, d)` of R^d, and the log evidence that came along with its
    standard error."""

    points: np.ndarray
    log_evidence: float
    log_evidence_se: float

    @property
    def sha256(self) -> str:
        """The checksum of the points."""
        return hashlib.sha256(np.ascontiguousarray(self.points, "<f8").tobytes()).hexdigest()


@dataclass(frozen=True)
class Reference:
    """What exact draws say of a target.

    Attributes
    ----------
    log_evidence, log_evidence_se : the log of the prior's mean of the likelihood over its peak.
    modes : masses of the depth flips, by one letter a bone of `flips.FLIPPING`: t(owards) the
        camera or a(way) from it, a dot where no seen joint depends on the bone; those below `MODES`
        together are what is missing to one.
    mean, mean_se, sd, sd_se : `(32,)`, moments of the coordinates `sample.NAMES`, body units.
    number : how many draws these are from.
    blocks : checksums of the blocks that these are.
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


def reference(name: str) -> Reference:
    """What is known of the target of that name."""
    text = (resources.files("inference.benchmark.data") / "reference.json").read_text("utf-8")
    record = json.loads(text)[name]
    moments = {key: np.array(record.pop(key)) for key in ("mean", "mean_se", "sd", "sd_se")}
    return Reference(**record | moments | {"blocks": tuple(record["blocks"])})


def draw_block(target: FrozenTarget, index: int) -> DrawBlock:
    """Draws a block, always the same. Raises `BadInput` unless JAX has 64-bit floats, and
    `OutOfBudget` where the engine cannot make it."""
    if not jax.config.jax_enable_x64:
        raise BadInput(
            "exact draws need 64-bit floats; call jax.config.update('jax_enable_x64', True) first"
        )
    posterior = estimate(target).posterior(frozen_model())
    words = np.frombuffer(hashlib.sha256(target.name.encode()).digest()[:4], "<u4")[0]
    key = jax.random.fold_in(jax.random.key(int(words)), index)
    (sampler,) = root_samplers(posterior, key, "rejection")
    if not sampler.more(BLOCK, Budget(MAX_PROPOSALS)):
        raise OutOfBudget(f"exact draws of {target.name} could not be made; the engine has changed")
    points = Target.of(posterior).points_of(sampler.poses(BLOCK))
    return DrawBlock(points, sampler.log_evidence, sampler.log_evidence_se)


def cache_folder() -> Path:
    """Where blocks are kept: the user's cache folder."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "poseterior" / "benchmark"


def exact_block(target: FrozenTarget, index: int, folder: Path | None = None) -> DrawBlock:
    """A block from the cache, or drawn and kept there; a kept one that is damaged is drawn anew."""
    path = (folder or cache_folder()) / f"{target.name}-{index:02}.npz"
    if path.exists():
        kept = _kept(path)
        if kept is not None:
            return kept
    block = draw_block(target, index)
    with contextlib.suppress(OSError, BadInput):  # without a cache it is slower, and no worse
        path.parent.mkdir(parents=True, exist_ok=True)
        _keep(path, block)
    return block


def _keep(path: Path, block: DrawBlock) -> None:
    evidence = np.array([block.log_evidence, block.log_evidence_se])
    sha256 = np.array(block.sha256)
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, points=block.points, evidence=evidence, sha256=sha256)


def _kept(path: Path) -> DrawBlock | None:
    """The block in a file; None where it is not what was written."""
    try:
        found = read_tables(path, "block of exact draws", "delete it")
        block = DrawBlock(found["points"], *found["evidence"].tolist())
    except (BadInput, KeyError, TypeError):
        return None
    return block if block.sha256 == str(found["sha256"]) else None


def same_bits(target: FrozenTarget, folder: Path | None = None) -> bool:
    """Whether this machine's draws have the bits that the reference was measured with, by the first
    block. Where they have not, their law is the same."""
    return exact_block(target, 0, folder).sha256 == reference(target.name).blocks[0]


def exact_points(target: FrozenTarget, number: int, folder: Path | None = None) -> np.ndarray:
    """The first `number` exact draws as points `(number, d)` of R^d, from the cache where they are
    there. Raises `BadInput` where there are not so many."""
    most = BLOCK * BLOCKS
    if not 1 <= number <= most:
        raise BadInput(f"a target has 1 to {most:,} exact draws, not {number:,}; ask for fewer")
    blocks = [exact_block(target, index, folder) for index in range(-(-number // BLOCK))]
    return np.concatenate([block.points for block in blocks])[:number]


def sample_at(target: FrozenTarget, points: np.ndarray, seed: int) -> Sample:
    """What the judge sees of points `(chain, draw, d)` of R^d; `seed` is for what no seen joint
    depends on."""
    chains, draws, dim = points.shape
    rng = np.random.default_rng([0xBE7C, seed])
    joints, lengths = target.poses(points.reshape(-1, dim), rng)
    return sample_of(
        joints.reshape(chains, draws, *joints.shape[1:]), lengths.reshape(chains, draws, -1)
    )


def measured(target: FrozenTarget) -> dict[str, Any]:
    """The record of `reference.json`, from the first `MEASURED` blocks."""
    blocks = [exact_block(target, index) for index in range(MEASURED)]
    logs = np.array([block.log_evidence for block in blocks])
    errors = np.array([block.log_evidence_se for block in blocks])
    parts = [sample_at(target, block.points[None], index) for index, block in enumerate(blocks)]
    values = np.concatenate([part.flat for part in parts])
    away = np.concatenate([part.away[0] for part in parts])
    sd = values.std(axis=0)
    fourth = np.mean((values - values.mean(axis=0)) ** 4, axis=0)
    # The delta method: var(s²) = (μ₄ - σ⁴)/n, and var(s) = var(s²)/4σ².
    varies = np.where(sd > 0, sd, 1.0)
    sd_se = np.sqrt(np.maximum(fourth - sd**4, 0) / len(values)) / (2 * varies)
    return {
        "log_evidence": float(np.logaddexp.reduce(logs) - math.log(MEASURED)),
        "log_evidence_se": float(np.sqrt(np.sum(errors**2)) / MEASURED),
        "modes": mode_masses(target, away),
        "mean": values.mean(axis=0).tolist(),
        "mean_se": (sd / math.sqrt(len(values))).tolist(),
        "sd": sd.tolist(),
        "sd_se": sd_se.tolist(),
        "number": len(values),
        "blocks": [block.sha256 for block in blocks],
    }


def mode_masses(target: FrozenTarget, away: np.ndarray) -> dict[str, float]:
    """Shares of the depth flips `(n, 8)` by their letters, commonest first, those of at least
    `MODES`."""
    decided = [bone for limb in target.limbs for bone in limb.bones]
    flips = [number for number, bone in enumerate(FLIPPING) if bone in decided]
    found, counts = np.unique(away[:, flips], axis=0, return_counts=True)
    shares = {}
    for row in np.argsort(-counts, kind="stable"):
        letters = np.full(len(FLIPPING), ".")
        letters[flips] = np.where(found[row], "a", "t")
        shares["".join(letters)] = float(counts[row] / len(away))
    return {letters: share for letters, share in shares.items() if share >= MODES}
