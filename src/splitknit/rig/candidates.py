"""Rigs that are compared: what changes from one to the next, and what all of them share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig

FULL_PX_PER_MM = 75.7
"""Of the full frame of the thesis's camera, 3200 x 2200 pixels."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One rig out of a sweep."""

    height_mm: float
    """Of camera and LEDs above the finger plane (the same, as in the thesis)."""
    radius_mm: float
    """Of the circle of LEDs."""
    power_w: float
    """Electrical power of one LED."""
    tilt_deg: float | None = None
    """Of the beams from the vertical, towards the axis; None aims them at the middle of the finger plane."""
    px_per_mm: float = 12.0
    """Resolution of the camera on the finger plane; the field stays."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("height_mm", 20.0, 1000.0),
            ("radius_mm", 1.0, 1000.0),
            ("power_w", 1e-4, 100.0),
            ("px_per_mm", 3.0, FULL_PX_PER_MM),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"a rig's {name} must lie between {low:g} and {high:g}, but it is {value:g}.",
            )
        require(
            self.tilt_deg is None or -60.0 <= self.tilt_deg <= 80.0,
            f"a rig's tilt_deg must lie between -60 and 80, or be 'centre', but it is {self.tilt_deg}.",
        )

    @property
    def beam_deg(self) -> float:
        """Angle of the beams from the vertical, towards the axis."""
        centre = float(np.rad2deg(np.arctan2(self.radius_mm, self.height_mm)))
        return centre if self.tilt_deg is None else self.tilt_deg

    @property
    def name(self) -> str:
        """Short, unique, fit for a file."""
        tilt = "centre" if self.tilt_deg is None else f"{self.tilt_deg:g}"
        return f"h{self.height_mm:g}_r{self.radius_mm:g}_p{self.power_w:g}_t{tilt}_s{self.px_per_mm:g}"

    @property
    def volume_l(self) -> float:
        """Size of the box: litres of the cylinder that holds LEDs and camera."""
        return float(np.pi * self.radius_mm**2 * self.height_mm * 1e-6)


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """What all candidates share."""

    leds_per_band: int = 7
    """LEDs on the circle for each of the bands, 3 to 64."""
    half_angle_deg: float = 30.0
    """Angle from the beam's axis at which an LED is half as bright: 60 for a bare chip, 30 and less with a lens; 90
    stands for equal light all around."""
    led_drop_mm: float = 0.0
    """How far the LEDs stand below the front of the lens; negative is above."""
    field_mm: tuple[float, float] = (2200 / FULL_PX_PER_MM, 3200 / FULL_PX_PER_MM)
    """Rows and columns of the field on the finger plane: the lens is chosen for it, whatever the height."""
    view: str = "perspective"
    """Of the simulated camera: ``perspective``, or ``orthographic`` as the thesis assumes it."""

    def __post_init__(self) -> None:
        require(3 <= self.leds_per_band <= 64, f"leds_per_band must be 3 to 64, but it is {self.leds_per_band}.")
        require(
            5.0 <= self.half_angle_deg <= 90.0, f"half_angle_deg must lie in 5 to 90, but it is {self.half_angle_deg}."
        )
        require(abs(self.led_drop_mm) <= 100.0, f"led_drop_mm must lie within 100 mm, but it is {self.led_drop_mm}.")
        require(min(self.field_mm) >= 15.0, f"field_mm must be at least 15 mm a side, but it is {self.field_mm}.")
        require(
            self.view in ("perspective", "orthographic"),
            f"view must be perspective or orthographic, not '{self.view}'.",
        )

    @property
    def lobe_exponent(self) -> float:
        """Exponent m of an LED whose intensity falls with cos^m: half at the half angle."""
        if self.half_angle_deg >= 90.0:
            return 0.0
        return float(np.log(0.5) / np.log(np.cos(np.deg2rad(self.half_angle_deg))))


def grid(
    heights_mm: Sequence[float],
    radii_mm: Sequence[float],
    powers_w: Sequence[float],
    tilts_deg: Sequence[float | None] = (None,),
    resolutions: Sequence[float] = (12.0,),
) -> tuple[Candidate, ...]:
    """All combinations, in the order of the lists; what is listed twice counts once.

    Raises
    ------
    BadInput
        If a list is empty or holds an impossible value.
    """
    for name, values in (
        ("heights_mm", heights_mm),
        ("radii_mm", radii_mm),
        ("powers_w", powers_w),
        ("tilts_deg", tilts_deg),
        ("resolutions", resolutions),
    ):
        require(len(values) > 0, f"{name} is empty; list one value at least.")
    found = (Candidate(*values) for values in itertools.product(heights_mm, radii_mm, powers_w, tilts_deg, resolutions))
    return tuple(dict.fromkeys(found))


def camera_of(candidate: Candidate, build: BuildSettings, view: str | None = None) -> Camera:
    """The candidate's camera: the field of `build`, seen from the candidate's height."""
    rows, columns = (max(8, round(side * candidate.px_per_mm)) for side in build.field_mm)
    matrix = None
    if (view or build.view) == "perspective":
        focal = candidate.px_per_mm * candidate.height_mm
        matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]], dtype=np.float64)
    return Camera(
        px_per_mm=candidate.px_per_mm,
        image_size=(rows, columns),
        height_mm=candidate.height_mm,
        model="orthographic" if matrix is None else "perspective",
        matrix=matrix,
    )


def rig_of(
    candidate: Candidate,
    build: BuildSettings,
    intensities: dict[str, float],
    view: str | None = None,
) -> Rig:
    """The candidate as a rig.

    Parameters
    ----------
    candidate, build : what to build
    intensities : of the LEDs on their axis, by band, in W/sr; a band that is not named has no LEDs
    view : of the camera, where it differs from `build.view`
    """
    count = build.leds_per_band
    tilt = np.deg2rad(candidate.beam_deg)
    leds = []
    for band, intensity in intensities.items():
        for k in range(count):
            azimuth = 2.0 * np.pi * (k + (0.5 if band == "nir" else 0.0)) / count
            x, y = float(np.cos(azimuth)), float(np.sin(azimuth))
            z = candidate.height_mm - build.led_drop_mm
            leds.append(
                Led(
                    band=band,
                    position_mm=(candidate.radius_mm * x, candidate.radius_mm * y, z),
                    intensity=intensity,
                    lobe_exponent=build.lobe_exponent,
                    aim=(-float(np.sin(tilt)) * x, -float(np.sin(tilt)) * y, -float(np.cos(tilt))),
                )
            )
    return Rig(camera_of(candidate, build, view), tuple(leds), {"source": "rig optimise", "candidate": candidate.name})
