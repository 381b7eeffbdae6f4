"""Does a posterior mean what it says? Calibration under the model, coverage of real poses, and the
reasons of misses.

tree = calibrate(model, "rejection", num_simulations=1000)      # simulate, draw, line up verdict =
judge(tree["simulation"].to_dataset())                # p-values, held to one false-alarm rate
arviz_plots.plot_ecdf_pit(tree)                                 # the ranks

Plain arrays first (`levels`, `uniformity`, `ece`, `choices`), poses next (`simulations`, `assess`,
`real`, `exclusions`), trees last (`record`). `controls` are posteriors that have to fail."""

from inference.studies.calibration.assess import Posterior, Standing, assess
from inference.studies.calibration.run import calibrate
from inference.studies.calibration.simulations import Instance, simulate
from inference.studies.calibration.uniformity import band, uniformity
from inference.studies.calibration.verdict import Calibration, judge

__all__ = [
    "Calibration",
    "Instance",
    "Posterior",
    "Standing",
    "assess",
    "band",
    "calibrate",
    "judge",
    "simulate",
    "uniformity",
]
