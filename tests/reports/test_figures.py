"""Figures: what is drawn is what the tree holds, on every case of the contract; files appear whole
or not at all."""

import contextlib
import os
import struct
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from PIL import Image

from poseterior import inference, probmodel
from poseterior.inference.hypothesis import Hypothesis
from poseterior.inference.results import Result
from poseterior.probmodel.example import example
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, JOINTS
from poseterior.reports import figures
from poseterior.reports.figures.colours import LIMB_OF, MAX_NAMED
from poseterior.reports.figures.depth import _density
from poseterior.reports.figures.files import FORMATS
from poseterior.reports.figures.window import WINDOW_DRAWS, Window, cropped
from poseterior.reports.tables import heaviest, values
from tests.reports.test_interactive import film_tree

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def model() -> probmodel.PoseModel:
    return probmodel.PoseModel()


def sampled(model: probmodel.PoseModel, detection: probmodel.Detection) -> Result:
    with jax.numpy_rank_promotion("allow"):  # strictness is for the tests of the sampler
        return inference.sample(
            model,
            inference.estimate_torso(detection),
            key=jax.random.key(3),
            num_samples=200,
            root="candidates",
        )


@pytest.fixture(scope="module")
def result(model: probmodel.PoseModel) -> Result:
    """The embedded example: right wrist missing, two candidates."""
    return sampled(model, example().detection)


@pytest.fixture(scope="module")
def five(result: Result) -> list[Hypothesis]:
    return inference.hypotheses(result, 5)


def named(axis: Axes, kind: type, start: str) -> list:
    """The artists of a kind whose gid begins like that."""
    return [
        artist
        for artist in axis.get_children()
        if isinstance(artist, kind) and (artist.get_gid() or "").startswith(start)
    ]


def words(axis: Axes) -> str:
    return " ".join(text.get_text().replace("\n", " ") for text in axis.texts)


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_discs_are_the_factors_of_the_heaviest_candidate(
    result: Result, five: list[Hypothesis]
) -> None:
    figure = figures.hypotheses_figure(result.tree, five)
    discs = {disc.get_gid(): disc for disc in named(figure.axes[0], Circle, "disc")}
    seen = example().detection.seen
    assert set(discs) == {
        f"disc {bone_end}" for bone_end in (JOINTS[bone.end] for bone in BONES if seen[bone.end])
    }
    radius = values(result.tree, "constant_data", "radius")[heaviest(result.tree)]
    knee = discs["disc left_knee"]
    assert knee.radius == pytest.approx(radius[JOINT_INDEX["left_knee"]])
    np.testing.assert_allclose(knee.center, example().detection.keypoints[JOINT_INDEX["left_knee"]])
    assert "not detected: right wrist" in words(figure.axes[0])
    assert len(named(figure.axes[0], Line2D, "joint")) == seen.sum()


def test_cloud_lies_in_the_discs_where_a_joint_was_seen(
    result: Result, five: list[Hypothesis]
) -> None:
    axis = figures.hypotheses_figure(result.tree, five).axes[0]
    draws = values(result.tree, "posterior", "candidate")[:WINDOW_DRAWS] == heaviest(result.tree)
    for disc in named(axis, Circle, "disc"):
        (cloud,) = [
            c for c in axis.collections if c.get_gid() == disc.get_gid().replace("disc", "cloud")
        ]
        points = np.asarray(cloud.get_offsets())
        assert len(points) == WINDOW_DRAWS
        distance = np.linalg.norm(points - disc.center, axis=1)
        assert (distance[draws] <= disc.radius * (1 + 1e-6)).all()


LEFT = {JOINT_INDEX[name] for name in ("left_elbow", "left_wrist", "left_knee", "left_ankle")}


def drawn_joints(axis, pose: str) -> np.ndarray:
    """The joints of a pose that are drawn, those of the right limbs first."""
    dots = [line for line in named(axis, Line2D, pose) if line.get_marker() == "o"]
    assert len(dots) == 2
    return np.concatenate([line.get_xydata() for line in dots])


def test_views_show_the_axes_they_say(result: Result, five: list[Hypothesis]) -> None:
    figure = figures.hypotheses_figure(result.tree, five)
    assert [axis.get_title(loc="left") for axis in figure.axes[1:4]] == [
        "From the camera",
        "From the side",
        "From above",
    ]
    wrist = five[0].joints[JOINT_INDEX["left_wrist"]]
    for axis, (across, along) in zip(figure.axes[1:4], [(0, 1), (2, 1), (0, 2)], strict=True):
        off = np.abs(drawn_joints(axis, "hypothesis 1") - [wrist[across], wrist[along]])
        assert off.max(axis=1).min() < 1e-9
        assert axis.get_aspect() == 1
    bottom, top = figure.axes[1].get_ylim()
    assert bottom > top, "y points down, as in the image"
    low, high = figure.axes[3].get_ylim()
    assert low < high, "away from the camera is up when seen from above"


