"""A simulated finger without photographs, and bodies whose unrolling is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from splitknit.flatten import GridSettings, SurfaceGrid, surface_grid
from splitknit.simulate.finger import Pose, draw_finger, finger_surface
from splitknit.simulate.master_print import MasterPrint
from splitknit.simulate.rig import default_rig
from splitknit.simulate.surface import Surface

PX_PER_MM = 16.0


@dataclass(frozen=True)
class Twin:
    """What the camera sees of a drawn finger, its master print, and its frame."""

    seen: Surface
    master: MasterPrint

    @property
    def ridge_mm(self) -> np.ndarray:
        return self.seen.height_mm - self.seen.shape_mm

    @property
    def frame(self) -> tuple[np.ndarray, tuple[int, int]]:
        return np.eye(3), self.seen.mask.shape

    def grid(self, **settings: Any) -> SurfaceGrid:
        chosen = GridSettings(**{"pitch_mm": 0.5, **settings})
        return surface_grid(self.seen.shape_mm, self.seen.mask, self.seen.camera.pitch_mm, *self.frame, settings=chosen)


@pytest.fixture(scope="session")
def twin() -> Twin:
    """A whorl, lying straight, at a quarter of full scale."""
    finger = draw_finger(731, "whorl")
    master = finger.master()
    return Twin(finger_surface(finger, Pose(insertion_mm=27.0), default_rig(0.25).camera, master=master), master)


def plane_points(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """x and y (mm) of pixels at PX_PER_MM."""
    rows, columns = size
    x = (np.arange(columns) - (columns - 1) / 2)[None, :] / PX_PER_MM
    y = ((rows - 1) / 2 - np.arange(rows))[:, None] / PX_PER_MM
    return np.broadcast_to(x, size), np.broadcast_to(y, size)


def body_grid(height: np.ndarray, mask: np.ndarray, pitch_mm: float = 0.4) -> SurfaceGrid:
    """Nodes of a body, upright as it lies."""
    shape = np.where(mask, height, np.nan).astype(np.float32)
    settings = GridSettings(pitch_mm=pitch_mm)
    return surface_grid(shape, mask, 1 / PX_PER_MM, np.eye(3), mask.shape, settings=settings)
