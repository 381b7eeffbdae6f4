"""Left and right that stay: in which frames of a film keypoints of one side stand under the names
of the other, as far as motion says it.

Keypoints that change their names jump, and jump back. So what is exchanged is a state of a chain in
time, and every three frames in succession are weighed by how far their keypoints, named as the
chain has it, lie from going straight on. What a frame says by itself comes to that where it is
drawn: the probabilities told here stand there in the place of those that the law has for any
frame."""

import math
from collections.abc import Iterable

import numpy as np
from scipy.special import expit, logit

from poseterior.inference.footage import FramesInMotion, Item
from poseterior.inference.stream import frame_and_person, in_time
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import EXCHANGES
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, LIMB_JOINTS, NUM_JOINTS

BENDS = {
    "shoulder": 0.0043,
    "elbow": 0.0067,
    "wrist": 0.0077,
    "hip": 0.0043,
    "knee": 0.0056,
    "ankle": 0.0047,
}
"""How far, along an axis, joints are from going straight on over two thirtieths of a second, body
units: scales of Student's law of `BENDS_FREEDOM` degrees of freedom, which has their medians and
about their tails; CMU motion capture, 95 recordings."""
BENDS_OF = 1 / 30
"""Seconds between the frames of which `BENDS` are, and the power of this time with which they grow:
they were fitted from 1/60 to 4/15 of a second."""
GROWTH, BENDS_FREEDOM = 1.3, 2.0
OVERLAP = 1 / 3
"""The power of every three frames' weight: each frame is in three of them, with the same errors.
Chosen on captured people, beside 1, 1/2 and 1/4 (reports/sides.md)."""
EXCHANGE_LASTS = 0.5
"""Seconds. Between 0.2 and 1.5 nothing depends on it."""
MOST_DECADES = 3.0
"""Powers of ten of odds: with less an exchange is not tried, and none is beyond doubt with more.
Other odds are rounded to the middle of theirs, since programs are compiled for each value; where
nothing can be exchanged a frame is drawn in three quarters of the time."""
_PAIRS = np.array([[JOINT_INDEX[f"{side}_{kind}"] for side in ("left", "right")] for kind in BENDS])
_MOVED = np.array([[kind in moved for kind in BENDS] for moved in EXCHANGES.values()], int)
"""`(6, 6)`: whether a kind of joint is exchanged, by exchange."""


def with_sides(
    items: Iterable[Item], rate: float, likelihood: Likelihood
) -> FramesInMotion | list[Item]:
    """Frames of one person that know how probable it is, by how keypoints move, that sides are
    exchanged in them.

    Parameters
    ----------
    items
        The frames; those that are detections are told.
    rate
        Frames a second, as their names number them.
    likelihood
        How detections err: which exchanges there are, how often, and for how long errors last; all
        errors are new in every frame where it does not say.

    Returns
    -------
    FramesInMotion or list of Item
        The same, in their order; untouched, and a list, where there are no exchanges, or no three
        frames with keypoints.
    """
    found = list(items)
    order, numbers = in_time([frame_and_person(item.name)[0] for item in found])
    seen = [
        (at, number, found[at].frame)
        for at, number in zip(order, numbers or range(len(order)), strict=True)
        if isinstance(found[at].frame, Detection)
    ]
    if not any(likelihood.faults.exchange) or len(seen) < 3:
        return found
    rows, counted, people = zip(*seen, strict=True)
    moments = np.array(counted) / rate
    keypoints = np.stack([person.keypoints for person in people])
    unit = _body_unit(keypoints)
    if unit == 0:
        return found
    weight = straightness(
        keypoints / unit,
        np.stack([_deviation(person, likelihood) for person in people]),
        moments,
        None if likelihood.learned is None else likelihood.learned.times,
    )
    probability = in_chain(weight, moments, likelihood.faults.exchange_probabilities)
    for row, each in zip(rows, probability, strict=True):
        found[row] = found[row]._replace(exchange=_rounded(each))
    return FramesInMotion(found, rate)


def _deviation(person: Detection, likelihood: Likelihood) -> np.ndarray:
    """`(15,)` body units: of errors each way; NaN of joints that do not count, and in a frame of
    which nothing can be drawn, which says nothing here either."""
    try:
        spread = likelihood.detected(person, TorsoCameraPrior.counted(likelihood.joints)).spread
    except BadInput:
        return np.full(NUM_JOINTS, np.nan)
    return np.where(np.isfinite(spread), np.asarray(spread) / 2, np.nan)


