"""A finger pressed on glass: what an optical sensor shows, with the truth.

The pad's body meets a glass plate that comes closer than its highest point by an indentation; what would lie beyond the
glass is the contact patch. Skin keeps its lengths: a point lies on the glass where it lies on the body's chart, but for
a small stretch and a smooth shift. Ridges darken where they touch; the harder they are pressed the wider they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from splitknit.errors import require
from splitknit.settings import Checked, Limits
from splitknit_simulator.finger.deformation import Deformation, deformed, deformed_minutiae, draw_deformation
from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.ridges import smooth_noise
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map

Array = NDArray[np.float64]

_FINER = 2
"""Samples per pixel and side: the sensor's pixels average what touches and what does not."""

_INDENTATION_MM = 1.1
"""At 1 N, of the undeformed body by the plane."""
_STIFFENING = 0.4
"""Indentation grows with this power of the force; Hertz's ball has 2/3, a finger pad stiffens (Pawluk and Howe
1999; Dzidek et al. 2017)."""
_PITCH_DEG = 6.0
"""Mean of the finger's pitch; positive lifts the tip towards the glass."""
_SMOOTH_MM = 5.0
"""Over which the shift of the skin is smooth."""
_LEVEL = 0.85
"""Ridge height (0 valley, 1 top) from which skin touches where the pressure is smallest."""
_WIDENING = 0.45
"""By how much that falls where the pressure is 4 times that of 1 N in the middle; ridges widen."""
_SOFTNESS = 0.09
"""Of the step between touching and not, in ridge heights."""
_BLUR_PX = 0.55
"""Standard deviation of the optics' blur."""
_BRIGHT_GREY, _DARK_GREY = 235.0, 45.0
"""Grey levels where nothing touches, and where skin touches."""
_MARGIN_MM = 1.0
"""Around the contact patch."""


@dataclass(frozen=True, slots=True)
class PressSettings(Checked):
    """How a finger is pressed, and what the sensor makes of it. Numbers are our choice where no source is named."""

    force_n: Annotated[float, Limits(0.1, 20.0)] = 1.5
    """Normal force; sensors are touched with 0.5 to 5 N."""
    turn_sd_deg: Annotated[float, Limits(0.0, 20.0)] = 6.0
    """Standard deviation of the finger's turn on the glass."""
    roll_sd_deg: Annotated[float, Limits(0.0, 15.0)] = 4.0
    """Of its roll about its axis."""
    pitch_sd_deg: Annotated[float, Limits(0.0, 8.0)] = 3.0
    """Its standard deviation; 0 to 8."""
    shift_mm: Annotated[float, Limits(0.0, 0.75)] = 0.35
    """Largest smooth shift of the skin on the glass."""
    stretch: Annotated[float, Limits(0.0, 0.1)] = 0.015
    """Skin that is pressed spreads by this fraction."""
    patches: Annotated[float, Limits(0.0, 0.3)] = 0.06
    """Standard deviation of the level over a print, over distances of 2.5 mm: moisture."""
    noise_grey: Annotated[float, Limits(0.0, 60.0)] = 5.0
    """Standard deviation of the sensor's noise, grey levels."""
    ppi: Annotated[float, Limits(250.0, 2000.0)] = 500.0
    """Pixels per inch of the print, 250 to 2000."""

    @property
    def depth_mm(self) -> float:
        """How far the glass goes beyond the highest point of the body."""
        return float(_INDENTATION_MM * self.force_n**_STIFFENING)


@dataclass(frozen=True, slots=True, eq=False)
class PressedPrint:
    """A contact print and its truth, mirrored against what a camera above the pad sees, tip up."""

    image: NDArray[np.uint8]
    """(H, W) ridges dark."""
    contact: NDArray[np.bool_]
    """(H, W) the patch on the glass, valleys included."""
    minutiae: Array
    """(N, 3) column, row, direction (rad, counter-clockwise as seen on the print, towards the side with one more
    ridge) of the true minutiae inside the image, touching or not."""
    ppi: float

    @property
    def area_mm2(self) -> float:
        """Of the contact patch."""
        return float(self.contact.sum()) * (25.4 / self.ppi) ** 2


