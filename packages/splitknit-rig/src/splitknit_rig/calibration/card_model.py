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
    """Where a card lies."""

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
        """(3,) unit vector out of the card."""
        a, b = np.deg2rad(self.tilt_deg)
        angle = float(np.hypot(a, b))
        fraction = float(np.sinc(angle / np.pi))
        return np.array([fraction * b, -fraction * a, np.cos(angle)])

    def points(self, camera: Camera, pixels: Any) -> Array:
        """Points (N, 3) in mm that `pixels` (N, 2; column, row) see on the card; BadInput unless
        below the camera."""
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
    facing = np.asarray(led.intensity * UNIT_MM2 * along**led.lobe_exponent / distance**2)
    return (
        facing
        * (towards @ plane.normal)
        * shading_at(camera.shading, _squared_radius(camera.image_size, pixels))
        / np.pi
    )


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Parameters of the model for every LED."""

    brightness: Array  # (L,)
    exponent: Array  # (L,)
    tilt: Array  # (L, 2): u and v
    lens: Array  # (2,)


class CardModel:
    """Geometry of a card under `leds`, seen at `pixels`: everything that does not change while
    fitting. The vector of parameters has the lens's a and b, then ln c, n, u and v of every LED."""

    bounds = ([-0.95] * 2, [-np.inf, 0.02, -0.7, -0.7]), ([0.95] * 2, [np.inf, 200.0, 0.7, 0.7])
    """Least and greatest values, of the lens and of an LED: a lens that keeps some light, beams
    from flat to narrow, an aim within 35 deg."""

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
        """Vector of parameters, one for the lens and one that all LEDs have."""
        return np.concatenate([of_lens, np.tile(of_led, self.count)])

    def answer(self, vector: Array) -> Answer:
        """Parameters written out."""
        of_leds = vector[2:].reshape(-1, 4)
        return Answer(np.exp(of_leds[:, 0]), of_leds[:, 1], of_leds[:, 2:], vector[:2])

    def logarithm(self, vector: Array) -> Array:
        """Model (L, N): ln of the brightness."""
        answer = self.answer(vector)
        return (
            np.log(answer.brightness)[:, None]
            + self.known
            + answer.exponent[:, None] * self._log_cosine(answer.tilt)
            + np.log(self._fall_off(answer.lens))
        )

    def jacobian(self, vector: Array) -> Array:
        """(L, N, P) derivatives of :meth:`logarithm`."""
        answer = self.answer(vector)
        jacobian = np.zeros((*self.known.shape, len(vector)))
        fall_off = self._fall_off(answer.lens)
        jacobian[..., 0] = self.squared / fall_off
        jacobian[..., 1] = self.squared**2 / fall_off
        log_cosine = self._log_cosine(answer.tilt)
        for k, by_parameter in enumerate(jacobian):
            tilt, exponent = answer.tilt[k], answer.exponent[k]
            along = np.maximum(self.seen[k, 0] + tilt @ self.seen[k, 1:], 1e-6)
            by_tilt = (self.seen[k, 1:] / along).T - tilt / (1 + tilt @ tilt)
            by_parameter[:, 2 + 4 * k] = 1.0
            by_parameter[:, 3 + 4 * k] = log_cosine[k]
            by_parameter[:, 4 + 4 * k : 6 + 4 * k] = exponent * by_tilt
        return jacobian

    def aim(self, answer: Answer, k: int) -> Array:
        """(3,) axis of LED k in the rig's frame, from the LED outwards, of unit length."""
        axis = np.array([1.0, *answer.tilt[k]]) @ self.frames[k]
        return np.asarray(axis / np.linalg.norm(axis))

    def _log_cosine(self, tilt: Array) -> Array:
        along = self.seen[:, 0] + np.einsum("ki,kin->kn", tilt, self.seen[:, 1:])
        length = np.linalg.norm(tilt, axis=1)[:, None]
        return np.asarray(np.log(np.maximum(along, 1e-6)) - 0.5 * np.log(1 + length**2))

    def _fall_off(self, lens: Array) -> Array:
        return np.asarray(np.maximum(1 + lens[0] * self.squared + lens[1] * self.squared**2, 0.02))


def _frame(led: Led) -> Array:
    """Rows: direction from the LED to the origin, and two unit vectors across it."""
    axis = -np.asarray(led.position_mm, dtype=np.float64)
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([axis, first, np.cross(axis, first)])
