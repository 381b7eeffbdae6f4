"""The command line: wires only. Each command has a file in `reports.commands`, imported when it is
called."""

from pathlib import Path
from typing import Annotated

import typer

from reports import console, options
from reports.options import Belief, Known, LowerMeasure, Sight, UpperMeasure

app = typer.Typer(
    name="poseterior",
    help="Exact posteriors over human 3D pose given 2D joint detections.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
_BUDGET = 1_000_000_000


def main() -> None:
    """The `poseterior` command."""
    console.guarded(app)


def _examples(*lines: str) -> str:
    return "Examples:\n\n" + "\n\n".join(f"  {line}" for line in lines)


@app.command(epilog=_examples("poseterior demo", "poseterior demo --out my-demo --seed 1"))
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo"),
    seed: options.Seed = 0,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Run the embedded example, end to end: one pose, one wrist missing, the truth drawn beside the
    hypotheses."""
    options.prepare_jax()
    from reports.commands import demo as command

    command.run(out, seed, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior hypotheses frame_keypoints.json --out result",
        "poseterior hypotheses people.json --person 3 --image photo.jpg --k 8",
        "poseterior hypotheses frame.json --limits limits.npz --candidates 1",
        "poseterior hypotheses frame.json --estimator zhou",
    )
)
def hypotheses(
    file: options.File,
    out: Annotated[
        Path, typer.Option(help="Folder for posterior.nc, hypotheses.json, hypotheses.png.")
    ] = Path("out"),
    k: Annotated[int, typer.Option(help="How many diverse hypotheses.")] = 5,
    num_samples: options.NumSamples = 10_000,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    estimator: options.Estimator = "dictionary",
    poses: options.Poses = "default",
    format: options.Format = "auto",
    person: options.Person = 0,
    image: options.Image = None,
    image_size: options.ImageSize = None,
    names: options.Names = None,
    correct: options.Correct = False,
    candidates: options.Candidates = 2,
    factor: options.Factor = 0.25,
    threshold: options.Threshold = None,
    head: options.Head = True,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    max_proposals: options.MaxProposals = _BUDGET,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Exact posterior draws and diverse hypotheses for one detected person: a picture, a table, two
    files."""
    options.prepare_jax()
    from reports.commands import hypotheses as command

    known = Known(image_size, names, correct, image)
    sight = Sight(
        file, format, person, estimator, candidates, factor, threshold, head, poses, known
    )
    request = command.Request(out, k, num_samples, seed, max_proposals, image)
    command.run(sight, Belief(limits, upper, lower), request, truth=None, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior sample frame.json --out posterior.nc --num-samples 100000",
        "poseterior sample frame.json --sampler rejection-group --num-samples 100",
    )
)
def sample(
    file: options.File,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("posterior.nc"),
    sampler: Annotated[
        str, typer.Option(help="rejection, rejection-group or rejection-prior.")
    ] = "rejection",
    num_samples: options.NumSamples = 10_000,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    estimator: options.Estimator = "dictionary",
    poses: options.Poses = "default",
    format: options.Format = "auto",
    person: options.Person = 0,
    image_size: options.ImageSize = None,
    names: options.Names = None,
    correct: options.Correct = False,
    candidates: options.Candidates = 2,
    factor: options.Factor = 0.25,
    threshold: options.Threshold = None,
    head: options.Head = True,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    max_proposals: options.MaxProposals = _BUDGET,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Posterior draws of one detected person, as netCDF."""
    options.prepare_jax()
    from reports.commands import sample as command

    known = Known(image_size, names, correct)
    sight = Sight(
        file, format, person, estimator, candidates, factor, threshold, head, poses, known
    )
    belief = Belief(limits, upper, lower)
    command.run(
        sight, belief, sampler, out, num_samples, seed, max_proposals, quiet=quiet, as_json=json
    )


@app.command(
    epilog=_examples(
        "poseterior frames walk/ --out walk-posterior",
        "poseterior frames video.json --out result --num-samples 1000 --keep 100",
    )
)
def frames(
    path: Annotated[
        Path,
        typer.Argument(
            help="A folder of detections, or one file of many frames.", show_default=False
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for the stream; a run that was stopped goes on there.")
    ] = Path("out"),
    k: Annotated[int, typer.Option(help="How many diverse hypotheses for each person.")] = 5,
    num_samples: options.NumSamples = 10_000,
    keep: Annotated[
        int | None, typer.Option(help="How many draws of each are written.", show_default="all")
    ] = None,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    estimator: options.Estimator = "dictionary",
    poses: options.Poses = "default",
    format: options.Format = "auto",
    image_size: options.ImageSize = None,
    names: options.Names = None,
    correct: options.Correct = False,
    candidates: options.Candidates = 2,
    factor: options.Factor = 0.25,
    threshold: options.Threshold = None,
    head: options.Head = True,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    max_proposals: options.MaxProposals = _BUDGET,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Exact draws and hypotheses of everyone in many frames, written as they come; goes on where it
    was stopped."""
    options.prepare_jax()
    from inference.machines import Machines
    from reports.commands import frames as command

    known = Known(image_size, names, correct)
    sight = Sight(path, format, 0, estimator, candidates, factor, threshold, head, poses, known)
    request = command.Request(
        out, k, num_samples, keep, seed, max_proposals, Machines(workers, scheduler)
    )
    command.run(sight, Belief(limits, upper, lower), request, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior show frame_keypoints.json --out overlay.png",
        "poseterior show landmarks.json --image photo.jpg --person 1",
        "poseterior show video.csv --names names.json",
    )
)
def show(
    file: options.File,
    out: Annotated[Path, typer.Option(help="The picture: .png, .pdf or .svg.")] = Path(
        "overlay.png"
    ),
    limits: options.Limits = "default",
    format: options.Format = "auto",
    person: options.Person = 0,
    image: options.Image = None,
    image_size: options.ImageSize = None,
    names: options.Names = None,
    correct: options.Correct = False,
    factor: options.Factor = 0.25,
    threshold: options.Threshold = None,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Draw how a file was read, joint by joint, and warn where another reading explains its people
    better."""
    options.prepare_jax()
    from reports.commands import show as command

    known = Known(image_size, names, correct, image)
    sight = Sight(file, format, person, factor=factor, threshold=threshold, known=known)
    command.run(sight, Belief(limits), out, image, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior detect photo.jpg --model hourglass.onnx --layout mpii_16",
        "poseterior detect *.jpg --model rtmpose.onnx --layout coco_17 --boxes people.json --out"
        " found.json",
        "poseterior detect photo.jpg --model net.onnx --layout coco_17 --box 280,44,218,346",
    )
)
def detect(
    images: Annotated[list[Path], typer.Argument(help="Images: PNG, JPEG, ….", show_default=False)],
    model: Annotated[
        Path, typer.Option(help="A top-down heatmap network, ONNX.", show_default=False)
    ],
    layout: Annotated[
        str, typer.Option(help="Its joints: mpii_16, coco_17, halpe_26, ….", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("detections.json"),
    box: Annotated[
        str | None, typer.Option(metavar="X,Y,WIDTH,HEIGHT", help="The person; else the image.")
    ] = None,
    boxes: Annotated[
        Path | None, typer.Option(help="COCO detection results: the people of all images.")
    ] = None,
    least_score: Annotated[
        float, typer.Option(help="Boxes with a lower score are left out.")
    ] = 0.5,
    input_size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Where the network has none.")
    ] = None,
    pixels: Annotated[
        str, typer.Option(help="How pixels are normalised: imagenet, unit or bytes.")
    ] = "imagenet",
    method: Annotated[
        str, typer.Option(help="Where a joint is in its heatmap: soft or quarter.")
    ] = "soft",
    threshold: Annotated[
        float, typer.Option(help="Joints whose heatmap's mean is up to this are missing.")
    ] = 0.002,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Find people's joints in images with a heatmap network of one's own, through onnxruntime."""
    from reports.commands import detect as command

    size = None if input_size is None else command.parse_size(input_size)
    one = None if box is None else command.parse_box(box)
    request = command.Request(
        model, layout, size, pixels, method, threshold, one, boxes, least_score
    )
    command.run(images, request, out, quiet=quiet, as_json=json)


@app.command(epilog=_examples("poseterior prior --num-samples 1000 --out prior.nc"))
def prior(
    num_samples: options.NumSamples = 10_000,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("prior.nc"),
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Poses from the prior: what anatomy allows before anything was seen."""
    options.prepare_jax()
    from reports.commands import prior as command

    command.run(Belief(limits, upper, lower), out, num_samples, seed, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior check posterior.nc", "poseterior check 01_01.amc --limits limits.npz"
    )
)
def check(
    file: Annotated[
        Path,
        typer.Argument(help="3D poses: .nc, .json, .amc, .bvh, .npy, .npz.", show_default=False),
    ],
    limits: options.Limits = "default",
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Say which bones of 3D poses break which limit, and by how many degrees."""
    options.prepare_jax()
    from reports.commands import check as command

    command.run(file, Belief(limits), quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior compare frame.json --samplers rejection,emcee,random-walk --out comparison",
        "poseterior compare frame.json --samplers smc,nss --seconds 120",
    )
)
def compare(
    file: options.File,
    samplers: Annotated[
        str, typer.Option(help="Names with commas between them; a wrong one lists them all.")
    ] = "rejection,emcee,aies,random-walk",
    out: Annotated[
        Path, typer.Option(help="Folder for comparison.nc, comparison.png and the runs.")
    ] = Path("comparison"),
    seconds: Annotated[
        float, typer.Option(help="Seconds for each baseline, from each of its two starts.")
    ] = 30.0,
    max_evaluations: Annotated[
        int | None,
        typer.Option(
            min=1, help="Most evaluations of the density for each of them.", show_default="no limit"
        ),
    ] = None,
    num_samples: Annotated[
        int, typer.Option(min=100, help="Draws of exact rejection as a contestant.")
    ] = 10_000,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    estimator: options.Estimator = "dictionary",
    format: options.Format = "auto",
    person: options.Person = 0,
    candidates: options.Candidates = 2,
    factor: options.Factor = 0.25,
    threshold: options.Threshold = None,
    head: options.Head = True,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Judge samplers by exact draws: which of them would have misled you on this detection?"""
    options.prepare_jax()
    from reports.commands import compare as command

    sight = Sight(file, format, person, estimator, candidates, factor, threshold, head)
    names = tuple(name.strip() for name in samplers.split(",") if name.strip())
    request = command.Request(names, out, seconds, max_evaluations, num_samples, seed)
    command.run(sight, Belief(limits, upper, lower), request, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior evaluate actions_train.npz --frames 500 --missing 0,1,2 --rotate 0,30,60"
        " --workers 2",
        "poseterior evaluate h36m/ --detections gt --frames 26385 --scheduler tcp://host:8786",
        "poseterior evaluate mocap/ --noise gaussian:0.02 --limits limits.npz --poses poses.npz"
        " --predictions chen.npz",
    )
)
def evaluate(
    dataset: Annotated[
        Path,
        typer.Argument(
            help="Motion capture, VideoPose3D's Human3.6M, or a plain .npz with truth.",
            show_default=False,
        ),
    ],
    estimator: Annotated[
        str, typer.Option(help="Names with commas: akhter-black, zhou, dictionary.")
    ] = "akhter-black,zhou,dictionary",
    missing: Annotated[
        str, typer.Option(help="Numbers of limb joints made missing, at random.")
    ] = "0",
    rotate: Annotated[str, typer.Option(help="Degrees by which the image is turned.")] = "0",
    k: Annotated[
        str, typer.Option(help="Numbers of hypotheses of which the best counts.")
    ] = "5,20",
    out: Annotated[
        Path, typer.Option(help="Folder for the results; a run that was stopped goes on there.")
    ] = Path("evaluation"),
    frames: Annotated[
        int | None,
        typer.Option(help="How many frames, as many of each action.", show_default="all"),
    ] = None,
    noise: Annotated[
        str,
        typer.Option(
            help="Of synthetic cameras: none, gaussian:SIZE, heavy-tailed:SIZE (of body height)."
        ),
    ] = "none",
    detections: Annotated[
        str, typer.Option(help="Human3.6M's 2D file, data_2d_h36m_NAME.npz.")
    ] = "gt",
    predictions: Annotated[
        list[Path] | None,
        typer.Option(help="Poses of another method, a row of Table 1; may be given again."),
    ] = None,
    num_samples: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="How many poses to draw for a frame.")
    ] = 1000,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    poses: options.Poses = "default",
    candidates: options.Candidates = 1,
    factor: options.Factor = 0.25,
    head: options.Head = True,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    bias: Annotated[
        bool, typer.Option(help="Whether the bias of its motion capture is studied too.")
    ] = True,
    max_proposals: options.MaxProposals = 20_000_000,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """The paper's evaluation on a data set whose truth is known: tables, curves, which of its
    relations hold."""
    options.prepare_jax()
    from reports.commands import evaluate as command

    source = command.Source(dataset, frames, noise, detections)
    request = command.Request(
        out,
        estimator,
        missing,
        rotate,
        k,
        num_samples,
        candidates,
        factor,
        head,
        poses,
        max_proposals,
        tuple(predictions or ()),
        bias,
        workers,
        scheduler,
        seed,
    )
    command.run(source, Belief(limits, upper, lower), request, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior coverage --sampler rejection --num-simulations 1000 --out coverage",
        "poseterior coverage --simulate-only --num-simulations 200, then --sampler draws.npz"
        " --num-simulations 200",
        "poseterior coverage --poses recordings.npz --estimator zhou --noise gaussian:0.02"
        " --missing 1 --out real",
    )
)
def coverage(
    sampler: Annotated[
        str, typer.Option(help="A name, or a file: `joints` (simulations, draws, 15, 3).")
    ] = "rejection",
    num_simulations: Annotated[
        int, typer.Option(help="Poses of the prior, each seen once.")
    ] = 1000,
    out: Annotated[
        Path, typer.Option(help="Folder for coverage.nc and coverage.png; a run goes on there.")
    ] = Path("coverage"),
    num_samples: options.NumSamples = 1000,
    simulate_only: Annotated[
        bool,
        typer.Option(
            "--simulate-only", help="Write simulations.nc, for samplers that run elsewhere."
        ),
    ] = False,
    poses: Annotated[
        Path | None,
        typer.Option(help="Real poses instead: motion capture, Human3.6M or a plain .npz."),
    ] = None,
    frames: Annotated[int, typer.Option(help="How many of the real poses.")] = 100,
    estimator: Annotated[
        str,
        typer.Option(
            help="Torso and camera of real poses: true, dictionary, akhter-black or zhou."
        ),
    ] = "true",
    noise: Annotated[
        str,
        typer.Option(
            help="2D errors of real poses: likelihood, none, gaussian:0.02 or heavy-tailed:0.02."
        ),
    ] = "likelihood",
    missing: Annotated[
        int, typer.Option(min=0, help="Limb joints of real poses that are not seen.")
    ] = 0,
    seed: options.Seed = 0,
    limits: options.Limits = "default",
    factor: options.Factor = 0.25,
    upper: options.Upper = UpperMeasure.angle,
    lower: options.Lower = LowerMeasure.area,
    max_proposals: Annotated[
        int,
        typer.Option(
            min=1, help="Most proposals (or evaluations) for each pose before it counts as failed."
        ),
    ] = 3_000_000,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Test whether a sampler's posterior means what it says, under the model or on real poses, and
    why it misses."""
    options.prepare_jax()
    from inference.machines import Machines
    from reports.commands import coverage as command

    belief = Belief(limits, upper, lower)
    request = command.Request(
        sampler, num_samples, seed, out, factor, max_proposals, Machines(workers, scheduler)
    )
    if poses is not None:
        real = command.Real(poses, frames, noise, missing, estimator)
        command.real(belief, request, real, quiet=quiet, as_json=json)
    elif simulate_only:
        command.write_simulations(belief, request, num_simulations, quiet=quiet, as_json=json)
    else:
        command.simulated(belief, request, num_simulations, quiet=quiet, as_json=json)


@app.command(
    epilog=_examples(
        "poseterior learn cmu/01 cmu/02 walk.bvh --out limits.npz",
        "poseterior learn cmu/01 cmu/02 --out limits.npz --poses poses.npz",
    )
)
def learn(
    mocap: Annotated[
        list[Path],
        typer.Argument(help="Motion capture: ASF/AMC folder, .bvh, .npz.", show_default=False),
    ],
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("limits.npz"),
    poses: Annotated[
        Path | None, typer.Option(help="File for pose dictionaries, of which estimators build.")
    ] = None,
    mirror: Annotated[
        bool, typer.Option(help="Whether what one side did is possible for the other.")
    ] = True,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> None:
    """Learn limits, bone lengths and torsos, and if asked for pose dictionaries, from motion
    capture."""
    options.prepare_jax()
    from reports.commands import learn as command

    command.run(mocap, out, poses, mirror=mirror, quiet=quiet, as_json=json)