def test_projected_hypotheses_lie_in_their_discs(result: Result, five: list[Hypothesis]) -> None:
    """Whatever candidate a hypothesis is of: from the camera all are drawn as that of the heaviest
    sees them."""
    axis = figures.hypotheses_figure(result.tree, five).axes[1]
    constant, heavy = result.tree["constant_data"], heaviest(result.tree)
    scale, offset = (constant[name].values[heavy] for name in ("scale", "translation"))
    assert len({int(values(result.tree, "posterior", "candidate")[one.draw]) for one in five}) == 2
    for rank, hypothesis in enumerate(five, 1):
        candidate = int(values(result.tree, "posterior", "candidate")[hypothesis.draw])
        drawn = drawn_joints(axis, f"hypothesis {rank}")
        assert len(drawn) == len(BONES)
        for bone, point in zip(sorted(LIMB_OF, key=lambda bone: bone in LEFT), drawn, strict=True):
            radius = constant["radius"].values[candidate, bone]
            if np.isfinite(radius):
                miss = np.linalg.norm(scale * point + offset - example().detection.keypoints[bone])
                assert miss <= radius * (1 + 1e-6)


def test_hypotheses_lie_over_the_photo(result: Result, five: list[Hypothesis]) -> None:
    """The photo under the view from the camera is where the heaviest candidate sees it."""
    image = np.full((640, 480, 3), 200, np.uint8)
    detections, camera = figures.hypotheses_figure(result.tree, five, image=image).axes[:2]
    constant, heavy = result.tree["constant_data"], heaviest(result.tree)
    scale, offset = (constant[name].values[heavy] for name in ("scale", "translation"))
    (pixels,), (units,) = detections.images, camera.images
    left, right, bottom, top = pixels.get_extent()
    wanted = (np.array([[left, top], [right, bottom]]) - offset) / scale
    left, right, bottom, top = units.get_extent()
    np.testing.assert_allclose([[left, top], [right, bottom]], wanted)
    low, high = sorted(camera.get_xlim())
    plain = figures.hypotheses_figure(result.tree, five).axes[1]
    assert (low, high) == tuple(sorted(plain.get_xlim())), "the photo does not widen the view"


def test_each_hypothesis_has_a_panel_of_its_own(result: Result, five: list[Hypothesis]) -> None:
    figure = figures.hypotheses_figure(result.tree, five)
    side, alone = figure.axes[2], figure.axes[4:]
    assert len(alone) == 5
    for rank, (axis, one) in enumerate(zip(alone, five, strict=True), 1):
        assert {line.get_gid() for line in axis.lines} == {f"alone {rank}"}
        np.testing.assert_allclose(
            drawn_joints(axis, f"alone {rank}"), drawn_joints(side, f"hypothesis {rank}")
        )
        assert axis.get_title(loc="left").startswith(f"{100 * one.weight:.0f} %")
        assert axis.get_xlim() == side.get_xlim()
    assert len(figures.hypotheses_figure(result.tree, five[:1]).axes) == 4, "one is no tangle"
    many = inference.hypotheses(result, MAX_NAMED + 2)
    assert len(figures.hypotheses_figure(result.tree, many).axes) == 4 + MAX_NAMED


def test_one_colour_a_hypothesis_in_all_panels(result: Result, five: list[Hypothesis]) -> None:
    figure = figures.hypotheses_figure(result.tree, five)
    assert len(set(figures.hypothesis_colours(5))) == 5
    for rank, colour in enumerate(figures.hypothesis_colours(5), 1):
        for axis in figure.axes[1:4]:
            assert {line.get_color() for line in named(axis, Line2D, f"hypothesis {rank}")} >= {
                colour
            }
    percents = [f"{100 * hypothesis.weight:.0f} %" for hypothesis in five]
    assert all(
        any(label.startswith(percent) for label in legend_of(figure)) for percent in percents
    )


def test_left_limbs_are_dashed(result: Result, five: list[Hypothesis]) -> None:
    axis = figures.hypotheses_figure(result.tree, five[:1]).axes[1]
    (dashed,) = (line for line in named(axis, Line2D, "hypothesis 1") if line.is_dashed())
    ends = dashed.get_xydata()[~np.isnan(dashed.get_xydata()[:, 0])].reshape(-1, 2, 2)[:, 1]
    np.testing.assert_allclose(
        np.sort(ends, axis=0), np.sort(five[0].joints[sorted(LEFT), :2], axis=0), atol=1e-9
    )


