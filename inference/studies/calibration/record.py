"""Standings as a DataTree: `coverage.nc`, laid out as ArviZ looks for it.

`/simulation` has everything by instance, failures too; `/covariates` what is seen of each, by which
`coverage judge` says where truths are covered; `/prior_sbc` the levels of those that were judged,
with `chain` and `draw` as ArviZ's plots of calibration want them (a draw is a simulation).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.studies.calibration.assess import Standing
from poseterior.inference.studies.calibration.exclusions import Reason, as_text
from poseterior.inference.studies.calibration.quantities import (
    MOVING_NAMES,
    OF_BOTH,
    OF_POSE,
    OF_ROOT,
    QUANTITIES,
)
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.inference.studies.flips import FLIPPING
from poseterior.inference.studies.measured import MeasureStandings
from poseterior.probmodel.datasets import Case
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.skeleton import (
    JOINT_INDEX,
    JOINTS,
    LENGTH_GROUPS,
    NUM_JOINTS,
    TORSO_JOINTS,
)

SEEN_OF = ("shoulders", "forearms", "shins", "score", "hidden")
"""How long shoulders, the shorter forearm and the shorter shin look beside the torso, the least
score of a joint seen, and how many joints are not."""
DETECTOR = "detector"
"""Whose points they are, by the name of their layout."""
COVARIATES = (DETECTOR, *SEEN_OF, "nearest_limit")
JOINTWISE = ("whole", "lateral", "depth", "spread_lateral", "spread_depth")
SCALARS = ("status", "sentence", "num_draws", "log_evidence", "nearest_limit")


def standings_tree(
    standings: list[Standing],
    attributes: dict[str, Any],
    columns: dict[str, np.ndarray] | None = None,
) -> xr.DataTree:
    """The tree of `standings`; `columns` `(n,)` are further variables by simulation."""
    return coverage_tree(standings_table(standings, columns=columns), attributes)


def coverage_tree(simulation: xr.Dataset, attributes: dict[str, Any]) -> xr.DataTree:
    """The tree of a table of standings."""
    known = [name for name in COVARIATES if name in simulation]
    groups = {
        "simulation": simulation.drop_vars(known),
        "prior_sbc": levels(simulation),
        "covariates": simulation[known],
    }
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(attributes)
    return tree


def standings_table(
    standings: list[Standing], first: int = 0, columns: dict[str, np.ndarray] | None = None
) -> xr.Dataset:
    """Standings by simulation, numbered from `first`; `columns` `(n,)` are further variables."""
    data: dict[str, Any] = {
        name: (("simulation",), np.array([getattr(one, name) for one in standings]))
        for name in SCALARS
    }
    data["level"] = (("simulation", "quantity"), np.stack([one.level for one in standings]))
    data |= {
        name: (("simulation", "joint"), np.stack([getattr(one, name) for one in standings]))
        for name in JOINTWISE
    }
    data |= {
        f"measure_{name}": (
            ("simulation", "measure"),
            np.stack([getattr(one.measures, name) for one in standings]),
        )
        for name in MeasureStandings._fields
    }
    data["stand_in"] = (
        ("simulation", "replicate", "joint"),
        np.stack([one.stand_in for one in standings]),
    )
    coords = {
        "simulation": np.arange(first, first + len(standings)),
        "quantity": list(QUANTITIES),
        "joint": list(MOVING_NAMES),
        "measure": list(MEASURES),
    }
    data |= {name: (("simulation",), column) for name, column in (columns or {}).items()}
    return xr.Dataset(data, coords=coords)


def case_columns(
    cases: Sequence[Case], reasons: Sequence[Sequence[Reason]]
) -> dict[str, np.ndarray]:
    """The further variables of real poses: the recording, the body unit in mm, and why the truth is
    excluded, where it is."""
    return {
        "recording": np.array([case.recording for case in cases]),
        "unit_mm": np.array([case.unit for case in cases]),
        "reasons": np.array([as_text(one) for one in reasons]),
        **detected_columns([case.detection for case in cases]),
    }


def seen_columns(detections: Sequence[Detection]) -> dict[str, np.ndarray]:
    """What is seen of people, by the names of `SEEN_OF`."""
    seen = [as_seen(detection) for detection in detections]
    return {name: np.array([one[name] for one in seen]) for name in SEEN_OF}


def detected_columns(detections: Sequence[Detection]) -> dict[str, np.ndarray]:
    """As `seen_columns`, of people whom somebody detected: by `DETECTOR`, too."""
    detector = np.array([detection.layout for detection in detections])
    return {DETECTOR: detector} | seen_columns(detections)


def as_seen(detection: Detection) -> dict[str, float]:
    """What is seen of a person, by the names of `SEEN_OF`; 0 where nothing is."""
    places = np.where(detection.seen[:, None], detection.keypoints, np.nan)
    torso = _apart(places, "pelvis", "thorax")
    sizes = {
        "shoulders": [_apart(places, "right_shoulder", "left_shoulder")],
        "forearms": [
            _apart(places, f"{side}_elbow", f"{side}_wrist") for side in ("right", "left")
        ],
        "shins": [_apart(places, f"{side}_knee", f"{side}_ankle") for side in ("right", "left")],
    }
    found = {name: _least(np.array(values) / torso) for name, values in sizes.items()}
    hidden = NUM_JOINTS - int(detection.seen.sum())
    return found | {"score": _least(detection.score[detection.seen]), "hidden": hidden}


def _apart(places: np.ndarray, one: str, other: str) -> float:
    return float(np.linalg.norm(places[JOINT_INDEX[one]] - places[JOINT_INDEX[other]]))


def _least(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else 0.0


def levels(simulation: xr.Dataset) -> xr.Dataset:
    """The levels of the simulations that were judged, quantities of a kind together: `joints`
    `(chain, draw, joint, axis)`, `bone_length`, `away`, and those of pose and detection, and of the
    root, one by one, where they were looked at."""
    found = simulation["level"]
    judged = np.isfinite(found.values).any(axis=1)
    values = found.values[judged][None]
    joints, rest = np.split(values[..., : len(OF_POSE)], [3 * len(MOVING_NAMES)], axis=-1)
    data: dict[str, Any] = {
        "joints": (
            ("chain", "draw", "joint", "axis"),
            joints.reshape(*joints.shape[:2], len(MOVING_NAMES), 3),
        ),
        "bone_length": (("chain", "draw", "length_group"), rest[..., : len(LENGTH_GROUPS)]),
        "away": (("chain", "draw", "bone"), rest[..., len(LENGTH_GROUPS) :]),
    }
    for name in (*OF_BOTH, *OF_ROOT):
        column = values[..., QUANTITIES.index(name)]
        if np.isfinite(column).any():
            data[name.replace(" ", "_")] = (("chain", "draw"), column)
    coords = {
        "chain": [0],
        "draw": np.flatnonzero(judged),
        "joint": list(MOVING_NAMES),
        "axis": list("xyz"),
        "length_group": list(LENGTH_GROUPS),
        "bone": [bone.name for bone in FLIPPING],
    }
    return xr.Dataset(data, coords=coords)


def instances_tree(instances: Sequence[Instance]) -> xr.DataTree:
    """What samplers elsewhere need of simulations, by simulation: `observed_data` (keypoints,
    score), `constant_data` (the torso in camera axes, the camera's scale and translation, radii τ),
    and `truth`."""
    frames = [instance.frame for instance in instances]
    views = [frame.observation for frame in frames]
    names = {
        "simulation": np.arange(len(frames)),
        "joint": list(JOINTS),
        "axis": list("xyz"),
        "uv": list("uv"),
    }

    def rows(dims: tuple[str, ...], values: list) -> tuple[tuple[str, ...], np.ndarray]:
        return ("simulation", *dims), np.stack([np.asarray(value) for value in values])

    return xr.DataTree.from_dict(
        {
            "observed_data": xr.Dataset(
                {
                    "keypoints": rows(
                        ("joint", "uv"), [frame.detection.keypoints for frame in frames]
                    ),
                    "score": rows(("joint",), [frame.detection.score for frame in frames]),
                },
                coords=names,
            ),
            "constant_data": xr.Dataset(
                {
                    "torso": rows(("torso_joint", "axis"), [view.view for view in views]),
                    "scale": rows((), [float(view.root.camera.scale) for view in views]),
                    "translation": rows(("uv",), [view.root.camera.translation for view in views]),
                    "radius": rows(("joint",), [_radius(view) for view in views]),
                },
                coords=names | {"torso_joint": list(TORSO_JOINTS)},
            ),
            "truth": xr.Dataset(
                {"joints": rows(("joint", "axis"), [instance.joints for instance in instances])},
                coords=names,
            ),
        }
    )


def _radius(view: Observation) -> np.ndarray:
    """`(15,)` pixels, NaN where a joint does not count, as files have it."""
    reach = view.reach * np.asarray(view.root.camera.scale)
    return np.where(np.isfinite(reach), reach, np.nan)
