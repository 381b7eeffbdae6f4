"""A detector to run: any top-down heatmap network in an ONNX file, from an image and person boxes
to detections.

    network = Network.load("model.onnx", MPII_16)
    detections = network.detect(image, boxes)

Top-down: each person's box is cut out, brought to the network's size, and comes back as a heatmap
for each joint. The weights are the user's. onnxruntime is an extra, imported when a network is
loaded."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from probmodel.detections import Detection
from probmodel.failures import BadInput
from probmodel.heatmaps import THRESHOLD, Crop, Decoded, decode
from probmodel.layouts import Layout

PIXELS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "imagenet": ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375)),
    "unit": ((0.0, 0.0, 0.0), (255.0, 255.0, 255.0)),
    "bytes": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
}
"""Mean and standard deviation of red, green and blue by which pixels (0 to 255) are normalised."""
PADDING = 1.25
"""The cut-out is so many times larger than the person's box, as networks of this kind are
trained."""
LARGEST_SIDE = 2048
"""Pixels; no network takes larger images than this here."""
LARGEST_CROP = 10
"""What is cut out is at most so many times larger than the image."""


@dataclass(frozen=True)
class Network:
    """A loaded network: `session`, its `layout`, its input's name and `size` (width, height), and
    its kind of `pixels`."""

    session: Any
    layout: Layout
    name: str
    input_name: str
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
    ) -> "Network":
        """Reads an ONNX file. `size` (width, height) is needed where the network takes images of
        any size.

        Raises `BadInput` where onnxruntime is not installed, the file is no network, or its input
        is not one image of three colours."""
        if pixels not in PIXELS:
            raise BadInput(f"there are no pixels {pixels!r}; choose one of {', '.join(PIXELS)}")
        session = _session(Path(path))
        inputs = session.get_inputs()
        shape = inputs[0].shape if inputs else []
        if (
            len(inputs) != 1
            or len(shape) != 4
            or shape[1] not in (3, "3")
            or inputs[0].type != "tensor(float)"
        ):
            raise BadInput(
                f"{path} takes {[(i.shape, i.type) for i in inputs]}, not one image (n, 3, height,"
                " width)"
            )
        own = tuple(side for side in (shape[3], shape[2]) if isinstance(side, int))
        if len(own) == 2 and size not in (None, own):
            raise BadInput(
                f"{path} takes images of {own[0]}x{own[1]} pixels, not of {size}; leave the"
                " size out"
            )
        chosen = own if len(own) == 2 else size
        if chosen is None or not all(1 < side <= LARGEST_SIDE for side in chosen):
            raise BadInput(
                f"{path} takes images of any size; say which it was trained on, such as"
                " --input-size 192x256"
            )
        return cls(session, layout, Path(path).name, inputs[0].name, (chosen[0], chosen[1]), pixels)

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
        """One detection for each of the `boxes` (x, y, width, height in pixels; by default the
        whole image) of an `image` `(H, W, 3)` of bytes. Raises `BadInput` on a box without a size,
        or an output that is no heatmaps."""
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
        if not (np.isfinite([x, y, width, height]).all() and width > 0 and height > 0):
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
        outputs = _run(self.session, {self.input_name: pixels.transpose(2, 0, 1)[None]}, self.name)
        maps = [output for output in outputs if isinstance(output, np.ndarray) and output.ndim == 4]
        if not maps or maps[-1].shape[:2] != (1, self.layout.count):
            shapes = [getattr(output, "shape", "?") for output in outputs]
            raise BadInput(
                f"{self.name} gives {shapes}, not heatmaps (1, {self.layout.count}, height, width)"
                f" of {self.layout.name}; choose the layout that it was trained on"
            )
        return np.asarray(maps[-1][0], dtype=float)


def _lies_in(crop: Crop, width: int, height: int) -> bool:
    """Whether a crop shows some of the image, and is of its order of size."""
    inside = (crop.corner < (width, height)) & (crop.corner + crop.size > 0)
    return bool(inside.all() and crop.size.max() <= LARGEST_CROP * max(width, height))


def cut_out(image: np.ndarray, crop: Crop, size: tuple[int, int]) -> np.ndarray:
    """`(height, width, 3)` bytes of `size` (width, height): the crop, black where it reaches beyond
    the image."""
    corner = crop.corner + 0.5  # from pixels' centres to their edges
    low = np.minimum(np.floor(corner), 0).astype(int)
    high = np.maximum(np.ceil(corner + crop.size), image.shape[1::-1]).astype(int)
    inside = Image.fromarray(np.ascontiguousarray(image[..., :3], dtype=np.uint8))
    padded = inside.crop((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    start = corner - low
    box = (*start, *np.minimum(start + crop.size, padded.size))
    return np.asarray(padded.resize(size, Image.Resampling.BILINEAR, box=box))


def _session(path: Path) -> Any:
    try:
        import onnxruntime
    except ImportError:
        raise BadInput(
            "running a network needs onnxruntime, which is not installed; install it with: "
            "pip install 'poseterior[detect]'"
        ) from None
    if not path.is_file():
        raise BadInput(f"there is no network at {path}; give an ONNX file")
    settings = onnxruntime.SessionOptions()
    settings.log_severity_level = 4  # what goes wrong is said in a sentence, below
    try:
        return onnxruntime.InferenceSession(str(path), settings, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own errors share no class but this
        raise BadInput(
            f"{path} is no ONNX network that can be run ({_words(error)}); export it anew"
        ) from None


def _run(session: Any, feed: dict[str, np.ndarray], name: str) -> list[Any]:
    try:
        outputs: list[Any] = session.run(None, feed)
        return outputs
    except Exception as error:  # see above
        raise BadInput(
            f"{name} could not be run on an image ({_words(error)}); try another --input-size"
        ) from None


def _words(error: Exception) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:200]
