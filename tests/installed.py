"""Tries an installed poseterior: `make dist` runs it by the Python of a clean environment, in an
empty folder, and with `-P`, so that nothing of the checkout is on the path."""

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NEEDED = (
    *("poseterior/__init__.py", "poseterior/py.typed"),
    *(
        "poseterior/probmodel/data/limits.npz",
        "poseterior/probmodel/data/limits_wide.npz",
        "poseterior/probmodel/data/poses.npz",
        "poseterior/probmodel/data/example.json",
    ),
    "poseterior/probmodel/data/errors.json",
    *(f"poseterior/inference/benchmark/data/{name}" for name in ("anatomy.npz", "targets.json")),
    *(
        "poseterior/inference/benchmark/data/reference.json",
        "poseterior/inference/benchmark/__init__.pyi",
    ),
    *(
        "poseterior/reports/cli.py",
        "poseterior/reports/exports/bvh.py",
    ),
)
"""Files without which the wheel does not work, or says less than it should."""


def main() -> None:
    """Raises where anything is not as it should be."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    (wheel,) = (ROOT / "dist").glob("*.whl")
    (sdist,) = (ROOT / "dist").glob("*.tar.gz")
    look(wheel, sdist, version)
    import poseterior
    from poseterior.inference.benchmark import external_samplers

    place = Path(poseterior.__file__).resolve()
    assert Path(sys.prefix).resolve() in place.parents, f"{place} is not the installed one"
    assert poseterior.__version__ == version
    assert all(hasattr(poseterior, name) for name in poseterior.__all__)
    command = Path(sys.prefix) / "bin" / "poseterior"
    said = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert said.stdout == f"poseterior {version}\n", said.stdout
    subprocess.run([command, "demo", "--quiet", "--out", "demo"], check=True, capture_output=True)
    subprocess.run([command, "export", "demo", "--to", "bvh"], check=True, capture_output=True)
    assert Path("demo.bvh").exists()
    assert {"dynesty", "nrpt"} <= set(external_samplers()), "entry points are not installed"
    print(f"{wheel.name} and {sdist.name} are whole, and the wheel works in {sys.prefix}")


def look(wheel: Path, sdist: Path, version: str) -> None:
    """Raises where a file is missing, or one is there that should not be."""
    inside = set(zipfile.ZipFile(wheel).namelist())
    assert not set(NEEDED) - inside, f"{wheel.name} lacks {set(NEEDED) - inside}"
    unwanted = [name for name in inside if name.startswith(("tests/", "poseterior/reports/pages/"))]
    assert not unwanted, f"{wheel.name} holds {unwanted}"
    with tarfile.open(sdist) as archive:
        names = archive.getnames()
    for name in ("pyproject.toml", "CITATION.cff", "tests/conftest.py", "docs/python.md"):
        assert f"poseterior-{version}/{name}" in names, f"{sdist.name} lacks {name}"


if __name__ == "__main__":
    main()
