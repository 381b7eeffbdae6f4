"""What an external sampler is, and how it is found: by the entry points of the installed packages.

    [project.entry-points."poseterior.samplers"]         # of anybody's pyproject.toml
    mypackage-nuts = "mypackage.nuts:SAMPLER"             # an ExternalSampler

    external_sampler("mypackage-nuts").draw(load("arm"), 3, Allowance(seconds=10))

Ours are declared in the same way. In a checkout, where what was installed may be older than the
sources, they are read from its pyproject.toml."""

import functools
import importlib.util
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark.forms import SamplerTarget
from poseterior.inference.benchmark.submission import Submission, submit
from poseterior.probmodel.failures import BadInput

ENTRY_POINTS = "poseterior.samplers"
"""The group of entry points."""
DISTRIBUTION = "poseterior"
"""Our distribution."""
CHECKOUT = Path(__file__).resolve().parents[3]
"""Where the sources lie; installed, it has no pyproject.toml."""
CLOCK = time.process_time


class SamplerRun(NamedTuple):
    """What a sampler brought.

    Attributes
    ----------
    submission
        Its draws.
    given
        How many exact draws it was started with.
    kept
        The share of the work that brought draws, evenly; 0 where all of them come at the end.
    steps
        How many draws in a row are the path of one walker; 1 where they are no paths.
    """

    submission: Submission
    given: int = 0
    kept: float = 0.0
    steps: int = 1


@dataclass(frozen=True)
class ExternalSampler:
    """What an entry point of the group names.

    Attributes
    ----------
    draw
        Draws of a target, by a seed, at most so dear: an `SamplerRun` whose draws are made by
        `submission.submit`; None where none came inside the walls.
    note
        How it is set up.
    needs
        The package that it imports when it draws; empty where its own is all that it needs.
    install
        What brings that package, as `pip install` takes it.
    """

    draw: Callable[[SamplerTarget, int, Allowance], SamplerRun | None]
    note: str
    needs: str = ""
    install: str = ""

    def require(self, name: str) -> None:
        """Raises `BadInput` where the package that the sampler of that name needs is missing."""
        if self.needs and importlib.util.find_spec(self.needs) is None:
            raise BadInput(
                f'the sampler {name} is not installed; install "{self.install}", or leave it out'
            )

    def run(
        self, name: str, target: SamplerTarget, seed: int, allowance: Allowance
    ) -> SamplerRun | None:
        """What `draw` brings. Raises `BadInput` where that is no `SamplerRun`, or cannot be draws
        of the target, as `submit` says."""
        found = self.draw(target, seed, allowance)
        if found is None:
            return None
        if not isinstance(found, SamplerRun):
            raise BadInput(
                f"the sampler {name} brought {type(found).__name__}, not a SamplerRun of"
                " poseterior.inference.benchmark; its package has to be mended"
            )
        submit(target, points=found.submission.points, where=f"the draws of {name}")
        if found.submission.points.shape[1] % found.steps:
            raise BadInput(
                f"the draws of {name} are {found.submission.points.shape[1]:,} a chain, which is no"
                f" multiple of the {found.steps:,} steps of a path; its package has to be mended"
            )
        return found


def external_samplers() -> dict[str, metadata.EntryPoint]:
    """The entry points by the names of their samplers, ours first; nothing is imported yet.

    Raises
    ------
    BadInput
        Where two packages declare samplers of one name.
    """
    found: dict[str, metadata.EntryPoint] = {}
    for entry in _declared():
        if entry.name in found:
            raise BadInput(
                f"two packages have a sampler {entry.name!r} ({found[entry.name].value} and"
                f" {entry.value}); uninstall one, or have it renamed"
            )
        found[entry.name] = entry
    return found


def external_sampler(name: str) -> ExternalSampler:
    """The sampler of an entry point, imported.

    Parameters
    ----------
    name
        A key of `external_samplers()`.

    Returns
    -------
    ExternalSampler
        What the entry point names.

    Raises
    ------
    BadInput
        Where it cannot be imported, or is no `ExternalSampler`.
    """
    entry = external_samplers()[name]
    try:
        found = entry.load()
    except (ImportError, AttributeError) as error:
        raise BadInput(
            f"the sampler {name} cannot be imported from {entry.value} ({error}); mend or uninstall"
            " its package, or leave it out"
        ) from None
    if not isinstance(found, ExternalSampler):
        raise BadInput(
            f"the entry point {name} names {entry.value}, which is no ExternalSampler of"
            " poseterior.inference.benchmark; its package has to be mended"
        )
    return found


def _declared() -> Iterator[metadata.EntryPoint]:
    ours = _declared_in(CHECKOUT)
    for name, value in ours.items():
        yield metadata.EntryPoint(name, value, ENTRY_POINTS)
    for entry in sorted(metadata.entry_points(group=ENTRY_POINTS), key=_ours_first):
        if not (ours and _is_ours(entry)):
            yield entry


def _ours_first(entry: metadata.EntryPoint) -> tuple[bool, str]:
    return not _is_ours(entry), entry.name


def _is_ours(entry: metadata.EntryPoint) -> bool:
    return entry.dist is not None and entry.dist.name == DISTRIBUTION


@functools.cache
def _declared_in(folder: Path) -> dict[str, str]:
    """The entry points in the pyproject.toml of our checkout; none where it is none."""
    file = folder / "pyproject.toml"
    if not file.is_file():
        return {}
    project = tomllib.loads(file.read_text(encoding="utf-8")).get("project", {})
    return project["entry-points"][ENTRY_POINTS] if project.get("name") == DISTRIBUTION else {}
