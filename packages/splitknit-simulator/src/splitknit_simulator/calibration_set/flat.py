"""Flat things under the rig: a white card, and a printed checkerboard held by hand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from splitknit import BadInput, Camera
from splitknit.errors import require
from splitknit.model import Array
from splitknit_simulator.calibration_set.bench import (
    BaseScene,
    GroundScene,
    PlaneFrame,
    base_plane,
    edge_coverage,
    facing_plane,
    seen_at,
    steps,
)
from splitknit_simulator.camera.lens import px_per_mm_at


@dataclass(frozen=True, eq=False, kw_only=True)
class CardScene(BaseScene):
    """A white matt card that fills the picture, tilted as the base is."""

    reflectance: float = 0.9
    height_mm: float = 0.0
    """z of its middle."""

    @property
    def plane(self) -> PlaneFrame:
        """Where the card lies."""
        return base_plane(self.tilt_deg, self.height_mm)

    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w): everywhere the same."""
        return np.full(u.shape, self.reflectance)


@dataclass(frozen=True, slots=True)
class PrintedBoard:
    """A printed checkerboard."""

    rows: int = 7
    """Inner corners, down."""
    columns: int = 10
    """Inner corners, across."""
    square_mm: float = 3.0
    margin_mm: float = 3.0
    """White paper around the outer squares."""
    paper: float = 0.85
    """Reflectances."""
    ink: float = 0.05
    print_blur_mm: float = 0.02
    """Standard deviation of the print's edges: a 600 dpi laser printer's dots are 0.042 mm wide."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of all squares together."""
        return (self.columns + 1) * self.square_mm, (self.rows + 1) * self.square_mm

    @property
    def outline_mm(self) -> Array:
        """(2, 4) u and v of the corners of all squares together."""
        width, height = self.size_mm
        halves = np.meshgrid((-width / 2, width / 2), (-height / 2, height / 2))
        return np.reshape(halves, (2, 4))

    def corners_mm(self) -> Array:
        """(rows * columns, 3) inner corners on the board, row by row from its top left; the middle
        is the origin."""
        across = (np.arange(self.columns) - (self.columns - 1) / 2) * self.square_mm
        up = ((self.rows - 1) / 2 - np.arange(self.rows)) * self.square_mm
        u, v = np.meshgrid(across, up)
        return np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardScene(GroundScene):
    """A printed checkerboard, held at any pose over black cloth."""

    board: PrintedBoard = field(default_factory=PrintedBoard)
    rotation_vector: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Axis times angle in rad, right-handed in the rig's frame."""
    translation_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the board's middle is."""
    cloth: float = 0.006
    """Reflectance beside the paper."""

    def __post_init__(self) -> None:
        top = float(self.plane.points(*self.board.outline_mm)[:, 2].max())
        require(
            top < self.camera.height_mm,
            f"the board reaches {top:.0f} mm up, but the camera is at {self.camera.height_mm:g} mm;"
            " hold it lower.",
        )

    @property
    def plane(self) -> PlaneFrame:
        """Where the board lies."""
        return facing_plane(self.rotation_vector, self.translation_mm)

    def albedo(self, u: Array, v: Array) -> Array:
        """Reflectance (h, w): ink, paper, and cloth around them."""
        board, axes = self.board, ((u, steps(u)), (-v, steps(v)))
        square, blur = board.square_mm, board.print_blur_mm

        def inside(margin_mm: float, blur_mm: float = 0.0) -> Array:
            """One inside the squares and their margin, zero outside."""
            halves = (0.5 * size + margin_mm for size in board.size_mm)
            across, up = (
                edge_coverage(half - np.abs(along), step, blur_mm)
                for half, (along, step) in zip(halves, axes, strict=True)
            )
            return across * up

        waves = np.ones(u.shape)
        for lines, (along, step) in zip((board.columns, board.rows), axes, strict=True):
            place = along / square + (lines + 1) / 2  # 0 at the outer edge of the first square
            line = np.clip(np.round(place), 1, lines)
            flank = 2.0 * edge_coverage((place - line) * square, step, blur) - 1.0
            # between +1 in the first square and -1 in the next
            waves = waves * np.where(line % 2 == 1, -flank, flank)
        black = inside(0.0, blur) * 0.5 * (1.0 + waves)  # the square at the top left is black
        paper = inside(board.margin_mm)
        return self.cloth + paper * (board.paper - self.cloth + black * (board.ink - board.paper))


# How a person holds a checkerboard under the rig.

_Pose = dict[str, Any]
"""`rotation_vector` and `translation_mm` of a :class:`BoardScene`."""


def board_poses(
    seed: int, count: int, camera: Camera, board: PrintedBoard | None = None
) -> list[_Pose]:
    """Draw poses of a board, all of its squares in the picture, or BadInput; more poses begin with
    the same ones."""
    board = board or PrintedBoard()
    rng = np.random.default_rng([seed, 0xB0])
    poses: list[_Pose] = []
    for _ in range(200 * count):  # then the board counts as too large for the picture
        pose = _draw(rng, camera, board)
        if pose is not None:
            poses.append(pose)
            if len(poses) == count:
                return poses
    field = [side / camera.px_per_mm for side in camera.image_size[::-1]]
    raise BadInput(
        f"a board of {board.size_mm[0]:g} x {board.size_mm[1]:g} mm does not fit at such tilts into"
        f" the picture of {field[0]:.0f} x {field[1]:.0f} mm; print a smaller one."
    )


def _draw(rng: np.random.Generator, camera: Camera, board: PrintedBoard) -> _Pose | None:
    """One pose, drawn evenly, or None where so turned a board does not fit."""
    tilt, turn, height = (
        low + (high - low) * rng.random()
        for low, high in ((10.0, 35.0), (-15.0, 15.0), (-5.0, 5.0))
    )
    axis = 2.0 * np.pi * rng.random()
    beside = rng.random(2)
    lean = cv2.Rodrigues(np.deg2rad(tilt) * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    spin = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(turn)]))[0]
    rotation = cv2.Rodrigues(lean @ spin)[0].ravel()
    rows, columns = camera.image_size
    free = 0.02 * rows  # margin on every side
    # held under the camera's axis, how far could it be moved until it leaves the picture?
    last = (columns - 1 - free, rows - 1 - free)
    places = _outer_corners(rotation, np.array([0.0, 0.0, height]), camera, board)
    least, most = free - places.min(axis=0), last - places.max(axis=0)
    move = least + beside * (most - least)
    middle = np.array([*(move * (1.0, -1.0) / px_per_mm_at(camera, height)), height])
    places = _outer_corners(rotation, middle, camera, board)
    if (places < free).any() or (places > last).any():
        return None
    return {
        "rotation_vector": tuple(map(float, rotation)),
        "translation_mm": tuple(map(float, middle)),
    }


def _outer_corners(rotation: Array, middle: Array, camera: Camera, board: PrintedBoard) -> Array:
    """(4, 2) column and row of the corners of all squares together."""
    return seen_at(camera, facing_plane(rotation, middle).points(*board.outline_mm))
