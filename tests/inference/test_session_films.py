"""Streams and films of calibrated cameras: what they say is what the results of their instants
say, in level axes."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr

from poseterior.inference import film_draws, measures, open_stream, sample_film, sample_frames
from poseterior.inference.footage import Footage
from poseterior.inference.instants import sample_instant
from poseterior.inference.stream import draws_of
from poseterior.probmodel import BadInput, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, ORDERS
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.reports.exports.results import Wanted, read_clip
from poseterior.reports.tables import film_table, stream_json, stream_lines
from tests.filmed import filmed, moving

FRAMES, ROOTS, DRAWS = 3, 100, 60
CAMERAS = [0, 2, 3]


@pytest.fixture(scope="module")
def session() -> Session:
    """Frames 4, 6 and 8; one camera of four has the sides of the legs exchanged in the last."""
    rng = np.random.default_rng(1)
    found = filmed(moving(FRAMES), rng.normal(0, 15, (4, FRAMES, 15, 2)))
    people = [list(view) for view in found.people]
    last = people[2][-1]
    sides = ORDERS[EXCHANGE_INDEX["legs"]]
    people[2][-1] = dataclasses.replace(last, keypoints=last.keypoints[sides])
    return dataclasses.replace(found, numbers=(4, 6, 8), people=tuple(map(tuple, people)))


@pytest.fixture(scope="module")
def stream(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("session") / "stream"
    return sample_frames(
        PoseModel(),
        Footage(session, CAMERAS),
        key=7,
        out=out,
        num_roots=ROOTS,
        num_samples=DRAWS,
        keep=DRAWS,
        k=2,
    )


@pytest.fixture(scope="module")
def alone(session: Session) -> xr.DataTree:
    """The result of the second frame by itself."""
    key = jax.random.fold_in(jax.random.key(7), 1)
    instant = session.instant(6, CAMERAS)
    found = sample_instant(PoseModel(), instant, key=key, num_samples=DRAWS, num_roots=ROOTS)
    return found.tree


@pytest.mark.slow
def test_a_frame_is_the_result_of_its_instant(
    session: Session, stream: Path, alone: xr.DataTree
) -> None:
    """The same draws, told by hand: z is up, so that it points against y; a body unit is the
    session's, and not that of each draw."""
    found = draws_of(stream, "6").isel(chain=0)
    world = alone["posterior"].to_dataset().isel(chain=0)
    told = (found.joints.values + found.place.values[:, None]) * session.unit
    joints = np.stack([told[..., 0], told[..., 2], -told[..., 1]], axis=-1)
    level = world.joints.values
    axes = [np.abs(level[..., axis] - joints[..., axis]).max() for axis in range(3)]
    assert max(axes) < 0.5, axes
    bones = world.bone_length.values * world["size"].values[:, None] / session.unit
    np.testing.assert_allclose(found.bone_length.values, bones, rtol=1e-5)
    clip = read_clip(stream, Wanted(rate=30.0))
    assert clip.origin == "origin of the calibration"
    mean = level.mean(axis=0)[0] / 1000
    np.testing.assert_allclose(clip.joints[1, 0], mean[[0, 2, 1]] * [1, 1, -1], atol=0.02)


@pytest.mark.slow
def test_measures_are_those_of_the_instant(stream: Path, alone: xr.DataTree) -> None:
    names = ("right_knee_flexion", "trunk_inclination", "distance(right_wrist,head)")
    found, own = measures(stream, *names), measures(alone, *names)
    for name in names:
        values = found[name].sel(frame="6").values
        np.testing.assert_allclose(values, own[name].values[0], rtol=1e-4, atol=1e-2)
        assert found[name].attrs["units"] == own[name].attrs["units"]
    with pytest.raises(BadInput, match="leave the height out"):
        measures(stream, *names, height=1.8)


