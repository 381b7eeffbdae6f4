"""Every sampler against `tests.oracle`, which shares no code with any of them: for every error law,
route, prior of the root, lens and fault, small cases by brute force; and controls that must fail.

Rows come from the registries of the product: a law, a route or a root that is added without being
here fails by its name. Evidence, means and deviations are compared in standard errors, and all
numbers of the table together raise a false alarm in one run of a thousand (`LIMIT`); seeds are
fixed. `tests.oracle_page` writes the table.
"""

import ast
import dataclasses
import functools
import inspect
import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.spatial.transform import Rotation

from poseterior.inference.baselines.catalogue import BaselineSampler
from poseterior.inference.draws import COMPLETE, Draws
from poseterior.inference.sampler import MAKERS, REJECTION
from poseterior.probmodel import DetectorErrors, Estimate, FaultPrior, Likelihood, PoseModel
from poseterior.probmodel.camera import Lens, WeakPerspective
from poseterior.probmodel.errors.detector import Exchange
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, EXCHANGES
from poseterior.probmodel.errors.laws import LAWS, Student
from poseterior.probmodel.root_priors import CANDIDATES, ROOT_PRIORS, UNCERTAIN
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS
from tests import oracle
from tests.oracle import Beliefs, Moments
from tests.scenes import drawer, key, prior_scene

FALSE_ALARM = 1e-3
"""Of the whole table."""
SEEN = (*oracle.TORSO, *oracle.ARM)
FACTOR, UPRIGHT = 0.5, 6.0
SPREADS = dict(zip(SEEN, np.linspace(0.44, 0.6, len(SEEN)), strict=True))
BIASES = dict(zip(SEEN, np.outer([1, -1, 1, -1, 1, 1], [0.15, -0.1]), strict=True))
"""Of a learned law, body units."""
OUTLIERS = {"right_shoulder": 0.1, "left_hip": 0.2, "right_elbow": 0.3, "right_wrist": 0.2}
FAR = 5.0
EXCHANGED = {"legs": 0.1, "arms": 0.2, "body": 0.15}
FOCAL, PRINCIPAL = 650.0, np.array([250.0, 420.0])
"""Pixels: some seven body units away, well beside the axis."""


class Row(NamedTuple):
    """A combination: how the root is believed in, the route, the law, and what else there is."""

    root: str
    route: str
    law: str
    lens: bool = False
    faults: str = "none"
    upright: bool = False
    bias: bool = False

    def __str__(self) -> str:
        also = [name for name in ("lens", "upright", "bias") if getattr(self, name)]
        faults = [] if self.faults == "none" else [self.faults]
        return ", ".join([self.root, self.route, self.law, *also, *faults])


FAULTS = ("none", "outliers", "exchanges")
ROUTES = {
    root: tuple(name for name, kind in MAKERS[root].items() if kind is not BaselineSampler)
    for root in ROOT_PRIORS
}
"""All samplers but the baselines, whose chains are judged by these, by the root's prior."""
PROPOSALS, ROOTED = ROUTES[CANDIDATES], ROUTES[UNCERTAIN]


