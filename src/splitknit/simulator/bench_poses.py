"""How a person holds a checkerboard under the rig."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import Camera
from splitknit.simulator.bench_flat import Board
from splitknit.simulator.bench_sight import plane_of, seen_at
from splitknit.simulator.lens import px_per_mm_at

TRIES = 200


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
    poses for :class:`splitknit.simulator.bench_flat.BoardScene`

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
        pose = _draw(rng, camera, board, ranges)
        if pose is not None:
            poses.append(pose)
            if len(poses) == count:
                return poses
    field = [side / camera.px_per_mm for side in camera.image_size[::-1]]
    raise BadInput(
        f"a board of {board.size_mm[0]:g} x {board.size_mm[1]:g} mm does not fit at such tilts into the picture of "
        f"{field[0]:.0f} x {field[1]:.0f} mm; print a smaller one."
    )


def _draw(rng: np.random.Generator, camera: Camera, board: Board, ranges: HandRanges) -> BoardPose | None:
    """One pose, or None where so turned a board does not fit."""
    tilt, turn, height = (
        low + (high - low) * rng.random() for low, high in (ranges.tilt_deg, ranges.turn_deg, ranges.height_mm)
    )
    axis = 2.0 * np.pi * rng.random()
    beside = rng.random(2)
    lean = cv2.Rodrigues(np.deg2rad(tilt) * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    spin = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(turn)]))[0]
    rotation = cv2.Rodrigues(lean @ spin)[0].ravel()
    rows, columns = camera.image_size
    free = ranges.edge * rows
    # held under the camera's axis, how far could it be moved until it leaves the picture?
    places = _outer_corners(rotation, np.array([0.0, 0.0, height]), camera, board)
    least = free - places.min(axis=0)
    most = (columns - 1 - free, rows - 1 - free) - places.max(axis=0)
    move = least + beside * (most - least)
    middle = np.array([*(move * (1.0, -1.0) / px_per_mm_at(camera, height)), height])
    places = _outer_corners(rotation, middle, camera, board)
    slack = min(float((places - free).min()), float(((columns - 1 - free, rows - 1 - free) - places).min()))
    if slack < 0.0:
        return None
    x, y, z = (float(v) for v in middle)
    return BoardPose((float(rotation[0]), float(rotation[1]), float(rotation[2])), (x, y, z))


def _outer_corners(
    rotation: NDArray[np.float64], middle: NDArray[np.float64], camera: Camera, board: Board
) -> NDArray[np.float64]:
    """(4, 2) column and row of the corners of all squares together."""
    width, height = board.size_mm
    u, v = np.meshgrid((-width / 2, width / 2), (-height / 2, height / 2))
    return seen_at(camera, plane_of(rotation, middle).points(u.ravel(), v.ravel()))
