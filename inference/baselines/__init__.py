"""Baseline samplers: MCMC, nested and tempered, on the same posterior as the exact engine."""
