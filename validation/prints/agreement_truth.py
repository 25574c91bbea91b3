"""Where the true minutiae of a simulated capture lie, and the capture's true surface, as prints
need them.

A pixel of the truth is a point of the finger's body, whose chart gives which point of the skin it
is: that gives each ``landmark_minutiae_px`` its minutia of the master (moved by the deformation),
and its direction in the picture.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.io.npz import read_npz
from splitknit_match.prints.sources import Source
from splitknit_simulator.finger.deformation import Deformation, deformed_minutiae
from splitknit_simulator.finger.finger import FingerPose, placement_of
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.population.sessions import (
    PopulationSettings,
    draw_impression,
    finger_of_today,
)

Array = NDArray[np.float64]
MAX_DISTANCE_MM = 0.06
"""Within which the chart at a landmark's pixel is that of its minutia."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A capture's true minutiae."""

    places_px: Array
    """(N, 2) column, row in the picture; all that are in view."""
    directions_rad: Array
    """(N,) counter-clockwise in the picture, towards the side with one more ridge; NaN if not
    known."""
    slant_deg: NDArray[np.float32]
    """(H, W) of the smooth shape, NaN outside."""
    period_mm: float
    arrays: dict

    def slant_at(self, places: Array) -> Array:
        """(N,) degrees; 89.9 beside the finger."""
        return np.nan_to_num(_sampled(self.slant_deg, places), nan=89.9)


def people(folder: Path) -> PopulationSettings:
    """The settings of a population's people and sessions; only standard ranges are understood."""
    document = json.loads((folder / "population.json").read_text(encoding="utf-8"))["settings"]
    return PopulationSettings(
        seed=document["seed"], scale=document["scale"], rig_seed=document["rig_seed"]
    )


def read_truth(folder: Path, subject: str, session: int, finger: str) -> Truth:
    """Read the truth of one capture of a population."""
    arrays = read_npz(folder / subject / f"session_{session}" / finger / "truth.npz")
    settings = people(folder)
    number = int(subject[1:])
    own = settings.person(number).fingers[finger]
    camera = settings.rig().camera
    # as the capture was drawn
    impression = draw_impression(own, settings.sessions, camera, (settings.seed, number, session))
    assert abs(impression.yaw_deg - float(arrays["impression_yaw_deg"])) < 1e-9, (
        "another population's truth"
    )
    body = FingerBody(finger_of_today(own.finger, impression).shape)
    moved = deformed_minutiae(
        arrays["master_minutiae_mm"],
        Deformation(
            arrays["deformation_u_mm"],
            arrays["deformation_v_mm"],
            arrays["deformation_shift_mm"],
            impression.swelling,
        ),
    )
    pitch = float(arrays["pitch_mm"])
    shape = arrays["shape_mm"]
    places = arrays["landmark_minutiae_px"].astype(np.float64).reshape(-1, 2)
    heights = [_sampled(arrays[name], places) for name in ("height_mm", "shape_mm")]
    charts = Charts(body, impression.pose(), camera, pitch, shape.shape)
    here = charts.at(places, heights[0])
    apart, which = cKDTree(moved[:, :2]).query(np.nan_to_num(here, nan=1e6))
    directions = _in_picture(charts, shape, places, moved[which, 2])
    directions[apart > MAX_DISTANCE_MM] = np.nan
    down, right = np.gradient(shape.astype(np.float64), pitch)
    slant = np.rad2deg(np.arctan(np.hypot(down, right))).astype(np.float32)
    return Truth(places, directions, slant, float(arrays["landmark_period_mm"]), arrays)


class Charts:
    """Chart (u, v) of points of a picture under parallel rays."""

    def __init__(
        self, body: FingerBody, pose: FingerPose, camera, pitch: float, size: tuple[int, int]
    ) -> None:
        self.body, self.placed, self.pitch, self.size = (
            body,
            placement_of(body, pose, camera),
            pitch,
            size,
        )

    def at(self, places: Array, heights: Array) -> Array:
        """(N, 2) at columns and rows (N, 2) with z (N,)."""
        x = (places[:, 0] - (self.size[1] - 1) / 2) * self.pitch
        y = ((self.size[0] - 1) / 2 - places[:, 1]) * self.pitch
        own = (np.stack([x, y, heights], 1) - self.placed.shift) @ self.placed.rotation
        return np.stack(self.body.distance_and_chart(*own.T)[1:], 1)


def _in_picture(
    charts: Charts, shape: NDArray[np.float32], places: Array, directions: Array
) -> Array:
    """Directions in the picture of directions on the chart, by the chart's slopes on the smooth
    shape."""
    step, slopes = 2.0, []
    for ahead in (np.array([step, 0.0]), np.array([0.0, -step])):  # right, up
        both = [
            charts.at(places + sign * ahead, _sampled(shape, places + sign * ahead))
            for sign in (1.0, -1.0)
        ]
        slopes.append(both[0] - both[1])
    right, up = slopes
    cross = right[:, 0] * up[:, 1] - right[:, 1] * up[:, 0]
    u = np.cos(directions)
    v = np.sin(directions)
    return np.arctan2(
        (right[:, 0] * v - right[:, 1] * u) / cross, (u * up[:, 1] - v * up[:, 0]) / cross
    )


def _sampled(values: NDArray[np.float32], places: Array) -> Array:
    column, row = (places[None, :, d].astype(np.float32) for d in range(2))
    return cv2.remap(values.astype(np.float64), column, row, cv2.INTER_LINEAR, borderValue=np.nan)[
        0
    ]


def true_source(truth: Truth, like: Source) -> Source:
    """The true surface on the same mask and frame as a reconstruction."""
    arrays = truth.arrays
    relief = (arrays["height_mm"] - arrays["shape_mm"]).astype(np.float32)
    mask = like.mask & np.isfinite(relief)
    return replace(
        like,
        mask=mask,
        height_mm=arrays["height_mm"],
        shape_mm=arrays["shape_mm"],
        ridge_mm=relief,
        preset="truth",
    )
