"""Heatmaps made from known joints come back, at several sharpnesses and occlusions; the right ones
are missing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.heatmaps import (
    THRESHOLD,
    Crop,
    decode,
    modes,
    quarter_argmax,
    soft_argmax,
)
from poseterior.probmodel.layouts import COCO_17, MPII_16
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS

SIDE = 64
RNG = np.random.default_rng
NEAR = 0.3
"""Heatmap pixels within which a joint must come back."""


def blobs(
    centres: np.ndarray,
    width: float,
    height: np.ndarray | float = 1.0,
    shape: tuple[int, int] = (SIDE, SIDE),
):
    """Gaussian heatmaps `(J, H, W)` around `centres` `(J, 2)`, heatmap pixels."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    square = (x - centres[:, 0, None, None]) ** 2 + (y - centres[:, 1, None, None]) ** 2
    return np.broadcast_to(height, len(centres))[:, None, None] * np.exp(-square / 2 / width**2)


def random_centres(seed: int, count: int = MPII_16.count, margin: float = 6.0) -> np.ndarray:
    return RNG(seed).uniform(margin, SIDE - 1 - margin, (count, 2))


@pytest.mark.slow
@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_joints_come_back_at_every_sharpness(width: float, noise: float) -> None:
    """Twelve people each: all joints within 0.3 heatmap pixels. Noise: uniform, 2 % of the peak,
    never negative."""
    errors = []
    for seed in range(12):
        centres = random_centres(seed)
        maps = blobs(centres, width) + RNG(seed).uniform(
            0, noise + 1e-12, (MPII_16.count, SIDE, SIDE)
        )
        found = decode(maps, MPII_16, threshold=0.0).detection
        truth = MPII_16.to_skeleton(np.column_stack([centres, np.ones(len(centres))]), 0.0)[0]
        errors.append(np.linalg.norm(found.keypoints - truth, axis=1))
    assert np.max(errors) < NEAR, np.max(errors)


@pytest.mark.parametrize("width", [1.0, 2.0, 3.0])
def test_the_quarter_shift_is_right_to_a_quarter_of_a_pixel_along_either_axis(width: float) -> None:
    """Which is all that it can be: up to 0.35 pixels in all. The argmax alone errs by up to half a
    pixel."""
    errors, plain = [], []
    for seed in range(12):
        centres = random_centres(seed)
        for centre, heatmap in zip(centres, blobs(centres, width), strict=True):
            top = modes(heatmap)[0]
            errors.append(np.abs(quarter_argmax(heatmap, top) - centre).max())
            plain.append(np.abs(np.array(top[::-1]) - centre).max())
    assert np.max(errors) <= 0.25 + 1e-9
    assert np.max(plain) > 0.45  # the control


@settings(max_examples=100, deadline=None)
@given(st.floats(6, 57), st.floats(6, 57), st.floats(1.0, 4.0), st.floats(0.01, 100))
def test_soft_argmax_is_unbiased_and_knows_no_unit(
    x: float, y: float, width: float, height: float
) -> None:
    heatmap = blobs(np.array([[x, y]]), width, height)[0]
    np.testing.assert_allclose(soft_argmax(heatmap, modes(heatmap)[0]), [x, y], atol=0.1)


@pytest.mark.parametrize("corner", [(0, 0), (0, 63), (63, 63), (0.4, 30.0)])
def test_at_the_border_a_joint_is_not_pulled_inside(corner: tuple[float, float]) -> None:
    heatmap = blobs(np.array([corner]), 2.0)[0]
    assert np.abs(soft_argmax(heatmap, modes(heatmap)[0]) - corner).max() <= 0.5


@pytest.mark.parametrize("width", [1.5, 2.0, 3.0])
def test_hidden_joints_are_missing_and_only_those(width: float) -> None:
    """A hidden joint's heatmap is empty, flat or faint: its mean lies under 0.002, as in the
    paper."""
    names = [name for name in MPII_16.points if name in JOINT_INDEX]
    for seed in range(30):
        rng = RNG(seed)
        hidden = set(
            rng.choice([n for n in names if "_" in n], rng.integers(0, 7), replace=False).tolist()
        )
        height = np.array(
            [
                0.05 * rng.random() * (name in hidden) + (name not in hidden)
                for name in MPII_16.points
            ]
        )
        maps = blobs(random_centres(seed), width, height) + 1e-4
        person = decode(maps, MPII_16).detection
        missing = {name for name, seen in zip(JOINTS, person.seen, strict=True) if not seen}
        assert missing == hidden


