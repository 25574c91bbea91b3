"""Alias of :mod:`splitknit.integration`, as it was called before; until version 1.0."""

from splitknit.integration import frankot_chellappa, poisson, shapelets

__all__ = ["frankot_chellappa", "poisson", "shapelets"]
