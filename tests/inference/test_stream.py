"""Many frames as one stream: resumed to the same bits, bad frames recorded, other runs refused."""

import dataclasses
import json
import os
import shutil
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from poseterior import inference
from poseterior.inference import (
    Estimating,
    Item,
    draws_of,
    open_stream,
    sample_frames,
    store,
    stream,
)
from poseterior.probmodel import Anatomy, BadInput, Lens, Likelihood, PoseModel
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.root_priors import CANDIDATES
from tests.scenes import drawer, key, prior_scene

SETTINGS = {"num_samples": 40, "k": 3, "keep": 40, "root": "candidates"}


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


@pytest.fixture(scope="module")
def items(model) -> list[Item]:
    frames = [Item(f"frame {seed}", prior_scene(model, seed, factor=0.6)) for seed in range(5)]
    return [*frames[:2], Item("frame 9", "frame 9 has no torso; choose another"), *frames[2:]]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(stream, "MOST_IN_BLOCK", 2)


def content(folder) -> dict[str, bytes]:
    """The values of all blocks (netCDF notes when it was written)."""
    found = {}
    for path in sorted(folder.glob("block-*.nc")):
        with xr.open_datatree(path, engine="netcdf4") as tree:
            for name, node in tree.children.items():
                found |= {
                    f"{path.name} {name} {key}": value.values.tobytes()
                    for key, value in node.data_vars.items()
                }
    return found


def test_a_stream_holds_every_frame_and_says_why_one_has_no_draws(model, items, tmp_path):
    done = []
    sample_frames(model, items, key=key(0), out=tmp_path / "s", progress=done.append, **SETTINGS)
    assert done == [2, 4, 6]
    tree = open_stream(tmp_path / "s")
    summary, hypotheses = tree["summary"], tree["hypotheses"]
    assert list(summary.frame.values) == [item.name for item in items]
    assert list(summary.status.values) == [
        "complete",
        "complete",
        "bad input",
        "complete",
        "complete",
        "complete",
    ]
    assert "no torso" in str(summary.sentence[2].item())
    good = np.arange(6) != 2
    assert (summary.num_draws.values == np.where(good, 40, 0)).all()
    assert np.isfinite(summary.log_evidence.values[good]).all()
    assert model.limits.check(hypotheses.joints.values[good]).valid.all()
    np.testing.assert_allclose(hypotheses.weight.values[good].sum(axis=1), 1)
    draws = draws_of(tmp_path / "s", "frame 1")
    assert draws.joints.shape == (1, 40, 15, 3)
    np.testing.assert_allclose(
        draws.joints[0].mean("draw"), summary["mean"].sel(frame="frame 1"), atol=1e-5
    )
    chosen = hypotheses.sel(frame="frame 1")
    np.testing.assert_allclose(chosen.joints, draws.joints[0, chosen.draw.values], atol=1e-6)
    assert draws_of(tmp_path / "s", "frame 9").sizes["draw"] == 0


def test_draws_are_those_of_sample(model, items, tmp_path):
    """With the frame's own key: the same set, in the same order."""
    import jax

    sample_frames(model, items[:2], key=key(4), out=tmp_path, **SETTINGS)
    result = inference.sample(
        model, items[1].frame, key=jax.random.fold_in(key(4), 1), num_samples=40, root="candidates"
    )
    ours = draws_of(tmp_path, items[1].name).joints.values
    assert np.array_equal(ours, result.tree["posterior"].joints.values.astype(np.float32))


def test_a_run_that_was_killed_goes_on_to_the_same_bits(model, items, tmp_path):
    sample_frames(model, items, key=key(0), out=tmp_path / "whole", **SETTINGS)

    def breaking():
        yield from items[:5]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample_frames(model, breaking(), key=key(0), out=tmp_path / "killed", **SETTINGS)
    assert len(list((tmp_path / "killed").glob("block-*.nc"))) == 2
    before = (tmp_path / "killed" / "block-000000.nc").stat().st_mtime_ns
    sample_frames(model, items, key=key(0), out=tmp_path / "killed", **SETTINGS)
    assert (tmp_path / "killed" / "block-000000.nc").stat().st_mtime_ns == before
    assert content(tmp_path / "killed") == content(tmp_path / "whole")
    assert not list(tmp_path.rglob("*.partial"))


