"""A sample of the photographs' pixels, enough to check them against their lights."""

from __future__ import annotations

from splitknit.imaging.pixels import Window
from splitknit.model import Array, FloatArray
from splitknit.observation.light import Light


def sampled_light(light: Light) -> tuple[FloatArray, Array, Window]:
    """Grey linear light (L, h, w) at some pixels, its lights (L, 3), and which pixels these are."""
    # images of at least so many pixels a side are enough to detect in which frame the lights were
    # measured
    every = max(1, max(light.shape) // 300)
    lights = light.rig.light_vectors()
    some = (slice(None, None, every), slice(None, None, every))
    return light.sampled(every).grey, lights, some
