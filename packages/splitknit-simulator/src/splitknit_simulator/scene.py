"""A finger in front of the camera: its pictures under every LED, as the sensor stores them, and the
truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from itertools import zip_longest
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Ambient, Band, Camera, Capture, Led, Rig
from splitknit.capture import spectral_band
from splitknit.errors import require
from splitknit.model import COLOURS, Array, FloatArray, PixelArray
from splitknit.settings import Checked, Limits, check_fields
from splitknit_simulator.camera.lens import blur_sigma_px, defocus, fall_off, px_per_mm_at
from splitknit_simulator.camera.sensor import SensorSettings, binning_scale, record
from splitknit_simulator.finger.conditions import Condition
from splitknit_simulator.finger.finger import FingerPose, PoseRanges
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.finger.ridges import around
from splitknit_simulator.light.films import (
    SERIES,
    Films,
    FilmSettings,
    mounted_films,
    once_scattered,
)
from splitknit_simulator.light.lighting import cut_out, finger_window, towards, white_card
from splitknit_simulator.light.renderer import (
    BandLight,
    RenderSettings,
    render_ambient,
    render_band,
)
from splitknit_simulator.light.skin import BAND_CHANNELS, CHANNELS, Channel, SkinOptics, SkinRanges
from splitknit_simulator.rigs import MirrorSettings
from splitknit_simulator.surface import SimulatedSurface, Truth, soft_step


@dataclass(frozen=True, slots=True)
class BackgroundSettings(Checked):
    """The scene around the finger."""

    albedo: Annotated[float, Limits(0.0, 1.0)] = 0.006
    """Diffuse reflectance of the black background."""
    dust_per_cm2: Annotated[float, Limits(0.0, 1000.0)] = 0.0
    """Bright specks on the background."""
    hand_shadow: Annotated[float, Limits(0.0, 1.0)] = 0.0
    """Fraction of the light that the hand takes away at the finger's base, 0 to 1."""
    colour: Annotated[tuple[float, float, float, float] | None, Limits(0.0, 1.0)] = None
    """Diffuse reflectance in red, green, blue and NIR of coloured paper in place of the black
    background. What it sends on to the finger's flanks is simulated too, as from an endless, evenly
    lit plane. Not between mirrors."""
    ambient: Annotated[float, Limits(0.0, 1.0)] = 0.002
    """Ambient light: radiance of a white card relative to the same card under one LED."""


def background_albedo(
    camera: Camera, settings: BackgroundSettings, rng: np.random.Generator
) -> FloatArray:
    """(H, W) albedo of the background: even, but for specks of dust."""
    height, width = camera.image_size
    albedo = np.full((height, width), settings.albedo, dtype=np.float32)
    area_cm2 = height * width / (10.0 * camera.px_per_mm) ** 2
    for _ in range(int(rng.poisson(settings.dust_per_cm2 * area_cm2))):
        _speck(albedo, camera.px_per_mm, 0.3, rng)
    return albedo


def _background_albedos(
    camera: Camera, settings: BackgroundSettings, rng: np.random.Generator
) -> dict[Channel, FloatArray]:
    """(H, W) albedo of the background for every channel; dust is white."""
    if settings.colour is None:
        return dict.fromkeys(CHANNELS, background_albedo(camera, settings, rng))
    return {
        channel: background_albedo(camera, replace(settings, albedo=albedo), deepcopy(rng))
        for channel, albedo in zip(CHANNELS, settings.colour, strict=True)
    }


def _speck(
    albedo: NDArray[np.float32], px_per_mm: float, brightest: float, rng: np.random.Generator
) -> None:
    row, column = (rng.random() * length for length in albedo.shape)
    long_px = px_per_mm * 0.02 * (0.4 / 0.02) ** rng.random()
    short_px = long_px * (0.2 + 0.8 * rng.random())
    angle = np.pi * rng.random()
    value = brightest * (0.1 + 0.9 * rng.random())
    window, dy, dx = around(albedo.shape, row, column, int(np.ceil(2.5 * long_px)) + 1)
    u = (dx * np.cos(angle) + dy * np.sin(angle)) / long_px
    v = (dy * np.cos(angle) - dx * np.sin(angle)) / short_px
    patch = albedo[window]
    np.maximum(patch, value * np.exp(-0.5 * (u * u + v * v) ** 2), out=patch, casting="same_kind")


