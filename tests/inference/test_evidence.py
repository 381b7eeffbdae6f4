"""The evidence, whole and limb by limb, against draws of the prior and against itself."""

import dataclasses

import numpy as np
import pytest

from poseterior import inference
from poseterior.probmodel import PoseModel
from tests.scenes import key, prior_scene
from tests.witnesses.limbs import build_groups
from tests.witnesses.pruned import group_prior


@pytest.fixture(scope="module")
def found():
    model = PoseModel()
    frame = prior_scene(model, 1, factor=0.8)
    return model, frame, inference.evidence(model, frame, key=key(0), relative_error=0.02)


def test_every_part_is_as_precise_as_asked_and_the_body_is_its_groups(found):
    _, _, parts = found
    assert set(parts) == {
        "body",
        "head",
        "arms",
        "right arm",
        "left arm",
        "legs",
        "right leg",
        "left leg",
    }
    assert all(
        0 < part.standard_error <= 0.02 or part.log_evidence > -1e-9 for part in parts.values()
    )
    groups = [parts[name] for name in ("head", "arms", "legs")]
    assert np.isclose(parts["body"].log_evidence, sum(group.log_evidence for group in groups))


@pytest.mark.slow
def test_limbs_and_groups_have_the_evidence_of_the_prior(found):
    """Share of a million draws of the prior that explain each limb and each group, within 4
    standard errors (false alarms: 4e-4 over six)."""
    model, frame, parts = found
    groups = build_groups(model, frame.observation)
    for name, sides in (("arms", ("right arm", "left arm")), ("legs", ("right leg", "left leg"))):
        hits = np.zeros(3)
        for part in range(4):
            draws = group_prior(key(part), groups[name], 250_000)
            offset = np.asarray(groups[name].reach(draws)) - np.asarray(groups[name].target)
            inside = np.all(
                np.sum(offset**2, axis=-1) <= np.asarray(groups[name].radius) ** 2, axis=-1
            )
            hits += [*inside.sum(axis=0), inside.all(axis=1).sum()]
        for count, label in zip(hits, (*sides, name), strict=True):
            assert count > 50
            error = np.hypot(parts[label].standard_error, 1 / np.sqrt(count))
            assert abs(parts[label].log_evidence - np.log(count / 1e6)) < 4 * error


def test_sampling_finds_the_same_evidence(found):
    model, frame, parts = found
    attrs = inference.sample(
        model, frame, key=key(5), num_samples=10_000, root="candidates"
    ).tree.attrs
    error = np.hypot(attrs["log_evidence_se"], parts["body"].standard_error)
    assert abs(attrs["log_evidence"] - parts["body"].log_evidence) < 3 * error


def test_what_cannot_be_explained_has_no_evidence(found):
    model, frame, _ = found
    keypoints = np.array(frame.detection.keypoints)
    keypoints[4] += 3000.0
    far = dataclasses.replace(
        frame, detection=dataclasses.replace(frame.detection, keypoints=keypoints)
    )
    parts = inference.evidence(model, far, key=key(0), relative_error=0.1)
    assert parts["right arm"].log_evidence == parts["body"].log_evidence == -np.inf
    assert np.isfinite(parts["left arm"].log_evidence)
