"""`poseterior frames`: draws and hypotheses of everyone in many frames, a stream that is resumed
where it was stopped."""

import functools
from pathlib import Path
from typing import NamedTuple

from inference.machines import HERE, Machines
from inference.roots import estimate_torso
from inference.stream import estimated, open_stream, sample_frames
from probmodel import BadInput
from reports import console, tables
from reports.options import Belief, Sight


class Request(NamedTuple):
    """What is asked for, where it goes, and who does it."""

    out: Path
    k: int
    num_samples: int
    keep: int | None
    seed: int
    max_proposals: int
    machines: Machines = HERE


def run(sight: Sight, belief: Belief, request: Request, *, quiet: bool, as_json: bool) -> None:
    """Writes the stream. Raises `BadInput` on a bad file, or where the folder holds another run;
    frames that cannot be estimated are counted, and their reasons written."""
    import jax

    console.output_folder(request.out)
    with console.progress("limits and torsos", quiet):
        model = belief.model()
    settings = sight.settings(model)
    # Read twice: what cannot be read is better found now than after hours, and then the number of
    # people is known.
    read = functools.partial(sight.known.frames, sight.file, sight.format, sight.threshold)
    people = sum(len(frame.people) for frame in read())
    if not people:
        raise BadInput(
            f"{sight.file} has no person in it; choose one in which the detector found some"
        )
    items = estimated(
        read(), lambda detection: estimate_torso(detection, sight.estimator, **settings)
    )
    with console.progress("people", quiet) as step:
        sample_frames(
            model,
            items,
            key=jax.random.key(request.seed),
            out=request.out,
            num_samples=request.num_samples,
            k=request.k,
            keep=request.keep,
            max_proposals=request.max_proposals,
            machines=request.machines,
            progress=lambda done: step(done, people),
        )
    summary = open_stream(request.out)["summary"].to_dataset()
    if as_json:
        console.show_json(tables.stream_json(summary) | {"out": str(request.out)})
        return
    console.OUT.print(tables.stream_table(summary))
    for line in tables.stream_lines(summary):
        console.say(line)
    console.say(f"Written to {request.out}: open it with inference.open_stream")
