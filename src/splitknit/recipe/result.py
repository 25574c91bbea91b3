"""The finished surface on the input's pixel grid."""

from __future__ import annotations

import numpy as np

from splitknit.model import Capture, FloatArray, Reconstruction
from splitknit.recipe.finger import Finger
from splitknit.recipe.presets import PipelineSettings
from splitknit.recipe.rays import place
from splitknit.recipe.surfaces import SurfaceParts


def assemble(capture: Capture, finger: Finger, surface: SurfaceParts, settings: PipelineSettings) -> Reconstruction:
    """Place the window's surface in the full image, cut to the mask, with the normals of the knitted height."""
    mask = finger.mask
    window = finger.window
    inside = mask[window]
    pitch = capture.rig.camera.pitch_mm

    def placed(part: FloatArray) -> FloatArray:
        whole = np.full(mask.shape, np.nan, dtype=np.float32)
        whole[window] = np.where(inside, part, np.float32(np.nan))
        return whole

    camera, top_mm = capture.rig.camera, settings.top_mm
    done = place(surface.height_mm, surface.shape_mm, inside, camera, window, top_mm)
    flat = done.x_mm is None or done.y_mm is None
    normals = np.zeros((*mask.shape, 3), dtype=np.float32)
    normals[window] = done.normals
    return Reconstruction(
        height_mm=placed(done.height_mm),
        ridge_mm=placed(surface.ridge_mm if flat else done.height_mm - done.shape_mm),
        shape_mm=placed(done.shape_mm),
        mask=mask,
        normals=normals,
        albedo=placed(surface.albedo),
        pitch_mm=pitch,
        x_mm=None if done.x_mm is None else placed(done.x_mm),
        y_mm=None if done.y_mm is None else placed(done.y_mm),
        input_from_upright=finger.upright.input_from_upright,
        upright_size=finger.upright.size,
        preset="",
        uncertainty_um=None if surface.uncertainty_um is None else placed(surface.uncertainty_um),
        quality=finger.quality,
        facts={**finger.facts, **surface.facts},
    )
