"""glTF: stick figures for viewers and game engines; hypotheses and draws are ghosts beside each
other in one place, a film is an animation. Written by the package `pygltflib`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.failures import BadInput, installing
from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS, PARENTS
from poseterior.reports.exports.clip import Clip

MOST_GHOSTS = 1000
"""Poses in one place; each is some thirty nodes."""
JOINT_SIZE, BONE_SIZE = 0.022, 0.012
"""Metres from the middle of a joint to its corners, and half the width of a bone."""
LEFT, RIGHT, MIDDLE = (0.10, 0.35, 0.75), (0.80, 0.25, 0.15), (0.35, 0.35, 0.38)
"""Colours of the two sides and of the trunk."""
_OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
_OCTAHEDRON_FACES = np.array(
    [
        [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4],
        [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
    ]
)  # fmt: skip
_PRISM = np.array([[x, y, z] for y in (0, 1) for z in (-1, 1) for x in (-1, 1)], float)
_PRISM_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
_BONES = [(PARENTS[end], end) for end in range(1, NUM_JOINTS)]


def write_gltf(clip: Clip, path: Path, unit: str) -> None:
    """A file in metres, as glTF always is: text where the name ends in .gltf, else binary. Each
    pose is a node with its joints and bones as children; heavier hypotheses are less transparent.
    Frames of a film without a pose have no key, so that the figure moves on from the last one to
    the next.

    Raises `BadInput` where the package `pygltflib` is missing, or there are too many poses."""
    try:
        import pygltflib
    except ImportError:
        raise BadInput(
            f"glTF files need the package pygltflib; {installing('export')}; or choose another --to"
        ) from None
    if not clip.film and len(clip.joints) > MOST_GHOSTS:
        raise BadInput(
            f"{len(clip.joints):,} poses in one place are too many for glTF, which takes"
            f" {MOST_GHOSTS:,}; give fewer --draws, or choose another --to"
        )
    scene = _Scene(pygltflib)
    if clip.film:
        scene.film(clip)
    else:
        scene.ghosts(clip)
    file = scene.finished()
    with replacing(path, "choose another --out") as partial:
        if path.suffix.lower() == ".gltf":
            file.convert_buffers(pygltflib.BufferFormat.DATAURI)
            partial.write_text(file.to_json(), encoding="utf-8")
        else:
            partial.write_bytes(b"".join(file.save_to_bytes()))


class _Scene:
    """A glTF file that grows; `lib` is pygltflib."""

    def __init__(self, lib: Any) -> None:
        self._lib = lib
        self._data = bytearray()
        self._file = lib.GLTF2(asset=lib.Asset(version="2.0", generator="poseterior"))
        self._roots: list[int] = []
        self._octahedron = self._shape(JOINT_SIZE * _OCTAHEDRON, _OCTAHEDRON_FACES)
        width = np.array([BONE_SIZE, 1.0, BONE_SIZE])
        self._prism = self._shape(width * _PRISM, _PRISM_FACES)

    def ghosts(self, clip: Clip) -> None:
        """Every pose of the clip, still."""
        weights = np.full(len(clip.joints), 0.3) if clip.weights is None else clip.weights
        for name, joints, weight in zip(clip.names, clip.joints, weights, strict=True):
            share = float(weight) if clip.weights is None else 0.3 + 0.7 * weight / weights.max()
            self._figure(name, joints, share)

    def film(self, clip: Clip) -> None:
        """One figure, moved through all poses of the clip."""
        there = np.flatnonzero(clip.there)
        nodes = self._figure("film", clip.joints[there[0]], 1.0)
        times = self._accessor(clip.times[there].astype(np.float32)[:, None], bounds=True)
        animation = self._lib.Animation(name="film")
        moves = list(zip(nodes, _moves(clip.joints[there]), strict=True))
        for node, paths in moves:
            for path, values in paths.items():
                sampler = self._lib.AnimationSampler(input=times, output=self._accessor(values))
                target = self._lib.AnimationChannelTarget(node=node, path=path)
                channel = self._lib.AnimationChannel(sampler=len(animation.samplers), target=target)
                animation.samplers.append(sampler)
                animation.channels.append(channel)
        self._file.animations.append(animation)

    def finished(self) -> Any:
        """The file, with its one scene and one buffer."""
        self._file.scenes = [self._lib.Scene(nodes=self._roots)]
        self._file.scene = 0
        self._file.buffers = [self._lib.Buffer(byteLength=len(self._data))]
        self._file.set_binary_blob(bytes(self._data))
        return self._file

    def _figure(self, name: str, joints: np.ndarray, alpha: float) -> list[int]:
        """A pose `(15, 3)` as a node with one child for every joint, then for every bone; their
        numbers."""
        meshes = {colour: self._meshes(colour, alpha) for colour in (LEFT, RIGHT, MIDDLE)}
        ends = [*range(NUM_JOINTS), *(end for _, end in _BONES)]
        kinds = [0] * NUM_JOINTS + [1] * len(_BONES)
        children = []
        for end, kind, paths in zip(ends, kinds, _moves(joints[None]), strict=True):
            still = {path: values[0].tolist() for path, values in paths.items()}
            label = JOINTS[end] if kind == 0 else f"{JOINTS[PARENTS[end]]} to {JOINTS[end]}"
            mesh = meshes[_colour(JOINTS[end])][kind]
            children.append(self._node(self._lib.Node(name=label, mesh=mesh, **still)))
        self._roots.append(self._node(self._lib.Node(name=name, children=children)))
        return children

    def _node(self, node: Any) -> int:
        self._file.nodes.append(node)
        return len(self._file.nodes) - 1

    def _meshes(self, colour: tuple[float, float, float], alpha: float) -> tuple[int, int]:
        """Meshes of a joint and of a bone in a colour."""
        surface = self._lib.PbrMetallicRoughness(
            baseColorFactor=[*colour, float(alpha)], metallicFactor=0.0, roughnessFactor=0.8
        )
        mode = self._lib.OPAQUE if alpha >= 1 else self._lib.BLEND
        self._file.materials.append(
            self._lib.Material(pbrMetallicRoughness=surface, alphaMode=mode)
        )
        material = len(self._file.materials) - 1
        for places, faces in (self._octahedron, self._prism):
            part = self._lib.Primitive(
                attributes=self._lib.Attributes(POSITION=places), indices=faces, material=material
            )
            self._file.meshes.append(self._lib.Mesh(primitives=[part]))
        return len(self._file.meshes) - 2, len(self._file.meshes) - 1

    def _shape(self, places: np.ndarray, faces: np.ndarray) -> tuple[int, int]:
        return (
            self._accessor(places.astype(np.float32), bounds=True, target=self._lib.ARRAY_BUFFER),
            self._accessor(
                faces.astype(np.uint16).reshape(-1, 1), target=self._lib.ELEMENT_ARRAY_BUFFER
            ),
        )

    def _accessor(
        self, values: np.ndarray, *, bounds: bool = False, target: int | None = None
    ) -> int:
        """Rows of numbers `(n, 1 | 3 | 4)`, put at the end of the buffer."""
        lib, data = self._lib, values.tobytes()
        self._data += bytes(-len(self._data) % 4)
        self._file.bufferViews.append(
            lib.BufferView(
                buffer=0, byteOffset=len(self._data), byteLength=len(data), target=target
            )
        )
        self._data += data
        accessor = lib.Accessor(
            bufferView=len(self._file.bufferViews) - 1,
            componentType=lib.FLOAT if values.dtype == np.float32 else lib.UNSIGNED_SHORT,
            count=len(values),
            type={1: lib.SCALAR, 3: lib.VEC3, 4: lib.VEC4}[values.shape[1]],
        )
        if bounds:
            accessor.min, accessor.max = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        self._file.accessors.append(accessor)
        return len(self._file.accessors) - 1


def _colour(joint: str) -> tuple[float, float, float]:
    return LEFT if joint.startswith("left") else RIGHT if joint.startswith("right") else MIDDLE


def _moves(joints: np.ndarray) -> Iterator[dict[str, np.ndarray]]:
    """For every joint, then every bone, what moves its shape to each of the poses `(n, 15, 3)`:
    translation, and for bones rotation and scale, `(n, 3 | 4)`."""
    for joint in range(NUM_JOINTS):
        yield {"translation": joints[:, joint].astype(np.float32)}
    for start, end in _BONES:
        bone = joints[:, end] - joints[:, start]
        length = np.linalg.norm(bone, axis=1, keepdims=True)
        ones = np.ones_like(length)
        yield {
            "translation": joints[:, start].astype(np.float32),
            "rotation": _from_up(bone / length).as_quat().astype(np.float32),
            "scale": np.concatenate([ones, length, ones], axis=1).astype(np.float32),
        }


def _from_up(direction: np.ndarray) -> Rotation:
    """The shortest turns from the y axis to directions `(n, 3)`."""
    x, y, z = direction.T
    sine = np.hypot(x, z)
    axis = np.stack([z, np.zeros_like(x), -x], axis=-1)
    axis = np.where(sine[:, None] > 1e-12, axis / np.maximum(sine, 1e-12)[:, None], [1.0, 0.0, 0.0])
    return Rotation.from_rotvec(np.arctan2(sine, y)[:, None] * axis)
