"""What people measure of a pose: joint angles, lengths, steps, each with its convention, unit and
source.

    measure_of("right_knee_flexion").of(joints)                          # degrees
    measure_of("angle(right_hip, right_knee, right_ankle)").of(joints)

`MEASURES` is the registry of those with a name; `measure_of` also understands expressions over any
joints. Joints are `(..., 15, 3)` in camera axes, their lengths in any unit."""

from poseterior.probmodel.measures.catalogue import MEASURES, PLAIN, USUAL
from poseterior.probmodel.measures.expressions import ALONG_SIGHT, FUNCTIONS, measure_of
from poseterior.probmodel.measures.measure import Measure, turned, wrapped

__all__ = [
    "ALONG_SIGHT",
    "FUNCTIONS",
    "MEASURES",
    "PLAIN",
    "USUAL",
    "Measure",
    "measure_of",
    "turned",
    "wrapped",
]
