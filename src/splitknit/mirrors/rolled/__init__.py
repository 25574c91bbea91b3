"""Views of one finger, from the front and in mirrors, as one surface around it."""

from splitknit.mirrors.rolled.blend import (
    Blended,
    BlendSettings,
    blend,
    coverage_deg,
    seam_lines,
    seam_steps,
    view_weight,
)
from splitknit.mirrors.rolled.chart import Chart, Sight, chart_over, heights, read, sampled, surface_normals
from splitknit.mirrors.rolled.reflection import (
    Plane,
    facing_share,
    led_image,
    mirrored_share,
    plane_of,
    reflect_points,
    reflect_vectors,
    reflected_corners,
)
from splitknit.mirrors.rolled.register import Correction, Seen, align, ridge_band, shifts_by
from splitknit.mirrors.rolled.search import Found, SearchSettings, search

__all__ = [
    "BlendSettings",
    "Blended",
    "Chart",
    "Correction",
    "Found",
    "Plane",
    "SearchSettings",
    "Seen",
    "Sight",
    "align",
    "blend",
    "chart_over",
    "coverage_deg",
    "facing_share",
    "heights",
    "led_image",
    "mirrored_share",
    "plane_of",
    "read",
    "reflect_points",
    "reflect_vectors",
    "reflected_corners",
    "ridge_band",
    "sampled",
    "seam_lines",
    "seam_steps",
    "search",
    "shifts_by",
    "surface_normals",
    "view_weight",
]
