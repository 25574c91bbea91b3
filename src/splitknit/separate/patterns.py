"""Separation by measurement: direct and global light from images under high-frequency patterns.

Ways to the same two images, after Nayar et al. 2006 and the thesis's section 3.2.5: shifted checkerboards (by maximum
and minimum, by known states, or by their symmetry), phase-shifted sinusoids, a moving occluder, and one image at a
lower resolution. What "direct" means depends on the pattern's size: light that leaves the skin within a check of where
it entered still counts as direct.
"""

from splitknit.separate.checkerboard import checkerboard
from splitknit.separate.occluder import occluder
from splitknit.separate.single_image import single_image
from splitknit.separate.sinusoid import PhaseSeparation, sinusoid
from splitknit.separate.stacks import Separation, StackSettings
from splitknit.separate.states import check_shifts, checkerboard_patterns, estimate_patterns
from splitknit.separate.symmetry import by_symmetry

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
