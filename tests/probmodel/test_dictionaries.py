"""Pose dictionaries: how poses are prepared, second routes to both dictionaries, and files that are
not one."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sklearn.decomposition import PCA

from poseterior import inference
from poseterior.probmodel import Anatomy, BadInput
from poseterior.probmodel.body import aligned, bone_vectors, mirror_pose, with_lengths
from poseterior.probmodel.example import example
from poseterior.probmodel.learning.dictionaries import (
    EXPLAINED,
    MOST,
    PoseDictionary,
    learn_dictionary,
    principal_directions,
)
from poseterior.probmodel.learning.poses import LEARNING_RATE, read_all
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.skeleton import JOINTS, MIRROR, TORSO_INDEX
from poseterior.reports.commands import learn
from poseterior.reports.options import Screen
from poseterior.reports.settings import LearnSettings

DICTIONARY = PoseDictionary.default()


def poses(number: int, seed: int = 0) -> np.ndarray:
    """Poses `(number, 15, 3)` that differ: the mean and much of a few principal directions, turned
    at random."""
    rng = np.random.default_rng(seed)
    weights = rng.normal(size=(number, 6)) * 0.6
    joints = DICTIONARY.mean + np.einsum("nk,kja->nja", weights, DICTIONARY.bases[:6])
    return joints @ Rotation.random(number, rng=rng).as_matrix().swapaxes(1, 2) + rng.normal(
        size=(number, 1, 3)
    )


def recording(joints: np.ndarray, name: str, subject: str = "one") -> Motion:
    return Motion(joints * 350.0, LEARNING_RATE, name, subject)


def smooth(number: int, seed: int) -> np.ndarray:
    """A recording's poses `(number, 15, 3)`: no bone jumps from frame to frame."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 6, number)[:, None]
    weights = np.sin(time * rng.uniform(0.5, 2, 6) + rng.uniform(0, 6, 6)) * 0.5
    return DICTIONARY.mean + np.einsum("nk,kja->nja", weights, DICTIONARY.bases[:6])


def test_the_embedded_dictionary_is_one():
    assert DICTIONARY.mean.shape == (15, 3)
    assert np.abs(DICTIONARY.mean[0]).max() < 1e-6
    assert len(DICTIONARY.bases) > 45  # overcomplete: more directions than coordinates
    assert len(DICTIONARY.atoms) == 128
    for terms in (DICTIONARY.bases, DICTIONARY.atoms):
        assert np.linalg.norm(terms, axis=(1, 2)) == pytest.approx(1.0, abs=1e-5)
    symmetric = DICTIONARY.lengths[[MIRROR[joint] - 1 for joint in range(1, 15)]]
    assert symmetric == pytest.approx(DICTIONARY.lengths)
    limbs = DICTIONARY.lengths[[2, 3, 5, 6, 9, 10, 12, 13]]  # elbows, wrists, knees, ankles
    assert limbs.mean() == pytest.approx(1.0, abs=0.02)


def test_new_lengths_keep_directions_and_the_pelvis():
    joints = poses(20)
    changed = with_lengths(joints, DICTIONARY.lengths)
    assert np.linalg.norm(bone_vectors(changed), axis=-1) == pytest.approx(
        np.tile(DICTIONARY.lengths, (20, 1))
    )
    assert changed[:, 0] == pytest.approx(joints[:, 0])
    across = np.cross(bone_vectors(changed), bone_vectors(joints))
    assert np.abs(across).max() < 1e-12
    assert with_lengths(changed, np.linalg.norm(bone_vectors(joints), axis=-1)) == pytest.approx(
        joints
    )


def test_alignment_takes_every_turn_and_place_away():
    """Poses that differ by a rigid motion become one; against SciPy's solution of Wahba's problem
    (second route)."""
    joints = poses(8)
    found = aligned(joints, DICTIONARY.torso)
    turned = (
        joints @ Rotation.random(8, rng=np.random.default_rng(1)).as_matrix().swapaxes(1, 2) + 2.0
    )
    assert aligned(turned, DICTIONARY.torso) == pytest.approx(found, abs=1e-9)
    for before, after in zip(joints, found, strict=True):
        centred = before - before[0]
        turn, _ = Rotation.align_vectors(DICTIONARY.torso[1:], centred[list(TORSO_INDEX[1:])])
        assert turn.apply(centred) == pytest.approx(after, abs=1e-6)


def test_principal_directions_are_those_of_scikit_learn():
    joints = aligned(poses(300), DICTIONARY.torso)
    found = principal_directions(joints).reshape(-1, 45)
    route = PCA(len(found)).fit(joints.reshape(300, -1))
    assert found @ found.T == pytest.approx(np.eye(len(found)), abs=1e-9)
    assert np.abs(np.sum(found * route.components_, axis=1)) == pytest.approx(1.0, abs=1e-6)
    assert (found @ np.arange(1, 46) > 0).all()  # the sign is a choice, not the processor's
    share = np.cumsum(PCA().fit(joints.reshape(300, -1)).explained_variance_ratio_)
    assert len(found) == min(MOST, 1 + int(np.searchsorted(share, EXPLAINED)))


def test_learning_is_blind_to_place_turn_size_and_side():
    """Recordings that were moved, turned, scaled or mirrored teach the same; a class is a class
    whatever its name."""
    first, second = smooth(200, 1), smooth(200, 2)
    turn = Rotation.from_rotvec([0.3, 2.0, -0.4]).as_matrix()
    learned = learn_dictionary([recording(first, "a/1"), recording(second, "b/1")], num_atoms=8)
    other = learn_dictionary(
        [recording(2 * first @ turn.T + 5, "a/1"), recording(mirror_pose(second), "z/1", "two")],
        num_atoms=8,
    )
    assert other.lengths == pytest.approx(learned.lengths, abs=1e-5)
    assert other.mean == pytest.approx(learned.mean, abs=1e-5)
    for one, two in zip(learned.bases, other.bases, strict=True):
        assert abs(np.sum(one * two)) == pytest.approx(1.0, abs=1e-3)
    assert learned.mean == pytest.approx(mirror_pose(learned.mean), abs=1e-5)


