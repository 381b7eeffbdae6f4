"""A known focal length against brute force in NumPy with a pinhole camera, which shares no code
with the product: evidence and moments of a small case, torso and one arm; controls that must fail.

False alarms: evidence and every moment are held to 4 standard errors, 6e-5 each; seeds are fixed.
"""

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference.uncertain.weighted import WeightedRoots, weigh_roots
from probmodel import Estimate, Likelihood, PoseModel
from probmodel.camera import Lens
from probmodel.likelihood import Gaussian
from probmodel.roots import NEAREST
from probmodel.skeleton import JOINT_INDEX, TORSO_INDEX
from tests.brute_force import propose_group
from tests.inference import test_uncertain_root as sound
from tests.scenes import key

FOCAL, PRINCIPAL = 650.0, np.array([250.0, 420.0])
"""Pixels: some seven body units away, well beside the axis."""
BATCH = 250_000


@functools.cache
def small_case() -> tuple[PoseModel, Estimate]:
    model, frame = sound.small_case()
    return model.seen_by(Lens(FOCAL, PRINCIPAL)), frame


def seen_at(points: np.ndarray, pelvis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(n, 2)` pixels at which a pinhole camera sees points `(n, 3)` beside a pelvis `(n, 3)`, and
    how large a body unit is there, `(n,)`."""
    place = points + pelvis
    return PRINCIPAL + FOCAL * place[:, :2] / place[:, 2:], FOCAL / place[:, 2]


def brute_force(frame: Estimate, attempts: int, seed: int, law: str) -> dict:
    """Evidence and moments by importance sampling from a plain proposal: rotation uniform, log
    scale uniform on a wide interval, the pelvis' image uniform in a square around the right hip's.
    """
    model, rng, detection = small_case()[0], np.random.default_rng(seed), frame.detection
    names = sound.SEEN
    score = detection.score[[JOINT_INDEX[name] for name in names]]
    radius = dict(zip(names, sound.FACTOR * score.mean() / score, strict=True))
    at = {name: detection.keypoints[JOINT_INDEX[name]] for name in names}
    torsos = np.asarray(model.torsos)
    row = {name: TORSO_INDEX.index(JOINT_INDEX[name]) for name in names[:4]}
    low, high = math.log(25.0), math.log(FOCAL / NEAREST)
    pools = [
        propose_group(model.limits, model.lengths, torso, "arms", 20_000, rng)[1]
        for torso in torsos
    ]

    def likelihood(name: str, points: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
        image, unit = seen_at(points, pelvis)
        gap = (image - at[name]) / unit[:, None]
        return (
            sound.PEAKS[law]
            * sound.likelihood_ratio(law, gap, radius[name])
            / (radius[name] * unit) ** 2
        )

    weights, values = [], []
    for _ in range(attempts // BATCH):
        torso = rng.integers(len(torsos), size=BATCH)
        rotation = Rotation.random(BATCH, rng=rng).as_matrix()
        scale = np.exp(rng.uniform(low, high, BATCH))
        half = 1.8 * scale[:, None]
        moved = at["right_hip"] + rng.uniform(-half, half, (BATCH, 2))
        away = FOCAL / scale
        pelvis = np.column_stack([(moved - PRINCIPAL) / FOCAL * away[:, None], away])
        weight = (high - low) * (2 * half[:, 0]) ** 2
        for name in names[:4]:
            points = np.einsum("nij,nj->ni", rotation, torsos[torso, row[name]])
            weight *= likelihood(name, points, pelvis)
        for n in np.flatnonzero(weight):
            pick = rng.integers(20_000, size=sound.ARMS_EACH)
            ends = [pools[torso[n]][JOINT_INDEX[name]][pick] @ rotation[n].T for name in names[4:]]
            keep = np.ones(sound.ARMS_EACH)
            for name, points in zip(names[4:], ends, strict=True):
                keep *= likelihood(name, points, pelvis[n][None])
            weights.append(weight[n] * keep.mean())
            share = keep / keep.sum() if keep.any() else keep
            elbow, wrist = ends
            root = [math.log(scale[n]), moved[n, 0], rotation[n, 2, 2], rotation[n, 2, 1]]
            values.append([*root, share @ elbow[:, 2], *(share @ wrist[:, [0, 2]])])
    weight, total = np.array(weights), attempts // BATCH * BATCH
    mean = weight.sum() / total
    error = math.sqrt((np.sum(weight**2) / total - mean**2) / total)
    return {
        "log": math.log(mean),
        "se": error / mean,
        **sound.moments(weight, np.array(values)),
    }


def under(law: str) -> tuple[PoseModel, Estimate]:
    model, frame = small_case()
    laws = {
        "disc": Likelihood(factor=sound.FACTOR),
        "gaussian": Likelihood(Gaussian(), sound.FACTOR),
    }
    return model, dataclasses.replace(frame, likelihood=laws[law])


@functools.cache
def known(law: str) -> dict:
    return brute_force(small_case()[1], 12_000_000, 5, law)


def apart(roots: WeightedRoots, brute: dict) -> tuple[float, float]:
    """How far evidences and moments are apart, in standard errors."""
    error = math.hypot(brute["se"], roots.log_evidence_se)
    moments = sound.off(sound.fast_moments(roots, roots.share), brute)
    return abs(roots.log_evidence - brute["log"]) / error, moments


@pytest.mark.slow
@pytest.mark.parametrize("law", ["disc", "gaussian"])
def test_evidence_and_moments_against_a_pinhole_camera(law: str) -> None:
    model, frame = under(law)
    roots = weigh_roots(frame.uncertain(model), key=key(3), num_roots=1500)
    assert math.hypot(known(law)["se"], roots.log_evidence_se) < 0.15
    evidence, moments = apart(roots, known(law))
    assert evidence < 4
    assert moments < 4
