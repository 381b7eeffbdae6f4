"""Tables: the right numbers, computed by hand from a small tree; None where there is none; 80
columns."""

import io
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from poseterior.inference.hypothesis import Hypothesis
from poseterior.inference.results import Result
from poseterior.inference.studies.evaluation.relations import Relation
from poseterior.inference.studies.evaluation.scores import Interval
from poseterior.probmodel.anatomy.limits import AnatomicalLimits, Check
from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.skeleton import BONE_NAMES, JOINT_INDEX, JOINTS, NUM_JOINTS
from poseterior.reports import tables
from poseterior.reports.tables import posterior
from poseterior.reports.tables.evaluation import relations_table
from poseterior.reports.tables.frames import Misread, fault_lines, misread
from poseterior.reports.tables.posterior import facing_sentences
from poseterior.reports.tables.words import undetected
from tests.reports.test_interactive import film_tree

UPRIGHT = np.diag(
    [1.0, -1.0, -1.0]
)  # a body that faces the camera: left is right in the image, up is up
RIGHT_KNEE, RIGHT_WRIST = JOINT_INDEX["right_knee"], JOINT_INDEX["right_wrist"]


def standing() -> np.ndarray:
    """A pose `(15, 3)` in camera axes that faces the camera, arms and legs hanging down."""
    body = {
        "thorax": (0, 1.4, 0),
        "head": (0, 2.0, 0),
        "right_shoulder": (-0.5, 1.4, 0),
        "right_elbow": (-0.5, 0.5, 0),
        "right_wrist": (-0.5, -0.2, 0.1),
        "left_shoulder": (0.5, 1.4, 0),
        "left_elbow": (0.5, 0.5, 0),
        "left_wrist": (0.5, -0.2, 0.1),
        "right_hip": (-0.3, -0.1, 0),
        "right_knee": (-0.3, -1.3, 0),
        "right_ankle": (-0.3, -2.5, -0.1),
        "left_hip": (0.3, -0.1, 0),
        "left_knee": (0.3, -1.3, 0),
        "left_ankle": (0.3, -2.5, -0.1),
        "pelvis": (0, 0, 0),
    }
    return np.array([body[name] for name in JOINTS], float) @ UPRIGHT.T


def small_tree(joints: np.ndarray) -> xr.DataTree:
    """A tree by hand: draws `(n, 15, 3)`, two candidates (share 1/4 and 3/4), right wrist missing,
    τ = 5 and 7 px."""
    score = np.full(15, 0.8)
    score[RIGHT_WRIST] = 0
    radius = np.full((2, 15), np.nan)
    radius[:, RIGHT_KNEE] = [5, 7]
    lying = np.array(
        [[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]
    )  # not symmetric: chest to the right, head away
    number = len(joints)
    posterior = {
        "joints": (("chain", "draw", "joint", "axis"), joints[None]),
        "keypoints": (("chain", "draw", "joint", "uv"), 10 * joints[None, ..., :2] + 50),
        "candidate": (("chain", "draw"), np.zeros((1, number), int)),
    }
    constant = {
        "radius": (("candidate", "joint"), radius),
        "rotation": (("candidate", "axis", "body_axis"), np.stack([UPRIGHT, lying])),
        "scale": (("candidate",), np.array([28.0, 29.0])),
        "torso_index": (("candidate",), np.array([18, 42])),
        "reprojection_error": (("candidate",), np.array([3.5, 3.6])),
        "log_evidence": (("candidate",), np.array([-np.inf, -16.25])),
        "log_evidence_se": (("candidate",), np.array([np.inf, 0.03])),
        "weight": (("candidate",), np.array([0.25, 0.75])),
    }
    keypoints = np.where(score[:, None] > 0, 10 * standing()[:, :2] + 50, np.nan)
    observed = {"keypoints": (("joint", "uv"), keypoints), "score": (("joint",), score)}
    groups = {"posterior": posterior, "constant_data": constant, "observed_data": observed}
    return xr.DataTree.from_dict({name: xr.Dataset(group) for name, group in groups.items()})


@pytest.fixture(scope="module")
def tree() -> xr.DataTree:
    """Two draws that differ by 2 in the depth of the right knee, and by 0.6 and 0.8 across."""
    draws = np.stack([standing(), standing()])
    draws[1, RIGHT_KNEE] += [0.6, 0.8, 2.0]
    return small_tree(draws)


def text(table: tables.Sheet) -> str:
    stream = io.StringIO()
    Console(file=stream, width=80).print(table)
    return stream.getvalue()


def row(words: str, start: str) -> str:
    line = next(line for line in words.splitlines() if line.strip().startswith(start))
    return " ".join(line.split())


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        ((0, 0, -1), "towards camera"),
        ((1, 0, 0), "right"),
        ((0, 0, 1), "away"),
        ((-1, 0, 0), "left"),
        ((-0.89, 0.15, -0.44), "left"),
        ((1, 0, -1), "towards camera, right"),
        ((-1, 0, -1), "towards camera, left"),
        ((1, 0, 1), "away, right"),
        ((-1, 0, 1), "away, left"),
        ((0, 1, 0), "down"),
        ((0.1, -1, 0.1), "up"),
        ((-1e-9, 0, -1), "towards camera"),
        ((-1e-9, 0, 1), "away"),
    ],
)
def test_facing_in_words(vector: Sequence[float], words: str) -> None:
    assert tables.facing_words(np.array(vector)) == words


