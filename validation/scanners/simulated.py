"""Other scanners' pictures of the simulator's fingers: its geometry, skin and noise under stripes, lines and lamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from splitknit.model import Camera, Led, default_rig
from splitknit_simulator.camera.lens import blur_sigma_px, defocus
from splitknit_simulator.camera.sensor import FULL_PX_PER_MM, SensorSettings
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, placement_of
from splitknit_simulator.finger.raycast import PlacedFinger, Placement, above, finger_in_view, meet_body, rays_of
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map
from splitknit_simulator.light.lighting import cut_out, light_on
from splitknit_simulator.light.renderer import LED_RADIUS_MM, Relief, RenderSettings, SubsurfaceScattering
from splitknit_simulator.light.skin import Medium, SkinRanges
from splitknit_simulator.scanners.structured_light import fringes
from splitknit_simulator.scanners.views import View

HEIGHT_MM = 140.0
PIVOT = np.array([0.0, 0.0, -6.0])
"""Cameras and projectors turn about this point, in the finger."""
PROJECTOR_ROWS, PROJECTOR_PX_MM, PROJECTOR_DEG = 1300, 0.03, 25.0
PROJECTOR_BLUR_MM, LASER_SIGMA_MM = 0.05, 0.05
APERTURE_MM = 28.0
"""Of the lens of depth from focus: f/2.5 at 70 mm."""


def turned(about: str, deg: float) -> np.ndarray:
    """(3, 3) turn about x or y that takes the direction of a device, `deg` from the z axis, to the z axis."""
    c, s = np.cos(np.deg2rad(deg)), np.sin(np.deg2rad(deg))
    return (
        np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) if about == "x" else np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    )


def camera_of(px_per_mm: float) -> Camera:
    shape = round(29.0 * px_per_mm), round(26.0 * px_per_mm)
    focal = HEIGHT_MM * px_per_mm
    matrix = np.array([[focal, 0, (shape[1] - 1) / 2], [0, focal, (shape[0] - 1) / 2], [0, 0, 1.0]])
    return Camera(px_per_mm, shape, HEIGHT_MM, "perspective", matrix)


def view_of(matrix: np.ndarray, turn: np.ndarray) -> View:
    """The calibrated view of a device of this matrix that was turned about the pivot."""
    flip = np.diag([1.0, -1.0, -1.0])
    return View(matrix, flip @ turn, flip @ (PIVOT - turn @ PIVOT) + [0, 0, HEIGHT_MM])


def projector() -> View:
    focal = HEIGHT_MM / PROJECTOR_PX_MM
    matrix = np.array([[focal, 0, 640], [0, focal, (PROJECTOR_ROWS - 1) / 2], [0, 0, 1.0]])
    return view_of(matrix, turned("x", PROJECTOR_DEG))


@dataclass
class Person:
    """A finger as `simulate_capture` draws it, laid down under another camera."""

    body: FingerBody
    skin: object
    placement: Placement
    optics: object
    seed: int


def person(seed: int, scale: float, impression: int = 0) -> Person:
    finger = draw_finger(seed)
    rig = default_rig(scale)
    pose_seed, _ = np.random.SeedSequence([seed, impression, 0x52]).spawn(2)
    pose = PoseRanges().draw(np.random.default_rng(pose_seed), rig.camera)
    body = FingerBody(finger.shape)
    optics = SkinRanges().draw(np.random.default_rng(np.random.SeedSequence([seed, 0x51])))
    return Person(body, skin_map(finger.master(), finger.skin), placement_of(body, pose, rig.camera), optics, seed)


class Sight:
    """A finger in one camera."""

    def __init__(self, who: Person, px_per_mm: float, deg: float = 0.0) -> None:
        turn = turned("y", deg)
        place = Placement(turn @ who.placement.rotation, turn @ (who.placement.shift - PIVOT) + PIVOT)
        self.camera, self.who, self.turn = camera_of(px_per_mm), who, turn
        self.view = view_of(self.camera.matrix, turn)
        self.surface = finger_in_view(PlacedFinger(who.body, who.skin, place), self.camera, 1)
        self.patch = cut_out(self.surface)
        self.rng = np.random.default_rng([who.seed, round(deg) % 360])
        self._media: dict = {}
        here = np.stack([self.patch.x, self.patch.y, self.patch.z], -1)
        self.points = (here - PIVOT) @ turn + PIVOT  # in the scene's frame

    def light(self, channel: str, lamp: View, patterns: Iterator | None = None) -> Iterator[tuple]:
        """Radiance (H, W) and mean light on the skin under a lamp, or under each pattern (a function of its rows)."""
        if channel != "opaque" and channel not in self._media:
            medium = Medium((self.who.optics.channel(channel),), self.who.optics.roughness, self.who.optics.glare)
            blur = SubsurfaceScattering(self.patch, medium, RenderSettings(workers=1))
            self._media[channel] = blur, Relief(self.surface, self.patch, medium)
        place = self.turn @ (lamp.centre_mm - PIVOT) + PIVOT
        led = Led("white", tuple(place))
        entering, gloss = light_on(self.patch, led, self.who.optics.roughness, LED_RADIUS_MM)
        entering, gloss = entering.astype(np.float32), (gloss * self.who.optics.glare).astype(np.float32)
        if channel == "opaque":  # painted: no light below the surface, no gloss
            gloss *= 0

            def leaving(light):
                return light / np.float32(np.pi)
        else:
            blur, relief = self._media[channel]
            gain = next(iter(relief.gains(led)))

            def leaving(light):
                return next(iter(blur(light))) * gain

        row = lamp.pixels(self.points)[1].astype(np.float32)
        for pattern in patterns or (None,):
            on = np.float32(1.0) if pattern is None else pattern(row).astype(np.float32)
            whole = np.zeros(self.camera.image_size, np.float32)
            whole[self.patch.window] = leaving(entering * on) + gloss * on
            yield whole, float((entering * on)[self.patch.mask].mean())

    def record(self, radiance: np.ndarray, brightest: float) -> np.ndarray:
        """What the sensor makes of light whose brightest reaches 0.7 of full scale: noise, ten bits."""
        sensor, binned = SensorSettings(), (FULL_PX_PER_MM / self.camera.px_per_mm) ** 2
        full = sensor.full_well_e * binned
        electrons = radiance * np.float32(0.7 / brightest * full)
        spread = np.sqrt(electrons + sensor.read_noise_e**2 * binned)
        electrons = electrons + spread * self.rng.standard_normal(electrons.shape, dtype=np.float32)
        return (np.clip(np.rint(electrons / full * 1023), 0, 1023) / 1023).astype(np.float32)


def stripe(period: float, step: int, steps: int, gamma: float = 1.1):
    """A projector's fringes with its gamma, eight bits and blur, as a function of the row."""
    at = np.arange(-200, PROJECTOR_ROWS + 200)
    level = np.rint(255 * fringes(at, period, step, steps)) / 255
    shown = gaussian_filter1d(level.astype(np.float64) ** gamma, PROJECTOR_BLUR_MM / PROJECTOR_PX_MM)
    return lambda row: np.interp(row, at, shown)


def line(centre: float):
    """A laser line on one row of its scanner."""
    sigma = LASER_SIGMA_MM / PROJECTOR_PX_MM
    return lambda row: np.exp(-0.5 * ((row - centre) / sigma) ** 2)


def silhouette(who: Person, px_per_mm: float, deg: float) -> tuple[np.ndarray, View]:
    turn, camera = turned("y", deg), camera_of(px_per_mm)
    place = Placement(turn @ who.placement.rotation, turn @ (who.placement.shift - PIVOT) + PIVOT)
    rays = rays_of(camera, *(np.arange(n) for n in camera.image_size))
    _, hit = meet_body(who.body, place, rays, np.full(rays.x.size, above(who.body, place)))
    return hit.reshape(camera.image_size), view_of(camera.matrix, turn)


def focused(sight: Sight, picture: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """A picture (noise-free) as lenses focused on these heights have it."""
    depth = np.where(sight.surface.mask, sight.surface.shape_mm, -8.0).astype(np.float32)
    stack = []
    for z in heights:
        sigma = blur_sigma_px(depth, float(z), HEIGHT_MM, APERTURE_MM, sight.camera.px_per_mm)
        stack.append(defocus(picture[..., None], sigma)[..., 0])
    return np.stack(stack)
