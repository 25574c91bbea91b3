"""The rig with mirrors as it is drawn: mirrors, holders, camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Camera, Mirror, Rig
from splitknit.simulator.mirror_settings import MirrorParts, MirrorViews
from splitknit.simulator.rig import default_rig

Array = NDArray[np.float64]

_HALF = math.sqrt(0.5)
_LIP_WALL_MM = 1.2
_GROOVE_IN_FLOOR_MM = 0.4
_POCKET_MM = 1.0


def mirror_rig(views: MirrorViews, scale: float, seed: int | None = None, intensity_spread: float = 0.1) -> Rig:
    """Return the thesis's rig with a camera that sees the mirrors too, and the mirrors where the drawing has them."""
    rig = default_rig(scale, seed, intensity_spread)
    rows, columns = (round(side * scale) for side in views.image_size)
    camera = replace(rig.camera, px_per_mm=views.px_per_mm * scale, image_size=(rows, columns))
    if views.model == "perspective":
        focal_px = camera.px_per_mm * camera.height_mm
        matrix = np.array([[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]])
        camera = replace(camera, model="perspective", matrix=matrix)
    leds = rig.leds if views.nir else tuple(led for led in rig.leds if led.band != "nir")
    return replace(rig, camera=camera, leds=leds, mirrors=nominal_mirrors(views, camera))


def nominal_mirrors(views: MirrorViews, camera: Camera) -> tuple[Mirror, ...]:
    """Return the mirrors as drawn: the part of each face that the holder's lip leaves free."""
    profile = HolderProfile(views.parts)
    return tuple(
        Mirror(
            name,
            tuple((float(x), float(y), float(z)) for x, y, z in profile.quad(name, camera, *profile.face)),
            views.reflectance,
        )
        for name in views.names
    )


def stop_y_mm(parts: MirrorParts, camera: Camera) -> float:
    """Return where the fingertip stops, in the rig's frame."""
    return min(camera.image_size[0] / camera.px_per_mm / 2 - parts.tip_margin_mm, parts.phalanx_mm / 2)


@dataclass(frozen=True, slots=True)
class HolderProfile:
    """Section of a holder with its mirror: points (distance from the holder's front, height over its foot), mm."""

    parts: MirrorParts

    @property
    def front(self) -> Array:
        """(2,) lower front edge of the mirror's reflecting face."""
        p = self.parts
        return np.array(
            [(p.clearance_mm + _LIP_WALL_MM) * _HALF + 0.2, (p.thick_mm + p.clearance_mm) * _HALF + _LIP_WALL_MM]
        )

    @property
    def face(self) -> tuple[Array, Array]:
        """Lower and upper end of the free face."""
        along = np.array([_HALF, _HALF])
        return self.front + self.parts.lip_mm * along, self.front + self.parts.wide_mm * along

    @property
    def glass(self) -> tuple[Array, Array]:
        """The mirror's ground upper edge, from its front to its back."""
        high = self.face[1]
        return high, high + self.parts.thick_mm * np.array([_HALF, -_HALF])

    @property
    def lip(self) -> tuple[Array, Array, Array]:
        """The lip's end: inner and outer edge, and where its outer face meets the holder's front."""
        along, behind = np.array([_HALF, _HALF]), np.array([_HALF, -_HALF])
        inside = self.front - self.parts.clearance_mm * behind
        outside = inside - _LIP_WALL_MM * behind
        end = self.parts.lip_mm * along
        return inside + end, outside + end, np.array([0.0, outside[1] - outside[0]])

    @property
    def shade(self) -> tuple[Array, Array]:
        """What stands before the mirror below the lip's upper edge, seen from the mirror: dark."""
        high = self.lip[1]
        return high - np.array([0.0, 8.0]), high

    @property
    def back(self) -> tuple[Array, Array]:
        """The holder's top behind the mirror."""
        edge = self.face[1] + (self.parts.thick_mm + self.parts.clearance_mm) * np.array([_HALF, -_HALF])
        return edge, edge + np.array([self.parts.wall_mm, 0.0])

    def quad(self, name: str, camera: Camera, low: Array, high: Array) -> Array:
        """(4, 3) rectangle between two points of the section, along the whole holder, in the rig's frame."""
        p = self.parts
        stop = stop_y_mm(p, camera)
        foot = -p.pad_height_mm + _GROOVE_IN_FLOOR_MM - _POCKET_MM
        half = p.long_mm / 2
        side = (p.widest_mm + p.finger_clearance_mm) / 2 + p.wall_mm + p.gap_mm
        middle, tip = stop + 1.0 - half, stop + p.wall_mm + p.gap_mm
        corners = [(low, -half), (low, half), (high, half), (high, -half)]
        if name == "tip":
            return np.array([(along, tip + u, foot + v) for (u, v), along in corners])
        sign = 1.0 if name == "right" else -1.0
        return np.array([(sign * (side + u), middle + along, foot + v) for (u, v), along in corners])
