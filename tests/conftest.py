"""A strict session: 64-bit floats, no implicit promotion of ranks, warnings are errors (see
pyproject)."""

import gc
import os
import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpyro.distributions  # noqa: F401 — whole, before a test that breaks off a command can break off this import
import pytest

if TYPE_CHECKING:  # the packages themselves are imported once floats are 64 bits wide
    from poseterior.inference import Result
    from poseterior.probmodel import Estimate

CACHE = Path(__file__).parents[1] / ".pytest_cache" / "compiled"
"""What XLA compiles is kept here, as the product keeps it for its user. Compiling is most of what
tests wait for, and the processes of a run, the slow run and the next run ask for the same."""
SETTINGS = {
    "jax_enable_x64": True,
    "jax_compilation_cache_dir": str(CACHE / "poseterior"),
    "jax_persistent_cache_min_compile_time_secs": 0.0,
    "jax_persistent_cache_min_entry_size_bytes": 0,
}
for name, value in SETTINGS.items():
    jax.config.update(name, value)
    if name != "jax_enable_x64":  # what tests start keeps its programs there too
        os.environ[name.upper()] = str(value)
jax.config.update("jax_numpy_rank_promotion", "raise")
# Traces are not kept: tests replace functions, and a trace of a replaced one would outlive them.
os.environ["POSETERIOR_PROGRAMS"] = ""
# Compilers leave millions of objects that live as long as the process; to look through them all as
# often as Python does by itself takes a thirtieth of the time.
gc.set_threshold(100_000, 20, 50)


MOST_MAPPINGS = 25_000
"""Parts of a process's memory, of which programs take the most."""


class Run(NamedTuple):
    """How a command ended: exit code, stdout, stderr."""

    code: int
    out: str
    err: str


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Another order, where `TESTS_SHUFFLED` says which: of files, and of the tests of a file."""
    seed = os.environ.get("TESTS_SHUFFLED")
    if not seed:
        return
    rng = random.Random(seed)
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    order = rng.sample([*files], len(files))
    items[:] = [item for path in order for item in rng.sample(files[path], len(files[path]))]


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Lets go of compiled programs before the system's number of mappings runs out: every one takes
    a few, a process is given 65,530, and XLA breaks off the process where it gets no more."""
    goes_on = nextitem is not None and nextitem.path == item.path
    if goes_on and not item.get_closest_marker("slow"):
        return
    if _mappings() > MOST_MAPPINGS:
        jax.clear_caches()
        gc.collect()


def _mappings() -> int:
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:  # no Linux, and no such number
        return 0


Cli = Callable[..., Run]
SHARED = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def few_trials() -> Iterator[None]:
    """The nearest miss, which a sentence tells where draws are lacking, is looked for among fewer
    poses: compiled without optimisation, so many would take two seconds each time."""
    from poseterior.inference.exact import reach

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reach, "TRIALS", 1 << 10)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real motion capture, detections and published tables, which is not part of the
    repository."""
    if not SHARED.is_dir():
        pytest.skip(
            "the shared data pack (motion capture, detections, published limits) is not beside the"
            " checkout"
        )
    return SHARED


@pytest.fixture(scope="session")
def cases(shared_data: Path) -> Path:
    """Small files in forms that users bring; README says what is right for each."""
    return shared_data / "cases"


@pytest.fixture(scope="session")
def example_estimate() -> "Estimate":
    """Torso and camera of the embedded example."""
    from poseterior.inference import estimate_torso
    from poseterior.probmodel.example import example

    return estimate_torso(example().detection)


@pytest.fixture(scope="session")
def example_result(example_estimate: "Estimate") -> "Result":
    """Exact draws of the embedded example, few: for what needs any result."""
    from poseterior.inference import sample
    from poseterior.probmodel import PoseModel

    return sample(
        PoseModel(),
        example_estimate,
        key=jax.random.key(0),
        num_samples=200,
        root="candidates",
    )


@pytest.fixture(scope="session")
def cache() -> Iterator[None]:
    """Commands keep what they compile in a folder of the tests, not in the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(CACHE))
        yield


@pytest.fixture
def poseterior(
    cache: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Cli:
    """Runs the command in this process."""
    from poseterior.reports import cli

    def run(*arguments: object) -> Run:
        monkeypatch.setattr(sys, "argv", ["poseterior", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return Run(int(ended.value.code or 0), said.out, said.err)

    return run
