"""Commands that are killed, and run again: `make kills`.

    KILLS=50 KILLS_SEED=1 make kills                 so many kills of every command
    KILLS_SECONDS=900 make kills                     or as many as fit into so long
    python -m tests.kills frames sample              these commands alone

A command is run once without harm. Then it is killed (SIGKILL: nothing can be put in order) at
random moments, run again where it was stopped, killed again, and so on, and in the end left to
finish; the first kill of all hits its last write. What it leaves must have the same bits as what
the first run left, and nothing beside. Then the disk fills up, is freed, and the same is asked.

A moment is a random time, or a random one of the touches of the results' folder: there the file
that is being written is cut off first. Commands are forks of this process, which has imported
everything and computed nothing: XLA's threads would not come along."""

import hashlib
import itertools
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

import poseterior.inference.baselines.run
import poseterior.inference.stream
import poseterior.inference.studies.calibration.run
import poseterior.inference.studies.comparison.contest
import poseterior.inference.studies.evaluation.run
from poseterior.probmodel.example import example
from poseterior.reports import cli

CHAIN = 4
"""Most kills in a row, before a run is left to finish."""
LONGEST = 600
"""Characters of a sentence."""
PATIENCE = 600
"""Seconds after which a run that does not end is a failure."""
CLOCK = {
    "wall_time_s",
    "seconds",
    "ess_per_second",
    "settled_per_second",
    "seconds_to_distance",
    "sha256",
}
"""What is another number whenever the clock runs, and the sums over it."""
_TOOK = re.compile(r" [\d.,]+ s\b")
"""The same in pages and sentences."""
_TOUCHES = ("open", "os.rename", "os.remove", "os.mkdir")


class Trial(NamedTuple):
    """A command to be killed: its words, of which `{}` is the place of its results, and of these
    the files whose content depends on how fast the machine was."""

    words: str
    out: str
    timed: tuple[str, ...] = ()


TRIALS = {
    "sample": Trial("sample frame.json --num-samples 300 --out {}/a.nc", "a.nc"),
    "hypotheses": Trial("hypotheses frame.json --num-samples 300 --k 2 --out {}", ""),
    "frames": Trial("frames walk --num-samples 40 --k 2 --out {}", ""),
    "learn": Trial("learn motion.npz --out {}/a.npz --poses {}/b.npz", "a.npz"),
    "coverage": Trial("coverage --num-simulations 100 --num-samples 20 --out {}", ""),
    "compare": Trial(
        "compare frame.json --samplers rejection,random-walk --seconds 1e9 --max-evaluations 400000"
        " --num-samples 200 --out {}",
        "",
        ("comparison.png",),
    ),
    "evaluate": Trial(
        "evaluate few.npz --estimator zhou,dictionary --num-samples 20 --k 2 --no-bias"
        " --scheduler {scheduler} --out {}",
        "",
    ),
}


def prepare(place: Path) -> None:
    """Files to begin with; blocks so small that there are several."""
    from poseterior.probmodel.datasets import from_motions, write_plain
    from tests.probmodel.test_datasets import MOTIONS

    data = example().path.read_bytes()
    (place / "frame.json").write_bytes(data)
    (place / "walk").mkdir()
    for number in range(7):
        (place / "walk" / f"{number}.json").write_bytes(data)
    np.savez(place / "motion.npz", **{f"a/{i}": one.joints for i, one in enumerate(MOTIONS)})
    few = from_motions(MOTIONS, "few", frames=6)
    write_plain(few, place / "few.npz")
    poseterior.inference.stream.MOST_IN_BLOCK = 2
    poseterior.inference.studies.calibration.run.BLOCK = 25
    poseterior.inference.studies.evaluation.run.BLOCK = 2
    poseterior.inference.studies.comparison.contest.REFERENCE = 300
    poseterior.inference.baselines.run.SAVE_EVERY = 0.0
    for name in TRIALS:
        import_module(f"poseterior.reports.commands.{name}")
    for name in (
        "poseterior.probmodel.learning.learner",
        "poseterior.reports.tables",
        "poseterior.reports.figures",
    ):
        import_module(name)


