"""The finished surface on the input's pixel grid."""

from __future__ import annotations

import numpy as np

from splitknit.geometry import height_gradients, normals_from_gradients
from splitknit.recipe.finger import Finger
from splitknit.recipe.surfaces import SurfaceParts
from splitknit.types import Capture, FloatArray, Reconstruction


def assemble(capture: Capture, finger: Finger, surface: SurfaceParts) -> Reconstruction:
    """Place the window's surface in the full image, cut to the mask, with the normals of the knitted height."""
    mask = finger.mask
    window = finger.window
    inside = mask[window]
    pitch = capture.rig.camera.pitch_mm

    def placed(part: FloatArray) -> FloatArray:
        whole = np.full(mask.shape, np.nan, dtype=np.float32)
        whole[window] = np.where(inside, part, np.float32(np.nan))
        return whole

    height = np.where(inside, surface.height_mm, np.float32(np.nan)).astype(np.float32)
    normals = np.zeros((*mask.shape, 3), dtype=np.float32)
    normals[window] = normals_from_gradients(*height_gradients(height, pitch)) * inside[..., None]
    return Reconstruction(
        height_mm=placed(surface.height_mm),
        ridge_mm=placed(surface.ridge_mm),
        shape_mm=placed(surface.shape_mm),
        mask=mask,
        normals=normals,
        albedo=placed(surface.albedo),
        pitch_mm=pitch,
        input_from_upright=finger.upright.input_from_upright,
        upright_size=finger.upright.size,
        preset="",
        uncertainty_um=None if surface.uncertainty_um is None else placed(surface.uncertainty_um),
        quality=finger.quality,
        facts={**finger.facts, **surface.facts},
    )