def test_a_pose_faces_where_its_candidate_does() -> None:
    facing = tables.pose_facing(standing())
    assert tables.facing_words(facing) == tables.facing_words(UPRIGHT[:, 2]) == "towards camera"


def test_posterior_rows_by_hand(tree: xr.DataTree) -> None:
    rows = {row["joint"]: row for row in tables.posterior_table(tree).json()}
    assert list(rows) == [name for name in JOINTS if name != "pelvis"]
    knee = rows["right_knee"]
    assert knee["seen"]
    assert knee["score"] == 0.8
    assert knee["radius_px"] == 7, "of the heaviest candidate"
    assert knee["depth_sd"] == pytest.approx(1)
    assert knee["lateral_sd"] == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert knee["depth_sd_mm"] == pytest.approx(MILLIMETRES)
    assert rows["right_wrist"] == rows["right_wrist"] | {
        "seen": False,
        "score": None,
        "radius_px": None,
    }
    assert rows["left_knee"]["depth_sd"] == pytest.approx(0)


def test_posterior_table_shows_the_rows(tree: xr.DataTree) -> None:
    words = text(tables.posterior_table(tree))
    assert row(words, "right knee") == "right knee 0.80 7.0 1.000 350 0.354 124"
    assert row(words, "right wrist").startswith("right wrist none – ")


def test_a_torso_that_is_held_fixed_says_so() -> None:
    """Not "0 mm"; limbs that happen to agree, a torso with two places, and one that is drawn with
    the pose, keep their numbers."""
    joints = np.random.default_rng(0).normal(size=(50, 15, 3))
    torso = [JOINTS.index(name) for name in ("pelvis", "thorax", "right_hip")]
    joints[:, torso] = joints[0, torso]
    joints[:, JOINTS.index("head")] = 1.0
    tree = small_tree(joints)
    words = text(tables.posterior_table(tree))
    assert words.count("held fixed") == 2 * 2  # in depth and across, of thorax and right hip
    assert row(words, "thorax").endswith("held fixed held fixed")
    assert row(words, "head").endswith("0.000 0 0.000 0")
    rows = {one["joint"]: one["held_fixed"] for one in tables.posterior_table(tree).json()}
    assert [name for name, held in rows.items() if held] == ["thorax", "right_hip"]
    one = small_tree(joints[:1])
    assert row(text(tables.posterior_table(one)), "head").endswith("0.000 0 0.000 0")
    tree.attrs["root"] = "uncertain"
    assert "held fixed" not in text(tables.posterior_table(tree))


def test_body_unit_in_millimetres_is_the_mean_limb_of_a_person_of_170_cm() -> None:
    shares = (0.186, 0.146, 0.245, 0.246)
    assert pytest.approx(1700 * np.mean(shares), abs=0.5) == MILLIMETRES


