"""Alias of :mod:`splitknit.photometric`, as it was called before; until version 1.0."""

from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light
from splitknit.photometric.robust import robust

__all__ = ["lambertian", "near_light", "robust"]
