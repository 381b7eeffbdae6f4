"""Draws in ArviZ's netCDF, as a user of ArviZ saves them."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from poseterior.inference import benchmark
from poseterior.inference.benchmark.submission import read_submission, submit
from poseterior.probmodel import BadInput


def draws() -> np.ndarray:
    """`(4, 50, d)`: draws of the prior, which the data of this target allow."""
    target = benchmark.load("arm-soft")
    points = target.prior_points(np.random.default_rng(4), 20_000)
    allowed = points[np.isfinite(target.log_likelihood(points))]
    return allowed[:200].reshape(4, 50, -1)


def test_the_posterior_of_a_netcdf_is_what_an_npz_holds(tmp_path: Path) -> None:
    target, points = benchmark.load("arm-soft"), draws()
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["posterior/points"] = points
        file["posterior/chain"] = np.arange(4)
        file["posterior/draw"] = np.arange(50)
        file["sample_stats/lp"] = np.zeros((4, 50))
    found = read_submission(tmp_path / "a.nc", target)
    np.testing.assert_array_equal(found.points, submit(target, points=points).points)
    assert found.given == 200


def test_variables_of_other_names_are_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        for number in range(6):
            file[f"posterior/x{number}"] = np.zeros((4, 50))
    with pytest.raises(BadInput, match=r"has \['x0', .* none of points, box, cube; give one of"):
        read_submission(tmp_path / "a.nc", benchmark.load("arm-soft"))
    with h5py.File(tmp_path / "c.nc", "w") as file:
        file["mcmc/chain"] = np.zeros((50, 4, 6))
    with pytest.raises(BadInput, match="has no group posterior, as ArviZ writes one; write one wi"):
        read_submission(tmp_path / "c.nc", benchmark.load("arm-soft"))
    (tmp_path / "b.nc").write_bytes(b"no")
    with pytest.raises(BadInput, match="is no file of draws"):
        read_submission(tmp_path / "b.nc", benchmark.load("arm-soft"))


def test_files_that_users_brought(shared_data: Path) -> None:
    target = benchmark.load("arm-soft")
    found = read_submission(shared_data / "cases" / "arviz_points.nc", target)
    assert found.points.shape == (4, 500, 6)
    with pytest.raises(BadInput, match="none of points, box, cube"):
        read_submission(shared_data / "cases" / "arviz_named.nc", target)
