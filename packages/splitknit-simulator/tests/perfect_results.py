"""Result folders of perfect reconstructions: the true surface of a simulated finger, as a
reconstruction keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.finger.orientation import Upright, find_upright
from splitknit.finger.ridges import relief_print
from splitknit.io.npz import write_npz
from splitknit.io.prints import write_print_png
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface


def write_perfect(
    folder: Path,
    seen: Any,
    camera: Camera,
    upright: Upright | None = None,
    more: Mapping[str, Any] | None = None,
) -> Path:
    """Write ``height.npz`` (with the arrays `more`) and ``print.png`` of the surface that `camera`
    has seen."""
    folder.mkdir(parents=True)
    upright = upright or find_upright(seen.mask)
    ridge = seen.height_mm - seen.shape_mm
    arrays = {
        "height_mm": seen.height_mm,
        "ridge_mm": ridge,
        "shape_mm": seen.shape_mm,
        "mask": seen.mask,
        "pitch_mm": np.float64(camera.pitch_mm),
        "normals": seen.normals,
        "input_from_upright": upright.input_from_upright,
        "upright_size": np.array(upright.size),
    }
    write_npz(folder / "height.npz", {**arrays, **(more or {})})
    picture = relief_print(
        ridge, seen.mask, camera.px_per_mm, upright.input_from_upright, upright.size
    )
    write_print_png(folder / "print.png", picture, 500.0)
    return folder


def write_impressions(folder: Path, scale: float, seed: int, turned: FingerPose) -> Path:
    """Two impressions of one finger, ``a`` and (`turned`) ``again``, and one of another,
    ``other``."""
    camera = default_rig(scale).camera
    straight = FingerPose(insertion_mm=27.0)
    for number, pose, name in (
        (seed, straight, "a"),
        (seed, turned, "again"),
        (seed + 1, straight, "other"),
    ):
        write_perfect(
            folder / name, finger_surface(draw_finger(number, "right_loop"), pose, camera), camera
        )
    return folder
