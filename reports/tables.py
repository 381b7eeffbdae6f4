"""Tables of results for a terminal, and the same numbers as plain dictionaries for --json.

Each `…_table` returns a rich table that fits 80 columns; each `…_json` holds the same rows
unrounded, None where there is no number. Lengths are in body units, beside them millimetres of a
person of 1.7 m."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from rich import box
from rich.table import Table

from probmodel.skeleton import BONE_NAMES, JOINT_INDEX, JOINTS

if TYPE_CHECKING:
    from inference.hypothesis import Hypothesis
    from inference.results import Result
    from probmodel.anatomy.limits import Check

MILLIMETRES = 350.0
"""One body unit, the mean limb length, of a person of 1.7 m: upper arm, forearm, thigh and shank
are 0.186, 0.146, 0.245 and 0.246 of the stature (Drillis & Contini, Body segment parameters, 1966),
on average 0.206 · 1700 mm."""
UNIT_NOTE = f"1 body unit = mean limb length, about {MILLIMETRES:.0f} mm for a person of 1.7 m"
STEEP = math.cos(math.radians(30))
"""A chest that points closer than 30° to the vertical faces up or down rather than anywhere
sideways."""
_CARDINAL = ("towards camera", "right", "away", "left")
_NEAR = 30
"""Degrees around a cardinal direction that are called by its name alone."""
_NOTHING = "–"


def spoken(name: str) -> str:
    """A joint's or bone's name as words."""
    return name.replace("_", " ")


def values(tree: xr.DataTree, group: str, name: str) -> np.ndarray:
    """The array of a variable; those of the posterior with chains and draws joined, `(draws,
    …)`."""
    array = np.asarray(tree.children[group].dataset[name].values)
    return array.reshape(-1, *array.shape[2:]) if group in ("posterior", "sample_stats") else array


def facing_words(vector: np.ndarray) -> str:
    """Where a chest `(3,)` in camera axes points, as the picture shows it: "left", "away, right",
    "up" …"""
    x, y, z = (float(value) for value in vector)
    if abs(y) > STEEP * math.hypot(x, y, z):
        return "down" if y > 0 else "up"
    angle = math.degrees(math.atan2(x, -z)) % 360
    nearest = round(angle / 90)
    if abs(angle - 90 * nearest) <= _NEAR:
        return _CARDINAL[nearest % 4]
    sideways, depth = ("right" if x > 0 else "left"), ("away" if z > 0 else "towards camera")
    return f"{depth}, {sideways}"


def pose_facing(joints: np.ndarray) -> np.ndarray:
    """`(3,)`: where the chest of a pose `(15, 3)` points: leftwards × upwards, in right-handed
    axes."""
    at = {name: joints[index] for name, index in JOINT_INDEX.items()}
    left = at["left_shoulder"] - at["right_shoulder"] + at["left_hip"] - at["right_hip"]
    return np.cross(left, at["thorax"] - at["pelvis"])


def hypotheses_json(hypotheses: Sequence["Hypothesis"]) -> list[dict[str, Any]]:
    """Of each hypothesis its number, share of the draws, where it faces, and the depth of its
    wrists and ankles."""
    return [
        {
            "hypothesis": number,
            "weight": float(hypothesis.weight),
            "draw": int(hypothesis.draw),
            "facing": facing_words(pose_facing(hypothesis.joints)),
            "depth": {name: float(hypothesis.joints[JOINT_INDEX[name], 2]) for name in _ENDS},
        }
        for number, hypothesis in enumerate(hypotheses, 1)
    ]


_ENDS = ("right_wrist", "left_wrist", "right_ankle", "left_ankle")


def hypotheses_table(hypotheses: Sequence["Hypothesis"]) -> Table:
    """The rows of `hypotheses_json`; depth in body units, positive away from the camera."""
    table = _table(
        "Hypotheses",
        "Wrists and ankles: depth behind the pelvis, body units (− is in front of it).",
    )
    for heading in ("", "share", "draw"):
        table.add_column(heading, justify="right")
    table.add_column("faces", no_wrap=True)
    for name in _ENDS:
        table.add_column(spoken(name).replace("right", "R").replace("left", "L"), justify="right")
    for row in hypotheses_json(hypotheses):
        depths = [_signed(row["depth"][name]) for name in _ENDS]
        table.add_row(
            str(row["hypothesis"]),
            _percent(row["weight"]),
            str(row["draw"]),
            row["facing"],
            *depths,
        )
    return table


def posterior_json(tree: xr.DataTree) -> list[dict[str, Any]]:
    """Per joint but the pelvis: its score, τ under the heaviest candidate in pixels, and the
    posterior's standard deviations of its depth and of its place across the image, relative to the
    pelvis, in body units."""
    joints = values(tree, "posterior", "joints")
    score = values(tree, "observed_data", "score")
    radius = values(tree, "constant_data", "radius")[heaviest(tree)]
    spread = joints.std(axis=0) if len(joints) else np.full(joints.shape[1:], np.nan)
    lateral = np.sqrt((spread[:, :2] ** 2).mean(axis=1))
    return [
        {
            "joint": name,
            "seen": bool(score[joint] > 0),
            "score": _number(score[joint]) if score[joint] > 0 else None,
            "radius_px": _number(radius[joint]),
            "depth_sd": _number(spread[joint, 2]),
            "depth_sd_mm": _number(spread[joint, 2] * MILLIMETRES),
            "lateral_sd": _number(lateral[joint]),
            "lateral_sd_mm": _number(lateral[joint] * MILLIMETRES),
        }
        for joint, name in enumerate(JOINTS)
        if name != "pelvis"
    ]


def posterior_table(tree: xr.DataTree) -> Table:
    """The rows of `posterior_json`."""
    table = _table(
        "Posterior, joint by joint", f"sd: standard deviation relative to the pelvis. {UNIT_NOTE}."
    )
    table.add_column("joint")
    for heading in ("score", "τ px", "sd of depth", "mm", "sd across", "mm"):
        table.add_column(heading, justify="right")
    for row in posterior_json(tree):
        table.add_row(
            spoken(row["joint"]),
            _fixed(row["score"], 2) if row["seen"] else "missing",
            _fixed(row["radius_px"], 1),
            _fixed(row["depth_sd"], 3),
            _fixed(row["depth_sd_mm"], 0),
            _fixed(row["lateral_sd"], 3),
            _fixed(row["lateral_sd_mm"], 0),
        )
    return table


def heaviest(tree: xr.DataTree) -> int:
    """Index of the candidate with the largest share of the posterior."""
    return int(np.argmax(values(tree, "constant_data", "weight")))


def candidates_json(tree: xr.DataTree) -> list[dict[str, Any]]:
    """Per candidate: its torso, where it faces, its scale, reprojection error, log evidence with
    its standard error, and its share of the posterior."""
    rotation = values(tree, "constant_data", "rotation")
    columns = {
        "scale_px": "scale",
        "reprojection_error_px": "reprojection_error",
        "log_evidence": "log_evidence",
        "log_evidence_se": "log_evidence_se",
        "weight": "weight",
    }
    numbers = {key: values(tree, "constant_data", name) for key, name in columns.items()}
    return [
        {
            "candidate": index,
            "torso": int(torso),
            "facing": facing_words(rotation[index, :, 2]),
            **{key: _number(column[index]) for key, column in numbers.items()},
        }
        for index, torso in enumerate(values(tree, "constant_data", "torso_index"))
    ]


def candidates_table(tree: xr.DataTree) -> Table:
    """The rows of `candidates_json`."""
    table = _table("Candidates: torso and camera", "")
    table.add_column("", justify="right")
    table.add_column("faces", no_wrap=True)
    for heading in ("torso", "px/unit", "error px", "log evidence", "share"):
        table.add_column(heading, justify="right")
    for row in candidates_json(tree):
        table.add_row(
            str(row["candidate"] + 1),
            row["facing"],
            _NOTHING if row["torso"] < 0 else str(row["torso"]),
            _fixed(row["scale_px"], 1),
            _fixed(row["reprojection_error_px"], 1),
            _plus_minus(row["log_evidence"], row["log_evidence_se"]),
            _percent(row["weight"]),
        )
    return table


def summary_json(result: "Result") -> dict[str, Any]:
    """What was drawn, from what, by what, at what cost."""
    given = result.tree.attrs
    limits, _, digest = str(given["limits"]).rpartition(" ")
    return {
        "status": result.status,
        "sentence": result.sentence,
        "source": str(given["source"]),
        "person": int(given["person"]),
        "sampler": str(given["sampler"]),
        "seed": str(given["seed"]),
        "num_draws": result.num_draws,
        "num_proposals": int(given["num_proposals"]),
        "acceptance_rate": _number(given["acceptance_rate"]),
        "log_evidence": _number(given["log_evidence"]),
        "log_evidence_se": _number(given["log_evidence_se"]),
        "wall_time_s": _number(given["wall_time_s"]),
        "limits": limits,
        "limits_sha256": digest,
        "measures": str(given["measures"]),
    }


def summary_lines(result: "Result") -> list[str]:
    """The summary as lines of at most 80 columns (but for the sentence of a run that is not
    complete)."""
    row = summary_json(result)
    accepted = (
        "" if row["acceptance_rate"] is None else f", {100 * row['acceptance_rate']:.2g} % accepted"
    )
    lines = [
        f"{row['num_draws']:,} draws by {row['sampler']} in {_fixed(row['wall_time_s'], 1)} s",
        f"{row['num_proposals']:,} proposals{accepted}",
        (
            "log evidence"
            f" {_plus_minus(row['log_evidence'], row['log_evidence_se'])}{_odds(row['log_evidence'])}"
        ),
        (
            f"limits {row['limits']} ({row['limits_sha256'][:12]}), {row['measures']}, seed"
            f" {row['seed']}"
        ),
    ]
    return lines + ([f"{row['status']}: {row['sentence']}"] if row["sentence"] else [])


def _odds(log_evidence: float | None) -> str:
    if log_evidence is None:
        return ""
    power = -log_evidence / math.log(10)  # not exponentiated as a whole: that may overflow
    exponent = math.floor(power)
    mantissa = round(10 ** (power - exponent))
    if mantissa == 10:
        mantissa, exponent = 1, exponent + 1
    number = f"{10**power:.0f}" if exponent < 3 else f"{mantissa}e{exponent}"
    return f": one possible pose in {number} explains the joints seen"


def stream_json(summary: xr.Dataset) -> dict[str, Any]:
    """A stream of frames in numbers: how many came to what end, and each frame's evidence."""
    status, counts = np.unique(summary.status.values, return_counts=True)
    rows = zip(
        summary.frame.values,
        summary.status.values,
        summary.sentence.values,
        summary.num_draws.values,
        summary.log_evidence.values,
        strict=True,
    )
    frames = [
        {
            "frame": str(name),
            "status": str(end),
            "sentence": str(why),
            "num_draws": int(draws),
            "log_evidence": _number(evidence),
        }
        for name, end, why, draws, evidence in rows
    ]
    return {"status": dict(zip(map(str, status), map(int, counts), strict=True)), "frames": frames}


