"""A whole capture of the digital twin: finger, skin, lights, background and sensor, with the truth."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.simulate.background import BackgroundSettings, background_albedo, hand_shadow
from splitknit.simulate.defocus import blur_sigma_px, defocus
from splitknit.simulate.diffusion import WalkTable, load_walks
from splitknit.simulate.finger import Finger, Pose, draw_finger, finger_surface
from splitknit.simulate.lens import fall_off, px_per_mm_at
from splitknit.simulate.lighting import finger_window, white_card
from splitknit.simulate.pose_ranges import PoseRanges
from splitknit.simulate.renderer import BandLight, RenderSettings, render_ambient, render_band
from splitknit.simulate.rig import default_rig
from splitknit.simulate.sensor import SensorSettings, binning_scale, record
from splitknit.simulate.skin import BAND_CHANNELS, SkinRanges, SkinSettings
from splitknit.simulate.surface import Surface
from splitknit.simulate.truth import optics_truth, surface_truth
from splitknit.types import Band, Capture, FloatArray, Led, PixelArray, Rig


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """One simulated capture."""

    scale: float = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels; not used where `rig` is given."""
    rig: Rig | None = None
    """Camera and LEDs as they are: any camera model, size, height, aims and lobes. None: the thesis's rig, made from
    `scale`, `rig_seed` and `intensity_spread`."""
    sensor_scale: float | None = None
    """Side of the sensor's pixels over side of a picture's pixels, for the noise: 1 = full resolution, 0.5 = 2 x 2
    binned. None: as :func:`splitknit.simulate.sensor.binning_scale` tells it of the camera."""
    rig_seed: int | None = 0
    """Seed of the LEDs' individual intensities; None makes them equal."""
    intensity_spread: float = 0.1
    """Standard deviation of the LEDs' intensities."""
    skin: SkinSettings | SkinRanges = field(default_factory=SkinRanges)
    """The skin itself, or the ranges from which each finger's is drawn."""
    pose: Pose | PoseRanges = field(default_factory=PoseRanges)
    """The pose itself, or the ranges from which each impression's is drawn."""
    render: RenderSettings = field(default_factory=RenderSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)

    def __post_init__(self) -> None:
        require(
            self.sensor_scale is None or 0.0 < self.sensor_scale <= 1.0,
            f"twin.sensor_scale must lie in (0, 1] or be None, but it is {self.sensor_scale}.",
        )


