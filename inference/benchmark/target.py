"""A frozen target in the forms that samplers want, in plain NumPy.

A target is the posterior of one detection under one torso and camera, or of torso and camera too
(`root`). Three charts, the same as those of `inference.baselines.target`, in which only coordinates
of the pose are kept that some seen joint depends on, and those of an uncertain root behind them:

- *points* `(n, d)` of R^d: the unconstrained coordinates, logits of the box;
- the *box* `[0, 1]^d`: bone lengths as fractions of their ranges, directions as points of their
  unit squares, roots as `BoxedRoot` says;
- the *cube* `[0, 1]^d`, in which the prior is flat: as the box, with lengths by their quantiles.

Every function takes one row `(d,)` or many `(n, d)`. Densities are normalised priors times the
likelihood over its peak, so that the evidence is between 0 and 1 (docs/model.md § 7). Errors grow
with the person in the image, so that every seen joint brings the likelihood scale⁻²: its peak is
that of the least scale."""

import functools
from dataclasses import dataclass

import numpy as np

from poseterior.inference.benchmark.anatomy import (
    CUBE_DIM,
    FrozenAnatomy,
    column_of_lower,
    column_of_upper,
)
from poseterior.inference.benchmark.root import FrozenRoot, PlacedTorso
from poseterior.probmodel.skeleton import (
    BONES,
    GROUPS,
    JOINTS,
    LENGTH_GROUPS,
    NUM_LENGTHS,
    NUM_LOWER,
    NUM_UPPER,
    Limb,
)

FRACTIONS = (
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"{bone.name} {axis}" for bone in BONES for axis in "uv"),
)
"""Names of the fractions of a pose."""
FROZEN_LAWS = {"disc": (1.0, 0.0), "gaussian": (1.5, 2.0)}
"""Error laws: the reach in spreads, and c in the log ratio -c·z² of the density to its peak."""
TARGET_CHUNK = 20_000
"""Rows that are computed at once at most, so that memory stays small."""