def test_without_draws_there_are_no_deviations(tree: xr.DataTree) -> None:
    empty = small_tree(np.empty((0, 15, 3)))
    assert all(row["depth_sd"] is None for row in tables.posterior_table(empty).json())
    assert row(text(tables.posterior_table(empty)), "right knee").endswith("7.0 – – – –")


def test_candidates_by_hand(tree: xr.DataTree) -> None:
    first, second = tables.candidates_table(tree).json()
    assert first["facing"] == "towards camera"
    assert second["facing"] == "right"
    assert first["log_evidence"] is None, "JSON has no infinity"
    assert first["log_evidence_se"] is None
    assert second == {
        "candidate": 1,
        "torso": 42,
        "facing": "right",
        "scale_px": 29.0,
        "reprojection_error_px": 3.6,
        "log_evidence": -16.25,
        "log_evidence_se": 0.03,
        "weight": 0.75,
    }
    assert (
        row(text(tables.candidates_table(tree)), "2 ") == "2 right 42 29.0 3.6 −16.25 ± 0.03 75 %"
    )


def test_hypotheses_rows() -> None:
    turned = standing() * [-1, 1, -1]  # turned by 180° about the vertical
    two = [Hypothesis(standing(), 0.996, 7), Hypothesis(turned, 0.004, 9)]
    rows = tables.hypotheses_table(two).json()
    assert [row["facing"] for row in rows] == ["towards camera", "away"]
    assert [row["draw"] for row in rows] == [7, 9]
    assert rows[0]["depth"] == pytest.approx(
        {"right_wrist": -0.1, "left_wrist": -0.1, "right_ankle": 0.1, "left_ankle": 0.1}
    )
    words = text(tables.hypotheses_table(two))
    assert row(words, "1 ") == "1 100 % 7 towards camera −0.10 −0.10 +0.10 +0.10"
    assert row(words, "2 ").startswith("2 < 1 % ")


ATTRIBUTES: dict[str, Any] = {
    "source": "walk.json",
    "person": 0,
    "sampler": "rejection",
    "seed": "0 7",
    "num_proposals": 589824,
    "acceptance_rate": 0.0017,
    "log_evidence": -16.68,
    "log_evidence_se": 0.031,
    "wall_time_s": 9.25,
    "limits": "my limits " + "7793d399517d" * 5 + "abcd",
    "measures": "upper angle, lower area",
}


def result(tree: xr.DataTree, **changes: Any) -> Result:
    copy = tree.copy()
    copy.attrs.update(ATTRIBUTES | changes)
    return Result(copy, "complete")


def test_summary_by_hand(tree: xr.DataTree) -> None:
    given = tables.summary_json(result(tree))
    assert given["num_draws"] == 2
    assert given["limits"] == "my limits", "names may hold spaces"
    assert given["limits_sha256"].startswith("7793d399517d")
    lines = tables.summary_lines(result(tree))
    assert lines == [
        "2 draws by rejection in 9.2 s",
        "589,824 proposals, 0.17 % accepted",
        "log evidence −16.68 ± 0.03: one possible pose in 2e7 explains the joints seen",
        "limits my limits (7793d399517d), upper angle, lower area, seed 7",
    ]
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("log_evidence", "words"),
    [
        (-math.log(50), "one possible pose in 50 "),
        (-math.log(1.96e7), "in 2e7 "),
        (-math.log(9.7e7), "in 1e8 "),
        (-2000.0, "in 4e868 "),
    ],
)
def test_evidence_as_odds(tree: xr.DataTree, log_evidence: float, words: str) -> None:
    assert words in tables.summary_lines(result(tree, log_evidence=log_evidence))[2]


def test_summary_of_an_incomplete_run_says_why(tree: xr.DataTree) -> None:
    base = result(tree, log_evidence=-math.inf, log_evidence_se=math.inf)
    broken = Result(base.tree, "impossible", "no pose explains it")
    lines = tables.summary_lines(broken)
    assert lines[2] == "log evidence –"
    assert lines[-1] == "impossible: no pose explains it"
    assert tables.summary_json(broken)["log_evidence"] is None


