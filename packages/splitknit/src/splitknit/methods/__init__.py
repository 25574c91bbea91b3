"""The algorithm: photographs of a finger in, its surface out; one function a method, and one table
of them all."""

from __future__ import annotations

from collections.abc import Callable

from splitknit.methods.metric import opaque_surface, skin_surface, undoes_blur
from splitknit.methods.photographs import FingerPhotographs, FingerSurface
from splitknit.methods.thesis import thesis_surface
from splitknit.presets import PipelineSettings

METHODS: dict[str, Callable[[FingerPhotographs, PipelineSettings], FingerSurface]] = {
    "thesis": thesis_surface,
    "opaque": opaque_surface,
    "skin": skin_surface,
}
"""The methods by name. A shape from mirrors replaces that of any of them
(:func:`splitknit.methods.photographs.on_mirror_shape`)."""


def method_for(photographs: FingerPhotographs, settings: PipelineSettings) -> str:
    """Name of the method that these settings choose for these photographs."""
    if settings.method == "thesis":
        return "thesis"
    return "skin" if undoes_blur(photographs.observation.material, settings.skin) else "opaque"
