"""Another error law than the disc: exact draws of it, by strata and from the prior, against a
second implementation in NumPy. What a new law has to bring is here in one class.

False alarms: every family of p-values is held to 0.001 altogether (Bonferroni), every evidence to 3
standard errors (0.3 % each); seeds are fixed.
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats
from scipy.stats import ks_2samp

from poseterior import inference
from poseterior.inference.studies.errorlaws.learn import LEARNABLE
from poseterior.probmodel import BadInput, Disc, ErrorLaw, Likelihood, PoseModel
from poseterior.probmodel.errors.keypoints import DetectedKeypoint
from poseterior.probmodel.errors.laws import LAWS, Gaussian, Student, law_of
from poseterior.probmodel.skeleton import GROUPS
from poseterior.reports.options import LearnedLaw
from tests.oracle import brute_force
from tests.scenes import key, prior_scene

FAMILY = 1e-3
"""False-alarm rate of one family of tests."""
ARM_JOINTS = [bone.end for limb in GROUPS["arms"] for bone in limb.bones]


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class CutGaussian(ErrorLaw):
    """A Gaussian of standard deviation one, cut at three: its square is exponential, cut at
    nine."""

    reach = 3.0
    log_peak = float(-np.log(2 * np.pi * (1 - np.exp(-4.5))))

    def log_ratio(self, square):
        square = jnp.asarray(square)
        return jnp.where(square <= self.reach**2, -square / 2, -jnp.inf)

    def distance(self, uniform):
        return jnp.sqrt(-2 * jnp.log1p(-(1 - np.exp(-(self.reach**2) / 2)) * jnp.asarray(uniform)))


@pytest.mark.parametrize("law", [*(law() for law in LAWS.values()), CutGaussian(), Student(2.0)])
def test_a_law_is_normalised_and_its_draws_follow_it(law):
    """Mass one by quadrature; 10,000 squared distances against the law's distribution function."""

    def ring(distance):
        ratio = np.exp(float(law.log_ratio(distance**2)))
        return 2 * np.pi * distance * np.exp(law.log_peak) * ratio

    assert integrate.quad(ring, 0, law.reach)[0] == pytest.approx(1, abs=1e-9)
    drawn = DetectedKeypoint(law, jnp.array([3.0, -2.0]), 0.5).sample(key(1), (10_000,))
    far = np.linalg.norm(np.asarray(drawn) - [3.0, -2.0], axis=-1) / 0.5
    grid = np.linspace(0, law.reach, 400)
    mass = np.array([integrate.quad(ring, 0, distance)[0] for distance in grid])
    uniform = np.interp(far, grid, mass)
    assert ks_2samp(uniform, np.linspace(0, 1, 20_001)).pvalue > FAMILY
    assert ks_2samp(uniform**1.2, np.linspace(0, 1, 20_001)).pvalue < FAMILY / 100  # it can fail


def test_a_students_law_is_scipys_and_ends_where_a_gaussian_does():
    """Density against SciPy's bivariate t, cut; mass beyond the reach; and the Gaussian that
    samplers propose by, which is nowhere below it, and touches it where it ends."""
    for df in (2.0, 4.5, 60.0):
        law = Student(df)
        far = np.linspace(0, law.reach, 500)
        t = stats.multivariate_t(np.zeros(2), 0.25 * np.eye(2), df)
        exact = t.logpdf(np.column_stack([far, 0 * far])) - np.log1p(-np.exp(-4.5))
        log_ratio = np.asarray(law.log_ratio(far**2))
        np.testing.assert_allclose(law.log_peak + log_ratio, exact, rtol=1e-9)
        beyond = integrate.quad(lambda r, t=t: 2 * np.pi * r * t.pdf([r, 0.0]), law.reach, np.inf)
        assert beyond[0] == pytest.approx(np.exp(-4.5), rel=1e-6)
        above = -(far**2) * law.precision / 2 - log_ratio
        np.testing.assert_allclose(law.log_over(far**2, law.precision), -above, atol=1e-12)
        assert above.min() > -1e-12
        assert above[-1] == pytest.approx(0, abs=1e-9)
        assert above[250] > 1e-3
    assert Student(1e7).reach == pytest.approx(Gaussian.reach, rel=1e-5)
    assert Student(1e7).precision == pytest.approx(Gaussian.precision, rel=1e-5)