def test_truth_is_drawn_where_given(result: Result, five: list[Hypothesis]) -> None:
    truth = example().joints
    figure = figures.hypotheses_figure(result.tree, five, truth=truth)
    for axis in figure.axes[1:]:
        bones = named(axis, Line2D, "truth")
        assert {line.get_color() for line in bones} >= {"black"}
    assert "truth" in legend_of(figure)
    assert "truth" not in legend_of(figures.hypotheses_figure(result.tree, five))


def test_draws_are_thinned(result: Result, five: list[Hypothesis]) -> None:
    figure = figures.hypotheses_figure(result.tree, five)
    (lines,) = named(figure.axes[2], LineCollection, "draws")
    drawn = np.array([path.vertices for path in lines.get_paths()])
    bones = drawn.reshape(WINDOW_DRAWS, len(JOINTS) - 1, 3, 2)
    assert np.isfinite(bones[:, :, :2]).all()
    assert np.isnan(bones[:, :, 2]).all()  # gaps


@pytest.mark.parametrize("k", [1, 7, 20])
def test_any_number_of_hypotheses_fits(result: Result, k: int, tmp_path: Path) -> None:
    figure = figures.hypotheses_figure(result.tree, inference.hypotheses(result, k))
    figures.save_figure(figure, tmp_path / "k.png")
    assert (f"{k - MAX_NAMED} more" in " ".join(legend_of(figure))) == (k > MAX_NAMED)
    width = figure.get_figwidth() * figure.dpi
    assert all(legend.get_window_extent().x1 <= width for legend in figure.legends)


def test_image_lies_under_the_detections(result: Result, five: list[Hypothesis]) -> None:
    image = np.full((640, 480, 3), 200, np.uint8)
    axis = figures.hypotheses_figure(result.tree, five, image=image).axes[0]
    (picture,) = axis.images
    extent = np.array(picture.get_extent())
    assert (extent % 1 == 0.5).all(), "the centre of a pixel has whole coordinates"
    high, wide = picture.get_array().shape[:2]
    assert (extent[1] - extent[0], extent[2] - extent[3]) == (wide, high)
    left, right = axis.get_xlim()
    keypoints = example().detection.keypoints
    assert left < np.nanmin(keypoints[:, 0])
    assert right > np.nanmax(keypoints[:, 0])
    assert not figures.hypotheses_figure(result.tree, five).axes[0].images


@pytest.mark.parametrize(
    ("image", "match"),
    [
        (np.zeros((10, 10, 3), np.uint8), "none of the detected joints lies in it"),
        (np.zeros((640, 480), np.uint8), "shape"),
        (np.zeros((640, 480, 2), np.uint8), "shape"),
        (np.zeros((0, 480, 3), np.uint8), "shape"),
    ],
)
def test_images_that_do_not_fit(
    result: Result, five: list[Hypothesis], image: np.ndarray, match: str
) -> None:
    with pytest.raises(BadInput, match=match):
        figures.hypotheses_figure(result.tree, five, image=image)


def without_draws(tree: xr.DataTree) -> xr.DataTree:
    groups = {name: tree[name].to_dataset() for name in tree.children}
    return xr.DataTree.from_dict(
        {
            name: data.isel(draw=slice(0)) if "draw" in data.dims else data
            for name, data in groups.items()
        }
    )


def test_a_run_without_draws_shows_the_detection(result: Result, tmp_path: Path) -> None:
    tree = without_draws(result.tree)
    figures.save_figure(figures.hypotheses_figure(tree, []), tmp_path / "a.png")
    figures.save_figure(figures.depth_figure(tree), tmp_path / "b.png")
    assert len(named(figures.hypotheses_figure(tree, []).axes[0], Circle, "disc")) == 8


def test_one_draw_is_enough(result: Result, tmp_path: Path) -> None:
    groups = {name: result.tree[name].to_dataset() for name in result.tree.children}
    tree = xr.DataTree.from_dict(
        {
            name: data.isel(draw=slice(1)) if "draw" in data.dims else data
            for name, data in groups.items()
        }
    )
    figures.save_figure(figures.depth_figure(tree), tmp_path / "b.png")


