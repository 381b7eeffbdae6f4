"""Pages: every template is filled in by its module, the page that is there is its template filled
in, and tables of small studies are what they should be."""

import ast
import importlib
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark import entrants, exact_points, load
from poseterior.inference.readings import READINGS, Verdict
from poseterior.inference.studies.misreadings import Study
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.reports.figures import leaderboard as pictures
from poseterior.reports.pages import (
    coverage,
    estimators,
    facing,
    page,
    readings,
    samplers,
    speed,
    waits,
)
from poseterior.reports.tables import leaderboard as tables
from poseterior.reports.tables import sheet_of

FOLDER = Path(page.__file__).parent
PAGES = sorted(path.stem for path in FOLDER.glob("*.md"))
SHEET = sheet_of(("", "error"), [("one", 1.0)])


def test_there_are_pages() -> None:
    assert PAGES == [
        "cameras",
        "centres",
        "coverage",
        "device",
        "estimators",
        "evaluation",
        "exchanges",
        "facing",
        "faults",
        "films",
        "honest",
        "judging",
        "leaderboard",
        "limits",
        "measures",
        "motion",
        "readings",
        "routes",
        "samplers",
        "sides",
        "speed",
        "strangers",
        "where",
        "whole",
    ]


@pytest.mark.parametrize("name", PAGES)
def test_a_template_is_filled_in(name: str) -> None:
    template = page.template_of(name)
    wanted = page.placeholders(template)
    assert wanted
    text = page.render(template, dict.fromkeys(wanted, SHEET))
    assert "{{" not in text
    assert "}}" not in text
    assert text.count(SHEET.markdown()) == len(wanted)


@pytest.mark.parametrize("name", PAGES)
def test_the_module_of_a_page_names_its_placeholders(name: str) -> None:
    module = importlib.import_module(f"poseterior.reports.pages.{name}")
    assert callable(module.main)
    tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    keys = {
        str(key.value)
        for found in ast.walk(tree)
        if isinstance(found, ast.Dict)
        for key in found.keys
        if isinstance(key, ast.Constant)
    }
    missing = set(page.placeholders(page.template_of(name))) - keys
    assert not missing


@pytest.mark.parametrize("name", PAGES)
def test_the_page_that_is_there_is_its_template(name: str) -> None:
    """Words are changed in both, or not at all."""
    parts = page.PLACEHOLDER.split(page.template_of(name))[::2]
    pattern = ".*?".join(map(re.escape, parts))
    text = (page.REPORTS / f"{name}.md").read_text(encoding="utf-8")
    assert re.fullmatch(pattern, text, re.DOTALL)


@pytest.mark.parametrize("values", [{}, {"one": "1"}, {"one": "1", "two": "2", "three": "3"}])
def test_what_does_not_fit_a_template_is_refused(values: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="placeholders without one value: "):
        page.render("{{one}} and {{two}}", values)


def test_a_page_is_written_with_its_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "REPORTS", tmp_path)
    monkeypatch.setattr(page, "template_of", lambda name: f"# {name}\n\n{{{{table}}}}\n")
    text = page.Page("errors", {"table": SHEET}, {"curves": Figure(figsize=(1, 1))}).write()
    assert text == f"# errors\n\n{SHEET.markdown()}\n"
    assert (tmp_path / "errors.md").read_text(encoding="utf-8") == text
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curves.png", "errors.md"]