def test_the_score_is_the_mean_and_alpha_its_share() -> None:
    maps = blobs(random_centres(1), 2.0, np.linspace(0.2, 1, MPII_16.count))
    person = decode(maps, MPII_16, threshold=0.0).detection
    for index, name in enumerate(MPII_16.points):
        if name in JOINT_INDEX:
            assert person.score[JOINT_INDEX[name]] == pytest.approx(maps[index].mean())
    assert np.nanmean(person.alpha()) == pytest.approx(1)


def test_a_sharp_peak_of_one_pixel_lies_under_the_papers_threshold() -> None:
    """σ = 1 on 64 × 64 has a mean of 2π/4096 = 0.0015: real networks blur more; a threshold of
    one's own helps."""
    maps = blobs(random_centres(0), 1.0)
    assert maps.mean(axis=(1, 2)).max() < THRESHOLD
    assert not decode(maps, MPII_16).detection.seen.any()
    assert decode(maps, MPII_16, threshold=1e-3).detection.seen.all()


@pytest.mark.parametrize("shape", [(64, 64), (64, 48), (96, 72)])
def test_from_the_heatmap_to_the_image(shape: tuple[int, int]) -> None:
    """Whatever the box, a joint at a known place of the image comes back to it."""
    rng = RNG(shape[1])
    corner, size = rng.uniform(-50, 400, 2), rng.uniform(100, 700, 2)
    share = rng.uniform(0.15, 0.85, (COCO_17.count, 2))
    maps = blobs(share * np.array(shape[::-1]) - 0.5, 2.0, shape=shape)
    person = decode(maps, COCO_17, Crop(corner, size)).detection
    truth = COCO_17.to_skeleton(np.column_stack([corner + share * size, np.ones(17)]), 0.0)[0]
    pixel = size / np.array(shape[::-1])
    seen = [JOINT_INDEX[name] for name in COCO_17.points if name in JOINT_INDEX]
    assert (np.abs(person.keypoints - truth)[seen] / pixel).max() < 0.1


def test_hourglass_boxes_are_two_hundred_pixels_a_unit() -> None:
    crop = Crop.around(np.array([300.0, 200.0]), 1.5)
    np.testing.assert_allclose(crop.size, [300, 300])
    np.testing.assert_allclose(crop.image(np.array([31.5, 31.5]), (64, 64)), [300, 200])


def test_several_modes_are_kept_as_alternatives() -> None:
    centres = random_centres(3)
    maps = blobs(centres, 2.0)
    other = np.array([[12.0, 50.0]])
    wrist = MPII_16.points.index("right_wrist")
    maps[wrist] = blobs(np.array([[45.0, 20.0]]), 2.0)[0] + 0.7 * blobs(other, 2.0)[0]
    decoded = decode(maps, MPII_16)
    assert set(decoded.alternatives) == {"right_wrist"}
    (row,) = decoded.alternatives["right_wrist"]
    np.testing.assert_allclose(row[:2], other[0], atol=NEAR)
    score = decoded.detection.score[JOINT_INDEX["right_wrist"]]
    assert row[2] == pytest.approx(0.7 * score, rel=0.02)
    np.testing.assert_allclose(
        decoded.detection.keypoints[JOINT_INDEX["right_wrist"]], [45, 20], atol=NEAR
    )


def test_a_plateau_is_one_maximum() -> None:
    heatmap = np.zeros((SIDE, SIDE))
    heatmap[20:23, 30:33] = 1.0
    assert len(modes(heatmap)) == 1
    assert len(modes(np.zeros((SIDE, SIDE)))) == 1


@pytest.mark.parametrize(
    ("maps", "match"),
    [
        (np.zeros((15, 64, 64)), r"shape \(15, 64, 64\), but mpii_16 needs \(16, height, width\)"),
        (np.zeros((16, 64)), r"shape \(16, 64\)"),
        (np.full((16, 8, 8), np.inf), "not finite"),
        (np.zeros((16, 1, 8)), "sides from 2"),
    ],
)
def test_what_are_no_heatmaps(maps: np.ndarray, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        decode(maps, MPII_16)
