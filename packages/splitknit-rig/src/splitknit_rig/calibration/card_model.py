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
LED k is its direction to the origin, moved by u and v along two vectors across it; the parameters
are n u and n v, the slopes of the brightness that it makes, in which the model is nearly linear
too.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True, slots=True)
class Order:
    """Which parameters are free."""

    name: str
    lens: int = 0  # coefficients of the lens's fall-off
    # exponents of the beams: ``none`` (all zero), ``band`` (one for the LEDs of a band) or ``led``
    beam: str = "none"
    # whether every LED has an axis of its own; all point to the origin otherwise
    aims: bool = False


LADDER = (
    Order("brightness of every LED"),
    Order("brightness of every LED, lens", lens=2),
    Order("brightness of every LED, lens, one beam for each band", lens=2, beam="band"),
    Order(
        "brightness and aim of every LED, lens, one beam for each band",
        lens=2,
        beam="band",
        aims=True,
    ),
    Order("brightness, aim and beam of every LED, lens", lens=2, beam="led", aims=True),
)
"""From the simplest to the richest; each contains the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Parameters of the model, written out for every LED."""

    brightness: Array  # (L,)
    exponent: Array  # (L,)
    tilt: Array  # (L, 2): u and v
    lens: Array  # (2,)


_MIN_LOBE_EXPONENT = 0.02  # of a beam: below it an aim has no meaning


