"""The exact engine: draws of the posterior itself by rejection, and its evidence."""
