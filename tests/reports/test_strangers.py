"""The views of reports/strangers.md: what was seen lies beside what is true as it was made."""

import dataclasses

import numpy as np
import pytest

from poseterior.inference.studies.person_views import beside
from poseterior.probmodel import DetectorErrors
from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.skeleton import NUM_JOINTS, PARENTS
from poseterior.reports.pages import films, strangers
from tests.filmed import filmed, moving

SPREAD, FREEDOM = 0.05, 8.0


def law(**changes: object) -> DetectorErrors:
    sure = dataclasses.replace(
        DetectorErrors.default(),
        law=Student(FREEDOM),
        sigma=np.full(NUM_JOINTS, SPREAD),
        inlier=np.ones(NUM_JOINTS),
        definition=np.zeros((NUM_JOINTS, 3)),
        definition_sd=np.zeros((NUM_JOINTS, 3)),
    )
    return dataclasses.replace(sure, **changes)


def test_a_film_without_errors_is_seen_where_it_is() -> None:
    session = filmed(moving(8), np.zeros((4, 8, NUM_JOINTS, 2)))
    views = strangers.views_of_session(session, session.people, 16)
    assert len(views) == 16
    assert len({view.person for view in views}) == 4
    for view in views:
        limbs = beside(view)[list(strangers.JUDGED)]
        assert np.abs(limbs).max() < 12.0  # mm: of the two focal lengths of a camera


def test_errors_have_the_moments_of_their_law() -> None:
    """Of a Student law with df degrees of freedom the variance is df / (df − 2); each of 15 × 2,000
    errors' squares has a relative deviation of 2, so that 7 % are six standard errors."""
    rng = np.random.default_rng(0)
    errors = np.stack([strangers.strays_of(law(), rng) for _ in range(2000)])
    wanted = SPREAD**2 * FREEDOM / (FREEDOM - 2)
    assert np.mean(errors**2) == pytest.approx(wanted, rel=0.07)
    assert np.mean(errors**2) != pytest.approx(SPREAD**2, rel=0.07)  # those of a Gaussian
    astray = law(inlier=np.zeros(NUM_JOINTS))
    far = np.stack([strangers.strays_of(astray, rng) for _ in range(2000)])
    radius = np.linalg.norm(far, axis=-1) / astray.outlier_radius
    assert radius.max() <= 1.0
    assert np.mean(radius**2) == pytest.approx(0.5, abs=0.01)  # all over the disc


def test_errors_of_a_film_last_and_are_in_every_frame_as_the_law_says() -> None:
    """Of 15 joints, 2 directions and 400 films: the variance's deviation is 2 % of it, that of the
    correlation 0.01. Errors that were new in every frame, or the same, have none, or 1."""
    rng, rate, lag = np.random.default_rng(1), 30.0, 3
    some = np.stack([films.lasting_errors(law(), 1 + lag, rate, rng) for _ in range(400)])
    assert np.mean(some**2) == pytest.approx(SPREAD**2 * FREEDOM / (FREEDOM - 2), rel=0.08)
    constant, slow, _ = films.ERROR_SHARES
    wanted = constant + slow * np.exp(-lag / (rate * films.ERRORS_LAST))
    first, last = some[:, 0].ravel(), some[:, lag].ravel()
    assert np.corrcoef(first, last)[0, 1] == pytest.approx(wanted, abs=0.05)


@pytest.mark.parametrize("metres", [1.0, 8.0])
def test_a_body_is_seen_through_the_lens(metres: float) -> None:
    """A nearly perfect detector sees joints where the pinhole has them, whole and in its place."""
    rng = np.random.default_rng(3)
    pose = np.zeros((NUM_JOINTS, 3))
    for joint in range(1, NUM_JOINTS):
        pose[joint] = pose[PARENTS[joint]] + 250 * rng.normal(size=3) / np.sqrt(3)
    sharp = law(sigma=np.full(NUM_JOINTS, 1e-3))
    turn, errors = strangers.camera_turn(rng), strangers.strays_of(sharp, rng)
    view = strangers.seen_from(turn, pose, np.zeros((NUM_JOINTS, 3)), errors, metres, "ann")
    assert view.truth[0] == pytest.approx([0, 0, 1000 * metres])
    bones = np.linalg.norm(view.truth[1:] - view.truth[list(PARENTS[1:])], axis=1)
    own = np.linalg.norm(pose[1:] - pose[list(PARENTS[1:])], axis=1)
    assert bones == pytest.approx(own)
    seen = view.detection.seen
    assert np.nanmax(np.abs(beside(view)[seen])) < 5.0