class CardModel:
    """Geometry of a card under `leds`, seen at `pixels`: everything that does not change while
    fitting."""

    def __init__(self, camera: Camera, leds: Sequence[Led], pixels: Array, card: CardPlane) -> None:
        """Prepare what does not depend on the parameters."""
        points = card.points(camera, pixels)
        self.count = len(leds)
        self.squared = _squared_radius(camera.image_size, pixels)
        names = sorted({led.band for led in leds})
        self.band = np.array([names.index(led.band) for led in leds])
        self.frames = np.empty((self.count, 3, 3))  # axis, across, across
        self.known = np.empty((self.count, len(pixels)))
        # direction from the LED to the point, in its frame
        self.seen = np.empty((self.count, 3, len(pixels)))
        for k, led in enumerate(leds):
            towards, distance = rays_to_led(led, points)
            self.known[k] = np.log(UNIT_MM2 / np.pi * (towards @ card.normal) / distance**2)
            self.frames[k] = _frame(led)
            self.seen[k] = -self.frames[k] @ towards.T

    def size(self, order: Order) -> int:
        """Number of parameters of `order`."""
        return sum(len(part) for part in self._places(order))

    def _places(self, order: Order) -> tuple[range, range, range, range]:
        """Where brightness, lens, exponents and tilts stand in the vector of parameters."""
        beams = {"none": 0, "band": int(self.band.max()) + 1, "led": self.count}[order.beam]
        sizes = self.count, order.lens, beams, 2 * self.count if order.aims else 0
        a, b, c, d = itertools.accumulate(sizes)
        return range(a), range(a, b), range(b, c), range(c, d)

    def _beam_of(self, order: Order) -> NDArray[np.intp]:
        """(L,) which of an order's beams, if it has any, is an LED's."""
        return self.band if order.beam == "band" else np.arange(self.count)

    def vector(self, answer: Answer, order: Order) -> Array:
        """Parameters of `order` that come closest to `answer`; a beam that is aimed for the first
        time is not flat."""
        exponent = np.maximum(answer.exponent, _MIN_LOBE_EXPONENT if answer.tilt.any() else 1.0)
        own, beams = self._beam_of(order), range(len(self._places(order)[2]))
        parts = [np.log(answer.brightness), answer.lens[: order.lens]]
        parts.append(np.array([exponent[own == b].mean() for b in beams]))
        if order.aims:
            parts.append((answer.tilt * exponent[:, None]).ravel())
        return np.concatenate(parts)

    def answer(self, vector: Array, order: Order) -> Answer:
        """Parameters written out for every LED."""
        light, lens, beams, tilts = (vector[list(part)] for part in self._places(order))
        exponent = beams[self._beam_of(order)] if len(beams) else np.zeros(self.count)
        tilt = tilts.reshape(-1, 2) / exponent[:, None] if order.aims else np.zeros((self.count, 2))
        return Answer(
            np.exp(light), exponent, tilt, np.concatenate([lens, np.zeros(2 - len(lens))])
        )

    def bounds(self, order: Order) -> tuple[Array, Array]:
        """Least and greatest values: a lens that keeps some light, beams from flat to narrow."""
        _, lens, beams, _ = self._places(order)
        low, high = np.full((2, self.size(order)), [[-np.inf], [np.inf]])
        low[list(lens)], high[list(lens)] = -0.95, 0.95
        low[list(beams)], high[list(beams)] = _MIN_LOBE_EXPONENT, 200.0
        return low, high

    def project(self, vector: Array, order: Order) -> Array:
        """Nearest parameters that can be: within bounds, and beams narrow enough to be aimed within
        35 deg."""
        moved = np.clip(vector, *self.bounds(order))
        if order.aims:
            _, _, beams, tilts = self._places(order)
            # an aim is tilted from the direction to the origin by a tangent of 0.7 at most: 35 deg
            needed = np.abs(moved[list(tilts)]).reshape(-1, 2).max(axis=1) / 0.7
            np.maximum.at(moved, beams[0] + self._beam_of(order), needed)
        return np.asarray(moved)

    def logarithm(self, answer: Answer) -> Array:
        """Model (L, N): ln of the brightness."""
        return (
            np.log(answer.brightness)[:, None]
            + self.known
            + answer.exponent[:, None] * self._log_cosine(answer)
            + np.log(self._fall_off(answer.lens))
        )

    def jacobian(self, answer: Answer, order: Order) -> Array:
        """(L, N, P) derivatives of :meth:`logarithm`."""
        jacobian = np.zeros((*self.known.shape, self.size(order)))
        light, lens, beams, tilts = self._places(order)
        fall_off = self._fall_off(answer.lens)
        log_cosine, own = self._log_cosine(answer), self._beam_of(order)
        for k, by_parameter in enumerate(jacobian):
            by_parameter[:, light[k]] = 1.0
            for power, place in enumerate(lens):
                by_parameter[:, place] = self.squared ** (power + 1) / fall_off
            if not beams:
                continue
            u, v = answer.tilt[k]
            along = np.maximum(self.seen[k, 0] + u * self.seen[k, 1] + v * self.seen[k, 2], 1e-6)
            by_u = self.seen[k, 1] / along - u / (1 + u * u + v * v)
            by_v = self.seen[k, 2] / along - v / (1 + u * u + v * v)
            # at constant n u and n v
            by_parameter[:, beams[own[k]]] = log_cosine[k] - u * by_u - v * by_v
            if tilts:
                by_parameter[:, tilts[2 * k]] = by_u
                by_parameter[:, tilts[2 * k + 1]] = by_v
        return jacobian

    def exponents(self, values: Array, order: Order) -> Array:
        """(L,) what a vector of parameters (or of their errors) implies for each LED's exponent;
        NaN where nothing."""
        beams = values[list(self._places(order)[2])]
        return beams[self._beam_of(order)] if len(beams) else np.full(self.count, np.nan)

    def prior(self, order: Order) -> tuple[Array, Array]:
        """Middle and inverse width of the prior of every parameter: exponents 5 +- 20, slopes 0 +-
        4."""
        middle, inverse = np.zeros(self.size(order)), np.zeros(self.size(order))
        _, _, beams, tilts = self._places(order)
        middle[list(beams)], inverse[list(beams)] = 5.0, 1 / 20.0
        inverse[list(tilts)] = 1 / 4.0
        return middle, inverse

    def aim(self, answer: Answer, k: int) -> Array:
        """(3,) axis of LED k in the rig's frame, from the LED outwards, of unit length."""
        axis = np.array([1.0, *answer.tilt[k]]) @ self.frames[k]
        return np.asarray(axis / np.linalg.norm(axis))

    def _log_cosine(self, answer: Answer) -> Array:
        u, v = answer.tilt[:, :1], answer.tilt[:, 1:]
        along = self.seen[:, 0] + u * self.seen[:, 1] + v * self.seen[:, 2]
        return np.log(np.maximum(along, 1e-6)) - 0.5 * np.log(1 + u * u + v * v)

    def _fall_off(self, lens: Array) -> Array:
        return np.asarray(np.maximum(1 + lens[0] * self.squared + lens[1] * self.squared**2, 0.02))


def _frame(led: Led) -> Array:
    """Rows: direction from the LED to the origin, and two unit vectors across it."""
    axis = -np.asarray(led.position_mm, dtype=np.float64)
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([axis, first, np.cross(axis, first)])
