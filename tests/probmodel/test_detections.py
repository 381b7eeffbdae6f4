"""One person in one frame: what a detection accepts, and what follows from its scores."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from poseterior.probmodel.detections import (
    LARGEST_NUMBER,
    LIKELIHOOD_JOINTS,
    LIMB_JOINTS,
    Detection,
    pick_person,
)
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

ELBOW, HEAD, WRIST = (JOINT_INDEX[name] for name in ("right_elbow", "head", "left_wrist"))
SCORES = st.lists(st.just(0.0) | st.floats(1e-6, 10), min_size=NUM_JOINTS, max_size=NUM_JOINTS)


def detection(score: object = None, **fields: object) -> Detection:
    """A detection with all joints at (joint, 2 · joint), those with score 0 missing."""
    score = np.ones(NUM_JOINTS) if score is None else np.asarray(score, dtype=float)
    keypoints = np.arange(NUM_JOINTS)[:, None] * np.array([[1.0, 2.0]])
    keypoints[score == 0] = np.nan
    return Detection(
        **{"keypoints": keypoints, "score": score, "layout": "x", "source": "f", "person": 0}
        | fields
    )


def with_entry(array: np.ndarray, index: object, value: float) -> np.ndarray:
    array = np.array(array, dtype=float)
    array[index] = value
    return array


ONES, POINTS = np.ones(NUM_JOINTS), np.zeros((NUM_JOINTS, 2))
BAD_FIELDS = [
    (
        {"keypoints": POINTS[:14]},
        r"keypoints of person 0 of f must have the shape \(15, 2\), not \(14, 2\)",
    ),
    ({"keypoints": "no"}, "must be numbers"),
    ({"score": np.ones(3)}, r"scores of person 0 of f must have the shape \(15,\), not \(3,\)"),
    (
        {"keypoints": with_entry(POINTS, (ELBOW, 0), np.nan)},
        "right_elbow .* needs finite coordinates",
    ),
    ({"keypoints": with_entry(POINTS, HEAD, np.nan)}, "head .* needs finite coordinates"),
    (
        {"keypoints": with_entry(POINTS, (ELBOW, 1), np.inf)},
        "right_elbow .* needs finite coordinates",
    ),
    ({"keypoints": with_entry(POINTS, (ELBOW, 1), -2 * LARGEST_NUMBER)}, "within ±1e.09 pixels"),
    ({"score": with_entry(ONES, ELBOW, -0.1)}, "score of right_elbow .* is -0.1"),
    ({"score": with_entry(ONES, ELBOW, np.nan)}, "score of right_elbow .* is nan"),
    ({"score": with_entry(ONES, ELBOW, np.inf)}, "score of right_elbow .* is inf"),
    ({"score": with_entry(ONES, ELBOW, 0)}, "right_elbow .* has score 0, .* must be NaN"),
    ({"person": -1}, "number of a person must be 0 or"),
    ({"person": True}, "number of a person must be 0 or"),
    ({"image_id": 7}, "image_id .* must be a text"),
    ({"image_size": (640, 0)}, "image_size .* two positive whole numbers"),
    ({"image_size": (640.5, 480)}, "image_size .* two positive whole numbers"),
    ({"image_size": [640, 480]}, "image_size .* two positive whole numbers"),
]


@pytest.mark.parametrize(("fields", "match"), BAD_FIELDS, ids=range(len(BAD_FIELDS)))
def test_bad_fields_are_refused_in_one_sentence(fields: dict[str, object], match: str) -> None:
    with pytest.raises(BadInput, match=match) as error:
        Detection(
            **{"keypoints": POINTS, "score": ONES, "layout": "x", "source": "f", "person": 0}
            | fields
        )
    assert str(error.value).endswith(".")


def test_arrays_are_copied_and_read_only() -> None:
    score = np.ones(NUM_JOINTS)
    person = detection(score)
    score[0] = 5
    assert person.score[0] == 1
    for array in (person.keypoints, person.score):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_likelihood_joints_are_the_limb_joints_and_the_head() -> None:
    assert set(LIKELIHOOD_JOINTS) == {*LIMB_JOINTS, HEAD}
    assert len(LIKELIHOOD_JOINTS) == 9


def test_alpha_by_hand() -> None:
    """Two observed joints with scores 0.2 and 0.6: alpha 0.5 and 1.5."""
    score = np.zeros(NUM_JOINTS)
    score[[ELBOW, WRIST]] = 0.2, 0.6
    score[JOINT_INDEX["pelvis"]] = 7  # of the torso: no factor, and no part in the mean
    expected = np.full(NUM_JOINTS, np.nan)
    expected[[ELBOW, WRIST]] = 0.5, 1.5
    np.testing.assert_allclose(detection(score).alpha(LIMB_JOINTS), expected)


@settings(deadline=None)
@given(
    SCORES, st.sampled_from([LIMB_JOINTS, LIKELIHOOD_JOINTS, (ELBOW,), (ELBOW, ELBOW, WRIST), ()])
)
def test_alpha_has_mean_one_over_the_observed(score: list[float], joints: tuple[int, ...]) -> None:
    person = detection(score)
    alpha = person.alpha(joints)
    observed = person.seen & np.isin(np.arange(NUM_JOINTS), joints)
    np.testing.assert_array_equal(np.isfinite(alpha), observed)
    spread = Likelihood(joints=joints).spread(person, 3.0)
    np.testing.assert_array_equal(np.isfinite(spread), observed)
    if observed.any():
        assert alpha[observed].mean() == pytest.approx(1)


def test_pick_person() -> None:
    two = [detection(person=0), detection(person=1)]
    assert pick_person(two, 1) is two[1]
    with pytest.raises(BadInput, match="f has 2 people, numbered 0 to 1; person 5 is not"):
        pick_person(two, 5)
    with pytest.raises(BadInput, match="f has 1 person, numbered 0; person -1 is not"):
        pick_person(two[:1], -1)
    with pytest.raises(BadInput, match="the list of detections is empty"):
        pick_person([], 0)
