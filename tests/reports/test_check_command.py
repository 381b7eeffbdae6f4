"""`poseterior check` on files of others, and on our own data sets."""

from pathlib import Path

import numpy as np

from poseterior.probmodel.datasets import from_motions, write_plain
from poseterior.reports.commands.check import read_poses
from tests.conftest import Cli
from tests.probmodel.test_datasets import MOTIONS
from tests.probmodel.test_markers import trc, write_c3d


def test_our_own_data_sets_are_checked(tmp_path: Path) -> None:
    data = from_motions(MOTIONS, "three recordings", frames=4)
    write_plain(data, tmp_path / "set.npz")
    poses = read_poses(tmp_path / "set.npz")
    np.testing.assert_allclose(poses.joints, data.poses, atol=1e-3)
    assert poses.names[0] == f"case 0, {data.recording[0]}"


def test_files_of_markers_are_checked(tmp_path: Path, poseterior: Cli) -> None:
    (tmp_path / "walk.trc").write_text(trc())
    for file in (tmp_path / "walk.trc", write_c3d(tmp_path / "walk.c3d")):
        run = poseterior("check", file, "--quiet")
        assert (run.code, run.err) == (0, "")
        assert f"of 3 poses in {file} are possible" in " ".join(run.out.split())
