"""Alias of :mod:`splitknit.photometric`, as it was called before; until version 1.0."""

from splitknit.photometric import lambertian, near_light, robust

__all__ = ["lambertian", "near_light", "robust"]
