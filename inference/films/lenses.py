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
    and their probabilities `(k,)`. A NaN where none was drawn: in weak perspective, and where each
    frame has a known one, but not all the same."""
    own = [np.unique(one[np.isfinite(one)]) for one in frames]
    focal = np.unique(np.concatenate(own))
    if max(map(len, own)) < 2:
        return focal if len(focal) == 1 else np.array([np.nan]), np.ones(1)
    counts = np.array([[np.count_nonzero(one == value) for value in focal] for one in frames])
    return focal, softmax(np.log(counts + UNSEEN).mean(axis=0))


def rows_of_lens(focal: np.ndarray, own: float, number: int) -> np.ndarray:
    """`number` rows of a frame's draws, whose focal lengths `(n,)` these are, that have one of the
    film's, or the next one that the frame has, if it has any; again from the first where there are
    fewer."""
    away = np.abs(np.log(focal / own))
    near = np.flatnonzero(away == np.nanmin(away)) if np.isfinite(away).any() else range(len(focal))
    return np.resize(near, number)