def table() -> list[Row]:
    """All laws under all routes. Candidates have neither faults nor lens nor uprightness. The fast
    route has every law with every lens and fault, others every law with every fault; what else
    there is goes by turns, so that any two levels meet."""
    rows = []
    for place, law in enumerate(LAWS):
        for turn, route in enumerate(PROPOSALS):
            rows.append(Row(CANDIDATES, route, law, bias=(place + turn) % 2 == 1))
        for at, faults in enumerate(FAULTS):
            turn = place + at
            for lens in (False, True):
                upright, bias = (turn + lens) % 2 == 1, (at // 2 + lens) % 2 == 1
                rows.append(Row(UNCERTAIN, ROOTED[0], law, lens, faults, upright, bias))
            lens, upright, bias = (part % 4 // 2 == 1 for part in (2 * turn, turn, turn + 1))
            for route in ROOTED[1:]:
                rows.append(Row(UNCERTAIN, route, law, lens, faults, upright, bias))
    return rows


ROWS = table()
PARTS = [
    pytest.param(row, marks=[] if place % 3 == 0 else pytest.mark.sweep)
    for place, row in enumerate(ROWS)
]
"""Every third row is among the slow tests: a law has 13, so that each place comes with another."""
COMPARED = len(oracle.NAMES) * 2 + len(oracle.FLAGS) + 1
LIMIT = float(stats.norm.isf(FALSE_ALARM / 2 / (COMPARED * len(ROWS))))
"""Standard errors: 5.0 or so."""
CAUGHT = float(stats.norm.isf(1e-4 / 2))
"""By as many a control must be off in the evidence, a single number that is named beforehand."""


# What the product is given, and what it answers: all that the tests know of it.


@functools.cache
def scene() -> Estimate:
    """Two shoulders, two hips and one arm seen, scores unequal, three torsos in the dictionary; a
    second candidate a little larger and turned."""
    missing = tuple(name for name in JOINTS if name not in SEEN)
    scores = np.linspace(0.6, 1.0, NUM_JOINTS)
    frame = prior_scene(model(), 11, factor=FACTOR, missing=missing, scores=scores)
    first = frame.candidates[0]
    turn = Rotation.from_euler("yx", [14, -9], degrees=True).as_matrix()
    camera = WeakPerspective(
        1.05 * first.camera.scale,
        turn @ np.asarray(first.camera.rotation),
        np.asarray(first.camera.translation) + np.array([4.0, -6.0]),
    )
    return dataclasses.replace(frame, candidates=(first, Candidate(0, first.torso, camera, 0.0)))


@functools.cache
def model() -> PoseModel:
    return PoseModel(torsos=np.asarray(PoseModel().torsos)[[0, 17, 40]])


def likelihood(row: Row) -> Likelihood:
    """Without biases the law's own spread, by scores; with them a detector's learned law."""
    outlier = [OUTLIERS.get(name, 0.0) * (row.faults == "outliers") for name in JOINTS]
    exchange = EXCHANGED if row.faults == "exchanges" else {}
    if not row.bias:
        kinds = tuple(exchange.get(name, 0.0) for name in EXCHANGES if name != "none")
        faults = FaultPrior(tuple(outlier), kinds, FAR)
        return Likelihood(LAWS[row.law](), factor=FACTOR, faults=faults)
    sigma = np.array([SPREADS.get(name, np.nan) / 2 for name in JOINTS])
    bias = np.array([BIASES.get(name, [np.nan, np.nan]) for name in JOINTS])
    inlier = 1 - np.array(outlier)
    return Likelihood.of(
        DetectorErrors(
            LAWS[row.law](),
            sigma,
            inlier,
            bias,
            exchange=Exchange(**exchange),
            outlier_radius=FAR,
        )
    )


def ask(row: Row, seed: int = 3, num_samples: int = 4000, num_roots: int = 1500) -> Draws:
    """The product's draws."""
    people = PoseModel(torsos=model().torsos, upright=UPRIGHT if row.upright else 0.0)
    if row.lens:
        people = people.seen_by(Lens(FOCAL, PRINCIPAL))
    if row.route == REJECTION and row.root == UNCERTAIN:
        num_samples, num_roots = 700, 300
    draw = drawer(
        people, root=row.root, sampler=row.route, num_samples=num_samples, num_roots=num_roots
    )
    return draw(dataclasses.replace(scene(), likelihood=likelihood(row)), key(seed))


def told(draws: Draws, truth: Moments) -> Moments:
    """What draws say of the oracle's quantities; those of one root err together. What hardly ever
    happens may be in none of them, which then have no scatter of their own: it has the true
    share's."""
    joints, size = draws.joints, draws.bone_length
    elbow, wrist, left = (
        joints[:, JOINT_INDEX[name]] for name in ("right_elbow", "right_wrist", "left_wrist")
    )
    cluster = np.arange(len(joints))
    if draws.prior.name == CANDIDATES:
        columns = [size[:, 1], size[:, 2], *elbow[:, [0, 2]].T, *wrist[:, [0, 2]].T]
        flags = [draws.points == 0]
    else:
        root = draws.points
        columns = [root.log_scale, *root.translation.T, root.rotation[:, 2, 2]]
        columns += [root.rotation[:, 2, 1], size[:, 1], size[:, 2], elbow[:, 2]]
        columns += [wrist[:, 0], wrist[:, 2], left[:, 2]]
        outlier = draws.faults.outlier
        flags = [root.torso == 0, outlier[:, JOINT_INDEX["right_wrist"]]]
        flags += [outlier[:, JOINT_INDEX["left_hip"]]]
        flags += [draws.faults.exchange == EXCHANGE_INDEX[name] for name in ("arms", "body")]
        cluster = root.log_scale
    moments = oracle.moments(
        np.ones(len(joints)),
        np.column_stack(columns),
        np.column_stack(flags).astype(float),
        cluster,
        truth.centre,
    )
    centre, mean, error = moments
    effective = len(joints)
    if draws.prior.name == UNCERTAIN:
        effective = min(draws.effective_roots, effective)
    share = truth.mean[-len(flags) :]
    rare = np.sqrt(share * (1 - share) / effective)
    error[-len(flags) :] = np.maximum(error[-len(flags) :], rare)
    return Moments(draws.log_evidence, draws.log_evidence_se, centre, mean, error)


# What the oracle is given.


def beliefs(row: Row, counted: tuple[str, ...] = SEEN) -> Beliefs:
    """The same as plain numbers; scores are normalised over those joints that are `counted`."""
    score = {name: scene().detection.score[JOINT_INDEX[name]] for name in SEEN}
    mean = np.mean([score[name] for name in counted])
    spread = SPREADS if row.bias else {name: FACTOR * mean / score[name] for name in SEEN}
    return Beliefs(
        row.law,
        spread,
        BIASES if row.bias else dict.fromkeys(SEEN, np.zeros(2)),
        outlier=OUTLIERS if row.faults == "outliers" else {},
        far=FAR,
        exchange=EXCHANGED if row.faults == "exchanges" else {},
        upright=UPRIGHT if row.upright else 0.0,
    )


def case(lens: bool) -> oracle.SmallCase:
    detection = scene().detection
    at = {name: detection.keypoints[JOINT_INDEX[name]] for name in SEEN}
    eye = oracle.Lens(FOCAL, PRINCIPAL) if lens else None
    lengths = tuple(np.asarray(one) for one in model().lengths)
    return oracle.SmallCase(at, model().limits, lengths, np.asarray(model().torsos), eye)


def same(row: Row) -> Row:
    """The row without its route: what the oracle depends on."""
    return row._replace(route="")


WIDER = {False: 1.05, True: 1.2}
"""Spreads of a control, without and with a lens, where the evidence says less of them."""
CONTROLS = {
    "scale × s": lambda given, lens: dataclasses.replace(given, wrong_power=1.0),
    "wider spread": lambda given, lens: given.wider(WIDER[lens]),
}


@functools.cache
def known(root: str, lens: bool) -> dict[tuple[Row, str], Moments]:
    """The oracle's answers of all rows of a root's prior and a lens, from the same draws; and wrong
    ones, where there are no faults."""
    wanted = {same(row): beliefs(row) for row in ROWS if (row.root, row.lens) == (root, lens)}
    asked = {(row, ""): given for row, given in wanted.items()}
    for name, change in CONTROLS.items():
        for row, given in wanted.items():
            if row.faults == "none":
                asked[row, name] = change(given, lens)
    if root == UNCERTAIN:
        return oracle.under_roots(case(lens), asked, seed=5)
    pairs = {(row, name): both(row, name) for row, name in asked}
    return oracle.under_candidates(case(lens), candidates(), pairs, 150_000, seed=5)


def both(row: Row, control: str = "") -> tuple[Beliefs, Beliefs]:
    """Of limbs and of torsos, whose scores are normalised apart under fixed roots."""
    change = CONTROLS.get(control, lambda given, lens: given)
    limbs, torsos = (
        change(beliefs(row, counted), row.lens) for counted in (oracle.ARM, oracle.TORSO)
    )
    return limbs, torsos


def candidates() -> tuple[oracle.Candidate, ...]:
    return tuple(
        oracle.Candidate(
            np.asarray(one.torso) @ np.asarray(one.camera.rotation).T,
            float(one.camera.scale),
            np.asarray(one.camera.translation),
        )
        for one in scene().candidates
    )


def apart(row: Row, draws: Draws, control: str = "") -> np.ndarray:
    """Every number that is compared, in standard errors."""
    truth = known(row.root, row.lens)[same(row), control]
    return told(draws, truth).apart(truth)


@functools.cache
def drawn(row: Row) -> Draws:
    return ask(row)


def test_nothing_of_the_product_is_in_the_oracle() -> None:
    tree = ast.parse(inspect.getsource(oracle))
    imported = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert imported == {"collections", "dataclasses", "math", "typing", "numpy", "scipy"}


@pytest.mark.parametrize("law", LAWS)
def test_every_law_has_its_own_formula_in_the_oracle(law: str) -> None:
    """Of mass one, within `WIDEST`."""
    assert law in oracle.DENSITIES

    def ring(size: float) -> float:
        return 2 * math.pi * size * oracle.DENSITIES[law](np.array(size**2))

    assert integrate.quad(ring, 0, oracle.WIDEST, limit=500)[0] == pytest.approx(1, abs=1e-6)


def test_everything_is_in_the_table() -> None:
    """Every law under every route; with torso and camera open, every two levels of a route's law,
    lens, faults, uprightness and biases together at least once."""
    for root, routes in ROUTES.items():
        held = {(row.route, row.law) for row in ROWS if row.root == root}
        assert held == set(itertools.product(routes, LAWS))
    levels = {
        "law": tuple(LAWS),
        "lens": (False, True),
        "faults": FAULTS,
        "upright": (False, True),
        "bias": (False, True),
    }
    for route in ROOTED:
        rows = [row for row in ROWS if (row.root, row.route) == (UNCERTAIN, route)]
        for one, other in itertools.combinations(levels, 2):
            held = {(getattr(row, one), getattr(row, other)) for row in rows}
            missing = set(itertools.product(levels[one], levels[other])) - held
            assert not missing, f"{route} lacks {one} × {other}: {missing}"


@pytest.mark.slow
@pytest.mark.parametrize("row", PARTS, ids=str)
def test_draws_and_evidence_are_those_of_brute_force(row: Row) -> None:
    assert drawn(row).status == COMPLETE
    found = np.abs(apart(row, drawn(row)))
    assert found.max() < LIMIT, found.round(1)


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if row.faults == "none"], ids=str)
def test_a_wrong_prior_and_a_wrong_law_are_seen(row: Row) -> None:
    """Negative controls: a factor of the scale too much in the prior, where it has a scale; a
    spread that is 5 % too wide, under a lens 20 %."""
    for control in CONTROLS:
        if control != "scale × s" or row.root == UNCERTAIN:
            assert abs(apart(row, drawn(row), control)[0]) > CAUGHT, control


