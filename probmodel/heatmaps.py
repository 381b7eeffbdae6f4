"""Heatmaps: where a network believes each joint to be, pixel by pixel, and the detection that
follows.

The paper starts from the heatmaps of a Stacked Hourglass: a joint lies at the maximum, its score is
the mean of its heatmap, and it was seen where that exceeds 0.002. `decode(heatmaps, layout, crop)`
does that for any layout; other maxima of a heatmap are kept beside it as alternatives. Arrays are
`(J, H, W)`; a pixel's coordinates are those of its centre."""

from typing import NamedTuple

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.layouts import Layout

THRESHOLD = 0.002
"""The mean of a heatmap up to which its joint is missing (the paper's, for Stacked Hourglass)."""
HOURGLASS_SIDE = 200.0
"""Pixels of the image in one unit of an hourglass's `scale`: the side of the box that is cut out is
200 · scale."""
WINDOW = 2.0
"""Standard deviation, heatmap pixels, of the window in which a maximum is averaged."""
ALTERNATIVE = 0.5
"""Another maximum at least so high, as a share of the highest, is kept as an alternative."""
MOST_ALTERNATIVES = 4
LARGEST_SIDE = 1024
"""Pixels; no heatmap is larger."""
_APART = 5
"""Two maxima of one heatmap are at least half of this many pixels apart."""
_ROUNDS = 30


