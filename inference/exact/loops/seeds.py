"""States of generators for many uses of one key: those that NumPy's SeedSequence
(O'Neill 2015) gives its SFC64, thousands at once, where NumPy makes them one by one.
Compiled; a test holds them to NumPy's bit for bit."""

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform

_POOL = 4
"""Words that all entropy is mixed into."""
_WARM = 12
"""Numbers that SFC64 is run on by before the first."""
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(16)
_IN = np.uint64(0x43B0D7E5)
_IN_STEP = np.uint64(0x931E8875)
_OUT = np.uint64(0x8B51F9DD)
_OUT_STEP = np.uint64(0x58F38DED)
_LEFT = np.uint64(0xCA01F9DD)
_RIGHT = np.uint64(0x4973F715)


def seeded(words: list[int], *path: int) -> np.ndarray:
    """`(4,)` uint64: a generator's state, for the words of a key and whole numbers that
    say what it is used for."""
    return seeded_rows(words, np.array([path]))[0]


def seeded_rows(words: list[int], paths: np.ndarray) -> np.ndarray:
    """`(n, 4)` uint64: the states for the words of a key and each of the `paths` `(n,
    k)`. Words and paths are of 32 bits."""
    entropy = np.zeros(max(len(words), _POOL) + paths.shape[1], np.uint64)
    entropy[: len(words)] = np.array(words, np.uint32)  # refuses what is longer
    states = np.empty((len(paths), 4), np.uint64)
    _seed_rows(entropy, paths, states)
    return states


@inlined
def _hashed(value: np.uint64, factor: np.uint64, step: np.uint64) -> tuple[np.uint64, np.uint64]:
    """A word after one round, and the next round's factor."""
    value ^= factor
    factor = factor * step & _LOW
    value = value * factor & _LOW
    return value ^ (value >> _HALF), factor


@inlined
def _mixed(one: np.uint64, other: np.uint64) -> np.uint64:
    value = (_LEFT * one - _RIGHT * other) & _LOW
    return value ^ (value >> _HALF)


@compiled
def _seed_rows(entropy: np.ndarray, paths: np.ndarray, states: np.ndarray) -> None:
    """Writes the states; `entropy` has room for a path at its end."""
    pool = np.empty(_POOL, np.uint64)
    drawn = np.empty(6, np.uint64)
    shared = entropy.size
    shared -= paths.shape[1]
    for row in range(len(paths)):
        for place in range(paths.shape[1]):
            entropy[shared + place] = np.uint64(paths[row, place])
        factor = _IN
        for place in range(_POOL):
            pool[place], factor = _hashed(entropy[place], factor, _IN_STEP)
        for source in range(_POOL):
            for place in range(_POOL):
                if source != place:
                    word, factor = _hashed(pool[source], factor, _IN_STEP)
                    pool[place] = _mixed(pool[place], word)
        for source in range(_POOL, entropy.size):
            for place in range(_POOL):
                word, factor = _hashed(entropy[source], factor, _IN_STEP)
                pool[place] = _mixed(pool[place], word)
        factor = _OUT
        for place in range(drawn.size):
            drawn[place], factor = _hashed(pool[place % _POOL], factor, _OUT_STEP)
        for place in range(3):
            states[row, place] = drawn[2 * place] | drawn[2 * place + 1] << np.uint64(32)
        states[row, 3] = np.uint64(1)
        stream = load(states[row])
        for _ in range(_WARM):
            _, stream = uniform(stream)
        store(states[row], stream)
