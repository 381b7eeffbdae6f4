"""The dictionary of torsos from poses: torsos that were seen, spread over all that were."""

import numpy as np
from scipy.spatial import cKDTree

from poseterior.probmodel.body import aligned, mean_torso, mirror_torso
from poseterior.probmodel.learning.poses import Poses
from poseterior.probmodel.skeleton import TORSO_INDEX


def learn_torsos(poses: Poses, count: int, *, mirror: bool) -> np.ndarray:
    """A dictionary of torsos that were seen, each the nearest to one centre of k-means, in which
    every subject counts alike: people differ more in their torsos than one person's moves do.

    Parameters
    ----------
    poses
        In body units.
    count
        How many torsos, J; fewer where there are fewer poses.
    mirror
        Whether half of the dictionary is the mirror image of the other half.

    Returns
    -------
    torsos : `(J, 6, 3)`
        In body axes, each turned about the pelvis onto their mean (Procrustes).
    """
    from sklearn.cluster import KMeans  # It takes a second to import, and only learning needs it.

    joints = poses.joints
    torsos = joints[:, list(TORSO_INDEX)]
    everything = np.concatenate([torsos, mirror_torso(torsos)]) if mirror else torsos
    torsos = aligned(joints, mean_torso(everything))[:, list(TORSO_INDEX)]
    clusters = min(count // 2 if mirror else count, len(torsos))
    flat = torsos.reshape(len(torsos), -1)
    weight = 1 / np.bincount(poses.subject)[poses.subject]
    means = KMeans(clusters, n_init=4, random_state=0).fit(flat, sample_weight=weight)
    centres = means.cluster_centers_
    chosen = torsos[np.unique(cKDTree(flat).query(centres)[1])]
    return np.concatenate([chosen, mirror_torso(chosen)]) if mirror else chosen
