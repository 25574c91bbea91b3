"""Simulated fingers to train the networks of the `metric` method on, and their truth on the grid of a reconstruction.

Skin, ridges, camera and lights are drawn from ranges far beyond those of plausible fingers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import (
    BoolArray,
    Capture,
    Checked,
    FloatArray,
    Grid,
    Limits,
    Rig,
    Window,
    bin_mean,
    check_fields,
    default_rig,
    require,
)
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import PoseRanges, SimulatedFinger, draw_finger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import CHANNELS, DRAWN, Boundary, SkinOptics, SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface, Texture
from splitknit_simulator.twin import master_of_print_file, photograph

Range = tuple[float, float]
_LAYERS_SPREAD = 0.35
"""Standard deviation of the logarithm of each channel's absorption, by which layers depart from one medium."""
_BLURRED = 0.15  # part of the fingers whose light spreads across the picture, as in an image that is blurred
_MATT, _RIDGELESS = 0.12, 0.08  # parts of the fingers without any surface reflection, and without ridges
_SWEAT = (0.0, 0.6)  # relative standard deviation of the surface reflection over 0.4 to 2 mm
_LED_TWIST_RAD = (-0.45, 0.45)  # by which the circle of lights is turned
_LED_JITTER_MM = 1.0  # standard deviation of each light's place, every way


@dataclass(frozen=True, slots=True)
class SceneRanges(Checked):
    """The ranges (low, high) from which each finger is drawn: all far beyond those of plausible fingers."""

    _group = "data"

    scattering_factor: Range = (0.2, 2.2)
    """Log-uniform; multiplies Jacques's scattering. Jensen's skin has 0.2 to 0.5 of it."""
    scattering_power: Range = (0.4, 1.6)
    """Exponent of the wavelength in it."""
    refraction: Annotated[Range, Limits(0, 1)] = (0.0, 1.0)
    """See :class:`splitknit_simulator.light.skin.Boundary`; small values more often, as forward scattering leaves."""
    entry_power: Range = (-0.3, 1.1)
    """The same."""
    melanin: Range = (0.0002, 0.015)
    """Log-uniform volume fraction."""
    blood: Range = (0.002, 0.015)
    """Log-uniform volume fraction."""
    oxygenation: Range = (0.5, 0.9)
    """Oxygenated fraction of the haemoglobin, 0 to 1."""
    yellow_per_mm: Range = (0.05, 0.2)
    """Absorption in the blue channel beside blood and melanin."""
    baseline_per_mm: Range = (0.005, 0.02)
    """Log-uniform absorption of bloodless skin."""
    roughness: Range = (0.12, 0.45)
    """GGX alpha of the skin's surface, 0.05 to 1."""
    glare: Range = (0.0, 1.6)
    """Weight of the surface reflection, 0 to 5; 1 is bare skin."""
    relief_gain: Range = (0.3, 2.2)
    """Log-uniform."""
    ridge_depth_um: Annotated[Range, Limits(0, above=True)] = (25.0, 110.0)
    """Mean height of ridges over valleys, positive."""
    prints_folder: str = ""
    """Folder of real prints of 500 pixels an inch (PNG) whose ridges some of the fingers have; empty: none."""
    prints_share: Annotated[float, Limits(0, 1)] = 0.3
    """That part."""
    steepness: Range = (0.6, 2.4)
    """Steepness of the ridges' profile, from rounded to flat-topped."""
    duty: Range = (-0.2, 0.5)
    """Breadth of the ridges, from narrower than the valleys to twice as broad."""
    form: Annotated[float, Limits(0, 0.3)] = 0.12
    """Standard deviation of the logarithms of thickness and tip length beyond those of people."""
    undulation_mm: Annotated[Range, Limits(0, 0.5)] = (0.0, 0.15)
    """Standard deviation of bumps and dents some 5 mm wide."""
    pigment: Annotated[Range, Limits(0, 0.2)] = (0.0, 0.03)
    """Standard deviation of the skin's brightness at the scale of ridges that is not relief."""
    mottling: Annotated[Range, Limits(0, 1)] = (0.0, 0.2)
    """Standard deviation of the logarithm of green light under mottled blood, over 0.5 to 3 mm."""
    grain: Annotated[Range, Limits(0, 0.2)] = (0.0, 0.03)
    """Relative standard deviation, from pixel to pixel and in each channel for itself, of what all images share."""
    full_well_e: Annotated[Range, Limits(100)] = (500.0, 5000.0)
    """Log-uniform electrons of a full-frame pixel: noise up to 2 % at half scale."""
    aperture_mm: Annotated[Range, Limits(0, above=True)] = (1.0, 4.0)
    """Aperture of some of the cameras, which are out of focus where the finger falls away."""
    aperture_share: Annotated[float, Limits(0, 1)] = 0.3
    """That part; the others are sharp everywhere."""
    other_rig_share: Annotated[float, Limits(0, 1)] = 0.5
    """Part of the fingers whose lights stand elsewhere than on the thesis's rig, within the following ranges."""
    led_radius_mm: Annotated[Range, Limits(0, above=True)] = (42.0, 62.0)
    """Radius of the circle of lights, positive."""
    led_height_mm: Annotated[Range, Limits(20, above=True)] = (120.0, 165.0)
    """Height of lights and camera above the finger."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, (tuple, list)):
                object.__setattr__(self, name, (float(value[0]), float(value[1])))
                require(value[0] <= value[1], f"data.{name} must be (low, high), but it is {list(value)}.")
        check_fields(self)
        self.skin(SkinOptics())

    @property
    def numbers(self) -> tuple[range, range, range]:
        """Numbers of the fingers that pieces come from, of whole ones to train on, and of those held out."""
        return range(0), range(0), range(0)

    def skin(self, base: SkinOptics) -> SkinRanges:
        """The simulator's own ranges around a base skin."""
        ranges: dict[str, Any] = {name: getattr(self, name) for name in DRAWN}
        if base.glare == 0:
            ranges["glare"] = (0.0, 0.0)
        return SkinRanges(base=base, **ranges)


