"""What is believed about a pose and its detection: skeleton, anatomical limits, distributions,
camera, the model.

detections = probmodel.read_detections("frame_keypoints.json")
model = probmodel.PoseModel(limits=probmodel.AnatomicalLimits.default())
"""

from probmodel.anatomy.limits import AnatomicalLimits
from probmodel.anatomy.population import Anatomy
from probmodel.anatomy.published import read_published
from probmodel.camera import WeakPerspective
from probmodel.detections import Detection
from probmodel.failures import BadInput, OutOfBudget
from probmodel.formats import read_detections, write_detections
from probmodel.formats.frames import DetectedFrame, read_frames
from probmodel.likelihood import Disc, ErrorLaw, Likelihood
from probmodel.model import PoseModel
from probmodel.observation import Observation
from probmodel.posterior import Estimate, Posterior
from probmodel.roots import Candidate, Root, RootPoint, RootPrior
from probmodel.uncertain import UncertainPosterior

__all__ = [
    "AnatomicalLimits",
    "Anatomy",
    "BadInput",
    "Candidate",
    "DetectedFrame",
    "Detection",
    "Disc",
    "ErrorLaw",
    "Estimate",
    "Likelihood",
    "Observation",
    "OutOfBudget",
    "PoseModel",
    "Posterior",
    "Root",
    "RootPoint",
    "RootPrior",
    "UncertainPosterior",
    "WeakPerspective",
    "read_detections",
    "read_frames",
    "read_published",
    "write_detections",
]
