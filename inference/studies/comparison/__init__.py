"""The judge: draws of any sampler against exact draws of the same posterior.

    compare(model, frame, ["rejection", "emcee"]).tree["summary"]       # the whole contest
    judge(read_sample(tree), read_sample(exact)).verdict                # draws that are there

Plain arrays first (`distances`, `permutation`, `ranks`, `modes`, `mixing`, `cost`), a verdict from
them (`judge`), and a thin layer that reads and writes DataTrees (`sample`, `record`). Every p-value
comes with its sample size and what it takes for granted; "cannot tell" is an answer."""

from inference.studies.comparison.contest import Comparison, compare
from inference.studies.comparison.judge import Judgement, Test, judge
from inference.studies.comparison.record import comparison_tree
from inference.studies.comparison.sample import Sample, read_sample

__all__ = [
    "Comparison",
    "Judgement",
    "Sample",
    "Test",
    "compare",
    "comparison_tree",
    "judge",
    "read_sample",
]
