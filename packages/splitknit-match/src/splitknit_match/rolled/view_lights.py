"""The lights of one view of a finger between mirrors: LEDs and their images, each where it reaches the skin.

In a mirror's view everything is reflected: the LEDs light the finger by way of their images, and the light that came by
way of the mirror seems to come from the LEDs themselves. So a ring of lights stands around every line of sight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Led, Rig
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.mirrors.reflection import Glass, Sight, facing_fraction, led_image, mirrored_fraction, shade_of
from splitknit.model import FloatArray
from splitknit.skin.grid import Grid, smooth_step

Array = NDArray[np.float64]
EDGE_BAND_MM = 0.3  # beside a light's edge it counts for nothing; as far again until it counts in full


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Points of the finger on a grid of one view's pixels."""

    sight: Sight
    origin_mm: Array  # (3,) of the grid, in the view's frame
    grid: Grid
    points_mm: Array  # (h, w, 3) in the rig's frame
    normals: Array  # (h, w, 3) in the rig's frame

    @staticmethod
    def of(heights_mm: FloatArray, grid: Grid, sight: Sight, origin_mm: Array) -> Skin:
        """The surface of heights (h, w), in perspective along the rays, on a view's grid moved to `origin_mm`."""
        normals = grid.view.in_rig(normals_from_gradients(*height_gradients(heights_mm, grid.pitch_mm)))
        points = sight.to_view(np.stack(grid.view.points(heights_mm), axis=-1).astype(np.float64) + origin_mm)
        return Skin(sight, origin_mm, grid, points, sight.turned(np.asarray(normals, dtype=np.float64)))


def view_light(rig: Rig, glasses: Sequence[Glass], skin: Skin) -> tuple[Rig, NDArray[np.float32]]:
    """The lights as one view has them: in the frame of the view, its origin moved to that of the skin's grid. Light
    that meets two mirrors one after the other is left out. `rig`: `rig.leds[k]` lights image k; `glasses`: all mirrors.

    Returns the rig, and (L, h, w) zero where one of an exposure's lights begins or ends at a mirror's edge, one
    elsewhere: a line of light that is not known to a tenth of a millimetre would look like a ridge.
    """
    sight = skin.sight
    leds, inner = [], []
    for exposure in rig.leds:
        members = [replace(exposure, also=()), *exposure.also]
        lights = [light for led in members for light in _lights(led, glasses, skin)]
        inner.append(np.min([_inner(light, skin.grid.pitch_mm) for light in lights], axis=0))
        # the ring around the line of sight comes first: it stands for the exposure
        ring = "" if sight.plane is None else sight.name
        first = [_in_view(light, skin) for light in lights if light.path == ring]
        others = [_in_view(light, skin) for light in lights if light.path != ring]
        ring_led = replace(first[0], reflected=False)
        leds.append(replace(ring_led, also=(*(replace(led, reflected=False) for led in first[1:]), *others)))
    return replace(rig, leds=tuple(leds), mirrors=()), np.stack(inner).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Light:
    """An LED or its image, in the rig's frame."""

    led: Led
    path: str  # the mirror's name; empty for the LED itself
    facing: NDArray[np.float32]  # (h, w) fraction that the skin is not turned away from
    through: NDArray[np.float32] | None = None  # (h, w) fraction that comes within the mirror's outline


def _lights(led: Led, glasses: Sequence[Glass], skin: Skin) -> list[_Light]:
    found = [_Light(led, "", facing_fraction(skin.points_mm, skin.normals, led))]
    for glass in glasses:
        image = led_image(led, glass.plane, glass.reflectance)
        facing = facing_fraction(skin.points_mm, skin.normals, image)
        through = mirrored_fraction(skin.points_mm, image, glass.plane, glass.corners_mm)
        found.append(_Light(image, glass.name, facing, through))
    return found


def _inner(light: _Light, pitch_mm: float) -> NDArray[np.float32]:
    """(h, w) zero beside the line where the light by way of a mirror ends."""
    if light.through is None or float(np.ptp(light.through)) < 0.5:
        return np.ones(light.facing.shape, dtype=np.float32)
    lit = (light.through > 0.5).astype(np.uint8)
    edge = cv2.morphologyEx(lit, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) * (light.facing > 0.5)
    away = cv2.distanceTransform(1 - edge.astype(np.uint8), cv2.DIST_L2, 5) * pitch_mm
    return smooth_step((away - EDGE_BAND_MM) / EDGE_BAND_MM)


def _in_view(light: _Light, skin: Skin) -> Led:
    """A light of the rig's frame in the view's moved frame, with its shade."""
    sight, grid = skin.sight, skin.grid
    seen = light.led if sight.plane is None else led_image(light.led, sight.plane)
    if seen.position_mm is not None:
        x, y, z = (float(v) for v in np.asarray(seen.position_mm) - skin.origin_mm)
        ax, ay, az = (float(v) for v in seen.axis)
        seen = replace(seen, position_mm=(x, y, z), aim=(ax, ay, az), reflected=True)
    fraction = light.facing if light.through is None else light.facing * light.through
    return replace(seen, shade=shade_of(fraction, grid.view), reflected=True, also=())
