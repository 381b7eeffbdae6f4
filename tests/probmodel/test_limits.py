"""Limits: every kind that a bone can break, how far beyond it is, and files of them.

The size of an excess is verified by turning bones in space: no turn by less than it mends the pose,
and one by a little more does."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from poseterior.probmodel.anatomy.limits import GRID, LIMITS, AnatomicalLimits, cell_of
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.body import mirror_pose
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.kinematics import articulation, direction, pose
from poseterior.probmodel.skeleton import BONE_NAMES, BONES, NUM_LOWER, NUM_UPPER

TORSO = np.array(
    [[0, 0, 0], [0, 1, 0], [-0.5, 1.1, 0], [0.5, 1.1, 0], [-0.3, -0.1, 0], [0.3, -0.1, 0]], float
)
SIDE = np.array([1.0, 0.0, 0.0])
UP = np.tile([0.0, 1.0, 0.0], (NUM_LOWER, 1))
seeds = st.integers(0, 2**32 - 1)


def simple_limits() -> AnatomicalLimits:
    """Upper bones within 30° of the equator; lower ones with u·x < 0.5, |u·y| ≤ 0.8 and
    |u·z| ≤ 0.6."""
    occupied = np.zeros((NUM_UPPER, *GRID), bool)
    occupied[:, :, 20:40] = True
    plane = np.where(occupied[1:], 0.0, np.nan)
    return AnatomicalLimits(
        occupied=occupied,
        normal=plane[..., None] + np.array([1.0, 0.0, 0.0]),
        tangent=plane[..., None] + np.array([0.2, 1.0, 0.0]),
        offset=plane - 0.5,
        bounds=plane[..., None] + np.array([-0.8, 0.8, -0.6, 0.6]),
        reference=SIDE,
        fallback=UP,
    )


def body(
    upper: dict[str, np.ndarray] | None = None, lower: dict[str, np.ndarray] | None = None
) -> np.ndarray:
    """A pose that `simple_limits` allow, but for the local directions that are given by the bones'
    names."""
    uppers = np.tile([0.6, -0.8, 0.0], (NUM_UPPER, 1))
    lowers = np.tile([-1.0, 0.0, 0.0], (NUM_LOWER, 1))
    for name, vector in (upper or {}).items():
        uppers[BONE_NAMES.index(name)] = vector
    for name, vector in (lower or {}).items():
        lowers[BONE_NAMES.index(name) - NUM_UPPER] = vector
    return np.asarray(pose(TORSO, uppers, lowers, np.full(len(BONES), 0.7), SIDE, UP))


def angles(azimuth: float, elevation: float) -> np.ndarray:
    return np.asarray(direction(np.radians(azimuth), np.radians(elevation)))


def test_a_possible_pose_breaks_nothing() -> None:
    check = simple_limits().check(body())
    assert check.pose_valid
    assert check.sentences() == []
    assert not check.excess.any()


@pytest.mark.parametrize("degrees", [0.5, 7.0, 40.0])
@pytest.mark.parametrize("name", [bone.name for bone in BONES[:NUM_UPPER]])
def test_occupancy(name: str, degrees: float) -> None:
    check = simple_limits().check(body(upper={name: angles(17.0, 30 + degrees)}))
    bone = BONE_NAMES.index(name)
    assert LIMITS[check.limit[bone]] == "occupancy"
    assert check.excess[bone] == pytest.approx(degrees, abs=0.01)
    assert f"{name} points {degrees:.1f}° outside" in check.sentences()[0]


@pytest.mark.parametrize("degrees", [0.5, 7.0, 20.0])
@pytest.mark.parametrize("name", [bone.name for bone in BONES[NUM_UPPER:]])
def test_plane(name: str, degrees: float) -> None:
    """The plane u·x = 0.5 is 60° from the x axis."""
    check = simple_limits().check(body(lower={name: angles(0.0, 60 - degrees)}))
    bone = BONE_NAMES.index(name)
    assert LIMITS[check.limit[bone]] == "plane"
    assert check.excess[bone] == pytest.approx(degrees, abs=1e-6)
    assert f"{name} bends {degrees:.1f}° beyond" in check.sentences()[0]


@pytest.mark.parametrize(("axis", "edge"), [(1, 0.8), (2, 0.6)])
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("degrees", [0.5, 7.0])
def test_box(axis: int, edge: float, sign: int, degrees: float) -> None:
    angle = np.arcsin(edge) + np.radians(degrees)
    vector = np.array([-np.cos(angle), 0.0, 0.0])
    vector[axis] = sign * np.sin(angle)
    check = simple_limits().check(body(lower={"left_forearm": vector}))
    bone = BONE_NAMES.index("left_forearm")
    assert LIMITS[check.limit[bone]] == "box"
    assert check.excess[bone] == pytest.approx(degrees, abs=1e-6)
    assert "left_forearm turns" in check.sentences()[0]


def test_lower_bone_of_an_impossible_parent() -> None:
    check = simple_limits().check(body(upper={"right_upper_leg": angles(0.0, 50.0)}))
    upper, lower = BONE_NAMES.index("right_upper_leg"), BONE_NAMES.index("right_lower_leg")
    assert [LIMITS[check.limit[i]] for i in (upper, lower)] == ["occupancy", "parent"]
    assert np.isnan(check.excess[lower])
    assert len(check.sentences()) == 2


def turned(joints: np.ndarray, bone: int, turns: Rotation) -> np.ndarray:
    """Poses `(n, 15, 3)` with one bone turned about its start; what hangs from it keeps its
    direction."""
    start, end = BONES[bone].start, BONES[bone].end
    vectors = turns.apply(joints[end] - joints[start])
    moved = np.tile(joints, (len(turns), 1, 1))
    children = [end] + [other.end for other in BONES if other.start == end]
    moved[:, children] += (joints[start] + vectors - joints[end])[:, None]
    return moved


def all_ways(joints: np.ndarray, bone: int, degrees: float) -> np.ndarray:
    """Poses with one bone turned so far, about axes all around it."""
    vector = joints[BONES[bone].end] - joints[BONES[bone].start]
    first = np.cross(vector, [0.3, -0.5, 0.8])
    second = np.cross(vector, first)
    around = np.linspace(0, 2 * np.pi, 1440, endpoint=False)[:, None]
    axes = np.cos(around) * first / np.linalg.norm(first) + np.sin(
        around
    ) * second / np.linalg.norm(second)
    return turned(joints, bone, Rotation.from_rotvec(axes * np.radians(degrees)))


@pytest.mark.parametrize(
    ("name", "pose_of"),
    [
        ("head", lambda: body(upper={"head": angles(-70.0, 44.0)})),
        ("right_upper_arm", lambda: body(upper={"right_upper_arm": angles(170.0, -52.0)})),
        ("left_lower_leg", lambda: body(lower={"left_lower_leg": angles(10.0, 5.0)})),
        ("right_forearm", lambda: body(lower={"right_forearm": angles(180.0, 52.0)})),
    ],
)
def test_excess_is_the_least_turn_that_mends_the_bone(
    name: str, pose_of: Callable[[], np.ndarray]
) -> None:
    limits, joints, bone = simple_limits(), pose_of(), BONE_NAMES.index(name)
    excess = limits.check(joints).excess[bone]
    assert excess > 5
    assert limits.margin(joints)[bone] == -excess
    assert not limits.check(all_ways(joints, bone, excess - 0.05)).valid[:, bone].any()
    assert limits.check(all_ways(joints, bone, excess + 0.05)).valid[:, bone].any()


@pytest.mark.parametrize(
    ("name", "pose_of"),
    [
        ("head", lambda: body(upper={"head": angles(-70.0, 14.0)})),
        ("right_upper_arm", lambda: body(upper={"right_upper_arm": angles(170.0, -22.0)})),
        ("left_lower_leg", lambda: body(lower={"left_lower_leg": angles(57.0, 33.0)})),
        ("right_forearm", lambda: body(lower={"right_forearm": angles(180.0, 30.0)})),
        ("left_forearm", lambda: body(lower={"left_forearm": angles(150.0, 10.0)})),
    ],
)
def test_margin_is_the_least_turn_that_breaks_a_limit(
    name: str, pose_of: Callable[[], np.ndarray]
) -> None:
    limits, joints, bone = simple_limits(), pose_of(), BONE_NAMES.index(name)
    margin = limits.margin(joints)[bone]
    assert margin > 2
    assert limits.check(all_ways(joints, bone, margin - 0.05)).valid[:, bone].all()
    assert not limits.check(all_ways(joints, bone, margin + 0.05)).valid[:, bone].all()


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (np.zeros((17, 3)), r"needs \(\.\.\., 15, 3\)"),
        (np.full((15, 3), np.nan), "not finite"),
        (np.zeros((15, 3)), "length zero"),
    ],
)
def test_what_is_no_pose_is_refused(joints: np.ndarray, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        simple_limits().check(joints)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_articulation_undoes_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    torso = TORSO + 0.1 * rng.normal(size=TORSO.shape)
    upper, lower = rng.normal(size=(NUM_UPPER, 3)), rng.normal(size=(NUM_LOWER, 3))
    upper, lower = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (upper, lower))
    length = rng.uniform(0.3, 2.0, len(BONES))
    found = articulation(pose(torso, upper, lower, length, SIDE, UP), SIDE, UP)
    for value, expected in zip(found, (torso, upper, lower, length), strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_pose_undoes_articulation(seed: int) -> None:
    joints = np.random.default_rng(seed).normal(size=(15, 3))
    again = pose(*articulation(joints, SIDE, UP), SIDE, UP)
    np.testing.assert_allclose(again, joints, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(seeds, st.floats(1e-3, 1e3))
def test_the_check_knows_no_place_heading_or_size(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    limits = simple_limits()
    joints = rng.normal(size=(4, 15, 3))
    moved = scale * Rotation.random(rng=rng).apply(joints.reshape(-1, 3)).reshape(
        joints.shape
    ) + rng.normal(size=3)
    before, after = limits.check(joints), limits.check(moved)
    np.testing.assert_array_equal(before.limit, after.limit)
    np.testing.assert_allclose(before.excess, after.excess, atol=1e-6)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_mirroring_twice_changes_nothing(seed: int) -> None:
    joints = np.random.default_rng(seed).normal(size=(15, 3))
    np.testing.assert_array_equal(mirror_pose(mirror_pose(joints)), joints)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_mirrored_poses_have_mirrored_directions(seed: int) -> None:
    """The default's reference is the mirrored axis, so local directions change one sign each."""
    joints = np.random.default_rng(seed).normal(size=(15, 3))
    here, there = articulation(joints, SIDE, UP), articulation(mirror_pose(joints), SIDE, UP)
    np.testing.assert_allclose(
        there.upper, np.asarray(here.upper)[[0, 2, 1, 4, 3]] * [-1, 1, 1], atol=1e-9
    )
    np.testing.assert_allclose(
        there.lower, np.asarray(here.lower)[[1, 0, 3, 2]] * [1, 1, -1], atol=1e-9
    )


