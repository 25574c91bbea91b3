"""A white Lambertian card under a calibrated rig, at any height: as a model, and as one
least-squares problem.

Pixel p of the image under LED k sees, on a card that lies near the finger plane,

    I_k(p) = c S(p) E_k(x) / pi,    E_k(x) = 10^4 i_k cos(theta) cos(beta)^n / d^2,

with the fall-off S of the lens, the card's brightness c, and, from LED k to the point x that the
pixel sees, the distance d, the angle theta to the card's normal and the angle beta to the LED's
axis.

In logarithms the model of :mod:`splitknit_rig.calibration.card_model` is a sum,

    ln I_k = ln c_k + [place of LED k, known] + n_k ln cos(beta_k) + ln(1 + a r^2 + b r^4),

so that it is linear in the logarithms of the brightnesses c_k and in the exponents n_k. The axis of
LED k is its direction to the origin, moved by u and v along two vectors across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit import Camera, Led
from splitknit.errors import require
from splitknit.imaging.view import plane_points, shading_at
from splitknit.model import Array

UNIT_MM2 = 1e4
"""An LED of intensity one gives the irradiance one at 100 mm.

Source: definition of `intensity` in the rig file.
"""


@dataclass(frozen=True, slots=True)
class CardPlane:
    """Height and tilt of a card."""

    # z of its surface on the camera's axis: its thickness, if it lies on the finger plane
    height_mm: float = 0.0
    # parts along x and y of its turn against the finger plane, right-handed
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        require(
            max(abs(t) for t in self.tilt_deg) <= 10,
            f"the card's tilt is {self.tilt_deg} deg, more than 10.",
        )

    @property
    def normal(self) -> Array:
        """(3,) unit normal of the card."""
        a, b = np.deg2rad(self.tilt_deg)
        angle = float(np.hypot(a, b))
        fraction = float(np.sinc(angle / np.pi))
        return np.array([fraction * b, -fraction * a, np.cos(angle)])

    def points(self, camera: Camera, pixels: Any) -> Array:
        """Points (N, 3) in mm on the card that `pixels` (N, 2; column, row) see. Raises BadInput if
        the card is not below the camera."""
        high = f"the card's height, {self.height_mm:g} mm, is not below the camera."
        require(self.height_mm < camera.height_mm, high)
        places = plane_points(camera, pixels)
        x, y, z = self.normal
        if camera.model == "perspective":
            fraction = (
                z * (camera.height_mm - self.height_mm) / (z * camera.height_mm - places @ (x, y))
            )
            return np.column_stack([places * fraction[:, None], camera.height_mm * (1 - fraction)])
        return np.column_stack([places, self.height_mm - places @ (x, y) / z])


def _squared_radius(image_size: Sequence[int], pixels: Any) -> Array:
    """(N,) squared distance of `pixels` from the image's centre over half its diagonal: r^2 of
    ``Camera.shading``."""
    places = np.asarray(pixels, dtype=np.float64)
    rows, columns = int(image_size[0]), int(image_size[1])
    x, y = places[:, 0] - 0.5 * (columns - 1), places[:, 1] - 0.5 * (rows - 1)
    return (x * x + y * y) / (0.25 * (rows**2 + columns**2))


def rays_to_led(led: Led, points_mm: Any) -> tuple[Array, Array]:
    """Unit vectors (N, 3) from points to a near LED, and their distances (N,) in mm; BadInput if
    the LED is distant."""
    require(
        led.position_mm is not None,
        "a flat field needs LEDs with position_mm; this rig has distant ones.",
    )
    away = np.asarray(led.position_mm, dtype=np.float64) - np.asarray(points_mm, dtype=np.float64)
    distance = np.linalg.norm(away, axis=1)
    return away / distance[:, None], distance


def card_light(camera: Camera, led: Led, pixels: Any, card: CardPlane | None = None) -> Array:
    """(N,) brightness at `pixels` (N, 2) of an ideal white card under a near LED, lens included:
    the flat field. In units of the rig: an LED of intensity one at 100 mm gives a facing card 1 /
    pi. `card`: on the finger plane if None.
    """
    plane = card or CardPlane()
    points = plane.points(camera, pixels)
    towards, distance = rays_to_led(led, points)
    along = np.maximum(-(towards @ led.axis), 1e-12)
    facing = led.intensity * UNIT_MM2 * along**led.lobe_exponent / distance**2
    return (
        facing
        * (towards @ plane.normal)
        * shading_at(camera.shading, _squared_radius(camera.image_size, pixels))
        / np.pi
    )


class CardModel:
    """Geometry of a card under `leds`, seen at `pixels`: everything that does not change while
    fitting. The vector of parameters has the lens's a and b, then ln c, n, u and v of every LED."""

    bounds = ([-0.95] * 2, [-np.inf, 0.02, -0.7, -0.7]), ([0.95] * 2, [np.inf, 200.0, 0.7, 0.7])
    """Lower and upper bounds for the lens and for an LED: the lens transmits some light everywhere,
    beams range from flat to narrow, aims lie within 35 deg."""

    def __init__(self, camera: Camera, leds: Sequence[Led], pixels: Array, card: CardPlane) -> None:
        """Prepare what does not depend on the parameters."""
        points = card.points(camera, pixels)
        self.count = len(leds)
        self.squared = _squared_radius(camera.image_size, pixels)
        self.frames = np.empty((self.count, 3, 3))  # axis, across, across
        self.known = np.empty((self.count, len(pixels)))
        # direction from the LED to the point, in its frame
        self.seen = np.empty((self.count, 3, len(pixels)))
        for k, led in enumerate(leds):
            towards, distance = rays_to_led(led, points)
            self.known[k] = np.log(UNIT_MM2 / np.pi * (towards @ card.normal) / distance**2)
            self.frames[k] = _frame(led)
            self.seen[k] = -self.frames[k] @ towards.T

    def vector(self, of_lens: Sequence[float], of_led: Sequence[float]) -> Array:
        """Vector of parameters, from values of the lens and values that all LEDs share."""
        return np.concatenate([of_lens, np.tile(of_led, self.count)])

    def logarithm(self, vector: Array) -> Array:
        """Model (L, N): ln of the brightness."""
        level, exponent, *tilt = vector[2:].reshape(-1, 4).T[..., None]
        along = self.seen[:, 0] + tilt[0] * self.seen[:, 1] + tilt[1] * self.seen[:, 2]
        log_cosine = np.log(np.maximum(along, 1e-6)) - 0.5 * np.log(1 + tilt[0] ** 2 + tilt[1] ** 2)
        fall_off = 1 + vector[0] * self.squared + vector[1] * self.squared**2
        return np.asarray(
            level + self.known + exponent * log_cosine + np.log(np.maximum(fall_off, 0.02))
        )

    def aim(self, vector: Array, k: int) -> tuple[float, float, float]:
        """Axis of LED k in the rig's frame, from the LED outwards, of unit length, rounded."""
        axis = np.array([1.0, *vector[4 + 4 * k : 6 + 4 * k]]) @ self.frames[k]
        x, y, z = (axis / np.linalg.norm(axis)).round(6).tolist()
        return x, y, z


def _frame(led: Led) -> Array:
    """Rows: direction from the LED to the origin, and two unit vectors across it."""
    axis = -np.asarray(led.position_mm, dtype=np.float64)
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([axis, first, np.cross(axis, first)])