@dataclass(frozen=True, slots=True, eq=False)
class TrainingScene:
    """One finger, before it is photographed."""

    number: int
    finger: SimulatedFinger
    rig: Rig
    settings: TwinSettings
    textured_by: SceneRanges | None = None  # ranges of what varies over the skin; None: it is even

    def facts(self, truth: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """What was drawn, for the file that goes with the finger; the skin is in the `truth` of its photographs."""
        camera = self.rig.camera
        names = ("scattering_factor", "melanin", "blood", "roughness", "glare")
        return {
            "finger": self.number,
            "px_per_mm": camera.px_per_mm,
            "camera_height_mm": camera.height_mm,
            "aperture_mm": self.settings.render.aperture_mm,
            "rim_exponent": self.settings.render.rim_exponent,
            "ridge_depth_um": self.finger.skin.ridge_depth_um,
            "led_mm": [list(led.position_mm or ()) for led in self.rig.leds],
            "skin": {name: float(truth[f"skin_{name}"]) for name in names},
        }


def draw_base(rng: np.random.Generator, data: SceneRanges) -> SkinOptics:
    """The parts of the skin that the simulator's own ranges do not draw; matt skin has no glare in it."""
    layers = np.exp(np.clip(rng.normal(0.0, _LAYERS_SPREAD, 4), -1.2, 1.2))
    boundary = Boundary(blurred=True)
    if rng.random() >= _BLURRED:
        low, high = data.refraction
        refraction = low + (high - low) * float(rng.random()) ** 2
        boundary = Boundary(refraction, float(rng.uniform(*data.entry_power)))
    return SkinOptics(
        yellow_per_mm=float(rng.uniform(*data.yellow_per_mm)),
        baseline_per_mm=_log_uniform(rng, data.baseline_per_mm),
        scattering_power=float(rng.uniform(*data.scattering_power)),
        layers=(float(layers[0]), float(layers[1]), float(layers[2]), float(layers[3])),
        boundary=boundary,
        glare=0.0 if rng.random() < _MATT else 1.0,
    )


def _log_uniform(rng: np.random.Generator, limits: Range) -> float:
    return math.exp(float(rng.uniform(math.log(limits[0]), math.log(limits[1]))))


def drawn_sensor(rng: np.random.Generator, data: SceneRanges) -> SensorSettings:
    """A sensor of any noise in the range."""
    return SensorSettings(full_well_e=_log_uniform(rng, data.full_well_e))


def textured(surface: SimulatedSurface, rng: np.random.Generator, data: SceneRanges) -> SimulatedSurface:
    """The surface with pigment at the scale of ridges, mottled blood, patches of sweat and a fixed pattern."""
    px_per_mm = surface.camera.px_per_mm

    def even_noise(deviation: float, scale_mm: Range) -> FloatArray:
        size = _log_uniform(rng, scale_mm) * px_per_mm
        step = max(1, int(size / 3))
        rows, columns = (-(-length // step) + 8 for length in surface.mask.shape)
        noise = cv2.GaussianBlur(rng.standard_normal((rows, columns)).astype(np.float32), (0, 0), size / step)
        large = cv2.resize(noise, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
        cut = large[: surface.mask.shape[0], : surface.mask.shape[1]]
        return np.asarray(cut * np.float32(deviation / max(float(noise.std()), 1e-9)), dtype=np.float32)

    pigment = even_noise(float(rng.uniform(*data.pigment)), (0.04, 0.25))
    blood = even_noise(float(rng.uniform(*data.mottling)), (0.5, 3.0))
    gloss = np.maximum(1 + even_noise(float(rng.uniform(*_SWEAT)), (0.4, 2.0)), 0)
    marked = np.asarray(surface.pigment * (1 + np.clip(pigment, -0.3, 0.3)), dtype=np.float32)
    grain = rng.standard_normal((len(CHANNELS), *surface.mask.shape), dtype=np.float32)
    grain = 1 + np.float32(rng.uniform(*data.grain)) * np.clip(grain, -4, 4)
    return replace(surface, pigment=marked, texture=Texture(gloss=gloss, blood=blood, grain=grain))


def draw_finger_of(number: int, rng: np.random.Generator, data: SceneRanges) -> SimulatedFinger:
    """The finger `number` with ridges of any depth in the range."""
    finger = draw_finger(number, print_settings=MasterPrintSettings(steepness=data.steepness, duty=data.duty))
    depth_um = 0.0 if rng.random() < _RIDGELESS else float(rng.uniform(*data.ridge_depth_um))
    thick, long = np.exp(np.clip(rng.normal(0.0, data.form, 2), -0.3, 0.3))
    shape = replace(
        finger.shape,
        thickness_mm=float(np.clip(finger.shape.thickness_mm * thick, 6.0, 30.0)),
        tip_length_mm=float(np.clip(finger.shape.tip_length_mm * long, 4.0, 14.0)),
    )
    chosen = np.random.default_rng([number, 80])
    skin = replace(finger.skin, ridge_depth_um=depth_um, undulation_mm=float(chosen.uniform(*data.undulation_mm)))
    finger = replace(finger, shape=shape, skin=skin)
    if not data.prints_folder or chosen.random() >= data.prints_share:
        return finger
    files = sorted(Path(data.prints_folder).glob("*.png"))
    require(len(files) > 0, f"data.prints_folder has no PNG images: {data.prints_folder}.")
    master = master_of_print_file(files[int(chosen.integers(len(files)))], number, finger.print_settings)
    return replace(finger, pattern=master.pattern, printed=master)


def moved_rig(rig: Rig, rng: np.random.Generator, data: SceneRanges) -> Rig:
    """The rig with its lights on another circle, each a little off it."""
    radius, height, twist = (
        float(rng.uniform(*limits)) for limits in (data.led_radius_mm, data.led_height_mm, _LED_TWIST_RAD)
    )
    leds = []
    for led in rig.leds:
        assert led.position_mm is not None
        azimuth = math.atan2(led.position_mm[1], led.position_mm[0]) + twist
        x, y, z = rng.normal(0.0, _LED_JITTER_MM, 3)
        place = (float(radius * math.cos(azimuth) + x), float(radius * math.sin(azimuth) + y), float(height + z))
        leds.append(replace(led, position_mm=place))
    return replace(rig, leds=tuple(leds), camera=replace(rig.camera, height_mm=height))


def draw_scene(
    number: int, rng: np.random.Generator, data: SceneRanges, scale: float, rim_exponent: float | None = None
) -> TrainingScene:
    """Draw the finger `number`, its skin's ranges, lights and camera, but for its sensor."""
    base = draw_base(rng, data)
    finger = draw_finger_of(number, rng, data)
    sharp = rng.random() < 1 - data.aperture_share
    render = RenderSettings(aperture_mm=0.0 if sharp else float(rng.uniform(*data.aperture_mm)))
    if rim_exponent is not None:
        render = replace(render, rim_exponent=rim_exponent)
    rig = default_rig(scale, int(rng.integers(1000)))
    if rng.random() < data.other_rig_share:
        rig = moved_rig(rig, rng, data)
    return TrainingScene(number, finger, rig, TwinSettings(scale=scale, skin=data.skin(base), render=render), data)


def with_sensor(scene: TrainingScene, rng: np.random.Generator, data: SceneRanges) -> TrainingScene:
    """The scene with a sensor of any noise in the range."""
    return replace(scene, settings=replace(scene.settings, sensor=drawn_sensor(rng, data)))


def photograph_scene(scene: TrainingScene) -> tuple[Capture, Mapping[str, NDArray[Any]]]:
    """Capture and truth, as :func:`splitknit_simulator.twin.simulate_capture` makes them, with the scene's own rig."""
    settings, camera = scene.settings, scene.rig.camera
    person = np.random.default_rng(np.random.SeedSequence([scene.number, 0x51]))
    pose_seed, photo_seed = np.random.SeedSequence([scene.number, 0, 0x52]).spawn(2)
    assert isinstance(settings.skin, SkinRanges) and isinstance(settings.pose, PoseRanges)
    skin = settings.skin.draw(person)
    pose = settings.pose.draw(np.random.default_rng(pose_seed), camera)
    surface = finger_surface(scene.finger, pose, camera, workers=settings.render.workers)
    if scene.textured_by is not None:
        surface = textured(surface, np.random.default_rng([scene.number, 79]), scene.textured_by)
    return photograph(surface, scene.rig, skin, photo_seed, settings=settings)


TRUTH_FRACTION = 0.999  # blocks of pixels of which a smaller fraction lies on the finger have no truth


class TruthOnGrid:
    """The truth of the simulator on the fine grid."""

    def __init__(self, truth: Mapping[str, NDArray[Any]], window: Window, grid: Grid, binning: float) -> None:
        """Take the window of the simulator's arrays; `binning` pixels a side make one of the grid's."""
        self._truth, self._window, self._shape, self._binning = truth, window, grid.shape, binning
        self.mask: BoolArray = np.asarray(self._mean("mask") > TRUTH_FRACTION)

    def relief_mm(self) -> FloatArray:
        """(h, w) height less shape; defined inside the mask."""
        return self._mean("height_mm") - self._mean("shape_mm")

    def shape_mm(self) -> FloatArray:
        """(h, w) shape, continued beyond the mask by the nearest values."""
        nearest = ndimage.distance_transform_edt(~self.mask, return_distances=False, return_indices=True)
        return np.asarray(self._mean("shape_mm")[tuple(nearest)], dtype=np.float32)

    def glare(self) -> FloatArray:
        """(L, h, w) in the white images' units."""
        return self._mean("glare_white")

    def _mean(self, name: str) -> FloatArray:
        rows, columns = (math.ceil(length * self._binning) for length in self._shape)
        cut = self._truth[name][(..., *self._window)][..., :rows, :columns]
        return bin_mean(np.nan_to_num(np.ascontiguousarray(cut, dtype=np.float32)), self._binning)
