"""Draws that go to disk block by block, against those that stay in memory; with blocks that repeat,
shares that are not shuffled and predictions that repeat as negative controls.

False alarms: 1e-4 a test, over a fresh seed; seeds are fixed."""

import dataclasses
import gc
import weakref
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from scipy.stats import hypergeom, ks_2samp

from poseterior import inference
from poseterior.inference import Result, drawsfile
from poseterior.inference.draws import COMPLETE, OUT_OF_BUDGET
from poseterior.inference.drawsfile import sample_to_file
from poseterior.inference.exact import mixture
from poseterior.inference.exact.mixture import RootSampler
from poseterior.inference.importance.weighted import WeightedRoots
from poseterior.inference.results import SINGLE, result_of
from poseterior.inference.saved import read_result
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.errors.faults import FaultPrior
from poseterior.probmodel.errors.likelihood import PAPER
from tests.goodness import floor
from tests.scenes import key

BLOCK, NUMBER = 512, 4000
ROOTED = {"root": "uncertain", "num_roots": 100, "double": True}
FIXED = {"root": "candidates"}


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(drawsfile, "BLOCK", BLOCK)


@pytest.fixture
def to_file(model, example_estimate, tmp_path) -> Callable[..., Result]:
    """Draws of the example to a file of this name, by this seed."""

    def run(name: str, seed: int, number: int = NUMBER, **given) -> Result:
        path, given = tmp_path / name, FIXED | given
        return sample_to_file(
            path, model, example_estimate, key=key(seed), num_samples=number, **given
        )

    return run


def joints_of(result: Result) -> np.ndarray:
    return np.asarray(result.tree["posterior"].joints)[0]


def repeated(joints: np.ndarray) -> int:
    """How many draws there are twice."""
    return len(joints) - len(np.unique(joints.reshape(len(joints), -1), axis=0))


def test_blocks_are_draws_of_the_posterior(to_file, model, example_estimate):
    # In single precision the torso's joints, two points, would be beside those in memory.
    filed = to_file("a.nc", 1, double=True)
    held = inference.sample(
        model, example_estimate, key=key(2), num_samples=NUMBER, root="candidates"
    )
    ours, theirs = joints_of(filed), joints_of(held)
    assert ours.shape == theirs.shape
    assert filed.status == COMPLETE
    assert repeated(ours) == 0
    moving = np.argwhere(theirs.std(axis=0) > 1e-9)
    values = [ks_2samp(ours[:, j, axis], theirs[:, j, axis]).pvalue for j, axis in moving]
    assert min(values) > floor(len(values))
    error = np.hypot(filed.tree.attrs["log_evidence_se"], held.tree.attrs["log_evidence_se"])
    assert abs(filed.tree.attrs["log_evidence"] - held.tree.attrs["log_evidence"]) < 4 * error
    assert np.array_equal(filed.tree["posterior"].draw, np.arange(NUMBER))


def test_blocks_that_are_not_forgotten_would_repeat(to_file, monkeypatch):
    monkeypatch.setattr(RootSampler, "forget", lambda self, number: None)
    filed = to_file("a.nc", 1)
    assert repeated(joints_of(filed)) > NUMBER / 2


def rarest_share(result: Result) -> float:
    """The p-value of the block whose share of the rarer candidate is the least likely if all draws
    stand in random order, times the blocks and two sides."""
    rarer = result.tree["constant_data"].weight.values.argmin()
    rare = np.asarray(result.tree["posterior"].candidate)[0] == rarer
    blocks = [rare[start : start + BLOCK] for start in range(0, len(rare), BLOCK)]
    laws = [(block.sum(), hypergeom(len(rare), rare.sum(), len(block))) for block in blocks]
    return 2 * len(blocks) * min(min(law.cdf(n), law.sf(n - 1)) for n, law in laws)


def in_order(counts, block, rng):
    """One candidate after the other."""
    while counts.sum() > block:
        own = np.array([min(counts[0], block), block - min(counts[0], block)])
        yield own
        counts = counts - own
    yield counts


