"""Settings of the printed parts: what the rig file does not say.

Everything is in millimetres and degrees. What follows from the rig file (LED places, camera height, field of view) is
worked out in :mod:`splitknit.rig.dimensions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class PrinterSettings:
    """The printer and what it can do without support."""

    bed_x_mm: float = 220.0
    """Largest print, along x."""
    bed_y_mm: float = 220.0
    """Largest print, along y."""
    bed_z_mm: float = 250.0
    """Largest print, its height."""
    nozzle_mm: float = 0.4
    """Width of the nozzle: the calibration nail's tip is as wide."""
    layer_mm: float = 0.2
    """Height of a layer: the step in which a part is looked through for what hangs over."""
    least_wall_mm: float = 1.2
    """Three lines of a 0.4 mm nozzle."""
    overhang_deg: float = 45.0
    """Faces that look down and lean further than this from the vertical need a look."""
    bridge_mm: float = 10.0
    """Longest bridge over air that is printed without support."""
    density_g_per_cm3: float = 1.24
    """PLA."""


@dataclass(frozen=True, slots=True)
class JointSettings:
    """How parts meet: a tapered ridge in a tapered groove, and M3 screws in lugs."""

    wall_mm: float = 2.4
    """Thickness of all upright walls; at least `printer.least_wall_mm`."""
    plate_mm: float = 4.4
    """Thickness of floors and of the lid."""
    clearance_mm: float = 0.2
    """Between parts that slide into each other, on each side."""
    ridge_mm: float = 2.4
    """Width of the ridge at its foot; its flank leans by 45 deg."""
    ridge_height_mm: float = 1.2
    """Height of the ridge; at most its width `joint.ridge_mm` less 0.8."""
    ring_mm: float = 4.0
    """How far the ends of a tube are thickened beyond the wall."""
    lug_radius_mm: float = 5.0
    """Half the width of the lugs that the screws go through."""
    lug_mm: float = 4.0
    """Thickness of the lug under a screw's head: M3 x 8 then reaches through a 4 mm insert."""
    screw_hole_mm: float = 3.4
    """Diameter of the hole that an M3 screw passes freely."""
    insert_hole_mm: float = 4.0
    """For a heat-set insert M3 x 4."""
    insert_depth_mm: float = 6.0
    """Depth of that hole: the insert, and room below it for the screw's end."""
    foot_mm: float = 8.5
    """Pockets for stick-on rubber feet of 8 mm, on base and lid."""


@dataclass(frozen=True, slots=True)
class LedSettings:
    """The LEDs: round, with a flange that rests on a shoulder of the hole."""

    white_diameter_mm: float = 5.0
    """Of the white LEDs' body; the hole is wider by the clearance."""
    nir_diameter_mm: float = 5.0
    """Of the NIR LEDs' body; 3 for the small ones (then also `nir_flange_mm` 3.8, `nir_flange_to_light_mm` 2.9)."""
    white_flange_mm: float = 5.9
    """Diameter of the white LEDs' flange, which rests on the shoulder."""
    nir_flange_mm: float = 5.9
    """Diameter of the NIR LEDs' flange."""
    white_flange_to_light_mm: float = 5.2
    """From the flange's front to the middle of the dome, which is the LED's `position_mm` in the rig file."""
    nir_flange_to_light_mm: float = 5.2
    """The same of the NIR LEDs."""
    clearance_mm: float = 0.1
    """Of the hole, on each side."""
    pocket_mm: float = 3.0
    """Depth of the pocket behind the shoulder, for flange and glue."""
    tip_free_mm: float = 0.5
    """The frame's lower face stays at least this much behind every LED's light."""