def test_composed_hypotheses_of_a_frame_are_those_of_its_result(model, items, tmp_path):
    import jax

    sample_frames(model, items[:2], key=key(0), out=tmp_path, composed=True, **SETTINGS)
    result = inference.sample(
        model,
        items[1].frame,
        key=jax.random.fold_in(key(0), 1),
        num_samples=SETTINGS["num_samples"],
        root="candidates",
    )
    chosen = inference.composed(result, items[1].frame.posterior(model, CANDIDATES), SETTINGS["k"])
    found = open_stream(tmp_path)["hypotheses"].isel(frame=1)
    assert found.joints.values == pytest.approx(np.array([one.joints for one in chosen]))
    assert found.draw.values.tolist() == [one.draw for one in chosen]
    with pytest.raises(BadInput, match="composed"):
        sample_frames(model, items[:2], key=key(0), out=tmp_path, **SETTINGS)


# --- where people stand


@pytest.mark.slow
def test_who_stands_in_place_is_seen_where_the_draws_are(items, tmp_path):
    """Through a pinhole, from its definition: x and y over depth, times the focal length."""
    import jax

    centre = np.array([300.0, 200.0])
    model = PoseModel.from_anatomy(Anatomy.embedded("wide"), lens=Lens(900.0, centre))
    options = SETTINGS | {"root": "uncertain", "num_roots": 60}
    sample_frames(model, items[:1], key=key(0), out=tmp_path, **options)
    draw = drawer(model, root="uncertain", num_samples=SETTINGS["num_samples"], num_roots=60)
    draws = draw(items[0].frame, jax.random.fold_in(key(0), 0))
    tree = open_stream(tmp_path)
    chosen = tree["hypotheses"].isel(frame=0)
    standing = chosen.joints.values + chosen.place.values[:, None]
    seen = centre + 900.0 * standing[..., :2] / standing[..., 2:]
    own = draws.keypoints[chosen.draw.values]
    assert seen == pytest.approx(own, abs=1e-6 * np.ptp(own))
    scale = np.asarray(draws.scale)
    assert tree["summary"].place.values[0, 2] == pytest.approx((900.0 / scale).mean())
    assert tree["summary"].place_sd.values[0, 2] == pytest.approx((900.0 / scale).std())
    half = chosen.joints.values + 0.5 * chosen.place.values[:, None]
    wrong = centre + 900.0 * half[..., :2] / half[..., 2:]
    assert np.abs(wrong - own).max() > 0.01 * np.ptp(own)


@pytest.mark.parametrize("focal", [None, [800.0, 1000.0]])
def test_without_one_focal_length_nobody_stands_anywhere(model, items, tmp_path, focal):
    """Nor where it is drawn: draws of one frame and of the next would stand elsewhere. But every
    draw stands somewhere by its own."""
    options = SETTINGS
    if focal is not None:
        model = model.seen_by(Lens(np.array(focal), np.array([300.0, 200.0])))
        options = SETTINGS | {"root": "uncertain", "num_roots": 60}
    sample_frames(model, items[:1], key=key(0), out=tmp_path, **options)
    tree = open_stream(tmp_path)
    assert np.isnan(tree["summary"].place.values).all()
    assert np.isnan(tree["hypotheses"].place.values).all()
    drawn = draws_of(tmp_path, items[0].name)
    if focal is None:
        assert np.isnan([*drawn.focal.values.ravel(), *drawn.place.values.ravel()]).all()
    else:
        assert set(drawn.focal.values.ravel().tolist()) == set(focal)
        near = drawn.place.values[0, :, 2] / drawn.focal.values[0]
        assert np.ptp(near) < 0.5 * near.mean()  # one over the scale: how large the person appears


