"""The filmed person of reports/honest.md: how the film is cut, and how draws are judged."""

import numpy as np
import pytest

from poseterior.probmodel import Lens
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS, NUM_JOINTS
from poseterior.reports.pages import filmed as pages
from poseterior.reports.pages import honest
from tests.filmed import detected, filmed, moving


def test_a_film_is_cut_in_two() -> None:
    seen = pages.Film(filmed(moving(9), np.zeros((4, 9, NUM_JOINTS, 2))))
    assert [seen.part_of(frame) for frame in range(9)] == [0] * 5 + [1] * 4
    for part, own, rest in ((0, range(5), range(5, 9)), (1, range(5, 9), range(5))):
        assert seen.part(part).numbers == tuple(own)
        assert seen.unseen(part).numbers == tuple(rest)


def test_a_case_knows_its_camera() -> None:
    """The truth, turned into the camera's axes and put where the hips are, is seen through the lens
    where the straight detection has it, but for the pixel by which its two focal lengths differ."""
    seen = pages.Film(filmed(moving(12), np.zeros((4, 12, NUM_JOINTS, 2))))
    for case in seen.cases[::5]:
        camera = seen.session.straight[case.camera]
        hips = camera.view(seen.session.world.points[case.frame, pages.HIPS].mean(axis=0))
        place = case.truth * seen.session.unit @ case.turns + hips
        image = case.lens.principal + case.lens.focal * place[:, :2] / place[:, 2:]
        assert image == pytest.approx(case.straight.keypoints, abs=1.5)


def test_the_skeletons_truth_is_not_the_midpoints() -> None:
    """Its pelvis lies above and behind the hips' midpoint, which errs as the hips do."""
    seen = pages.Film(filmed(moving(12), np.zeros((4, 12, NUM_JOINTS, 2))))
    case = seen.cases[0]._replace(doubt=np.tile(0.01 * np.eye(3), (NUM_JOINTS, 1, 1)))
    truth = case.skeletal_truth
    assert 0.25 < np.linalg.norm(truth[0] - case.truth[0]) < 0.5
    np.testing.assert_array_equal(truth[2:], case.truth[2:])
    size = case.skeletal_errors(np.random.default_rng(0), 20_000).std(axis=0)
    assert size[0] == pytest.approx(0.0)
    wrist = size[JOINT_INDEX["left_wrist"]]
    # The pelvis is four fifths of two hips' mean, a fifth of two shoulders'.
    assert wrist == pytest.approx(0.1 * np.sqrt(1 + (0.806**2 + 0.194**2) / 2), rel=0.03)


def test_draws_are_judged_in_spreads_and_millimetres() -> None:
    """A truth at the middle of standard normal draws in x, and beyond all of them in y; its own
    doubt, of both coordinates, pulls both towards the middle."""
    rng = np.random.default_rng(0)
    truth = np.zeros((NUM_JOINTS, 3))
    truth[list(LIMB_JOINTS)] = [0.0, 9.0, 0.0]
    doubt = np.zeros((NUM_JOINTS, 3, 3))
    doubt[list(LIMB_JOINTS)] = 81 * np.eye(3)
    detection = detected(np.zeros((NUM_JOINTS, 2)), "film")
    lens = Lens(1000.0, np.zeros(2))
    case = pages.FilmedCase(1, 2, detection, truth, doubt, detection, lens, np.eye(3))
    joints = rng.normal(size=(4000, NUM_JOINTS, 3))
    found = honest.judge(case, pages.FilmedDraws(joints, 50.0, 2.0))
    assert found.bare[:, 0] == pytest.approx(np.full(8, 0.5), abs=0.05)
    assert (found.bare[:, 1] == 1).all()
    assert found.standing[:, 1] == pytest.approx(np.full(8, 0.84), abs=0.03)
    assert found.spread == pytest.approx(np.ones((8, 3)), abs=0.1)
    # Eight of twelve judged joints are 9 body units from the draws' mean.
    assert found.mean == pytest.approx(338 * 9 * 8 / 12, rel=0.02)
    assert found.best > found.mean / 2
    # A limb joint of the truth lies beyond all draws, but for the errors that it may have.
    limbs = np.array(LIMB_JOINTS) - 1
    assert (found.levels[limbs] < 0.5).all()
    exact = honest.judge(case._replace(doubt=0 * doubt), pages.FilmedDraws(joints, 50.0, 2.0))
    assert (exact.levels[limbs] > 0.99).all()
    assert found.stand_ins.shape == (10, NUM_JOINTS - 1)
    nothing = honest.judge(case, pages.FilmedDraws(joints[:0], np.nan, 1.0))
    assert not nothing.drawn
    assert np.isnan(nothing.standing).all()
