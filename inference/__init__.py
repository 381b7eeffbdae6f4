"""How a posterior is computed: estimators of torso and camera, samplers with one face, hypotheses.

frame = inference.estimate_torso(detection)
result = inference.sample(model, frame, key=jax.random.key(0), num_samples=10_000)
"""

import lazy_loader

# Every name stands in `__init__.pyi` and is looked up when first used: what a command does not need
# it does not wait for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
