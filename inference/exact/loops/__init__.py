"""Compiled loops over strata, and the tables they share."""
