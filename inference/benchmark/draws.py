"""A million exact draws of a target, made on demand in blocks and kept, and what the first of them
say: what stands in the package as `references`.

    points = exact_points(load("arm"), 100_000)  # (100000, 6), the first of a million

A block has the same bits wherever the same compiled loops run on a processor of the same kind;
elsewhere it has the same law, and `same_bits` says which. Where the root is uncertain, exact draws
are dear, and there are fewer."""

import contextlib
import hashlib
import io
import math
import os
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark.programs import estimate, frozen_model, model_of
from poseterior.inference.benchmark.references import SHIPPED, Moments, reference, sample_at
from poseterior.inference.benchmark.root import BoxedRoot, GivenRoot
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.draws import COMPLETE, Progress
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.mixture import root_samplers
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance.rejection import reject_roots
from poseterior.inference.importance.rejection import verdict as complaint
from poseterior.inference.studies.flips import FLIPPING
from poseterior.probmodel.arrays import read_tables
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.probmodel.files import replacing
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.transport import to_fractions


class Blocks(NamedTuple):
    """How many draws of a target there are: the `size` of a block, which is drawn as a whole, by a
    key of its own; how many `there_are`; and from how many of them, the first, the target is
    `measured`, whose checksums are kept."""

    size: int
    there_are: int
    measured: int


BLOCKS = {
    ("disc", GivenRoot): Blocks(50_000, 20, 4),
    ("gaussian", GivenRoot): Blocks(50_000, 20, 3),
    ("disc", BoxedRoot): Blocks(10_000, 10, 1),
}
"""By law and root: exact draws under soft walls are dearer, and those of a root come at some a
second."""
BLOCK_PROPOSALS = 100_000_000_000
"""Proposals for a block; soft walls turn down most."""
PILOT_ROOTS = 2_000
"""Roots of the pilot run that finds the bound of the rejection."""
MODES = 1e-4
"""Modes of less mass are not listed; their masses are put together."""


class DrawBlock(NamedTuple):
    """Some exact draws: `points` `(n, d)` of R^d, and the log evidence that came along with its
    standard error. Where the root is uncertain, a share `cut_off` of the posterior lies above the
    bound of the rejection, and the draws lack it."""

    points: np.ndarray
    log_evidence: float
    log_evidence_se: float
    cut_off: float = 0.0

    @property
    def sha256(self) -> str:
        """The checksum of the points."""
        return hashlib.sha256(np.ascontiguousarray(self.points, "<f8").tobytes()).hexdigest()


def blocks_of(target: FrozenTarget) -> Blocks:
    """How many draws of the target there are. Raises `BadInput` where there are none of its
    kind."""
    kind = target.law, type(target.root)
    if kind not in BLOCKS:
        raise BadInput(
            f"there are no exact draws of {target.name} under a {target.law} law with an uncertain"
            " root; take the disc, or `inference.importance.rejection`"
        )
    return BLOCKS[kind]


def draw_block(target: FrozenTarget, index: int, progress: Progress | None = None) -> DrawBlock:
    """Draws a block, always the same; `progress` is called with the draws made and wanted, where
    they come one by one. Raises `BadInput` unless JAX has 64-bit floats, and `OutOfBudget` where
    the engine cannot make it."""
    if not jax.config.jax_enable_x64:
        raise BadInput(
            "exact draws need 64-bit floats; call jax.config.update('jax_enable_x64', True) first"
        )
    words = np.frombuffer(hashlib.sha256(target.name.encode()).digest()[:4], "<u4")[0]
    key = jax.random.fold_in(jax.random.key(int(words)), index)
    if isinstance(target.root, GivenRoot):
        return _under_one_root(target, key)
    return draw_roots(target, target.root, key, blocks_of(target).size, progress)


def _under_one_root(target: FrozenTarget, key: jax.Array) -> DrawBlock:
    found = estimate(target).posterior(frozen_model(), CANDIDATES)
    size = blocks_of(target).size
    (sampler,) = root_samplers(found, key, "rejection")
    if not sampler.more(size, Budget(BLOCK_PROPOSALS)):
        raise _no_draws(target)
    points = Target.of(found).points_of(sampler.poses(size))
    return DrawBlock(points, sampler.log_evidence, sampler.log_evidence_se)


