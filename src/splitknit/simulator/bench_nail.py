"""The nail: a cone on the rig's base, and its shadows, from which the LEDs' places follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Led
from splitknit.simulator.bench_scene import GroundScene, Window, disc_points, irradiance, positions_of
from splitknit.simulator.bench_sight import Array, Plane, base_plane, inside, seen_at


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
        super().__post_init__()
        require(
            0.0 < self.tip_radius_mm <= self.base_radius_mm,
            f"the nail's tip must not be wider than its base, but the radii are {self.tip_radius_mm} mm and "
            f"{self.base_radius_mm} mm.",
        )
        require(self.nail_mm > 0.0, f"the nail's height must be positive, but it is {self.nail_mm} mm.")
        heights = self.plane.own(positions_of(self.leds, "a nail"))[:, 2]
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
    def plane(self) -> Plane:
        """Where the base lies."""
        return base_plane(self.tilt_deg)

    @property
    def tip_mm(self) -> NDArray[np.float64]:
        """(3,) middle of the nail's tip in the rig's frame."""
        return self.plane.points(*self.position_mm, self.nail_mm)

    def shadow_tips_mm(self) -> NDArray[np.float64]:
        """(L, 3) where the rays from the LEDs' middles through the tip's middle meet the base, in the rig's frame."""
        places = self.plane.own(positions_of(self.leds, "a nail"))
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

    def share_lit(self, led: Led) -> Array:
        """Share (H, W) of the LED's face that the base sees past the nail: 0 in the core shadow, soft at its rim."""
        share = np.ones(self.camera.image_size)
        places = self.plane.own(disc_points(led, self.bench.led_radius_mm))
        casts = [self._cast(place) for place in places]
        window = self._window(casts)
        if window is None:
            return share
        hidden = np.zeros(share[window].shape)
        for cast in casts:
            hidden += self._inside(window, cast)
        share[window] -= hidden / len(casts)
        return share

    def _grey(self, leds: tuple[Led, ...]) -> Array:
        grey = super()._grey(leds)
        outline = self._outline()
        window = self._window([outline])
        if window is None:
            return grey
        share = self._inside(window, outline)
        points, normal = self._surface(window)
        received = np.zeros(share.shape)
        for led in leds:
            received += irradiance(led, np.moveaxis(points, -1, 0), np.moveaxis(normal, -1, 0))
        cone = self.reflectance * (received / np.pi + self.room_light)
        grey[window] += share * (cone - grey[window])
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
        """Share of each pixel of the window inside the hull of the nail's foot and of its tip's shadow.

        The shadow of a cone on the plane on which it stands is that hull, and the shadow of its flat tip a circle.
        """
        u, v = self._hit[0][window], self._hit[1][window]
        foot = np.asarray(self.position_mm, dtype=np.float64)
        return inside(-_hull_distance(u - foot[0], v - foot[1], self.base_radius_mm, cast[0] - foot, cast[1]))

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