def verdict(*broken: tuple[int, str, int, float]) -> Check:
    limit, excess = np.zeros((3, 9), int), np.zeros((3, 9))
    for pose, bone, code, far in broken:
        limit[pose, BONE_NAMES.index(bone)], excess[pose, BONE_NAMES.index(bone)] = code, far
    return Check(limit == 0, limit, excess)


def test_check_rows_by_hand() -> None:
    check = verdict(
        (1, "right_upper_arm", 1, 12.34),
        (1, "right_forearm", 2, math.nan),
        (2, "left_lower_leg", 3, 4.0),
    )
    rows = tables.check_json(check, ["a", "b", "c"])
    assert [row["possible"] for row in rows] == [True, False, False]
    assert rows[1]["broken"] == [
        {"bone": "right_upper_arm", "limit": "occupancy", "excess_degrees": 12.34},
        {"bone": "right_forearm", "limit": "parent", "excess_degrees": None},
    ]
    words = text(tables.check_table(check, ["a", "b", "c"]))
    assert "1 of 3 poses are possible." in words
    assert row(words, "c ") == "c left lower leg bends beyond the joint's plane 4.0"
    assert "right forearm     hangs from an impossible bone" in words


def test_check_of_one_pose_and_of_real_limits() -> None:
    check = AnatomicalLimits.default().check(standing())
    (only,) = tables.check_json(check, ["standing"])
    assert only["possible"] == bool(check.pose_valid)
    assert len(only["broken"]) == len(check.sentences())


def test_as_many_names_as_poses() -> None:
    with pytest.raises(ValueError, match="zip"):
        tables.check_json(verdict(), ["a", "b"])


def test_everything_fits_a_terminal_and_is_json(tree: xr.DataTree) -> None:
    check, names = verdict((0, "left_upper_leg", 1, 123.4)), ["x" * 200, "b", "c"]
    mirrored = Hypothesis(standing() @ np.diag([-1.0, 1, -1]), 1.0, 1_234_567)
    for sheet in (
        tables.posterior_table(tree),
        tables.candidates_table(tree),
        tables.hypotheses_table([mirrored]),
        tables.check_table(check, names),
        tables.broken_table(check),
    ):
        assert max(map(len, text(sheet).splitlines())) <= 80
        json.dumps(sheet.json(), allow_nan=False)
    json.dumps(tables.check_json(check, names), allow_nan=False)
    json.dumps(tables.summary_json(result(tree)), allow_nan=False)


SHEET = tables.sheet_of(
    ("", tables.Column("how", left=True), "error", "frames"),
    [
        ("one", "well", Interval(1.25, 1.0, 1.5), 1234),
        ("two", "badly", Interval(math.nan, math.nan, math.nan), None),
        ("three", "once", Interval(2.0, math.nan, math.nan), 5),
    ],
    title="Errors",
    caption="In mm.",
)
"""Words, numbers, intervals, and what there is none of."""


def test_a_relation_of_no_frames_has_no_numbers() -> None:
    unknown = Relation("any", "7 %", Interval(np.nan, np.nan, np.nan), 0.0, 1.0, "share", 0)
    rows = relations_table([unknown]).json()
    assert rows[0]["found (95 % interval)"] == "–"
    known = unknown._replace(found=Interval(0.1, -0.05, 0.2), frames=9)
    assert relations_table([known]).json()[0]["found (95 % interval)"] == "+10.0 % (−5.0 to +20.0)"


def test_a_sheet_as_markdown() -> None:
    table = """|  | how | error | frames |
| --- | --- | ---: | ---: |
| one | well | 1.2 ± 0.2 | 1,234 |
| two | badly | – | – |
| three | once | 2.0 | 5 |

*In mm.*"""
    assert SHEET.markdown() == table
    assert SHEET.markdown(titled=True) == "### Errors\n\n" + table
    assert SHEET._repr_markdown_() == SHEET.markdown(titled=True), "in a notebook"