@pytest.mark.parametrize("law", [law() for law in LAWS.values()], ids=list(LAWS))
def test_no_law_lies_above_the_envelopes_by_which_samplers_propose(law):
    """Nor below them where it says that it is one; a narrower envelope must be noticed."""
    square = np.linspace(0, law.reach, 500) ** 2
    for precision in (0.0, law.precision):
        over = np.asarray(law.log_over(square, precision))
        assert over[0] == 0
        assert over.max() < 1e-12
        assert (over.min() > -1e-12) == law.follows(precision)
    assert np.max(law.log_over(square, 1.1 * law.precision + 0.1)) > 1e-3


@pytest.mark.parametrize("law", [law() for law in LAWS.values()], ids=list(LAWS))
def test_a_law_is_read_as_it_was_written(law):
    again = law_of(law.name, law.parameters)
    assert again == law
    with pytest.raises(BadInput, match=f"the error law {law.name} is given with"):
        law_of(law.name, law.parameters | {"width": 1.0})
    with pytest.raises(BadInput, match="choose among disc, gaussian"):
        law_of(law.name.upper(), law.parameters)


def test_laws_that_can_be_learned_have_their_choice_and_all_stand_in_the_documentation():
    assert list(LearnedLaw) == list(LEARNABLE)
    assert set(LEARNABLE) < set(LAWS)
    text = (Path(__file__).parents[2] / "docs" / "commands.md").read_text()
    assert not [name for name in LAWS if f"`{name}`" not in text]


def test_tails_that_reach_beyond_a_person_are_refused():
    for df in (0.9, 0.0, np.nan):
        with pytest.raises(BadInput, match="1 degree of freedom or more"):
            Student(df)
    with pytest.raises(BadInput, match=r"end within 6.7 spreads, and Student\(df=1.9\) ends at 7"):
        Likelihood(Student(1.9))
    assert Likelihood(Student(2.0)).law.reach > 6.6


def by_the_law(joints, camera, keypoints, spread):
    """`(n,)` bool: draws kept with the probability that the Gaussian, cut at three, gives them."""
    log_keep = 0.0
    for joint, points in joints.items():
        if np.isfinite(spread[joint]):
            image = camera.scale * points[:, :2] + camera.translation
            square = np.sum((image - keypoints[joint]) ** 2, axis=-1) / spread[joint] ** 2
            log_keep = log_keep + np.where(square <= 9, -square / 2, -np.inf)
    rng = np.random.default_rng(int(1e6 * np.abs(log_keep[np.isfinite(log_keep)]).sum()) % 2**32)
    return np.log1p(-rng.uniform(size=len(log_keep))) <= log_keep


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["rejection", "rejection-device", "rejection-group"])
def test_draws_and_evidence_follow_the_law(sampler):
    """Both arms and their lengths; and the disc that has the same reach, which must fail."""
    model = PoseModel()
    seen = ("right_elbow", "right_wrist", "left_elbow", "left_wrist")
    missing = ("head", "right_knee", "right_ankle", "left_knee", "left_ankle")
    frame = prior_scene(model, 5, factor=0.5, missing=missing)
    assert all(frame.detection.seen[joint] for joint in ARM_JOINTS), seen
    frame = dataclasses.replace(
        frame, likelihood=dataclasses.replace(frame.likelihood, law=CutGaussian())
    )
    size, joints, proposed = brute_force(
        model.limits, model.lengths, frame, "arms", 400_000, 1, by_the_law
    )
    assert len(size) > 400
    result = inference.sample(
        model, frame, sampler=sampler, key=key(2), num_samples=3000, root="candidates"
    )

    def smallest(tree):
        drawn = tree["posterior"].joints.values[0]
        pairs = [
            ks_2samp(drawn[:, joint, axis], points[:, axis]).pvalue
            for joint, points in joints.items()
            for axis in range(3)
        ]
        return min(pairs) * len(pairs)

    assert smallest(result.tree) > FAMILY
    rate = len(size) / proposed
    error = np.hypot(result.tree.attrs["log_evidence_se"], np.sqrt((1 - rate) / len(size)))
    assert abs(result.tree.attrs["log_evidence"] - np.log(rate)) < 3 * error
    wide = dataclasses.replace(frame.likelihood, law=Disc(), factor=3 * 0.5)
    wrong = inference.sample(
        model,
        dataclasses.replace(frame, likelihood=wide),
        key=key(3),
        num_samples=3000,
        root="candidates",
    )
    assert smallest(wrong.tree) < FAMILY / 100
