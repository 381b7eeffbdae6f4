"""What draws say of joint angles, lengths and steps."""

import numpy as np
import xarray as xr

from poseterior.reports.tables.posterior import UNIT_NOTE
from poseterior.reports.tables.sheet import (
    NOTHING,
    Column,
    Record,
    Sheet,
    fixed,
    number,
    percent,
)
from poseterior.reports.tables.words import spoken

DIGITS = {"degrees": 1, "mm": 0, "body units": 2}
"""Decimal places, by unit."""
SIGNS = {"degrees": "°", "mm": " mm", "body units": ""}
_SPREAD_FIELDS = ("mean", "sd", "low", "high")


def measures_table(found: xr.Dataset) -> Sheet:
    """Each measure of one person: mean, standard deviation, interval, and both modes where there
    are two.

    Parameters
    ----------
    found
        As `inference.measure_intervals` gives it.
    """
    columns = [
        Column("measure", "measure", spoken, left=True),
        Column("mean", lambda record: _written(record, "mean"), whole=True),
        Column("sd", lambda record: _written(record, "sd")),
        Column(f"{percent(found.attrs['probability'])} interval", _interval, whole=True),
        Column("two modes", _modes, left=True),
    ]
    return Sheet(columns, records(found), "Measures", _caption(found))


def measured_film_table(found: xr.Dataset) -> Sheet:
    """Each measure of one person's film: from where to where its mean goes, how wide its intervals
    are, and how many frames leave two modes.

    Parameters
    ----------
    found
        As of `measures_table`, by frame.
    """
    width = (found.high - found.low).values
    two = np.isfinite(found.value.isel(mode=1).values)
    rows = [
        {
            "measure": str(name),
            "unit": str(found.units.values[index]),
            "frames": int(np.isfinite(width[index]).sum()),
            "least": number(np.nanmin(found["mean"].values[index])),
            "most": number(np.nanmax(found["mean"].values[index])),
            "width": number(np.nanmedian(width[index])),
            "widest": number(np.nanmax(width[index])),
            "widest_in": str(found.frame.values[int(np.nanargmax(width[index]))]),
            "two_modes": float(two[index].mean()),
        }
        for index, name in enumerate(found.measure.values)
        if np.isfinite(width[index]).any()
    ]
    columns = [
        Column("measure", "measure", spoken, left=True),
        Column("mean from", lambda record: _written(record, "least")),
        Column("to", lambda record: _written(record, "most")),
        Column("width", lambda record: _written(record, "width")),
        Column("widest", lambda record: _written(record, "widest")),
        Column("in frame", "widest_in", left=True),
        Column("two modes", "two_modes", percent),
    ]
    said = f"Width: of {percent(found.attrs['probability'])} intervals, median over frames."
    return Sheet(columns, rows, "Measures of the film", f"{said} {_caption(found)}")


def records(found: xr.Dataset) -> list[Record]:
    """A record for each measure, of each frame where there are frames, those without a pose too."""
    frames = found.frame.values if "frame" in found.dims else [None]
    rows: list[Record] = []
    for place, frame in enumerate(frames):
        here = found if frame is None else found.isel(frame=place)
        named = {} if frame is None else _frame(str(frame))
        values = {name: here[name].values for name in (*_SPREAD_FIELDS, "value", "mass")}
        for index, name in enumerate(found.measure.values):
            row = {field: number(values[field][index]) for field in _SPREAD_FIELDS}
            for mode in range(found.sizes["mode"]):
                row[f"value_{mode + 1}"] = number(values["value"][index, mode])
                row[f"mass_{mode + 1}"] = number(values["mass"][index, mode])
            unit = str(found.units.values[index])
            rows.append({**named, "measure": str(name), "unit": unit, **row})
    return rows


def records_sheet(found: xr.Dataset) -> Sheet:
    """`records` as a table for a spreadsheet."""
    rows = records(found)
    return Sheet([Column(name) for name in rows[0]], rows)


def _frame(name: str) -> dict[str, str]:
    from poseterior.inference.stream import frame_and_person  # as of `inference.measured`

    frame, person = frame_and_person(name)
    return {"frame": frame, "person": person}


def _written(record: Record, field: str) -> str:
    return _number(record[field], record["unit"])


def _number(value: float | None, unit: str) -> str:
    return fixed(DIGITS[unit], SIGNS[unit])(value).replace("-", "−")


def _interval(record: Record) -> str:
    low, high = (_written(record, end) for end in ("low", "high"))
    return NOTHING if record["low"] is None else f"{low} to {high}"


def _modes(record: Record) -> str:
    if record["value_2"] is None:
        return ""
    parts = [
        f"{_number(record[f'value_{mode}'], record['unit'])} ({percent(record[f'mass_{mode}'])})"
        for mode in (1, 2)
    ]
    return " or ".join(parts)


def _caption(found: xr.Dataset) -> str:
    lengths = "" if "body units" not in found.units.values else f" Lengths: {UNIT_NOTE}."
    up = found.attrs.get("up")
    whose = f"from the calibration's axis {up}" if up else "the camera's"
    return (
        f"Verticals are {whose}. Angles of a circle have the mean and deviation of directions;"
        f" their intervals may end beyond 180°.{lengths}"
    )
