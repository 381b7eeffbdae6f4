"""External samplers: those that are not among the product's baselines, each an entry point of the
group `poseterior.samplers`, declared by whichever package it is in (`entries`). Ours are those of
other libraries as they come (`nested`, `tempered`), and parallel tempering of our own (`ladder`),
as none of them has a non-reversible one. They climb the graded likelihood from the prior, because
an indicator gives nested and tempered samplers nothing to climb (`graded`)."""
