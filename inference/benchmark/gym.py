"""Frozen targets as models of TensorFlow Probability's inference gym, in JAX.

    model = gym_model("arm-soft")
    model.unnormalized_log_prob(model.default_event_space_bijector(jnp.zeros(6)))
    model.sample_transformations["identity"].ground_truth_mean

It needs `pip install '.[gym]'`: the gym, and TensorFlow Probability as it is built every
night, because its last release does not run on this JAX."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.benchmark.catalogue import load
from poseterior.inference.benchmark.programs import in_jax
from poseterior.inference.benchmark.references import Moments, shipped_points


def gym_model(name: str, hardness: float = math.inf) -> Any:
    """A target as the gym's `BayesianModel` on the box: fractions of the lengths' ranges, points of
    the directions' squares.

    Parameters
    ----------
    name
        Of the target.
    hardness
        Of the walls, as in `FrozenTarget.log_graded`. Infinite, they are the target's, and the log
        density is -inf outside of them, which a chain cannot start in; the ground truth is always
        the target's.

    Returns
    -------
    inference_gym.targets.BayesianModel
        With the sample transformations `identity`, and `joints`: where those joints are that a
        coordinate moves, `(k, 3)`, camera axes, body units: of the torso where it is uncertain,
        then in the order of `FrozenTarget.limbs`.
        Their ground truth is from the exact draws in the package.

    Raises
    ------
    BadInput
        On a target that does not exist.
    ImportError
        Where the extra `gym` is not installed.
    """
    from inference_gym import using_jax as gym
    from tensorflow_probability.substrates.jax import bijectors, distributions

    target = load(name)
    density = in_jax(target)
    to_box = bijectors.Sigmoid()
    moved = *target.root.joints[1:], *(bone.end for limb in target.limbs for bone in limb.bones)
    ends = jnp.array(moved)

    def joints(box: jax.Array) -> jax.Array:
        return density.joints(to_box.inverse(box))[..., ends, :]

    class FrozenPosterior(gym.targets.BayesianModel):
        def _prior_distribution(self) -> Any:
            return distributions.Independent(distributions.Beta(*target.prior_shape), 1)

        def _log_likelihood(self, box: jax.Array) -> jax.Array:
            points = to_box.inverse(box)
            if math.isinf(hardness):
                return density.log_likelihood(points)
            return density.log_graded(points, hardness)

    exact = jnp.asarray(target.box_of(shipped_points(name)))
    found = {"identity": (lambda box: box, "Box"), "joints": (joints, "Joints, body units")}
    return FrozenPosterior(
        default_event_space_bijector=to_box,
        event_shape=(target.dim,),
        dtype=exact.dtype,
        name=f"poseterior_{name.replace('-', '_')}",
        pretty_name=f"poseterior: {target.about}",
        sample_transformations={
            label: _transformation(gym.targets.Model.SampleTransformation, function, words, exact)
            for label, (function, words) in found.items()
        },
    )


def _transformation(make: Any, function: Any, words: str, exact: jax.Array) -> Any:
    """A sample transformation with its ground truth."""
    values = np.asarray(jax.jit(function)(exact))
    truth = Moments.of(values)
    return make(
        fn=function,
        pretty_name=words,
        ground_truth_mean=truth.mean,
        ground_truth_mean_standard_error=truth.mean_se,
        ground_truth_standard_deviation=truth.sd,
        ground_truth_standard_deviation_standard_error=truth.sd_se,
        dtype=exact.dtype,
    )
