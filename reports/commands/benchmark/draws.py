"""`poseterior benchmark draws`: exact draws of a target."""

import numpy as np

from poseterior.probmodel.files import replacing
from poseterior.reports import console
from poseterior.reports.options import Screen
from poseterior.reports.settings import BenchmarkDrawsSettings


def run(settings: BenchmarkDrawsSettings, screen: Screen) -> None:
    """Writes draws, with the evidence of the target. Raises `BadInput` on a target that does not
    exist, or a file that cannot be written."""
    from poseterior.inference.benchmark import exact_points, load, reference, same_bits

    target = load(settings.target)
    with console.progress(f"exact draws of {target.name}", screen.quiet) as step:
        points = exact_points(target, settings.num_samples, progress=step)
    known = reference(target.name)
    evidence = {"log_evidence": known.log_evidence, "log_evidence_se": known.log_evidence_se}
    with replacing(settings.out) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, points=points, **evidence)
    same = same_bits(target)
    about = {"target": target.name, **evidence, "same_bits": same, "out": str(settings.out)}
    said = [f"{len(points):,} exact draws of {target.name} written to {settings.out}"]
    if not same:
        said.append("Their law is the reference's, their bits are not: another kind of processor")
    console.show(screen.json, about, *said)
