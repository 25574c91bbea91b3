"""Simulated fingers to train `relief` and `shape` on, and their truth on the grid of a
reconstruction.

Skin, ridges, camera and lights are drawn from ranges far beyond those of plausible fingers;
everything about a finger follows from its number.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from splitknit.imaging.pixels import bin_mean
from splitknit.nominal import default_rig
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import draw_finger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrintSettings
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import CHANNELS, Boundary, SkinOptics, SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import Texture
from splitknit_simulator.twin import master_of_print_file, photograph

HELD_OUT_FROM = 1_000_000  # fingers and palms from this number on are never trained on
SKIN = {
    "scattering_factor": (0.2, 2.2),  # Jensen's skin has 0.2 to 0.5 of Jacques's
    "melanin": (0.0002, 0.015),
    "blood": (0.002, 0.015),
    "oxygenation": (0.5, 0.9),
    "roughness": (0.12, 0.45),
    "glare": (0.0, 1.6),
    "relief_gain": (0.3, 2.2),
}
SCATTERING_POWER = (0.4, 1.6)  # exponent of the wavelength
REFRACTION = (0.0, 1.0)  # see `splitknit_simulator.light.skin.Boundary`
ENTRY_POWER = (-0.3, 1.1)  # likewise
YELLOW_PER_MM = (0.05, 0.2)  # see `splitknit_simulator.light.skin.SkinOptics`
BASELINE_PER_MM = (0.005, 0.02)  # likewise
# of the logarithm of each channel's absorption, by which layers depart from one medium
LAYERS_SPREAD = 0.35
# part of the fingers whose light spreads across the picture, as in an image that is blurred
BLURRED_FRACTION = 0.15
MATT_FRACTION = 0.12  # part of the fingers without any surface reflection
RIDGELESS_FRACTION = 0.08  # part of the fingers without ridges
RIDGE_DEPTH_UM = (25.0, 110.0)
STEEPNESS = (0.6, 2.4)  # of the ridges' profile
DUTY = (-0.2, 0.5)  # of the ridges' profile
# part of the fingers that have the ridges of real prints, where there are any
REAL_PRINT_FRACTION = 0.3
# standard deviation of the logarithms of thickness and tip length beyond those of people
FORM_SD = 0.12
UNDULATION_MM = (0.0, 0.15)  # standard deviation of bumps and dents some 5 mm wide
# standard deviation of the skin's brightness at the scale of ridges that is not relief
PIGMENT = (0.0, 0.03)
MOTTLING = (0.0, 0.2)  # of the logarithm of green light under mottled blood, over 0.5 to 3 mm
SWEAT = (0.0, 0.6)  # relative standard deviation of the surface reflection over 0.4 to 2 mm
GRAIN = (0.0, 0.03)  # relative standard deviation, from pixel to pixel, of what all images share
FULL_WELL_E = (500.0, 5000.0)  # electrons of a full-frame pixel: noise up to 2 % at half scale
SHARP_FRACTION = 0.7  # part of the cameras that are sharp everywhere
APERTURE_MM = (1.0, 4.0)  # of the others
# part of the fingers whose lights stand elsewhere than on the thesis's rig
OTHER_RIG_FRACTION = 0.5
RING_RADIUS_MM = (42.0, 62.0)  # of the circle on which these lights stand
RING_HEIGHT_MM = (120.0, 165.0)
RING_TURN_RAD = (-0.45, 0.45)
LED_JITTER_MM = 1.0  # standard deviation of each light's place, every way
# blocks of pixels of which a smaller fraction lies on the finger have no truth
TRUTH_FRACTION = 0.999


def log_uniform(rng, limits):
    return math.exp(float(rng.uniform(math.log(limits[0]), math.log(limits[1]))))


def draw_skin(rng):
    """Ranges of a finger's skin, around parts that the simulator's own ranges do not draw."""
    layers = np.exp(np.clip(rng.normal(0.0, LAYERS_SPREAD, 4), -1.2, 1.2))
    boundary = Boundary(blurred=True)
    if rng.random() >= BLURRED_FRACTION:
        # small refractions more often, as forward scattering leaves
        refraction = REFRACTION[0] + (REFRACTION[1] - REFRACTION[0]) * float(rng.random()) ** 2
        boundary = Boundary(refraction, float(rng.uniform(*ENTRY_POWER)))
    base = SkinOptics(
        yellow_per_mm=float(rng.uniform(*YELLOW_PER_MM)),
        baseline_per_mm=log_uniform(rng, BASELINE_PER_MM),
        scattering_power=float(rng.uniform(*SCATTERING_POWER)),
        layers=tuple(float(layer) for layer in layers),
        boundary=boundary,
    )
    matt = {"glare": (0.0, 0.0)} if rng.random() < MATT_FRACTION else {}
    return SkinRanges(**{"base": replace(base, glare=0.0 if matt else 1.0), **SKIN, **matt})


def draw_sensor(rng):
    return SensorSettings(full_well_e=log_uniform(rng, FULL_WELL_E))


def textured(surface, rng):
    """The surface with pigment at the scale of ridges, mottled blood, patches of sweat and a fixed
    pattern."""
    px_per_mm = surface.camera.px_per_mm

    def even_noise(deviation, scale_mm):
        size = log_uniform(rng, scale_mm) * px_per_mm
        step = max(1, int(size / 3))
        rows, columns = (-(-length // step) + 8 for length in surface.mask.shape)
        noise = cv2.GaussianBlur(
            rng.standard_normal((rows, columns)).astype(np.float32), (0, 0), size / step
        )
        large = cv2.resize(noise, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
        cut = large[: surface.mask.shape[0], : surface.mask.shape[1]]
        return np.asarray(
            cut * np.float32(deviation / max(float(noise.std()), 1e-9)), dtype=np.float32
        )

    pigment = even_noise(float(rng.uniform(*PIGMENT)), (0.04, 0.25))
    blood = even_noise(float(rng.uniform(*MOTTLING)), (0.5, 3.0))
    gloss = np.maximum(1 + even_noise(float(rng.uniform(*SWEAT)), (0.4, 2.0)), 0)
    marked = np.asarray(surface.pigment * (1 + np.clip(pigment, -0.3, 0.3)), dtype=np.float32)
    grain = rng.standard_normal((len(CHANNELS), *surface.mask.shape), dtype=np.float32)
    grain = 1 + np.float32(rng.uniform(*GRAIN)) * np.clip(grain, -4, 4)
    return replace(surface, pigment=marked, texture=Texture(gloss=gloss, blood=blood, grain=grain))


def draw_finger_of(number, rng, prints=None):
    """The finger `number` with ridges of any depth; `prints`: folder of real prints of 500 pixels
    an inch (PNG)."""
    finger = draw_finger(number, print_settings=MasterPrintSettings(steepness=STEEPNESS, duty=DUTY))
    depth_um = 0.0 if rng.random() < RIDGELESS_FRACTION else float(rng.uniform(*RIDGE_DEPTH_UM))
    thick, long = np.exp(np.clip(rng.normal(0.0, FORM_SD, 2), -0.3, 0.3))
    shape = replace(
        finger.shape,
        thickness_mm=float(np.clip(finger.shape.thickness_mm * thick, 6.0, 30.0)),
        tip_length_mm=float(np.clip(finger.shape.tip_length_mm * long, 4.0, 14.0)),
    )
    chosen = np.random.default_rng([number, 80])
    skin = replace(
        finger.skin, ridge_depth_um=depth_um, undulation_mm=float(chosen.uniform(*UNDULATION_MM))
    )
    finger = replace(finger, shape=shape, skin=skin)
    if prints is None or chosen.random() >= REAL_PRINT_FRACTION:
        return finger
    files = sorted(Path(prints).glob("*.png"))
    master = master_of_print_file(
        files[int(chosen.integers(len(files)))], number, finger.print_settings
    )
    return replace(finger, pattern=master.pattern, printed=master)


def moved_rig(rig, rng):
    """The rig with its lights on another circle, each a little off it."""
    limits = (RING_RADIUS_MM, RING_HEIGHT_MM, RING_TURN_RAD)
    radius, height, twist = (float(rng.uniform(*limit)) for limit in limits)
    leds = []
    for led in rig.leds:
        azimuth = math.atan2(led.position_mm[1], led.position_mm[0]) + twist
        x, y, z = rng.normal(0.0, LED_JITTER_MM, 3)
        place = (
            float(radius * math.cos(azimuth) + x),
            float(radius * math.sin(azimuth) + y),
            float(height + z),
        )
        leds.append(replace(led, position_mm=place))
    return replace(rig, leds=tuple(leds), camera=replace(rig.camera, height_mm=height))


def draw_scene(number, rng, scale, prints=None, rim_exponent=None):
    """Finger, rig and settings of the camera for the finger `number`, but for its sensor."""
    skin = draw_skin(rng)
    finger = draw_finger_of(number, rng, prints)
    render = RenderSettings(
        aperture_mm=0.0 if rng.random() < SHARP_FRACTION else float(rng.uniform(*APERTURE_MM))
    )
    if rim_exponent is not None:
        render = replace(render, rim_exponent=rim_exponent)
    rig = default_rig(scale, int(rng.integers(1000)))
    if rng.random() < OTHER_RIG_FRACTION:
        rig = moved_rig(rig, rng)
    return finger, rig, TwinSettings(scale=scale, skin=skin, render=render)


def photograph_scene(number, finger, rig, settings):
    """Capture and truth, as `splitknit_simulator.twin.simulate_capture` makes them, with the
    scene's own rig."""
    person = np.random.default_rng(np.random.SeedSequence([number, 0x51]))
    pose_seed, photo_seed = np.random.SeedSequence([number, 0, 0x52]).spawn(2)
    skin = settings.skin.draw(person)
    pose = settings.pose.draw(np.random.default_rng(pose_seed), rig.camera)
    surface = finger_surface(finger, pose, rig.camera, workers=settings.render.workers)
    surface = textured(surface, np.random.default_rng([number, 79]))
    return photograph(surface, rig, skin, photo_seed, settings=settings)


