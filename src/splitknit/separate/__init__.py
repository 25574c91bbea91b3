"""What the skin does to light: scattering, glare, and how to undo both.

Direct light is measured by patterns (:mod:`splitknit.separate.patterns`) or drawn by the thesis's network
(:mod:`splitknit.separate.direct`).
"""

from splitknit.separate.colour import SpectralFit, cross_spectra, fit_spectra, unmixing_weights
from splitknit.separate.diffusion import Diffusion, SkinSettings, diffusion
from splitknit.separate.glare import GlareFit, fit_glare, fresnel_transmission, microfacet_glare
from splitknit.separate.local_wiener import LocalWienerSettings, local_wiener, window_power
from splitknit.separate.patterns import (
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
    "Diffusion",
    "GlareFit",
    "LocalWienerSettings",
    "PhaseSeparation",
    "Separation",
    "SkinSettings",
    "SpectralFit",
    "StackSettings",
    "check_shifts",
    "checkerboard",
    "checkerboard_patterns",
    "cross_spectra",
    "diffusion",
    "estimate_patterns",
    "fit_glare",
    "fit_spectra",
    "fresnel_transmission",
    "local_wiener",
    "microfacet_glare",
    "occluder",
    "single_image",
    "sinusoid",
    "unmixing_weights",
    "window_power",
]
