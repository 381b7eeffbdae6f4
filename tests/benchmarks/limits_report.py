"""Writes reports/limits.md and reports/limits.png: how the embedded limits compare with the
published ones, and how far they hold for people and recordings that they were not learned from.

Usual way in: `python tests/benchmarks/limits_report.py ../shared/data` from the root of the
repository; ten minutes."""

import argparse
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import matplotlib  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib.image import AxesImage  # noqa: E402

from probmodel.anatomy.limits import GRID, AnatomicalLimits  # noqa: E402
from probmodel.anatomy.population import Anatomy  # noqa: E402
from probmodel.anatomy.published import read_published  # noqa: E402
from probmodel.body import mirror_pose  # noqa: E402
from probmodel.kinematics import articulation  # noqa: E402
from probmodel.learning.limits import learn_limits  # noqa: E402
from probmodel.learning.occupancy import occupancy  # noqa: E402
from probmodel.learning.overlap import Overlap, overlap  # noqa: E402
from probmodel.learning.poses import Poses, gather  # noqa: E402
from probmodel.learning.sphere import cell_areas, cells_of, fibonacci  # noqa: E402
from probmodel.learning.tolerance import Tolerance  # noqa: E402
from probmodel.motion import Motion, read_motion  # noqa: E402
from probmodel.skeleton import BONE_NAMES, UPPER_BONES  # noqa: E402

REPORTS = Path(__file__).parents[2] / "reports"
SOURCES = ("cmu/asfamc", "cmu/actions_train.npz", "bvh")
SUBJECTS = {
    "01": ("01",),
    "02 and the action set": ("02", "actions_train"),
    "03": ("03",),
    "131": ("cmu_131_03",),
}
FOLDS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="the data pack's folder")
    data = parser.parse_args().data
    motions = [motion for source in SOURCES for motion in read_motion(data / source)]
    # The tables of joint limits as they are embedded; the others are learned here.
    anatomy, published = (
        Anatomy.default(),
        read_published(data / "akhter_black" / "jointAngleModel_v2.mat"),
    )
    poses = gather(motions)
    sections = [
        comparison(anatomy.limits, published),
        frontier(poses, published),
        seen_beyond(poses, published),
        generalisation(motions, anatomy.limits, published),
    ]
    figure(anatomy.limits, poses, REPORTS / "limits.png")
    template = (Path(__file__).parent / "limits_report.md").read_text()
    text = template
    for number, section in enumerate(sections, 1):
        text = text.replace(f"{{{{{number}}}}}", section)
    (REPORTS / "limits.md").write_text(text)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def words(name: str) -> str:
    return name.replace("_", " ")


def comparison(limits: AnatomicalLimits, published: AnatomicalLimits) -> str:
    given, joint = overlap(limits, published), overlap(limits, published, joint=True)
    rows = [
        (
            words(bone),
            f"{given.area[i]:.2f}",
            f"{given.other_area[i]:.2f}",
            *map(percent, shares(given, i)),
            *(map(percent, shares(joint, i)) if i >= len(UPPER_BONES) else ("", "")),
        )
        for i, bone in enumerate(BONE_NAMES)
    ]
    head = (
        "bone",
        "ours (sr)",
        "published (sr)",
        "covered",
        "outside",
        "covered, with parent",
        "outside, with parent",
    )
    return table(head, rows)


def shares(measure: Overlap, bone: int) -> tuple[float, float]:
    return float(measure.covered[bone]), float(measure.outside[bone])


def frontier(poses: Poses, published: AnatomicalLimits) -> str:
    """Upper bones for several radii; lower bones for several margins and neighbourhoods."""
    upper, area = upper_directions(poses.joints), cell_areas()
    rows = []
    for radius in (0, 2, 4, 6, 8, 10, 12, 15):
        cells = [
            occupancy(upper[:, bone], radius, Tolerance.closing) for bone in range(len(UPPER_BONES))
        ]
        pairs = zip(cells, np.asarray(published.occupied), strict=True)
        rows.append(
            (f"{radius}°", *(covered_and_outside(ours, theirs, area) for ours, theirs in pairs))
        )
    first = table(("radius", *(words(bone.name) for bone in UPPER_BONES)), rows)
    rows = []
    for neighbourhood, margin in ((10, 4), (25, 0), (25, 4), (25, 8), (35, 4)):
        tolerance = dataclasses.replace(Tolerance(), neighbourhood=neighbourhood, lower=margin)
        measure = overlap(learn_limits(poses.joints, tolerance), published)
        rows.append(
            (
                f"{neighbourhood}°",
                f"{margin}°",
                *(" / ".join(map(percent, shares(measure, i))) for i in range(5, 9)),
            )
        )
    return first + "\n\n" + table(("neighbourhood", "margin", *map(words, BONE_NAMES[5:])), rows)


def covered_and_outside(ours: np.ndarray, theirs: np.ndarray, area: np.ndarray) -> str:
    common = area[ours & theirs].sum()
    return f"{percent(common / area[theirs].sum())} / {percent(1 - common / area[ours].sum())}"


def upper_directions(joints: np.ndarray) -> np.ndarray:
    """`(2N, 5, 3)`: local directions of the upper bones in poses `(N, 15, 3)` and their mirror
    images."""
    limits = AnatomicalLimits.default()
    both = np.concatenate([joints, mirror_pose(joints)])
    return np.asarray(articulation(both, limits.reference, limits.fallback).upper)


