"""Tables of one person's posterior: hypotheses, joints, candidates; and its summary.

Lengths are in body units, with millimetres of a person of 1.7 m beside them. Every table fits 80
columns.
"""

import functools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.errors.faults import EXCHANGES
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, TORSO_INDEX
from poseterior.reports.tables.sheet import (
    NOTHING,
    Column,
    Record,
    Sheet,
    fixed,
    number,
    percent,
    plus_minus,
    signed,
)
from poseterior.reports.tables.words import facing_words, pose_facing, spoken, undetected

if TYPE_CHECKING:
    from poseterior.inference.hypothesis import Hypothesis
    from poseterior.inference.results import Result

UNIT_NOTE = f"1 body unit = mean limb length, about {MILLIMETRES:.0f} mm for a person of 1.7 m"
STILL = 1e-9
"""Body units within which nothing moves: rounding, not spread."""
HELD = "held fixed"
LIKELY_FAULT = 0.5
"""Posterior probability above which a fault of the detector is spoken of."""
_ENDS = ("right_wrist", "left_wrist", "right_ankle", "left_ankle")


def values(tree: xr.DataTree, group: str, name: str) -> np.ndarray:
    """The array of a variable; for those of the posterior, chains and draws are joined: `(draws,
    …)`."""
    array = np.asarray(tree.children[group].dataset[name].values)
    return array.reshape(-1, *array.shape[2:]) if group in ("posterior", "sample_stats") else array


def heaviest(tree: xr.DataTree) -> int:
    """Index of the candidate with the largest share of the posterior."""
    return int(np.argmax(values(tree, "constant_data", "weight")))


def still(tree: xr.DataTree) -> np.ndarray:
    """`(15,)`: joints of the torso that are in one place in all draws, because the root that they
    belong to is held fixed."""
    joints = values(tree, "posterior", "joints")
    if is_uncertain(tree) or not len(joints):
        return np.zeros(len(JOINTS), bool)
    torso = np.isin(np.arange(len(JOINTS)), TORSO_INDEX)
    return torso & (np.ptp(joints, axis=0).max(axis=1) <= STILL)


def projected(tree: xr.DataTree, hypotheses: Sequence["Hypothesis"]) -> np.ndarray:
    """`(k, 15, 2)` pixels: where hypotheses of a result fall in the image, each seen by its own
    camera."""
    drawn = values(tree, "posterior", "keypoints")
    own = [drawn[one.draw] if one.keypoints is None else one.keypoints for one in hypotheses]
    return np.array(own).reshape(-1, len(JOINTS), 2)


def hypotheses_table(hypotheses: Sequence["Hypothesis"]) -> Sheet:
    """Each hypothesis: its share of the draws, its draw, where it faces, and the depth of its
    wrists and ankles."""
    records = [
        {
            "hypothesis": rank,
            "weight": float(hypothesis.weight),
            "draw": int(hypothesis.draw),
            "facing": facing_words(pose_facing(hypothesis.joints)),
            "depth": {name: float(hypothesis.joints[JOINT_INDEX[name], 2]) for name in _ENDS},
        }
        for rank, hypothesis in enumerate(hypotheses, 1)
    ]
    columns = [
        Column("", "hypothesis"),
        Column("share", "weight", percent),
        Column("draw", form=str),
        Column("faces", "facing", left=True, whole=True),
        *(_depth(name) for name in _ENDS),
    ]
    caption = "Wrists and ankles: depth behind the pelvis, body units (− is in front of it)."
    if any(one.keypoints is not None for one in hypotheses):
        caption += " Composed of limbs of draws; the draw nearest to each is named."
    return Sheet(columns, records, "Hypotheses", caption)


def _depth(name: str) -> Column:
    head = spoken(name).replace("right", "R").replace("left", "L")
    return Column(head, lambda record: record["depth"][name], signed)


