"""ST-GCN's Kinetics-skeleton: a clip of frames of people, OpenPose's COCO-18 in fractions.

{"data": [{"frame_index": 1, "skeleton": [{"pose": [x, y, …], "score": […]}, …]}, …],
 "label": …}"""

from collections.abc import Iterator

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import (
    Content,
    chosen_layout,
    image_name,
    mapping,
    scored_points,
    sequence,
)


def recognises(content: Content) -> bool:
    """An object whose data are frames with a skeleton."""
    document = content.first
    frames = document.get("data") if isinstance(document, dict) else None
    head = frames[0] if isinstance(frames, list) and frames else None
    return isinstance(head, dict) and "skeleton" in head


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Everyone of every frame."""
    source, person = content.source, 0
    frames = sequence(mapping(content.json, source).get("data"), f"'data' of {source}")
    for index, value in enumerate(frames):
        frame = mapping(value, f"frame {index} of {source}")
        image = image_name(frame.get("frame_index", index), f"'frame_index' of frame {index}")
        for record in sequence(frame.get("skeleton"), f"'skeleton' of frame {index} of {source}"):
            where = f"person {person} of {source}"
            fields = mapping(record, where)
            pose, score = (sequence(fields.get(key), f"'{key}' of {where}") for key in _KEYS)
            if len(pose) != 2 * len(score):
                raise BadInput(
                    f"{where} has {len(pose)} coordinates but {len(score)} scores; check what wrote"
                    " it."
                )
            layout = chosen_layout(len(score), content, where)
            flat = [n for row in zip(pose[::2], pose[1::2], score, strict=True) for n in row]
            points = scored_points(flat, layout.points, where)
            yield layout.detection(points, threshold, source, person, image)
            person += 1


_KEYS = ("pose", "score")
