"""Alias of :mod:`splitknit.integration`, as it was called before; until version 1.0."""

from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import shapelets

__all__ = ["frankot_chellappa", "poisson", "shapelets"]
