"""The warm-up: a second process that compiles while this one imports, estimates and
compiles the rest: first the loops of proposals, or those that weight limbs where the
root is uncertain, then the programs of what comes after them. Numba compiles under one
lock, so that threads do not help; both processes share its cache, and JAX's.

    begin("fixed")  # at the start of a command that draws, before heavy imports
    wait()          # before the first proposal
    finish()        # before a result is made of draws

Where anything of it fails, this process compiles the loops itself, as it would
without."""

import atexit
import os
import select
import subprocess
import sys
import threading
from typing import Any

from poseterior.inference.exact.loops.cache_folder import FOLDER

COMPILED = {"fixed": "proposals.propose_limb", "uncertain": "pairs.combine_rows"}
"""By the kind of root: the loop that is in the cache folder where all are."""
TIMEOUT = 120.0
"""Seconds that are waited for the other process at most."""
READY = b"loops\n"
"""What the other process says once the loops are compiled."""
_other: subprocess.Popen | None = None
_one_waits = threading.Lock()


def missing(root: str) -> bool:
    """Whether loops for this kind of root have yet to be compiled, so that a command
    takes longer than it will the next time."""
    return FOLDER is None or not any(FOLDER.rglob(f"{COMPILED[root]}-*.nbi"))


def begin(root: str) -> None:
    """Starts the other process for this kind of root, where there is something to
    compile, a cache folder, and a core to do it."""
    global _other
    if _other is not None or FOLDER is None or not missing(root) or (os.cpu_count() or 1) < 2:
        return
    # -P: a folder `inference` where the user happens to be is not ours.
    command = [sys.executable, "-P", "-m", "poseterior.inference.exact.warm_up", root]
    quiet = subprocess.DEVNULL
    try:
        _other = subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet)
    except OSError:
        return
    atexit.register(_other.kill)


def wait() -> None:
    """Returns once the other process, if there is one, has compiled the loops, or has
    ended."""
    if _other is None or _other.stdout is None:
        return
    with _one_waits:
        if not _other.stdout.closed:
            if not select.select([_other.stdout], [], [], TIMEOUT)[0]:
                _other.kill()
            _other.stdout.close()


def finish() -> None:
    """Returns once the other process, if there is one, has ended: then its programs are
    there."""
    if _other is None:
        return
    try:
        _other.wait(TIMEOUT)
    except subprocess.TimeoutExpired:
        _other.kill()


def signatures() -> dict[str, tuple]:
    """The types of what the engine calls each loop of proposals with."""
    import numba
    import numpy as np

    from poseterior.inference.exact.loops import tables

    reals = np.zeros(0)
    indices = np.zeros(0, np.int64)
    alias = np.zeros(0, tables.ALIAS)
    limb = tables.CutLimb(
        tables.LimbProblem(np.eye(3), np.zeros((2, 2)), np.ones(2)),
        tables.LimbTables(np.zeros(1, tables.CELLS), (0.0,) * 6, False, False, 2),
        tables.Strata(
            subs=np.zeros(0, tables.SUBS),
            alias=alias,
            entries=np.zeros(0, tables.ENTRIES),
            starts=indices,
            ends=indices,
            totals=reals,
        ),
    )
    bins = tables.LengthBins(
        tables.LengthLaw(0.0, 0.0, 0.0, 0.0),
        mass=reals,
        proposed=reals,
        edges=reals,
        alias=alias,
        slices=np.zeros(0, tables.SLICES),
    )
    state = np.zeros(4, np.uint64)
    bodies = tables.Bodies(np.zeros((0, 2)), np.zeros((0, 1, 3)), np.zeros((0, 1, 3)))
    pair = tables.workspace_pair(1)
    given = {
        "propose_lengths": (state, indices, 0, (bins, bins), True, pair[0]),
        "propose_limb": (state, limb, 1, 0, pair[0]),
        "add_bodies": (state, 0, pair, indices, bodies, 0),
    }
    return {name: tuple(map(numba.typeof, values)) for name, values in given.items()}


def programs(root: str) -> None:
    """Has JAX compile what a result of this kind of root is made of, for an embedded
    example: its programs serve every detection."""
    import numpy as np

    from poseterior.inference.draws import Draws, KnownRoots
    from poseterior.inference.estimators import estimate_torso
    from poseterior.inference.results import tree_of
    from poseterior.probmodel.errors.faults import Faults
    from poseterior.probmodel.example import example
    from poseterior.probmodel.model import PoseModel
    from poseterior.probmodel.pose import Pose
    from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN

    model = PoseModel()
    estimate = estimate_torso(example().detection)
    number = len(estimate.candidates)
    points: Any = np.arange(number)
    poses = Pose.blank(number)
    posterior = estimate.posterior(model, CANDIDATES)
    if root == "uncertain":
        points = posterior.root_prior.points(points)
        posterior = estimate.posterior(model, UNCERTAIN)
    known = KnownRoots(points, np.ones(number) / number, lambda rows: (0.0, 0.0))
    about = {"seed": "0 0", "log_evidence": 0.0, "log_evidence_se": 0.0}
    tree_of(Draws(posterior, points, poses, Faults.none(number), known, about)).load()


def weight_limbs() -> None:
    """Has numba compile what weights limbs, by weighting those of a root that sees
    nothing, under a prior without poses: for that of a model JAX would compile first."""
    import numpy as np

    from poseterior.inference.exact.groups import GroupTables
    from poseterior.inference.exact.loops.tables import CELLS, LimbTables
    from poseterior.inference.importance.limbs import LimbSampling, blind, weigh_limbs
    from poseterior.probmodel.anatomy.limits import NUM_AZIMUTH, NUM_ELEVATION
    from poseterior.probmodel.errors.likelihood import PAPER
    from poseterior.probmodel.skeleton import GROUPS

    cells = np.zeros(NUM_AZIMUTH * NUM_ELEVATION, CELLS)
    tables = {}
    for name, limbs in GROUPS.items():
        bones = len(limbs[0].bones)
        limb = LimbTables(cells, (0.0,) * 6, False, False, bones)
        lengths = np.tile([0.0, 1.0, 2.0, 2.0], (bones, 1))
        tables[name] = GroupTables((limb,) * len(limbs), lengths)
    views = blind(1)
    sampling = LimbSampling(tables, {}, [0, 0], PAPER.law, {1: (1, 2), 2: (1, 2)})
    weigh_limbs(sampling, views, np.zeros(views.reach.shape, bool), 0)


def propose() -> None:
    """Has numba compile the loops of proposals."""
    from poseterior.inference.exact.loops import proposals

    for name, types in signatures().items():
        getattr(proposals, name).compile(types)


LOOPS = {"fixed": propose, "uncertain": weight_limbs}
"""By the kind of root: what compiles its loops."""


def main(root: str) -> None:
    """What the other process does."""
    LOOPS[root]()
    os.write(1, READY)
    if os.environ.get("POSETERIOR_PROGRAMS"):  # else they would be compiled for this process alone
        programs(root)


if __name__ == "__main__":
    main(sys.argv[1])