# One life of a command.


class Moment(NamedTuple):
    """When to kill: after so many seconds, or at a touch of the folder, the file cut off to a share
    of its length; never, without either."""

    seconds: float | None = None
    touch: int | None = None
    share: float = 1.0


class Life(NamedTuple):
    """How a run ended: its exit code (None: killed), the seconds it took, what it said, and the
    touches of its folder."""

    code: int | None
    seconds: float
    said: str
    touches: list[str]


def live(words: list[str], folder: Path, moment: Moment, prepared: Callable[[], object]) -> Life:
    """Runs a command in a fork; `prepared` is called there first."""
    with tempfile.TemporaryDirectory() as place:
        log, touches = Path(place, "log"), Path(place, "touches")
        started = time.monotonic()
        child = os.fork()
        if not child:
            _die_or_do(words, folder, moment, prepared, log, touches)
        code = _ended(child, started + (moment.seconds or PATIENCE))
        seconds = time.monotonic() - started
        if code is None and moment == Moment():
            raise AssertionError(f"{words} did not end in {PATIENCE} seconds")
        said = log.read_text() if log.exists() else ""
        seen = touches.read_text().split() if touches.exists() else []
    return Life(None if code is None or code < 0 else code, seconds, said, seen)


def _ended(child: int, until: float) -> int | None:
    """The exit code of a child; None where it had to be killed."""
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until:
            os.kill(child, 9)
            os.waitpid(child, 0)
            return None
        time.sleep(0.005)


def _die_or_do(
    words: list[str],
    folder: Path,
    moment: Moment,
    prepared: Callable[[], object],
    log: Path,
    touches: Path,
) -> NoReturn:
    """The life of the child."""
    code: Any = 1
    try:
        file = os.open(log, os.O_WRONLY | os.O_CREAT)
        os.dup2(file, 1)
        os.dup2(file, 2)
        prepared()
        seen = _watch(folder, moment)
        sys.argv = ["poseterior", *words]
        try:
            cli.main()
        except SystemExit as ended:
            code = ended.code or 0
        sys.stdout.flush()
        touches.write_text("\n".join(seen))
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code if isinstance(code, int) else 1)


def _watch(folder: Path, moment: Moment) -> list[str]:
    """Counts the touches of the folder, and at the one of the moment ends this process."""
    seen: list[str] = []
    place = os.fspath(folder)

    def hook(event: str, values: tuple[Any, ...]) -> None:
        if event not in _TOUCHES or not str(values[0]).startswith(place):
            return
        seen.append(event)
        if len(seen) == moment.touch:
            if event == "os.rename":
                os.truncate(values[0], int(moment.share * os.stat(values[0]).st_size))
            os.kill(os.getpid(), 9)

    sys.addaudithook(hook)
    return seen


# What is left.


