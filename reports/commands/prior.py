"""`poseterior prior`: poses from the prior, as netCDF."""

from poseterior.inference.prior import sample_prior
from poseterior.inference.results import save_tree
from poseterior.reports import console
from poseterior.reports.options import Screen
from poseterior.reports.settings import PriorSettings


def run(settings: PriorSettings, screen: Screen) -> None:
    """Writes prior.nc."""
    import jax

    out = console.output_file(settings.out)
    model, number = settings.prior.model(), settings.num_samples
    with console.progress("draws of the prior", screen.quiet) as step:
        key = jax.random.key(settings.seed)
        tree = sample_prior(model, key=key, num_samples=number, progress=step)
    save_tree(tree, out)
    about = {key: tree.attrs[key] for key in ("limits", "measures")}
    console.show(
        screen.json,
        {"num_samples": number, **about, "out": str(out)},
        f"{number} poses from the prior ({about['measures']}; limits {model.limits.name}).",
        f"Written to {out}",
    )
