"""Skin: scattering and specular light, and how the `metric` method undoes both, by analysis and synthesis.

A current surface predicts what photometric stereo would find on it behind the skin's blur; the difference from what it
did find, unmixed from glare by colour, corrects the surface. First the shape on a coarse grid, from all bands; then the
ridges on a fine grid, from the colours of the white band; and again, because ridges bias the shape (the mean normal of
a ridged slope is flatter than the slope).
"""

from splitknit.skin.colour import SpectralFit, cross_spectra, fit_spectra, unmixing_weights
from splitknit.skin.diffusion import Diffusion, SkinSettings, diffusion
from splitknit.skin.glare import GlareFit, fit_glare, fresnel_transmission, microfacet_glare
from splitknit.skin.learned import Networks, can_learn
from splitknit.skin.relief import LocalWienerSettings, local_wiener, window_power
from splitknit.skin.surface import MetricSettings, SkinSurface, first_shape, reconstruct_skin

__all__ = [
    "Diffusion",
    "GlareFit",
    "LocalWienerSettings",
    "MetricSettings",
    "Networks",
    "SkinSettings",
    "SkinSurface",
    "SpectralFit",
    "can_learn",
    "cross_spectra",
    "diffusion",
    "first_shape",
    "fit_glare",
    "fit_spectra",
    "fresnel_transmission",
    "local_wiener",
    "microfacet_glare",
    "reconstruct_skin",
    "unmixing_weights",
    "window_power",
]