def stream_table(summary: xr.Dataset, most: int = 12) -> Table:
    """The first frames of a stream: evidence, and how uncertain the wrists' and ankles' depths
    are."""
    table = _table("Frames", f"sd: standard deviation of depth behind the pelvis. {UNIT_NOTE}.")
    for heading in ("frame", "draws", "log evidence", "wrists sd", "ankles sd", ""):
        table.add_column(heading, justify="left" if heading in ("frame", "") else "right")
    depth = summary.sd.sel(axis="z")
    for index in range(min(most, summary.sizes["frame"])):
        row = summary.isel(frame=index)
        ends = [
            depth.isel(frame=index).sel(joint=[f"right_{end}", f"left_{end}"]).values
            for end in ("wrist", "ankle")
        ]
        spread = ["/".join(_fixed(_number(value), 2) for value in pair) for pair in ends]
        evidence = _fixed(_number(row.log_evidence.item()), 1)
        said = "" if row.status == "complete" else str(row.status.item())
        table.add_row(str(row.frame.item()), f"{int(row.num_draws):,}", evidence, *spread, said)
    return table


def stream_lines(summary: xr.Dataset) -> list[str]:
    """How many frames came to what end, and the first reasons of those that brought nothing."""
    counts = stream_json(summary)["status"]
    lines = [
        f"{summary.sizes['frame']:,} frames: "
        + ", ".join(f"{number:,} {name}" for name, number in counts.items())
    ]
    failed = summary.isel(frame=np.flatnonzero(summary.status.values != "complete")[:3])
    return lines + [
        f"{name}: {why}"
        for name, why in zip(failed.frame.values, failed.sentence.values, strict=True)
    ]


