"""Figures and images as files."""

import logging
import math
import os
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import ExifTags, Image, ImageOps

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import opened, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What Pillow finds in a damaged image stands in our own sentence; without a handler of the user's,
# Python would print it beside that.
logging.getLogger("PIL").addHandler(logging.NullHandler())
PNG_LEVEL = 3
"""Of a PNG's compression: a fourteenth larger than by the usual 6, in a third of the time."""
FORMATS = ("PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP")
"""Of images that are read; Pillow knows many more, some of which start other programs."""
PLUGINS = {"WEBP": "WebP"}
"""Of Pillow, where their names are spelled otherwise."""
MAX_PIXELS = 60_000_000
"""Images above this are refused before they are decoded: a small file can claim any size."""
FILM_DIAGONAL = math.hypot(36.0, 24.0)
"""Millimetres."""


def save_figure(figure: "Figure", path: str | os.PathLike) -> None:
    """Writes PNG, PDF or SVG, by the name's ending, whole or not at all.

    Raises
    ------
    BadInput
        Where it cannot be written there.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("png", "pdf", "svg"):
        raise BadInput(
            f"cannot write a figure to {path}; give it a name that ends in .png, .pdf or .svg."
        )
    with replacing(path) as partial:
        options: dict[str, Any] = {}
        if kind == "png":
            options["pil_kwargs"] = {"compress_level": PNG_LEVEL}
        figure.savefig(partial, format=kind, **options)


def read_image(path: str | os.PathLike) -> np.ndarray:
    """An image file as `(H, W, 3)` bytes, turned the way its camera was held.

    Raises
    ------
    BadInput
        Where there is no file, it is no image of `FORMATS`, is damaged, or has more than
        `MAX_PIXELS` pixels.
    """
    return _of_image(path, lambda image: np.asarray(ImageOps.exif_transpose(image).convert("RGB")))


def photo_focal(path: str | os.PathLike) -> float | None:
    """The focal length, pixels, that a photo's EXIF says, None where it says none: that of film of
    35 mm, whose frames measure `FILM_DIAGONAL`, with the same angle of view along the diagonal
    (CIPA DCG-001). Raises `BadInput` as `read_image` does."""
    return _of_image(path, _said_focal)


def _said_focal(image: Image.Image) -> float | None:
    said = image.getexif().get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
    if not isinstance(said, int) or said <= 0:  # 0 where it is not known
        return None
    return said * math.hypot(*image.size) / FILM_DIAGONAL


def _of_image[Value](path: str | os.PathLike, asked: Callable[[Image.Image], Value]) -> Value:
    """What an image file is asked."""
    # Loaded one by one: else Pillow loads all plugins that it has where one of these is missing.
    for name in FORMATS:
        import_module(f"PIL.{PLUGINS.get(name, name.title())}ImagePlugin")
    too_large = (
        f"{path} has more than {MAX_PIXELS // 1_000_000} million pixels; give a smaller image."
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with (
                opened(path, "image", "check its name.") as file,
                Image.open(file, formats=FORMATS) as image,
            ):
                if image.width * image.height > MAX_PIXELS:
                    raise BadInput(too_large)
                return asked(image)
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        raise BadInput(too_large) from None
    except BadInput:
        raise
    except Exception as error:  # Pillow meets damaged files with errors of many kinds.
        raise BadInput(
            f"{path} is no image that can be read ({type(error).__name__}); give a PNG or JPEG"
            " (BMP, GIF, TIFF and WebP are read, too)."
        ) from None
