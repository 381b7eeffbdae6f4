"""Estimators: a detection → torso and camera candidates. One file each; `ESTIMATORS` names them.

The usual way in: `estimate_torso(detection)`.
"""

from collections.abc import Callable, Sequence

import numpy as np

from inference.candidates import Candidate, Frame
from inference.estimators.dictionary import fit_dictionary
from probmodel.anatomy import Anatomy
from probmodel.detections import LIKELIHOOD_JOINTS, Detection
from probmodel.failures import BadInput

Estimator = Callable[[Detection, np.ndarray], tuple[Candidate, ...]]
ESTIMATORS: dict[str, Estimator] = {"dictionary": fit_dictionary}


def estimate_torso(
    detection: Detection,
    method: str = "dictionary",
    *,
    torsos: np.ndarray | None = None,
    num_candidates: int = 2,
    factor: float = 0.25,
    joints: Sequence[int] = LIKELIHOOD_JOINTS,
) -> Frame:
    """Estimates torso and camera of one person.

    `torsos` `(J, 6, 3)` is the dictionary (default: the embedded one). `num_candidates` is the most that are kept, best
    reprojection first; 1 is the paper's method. `factor` and `joints` shape the likelihood's discs (`Frame`). Raises
    `BadInput` on an unknown method, and where too few torso joints were detected for a camera.
    """
    if method not in ESTIMATORS:
        raise BadInput(f"there is no estimator {method!r}; choose one of {', '.join(ESTIMATORS)}")
    if num_candidates < 1:
        raise BadInput(f"the number of candidates must be at least 1, not {num_candidates}")
    torsos = np.asarray(Anatomy.default().torsos if torsos is None else torsos, float)
    candidates = ESTIMATORS[method](detection, torsos)
    return Frame(detection, candidates[:num_candidates], factor, tuple(joints))