# --- an uncertain root


UNCERTAIN = SETTINGS | {"root": "uncertain", "num_roots": 60}


@pytest.fixture(scope="module")
def uncertain(model, items, tmp_path_factory) -> Path:
    """A stream of two blocks."""
    folder = tmp_path_factory.mktemp("uncertain") / "stream"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream, "MOST_IN_BLOCK", 2)
        sample_frames(model, items[:4], key=key(0), out=folder, **UNCERTAIN)
    return folder


@pytest.mark.slow
def test_draws_under_an_uncertain_root_are_those_of_sample(model, items, uncertain):
    import jax

    tree, name = open_stream(uncertain), items[1].name
    result = inference.sample(
        model,
        items[1].frame,
        key=jax.random.fold_in(key(0), 1),
        num_samples=SETTINGS["num_samples"],
        root="uncertain",
        num_roots=UNCERTAIN["num_roots"],
    )
    ours = draws_of(uncertain, name).joints.values
    assert np.array_equal(ours, result.tree["posterior"].joints.values.astype(np.float32))
    row = tree["summary"].sel(frame=name)
    assert float(row.effective_roots) == result.tree.attrs["effective_roots"]
    assert float(row.log_evidence) == result.tree.attrs["log_evidence"]
    assert (str(row.status.item()), str(row.sentence.item())) == (result.status, result.sentence)
    assert tree.attrs["root"] == "uncertain"
    assert tree.attrs["num_roots"] == 60
    assert np.isnan(tree["summary"].effective_roots.values[2])
    thorax = ours[0, :, 1]
    assert thorax.std(axis=0).max() > 0.01  # with a fixed root, zero


@pytest.mark.slow
def test_too_few_roots_are_no_answer_for_a_frame(model, items, tmp_path):
    few = UNCERTAIN | {"num_roots": 3}
    sample_frames(model, items[:1], key=key(0), out=tmp_path, **few)
    row = open_stream(tmp_path)["summary"].isel(frame=0)
    assert row.status.item() == "out of budget"
    assert 0 <= float(row.effective_roots) <= 3
    assert "roots" in row.sentence.item()


@pytest.mark.slow
def test_an_uncertain_stream_goes_on_to_the_same_bits(model, items, uncertain, tmp_path):
    out = tmp_path / "killed"

    def breaking():
        yield from items[:2]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample_frames(model, breaking(), key=key(0), out=out, **UNCERTAIN)
    sample_frames(model, items[:4], key=key(0), out=out, **UNCERTAIN)
    assert content(out) == content(uncertain)
    with pytest.raises(BadInput, match="its root is 'uncertain', not 'candidates'"):
        sample_frames(model, items[:4], key=key(0), out=out, **SETTINGS)
    with pytest.raises(BadInput, match="its num_roots is 60, not 61"):
        sample_frames(model, items[:4], key=key(0), out=out, **(UNCERTAIN | {"num_roots": 61}))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"root": "free"}, "there is no root 'free'"),
        (
            {"root": "uncertain", "sampler": "rejection-prior"},
            "no sampler 'rejection-prior' draws torso",
        ),
        ({"root": "uncertain", "num_roots": 0}, "roots must lie between 1 and"),
        ({"sampler": "emcee"}, "there is no exact sampler 'emcee'"),
    ],
)
def test_roots_that_cannot_be_are_refused(model, tmp_path, arguments, match):
    with pytest.raises(BadInput, match=match):
        sample_frames(model, [], key=key(0), out=tmp_path, **arguments)
    assert not list(tmp_path.iterdir())


def test_only_so_many_draws_are_kept(model, items, tmp_path):
    folders = {keep: tmp_path / str(keep) for keep in (0, 7, 40)}
    for keep, folder in folders.items():
        some = SETTINGS | {"keep": keep}
        sample_frames(model, items[:1], key=key(0), out=folder, **some)
        summary = open_stream(folder)["summary"]
        assert int(summary.num_draws[0]) == 40
        xr.testing.assert_identical(summary, open_stream(folders[0])["summary"])
    assert draws_of(folders[7], items[0].name).sizes["draw"] == 7
    with pytest.raises(BadInput, match="no draws were kept in"):
        draws_of(folders[0], items[0].name)


