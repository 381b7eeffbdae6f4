"""Pages that turn: what they hold is what the result holds, and nothing in them comes from
elsewhere or is run that is not ours. How they move is for `test_browser`."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from poseterior import inference
from poseterior.inference.hypothesis import Hypothesis, hypotheses
from poseterior.inference.results import Result
from poseterior.inference.saved import read_result
from poseterior.inference.stream import LEVELS
from poseterior.probmodel.errors.faults import EXCHANGES
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS
from poseterior.reports.interactive import film, saved
from poseterior.reports.interactive.film import film_page
from poseterior.reports.interactive.page import write_page
from poseterior.reports.interactive.person import MAX_DRAWS, person_page
from poseterior.reports.tables import values
from poseterior.reports.tables.posterior import still
from tests.conftest import Cli

EVIL = "<script>alert(1)</script><img src=x onerror=alert(2)>&\"'"
"""A name that a file may have for its image."""
LARGEST = 5_000_000


class Parsed(HTMLParser):
    """A page as a browser would split it: its elements, and the texts of scripts and styles."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {"script": [], "style": [], "other": []}
        self._inside = "other"
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag in self.texts:
            self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        if tag == self._inside:
            self._inside = "other"

    def handle_data(self, data: str) -> None:
        self.texts[self._inside].append(data)

    @property
    def data(self) -> dict:
        """What the scene shows."""
        return json.loads(self.texts["script"][0])

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.texts["other"]).split())


def unpacked(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, *shape)


@pytest.fixture(scope="module")
def five(example_result: Result) -> list[Hypothesis]:
    return hypotheses(example_result, 5)


@pytest.fixture(scope="module")
def page(example_result: Result, five: list[Hypothesis]) -> str:
    return person_page(example_result, five)


def named(result: Result, **attributes: object) -> Result:
    tree = result.tree.copy()
    tree.attrs.update(attributes)
    return Result(tree, result.status, result.sentence)


