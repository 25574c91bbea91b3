"""Direct and global light: measured by patterns (:mod:`splitknit.separation.patterns`), or estimated from one
photograph by the thesis's network (:mod:`splitknit.separation.direct`)."""

from splitknit.separation.patterns import (
    PhaseSeparation,
    Separation,
    StackSettings,
    check_shifts,
    checkerboard,
    checkerboard_patterns,
    estimate_patterns,
    occluder,
    single_image,
    sinusoid,
)

__all__ = [
    "PhaseSeparation",
    "Separation",
    "StackSettings",
    "check_shifts",
    "checkerboard",
    "checkerboard_patterns",
    "estimate_patterns",
    "occluder",
    "single_image",
    "sinusoid",
]