def test_cells_are_half_open_and_close_at_the_ends() -> None:
    azimuth = np.radians([-180 + 1e-9, -1e-9, 1e-9, 180 - 1e-9, 0, 0])
    elevation = np.radians([0.1, 0.1, -0.1, 0.1, 90, -90])
    column, row = cell_of(direction(jnp.asarray(azimuth), jnp.asarray(elevation)))
    assert column.tolist() == [0, 59, 60, 119, 60, 60]
    assert row.tolist() == [30, 30, 29, 30, 59, 0]


def changed(**changes: Callable[[np.ndarray], np.ndarray]) -> AnatomicalLimits:
    limits = simple_limits()
    return dataclasses.replace(
        limits, **{key: change(np.array(getattr(limits, key))) for key, change in changes.items()}
    )


def with_value(where: tuple[int, ...], value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(table: np.ndarray) -> np.ndarray:
        table[where] = value
        return table

    return change


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (lambda: changed(occupied=lambda table: table[:, :60]), "occupied has shape"),
        (lambda: changed(offset=with_value((0, 5, 25), np.nan)), "no plane"),
        (lambda: changed(bounds=with_value((0, 5, 25, 1), np.inf)), "not finite"),
        (lambda: changed(normal=lambda table: 2 * table), "length one"),
        (lambda: changed(tangent=lambda table: table * 0 + [1.0, 0.0, 0.0]), "parallel"),
        (lambda: changed(bounds=with_value((0, 5, 25, 1), -0.9)), "exceeds its upper"),
        (
            lambda: changed(
                occupied=lambda table: table & (np.arange(NUM_UPPER) > 0)[:, None, None]
            ),
            "no occupied cell",
        ),
        (lambda: changed(reference=lambda table: table * np.nan), "not finite"),
    ],
)
def test_tables_that_are_none_are_refused(
    limits: Callable[[], AnatomicalLimits], message: str
) -> None:
    with pytest.raises(BadInput, match=f"the file: .*{message}"):
        limits().verify("the file")