class TruthOnGrid:
    """The truth of the simulator on the fine grid of a reconstruction."""

    def __init__(self, truth, window, grid, binning):
        """Take the window of the simulator's arrays; `binning` pixels a side make one of the
        grid's."""
        self._truth, self._window, self._shape, self._binning = truth, window, grid.shape, binning
        self.mask = self._mean("mask") > TRUTH_FRACTION

    def relief_mm(self):
        """(h, w) height less shape; defined inside the mask."""
        return self._mean("height_mm") - self._mean("shape_mm")

    def shape_mm(self):
        """(h, w) shape, continued beyond the mask by the nearest values."""
        nearest = ndimage.distance_transform_edt(
            ~self.mask, return_distances=False, return_indices=True
        )
        return np.asarray(self._mean("shape_mm")[tuple(nearest)], dtype=np.float32)

    def glare(self):
        """(L, h, w) in the white images' units; None where the truth does not know it."""
        return self._mean("glare_white") if "glare_white" in self._truth else None

    def _mean(self, name):
        rows, columns = (math.ceil(length * self._binning) for length in self._shape)
        cut = self._truth[name][(..., *self._window)][..., :rows, :columns]
        return bin_mean(np.nan_to_num(np.ascontiguousarray(cut, dtype=np.float32)), self._binning)