def test_what_is_kept_is_as_large_as_is_said(model, items, tmp_path):
    """The values of one frame's draws, in bytes."""
    sample_frames(model, items[:1], key=key(0), out=tmp_path, **SETTINGS)
    draws = draws_of(tmp_path, items[0].name)
    values = sum(draws[name].nbytes for name in stream.PoseDraws._fields)
    assert values == SETTINGS["keep"] * stream.DRAW_BYTES


def test_other_runs_and_other_frames_are_refused_and_nothing_is_overwritten(model, items, tmp_path):
    sample_frames(model, items[:2], key=key(0), out=tmp_path, **SETTINGS)
    before = content(tmp_path)
    with pytest.raises(BadInput, match=r"holds another run .its seed is"):
        sample_frames(model, items[:2], key=key(1), out=tmp_path, **SETTINGS)
    with pytest.raises(BadInput, match="its num_samples is 40, not 41"):
        sample_frames(
            model, items[:2], key=key(0), out=tmp_path, **(SETTINGS | {"num_samples": 41})
        )
    moved = dataclasses.replace(items[0].frame, likelihood=Likelihood(factor=0.7))
    with pytest.raises(BadInput, match=r"made of other frames"):
        sample_frames(
            model, [Item(items[0].name, moved), items[1]], key=key(0), out=tmp_path, **SETTINGS
        )
    assert content(tmp_path) == before


@pytest.fixture(scope="module")
def written(model, items, tmp_path_factory) -> Path:
    """A stream of three blocks."""
    folder = tmp_path_factory.mktemp("written") / "stream"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream, "MOST_IN_BLOCK", 2)
        sample_frames(model, items, key=key(0), out=folder, **SETTINGS)
    return folder


@pytest.fixture
def copy(written, tmp_path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "copy"))


def cut_off(block: Path) -> None:
    block.write_bytes(block.read_bytes()[:1000])


def zeroed(block: Path) -> None:
    """Values set to zero by somebody who knows netCDF."""
    with netCDF4.Dataset(block, "a") as file:
        for group in ("hypotheses", "posterior"):
            file[group]["joints"][:] = 0.0


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("spoil", [cut_off, zeroed, Path.unlink])
def test_missing_and_damaged_blocks_are_named_and_made_anew(
    spoil, number, model, items, written, copy, caplog
):
    block = copy / f"block-00000{number}.nc"
    spoil(block)
    with pytest.raises(BadInput, match=block.name):
        open_stream(copy)
    with pytest.raises(BadInput, match=block.name):
        draws_of(copy, items[2 * number].name)
    sample_frames(model, items, key=key(0), out=copy, **SETTINGS)
    assert content(copy) == content(written)
    assert (f"{block.name} is damaged" in caplog.text) == (spoil is not Path.unlink)


def test_blocks_of_a_longer_run_are_refused(model, items, copy):
    """Seventy people, then sixty-four, with the same folder."""
    before = content(copy)
    with pytest.raises(BadInput, match=r"of a longer one, block-000001.nc and after"):
        sample_frames(model, items[:2], key=key(0), out=copy, **SETTINGS)
    assert content(copy) == before
    with pytest.raises(BadInput, match=r"block-000002.nc was made of other frames"):
        sample_frames(model, items[:5], key=key(0), out=copy, **SETTINGS)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"key": key(1)}, "its seed is"),
        ({"num_samples": 41}, "its num_samples is 40, not 41"),
        ({"k": 2}, "its k is 3, not 2"),
        ({"keep": 5}, "its keep is 40, not 5"),
    ],
)
def test_a_run_that_lost_its_settings_is_not_mixed_with_another(
    other, said, model, items, written, copy
):
    (copy / "run.json").unlink()
    (copy / "block-000000.nc").unlink()
    with pytest.raises(BadInput, match=said):
        sample_frames(model, items, out=copy, **({"key": key(0)} | SETTINGS | other))
    assert not (copy / "block-000000.nc").exists()
    sample_frames(model, items, key=key(0), out=copy, **SETTINGS)
    assert content(copy) == content(written)


