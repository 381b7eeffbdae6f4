"""Weighted proposals of the limbs of many roots against exact ones by strata, which share no
proposal with them: evidences, and draws. False alarms: 4.5 standard errors, 7e-6 a number; seeds
are fixed.
"""

import dataclasses
import functools

import numpy as np
import pytest

from poseterior.inference.exact.groups import draw_group, group_tables, plan_group
from poseterior.inference.exact.loops.pairs import combine_rows
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.strata import Resolution
from poseterior.inference.exact.loops.tables import (
    ACCEPTED,
    SIGHT_FRAMES,
    AcceptedRows,
    blank_bodies,
)
from poseterior.inference.exact.problem import limb_problems, log_ratio_of
from poseterior.inference.importance.limbs import (
    LIMBS,
    frames_of,
    outliers_of,
    views_of,
    weigh_group,
)
from poseterior.inference.importance.weighted import weigh_roots
from poseterior.probmodel import Likelihood, PoseModel
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import LAWS
from poseterior.probmodel.pose import GroupDraws
from poseterior.probmodel.skeleton import GROUPS, JOINT_INDEX
from tests.inference.test_error_laws import CutGaussian
from tests.scenes import key, prior_scene

ROOTS, REPEATED, ATTEMPTS = 4, 300, 1 << 15
WRIST = JOINT_INDEX["left_wrist"]


@functools.cache
def scene(upper="angle", lower="area"):
    model = PoseModel(upper=upper, lower=lower)
    return model, prior_scene(model, 21, factor=0.4, missing=("right_elbow",))


def likely_roots(model, frame):
    roots = weigh_roots(
        dataclasses.replace(frame, likelihood=Likelihood(factor=0.4)).posterior(model),
        key=key(3),
        num_roots=40,
    )
    return roots.points.take(np.argsort(-roots.log_weight)[:ROOTS])


def features(draws):
    """`(n, ...)`: one, and all that a draw is."""
    number = len(draws.length)
    columns = [part.reshape(number, int(np.prod(part.shape[1:]))) for part in draws]
    return np.concatenate([np.ones((number, 1)), *columns], axis=1)


def by_strata(model, observation, name):
    """Estimates `(1 + features,)` of a group's evidence times means, with standard errors."""
    tables, limbs = group_tables(model)[name], limb_problems(observation)[name]
    plan = plan_group(tables, limbs, Resolution(4, 3, 1))
    rng, order = np.random.default_rng(5), list(range(len(limbs)))
    bodies, _ = draw_group(plan, tables, limbs, order, rng, seeded([6], 0), proposals=ATTEMPTS)
    draws = GroupDraws(bodies.length[:, : len(tables.lengths)], bodies.upper, bodies.lower)
    log_ratio = log_ratio_of(model, observation, GROUPS[name])
    ratio = np.ones(len(draws.length)) if log_ratio is None else np.exp(log_ratio(draws))
    values = features(draws) * ratio[:, None] * plan.mass
    mean = values.sum(axis=0) / ATTEMPTS
    return mean, np.sqrt(((values**2).sum(axis=0) / ATTEMPTS - mean**2) / ATTEMPTS)


def by_weights(tables, limbs, law, size):
    """The same `(size,)` by weighted attempts, over and over again under one root."""
    repeated = [np.repeat(frames, REPEATED, axis=0) for frames in limbs]
    states = np.array([seeded([7], row) for row in range(REPEATED)])
    found = weigh_group(tables, repeated, law, states, (16, 16))
    values = np.zeros((REPEATED, size))
    for row, one in enumerate(found):
        if len(one.draws.length):
            values[row] = np.exp(one.log_evidence) * features(one.draws).mean(axis=0)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(REPEATED)


def off(model, frame, law, outlier=False):
    """The largest distances, in standard errors, of evidences and of means, and how large the
    errors of the evidences are."""
    frame = dataclasses.replace(frame, likelihood=Likelihood(law, factor=0.4))
    posterior, faults = frame.posterior(model), Faults.none(ROOTS)
    faults.outlier[:, WRIST] = outlier
    points = likely_roots(model, frame)
    limbs = frames_of(views_of(posterior, points, faults), outliers_of(posterior, faults))
    worst, relative = np.zeros(2), []
    for row in range(ROOTS):
        observation = posterior.detected.under(
            posterior.root_prior, points.take(row), faults.take(row)
        )
        for name, tables in group_tables(model).items():
            own = [
                frames[row : row + 1]
                for frames, limb in zip(limbs, LIMBS, strict=True)
                if limb in GROUPS[name]
            ]
            known, error = by_strata(model, observation, name)
            mean, own_error = by_weights(tables, own, law, len(known))
            whole = np.hypot(error, own_error)
            apart = np.abs(mean - known) / np.where(whole > 0, whole, np.inf)
            worst = np.maximum(worst, [apart[0], apart[1:].max()])
            relative.append(whole[0] / known[0])
    return worst, np.array(relative)


