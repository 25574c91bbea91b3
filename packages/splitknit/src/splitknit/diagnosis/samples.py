"""Some of the photographs' pixels, which are enough to ask whether they go together with their
lights."""

from __future__ import annotations

from splitknit.diagnosis.parameters import (
    FRAME_SIDE,
)
from splitknit.imaging.band import linear_stack
from splitknit.model import Array, Band, Capture, FloatArray


def sampled_light(capture: Capture, band: Band) -> tuple[FloatArray, Array, tuple[slice, slice]]:
    """Grey linear light (L, h, w) at some of a band's pixels, its lights (L, 3), and which pixels
    these are."""
    every = max(1, max(capture.shape) // FRAME_SIDE)
    lights = capture.rig.select(band.lights).light_vectors()
    some = (slice(None, None, every), slice(None, None, every))
    return linear_stack(band.sampled(every), capture.encoding, "grey"), lights, some