def seen_beyond(poses: Poses, published: AnatomicalLimits) -> str:
    """Share of the area of cells in which a direction was seen that the published tables do not
    have."""
    upper, area = upper_directions(poses.joints), cell_areas()
    rows = []
    for bone, theirs in zip(range(len(UPPER_BONES)), np.asarray(published.occupied), strict=True):
        seen = np.zeros(GRID, bool)
        seen[cells_of(upper[:, bone])] = True
        rows.append(
            (
                words(UPPER_BONES[bone].name),
                f"{area[seen].sum():.2f}",
                percent(area[seen & ~theirs].sum() / area[seen].sum()),
            )
        )
    return table(("bone", "seen (sr)", "of it, outside the published table"), rows)


def generalisation(
    motions: list[Motion], limits: AnatomicalLimits, published: AnatomicalLimits
) -> str:
    everything = gather(motions).joints
    rows = [
        valid_row("all, learned from", limits, everything),
        valid_row("all, published limits", published, everything),
    ]
    for label, subjects in SUBJECTS.items():
        rows.append(
            held_out(f"subject {label}", motions, lambda i, m, who=subjects: m.subject in who)
        )
    folds = [
        held_out("", motions, lambda i, m, fold=fold: i % FOLDS == fold) for fold in range(FOLDS)
    ]
    weights = np.array([float(row[1]) for row in folds])
    means = weights @ np.array([[float(cell) for cell in row[2:]] for row in folds]) / weights.sum()
    rows.append(
        (f"recordings, {FOLDS} folds", int(weights.sum()), *(f"{mean:.3f}" for mean in means))
    )
    return table(("frames", "number", "all nine", *map(words, BONE_NAMES)), rows)


def held_out(label: str, motions: list[Motion], out: Callable[..., bool]) -> tuple[object, ...]:
    """Learns without some recordings and checks them."""
    kept = [motion for i, motion in enumerate(motions) if not out(i, motion)]
    left = [motion for i, motion in enumerate(motions) if out(i, motion)]
    return valid_row(label, learn_limits(gather(kept).joints, Tolerance()), gather(left).joints)


def valid_row(label: str, limits: AnatomicalLimits, joints: np.ndarray) -> tuple[object, ...]:
    check = limits.check(joints)
    return (
        label,
        len(joints),
        *(f"{share:.3f}" for share in [check.pose_valid.mean(), *check.valid.mean(axis=0)]),
    )


def figure(limits: AnatomicalLimits, poses: Poses, path: Path) -> None:
    """Maps of our own tables: where upper bones can point, and how much room the lower bones have
    there."""
    upper = upper_directions(poses.joints)
    fig = plt.figure(figsize=(13, 6.2), layout="constrained")
    grid = fig.add_gridspec(2, 6)
    for bone, place in ((0, grid[0, 0:2]), (1, grid[0, 2:4]), (3, grid[0, 4:6])):
        axes = fig.add_subplot(place)
        possible = np.asarray(limits.occupied)[bone]
        axes.imshow(
            np.where(possible, 0.15, np.nan).T,
            origin="lower",
            extent=EXTENT,
            cmap="Greys",
            vmin=0,
            vmax=1,
        )
        counts = np.zeros(GRID)
        np.add.at(counts, cells_of(upper[:, bone]), 1.0)
        image = draw(axes, np.where(counts > 0, counts, np.nan), "viridis", log=True)
        outline(axes, possible)
        axes.set_title(words(UPPER_BONES[bone].name), fontsize=11)
    fig.colorbar(image, ax=axes, label="frames seen", shrink=0.85)
    free = solid_angles(limits)
    for bone, place in ((0, grid[1, 0:3]), (2, grid[1, 3:6])):
        axes = fig.add_subplot(place)
        image = draw(axes, free[bone], "magma")
        outline(axes, limits.has_plane[bone])
        axes.set_title(
            f"room of the {words(BONE_NAMES[5 + bone])}, by direction of its parent", fontsize=11
        )
    fig.colorbar(image, ax=axes, label="steradians", shrink=0.85)
    fig.savefig(path, dpi=120)
    plt.close(fig)


EXTENT = (-180, 180, -90, 90)


def draw(axes: plt.Axes, values: np.ndarray, colours: str, *, log: bool = False) -> AxesImage:
    norm = matplotlib.colors.LogNorm(1, 2000) if log else matplotlib.colors.Normalize(0, 4 * np.pi)
    image = axes.imshow(
        values.T, origin="lower", extent=EXTENT, cmap=colours, norm=norm, aspect="auto"
    )
    axes.set_xticks(range(-180, 181, 90))
    axes.set_yticks(range(-90, 91, 45))
    axes.set_xlabel("azimuth (°)")
    axes.set_ylabel("elevation (°)")
    return image


def outline(axes: plt.Axes, mask: np.ndarray) -> None:
    azimuth, elevation = np.arange(GRID[0]) * 3 - 178.5, np.arange(GRID[1]) * 3 - 88.5
    axes.contour(azimuth, elevation, mask.T.astype(float), [0.5], colors="black", linewidths=1.0)


def solid_angles(limits: AnatomicalLimits) -> np.ndarray:
    """`(4, 120, 60)` steradians of valid lower directions, by cell of the parent."""
    directions, triples = fibonacci(2000), np.asarray(limits.triples())
    areas = np.full(limits.has_plane.shape, np.nan)
    for where in zip(*np.nonzero(limits.has_plane), strict=True):
        coordinate = directions @ triples[where].T
        bounds = np.asarray(limits.bounds)[where]
        inside = (coordinate[:, 1:] >= bounds[0::2]) & (coordinate[:, 1:] <= bounds[1::2])
        valid = inside.all(axis=-1) & (coordinate[:, 0] + np.asarray(limits.offset)[where] < 0)
        areas[where] = 4 * np.pi * valid.mean()
    return areas


if __name__ == "__main__":
    main()
