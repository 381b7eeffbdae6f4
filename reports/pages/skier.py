"""The first page's picture, of what its command wrote:

    poseterior hypotheses examples/skier.json --image examples/skier.jpg --out result
    python -m poseterior.reports.pages.skier result

It is the command's own picture, smaller. Its comment holds the shares of the hypotheses, by which a
test knows when the command draws others."""

import argparse
import json
from pathlib import Path

from PIL import Image

PICTURE = Path(__file__).resolve().parents[2] / "examples" / "skier_hypotheses.jpg"
WIDTH, QUALITY = 1400, 85
"""Pixels, and JPEG's."""


def shares_of(folder: Path) -> list[int]:
    """Shares of a result's hypotheses in percent, the heaviest first."""
    document = json.loads((folder / "hypotheses.json").read_text(encoding="utf-8"))
    return [round(100 * one["weight"]) for one in document["hypotheses"]]


def drawn_shares(picture: Path = PICTURE) -> list[int]:
    """Shares that the picture was made with."""
    with Image.open(picture) as image:
        return json.loads(image.info["comment"])


def main() -> None:
    """Makes the picture of a result's folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    with Image.open(folder / "hypotheses.png") as image:
        small = image.convert("RGB")
    small.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
    small.save(PICTURE, quality=QUALITY, comment=json.dumps(shares_of(folder)))


if __name__ == "__main__":
    main()
