"""The focal length of a film whose frames were drawn before an unknown camera: one for all of its
frames.

Frames say with which focal lengths they go: by shares of their draws. Their errors last, so that
all together say as much as one of them (`coupling`): the film's probabilities are the geometric
mean of theirs, made to have sum one."""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax

UNSEEN = 0.5
"""Draws that every focal length has in every frame beyond its own (Jeffreys): none is impossible
because few draws have missed it."""


def film_lenses(frames: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Of frames whose draws have these focal lengths `(n,)`, those `(k,)` that the film may have,
    and their probabilities `(k,)`; a NaN where none is known."""
    focal = np.unique(np.concatenate(frames))  # one NaN, if any
    if len(focal) == 1:
        return focal, np.ones(1)
    counts = np.array([[np.count_nonzero(one == own) for own in focal] for one in frames])
    return focal, softmax(np.log(counts + UNSEEN).mean(axis=0))


def rows_of_lens(focal: np.ndarray, own: float, number: int) -> np.ndarray:
    """`number` rows of a frame's draws, whose focal lengths `(n,)` these are, that have one of the
    film's, or the next one that the frame has; again from the first where there are fewer."""
    if np.isnan(own):
        return np.resize(np.arange(len(focal)), number)
    away = np.abs(np.log(focal / own))
    return np.resize(np.flatnonzero(away == away.min()), number)