def film_tree(names: list[str], k: int = 2, seed: int = 0) -> xr.DataTree:
    """A stream as `open_stream` gives it, of made-up poses; the second item has none."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(len(names), k, NUM_JOINTS, 3))
    depth = np.sort(rng.normal(size=(len(names), NUM_JOINTS, len(LEVELS))), axis=2)
    some = np.arange(len(names)) != 1
    poses[~some], depth[~some] = np.nan, np.nan
    mean = np.where(some[:, None, None], poses[:, 0], np.nan)
    coords = {"frame": names, "joint": list(JOINTS), "axis": list("xyz"), "level": list(LEVELS)}
    coords |= {"pattern": list(EXCHANGES)}
    summary = {
        "status": ("frame", np.where(some, "complete", "bad input")),
        "sentence": ("frame", np.where(some, "", f"too little of {EVIL}")),
        "num_draws": ("frame", 10 * some),
        "log_evidence": ("frame", np.where(some, -20.0, -np.inf)),
        "effective_roots": ("frame", np.full(len(names), np.nan)),
        "outlier": (("frame", "joint"), np.zeros((len(names), NUM_JOINTS))),
        "exchange": (("frame", "pattern"), np.tile(np.eye(6)[0], (len(names), 1))),
        "mean": (("frame", "joint", "axis"), mean),
        "sd": (("frame", "joint", "axis"), np.abs(mean)),
        "depth": (("frame", "joint", "level"), depth),
    }
    chosen = {"joints": (("frame", "hypothesis", "joint", "axis"), poses)}
    return xr.DataTree.from_dict(
        {
            "summary": xr.Dataset(summary, coords=coords),
            "hypotheses": xr.Dataset(chosen, coords={"frame": names}),
        }
    )


NAMES = ["a.jpg/0", "b.jpg/0", "c.jpg/0", "c.jpg/1"]


# ---- what every page keeps to


@pytest.mark.parametrize("kind", ["person", "film"])
def test_a_page_needs_nothing_from_elsewhere(kind: str, page: str) -> None:
    found = Parsed(page if kind == "person" else film_page(film_tree(NAMES), "a film"))
    for tag, attributes in found.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form"), tag
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            if name in ("src", "href", "srcset", "data", "action"):
                raise AssertionError(f"{tag} has {name}={value}")
    for text in found.texts["style"] + found.texts["script"][1:]:
        bare = text.replace("http://www.w3.org/2000/svg", "")  # the name of a language
        assert not re.search(r"https?:|//[a-z]|url\(|@import|fetch\(|import\(|XMLHttp", bare)


@pytest.mark.parametrize("kind", ["person", "film"])
def test_a_page_lets_a_browser_run_its_own_script_alone(kind: str, page: str) -> None:
    found = Parsed(page if kind == "person" else film_page(film_tree(NAMES), "a film"))
    (policy,) = (one["content"] for tag, one in found.elements if "http-equiv" in one)
    scripts = [one for tag, one in found.elements if tag == "script"]
    assert [one.get("type") for one in scripts] == ["application/json", None]
    (style,), script = found.texts["style"], found.texts["script"][1]
    for kind_of, text in (("style-src", style), ("script-src", script)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind_of} 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert "unsafe" not in policy


def test_texts_of_files_are_escaped_on_a_persons_page(
    example_result: Result, five: list[Hypothesis]
) -> None:
    plain = Parsed(person_page(example_result, five))
    result = named(example_result, source=f"folder/{EVIL}", limits=f"{EVIL} 0123")
    found = Parsed(person_page(result, five, warnings=[f"look at {EVIL}"]))
    tags = [tag for tag, _ in found.elements]
    added = sorted(tags)
    for tag in sorted(tag for tag, _ in plain.elements):
        added.remove(tag)
    assert added == ["p", "section"], "the box of the warning, and nothing else"
    assert f"look at {EVIL}" in found.words
    assert EVIL in found.words


def test_texts_of_files_are_escaped_on_a_films_page() -> None:
    """An image names its frame; the reason of a frame without a pose may name both."""
    evil = [f"{EVIL}/0", f"{EVIL}{EVIL}/0", "c/0"]
    plain = Parsed(film_page(film_tree(["a/0", "b/0", "c/0"]), "film"))
    found = Parsed(film_page(film_tree(evil), EVIL, fragments=[EVIL]))
    tags = [tag for tag, _ in found.elements]
    assert sorted(tags) == sorted([*(tag for tag, _ in plain.elements), "p"])
    assert found.data["frames"] == [EVIL, f"{EVIL}{EVIL}", "c"]
    assert found.data["people"][0]["words"][1] == f"too little of {EVIL}"
    assert f"(the first: {EVIL})" in found.words


def test_an_unescaped_text_would_be_seen() -> None:
    """The control: the parser above does find what gets through."""
    tags = [tag for tag, _ in Parsed(f"<p>{EVIL}</p>").elements]
    assert tags == ["p", "script", "img"]


# ---- a person


def test_a_page_of_a_thousand_draws_stays_small(example_result: Result, tmp_path: Path) -> None:
    """A photo of noise, which packs worst."""
    tree = example_result.tree
    many = xr.DataTree.from_dict(
        {
            name: xr.concat([tree[name].to_dataset()] * 5, dim="draw")
            if "draw" in tree[name].dims
            else tree[name].to_dataset()
            for name in tree.children
        }
    )
    many.attrs.update(tree.attrs)
    result = Result(many, "complete")
    assert result.num_draws == MAX_DRAWS
    noise = np.random.default_rng(0).integers(0, 255, (2000, 1500, 3), dtype=np.uint8)
    write_page(person_page(result, hypotheses(result, 7), image=noise), tmp_path / "a.html")
    size = (tmp_path / "a.html").stat().st_size
    assert size < LARGEST
    assert len(unpacked(Parsed((tmp_path / "a.html").read_text()).data["draws"], 45)) == MAX_DRAWS


def test_the_scene_holds_the_numbers_of_the_result(
    example_result: Result, five: list[Hypothesis], page: str
) -> None:
    data, tree = Parsed(page).data, example_result.tree
    joints, keypoints = (values(tree, "posterior", name) for name in ("joints", "keypoints"))
    np.testing.assert_array_equal(unpacked(data["draws"], 15, 3), joints.astype("f4"))
    np.testing.assert_array_equal(unpacked(data["projected"], 15, 2), keypoints.astype("f4"))
    assert len(data["hypotheses"]) == 5
    for shown, one in zip(data["hypotheses"], five, strict=True):
        np.testing.assert_allclose(shown["joints"], one.joints, atol=1e-6)
        np.testing.assert_allclose(shown["projected"], keypoints[one.draw], atol=1e-6)
        assert shown["weight"] == one.weight
    detected = values(tree, "observed_data", "keypoints")
    for joint, point in enumerate(data["detection"]["points"]):
        if point is None:
            assert np.isnan(detected[joint]).all()
        else:
            np.testing.assert_allclose(point, detected[joint], atol=1e-6)
    assert data["truth"] is None
    assert data["photo"] is None


def test_marginals_are_those_of_all_draws(example_result: Result, page: str) -> None:
    data, tree = Parsed(page).data, example_result.tree
    joints = values(tree, "posterior", "joints")
    fixed = still(tree)
    for name, sample in {
        "depth": joints[..., 2],
        "across": joints[..., 0],
        "height": -joints[..., 1],
    }.items():
        for joint, one in enumerate(data["marginals"][name]):
            if fixed[joint]:
                assert one["counts"] is None
                assert one["words"].startswith("held fixed")
                continue
            column = sample[:, joint]
            assert np.sum(one["counts"]) == len(joints)
            edges = np.linspace(one["low"], one["high"], len(one["counts"][0]) + 1)
            counts, _ = np.histogram(column, edges)
            np.testing.assert_array_equal(np.sum(one["counts"], axis=0), counts)
            assert one["mean"] == pytest.approx(column.mean())
            assert one["sd"] == pytest.approx(column.std())
            np.testing.assert_allclose(one["interval"], np.quantile(column, [0.05, 0.95]))
    other = (
        values(tree, "posterior", "candidate") != values(tree, "constant_data", "weight").argmax()
    )
    wrist = data["marginals"]["depth"][JOINT_INDEX["left_wrist"]]
    assert np.sum(wrist["counts"][1]) == other.sum()


def test_truth_and_photo_are_shown_where_given(
    example_result: Result, five: list[Hypothesis]
) -> None:
    truth = np.arange(45.0).reshape(15, 3) / 10
    image = np.full((640, 480, 3), 90, np.uint8)
    data = Parsed(person_page(example_result, five, image=image, truth=truth)).data
    np.testing.assert_allclose(data["truth"], truth)
    for joint, one in enumerate(data["marginals"]["depth"]):
        if one["counts"] is not None:
            assert one["low"] < truth[joint, 2] < one["high"]
    assert data["photo"]["src"].startswith("data:image/jpeg;base64,")
    left, top, right, bottom = data["photo"]["box"]
    assert -0.5 <= left < right <= 479.5
    assert -0.5 <= top < bottom <= 639.5
    with pytest.raises(BadInput, match="none of the detected joints lies in it"):
        person_page(example_result, five, image=image[:10, :10])


def test_chains_are_shown_from_end_to_end() -> None:
    rows = evenly(25_000, MAX_DRAWS)
    assert (rows[0], rows[-1], len(set(rows))) == (0, 24_999, MAX_DRAWS)
    assert evenly(7, MAX_DRAWS).tolist() == list(range(7))


def test_words_say_what_is_open(example_result: Result, page: str) -> None:
    said = Parsed(page).words
    assert "Not detected, so that anatomy alone says where: right wrist." in said
    assert "one possible pose in" in said
    assert "Torso and camera are held fixed at an estimator's candidates." in said
    doubtful = named(example_result, converged=0)
    five = hypotheses(example_result, 1)
    assert "did not converge" in Parsed(person_page(doubtful, five)).words
    short = Result(example_result.tree, "out of budget", "only 3 of 5 draws; wait longer")
    assert "only 3 of 5 draws; wait longer" in Parsed(person_page(short, five)).words
    assert "did not converge" not in said


# ---- a film


def test_a_film_holds_the_numbers_of_the_stream() -> None:
    tree = film_tree(NAMES)
    data = Parsed(film_page(tree, "film")).data
    assert data["frames"] == ["a.jpg", "b.jpg", "c.jpg"]
    assert [one["name"] for one in data["people"]] == ["0", "1"]
    first, second = data["people"]
    poses = tree["hypotheses"].joints.values
    np.testing.assert_array_equal(unpacked(first["poses"], 2, 15, 3), poses[[0, 1, 2]].astype("f4"))
    bands = unpacked(first["bands"], 15, len(LEVELS))
    np.testing.assert_array_equal(bands, tree["summary"]["depth"].values[[0, 1, 2]].astype("f4"))
    shown = unpacked(second["poses"], 2, 15, 3)
    np.testing.assert_array_equal(shown[2], poses[3].astype("f4"))
    assert np.isnan(shown[:2]).all()
    assert second["words"][0] == "not in this frame"


def test_a_film_holds_quantiles_of_measures() -> None:
    """Of the draws of every item, each with as many as it has; none where there is none."""
    names = ["right_knee_flexion", "trunk_rotation"]
    rng = np.random.default_rng(3)
    draws = {name: rng.normal(175, 8, (len(NAMES), 20)) for name in names}
    for drawn in draws.values():
        drawn[1], drawn[2, 7:] = np.nan, np.nan
    draws["trunk_rotation"] = (draws["trunk_rotation"] + 180) % 360 - 180
    attributes = {"units": "degrees"}
    measured = xr.Dataset(
        {
            name: (("frame", "draw"), drawn, attributes | {"circular": int("trunk" in name)})
            for name, drawn in draws.items()
        }
    )
    data = Parsed(film_page(film_tree(NAMES), "film", measured=measured)).data
    assert [one["name"] for one in data["measures"]] == ["right knee flexion", "trunk rotation"]
    first = unpacked(data["people"][0]["measures"], 2, len(LEVELS))
    assert np.isfinite(first).all(axis=(1, 2)).tolist() == [True, False, True]
    knee = np.quantile(draws["right_knee_flexion"][2, :7], LEVELS)
    np.testing.assert_allclose(first[2, 0], knee, rtol=1e-6)
    assert np.ptp(first[:, 1], axis=1)[[0, 2]].max() < 60  # no jump over the circle's end
    assert Parsed(film_page(film_tree(NAMES), "film")).data["measures"] == []


def test_a_long_film_is_thinned_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"{index}/0" for index in range(50)]
    assert "evenly spread" not in film_page(film_tree(names), "film")
    monkeypatch.setattr(film, "MOST_BYTES", 10 * 15 * (3 * 2 + 5) * 4 * 4 // 3)
    found = Parsed(film_page(film_tree(names), "film"))
    assert len(found.data["frames"]) == 10
    assert found.data["frames"][-1] == "49"
    assert "The film has 50 frames; this page holds 10 of them" in found.words


def test_a_film_without_a_pose_has_no_page() -> None:
    with pytest.raises(BadInput, match="no frame with a pose"):
        film_page(film_tree(["a/0", "b/0"]).isel(frame=[1]), "film")


# ---- results read back


@pytest.fixture(scope="module")
def folder(
    example_result: Result, five: list[Hypothesis], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("result")
    example_result.save(path / "posterior.nc", double=True)
    chosen = {"hypotheses": [one.as_json() for one in five]}
    (path / "hypotheses.json").write_text(json.dumps(chosen))
    return path


def test_a_saved_result_gives_the_same_page(folder: Path, page: str) -> None:
    assert saved.page_of(folder) == page
    assert saved.page_of(folder / "posterior.nc") == page


def test_a_saved_result_without_hypotheses_gets_new_ones(
    example_result: Result, tmp_path: Path, page: str
) -> None:
    example_result.save(tmp_path / "posterior.nc", double=True)
    assert saved.page_of(tmp_path) == page  # chosen by the same rule


def test_show_writes_the_page_of_a_result(poseterior: Cli, folder: Path, page: str) -> None:
    done = poseterior("show", folder, "--quiet")
    assert done.code == 0, done.err
    assert (folder / "hypotheses.html").read_text(encoding="utf-8") == page
    done = poseterior("show", folder, "--out", folder / "a.png", "--quiet")
    assert done.code == 2
    assert "give --out a name that ends in .html" in done.err


def test_open_hands_the_page_to_a_browser(
    poseterior: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: asked.append(address) is None)
    done = poseterior("show", folder, "--quiet", "--open")
    assert (done.code, done.err) == (0, "")
    assert asked == [(folder / "hypotheses.html").as_uri()]
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    done = poseterior("show", folder, "--quiet", "--open")
    assert done.code == 0
    assert "no browser could be started; open" in done.err


def _without(name: str):
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def _set(name: str, index: tuple, value: float):
    def change(file: h5py.File) -> None:
        file[name][index] = value

    return change


def _attribute(name: str, value: object):
    def change(file: h5py.File) -> None:
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_without("posterior/keypoints"), "lacks posterior/keypoints"),
        (_without("constant_data/weight"), "lacks constant_data/weight"),
        (_set("posterior/joints", (0, 3, 4, 1), np.nan), "has nan in posterior/joints"),
        (_set("posterior/keypoints", (0, 3, 4, 1), 1e30), r"has 1e\+30 in posterior/keypoints"),
        (_set("observed_data/keypoints", (3, 1), np.inf), "has inf in observed_data/keypoints"),
        (_set("constant_data/radius", (0, 8), 1e308), r"has 1e\+308 in constant_data/radius"),
        (_set("constant_data/weight", (0,), np.nan), "has nan in constant_data/weight"),
        (_set("constant_data/weight", (0,), -0.5), "a weight that none has"),
        (_set("constant_data/scale", (0,), 0.0), "a camera or a weight that none has"),
        (_set("constant_data/rotation", (0, 1, 1), np.nan), "has nan in constant_data/rotation"),
        (_set("constant_data/rotation", (0,), 0.0), "a camera or a weight that none has"),
        (_attribute("num_proposals", np.nan), "says nan of its num_proposals"),
        (_attribute("wall_time_s", -1.0), "says -1 of its wall_time_s"),
        (_attribute("source", "a" * 6000), "has 6,000 characters in its source"),
        (_set("posterior/candidate", (0, 3), 9), "candidates that it does not list"),
        (_attribute("sampler", None), "does not say its sampler"),
        (_attribute("log_evidence", "none"), "does not say its log_evidence"),
        (_attribute("source", np.arange(5)), "does not say its source"),
    ],
)
def test_a_result_that_is_none_is_refused(folder: Path, tmp_path: Path, change, said: str) -> None:
    path = tmp_path / "posterior.nc"
    path.write_bytes((folder / "posterior.nc").read_bytes())
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(BadInput, match=said):
        read_result(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "is not a hypotheses.json"),
        ('{"hypotheses": []}', "is not of the draws beside it"),
        ('{"hypotheses": [{"draw": 999999, "weight": 1, "joints": {}}]}', "is not a hypotheses"),
    ],
)
def test_hypotheses_of_other_draws_are_refused(
    folder: Path, tmp_path: Path, text: str, said: str
) -> None:
    (tmp_path / "posterior.nc").write_bytes((folder / "posterior.nc").read_bytes())
    (tmp_path / "hypotheses.json").write_text(text)
    with pytest.raises(BadInput, match=said):
        saved.page_of(tmp_path)


def test_hypotheses_that_were_moved_are_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "posterior.nc").write_bytes((folder / "posterior.nc").read_bytes())
    chosen = json.loads((folder / "hypotheses.json").read_text())
    chosen["hypotheses"][0]["joints"]["head"][2] += 1e-3
    (tmp_path / "hypotheses.json").write_text(json.dumps(chosen))
    with pytest.raises(BadInput, match="is not of the draws beside it"):
        saved.page_of(tmp_path)


def test_folders_without_a_result_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is a folder without a result"):
        saved.page_of(tmp_path)
    (tmp_path / "posterior.nc").write_text("no netCDF")
    with pytest.raises(BadInput):
        saved.page_of(tmp_path)


def test_samplers_of_chains_can_be_shown(example_estimate, tmp_path: Path) -> None:
    """A result of another sampler has all that a page asks for."""
    import jax

    from poseterior.probmodel import PoseModel

    result = inference.sample(
        PoseModel(),
        example_estimate,
        key=jax.random.key(0),
        num_samples=40,
        chains=2,
        root="candidates",
    )
    result.save(tmp_path / "posterior.nc", double=True)
    data = Parsed(saved.page_of(tmp_path / "posterior.nc")).data
    assert len(unpacked(data["draws"], 45)) == 40