@pytest.mark.slow
def test_faults_are_told_by_view(stream: Path) -> None:
    """Only the third camera of four has exchanged legs, and only in the last frame."""
    tree = open_stream(stream)
    summary = tree["summary"].to_dataset()
    assert summary.view.values.tolist() == ["cam1", "cam3", "cam4"]
    assert summary.exchange.dims == ("frame", "view", "pattern")
    turned = 1 - summary.exchange.sel(pattern="none").values
    assert turned[2, 1] > 0.9
    assert np.delete(turned.ravel(), 7).max() < 0.5
    said = [line for line in stream_lines(summary) if "exchanged" in line]
    assert len(said) == 1
    assert "in 1 frame: 8 of cam3 (legs," in said[0]
    assert [frame["exchanged"] > 0.9 for frame in stream_json(summary)["frames"]] == [0, 0, 1]
    table = film_table(summary)
    spread = np.linalg.norm(summary["sd"].values, axis=-1)[:, JOINT_INDEX["right_wrist"]]
    row = next(one for one in table.json() if one["joint"] == "right_wrist")
    wanted = np.median(spread) * tree.attrs["unit_mm"]
    assert row["median_sd_mm"] == pytest.approx(wanted, rel=1e-6)


@pytest.mark.slow
def test_a_film_of_cameras_is_paths_of_bodies(
    session: Session, stream: Path, tmp_path: Path
) -> None:
    """Of one size each; before the quick is taken away, each frame has the places of its draws;
    gaps are filled."""
    out = sample_film(
        PoseModel(),
        Footage(session, CAMERAS),
        rate=60,
        key=7,
        out=tmp_path / "film",
        num_roots=ROOTS,
        num_paths=DRAWS,
        cutoff=29.9,  # above half the rate: nothing is taken away
        k=2,
    )
    paths = film_draws(out)
    assert paths.sizes["frame"] == FRAMES
    assert paths.attrs["step"] == 2
    own = np.stack([draws_of(stream, str(name)).place.values[0] for name in (4, 6, 8)])
    np.testing.assert_allclose(
        np.sort(paths.place.values[0], axis=0), np.sort(own.swapaxes(0, 1), axis=0), atol=1e-5
    )
    assert measures(out, "right_knee_flexion").sizes == {"frame": FRAMES, "draw": DRAWS}
    assert paths.bone_length.values[0].shape == (DRAWS, 5)
    assert np.isnan(paths.focal.values).all()  # cameras are calibrated, each by its own


def test_views_come_as_footage(session: Session, tmp_path: Path) -> None:
    """Or are refused before anything is drawn."""
    model, footage = PoseModel(), Footage(session)
    for number, (items, given, words) in enumerate(
        [
            (list(footage), {}, "as `Footage`"),
            (footage, {"composed": True}, "not put together limb by limb"),
            (footage, {"sampler": "rejection"}, "no sampler 'rejection'"),
        ]
    ):
        with pytest.raises(BadInput, match=words):
            sample_frames(model, items, key=0, out=tmp_path / str(number), num_samples=9, **given)
    with pytest.raises(BadInput, match="several views have no root"):
        footage.first.posterior(model, "candidates")
    with pytest.raises(BadInput, match="cannot be chosen"):
        Footage(session, [0, 7])


@pytest.mark.slow
def test_another_law_or_other_cameras_are_another_run(session: Session, tmp_path: Path) -> None:
    """And said to be, before a block is compared."""
    few, given = session.take(range(1)), {"key": 0, "num_samples": 9, "num_roots": 9, "k": 1}
    sample_frames(PoseModel(), Footage(few, CAMERAS), out=tmp_path, **given)
    for other, words in [
        (Footage(few, CAMERAS, Likelihood()), "its likelihood is"),
        (Footage(few, CAMERAS[:2]), "its views is"),
    ]:
        with pytest.raises(BadInput, match=f"another run .*{words}"):
            sample_frames(PoseModel(), other, out=tmp_path, **given)
