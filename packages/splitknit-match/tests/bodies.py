"""Bodies whose unrolling is known, and what is known of a simulated finger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit_match.prints.unroll import SurfaceGrid, surface_grid
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.surface import SimulatedSurface

PX_PER_MM = 16.0


@dataclass(frozen=True)
class Twin:
    """What the camera sees of a drawn finger, its master print, and its frame."""

    seen: SimulatedSurface
    master: MasterPrint

    @property
    def ridge_mm(self) -> np.ndarray:
        return self.seen.height_mm - self.seen.shape_mm

    @property
    def frame(self) -> tuple[np.ndarray, tuple[int, int]]:
        return np.eye(3), self.seen.mask.shape

    def grid(self) -> SurfaceGrid:
        return surface_grid(
            self.seen.shape_mm, self.seen.mask, self.seen.camera.pitch_mm, *self.frame, node_mm=0.5
        )


def plane_points(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """x and y (mm) of pixels at PX_PER_MM."""
    rows, columns = size
    x = (np.arange(columns) - (columns - 1) / 2)[None, :] / PX_PER_MM
    y = ((rows - 1) / 2 - np.arange(rows))[:, None] / PX_PER_MM
    return np.broadcast_to(x, size), np.broadcast_to(y, size)


def body_grid(height: np.ndarray, mask: np.ndarray) -> SurfaceGrid:
    """Nodes of a body, upright as it lies."""
    shape = np.where(mask, height, np.nan).astype(np.float32)
    return surface_grid(shape, mask, 1 / PX_PER_MM, np.eye(3), mask.shape, node_mm=0.4)