def straightness(
    keypoints: np.ndarray, deviation: np.ndarray, moments: np.ndarray, times: ErrorTimes | None
) -> np.ndarray:
    """How straight keypoints go on through three frames, whatever is exchanged in each.

    Parameters
    ----------
    keypoints : `(frames, 15, 2)`
        Body units, NaN where missing.
    deviation : `(frames, 15)`
        Of their errors each way.
    moments : `(frames,)`
        Seconds.
    times
        For how long errors last; None where all are new in every frame.

    Returns
    -------
    ndarray
        `(frames - 2, 6, 6, 6)`: weights by the exchanges of the three, one at most. A kind of joint
        that is not seen on both sides in all three says nothing.
    """
    before, after = np.diff(moments)[:-1], np.diff(moments)[1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # frames of one moment
        on = after / before
    each = np.stack([on, -1 - on, np.ones_like(on)], axis=1)
    lasting = _lasting(np.stack([moments[:-2], moments[1:-1], moments[2:]], axis=1), times)
    own = np.sqrt(np.square(deviation[:, _PAIRS]).mean(axis=-1))
    scaled = np.stack([own[:-2], own[1:-1], own[2:]], axis=1) * each[..., None]
    noise = np.einsum("tak,tab,tbk->tk", scaled, lasting, scaled)
    bends = np.array([*BENDS.values()]) * ((before + after)[:, None] / 2 / BENDS_OF) ** GROWTH
    # (frames, kinds, exchanged, sides, axes)
    pairs = np.stack([keypoints[:, _PAIRS], keypoints[:, _PAIRS[:, ::-1]]], axis=2)
    first, middle, last = (
        pairs[start : len(pairs) - 2 + start] * each[:, start, None, None, None, None]
        for start in range(3)
    )
    bend = first[:, :, :, None, None] + middle[:, :, None, :, None] + last[:, :, None, None]
    square = np.square(bend).sum(axis=-1) / (BENDS_FREEDOM * (bends**2 + noise))[..., *[None] * 4]
    log = -OVERLAP * (BENDS_FREEDOM + 2) / 2 * np.log1p(square).sum(axis=-1)
    log = np.where(np.isfinite(log).all(axis=(2, 3, 4), keepdims=True), log, 0.0)
    total = np.sum(
        [
            log[:, kind][:, moved[:, None, None], moved[:, None], moved]
            for kind, moved in enumerate(_MOVED.T)
        ],
        axis=0,
    )
    return np.exp(total - total.max(axis=(1, 2, 3), keepdims=True))


def in_chain(weight: np.ndarray, moments: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """The probabilities of exchanges in every frame, forwards and backwards in time (Rabiner 1989),
    by pairs of neighbours.

    Parameters
    ----------
    weight : `(frames - 2, 6, 6, 6)`
        Of `straightness`.
    moments : `(frames,)`
        Seconds.
    prior : `(6,)`
        In a frame of which nothing is known.

    Returns
    -------
    ndarray
        `(frames, 6)`.
    """
    stays = np.exp(-np.diff(moments) / EXCHANGE_LASTS)[:, None, None]
    step = stays * np.eye(len(prior)) + (1 - stays) * prior
    ahead = np.empty_like(step)
    ahead[0] = prior[:, None] * step[0]
    behind = np.ones_like(step)
    for row, three in enumerate(weight, 1):
        ahead[row] = step[row] * np.einsum("ab,abc->bc", ahead[row - 1], three)
        ahead[row] /= ahead[row].sum()
    for row in range(len(weight) - 1, -1, -1):
        behind[row] = np.einsum("abc,bc->ab", weight[row], step[row + 1] * behind[row + 1])
        behind[row] /= behind[row].sum()
    pair = ahead * behind
    pair /= pair.sum(axis=(1, 2), keepdims=True)
    return np.concatenate([pair[:1].sum(axis=2), pair.sum(axis=1)])


def _lasting(moments: np.ndarray, times: ErrorTimes | None) -> np.ndarray:
    """`(n, 3, 3)`: the correlations of a joint's errors at three moments `(n, 3)`."""
    if times is None:
        return np.broadcast_to(np.eye(3), (len(moments), 3, 3))
    apart = np.abs(moments[:, :, None] - moments[:, None])
    return times.constant + times.slow * np.exp(-apart / times.seconds) + times.quick * np.eye(3)


def _body_unit(keypoints: np.ndarray) -> float:
    """About how many pixels a body unit is: the mean length of limb bones, as if they pointed
    everywhere; 0 where none is seen."""
    ends = np.array([[bone.start, bone.end] for bone in BONES if bone.end in LIMB_JOINTS])
    length = np.linalg.norm(np.diff(keypoints[:, ends], axis=2)[:, :, 0], axis=-1)
    seen = length[np.isfinite(length)]
    return float(4 / math.pi * seen.mean()) if len(seen) else 0.0


def _rounded(probability: np.ndarray) -> tuple[float, ...]:
    """Those of all exchanges but "none", which remains possible; their odds rounded."""
    with np.errstate(divide="ignore"):
        decades = logit(np.clip(probability, 0.0, 1.0)) / math.log(10)
    most = MOST_DECADES - 0.5
    some = expit(math.log(10) * np.clip(np.floor(decades) + 0.5, -most, most))
    some[1:][decades[1:] < -MOST_DECADES] = 0.0
    return tuple((some[1:] / some.sum()).tolist())
