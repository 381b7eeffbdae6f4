"""A network end to end: built here, so small that its heatmaps can be told by hand. It finds
coloured dots."""

import gc
import json
import re
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from PIL import Image, ImageDraw

from poseterior.inference.detector import PADDING, Network, cut_out
from poseterior.probmodel import BadInput, read_detections
from poseterior.probmodel.heatmaps import Crop
from poseterior.probmodel.layouts import COCO_17, MPII_16
from poseterior.probmodel.skeleton import JOINT_INDEX
from tests.conftest import Cli
from tests.probmodel.test_formats import STANDING

HUES = np.array([[255, 40 + 200 * (i % 4) // 3, 200 * (i // 4) // 3] for i in range(MPII_16.count)])
"""A colour for each joint; no two are nearer to each other than the network's tolerance."""
SIDE = 128
VIEWS = (
    (1.0, (20.0, 10.0), (160, 190)),
    (2.3, (31.7, 40.2), (300, 480)),
    (0.9, (3.0, 4.0), (100, 160)),
)
"""Scale and shift of the person, size of the image."""


def dot_network(
    path: Path, *, side: int | None = SIDE, channels: int = MPII_16.count, sharp: float = 0.002
) -> Path:
    """Heatmap j = exp(-sharp · |pixel - colour j|²), averaged over 2 × 2 pixels."""
    colours = HUES[np.arange(channels) % MPII_16.count].astype(np.float32)
    # |p - c|² = |p|² - 2 c·p + |c|²: one convolution of 1 × 1 over the pixels and their squares.
    weight = np.concatenate([-2 * colours, np.ones((channels, 3), np.float32)], axis=1)[
        :, :, None, None
    ]
    bias = (colours**2).sum(axis=1)
    nodes = [
        helper.make_node("Mul", ["image", "image"], ["squares"]),
        helper.make_node("Concat", ["image", "squares"], ["both"], axis=1),
        helper.make_node("Conv", ["both", "weight", "bias"], ["distance"]),
        helper.make_node("Mul", ["distance", "sharp"], ["scaled"]),
        helper.make_node("Exp", ["scaled"], ["near"]),
        helper.make_node(
            "AveragePool", ["near"], ["heatmaps"], kernel_shape=[2, 2], strides=[2, 2]
        ),
    ]
    constants = {"weight": weight, "bias": bias, "sharp": np.array(-sharp, np.float32)}
    graph = helper.make_graph(
        nodes,
        "dots",
        [
            helper.make_tensor_value_info(
                "image", TensorProto.FLOAT, [1, 3, side or "h", side or "w"]
            )
        ],
        [helper.make_tensor_value_info("heatmaps", TensorProto.FLOAT, None)],
        [
            numpy_helper.from_array(np.asarray(value, np.float32), name)
            for name, value in constants.items()
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, str(path))
    return path


def picture(
    scale: float, shift: tuple[float, float], size: tuple[int, int], hidden: set[str] = frozenset()
) -> tuple:
    """An image of `STANDING` in dots, and where they are: `{joint: (x, y)}`, pixels."""
    fine = 8  # drawn large and made small, so that dots lie between pixels too
    image = Image.new("RGB", (size[0] * fine, size[1] * fine), (0, 0, 255))
    pen = ImageDraw.Draw(image)
    places = {}
    for name, hue in zip(MPII_16.points, HUES, strict=True):
        if name not in hidden:
            x, y = np.array(STANDING[name]) * scale + shift
            places[name] = (x, y)
            reach = 4 * scale * fine
            centre = np.array([x + 0.5, y + 0.5]) * fine
            pen.ellipse(
                [*(centre - reach), *(centre + reach)], fill=tuple(int(value) for value in hue)
            )
    return np.asarray(image.resize(size, Image.Resampling.BOX)), places


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Network:
    path = dot_network(tmp_path_factory.mktemp("network") / "dots.onnx")
    return Network.load(path, MPII_16, pixels="bytes")


def test_dots_are_found_where_they_are(network: Network) -> None:
    """Whatever the size of the image and the place of the person in it, to half a pixel of the
    network's heatmap."""
    for scale, shift, size in VIEWS:
        image, places = picture(scale, shift, size)
        (person,) = network.detect(image, threshold=0.0, image_id="a")
        heatmap_pixel = max(size) / (SIDE / 2)
        for name, xy in places.items():
            if name in JOINT_INDEX:
                assert (
                    np.abs(person.keypoints[JOINT_INDEX[name]] - xy).max()
                    < 0.5 * heatmap_pixel + 0.3
                ), (name, scale)
        assert (person.layout, person.image_id, person.image_size) == ("mpii_16", "a", size)


def test_hidden_dots_are_missing(network: Network) -> None:
    image, _ = picture(1.0, (20.0, 10.0), (160, 190), {"left_wrist", "right_knee"})
    (person,) = network.detect(image, threshold=2e-4)
    assert {name for name, joint in JOINT_INDEX.items() if not person.seen[joint]} == {
        "left_wrist",
        "right_knee",
    }


def test_two_people_in_two_boxes(network: Network) -> None:
    left, places = picture(1.0, (20.0, 10.0), (160, 190))
    image = np.concatenate([left, np.full((190, 60, 3), (0, 0, 255), np.uint8), left], axis=1)
    people = network.detect(image, [(30, 5, 85, 185), (250, 5, 85, 185)], threshold=0.0)
    assert [person.person for person in people] == [0, 1]
    for number, person in enumerate(people):
        for name in ("right_wrist", "left_ankle", "head"):
            xy = np.add(places[name], [220 * number, 0])
            assert np.abs(person.keypoints[JOINT_INDEX[name]] - xy).max() < 2.5, name


def test_a_cut_out_is_the_box_and_black_beyond() -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    image[10:20, 30:40] = 255
    inside = cut_out(image, Crop(np.array([29.5, 9.5]), np.array([10.0, 10.0])), (10, 10))
    assert (inside == 255).all()
    beyond = cut_out(image + 100, Crop(np.array([-20.5, -20.5]), np.array([40.0, 40.0])), (40, 40))
    assert (beyond[:20] == 0).all()
    assert (beyond[:, :20] == 0).all()
    assert (beyond[21:, 21:] == 100).all()


def test_the_crop_has_the_networks_proportions_and_the_box_in_its_middle(network: Network) -> None:
    crop = network.crop((10, 20, 30, 80))
    np.testing.assert_allclose(crop.size, [80 * PADDING] * 2)
    np.testing.assert_allclose(crop.corner + crop.size / 2, [10 + 15 - 0.5, 20 + 40 - 0.5])


REFUSALS = {
    "layout": (
        lambda path: Network.load(dot_network(path, channels=17), MPII_16).detect(
            np.zeros((9, 9, 3), np.uint8)
        ),
        r"gives \[\(1, 17, 64, 64\)\], not heatmaps \(1, 16, height, width\) of mpii_16",
    ),
    "open size": (
        lambda path: Network.load(dot_network(path, side=None), MPII_16),
        "takes images of any size",
    ),
    "wrong size": (
        lambda path: Network.load(dot_network(path), MPII_16, size=(64, 64)),
        "takes images of 128x128",
    ),
    "pixels": (
        lambda path: Network.load(dot_network(path), MPII_16, pixels="grey"),
        "there are no pixels 'grey'",
    ),
    "no file": (lambda path: Network.load(path, MPII_16), "there is no network at"),
    "no network": (
        lambda path: Network.load(path.write_bytes(b"hello") and path, MPII_16),
        "no ONNX network that",
    ),
    "box": (
        lambda path: Network.load(dot_network(path), MPII_16).crop((1, 2, 0, 4)),
        "with a size",
    ),
}


def endless_network(path: Path, turns: int = 2**62) -> Path:
    """The dots, after so many turns of a loop that adds nothing."""
    dot_network(path)
    model = onnx.load(str(path))
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["on"], ["on_out"]),
            helper.make_node("Mul", ["value", "value"], ["value_out"]),
        ],
        "turn",
        [
            helper.make_tensor_value_info("turn", TensorProto.INT64, []),
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("on_out", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value_out", TensorProto.FLOAT, None),
        ],
    )
    graph = model.graph
    graph.initializer.append(numpy_helper.from_array(np.array(turns, np.int64), "turns"))
    graph.initializer.append(numpy_helper.from_array(np.array(True), "go"))
    graph.node[-1].output[0] = "before"
    graph.node.append(helper.make_node("Loop", ["turns", "go", "before"], ["heatmaps"], body=body))
    onnx.save(model, str(path))
    return path


def test_a_network_that_does_not_end_is_ended(tmp_path: Path) -> None:
    short = Network.load(endless_network(tmp_path / "a.onnx", 3), MPII_16)
    assert len(short.detect(np.zeros((9, 9, 3), np.uint8), threshold=0.0)) == 1
    endless = Network.load(endless_network(tmp_path / "b.onnx"), MPII_16, time_limit=20.0)
    object.__setattr__(endless.process, "limit", 1.0)
    with pytest.raises(BadInput, match=r"b\.onnx took more than 1 seconds, so it was stopped"):
        endless.detect(np.zeros((9, 9, 3), np.uint8))
    assert endless.process._process.returncode is not None
    with pytest.raises(BadInput, match="was stopped before"):
        endless.detect(np.zeros((9, 9, 3), np.uint8))


def test_the_process_ends_with_the_network(tmp_path: Path) -> None:
    network = Network.load(dot_network(tmp_path / "a.onnx"), MPII_16)
    process = network.process._process
    del network
    gc.collect()
    assert process.returncode is not None


@pytest.mark.parametrize("box", [(0, 0, 1e9, 1e9), (1e300, 0, 1, 1), (-1e8, 0, 1, 1)])
def test_a_box_far_beyond_the_image_is_refused(network: Network, box: tuple[float, ...]) -> None:
    with pytest.raises(BadInput, match=r"a person's box|does not fit"):
        network.detect(np.zeros((9, 9, 3), np.uint8), [box])


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(tmp_path: Path, name: str) -> None:
    call, match = REFUSALS[name]
    with pytest.raises(BadInput, match=match):
        call(tmp_path / "a.onnx")


def test_without_onnxruntime_a_sentence_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(BadInput, match=r"pip install '\.\[detect\]' in a clone"):
        Network.load(dot_network(tmp_path / "a.onnx"), COCO_17)


def test_the_command_from_images_to_detections(tmp_path: Path, poseterior: Cli) -> None:
    model = dot_network(tmp_path / "dots.onnx", side=None)
    places = {}
    for number in (7, 12):
        image, places[number] = picture(1.0, (20.0 + number, 10.0), (180, 190))
        Image.fromarray(image).save(tmp_path / f"{number:012d}.png")
    box = {"category_id": 1, "bbox": [25, 5, 100, 185], "score": 0.9}
    records = [box | {"image_id": 7}, box | {"image_id": 12}, box | {"image_id": 12, "score": 0.1}]
    (tmp_path / "boxes.json").write_text(json.dumps(records))
    images = sorted(map(str, tmp_path.glob("*.png")))
    done = poseterior(
        "detect",
        *images,
        "--model",
        str(model),
        "--layout",
        "mpii_16",
        "--boxes",
        str(tmp_path / "boxes.json"),
        "--input-size",
        "128x128",
        "--pixels",
        "bytes",
        "--threshold",
        "0.0001",
        "--out",
        str(tmp_path / "found.json"),
        "--json",
        "--quiet",
    )
    assert done.code == 0, done.err
    assert [row["joints"] for row in json.loads(done.out)["people"]] == [15, 15]
    people = read_detections(tmp_path / "found.json")
    assert [(person.image_id, person.image_size) for person in people] == [
        ("000000000007.png", (180, 190)),
        ("000000000012.png", (180, 190)),
    ]
    for number, person in zip((7, 12), people, strict=True):
        assert (
            np.abs(
                person.keypoints[JOINT_INDEX["right_wrist"]] - places[number]["right_wrist"]
            ).max()
            < 3
        )


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("--layout", "mpii"), "there is no layout 'mpii'; choose one of coco_17"),
        (("--layout", "mpii_16", "--box", "1,2,3"), "--box must be x,y,width,height"),
        (("--layout", "mpii_16", "--box", "0,0,1e9,1e9"), "does not fit .*a.png, which has 40x40"),
        (
            ("--layout", "mpii_16", "--box", "1e300,0,1,1"),
            "must be x, y, width, height",
        ),
        (
            ("--layout", "mpii_16", "--box", "0,-1e300,1,1"),
            "must be x, y, width, height",
        ),
        (("--layout", "mpii_16", "--input-size", "64"), "--input-size must look like 192x256"),
        (("--layout", "mpii_16", "--boxes", "{tmp}/dots.onnx"), "is not (UTF-8 text|valid JSON)"),
        (("--layout", "mpii_16", "--method", "mean"), "there is no way 'mean'"),
    ],
)
def test_what_the_command_refuses(
    tmp_path: Path,
    poseterior: Cli,
    arguments: tuple[str, ...],
    match: str,
) -> None:
    model = dot_network(tmp_path / "dots.onnx")
    Image.new("RGB", (40, 40)).save(tmp_path / "a.png")
    words = [word.format(tmp=tmp_path) for word in arguments]
    done = poseterior(
        "detect",
        str(tmp_path / "a.png"),
        "--model",
        str(model),
        *words,
        "--out",
        str(tmp_path / "o.json"),
    )
    assert done.code == 2
    assert re.search(match, done.err)
