"""What a detector does wrong, for synthetic cameras: nothing, Gaussian errors, or errors with heavy
tails."""

from typing import NamedTuple

import numpy as np

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import NUM_JOINTS

KINDS = ("none", "gaussian", "heavy-tailed")
HEAVY_FREEDOM = 2.0
"""Degrees of freedom of the heavy tails (Student's t): no variance; one error in 27 is beyond five
times the size."""


class Noise(NamedTuple):
    """Errors of 2D joints, independent of each other: `kind` is one of `KINDS`, `size` their scale
    in x and in y as a share of the body height: the standard deviation (Gaussian), or what
    multiplies Student's t (heavy-tailed)."""

    kind: str = "none"
    size: float = 0.0

    @classmethod
    def parse(cls, text: str) -> "Noise":
        """`none`, `gaussian:0.02` or `heavy-tailed:0.02`. Raises `BadInput` on anything else."""
        kind, _, size = text.partition(":")
        try:
            noise = cls(kind, float(size or 0))
        except ValueError:
            noise = cls(kind, -1.0)
        if kind not in KINDS or not 0 <= noise.size < 1 or (kind == "none") != (noise.size == 0):
            raise BadInput(
                f"the noise {text!r} must look like none, gaussian:0.02 or heavy-tailed:0.02 (of"
                " the height)"
            )
        return noise

    def errors(self, height: float, seed: int, number: int) -> np.ndarray:
        """`(15, 2)`, in the units of `height`, of the case `number`. Of one kind and seed, larger
        sizes are the same errors enlarged."""
        rng = np.random.default_rng([seed, 0, number])
        shape = (NUM_JOINTS, 2)
        unit = (
            rng.standard_t(HEAVY_FREEDOM, shape)
            if self.kind == "heavy-tailed"
            else rng.normal(size=shape)
        )
        return self.size * height * unit


EXACT = Noise()
"""True 2D."""
