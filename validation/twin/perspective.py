"""Light on a finger under a perspective camera against an orthographic one, at the same points of the skin.

Run ``python validation/twin/perspective.py``: half a minute. Both cameras stand 140 mm above a finger in the middle of
the picture. Light that came through the skin leaves it equally in all directions but for the Fresnel transmittance,
which is divided out: what remains is the error of a convolution in the image, with one pitch for the whole finger, of
a perspective picture. Printed for slants of the smooth skin and for each channel: median, and 5th to 95th percentile,
of the relative difference over seven white LEDs, where there is at least a tenth of the brightest light.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Led, default_rig
from splitknit_simulator.camera.lens import pixels_of_points
from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger, draw_finger, finger_surface
from splitknit_simulator.light.lighting import cut_out
from splitknit_simulator.light.renderer import render_band
from splitknit_simulator.light.skin import CHANNELS, Medium, SkinOptics, fresnel
from splitknit_simulator.surface import SimulatedSurface

SCALE = 0.25
SLANTS = ((0, 30), (30, 40), (40, 50), (50, 60), (60, 70))
Array32 = NDArray[np.float32]


def light(surface: SimulatedSurface, leds: tuple[Led, ...], skin: SkinOptics) -> Array32:
    """(L, C, H, W) light inside the skin before it leaves towards the camera."""
    patch = cut_out(surface)
    optics = [skin.channel(channel) for channel in CHANNELS]
    band = render_band(surface, leds, Medium(optics, skin.roughness, 0.0))
    leaving = np.sqrt(patch.nv**2 + (0.5 * skin.roughness) ** 2 * (1.0 - patch.nv**2))
    result = np.zeros((len(leds), len(optics), *surface.mask.shape), dtype=np.float32)
    result[(slice(None), slice(None), *band.window)] = band.diffuse / np.maximum(1.0 - fresnel(leaving), 1e-3)
    return result


def compare(finger: SimulatedFinger, scale: float = SCALE) -> tuple[Array32, Array32, NDArray[np.bool_]]:
    """Ratio (L, C, N) of perspective to orthographic light at points of the skin, slants (N,), and which count."""
    rig = default_rig(scale)
    rows, columns = rig.camera.image_size
    focal_px = rig.camera.px_per_mm * rig.camera.height_mm
    matrix = np.array([[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]])
    near = replace(rig.camera, model="perspective", matrix=matrix)
    pose, master, skin, leds = FingerPose(insertion_mm=26.5), finger.master(), SkinOptics(), rig.leds[:7]
    flat, spread = (finger_surface(replace(finger, printed=master), pose, camera) for camera in (rig.camera, near))
    assert spread.x_mm is not None and spread.y_mm is not None
    x, y, z = (np.nan_to_num(a).astype(np.float64) for a in (spread.x_mm, spread.y_mm, spread.height_mm))
    place = [a.astype(np.float32) for a in pixels_of_points(rig.camera, x, y, z)]
    inner = [cv2.erode(surface.mask.astype(np.uint8), np.ones((5, 5))) for surface in (flat, spread)]
    both = (cv2.remap(inner[0], *place, cv2.INTER_NEAREST) > 0) & (inner[1] > 0)
    reference = light(flat, leds, skin)
    found = light(spread, leds, skin)[..., both]
    there = np.empty(found.shape, dtype=np.float32)
    for k in range(found.shape[0]):
        for c in range(found.shape[1]):
            there[k, c] = cv2.remap(reference[k, c], *place, cv2.INTER_CUBIC)[both]
    bright = there > 0.1 * there.max(axis=(0, 2), keepdims=True)
    slant = np.rad2deg(np.arccos(np.clip(spread.shape_normals[both][:, 2], -1.0, 1.0)))
    return found / np.maximum(there, 1e-9), slant, bright


def main() -> None:
    """Print the table."""
    finger = draw_finger(3)
    smooth = replace(finger, skin=replace(finger.skin, ridge_depth_um=0.0, pore_depth_um=0.0, creases=()))
    ratio, slant, bright = compare(smooth)
    print(f"{'slant':>10}  " + "  ".join(f"{name:^24}" for name in CHANNELS))
    for low, high in SLANTS:
        part = (slant >= low) & (slant < high)
        cells = []
        for c in range(len(CHANNELS)):
            error = 100.0 * (ratio[:, c, part][bright[:, c, part]] - 1.0)
            fifth, half, most = np.percentile(error, [5, 50, 95])
            cells.append(f"{half:+6.2f} % [{fifth:+6.2f}, {most:+6.2f}]")
        print(f"{low:>3} to {high:>3}  " + "  ".join(f"{cell:^24}" for cell in cells))


if __name__ == "__main__":
    main()
