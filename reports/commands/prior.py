"""`poseterior prior`: poses from the prior, as netCDF."""

from pathlib import Path

from inference.prior import sample_prior
from inference.results import save_tree
from reports import console
from reports.options import Belief


def run(
    belief: Belief, out: Path, num_samples: int, seed: int, *, quiet: bool, as_json: bool
) -> None:
    """Writes prior.nc."""
    import jax

    console.output_file(out)
    model = belief.model()
    with console.progress("draws of the prior", quiet) as step:
        tree = sample_prior(model, key=jax.random.key(seed), num_samples=num_samples, progress=step)
    save_tree(tree, out)
    about = {key: tree.attrs[key] for key in ("limits", "measures")}
    found = {"num_samples": num_samples, **about, "out": str(out)}
    if as_json:
        console.show_json(found)
    else:
        console.say(
            f"{num_samples} poses from the prior ({found['measures']}; limits {model.limits.name})."
        )
        console.say(f"Written to {out}")
