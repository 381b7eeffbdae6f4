"""`poseterior benchmark judge`: the verdict on draws of a target."""

from poseterior.reports import console
from poseterior.reports.options import Screen
from poseterior.reports.settings import BenchmarkJudgeSettings


def run(settings: BenchmarkJudgeSettings, screen: Screen) -> None:
    """Judges draws by exact ones. Raises `BadInput` where they cannot be draws of the target."""
    from poseterior.inference.benchmark import load, verdict
    from poseterior.reports.tables.benchmark import tests_table, verdict_record, verdict_sentences

    with console.progress(f"tests against exact draws of {settings.target}", screen.quiet):
        found = verdict(load(settings.target), settings.submission)
    sheets = [tests_table(found)] if found.judgement.tests else []
    console.show(screen.json, verdict_record(found), *sheets, *verdict_sentences(found))
