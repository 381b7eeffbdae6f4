"""Draws of a network of SLCP (bayesflow 2.1) beside truths, in bayesflow's own dictionaries, as a
file that `poseterior coverage judge` reads.

    python examples/posteriors/amortised.py coupling_flow 500 5 slcp_barely_trained.npz

Network, simulations to learn from, epochs, file. Needs bayesflow and one of Keras's backends."""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import bayesflow
import keras
import numpy as np
from slcp import SEEN, simulated

SEED = 51
INSTANCES = 150
DRAWS = 100
NAMES = ("parameters", "seen")


def main(network: str, simulations: int, epochs: int, path: Path) -> None:
    """Trains, draws, and writes draws, truths, and what was seen."""
    rng = np.random.default_rng(SEED)
    keras.utils.set_random_seed(SEED)
    truth, seen = simulated(INSTANCES, rng)
    workflow = bayesflow.BasicWorkflow(
        inference_network=network,
        inference_variables=NAMES[0],
        inference_conditions=NAMES[1],
        standardize="all",
    )
    data = dict(zip(NAMES, simulated(simulations, rng), strict=True))
    workflow.fit_offline(data, epochs=epochs, batch_size=min(256, simulations // 4), verbose=2)
    draws = workflow.sample(num_samples=DRAWS, conditions={NAMES[1]: seen})[NAMES[0]]
    made = {
        "seed": SEED,
        "simulations": simulations,
        "epochs": epochs,
        "estimator": network,
        "versions": {one: version(one) for one in ("bayesflow", "keras", "jax", "numpy")},
    }
    columns = {f"covariates.{name}": seen[:, at] for at, name in enumerate(SEEN)}
    np.savez_compressed(
        path,
        **{"estimates.parameters": draws.astype(np.float16)},
        **{"targets.parameters": truth.astype(np.float32)},
        **{name: column.astype(np.float32) for name, column in columns.items()},
        made=np.array(json.dumps(made)),
    )


if __name__ == "__main__":
    network, simulations, epochs, path = sys.argv[1:]
    main(network, int(simulations), int(epochs), Path(path))