def posterior_table(tree: xr.DataTree) -> Sheet:
    """Each joint but the pelvis: its score, τ under the heaviest candidate, and the posterior's
    standard deviations of its depth and of its place across the image, relative to the pelvis."""
    joints = values(tree, "posterior", "joints")
    score = values(tree, "observed_data", "score")
    radius = values(tree, "constant_data", "radius")[heaviest(tree)]
    spread = joints.std(axis=0) if len(joints) else np.full(joints.shape[1:], np.nan)
    lateral = np.sqrt((spread[:, :2] ** 2).mean(axis=1))
    fixed_joints = still(tree)
    faults = faults_of(tree)
    records = [
        {
            "joint": name,
            "seen": bool(score[joint] > 0),
            "score": number(score[joint]) if score[joint] > 0 else None,
            "radius_px": number(radius[joint]),
            "held_fixed": bool(fixed_joints[joint]),
            "depth_sd": number(spread[joint, 2]),
            "depth_sd_mm": number(spread[joint, 2] * MILLIMETRES),
            "lateral_sd": number(lateral[joint]),
            "lateral_sd_mm": number(lateral[joint] * MILLIMETRES),
            **({"outlier": faults.outlier[name]} if faults else {}),
        }
        for joint, name in enumerate(JOINTS)
        if name != "pelvis"
    ]
    columns = [
        Column("joint", _spoken_joint, left=True),
        Column("score", form=lambda score: "none" if score is None else f"{score:.2f}"),
        Column("τ px", "radius_px", fixed(1)),
        Column("sd of depth", _unless_held("depth_sd", HELD), _spread),
        Column("mm", _unless_held("depth_sd_mm", ""), _whole),
        Column("sd across", _unless_held("lateral_sd", HELD), _spread),
        Column("mm", _unless_held("lateral_sd_mm", ""), _whole),
        *([Column("wrong", "outlier", percent)] if faults else []),
    ]
    wrong = " wrong: that its keypoint is an outlier." if faults else ""
    lost = " none: not detected." if (score[1:] <= 0).any() else ""
    caption = f"sd: standard deviation relative to the pelvis.{lost} {UNIT_NOTE}.{wrong}"
    return Sheet(columns, records, "Posterior, joint by joint", caption)


def _spoken_joint(record: Record) -> str:
    return spoken(record["joint"]) if record["seen"] else undetected(record["joint"])


class FaultProbabilities(NamedTuple):
    """Posterior probabilities of a detector's faults: that each joint's keypoint is an `outlier`,
    and of each `exchange` of left and right, by name."""

    outlier: dict[str, float]
    exchange: dict[str, float]

    @property
    def lines(self) -> list[str]:
        """What is more probable than not, in words."""
        found = [
            f"the {spoken(joint)}'s keypoint is an outlier ({100 * share:.0f} %)"
            for joint, share in self.outlier.items()
            if share > LIKELY_FAULT
        ]
        return found + [
            f"left and right are exchanged: {name} ({100 * share:.0f} %)"
            for name, share in self.exchange.items()
            if share > LIKELY_FAULT and name != "none"
        ]


def faults_of(tree: xr.DataTree) -> FaultProbabilities | None:
    """The faults of a posterior that may have some; None where there are no draws or no faults."""
    if "outlier" not in tree["posterior"] or not tree["posterior"].sizes["draw"]:
        return None
    outlier = values(tree, "posterior", "outlier").mean(axis=0)
    exchange = values(tree, "posterior", "exchange")
    counts = np.bincount(exchange.astype(int), minlength=len(EXCHANGES))
    return FaultProbabilities(
        dict(zip(JOINTS, outlier.tolist(), strict=True)),
        dict(zip(EXCHANGES, (counts / len(exchange)).tolist(), strict=True)),
    )


def _unless_held(key: str, instead: str) -> Callable[[Record], float | str | None]:
    """A number of the record, or words where the joint is held fixed."""
    return lambda record: instead if record["held_fixed"] else record[key]


def _spread(value: float | str | None) -> str:
    return value if isinstance(value, str) else fixed(3)(value)


def _whole(value: float | str | None) -> str:
    return value if isinstance(value, str) else fixed(0)(value)


def candidates_table(tree: xr.DataTree) -> Sheet:
    """What there is to say of torso and camera: `sides_table` where they are uncertain, else
    `fixed_table`."""
    return sides_table(tree) if is_uncertain(tree) else fixed_table(tree)


