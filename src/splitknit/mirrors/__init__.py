"""The finger's shape from one image: its outlines in front view and in mirrors beside it."""

from splitknit.mirrors.body import Slopes
from splitknit.mirrors.mirror import MirrorShape, mirror_shape
from splitknit.mirrors.outline import medial_line
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import Views, find_views, mirror_outline, view_binning, without_mirrors

__all__ = [
    "MirrorShape",
    "MirrorShapeSettings",
    "Slopes",
    "Views",
    "find_views",
    "medial_line",
    "mirror_outline",
    "mirror_shape",
    "view_binning",
    "without_mirrors",
]
