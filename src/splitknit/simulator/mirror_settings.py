"""Mirrors beside the simulated finger: which, how large, how far from where the drawing has them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from splitknit.errors import require

SIDES = ("left", "right", "tip")


@dataclass(frozen=True, slots=True)
class MirrorParts:
    """The printed parts that carry the mirrors: dimensions as ``splitknit rig cad`` draws them, mm.

    The values are those of a rig whose mirrors show the whole side of most fingers: larger mirrors, and a finger plane
    higher above the base, than the parts for a finger alone have (``docs/twin.md`` names the options of ``rig cad``).
    """

    long_mm: float = 30.0
    """Of a mirror, along its lower edge."""
    wide_mm: float = 30.0
    """Of a mirror, up its slope."""
    thick_mm: float = 2.0
    """Of a mirror's glass."""
    gap_mm: float = 1.0
    """Between the groove's block and a holder."""
    lip_mm: float = 0.8
    """How much of the mirror's lower edge the holder's lip covers."""
    clearance_mm: float = 0.2
    """Of all joints."""
    wall_mm: float = 2.4
    """Of the printed walls: the groove's, the stop's, and the holder's top behind the mirror."""
    pad_height_mm: float = 21.2
    """Of the finger plane over the groove's bottom."""
    widest_mm: float = 22.0
    """Of the fingers."""
    finger_clearance_mm: float = 2.0
    """Between the widest finger and the walls of the groove, both sides together."""
    tip_margin_mm: float = 27.0
    """From the fingertip's stop to the picture's upper border."""
    phalanx_mm: float = 30.0
    """Of the last phalanx, tip to crease: in a large picture its middle lies in the picture's."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            require(
                bool(np.isfinite(value)) and 0.0 <= value <= 200.0,
                f"mirrors.parts.{item.name} must lie between 0 and 200, but it is {value}.",
            )
        require(
            self.wide_mm > self.lip_mm + 1.0 and self.long_mm > 1.0,
            "mirrors.parts.wide_mm must be at least 1 mm more than what the lip covers, and long_mm above 1.",
        )


@dataclass(frozen=True, slots=True)
class MirrorViews:
    """What the twin's mirrors are; without names there are none."""

    names: tuple[str, ...] = ()
    """Of ``left``, ``right`` and ``tip``. A rig that is given with mirrors has those."""
    reflectance: float = 0.9
    """Share of the light that a mirror reflects: aluminium on the face, protected, 0.85 to 0.92."""
    turn_sd_deg: float = 1.0
    """Standard deviation, about each axis, of the true mirrors against the drawing: a glued holder, a mirror that
    rocks in its seat."""
    turn_most_deg: float = 3.0
    """Turns beyond this, about any axis, are cut off to it; 0 to 10."""
    shift_sd_mm: float = 0.7
    """Standard deviation of the true mirrors' places against the drawing, along each axis; 0 to 10."""
    shift_most_mm: float = 2.0
    """Shifts beyond this, along any axis, are cut off to it; 0 to 10."""
    pose_seed: int | None = None
    """Of the true poses; None: they follow from the finger's seed, and are the same in all its impressions."""
    px_per_mm: float = 43.0
    """Of the full frame: all views must fit."""
    image_size: tuple[int, int] = (2464, 3280)
    """Rows and columns of the full frame: all of the IMX219."""
    model: str = "orthographic"
    """Of the camera: ``orthographic``, or ``perspective`` from 140 mm with a lens without distortion. A given `rig` has
    its own camera."""
    insertion_mm: tuple[float, float] = (28.7, 30.3)
    """From the lower image border to the tip, in place of the pose ranges' own; cut to the tip's stop."""
    nir: bool = True
    """Whether the rig has its NIR LEDs: mirrors can do without."""
    ridges_to_deg: float = 112.0
    """Around the finger, from the pad's top: there the ridged skin ends; 180: it goes all around."""
    dust_per_cm2: float = 0.0
    """Bright specks on the mirrors."""
    plastic_albedo: float = 0.04
    """Of holders and tube: black print."""
    glass_albedo: float = 0.12
    """Of the mirrors' ground upper edge."""
    truth_pitch_mm: float = 0.08
    """Of the grid around the finger in the truth."""
    parts: MirrorParts = field(default_factory=MirrorParts)

    def __post_init__(self) -> None:
        known = all(name in SIDES for name in self.names) and len(set(self.names)) == len(self.names)
        require(known, f"mirrors.names are some of left, right and tip, each once, but they are {list(self.names)}.")
        for name, low, high in (
            ("reflectance", 1e-6, 1.0),
            ("turn_sd_deg", 0.0, 10.0),
            ("turn_most_deg", 0.0, 10.0),
            ("shift_sd_mm", 0.0, 10.0),
            ("shift_most_mm", 0.0, 10.0),
            ("px_per_mm", 1.0, 200.0),
            ("ridges_to_deg", 60.0, 180.0),
            ("dust_per_cm2", 0.0, 1000.0),
            ("plastic_albedo", 0.0, 1.0),
            ("glass_albedo", 0.0, 1.0),
            ("truth_pitch_mm", 0.02, 2.0),
        ):
            value = getattr(self, name)
            require(
                bool(np.isfinite(value)) and low <= value <= high,
                f"mirrors.{name} must lie between {low:g} and {high:g}, but it is {value}.",
            )
        require(
            self.model in ("orthographic", "perspective"),
            f"mirrors.model is orthographic or perspective, not '{self.model}'.",
        )
        low_mm, high_mm = self.insertion_mm
        require(0.0 < low_mm <= high_mm, f"mirrors.insertion_mm must be (low, high), but it is {self.insertion_mm}.")
        require(min(self.image_size) >= 64, "mirrors.image_size must be at least 64 x 64 pixels.")
