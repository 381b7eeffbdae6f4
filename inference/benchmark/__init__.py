"""Frozen targets."""
