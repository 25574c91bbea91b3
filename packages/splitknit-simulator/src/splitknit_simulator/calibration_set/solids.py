"""What stands on the rig's base: the nail, whose shadows show where the LEDs are, a chrome or grey
ball, and a printed phantom."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Led
from splitknit.errors import require
from splitknit.model import Array, FloatArray
from splitknit_simulator.calibration_set.bench import (
    BaseScene,
    card_radiance,
    edge_coverage,
    seen_at,
    steps,
)
from splitknit_simulator.camera.lens import SightLines
from splitknit_simulator.light.lighting import UNIT, irradiance
from splitknit_simulator.surface import Window

Lines = tuple[Array, Array]
"""Points (..., 3) and unit vectors (..., 3): normals of a mirror, or directions of rays."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _SolidScene(BaseScene):
    """Something that stands on the base; its kinds define where it is seen and how bright it is."""

    # where it stands on the base (x and y, before the base's tilt)
    position_mm: tuple[float, float] = (0.0, 0.0)
    ground: float = 0.85  # reflectance of the base

    @property
    @abstractmethod
    def _solid(self) -> tuple[Window, Array, Lines] | None:
        """Pixels that may see it, the fraction of each that does, and its points and normals there;
        None: outside."""

    @abstractmethod
    def _radiance(self, leds: tuple[Led, ...], seen: Lines) -> Array:
        """(h, w) light that it sends to the camera from points and normals."""

    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w) of the base."""
        return np.full(u.shape, self.ground)

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        grey = super()._grey(leds)
        if self._solid is not None:
            window, fraction, seen = self._solid
            grey[window] += fraction * (self._radiance(leds, seen) - grey[window])
        return grey

    @property
    def _depth(self) -> Array:
        depth = self._hit[2].copy()
        if self._solid is not None:
            window, fraction, (points, _) = self._solid
            depth[window] = np.where(fraction > 0.5, points[..., 2], depth[window])
        return depth

    def _matt(
        self, leds: tuple[Led, ...], points: Array, normals: Array, reflectance: float
    ) -> Array:
        """Radiance (h, w) of a matt surface (h, w, 3) under the LEDs and the ambient light."""
        received = np.zeros(points.shape[:2])
        for led in leds:
            received += irradiance(
                led, np.moveaxis(points, -1, 0).astype(np.float32), np.moveaxis(normals, -1, 0)
            )
        return reflectance * (received / np.pi + self.ambient_light)


@dataclass(frozen=True, eq=False, kw_only=True)
class NailScene(_SolidScene):
    """A dark matt cone that stands upright on the white base."""

    nail_mm: float = 13.0
    """Height of its tip above the base."""
    base_radius_mm: float = 2.5
    tip_radius_mm: float = 0.15
    """Its tip is flat: a printed or filed one is not sharper."""
    reflectance: float = 0.15
    """Reflectance of the cone."""

    def __post_init__(self) -> None:
        lowest = float(self.plane.own(_positions_of(self.leds, "a nail"))[:, 2].min())
        require(
            self.nail_mm < lowest - 10.0,
            f"the nail of {self.nail_mm:g} mm leaves less than 10 mm below the LEDs (the lowest is"
            f" at {lowest:.0f} mm) and throws no useful shadow; take a shorter one.",
        )
        require(
            self.nail_mm < self.camera.height_mm - 10.0,
            f"the nail of {self.nail_mm:g} mm leaves less than 10 mm below the camera, which is at "
            f"{self.camera.height_mm:g} mm; take a shorter one.",
        )

    @property
    def tip_mm(self) -> Array:
        """(3,) middle of the nail's tip in the rig's frame."""
        return self.plane.points(*self.position_mm, self.nail_mm)

    def shadow_tips_mm(self) -> Array:
        """(L, 3) where the rays from the LEDs' middles through the tip's middle meet the base, in
        the rig's frame."""
        places = self.plane.own(_positions_of(self.leds, "a nail"))
        return self.plane.points(*np.array([self._cast(place)[0] for place in places]).T)

    def tip_px(self) -> Array:
        """(2,) column and row of the tip's middle."""
        return seen_at(self.camera, self.tip_mm)

    def shadow_tips_px(self) -> Array:
        """(L, 2) column and row of :meth:`shadow_tips_mm`, in the picture or outside it."""
        return seen_at(self.camera, self.shadow_tips_mm())

    def fraction_lit(self, led: Led) -> Array:
        """Fraction (H, W) of the LED's face that the base sees past the nail: 0 in the core shadow,
        soft at its rim."""
        fraction = np.ones(self.camera.image_size)
        casts = [
            self._cast(place)
            for place in self.plane.own(_disc_points(led, self.bench.led_radius_mm))
        ]
        window = self._window(casts)
        if window is not None:
            fraction[window] -= sum(self._inside(window, cast) for cast in casts) / len(casts)
        return fraction

    @cached_property
    def _solid(self) -> tuple[Window, Array, Lines] | None:
        outline = self._outline()
        window = self._window([outline])
        return (
            None
            if window is None
            else (window, self._inside(window, outline), self._surface(window))
        )

    def _radiance(self, leds: tuple[Led, ...], seen: Lines) -> Array:
        return self._matt(leds, *seen, self.reflectance)

    def _cast(self, place: Array) -> tuple[Array, float]:
        """Middle and radius of the tip's shadow on the base, from a light at `place` (the base's
        own frame)."""
        foot = np.asarray(self.position_mm, dtype=np.float64)
        stretch = self.nail_mm / (place[2] - self.nail_mm)
        return foot + (foot - place[:2]) * stretch, self.tip_radius_mm * (1.0 + stretch)

    def _outline(self) -> tuple[Array, float]:
        """The same as seen from the camera: where on the base the tip seems to lie."""
        camera = self.camera
        if camera.model == "perspective":
            return self._cast(self.plane.own((0.0, 0.0, camera.height_mm)))
        up = np.array([0.0, 0.0, 1.0]) @ self.plane.axes
        return np.asarray(self.position_mm) - up[:2] / up[2] * self.nail_mm, self.tip_radius_mm

    def _window(self, casts: list[tuple[Array, float]]) -> Window | None:
        """Pixels that some of the shadows may reach, or None if all lie outside the picture."""
        ends = np.array([middle for middle, _ in casts] + [self.position_mm])
        widest = max(self.base_radius_mm, *(radius for _, radius in casts))
        return self.pixels_between(ends.min(axis=0) - widest, ends.max(axis=0) + widest)

    def _inside(self, window: Window, cast: tuple[Array, float]) -> Array:
        """Fraction of each pixel of the window in the cone's shadow: the hull of the nail's foot
        and its tip's."""
        u, v = self._hit[0][window], self._hit[1][window]
        foot = np.asarray(self.position_mm, dtype=np.float64)
        return edge_coverage(
            -_hull_distance(u - foot[0], v - foot[1], self.base_radius_mm, cast[0] - foot, cast[1])
        )

    def _surface(self, window: Window) -> Lines:
        """Points (h, w, 3) and unit normals of the cone where the pixels of the window see it, in
        the rig's frame."""
        up = self._sight.some(window).towards_camera @ self.plane.axes
        up /= up[..., 2:]
        du, dv = (
            self._hit[0][window] - self.position_mm[0],
            self._hit[1][window] - self.position_mm[1],
        )
        # a line of sight is (du + w up_u, dv + w up_v) at the height w over the base; the cone's
        # radius is R - g w
        g = (self.base_radius_mm - self.tip_radius_mm) / self.nail_mm
        a = up[..., 0] ** 2 + up[..., 1] ** 2 - g * g
        b = du * up[..., 0] + dv * up[..., 1] + g * self.base_radius_mm
        c = du * du + dv * dv - self.base_radius_mm**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        # of a w^2 + 2 b w + c = 0 the solution (root - b) / a, where the line leaves the cone
        # upwards; a may vanish
        w = np.clip(-c / np.where(np.abs(b + root) > 1e-12, b + root, 1e-12), 0.0, self.nail_mm)
        u, v = du + w * up[..., 0], dv + w * up[..., 1]
        top_u, top_v = du + self.nail_mm * up[..., 0], dv + self.nail_mm * up[..., 1]
        on_top = top_u**2 + top_v**2 <= self.tip_radius_mm**2
        w = np.where(on_top, self.nail_mm, w)
        out = np.maximum(np.hypot(u, v), 1e-9)
        normal = np.stack([u / out, v / out, np.full_like(u, g)], axis=-1)
        normal = np.where(on_top[..., None], (0.0, 0.0, 1.0), normal)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        x = np.where(on_top, top_u, u) + self.position_mm[0]
        y = np.where(on_top, top_v, v) + self.position_mm[1]
        return self.plane.points(x, y, w), normal @ self.plane.axes.T