@dataclass(frozen=True, eq=False)
class FrozenTarget:
    """One target.

    Attributes
    ----------
    name, about : what it is called, and what is hard about it.
    root : the torso in front of a camera, or the prior of it.
    seen_at : `(15, 2)`, where joints were detected in the image, in its units; 0 where not.
    score : `(15,)`, the detector's scores; 0 where a joint was not detected.
    factor : the spread of a joint of average score, body units.
    law : the errors' law, a key of `FROZEN_LAWS`.
    """

    name: str
    about: str
    root: FrozenRoot
    seen_at: np.ndarray
    score: np.ndarray
    factor: float
    law: str

    @functools.cached_property
    def seen(self) -> np.ndarray:
        """`(k,)`: indices of the joints that count."""
        joints = (*self.root.joints, *(bone.end for bone in BONES))
        return np.array([joint for joint in joints if self.score[joint] > 0])

    @functools.cached_property
    def spread(self) -> np.ndarray:
        """`(k,)`: the spreads of those joints' errors, body units (docs/model.md § 3)."""
        score = self.score[self.seen]
        return self.factor * score.mean() / score

    @functools.cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """The limbs that have a seen joint, cut off behind the last one."""
        cut = (self._cut(limb) for limbs in GROUPS.values() for limb in limbs)
        return tuple(limb for limb in cut if limb is not None)

    def _cut(self, limb: Limb) -> Limb | None:
        seen = [bone.end in self.seen for bone in limb.bones]
        if not any(seen):
            return None
        return limb if seen[-1] else limb._replace(lower=None)

    @functools.cached_property
    def active(self) -> np.ndarray:
        """Which of the fractions of a pose are coordinates of the target, the first ones."""
        found: set[int] = set()
        for limb in self.limbs:
            found |= {bone.length_group for bone in limb.bones}
            starts = [column_of_upper(limb.upper)]
            starts += [] if limb.lower is None else [column_of_lower(limb.lower)]
            found |= {start + side for start in starts for side in (0, 1)}
        return np.array(sorted(found))

    @property
    def dim(self) -> int:
        """How many coordinates there are."""
        return len(self.active) + len(self.root.coordinates)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Their names."""
        return (*(FRACTIONS[index] for index in self.active), *self.root.coordinates)

    @functools.cached_property
    def prior_shape(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters alpha, beta `(d,)` of the prior on the box: Beta distributions of lengths, and
        uniform ones, which are Beta(1, 1), of all else."""
        lengths, free = self._lengths
        anatomy = FrozenAnatomy.default().lengths
        alpha = np.ones(self.dim)
        beta = np.ones(self.dim)
        alpha[free] = anatomy.alpha[lengths]
        beta[free] = anatomy.beta[lengths]
        return alpha, beta

    def log_prior(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: normalised log density of the prior at points `(..., d)` of R^d."""
        points = np.asarray(points, float)
        alpha, beta = self.prior_shape
        up = -np.logaddexp(0, -points)
        down = -np.logaddexp(0, points)
        constant = FrozenAnatomy.default().lengths.log_constants[self._lengths[0]].sum()
        return np.sum(alpha * up + beta * down, axis=-1) + constant

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: log of the likelihood over its peak at points `(..., d)` of R^d, at most 0; -inf
        where a seen joint lies beyond its reach."""
        return self._log_likelihood_in_box(self.box_of(points))

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: log density of the target at points `(..., d)` of R^d, but for the evidence."""
        return self.log_prior(points) + self.log_likelihood(points)

    def log_density_in_box(self, box: np.ndarray) -> np.ndarray:
        """`(...)`: log density of the target at points `(..., d)` of the box, per unit of the box,
        but for the evidence; -inf outside."""
        box = np.asarray(box, float)
        inside = np.all((box > 0) & (box < 1), axis=-1)
        safe = np.where(inside[..., None], box, 0.5)
        lengths, free = self._lengths
        anatomy = FrozenAnatomy.default().lengths
        fraction = safe[..., free]
        prior = (anatomy.alpha[lengths] - 1) * np.log(fraction)
        prior = prior + (anatomy.beta[lengths] - 1) * np.log1p(-fraction)
        log_prior = np.sum(prior + anatomy.log_constants[lengths], axis=-1)
        return np.where(inside, log_prior + self._log_likelihood_in_box(safe), -np.inf)

    def log_graded(self, points: np.ndarray, hardness: float) -> np.ndarray:
        """`(...)`: log of a likelihood with slopes for walls, for tempering and nested sampling.

        Within reach it is the target's; beyond, it falls from there by `hardness` · (z²/reach² - 1)
        for every joint that lies z spreads away, instead of to nothing. At hardness 0 it is flat
        under discs but for a root's scale, and in the limit it is the target's. Draws of it that
        lie inside (`misfit` at most 1) are draws of the target at any hardness, and their share
        times its evidence is the target's evidence.
        """
        box = self.box_of(points)
        squares = self._squares_in_box(box)
        reach, curvature = FROZEN_LAWS[self.law]
        within = np.minimum(squares, reach**2)
        beyond = (squares - within) / reach**2
        return self._log_growth(box) - np.sum(curvature * within + hardness * beyond, axis=-1)

    def prior_transform(self, cube: np.ndarray) -> np.ndarray:
        """Points `(..., d)` of R^d from points of the unit cube: uniform ones become draws of the
        prior."""
        from scipy.special import betaincinv

        box = np.array(cube, float)
        lengths, free = self._lengths
        anatomy = FrozenAnatomy.default().lengths
        box[..., free] = betaincinv(anatomy.alpha[lengths], anatomy.beta[lengths], box[..., free])
        return self.points_of_box(box)

    def box_of(self, points: np.ndarray) -> np.ndarray:
        """The box `(..., d)` at points of R^d."""
        points = np.asarray(points, float)
        small = np.exp(-np.abs(points))
        return np.where(points >= 0, 1.0, small) / (1 + small)

    def points_of_box(self, box: np.ndarray) -> np.ndarray:
        """Points of R^d `(..., d)`, finite also at the ends of the box."""
        edge = np.finfo(float).eps
        inside = np.clip(np.asarray(box, float), edge, 1 - edge)
        return np.log(inside) - np.log1p(-inside)

    def squares(self, points: np.ndarray) -> np.ndarray:
        """`(..., k)`: squared distances of the seen joints from their detections, in spreads, at
        points `(..., d)` of R^d."""
        return self._squares_in_box(self.box_of(points))

    def misfits(self, points: np.ndarray) -> np.ndarray:
        """`(..., k)`: distances of the seen joints from their detections, in reaches."""
        return np.sqrt(self.squares(points)) / FROZEN_LAWS[self.law][0]

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: the largest of them: a point is inside the support iff it is at most 1."""
        return self.misfits(points).max(axis=-1)

    def prior_points(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, d)` draws of the prior as points of R^d."""
        lengths, free = self._lengths
        anatomy = FrozenAnatomy.default().lengths
        box = rng.uniform(size=(number, self.dim))
        box[:, free] = rng.beta(
            anatomy.alpha[lengths], anatomy.beta[lengths], (number, int(free.sum()))
        )
        return self.points_of_box(box)

    def poses(self, points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Whole poses at points `(n, d)` of R^d: joints `(n, 15, 3)` in camera axes and lengths
        `(n, 5)`, body units. What no seen joint depends on is drawn from the prior, which is what
        it follows whatever the rest does."""
        anatomy = FrozenAnatomy.default()
        fractions = rng.uniform(size=(len(points), CUBE_DIM))
        fractions[:, :NUM_LENGTHS] = rng.beta(
            anatomy.lengths.alpha, anatomy.lengths.beta, (len(points), NUM_LENGTHS)
        )
        of_pose, of_root = self._parts(self.box_of(points))
        fractions[:, self.active] = of_pose
        limbs = tuple(limb for limbs in GROUPS.values() for limb in limbs)
        return self._poses(fractions, of_root, limbs)

    def decided(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `poses`, but for what no seen joint depends on: such joints lie in the origin, and
        such lengths are in the middle of their ranges."""
        of_pose, of_root = self._parts(self.box_of(points))
        return self._poses(self._complete(of_pose), of_root, self.limbs)

    def detections(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """`(n, k, 2)`: where the seen joints of poses at points `(n, d)` of R^d may be detected, in
        units of the image: their places with errors of the target's law."""
        reach, curvature = FROZEN_LAWS[self.law]
        share = rng.uniform(size=(len(points), len(self.seen)))
        if curvature:  # the size's law is cut off at the reach
            most = -np.expm1(-curvature * reach**2)
            size = np.sqrt(-np.log1p(-share * most) / curvature)
        else:
            size = reach * np.sqrt(share)
        angle = rng.uniform(0, 2 * np.pi, share.shape)
        error = (self.spread * size)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        on_plane = self.decided(points)[0][:, self.seen, :2] + error
        root = self.root_at(points)
        return root.place[..., None, :] + root.scale[..., None, None] * on_plane

    def root_at(self, points: np.ndarray) -> PlacedTorso:
        """The roots at points `(n, d)` of R^d; one for all where it is fixed."""
        return self.root.at(self._parts(self.box_of(points))[1])

    @property
    def seen_joints(self) -> list[str]:
        """The names of the seen joints, in the order of `squares`."""
        return [JOINTS[joint] for joint in self.seen]

    @functools.cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Which length groups are coordinates, and which coordinates `(d,)` bool are lengths."""
        lengths = self.active[self.active < NUM_LENGTHS]
        return lengths, np.arange(self.dim) < len(lengths)

    def _parts(self, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coordinates of the pose, and those of the root."""
        return box[..., : len(self.active)], box[..., len(self.active) :]

    def _complete(self, box: np.ndarray) -> np.ndarray:
        """All fractions `(n, 23)` of poses; what no seen joint depends on lies in the middle."""
        fractions = np.full((len(box), CUBE_DIM), 0.5)
        fractions[:, self.active] = box
        return fractions

    def _poses(
        self, fractions: np.ndarray, of_root: np.ndarray, limbs: tuple[Limb, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joints and lengths at fractions `(n, 23)` of poses, and those of the root."""
        anatomy = FrozenAnatomy.default()
        parts = (
            np.split(each, range(TARGET_CHUNK, len(each), TARGET_CHUNK))
            for each in (fractions, of_root)
        )
        joints = np.concatenate(
            [
                anatomy.joints(self.root.at(root).torso, part, limbs)
                for part, root in zip(*parts, strict=True)
            ]
        )
        return joints, anatomy.lengths.at(fractions[:, :NUM_LENGTHS])

    def _squares_in_box(self, box: np.ndarray) -> np.ndarray:
        flat = box.reshape(-1, self.dim)
        parts = np.split(flat, range(TARGET_CHUNK, len(flat), TARGET_CHUNK))
        found = np.concatenate([self._squares_of(part) for part in parts])
        return found.reshape(*box.shape[:-1], len(self.seen))

    def _squares_of(self, box: np.ndarray) -> np.ndarray:
        of_pose, of_root = self._parts(box)
        view = self.root.at(of_root)
        joints = FrozenAnatomy.default().joints(view.torso, self._complete(of_pose), self.limbs)
        on_plane = self.seen_at[self.seen] - view.place[..., None, :]
        offset = joints[:, self.seen, :2] - on_plane / view.scale[..., None, None]
        return np.sum(offset**2, axis=-1) / self.spread**2

    def _log_likelihood_in_box(self, box: np.ndarray) -> np.ndarray:
        return self._log_growth(box) + self._log_ratio(self._squares_in_box(box))

    def _log_growth(self, box: np.ndarray) -> np.ndarray:
        """`(...)`: log of the scale⁻² that every seen joint brings, over that of the least."""
        return -2 * len(self.seen) * self.root.log_growth(self._parts(box)[1])

    def _log_ratio(self, squares: np.ndarray) -> np.ndarray:
        reach, curvature = FROZEN_LAWS[self.law]
        inside = np.all(squares <= reach**2, axis=-1)
        return np.where(inside, -curvature * np.sum(squares, axis=-1), -np.inf)


assert len(FRACTIONS) == CUBE_DIM == NUM_LENGTHS + 2 * (NUM_UPPER + NUM_LOWER)
