"""How long files of 2D joints take to read: `make bench`."""

import json

from poseterior.probmodel import read_frames
from poseterior.probmodel.layouts import BODY_25
from tests.probmodel.test_formats import flat, openpose


def test_a_thousand_frames_of_a_folder(benchmark, tmp_path):
    text = json.dumps(openpose(flat(BODY_25.points)))
    for number in range(1_000):
        (tmp_path / f"{number:012d}_keypoints.json").write_text(text)
    assert benchmark(lambda: sum(len(frame.people) for frame in read_frames(tmp_path))) == 1_000
