"""The whole public interface under one name: the model, readers, estimators, samplers, hypotheses,
streams, distributions and studies that `probmodel` and `inference` export.

    import poseterior as pt

    person = pt.read_detections("frame_keypoints.json")[0]  # or pt.detections_of(array)
    result = pt.sample(pt.PoseModel(), person, key=0, num_samples=10_000)

Names are looked up when they are first used: the import itself costs next to nothing, and does not
bring JAX along. It switches JAX's 64-bit floats on, without which limits, which are decided to the
last bits, would be others; a JAX_ENABLE_X64 in the environment has its way."""

import os
import sys
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what `__getattr__` finds, for type checkers and editors
    from poseterior.inference import (
        ESTIMATORS,
        SAMPLERS,
        Estimating,
        Evidence,
        Footage,
        Hypothesis,
        Item,
        Machines,
        Resident,
        Result,
        RootedTarget,
        Target,
        composed,
        diverse,
        draws_of,
        estimate_torso,
        estimate_torsos,
        evidence,
        film_draws,
        film_of,
        for_arviz,
        grid_poses,
        hypotheses,
        measure_intervals,
        measures,
        open_stream,
        resident_draws,
        sample,
        sample_film,
        sample_frames,
        sample_instant,
        sample_to_file,
    )
    from poseterior.inference.studies.calibration import calibrate, cover, read_cases
    from poseterior.inference.studies.comparison import Comparison, compare
    from poseterior.inference.studies.judging import (
        Judged,
        Locally,
        Recalibration,
        judge_coverage,
        posterior_sbc,
        recalibrate,
    )
    from poseterior.probmodel import (
        AnatomicalLimits,
        Anatomy,
        BadInput,
        BoneLength,
        Candidate,
        Candidates,
        DetectedFrame,
        DetectedKeypoint,
        Detection,
        DetectorErrors,
        Disc,
        ErrorLaw,
        Estimate,
        FaultPrior,
        Gaussian,
        HingedDirection,
        Lens,
        Likelihood,
        Observation,
        OccupiedDirection,
        OutOfBudget,
        Perspective,
        PoseModel,
        Posterior,
        Root,
        RootPoint,
        Student,
        TorsoCameraPrior,
        TorsoDictionary,
        WeakPerspective,
        detections_of,
        read_detections,
        read_frames,
        read_published,
        write_detections,
    )
    from poseterior.probmodel.datasets import DataSet, read_data_set
    from poseterior.probmodel.motion import Motion, read_motion
    from poseterior.probmodel.sessions import Session, read_session

    __version__: str

_HOMES = (
    "poseterior.probmodel",
    "poseterior.probmodel.motion",
    "poseterior.probmodel.datasets",
    "poseterior.probmodel.sessions",
    "poseterior.inference",
    "poseterior.inference.studies.comparison",
    "poseterior.inference.studies.calibration",
    "poseterior.inference.studies.judging",
)
"""Where names are looked for: the first one that exports a name has it."""

__all__ = [
    "ESTIMATORS",
    "SAMPLERS",
    "AnatomicalLimits",
    "Anatomy",
    "BadInput",
    "BoneLength",
    "Candidate",
    "Candidates",
    "Comparison",
    "DataSet",
    "DetectedFrame",
    "DetectedKeypoint",
    "Detection",
    "DetectorErrors",
    "Disc",
    "ErrorLaw",
    "Estimate",
    "Estimating",
    "Evidence",
    "FaultPrior",
    "Footage",
    "Gaussian",
    "HingedDirection",
    "Hypothesis",
    "Item",
    "Judged",
    "Lens",
    "Likelihood",
    "Locally",
    "Machines",
    "Motion",
    "Observation",
    "OccupiedDirection",
    "OutOfBudget",
    "Perspective",
    "PoseModel",
    "Posterior",
    "Recalibration",
    "Resident",
    "Result",
    "Root",
    "RootPoint",
    "RootedTarget",
    "Session",
    "Student",
    "Target",
    "TorsoCameraPrior",
    "TorsoDictionary",
    "WeakPerspective",
    "__version__",
    "calibrate",
    "compare",
    "composed",
    "cover",
    "detections_of",
    "diverse",
    "draws_of",
    "estimate_torso",
    "estimate_torsos",
    "evidence",
    "film_draws",
    "film_of",
    "for_arviz",
    "grid_poses",
    "hypotheses",
    "judge_coverage",
    "measure_intervals",
    "measures",
    "open_stream",
    "posterior_sbc",
    "read_cases",
    "read_data_set",
    "read_detections",
    "read_frames",
    "read_motion",
    "read_published",
    "read_session",
    "recalibrate",
    "resident_draws",
    "sample",
    "sample_film",
    "sample_frames",
    "sample_instant",
    "sample_to_file",
    "write_detections",
]


def _switch_doubles_on() -> None:
    """Of a JAX that is here already, by its configuration; else of the one that will come."""
    if "JAX_ENABLE_X64" in os.environ:
        return
    if "jax" in sys.modules:
        import jax

        jax.config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"


_switch_doubles_on()


def __getattr__(name: str) -> Any:
    """A public name, looked up once (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'poseterior' has no attribute {name!r}")
    globals()[name] = found = _version() if name == "__version__" else _exported(name)
    return found


def _version() -> str:
    """The installed distribution's version; a checkout that is on the path alone has none."""
    try:
        return metadata.version("poseterior")
    except metadata.PackageNotFoundError:
        raise AttributeError(
            "poseterior is not installed, so it has no __version__; install it with pip"
        ) from None


def _exported(name: str) -> Any:
    home = next(home for home in map(import_module, _HOMES) if name in home.__all__)
    return getattr(home, name)


def __dir__() -> list[str]:
    return sorted(__all__)