@dataclass(frozen=True, slots=True)
class FingerSettings:
    """Fingers of men and women, and how they lie.

    British adults of 19 to 65 years (5th percentile of women to 95th of men, mm): thumb breadth 17 to 26, index finger
    breadth 16 to 23, thumb thickness 15 to 24, index finger thickness 14 to 21, index finger length 60 to 79, little
    finger length 43 to 63 (breadth and thickness at the proximal joint; the last phalanx is about a quarter thinner).

    References
    ----------
    S. Pheasant, "Bodyspace: Anthropometry, Ergonomics and the Design of Work", 2nd edition, 1996, table of the hand.
    """

    widest_mm: float = 26.0
    """Thumb, 95th percentile of men."""
    thickest_mm: float = 24.0
    """Thumb at its joint, 95th percentile of men: what the opening must pass."""
    clearance_mm: float = 2.0
    """Around the widest and thickest finger in the opening; on both sides together in the groove."""
    pad_height_mm: float = 14.0
    """Thickness of the last phalanx: the groove's bottom lies this far below the finger plane."""
    groove_depth_mm: float = 6.0
    """From the groove's rim to its bottom; less than `finger.stop_height_mm`."""
    reach_mm: float = 45.0
    """From the finger's stop to where the hand must stay outside: the little finger of most women is as long."""
    hand_width_mm: float = 80.0
    """Width of the niche in front of the opening: knuckles of the fingers beside it."""
    hand_height_mm: float = 16.0
    """Height of the niche at its sides; its roof then rises at 45 deg."""
    tip_margin_mm: float = 3.0
    """From the fingertip at the stop to the upper border of the picture, at least."""
    phalanx_mm: float = 30.0
    """From the tip backwards what must be lit by every LED; in a large picture it lies in the middle."""
    stop_height_mm: float = 9.0
    """Of the stop over the groove's bottom; lower than the tip's pad, so that it throws no shadow on it."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """The camera's board (Raspberry Pi camera v2: 25 x 24 mm, holes 21 x 12.5 mm, M2) and its lens."""

    board_x_mm: float = 25.0
    """Size of the camera's board along x: no LED may stand where it is."""
    board_y_mm: float = 24.0
    """The same along y."""
    hole_x_mm: float = 21.0
    """Distance of the board's holes along x."""
    hole_y_mm: float = 12.5
    """Distance of its two lines of holes along y."""
    lens_to_holes_mm: float = 0.0
    """From the lens's axis to the line of the nearer two holes; the other two lie `hole_y_mm` further."""
    lens_to_connector_mm: float = 9.5
    """From the lens's axis to the edge with the flat cable's connector."""
    board_above_lens_mm: float = 12.0
    """From the lens's centre of projection, at the rig's camera height, up to the board's front: 12 mm for an M12
    holder with an 11 to 12 mm lens, about 5 mm for the stock lens."""
    barrel_mm: float = 15.0
    """Diameter of the lens where it passes the frame: M12 lenses and the round part of their holders have 14."""
    barrel_front_mm: float = 8.0
    """How far the lens reaches below its centre of projection, towards the finger."""
    post_mm: float = 5.0
    """Diameter of the posts that carry the board."""
    post_hole_mm: float = 1.7
    """For self-tapping M2 screws."""


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """Raspberry Pi 4B (85 x 56 mm, holes 58 x 49 mm, M2.5) and the LED circuit's board above it."""

    pi_x_mm: float = 85.0
    """Size of the Pi's board along x, without what stands out."""
    pi_y_mm: float = 56.0
    """Size of the Pi's board along y."""
    pi_hole_x_mm: float = 58.0
    """Distance of the Pi's holes along x."""
    pi_hole_y_mm: float = 49.0
    """Distance of the Pi's holes along y."""
    pi_hole_edge_mm: float = 3.5
    """From the middle of the Pi's first holes to the edge of its board, along x."""
    pi_overhang_mm: float = 3.0
    """How far the USB sockets stand out."""
    pi_post_height_mm: float = 6.0
    """From the box's floor up to the Pi's board."""
    pi_post_hole_mm: float = 2.1
    """For self-tapping M2.5 screws."""
    pcb_x_mm: float = 90.0
    """Size of the circuit's board along x."""
    pcb_y_mm: float = 70.0
    """Size of the circuit's board along y: 90 x 70 is a common size of prototype board."""
    pcb_hole_x_mm: float = 84.0
    """Distance of the circuit's holes along x."""
    pcb_hole_y_mm: float = 64.0
    """Distance of the circuit's holes along y."""
    pcb_over_pi_mm: float = 22.0
    """From the Pi's board to the circuit's board: over the USB sockets."""
    pcb_post_hole_mm: float = 2.5
    """For self-tapping M3 screws."""
    pcb_parts_mm: float = 16.0
    """Room above the circuit's board."""
    post_mm: float = 7.0
    """Diameter of the posts that carry both boards."""
    cable_hole_mm: float = 16.0
    """Passes a USB-C plug and the LEDs' supply."""
    slot_x_mm: float = 24.0
    """Length, along x, of the floor's openings for flat cable and LED wires."""
    slot_y_mm: float = 8.0
    """Width of these openings."""
    wire_room_mm: float = 10.0
    """Above the camera's board and the LEDs, for their wires."""


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """Calibration disc and nail."""

    dot_mm: float = 1.5
    """Diameter of the disc's dots."""
    dot_spacing_mm: float = 10.0
    """From dot to dot, along x and along y; one dot is in the middle."""
    dot_depth_mm: float = 0.6
    """Depth of recessed dots; the disc stays at least `printer.least_wall_mm` thick below them."""
    disc_mm: float = 2.4
    """Thickness of the disc."""
    nail_offset_mm: float = 6.0
    """How far from the middle the nail may stand, along rows and along columns."""
    nail_margin_mm: float = 2.0
    """Between the farthest shadow tip and the border of the picture."""
    nail_radius_mm: float = 2.5
    """Radius of the nail's foot: every shadow's tip must fall outside it."""


