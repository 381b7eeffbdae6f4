"""What is said of a camera that is too near for weak perspective: by pinhole projections of bodies
made here, at distances that are known."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

from poseterior.probmodel import Detection, Lens, PoseModel
from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.camera import FOCAL_MEDIAN
from poseterior.probmodel.distance import farthest, nearest
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS
from poseterior.reports.doubts import about_the_camera
from poseterior.reports.figures.files import photo_focal
from poseterior.reports.options import FAR_ENOUGH, RootKind, Viewing

SIZE = (1080, 1920)


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


def person(model: PoseModel, metres: float, turned: float = 0.0) -> Detection:
    """All bones of the mean length across the image, before a usual camera; or turned out of it."""
    low, high, alpha, beta = map(np.asarray, model.lengths)
    mean = low + (high - low) * alpha / (alpha + beta)
    joints = np.zeros((NUM_JOINTS, 2))
    for bone in BONES:
        across = mean[bone.length_group] * np.cos(np.radians(turned))
        joints[bone.end] = joints[bone.start] + [0.0, across]
    focal = FOCAL_MEDIAN * max(SIZE)
    keypoints = focal * joints * MILLIMETRES / 1000 / metres + np.array(SIZE) / 2
    return Detection(keypoints, np.ones(NUM_JOINTS), "skeleton_15", "made here", 0)


@pytest.mark.parametrize("metres", [1.0, 2.5, 8.0])
def test_the_farthest_is_never_nearer_than_the_person(model: PoseModel, metres: float) -> None:
    """And hardly farther, where bones lie across the image: by what lengths of people vary."""
    assert metres < farthest(person(model, metres), SIZE, model.lengths) < 1.3 * metres
    turned = farthest(person(model, metres, turned=60), SIZE, model.lengths)
    assert turned == pytest.approx(2 * farthest(person(model, metres), SIZE, model.lengths))


def test_two_wrong_keypoints_say_nothing(model: PoseModel) -> None:
    seen = person(model, 8.0)
    wrong = seen.keypoints.copy()
    for bone in [bone for bone in BONES if bone.name.endswith("forearm")][:2]:
        wrong[bone.end] += 900.0
    stray = dataclasses.replace(seen, keypoints=wrong)
    assert farthest(stray, SIZE, model.lengths) > FAR_ENOUGH


SEEN_BY = [
    ("uncertain", None, 1.5, SIZE, 5, "the focal length is drawn with the rest"),
    ("uncertain", None, 8.0, SIZE, 0, None),
    ("uncertain", None, 1.5, None, 0, "not known how large the image is"),
    ("uncertain", "weak", 1.5, None, 0, None),
    ("uncertain", "weak", 1.5, SIZE, 0, None),
    ("uncertain", "unknown", 8.0, SIZE, 5, None),
    ("uncertain", "1000", 1.5, SIZE, 1, None),
    ("fixed", None, 1.5, SIZE, 0, None),
]
"""Root, `--focal`, metres to a person, size of the image; of how many focal lengths one is drawn
(0: weak perspective), and what is said."""


@pytest.mark.parametrize(("root", "focal", "metres", "size", "number", "said"), SEEN_BY)
def test_the_camera_is_unknown_where_people_are_near(
    model: PoseModel,
    root: str,
    focal: str | None,
    metres: float,
    size: tuple[int, int] | None,
    number: int,
    said: str | None,
) -> None:
    people = [person(model, metres)]
    viewing = Viewing(root=RootKind(root), focal=focal)
    within = nearest(people, size, model.lengths)
    seen_by = viewing.seen_by(model, within, size)
    assert (0 if seen_by.lens is None else seen_by.lens.number) == number
    sentences = about_the_camera(within, size, seen_by, viewing)
    assert [said is not None and said in one for one in sentences] == [True] * (said is not None)
    assert all("within 1.8 m" in sentence for sentence in sentences if size is not None)


@pytest.mark.parametrize(
    ("samplers", "number", "said"),
    [
        (["weighted-roots", "rejection"], 5, "the focal length is drawn with the rest"),
        (["rejection", "emcee"], 0, "too narrow: give --focal, in pixels, or take weighted-roots"),
    ],
)
def test_samplers_that_cannot_draw_a_focal_length_get_none(
    model: PoseModel, samplers: list[str], number: int, said: str
) -> None:
    seen_by = Viewing().seen_by(model, 1.5, SIZE, None, samplers)
    assert (0 if seen_by.lens is None else seen_by.lens.number) == number
    (sentence,) = about_the_camera(1.5, SIZE, seen_by, Viewing(), None, samplers)
    assert said in sentence


def test_one_person_says_whether_the_camera_is_near(model: PoseModel) -> None:
    near, far = person(model, 1.5), person(model, 8.0)
    assert nearest(iter([far, near, far]), SIZE, model.lengths) < FAR_ENOUGH
    assert nearest([far, far], SIZE, model.lengths) > FAR_ENOUGH


@pytest.mark.parametrize(
    ("viewing", "said"),
    [
        ({"focal": "weak", "principal": "540,960"}, "--principal says nothing under weak persp"),
        ({"principal": "540,960"}, "--principal says nothing under weak perspective"),
        ({"focal": ""}, "--focal must be pixels of the image"),
        ({"focal": "unknown", "root": RootKind.fixed}, "leave --root fixed out"),
    ],
)
def test_what_cannot_be_said_of_a_camera(
    model: PoseModel, viewing: dict[str, Any], said: str
) -> None:
    with pytest.raises(BadInput, match=said):
        Viewing(**viewing).seen_by(model, 8.0, SIZE)


def test_an_optical_axis_is_taken_where_the_focal_length_is_drawn(model: PoseModel) -> None:
    lens = Viewing(principal="500,900").seen_by(model, 1.5, SIZE).lens
    assert lens is not None
    np.testing.assert_array_equal(lens.principal, [500.0, 900.0])


def test_who_is_hardly_seen_is_not_judged(model: PoseModel) -> None:
    seen = person(model, 1.5)
    score = np.zeros(NUM_JOINTS)
    score[:4] = 1.0
    keypoints = np.where(score[:, None] > 0, seen.keypoints, np.nan)
    hidden = dataclasses.replace(seen, keypoints=keypoints, score=score)
    assert np.isnan(farthest(hidden, SIZE, model.lengths))
    assert nearest([hidden], SIZE, model.lengths) == np.inf


def photo(folder: Path, says: object, orientation: int = 1) -> Path:
    """An image of 600 × 400 pixels; with 30 mm, a diagonal of film is 43.3 mm, so many pixels."""
    image = Image.new("RGB", (600, 400))
    exif = image.getexif()
    exif[ExifTags.Base.Orientation] = orientation
    if says is not None:
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = says
    image.save(folder / "photo.jpg", exif=exif)
    return folder / "photo.jpg"


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_photo_says_its_focal_length(tmp_path: Path, orientation: int) -> None:
    """A frame of film has the proportions of this photo: 36 mm are 600 pixels."""
    assert photo_focal(photo(tmp_path, 30, orientation)) == pytest.approx(30 * 600 / 36)


@pytest.mark.parametrize("says", [None, 0])
def test_a_photo_that_says_none(tmp_path: Path, says: object) -> None:
    assert photo_focal(photo(tmp_path, says)) is None


def test_the_lens_of_a_photo(model: PoseModel) -> None:
    lens = Viewing(focal="exif").seen_by(model, np.inf, (600, 400), 500.0).lens
    assert lens is not None
    assert (float(lens.focal), lens.principal.tolist()) == (500.0, [300.0, 200.0])
    with pytest.raises(BadInput, match="whose EXIF says FocalLengthIn35mmFilm"):
        Viewing(focal="exif").seen_by(model, np.inf, (600, 400))


def test_another_focal_length_than_the_photos_is_doubted(model: PoseModel) -> None:
    near, middle = 1.5, np.array(SIZE) / 2
    for focal, doubted in ((1000.0, False), (1200.0, False), (1300.0, True), (700.0, True)):
        seen_by, viewing = model.seen_by(Lens(focal, middle)), Viewing(focal=str(focal))
        said = about_the_camera(near, SIZE, seen_by, viewing, 1000.0)
        assert bool(said) == doubted
        assert all("1000 pixels, not" in sentence for sentence in said)
    unknown = model.seen_by(Lens.unknown(3000.0, middle))
    assert about_the_camera(near, SIZE, unknown, Viewing(focal="unknown"), 1000.0) == []
    (sentence,) = about_the_camera(near, SIZE, unknown, Viewing(), 1000.0)
    assert "in pixels or exif (1000 pixels)" in sentence
