"""`poseterior benchmark list`: the frozen targets."""

from poseterior.reports import console
from poseterior.reports.options import Screen
from poseterior.reports.settings import BenchmarkListSettings


def run(settings: BenchmarkListSettings, screen: Screen) -> None:
    """Says which targets there are, and how hard they are."""
    from poseterior.reports.tables.benchmark import targets_table

    sheet = targets_table()
    console.show(screen.json, {"targets": sheet.json()}, sheet)
