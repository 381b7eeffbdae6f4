"""A benchmark that samplers can be held to: frozen posteriors, high-dimensional, with many modes
and hard walls, of which exact draws and evidences are known.

    target = benchmark.load("arm")               # catalogue: every target by its name
    target.log_density(points)                   # target: the forms that samplers want, plain NumPy
    draws = benchmark.submit(target, points=…)   # submission: draws of any sampler, looked through
    benchmark.verdict(target, draws)             # verdicts: judged by exact draws (references)

What a sampler and its judge need is plain NumPy on tables that are frozen with the targets
(`anatomy`); `programs` has the same targets in JAX and NumPyro, `gym` for the inference gym;
`draws` makes more exact draws, and `freeze` is how all of it was made."""

import lazy_loader

# As in `inference`: importing a target does not bring JAX along.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