def content(folder: Path, timed: tuple[str, ...] = ()) -> dict[str, str]:
    """A digest of every file below a folder, arrays by their values: netCDF and zip note when they
    were written."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir():
            found[name] = "folder"
        elif path.name in timed:
            found[name] = "as fast as the machine was"
        else:
            digest = hashlib.sha256()
            for piece in _pieces(path):
                digest.update(piece)
            found[name] = digest.hexdigest()
    return found


def _pieces(path: Path) -> Iterator[bytes]:
    import netCDF4

    if path.suffix == ".nc":
        with netCDF4.Dataset(path) as file:
            yield from _group(file)
    elif path.suffix == ".npz":
        with np.load(path) as file:
            for name in sorted({*file.files} - {"_clock", "_history", "_sha256"}):
                yield name.encode() + file[name].tobytes()
    elif path.suffix == ".html":
        yield _TOOK.sub("", path.read_text(encoding="utf-8")).encode()
    else:
        yield path.read_bytes()


def _group(group: Any) -> Iterator[bytes]:
    notes = {name: group.getncattr(name) for name in group.ncattrs()}
    yield repr([(name, str(notes[name])) for name in sorted({*notes} - CLOCK)]).encode()
    for name in sorted({*group.variables} - CLOCK):
        values = group[name][...]
        text = values.dtype == object
        plain = _TOOK.sub("", repr(values.tolist())) if text else values.tobytes()
        yield repr([name, group[name].dimensions, plain]).encode()
    for name in sorted(group.groups):
        yield name.encode()
        yield from _group(group[name])


def difference(found: dict[str, str], wanted: dict[str, str]) -> str:
    """In words; empty where there is none."""
    several = {
        "lacks": [*wanted.keys() - found.keys()],
        "holds beside": [*found.keys() - wanted.keys()],
        "holds otherwise": [key for key in found.keys() & wanted if found[key] != wanted[key]],
    }
    return "; ".join(f"{words} {sorted(names)}" for words, names in several.items() if names)


# Trials.


class Stand:
    """Where a command's trials take place: its folders, and what it leaves without harm."""

    def __init__(self, name: str, place: Path, scheduler: str) -> None:
        self.trial, self.place, self.scheduler = TRIALS[name], place, scheduler
        self.temporary = place / "temporary"
        self.temporary.mkdir(exist_ok=True)
        first = self.place / f"{name}-whole"
        first.mkdir()
        life = self.run(first)
        assert life.code == 0, life.said
        self.whole, self.seconds = content(first, self.trial.timed), life.seconds
        self.touches = life.touches

    def run(
        self,
        folder: Path,
        moment: Moment = Moment(),  # noqa: B008 — a plain value
        limit: int | None = None,
    ) -> Life:
        """One life of the command, with files of at most `limit` bytes."""
        filled = self.trial.words.replace("{scheduler}", self.scheduler).replace("{}", str(folder))

        def prepared() -> None:
            os.chdir(self.place)
            tempfile.tempdir = str(self.temporary)
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        return live([*filled.split(), "--quiet"], folder, moment, prepared)

    def finished(self, folder: Path) -> None:
        """Lets the command finish; raises where that leaves anything else than the first run."""
        life = self.run(folder)
        assert life.code == 0, life.said
        found = difference(content(folder, self.trial.timed), self.whole)
        assert not found, f"{folder.name} {found}"
        beside = [path.name for path in self.temporary.iterdir()]
        assert not beside, f"{beside} are left in the folder for temporary files"

    def moments(self, rng: np.random.Generator) -> Iterator[Moment]:
        """The first within the last write, the others anywhere."""
        last = max(n for n, event in enumerate(self.touches, 1) if event == "os.rename")
        yield Moment(touch=last, share=0.5)
        while True:
            if rng.random() < 0.5:
                yield Moment(seconds=float(rng.uniform(0.02, self.seconds)))
            else:
                touch = int(rng.integers(1, len(self.touches) + 1))
                yield Moment(touch=touch, share=float(rng.random()))


def killed(stand: Stand, name: str, wanted: int, rng: np.random.Generator, ends: float) -> int:
    """Kills a command so often, or until the time is up, and looks at what it leaves; the number
    of kills."""
    moments, kills = stand.moments(rng), 0
    for number in itertools.count():
        if kills >= wanted or time.monotonic() > ends:
            return kills
        folder = stand.place / f"{name}-{number}"
        folder.mkdir()
        for moment in itertools.islice(moments, min(CHAIN, wanted - kills)):
            life = stand.run(folder, moment)
            assert life.code in (None, 0), life.said
            kills += life.code is None
        stand.finished(folder)
        shutil.rmtree(folder)
    return kills


def filled(stand: Stand, name: str, wanted: int, rng: np.random.Generator, ends: float) -> int:
    """Runs a command on disks that are too small, then again with room; how often it had said
    so."""
    said = 0
    for number in range(wanted):
        if time.monotonic() > ends:
            break
        with _disk(stand.place / f"{name}-disk-{number}") as disk:
            room = int(rng.uniform(0.02, 1.0) * disk.needed(stand))
            disk.allow(room)
            life = stand.run(disk.folder, limit=disk.limit)
            assert life.code in (0, 2), life.said
            if life.code == 2:
                sentences = life.said.strip().splitlines()
                assert all(line.startswith("poseterior: ") for line in sentences), life.said
                assert max(map(len, sentences)) <= LONGEST
                said += 1
            disk.allow(None)
            stand.finished(disk.folder)
    return said


