"""Does a posterior mean what it says? Calibration under the model, coverage of real poses, and the
reasons of misses.

    tree = calibrate(model, "rejection", num_simulations=1000)   # simulate, draw, line up
    verdict = judge(tree["simulation"].to_dataset())             # p-values, one false-alarm rate
    arviz_plots.plot_ecdf_pit(tree)                              # the ranks

    cases, source = read_cases(Path("recordings.npz"), frames=100)
    covered = summary(cover(model, cases, estimator="zhou", source=source))

Plain arrays first (`levels`, `uniformity`, `ece`, `choices`), poses next (`simulations`, `assess`,
`real`, `exclusions`), trees last (`record`). `controls` are posteriors that have to fail."""

from poseterior.inference.studies.calibration.assess import Answer, Standing, assess
from poseterior.inference.studies.calibration.coverage import measure_scores, summary
from poseterior.inference.studies.calibration.real import read_cases
from poseterior.inference.studies.calibration.run import calibrate, cover
from poseterior.inference.studies.calibration.simulations import Instance, simulate
from poseterior.inference.studies.calibration.uniformity import band, uniformity
from poseterior.inference.studies.calibration.verdict import Calibration, judge

__all__ = [
    "Answer",
    "Calibration",
    "Instance",
    "Standing",
    "assess",
    "band",
    "calibrate",
    "cover",
    "judge",
    "measure_scores",
    "read_cases",
    "simulate",
    "summary",
    "uniformity",
]
