"""What stands on the rig's base: the nail, whose shadows show where the LEDs are, and a chrome or grey ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit.simulator.calibration_set.bench import (
    Array,
    GroundScene,
    PlaneFrame,
    SightLines,
    Steps,
    Window,
    base_plane,
    card_radiance,
    edge_coverage,
    seen_at,
    steps,
)
from splitknit.simulator.light.lighting import UNIT, irradiance


@dataclass(frozen=True, eq=False, kw_only=True)
class NailScene(GroundScene):
    """A dark matt cone that stands upright on the white base."""

    position_mm: tuple[float, float] = (0.0, 0.0)
    """Where it stands on the base (x and y, before the base's tilt)."""
    nail_mm: float = 13.0
    """Height of its tip above the base."""
    base_radius_mm: float = 2.5
    tip_radius_mm: float = 0.15
    """Its tip is flat: a printed or filed one is not sharper."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Of the rig's base against the camera, about x, then y."""
    reflectance: float = 0.15
    """Of the cone."""
    ground: float = 0.85
    """Reflectance of the base."""

    def __post_init__(self) -> None:
        heights = self.plane.own(_positions_of(self.leds, "a nail"))[:, 2]
        lowest = float(heights.min())
        require(
            self.nail_mm < lowest - 10.0,
            f"the nail of {self.nail_mm:g} mm leaves less than 10 mm below the LEDs (the lowest is at {lowest:.0f} mm) "
            "and throws no useful shadow; take a shorter one.",
        )
        require(
            self.nail_mm < self.camera.height_mm - 10.0,
            f"the nail of {self.nail_mm:g} mm leaves less than 10 mm below the camera, which is at "
            f"{self.camera.height_mm:g} mm; take a shorter one.",
        )

    @property
    def plane(self) -> PlaneFrame:
        """Where the base lies."""
        return base_plane(self.tilt_deg)

    @property
    def tip_mm(self) -> NDArray[np.float64]:
        """(3,) middle of the nail's tip in the rig's frame."""
        return self.plane.points(*self.position_mm, self.nail_mm)

    def shadow_tips_mm(self) -> NDArray[np.float64]:
        """(L, 3) where the rays from the LEDs' middles through the tip's middle meet the base, in the rig's frame."""
        places = self.plane.own(_positions_of(self.leds, "a nail"))
        return self.plane.points(*np.array([self._cast(place)[0] for place in places]).T)

    def tip_px(self) -> NDArray[np.float64]:
        """(2,) column and row of the tip's middle."""
        return seen_at(self.camera, self.tip_mm)

    def shadow_tips_px(self) -> NDArray[np.float64]:
        """(L, 2) column and row of :meth:`shadow_tips_mm`, in the picture or outside it."""
        return seen_at(self.camera, self.shadow_tips_mm())

    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w) of the base."""
        return np.full(u.shape, self.ground)

    def fraction_lit(self, led: Led) -> Array:
        """Fraction (H, W) of the LED's face that the base sees past the nail: 0 in the core shadow, soft at its rim."""
        fraction = np.ones(self.camera.image_size)
        places = self.plane.own(_disc_points(led, self.bench.led_radius_mm))
        casts = [self._cast(place) for place in places]
        window = self._window(casts)
        if window is None:
            return fraction
        hidden = np.zeros(fraction[window].shape)
        for cast in casts:
            hidden += self._inside(window, cast)
        fraction[window] -= hidden / len(casts)
        return fraction

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        grey = super()._grey(leds)
        outline = self._outline()
        window = self._window([outline])
        if window is None:
            return grey
        fraction = self._inside(window, outline)
        points, normal = self._surface(window)
        received = np.zeros(fraction.shape)
        for led in leds:
            received += irradiance(led, _axes(points), np.moveaxis(normal, -1, 0))
        cone = self.reflectance * (received / np.pi + self.ambient_light)
        grey[window] += fraction * (cone - grey[window])
        return grey

    @property
    def _depth(self) -> Array:
        depth = self._hit[2].copy()
        outline = self._outline()
        window = self._window([outline])
        if window is not None:
            on_nail = self._inside(window, outline) > 0.5
            depth[window] = np.where(on_nail, self._surface(window)[0][..., 2], depth[window])
        return depth

    def _cast(self, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Middle and radius of the tip's shadow on the base, from a light at `place` (the base's own frame)."""
        foot = np.asarray(self.position_mm, dtype=np.float64)
        stretch = self.nail_mm / (place[2] - self.nail_mm)
        return foot + (foot - place[:2]) * stretch, self.tip_radius_mm * (1.0 + stretch)

    def _outline(self) -> tuple[NDArray[np.float64], float]:
        """The same as seen from the camera: where on the base the tip seems to lie."""
        camera = self.camera
        if camera.model == "perspective":
            return self._cast(self.plane.own((0.0, 0.0, camera.height_mm)))
        up = np.array([0.0, 0.0, 1.0]) @ self.plane.axes
        return np.asarray(self.position_mm) - up[:2] / up[2] * self.nail_mm, self.tip_radius_mm

    def _window(self, casts: list[tuple[NDArray[np.float64], float]]) -> Window | None:
        """Pixels that some of the shadows may reach, or None if all lie outside the picture."""
        ends = np.array([middle for middle, _ in casts] + [self.position_mm])
        widest = max(self.base_radius_mm, *(radius for _, radius in casts))
        return self.pixels_between(ends.min(axis=0) - widest, ends.max(axis=0) + widest)

    def _inside(self, window: Window, cast: tuple[NDArray[np.float64], float]) -> Array:
        """Fraction of each pixel of the window inside the cone's shadow: the hull of the nail's foot and of its tip's
        shadow.
        """
        u, v = self._hit[0][window], self._hit[1][window]
        foot = np.asarray(self.position_mm, dtype=np.float64)
        return edge_coverage(-_hull_distance(u - foot[0], v - foot[1], self.base_radius_mm, cast[0] - foot, cast[1]))

    def _surface(self, window: Window) -> tuple[Array, Array]:
        """Points (h, w, 3) and unit normals of the cone where the pixels of the window see it, in the rig's frame."""
        lines = self._sight
        up = np.stack([lines.slope_x[window], lines.slope_y[window], np.full_like(lines.x[window], -1.0)], axis=-1)
        up = up @ self.plane.axes
        up /= up[..., 2:]
        du, dv = self._hit[0][window] - self.position_mm[0], self._hit[1][window] - self.position_mm[1]
        # a line of sight is (du + w up_u, dv + w up_v) at the height w over the base; the cone's radius is R - g w
        g = (self.base_radius_mm - self.tip_radius_mm) / self.nail_mm
        a = up[..., 0] ** 2 + up[..., 1] ** 2 - g * g
        b = du * up[..., 0] + dv * up[..., 1] + g * self.base_radius_mm
        c = du * du + dv * dv - self.base_radius_mm**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        # of a w^2 + 2 b w + c = 0 the solution (root - b) / a, where the line leaves the cone upwards; a may vanish
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


