"""A finger in front of the camera: its pictures under every LED, as the sensor stores them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Band, Camera, FloatArray, Led, PixelArray, Rig
from splitknit.simulator.background import background_albedo, hand_shadow
from splitknit.simulator.coloured import photograph_coloured
from splitknit.simulator.defocus import blur_sigma_px, defocus
from splitknit.simulator.diffusion import WalkTable
from splitknit.simulator.lens import fall_off, px_per_mm_at
from splitknit.simulator.lighting import finger_window, white_card
from splitknit.simulator.renderer import BandLight, RenderSettings, render_ambient, render_band
from splitknit.simulator.sensor import binning_scale, record
from splitknit.simulator.skin import BAND_CHANNELS, ChannelOptics, SkinSettings
from splitknit.simulator.surface import Surface

if TYPE_CHECKING:
    from splitknit.simulator.twin import TwinSettings


class Scene:
    """One finger in front of the camera."""

    def __init__(
        self,
        subject: tuple[Surface, Rig, SkinSettings],
        settings: TwinSettings,
        rng: np.random.Generator,
        walks: WalkTable,
    ) -> None:
        """Lay the background, whose dust `rng` draws, and find how far each pixel is out of focus."""
        surface, rig, skin = subject
        self.surface, self.rig, self.skin, self.settings, self.walks = surface, rig, skin, settings, walks
        self.albedo = np.where(surface.mask, 0, background_albedo(rig.camera, settings.background, rng))
        self.shade = hand_shadow(rig.camera, settings.background)
        self.scale = settings.sensor_scale or binning_scale(rig.camera)
        self.fall_off = fall_off(rig.camera) if rig.camera.shading else None
        self.blur = finger_blur(surface, settings.render)

    def photograph(self, name: str, seed: np.random.SeedSequence) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
        """Images of one band, the glare (L, H, W) in the images' units, and the exposure (one number).

        Glare and exposure are those of the middle of the lens: what the images are divided by its fall-off.
        """
        members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
        leds = [self.rig.leds[k] for k in members]
        if any(led.colour for led in leds):
            return photograph_coloured(self, name, seed)
        optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
        skin, render = self.skin, self.settings.render
        light = render_band(
            self.surface, leds, optics, roughness=skin.roughness, glare=skin.glare, walks=self.walks, settings=render
        )
        fallen = None if self.fall_off is None else self.fall_off[light.window]
        exposure = np.float32(self.settings.sensor.exposure / brightest(light.diffuse, fallen))
        ambient = self.ambient(name, leds)
        seeds = seed.spawn(len(leds) + 1)
        height, width = self.rig.camera.image_size
        glare = np.zeros((len(leds), height, width), dtype=np.float16)

        def shoot(k: int) -> PixelArray:
            frame = ambient + self.frame(
                light, k, white_card(self.rig.camera, leds[k], -self.settings.background.depth_mm)
            )
            glare[k][light.window] = light.glare[k] * self.shade[light.window[0]] * exposure
            return self.record(frame * exposure, name, seeds[k])

        with ThreadPoolExecutor(render.workers) as pool:
            images = list(pool.map(shoot, range(len(leds))))
        dark = self.record(np.broadcast_to(ambient, (height, width, 3)) * exposure, name, seeds[-1])
        band = Band(
            name=name,
            pixels=_stack(images),
            leds=tuple((k,) for k in members),
            exposure=np.ones(len(leds)),
            black_level=np.zeros(len(leds)),
            ambient=dark,
            shading=self.rig.camera.shading,
        )
        return band, glare, np.array(float(exposure))

    def frame(self, light: BandLight, k: int, card: FloatArray) -> FloatArray:
        """(H, W, 3) radiance of the whole frame under light k."""
        frame = np.repeat((card * self.albedo)[..., None], 3, axis=2)
        window = frame[light.window]
        for c in range(3):
            diffuse = light.diffuse[k, min(c, light.diffuse.shape[1] - 1)]
            window[..., c] += diffuse + light.glare[k]
        frame *= self.shade[..., None]
        return frame

    def ambient(self, name: str, leds: list[Led]) -> FloatArray:
        """(H, W, 3) radiance of the frame with all LEDs off."""
        optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
        level = room_level(self.rig.camera, leds, self.settings.background.ambient)
        return room_light(
            self.surface, self.albedo, level, optics, self.skin.roughness, walks=self.walks, render=self.settings.render
        )

    def record(self, frame: FloatArray, name: str, seed: np.random.SeedSequence) -> PixelArray:
        """(H, W, 3) what the sensor stores of the radiance (H, W, 3) times the exposure."""
        if self.blur is not None:
            frame = defocus(frame, self.blur)
        if self.fall_off is not None:
            frame = frame * self.fall_off[..., None]
        return record(frame, name, seed, self.settings.sensor, self.scale)


def room_level(camera: Camera, leds: Sequence[Led], share: float) -> float:
    """Radiance of a white card under the room's light: `share` of that under one LED (mean of all)."""
    return share * float(np.mean([white_card(camera, led, step=10**6).mean() for led in leds]))


def room_light(
    surface: Surface,
    albedo: FloatArray,
    level: float,
    optics: Sequence[ChannelOptics],
    roughness: float,
    *,
    walks: WalkTable,
    render: RenderSettings,
) -> FloatArray:
    """(H, W, 3) radiance of finger and background `albedo` (H, W) under a room that gives a white card `level`."""
    frame = np.repeat((np.float32(level) * albedo)[..., None], 3, axis=2)
    if level > 0.0:
        skin = render_ambient(surface, level, optics, roughness=roughness, walks=walks, settings=render)
        window = frame[finger_window(surface)]
        for c in range(3):
            window[..., c] += skin[min(c, skin.shape[0] - 1)]
    return np.asarray(frame, dtype=np.float32)


def finger_blur(surface: Surface, settings: RenderSettings) -> FloatArray | None:
    """(H, W) defocus in pixels (standard deviation) by the finger's depth, or None where it is switched off."""
    if settings.aperture_mm == 0.0:
        return None
    camera = surface.camera
    depth, top = finger_depth(surface)
    focus = top - settings.focus_depth_mm
    return blur_sigma_px(depth, focus, camera.height_mm, settings.aperture_mm, px_per_mm_at(camera, focus))


def finger_depth(surface: Surface) -> tuple[FloatArray, float]:
    """(H, W) z of the finger's shape in mm, and that of its highest point.

    Beyond the outline that of the outline goes on: the dark background shows no blur of its own.
    """
    mask = surface.mask
    z = np.where(mask, surface.shape_mm, 0).astype(np.float32)
    weight, size = mask.astype(np.float32), 0.5 * surface.camera.px_per_mm
    near = cv2.GaussianBlur(z, (0, 0), size) / np.maximum(cv2.GaussianBlur(weight, (0, 0), size), 1e-3)
    return np.where(mask, z, near).astype(np.float32), float(z[mask].max())


def _stack(images: list[PixelArray]) -> PixelArray:
    stacked: PixelArray = np.stack(images)  # type: ignore[assignment]
    return stacked


def brightest(diffuse: FloatArray, fall_off: FloatArray | None = None) -> float:
    """99.9th percentile of the diffuse light behind the lens over all lights, in the channel where it is highest."""
    sample = diffuse[:, :, ::4, ::4]
    if fall_off is not None:
        sample = sample * fall_off[::4, ::4]
    values = [np.percentile(sample[:, c][sample[:, c] > 0], 99.9) for c in range(sample.shape[1])]
    return float(max(values))