def test_a_sheet_as_csv_has_intervals_in_three_columns() -> None:
    assert SHEET.csv() == (
        ",how,error,error low,error high,frames\n"
        "one,well,1.25,1,1.5,1234\ntwo,badly,,,,\nthree,once,2,,,5\n"
    )


def test_a_sheet_as_json_holds_values_and_none() -> None:
    one, two, _ = SHEET.json()
    interval = {"value": 1.25, "low": 1.0, "high": 1.5}
    assert one == {"name": "one", "how": "well", "error": interval, "frames": 1234}
    assert two["error"] == {"value": None, "low": None, "high": None}
    json.dumps(SHEET.json(), allow_nan=False)


def test_a_sheet_on_a_terminal() -> None:
    words = text(SHEET)
    assert words.startswith("Errors")
    assert "In mm." in words
    assert row(words, "one") == "one well 1.2 ± 0.2 1,234"
    assert "badly" not in text(SHEET.only(["", "error"]))


def test_columns_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="two columns of one name: name, ratio, ratio"):
        tables.sheet_of(("", "ratio", "ratio"), [])


def test_rows_are_as_long_as_the_head() -> None:
    with pytest.raises(ValueError, match="zip"):
        tables.sheet_of(("", "ratio"), [("one", 1, 2)])


def test_a_side_without_draws_has_a_scale_and_no_spread() -> None:
    assert posterior._scale({"scale_px": 111.9, "scale_sd_px": None}) == "112"
    assert posterior._scale({"scale_px": 111.9, "scale_sd_px": 3.4}) == "112 ± 3"


def test_a_head_s_end_is_not_called_missing() -> None:
    """Nose, eyes and ears may be seen where the head's end is not."""
    assert undetected("head") == "head's end"
    assert undetected("right_wrist") == "right wrist"


def test_sides_and_sentences_say_where_chests_face() -> None:
    """A side's average, and shares of draws: of three draws of one side one faces elsewhere."""
    left = standing() @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    tree = small_tree(np.stack([standing(), standing(), left]))
    assert len({tables.facing_words(tables.pose_facing(one)) for one in (standing(), left)}) == 2
    tree.attrs["log_evidence"] = np.nan
    (sentence, *_) = facing_sentences(tree)
    other = tables.facing_words(tables.pose_facing(left))
    assert f"by share of the draws: towards camera 67 %; {other} 33 %." in sentence


def test_frames_with_left_and_right_exchanged_are_told_in_stretches() -> None:
    """By person, in the order of their frames; what is not more probable than not is left out."""
    names = [f"{frame:02}/0" for frame in range(6)] + ["00/1", "01/1"]
    legs, body = np.eye(6)[2], np.eye(6)[5]
    none = np.eye(6)[0]
    share = np.array([none, legs, 0.9 * legs + 0.1 * none, body, none, legs, 0.4 * legs, legs])
    share[4] = np.nan  # a law without exchanges, or no pose
    outlier = np.zeros((8, NUM_JOINTS))
    outlier[[1, 2, 3], [4, 4, 7]] = 0.8
    summary = film_tree(names)["summary"].to_dataset()
    summary["exchange"].values[:] = share
    summary["outlier"].values[:] = outlier
    assert misread(summary) == [
        Misread("01/0", "02/0", "legs", pytest.approx(0.9), 2),
        Misread("03/0", "03/0", "body", 1.0, 1),
        Misread("05/0", "05/0", "legs", 1.0, 1),
        Misread("01/1", "01/1", "legs", 1.0, 1),
    ]
    assert fault_lines(summary) == [
        "left and right are exchanged in 5 frames: 01/0 to 02/0 (legs, 90 %), 03/0 (body, 100 %),"
        " 05/0 (legs, 100 %), 01/1 (legs, 100 %)",
        f"3 keypoints probably wrong, the {JOINTS[4].replace('_', ' ')} most often (2 frames)",
    ]
    summary["exchange"].values[:] = none
    summary["outlier"].values[:] = 0.0
    assert not fault_lines(summary)
