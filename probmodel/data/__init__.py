"""Embedded data: default anatomy and the example; PROVENANCE.md says where they come from."""