@pytest.mark.parametrize("shared_out", [mixture._shared_out, in_order])
def test_every_block_is_a_sample_of_the_mixture(to_file, monkeypatch, shared_out):
    monkeypatch.setattr(mixture, "_shared_out", shared_out)
    filed = to_file("a.nc", 3)
    weight = filed.tree["constant_data"].weight.values
    assert 0.02 < weight.min() < 0.2
    found = rarest_share(filed)
    assert found < 1e-8 if shared_out is in_order else found > 1e-4


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("given", [FIXED, ROOTED])
def test_predictions_of_blocks_have_errors_of_their_own(to_file, monkeypatch, given, numbered):
    if not numbered:
        monkeypatch.setattr(drawsfile, "result_of", lambda draws, block=0: result_of(draws))
    filed = to_file("a.nc", 4, 2 * BLOCK + 1, **given)
    made = filed.tree["posterior_predictive"].keypoints - filed.tree["posterior"].keypoints
    (joint, *_) = np.flatnonzero(np.isfinite(made).all(axis=(0, 1, 3)))
    errors = np.asarray(made)[0, :, joint, 0]
    alike = np.corrcoef(errors[:BLOCK], errors[BLOCK : 2 * BLOCK])[0, 1]
    assert abs(alike) < 4 / np.sqrt(BLOCK) if numbered else alike > 0.8


def test_blocks_of_weighted_roots_are_draws_of_the_posterior(to_file, model, example_estimate):
    """Each block has every root as often as its weight says, to one draw; the others are those of
    draws in memory."""
    filed = to_file("a.nc", 1, **ROOTED)
    held = inference.sample(
        model, example_estimate, key=key(1), num_samples=NUMBER, root="uncertain", num_roots=100
    )
    share = held.tree["roots"].share.values
    assert np.array_equal(filed.tree["roots"].share, share), "the same roots"
    rows = filed.tree["posterior"].root_index.values[0]
    for start in range(0, NUMBER, BLOCK):
        own = rows[start : start + BLOCK]
        counts = np.bincount(own, minlength=100)
        assert np.abs(counts - len(own) * share).max() < 1 + 1e-9
    ours, theirs = joints_of(filed), joints_of(held)
    assert ours.shape == theirs.shape
    assert repeated(ours) < NUMBER / 100, "two limbs of a root are drawn together now and then"
    moving = np.argwhere(theirs.std(axis=0) > 1e-9)
    values = [  # not exact: draws of one root have one torso
        ks_2samp(ours[:, j, axis], theirs[:, j, axis], method="asymp").pvalue for j, axis in moving
    ]
    assert min(values) > floor(len(values))
    assert np.array_equal(filed.tree["posterior"].draw, np.arange(NUMBER))
    for name in ("acceptance_rate", "log_evidence", "num_samples", "seed", "effective_roots"):
        assert filed.tree.attrs[name] == held.tree.attrs[name], name


def test_blocks_of_weighted_roots_by_one_seed_would_repeat(to_file, monkeypatch):
    draw = WeightedRoots.draw
    monkeypatch.setattr(
        WeightedRoots,
        "draw",
        lambda self, _rng, number: draw(self, np.random.default_rng(0), number),
    )
    assert repeated(joints_of(to_file("a.nc", 1, **ROOTED))) > NUMBER / 2


@pytest.mark.slow
def test_faults_stand_in_every_block(to_file, tmp_path, example_estimate, model):
    faulty = dataclasses.replace(
        example_estimate,
        likelihood=dataclasses.replace(PAPER, faults=FaultPrior.of(0.2, 0.1)),
    )
    path, given = tmp_path / "f.nc", {"key": key(3), "num_samples": 3 * BLOCK}
    sample_to_file(path, model, faulty, **given, root="uncertain", num_roots=100)
    with xr.open_datatree(path, engine="netcdf4") as tree:
        draws, roots = tree["posterior"].isel(chain=0).load(), tree["roots"].load()
    assert draws.outlier.dtype == bool
    for start in range(0, 3 * BLOCK, BLOCK):
        block = slice(start, start + BLOCK)
        assert draws.outlier[block].values.any()
        turned = roots.rotation.values[draws.root_index.values[block]]
        np.testing.assert_allclose(draws.rotation.values[block], turned)
    # One root has one pattern, in whichever block.
    for own in np.unique(draws.root_index.values):
        rows = draws.root_index.values == own
        assert len(np.unique(draws.outlier.values[rows], axis=0)) == 1


