"""The judge: draws of any sampler against exact draws of the same posterior.

Plain arrays first (`distances`, `permutation`, `ranks`, `modes`, `mixing`, `cost`), a verdict from
them (`judge`), and a thin layer that reads and writes DataTrees (`sample`, `record`). Every p-value
comes with its sample size and what it takes for granted; "cannot tell" is an answer."""

from inference.studies.comparison.judge import Judgement, Test, judge
from inference.studies.comparison.record import comparison_tree
from inference.studies.comparison.sample import Sample, read_sample

__all__ = ["Judgement", "Sample", "Test", "comparison_tree", "judge", "read_sample"]
