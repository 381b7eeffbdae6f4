"""`poseterior detect`: images and a heatmap network → a file of detections that every other command
reads."""

from collections.abc import Callable
from pathlib import Path

from poseterior.inference.detector import Network
from poseterior.probmodel import BadInput, Detection, write_detections
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.layouts import LAYOUTS
from poseterior.reports import console, figures, tables
from poseterior.reports.options import Screen, parse_size
from poseterior.reports.settings import DetectSettings

Box = tuple[float, ...]


def run(settings: DetectSettings, screen: Screen) -> None:
    """Writes the detections of all images. Raises `BadInput` on a bad image, network, layout or
    box."""
    out = console.output_file(settings.out)
    if settings.layout not in LAYOUTS:
        raise BadInput(
            f"there is no layout {settings.layout!r}; choose one of {', '.join(LAYOUTS)}"
        )
    boxes_of, size = _finder(settings), settings.input_size
    network = Network.load(
        settings.model,
        LAYOUTS[settings.layout],
        size=None if size is None else parse_size(size, "--input-size", "192x256"),
        pixels=settings.pixels,
    )
    people: list[Detection] = []
    with console.progress("detecting", screen.quiet) as step:
        for number, path in enumerate(settings.images):
            people += network.detect(
                figures.read_image(path),
                boxes_of(path),
                threshold=settings.threshold,
                method=settings.method,
                source=str(path),
                image_id=path.name,
                first_person=len(people),
            )
            step(number + 1, len(settings.images))
    if not people:
        raise BadInput(
            f"{settings.boxes} has no person's box for any of the images; check its image ids"
        )
    write_detections(out, people)
    rows = [
        {"image": person.image_id, "person": person.person, "joints": int(person.seen.sum())}
        for person in people
    ]
    console.show(
        screen.json,
        {"people": rows, "layout": settings.layout, "out": str(out)},
        tables.people_table(people),
        f"Written to {out}; look at it with: poseterior show {out} --image {settings.images[0]}",
    )


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


def _finder(settings: DetectSettings) -> Callable[[Path], list[Box] | None]:
    """The boxes of an image, by its name, or by its number as COCO numbers images; None for the
    whole of it."""
    one = None if settings.box is None else [parse_box(settings.box)]
    if settings.boxes is None:
        return lambda path: one
    boxes = read_boxes(settings.boxes, settings.least_score)

    def find(path: Path) -> list[Box]:
        names = (path.name, path.stem, path.stem.lstrip("0"))
        return next((boxes[name] for name in names if name in boxes), [])

    return find


def parse_box(text: str) -> Box:
    """Four numbers from "x,y,width,height". Raises `BadInput` otherwise."""
    try:
        x, y, width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise BadInput(f"--box must be x,y,width,height in pixels, not {text!r}") from None
    return x, y, width, height
