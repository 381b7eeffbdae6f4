"""How detections err: the laws of a keypoint's error, a detector's own spreads and biases, outliers
and exchanged sides, and the likelihood that all of them make."""

LAW_NAMES = ("disc", "gaussian", "student")
"""The error laws of `laws.LAWS`, by name: `--help` lists them without waiting for JAX."""
