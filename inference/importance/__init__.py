"""The posterior with an uncertain root: roots given the torso's detections, weighed by the evidence
of the limbs (docs/model.md § 9)."""
