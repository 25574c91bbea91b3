"""What matching makes of a reconstruction: a template, and images for the thesis's matcher."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.reconstruction import Surface
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import Template, make_template
from splitknit_match.matching.thesis import FingerImages, ThesisSettings, finger_images


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """All that the settings of a comparison can change."""

    thesis: ThesisSettings = field(default_factory=ThesisSettings)


def surface_template(surface: Surface) -> Template:
    """Template of a reconstruction, without its print."""
    band = ridge_band(
        surface.ridge_mm,
        surface.mask,
        surface.pitch_mm,
        surface.shape_mm,
        surface.input_from_upright,
        upright_size=surface.upright_size,
    )
    return replace(make_template(band), kind="surface")


def surface_images(surface: Surface) -> FingerImages:
    """Channels for the thesis's matcher; where the surface is not split, its height is its
    relief."""
    across, up = height_gradients(surface.shape_mm, surface.pitch_mm)
    relief = surface.ridge_mm + surface.shape_mm if surface.whole else surface.ridge_mm
    return finger_images(
        surface.normals,
        normals_from_gradients(across, up),
        relief,
        surface.mask,
        surface.pitch_mm,
        input_from_upright=surface.input_from_upright,
        upright_size=surface.upright_size,
    )