def test_weighted_proposals_have_the_evidence_and_draws_of_exact_ones():
    worst, relative = off(*scene(), Likelihood().law)
    assert (worst < 4.5).all()
    assert np.median(relative) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    "law", [*(law() for law in LAWS.values()), CutGaussian()], ids=lambda law: law.name
)
def test_under_every_law(law):
    """A Gaussian by discs of random radii, others by their density at what was found."""
    worst, relative = off(*scene(), law)
    assert (worst < 4.5).all()
    assert np.median(relative) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("law", [law() for law in LAWS.values()])
def test_where_a_keypoint_is_an_outlier(law):
    worst, relative = off(*scene(), law, outlier=True)
    assert (worst < 4.5).all()
    assert np.median(relative) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("upper", "lower"), [("area", "area"), ("angle", "box"), ("area", "box")])
def test_under_other_measures_of_the_prior(upper, lower):
    worst, _ = off(*scene(upper, lower), Likelihood().law)
    assert (worst < 4.5).all()


@pytest.mark.parametrize("upper", ["angle", pytest.param("area", marks=pytest.mark.slow)])
def test_where_everything_is_within_reach_the_prior_comes_back(upper):
    """Evidence one; directions near the poles, where the density by area has no bound, as often
    as the prior says."""
    model, _ = scene(upper)
    for name, tables in group_tables(model).items():
        two, limbs = tables.builds[0].bones, len(GROUPS[name])
        reach = np.full((REPEATED, 2), 20.0)
        reach[:, 1] = 20.0 if two == 2 else np.inf
        turn = np.linalg.qr(np.arange(9).reshape(3, 3) ** 2 + 1.0)[0]
        frames = np.zeros((REPEATED, 2), SIGHT_FRAMES)
        frames["axes"], frames["start"], frames["stretch"] = turn, 1.0, [1.0, 0.0, 1.0]
        frames["reach"] = frames["spread"] = reach
        states = np.array([seeded([8, limbs], row) for row in range(REPEATED)])
        found = weigh_group(tables, [frames] * limbs, Likelihood().law, states, (16, 16))
        evidence = np.exp([one.log_evidence for one in found])
        error = evidence.std(ddof=1) / np.sqrt(REPEATED)
        cells = tables.builds[0].cells["mass"].reshape(120, 60)
        whole = np.prod([build.cells["mass"].sum() for build in tables.builds])
        assert abs(evidence.mean() - whole) < 4.5 * error < 0.06
        lift = np.array([np.degrees(np.arcsin(one.draws.upper[:, 0, 2])) for one in found])
        share = (evidence[:, None] * (np.abs(lift) > 87)).mean(axis=1)
        known = cells[:, [0, -1]].sum() / cells.sum() * whole
        error = share.std(ddof=1) / np.sqrt(REPEATED)
        assert abs(share.mean() - known) < 4.5 * max(error, 1e-4)


def test_pairs_of_proposals_share_their_lengths():
    """Evidence and pairs by hand: the mean over lengths of products, not the product of means."""
    first, second = np.zeros(3, ACCEPTED), np.zeros(3, ACCEPTED)
    first["draw"], first["weight"] = [0, 0, 1], [1.0, 3.0, 2.0]
    second["draw"], second["weight"] = [1, 1, 2], [5.0, 1.0, 7.0]
    for found in (first, second):
        found["upper"] = np.arange(3)[:, None]  # the proposal's number
        found["lower"] = -found["upper"]
    ends, lengths = np.array([3]), np.arange(6.0).reshape(2, 1, 3)
    one, two = AcceptedRows(first, ends), AcceptedRows(second, ends)
    draws = blank_bodies(600, 2)
    evidence = combine_rows(seeded([9], 0)[None], one, two, lengths, 4, draws)
    assert evidence[0] == pytest.approx(2.0 * 6.0 / (3 * 4**2))
    length, upper, lower = draws
    assert (length == [1, 4]).all()
    assert (lower == -upper).all()
    assert (upper[:, 0] == 2).all()
    assert set(upper[:, 1, 0]) == {0, 1}
    assert abs((upper[:, 1, 0] == 0).mean() - 5 / 6) < 4.5 * np.sqrt(5 / 36 / 600)
