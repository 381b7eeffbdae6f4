"""Files of error laws: what is written is read, and what is none is refused in one sentence."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from poseterior.probmodel import BadInput, Detection
from poseterior.probmodel.errors.detector import (
    ANY_SCORE,
    FORMAT,
    NO_EXCHANGE,
    DetectorErrors,
    Exchange,
)
from poseterior.probmodel.errors.laws import Disc, Gaussian, Student
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.layouts import STRAY
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

WRIST, HEAD = JOINT_INDEX["left_wrist"], JOINT_INDEX["head"]
DOCUMENT: dict[str, Any] = {
    "format": FORMAT,
    "law": "student",
    "df": 4,
    "joints": {
        "left_wrist": {"sigma": 0.06, "inlier": 0.9, "bias": [0.01, -0.02]},
        "head": {"sigma": 0.1},
    },
    "exchange": {"legs": 0.01, "arms": 0.005},
    "score": {"edges": [0.3, 0.6], "sigma_factor": [2, 1.3, 1]},
    "learned": {"detector": "body_25b"},
}


def changed(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """The document with one entry changed; `...` takes it away."""
    document = copy.deepcopy(DOCUMENT)
    place = document
    for name in path[:-1]:
        place = place[name]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return document


def test_a_document_becomes_arrays_in_the_skeletons_order():
    errors = DetectorErrors.from_document(DOCUMENT, "x")
    assert (errors.law, errors.exchange) == (Student(4.0), Exchange(0.01, 0.005, 0.0))
    assert np.flatnonzero(errors.known).tolist() == [WRIST, HEAD]
    assert errors.sigma[[WRIST, HEAD]].tolist() == [0.06, 0.1]
    assert errors.inlier[[WRIST, HEAD]].tolist() == [0.9, 1.0]
    assert errors.bias[WRIST].tolist() == [0.01, -0.02]
    assert errors.bias[HEAD].tolist() == [0.0, 0.0]
    assert np.isnan(errors.se).all()


def test_the_spread_depends_on_the_score():
    errors = DetectorErrors.from_document(DOCUMENT, "x")
    at = [errors.spread(np.full(NUM_JOINTS, score))[WRIST] for score in (0.1, 0.3, 0.59, 0.6, 1.0)]
    assert at == pytest.approx([0.12, 0.078, 0.078, 0.06, 0.06])
    assert np.isnan(errors.spread(np.ones(NUM_JOINTS))[0])


def test_what_is_written_is_read(tmp_path: Path):
    errors = DetectorErrors.from_document(
        changed(("joints", "head"), {"sigma": 0.1, "se": [0.1, 0.2, 0.3, 0.4], "pairs": 17}), "x"
    )
    errors.write(tmp_path / "errors.json")
    again = DetectorErrors.read(tmp_path / "errors.json")
    for name in ("sigma", "inlier", "bias", "se", "pairs"):
        assert np.array_equal(getattr(again, name), getattr(errors, name), equal_nan=True)
    for name in ("law", "exchange", "score", "outlier_radius", "learned"):
        assert getattr(again, name) == getattr(errors, name)
    assert (again.pairs[HEAD], again.se[HEAD].tolist()) == (17, [0.1, 0.2, 0.3, 0.4])


TIMES = {
    **{"constant": 0.5, "slow": 0.4, "quick": 0.1, "seconds": 0.15},
    **{"deviation": 0.07, "longest": 0.5, "rate": 60.0},
}


def test_how_long_errors_last_is_kept_and_says_nothing_of_one_frame(tmp_path: Path) -> None:
    """The hash by which runs are known again is that of a frame's posterior; the control: another
    spread changes it."""
    given = {**TIMES, "se": {"constant": 0.1, "seconds": None}}
    errors = DetectorErrors.from_document(changed(("times",), given), "x")
    errors.write(tmp_path / "errors.json")
    again = DetectorErrors.read(tmp_path / "errors.json").times
    assert again is not None
    assert again[:-1] == tuple(TIMES.values())
    np.testing.assert_array_equal(again.se, [0.1, np.nan, np.nan, np.nan])
    plain = DetectorErrors.from_document(DOCUMENT, "x")
    assert plain.times is None
    assert Likelihood.of(errors).sha256 == Likelihood.of(plain).sha256
    other = DetectorErrors.from_document(changed(("joints", "head", "sigma"), 0.2), "x")
    assert Likelihood.of(other).sha256 != Likelihood.of(plain).sha256


def test_a_film_of_errors_that_last_is_worth_a_frame() -> None:
    plain = DetectorErrors.from_document(DOCUMENT, "x")
    assert plain.worth(100, 60.0) == 1.0
    times = DetectorErrors.from_document(changed(("times",), TIMES), "x")
    assert 1.0 < times.worth(100, 60.0) < 2.0


def test_a_gaussian_needs_nothing_but_joints():
    errors = DetectorErrors.from_document(
        {"format": FORMAT, "law": "gaussian", "joints": {"head": {"sigma": 0.1}}}, "x"
    )
    assert (errors.law, errors.exchange, errors.score) == (Gaussian(), NO_EXCHANGE, ANY_SCORE)


def test_a_joint_that_is_seen_must_be_known():
    errors, seen = DetectorErrors.from_document(DOCUMENT, "x"), np.zeros(NUM_JOINTS, bool)
    seen[[WRIST, HEAD]] = True
    errors.require(seen, "person 0 of x.json")
    seen[JOINT_INDEX["left_knee"]] = True
    with pytest.raises(BadInput, match=r"knows no left_knee, which is seen in person 0 of x\.json"):
        errors.require(seen, "person 0 of x.json")


WRIST_PATH = ("joints", "left_wrist")
REFUSALS = [
    (("times",), [1], r"times must be an object, not \[1\]"),
    (("times",), {**TIMES, "slow": 0.5}, "constant, slow, quick must be shares with sum 1, not"),
    (("times",), {**TIMES, "seconds": 0}, "the times' seconds must be a positive number, not 0"),
    (("times",), {**TIMES, "seconds": None}, "times seconds must be a number, not None"),
    (("times",), {**TIMES, "se": {"slow": "x"}}, "times se slow must be a number, not 'x'"),
    (("times",), {**TIMES, "se": {"fast": 1}}, "times se has no 'fast'"),
    (("format",), "poseterior error law 2", 'does not begin with "format"'),
    (("format",), ..., 'does not begin with "format"'),
    (("law",), ..., "lacks 'law'"),
    (("law",), "cauchy", "there is no error law 'cauchy'; choose among disc, gaussian, student"),
    (("law",), ["disc"], r"there is no error law \['disc'\]"),
    (("law",), "gaussian", "the error law gaussian is given with no parameter, not with df"),
    (("df",), ..., "the error law student is given with df, not with no parameter"),
    (("df",), 0, "a student law has 1 degree of freedom or more, not 0"),
    (("df",), float("nan"), "df must be a finite number, not nan"),
    (("df",), 10**400, "df must be a finite number"),
    (("units",), "pixels", "units must be .body units"),
    (("axes",), "body", "axes must be 'image: right, down', not 'body'"),
    (("sigma",), 0.1, "an error law has no 'sigma'; it may have axes, df"),
    (("joints",), [], r"joints must be an object, not \[\]"),
    (("joints",), {}, "must know at least one joint"),
    (("joints", "left_hand"), {"sigma": 1}, "has a joint 'left_hand', which the skeleton has not"),
    (WRIST_PATH, 0.1, "left_wrist must be an object, not 0.1"),
    ((*WRIST_PATH, "sigma"), ..., "left_wrist lacks 'sigma'"),
    ((*WRIST_PATH, "sigma"), 0, "sigma of left_wrist must be positive .* not 0"),
    ((*WRIST_PATH, "sigma"), -0.1, "sigma of left_wrist must be positive .* not -0.1"),
    ((*WRIST_PATH, "sigma"), 1e9, "sigma of left_wrist must be positive and at most 100"),
    ((*WRIST_PATH, "sigma"), float("nan"), "sigma of left_wrist must be a finite number, not nan"),
    ((*WRIST_PATH, "sigma"), "0.1", "sigma of left_wrist must be a number, not '0.1'"),
    ((*WRIST_PATH, "sigma"), True, "sigma of left_wrist must be a number, not True"),
    ((*WRIST_PATH, "inlier"), 1.1, "inlier of left_wrist must lie between 0 and 1, not 1.1"),
    ((*WRIST_PATH, "inlier"), -0.1, "inlier of left_wrist must lie between 0 and 1, not -0.1"),
    ((*WRIST_PATH, "bias"), [1], r"bias of left_wrist must be 2 numbers, not \[1\]"),
    ((*WRIST_PATH, "bias"), [0, 1e6], "bias of left_wrist must be two numbers within ±100"),
    (
        (*WRIST_PATH, "tau"),
        1,
        "left_wrist has no 'tau'; it may have bias, definition, definition_sd, inlier",
    ),
    ((*WRIST_PATH, "pairs"), -1, "pairs of left_wrist must be a whole number, not -1"),
    ((*WRIST_PATH, "se"), [1, 2], "se of left_wrist must be 4 numbers"),
    (("exchange", "head"), 0.1, "exchange has no 'head'; it may have arms, body, legs"),
    (("exchange", "legs"), 0.999, "together stay below 1, not 0.999, 0.005, 0"),
    (("exchange", "legs"), -0.1, "must each lie between 0 and 1"),
    (("score", "edges"), [0.5], "has 1 edges and 3 factors"),
    (("score", "edges"), [0.5, 0.5], "must be rising numbers"),
    (("score", "sigma_factor"), [1, 0, 1], "must be positive and at most 100"),
    (("score", "sigma_factor"), ..., "score sigma_factor must be a list of numbers, not None"),
    (("outlier_radius",), 0, "outlier_radius must lie between 0 and 100 body units, not 0"),
    (
        ("outlier_radius",),
        1e-300,
        "outlier_radius is 1e-300 body units, less than the sigma of head",
    ),
    (("outlier_radius",), 0.09, r"less than the sigma of head \(0.1\); outliers lie farther off"),
    (
        (*WRIST_PATH, "sigma"),
        1e-3,
        "sigma of left_wrist is 0.001 body units where its score is best",
    ),
    ((*WRIST_PATH, "sigma"), 1e-300, "less than 0.002, which is under a millimetre of a person"),
    (("score", "sigma_factor"), [2, 1, 1e-3], "sigma of left_wrist is 6e-05 body units"),
    (("learned",), "here", "learned must be an object, not 'here'"),
]


@pytest.mark.parametrize(("path", "value", "words"), REFUSALS)
def test_what_is_no_error_law_is_refused(path: tuple[str, ...], value: Any, words: str):
    with pytest.raises(BadInput, match=words) as refusal:
        DetectorErrors.from_document(changed(path, value), "law.json")
    assert str(refusal.value).startswith("law.json")


@pytest.mark.parametrize(
    "text",
    [
        '{"format": "a", "format": "b"}',
        json.dumps(DOCUMENT).replace('"head": {', '"head": {"sigma": 9, '),
        json.dumps(DOCUMENT)[:-1] + ', "law": "disc"}',
    ],
)
def test_names_that_stand_twice_are_refused(text: str, tmp_path: Path):
    (tmp_path / "law.json").write_text(text)
    with pytest.raises(
        BadInput, match=r"law\.json has '\w+' twice in one object; keep one of them"
    ):
        DetectorErrors.read(tmp_path / "law.json")


def test_files_that_are_none_are_refused(tmp_path: Path):
    with pytest.raises(BadInput, match="there is no error law at"):
        DetectorErrors.read(tmp_path / "none.json")
    (tmp_path / "list.json").write_text(json.dumps([1]))
    with pytest.raises(BadInput, match="does not begin with"):
        DetectorErrors.read(tmp_path / "list.json")


def test_arrays_of_another_shape_are_refused():
    errors = DetectorErrors.from_document(DOCUMENT, "x")
    with pytest.raises(BadInput, match=r"sigma of an error law must have the shape \(15,\)"):
        DetectorErrors(Disc(), errors.sigma[:3], errors.inlier, errors.bias)


def test_a_moved_midpoint_errs_by_both_together() -> None:
    """Where a thorax was computed and moved, its error is its own and that of the move, which are
    unrelated: 2 √(σ² + stray²) of a body unit, in pixels; the pelvis, which was not, errs alone."""
    sigma = np.full(NUM_JOINTS, 0.05)
    likelihood = Likelihood.of(
        DetectorErrors(Gaussian(), sigma, np.ones(NUM_JOINTS), np.zeros((NUM_JOINTS, 2)))
    )
    detection = Detection(
        np.zeros((NUM_JOINTS, 2)), np.ones(NUM_JOINTS), "own", "made up", 0, moved=("thorax",)
    )
    thorax, pelvis = (
        likelihood.spread(detection, 80.0, range(NUM_JOINTS))[JOINT_INDEX[name]]
        for name in ("thorax", "pelvis")
    )
    assert thorax == pytest.approx(80 * 2 * np.sqrt(0.05**2 + STRAY["thorax"] ** 2))
    assert pelvis == pytest.approx(80 * 2 * 0.05)
