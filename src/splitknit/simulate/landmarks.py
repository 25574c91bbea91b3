"""What the simulated finger knows about itself, in pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from splitknit.simulate.master_print import MasterPrint
from splitknit.simulate.skin_map import SkinMap
from splitknit.types import BoolArray, Camera

if TYPE_CHECKING:
    from splitknit.simulate.finger import Finger, Pose

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
    step = max(1, int(0.2 * camera.px_per_mm))
    rows, columns = np.nonzero(mask[::step, ::step])
    rows, columns = rows * step, columns * step
    where = LinearNDInterpolator(chart[rows, columns].astype(np.float64), np.stack([columns, rows], 1))

    def pixels(points: Any) -> Array:
        array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return np.asarray(where(array), dtype=np.float64).reshape(-1, 2)

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
        "chart_mm": chart,
    }


def _tip(mask: BoolArray, pose: Pose) -> Array:
    """(column, row) of the outline's farthest point along the finger."""
    top = np.argmax(mask, axis=0)
    columns = np.nonzero(mask.any(axis=0))[0]
    along = -np.sin(pose.yaw_rad) * columns - np.cos(pose.yaw_rad) * top[columns]
    best = columns[along > along.max() - 0.75]
    column = float(best.mean())
    return np.array([column, float(top[best].mean())])
