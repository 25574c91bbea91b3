"""What stands around the finger where there are mirrors: holders, glass, the tube behind it, dust."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, Camera, FloatArray, Led, Mirror
from splitknit.simulator.background import BackgroundSettings, background_albedo
from splitknit.simulator.mirror_light import irradiance
from splitknit.simulator.mirror_parts import HolderProfile
from splitknit.simulator.mirror_settings import MirrorViews
from splitknit.simulator.mirror_view import Coverage, View, outline_coverage

Array = NDArray[np.float64]

_TUBE_MM = 52.0
"""Inner radius of the tube around the finger."""
_STRAY_SHARE = 0.1
"""Light that comes to the tube by way of other things, against that of a white card under the LED."""
_LID_SHARE = 0.2
"""Light from what hangs above the finger, which a second mirror shows, against that from the tube."""


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """A flat piece of plastic or glass in the picture."""

    coverage: Coverage
    middle: Array
    """(3,) mm, where it truly is."""
    normal: Array
    albedo: float

    def radiance(self, led: Led) -> float:
        """What it sends under one LED: matt."""
        return self.albedo / np.pi * irradiance(led, self.middle, self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Everything of one mirror but the finger."""

    name: str
    holder: tuple[Plate, ...]
    """Behind and beside the face, in front of the background."""
    lip: tuple[Plate, ...]
    """In front of the face."""
    reflected_lip: tuple[Plate, ...]
    """What the mirror shows of the lip; its `coverage` is in the mirror, the rest as it truly is."""
    opposite: tuple[Coverage, ...]
    """Where it shows the other mirrors."""
    wall: Plate
    """The tube on the far side of the finger."""
    dust: FloatArray
    """(H, W) albedo of the specks on the face."""


def mirror_frame(
    view: View,
    mirrors: Sequence[Mirror],
    camera: Camera,
    views: MirrorViews,
    rng: np.random.Generator,
) -> Frame:
    """Lay out what surrounds the finger in and around one mirror.

    Parameters
    ----------
    view : of the mirror
    mirrors : all, as they truly are
    camera : of the rig
    views : settings; the holders stand where the drawing has them
    rng : draws the dust
    """
    name, profile = view.mirror.name, HolderProfile(views.parts)
    inwards = _inwards(name)

    def plate(low: Array, high: Array, albedo: float) -> Plate:
        corners = profile.quad(name, camera, low, high)
        return Plate(outline_coverage(camera, corners), corners.mean(axis=0), _face_normal(corners, inwards), albedo)

    low, high = profile.glass
    glass = plate(low, high, views.glass_albedo)
    back = plate(*profile.back, views.plastic_albedo)
    inside, outside, start = profile.lip
    lip = (plate(outside, start, views.plastic_albedo), plate(inside, outside, views.plastic_albedo))
    shown = tuple(
        replace(one, coverage=outline_coverage(camera, view.reflection.points(profile.quad(name, camera, *ends))))
        for one, ends in ((plate(*profile.shade, 0.0), profile.shade), (lip[1], (inside, outside)))
    )
    opposite = tuple(
        outline_coverage(camera, view.reflection.points(np.asarray(other.corners_mm)))
        for other in mirrors
        if other.name != name
    )
    middle = np.append(_TUBE_MM * inwards[:2], -5.0)
    wall = Plate(view.coverage, middle, -inwards, views.plastic_albedo)
    specks = BackgroundSettings(albedo=0.0, dust_per_cm2=views.dust_per_cm2)
    return Frame(name, (glass, back), lip, shown, opposite, wall, background_albedo(camera, specks, rng))


def _inwards(name: str) -> Array:
    """(3,) horizontal direction from a mirror towards the finger and beyond."""
    return {"left": np.array([1.0, 0, 0]), "right": np.array([-1.0, 0, 0]), "tip": np.array([0, -1.0, 0])}[name]


def _face_normal(corners: Array, inwards: Array) -> Array:
    """(3,) unit normal of a rectangle, upwards."""
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normal /= np.linalg.norm(normal)
    lean = normal[2] if abs(normal[2]) > 1e-6 else float(normal @ inwards)
    return np.asarray(normal if lean > 0 else -normal)


def blend(frame: FloatArray, cover: Coverage, over: FloatArray | np.float32, free: BoolArray | None = None) -> None:
    """Replace what `cover` covers of `frame` (H, W, 3) by `over` (H, W, 3), in place; only where `free` (H, W)."""
    share = cover.share if free is None else cover.share * free[cover.window]
    some = frame[cover.window]
    some += share[..., None] * ((over[cover.window] if isinstance(over, np.ndarray) else over) - some)


def visible(view: View, frame: Frame, free: BoolArray) -> BoolArray:
    """(H, W) pixels that show the finger in a mirror: not the lip, not the lip in the mirror, not the finger itself."""
    mask = view.mask & free
    for plate in (*frame.reflected_lip, *frame.lip):
        mask[plate.coverage.window] &= plate.coverage.share < 0.5
    return mask


def background_of(frame: Frame, camera: Camera, led: Led) -> FloatArray:
    """(H, W, 3) radiance of what a mirror shows behind the finger."""
    above = np.array([0.0, 0.0, 1.0])
    stray = _STRAY_SHARE * frame.wall.albedo / np.pi * irradiance(led, np.zeros(3), above)
    wall = frame.wall.radiance(led) + stray
    content = np.full((*camera.image_size, 3), wall, dtype=np.float32)
    for cover in frame.opposite:
        blend(content, cover, np.float32(_LID_SHARE * wall))
    return content
