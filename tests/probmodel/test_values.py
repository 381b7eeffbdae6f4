"""Detections of what is in memory: arrays, and the results of YOLO-pose, in the order and with the
numbers that were given; everything else is refused by what it is."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.values import detections_of
from poseterior.probmodel.layouts import COCO_17, MPII_16
from poseterior.probmodel.skeleton import JOINT_INDEX

RNG = np.random.default_rng(0)
PEOPLE = RNG.uniform(10, 400, (2, 17, 2))


class Tensor:
    """What PyTorch's are like: no array until they are on the processor."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def detach(self) -> "Tensor":
        return self

    def cpu(self) -> np.ndarray:
        return self.values


def results(xy: np.ndarray, conf: np.ndarray | None) -> SimpleNamespace:
    """As Ultralytics has them for an image of 640 x 480."""
    keypoints = SimpleNamespace(xy=Tensor(xy), conf=None if conf is None else Tensor(conf))
    return SimpleNamespace(keypoints=keypoints, orig_shape=(480, 640), path="photo.jpg")


@pytest.mark.parametrize("give", [np.asarray, np.ndarray.tolist, Tensor])
def test_arrays_lists_and_tensors_are_the_same(give: Any) -> None:
    one, two = detections_of(give(PEOPLE))
    assert (one.layout, one.person, two.person) == ("coco_17", 0, 1)
    for name in ("left_wrist", "right_knee"):
        place = PEOPLE[1, COCO_17.points.index(name)]
        np.testing.assert_array_equal(two.keypoints[JOINT_INDEX[name]], place)
    assert not two.seen[JOINT_INDEX["head"]]
    assert two.face is not None


def test_one_person_needs_no_axis_of_people_and_scores_are_kept() -> None:
    rows = np.column_stack([PEOPLE[0], np.linspace(0, 1, 17)])
    (one,) = detections_of(rows, "coco_17", image_size=(640, 480))
    wrist = COCO_17.points.index("left_wrist")
    assert one.score[JOINT_INDEX["left_wrist"]] == rows[wrist, 2]
    assert one.image_size == (640, 480)


def test_the_layout_is_that_of_so_many_points_or_the_one_named() -> None:
    (one,) = detections_of(RNG.uniform(10, 400, (16, 2)))
    assert one.layout == MPII_16.name
    with pytest.raises(BadInput, match="17 points of a person, but mpii_16 has 16"):
        detections_of(PEOPLE, "mpii_16")


def test_fractions_of_a_known_image_become_pixels() -> None:
    (one, _) = detections_of(PEOPLE / [640, 480], image_size=(640, 480))
    same = detections_of(PEOPLE)[0]
    np.testing.assert_allclose(one.keypoints, same.keypoints, rtol=1e-12)


def test_missing_is_nan_or_where_detectors_put_what_they_did_not_find() -> None:
    people, names = PEOPLE.copy(), ("left_wrist", "right_knee", "left_elbow")
    for name, place in zip(names, (np.nan, 0.0, -1.0), strict=True):
        people[0, COCO_17.points.index(name)] = place
    one, two = detections_of(people)
    for name in names:
        assert not one.seen[JOINT_INDEX[name]]
        assert two.seen[JOINT_INDEX[name]]


def test_results_of_yolo_pose() -> None:
    """Several images are one list of people; points at (0, 0) are none, whatever their score."""
    conf = np.full((2, 17), 0.9)
    xy = PEOPLE.copy()
    xy[0, COCO_17.points.index("left_wrist")] = 0.0
    one, two, three = detections_of([results(xy, conf), results(PEOPLE[:1], None)])
    assert [person.person for person in (one, two, three)] == [0, 1, 2]
    assert one.source == "photo.jpg"
    assert one.image_size == (640, 480)
    assert not one.seen[JOINT_INDEX["left_wrist"]]
    assert two.score[JOINT_INDEX["left_wrist"]] == 0.9
    assert three.score[JOINT_INDEX["left_wrist"]] == 1.0
    assert detections_of(results(np.empty((0, 17, 2)), None)) == [], "nobody was found"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("photo.jpg", "not of str"),
        (None, "not of NoneType"),
        (np.ones((17, 4)), "has the shape"),
        (np.ones(17), "has the shape"),
        ([[1.0], [1.0, 2.0]], "not of list"),
        (np.array([["a", "b"]] * 17), "not of ndarray"),
        (PEOPLE / 500, "are fractions of an image whose size"),
        (PEOPLE * 1e12, "beyond"),
        (np.ones((19, 2)) * 7, "holds 19 points"),
        (SimpleNamespace(keypoints=None, path="a.jpg"), "no keypoints; give those of a pose model"),
        (results(RNG.uniform(10, 400, (1, 21, 2)), None), "21 points of a person, not COCO's 17"),
    ],
)
def test_what_is_neither_is_refused_by_what_it_is(given: Any, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        detections_of(given)


def test_a_notebook_shows_a_detection_and_no_tag_of_a_name() -> None:
    about = results(PEOPLE[:1], None)
    about.path = "<script>x</script>"
    html = detections_of(about)[0]._repr_html_()
    assert "left_wrist" in html
    assert "<script>" not in html
