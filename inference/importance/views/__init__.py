"""Weighted sampling of one body in several views, and the slow route by which it is judged."""