def test_depth_figure_shows_interval_and_deviation(result: Result) -> None:
    ridges, spreads = figures.depth_figure(result.tree).axes
    joint = JOINT_INDEX["left_ankle"]
    depth = values(result.tree, "posterior", "joints")[:, joint, 2]
    (interval,) = named(ridges, Line2D, "interval left_ankle")
    np.testing.assert_allclose(interval.get_xdata(), np.quantile(depth, [0.05, 0.95]))
    (point,) = named(spreads, Line2D, "sd left_ankle")
    assert point.get_xdata()[0] == pytest.approx(depth.std())
    assert any(
        label.get_text() == "right wrist (not detected)" for label in ridges.get_yticklabels()
    )


def test_a_torso_that_is_held_fixed_says_so(result: Result, five: list[Hypothesis]) -> None:
    """And has rows where it is drawn with the pose."""
    held, rows = "torso and camera: held fixed", 9
    ridges, spreads = figures.depth_figure(result.tree).axes
    assert words(spreads) == "held fixed"
    assert ridges.get_yticklabels()[rows].get_text() == "torso and camera"
    assert len(ridges.get_yticks()) == rows + 1
    assert held in words(figures.hypotheses_figure(result.tree, five).axes[0])
    free = result.tree.copy()
    free.attrs["root"] = "uncertain"
    ridges, spreads = figures.depth_figure(free).axes
    assert words(spreads) == ""
    assert len(ridges.get_yticks()) == rows + 5
    assert held not in words(figures.hypotheses_figure(free, five).axes[0])


def test_density_keeps_the_mass() -> None:
    edges = np.linspace(-3, 3, 161)
    sample = np.random.default_rng(0).normal(scale=0.5, size=1000)
    assert _density(sample, edges).sum() == pytest.approx(1000)


REAL = {
    "side view": ("openpose/body25_spin_im1010_keypoints.json", 0),
    "from behind": ("openpose/coco18_hmr_random_keypoints.json", 0),
    "upper body": ("openpose/body25_openposer_du_wohn_wo_000000000030_keypoints.json", 0),
}


@pytest.mark.parametrize("case", REAL)
def test_real_detections(
    shared_data: Path, model: probmodel.PoseModel, case: str, tmp_path: Path
) -> None:
    name, person = REAL[case]
    detection = probmodel.read_detections(shared_data / "detections" / name)[person]
    real = sampled(model, detection)
    figure = figures.hypotheses_figure(real.tree, inference.hypotheses(real, 5))
    factors = detection.seen[[bone.end for bone in BONES]].sum()
    assert len(named(figure.axes[0], Circle, "disc")) == factors
    figures.save_figure(figure, tmp_path / "real.png")
    figures.save_figure(figures.depth_figure(real.tree), tmp_path / "depth.png")
    assert (tmp_path / "real.png").read_bytes().startswith(PNG)


def test_a_real_image(shared_data: Path, model: probmodel.PoseModel) -> None:
    folder = shared_data / "detections" / "coco"
    detection = probmodel.read_detections(folder / "test_coco.json")[0]
    real = sampled(model, detection)
    image = figures.read_image(folder / "000000000785.jpg")
    assert image.shape == (425, 640, 3)
    axis = figures.hypotheses_figure(real.tree, inference.hypotheses(real, 3), image=image).axes[0]
    assert axis.get_xlim()[1] - axis.get_xlim()[0] < 640, "shows the person, not the whole image"


def test_the_film_shows_bands_of_depth_and_gaps(tmp_path: Path) -> None:
    names = [f"{index}/{person}" for index in range(6) for person in (0, 1)]
    summary = film_tree(names)["summary"].to_dataset()  # the second has no pose: person 1, frame 0
    figure = figures.film_figure(summary)
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[:2] == ["Depth behind the pelvis, person 0", "Depth behind the pelvis, person 1"]
    for person in (0, 1):
        axis = figure.axes[person]
        (line,) = named(axis, Line2D, "median right_wrist")
        depth = summary.depth.sel(joint="right_wrist", level=0.5).values[person::2]
        np.testing.assert_array_equal(line.get_ydata(), depth)
    assert np.isnan(figure.axes[1].lines[0].get_ydata()).tolist() == [True] + [False] * 5
    figures.save_figure(figure, tmp_path / "depth.png")


def test_a_film_of_many_people_shows_those_with_most_poses() -> None:
    names = [f"{index}/{person}" for index in range(4) for person in range(index, 5)]
    figure = figures.film_figure(film_tree(names)["summary"].to_dataset())
    titles = [axis.get_title(loc="left") for axis in figure.axes[:3]]
    assert [title[-1] for title in titles] == ["2", "3", "4"]


def test_parts_of_an_image_lie_where_they_were() -> None:
    image = np.arange(40 * 30 * 3).reshape(40, 30, 3)
    part = cropped(image, Window(np.array([-5.0, 3.2]), np.array([9.1, 70.0])))
    np.testing.assert_array_equal(part.pixels, image[3:, :11])
    np.testing.assert_array_equal(part.corners, [[-0.5, 2.5], [10.5, 39.5]])


