"""What is said of a camera that is too near for weak perspective: by pinhole projections of bodies
made here, at distances that are known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from poseterior.probmodel import Detection, Lens, PoseModel
from poseterior.probmodel.camera import FOCAL_MEDIAN
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS
from poseterior.reports.doubts import FAR_ENOUGH, MILLIMETRES, about_the_camera, farthest
from poseterior.reports.figures.files import photo_focal
from poseterior.reports.options import Prior, Viewing

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
    assert metres < farthest(person(model, metres), SIZE, model) < 1.3 * metres
    turned = farthest(person(model, metres, turned=60), SIZE, model)
    assert turned == pytest.approx(2 * farthest(person(model, metres), SIZE, model))


def test_two_wrong_keypoints_say_nothing(model: PoseModel) -> None:
    seen = person(model, 8.0)
    wrong = seen.keypoints.copy()
    for bone in [bone for bone in BONES if bone.name.endswith("forearm")][:2]:
        wrong[bone.end] += 900.0
    stray = dataclasses.replace(seen, keypoints=wrong)
    assert farthest(stray, SIZE, model) > FAR_ENOUGH


def test_a_near_camera_is_spoken_of(model: PoseModel) -> None:
    near, far = person(model, 1.5), person(model, 8.0)
    (sentence,) = about_the_camera([near], SIZE, model)
    assert "within 1.8 m" in sentence
    assert "--focal" in sentence
    assert about_the_camera([far], SIZE, model) == []
    assert about_the_camera([near, far, far], SIZE, model) == []
    assert about_the_camera([near], None, model) == []
    assert about_the_camera([near], SIZE, model.seen_by(Lens(1000.0, np.array(SIZE) / 2))) == []


def test_who_is_hardly_seen_is_not_judged(model: PoseModel) -> None:
    seen = person(model, 1.5)
    score = np.zeros(NUM_JOINTS)
    score[:4] = 1.0
    keypoints = np.where(score[:, None] > 0, seen.keypoints, np.nan)
    hidden = dataclasses.replace(seen, keypoints=keypoints, score=score)
    assert np.isnan(farthest(hidden, SIZE, model))
    assert about_the_camera([hidden], SIZE, model) == []


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
    lens = Viewing(focal="exif")._lens((600, 400), 500.0)
    assert lens is not None
    assert (float(lens.focal), lens.principal.tolist()) == (500.0, [300.0, 200.0])
    with pytest.raises(BadInput, match="whose EXIF says FocalLengthIn35mmFilm"):
        Viewing(focal="exif").model(Prior(), (600, 400))


def test_another_focal_length_than_the_photos_is_doubted(model: PoseModel) -> None:
    near, middle = [person(model, 1.5)], np.array(SIZE) / 2
    for focal, doubted in ((1000.0, False), (1200.0, False), (1300.0, True), (700.0, True)):
        said = about_the_camera(near, SIZE, model.seen_by(Lens(focal, middle)), 1000.0)
        assert bool(said) == doubted
        assert all("1000 pixels, not" in sentence for sentence in said)
    unknown = model.seen_by(Lens.unknown(3000.0, middle))
    assert about_the_camera(near, SIZE, unknown, 1000.0) == []
    (sentence,) = about_the_camera(near, SIZE, model, 1000.0)
    assert "in pixels or exif (1000 pixels)" in sentence
