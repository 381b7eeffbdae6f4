"""What an estimate costs, 64 people together: `make bench`. The aims: 30 ms a person for Zhou, 60
ms for A&B, 15 ms for the dictionary."""

import numpy as np
import pytest

from poseterior import inference
from poseterior.probmodel import Detection
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from tests.scenes import camera

PEOPLE = 64


@pytest.fixture(scope="module")
def people() -> list[Detection]:
    rng, dictionary = np.random.default_rng(0), PoseDictionary.default()
    weights = rng.normal(size=(PEOPLE, len(dictionary.bases))) * 0.1
    poses = dictionary.mean + np.einsum("nk,kja->nja", weights, dictionary.bases)
    found = []
    for number, pose in enumerate(poses):
        keypoints = (
            np.asarray(camera(37.0 * number, 10).project(pose)) + rng.normal(size=(15, 2)) * 5
        )
        found.append(Detection(keypoints, rng.uniform(0.5, 1, 15), "synthetic", "a crowd", number))
    return found


@pytest.mark.parametrize("method", ["dictionary", "akhter-black", "zhou"])
def test_sixty_four_people(benchmark, people, method):
    frames = benchmark(lambda: inference.estimate_torsos(people, method))
    assert all(frame.converged for frame in frames)


@pytest.mark.parametrize("method", ["dictionary", "akhter-black", "zhou"])
def test_one_person(benchmark, people, method):
    """What `hypotheses` and `sample` wait for."""
    assert benchmark(lambda: inference.estimate_torso(people[0], method)).converged