def _hull_distance(u: Array, v: Array, radius: float, second: Array, second_radius: float) -> Array:
    """Distance (negative inside) to the hull of a circle about the origin and a circle about
    `other`."""
    length = float(np.hypot(*second))
    slope = (
        (radius - second_radius) / length if length > 0.0 else 2.0 * np.sign(radius - second_radius)
    )
    if abs(slope) >= 1.0:  # one circle contains the other
        inner = slope > 0 or length == 0.0
        first = np.hypot(u, v) - radius
        return first if inner else np.hypot(u - second[0], v - second[1]) - second_radius
    along = (u * second[0] + v * second[1]) / length
    beside = np.abs(u * second[1] - v * second[0]) / length
    across = float(np.sqrt(1.0 - slope * slope))
    place = along * across - beside * slope
    straight = beside * across + along * slope - radius
    near = np.hypot(u, v) - radius
    far = np.hypot(u - second[0], v - second[1]) - second_radius
    return np.where(place < 0.0, near, np.where(place > across * length, far, straight))


# A ball on the rig's base: chrome, in which the LEDs are seen reflected, or grey and matt, which
# they shade.


@dataclass(frozen=True, eq=False, kw_only=True)
class SphereScene(_SolidScene):
    """A ball of known radius that rests on the base."""

    radius_mm: float = 8.0
    chrome: bool = True
    """A mirror; otherwise grey and matt."""
    reflectance: float | None = None
    """Reflectance of the ball; by default 0.6 for chrome, 0.5 for grey."""
    ground: float = 0.05
    """Reflectance of the base: dark, so that the ball's outline and the mirrored LEDs stand out."""
    surround: float = 0.01
    """Radiance of the rig's inner walls relative to a white card's at the origin under the LEDs
    that are on: what chrome mirrors beside the LEDs and the base."""

    def __post_init__(self) -> None:
        room = min(float(_positions_of(self.leds, "a ball")[:, 2].min()), self.camera.height_mm)
        require(
            2.0 * self.radius_mm < 0.5 * room,
            f"a ball of {2 * self.radius_mm:g} mm reaches more than half way to the LEDs and the"
            f" camera ({room:.0f} mm up); take a smaller one.",
        )

    @property
    def middle_mm(self) -> Array:
        """(3,) middle of the ball in the rig's frame."""
        return self.plane.points(*self.position_mm, self.radius_mm)

    def outline_px(self) -> Array:
        """(360, 2) column and row of points of the ball's outline."""
        near = self.camera.model == "perspective"
        return seen_at(self.camera, self._rim(self._towards_camera(self.middle_mm), near))

    def highlights_mm(self) -> Array:
        """(L, 3) points of the ball that mirror the LEDs' middles to the camera."""
        places = _positions_of(self.leds, "a ball")
        normals = np.tile((0.0, 0.0, 1.0), (len(places), 1))
        # the ball is small beside the distances: each turn shrinks the error by their ratio
        for _ in range(60):
            points = self.middle_mm + self.radius_mm * normals
            normals = unit(unit(places - points) + unit(self._towards_camera(points)))
        return self.middle_mm + self.radius_mm * normals

    def fraction_lit(self, led: Led) -> Array:
        """Fraction (H, W) of the LED's face that the base sees past the ball."""
        fraction = np.ones(self.camera.image_size)
        places = _disc_points(led, self.bench.led_radius_mm)
        window = self._shadow(places)
        if window is not None:
            points = np.stack([axis[window] for axis in self._points], axis=-1).astype(np.float64)
            for place in places:
                hidden = edge_coverage(self._depth_in_shadow(points, place))
                fraction[window] -= hidden / len(places)
        return fraction

    def _depth_in_shadow(self, points: Array, place: Array) -> Array:
        """By how much (mm) the lines from points (..., 3) of the base to the point `place` pass
        inside the ball."""
        away = points - self.middle_mm
        towards = unit(place - points)
        nearest = np.sum(away * towards, axis=-1)
        return np.asarray(
            self.radius_mm - np.sqrt(np.maximum(np.sum(away * away, axis=-1) - nearest**2, 0.0))
        )

    def _shadow(self, places: Array) -> Window | None:
        """Pixels that the ball's shadow from points (N, 3) may reach."""
        rims = self.plane.own([self._rim(place - self.middle_mm, near=True) for place in places])
        away = rims[..., :2] - self.plane.own(places)[:, None, :2]
        height = rims[..., 2:]
        casts = rims[..., :2] + away * (height / (self.plane.own(places)[:, None, 2:] - height))
        return self.pixels_between(casts.min(axis=(0, 1)), casts.max(axis=(0, 1)))

    def _rim(self, towards: Array, near: bool) -> Array:
        """(360, 3) points where lines from its middle plus `towards` (3,), or parallel to that,
        touch the ball."""
        distance = float(np.linalg.norm(towards))
        view, nearer = towards / distance, self.radius_mm / distance if near else 0.0
        ring = np.sqrt(1.0 - nearer**2) * _ring(view, 360)
        return np.asarray(self.middle_mm + self.radius_mm * (nearer * view + ring))

    def _towards_camera(self, points: Array) -> Array:
        if self.camera.model == "perspective":
            return (0.0, 0.0, self.camera.height_mm) - points
        return np.broadcast_to(np.array([0.0, 0.0, self.camera.height_mm]), points.shape)

    @cached_property
    def _ball(self) -> Window | None:
        """Pixels that may see the ball, or None if it is outside the picture."""
        places, (height, width) = self.outline_px(), self.camera.image_size
        left, top = (max(int(v) - 3, 0) for v in np.floor(places.min(axis=0)))
        right, bottom = (
            min(int(v) + 4, most)
            for v, most in zip(np.ceil(places.max(axis=0)), (width, height), strict=True)
        )
        return (
            (slice(top, bottom), slice(left, right))
            if bottom - top >= 2 and right - left >= 2
            else None
        )

    @cached_property
    def _solid(self) -> tuple[Window, Array, Lines] | None:
        if self._ball is None:
            return None
        seen, inwards = self._seen(self._sight.some(self._ball))
        return self._ball, edge_coverage(inwards), seen

    def _seen(self, sight: SightLines) -> tuple[Lines, Array]:
        """Where lines of sight meet the ball or touch it, its normals there, and by how much (mm)
        they pass inside."""
        down = -sight.towards_camera
        away = np.stack([sight.x, sight.y, np.zeros_like(sight.x)], axis=-1) - self.middle_mm
        # of the line to the ball's middle
        nearest = away - np.sum(away * down, axis=-1, keepdims=True) * down
        beside2 = np.sum(nearest * nearest, axis=-1)
        depth = np.sqrt(np.maximum(self.radius_mm**2 - beside2, 0.0))
        normals = unit(nearest - depth[..., None] * down)
        return (self.middle_mm + self.radius_mm * normals, normals), self.radius_mm - np.sqrt(
            beside2
        )

    def _radiance(self, leds: tuple[Led, ...], seen: Lines) -> Array:
        default = 0.6 if self.chrome else 0.5
        reflectance = default if self.reflectance is None else self.reflectance
        if not self.chrome:
            return self._matt(leds, *seen, reflectance)
        assert self._ball is not None
        return self._mirrored(leds, self._sight.some(self._ball), seen, reflectance)

    def _mirrored(
        self, leds: tuple[Led, ...], lines: SightLines, seen: Lines, reflectance: float
    ) -> Array:
        """Radiance (h, w) of the chrome ball: the base, the walls and the LEDs in it."""
        rays = mirrored(lines, seen)
        walls = self.surround * sum(card_radiance(led) for led in leds) + self.ambient_light
        start, way = self.plane.own(rays[0]), rays[1] @ self.plane.axes
        falls = way[..., 2] < -1e-3
        reach = np.where(falls, -start[..., 2] / np.where(falls, way[..., 2], -1.0), 0.0)
        ground = self._matt(
            leds, rays[0] + reach[..., None] * rays[1], self.plane.axes[:, 2], self.ground
        )
        scene = np.where(falls, ground, walls)
        for led in leds:
            scene = scene + self._led_in_mirror(led, lines, rays)
        return reflectance * scene

    def _led_in_mirror(self, led: Led, lines: SightLines, rays: Lines) -> Array:
        """Radiance (h, w) of an LED's face in the chrome, averaged over each pixel near its rim."""
        inwards, radiance = _led_face(led, self.bench.led_radius_mm, rays)
        # in the very middle of the face the distance from its rim has no slope: the neighbours'
        # counts
        pixel = cv2.dilate(np.hypot(*steps(inwards)), np.ones((3, 3), np.uint8))
        light = np.where(inwards > 0.0, radiance, 0.0)
        at = np.nonzero(np.abs(inwards) < 2.0 * pixel)
        if at[0].size:
            finer = _finer_lines(lines, at)
            hit, value = _led_face(
                led, self.bench.led_radius_mm, mirrored(finer, self._seen(finer)[0])
            )
            light[at] = np.mean(np.where(hit > 0.0, value, 0.0), axis=0)
        return light


