"""A strict session: 64-bit floats, no implicit promotion of ranks, warnings are errors (see
pyproject)."""

from pathlib import Path

import jax
import numpyro.distributions  # noqa: F401 — whole, before a test that breaks off a command can break off this import
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

SHARED = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real motion capture, detections and published tables, which is not part of the
    repository."""
    if not SHARED.is_dir():
        pytest.skip(
            "the shared data pack (motion capture, detections, published limits) is not beside the"
            " checkout"
        )
    return SHARED
