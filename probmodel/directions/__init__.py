"""Directions of bones: regions of the sphere, their supports and the distributions that live on
them."""
