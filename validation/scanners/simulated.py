"""Other scanners of the simulator's fingers: its geometry, skin and noise under stripes, lines and
lamps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import cv2
import focus
import laser
import numpy as np
import stereo
import structured_light
from numpy.typing import NDArray
from views import View

from splitknit.model import Array, BoolArray, Camera, FloatArray, Led
from splitknit_simulator.camera.lens import blur_sigma_px, defocus
from splitknit_simulator.camera.sensor import FULL_PX_PER_MM, SensorSettings
from splitknit_simulator.finger.finger import placement_of
from splitknit_simulator.finger.raycast import (
    PlacedFinger,
    Placement,
    above,
    finger_in_view,
    meet_body,
    rays_of,
)
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map
from splitknit_simulator.light.lighting import cut_out, light_on
from splitknit_simulator.light.renderer import Relief, RenderSettings, SubsurfaceScattering
from splitknit_simulator.light.skin import Medium
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import drawn_finger

SCALE = 0.4
PX_PER_MM = 75.7 * SCALE
HEIGHT_MM = 140.0
PIVOT = np.array([0.0, 0.0, -6.0])  # in the finger: cameras and projectors turn about it
PROJECTOR_ROWS = 1300
PROJECTOR_PX_MM = 0.03
PROJECTOR_DEG = 25.0
PROJECTOR_BLUR_MM = 0.05
LASER_SIGMA_MM = 0.05
APERTURE_MM = 28.0  # of the lens of depth from focus: f/2.5 at 70 mm
PERIODS = (1300.0, 200.0, 36.0)  # of the stripes, in the projector's rows
STEPS = 6  # phase steps of each period
Pattern = Callable[[FloatArray], NDArray[np.floating]]  # light by the projector's row
# with the light on the skin (1: one evenly lit exposure), seconds of computing
Scan = tuple[FloatArray, float, float]


def turned(about: str, deg: float) -> Array:
    """(3, 3) turn about x or y that takes the direction of a device, `deg` from the z axis, to the
    z axis."""
    c = np.cos(np.deg2rad(deg))
    s = np.sin(np.deg2rad(deg))
    return np.array(
        [[1, 0, 0], [0, c, -s], [0, s, c]] if about == "x" else [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    )


def camera_of(px_per_mm: float) -> Camera:
    """A pinhole that looks down on the finger."""
    shape = (round(29.0 * px_per_mm), round(26.0 * px_per_mm))
    focal = HEIGHT_MM * px_per_mm
    matrix = np.array([[focal, 0, (shape[1] - 1) / 2], [0, focal, (shape[0] - 1) / 2], [0, 0, 1.0]])
    return Camera(px_per_mm, shape, HEIGHT_MM, "perspective", matrix)


def view_of(matrix: Array, turn: Array) -> View:
    """The calibrated view of a device of this matrix that was turned about the pivot."""
    flip = np.diag([1.0, -1.0, -1.0])
    return View(matrix, flip @ turn, flip @ (PIVOT - turn @ PIVOT) + [0, 0, HEIGHT_MM])


def projector() -> View:
    """A projector of stripes, or the scanner of a laser line."""
    focal = HEIGHT_MM / PROJECTOR_PX_MM
    matrix = np.array([[focal, 0, 640], [0, focal, (PROJECTOR_ROWS - 1) / 2], [0, 0, 1.0]])
    return view_of(matrix, turned("x", PROJECTOR_DEG))


class Sight:
    """A finger in one camera."""

    def __init__(self, fingers: Fingers, deg: float = 0.0) -> None:
        """The camera is turned by `deg` about the finger's axis."""
        turn = turned("y", deg)
        self.camera, self.fingers, self.turn = camera_of(PX_PER_MM), fingers, turn
        assert self.camera.matrix is not None
        self.view = view_of(self.camera.matrix, turn)
        self.surface = finger_in_view(
            PlacedFinger(fingers.body, fingers.skin, fingers.placed(turn)), self.camera, 1
        )
        self.patch = cut_out(self.surface)
        self.rng = np.random.default_rng([fingers.seed, round(deg) % 360])
        self._media: dict[str, tuple[SubsurfaceScattering, Relief]] = {}
        here = np.stack([self.patch.x, self.patch.y, self.patch.z], -1)
        self.points = (here - PIVOT) @ turn + PIVOT  # in the scene's frame

    def light(
        self, channel: Any, lamp: View, patterns: Iterable[Pattern] = ()
    ) -> Iterator[tuple[FloatArray, float]]:
        """Radiance (H, W) and mean light on the skin under a lamp, or under each pattern;
        ``opaque``: painted skin."""
        optics = self.fingers.optics
        gain: Any = np.float32(1 / np.pi)
        led = Led("white", tuple(self.turn @ (lamp.centre_mm - PIVOT) + PIVOT))
        entering, gloss = light_on(self.patch, led, optics.roughness)
        gloss = gloss * np.float32(0 if channel == "opaque" else optics.glare)
        blur: Any = lambda light: iter((light,))  # noqa: E731
        if channel != "opaque":
            if channel not in self._media:
                medium = Medium((optics.channel(channel),), optics.roughness, optics.glare)
                scattering = SubsurfaceScattering(self.patch, medium, RenderSettings(workers=1))
                self._media[channel] = scattering, Relief(self.surface, self.patch, medium)
            blur, relief = self._media[channel]
            gain = next(relief.gains(led))
        row = lamp.pixels(self.points)[1].astype(np.float32)
        for pattern in patterns or (np.ones_like,):
            on = pattern(row).astype(np.float32)
            whole = np.zeros(self.camera.image_size, np.float32)
            whole[self.patch.window] = next(blur(entering * on)) * gain + gloss * on
            yield whole, float((entering * on)[self.patch.mask].mean())

    def even(self, channel: str, lamp: View) -> tuple[FloatArray, float, float]:
        """Evenly lit: radiance, its brightest, and the light on the skin."""
        radiance, on_skin = next(self.light(channel, lamp))
        return radiance, float(np.percentile(radiance[self.surface.mask], 99.5)), on_skin

    def record(self, radiance: FloatArray, brightest: float) -> FloatArray:
        """What the sensor makes of light whose brightest reaches 0.7 of full scale: noise, ten
        bits."""
        sensor = SensorSettings()
        binned = (FULL_PX_PER_MM / self.camera.px_per_mm) ** 2
        full = sensor.full_well_e * binned
        electrons = radiance * np.float32(0.7 / brightest * full)
        spread = np.sqrt(electrons + sensor.read_noise_e**2 * binned)
        electrons += spread * self.rng.standard_normal(electrons.shape, dtype=np.float32)
        return np.asarray(
            np.clip(np.rint(electrons / full * 1023), 0, 1023) / 1023, dtype=np.float32
        )


