"""How draws are made: one file for each way, one face for all of them in `inference.sampler`."""
