"""Small pieces of simulated fingers to train the relief's network on, each with its own skin, lights and exposure.

A piece takes a tenth of the time of a whole finger, so that a network sees ten times as many kinds of skin. There is no
reconstruction of a piece: its smooth shape is the true one with a random smooth error.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.training.relief_data import TruthOnGrid, assembled, light_on
from splitknit.apps.training.relief_scenes import ReliefData
from splitknit.apps.training.scene_ranges import draw_base, draw_finger_of, moved_rig
from splitknit.errors import require
from splitknit.model import FloatArray, Rig, default_rig
from splitknit.pipeline import preset_settings
from splitknit.simulator.camera.sensor import SensorSettings, record
from splitknit.simulator.finger.finger import PoseRanges, finger_surface
from splitknit.simulator.light.renderer import BandLight, RenderSettings, render_band
from splitknit.simulator.light.skin import BAND_CHANNELS, SkinSettings, WalkTable, load_walks
from splitknit.simulator.surface import Surface
from splitknit.skin.bands import BandImages
from splitknit.skin.grid import Grid
from splitknit.training.relief import WEIGHT

TRIM_PX = 60
"""Rim of a piece that is rendered but not kept: light from beyond the piece is missing there."""
LEAST_SKIN = 0.35
"""Pieces of which less than this part is skin are not rendered."""
LEAST_TRUST = 0.2
"""Pieces whose mean weight is less are not kept."""
BRIGHTEST = 0.72
EXPOSURE = (0.55, 1.05)
"""Times :data:`BRIGHTEST`, the brightest diffuse light of a piece over the sensor's full scale."""
BLUR_PX = (0.3, 1.2)
"""Standard deviation of the defocus of a part of the pieces."""
BLUR_SHARE = 0.25
SHIFT_MM = 0.5
TILT = 0.06
BEND_PER_MM = 0.01
"""Standard deviations of the smooth shape's error: a shift, slopes along both axes, and three second-order terms."""