def draw_roots(
    target: FrozenTarget,
    root: BoxedRoot,
    key: jax.Array,
    size: int,
    progress: Progress | None = None,
) -> DrawBlock:
    """So many draws of a target with an uncertain root: under flat priors of scale and place, those
    in its box. Raises `OutOfBudget` where the engine cannot make them."""
    found = estimate(target).posterior(model_of(target))
    roots = reject_roots(
        found,
        key=key,
        num_samples=size,
        num_roots=PILOT_ROOTS,
        max_proposals=BLOCK_PROPOSALS,
        progress=progress,
    )
    if complaint(roots)[0] != COMPLETE:
        raise _no_draws(target)
    # Rejection splits the key in two, which are the same as `fold_in` makes of 0 and 1.
    rng = np.random.default_rng(words_of(jax.random.fold_in(key, 2)))
    drawn, poses, _ = roots.draw(rng, size)
    of_root = root.box_of(drawn.torso, drawn.rotation, drawn.log_scale, drawn.translation, rng)
    of_pose = np.asarray(to_fractions(found.model, poses))[:, target.active]
    box = np.concatenate([of_pose, of_root], axis=1)
    inside = ((of_root >= 0) & (of_root <= 1)).all(axis=1)
    share = float(inside.mean())
    if not share:
        raise _no_draws(target)
    # From a density of the detection to the prior's mean of the likelihood over its peak.
    peak = found.log_peak - 2 * len(target.seen) * math.log(root.scale[0])
    log_evidence = roots.log_evidence - peak - root.log_volume + math.log(share)
    error = math.hypot(roots.log_evidence_se, math.sqrt((1 - share) / (share * size)))
    return DrawBlock(target.points_of_box(box[inside]), log_evidence, error, roots.cut_off)


def _no_draws(target: FrozenTarget) -> OutOfBudget:
    return OutOfBudget(f"exact draws of {target.name} could not be made; the engine has changed")


def cache_folder() -> Path:
    """Where blocks are kept: the user's cache folder."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "poseterior" / "benchmark"


def exact_block(
    target: FrozenTarget,
    index: int,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> DrawBlock:
    """A block from the cache, or drawn and kept there; a kept one that is damaged is drawn anew.
    `progress` as in `draw_block`."""
    path = (folder or cache_folder()) / f"{target.name}-{index:02}.npz"
    if path.exists():
        kept = _kept(path)
        if kept is not None:
            return kept
    block = draw_block(target, index, progress)
    with contextlib.suppress(OSError, BadInput):  # without a cache it is slower, and no worse
        path.parent.mkdir(parents=True, exist_ok=True)
        _keep(path, block)
    return block


def _keep(path: Path, block: DrawBlock) -> None:
    evidence = np.array([block.log_evidence, block.log_evidence_se, block.cut_off])
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


def exact_points(
    target: FrozenTarget,
    number: int,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """The first `number` exact draws as points `(number, d)` of R^d, from the cache where they are
    there; `progress` is called with the draws made and those of all the blocks that are needed.
    Raises `BadInput` where there are not so many."""
    size, there_are, _ = blocks_of(target)
    if not 1 <= number <= size * there_are:
        raise BadInput(
            f"{target.name} has 1 to {size * there_are:,} exact draws, not {number:,}; ask for"
            " fewer"
        )
    blocks = []
    for index in range(-(-number // size)):
        report = _after(progress, index * size, -(-number // size) * size)
        blocks.append(exact_block(target, index, folder, report))
        report(size, size)
    points = np.concatenate([block.points for block in blocks])[:number]
    if len(points) < number:  # a box may cut some off
        raise BadInput(
            f"of {target.name} {len(points):,} exact draws lie in its box, not {number:,}; ask for"
            " fewer"
        )
    return points


def _after(progress: Progress | None, before: int, wanted: int) -> Progress:
    """Reports of a block, as reports of all blocks."""

    def report(made: int, _: int) -> None:
        if progress is not None:
            progress(before + made, wanted)

    return report


def measured(target: FrozenTarget) -> dict[str, Any]:
    """The record of `reference.json`, from the first blocks."""
    blocks = [exact_block(target, index) for index in range(blocks_of(target).measured)]
    logs = np.array([block.log_evidence for block in blocks])
    errors = np.array([block.log_evidence_se for block in blocks])
    parts = [sample_at(target, block.points[None]) for block in blocks]
    values = np.concatenate([part.flat for part in parts])
    away = np.concatenate([part.away[0] for part in parts])
    moments = Moments.of(values)
    return {
        "log_evidence": float(np.logaddexp.reduce(logs) - math.log(len(blocks))),
        "log_evidence_se": float(np.sqrt(np.sum(errors**2)) / len(blocks)),
        "cut_off": float(np.mean([block.cut_off for block in blocks])),
        "modes": mode_masses(target, away),
        **{field.name: getattr(moments, field.name).tolist() for field in fields(moments)},
        "number": len(values),
        "blocks": [block.sha256 for block in blocks],
        "shipped": hashlib.sha256(shipped_file(target)).hexdigest(),
    }


def shipped_file(target: FrozenTarget) -> bytes:
    """The file of draws that is in the package: the first of the last block, in single precision,
    for which a joint at the rim of its disc may lie a millionth beyond."""
    file = io.BytesIO()
    last = blocks_of(target).there_are - 1
    np.save(file, exact_block(target, last).points[:SHIPPED].astype("<f4"))
    return file.getvalue()


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
