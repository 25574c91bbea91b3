"""What a calibrated rig lets a white Lambertian card show: the flat field as a model, at any height.

Pixel p of the image under LED k sees, on a card that lies near the finger plane,

    I_k(p) = c S(p) E_k(x) / pi,    E_k(x) = 10^4 i_k cos(theta) cos(beta)^n / d^2,

with the fall-off S of the lens, the card's brightness c, and, from LED k to the point x that the pixel sees, the
distance d, the angle theta to the card's normal and the angle beta to the LED's axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging import shading_at
from splitknit.imaging.view import plane_points
from splitknit.model import Camera, Led

Array = NDArray[np.float64]

UNIT_MM2 = 1e4
"""An LED of intensity one gives the irradiance one at 100 mm."""


@dataclass(frozen=True, slots=True)
class CardPlane:
    """Where a card lies."""

    height_mm: float = 0.0
    """z of its surface on the camera's axis: its thickness, if it lies on the finger plane."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Parts along x and y of its turn against the finger plane, right-handed."""

    def __post_init__(self) -> None:
        require(abs(self.height_mm) <= 1000, f"the card's height must be in mm, but it is {self.height_mm:g}.")
        require(max(abs(t) for t in self.tilt_deg) <= 10, f"the card's tilt is {self.tilt_deg} deg, more than 10.")

    @property
    def normal(self) -> Array:
        """(3,) unit vector out of the card."""
        a, b = np.deg2rad(self.tilt_deg)
        angle = float(np.hypot(a, b))
        share = float(np.sinc(angle / np.pi))
        return np.array([share * b, -share * a, np.cos(angle)])

    def points(self, camera: Camera, pixels: Any) -> Array:
        """Points (N, 3) in mm that `pixels` (N, 2; column, row) see on the card.

        Raises
        ------
        BadInput
            If the card does not lie below the camera.
        """
        require(
            self.height_mm < camera.height_mm, f"the card's height, {self.height_mm:g} mm, is not below the camera."
        )
        places = plane_points(camera, pixels)
        x, y, z = self.normal
        if camera.model == "perspective":
            share = z * (camera.height_mm - self.height_mm) / (z * camera.height_mm - places @ (x, y))
            return np.column_stack([places * share[:, None], camera.height_mm * (1 - share)])
        return np.column_stack([places, self.height_mm - places @ (x, y) / z])


def squared_radius(image_size: Sequence[int], pixels: Any) -> Array:
    """(N,) squared distance of `pixels` from the image's centre over half its diagonal: r^2 of ``Camera.shading``."""
    places = np.asarray(pixels, dtype=np.float64)
    rows, columns = int(image_size[0]), int(image_size[1])
    x, y = places[:, 0] - 0.5 * (columns - 1), places[:, 1] - 0.5 * (rows - 1)
    return np.asarray((x * x + y * y) / (0.25 * (rows**2 + columns**2)))


def lens_fall_off(camera: Camera, pixels: Any) -> Array:
    """(N,) brightness of the lens at `pixels` relative to the image's centre."""
    return shading_at(camera.shading, squared_radius(camera.image_size, pixels))


def rays_to_led(led: Led, points_mm: Any) -> tuple[Array, Array]:
    """Unit vectors (N, 3) from points to a near LED, and their distances (N,) in mm.

    Raises
    ------
    BadInput
        If the LED is distant: it has no place, and so no flat field of its own.
    """
    require(led.position_mm is not None, "a flat field needs LEDs with position_mm; this rig has distant ones.")
    away = np.asarray(led.position_mm, dtype=np.float64) - np.asarray(points_mm, dtype=np.float64)
    distance = np.linalg.norm(away, axis=1)
    return away / distance[:, None], distance


def facing_light(led: Led, points_mm: Any) -> Array:
    """(N,) irradiance of a surface at points (N, 3) that faces the LED."""
    towards, distance = rays_to_led(led, points_mm)
    along = np.maximum(-(towards @ led.axis), 1e-12)
    return np.asarray(led.intensity * UNIT_MM2 * along**led.lobe_exponent / distance**2)


def card_light(camera: Camera, led: Led, pixels: Any, card: CardPlane | None = None) -> Array:
    """(N,) brightness at `pixels` of an ideal white card, lens included: the flat field.

    Parameters
    ----------
    camera : Camera
    led : Led
        Near.
    pixels : (N, 2) columns and rows
    card : where the card lies; on the finger plane by default

    Returns
    -------
    (N,) in the units of the rig: an LED of intensity one at 100 mm gives a facing card 1 / pi
    """
    plane = card or CardPlane()
    points = plane.points(camera, pixels)
    towards, _ = rays_to_led(led, points)
    return np.asarray(facing_light(led, points) * (towards @ plane.normal) * lens_fall_off(camera, pixels) / np.pi)
