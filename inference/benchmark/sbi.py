"""Frozen targets as tasks of sbibm, the benchmark of simulation-based inference, in PyTorch.

    task = sbibm_task("arm")
    task.get_simulator()(task.get_prior()(num_samples=1000))     # detections
    task.get_reference_posterior_samples(num_observation=1)      # exact draws

Parameters are points of the box, data where the seen joints are detected. sbibm 1.1 asks for much
that its tasks do not need; they run with `pip install --no-deps sbibm pyro-ppl pyro-api` and
`pip install torch pandas tqdm opt-einsum diskcache`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from poseterior.inference.benchmark.catalogue import load
from poseterior.inference.benchmark.references import shipped_points
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.probmodel.failures import BadInput

SBIBM_SIMULATIONS = [1_000, 10_000, 100_000]
"""Numbers of simulations that algorithms are compared at, as sbibm's own tasks have them."""


def sbibm_task(name: str) -> Any:
    """A target as a task with one observation, the detection that the target is frozen with.

    Parameters
    ----------
    name
        Of the target.

    Returns
    -------
    sbibm.tasks.Task
        Its reference posterior samples are the exact draws in the package. Of the pose that a
        detection was simulated from nothing is kept; its true parameters are one more exact draw,
        which given the detection has the same law.

    Raises
    ------
    BadInput
        On a target that does not exist, and, by its methods, on an observation that does not.
    ImportError
        Where sbibm or PyTorch is not installed.
    """
    import pyro
    import torch
    from sbibm.tasks.simulator import Simulator
    from sbibm.tasks.task import Task

    target = load(name)
    alpha, beta = (
        torch.as_tensor(part, dtype=torch.get_default_dtype()) for part in target.prior_shape
    )
    exact = _tensor(target.box_of(shipped_points(name)))

    class FrozenTask(Task):
        def __init__(self) -> None:
            super().__init__(
                dim_data=2 * len(target.seen),
                dim_parameters=target.dim,
                name=f"poseterior_{name.replace('-', '_')}",
                name_display=f"poseterior: {target.about}",
                num_observations=1,
                num_posterior_samples=len(exact) - 1,
                num_simulations=SBIBM_SIMULATIONS,
                path=Path(__file__).parent,
            )
            self.prior_params = {"concentration1": alpha, "concentration0": beta}
            self.prior_dist = pyro.distributions.Beta(alpha, beta).to_event(1)

        def get_prior(self) -> Callable:
            def prior(num_samples: int = 1) -> Any:
                return pyro.sample("parameters", self.prior_dist.expand_by([num_samples]))

            return prior

        def get_simulator(self, max_calls: int | None = None) -> Any:
            def simulator(parameters: Any) -> Any:
                rng = np.random.default_rng(torch.randint(2**62, (1,)).item())
                points = target.points_of_box(parameters.detach().numpy().astype(float))
                return _tensor(target.detections(points, rng).reshape(len(points), -1))

            return Simulator(task=self, simulator=simulator, max_calls=max_calls)

        def get_labels_parameters(self) -> list[str]:
            return list(target.coordinates)

        def get_labels_data(self) -> list[str]:
            return [f"{joint} {axis}" for joint in target.seen_joints for axis in "uv"]

        def get_observation(self, num_observation: int) -> Any:
            _require_first(target, num_observation)
            return _tensor(target.seen_at[target.seen].reshape(1, -1))

        def get_reference_posterior_samples(self, num_observation: int) -> Any:
            _require_first(target, num_observation)
            return exact[1:]

        def get_true_parameters(self, num_observation: int) -> Any:
            _require_first(target, num_observation)
            return exact[:1]

        def _get_transforms(self, *_: Any, **__: Any) -> dict[str, Any]:
            return {"parameters": torch.distributions.biject_to(self.prior_dist.support).inv}

        def _get_log_prob_fn(self, num_observation: int | None = None, **_: Any) -> Callable:
            _require_first(target, num_observation)

            def log_density(parameters: Any) -> Any:
                box = parameters["parameters"] if isinstance(parameters, dict) else parameters
                return _tensor(target.log_density_in_box(box.detach().numpy().astype(float)))

            return log_density

    return FrozenTask()


def _tensor(values: np.ndarray) -> Any:
    import torch

    return torch.as_tensor(values, dtype=torch.get_default_dtype())


def _require_first(target: FrozenTarget, num_observation: int | None) -> None:
    if num_observation != 1:
        raise BadInput(
            f"{target.name} has one observation, number 1, not {num_observation}; take"
            " num_observation=1"
        )