class Fingers:
    """A finger under cameras, each made once."""

    def __init__(self, seed: int) -> None:
        """As `simulate_capture` draws it and lays it down."""
        drawn = drawn_finger(seed, None, TwinSettings(scale=SCALE), 0, None)
        self.body = FingerBody(drawn.finger.shape)
        self.skin = skin_map(drawn.finger.master(), drawn.finger.skin)
        self.placement = placement_of(self.body, drawn.pose, drawn.rig.camera)
        self.optics, self.seed, self._sights = drawn.skin, seed, dict[float, Sight]()

    def placed(self, turn: Array) -> Placement:
        """Where it lies for a device that was turned about the pivot."""
        return Placement(
            turn @ self.placement.rotation, turn @ (self.placement.shift - PIVOT) + PIVOT
        )

    def at(self, deg: float) -> Sight:
        """The camera `deg` beside the axis."""
        if deg not in self._sights:
            self._sights[deg] = Sight(self, deg)
        return self._sights[deg]


def stripe(period: float, step: int, steps: int, gamma: float = 1.1) -> Pattern:
    """A projector's fringes with its gamma, eight bits and blur."""
    at = np.arange(-200.0, PROJECTOR_ROWS + 200)
    level = (
        np.rint(255 * structured_light.fringes(at, period, step, steps)).astype(np.float64) / 255
    )
    blur_px = PROJECTOR_BLUR_MM / PROJECTOR_PX_MM
    projected = cv2.GaussianBlur(level[None] ** gamma, (0, 0), blur_px)[0]
    return lambda row: np.interp(row, at, projected)


def line(centre: float) -> Pattern:
    """A laser line on one row of its scanner."""
    sigma = LASER_SIGMA_MM / PROJECTOR_PX_MM
    return lambda row: np.exp(-0.5 * ((row - centre) / sigma) ** 2)