def test_saved_and_loaded_without_loss(tmp_path: Path) -> None:
    limits = simple_limits()
    limits.save(tmp_path / "limits.npz")
    loaded = AnatomicalLimits.load(tmp_path / "limits.npz")
    for field in ("occupied", "normal", "tangent", "offset", "bounds", "reference", "fallback"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(limits, field))
    assert loaded.sha256 == limits.sha256
    assert loaded.sha256 != changed(offset=with_value((0, 5, 25), -0.4)).sha256
    assert list(tmp_path.iterdir()) == [tmp_path / "limits.npz"]


def test_equal_tables_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        simple_limits().save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot write"):
        simple_limits().save(tmp_path / "nowhere" / "limits.npz")


@pytest.mark.parametrize("loader", [AnatomicalLimits.load, Anatomy.load])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.95, 0.999])
def test_truncated_files_are_refused(
    tmp_path: Path, loader: Callable[[Path], object], share: float
) -> None:
    simple_limits().save(tmp_path / "limits.npz")
    whole = (tmp_path / "limits.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(BadInput, match=r"cut\.npz is no limits file, or is truncated"):
        loader(tmp_path / "cut.npz")


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_a_damaged_file_is_refused_or_reads_the_same(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    simple_limits().save(folder / "limits.npz")
    content = bytearray((folder / "limits.npz").read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    (folder / "limits.npz").write_bytes(content)
    try:
        loaded = AnatomicalLimits.load(folder / "limits.npz")
    except BadInput:
        return
    assert loaded.sha256 == simple_limits().sha256


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x05\x06" + bytes(18), b"\x93NUMPY"])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "other.npz").write_bytes(content)
    with pytest.raises(BadInput, match=r"other\.npz"):
        AnatomicalLimits.load(tmp_path / "other.npz")


def test_arrays_of_something_else_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "single.npy", np.zeros(3))
    np.savez(tmp_path / "other.npz", poses=np.zeros((2, 15, 3)))
    np.savez(tmp_path / "pickled.npz", occupied=np.array([{}], dtype=object))
    for name in ("single.npy", "other.npz", "pickled.npz", "missing.npz"):
        with pytest.raises(BadInput, match=name):
            AnatomicalLimits.load(tmp_path / name)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("occupied", np.zeros(10, np.uint8), "occupied has shape"),
        ("has_plane", np.zeros((3, 1200), np.uint8), "has_plane has shape"),
        ("normal", np.zeros((7, 3)), "normal has shape"),
        ("bounds", np.array("text"), "bounds has shape"),
        ("reference", np.zeros(4), "reference has shape"),
        ("fallback", np.full((4, 3), np.nan), "not finite"),
    ],
)
def test_other_shapes_are_refused(
    tmp_path: Path, key: str, value: np.ndarray, message: str
) -> None:
    np.savez(tmp_path / "limits.npz", **(simple_limits().pack() | {key: value}))
    with pytest.raises(BadInput, match=message):
        AnatomicalLimits.load(tmp_path / "limits.npz")


@pytest.mark.parametrize(
    "key",
    ["occupied", "has_plane", "normal", "tangent", "offset", "bounds", "reference", "fallback"],
)
def test_missing_arrays_are_named(tmp_path: Path, key: str) -> None:
    np.savez(
        tmp_path / "limits.npz", **{k: v for k, v in simple_limits().pack().items() if k != key}
    )
    with pytest.raises(BadInput, match=f"lacks {key}"):
        AnatomicalLimits.load(tmp_path / "limits.npz")