def _hull_distance(u: Array, v: Array, radius: float, other: NDArray[np.float64], other_radius: float) -> Array:
    """Distance (negative inside) to the hull of a circle about the origin and a circle about `other`."""
    length = float(np.hypot(*other))
    slope = (radius - other_radius) / length if length > 0.0 else 2.0 * np.sign(radius - other_radius)
    if abs(slope) >= 1.0:  # one circle contains the other
        inner = slope > 0 or length == 0.0
        first = np.hypot(u, v) - radius
        return first if inner else np.hypot(u - other[0], v - other[1]) - other_radius
    along = (u * other[0] + v * other[1]) / length
    beside = np.abs(u * other[1] - v * other[0]) / length
    across = float(np.sqrt(1.0 - slope * slope))
    place = along * across - beside * slope
    straight = beside * across + along * slope - radius
    near = np.hypot(u, v) - radius
    far = np.hypot(u - other[0], v - other[1]) - other_radius
    return np.asarray(np.where(place < 0.0, near, np.where(place > across * length, far, straight)))


# A ball on the rig's base: chrome, in which the LEDs are seen reflected, or grey and matt, which they shade.


@dataclass(frozen=True, eq=False, kw_only=True)
class SphereScene(GroundScene):
    """A ball of known radius that rests on the base."""

    radius_mm: float = 8.0
    position_mm: tuple[float, float] = (0.0, 0.0)
    """Where it touches the base (x and y, before the base's tilt)."""
    chrome: bool = True
    """A mirror; otherwise grey and matt."""
    reflectance: float | None = None
    """Of the ball; by default 0.6 for chrome, 0.5 for grey."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Of the rig's base against the camera, about x, then y."""
    ground: float = 0.05
    """Reflectance of the base: dark, so that the ball's outline and the mirrored LEDs stand out."""
    surround: float = 0.01
    """Radiance of the rig's inner walls relative to a white card's at the origin under the LEDs that are on: what
    chrome mirrors beside the LEDs and the base."""

    def __post_init__(self) -> None:
        room = float(_positions_of(self.leds, "a ball")[:, 2].min())
        room = min(room, self.camera.height_mm)
        require(
            2.0 * self.radius_mm < 0.5 * room,
            f"a ball of {2 * self.radius_mm:g} mm reaches more than half way to the LEDs and the camera ({room:.0f} mm "
            "up); take a smaller one.",
        )

    @property
    def plane(self) -> PlaneFrame:
        """Where the base lies."""
        return base_plane(self.tilt_deg)

    @property
    def middle_mm(self) -> NDArray[np.float64]:
        """(3,) middle of the ball in the rig's frame."""
        return self.plane.points(*self.position_mm, self.radius_mm)

    def middle_px(self) -> NDArray[np.float64]:
        """(2,) column and row where the ball's middle appears (its outline is an ellipse about nearly the same)."""
        return seen_at(self.camera, self.middle_mm)

    def outline_px(self, count: int = 360) -> NDArray[np.float64]:
        """(count, 2) column and row of points of the ball's outline."""
        view = self._towards_camera(self.middle_mm)
        return seen_at(self.camera, self._rim(view, self.camera.model == "perspective", count))

    def highlights_mm(self) -> NDArray[np.float64]:
        """(L, 3) points of the ball that mirror the LEDs' middles to the camera."""
        places = _positions_of(self.leds, "a ball")
        normals = np.tile((0.0, 0.0, 1.0), (len(places), 1))
        for _ in range(60):  # the ball is small beside the distances: each turn shrinks the error by their ratio
            points = self.middle_mm + self.radius_mm * normals
            normals = unit(unit(places - points) + unit(self._towards_camera(points)))
        return np.asarray(self.middle_mm + self.radius_mm * normals)

    def highlights_px(self) -> NDArray[np.float64]:
        """(L, 2) column and row of :meth:`highlights_mm`."""
        return seen_at(self.camera, self.highlights_mm())

    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w) of the base."""
        return np.full(u.shape, self.ground)

    def fraction_lit(self, led: Led) -> Array:
        """Fraction (H, W) of the LED's face that the base sees past the ball."""
        fraction = np.ones(self.camera.image_size)
        places = _disc_points(led, self.bench.led_radius_mm)
        window = self._shadow(places)
        if window is None:
            return fraction
        points = np.stack([axis[window] for axis in self._points], axis=-1).astype(np.float64)
        depth = self._depth_in_shadow(points, places[0])
        step = steps(depth)
        # lines to the rest of the face pass the ball less than the face's radius beside the line to its middle
        pixel = np.hypot(step.column, step.row)
        rim = np.abs(depth) < self.bench.led_radius_mm + 2.0 * pixel
        step, points = Steps(step.column[rim], step.row[rim]), points[rim]
        hidden = np.mean([edge_coverage(self._depth_in_shadow(points, place), step) for place in places], axis=0)
        part = np.where(depth > 0.0, 0.0, 1.0)
        part[rim] = 1.0 - hidden
        fraction[window] = part
        return fraction

    def _depth_in_shadow(self, points: Array, place: Array) -> Array:
        """By how much (mm) the lines from points (..., 3) of the base to the point `place` pass inside the ball."""
        away = points - self.middle_mm
        towards = unit(place - points)
        nearest = np.sum(away * towards, axis=-1)
        return np.asarray(self.radius_mm - np.sqrt(np.maximum(np.sum(away * away, axis=-1) - nearest**2, 0.0)))

    def _shadow(self, places: Array) -> Window | None:
        """Pixels that the ball's shadow from points (N, 3) may reach."""
        rims = [self._rim(place - self.middle_mm, near=True) for place in places]
        low, high = [], []
        for place, rim in zip(self.plane.own(places), map(self.plane.own, rims), strict=True):
            cast = rim[:, :2] + (rim[:, :2] - place[:2]) * (rim[:, 2] / (place[2] - rim[:, 2]))[:, None]
            low.append(cast.min(axis=0))
            high.append(cast.max(axis=0))
        return self.pixels_between(np.min(low, axis=0), np.max(high, axis=0))

    def _rim(self, towards: Array, near: bool, count: int = 360) -> Array:
        """(count, 3) points where lines from its middle plus `towards` (3,), or parallel to that, touch the ball."""
        distance = float(np.linalg.norm(towards))
        view = towards / distance
        nearer = self.radius_mm / distance if near else 0.0
        across = unit(np.cross(view, (1.0, 0.0, 0.0) if abs(view[0]) < 0.9 else (0.0, 1.0, 0.0)))
        angle = 2.0 * np.pi * np.arange(count) / count
        ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(view, across)
        return np.asarray(self.middle_mm + self.radius_mm * (nearer * view + np.sqrt(1.0 - nearer**2) * ring))

    @property
    def _reflectance(self) -> float:
        return self.reflectance if self.reflectance is not None else 0.6 if self.chrome else 0.5

    def _towards_camera(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors (..., 3) from points to the camera."""
        if self.camera.model == "perspective":
            return np.asarray((0.0, 0.0, self.camera.height_mm) - points)
        return np.broadcast_to(np.array([0.0, 0.0, self.camera.height_mm]), points.shape)

    @cached_property
    def _ball(self) -> Window | None:
        """Pixels that may see the ball, or None if it is outside the picture."""
        places = self.outline_px()
        low = np.floor(places.min(axis=0)).astype(int) - 3
        high = np.ceil(places.max(axis=0)).astype(int) + 4
        height, width = self.camera.image_size
        left, top = (int(v) for v in np.maximum(low, 0))
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        return (slice(top, bottom), slice(left, right)) if bottom - top >= 2 and right - left >= 2 else None

    def _seen(self, sight: SightLines) -> tuple[Lines, Array]:
        """Where lines of sight meet the ball, its normals there, and by how much (mm) they pass inside its outline.

        Lines that pass it are taken to touch it.
        """
        down = directions(sight)
        away = np.stack([sight.x, sight.y, np.zeros_like(sight.x)], axis=-1) - self.middle_mm
        nearest = away - np.sum(away * down, axis=-1, keepdims=True) * down  # of the line to the ball's middle
        beside2 = np.sum(nearest * nearest, axis=-1)
        depth = np.sqrt(np.maximum(self.radius_mm**2 - beside2, 0.0))
        normals = unit(nearest - depth[..., None] * down)
        return (self.middle_mm + self.radius_mm * normals, normals), self.radius_mm - np.sqrt(beside2)

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        grey = super()._grey(leds)
        if self._ball is None:
            return grey
        lines = _cut(self._sight, self._ball)
        seen, inwards = self._seen(lines)
        ball = self._mirrored(leds, lines, seen) if self.chrome else self._matt(leds, seen)
        grey[self._ball] += edge_coverage(inwards) * (ball - grey[self._ball])
        return grey

    def _matt(self, leds: tuple[Led, ...], seen: Lines) -> Array:
        """Radiance (h, w) of the grey ball."""
        points, normals = seen
        received = np.zeros(points.shape[:2])
        for led in leds:
            received += irradiance(led, _axes(points), np.moveaxis(normals, -1, 0))
        return np.asarray(self._reflectance * (received / np.pi + self.ambient_light))

    def _mirrored(self, leds: tuple[Led, ...], lines: SightLines, seen: Lines) -> Array:
        """Radiance (h, w) of the chrome ball: the base, the walls and the LEDs in it."""
        rays = mirrored(lines, seen)
        walls = self.surround * sum(card_radiance(led) for led in leds) + self.ambient_light
        start, way = self.plane.own(rays[0]), rays[1] @ self.plane.axes
        falls = way[..., 2] < -1e-3
        reach = np.where(falls, -start[..., 2] / np.where(falls, way[..., 2], -1.0), 0.0)
        ground = rays[0] + reach[..., None] * rays[1]
        received = np.zeros(lines.x.shape)
        for led in leds:
            received += irradiance(led, _axes(ground), self.plane.axes[:, 2])
        scene = np.where(falls, self.ground * (received / np.pi + self.ambient_light), walls)
        for led in leds:
            scene = scene + self._led_in_mirror(led, lines, rays)
        return np.asarray(self._reflectance * scene)

    def _led_in_mirror(self, led: Led, lines: SightLines, rays: Lines) -> Array:
        """Radiance (h, w) of an LED's face in the chrome, averaged over each pixel near its rim."""

        inwards, radiance = _led_face(led, self.bench.led_radius_mm, rays)
        step = steps(inwards)
        # in the very middle of the face the distance from its rim has no slope: the neighbours' counts
        pixel = cv2.dilate(np.hypot(step.column, step.row), np.ones((3, 3), np.uint8))
        light = np.where(inwards > 0.0, radiance, 0.0)
        at = np.nonzero(np.abs(inwards) < 2.0 * pixel)
        if at[0].size:
            finer = _finer_lines(lines, at)
            hit, value = _led_face(led, self.bench.led_radius_mm, mirrored(finer, self._seen(finer)[0]))
            light[at] = np.mean(np.where(hit > 0.0, value, 0.0), axis=0)
        return light

    @property
    def _depth(self) -> Array:
        depth = self._hit[2].copy()
        if self._ball is not None:
            seen, inwards = self._seen(_cut(self._sight, self._ball))
            depth[self._ball] = np.where(inwards > 0.0, seen[0][..., 2], depth[self._ball])
        return depth


def _cut(sight: SightLines, window: Window) -> SightLines:
    return SightLines(sight.x[window], sight.y[window], sight.slope_x[window], sight.slope_y[window])


# LEDs in a mirror: where lines of sight go after it, and whether they end on an LED's bright face.

FINER = 12
"""A pixel near a mirrored LED's rim is this many samples wide."""

Lines = tuple[Array, Array]
"""Points (..., 3) and unit vectors (..., 3): normals of a mirror, or directions of rays."""


def unit(vectors: NDArray[np.float64]) -> Array:
    """Vectors (..., 3) of length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def directions(sight: SightLines) -> Array:
    """Unit vectors (..., 3) from the camera."""
    return unit(np.stack([sight.slope_x, sight.slope_y, np.full_like(sight.x, -1.0)], axis=-1))


def mirrored(sight: SightLines, mirror: Lines) -> Lines:
    """Where lines of sight leave a mirror (points and normals) and which way they go then."""
    points, normals = mirror
    down = directions(sight)
    return points, down - 2.0 * np.sum(down * normals, axis=-1, keepdims=True) * normals


def _led_face(led: Led, radius_mm: float, rays: Lines) -> tuple[Array, Array]:
    """By how much (mm) rays pass inside the rim of the LED's face, and the radiance of that face towards them.

    A face of radius r that sends the intensity I straight ahead has the radiance I / (pi r^2) there; seen from beside
    its axis, its lobe's fraction over the cosine of its own foreshortening.
    """
    start, way = rays
    middle = np.asarray(led.position_mm, dtype=np.float64)
    cosine = -(way @ led.axis)
    meets = cosine > 1e-3
    reach = ((middle - start) @ led.axis) / np.where(meets, -cosine, -1.0)
    offset = start + reach[..., None] * way - middle
    inwards = np.where(meets & (reach > 0.0), radius_mm - np.linalg.norm(offset, axis=-1), -1e3)
    ahead = led.intensity * UNIT / (np.pi * max(radius_mm, 1e-6) ** 2)
    return inwards, np.asarray(ahead * np.maximum(cosine, 1e-3) ** (led.lobe_exponent - 1.0))


def _finer_lines(sight: SightLines, at: tuple[NDArray[Any], ...]) -> SightLines:
    """Lines of sight (FINER^2, N) of a square grid of points within the N pixels `at`."""
    places = (np.arange(FINER) + 0.5) / FINER - 0.5
    row, column = np.repeat(places, FINER)[:, None], np.tile(places, FINER)[:, None]

    def finer(value: Array) -> Array:
        step = steps(value)
        return np.asarray(value[at] + row * step.row[at] + column * step.column[at])

    return SightLines(finer(sight.x), finer(sight.y), finer(sight.slope_x), finer(sight.slope_y))


def _axes(points: Array) -> FloatArray:
    """x, y and z (3, h, w) of points (h, w, 3)."""
    return np.moveaxis(points, -1, 0).astype(np.float32)


def _positions_of(leds: Sequence[Led], what: str) -> NDArray[np.float64]:
    """(L, 3) positions in mm of LEDs that all have one, or BadInput: `what` needs them."""
    for index, led in enumerate(leds):
        require(led.position_mm is not None, f"{what} needs LEDs with positions, but LED {index} is distant light.")
    return np.array([led.position_mm for led in leds], dtype=np.float64)


def _disc_points(led: Led, radius_mm: float) -> NDArray[np.float64]:
    """(N, 3) points in mm that stand for equal parts of an LED's bright face: its middle and rings of 6 and of 12.

    Each ring has the mean squared radius of its part of the disc, so that the points have the disc's own spread.
    """
    middle = np.asarray(led.position_mm, dtype=np.float64)
    if radius_mm == 0.0:
        return middle[None]
    axis = led.axis
    across = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    points = [middle]
    for count, fraction, turn in ((6, 4.0 / 19.0, 0.1), (12, 13.0 / 19.0, 0.36)):
        angle = turn + 2.0 * np.pi * np.arange(count) / count
        ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
        points.extend(middle + radius_mm * np.sqrt(fraction) * ring)
    return np.array(points)
