"""A detector to run: any top-down heatmap network in an ONNX file, from an image and person boxes
to detections.

    network = Network.load("model.onnx", MPII_16)
    detections = network.detect(image, boxes)

Top-down: each person's box is cut out, brought to the network's size, and comes back as a heatmap
for each joint. The weights are the user's. onnxruntime is an extra; the network runs in a process
of its own, which is ended where it takes too long: an ONNX file is a program."""

import contextlib
import importlib.util
import os
import subprocess
import sys
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from PIL import Image

from poseterior.inference import network_process
from poseterior.probmodel.detections import LARGEST_NUMBER, Detection
from poseterior.probmodel.failures import BadInput, installing, shown
from poseterior.probmodel.files import opened
from poseterior.probmodel.heatmaps import THRESHOLD, Crop, Decoded, decode
from poseterior.probmodel.layouts import Layout

PIXELS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "imagenet": ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375)),
    "unit": ((0.0, 0.0, 0.0), (255.0, 255.0, 255.0)),
    "bytes": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
}
"""Mean and standard deviation of red, green and blue by which pixels (0 to 255) are normalised."""
PADDING = 1.25
"""The cut-out is so many times larger than the person's box, as networks of this kind are
trained."""
LARGEST_INPUT = 2048
"""Pixels; no network takes larger images than this here."""
LARGEST_CROP = 10
"""What is cut out is at most so many times larger than the image."""
MOST_PIXELS = 200_000_000
"""Of an image together with what a box takes in beyond it."""
TIME_LIMIT = 120.0
"""Seconds that a network may take to load, and again for each person."""
MEMORY_LIMIT = 16_000_000_000
"""Bytes of address space that it may use."""