def test_the_runner_takes_the_arguments_of_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By their names and kinds; it makes the folder, writes, prints and times."""
    monkeypatch.setattr(page, "REPORTS", tmp_path)
    monkeypatch.setattr(page, "template_of", lambda name: "{{data}} {{people}}\n")
    work = tmp_path / "deep" / "work"

    def main(data: page.Data, work: page.Work, people: page.People = 3) -> page.Page | None:
        assert work.is_dir()
        if people < 0:
            raise BadInput("nobody is there; ask for somebody")
        return page.Page("errors", {"data": str(data), "people": people}) if people else None

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["errors", *words])
        with pytest.raises(SystemExit) as ended:
            page.run(main)
        return int(ended.value.code or 0), "".join(capsys.readouterr())

    status, said = run("pack", str(work), "0")
    assert (status, said) == (0, "0 seconds\n")
    assert not (tmp_path / "errors.md").exists()
    assert run("pack", str(work)) == (0, "pack 3\n\n0 seconds\n")
    assert (tmp_path / "errors.md").read_text(encoding="utf-8") == "pack 3\n"
    assert run("pack", str(work), "--", "-1") == (2, "nobody is there; ask for somebody\n")
    assert run("pack")[0] == 2, "a folder is missing"


def test_what_is_kept_is_not_made_again(tmp_path: Path) -> None:
    asked: list[int] = []

    def make(number: int) -> xr.DataTree:
        asked.append(number)
        return xr.DataTree(xr.Dataset({"number": number}))

    for _ in range(2):
        assert int(page.kept(tmp_path / "a.nc", make, 7)["number"]) == 7
        assert page.kept_json(tmp_path / "a.json", lambda: asked.append(1) or {"1": 2.5}) == {
            "1": 2.5
        }
    assert asked == [7, 1]


# --- rendering of small studies


def test_facing_counts_by_angle() -> None:
    near, far = (
        facing.FacingRow(
            angle=angle, candidates=2, share=0.75, complete=True, apart=50.0, first=False
        )
        for angle in (10.0, 80.0)
    )
    rows = [near, near._replace(share=0.25, first=True), far, far._replace(complete=False)]
    lines = facing.table(rows).texts()
    assert lines[0] == ["0–15", "2", "2", "50°", "1 of 2 (50%)", "1 of 2 (50%)"]
    assert lines[1] == ["75–90", "1", "1", "50°", "1 of 1 (100%)", "0 of 1 (0%)"]
    assert lines[2][:2] == ["all", "3"]


def test_costs_are_shown_by_quartiles() -> None:
    costs = [speed.FrameCost(0.02, second, 0.1, 0.2, 30.0, 2e-3) for second in (0.5, 1.0, 2.0)]
    rows = {row[0]: row[1:] for row in speed.costs_table(costs, floor=1e-6).texts()}
    assert rows["whole bodies a second"][::2] == ["50,000", "100,000", "200,000"]
    assert rows["set-up, ms"] == ["20"] * 5
    assert rows["acceptance of legs, %"] == ["20"] * 5
    assert rows["times faster than naive groups"][2] == "200"
    assert rows["times the floor (23 random numbers)"][2] == "10"


def test_waits_are_compared_by_work() -> None:
    """Whatever else the machine did meanwhile."""
    found = {"imports": waits.Wait(9.0, 2.0), "a call": waits.Wait(12.0, 5.0)}
    assert waits.waits_table(found).texts() == [
        ["imports", "9", "2", "1"],
        ["a call", "12", "5", "2.5"],
    ]


def test_stages_of_an_attempt_are_shown_by_medians() -> None:
    costs = [speed.StageCost(60.0, 18.0, limb, 40.0, 100.0, 0.4, 0.125) for limb in (40, 50, 90)]
    rows = {row[0]: row[1:] for row in speed.stages_table({"arms": costs}).texts()}
    assert rows["ns for each limb that is tried"] == ["50"]
    assert rows["% that pass both"] == ["12.5"]


def comparison(label: str, **changes: float) -> xr.Dataset:
    line = {"ess_per_second": 10.0, "settled_per_second": 20.0, "seconds_to_distance": 2.0}
    line |= {"time_known": 0.0, "log_evidence": -12.0, "log_evidence_se": 0.1, "seconds": 4.0}
    words = {"verdict": ("sampler", ["differs"])}
    numbers = {name: ("sampler", [value]) for name, value in (line | changes).items()}
    return xr.Dataset(words | numbers, coords={"sampler": [label]})


def contest() -> xr.DataTree:
    lines = [
        comparison("rejection"),
        comparison("emcee (dispersed)", seconds_to_distance=np.inf),
        comparison("smc", log_evidence=-11.0, ess_per_second=40.0, time_known=1.0),
        comparison("nss", settled_per_second=500.0, log_evidence=np.nan),
    ]
    tree = xr.DataTree.from_dict({"summary": xr.concat(lines, "sampler")})
    tree.attrs = {"dim": 16, "exact_log_evidence": -12.0, "exact_log_evidence_se": 0.01}
    tree.attrs["exact_seconds"] = np.array([[0.1, 0.5], [0.2, 1.0], [0.3, 2.0]])
    return tree


def test_the_best_lines_of_a_frame() -> None:
    row = samplers.summary({"two missing": contest()}).texts()[0]
    assert row[:5] == ["two missing", "16", "-12.0", "50,000", "100,000"]
    assert row[5:7] == ["40 (smc)", "2,500"]
    assert row[7:9] == ["≤ 20 (emcee (dispersed))", "≥ 5,000"], "nss has no path"
    assert row[9:] == ["2 s", "2 s", "3 of 3"]


def test_evidence_that_is_off_is_flagged() -> None:
    row = samplers.evidences({"two missing": contest()}).texts()[0]
    assert row[:2] == ["two missing", "-12.00 ± 0.01"]
    assert row[2:] == ["-11.00 ± 0.10, **off by +10.0 errors**", "none in 4 s", "–"]
    assert samplers.absent({"one": contest()}).startswith("Not run yet: on *one* emcee-de")


def entry(sampler: str, start: str = "", **changes: object) -> dict[str, object]:
    """A line of the leaderboard on one arm, after two seconds."""
    line = {"target": "arm", "budget": "seconds", "sampler": sampler, "start": start}
    line |= {"allowed": 2.0}
    numbers = {"effective_draws": 300.0, "earned": 100.0, "evaluations": 4e4, "seconds": 2.0}
    numbers |= {"to_distance": 1.0, "rhat_worst": 1.0}
    about = {"verdict": "agrees", "missed_mass": 0.0, "worst_w1": 0.1, "evidence_error": None}
    return line | numbers | about | changes


def leaderboard_lines() -> list[dict[str, object]]:
    """Lines on one arm: of those that were given nothing, emcee is the best that agrees."""
    lines = [
        entry("exact", earned=1e4, to_distance=0.01),
        entry("emcee", "exact draws", earned=500.0, to_distance=0.5),
        entry("emcee", "prior"),
        entry("smc", verdict="differs", earned=900.0, to_distance=None),
        {**entry("random-walk", "prior"), "verdict": "no draws"},
    ]
    for name in ("earned", "evaluations", "seconds", "to_distance"):
        del lines[-1][name]
    return lines


def test_the_leaderboard_ranks_by_what_was_earned() -> None:
    lines = leaderboard_lines()
    (row,) = tables.ratios(lines).texts()
    assert row[:5] == ["arm", "6", "5,000", "emcee: 50", "100"], (
        "neither gifts nor wrong ones count"
    )
    assert row[5:] == ["0.01 s", "emcee: 1 s", "100"]
    rows = tables.board(lines, "arm", "seconds").texts()
    assert rows[0][:7] == ["exact", "–", "agrees", "300", "5,000", "250", "0.01 s"]
    assert rows[-1][2:7] == ["no draws", "300", "–", "–", "–"]
    assert tables.ratios([]).texts() == []


def test_who_never_comes_near_is_behind_by_more_than_its_time() -> None:
    lines = [entry("exact", to_distance=0.01), entry("smc", verdict="differs", to_distance=None)]
    (row,) = tables.ratios(lines).texts()
    assert row[3:5] == ["none", "–"]
    assert row[6:] == ["none", "> 200"]


def test_the_leaderboard_explains_who_agrees_by_its_start() -> None:
    """Three walkers far apart, each where an exact draw has put it, agree: not without a word."""
    given = {"effective_draws": 144.0, "earned": 16.0, "rhat_worst": 3.91}
    lines = [entry("random-walk", "exact draws", **given)]
    said = (
        "random-walk agrees because it was started in exact draws: of its 144 effective draws it"
        " has earned 16, and R-hat 3.91 says that its chains are still far apart"
    )
    assert said in tables.board(lines, "arm", "seconds").markdown()
    lines = [entry("random-walk", "prior", **given)]
    assert "exact draws" not in tables.board(lines, "arm", "seconds").markdown()


def test_the_ranking_by_hand() -> None:
    """Who agrees with chains apart is unmixed, also in lines kept from before that word; gifts and
    equal evaluations are not ranked."""
    lines = [
        *leaderboard_lines(),
        entry("aies", "prior", rhat_worst=3.44),
        entry("nrpt", verdict="cannot tell", effective_draws=23.0),
        entry("sa", "prior", earned=50.0),
        entry("sa", "prior", budget="evaluations", verdict="differs"),
    ]
    rows = {row[0]: row[1:] for row in tables.ranking(lines).texts()}
    assert list(rows)[:3] == ["exact", "emcee", "sa"]
    assert rows["emcee"] == ["1 of 1", "6", "100", "0", "0", "0", "0"]
    assert rows["sa"] == ["1 of 1", "6", "200", "0", "0", "0", "0"]
    assert rows["aies"] == ["0 of 1", "–", "–", "1", "0", "0", "0"]
    assert rows["nrpt"][-2:] == ["1", "0"]
    assert rows["random-walk"][-1] == "1"
    said = [row[2] for row in tables.board(lines, "arm", "seconds").texts()]
    assert "cannot tell: run 5 times as long" in said


def test_the_leaderboard_s_pictures() -> None:
    lines = leaderboard_lines()
    (cells,) = pictures.standings(lines).axes
    assert [text.get_text() for text in cells.get_yticklabels()] == [
        str(record["sampler"]) for record in tables.ranking(lines).records
    ]
    shown = {mark.get_gid(): mark.get_text() for mark in cells.texts}
    assert shown["random-walk arm"] == "·", "it has no draws"
    assert len(shown) == len(tables.entered(lines)), "runs from exact draws are left out"
    earned, timed = pictures.growth(lines).axes
    assert earned.get_lines()[0].get_ydata() == [100.0]
    assert timed.get_lines()[0].get_ydata() == [100.0]


def test_walking_downhill_comes_inside_at_a_price(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entrants, "DOWNHILL_STEPS", 200)
    target = load("arm")
    points, spent = entrants.downhill(target, np.random.default_rng(0), 20, Allowance())
    assert len(points) >= 5
    assert (target.misfit(points) <= 1).all()
    assert spent > 2 * len(points)


def test_walkers_are_spread_where_few_starts_were_found() -> None:
    """All inside, none where another is, the found ones first, and every evaluation counted."""
    target, rng = load("single"), np.random.default_rng(0)
    few = exact_points(target, 3)
    points, spent = entrants.filled(target, rng, few, 40)
    np.testing.assert_array_equal(points[:3], few)
    assert len(np.unique(points, axis=0)) == 40
    assert (target.misfit(points) <= 1).all()
    assert spent >= 37
    same, nothing = entrants.filled(target, rng, few, 3)
    np.testing.assert_array_equal(same, few)
    assert nothing == 0


def verdict(whole: float) -> Verdict:
    """Of one person whom the reading with everything exchanged explains better by so many nats."""
    names = (*(reading.name for reading in READINGS), "whole")
    gains = np.append(np.full(len(READINGS), -10.0), whole)[None]
    return Verdict(names, gains, np.zeros(1), np.full(1, 15.0), np.ones(1), ())


def test_doubted_files_are_counted() -> None:
    people = [verdict(50.0), verdict(-10.0), verdict(-10.0)]
    found = Study({"right": people, "whole": people[:1]}, [10.0, 40.0, 80.0], [])
    rows = readings.table(found).texts()
    assert rows[0] == ["right", "33.3% (1 of 3)", "100.0%", "0.0%", "0.0%", "–"]
    assert rows[1] == ["everything exchanged", "100.0% (1 of 1)", "100.0%", "0.0%", "0.0%", "–"]
    assert readings.share(people * 10, 10) == (3, 3), "evidence adds up over a file"


def test_estimators_recover_poses_in_their_span() -> None:
    whole, rng = PoseDictionary.default(), np.random.default_rng(0)
    pose = estimators._in_the_span(whole, "zhou", 2, 3, rng)
    assert pose.shape == (15, 3)
    assert estimators._seen(pose).seen.all()


def test_rejections_of_the_toy() -> None:
    table = coverage.toy_table({"ranks": [0.005, 0.04, 0.1, 0.9]})
    assert table.texts() == [["ranks", "25.0%", "50.0%", "75.0%", "4"]]
