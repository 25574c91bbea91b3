"""Plane mirrors: what a camera sees in them, and the light that they send."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera, Led, Mirror
from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_simulator.camera.lens import pixels_of_points
from splitknit_simulator.finger.raycast import (
    PlacedFinger,
    Placement,
    surface_of,
)
from splitknit_simulator.light.lighting import LED_RADIUS_MM, Vectors
from splitknit_simulator.rigs import SIDES, MirrorSettings, triple
from splitknit_simulator.surface import SimulatedSurface, Window, soft_step


@dataclass(frozen=True, slots=True, eq=False)
class _Reflection:
    """Reflection in a plane: x -> matrix x + offset, its own inverse."""

    matrix: Array  # (3, 3)
    offset: Array  # (3,) mm

    @classmethod
    def of(cls, mirror: Mirror) -> _Reflection:
        """The reflection in a mirror's plane."""
        normal, point = mirror.normal, mirror.point_mm
        return cls(np.eye(3) - 2.0 * np.outer(normal, normal), 2.0 * normal * float(normal @ point))

    def points(self, points: Array) -> Array:
        """(..., 3) points, reflected."""
        return points @ self.matrix.T + self.offset

    def vectors(self, vectors: Array) -> Array:
        """(..., 3) directions, reflected."""
        return vectors @ self.matrix.T

    def placement(self, placement: Placement) -> Placement:
        """Where the reflected finger lies: a left-handed frame."""
        return Placement(self.matrix @ placement.rotation, self.points(placement.shift))

    def led(self, led: Led, reflectance: float) -> Led:
        """The image of an LED: as bright as the mirror lets it."""
        others = tuple(self.led(lamp, reflectance) for lamp in led.also)
        image = replace(led, intensity=led.intensity * reflectance, also=others, reflected=True)
        if led.position_mm is None:
            return replace(image, direction=triple(self.vectors(np.asarray(led.direction))))
        position = triple(self.points(np.asarray(led.position_mm)))
        return replace(image, position_mm=position, aim=triple(self.vectors(led.axis)))


@dataclass(frozen=True, slots=True, eq=False)
class _Gate:
    """The outline through which light must pass: the face of a mirror, convex."""

    corners: Array  # (N, 3)

    def reflected(self, reflection: _Reflection) -> _Gate:
        """The same outline behind a mirror."""
        return _Gate(reflection.points(self.corners))

    def fraction(self, points: Vectors, led: Led) -> NDArray[np.float32]:
        """Fraction of an LED's face that points see through the outline: 0 to 1,
        their shape."""
        x, y, z = points
        middle, normal, inwards = self._frame()
        near = led.position_mm is not None
        source = np.asarray(led.position_mm if near else led.direction, dtype=np.float64)
        px, py, pz = x - middle[0], y - middle[1], z - middle[2]
        here = px * normal[0] + py * normal[1] + pz * normal[2]
        if near:
            dx, dy, dz = source[0] - x, source[1] - y, source[2] - z
            along = float((source - middle) @ normal) - here
        else:
            dx, dy, dz = source
            along = np.broadcast_to(float(source @ normal), here.shape)
        crossing = -here / np.where(np.abs(along) < 1e-9, 1e-9, along)
        qx, qy, qz = px + crossing * dx, py + crossing * dy, pz + crossing * dz
        inside = np.full(here.shape, np.inf)
        for (ex, ey, ez), distance in inwards:
            inside = np.minimum(inside, qx * ex + qy * ey + qz * ez + distance)
        ahead = (crossing > 0.0) & (crossing < (1.0 if near else np.inf))
        soft = np.maximum(LED_RADIUS_MM * crossing, 1e-3) if near else 1e-3
        fraction = soft_step(0.5 + 0.5 * inside / np.where(ahead, soft, 1.0))
        return np.where(ahead, fraction, 0.0).astype(np.float32)

    def _frame(self) -> tuple[Array, Array, list[tuple[Array, float]]]:
        """Middle, normal, and for every edge its inward direction and the middle's distance from
        it."""
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
    gate: _Gate | None = None

    def reflected(self, reflection: _Reflection) -> Light:
        """The same behind a mirror, at full strength."""
        gate = None if self.gate is None else self.gate.reflected(reflection)
        return Light(reflection.led(self.led, 1.0), gate)


def lights_of(led: Led, mirrors: Sequence[Mirror]) -> list[Light]:
    """Everything that lights the finger when `led` is on: itself and its image in every mirror.

    Light that meets two mirrors one after the other is left out.
    """
    reflected = [
        (_Reflection.of(mirror).led(led, mirror.reflectance), mirror.corners_mm)
        for mirror in mirrors
    ]
    return [Light(led), *(Light(image, _Gate(np.asarray(corners))) for image, corners in reflected)]


