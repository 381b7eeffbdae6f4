"""Who is who in a film: the same person is the same number in all frames.

    cast = cast_of((frame.name, frame.people) for frame in read_frames("walk/"))
    cast.numbers[3]         # of everyone in the fourth frame, in their order there

Where detections carry a track (`Detection.track`), it is followed. Those that carry none are
matched by continuity: whoever lies nearest to where a person was seen last, is that person. Both
can be wrong, and `doubts` says where they may be."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray

FARTHEST_MATCH = 1.0
"""How far, in sizes of a body, people come between two frames: a runner filmed five times a
second comes about as far."""
MOST_KNOWN = 64
"""People among whom somebody without a track is looked for: those who were seen last."""
MOST_PEOPLE_NAMED = 3
"""Frames that a doubt names."""


class Cast(NamedTuple):
    """The people of a film.

    Attributes
    ----------
    numbers
        For each frame the numbers of its people, in their order there. They count from 0 in the
        order in which people are first seen.
    tracks
        By number, the track that was followed; None where it was continuity alone.
    frames
        By number, in how many frames the person is.
    doubts
        Sentences: what was not followed, and where people may have been mistaken for each other.
    """

    numbers: list[list[int]]
    tracks: list[str | None]
    frames: list[int]
    doubts: list[str]

    @property
    def size(self) -> int:
        """How many people there are."""
        return len(self.tracks)


class _Seen(NamedTuple):
    """What is needed of a detection."""

    keypoints: FloatArray
    track: str | None


class _Frame(NamedTuple):
    name: str
    people: list[_Seen]


def cast_of(frames: Iterable[tuple[str, Sequence[Detection]]]) -> Cast:
    """Who is who.

    A film in which nobody carries a track and no two people are ever seen together is of one
    person. Tracks by which two people of a frame are the same, or which never recur, are not
    tracks, and are not followed.

    Parameters
    ----------
    frames
        The name of each frame and its people, in the order of time.

    Returns
    -------
    Cast
        A number for everyone in every frame.
    """
    film = [
        _Frame(name, [_Seen(one.keypoints, one.track) for one in people]) for name, people in frames
    ]
    doubts = _no_tracks(film)
    if doubts:
        film = [
            _Frame(name, [seen._replace(track=None) for seen in people]) for name, people in film
        ]
    tracked = any(seen.track is not None for _, people in film for seen in people)
    alone = not tracked and max((len(people) for _, people in film), default=0) <= 1
    followed = _Followed(np.inf if alone else FARTHEST_MATCH)
    numbers = [followed.frame(frame) for frame in film]
    counts = Counter(number for people in numbers for number in people)
    doubts += _said(film, followed, alone)
    tracks = [one.track for one in followed.known]
    return Cast(numbers, tracks, [counts[number] for number in range(len(tracks))], doubts)


def distances(earlier: Sequence[FloatArray], later: Sequence[FloatArray]) -> FloatArray:
    """`(n, m)`: how far people lie from where people lay earlier, in sizes of the larger of both.

    It is the mean over the joints that both have seen; of people without such, the distance of
    their middles; infinite where one has seen nothing.

    Parameters
    ----------
    earlier, later
        Keypoints `(15, 2)` of n and m people, NaN where missing.
    """
    return np.array([[_distance(a, b) for b in later] for a in earlier]).reshape(
        len(earlier), len(later)
    )


def _distance(a: FloatArray, b: FloatArray) -> float:
    seen = [points[np.isfinite(points).all(axis=1)] for points in (a, b)]
    if not (len(seen[0]) and len(seen[1])):
        return np.inf
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))) for points in seen)
    both = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if both.any():
        away = float(np.linalg.norm(a[both] - b[both], axis=1).mean())
    else:
        away = float(np.linalg.norm(seen[0].mean(axis=0) - seen[1].mean(axis=0)))
    return away / size if size > 0 else (0.0 if away == 0 else np.inf)


# --- tracks


def _no_tracks(film: Sequence[_Frame]) -> list[str]:
    """Why the tracks of a film are none, in a sentence; nothing where they may be followed, or
    there are none."""
    frames_of: dict[str, int] = {}
    for name, people in film:
        tracks = [seen.track for seen in people if seen.track is not None]
        twice = next((track for track in tracks if tracks.count(track) > 1), None)
        if twice is not None:
            return [
                f"two people of frame {name} carry the same track, {twice}: tracks are not followed"
            ]
        for track in tracks:
            frames_of[track] = frames_of.get(track, 0) + 1
    if len(film) > 2 and frames_of and max(frames_of.values()) == 1:
        return ["no track recurs in another frame: they are not those of people, nor followed"]
    return []


# --- continuity


@dataclass
class _Known:
    """A person: where and in which frame seen last."""

    keypoints: FloatArray
    track: str | None
    last: int


@dataclass
class _Followed:
    """People followed through frames that are given one after the other.

    Attributes
    ----------
    farthest
        How far people come between two frames, in sizes of a body.
    known
        Everybody, by number.
    near, exchanged, far
        The names of frames in which two people without tracks might be taken for each other; in
        which two tracks seem to have changed bodies; in which somebody is farther from where he was
        than people come.
    """

    farthest: float
    known: list[_Known] = field(default_factory=list)
    near: list[str] = field(default_factory=list)
    exchanged: list[str] = field(default_factory=list)
    far: list[str] = field(default_factory=list)
    _count: int = 0

    def frame(self, frame: _Frame) -> list[int]:
        """The numbers of the next frame's people."""
        of_track = {one.track: number for number, one in enumerate(self.known) if one.track}
        found: dict[int, int] = {}
        for place, seen in enumerate(frame.people):
            if seen.track in of_track:
                found[place] = of_track[seen.track]
        found |= self._nearest(frame, found)
        self._doubt(frame, found)
        for place, seen in enumerate(frame.people):
            number = found.setdefault(place, len(self.known))
            if number == len(self.known):
                self.known.append(_Known(seen.keypoints, seen.track, self._count))
            elif np.isfinite(seen.keypoints).any():
                track = seen.track or self.known[number].track
                self.known[number] = _Known(seen.keypoints, track, self._count)
        self._count += 1
        return [found[place] for place in range(len(frame.people))]

    def _nearest(self, frame: _Frame, found: dict[int, int]) -> dict[int, int]:
        """Of people whose track is new, or who have none: whom they continue, by place. One with a
        track continues nobody who has another."""
        places = [place for place in range(len(frame.people)) if place not in found]
        others = [number for number in self._latest() if number not in found.values()]
        if not places or not others:
            return {}
        from scipy.optimize import linear_sum_assignment

        people = [frame.people[place] for place in places]
        known = [self.known[number] for number in others]
        away = distances([one.keypoints for one in known], [one.keypoints for one in people])
        strangers = [[bool(one.track and seen.track) for seen in people] for one in known]
        allowed = (away <= self.farthest) & ~np.array(strangers)
        cost = np.where(allowed, away, 1e6)
        cost = np.where(np.isfinite(cost), cost, 1e3)
        pairs = zip(*linear_sum_assignment(cost), strict=True)
        return {places[col]: others[row] for row, col in pairs if allowed[row, col]}

    def _latest(self) -> list[int]:
        order = sorted(range(len(self.known)), key=lambda number: -self.known[number].last)
        return order[:MOST_KNOWN]

    def _doubt(self, frame: _Frame, found: dict[int, int]) -> None:
        """Notes whether any two of a frame could as well be each other."""
        before = [self.known[number].keypoints for number in found.values()]
        now = [frame.people[place].keypoints for place in found]
        tracked = [frame.people[place].track is not None for place in found]
        away = distances(before, now)
        for a, b in combinations(range(len(found)), 2):
            kept, exchanged = away[a, a] + away[b, b], away[a, b] + away[b, a]
            if tracked[a] and tracked[b] and 2 * exchanged < kept:
                _note(self.exchanged, frame.name)
            if not (tracked[a] and tracked[b]) and 2 * kept >= exchanged:
                _note(self.near, frame.name)
        leaps = np.diag(away)
        if ((leaps > FARTHEST_MATCH) & np.isfinite(leaps)).any():
            _note(self.far, frame.name)


def _note(names: list[str], name: str) -> None:
    if not names or names[-1] != name:
        names.append(name)


def _said(film: Sequence[_Frame], followed: _Followed, alone: bool) -> Iterator[str]:
    """The doubts of a film that was followed."""
    untracked = any(seen.track is None for _, people in film for seen in people)
    if untracked and not alone:
        yield (
            "not everybody carries a track: who is who is told by where people are, from frame to"
            " frame"
        )
    if followed.near:
        yield f"two people could be taken for each other in {_frames(followed.near)}"
    if followed.exchanged:
        yield f"tracks seem to change bodies in {_frames(followed.exchanged)}"
    if followed.far:
        yield (
            f"somebody is farther than a body's size from where he was last in"
            f" {_frames(followed.far)}: is it the same person?"
        )


def _frames(names: list[str]) -> str:
    more = len(names) - MOST_PEOPLE_NAMED
    said = ", ".join(names[:MOST_PEOPLE_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"frame {said}" if len(names) == 1 else f"frames {said}"
