"""Settings of printing and of the joints between printed parts, in millimetres and degrees."""

from __future__ import annotations

from dataclasses import dataclass


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