# A printed phantom: heights above a plane, on dark ground.


@dataclass(frozen=True, eq=False, kw_only=True)
class ReliefScene(_SolidScene):
    """A matt grey thing of known heights, its highest point on the finger plane."""

    height_mm: FloatArray
    """(h, w) on a grid of `pitch_mm`, up its rows' beginning; NaN where there is none."""
    pitch_mm: float
    reflectance: float = 0.5
    ground: float = 0.02

    @cached_property
    def _solid(self) -> tuple[Window, Array, Lines] | None:
        inside = np.isfinite(self.height_mm)
        top = float(np.nanmax(self.height_mm))
        below = np.where(inside, self.height_mm, np.nanmin(self.height_mm)) - top
        rise, across = map(np.asarray, np.gradient(below, self.pitch_mm))
        way = self._sight.towards_camera @ self.plane.axes
        way /= way[..., 2:]
        w = np.zeros(self.camera.image_size)
        for _ in range(10):  # a contraction: the slope of a line of sight times a skirt's
            u, v = self._hit[0] + w * way[..., 0], self._hit[1] + w * way[..., 1]
            w = self._sampled(below, u, v)
        slopes = [-self._sampled(across, u, v), self._sampled(rise, u, v)]
        normals = unit(np.stack([*slopes, np.ones_like(u)], axis=-1))
        lines = self.plane.points(u, v, w), normals @ self.plane.axes.T
        whole = slice(0, w.shape[0]), slice(0, w.shape[1])
        return whole, self._sampled(inside, u, v), lines

    def _radiance(self, leds: tuple[Led, ...], seen: Lines) -> Array:
        return self._matt(leds, *seen, self.reflectance)

    def _sampled(self, values: NDArray[Any], u: Array, v: Array) -> Array:
        """Values of the grid at u and v on the plane; beside it those of its edge."""
        rows, columns = values.shape
        place = (
            (u - self.position_mm[0]) / self.pitch_mm + (columns - 1) / 2,
            (rows - 1) / 2 - (v - self.position_mm[1]) / self.pitch_mm,
        )
        column, row = (axis.astype(np.float32) for axis in place)
        return cv2.remap(
            values.astype(np.float32),
            column,
            row,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(np.float64)


# LEDs in a mirror: where lines of sight go after it, and whether they end on an LED's bright face.


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def mirrored(sight: SightLines, mirror: Lines) -> Lines:
    """Where lines of sight leave a mirror (points and normals) and which way they go then."""
    points, normals = mirror
    down = -sight.towards_camera
    return points, down - 2.0 * np.sum(down * normals, axis=-1, keepdims=True) * normals


def _led_face(led: Led, radius_mm: float, rays: Lines) -> tuple[Array, Array]:
    """By how much (mm) rays pass inside the rim of the LED's face, and the radiance of that face
    towards them.

    A face of radius r that sends the intensity I straight ahead has the radiance I / (pi r^2)
    there; seen from beside its axis, its lobe's fraction over the cosine of its own foreshortening.
    """
    start, way = rays
    middle = np.asarray(led.position_mm, dtype=np.float64)
    cosine = -(way @ led.axis)
    meets = cosine > 1e-3
    reach = ((middle - start) @ led.axis) / np.where(meets, -cosine, -1.0)
    offset = start + reach[..., None] * way - middle
    inwards = np.where(meets & (reach > 0.0), radius_mm - np.linalg.norm(offset, axis=-1), -1e3)
    ahead = led.intensity * UNIT / (np.pi * max(radius_mm, 1e-6) ** 2)
    return inwards, ahead * np.maximum(cosine, 1e-3) ** (led.lobe_exponent - 1.0)


RIM_SAMPLES = 12
"""Across a pixel in which the rim of an LED's mirror image lies. Chosen on: speed."""


def _finer_lines(sight: SightLines, at: tuple[NDArray[Any], ...]) -> SightLines:
    """Lines of sight (RIM_SAMPLES^2, N) of a square grid of points within the N pixels `at`."""
    places = (np.arange(RIM_SAMPLES) + 0.5) / RIM_SAMPLES - 0.5
    row, column = np.repeat(places, RIM_SAMPLES)[:, None], np.tile(places, RIM_SAMPLES)[:, None]

    def finer(value: Array) -> Array:
        down, right = steps(value)
        return np.asarray(value[at] + row * down[at] + column * right[at])

    return SightLines(*map(finer, sight))


def _positions_of(leds: Sequence[Led], what: str) -> Array:
    """(L, 3) positions in mm of LEDs that all have one, or BadInput: `what` needs them."""
    for index, led in enumerate(leds):
        require(
            led.position_mm is not None,
            f"{what} needs LEDs with positions, but LED {index} is distant light.",
        )
    return np.array([led.position_mm for led in leds], dtype=np.float64)


def _disc_points(led: Led, radius_mm: float) -> Array:
    """(N, 3) points in mm that stand for equal parts of an LED's bright face: its middle and rings
    of 6 and of 12.

    Each ring has the mean squared radius of its part of the disc, so that the points have the
    disc's own spread.
    """
    middle = np.asarray(led.position_mm, dtype=np.float64)
    if radius_mm == 0.0:
        return middle[None]
    rings = [
        radius_mm * np.sqrt(fraction) * _ring(led.axis, count, turn)
        for count, fraction, turn in ((6, 4.0 / 19.0, 0.1), (12, 13.0 / 19.0, 0.36))
    ]
    return np.concatenate([middle[None], *(middle + ring for ring in rings)])


def _ring(axis: Array, count: int, turn: float = 0.0) -> Array:
    """(count, 3) unit vectors all around an axis (3,)."""
    across = unit(np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0)))
    angle = turn + 2.0 * np.pi * np.arange(count) / count
    return np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(axis, across)