# One simulated capture.


@dataclass(frozen=True, slots=True)
class TwinSettings(Checked):
    """One simulated capture."""

    scale: float = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels; not used where `rig` is
    given."""
    rig_seed: int | None = 0
    """Seed of the LEDs' individual intensities; None makes them equal."""
    skin: SkinOptics | SkinRanges = field(default_factory=SkinRanges)
    """The skin itself, or the ranges from which each finger's is drawn."""
    pose: FingerPose | PoseRanges = field(default_factory=PoseRanges)
    """The pose itself, or the ranges from which each impression's is drawn."""
    render: RenderSettings = field(default_factory=RenderSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    rig: Rig | None = None
    """Camera and LEDs as they are: any camera model, size, height, aims and lobes. None: the
    thesis's rig, made from `scale` and `rig_seed`."""
    side_lights: Annotated[int, Limits(0, 16)] = 0
    """White LEDs added to the side of the finger, 90 mm from the axis and 30 mm above the finger
    plane, on an arc that leaves the hand free."""
    sensor_scale: Annotated[float | None, Limits(0.0, 1.0, above=True)] = None
    """Size of a sensor pixel relative to an image pixel, for the noise: 1 = full resolution, 0.5 =
    2 x 2 binned. None: as :func:`splitknit_simulator.camera.sensor.binning_scale` finds it from the
    camera."""
    motion: HandMotion = field(default_factory=HandMotion)
    """How the finger moves between the shots; it lies still unless `motion.amplitude_mm` is above
    zero."""
    mirrors: MirrorSettings = field(default_factory=MirrorSettings)
    """Mirrors beside the finger: none unless they are named, or a given `rig` has them."""
    condition: Condition = field(default_factory=Condition)
    """State of the finger's skin: clean unless `condition.kind` is wet, dry, dusty, scarred or
    glossy."""
    films: FilmSettings = field(default_factory=FilmSettings)
    """Polarising films before the white LEDs and the camera: none unless `films.kind` is analyser
    or leds."""

    def __post_init__(self) -> None:
        check_fields(self)
        moving, coloured = self.motion.amplitude_mm > 0, self.background.colour is not None
        require(
            not (self.condition.active and moving),
            "a finger in some condition lies still in the twin; leave out motion, or condition.",
        )
        require(
            not self.between_mirrors
            or not (self.condition.active or moving or coloured or self.films.kind != "none"),
            "between mirrors the twin's finger is clean, lies still and on black, without films;"
            " leave out mirrors, or condition, motion, background.colour and films.kind.",
        )

    @property
    def between_mirrors(self) -> bool:
        """Whether the finger lies between mirrors."""
        return bool(self.mirrors.names) or (self.rig is not None and bool(self.rig.mirrors))


# What is known about a capture, as plain arrays by name.


def surface_truth(surface: SimulatedSurface) -> Truth:
    """Heights, normals, mask, relief and landmarks; of a perspective camera also the points' x and
    y, and its lens."""
    truth: Truth = {
        "height_mm": surface.height_mm,
        "shape_mm": surface.shape_mm,
        "mask": surface.mask,
        "normals": surface.normals,
        "relief_um": surface.relief_um,
        "pitch_mm": np.array(surface.camera.pitch_mm),
    }
    truth |= places_truth(surface)
    if surface.camera.model == "perspective":
        truth |= _flat("camera", asdict(surface.camera))
    if surface.coat is not None:
        truth |= surface.coat.truth()
    return truth | _flat("landmark", surface.landmarks)


def places_truth(surface: SimulatedSurface) -> Truth:
    """(H, W) x and y of the skin's points under a perspective camera; the grid gives the others."""
    if surface.camera.model == "orthographic":
        return {}
    x, y, _ = surface.sight().at(surface.height_mm)
    return {"x_mm": x.astype(np.float32), "y_mm": y.astype(np.float32)}


def optics_truth(skin: SkinOptics) -> Truth:
    """Return the coefficients by channel, in the order red, green, blue, NIR, and the parameters
    they come from."""
    media = [skin.channel(channel) for channel in CHANNELS]
    truth: Truth = {
        "optics_channels": np.array(CHANNELS),
        "optics_scattering_per_mm": np.array([m.scattering_per_mm for m in media]),
        "optics_absorption_per_mm": np.array([m.absorption_per_mm for m in media]),
        "optics_relief_gain_per_um": np.array([m.relief_gain_per_um for m in media]),
    }
    return truth | _flat("skin", asdict(skin))


def _flat(prefix: str, values: Mapping[str, Any]) -> Truth:
    """One array for each entry; what is inside mappings and lists of arrays gets longer names."""
    result: Truth = {}
    for key, value in values.items():
        name = f"{prefix}_{key}"
        if isinstance(value, Mapping):
            result |= _flat(name, value)
        elif isinstance(value, list):
            result |= _flat(name, {str(k): entry for k, entry in enumerate(value)})
        elif value is not None:
            result[name] = np.asarray(value)
    return result


BACKGROUND_MM = 10.0  # below the finger plane
_SHADED_ROWS = 0.25
"""Fraction of the frame's rows, from the last one, in the hand's shadow."""


class Scene:
    """One finger in front of the camera."""

    def __init__(
        self,
        subject: tuple[SimulatedSurface, Rig, SkinOptics],
        settings: TwinSettings,
        rng: np.random.Generator,
    ) -> None:
        """Lay the background, whose dust `rng` draws, and find how far each pixel is out of
        focus."""
        surface, rig, skin = subject
        self.surface, self.rig, self.skin, self.settings = surface, rig, skin, settings
        albedos = _background_albedos(rig.camera, settings.background, rng)
        self.albedo = {
            channel: np.where(surface.mask, 0, albedo) for channel, albedo in albedos.items()
        }
        # (H, 1) fraction of the light that reaches each row
        height = rig.camera.image_size[0]
        below = (np.arange(height) / (height - 1) - (1.0 - _SHADED_ROWS)) / (0.3 * _SHADED_ROWS)
        shadow = settings.background.hand_shadow * soft_step(below)
        self.shade = (1.0 - shadow).astype(np.float32)[:, None]
        self.films = films_of(settings, rig)
        self.scale = settings.sensor_scale or binning_scale(rig.camera)
        self.fall_off = fall_off(rig.camera) if rig.camera.shading else None
        self.exposure = np.float32(1.0)
        self.blur: FloatArray | None = None
        if settings.render.aperture_mm > 0.0:
            depth, top = finger_depth(surface)
            self.blur = self.blur_by(depth, top)

    def photograph(self, name: str, seed: np.random.SeedSequence) -> Taken:
        """Photograph one band.

        An LED of a colour is a narrow line: all pixels that see it see the skin at its wavelength,
        blurred as light of this colour is; how strongly they see it is the camera's crosstalk.
        Glare and exposure are those of the middle of the lens: what the images are divided by its
        fall-off.
        """
        numbers = members_of(name, self.rig, self.settings)
        leds = [self.rig.leds[k] for k in numbers]
        light, groups = self.render(name, leds), exposures_of(leds)
        if name != "white_crossed":  # both series have one exposure
            self.exposure = np.float32(
                self.settings.sensor.exposure / self.brightest(light, groups, leds)
            )
        light = self.behind_films(name, light, numbers)
        shots = [Shot(self, light, numbers, group) for group in groups]
        return photographs(name, shots, self.exposure, seed)

    def render(self, name: str, leds: Sequence[Led]) -> BandLight:
        """Light of the finger under LEDs of one band."""
        name = spectral_band(name)
        light = render_band(self.surface, leds, self.skin.medium(name), self.settings.render)
        if self.settings.background.colour is not None:
            self._add_reflected(light, name, leds)
        return light

    def _add_reflected(self, light: BandLight, name: str, leds: Sequence[Led]) -> None:
        """Add to the finger's light what comes by way of the background, in place: a hemisphere
        from below."""
        channels = BAND_CHANNELS[name]
        up = np.array([0.0, 0.0, -1.0])
        below = render_ambient(self.surface, 1.0, self.skin.medium(name), self.settings.render, up)
        colour = dict(zip(CHANNELS, self.settings.background.colour or (), strict=True))
        for k, led in enumerate(leds):
            card = float(white_card(self.rig.camera, led, -BACKGROUND_MM).mean())
            for c, channel in enumerate(channels):
                light.diffuse[k, c] += np.float32(card * colour[channel]) * below[c]

    def background(self, light: FloatArray | np.float32, name: str) -> FloatArray:
        """(H, W, 3) radiance of the background, none where the finger is, where a white card sends
        `light`."""
        channels = BAND_CHANNELS[name] * (3 // len(BAND_CHANNELS[name]))
        return np.stack([light * self.albedo[channel] for channel in channels], axis=-1)

    def exposed(
        self, light: BandLight, group: Sequence[int], leds: Sequence[Led], ambient: FloatArray
    ) -> FloatArray:
        """(H, W, 3) what the pixels see under a group's LEDs together and `ambient` light; `light`:
        of all `leds`."""
        mixing, frame = self._mixing, ambient.copy()
        for k in group:
            card = white_card(self.rig.camera, leds[k], -BACKGROUND_MM)
            lit = self.frame(light, k, self.background(card, leds[k].band))
            if leds[k].colour:
                c = COLOURS.index(leds[k].colour)
                lit = lit[..., c : c + 1] * mixing[:, c].astype(np.float32)
            frame += lit
        return frame

    def brightest(
        self, light: BandLight, groups: Sequence[Sequence[int]], leds: Sequence[Led]
    ) -> float:
        """99.9th percentile of the diffuse light behind the lens, in the channel where it is
        highest.

        White LEDs count together, coloured ones by the exposure.
        """
        fallen = None if self.fall_off is None else self.fall_off[light.window]
        if not any(led.colour for led in leds):
            return brightest(light.diffuse, fallen)
        seen = 1.0 if fallen is None else fallen[::4, ::4]
        levels = []
        for group in groups:
            total = np.zeros((3, *light.diffuse[0, 0, ::4, ::4].shape))
            for k in group:
                sample = light.diffuse[k, :, ::4, ::4] * seen
                if leds[k].colour:
                    c = COLOURS.index(leds[k].colour)
                    total += self._mixing[:, c, None, None] * sample[c]
                else:
                    total += sample
            levels += [float(np.percentile(channel[channel > 0], 99.9)) for channel in total]
        return max(levels)

    @property
    def _mixing(self) -> Array:
        crosstalk = self.rig.camera.crosstalk
        return np.eye(3) if crosstalk is None else np.asarray(crosstalk)

    def frame(self, light: BandLight, k: int, frame: FloatArray) -> FloatArray:
        """(H, W, 3) radiance of the whole frame under light k, written over that of the background,
        `frame`."""
        frame[light.window] += np.moveaxis(light.diffuse[k] + light.glare[k], 0, -1)
        frame *= self.shade[..., None]
        return frame

    def ambient(self, name: str, leds: Sequence[Led]) -> FloatArray:
        """(H, W, 3) radiance of finger and background with all LEDs off."""
        name = spectral_band(name)
        level = ambient_level(self.rig.camera, leds, self.settings.background.ambient)
        frame = self.background(np.float32(level), name)
        if level > 0.0:
            skin = render_ambient(self.surface, level, self.skin.medium(name), self.settings.render)
            frame[finger_window(self.surface)] += np.moveaxis(skin, 0, -1)
        if self.films is not None and name == "white":
            frame *= self.films.ambient
        return np.asarray(frame, dtype=np.float32)

    def behind_films(self, name: str, light: BandLight, numbers: Sequence[int]) -> BandLight:
        """Light of a band's LEDs `numbers`, in place, as films leave it, over what they leave of
        depolarised light."""
        if self.films is None or name == "nir":
            return light
        patch, members = (
            cut_out(self.surface, shadows=True),
            members_of(name, self.rig, self.settings),
        )
        optics = self.skin.medium("white").optics
        for i, number in enumerate(numbers):
            to_led, _ = towards(self.rig.leds[number], patch.points)
            ray = int(name == "white_crossed"), members.index(number), to_led, patch.view
            light.glare[i] *= (self.films.specular(*ray) / self.films.depolarised).astype(
                np.float32
            )
            kept = (self.films.once_scattered(*ray) / self.films.depolarised).astype(np.float32)
            for c, once in enumerate(once_scattered(patch, self.rig.leds[number], optics)):
                light.diffuse[i, c] += kept * once
        return light

    def take(
        self,
        name: str,
        groups: Sequence[tuple[int, ...]],
        shoot: Callable[[int, np.random.SeedSequence], PixelArray],
        dark: FloatArray,
        seed: np.random.SeedSequence,
    ) -> Band:
        """Take a band's images, an exposure of each of `groups` of LEDs, and its ambient frame of
        `dark` (H, W, 3)."""
        rig, seeds = self.rig, seed.spawn(len(groups) + 1)
        leds = [rig.leds[k] for group in groups for k in group]
        with ThreadPoolExecutor(self.settings.render.workers) as pool:
            images = list(pool.map(shoot, range(len(groups)), seeds[:-1]))
        return Band(
            name=name,
            pixels=np.stack(images),  # type: ignore[arg-type]
            leds=tuple(groups),
            exposure=np.ones(len(groups)),
            black_level=np.zeros(len(groups)),
            ambient=Ambient(self.record(dark, name, leds, seeds[-1])),
            polarisation=(
                "" if self.films is None or name == "nir" else SERIES[name == "white_crossed"]
            ),
        )

    def blur_by(self, depth: FloatArray, top_mm: float) -> FloatArray:
        """(H, W) defocus in pixels (standard deviation) of what lies at z = `depth`; `top_mm` is
        the finger's."""
        camera, render = self.rig.camera, self.settings.render
        focus = top_mm - render.focus_depth_mm
        return blur_sigma_px(
            depth, focus, camera.height_mm, render.aperture_mm, px_per_mm_at(camera, focus)
        )

    def through_lens(self, frame: FloatArray) -> FloatArray:
        """(H, W, 3) the radiance (H, W, 3) as defocus and fall-off of the lens leave it."""
        if self.blur is not None:
            frame = defocus(frame, self.blur)
        return frame if self.fall_off is None else frame * self.fall_off[..., None]

    def record(
        self, frame: FloatArray, name: str, leds: Sequence[Led], seed: np.random.SeedSequence
    ) -> PixelArray:
        """(H, W, 3) what the sensor stores of the radiance (H, W, 3) of a band's LEDs times the
        exposure."""
        if self.films is not None and name != "nir":
            frame = self.films.on_camera(frame, crossed=name == "white_crossed")
        return record(
            self.through_lens(frame),
            response_to(name, leds),
            seed,
            self.settings.sensor,
            self.scale,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A finger under the LEDs of one exposure."""

    scene: Scene
    light: BandLight
    numbers: Sequence[int]  # of the light's LEDs in the rig
    group: Sequence[int]  # which of the light's LEDs are lit
    smear: FloatArray | None = None  # kernel of the blur within the exposure

    @property
    def leds(self) -> list[Led]:
        """The light's LEDs."""
        return [self.scene.rig.leds[k] for k in self.numbers]


def photographs(
    name: str, shots: Sequence[Shot], exposure: np.float32, seed: np.random.SeedSequence
) -> Taken:
    """Photograph the shots of one band."""
    first = shots[0].scene
    groups = [tuple(shot.numbers[k] for k in shot.group) for shot in shots]
    used = sorted(number for group in groups for number in group)
    leds = [first.rig.leds[number] for number in used]
    ambient = first.ambient(name, leds)
    glare = np.zeros((len(used), *first.rig.camera.image_size), dtype=np.float16)

    def shoot(number: int, seed: np.random.SeedSequence) -> PixelArray:
        shot = shots[number]
        light, shade = shot.light, shot.scene.shade
        frame = shot.scene.exposed(light, shot.group, shot.leds, ambient) * exposure
        for k in shot.group:
            seen = light.glare[k] * shade[light.window[0]] * exposure
            glare[used.index(shot.numbers[k])][light.window] = seen
        if shot.smear is not None:
            smeared = cv2.filter2D(frame, -1, shot.smear, borderType=cv2.BORDER_REPLICATE)
            frame = np.asarray(smeared, dtype=np.float32)
        return shot.scene.record(frame, name, leds, seed)

    band = first.take(name, groups, shoot, ambient * exposure, seed)
    return band, glare, np.array(float(exposure))


def ambient_level(camera: Camera, leds: Sequence[Led], fraction: float) -> float:
    """Radiance of a white card under ambient light: `fraction` of that under one LED (mean of
    all)."""
    return fraction * float(np.mean([white_card(camera, led, step=10**6).mean() for led in leds]))


Taken = tuple[Band, NDArray[np.float16], NDArray[Any]]
"""Images of one band, the glare (L, H, W) of each of its LEDs in the images' units, and the
exposure (one number)."""


def response_to(band: str, leds: Sequence[Led]) -> str:
    """How the sensor responds to LEDs of a band: a name of
    :data:`splitknit_simulator.camera.sensor.RESPONSE`."""
    return "coloured" if any(led.colour for led in leds) else spectral_band(band)


def bands_of(rig: Rig, settings: TwinSettings) -> list[str]:
    """Bands of a capture in the order in which they are taken."""
    names = ["white", *(["white_crossed"] if settings.films.kind != "none" else []), "nir"]
    return [name for name in names if members_of(name, rig, settings)]


def members_of(name: str, rig: Rig, settings: TwinSettings) -> list[int]:
    """Numbers of the LEDs of a capture's band; those of a crossed series on neighbours follow all
    other white ones."""
    numbers = [k for k, led in enumerate(rig.leds) if led.band == spectral_band(name)]
    if settings.films.kind == "leds" and name != "nir":
        half = len(numbers) // 2
        return numbers[half:] if name == "white_crossed" else numbers[:half]
    return numbers


def films_of(settings: TwinSettings, rig: Rig) -> Films | None:
    """Films as they are mounted on a rig: the same for every finger."""
    if settings.films.kind == "none":
        return None
    require(
        not any(led.colour or led.also for led in rig.leds),
        "films stand before single white LEDs in the twin; leave out coloured LEDs, or films.kind.",
    )
    rng = np.random.default_rng([settings.rig_seed or 0, 0x57])
    leds = [rig.leds[k] for k in members_of("white", rig, settings)]
    return mounted_films(settings.films, leds, rng)


def take_capture(
    scene: Scene,
    photograph: Callable[[str, np.random.SeedSequence], Taken],
    seed: np.random.SeedSequence,
    truth: Truth,
) -> Capture:
    """Photograph every band of a scene's rig; glare, exposures, optics and LEDs are added to
    `truth`."""
    rig = scene.rig
    names, bands = bands_of(rig, scene.settings), {}
    for name, band_seed in zip(names, seed.spawn(len(names)), strict=True):
        bands[name], truth[f"glare_{name}"], truth[f"exposure_{name}"] = photograph(name, band_seed)
    truth |= optics_truth(scene.skin)
    truth["led_intensity"] = np.array([led.intensity for led in rig.leds])
    encoding = scene.settings.sensor.encoding
    return Capture(
        rig=rig, bands=bands, encoding=encoding, material="skin", subject={"id": "anonymous"}
    )


def finger_depth(surface: SimulatedSurface) -> tuple[FloatArray, float]:
    """(H, W) z of the finger's shape in mm, and that of its highest point.

    Beyond the outline that of the outline goes on: the dark background shows no blur of its own.
    """
    mask = surface.mask
    z = np.where(mask, surface.shape_mm, 0).astype(np.float32)
    weight, size = mask.astype(np.float32), 0.5 * surface.camera.px_per_mm
    near = cv2.GaussianBlur(z, (0, 0), size) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), size), 1e-3
    )
    return np.where(mask, z, near).astype(np.float32), float(z[mask].max())


def brightest(diffuse: FloatArray, fall_off: FloatArray | None = None) -> float:
    """99.9th percentile of the diffuse light behind the lens over all lights, in the channel where
    it is highest."""
    sample = diffuse[:, :, ::4, ::4]
    if fall_off is not None:
        sample = sample * fall_off[::4, ::4]
    values = [np.percentile(sample[:, c][sample[:, c] > 0], 99.9) for c in range(sample.shape[1])]
    return float(max(values))


def exposures_of(leds: Sequence[Led]) -> list[tuple[int, ...]]:
    """Which of `leds` share an exposure: the k-th of each colour; a white one has its own."""
    of_colours = [[k for k, led in enumerate(leds) if led.colour == colour] for colour in COLOURS]
    shared = [
        tuple(sorted(k for k in group if k is not None)) for group in zip_longest(*of_colours)
    ]
    return shared + [(k,) for k, led in enumerate(leds) if not led.colour]