def stripes(finger: Fingers, channel: str = "blue", periods: tuple[float, ...] = PERIODS) -> Scan:
    """Fringes of several periods."""
    sight = finger.at(0)
    lamp = projector()
    _, brightest, unit = sight.even(channel, lamp)
    shots = list(
        sight.light(
            channel, lamp, [stripe(period, k, STEPS) for period in periods for k in range(STEPS)]
        )
    )
    images = np.stack([sight.record(shot, brightest) for shot, _ in shots])
    images[:, (images >= 1.0).any(axis=0)] = np.nan
    begun = time.process_time()
    decoded = structured_light.decode(
        images.reshape(len(periods), STEPS, *images.shape[1:]), periods
    )
    cloud, _ = structured_light.scan(sight.view, lamp, decoded)
    return cloud, sum(shot for _, shot in shots) / unit, time.process_time() - begun


def laser_line(finger: Fingers) -> Scan:
    """A red line that sweeps over the finger in steps of 0.1 mm."""
    sight = finger.at(0)
    lamp = projector()
    rows = lamp.pixels(sight.points[sight.patch.mask])[1]
    first = float(rows.min()) - 10.0
    step = 0.1 / PROJECTOR_PX_MM
    plan = [line(first + k * step) for k in range(int((np.ptp(rows) + 20.0) / step))]
    _, even_brightest, unit = sight.even("red", lamp)
    middle = next(sight.light("red", lamp, [plan[len(plan) // 2]]))[0]
    brightest = float(np.percentile(middle[middle > 0.2 * middle.max()], 99.0))
    light = busy = 0.0

    def frames() -> Iterator[FloatArray]:
        nonlocal light, busy
        for radiance, on_skin in sight.light("red", lamp, plan):
            light += on_skin
            shot = sight.record(radiance, brightest)
            begun = time.process_time()
            yield shot
            busy += time.process_time() - begun

    when = laser.peaks(frames())
    begun = time.process_time()
    cloud = laser.scan(sight.view, lamp, when, (first, step))
    return cloud, light / unit * even_brightest / brightest, busy + time.process_time() - begun


def depth_from_focus(finger: Fingers) -> Scan:
    """Twenty pictures, half a millimetre apart in depth, at one magnification."""
    sight = finger.at(0)
    radiance, brightest, _ = sight.even("green", projector())
    heights = np.linspace(1.0, -8.5, 20)
    depth = np.where(sight.surface.mask, sight.surface.shape_mm, -8.0).astype(np.float32)
    sigmas = (
        blur_sigma_px(depth, float(z), HEIGHT_MM, APERTURE_MM, sight.camera.px_per_mm)
        for z in heights
    )
    stack = np.stack(
        [sight.record(defocus(radiance[..., None], sigma)[..., 0], brightest) for sigma in sigmas]
    )
    begun = time.process_time()
    number, _ = focus.depth(stack, 0.4 * PX_PER_MM)
    cloud = focus.scan(sight.view, number, (float(heights[0]), float(heights[1] - heights[0])))
    return cloud, 20.0, time.process_time() - begun


def cameras(finger: Fingers, angles: tuple[float, ...] = (-36.0, -18.0, 0.0, 18.0, 36.0)) -> Scan:
    """Stereo of neighbours among cameras around the finger."""
    sights = [finger.at(deg) for deg in angles]
    lamp = projector()
    pictures = [sight.record(*sight.even("green", lamp)[:2]) for sight in sights]
    begun = time.process_time()
    cloud = stereo.scan(pictures, [sight.view for sight in sights], np.array([0.0, 0.0, -3.0]), 6.0)
    return cloud, 1.0, time.process_time() - begun


def hull(finger: Fingers) -> Scan:
    """The visual hull of six silhouettes around the finger."""
    masks: list[BoolArray] = []
    views = []
    camera = camera_of(10.0)
    assert camera.matrix is not None
    for deg in (-75.0, -45.0, -15.0, 15.0, 45.0, 75.0):
        turn = turned("y", deg)
        place = finger.placed(turn)
        rays = rays_of(camera, *(np.arange(n) for n in camera.image_size))
        _, hit = meet_body(finger.body, place, rays, above(finger.body, place))
        masks.append(hit.reshape(camera.image_size))
        views.append(view_of(camera.matrix, turn))
    begun = time.process_time()
    cloud = stereo.hull(masks, views, np.array([[-13.0, -14.4, -8.0], [13.0, 14.4, 1.5]]), 0.045)
    return cloud, 1.0, time.process_time() - begun
