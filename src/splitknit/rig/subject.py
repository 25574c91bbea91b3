"""The fingers that all rigs of a sweep photograph: surfaces, and their truth as points."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, Camera
from splitknit.simulator.finger import Finger, Pose, draw_finger, finger_surface, place
from splitknit.simulator.finger_shape import FingerBody
from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.pose_ranges import PoseRanges
from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]
FIELD_MM = (2200 / 75.7, 3200 / 75.7)
"""Rows and columns of the thesis's field on the finger plane."""
ABOVE_CREASE_MM = 0.5
"""The phalange is what lies further towards the tip than this, seen from its crease."""
MAX_SLANT_DEG = 60.0
"""The print is where the shape is flatter than this (``docs/conventions.md``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """A surface as points."""

    phalange: Array
    """(N, 3) mm, all that the camera sees of the phalange."""
    print: BoolArray
    """(N,) which of them carry the print: slant of the shape up to 60 deg."""


@functools.lru_cache(maxsize=16)
def person(seed: int) -> tuple[Finger, MasterPrint]:
    """A finger and its master print; drawing the print is what takes long."""
    finger = draw_finger(seed)
    return finger, finger.master()


def pose_of(seed: int, camera: Camera) -> Pose:
    """How this finger lies: in the same place under any camera, whose rows are only about `FIELD_MM` long."""
    even = Camera(px_per_mm=100.0, image_size=(round(100 * FIELD_MM[0]), round(100 * FIELD_MM[1])))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0C]))
    pose = PoseRanges(height_mm=(0.0, 0.0), insertion_mm=(25.0, 27.0)).draw(rng, even)
    rows_mm = camera.image_size[0] / camera.px_per_mm
    return replace(pose, insertion_mm=pose.insertion_mm + 0.5 * (rows_mm - even.image_size[0] / even.px_per_mm))


def view_of(seed: int, camera: Camera) -> Surface:
    """The finger on the pixels of `camera`."""
    finger, master = person(seed)
    return finger_surface(finger, pose_of(seed, camera), camera, master=master, workers=1)


def phalange(seed: int, surface: Surface) -> BoolArray:
    """(H, W) pixels of the distal phalange: the finger above its first crease."""
    finger, _ = person(seed)
    placement = place(FingerBody(finger.shape), pose_of(seed, surface.camera), surface.camera)
    x, y = places(surface)
    z = np.where(surface.mask, surface.shape_mm, 0.0).astype(np.float64)
    along = np.asarray(placement.to_finger(x.ravel(), y.ravel(), z.ravel())[1]).reshape(z.shape)
    return np.asarray(surface.mask & (along >= ABOVE_CREASE_MM))


def printed(surface: Surface, where: BoolArray) -> BoolArray:
    """(H, W) pixels of `where` whose shape is flat enough to carry the print."""
    return np.asarray(where & (surface.shape_normals[..., 2] > np.cos(np.deg2rad(MAX_SLANT_DEG))))


def places(surface: Surface) -> tuple[Array, Array]:
    """(H, W) x and y of what each pixel sees, mm; of the pixel on the finger plane beside the finger."""
    x, y = grid_places(surface.camera)
    if surface.x_mm is not None and surface.y_mm is not None:
        return np.where(surface.mask, surface.x_mm, x), np.where(surface.mask, surface.y_mm, y)
    return x, y


def grid_places(camera: Camera) -> tuple[Array, Array]:
    """(H, W) x and y of where each pixel looks on the finger plane, mm."""
    rows, columns = camera.image_size
    x = (np.arange(columns) - (columns - 1) / 2) * camera.pitch_mm
    y = ((rows - 1) / 2 - np.arange(rows)) * camera.pitch_mm
    across, up = np.meshgrid(x, y)
    return across, up


@functools.lru_cache(maxsize=8)
def truth(seed: int, px_per_mm: float) -> Points:
    """The true surface, seen straight from above, whatever the rig: what every reconstruction is measured against."""
    size = (round(FIELD_MM[0] * px_per_mm), round(FIELD_MM[1] * px_per_mm))
    surface = view_of(seed, Camera(px_per_mm=px_per_mm, image_size=size))
    whole = phalange(seed, surface)
    x, y = places(surface)
    points = np.stack([x, y, surface.height_mm.astype(np.float64)], axis=-1)
    return Points(points[whole], printed(surface, whole)[whole])
