"""`poseterior demo`: the main job on the embedded example, with the true pose beside the
hypotheses."""

from pathlib import Path

from probmodel.example import example
from reports.commands import hypotheses
from reports.options import Belief, Sight


def run(out: Path, seed: int, *, quiet: bool, as_json: bool) -> None:
    """Draws 10,000 poses and chooses five for the example: one pose of motion capture, one wrist
    missing."""
    made = example()
    request = hypotheses.Request(
        out, k=5, num_samples=10_000, seed=seed, max_proposals=1_000_000_000
    )
    hypotheses.run(
        Sight(made.path), Belief(), request, truth=made.joints, quiet=quiet, as_json=as_json
    )