@dataclass(frozen=True, slots=True)
class MirrorSettings:
    """First-surface mirrors beside the finger, at 45 deg."""

    long_mm: float = 30.0
    """Of a mirror, along its lower edge."""
    wide_mm: float = 20.0
    """Of a mirror, up its slope."""
    thick_mm: float = 2.0
    """Of a mirror's glass."""
    gap_mm: float = 1.0
    """Between the groove's block and a holder."""
    lip_mm: float = 0.8
    """How much of the mirror's lower edge the lip covers."""


@dataclass(frozen=True, slots=True)
class PartSettings:
    """All settings of the parts."""

    printer: PrinterSettings = field(default_factory=PrinterSettings)
    joint: JointSettings = field(default_factory=JointSettings)
    led: LedSettings = field(default_factory=LedSettings)
    finger: FingerSettings = field(default_factory=FingerSettings)
    camera: CameraSettings = field(default_factory=CameraSettings)
    board: BoardSettings = field(default_factory=BoardSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    mirror: MirrorSettings = field(default_factory=MirrorSettings)

    def __post_init__(self) -> None:
        for group, values in ((item.name, getattr(self, item.name)) for item in fields(self)):
            _check_group(group, values)
        wall, least = self.joint.wall_mm, self.printer.least_wall_mm
        require(
            wall >= least,
            f"joint.wall_mm is {wall:g}, thinner than the least wall of {least:g} mm (printer.least_wall_mm).",
        )
        groove = self.joint.ridge_mm + self.joint.clearance_mm + 0.3
        require(
            self.joint.plate_mm >= groove + least,
            f"joint.plate_mm is {self.joint.plate_mm:g}, but below the groove of {groove:g} mm {least:g} mm must "
            f"remain: set it to {groove + least:g} or more.",
        )
        require(
            self.joint.ridge_height_mm <= self.joint.ridge_mm - 0.8,
            f"joint.ridge_height_mm is {self.joint.ridge_height_mm:g}: a ridge of {self.joint.ridge_mm:g} mm that "
            f"leans by 45 deg may be {self.joint.ridge_mm - 0.8:g} mm high at most.",
        )
        require(
            self.calibration.dot_depth_mm <= self.calibration.disc_mm - least,
            f"calibration.dot_depth_mm is {self.calibration.dot_depth_mm:g}, but a disc of "
            f"{self.calibration.disc_mm:g} mm allows {self.calibration.disc_mm - least:g} mm at most.",
        )
        require(
            self.finger.stop_height_mm < self.finger.pad_height_mm,
            f"finger.stop_height_mm is {self.finger.stop_height_mm:g}, but the stop must end below the finger plane, "
            f"{self.finger.pad_height_mm:g} mm above the groove (finger.pad_height_mm).",
        )
        require(
            self.finger.groove_depth_mm < self.finger.stop_height_mm,
            f"finger.groove_depth_mm is {self.finger.groove_depth_mm:g}, but the stop is only "
            f"{self.finger.stop_height_mm:g} mm high (finger.stop_height_mm).",
        )


_MAY_BE_ZERO = frozenset({"lens_to_holes_mm", "clearance_mm", "gap_mm", "nail_offset_mm", "nail_margin_mm"})


def _check_group(group: str, values: Any) -> None:
    assert is_dataclass(values)
    for item in fields(values):
        value = getattr(values, item.name)
        low = 0.0 if item.name in _MAY_BE_ZERO else 0.05
        require(
            low <= value <= 1000.0,
            f"{group}.{item.name} must be a number from {low:g} to 1000, but it is {value:g}.",
        )
    if isinstance(values, PrinterSettings):
        require(
            20.0 <= values.overhang_deg <= 80.0,
            f"printer.overhang_deg must lie between 20 and 80, but it is {values.overhang_deg:g}.",
        )