def test_atoms_describe_what_they_were_not_learned_from():
    """Sparse non-negative sums of few atoms come nearer to new poses than the mean pose does, by
    far."""
    from sklearn.decomposition import sparse_encode

    learned = learn_dictionary(
        [recording(smooth(600, seed), f"a/{seed}") for seed in range(4)], num_atoms=40
    )
    new = aligned(with_lengths(smooth(100, 9), learned.lengths), learned.torso)
    flat = learned.atoms.reshape(len(learned.atoms), -1)
    code = sparse_encode(
        new.reshape(100, -1), flat, algorithm="lasso_cd", alpha=0.1, positive=True, max_iter=10**6
    )
    error = np.linalg.norm((code @ flat).reshape(new.shape) - new, axis=-1).mean()
    assert error < 0.4 * np.linalg.norm(learned.mean - new, axis=-1).mean()
    assert np.count_nonzero(code > 1e-6, axis=1).mean() < 15


@pytest.mark.slow
def test_the_embedded_dictionary_can_be_rebuilt(shared_data):
    paths = [
        shared_data / "cmu" / "asfamc",
        shared_data / "cmu" / "actions_train.npz",
        shared_data / "bvh",
    ]
    learned = learn_dictionary(read_all(paths))
    for field in dataclasses.fields(DICTIONARY):
        assert getattr(learned, field.name) == pytest.approx(
            getattr(DICTIONARY, field.name), abs=1e-6
        )


@pytest.mark.slow
def test_learn_writes_dictionaries_that_estimators_use(shared_data, tmp_path, capsys):
    """From one recording of walking: beside the limits, and only where asked for."""
    walk, out, poses = (
        shared_data / "cmu" / "asfamc" / "02" / "02_01.amc",
        tmp_path / "l.npz",
        tmp_path / "p.npz",
    )
    learn.run(LearnSettings(mocap=[walk], out=out), Screen(quiet=True, json=True))
    assert not poses.exists()
    before = out.read_bytes()
    learn.run(LearnSettings(mocap=[walk], out=out, poses=poses), Screen(quiet=True))
    assert out.read_bytes() == before
    assert f"and {poses}" in capsys.readouterr().out
    wider = tmp_path / "wider.npz"
    learn.run(LearnSettings(mocap=[walk], out=wider, wider=2), Screen(quiet=True, json=True))
    usual, wide = (np.asarray(Anatomy.load(path).limits.occupied) for path in (out, wider))
    assert (usual <= wide).all()
    assert wide.sum() > 1.2 * usual.sum()
    learned = PoseDictionary.load(poses)
    frame = inference.estimate_torso(example().detection, "zhou", poses=learned)
    assert np.isfinite(frame.pose).all()
    with pytest.raises(BadInput, match="is a folder"):
        learn.run(LearnSettings(mocap=[walk], out=out, poses=tmp_path), Screen(quiet=True))


def test_saved_and_loaded_it_is_the_same(tmp_path):
    DICTIONARY.save(tmp_path / "poses.npz")
    again = PoseDictionary.load(tmp_path / "poses.npz")
    for field in dataclasses.fields(DICTIONARY):
        assert np.array_equal(getattr(again, field.name), getattr(DICTIONARY, field.name))


def damaged(**changes: object) -> dict:
    whole = {"joints": np.array(JOINTS), **dataclasses.asdict(DICTIONARY)}
    return {name: value for name, value in (whole | changes).items() if value is not None}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"joints": np.array([f"joint {i}" for i in range(17)])}, "another skeleton, of 17 joints"),
        ({"joints": np.array(JOINTS[::-1])}, "another skeleton"),
        ({"joints": None}, "lacks joints"),
        ({"atoms": None, "bases": None}, "lacks bases, atoms"),
        ({"atoms": np.ones((8, 17, 3))}, r"atoms has shape \(8, 17, 3\).*another skeleton"),
        ({"bases": np.ones((0, 15, 3))}, "bases has shape"),
        ({"mean": np.full((15, 3), np.nan)}, "mean holds a number that is not finite"),
        ({"mean": np.array("walking")}, "mean has shape"),
        ({"lengths": np.zeros(14)}, "length that is not positive"),
    ],
)
def test_a_file_that_is_not_one_is_refused(changes, match, tmp_path):
    np.savez(tmp_path / "poses.npz", **damaged(**changes))
    with pytest.raises(BadInput, match=match):
        PoseDictionary.load(tmp_path / "poses.npz")


def test_no_file_and_no_npz_are_refused(tmp_path):
    with pytest.raises(BadInput, match="there is no file of pose dictionaries"):
        PoseDictionary.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("poses")
    with pytest.raises(BadInput, match="is no file of pose dictionaries"):
        PoseDictionary.load(tmp_path / "text.npz")


@pytest.mark.parametrize(
    ("motions", "match"),
    [
        ([], "no usable frame"),
        ([recording(smooth(20, 1), "a/1")], "too few for a dictionary of 128"),
        (
            [recording(np.repeat(np.zeros((1, 15, 3)), 9, axis=0), "a/1")],
            "a/1 of subject one has a bone of length zero",
        ),
    ],
)
def test_too_little_motion_is_refused(motions, match):
    with pytest.raises(BadInput, match=match):
        learn_dictionary(motions)
