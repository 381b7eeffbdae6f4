"""Measures between any joints, written as a function of their names: `angle(right_hip, right_knee,
right_ankle)`.

A name and joints in one pair of brackets, nothing else: an expression is looked up in a table, and
never run."""

import difflib
import functools
import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.measures.axes import UPWARD, across, angle_between, between
from poseterior.probmodel.measures.catalogue import MEASURES, height_above_feet
from poseterior.probmodel.measures.measure import Kind, Measure
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS

OWN = "as written"
ALONG_SIGHT = "depth"
"""The one function that means nothing without a camera."""
LONGEST_EXPRESSION = 200
"""Letters of an expression."""
_CALL = re.compile(r"\s*([a-z]+)\s*\(([a-z_\s,]*)\)\s*", re.ASCII)


class Function(NamedTuple):
    """What may stand in front of the brackets: how many joints it takes, how it is computed of
    poses and these joints' names, its kind, and what it means, in words."""

    joints: int
    of: Callable[..., np.ndarray]
    kind: Kind
    meaning: str


def _angle(joints: np.ndarray, first: str, corner: str, last: str) -> np.ndarray:
    return angle_between(between(joints, corner, first), between(joints, corner, last))


def _distance(joints: np.ndarray, first: str, second: str) -> np.ndarray:
    return np.linalg.norm(between(joints, first, second), axis=-1)


def _level(joints: np.ndarray, first: str, second: str) -> np.ndarray:
    return np.linalg.norm(across(between(joints, first, second), UPWARD), axis=-1)


def _inclination(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    return angle_between(between(joints, start, end), UPWARD)


def _depth(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    return between(joints, start, end)[..., 2]


FUNCTIONS = {
    "angle": Function(3, _angle, "angle", "at the second joint, between the other two"),
    "inclination": Function(
        2, _inclination, "angle", "of the line from the first to the second, 0 where it points up"
    ),
    "distance": Function(2, _distance, "length", "between two joints"),
    "level": Function(2, _level, "length", "between two joints, on the level"),
    "height": Function(1, height_above_feet, "length", "above the lower ankle, vertically"),
    ALONG_SIGHT: Function(
        2, _depth, "length", "of the second behind the first, along the camera's z"
    ),
}
"""By name, what expressions may ask for."""


def measure_of(text: str) -> Measure:
    """The measure of that name, or the one that an expression describes.

    Parameters
    ----------
    text
        A name of `MEASURES`, or one of `FUNCTIONS` with names of joints in brackets.

    Returns
    -------
    Measure
        With the expression, without blanks, for a name.

    Raises
    ------
    BadInput
        Where there is no such measure, function or joint, or joints are too few, too many or twice
        the same.
    """
    name = text.strip()
    if name in MEASURES:
        return MEASURES[name]
    if len(text) > LONGEST_EXPRESSION or not (call := _CALL.fullmatch(text)):
        raise BadInput(f"there is no measure {shown(name)}; {_nearest(name)}")
    word = call[1]
    given = [joint.strip() for joint in call[2].split(",")]
    if word not in FUNCTIONS:
        raise BadInput(
            f"{shown(name)} asks for {word}, which there is not; write {_one_of(FUNCTIONS)} in"
            " front of the brackets"
        )
    function = FUNCTIONS[word]
    for joint in given:
        if joint not in JOINT_INDEX:
            raise BadInput(
                f"{shown(name)} names a joint {shown(joint)}, which there is not; choose of"
                f" {', '.join(JOINTS)}"
            )
    if len(given) != function.joints or len(set(given)) < len(given):
        raise BadInput(
            f"{shown(name)} has {len(given)} joints; {word} takes {function.joints}, each another,"
            " with commas between them"
        )
    return Measure(
        f"{word}({','.join(given)})",
        functools.partial(_at, function.of, tuple(given)),
        function.kind,
        function.meaning,
        OWN,
    )


def _at(of: Callable[..., np.ndarray], names: tuple[str, ...], joints: np.ndarray) -> np.ndarray:
    return of(joints, *names)


def _nearest(name: str) -> str:
    """What to write instead."""
    near = difflib.get_close_matches(name, MEASURES, 3, 0.5)
    other = f"perhaps {_one_of(near)}" if near else f"give a name such as {next(iter(MEASURES))}"
    return f"{other}, or an expression such as angle(right_hip,right_knee,right_ankle)"


def _one_of(names: Iterable[str]) -> str:
    *some, last = names
    return f"{', '.join(some)} or {last}" if some else last
