"""Where the LEDs are, from a nail and the tips of its shadows: the thesis's construction, and what it can be held to.

The ray from the tip of the shadow through the nail, seen from above, meets the circle on which the LEDs sit on the far
side of the nail; the LED is there, at the height of the circle. Its direction is that of its position seen from the
centre of the circle on the finger plane. Every position of the nail gives one direction; the thesis takes the mean of
two. How far apart they are is the only sign of a bad table, and it is reported for each LED.

Source: the thesis, section 4.3.2, with step 5 corrected: the ray runs through the nail and the tip, not through the
centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.light_table import Tip, pixels
from splitknit.errors import require
from splitknit.imaging.view import plane_points
from splitknit.model import Camera

Points = NDArray[np.float64]
SHADOW_MM = 0.2
"""A tip nearer to its nail than this shows no shadow."""


@dataclass(frozen=True, slots=True)
class Circle:
    """The circle on which the LEDs sit, as it is measured with a ruler."""

    radius_mm: float
    height_mm: float
    """Of the LEDs above the finger plane."""
    centre_mm: tuple[float, float] = (0.0, 0.0)
    """Its centre on the finger plane, in the rig's frame."""

    def __post_init__(self) -> None:
        require(1.0 <= self.radius_mm <= 1e4, f"the LED circle's radius must be 0.1 to 1000 cm, not {self.radius_mm}.")
        require(1.0 <= self.height_mm <= 1e4, f"the LEDs' height must be 0.1 to 1000 cm, not {self.height_mm / 10}.")
        require(bool(np.isfinite(self.centre_mm).all()), "the LED circle's centre must be finite.")

    @property
    def foot_mm(self) -> Points:
        """(3,) the centre on the finger plane, from which directions are counted."""
        return np.array([*self.centre_mm, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class LedEstimate:
    """One LED as one method finds it."""

    band: str
    led: int
    position_mm: Points
    """(3,) in the rig's frame."""
    direction: Points
    """(3,) unit, from the circle's centre on the finger plane towards the LED."""
    disagreement_deg: float | None
    """Largest angle between the directions of two nail positions; None with one position."""
    nails: tuple[int, ...]
    singles: Points
    """(K, 3) positions, one for each of the nail's."""


def _circle_positions(nails_mm: Points, tips_mm: Points, circle: Circle) -> Points:
    """Where the rays (N, 3) from shadow tips through nails, inside the LED circle, meet it beyond the nail, mm."""
    along = nails_mm - tips_mm
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    out = nails_mm - np.asarray(circle.centre_mm)
    half = (along * out).sum(axis=1)
    # |out + s along| = radius, the root in front
    inside = circle.radius_mm**2 - (out * out).sum(axis=1)
    step = np.sqrt(half * half + inside) - half
    return np.column_stack([nails_mm + step[:, None] * along, np.full(len(along), circle.height_mm)])


def _nail_height_mm(nails_mm: Points, tips_mm: Points, positions_mm: Points) -> float:
    """The nail's height, by similar triangles from the lengths of its shadows; the median over the rows."""
    shadow = np.linalg.norm(tips_mm - nails_mm, axis=1)
    ratio = shadow / np.maximum(np.linalg.norm(positions_mm[:, :2] - nails_mm, axis=1), 1e-9)
    return float(np.median(positions_mm[:, 2] * ratio / (1.0 + ratio)))


def nail_points(camera: Camera, nail_px: Points, height_mm: float, seen: str = "tip") -> Points:
    """Where the nail stands on the finger plane, (N, 2), given the pixel of its tip or of its base. A perspective
    camera sees the tip of a nail of `height_mm` further out than where the nail stands.
    """
    points = plane_points(camera, nail_px)
    if camera.model == "perspective" and seen == "tip":
        points = points * (1.0 - height_mm / camera.height_mm)
    return points


def by_circle(
    tips: Sequence[Tip], camera: Camera, circle: Circle, *, known_height_mm: float | None = None, seen: str = "tip"
) -> tuple[tuple[LedEstimate, ...], float]:
    """Find every LED by the thesis's construction; return them in the order of the rows, and the nail's height in mm,
    found from the lengths of the shadows unless known. `seen`: ``tip`` or ``base``, what of the nail the table gives.
    Raises BadInput naming LED and nail position: there is no shadow, or the nail stands outside the circle.
    """
    nail_px, tip_px = pixels(tips)
    ends = plane_points(camera, tip_px)
    height = known_height_mm or 0.0
    for _ in range(12):  # the height matters to where a perspective camera sees the nail, and follows from it
        nails = nail_points(camera, nail_px, height, seen)
        _check_shadows(tips, nails, ends, circle)
        positions = _circle_positions(nails, ends, circle)
        found = _nail_height_mm(nails, ends, positions)
        if camera.model != "perspective" or known_height_mm is not None or abs(found - height) < 1e-6:
            break
        height = min(found, 0.6 * circle.height_mm)
    estimates = []
    for band, led in dict.fromkeys((tip.band, tip.led) for tip in tips):
        rows = [k for k, tip in enumerate(tips) if (tip.band, tip.led) == (band, led)]
        estimates.append(combine(band, led, positions[rows], tuple(tips[k].nail for k in rows), circle))
    return tuple(estimates), found if known_height_mm is None else known_height_mm


def combine(band: str, led: int, singles: Points, nails: tuple[int, ...], circle: Circle) -> LedEstimate:
    """Put the positions (K, 3) that single nail positions give together: the mean, and how far apart they are."""
    arms = singles - circle.foot_mm
    units = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    mean = units.mean(axis=0)
    # at the mean height, in the mean direction: for arms of one length, the mean position
    position = circle.foot_mm + mean * (arms[:, 2].mean() / mean[2])
    return LedEstimate(band, led, position, mean / np.linalg.norm(mean), _largest_angle_deg(units), nails, singles)


def _largest_angle_deg(units: Points) -> float | None:
    """Largest angle in degrees between two of the unit vectors (K, 3), None for a single one."""
    if len(units) < 2:
        return None
    # by the chord, which is exact for small angles where the cosine is not
    chords = np.linalg.norm(units[:, None] - units[None], axis=2)
    return float(np.degrees(2.0 * np.arcsin(np.clip(chords.max() / 2.0, 0.0, 1.0))))


def _check_shadows(tips: Sequence[Tip], nails: Points, ends: Points, circle: Circle) -> None:
    away = np.linalg.norm(nails - np.asarray(circle.centre_mm), axis=1)
    shadow = np.linalg.norm(nails - ends, axis=1)
    for k, tip in enumerate(tips):
        require(
            shadow[k] >= SHADOW_MM,
            f"{tip.name}: there is no shadow, for its tip lies {shadow[k]:.2f} mm from the nail; correct the row, or "
            f"photograph a longer nail.",
        )
        require(
            away[k] < circle.radius_mm,
            f"{tip.name}: the line from the shadow to the LED does not start inside the LED circle: the nail stands "
            f"{away[k]:.1f} mm from the circle's centre and its radius is {circle.radius_mm:g} mm; correct the row, "
            f"the centre, the radius or px-per-cm.",
        )
