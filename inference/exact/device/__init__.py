"""Exact rejection by strata on the device that JAX computes on."""
