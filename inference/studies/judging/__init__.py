"""Anybody's posterior, judged by draws beside truths: is it calibrated, where does it fail, and
what would make its intervals hold.

    found = judge_coverage(draws, truth, covariates={"angle": angle})
    found.sentence, found.local.sentence        # verdict with one stated error rate, and where
    recalibrate(found.level)                    # intervals with a guarantee; no posterior any more

Nothing here knows what a pose is; ranks and tests are those of `studies.calibration`. Files are
read by `files`, `posterior_sbc` judges a sampler on one data set of the user's own."""

from poseterior.inference.studies.judging.brought import Brought
from poseterior.inference.studies.judging.files import read_brought
from poseterior.inference.studies.judging.judge import Judged, judge_coverage
from poseterior.inference.studies.judging.posterior_sbc import posterior_sbc
from poseterior.inference.studies.judging.repair import Recalibration, recalibrate
from poseterior.inference.studies.judging.where import Locally, locally

__all__ = [
    "Brought",
    "Judged",
    "Locally",
    "Recalibration",
    "judge_coverage",
    "locally",
    "posterior_sbc",
    "read_brought",
    "recalibrate",
]
