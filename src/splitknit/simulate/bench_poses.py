"""How a person holds a checkerboard under the rig."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.simulate.bench_flat import Board
from splitknit.simulate.bench_sight import plane_of, seen_at
from splitknit.types import Camera

TRIES = 2000


@dataclass(frozen=True, slots=True)
class BoardPose:
    """One pose of a board."""

    rotation_vector: tuple[float, float, float]
    translation_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class HandRanges:
    """Ranges from which poses are drawn, evenly."""

    tilt_deg: tuple[float, float] = (10.0, 35.0)
    """Against the finger plane, about any axis in it."""
    turn_deg: tuple[float, float] = (-15.0, 15.0)
    """About the board's own normal."""
    height_mm: tuple[float, float] = (-5.0, 5.0)
    """z of the board's middle."""
    edge: float = 0.02
    """Share of the picture's height that stays free around the outer squares."""

    def __post_init__(self) -> None:
        for name in ("tilt_deg", "turn_deg", "height_mm"):
            low, high = getattr(self, name)
            require(bool(np.isfinite([low, high]).all()) and low <= high, f"board range {name} must be (low, high).")
        require(self.tilt_deg[0] >= 0.0 and self.tilt_deg[1] <= 60.0, "board tilts must lie between 0 and 60 deg.")
        require(0.0 <= self.edge < 0.5, f"board edge must lie in [0, 0.5), but it is {self.edge}.")


def board_poses(
    seed: int, count: int, camera: Camera, board: Board | None = None, ranges: HandRanges | None = None
) -> list[BoardPose]:
    """Draw poses of a board, all of its squares in the picture.

    Parameters
    ----------
    seed : the same seed gives the same poses; more poses begin with the same ones
    count : of poses
    camera : that looks on
    board, ranges : defaults

    Returns
    -------
    poses for :class:`splitknit.simulate.bench_flat.BoardScene`

    Raises
    ------
    BadInput
        If the board does not fit into the picture.
    """
    require(seed >= 0 and count >= 1, "seed must not be negative and count must be at least one.")
    board, ranges = board or Board(), ranges or HandRanges()
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xB0]))
    poses: list[BoardPose] = []
    for _ in range(TRIES * count):
        pose = _draw(rng, camera, ranges)
        if _in_view(pose, camera, board, ranges.edge):
            poses.append(pose)
            if len(poses) == count:
                return poses
    field = [side / camera.px_per_mm for side in camera.image_size[::-1]]
    raise BadInput(
        f"a board of {board.size_mm[0]:g} x {board.size_mm[1]:g} mm does not fit at such tilts into the picture of "
        f"{field[0]:.0f} x {field[1]:.0f} mm; print a smaller one."
    )


def _draw(rng: np.random.Generator, camera: Camera, ranges: HandRanges) -> BoardPose:
    tilt, turn, height = (
        low + (high - low) * rng.random() for low, high in (ranges.tilt_deg, ranges.turn_deg, ranges.height_mm)
    )
    axis = 2.0 * np.pi * rng.random()
    beside = rng.random(2) - 0.5
    lean = cv2.Rodrigues(np.deg2rad(tilt) * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    spin = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(turn)]))[0]
    rotation = cv2.Rodrigues(lean @ spin)[0].ravel()
    # a person looks at the picture and moves the board about its middle
    rows, columns = camera.image_size
    middle = _middle_of_view(camera)
    x = middle[0] + 0.4 * beside[0] * columns / camera.px_per_mm
    y = middle[1] + 0.4 * beside[1] * rows / camera.px_per_mm
    return BoardPose((float(rotation[0]), float(rotation[1]), float(rotation[2])), (float(x), float(y), float(height)))


def _middle_of_view(camera: Camera) -> NDArray[np.float64]:
    """(2,) x and y in mm that appear in the picture's middle, distortion (none there to speak of) left out."""
    rows, columns = camera.image_size
    origin = seen_at(camera, np.zeros(3))
    away = np.array([(columns - 1) / 2, (rows - 1) / 2]) - origin
    return np.asarray(away * (1.0, -1.0) / camera.px_per_mm)


def _in_view(pose: BoardPose, camera: Camera, board: Board, edge: float) -> bool:
    width, height = board.size_mm
    u, v = np.meshgrid((-width / 2, width / 2), (-height / 2, height / 2))
    points = plane_of(pose.rotation_vector, pose.translation_mm).points(u.ravel(), v.ravel())
    places = seen_at(camera, points)
    rows, columns = camera.image_size
    free = edge * rows
    return bool(
        (places >= free).all()
        and (places[:, 0] <= columns - 1 - free).all()
        and (places[:, 1] <= rows - 1 - free).all()
    )
