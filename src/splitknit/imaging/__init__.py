"""From stored pixel values to linear light.

A stored value v becomes (decode(v) - decode(black)) / exposure, less the ambient light treated the same way. Values
are relative to the full scale of the file (255 or 65535), so an unscaled image lies in [0, 1].
"""

from splitknit.imaging.band import (
    CHANNELS,
    GREY_WEIGHTS,
    Window,
    bin_mean,
    decode_table,
    has_colour,
    linear_channels,
    linear_image,
    linear_stack,
    linear_survey,
    pick_channel,
    saturation_levels,
)
from splitknit.imaging.view import lens_shading, shading_at

__all__ = [
    "CHANNELS",
    "GREY_WEIGHTS",
    "Window",
    "bin_mean",
    "decode_table",
    "has_colour",
    "lens_shading",
    "linear_channels",
    "linear_image",
    "linear_stack",
    "linear_survey",
    "pick_channel",
    "saturation_levels",
    "shading_at",
]