def is_uncertain(tree: xr.DataTree) -> bool:
    """Whether torso and camera were drawn with the poses."""
    return tree.attrs.get("root") == UNCERTAIN


def sides_table(tree: xr.DataTree) -> Sheet:
    """Each way the person may face: how many torsos it has, its mean scale with the standard
    deviation, by how much the camera's rotation scatters, log evidence with standard error, and
    share of the posterior."""
    names = {
        "torsos": "num_torsos",
        "scale_px": "scale",
        "scale_sd_px": "scale_sd",
        "turn_sd_degrees": "turn_sd",
        "log_evidence": "log_evidence",
        "log_evidence_se": "log_evidence_se",
        "weight": "weight",
    }
    columns = {key: values(tree, "constant_data", name) for key, name in names.items()}
    records = [
        {
            "candidate": index,
            "facing": facing_words(facing),
            **{key: number(column[index]) for key, column in columns.items()},
        }
        for index, facing in enumerate(_mean_facings(tree))
    ]
    shown = [
        Column("", "candidate", form=lambda index: str(index + 1)),
        Column("faces on average", "facing", left=True, whole=True),
        Column("torsos", form=fixed(0)),
        Column("px", _scale, str, whole=True),
        Column("turn", "turn_sd_degrees", fixed(0, "°")),
        Column("log evidence", _evidence, plus_minus, whole=True),
        Column("share", "weight", percent),
    ]
    effective = tree.attrs["effective_roots"]
    weighed = tree.attrs["num_roots"]
    done = "weighed" if "roots" in tree.children else "drawn"
    caption = (
        f"Torso and camera are uncertain: {effective:,.0f} effective of {weighed:,} roots {done},"
        " each counted to the side it faces; a hypothesis may face another way than its side does"
        " on average. px: a body unit, in pixels; ± and turn: standard deviations."
    )
    return Sheet(shown, records, "Torso and camera", caption)


def _mean_facings(tree: xr.DataTree) -> np.ndarray:
    """`(sides, 3)`: where chests of each side's draws point on average; of a side without draws,
    where its torso does."""
    chests = pose_facing(values(tree, "posterior", "joints"))
    side = values(tree, "posterior", "candidate")
    torso = values(tree, "constant_data", "rotation")[:, :, 2]
    return np.array(
        [
            chests[side == index].mean(axis=0) if (side == index).any() else facing
            for index, facing in enumerate(torso)
        ]
    )


def _scale(row: Record) -> str:
    """Mean and standard deviation; a side without draws has no spread."""
    mean = fixed(0)(row["scale_px"])
    spread = row["scale_sd_px"]
    return mean if spread is None else f"{mean} ± {spread:.0f}"


def fixed_table(tree: xr.DataTree) -> Sheet:
    """Each candidate: its torso, where it faces, its scale, reprojection error, log evidence with
    standard error, and its share of the posterior."""
    rotation = values(tree, "constant_data", "rotation")
    variables = {
        "scale_px": "scale",
        "reprojection_error_px": "reprojection_error",
        "log_evidence": "log_evidence",
        "log_evidence_se": "log_evidence_se",
        "weight": "weight",
    }
    numbers = {key: values(tree, "constant_data", name) for key, name in variables.items()}
    records = [
        {
            "candidate": index,
            "torso": int(torso),
            "facing": facing_words(rotation[index, :, 2]),
            **{key: number(column[index]) for key, column in numbers.items()},
        }
        for index, torso in enumerate(values(tree, "constant_data", "torso_index"))
    ]
    columns = [
        Column("", "candidate", form=lambda index: str(index + 1)),
        Column("faces", "facing", left=True, whole=True),
        Column("torso", form=lambda index: NOTHING if index < 0 else str(index)),
        Column("px/unit", "scale_px", fixed(1)),
        Column("error px", "reprojection_error_px", fixed(1)),
        Column("log evidence", _evidence, plus_minus),
        Column("share", "weight", percent),
    ]
    return Sheet(columns, records, "Candidates: torso and camera")


def _evidence(record: Record) -> tuple[float | None, float | None]:
    return record["log_evidence"], record["log_evidence_se"]


