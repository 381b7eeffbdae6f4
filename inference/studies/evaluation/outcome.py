"""What comes out of a frame: errors of the single estimate, of k hypotheses, of all draws; and how
it went.

A block of frames is estimated together and then drawn one by one, each with a key from its own
number. The same block gives the same bits wherever and whenever it is done."""

import dataclasses
import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray as xr

from poseterior.inference.composition import compose
from poseterior.inference.draws import Draws
from poseterior.inference.estimators import estimate_torsos
from poseterior.inference.hypothesis import diverse
from poseterior.inference.sampler import MANY_ROOTS, DetectionSampler, sampler_of
from poseterior.inference.studies.calibration.real import TRUE, true_candidate
from poseterior.inference.studies.errors import aligned_errors, joint_errors
from poseterior.inference.studies.evaluation.conditions import Condition
from poseterior.inference.studies.evaluation.metrics import distinct_flips, spread
from poseterior.inference.studies.evaluation.samples import SAMPLE_SHAPES, of_samples
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.datasets import Case, DataSet
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS, TORSO_INDEX

BAD_INPUT, FAILED = "bad input", "failed"
LONGEST_SENTENCE = 400
"""Letters of a reason that are kept."""
BLANK = {"O": "", "f": np.nan, "i": 0, "u": 0}
"""What stands where nothing is known, by kind of number."""


class Field:
    """What is kept of a frame under one name: its type and, by dimension, its sizes."""

    def __init__(self, kind: str, **sizes: int) -> None:
        self.kind = kind
        self.sizes = sizes


@dataclass(frozen=True, eq=False)
class Protocol:
    """What is done with every frame.

    Parameters
    ----------
    anatomy, upper, lower
        What is believed, and the measures of upper and lower bones.
    dictionary
        The poses that estimators build of.
    candidates
        How many torsos and cameras are kept; 1 is the paper's method.
    likelihood
        How detections err, and which joints count.
    num_samples, max_proposals, ks
        Draws, the budget for them, and how many hypotheses are chosen among them.
    num_roots
        From how many roots draws are made where the root is uncertain.
    upright
        What is believed of how bodies are turned where the root is uncertain
        (`probmodel.rotations.UprightRotation`).
    composed
        Whether hypotheses are put together limb by limb (`inference.composition`).
    """

    anatomy: Anatomy
    dictionary: PoseDictionary
    upper: str = "angle"
    lower: str = "area"
    candidates: int = 1
    likelihood: Likelihood = PAPER
    num_samples: int = 1000
    ks: tuple[int, ...] = (5, 20)
    max_proposals: int = 20_000_000
    seed: int = 0
    num_roots: int = MANY_ROOTS
    upright: float = 0.0
    composed: bool = False

    def __post_init__(self) -> None:
        if (
            not self.ks
            or len(set(self.ks)) != len(self.ks)
            or not 1 <= min(self.ks) <= max(self.ks) <= self.num_samples
        ):
            raise BadInput(
                f"k must be different numbers from 1 to the {self.num_samples} draws of a frame,"
                f" not {', '.join(map(str, self.ks)) or 'none'}"
            )

    @functools.cached_property
    def model(self) -> PoseModel:
        """The model of it."""
        return PoseModel.from_anatomy(self.anatomy, upper=self.upper, lower=self.lower)

    @functools.cached_property
    def rooted(self) -> PoseModel:
        """The model where the root is a part of the posterior."""
        return PoseModel.from_anatomy(
            self.anatomy, upper=self.upper, lower=self.lower, upright=self.upright
        )

    def sampler(self, root: str) -> DetectionSampler:
        """What draws under one of `conditions.ROOTS`; the true root is the only candidate."""
        own, model = (UNCERTAIN, self.rooted) if root == UNCERTAIN else (CANDIDATES, self.model)
        chosen = sampler_of(own, num_roots=self.num_roots, max_proposals=self.max_proposals)
        return DetectionSampler(model, own, chosen, self.num_samples)

    @functools.cached_property
    def fields(self) -> dict[str, Field]:
        """What is kept of a frame, by name. Errors in mm; `hypotheses_k` are heaviest cluster
        first; `_unscaled`: by similarity alone, mean over joints; `effective_roots` where the root
        is uncertain; what `samples.of_samples` says."""
        by_joint = Field("f4", joint=NUM_JOINTS)
        found = {
            "status": Field("O"),
            "sentence": Field("O"),
            "num_draws": Field("i4"),
            "log_evidence": Field("f8"),
            "effective_roots": Field("f8"),
            "single": by_joint,
            "single_unscaled": Field("f4"),
            "single_valid": Field("u1", bone=len(BONES)),
            "all": by_joint,
            "all_unscaled": Field("f4"),
            "all_by_joint": by_joint,
            "mean_draw": Field("f4"),
            "spread": Field("f4"),
            "flips": Field("i4"),
            "seconds": Field("f4"),
            **{name: Field("f8", **sizes) for name, sizes in SAMPLE_SHAPES.items()},
        }
        for k in self.ks:
            found |= {
                f"hypotheses_{k}": Field("f4", **{f"hypothesis_{k}": k, "joint": NUM_JOINTS}),
                f"hypotheses_{k}_unscaled": Field("f4", **{f"hypothesis_{k}": k}),
                f"flips_{k}": Field("i4"),
            }
        return found

    def blank(self, number: int) -> dict[str, np.ndarray]:
        """`number` frames of which nothing is known."""
        return {
            name: np.full((number, *one.sizes.values()), BLANK[one.kind[0]], one.kind)
            for name, one in self.fields.items()
        }

    def dataset(self, values: Mapping[str, np.ndarray]) -> xr.Dataset:
        """What is kept of frames, with names."""
        return xr.Dataset(
            {name: (("frame", *self.fields[name].sizes), value) for name, value in values.items()}
        )


