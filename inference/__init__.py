"""How a posterior is computed: estimators of torso and camera, samplers with one face, hypotheses.

frame = inference.estimate_torso(detection)
result = inference.sample(model, frame, key=jax.random.key(0), num_samples=10_000)
"""

from inference.baselines.target import Target
from inference.evidences import Evidence, evidence
from inference.hypothesis import Hypothesis, diverse, grid_poses, hypotheses
from inference.machines import Machines
from inference.results import Result
from inference.roots import ESTIMATORS, estimate_torso, estimate_torsos
from inference.sampler import SAMPLERS, sample
from inference.stream import Item, draws_of, open_stream, sample_frames

__all__ = [
    "ESTIMATORS",
    "SAMPLERS",
    "Evidence",
    "Hypothesis",
    "Item",
    "Machines",
    "Result",
    "Target",
    "diverse",
    "draws_of",
    "estimate_torso",
    "estimate_torsos",
    "evidence",
    "grid_poses",
    "hypotheses",
    "open_stream",
    "sample",
    "sample_frames",
]