def test_a_block_under_another_number_is_refused(model, items, copy):
    shutil.copy(copy / "block-000000.nc", copy / "block-000001.nc")
    with pytest.raises(BadInput, match="is block 0 of its run under another name"):
        open_stream(copy)


def test_a_stream_grows(model, items, written, tmp_path):
    sample_frames(model, items[:4], key=key(0), out=tmp_path, **SETTINGS)
    sample_frames(model, items, key=key(0), out=tmp_path, **SETTINGS)
    assert content(tmp_path) == content(written)
    assert open_stream(tmp_path)["summary"].sizes["frame"] == 6


@pytest.mark.slow
def test_workers_draw_the_same_bits(model, items, written, tmp_path):
    sample_frames(
        model, items, key=key(0), out=tmp_path, machines=inference.Machines(2), **SETTINGS
    )
    assert content(tmp_path) == content(written)


LENS = Lens(1000.0001, np.array([320.0, 240.0]))
OTHERWISE = {
    "focal": {"lens": Lens(np.nextafter(LENS.focal, 2000), LENS.principal)},
    "principal": {"lens": Lens(LENS.focal, np.nextafter(LENS.principal, [999, 0]))},
    "upright": {"upright": np.nextafter(20.0, 21)},
    "likelihood": {"factor": np.nextafter(0.25, 1)},
}


@pytest.mark.parametrize("name", OTHERWISE)
def test_settings_are_compared_to_the_last_bit(name, tmp_path):
    """A run is gone on with by the same numbers alone; the same ones are."""

    def go(lens=LENS, upright=20.0, factor=0.25):
        estimating = Estimating("dictionary", likelihood=Likelihood(factor=factor))
        sample_frames(
            PoseModel(lens=lens, upright=upright),
            [Item("a", "nobody")],
            key=key(0),
            out=tmp_path,
            estimating=estimating,
            **SETTINGS | {"root": "uncertain"},
        )

    go()
    go()
    with pytest.raises(BadInput, match=rf"holds another run \(its {name} is"):
        go(**OTHERWISE[name])


def test_two_processes_do_not_write_to_one_folder(model, items, tmp_path):
    with store.locked(tmp_path), pytest.raises(BadInput, match=f"by process {os.getpid()} on "):
        sample_frames(model, items, key=key(0), out=tmp_path, **SETTINGS)
    assert not list(tmp_path.iterdir())


def test_names_that_no_file_can_hold_are_written_in_others(model, tmp_path):
    sample_frames(model, [Item("a\ud800\0b", "bad \ud800")], key=key(0), out=tmp_path, **SETTINGS)
    summary = open_stream(tmp_path)["summary"]
    assert summary.frame.values.tolist() == ["a\\ud800\\0b"]


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"num_samples": 3, "k": 4}, "3 samples, 4 hypotheses"),
        ({"num_samples": 0, "k": 1}, "0 samples"),
        ({"num_samples": 3, "k": 1, "keep": -1}, "-1 kept"),
    ],
)
def test_numbers_that_do_not_go_together_are_refused(model, tmp_path, arguments, match):
    with pytest.raises(BadInput, match=match):
        sample_frames(model, [], key=key(0), out=tmp_path, **arguments)


# --- people who are estimated by the stream


class Counting(Estimating):
    """Counts who is estimated; the dictionary estimator, which refuses whoever stands first."""

    refused, asked = "nobody", 0

    def __call__(self, detections):
        type(self).asked += len(detections)
        if any(detection.source == self.refused for detection in detections):
            raise BadInput(f"{self.refused} is nobody's")
        return super().__call__(detections)


