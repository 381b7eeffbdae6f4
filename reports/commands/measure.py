"""`poseterior measure`: joint angles, lengths and steps of a result, with intervals: a table, a
picture, and a file for a spreadsheet or for xarray."""

from pathlib import Path

import numpy as np
import xarray as xr

from poseterior.inference.measured import measure_intervals, measures
from poseterior.inference.results import save_tree
from poseterior.inference.stream import in_time, rows_of_person
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.measures import USUAL
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.measures import bands_figure, densities_figure
from poseterior.reports.options import Screen
from poseterior.reports.settings import MeasureSettings
from poseterior.reports.tables.measures import (
    measured_film_table,
    measures_table,
    records,
    records_sheet,
)


def run(settings: MeasureSettings, screen: Screen) -> None:
    """Writes the file and the picture. Raises `BadInput` on a measure or a result that is none."""
    out = console.output_file(settings.out)
    if out.suffix.lower() not in (".csv", ".nc"):
        raise BadInput(f"--out {out} is to be a .csv, or a .nc with every draw; give such a name")
    wanted = settings.measure or []
    with console.progress("measures of every draw", screen.quiet):
        found = measures(settings.result, *wanted, height=settings.height)
        numbers = None
        if "frame" in found.dims:
            found, numbers = _of_person(found, settings.person, settings.result)
        elif settings.person is not None:
            raise BadInput(f"{settings.result} is of one person; leave --person out")
        summed = measure_intervals(found, settings.interval)
    shown = list(map(str, found.data_vars)) if wanted else list(USUAL)
    picture = out.with_suffix(".png")
    with console.progress("the picture", screen.quiet):
        figure = (
            densities_figure(found, summed, shown)
            if numbers is None
            else bands_figure(summed, numbers, shown)
        )
        save_figure(figure, picture)
        _write(found, summed, out)
    about = {"interval": settings.interval, "out": str(out), "picture": str(picture)}
    sheet = (measures_table if numbers is None else measured_film_table)(summed)
    written = f"Written to {out} and {picture}"
    console.show(screen.json, {"measures": _json(found, summed), **about}, sheet, written)


def _of_person(found: xr.Dataset, person: int | None, path: Path) -> tuple[xr.Dataset, list[int]]:
    """One person's frames in the order of time, and their numbers. Raises `BadInput` as
    `rows_of_person`."""
    names, rows = rows_of_person([str(name) for name in found.frame.values], person, path)
    there = [(name, row) for name, row in zip(names, rows, strict=True) if row is not None]
    order, numbers = in_time([name for name, _ in there])
    picked = found.isel(frame=[there[at][1] for at in order])
    return picked, numbers or list(range(1, len(order) + 1))


def _write(found: xr.Dataset, summed: xr.Dataset, out: Path) -> None:
    if out.suffix.lower() == ".csv":
        console.write_text(out, records_sheet(summed).csv())
        return
    kept = {
        name: value
        for name, value in sorted(found.attrs.items())
        if not name.startswith("_") and isinstance(value, str | int | float | np.generic)
    }
    parts = {"draws": found.drop_attrs(deep=False), "intervals": summed.drop_attrs(deep=False)}
    tree = xr.DataTree.from_dict(parts)
    tree.attrs = kept | {"probability": summed.attrs["probability"]}
    save_tree(tree, out)


def _json(found: xr.Dataset, summed: xr.Dataset) -> list[dict]:
    about = ("convention", "source")
    return [
        {**row, **{key: found[row["measure"]].attrs[key] for key in about}}
        for row in records(summed)
    ]
