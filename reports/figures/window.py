"""The part of an image that is shown of a posterior, the same in pictures and on pages that
turn."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from poseterior.probmodel.failures import BadInput
from poseterior.reports.tables.posterior import heaviest, values

WINDOW_DRAWS = 150
"""Draws shown in the background of a panel; more of them make a grey block."""


class Window(NamedTuple):
    """The part of the image that is shown: corners `(2,)`, pixels."""

    low: np.ndarray
    high: np.ndarray


def window_of(tree: xr.DataTree, image: np.ndarray | None) -> Window:
    """What there is to see: discs, seen joints, nearly all draws; of an image only what lies around
    that. Raises `BadInput` where the image is not one, or shows none of the detected joints."""
    keypoints = values(tree, "observed_data", "keypoints")
    radius = np.nan_to_num(values(tree, "constant_data", "radius")[heaviest(tree)])[:, None]
    seen = np.isfinite(keypoints).all(axis=1)
    points = np.concatenate([(keypoints - radius)[seen], (keypoints + radius)[seen]])
    projected = values(tree, "posterior", "keypoints")[:WINDOW_DRAWS].reshape(-1, 2)
    if len(projected):
        points = np.concatenate([points, np.quantile(projected, [0.01, 0.99], axis=0)])
    low = points.min(axis=0)
    high = points.max(axis=0)
    margin = 0.08 * (high - low).max()
    low = low - margin
    high = high + margin
    if image is not None:
        size = _image_size(image)
        if not ((keypoints[seen] >= 0) & (keypoints[seen] <= size)).all(axis=1).any():
            raise BadInput(
                f"the image is {size[0]} x {size[1]} pixels and none of the detected joints lies in"
                " it; give the image from which the detection was made."
            )
        low = np.maximum(low, np.minimum(0, points.min(axis=0)))
        high = np.minimum(high, np.maximum(size, points.max(axis=0)))
    # A panel of reasonable shape, whatever the pose: at least half as wide as high and as high as
    # wide.
    middle = (low + high) / 2
    half = (high - low) / 2
    half = np.maximum(half, half[::-1] * np.array([0.55, 0.75]))
    return Window(middle - half, middle + half)


class Part(NamedTuple):
    """A part of an image: its `pixels` `(h, w, 3)`, and where in the whole one its upper left and
    lower right `corners` `(2, 2)` lie."""

    pixels: np.ndarray
    corners: np.ndarray


def cropped(image: np.ndarray, window: Window) -> Part:
    """What of an image `(H, W, 3)` lies in the window."""
    size = _image_size(image)
    low = np.clip(np.floor(window.low), 0, np.array(size) - 1).astype(int)
    high = np.clip(np.ceil(window.high) + 1, low + 1, size).astype(int)
    pixels = image[low[1] : high[1], low[0] : high[0]]
    return Part(pixels, low + corners_of(pixels))


def corners_of(image: np.ndarray) -> np.ndarray:
    """The corners of an image in its own pixels: the centre of a pixel has whole coordinates."""
    return np.array([[0, 0], _image_size(image)]) - 0.5


def _image_size(image: np.ndarray) -> tuple[int, int]:
    if image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise BadInput(f"an image is an array of shape (height, width, 3), not {image.shape}.")
    return image.shape[1], image.shape[0]