class _Disk:
    """A folder with little room: a file system of its own where this user may mount one, else a
    limit on the size of every file."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.limit = folder, None
        folder.mkdir()
        self.mounted = not _mount("-t", "tmpfs", "-o", "size=1g", "tmpfs", str(folder))

    def needed(self, stand: Stand) -> int:
        """Bytes that the command's results take, or the largest file of them."""
        whole = stand.place / self.folder.name.replace(
            self.folder.name[self.folder.name.index("-") :], "-whole"
        )
        sizes = [path.stat().st_size for path in whole.rglob("*") if path.is_file()]
        return sum(sizes) if self.mounted else max(sizes)

    def allow(self, room: int | None) -> None:
        """So many bytes; None: enough."""
        if self.mounted:
            size = "1g" if room is None else str(max(room, 4096))
            assert not _mount("-o", f"remount,size={size}", str(self.folder))
        else:
            self.limit = room

    def gone(self) -> None:
        if self.mounted:
            subprocess.run(["umount", str(self.folder)], check=True)
        shutil.rmtree(self.folder)


def _mount(*words: str) -> int:
    command = shutil.which("mount")
    if command is None:
        return 1
    return subprocess.run([command, *words], capture_output=True, check=False).returncode


@contextmanager
def _disk(folder: Path) -> Iterator[_Disk]:
    disk = _Disk(folder)
    try:
        yield disk
    finally:
        disk.gone()


@contextmanager
def _workers(place: Path, wanted: bool) -> Iterator[str]:
    """The address of a scheduler with a worker that outlives the command; empty where none is
    needed."""
    if not wanted:
        yield ""
        return
    file = place / "scheduler.json"
    start = [sys.executable, "-m", "distributed.cli"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard"]
    both = [
        subprocess.Popen([f"{start[0]}", "-m", f"{start[2]}.dask_{kind}", *options, *more], **quiet)
        for kind, more in (
            ("scheduler", ["--port", "0"]),
            ("worker", ["--nthreads", "1", "--nworkers", "1", "--local-directory", str(place)]),
        )
    ]
    try:
        while not file.exists():
            assert both[0].poll() is None, "the scheduler did not start"
            time.sleep(0.1)
        import json

        address = json.loads(file.read_text())["address"]
        yield address
    finally:
        for process in reversed(both):
            process.terminate()
            process.wait()


def campaign(names: list[str], kills: int, seed: int, seconds: float, out: Callable) -> int:
    """Trials of all these commands; the number of those that failed."""
    failures, began = 0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        os.environ["XDG_CACHE_HOME"] = str(place / "cache")
        prepare(place)
        with _workers(place, "evaluate" in names) as scheduler:
            for number, name in enumerate(names):
                rng = np.random.default_rng([seed, [*TRIALS].index(name)])
                left = seconds - (time.monotonic() - began)
                ends = time.monotonic() + left / (len(names) - number)
                try:
                    stand = Stand(name, place, scheduler)
                    done = killed(stand, name, kills, rng, ends)
                    said = filled(stand, name, max(1, kills // 10), rng, ends)
                except AssertionError:
                    failures += 1
                    out(f"{name}: FAILED\n{traceback.format_exc()}")
                    continue
                out(
                    f"{name}: {done} kills, {said} full disks; the same bits as a run of"
                    f" {stand.seconds:.1f} s that touches its folder {len(stand.touches)} times"
                )
    return failures


def main() -> int:
    """A campaign by the environment; 1 where something failed."""
    kills, seed = int(os.environ.get("KILLS", "50")), int(os.environ.get("KILLS_SEED", "0"))
    seconds = float(os.environ.get("KILLS_SECONDS", "inf"))
    names = sys.argv[1:] or [*TRIALS]
    return int(campaign(names, kills, seed, seconds, partial(print, flush=True)) > 0)


if __name__ == "__main__":
    sys.exit(main())
