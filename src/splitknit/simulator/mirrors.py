"""Plane mirrors: what lies behind them, and the light that they send."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Led, Mirror
from splitknit.simulator.mirror_settings import MirrorViews
from splitknit.simulator.raycast import Placement

Array = NDArray[np.float64]
Numbers = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class Reflection:
    """Reflection in a plane: x -> matrix x + offset, its own inverse."""

    matrix: Array
    """(3, 3)."""
    offset: Array
    """(3,) mm."""

    @classmethod
    def of(cls, mirror: Mirror) -> Reflection:
        """The reflection in a mirror's plane."""
        normal, point = mirror.normal, mirror.point_mm
        return cls(np.eye(3) - 2.0 * np.outer(normal, normal), 2.0 * normal * float(normal @ point))

    def points(self, points: Array) -> Array:
        """(..., 3) points, reflected."""
        return np.asarray(points @ self.matrix.T + self.offset)

    def vectors(self, vectors: Array) -> Array:
        """(..., 3) directions, reflected."""
        return np.asarray(vectors @ self.matrix.T)

    def placement(self, placement: Placement) -> Placement:
        """Where the reflected finger lies: a left-handed frame."""
        return Placement(self.matrix @ placement.rotation, self.points(placement.shift))

    def led(self, led: Led, reflectance: float) -> Led:
        """The image of an LED: as bright as the mirror lets it."""
        others = tuple(self.led(other, reflectance) for other in led.also)
        changes = {"intensity": led.intensity * reflectance, "also": others, "reflected": True}
        aim = None if led.position_mm is None else _triple(self.vectors(led.axis))
        if led.position_mm is None:
            return replace(led, direction=_triple(self.vectors(np.asarray(led.direction))), **changes)  # type: ignore[arg-type]
        position = _triple(self.points(np.asarray(led.position_mm)))
        return replace(led, position_mm=position, aim=aim, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """The outline through which light must pass: the face of a mirror, convex."""

    corners: Array
    """(N, 3)."""

    def reflected(self, reflection: Reflection) -> Gate:
        """The same outline behind a mirror."""
        return Gate(reflection.points(self.corners))

    def share(self, x: Numbers, y: Numbers, z: Numbers, led: Led, radius_mm: float) -> NDArray[np.float32]:
        """Share of an LED's face, of `radius_mm`, that points see through the outline: 0 to 1, their shape."""
        middle, normal, inwards = self._frame()
        source = np.asarray(led.position_mm if led.position_mm is not None else led.direction, dtype=np.float64)
        px, py, pz = x - middle[0], y - middle[1], z - middle[2]
        here = px * normal[0] + py * normal[1] + pz * normal[2]
        if led.position_mm is None:
            dx, dy, dz = source
            along = np.broadcast_to(float(source @ normal), here.shape)
        else:
            dx, dy, dz = source[0] - x, source[1] - y, source[2] - z
            along = float((source - middle) @ normal) - here
        crossing = -here / np.where(np.abs(along) < 1e-9, 1e-9, along)
        qx, qy, qz = px + crossing * dx, py + crossing * dy, pz + crossing * dz
        inside = np.full(here.shape, np.inf)
        for (ex, ey, ez), distance in inwards:
            inside = np.minimum(inside, qx * ex + qy * ey + qz * ez + distance)
        ahead = crossing > 0.0
        soft = np.maximum(radius_mm * crossing, 1e-3) if led.position_mm is not None else np.full(here.shape, 1e-3)
        if led.position_mm is not None:
            ahead &= crossing < 1.0
        share = np.clip(0.5 + 0.5 * inside / np.where(ahead, soft, 1.0), 0.0, 1.0)
        return np.where(ahead, share * share * (3.0 - 2.0 * share), 0.0).astype(np.float32)

    def _frame(self) -> tuple[Array, Array, list[tuple[Array, float]]]:
        """Middle, normal, and for every edge its inward direction and the middle's distance from it."""
        middle = self.corners.mean(axis=0)
        _, _, axes = np.linalg.svd(self.corners - middle)
        edges = []
        for start, end in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            inward = np.cross(axes[2], end - start)
            inward /= np.linalg.norm(inward)
            distance = float(inward @ (middle - start))
            edges.append((inward if distance > 0 else -inward, abs(distance)))
        return middle, np.asarray(axes[2]), edges


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """An LED, or its image in a mirror, seen through that mirror's face."""

    led: Led
    gate: Gate | None = None

    def reflected(self, reflection: Reflection) -> Light:
        """The same behind a mirror, at full strength."""
        gate = None if self.gate is None else self.gate.reflected(reflection)
        return Light(reflection.led(self.led, 1.0), gate)


def lights_of(led: Led, mirrors: Sequence[Mirror]) -> list[Light]:
    """Everything that lights the finger when `led` is on: itself and its image in every mirror.

    Light that meets two mirrors one after the other is left out.
    """
    images = [
        Light(Reflection.of(mirror).led(led, mirror.reflectance), Gate(np.asarray(mirror.corners_mm)))
        for mirror in mirrors
    ]
    return [Light(led), *images]


def as_built(mirrors: Sequence[Mirror], views: MirrorViews, seed: int) -> tuple[Mirror, ...]:
    """Draw where the mirrors truly are: turned about their middle and shifted against the drawing."""
    drawn = []
    for mirror in mirrors:
        number = ("left", "right", "tip").index(mirror.name)
        rng = np.random.default_rng(np.random.SeedSequence([seed, 0x3117, number]))
        turn = np.clip(views.turn_sd_deg * rng.standard_normal(3), -views.turn_most_deg, views.turn_most_deg)
        shift = np.clip(views.shift_sd_mm * rng.standard_normal(3), -views.shift_most_mm, views.shift_most_mm)
        rotation = np.asarray(cv2.Rodrigues(np.deg2rad(turn))[0], dtype=np.float64)
        middle = mirror.point_mm
        corners = (np.asarray(mirror.corners_mm) - middle) @ rotation.T + middle + shift
        drawn.append(replace(mirror, corners_mm=tuple(_triple(corner) for corner in corners)))
    return tuple(drawn)


def _triple(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