def simulate_capture(
    seed: int,
    pattern: str | None = None,
    settings: TwinSettings | None = None,
    *,
    impression: int = 0,
    finger: Finger | None = None,
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Simulate one capture of one person's finger.

    Parameters
    ----------
    seed : of the person: finger, print and skin follow from it
    pattern : class of the print (``arch``, ``left_loop``, ``whorl``, ...); None draws it
    settings : of the twin
    impression : number of the capture of this finger: pose, dust and noise change with it
    finger : photographed instead of the one that `seed` draws

    Returns
    -------
    capture : 8-bit (or 16-bit) images of both bands with ambient frames, and the rig
    truth : arrays by name, see ``docs/twin.md``

    Notes
    -----
    The same arguments give the same bytes, whatever the number of workers.
    """
    settings = settings or TwinSettings()
    require(seed >= 0 and impression >= 0, "seed and impression must not be negative.")
    rig = settings.rig or default_rig(settings.scale, settings.rig_seed, settings.intensity_spread)
    finger = finger or draw_finger(seed, pattern)
    person = np.random.default_rng(np.random.SeedSequence([seed, 0x51]))
    pose_seed, photo_seed = np.random.SeedSequence([seed, impression, 0x52]).spawn(2)
    skin = settings.skin if isinstance(settings.skin, SkinSettings) else settings.skin.draw(person)
    if isinstance(settings.pose, Pose):
        pose = settings.pose
    else:
        pose = settings.pose.draw(np.random.default_rng(pose_seed), rig.camera)
    surface = finger_surface(finger, pose, rig.camera, workers=settings.render.workers)
    capture, truth = photograph(surface, rig, skin, photo_seed, settings=settings)
    subject = {"id": "anonymous", "finger": "simulated", "session": impression + 1}
    return replace(capture, subject=subject), truth


def photograph(
    surface: Surface,
    rig: Rig,
    skin: SkinSettings,
    seed: np.random.SeedSequence,
    *,
    settings: TwinSettings | None = None,
    walks: WalkTable | None = None,
) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Photograph `surface` under every LED of `rig`.

    Parameters
    ----------
    surface : on the pixels of `rig.camera`
    rig : LEDs of the bands ``white`` and ``nir``; each lights one image
    skin : optics of the finger
    seed : of background and noise
    settings : only `render`, `background`, `sensor` and `sensor_scale` are used here
    walks : table of random walks; None loads the shipped one

    Returns
    -------
    capture : as a camera would store it
    truth : arrays by name, see ``docs/twin.md``

    Raises
    ------
    BadInput
        If the surface does not fit the camera or no part of it is in the picture.
    """
    settings = settings or TwinSettings()
    require(
        surface.mask.shape == rig.camera.image_size,
        f"the surface has {surface.mask.shape} pixels, but the rig's camera has {rig.camera.image_size}.",
    )
    walks = walks or load_walks()
    background_seed, noise_seed = seed.spawn(2)
    scene = _Scene((surface, rig, skin), settings, np.random.default_rng(background_seed), walks)
    truth = surface_truth(surface)
    bands = {}
    names = [name for name in BAND_CHANNELS if any(led.band == name for led in rig.leds)]
    for name, band_seed in zip(names, noise_seed.spawn(len(names)), strict=True):
        bands[name], truth[f"glare_{name}"], truth[f"exposure_{name}"] = scene.photograph(name, band_seed)
    truth |= optics_truth(skin)
    truth["led_intensity"] = np.array([led.intensity for led in rig.leds])
    capture = Capture(
        rig=rig,
        bands=bands,
        encoding=settings.sensor.encoding,
        material="skin",
        subject={"id": "anonymous"},
    )
    return capture, truth


class _Scene:
    """One finger in front of the camera."""

    def __init__(
        self,
        subject: tuple[Surface, Rig, SkinSettings],
        settings: TwinSettings,
        rng: np.random.Generator,
        walks: WalkTable,
    ) -> None:
        surface, rig, skin = subject
        self.surface, self.rig, self.skin, self.settings, self.walks = surface, rig, skin, settings, walks
        self.albedo = np.where(surface.mask, 0, background_albedo(rig.camera, settings.background, rng))
        self.shade = hand_shadow(rig.camera, settings.background)
        self.scale = settings.sensor_scale or binning_scale(rig.camera)
        self.fall_off = fall_off(rig.camera) if rig.camera.shading else None
        self.blur = self._blur()

    def photograph(self, name: str, seed: np.random.SeedSequence) -> tuple[Band, NDArray[np.float16], NDArray[Any]]:
        """Images of one band, the glare (L, H, W) in the images' units, and the exposure (one number).

        Glare and exposure are those of the middle of the lens: what the images are divided by its fall-off.
        """
        members = [k for k, led in enumerate(self.rig.leds) if led.band == name]
        leds = [self.rig.leds[k] for k in members]
        optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
        skin, render = self.skin, self.settings.render
        light = render_band(
            self.surface, leds, optics, roughness=skin.roughness, glare=skin.glare, walks=self.walks, settings=render
        )
        fallen = None if self.fall_off is None else self.fall_off[light.window]
        exposure = np.float32(self.settings.sensor.exposure / _brightest(light.diffuse, fallen))
        ambient = self._ambient(name, leds)
        seeds = seed.spawn(len(leds) + 1)
        height, width = self.rig.camera.image_size
        glare = np.zeros((len(leds), height, width), dtype=np.float16)

        def shoot(k: int) -> PixelArray:
            frame = ambient + self._frame(
                light, k, white_card(self.rig.camera, leds[k], -self.settings.background.depth_mm)
            )
            glare[k][light.window] = light.glare[k] * self.shade[light.window[0]] * exposure
            return self._record(frame * exposure, name, seeds[k])

        with ThreadPoolExecutor(render.workers) as pool:
            images = list(pool.map(shoot, range(len(leds))))
        dark = self._record(np.broadcast_to(ambient, (height, width, 3)) * exposure, name, seeds[-1])
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

    def _frame(self, light: BandLight, k: int, card: FloatArray) -> FloatArray:
        """(H, W, 3) radiance of the whole frame under light k."""
        frame = np.repeat((card * self.albedo)[..., None], 3, axis=2)
        window = frame[light.window]
        for c in range(3):
            diffuse = light.diffuse[k, min(c, light.diffuse.shape[1] - 1)]
            window[..., c] += diffuse + light.glare[k]
        frame *= self.shade[..., None]
        return frame

    def _ambient(self, name: str, leds: list[Led]) -> FloatArray:
        """(H, W, 3) radiance of the frame with all LEDs off."""
        settings = self.settings.background
        level = settings.ambient * float(np.mean([white_card(self.rig.camera, led, step=10**6).mean() for led in leds]))
        frame = np.repeat((np.float32(level) * self.albedo)[..., None], 3, axis=2)
        if level > 0.0:
            optics = [self.skin.channel(channel) for channel in BAND_CHANNELS[name]]
            skin = render_ambient(
                self.surface,
                level,
                optics,
                roughness=self.skin.roughness,
                walks=self.walks,
                settings=self.settings.render,
            )
            light = BandLight(finger_window(self.surface), skin[None], np.zeros_like(skin[:1]))
            for c in range(3):
                frame[light.window][..., c] += light.diffuse[0, min(c, skin.shape[0] - 1)]
        return frame

    def _blur(self) -> FloatArray | None:
        """(H, W) defocus in pixels, or None where it is switched off."""
        render, camera = self.settings.render, self.rig.camera
        if render.aperture_mm == 0.0:
            return None
        z = np.where(self.surface.mask, self.surface.shape_mm, 0).astype(np.float32)
        top = float(z[self.surface.mask].max())
        # beyond the outline the blur of the outline itself goes on: the dark background shows no blur of its own
        weight = self.surface.mask.astype(np.float32)
        size = 0.5 * camera.px_per_mm
        near = cv2.GaussianBlur(z, (0, 0), size) / np.maximum(cv2.GaussianBlur(weight, (0, 0), size), 1e-3)
        z = np.where(self.surface.mask, z, near)
        focus = top - render.focus_depth_mm
        return blur_sigma_px(z, focus, camera.height_mm, render.aperture_mm, px_per_mm_at(camera, focus))

    def _record(self, frame: FloatArray, name: str, seed: np.random.SeedSequence) -> PixelArray:
        if self.blur is not None:
            frame = defocus(frame, self.blur)
        if self.fall_off is not None:
            frame = frame * self.fall_off[..., None]
        return record(frame, name, seed, self.settings.sensor, self.scale)


def _stack(images: list[PixelArray]) -> PixelArray:
    stacked: PixelArray = np.stack(images)  # type: ignore[assignment]
    return stacked


def _brightest(diffuse: FloatArray, fall_off: FloatArray | None = None) -> float:
    """99.9th percentile of the diffuse light behind the lens over all lights, in the channel where it is highest."""
    sample = diffuse[:, :, ::4, ::4]
    if fall_off is not None:
        sample = sample * fall_off[::4, ::4]
    values = [np.percentile(sample[:, c][sample[:, c] > 0], 99.9) for c in range(sample.shape[1])]
    return float(max(values))
