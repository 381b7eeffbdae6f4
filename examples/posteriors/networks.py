"""Draws of a network of a task (NPE of sbi 0.27, a spline flow) beside truths, as files that
`poseterior coverage judge` reads.

    python examples/posteriors/networks.py two_moons 300 3 two_moons_barely_trained.npz
    python examples/posteriors/networks.py two_moons 5000 50 two_moons_trained.npz
    python examples/posteriors/networks.py slcp 30000 150 slcp_trained.npz

Task, simulations to learn from, most epochs, file. Needs sbi and PyTorch."""

import json
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from sbi.inference import NPE
from sbi.utils import BoxUniform

SEED = 49
INSTANCES = 150
DRAWS = 100
QUIET = {"show_progress_bars": False}


def main(task: str, simulations: int, epochs: int, path: Path) -> None:
    """Trains, draws, and writes draws, truths, log densities of the network, and what was seen."""
    of = import_module(task)
    rng = np.random.default_rng(SEED)
    torch.manual_seed(SEED)
    truth, seen = of.simulated(INSTANCES, rng)
    edge = of.EDGE * torch.ones(len(of.NAMES))
    network = NPE(BoxUniform(-edge, edge), density_estimator="nsf", **QUIET)
    network.append_simulations(*map(_tensor, of.simulated(simulations, rng)))
    network.train(max_num_epochs=epochs)
    posterior = network.build_posterior()
    draws = np.stack(
        [
            posterior.sample((DRAWS,), x=one, max_sampling_batch_size=DRAWS, **QUIET).numpy()
            for one in _tensor(seen)
        ]
    )
    points = _tensor(np.concatenate([truth[:, None], draws], axis=1))
    density = torch.stack(
        [
            posterior.log_prob(some, x=one, norm_posterior=False)
            for some, one in zip(points, _tensor(seen), strict=True)
        ]
    ).numpy()
    made = {
        "seed": SEED,
        "simulations": simulations,
        "most epochs": epochs,
        "epochs": network.summary["epochs_trained"][-1],
        "estimator": "NPE, nsf",
        "versions": {one: version(one) for one in ("sbi", "torch", "numpy")},
    }
    np.savez_compressed(
        path,
        draws=draws.astype(np.float32),
        truth=truth.astype(np.float32),
        names=np.array(of.NAMES),
        log_density_truth=density[:, 0],
        log_density=density[:, 1:],
        covariates=seen.astype(np.float32),
        covariate_names=np.array(of.SEEN),
        made=np.array(json.dumps(made)),
    )


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


if __name__ == "__main__":
    task, simulations, epochs, path = sys.argv[1:]
    main(task, int(simulations), int(epochs), Path(path))