def press_finger(
    finger: SimulatedFinger, seed: int, settings: PressSettings | None = None, *, master: MasterPrint | None = None
) -> PressedPrint:
    """Press a finger on glass.

    Parameters
    ----------
    finger : its body, skin and ridges
    seed : of this press; the same finger, seed and settings give the same bytes
    settings : PressSettings, optional
    master : of this finger where it was drawn already, else it is drawn

    Raises
    ------
    BadInput
        If hardly anything would touch.

    References
    ----------
    D. Pawluk and R. Howe, J. Biomech. Eng. 121, 1999 (pressure like an inverted paraboloid, stiffening); B. Dzidek et
    al., J. R. Soc. Interface 14, 2017 (contact mechanics of the finger pad).
    """
    s = settings or PressSettings()
    rng = np.random.default_rng([finger.seed, seed, 0x9E55])
    master = master or finger.master()
    roll, pitch, turn = (float(np.clip(rng.standard_normal(), -2.0, 2.0)) for _ in range(3))
    pose = FingerPose(
        roll_rad=float(np.deg2rad(s.roll_sd_deg * roll)),
        pitch_rad=float(np.deg2rad(_PITCH_DEG + s.pitch_sd_deg * pitch)),
    )
    deformation = draw_deformation(rng, master, s.shift_mm, _SMOOTH_MM, s.stretch)
    depth_at, middle, reach = _touching(FingerBody(finger.shape), pose, s.depth_mm, deformation)
    half = 0.5 * reach + _MARGIN_MM
    turn_rad = float(np.deg2rad(s.turn_sd_deg * turn))
    step = 25.4 / s.ppi
    size = (2 * int(np.ceil(half[1] / step)), 2 * int(np.ceil(half[0] / step)))
    u, v = _skin_of_print(size, step, middle, turn_rad)
    inside = 1.0 - depth_at(u, v) / s.depth_mm  # 1 in the middle, 0 on the patch's rim
    inside = np.nan_to_num(inside, nan=-1.0)
    pressed = np.clip(inside, 0.0, 1.0) * np.sqrt(s.force_n / 4.0)
    skin = skin_map(deformed(master, deformation), finger.skin)
    height = 1.0 + skin.displacement(u, v) / (1e-3 * finger.skin.ridge_depth_um)
    level = _LEVEL - _WIDENING * pressed + s.patches * smooth_noise(rng, u.shape, 2.5 * _FINER / step)
    touching = 1.0 / (1.0 + np.exp(np.clip((level - height) / _SOFTNESS, -50.0, 50.0)))
    touching /= 1.0 + np.exp(np.clip(-inside / 0.02, -50.0, 50.0))
    fraction = cv2.resize(touching, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    fraction = cv2.GaussianBlur(fraction, (0, 0), _BLUR_PX)
    grey = _BRIGHT_GREY - (_BRIGHT_GREY - _DARK_GREY) * fraction + s.noise_grey * rng.standard_normal(size)
    return PressedPrint(
        np.round(np.clip(grey, 0.0, 255.0)).astype(np.uint8),
        cv2.resize(inside, (size[1], size[0]), interpolation=cv2.INTER_AREA) > 0,
        _on_print(deformed_minutiae(master.minutiae, deformation), size, step, middle, turn_rad),
        s.ppi,
    )


def _touching(
    body: FingerBody, pose: FingerPose, depth_mm: float, deformation: Deformation
) -> tuple[LinearNDInterpolator, Array, Array]:
    """Depth below the highest point over the chart where the deformed skin lies; middle and size of the patch, mm."""
    shape = body.shape
    y, side = np.meshgrid(np.linspace(-4.0, shape.length_mm, 141), np.linspace(-0.55, 0.55, 101), indexing="ij")
    x = side * shape.width_mm
    z = body.top(x, y)
    axis, drop = body.axis_line(y)
    points = np.stack([x + axis + shape.skew * (z - drop), y, z], -1)[np.isfinite(z)]
    up = points @ pose.rotation()[2]
    depth = up.max() - up
    near = depth < 1.6 * depth_mm + 0.3
    _, u, v = body.distance_and_chart(*points[near].T)
    touching = depth[near] < depth_mm
    require(int(touching.sum()) > 50, "hardly anything of the finger touches the glass; press harder.")
    chart = np.stack([u, v], 1)
    low, high = chart[touching].min(axis=0), chart[touching].max(axis=0)
    spread = deformation.stretch * np.abs(chart).max() + 0.5
    return LinearNDInterpolator(chart, depth[near]), 0.5 * (low + high), high - low + 2.0 * spread


def _skin_of_print(size: tuple[int, int], step: float, middle: Array, turn_rad: float) -> tuple[Array, Array]:
    """Chart (u, v) under every sample of the print, `_FINER` times as fine."""
    right = (np.arange(_FINER * size[1]) + 0.5) / _FINER - 0.5 * size[1]
    down = (np.arange(_FINER * size[0]) + 0.5) / _FINER - 0.5 * size[0]
    x, y = np.meshgrid(right * step, -down * step)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    return middle[0] - (cosine * x + sine * y), middle[1] - sine * x + cosine * y


def _on_print(minutiae: Array, size: tuple[int, int], step: float, middle: Array, turn_rad: float) -> Array:
    """Column, row and direction on the print of minutiae (N, 3) on the chart: :func:`_skin_of_print` undone."""
    left, up = minutiae[:, 0] - middle[0], minutiae[:, 1] - middle[1]
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    x, y = -cosine * left - sine * up, -sine * left + cosine * up
    column, row = x / step + 0.5 * size[1] - 0.5, 0.5 * size[0] - 0.5 - y / step
    # mirrored, then turned
    direction = (np.pi - minutiae[:, 2] + turn_rad) % (2.0 * np.pi)
    found = np.column_stack([column, row, direction])
    within = (column >= 0) & (column <= size[1] - 1) & (row >= 0) & (row <= size[0] - 1)
    return np.asarray(found[within])
