"""`poseterior detect`: images and a heatmap network → a file of detections that every other command
reads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from inference.detector import Network
from probmodel import BadInput, Detection, write_detections
from probmodel.documents import read_json
from probmodel.layouts import LAYOUTS
from reports import console, figures

Box = tuple[float, ...]


@dataclass(frozen=True)
class Request:
    """Which network on which people: `boxes` names a COCO file of person boxes, `person_box` is one
    for all images."""

    model: Path
    layout: str
    input_size: tuple[int, int] | None
    pixels: str
    method: str
    threshold: float
    person_box: Box | None = None
    boxes: Path | None = None
    least_score: float = 0.5


def run(images: Sequence[Path], request: Request, out: Path, *, quiet: bool, as_json: bool) -> None:
    """Writes the detections of all images. Raises `BadInput` on a bad image, network, layout or
    box."""
    console.output_file(out)
    if request.layout not in LAYOUTS:
        raise BadInput(f"there is no layout {request.layout!r}; choose one of {', '.join(LAYOUTS)}")
    boxes = None if request.boxes is None else read_boxes(request.boxes, request.least_score)
    network = Network.load(
        request.model, LAYOUTS[request.layout], size=request.input_size, pixels=request.pixels
    )
    people: list[Detection] = []
    with console.progress("detecting", quiet) as step:
        for number, path in enumerate(images):
            people += network.detect(
                figures.read_image(path),
                _boxes_of(path, boxes, request),
                threshold=request.threshold,
                method=request.method,
                source=str(path),
                image_id=path.name,
                first_person=len(people),
            )
            step(number + 1, len(images))
    if not people:
        raise BadInput(
            f"{request.boxes} has no person's box for any of the images; check its image ids"
        )
    write_detections(out, people)
    if as_json:
        rows = [
            {"image": person.image_id, "person": person.person, "joints": int(person.seen.sum())}
            for person in people
        ]
        console.show_json({"people": rows, "layout": request.layout, "out": str(out)})
    else:
        console.OUT.print(_table(people))
        console.say(f"Written to {out}; look at it with: poseterior show {out} --image {images[0]}")


def read_boxes(path: Path, least_score: float) -> dict[str, list[Box]]:
    """Person boxes by image id, from a list of COCO's detection results. Raises `BadInput` where it
    is none."""
    records = read_json(path, "list of boxes", "give COCO's results with image_id and bbox")
    try:
        found: dict[str, list[Box]] = {}
        for record in records:
            if record.get("category_id", 1) == 1 and record.get("score", 1.0) >= least_score:
                x, y, width, height = (float(value) for value in record["bbox"])
                found.setdefault(str(record["image_id"]), []).append((x, y, width, height))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(
            f"{path} is no list of boxes ({type(error).__name__}); give COCO's results with"
            " image_id and bbox"
        ) from None
    return found


def _boxes_of(
    path: Path, boxes: Mapping[str, list[Box]] | None, request: Request
) -> list[Box] | None:
    """The boxes of an image, by its name, or by its number as COCO numbers images; None for the
    whole of it."""
    if boxes is None:
        return None if request.person_box is None else [request.person_box]
    names = (path.name, path.stem, path.stem.lstrip("0"))
    return next((boxes[name] for name in names if name in boxes), [])


def parse_box(text: str) -> Box:
    """Four numbers from "x,y,width,height". Raises `BadInput` otherwise."""
    try:
        x, y, width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInput(f"--box must be x,y,width,height in pixels, not {text!r}") from None
    return x, y, width, height


def parse_size(text: str) -> tuple[int, int]:
    """Two whole numbers from "192x256". Raises `BadInput` otherwise."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise BadInput(f"--input-size must look like 192x256, not {text!r}")
    return int(width), int(height)


def _table(people: Sequence[Detection]) -> Table:
    table = Table(
        "image", title="People", box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False
    )
    for heading in ("person", "joints", "highest score"):
        table.add_column(heading, justify="right")
    for person in people:
        cells: tuple[Any, ...] = (
            person.image_id,
            person.person,
            person.seen.sum(),
            f"{person.score.max():.3g}",
        )
        table.add_row(*map(str, cells))
    return table
