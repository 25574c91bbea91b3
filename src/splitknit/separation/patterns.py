"""Separation by measurement: direct and global light from images under high-frequency patterns.

Ways to the same two images, after Nayar et al. 2006 and the thesis's section 3.2.5: shifted checkerboards (by maximum
and minimum, by known states, or by their symmetry), phase-shifted sinusoids, a moving occluder, and one image at a
lower resolution. What "direct" means depends on the pattern's size: light that leaves the skin within a check of where
it entered still counts as direct.
"""

from splitknit.separation.checkerboard import checkerboard
from splitknit.separation.occluder import occluder
from splitknit.separation.single_image import single_image
from splitknit.separation.sinusoid import PhaseSeparation, sinusoid
from splitknit.separation.stacks import Separation, StackSettings
from splitknit.separation.states import check_shifts, checkerboard_patterns, estimate_patterns
from splitknit.separation.symmetry import by_symmetry

__all__ = [
    "PhaseSeparation",
    "Separation",
    "StackSettings",
    "by_symmetry",
    "check_shifts",
    "checkerboard",
    "checkerboard_patterns",
    "estimate_patterns",
    "occluder",
    "single_image",
    "sinusoid",
]
