"""What is compiled is compiled once: another key, which gives every root another number of draws,
finds all programs there."""

import jax
import jax.numpy as jnp
import pytest

from poseterior import inference
from poseterior.probmodel import Estimate, PoseModel
from tests.scenes import drawer, key


def compiled(caplog: pytest.LogCaptureFixture) -> list[str]:
    """The programs that JAX has said it compiled since it was asked last."""
    said = [line for line in caplog.messages if line.startswith("Compiling ")]
    caplog.clear()
    return said


def test_another_key_compiles_nothing(
    example_estimate: Estimate, caplog: pytest.LogCaptureFixture
) -> None:
    assert len(example_estimate.candidates) == 2
    model = PoseModel()
    inference.sample(model, example_estimate, key=key(0), num_samples=100, root="candidates")
    with jax.log_compiles():
        for seed in (1, 2, 3):
            inference.sample(
                model, example_estimate, key=key(seed), num_samples=100, root="candidates"
            )
        assert compiled(caplog) == []
        jnp.asarray([1.0] * 1237) + 1.0  # the control: a shape that nobody else has
        assert compiled(caplog)


@pytest.mark.slow
def test_a_stream_under_an_uncertain_root_compiles_for_its_first_frame_alone(
    example_estimate: Estimate, caplog: pytest.LogCaptureFixture
) -> None:
    """Frames bring other numbers of roots and of draws; programs are as many as for one."""
    draw = drawer(PoseModel(), root="uncertain", num_samples=50, num_roots=20)
    draw(example_estimate, key(0))
    with jax.log_compiles():
        for seed in (1, 2):
            draw(example_estimate, key(seed))
        assert compiled(caplog) == []
        other = drawer(draw.model, root="uncertain", num_samples=51, num_roots=23)
        other(example_estimate, key(3))
        assert compiled(caplog) == []