def judge_block(
    protocol: Protocol, condition: Condition, data: DataSet, first: int
) -> dict[str, np.ndarray]:
    """What comes out of the frames of `data`, by name (`Protocol.fields`); `first` is the number
    of the first one in its data set.

    A frame that cannot be read, estimated or drawn from is recorded with its reason.
    """
    found = protocol.blank(len(data))
    cases = [_prepared(condition, protocol.seed, data, row, first) for row in range(len(data))]
    frames = _estimated(protocol, condition.estimator, cases)
    for row, (case, frame) in enumerate(zip(cases, frames, strict=True)):
        started = time.perf_counter()
        status, sentence, values = _judged(protocol, condition.root, case, frame)
        values["seconds"] = time.perf_counter() - started
        values |= {"status": status, "sentence": sentence[:LONGEST_SENTENCE]}
        for name, value in values.items():
            found[name][row] = value
    return found


def _prepared(
    condition: Condition, seed: int, data: DataSet, row: int, first: int
) -> Case | Exception:
    try:
        case = data.case(row, number=first + row)
        return case.hiding(condition.missing, seed).turned(condition.rotate)
    except BadInput as error:
        return error


def _estimated(
    protocol: Protocol, estimator: str, cases: Sequence[Case | Exception]
) -> list[Estimate | Exception]:
    """All together, which is faster; one by one where one of them spoils it for the others."""
    good = [case.detection for case in cases if isinstance(case, Case)]
    settings: dict[str, Any] = {
        "torsos": protocol.anatomy.torsos,
        "limits": protocol.anatomy.limits,
        "poses": protocol.dictionary,
        "num_candidates": protocol.candidates,
        "likelihood": protocol.likelihood,
    }
    try:
        frames: list[Estimate | Exception] = list(estimate_torsos(good, estimator, **settings))
    except Exception:
        frames = []
        for detection in good:
            try:
                frames += estimate_torsos([detection], estimator, **settings)
            except Exception as error:  # recorded, frame by frame
                frames.append(error)
    rest = iter(frames)
    return [case if isinstance(case, Exception) else _taken_by(case, next(rest)) for case in cases]


