"""k-means against scikit-learn's, which shares no code with it."""

import numpy as np
import pytest

from poseterior.inference.clusters import clusters

POINTS = np.random.default_rng(0).normal(size=(700, 45)) + 30 * np.arange(700)[:, None] % 3


@pytest.mark.parametrize("k", [1, 2, 5, 9])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_clusters_are_those_of_another_library(k: int, seed: int) -> None:
    from sklearn.cluster import KMeans

    theirs = KMeans(k, init="k-means++", n_init=1, random_state=seed).fit(POINTS)
    ours = clusters(POINTS, k, seed)
    assert np.array_equal(ours.labels, theirs.labels_)
    assert np.allclose(ours.centres, theirs.cluster_centers_, rtol=0, atol=1e-12)


def test_another_seed_finds_other_clusters() -> None:
    """The control of the above: seeds matter there."""
    assert not np.array_equal(clusters(POINTS, 9, 0).labels, clusters(POINTS, 9, 1).labels)


def test_what_is_left_out_changes_nothing() -> None:
    """Long runs, of which most points are looked at in few iterations, and coordinates that all
    points share: against every point in every iteration."""
    rng = np.random.default_rng(3)
    points = np.hstack([rng.normal(size=(2000, 12)), np.full((2000, 4), 0.1)])
    found = clusters(points, 6, 1)
    centres = np.array([points[found.labels == label].mean(axis=0) for label in range(6)])
    distances = np.linalg.norm(points[:, None] - found.centres, axis=2)
    assert np.array_equal(found.labels, distances.argmin(axis=1))
    assert np.abs(found.centres - centres).max() < 0.01  # at rest
    assert (found.centres[:, 12:] == 0.1).all()


def test_fewer_distinct_points_than_clusters_leave_some_empty() -> None:
    points = np.repeat(np.eye(3), 4, axis=0)
    found = clusters(points, 5, 0)
    assert len(np.unique(found.labels)) == 3
    assert np.allclose(found.centres[found.labels], points)