@pytest.mark.parametrize("number", [100, NUMBER])
@pytest.mark.parametrize("double", [False, True])
def test_a_file_has_the_numbers_that_it_says(to_file, model, tmp_path, monkeypatch, number, double):
    """In one block or in many: what stands in the file, and what tables and pages read of it."""
    path = tmp_path / "a.nc"
    filed = to_file("a.nc", 5, number, double=double)
    monkeypatch.setattr(drawsfile, "BLOCK", NUMBER)
    exact = to_file("b.nc", 5, number, double=True)
    with xr.open_datatree(path, engine="netcdf4") as tree:
        for group, names in SINGLE.items():
            if group not in tree.children:  # discs have no log likelihood
                continue
            assert {tree[group][name].dtype for name in names} == {
                np.dtype("f8" if double else "f4")
            }
        assert tree["posterior"].bone_length.dtype == "f8"
        assert tree.attrs["num_proposals"] == filed.tree.attrs["num_proposals"]
        assert tree["posterior"].sizes["draw"] == tree["sample_stats"].sizes["draw"] == number
        if number == 100:
            close = 0 if double else 1e-6
            for name in ("joints", "lp"):
                group = "sample_stats" if name == "lp" else "posterior"
                ours, theirs = tree[group][name].values, exact.tree[group][name].values
                assert np.abs(ours - theirs).max() <= close
    again = read_result(path)
    assert again.num_draws == number
    assert np.array_equal(again.tree["posterior"].joints, filed.tree["posterior"].joints) == (
        double or number != 100  # few draws are still in memory, as they were drawn
    )
    assert model.limits.check(joints_of(again)).pose_valid.all()


def test_a_budget_that_ends_leaves_what_there_is(to_file):
    whole = to_file("a.nc", 6)
    budget = int(whole.tree.attrs["num_proposals"] * 0.8)
    found = to_file("b.nc", 6, max_proposals=budget)
    assert found.status == OUT_OF_BUDGET
    assert BLOCK < found.num_draws < NUMBER
    assert found.sentence.startswith(f"{found.num_draws} of {NUMBER} draws after ")
    assert found.tree.attrs["status"] == OUT_OF_BUDGET
    assert repeated(joints_of(found)) == 0


def test_nothing_is_written_where_there_is_no_draw(to_file, tmp_path):
    found = to_file("a.nc", 7, max_proposals=10)
    assert found.num_draws == 0
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("given", [FIXED, ROOTED])
def test_one_block_is_in_memory_at_a_time(to_file, monkeypatch, given):
    """Trees that nobody looks at again are gone at once, without the collector of cycles."""
    alive: list[weakref.ref] = []
    most = 0

    def counted(*given):
        nonlocal most
        result = result_of(*given)
        alive.append(weakref.ref(result.tree["posterior"].to_dataset().joints.variable._data))
        most = max(most, sum(one() is not None for one in alive))
        return result

    monkeypatch.setattr(drawsfile, "result_of", counted)
    gc.disable()
    try:
        to_file("a.nc", 8, **given)
    finally:
        gc.enable()
    assert len(alive) == -(-NUMBER // BLOCK)
    assert most <= 2


def test_the_first_draws_of_a_result(to_file):
    filed = to_file("a.nc", 9)
    some = filed.first(100)
    assert some.num_draws == 100
    assert np.array_equal(joints_of(some), joints_of(filed)[:100])
    assert some.first(100) is some
    assert some.tree.attrs == filed.tree.attrs


def test_a_folder_that_cannot_be_written_to(to_file):
    for number in (100, NUMBER):
        with pytest.raises(BadInput, match=r"cannot write .*; choose a folder"):
            to_file("none/a.nc", 0, number)
