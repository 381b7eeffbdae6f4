"""`poseterior frames`: draws and hypotheses of everyone in many frames, a stream that is resumed
where it was stopped."""

from inference.roots import estimate_torso
from inference.stream import estimated, open_stream, sample_frames
from reports import console, tables
from reports.options import Screen
from reports.settings import FramesSettings


def run(settings: FramesSettings, screen: Screen) -> None:
    """Writes the stream. Raises `BadInput` on a bad file, or where the folder holds another run;
    frames that cannot be estimated are counted, and their reasons written."""
    import jax

    out, sampling, estimation = settings.out, settings.sampling, settings.estimation
    console.output_folder(out)
    with console.progress("limits and torsos", screen.quiet):
        model = settings.prior.model()
    known = estimation.settings(model)
    items = estimated(
        settings.detected.frames(settings.path),
        lambda detection: estimate_torso(detection, estimation.estimator, **known),
    )
    with console.progress("people", screen.quiet) as step:
        sample_frames(
            model,
            items,
            key=jax.random.key(sampling.seed),
            out=out,
            root=settings.rooting.root,
            num_roots=settings.rooting.roots,
            num_samples=sampling.num_samples,
            k=settings.k,
            keep=settings.keep,
            max_proposals=sampling.max_proposals,
            machines=settings.workforce.machines(),
            progress=lambda done: step(done, settings.people),
        )
    summary = open_stream(out)["summary"].to_dataset()
    if screen.json:
        console.show_json(tables.stream_json(summary) | {"out": str(out)})
        return
    console.OUT.print(tables.stream_table(summary))
    for line in tables.stream_lines(summary):
        console.say(line)
    console.say(f"Written to {out}: open it with poseterior.open_stream")
