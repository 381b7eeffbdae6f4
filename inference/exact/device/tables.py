"""Strata and bins of lengths on JAX's device, and how its program reads them.

The tables of the compiled loops are handed over as they are, word by word: every row is
some 64-bit words, whose names and places are those of the structured arrays in
`loops.tables`. A number is read by its name:

    row = plan.limbs[0].entries[17]
    real(row, ENTRIES, "region")
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.exact.groups import GroupTables, Plan
from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.tables import (
    ALIAS,
    LengthBins,
    LimbProblem,
    LimbTables,
    Strata,
)
from poseterior.probmodel.anatomy.limits import CELL

WORD = 8
"""Bytes."""
Array = Any
"""Of NumPy until it is handed over, of JAX from then on."""


class DeviceLengths(NamedTuple):
    """`LengthBins` on the device: `law` `(4,)`, and words of `SLICES` and `ALIAS`, a
    row each."""

    law: Array
    slices: Array
    alias: Array


class DeviceLimb(NamedTuple):
    """A limb on the device.

    Attributes
    ----------
    axes, target, reach
        As of a `LimbProblem`.
    reference
        `(6,)` of the lower frame, and its fallback.
    cells, subs, alias, entries
        Words of `CELLS`, `SUBS`, `ALIAS` and `ENTRIES`, a row each.
    starts, sizes
        `(bins,)`: where a bin's strata begin, and how many there are.
    """

    axes: Array
    target: Array
    reach: Array
    reference: Array
    cells: Array
    subs: Array
    alias: Array
    entries: Array
    starts: Array
    sizes: Array


class DevicePlan(NamedTuple):
    """A group's `Plan` on the device.

    Attributes
    ----------
    limbs
        Of the group.
    lengths
        Of their bones.
    bins
        Words of the `ALIAS` by which pairs of bins of lengths are chosen.
    half
        Half the width of a sub-cell, radians.
    """

    limbs: tuple[DeviceLimb, ...]
    lengths: tuple[DeviceLengths, ...]
    bins: Array
    half: Array


def words(table: np.ndarray) -> np.ndarray:
    """A structured array `(n,)` as its words `(n, words)`."""
    return table.view(np.int64).reshape(len(table), -1)


def padded(table: np.ndarray, least: int) -> np.ndarray:
    """The same with rows of zeros up to a power of two, and so many at `least`:
    programs are made for shapes, and these tables are of another length for every
    frame."""
    room = np.zeros(1 << (max(len(table), least, 1) - 1).bit_length(), table.dtype)
    room[: len(table)] = table
    return words(room)


def whole(row: jax.Array, table: np.dtype, name: str) -> jax.Array:
    """A whole number of a row, by the name of its field."""
    kind, first = table.fields[name][:2]  # type: ignore[index]
    bits = 8 * kind.itemsize
    shifted = row[first // WORD] >> 8 * (first % WORD)
    return shifted if bits == 8 * WORD else shifted & ((1 << bits) - 1)


def real(row: jax.Array, table: np.dtype, *names: str) -> tuple[jax.Array, ...]:
    """Numbers of a row, by the names of their fields."""
    places = [table.fields[name][1] // WORD for name in names]  # type: ignore[index]
    return tuple(jax.lax.bitcast_convert_type(row[place], jnp.float64) for place in places)


def _lengths(bins: LengthBins) -> DeviceLengths:
    return DeviceLengths(np.array(bins.law), words(bins.slices), words(bins.alias))


def _limbs(
    problems: tuple[LimbProblem, ...], builds: tuple[LimbTables, ...], strata: tuple[Strata, ...]
) -> Iterator[DeviceLimb]:
    subs = max(len(own.subs) for own in strata)
    entries = max(len(own.entries) for own in strata)
    for problem, tables, own in zip(problems, builds, strata, strict=True):
        yield DeviceLimb(
            *problem,
            reference=np.array(tables.reference),
            cells=words(tables.cells),
            subs=padded(own.subs, subs),
            alias=padded(own.alias, entries),
            entries=padded(own.entries, entries),
            starts=own.starts,
            sizes=own.ends - own.starts,
        )


def device_plan(
    plan: Plan, tables: GroupTables, limbs: tuple[LimbProblem, ...]
) -> tuple[DevicePlan, float]:
    """Hands a plan over to the device.

    The loops of the processor draw a length until one is kept. Here a proposal whose
    length is not kept has failed: bins are chosen in proportion to their envelopes
    instead of their masses, and the proposal's mass is larger by as much.

    Returns
    -------
    The plan, and the mass of its proposal.
    """
    lengths = plan.bins[: tables.builds[0].bones]
    first, *second = (bins.proposed / bins.mass for bins in lengths)
    larger = np.outer(first, second[0]).ravel() if second else first
    bins = np.zeros(len(plan.share), ALIAS)
    mass = plan.mass * alias_table(plan.share * larger, bins)
    found = DevicePlan(
        tuple(_limbs(limbs, tables.builds, plan.strata)),
        tuple(_lengths(own) for own in lengths),
        words(bins),
        np.array(CELL / plan.sub / 2),
    )
    # All at once: each array handed over by itself would be waited for.
    return jax.device_put(found), float(mass)
