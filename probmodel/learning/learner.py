"""Learning an anatomy from motion capture: limits, bone lengths and torsos.

The usual way in: `learn(read_all(paths))`."""

from collections.abc import Sequence

from poseterior.probmodel.anatomy.population import Anatomy, LengthPrior
from poseterior.probmodel.arrays import single
from poseterior.probmodel.learning.lengths import learn_lengths
from poseterior.probmodel.learning.limits import learn_limits
from poseterior.probmodel.learning.poses import Progress, gather
from poseterior.probmodel.learning.tolerance import DEFAULT, Tolerance
from poseterior.probmodel.learning.torsos import learn_torsos
from poseterior.probmodel.motion import Motion


def learn(
    motions: Sequence[Motion],
    *,
    tolerance: Tolerance = DEFAULT,
    mirror: bool = True,
    num_torsos: int = 48,
    name: str = "learned",
    progress: Progress | None = None,
) -> Anatomy:
    """Limits, lengths and torsos from recordings.

    Parameters
    ----------
    motions
        Recordings; their glitches are dropped, and they are thinned to 30 Hz.
    tolerance
        How far beyond what was seen a bone may go.
    mirror
        Whether the mirror image of every pose counts too.
    num_torsos
        Size of the dictionary of torsos.
    name
        Name of the limits.
    progress
        Called with what is being done, steps done, and steps in all.

    Raises
    ------
    BadInput
        Where no usable frame is left or a bone has length zero.
    """
    poses = gather(motions)
    limits = learn_limits(poses.joints, tolerance, mirror=mirror, name=name, progress=progress)
    lengths = LengthPrior(*(single(field) for field in learn_lengths(poses)))
    return Anatomy(limits, lengths, single(learn_torsos(poses, num_torsos, mirror=mirror)))
