"""The judge: draws of any sampler against exact draws of the same posterior.

    compare(model, frame, ["rejection", "emcee"]).tree["summary"]       # the whole contest
    judge(read_sample(tree), read_sample(exact)).verdict                # draws that are there

Plain arrays first (`distances`, `permutation`, `ranks`, `modes`, `mixing`, `cost`), a verdict from
them (`judge`), and a thin layer that reads and writes DataTrees (`sample`, `record`). Every p-value
comes with its sample size and what it takes for granted; "cannot tell" is an answer."""

import lazy_loader

# As in `inference`: the judge does not bring JAX along.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