class Crop(NamedTuple):
    """The box of the image that was given to the network: `corner` `(2,)` and `size` `(2,)`, x and
    y, pixels."""

    corner: FloatArray
    size: FloatArray

    @classmethod
    def around(cls, centre: FloatArray, scale: float) -> "Crop":
        """Stacked Hourglass's square box, from MPII's centre (pixels) and scale (of 200 pixels)."""
        side = np.full(2, HOURGLASS_SIDE * scale)
        return cls(np.asarray(centre, float) - side / 2, side)

    @classmethod
    def whole(cls, heatmaps: FloatArray) -> "Crop":
        """The heatmap itself: coordinates are its pixels."""
        return cls(np.full(2, -0.5), np.array(heatmaps.shape[:-3:-1], float))

    def image(self, xy: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Pixels of the image `(..., 2)` for pixels of a heatmap of `shape` (height, width)."""
        return self.corner + (xy + 0.5) * self.size / np.array(shape[::-1], float)


class Decoded(NamedTuple):
    """A `detection`, and by joint name the other maxima `(m, 3)` of its heatmap: x, y (image
    pixels) and a score, the joint's own × the maximum's height over the highest."""

    detection: Detection
    alternatives: dict[str, FloatArray]


def decode(
    heatmaps: FloatArray,
    layout: Layout,
    crop: Crop | None = None,
    *,
    threshold: float = THRESHOLD,
    method: str = "soft",
    source: str = "heatmaps",
    person: int = 0,
    image_id: str | None = None,
    image_size: tuple[int, int] | None = None,
) -> Decoded:
    """The detection in heatmaps, and the other maxima of each.

    Parameters
    ----------
    heatmaps
        `(J, H, W)`, in the order of `layout`.
    layout
        The network's joints.
    crop
        The box of the image that the network saw; by default coordinates are the heatmaps' pixels.
    threshold
        A joint whose heatmap has a mean up to this is missing.
    method
        "soft": the mean in a window around the maximum. "quarter": the maximum moved by a quarter
        of a pixel towards its higher neighbour.
    source, person, image_id, image_size
        As in `Detection`.

    Raises
    ------
    BadInput
        Where the array is not one of this layout's heatmaps, or not finite.
    """
    heatmaps = _checked(heatmaps, layout, source)
    shape = (heatmaps.shape[1], heatmaps.shape[2])
    crop = Crop.whole(heatmaps) if crop is None else crop
    if method not in LOCATORS:
        raise BadInput(
            f"there is no way {method!r} to find a joint in its heatmap; choose one of"
            f" {', '.join(LOCATORS)}."
        )
    locate = LOCATORS[method]
    score = np.maximum(heatmaps.mean(axis=(1, 2)), 0.0)
    maxima = [modes(heatmap) for heatmap in heatmaps]
    best = np.array(
        [locate(heatmap, tops[0]) for heatmap, tops in zip(heatmaps, maxima, strict=True)]
    )
    points = np.column_stack([crop.image(best, shape), score])
    alternatives = {
        name: np.array(
            [
                [*crop.image(locate(heatmap, top), shape), value * _height(heatmap, top, tops[0])]
                for top in tops[1:]
            ]
        )
        for name, heatmap, tops, value in zip(layout.points, heatmaps, maxima, score, strict=True)
        if len(tops) > 1 and value > threshold
    }
    detection = layout.detection(points, threshold, source, person, image_id, image_size)
    return Decoded(detection, alternatives)


def modes(heatmap: FloatArray) -> list[tuple[int, int]]:
    """Row and column of the local maxima of one heatmap `(H, W)`, highest first; the first is the
    argmax."""
    from scipy.ndimage import maximum_filter  # takes a while, and few files are heatmaps

    top = float(heatmap.max())
    peak = (heatmap == maximum_filter(heatmap, _APART, mode="constant", cval=-np.inf)) & (
        heatmap >= ALTERNATIVE * top
    )
    first = np.unravel_index(int(np.argmax(heatmap)), heatmap.shape)
    found = [(int(first[0]), int(first[1]))]
    if top > 0:
        rows, columns = np.nonzero(peak)
        order = np.argsort(-heatmap[rows, columns], kind="stable")[: 50 * MOST_ALTERNATIVES]
        for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
            if len(found) > MOST_ALTERNATIVES:
                break
            if all(
                max(abs(row - r), abs(column - c)) > _APART // 2 for r, c in found
            ):  # a plateau is one maximum
                found.append((row, column))
    return found


def quarter_argmax(heatmap: FloatArray, top: tuple[int, int]) -> FloatArray:
    """`(2,)` x, y: the maximum at row and column `top`, moved by 1/4 pixel towards the higher of
    its neighbours.

    The usual shift of Newell et al., "Stacked Hourglass Networks" (2016). Wrong by up to 1/4 pixel
    along either axis."""
    row, column = top
    padded = np.pad(heatmap, 1, mode="edge")
    across = np.sign(padded[row + 1, column + 2] - padded[row + 1, column])
    along = np.sign(padded[row + 2, column + 1] - padded[row, column + 1])
    return np.array([column + across / 4, row + along / 4])


def soft_argmax(heatmap: FloatArray, top: tuple[int, int]) -> FloatArray:
    """`(2,)` x, y: the mean of the heatmap under a Gaussian window that is centred on that very
    mean.

    Found by repeating from row and column `top`; a window that stayed at the maximum would pull
    towards the pixel's centre. Exact for a Gaussian blob of any width, as far as its pixels tell.
    """
    weight = np.maximum(heatmap, 0.0)
    centre = np.array([top[1], top[0]], float)
    if weight[top] <= 0:
        return centre
    x, y = (np.arange(size, dtype=float) for size in heatmap.shape[::-1])
    for _ in range(_ROUNDS):
        across, along = _window(x, centre[0]), _window(y, centre[1])
        total = along @ weight @ across
        centre = np.array([along @ weight @ (x * across), (y * along) @ weight @ across]) / total
    return centre


LOCATORS = {"soft": soft_argmax, "quarter": quarter_argmax}
"""Where in its heatmap a joint is, by name."""


def _window(pixel: FloatArray, centre: float) -> FloatArray:
    """Weights of the pixels along one axis; at the border only as far as there is as much on the
    other side."""
    reach = max(0.5, min(centre + 0.5, pixel[-1] + 0.5 - centre))
    return np.exp(-(((pixel - centre) / WINDOW) ** 2) / 2) * (np.abs(pixel - centre) <= reach)


def _height(heatmap: FloatArray, top: tuple[int, int], highest: tuple[int, int]) -> float:
    return float(heatmap[top] / heatmap[highest])


def _checked(heatmaps: FloatArray, layout: Layout, source: str) -> FloatArray:
    if (
        heatmaps.ndim != 3
        or heatmaps.shape[0] != layout.count
        or not all(1 < n <= LARGEST_SIDE for n in heatmaps.shape[1:])
    ):
        raise BadInput(
            f"{source} has heatmaps of shape {heatmaps.shape}, but {layout.name} needs"
            f" ({layout.count}, height, width) with sides from 2 to {LARGEST_SIDE} pixels."
        )
    heatmaps = np.asarray(heatmaps, dtype=float)
    if not np.isfinite(heatmaps).all():
        raise BadInput(
            f"{source} has heatmaps with numbers that are not finite; run the network again."
        )
    return heatmaps
