"""What `--help` and the pages tell people to type is what the commands take; one option means one
thing."""

import dataclasses
import json
import re
import shlex
import types
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from poseterior.inference import ESTIMATORS, SAMPLERS
from poseterior.inference.films.film import CUTOFF, NUM_PATHS
from poseterior.inference.importance.weighted import MOST_ROOTS
from poseterior.inference.sampler import ROOTED_SAMPLERS
from poseterior.inference.studies.judging import recalibrate
from poseterior.probmodel import Anatomy, read_detections
from poseterior.probmodel.root_priors import ROOT_PRIORS
from poseterior.reports import cli, options
from poseterior.reports.fields import OPTION
from poseterior.reports.settings import FilmSettings
from tests.conftest import Cli
from tests.probmodel.test_formats_fuzz import deeplabcut_rows, table
from tests.reports.test_cli import native, openpose

ROOT = Path(__file__).parents[2]
EXAMPLES = [line for kind in cli.COMMANDS.values() for line in kind.EXAMPLES]
RUN = [
    line
    for line in EXAMPLES
    if re.match(
        "demo|hypotheses|sample|frames|show|export|prior|check posterior|coverage --simulate", line
    )
    and "session/" not in line
]
"""Those that need neither a network, nor motion capture, nor minutes."""


def documented() -> list[str]:
    """The command lines of the pages: indented ones, and those in a notebook's text that have
    options."""
    pages = [*ROOT.glob("*.md"), *ROOT.glob("reports/*.md"), *ROOT.glob("docs/**/*.md")]
    found = [
        line
        for page in pages
        for line in re.findall(r"^ {4,}(?:\S*/)?poseterior (\w[^#\n]*)", page.read_text(), re.M)
    ]
    for notebook in ROOT.glob("notebooks/*.ipynb"):
        found += re.findall(r"`poseterior (\w+ [^`]*--[^`]*)`", notebook.read_text())
    return found