class _Process:
    """A network in a process of its own. `inputs` lists name, shape and type of what it takes.

    Raises `BadInput` where the file is no network, or takes longer than `limit` seconds."""

    def __init__(self, path: Path, limit: float) -> None:
        self.name, self.limit = path.name, limit
        script = str(Path(network_process.__file__))
        self._process = subprocess.Popen(
            [sys.executable, "-P", script, str(path), str(MEMORY_LIMIT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.close = weakref.finalize(self, _end, self._process)
        answer, _ = self._answer()
        if "error" in answer:
            raise BadInput(
                f"{path} is no ONNX network that can be run ({answer['error']}); export it anew"
            )
        self.inputs = [(name, shape, kind) for name, shape, kind in answer["inputs"]]

    def run(self, pixels: np.ndarray) -> list[np.ndarray]:
        """The network's outputs for one image. Raises `BadInput` where it fails, or takes too
        long."""
        if not self.close.alive:
            raise BadInput(f"{self.name} was stopped before; load it anew")
        with contextlib.suppress(OSError):  # it ended before, which the answer tells
            network_process.send(cast(BinaryIO, self._process.stdin), {}, [pixels])
        answer, outputs = self._answer()
        if "error" in answer:
            raise BadInput(
                f"{self.name} could not be run on an image ({answer['error']}); try another"
                " size of its input"
            )
        return outputs

    def _answer(self) -> tuple[dict[str, Any], list[np.ndarray]]:
        timer = threading.Timer(self.limit, self._process.kill)
        timer.start()
        try:
            return network_process.receive(cast(BinaryIO, self._process.stdout))
        except (EOFError, OSError):
            late = not timer.is_alive()
            self.close()
            reason = (
                f"took more than {self.limit:g} seconds"
                if late
                else f"ended its process (exit status {self._process.returncode})"
            )
            raise BadInput(
                f"{self.name} {reason}, so it was stopped; give a network of a pose detector"
            ) from None
        finally:
            timer.cancel()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):  # it still held what nobody will read
            cast(BinaryIO, pipe).close()
    process.wait()


@dataclass(frozen=True)
class Network:
    """A loaded network: its `process`, its `layout`, the `size` (width, height) of what it takes,
    and its kind of `pixels`."""

    process: _Process
    layout: Layout
    name: str
    size: tuple[int, int]
    pixels: str = "imagenet"

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        layout: Layout,
        *,
        size: tuple[int, int] | None = None,
        pixels: str = "imagenet",
        time_limit: float = TIME_LIMIT,
    ) -> "Network":
        """Starts the network of an ONNX file.

        Parameters
        ----------
        path, layout
            The file, and the order of its heatmaps.
        size
            (width, height) of the images it takes, where it takes any.
        pixels
            One of `PIXELS`: how pixels are normalised.
        time_limit
            Seconds after which it is ended, while it loads and for each person.

        Raises
        ------
        BadInput
            Where onnxruntime is not installed, the file is no network, its input is not one image
            of three colours, or it takes too long.
        """
        if pixels not in PIXELS:
            raise BadInput(f"there are no pixels {pixels!r}; choose one of {', '.join(PIXELS)}")
        process = _start(Path(path), time_limit)
        shapes = [(shape, kind) for _, shape, kind in process.inputs]
        shape = shapes[0][0] if shapes else []
        if (
            len(shapes) != 1
            or len(shape) != 4
            or shape[1] not in (3, "3")
            or shapes[0][1] != "tensor(float)"
        ):
            raise BadInput(f"{path} takes {shown(shapes)}, not one image (n, 3, height, width)")
        own = tuple(side for side in (shape[3], shape[2]) if isinstance(side, int))
        if len(own) == 2 and size not in (None, own):
            raise BadInput(
                f"{path} takes images of {own[0]}x{own[1]} pixels, not of {size}; leave the"
                " size out"
            )
        chosen = own if len(own) == 2 else size
        if chosen is None or not all(1 < side <= LARGEST_INPUT for side in chosen):
            raise BadInput(
                f"{path} takes images of any size; say which it was trained on: size=(192, 256),"
                " or on the command line --input-size 192x256"
            )
        return cls(process, layout, Path(path).name, (chosen[0], chosen[1]), pixels)

    def detect(
        self,
        image: np.ndarray,
        boxes: Sequence[Sequence[float]] | None = None,
        *,
        threshold: float = THRESHOLD,
        method: str = "soft",
        source: str = "image",
        image_id: str | None = None,
        first_person: int = 0,
    ) -> list[Detection]:
        """One detection for each person's box.

        Parameters
        ----------
        image
            `(H, W, 3)` bytes.
        boxes
            x, y, width, height in pixels of each person; by default the whole image is one.
        threshold, method
            As in `heatmaps.decode`.
        source, image_id, first_person
            What the image is called, and the number of its first person.

        Raises
        ------
        BadInput
            Where a box has no size or lies far from the image, or the network's output is no
            heatmaps, or it takes too long.
        """
        return [
            found.detection
            for found in self.decode(
                image,
                boxes,
                threshold=threshold,
                method=method,
                source=source,
                image_id=image_id,
                first_person=first_person,
            )
        ]

    def decode(
        self,
        image: np.ndarray,
        boxes: Sequence[Sequence[float]] | None = None,
        *,
        threshold: float = THRESHOLD,
        method: str = "soft",
        source: str = "image",
        image_id: str | None = None,
        first_person: int = 0,
    ) -> list[Decoded]:
        """`detect`, with the alternatives of each joint."""
        height, width = image.shape[:2]
        whole = boxes is None
        people = [(0.0, 0.0, float(width), float(height))] if boxes is None else boxes
        found = []
        for person, box in enumerate(people, start=first_person):
            crop = self.crop(box, padding=1.0 if whole else PADDING)
            if not _lies_in(crop, width, height):
                raise BadInput(
                    f"the person's box {list(box)} does not fit {source}, which has"
                    f" {width}x{height} pixels; give x, y, width and height in its pixels"
                )
            heatmaps = self.heatmaps(image, crop)
            where = f"{self.name} on {source}"
            found.append(
                decode(
                    heatmaps,
                    self.layout,
                    crop,
                    threshold=threshold,
                    method=method,
                    source=where,
                    person=person,
                    image_id=image_id,
                    image_size=(width, height),
                )
            )
        return found

    def crop(self, box: Sequence[float], padding: float = PADDING) -> Crop:
        """What is cut out for a box (x, y, width, height): padded, and widened to the network's
        proportions."""
        x, y, width, height = (float(value) for value in box)
        possible = (np.abs([x, y, width, height]) <= LARGEST_NUMBER).all()  # false for NaN too
        if not (possible and width > 0 and height > 0):
            raise BadInput(
                f"a person's box must be x, y, width, height with a size, not {list(box)}"
            )
        proportion = self.size[0] / self.size[1]
        size = padding * np.array(
            [max(width, height * proportion), max(height, width / proportion)]
        )
        return Crop(np.array([x + width / 2, y + height / 2]) - size / 2 - 0.5, size)

    def heatmaps(self, image: np.ndarray, crop: Crop) -> np.ndarray:
        """`(J, H, W)`: the network's last output, on the pixels of `crop`."""
        mean, deviation = (np.array(values, np.float32) for values in PIXELS[self.pixels])
        pixels = (cut_out(image, crop, self.size).astype(np.float32) - mean) / deviation
        outputs = self.process.run(pixels.transpose(2, 0, 1)[None])
        maps = [output for output in outputs if output.ndim == 4]
        if not maps or maps[-1].shape[:2] != (1, self.layout.count):
            shapes = [output.shape for output in outputs]
            raise BadInput(
                f"{self.name} gives {shown(shapes)}, not heatmaps (1, {self.layout.count}, height,"
                f" width) of {self.layout.name}; choose the layout that it was trained on"
            )
        return np.asarray(maps[-1][0], dtype=float)


def _lies_in(crop: Crop, width: int, height: int) -> bool:
    """Whether a crop shows some of the image, and is of its order of size."""
    inside = (crop.corner < (width, height)) & (crop.corner + crop.size > 0)
    return bool(inside.all() and crop.size.max() <= LARGEST_CROP * max(width, height))


def cut_out(image: np.ndarray, crop: Crop, size: tuple[int, int]) -> np.ndarray:
    """`(height, width, 3)` bytes of `size` (width, height): the crop, black where it reaches beyond
    the image. Raises `BadInput` where it reaches too far beyond it."""
    corner = crop.corner + 0.5  # from pixels' centres to their edges
    low = np.minimum(np.floor(corner), 0).astype(int)
    high = np.maximum(np.ceil(corner + crop.size), image.shape[1::-1]).astype(int)
    if np.prod((high - low).astype(float)) > MOST_PIXELS:
        raise BadInput(
            f"a person's box begins at {shown(crop.corner.tolist())} and spans"
            f" {shown(crop.size.tolist())} pixels, but the image has {image.shape[1]}x"
            f"{image.shape[0]}; give boxes in its pixels"
        )
    inside = Image.fromarray(np.ascontiguousarray(image[..., :3], dtype=np.uint8))
    padded = inside.crop((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    start = corner - low
    box = (*start, *np.minimum(start + crop.size, padded.size))
    return np.asarray(padded.resize(size, Image.Resampling.BILINEAR, box=box))


def _start(path: Path, time_limit: float) -> _Process:
    if importlib.util.find_spec("onnxruntime") is None:
        raise BadInput(
            f"running a network needs onnxruntime, which is not installed; {installing('detect')}"
        )
    opened(path, "network", "give an ONNX file").close()
    return _Process(path, time_limit)