def facing_sentences(tree: xr.DataTree) -> list[str]:
    """Which ways the person may face, how much speaks for each, and how surprising the detection
    is."""
    counts = Counter(map(facing_words, pose_facing(values(tree, "posterior", "joints"))))
    ways = [f"{words} {percent(n / counts.total())}" for words, n in counts.most_common()]
    single = len(values(tree, "constant_data", "weight")) == 1
    open_way = (
        "Torso and camera are drawn with the pose"
        if is_uncertain(tree)
        else (
            "Torso and camera are held fixed at an estimator's"
            f" {'candidate' if single else 'candidates'}"
        )
    )
    facing = f" Where the chest faces, by share of the draws: {'; '.join(ways)}." if ways else ""
    found = [f"{open_way}.{facing}"]
    evidence = number(tree.attrs["log_evidence"])
    if evidence is not None and not is_uncertain(tree):
        found.append(f"Log evidence {plus_minus((evidence, None))}{_odds(evidence)}.")
    return found


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
        **_effective(given),
        "num_proposals": int(given["num_proposals"]),
        "acceptance_rate": number(given["acceptance_rate"]),
        "log_evidence": number(given["log_evidence"]),
        "log_evidence_se": number(given["log_evidence_se"]),
        "wall_time_s": number(given["wall_time_s"]),
        "limits": limits,
        "limits_sha256": digest,
        "measures": str(given["measures"]),
        "moved": str(given.get("moved", "")).split(),
        **({"faults": faults._asdict()} if (faults := faults_of(result.tree)) else {}),
    }


def _seed(words: str) -> int:
    """The seed that a JAX key was made of, whose words of 32 bits these are."""
    return functools.reduce(lambda high, low: (high << 32) + int(low), words.split(), 0)


def summary_lines(result: "Result") -> list[str]:
    """The summary as lines of at most 80 columns (the sentence of a run that is not complete may be
    longer)."""
    row = summary_json(result)
    rate = row["acceptance_rate"]
    digest = row["limits_sha256"][:12]
    accepted = "" if rate is None else f", {100 * rate:.2g} % accepted"
    uncertain = row.get("root") == UNCERTAIN
    evidence = plus_minus(_evidence(row)) + ("" if uncertain else _odds(row["log_evidence"]))
    lines = [
        f"{row['num_draws']:,} draws by {row['sampler']} in {fixed(1)(row['wall_time_s'])} s",
        f"{row['num_proposals']:,} proposals{accepted}",
        f"log evidence {evidence}",
        f"limits {row['limits']} ({digest}), {row['measures']}, seed {_seed(row['seed'])}",
    ]
    if uncertain:
        roots = f"{row['effective_roots']:,.0f} effective roots of {row['num_roots']:,.0f}"
        roots += f", R-hat {row['rhat']:.3f}" if row.get("rhat") else ""
        lines[1] = f"{row['num_proposals']:,} proposals, {roots}"
    if moved := row["moved"]:
        lines.append(f"{' and '.join(moved)} moved from the midpoints that the detector gives")
    faults = faults_of(result.tree)
    lines += faults.lines if faults else []
    return lines + ([f"{row['status']}: {row['sentence']}"] if row["sentence"] else [])


def _effective(given: dict) -> dict[str, Any]:
    """What there is to say of an uncertain root: how many roots, and how many they are worth."""
    if given.get("root") != UNCERTAIN:
        return {}
    names = [name for name in ("num_roots", "effective_roots", "rhat") if name in given]
    return {"root": UNCERTAIN, **{name: number(given[name]) for name in names}}


def _odds(log_evidence: float | None) -> str:
    if log_evidence is None:
        return ""
    power = -log_evidence / math.log(10)  # not exponentiated as a whole: that may overflow
    exponent = math.floor(power)
    mantissa = round(10 ** (power - exponent))
    if mantissa == 10:
        mantissa = 1
        exponent = exponent + 1
    odds = f"{10**power:.0f}" if exponent < 3 else f"{mantissa}e{exponent}"
    return f": one possible pose in {odds} explains the joints seen"