@pytest.fixture
def parsed(poseterior: Cli, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """The settings that the real application makes of a command line, with commands that do
    nothing."""
    settings: list[Any] = []
    idle = types.SimpleNamespace(run=lambda wanted, screen: settings.append(wanted))
    monkeypatch.setattr(cli, "import_module", lambda name: idle)
    monkeypatch.setattr(cli, "_compile_ahead", lambda root, screen: None)  # nothing will be drawn
    monkeypatch.setattr(cli.options, "check", lambda wanted: None)  # there are no such files

    def parse(line: str) -> Any:
        run = poseterior(*shlex.split(line))
        assert (run.code, run.err) == (0, ""), f"{line}: {run.err}"
        return settings.pop()

    return parse


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_example_is_one_of_its_command(name: str, parsed: Callable[[str], Any]) -> None:
    for line in cli.COMMANDS[name].EXAMPLES:
        assert line.split()[: len(name.split())] == name.split()
        assert isinstance(parsed(line), cli.COMMANDS[name])


def test_what_the_pages_say_is_what_the_commands_take(parsed: Callable[[str], Any]) -> None:
    lines = documented()
    assert len(lines) >= 7
    for line in lines:
        parsed(line)


def test_values_arrive_where_they_belong(parsed: Callable[[str], Any]) -> None:
    wanted = parsed(
        "compare f.json --root fixed --person 2 --names n.json --image-size 9x9 --correct"
        " --poses p.npz --no-head --upper area --seed 5"
    )
    assert wanted.person.person == 2
    assert wanted.person.detected == options.Detected(
        names=Path("n.json"), image_size="9x9", correct=True
    )
    assert wanted.estimation == options.Estimation(poses="p.npz", head=False)
    assert wanted.prior == options.Prior(upper=options.UpperMeasure.area)
    assert wanted.seed == 5
    assert parsed("coverage --poses x.npz").dataset == Path("x.npz")


def test_every_command_that_reads_detections_has_all_of_its_options() -> None:
    reading = {
        option.name
        for group in (options.Detected, options.Estimation, options.Prior)
        for option in cli.declared(group)
    }
    for name in ("hypotheses", "sample", "frames", "film", "show", "compare"):
        own = {option.name for option in cli.declared(cli.COMMANDS[name])}
        assert own >= reading, f"{name} lacks {reading - own}"


OF_THEIR_OWN = {
    "out": set(cli.COMMANDS),  # what is written differs
    "file": {"check", "benchmark", "show"},  # poses, draws, results, not detections alone
    "names": {"check", "learn", "evaluate"},  # of a motion capture's joints
    "height": {"export"},  # of which it has a usual one
    "measure": {"export"},  # for a format that has room for it
    "result": {"export"},  # hypotheses.json too
    "draws": {"export"},  # how many; elsewhere a file of them
    "poses": {"learn"},  # the file that the others read is written
    "limits": {"check"},  # those that poses were drawn under
    "layout": {"detect"},  # of a network, which has to say it
    "threshold": {"detect"},  # a network's scores are its heatmaps' means
    # Studies of many poses: lists of what is compared, and less work for each of them.
    "num_samples": {"evaluate", "coverage", "film"},
    "max_proposals": {"evaluate", "coverage"},
    "candidates": {"evaluate"},
    "k": {"evaluate", "export"},
    "person": {"export", "frames", "film", "measure"},  # of a film, not of a file of detections
    "estimator": {"evaluate", "coverage"},
    "missing": {"evaluate", "coverage"},
    "errors": {"coverage", "film"},  # of views of people alone; of a detector, which films need
    "frames": {"evaluate", "coverage", "calibrate"},
    "root": {
        "evaluate",
        "hypotheses",
        "sample",
        "frames",
        "film",
    },  # open where a person is asked about
    "fps": {"calibrate"},  # of a session whose frames may not follow each other
    "roots": {"frames", "film", "evaluate", "coverage"},
    "noise": {"evaluate", "coverage"},
    "dataset": {"evaluate", "coverage", "calibrate"},
    "sampler": {"coverage"},  # draws in a file, too
}
"""Options whose type, help or default is another one in some commands, and why."""


def test_one_option_means_one_thing() -> None:
    meanings: dict[str, set[tuple]] = defaultdict(set)
    for name, kind in cli.COMMANDS.items():
        for option in [*cli.declared(kind), *cli.declared(options.Screen)]:
            if name not in OF_THEIR_OWN.get(option.name, ()):
                info = option.annotation.__metadata__[0]
                meaning = (option.annotation.__origin__, option.default, info.help, info.min)
                meanings[option.name].add(meaning)
    assert {name: found for name, found in meanings.items() if len(found) > 1} == {}


def test_help_names_what_is_accepted() -> None:
    assert tuple(SAMPLERS) == options.SAMPLERS
    assert MOST_ROOTS == options.MOST_ROOTS
    defaults = {field.name: field.default for field in dataclasses.fields(FilmSettings)}
    assert defaults["cutoff"] == CUTOFF
    assert defaults["sampling"].num_samples == defaults["rooting"].roots == NUM_PATHS
    assert ROOTED_SAMPLERS[:2] == options.ROUTES
    assert {kind.prior for kind in options.RootKind} == {*ROOT_PRIORS}
    assert ROOTED_SAMPLERS == options.ROOTED
    assert all(name in help_of(cli.COMMANDS["sample"], "sampler") for name in SAMPLERS)
    assert all(name in help_of(options.Estimation, "estimator") for name in ESTIMATORS)


def help_of(group: type, name: str) -> str:
    (field,) = (field for field in dataclasses.fields(group) if field.name == name)
    return field.metadata[OPTION].help


def test_the_version(poseterior: Cli) -> None:
    run = poseterior("--version")
    assert run.code == 0
    assert re.fullmatch(r"poseterior \d+\.\d+\.\d+\S*\n", run.out)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that examples name."""
    place = tmp_path_factory.mktemp("place")
    for name in ("frame", "frame_keypoints", "video"):
        (place / f"{name}.json").write_text(openpose())
    for name in ("people", "landmarks", "street"):
        (place / f"{name}.json").write_text(openpose(people=4))
    (place / "walk").mkdir()
    for number in range(2):
        (place / "walk" / f"frame_{number}.json").write_text(native())
    odd = {"a": "right_hip", "b": "left_hip", "c": "right_shoulder", "d": "left_shoulder"}
    (place / "names.json").write_text(json.dumps(odd))
    (place / "video.csv").write_text(table(deeplabcut_rows(parts=odd)))
    Anatomy.default().save(place / "limits.npz")
    levels = xr.DataArray(
        np.linspace(0, 1, 60)[:, None],
        dims=("simulation", "quantity"),
        coords={"quantity": ["right_wrist z"]},
    )
    recalibrate(levels).save(place / "wider.json", {})
    seen = read_detections(place / "frame.json")[0].keypoints
    width, height = np.nanmax(seen, axis=0).astype(int) + 10
    Image.new("RGB", (int(width), int(height))).save(place / "photo.jpg")
    return place


@pytest.mark.slow
def test_examples_run(place: Path, poseterior: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """As they stand, in the order in which they stand: later ones read what earlier ones write."""
    monkeypatch.chdir(place)
    for line in RUN:
        run = poseterior(*shlex.split(line), "--quiet")
        assert run.code == 0, f"{line}: {run.err}"