# ---- files


@pytest.fixture
def plain() -> Figure:
    figure = Figure(figsize=(1, 1))
    figure.add_subplot()
    return figure


@pytest.mark.parametrize(
    ("name", "start"), [("a.png", PNG), ("a.PNG", PNG), ("a.pdf", b"%PDF"), ("a.svg", b"<?xml")]
)
def test_saved_by_the_names_ending(plain: Figure, tmp_path: Path, name: str, start: bytes) -> None:
    figures.save_figure(plain, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(start)
    assert os.listdir(tmp_path) == [name]


def test_saving_replaces_whole_files_only(
    plain: Figure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(plain, "savefig", full)
    with pytest.raises(BadInput, match="No space left"):
        figures.save_figure(plain, path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize("name", ["missing/a.png", "a.gif", "a", "folder.png"])
def test_saving_says_why_it_cannot(plain: Figure, tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(BadInput, match=r"cannot write .*;"):
        figures.save_figure(plain, tmp_path / name)
    assert os.listdir(tmp_path) == ["folder.png"]


@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA", "P", "1", "CMYK"])
def test_images_of_any_kind_become_rgb(tmp_path: Path, mode: str) -> None:
    path = tmp_path / ("a.tiff" if mode == "CMYK" else "a.png")
    Image.new(mode, (5, 4)).save(path)
    image = figures.read_image(path)
    assert image.shape == (4, 5, 3)
    assert image.dtype == np.uint8


def test_images_are_turned_as_the_camera_was_held(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # orientation: turn by 90°
    Image.new("RGB", (5, 4)).save(tmp_path / "a.jpg", exif=exif)
    assert figures.read_image(tmp_path / "a.jpg").shape == (5, 4, 3)


def test_images_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no image")
    Image.new("RGB", (50, 40)).save(tmp_path / "whole.png")
    (tmp_path / "half.png").write_bytes((tmp_path / "whole.png").read_bytes()[:60])
    for name, match in {
        "text.png": "no image",
        "half.png": "no image",
        "none.png": "no image at",
        ".": "is a folder, not a file",
    }.items():
        with pytest.raises(BadInput, match=match):
            figures.read_image(tmp_path / name)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP", "MPO"])
def test_images_of_the_list_are_read(tmp_path: Path, kind: str) -> None:
    Image.new("RGB", (5, 4)).save(tmp_path / "image", kind)
    assert figures.read_image(tmp_path / "image").shape == (4, 5, 3)


def pillows() -> list[str]:
    """All formats that Pillow writes, and so could read, but those of the list."""
    Image.init()
    # Pillow itself warns of IM.
    return sorted(set(Image.SAVE) & set(Image.OPEN) - {*FORMATS, "IM"})


@pytest.mark.parametrize("kind", pillows())
def test_images_of_other_kinds_are_refused(tmp_path: Path, kind: str) -> None:
    """Of every format that Pillow knows, EPS among them, which starts Ghostscript."""
    # Under a name of its own: Pillow's SPIDER takes over the ending of what it writes.
    path, written = tmp_path / "image.other", False
    for mode in ("RGB", "L", "1", "F"):
        with contextlib.suppress(OSError, ValueError, KeyError, RuntimeError, SystemError):
            Image.new(mode, (16, 16)).save(path, kind)
            written = True
            break
    if not written:
        pytest.skip(f"Pillow writes {kind} by another library alone")
    with pytest.raises(BadInput, match="is no image that can be read"):
        figures.read_image(path)


def test_the_library_says_nothing_beside_our_sentence(tmp_path: Path) -> None:
    """In a process of its own: within pytest, logs have a handler."""
    path = tmp_path / "many.tif"
    Image.new("RGB", (8, 8)).save(path)
    data = bytearray(path.read_bytes())
    samples = data.index(struct.pack("<HHI", 277, 3, 1))  # the tag "samples per pixel"
    data[samples + 8 : samples + 10] = struct.pack("<H", 25_905)
    path.write_bytes(data)
    code = f"from poseterior.reports.figures import read_image; read_image({str(path)!r})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "is no image that can be read" in run.stderr
    assert "can be decoded" not in run.stderr


@pytest.mark.parametrize("side", [7_800, 9_600, 20_000])
def test_images_that_claim_too_much(tmp_path: Path, side: int) -> None:
    Image.new("1", (side, side)).save(tmp_path / "bomb.png")
    with pytest.raises(BadInput, match="million pixels"):
        figures.read_image(tmp_path / "bomb.png")
