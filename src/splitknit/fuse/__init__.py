"""Views of one finger, from the front and in mirrors, as one surface around it."""

from splitknit.fuse.blend import Blended, BlendSettings, blend, coverage_deg, seam_lines, seam_steps, view_weight
from splitknit.fuse.body import Body, body_from_outlines, outline
from splitknit.fuse.chart import Chart, chart_over, read, sampled, surface_normals
from splitknit.fuse.disparity import Disparity, DisparitySettings, disparity, ridge_band
from splitknit.fuse.light import facing_share, mirrored_share, reflected_corners
from splitknit.fuse.reflection import Plane, led_image, plane_of, reflect_points, reflect_vectors
from splitknit.fuse.register import Correction, align, shifts_by, warp_field
from splitknit.fuse.search import Found, SearchSettings, search
from splitknit.fuse.sight import Sight, heights

__all__ = [
    "BlendSettings",
    "Blended",
    "Body",
    "Chart",
    "Correction",
    "Disparity",
    "DisparitySettings",
    "Found",
    "Plane",
    "SearchSettings",
    "Sight",
    "align",
    "blend",
    "body_from_outlines",
    "chart_over",
    "coverage_deg",
    "disparity",
    "facing_share",
    "heights",
    "led_image",
    "mirrored_share",
    "outline",
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
    "warp_field",
]
