"""What the simulated finger knows about itself, in pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.model import BoolArray, Camera
from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.skin_map import SkinMap

if TYPE_CHECKING:
    from splitknit.simulator.finger import Finger, Pose

Array = NDArray[np.float64]


def find_landmarks(
    finger: Finger,
    pose: Pose,
    *,
    mask: BoolArray,
    chart: NDArray[np.float32],
    skin: SkinMap,
    master: MasterPrint,
    camera: Camera,
) -> dict[str, Any]:
    """Collect landmarks; pixel positions are (column, row), NaN or absent where not in view.

    `chart` (H, W, 2) holds (u, v) of every visible pixel.
    """
    lattice = _Lattice(mask, chart, max(1, int(0.35 * camera.px_per_mm)))

    def pixels(points: Any) -> Array:
        return lattice.find(np.asarray(points, dtype=np.float64).reshape(-1, 2))

    def visible(points: Any) -> Array:
        found = pixels(points)
        return np.asarray(found[np.isfinite(found).all(axis=1)])

    creases = [visible(line[::8]) for line in skin.crease_lines]
    minutiae = pixels(master.minutiae[:, :2]) if len(master.minutiae) else np.zeros((0, 2))
    return {
        "tip_px": _tip(mask, pose),
        "crease_px": creases,
        "cores_px": pixels(master.cores_mm),
        "deltas_px": pixels(master.deltas_mm),
        "minutiae_px": minutiae[np.isfinite(minutiae).all(axis=1)],
        "seed": finger.seed,
        "pattern": master.pattern,
        "yaw_rad": pose.yaw_rad,
        "pitch_rad": pose.pitch_rad,
        "roll_rad": pose.roll_rad,
        "x_mm": pose.x_mm,
        "insertion_mm": pose.insertion_mm,
        "height_mm": pose.height_mm,
        "period_mm": master.period_mm,
    }


class _Lattice:
    """Finds the pixel that shows a point of the chart."""

    def __init__(self, mask: BoolArray, chart: NDArray[np.float32], step: int) -> None:
        rows, columns = np.nonzero(mask[::step, ::step])
        self.seeds = np.stack([columns, rows], 1).astype(np.float64) * step
        self.chart = chart
        self.tree = cKDTree(chart[rows * step, columns * step].astype(np.float64)) if len(rows) else None

    def find(self, points: Array) -> Array:
        """Return (N, 2) columns and rows by Newton steps from the nearest seed; NaN where nothing shows the point."""
        found = np.full(points.shape, np.nan)
        if self.tree is None or not len(points):
            return found
        guess = self.seeds[self.tree.query(points)[1]]
        with np.errstate(invalid="ignore", divide="ignore"):
            for _ in range(6):
                here, along_x, along_y = self._sample(guess)
                miss = points - here
                cross = along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]
                right = (miss[:, 0] * along_y[:, 1] - miss[:, 1] * along_y[:, 0]) / cross
                down = (along_x[:, 0] * miss[:, 1] - along_x[:, 1] * miss[:, 0]) / cross
                guess = guess + np.clip(np.stack([right, down], 1), -60.0, 60.0)
            here, _, _ = self._sample(guess)
        good = np.abs(points - here).max(axis=1) < 0.01
        found[good] = guess[good]
        return found

    def _sample(self, pixels: Array) -> tuple[Array, Array, Array]:
        """Chart and its steps per column and per row at (N, 2) positions; NaN outside the finger."""
        rows, columns = self.chart.shape[:2]
        inside = np.isfinite(pixels).all(axis=1)
        inside &= (pixels >= 0).all(axis=1) & (pixels[:, 0] <= columns - 1) & (pixels[:, 1] <= rows - 1)
        safe = np.where(inside[:, None], pixels, 0.0)
        j = np.clip(safe[:, 0].astype(np.intp), 0, max(columns - 2, 0))
        i = np.clip(safe[:, 1].astype(np.intp), 0, max(rows - 2, 0))
        i1, j1 = np.minimum(i + 1, rows - 1), np.minimum(j + 1, columns - 1)
        a, b = self.chart[i, j].astype(np.float64), self.chart[i, j1].astype(np.float64)
        c, d = self.chart[i1, j].astype(np.float64), self.chart[i1, j1].astype(np.float64)
        fx, fy = (safe[:, 0] - j)[:, None], (safe[:, 1] - i)[:, None]
        along_x = (1 - fy) * (b - a) + fy * (d - c)
        along_y = (1 - fx) * (c - a) + fx * (d - b)
        here = a + fx * (b - a) + fy * (c - a) + fx * fy * (a - b - c + d)
        here[~inside] = np.nan
        return here, along_x, along_y


def _tip(mask: BoolArray, pose: Pose) -> Array:
    """(column, row) of the outline's farthest point along the finger."""
    top = np.argmax(mask, axis=0)
    columns = np.nonzero(mask.any(axis=0))[0]
    along = -np.sin(pose.yaw_rad) * columns - np.cos(pose.yaw_rad) * top[columns]
    best = columns[along > along.max() - 0.75]
    column = float(best.mean())
    return np.array([column, float(top[best].mean())])