def _taken_by(case: Case, frame: Estimate | Exception) -> Estimate | Exception:
    """The estimate with what is known of the case's camera."""
    return frame if isinstance(frame, Exception) else dataclasses.replace(frame, lens=case.lens)


def _judged(
    protocol: Protocol, root: str, case: Case | Exception, frame: Estimate | Exception
) -> tuple[str, str, dict[str, Any]]:
    if isinstance(case, Exception) or isinstance(frame, Exception):
        return *_reason(frame), {}
    try:
        values = _single(protocol, case, frame)
        if root == TRUE:
            frame = _truth(protocol, case)
        status, sentence, drawn = _drawn(protocol, root, case, frame)
    except (
        Exception
    ) as error:  # one frame of a million must not stop the others; it is counted, and says why
        return *_reason(error), {}
    return status, sentence, values | drawn


def _reason(error: object) -> tuple[str, str]:
    return (
        (BAD_INPUT, str(error))
        if isinstance(error, BadInput)
        else (FAILED, f"{type(error).__name__}: {error}")
    )


def _single(protocol: Protocol, case: Case, frame: Estimate) -> dict[str, Any]:
    pose = frame.pose
    assert pose is not None  # every estimator of the table gives one
    return {
        "single": joint_errors(pose, case.pose),
        "single_unscaled": aligned_errors(pose, case.pose).mean(),
        "single_valid": protocol.anatomy.limits.check(pose).valid,
    }


def _truth(protocol: Protocol, case: Case) -> Estimate:
    """The true torso in front of the true camera, in place of an estimate."""
    root = true_candidate(case, protocol.model)
    return Estimate(case.detection, (root,), protocol.likelihood, estimator=TRUE)


def _drawn(
    protocol: Protocol, root: str, case: Case, frame: Estimate
) -> tuple[str, str, dict[str, Any]]:
    draws = protocol.sampler(root)(
        frame, jax.random.fold_in(jax.random.key(protocol.seed), case.number)
    )
    joints = draws.joints
    values: dict[str, Any] = {
        "num_draws": len(joints),
        "log_evidence": draws.log_evidence,
        "effective_roots": draws.effective_roots,
    }
    if len(joints) < max(protocol.ks):
        return draws.status, draws.sentence, values
    rng = np.random.default_rng([protocol.seed, 3, case.number])
    values |= of_samples(
        joints * case.unit,
        (draws.keypoints - case.image(case.pose)) / case.scale,
        case.pose,
        case.detection.score > 0,
        rng,
        given=TORSO_INDEX if root == TRUE else (),
        strays=case.strays(rng, len(joints)),
    )
    scaled = joint_errors(joints, case.pose)
    plain = aligned_errors(joints, case.pose).mean(axis=-1)
    means = scaled.mean(axis=-1)
    values |= {
        "all": scaled[means.argmin()],
        "all_by_joint": scaled.min(axis=0),
        "all_unscaled": plain.min(),
        "mean_draw": means.mean(),
        "spread": spread(joints) * case.unit,
        "flips": distinct_flips(joints),
    }
    for k in protocol.ks:
        chosen = _hypotheses(protocol, draws, k)
        values |= {
            f"hypotheses_{k}": joint_errors(chosen, case.pose),
            f"hypotheses_{k}_unscaled": aligned_errors(chosen, case.pose).mean(axis=-1),
            f"flips_{k}": distinct_flips(chosen),
        }
    return draws.status, draws.sentence, values


def _hypotheses(protocol: Protocol, draws: Draws, k: int) -> np.ndarray:
    """`(k, 15, 3)`; some stand twice where draws are alike, so that there are fewer than k."""
    if protocol.composed:
        poses = np.stack([one.joints for one in compose(draws, k, seed=protocol.seed)])
    else:
        chosen = diverse(draws.joints.astype(np.float32), k, seed=protocol.seed)
        poses = draws.joints[[one.draw for one in chosen]]
    return np.resize(poses, (k, *poses.shape[1:]))