def as_built(mirrors: Sequence[Mirror], views: MirrorSettings, seed: int) -> tuple[Mirror, ...]:
    """Draw where the mirrors truly are: turned about their middle and shifted against the
    drawing."""
    drawn = []
    for mirror in mirrors:
        rng = np.random.default_rng([seed, 0x3117, SIDES.index(mirror.name)])
        # larger turns (deg) and shifts (mm), about or along any axis, are cut
        turn = np.clip(views.turn_sd_deg * rng.standard_normal(3), -3.0, 3.0)
        shift = np.clip(views.shift_sd_mm * rng.standard_normal(3), -2.0, 2.0)
        rotation = np.asarray(cv2.Rodrigues(np.deg2rad(turn))[0], dtype=np.float64)
        middle = mirror.point_mm
        corners = (np.asarray(mirror.corners_mm) - middle) @ rotation.T + middle + shift
        drawn.append(replace(mirror, corners_mm=tuple(map(triple, corners))))
    return tuple(drawn)


# What a camera sees in a mirror: the surface of the reflected finger.


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How much of each pixel something flat covers."""

    window: Window  # rows and columns of the frame; empty where it lies outside
    fraction: FloatArray  # (h, w) inside the window, 0 to 1


@dataclass(frozen=True, slots=True, eq=False)
class ReflectedView:
    """One mirror and what the camera sees in it."""

    mirror: Mirror  # as it truly is
    reflection: _Reflection
    # the reflected finger, also a little beyond the outline; in the rig's frame, as though there
    # were no mirror
    surface: SimulatedSurface
    coverage: Coverage  # the face in the picture

    @property
    def mask(self) -> BoolArray:
        """(H, W) pixels of the mirror's face that show the finger, if nothing stands before the
        mirror."""
        mask = np.zeros_like(self.surface.mask)
        window = self.coverage.window
        mask[window] = self.surface.mask[window] & (self.coverage.fraction >= 0.5)
        return mask


def mirror_view(
    finger: PlacedFinger, camera: Camera, mirror: Mirror, *, workers: int = 2
) -> ReflectedView:
    """Show the finger's reflection in a mirror, as it truly is, to a camera; the result does not
    depend on `workers`, threads.

    Raises BadInput if the mirror lies outside the picture, or no part of the finger is seen in it.
    """
    reflection = _Reflection.of(mirror)
    behind = replace(finger, placement=reflection.placement(finger.placement))
    coverage = outline_coverage(camera, np.asarray(mirror.corners_mm))
    require(
        (coverage.fraction >= 0.5).any(),
        f"the {mirror.name} mirror lies outside the picture; lower px_per_mm or make image_size"
        " larger.",
    )
    # skin is rendered beyond the mirror's outline, since light diffuses across it
    margin = int(np.ceil(3.0 * camera.px_per_mm))
    rows, columns = (
        slice(max(part.start - margin, 0), min(part.stop + margin, length))
        for part, length in zip(coverage.window, camera.image_size, strict=True)
    )
    surface = _surface(behind, camera, (rows, columns), workers)
    view = ReflectedView(mirror, reflection, surface, coverage)
    require(
        view.mask.any(),
        f"the {mirror.name} mirror shows nothing of the finger; move the finger or the mirror.",
    )
    return view


_COVERAGE_SAMPLES = 8
"""Across a pixel in which a flat outline's coverage is counted. Chosen on: speed."""


def outline_coverage(camera: Camera, corners: Array) -> Coverage:
    """Where an outline (N, 3) appears, its edges as the lens bends them."""
    fraction = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None]
    edges = [
        a + fraction * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    x, y, z = np.concatenate(edges).T
    column, row = pixels_of_points(camera, x, y, z)
    rows, columns = camera.image_size
    first = np.clip(np.floor([column.min() - 1, row.min() - 1]), 0, [columns, rows]).astype(int)
    last = np.clip(np.ceil([column.max() + 2, row.max() + 2]), first, [columns, rows]).astype(int)
    window = slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))
    width, height = (int(size) for size in last - first)
    if width == 0 or height == 0:
        return Coverage(window, np.zeros((height, width), dtype=np.float32))
    fine = np.zeros((height * _COVERAGE_SAMPLES, width * _COVERAGE_SAMPLES), dtype=np.uint8)
    # pixel centres are whole numbers; the fine grid's are at (k + 0.5) / _COVERAGE_SAMPLES - 0.5
    points = (np.stack([column, row], axis=1) - first + 0.5) * _COVERAGE_SAMPLES - 0.5
    cv2.fillPoly(fine, [np.rint(points * 256).astype(np.int32)], 1, cv2.LINE_8, 8)
    covered = cv2.resize(fine.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return Coverage(window, np.asarray(covered, dtype=np.float32))


_SHOWN_PROXIMAL_MM = 32.0
"""From the first crease towards the palm, where the hand's sleeve begins."""


def _surface(finger: PlacedFinger, camera: Camera, box: Window, workers: int) -> SimulatedSurface:
    """The first points of a placed finger on the rays of a part of the camera's pixels."""
    body, placement = finger.body, finger.placement
    shape = body.shape
    half = 0.8 * max(shape.width_mm, shape.thickness_mm)
    corners = np.array(
        [
            (x, y, z)
            for x in (-half, half)
            for y in (-_SHOWN_PROXIMAL_MM, shape.length_mm + 2.0)
            for z in (-half, half)
        ]
    )
    heights = corners @ placement.rotation[2] + placement.shift[2]
    bottom, top = float(heights.min()) - 2.0, float(heights.max()) + 2.0
    return surface_of(finger, camera, box, (top, bottom), workers, reach_mm=_SHOWN_PROXIMAL_MM)