QUICK = oracle.Effort(60_000, 30_000, 3_000, 40)


@functools.cache
def quickly_known(row: Row) -> Moments:
    return oracle.under_roots(case(row.lens), {"": beliefs(row)}, 5, QUICK)[""]


def test_limbs_left_under_their_envelope_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Student's law by few roots: right as it is, and far off, 1.2 nats, where what its Gaussian
    envelope proposed is taken as it comes."""
    row = Row(UNCERTAIN, ROOTED[0], "student")
    truth = quickly_known(row)

    def off() -> np.ndarray:
        draws = ask(row, num_samples=1500, num_roots=300)
        return np.abs(told(draws, truth).apart(truth))

    assert off().max() < LIMIT
    monkeypatch.setattr(Student, "exact", True)
    assert off()[0] > 4 * LIMIT


@pytest.mark.parametrize("law", LAWS)
def test_exact_draws_under_candidates_are_those_of_brute_force(law: str) -> None:
    """A part of the table in little: 40,000 arms, 1,000 draws."""
    row = Row(CANDIDATES, PROPOSALS[0], law)
    truth = oracle.under_candidates(case(False), candidates(), {"": both(row)}, 40_000, 5)[""]
    draws = ask(row, num_samples=1000)
    assert np.abs(told(draws, truth).apart(truth)).max() < LIMIT