def check_json(check: "Check", names: Sequence[str]) -> list[dict[str, Any]]:
    """Per pose: its name, whether it is possible, and which bone breaks which limit by how many
    degrees (None for a bone that hangs from an impossible one)."""
    from probmodel.anatomy.limits import LIMITS

    valid, limit, excess = (np.atleast_2d(array) for array in check)
    return [
        {
            "pose": name,
            "possible": bool(valid[pose].all()),
            "broken": [
                {
                    "bone": bone,
                    "limit": LIMITS[limit[pose, i]],
                    "excess_degrees": _number(excess[pose, i]),
                }
                for i, bone in enumerate(BONE_NAMES)
                if not valid[pose, i]
            ],
        }
        for pose, name in zip(range(len(valid)), names, strict=True)
    ]


_BREAKS = {
    "occupancy": "points outside its directions",
    "parent": "hangs from an impossible bone",
    "plane": "bends beyond the joint's plane",
    "box": "turns beyond the joint's range",
}


def check_table(check: "Check", names: Sequence[str]) -> Table:
    """One row for each broken limit; the caption says how many poses break none."""
    rows = check_json(check, names)
    table = _table(
        "Anatomical limits",
        f"{sum(row['possible'] for row in rows)} of {len(rows)} poses are possible.",
    )
    table.add_column("pose", overflow="fold")
    table.add_column("bone")
    table.add_column("breaks")
    table.add_column("by degrees", justify="right")
    for row in rows:
        for broken in row["broken"]:
            words = _BREAKS[broken["limit"]]
            table.add_row(
                row["pose"], spoken(broken["bone"]), words, _fixed(broken["excess_degrees"], 1)
            )
    return table


def _table(title: str, caption: str) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        caption=caption or None,
        caption_justify="left",
        caption_style="dim",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1),
    )


def _number(value: Any) -> float | None:
    """JSON has no word for NaN and infinity."""
    return float(value) if np.isfinite(value) else None


def _fixed(value: float | None, digits: int) -> str:
    return _NOTHING if value is None else f"{value:.{digits}f}"


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _percent(share: float | None) -> str:
    if share is None:
        return _NOTHING
    return "< 1 %" if 0 < share < 0.01 else f"{100 * share:.0f} %"


def _plus_minus(value: float | None, error: float | None) -> str:
    if value is None:
        return _NOTHING
    number = f"{value:.2f}".replace("-", "−")
    return number if error is None else f"{number} ± {error:.2f}"