def training_crops(number: int, data: ReliefData) -> NDArray[np.float16]:
    """Samples (n, 41, h, w) of pieces of the finger `number`; see ``separate.train_relief_batches``.

    Raises
    ------
    BadInput
        If the images are smaller than a piece, or not one piece holds enough skin.
    """
    rng = np.random.default_rng([number, 78])
    usual = rng.random() < data.crop_usual_share
    scale = data.scale if usual else float(rng.uniform(*data.other_scale))
    finger = draw_finger_of(number, rng, data)
    camera = default_rig(scale).camera
    side = data.crop_px
    require(
        min(camera.image_size) >= side > 2 * TRIM_PX,
        f"pieces of {side} pixels do not fit into images of {camera.image_size[0]} x {camera.image_size[1]}, "
        f"or are not larger than twice their rim of {TRIM_PX}.",
    )
    surface = finger_surface(finger, PoseRanges().draw(rng, camera), camera, workers=1)
    walks = load_walks()
    rows, columns = np.nonzero(surface.mask)
    found = []
    for piece in range(data.crops):
        i = int(rng.integers(len(rows)))
        middle = (int(rows[i]), int(columns[i]))
        corner = [
            min(max(at - side // 2, 0), length - side) for at, length in zip(middle, surface.mask.shape, strict=True)
        ]
        window = (slice(corner[0], corner[0] + side), slice(corner[1], corner[1] + side))
        if surface.mask[window].mean() < LEAST_SKIN:
            continue
        skin = data.skin(draw_base(rng, data)).draw(rng)
        rig = _rig(rng, scale, data)
        sample = _sample(surface, window, (skin, rig, scale), (number, piece), rng, walks)
        if sample[WEIGHT].mean(dtype=np.float32) >= LEAST_TRUST:
            found.append(sample)
    require(len(found) > 0, f"not one piece of {side} pixels of finger {number} holds enough skin.")
    return np.stack(found)


def _rig(rng: np.random.Generator, scale: float, data: ReliefData) -> Rig:
    """The white lights of a rig."""
    rig = default_rig(scale, int(rng.integers(10_000)))
    rig = replace(rig, leds=tuple(led for led in rig.leds if led.band == "white"))
    return moved_rig(rig, rng, data) if rng.random() < data.other_rig_share else rig


def _sample(  # noqa: PLR0917
    surface: Surface,
    window: tuple[slice, slice],
    scene: tuple[SkinSettings, Rig, float],
    name: tuple[int, int],
    rng: np.random.Generator,
    walks: WalkTable,
) -> NDArray[np.float16]:
    """Photograph one piece and describe it."""
    skin, rig, scale = scene
    mask = np.zeros_like(surface.mask)
    mask[window] = surface.mask[window]
    optics = [skin.channel(channel) for channel in BAND_CHANNELS["white"]]
    light = render_band(
        replace(surface, mask=mask),
        rig.leds,
        optics,
        roughness=skin.roughness,
        glare=skin.glare,
        walks=walks,
        settings=RenderSettings(workers=1),
    )
    diffuse, glare = (_placed(part, light, window) for part in (light.diffuse, light.glare))
    inside = mask[window]
    brightest = max(float(np.percentile(diffuse[:, :, inside], 99.5)), 1e-12)
    exposure = np.float32(BRIGHTEST / brightest * rng.uniform(*EXPOSURE))
    blur_px = float(rng.uniform(*BLUR_PX)) if rng.random() < BLUR_SHARE else 0.0
    images = []
    for k in range(len(rig.leds)):
        frame = np.moveaxis((diffuse[k] + glare[k]) * exposure, 0, -1)
        if blur_px > 0:
            frame = cv2.GaussianBlur(frame, (0, 0), blur_px)
        seed = np.random.SeedSequence([*name, k])
        stored = record(np.ascontiguousarray(frame), "white", seed, SensorSettings(), scale)
        images.append(np.moveaxis(stored.astype(np.float32) / np.float32(255), -1, 0))
    white = BandImages(("red", "green", "blue"), np.stack(images, axis=1), rig)
    pitch_mm = rig.camera.pitch_mm
    (height, width), (rows, columns) = surface.mask.shape, window
    x = (np.arange(columns.start, columns.stop) - (width - 1) / 2) * pitch_mm
    y = ((height - 1) / 2 - np.arange(rows.start, rows.stop)) * pitch_mm
    grid = Grid(np.ascontiguousarray(inside), x, y, pitch_mm, (False,) * 4)
    truth = {
        "mask": inside,
        "height_mm": surface.height_mm[window],
        "shape_mm": surface.shape_mm[window],
        "glare_white": glare * exposure,
    }
    on_grid = TruthOnGrid(truth, (slice(None), slice(None)), grid, 1)
    smooth = on_grid.shape_mm() + _smooth_error(rng, grid)
    lights = light_on(rig, grid, smooth, preset_settings("metric").metric.coarse_pitch_mm)
    sample = assembled(white, grid, smooth, lights, on_grid)
    return np.ascontiguousarray(sample[:, TRIM_PX:-TRIM_PX, TRIM_PX:-TRIM_PX])


def _placed(light: FloatArray, band: BandLight, window: tuple[slice, slice]) -> FloatArray:
    """Rendered light (..., h, w), whose own window is that of the skin, on the piece; zero around it."""
    sides = [part.stop - part.start for part in window]
    piece = np.zeros((*light.shape[:-2], *sides), dtype=np.float32)
    into: list[slice] = []
    source: list[slice] = []
    for length, own, part in zip(light.shape[-2:], band.window, window, strict=True):
        start = own.start - part.start
        low, high = max(start, 0), min(start + length, part.stop - part.start)
        into.append(slice(low, high))
        source.append(slice(low - start, high - start))
    piece[..., into[0], into[1]] = light[..., source[0], source[1]]
    return piece


def _smooth_error(rng: np.random.Generator, grid: Grid) -> FloatArray:
    """What a smooth shape (h, w) may be wrong by, mm."""
    x, y = np.meshgrid(grid.x_mm - grid.x_mm.mean(), grid.y_mm - grid.y_mm.mean())
    spreads = (SHIFT_MM, TILT, TILT, BEND_PER_MM, BEND_PER_MM, BEND_PER_MM)
    terms = (np.ones_like(x), x, y, x * x, y * y, x * y)
    total = sum(rng.normal(0, spread) * term for spread, term in zip(spreads, terms, strict=True))
    return np.asarray(total, dtype=np.float32)
