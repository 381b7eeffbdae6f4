"""Makes the embedded error law, probmodel/data/errors.json (probmodel/data/PROVENANCE.md).

    python -m poseterior.inference.studies.errorlaws.embedded ../shared/data/multicamera

Spreads are those of a real film, learned as `poseterior calibrate` learns them; left and right have
the same, and the film's bias is a part of them, since another camera would show another. Shares of
inliers are published ones, exchanges are assumed.
"""

import sys
from pathlib import Path

import numpy as np

from poseterior.inference.studies.errorlaws.learn import learn
from poseterior.inference.studies.errorlaws.pairs import pairs_of_session
from poseterior.inference.studies.errorlaws.times import times_of_session
from poseterior.probmodel.errors.detector import DetectorErrors, Exchange
from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.sessions import Session, read_session
from poseterior.probmodel.skeleton import JOINTS, MIRROR

INLIERS = {
    "hip": 0.99,
    "knee": 0.94,
    "ankle": 0.93,
    "shoulder": 0.99,
    "elbow": 0.95,
    "wrist": 0.90,
    "pelvis": 0.99,
    "thorax": 0.99,
    "head": 0.95,
}
"""Chang, Moon & Lee (PoseLifter, arXiv 1910.12029), by part of the body. They have 1.00 for hips,
where 0.99 is as much as the film's 400 detections without an outlier can say, which stands for the
torso's midpoints too; and no head, which gets the elbows'."""
EXCHANGES = Exchange(legs=0.005, arms=0.005, body=0.005)
"""Assumed: the film shows none in 400 detections, which bounds each by 0.75 % (95 %)."""
FILM_RATE = 60.0
"""Frames a second of the film."""
PATH = Path(__file__).parents[3] / "probmodel" / "data" / "errors.json"


def embedded(session: Session, *, perspective: bool = False) -> DetectorErrors:
    """The law of a session, made fit for detectors that nobody has calibrated; without what
    `perspective` adds, where the focal length is known."""
    true = pairs_of_session(session, perspective=True)
    learned = learn(true if perspective else pairs_of_session(session), truth=true)
    found, mixture = learned.errors, learned.fit.mixture
    square = mixture.sigma**2 + np.sum(mixture.bias**2, axis=1) / 2
    sigma = np.sqrt((square + square[list(MIRROR)]) / 2)
    return DetectorErrors(
        Student(round(found.law.df, 1)) if isinstance(found.law, Student) else found.law,
        sigma.round(3),
        np.array([INLIERS[joint.split("_")[-1]] for joint in JOINTS]),
        np.zeros_like(found.bias),
        exchange=EXCHANGES,
        times=times_of_session(session, FILM_RATE, perspective=perspective),
        learned={
            **found.learned,
            "detector": session.people[0][0].layout,
            "truth": "triangulated by the other cameras, seen"
            + (" in perspective" if perspective else " along the line of sight"),
            "sigma": "of the film, sides together, its bias a part of it",
            "inlier": "Chang, Moon & Lee, arXiv 1910.12029",
            "exchange": "assumed",
        },
    )


if __name__ == "__main__":
    embedded(read_session(Path(sys.argv[1]))).write(PATH)