@pytest.fixture
def people(model, items) -> list[Item]:
    """The detections of the items."""
    return [
        item if isinstance(item.frame, str) else Item(item.name, item.frame.detection)
        for item in items
    ]


@pytest.fixture
def counting(monkeypatch) -> Counting:
    monkeypatch.setattr(Counting, "asked", 0)
    return Counting(likelihood=Likelihood(factor=0.6))


@pytest.mark.slow
def test_people_are_estimated_where_their_block_is_made_and_not_again(
    model, people, counting, tmp_path
):
    out, estimated = tmp_path / "people", tmp_path / "estimated"
    known = {"key": key(0), "estimating": counting} | SETTINGS
    sample_frames(model, people[:4], out=out, **known)
    assert counting.asked == 3
    sample_frames(model, people, out=out, **known)
    assert counting.asked == 5
    sample_frames(model, people, out=out, **known)
    assert counting.asked == 5
    given = [
        item if isinstance(item.frame, str) else Item(item.name, counting([item.frame])[0])
        for item in people
    ]
    sample_frames(model, given, key=key(0), out=estimated, **SETTINGS)
    assert content(estimated) == content(out)
    with pytest.raises(BadInput, match="its candidates is 2, not 1"):
        sample_frames(
            model, people, out=out, **known | {"estimating": Estimating(num_candidates=1)}
        )


def test_who_cannot_be_estimated_takes_nobody_along(model, people, counting, monkeypatch, tmp_path):
    lost = dataclasses.replace(people[0].frame, source="a lost file")
    monkeypatch.setattr(Counting, "refused", lost.source)
    some = [Item("lost", lost), *people[1:2]]
    sample_frames(model, some, key=key(0), out=tmp_path, estimating=counting, **SETTINGS)
    summary = open_stream(tmp_path)["summary"]
    assert summary.status.values.tolist() == ["bad input", "complete"]
    assert str(summary.sentence[0].item()) == "a lost file is nobody's"


def test_people_whom_nothing_can_estimate_are_refused(model, people, tmp_path):
    with pytest.raises(BadInput, match=r"frame 0 is a detection; .* \(`estimating`\)"):
        sample_frames(model, people, key=key(0), out=tmp_path / "x", **SETTINGS)
    with pytest.raises(BadInput, match="there is no estimator 'oracle'"):
        sample_frames(
            model,
            people,
            key=key(0),
            out=tmp_path / "y",
            estimating=Estimating("oracle"),
            **SETTINGS,
        )
    assert not (tmp_path / "y").exists()


def test_what_estimates_depend_on_is_told_apart(tmp_path):
    """Settings of estimators that differ in one thing, a file's content among them."""
    torsos, poses = Anatomy.default().torsos, PoseDictionary.default()
    np.savez(tmp_path / "one.npz", joints=np.eye(15, 3)[None])
    np.savez(tmp_path / "two.npz", joints=2 * np.eye(15, 3)[None])
    files = []
    for name in ("one", "two"):
        shutil.copy(tmp_path / f"{name}.npz", tmp_path / "poses.npz")
        files.append(Estimating(str(tmp_path / "poses.npz")).settings)
    others = [
        Estimating(),
        Estimating("zhou"),
        Estimating(torsos=torsos[:-1]),
        Estimating(poses=dataclasses.replace(poses, mean=poses.mean * 1.01)),
        Estimating(num_candidates=1),
        Estimating(likelihood=Likelihood(factor=0.6)),
    ]
    found = [json.dumps(one) for one in [*files, *(other.settings for other in others)]]
    assert len(set(found)) == len(found)
    assert Estimating(torsos=torsos, poses=poses).settings == Estimating().settings


def test_what_is_not_a_stream_is_named(tmp_path):
    with pytest.raises(BadInput, match="is not a stream of frames"):
        open_stream(tmp_path)
    with pytest.raises(BadInput, match="is not a stream of frames"):
        draws_of(tmp_path, "x")


def test_who_is_not_in_a_stream_is_named(written):
    with pytest.raises(BadInput, match="has no frame 'x'"):
        draws_of(written, "x")
