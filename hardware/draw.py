"""Draw the printed parts of the rig: ``python -m hardware.draw [--dimensions my.toml] [--out
parts]``. Needs build123d.

Writes ``stl/`` (as printed), ``step/`` and ``assembly.step`` (in the rig's frame), and
``parts.json``: every dimension, and each part's size and mass.
"""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from hardware import sizes
from hardware.checks import check_dimensions
from hardware.films import film_mounts, rig_of, side_film_deg
from hardware.geometry import LedHole, RigDimensions, dimensions_of, side_lamp
from splitknit.errors import BadInput, require

# the rig with the camera above, from below upwards
STACK = ("base", "cylinder", "frame", "box", "lid")
STACK_BELOW = ("window_base", *STACK[1:])  # turned over: the lid is the foot
FILM_PARTS = ("analyser_plate", "analyser", "film_ring")  # between cylinder and frame


@dataclass(frozen=True, slots=True)
class Part:
    """One printed part, drawn in its place in the rig's frame."""

    title: str
    quantity: int = 1
    face_down: bool = False  # printed with its upper face on the bed


PARTS = {
    "base": Part("Base with finger groove"),
    "cylinder": Part("Cylinder with the finger's opening"),
    "frame": Part("LED and camera frame"),
    "box": Part("Circuit box"),
    "lid": Part("Lid"),
    "window_base": Part("Window base, for the camera below"),
    "mirror_holder": Part("Mirror holder at 45 deg (left, right, tip)", quantity=3),
    "calibration_disc": Part("Calibration disc, recessed dots", face_down=True),
    "calibration_disc_flat": Part(
        "Calibration disc, flush dots (with the pegs of calibration_dots)", face_down=True
    ),
    "calibration_dots": Part("Black dots for the flat disc"),
    "nail": Part("Nail cone"),
    "analyser_plate": Part("Plate before the lens, on which the analyser turns"),
    "analyser": Part("Analyser: ring with lever, film before the lens"),
    "film_ring": Part("Ring of films below the LEDs"),
    "side_lamp": Part("Lamp of a side light"),
}
# between a curved face and its triangles: below what a printer holds
TOLERANCE_MM = 0.02
TOLERANCE_RAD = 0.2
# in the header of every STEP file, so that the same rig gives the same bytes
_TIMESTAMP = "2000-01-01T00:00:00"


def names_of(d: RigDimensions) -> list[str]:
    """Names of the parts that a rig has; an analyser that does not turn is not a part of its
    own."""
    extras = [*FILM_PARTS, "side_lamp"]
    drawn = (
        []
        if d.films is None
        else [name for name in FILM_PARTS if name != "analyser" or d.films.kind != "neighbours"]
    )
    drawn += ["side_lamp"] if d.sides else []
    return [name for name in PARTS if name not in extras or name in drawn]


def draw_parts(d: RigDimensions) -> dict[str, Any]:
    """Solids of the parts by name; BadInput if the rig cannot be built."""
    check_dimensions(d)
    try:
        from hardware.parts import MAKERS
    except ImportError:
        raise BadInput("drawing parts needs build123d: python -m pip install build123d") from None
    return {name: MAKERS[name](d) for name in names_of(d)}


def write_parts(out: Path, s: SimpleNamespace) -> dict[str, Any]:
    """Draw and write all parts of the rig of these dimensions; return the document of
    ``parts.json``."""
    d = dimensions_of(rig_of(s), s)
    solids = draw_parts(d)
    from build123d import Compound, Location, Pos, Rot, export_step, export_stl

    from hardware.parts import side_places

    for name in ("stl", "step"):
        (out / name).mkdir(parents=True, exist_ok=True)
    rows = {}
    for name, solid in solids.items():
        printed = Rot(180, 0, 0) * solid if PARTS[name].face_down else solid
        box = printed.bounding_box()
        printed = Pos(-box.center().X, -box.center().Y, -box.min.Z) * printed
        export_stl(printed, str(out / "stl" / f"{name}.stl"), TOLERANCE_MM, TOLERANCE_RAD)
        size = [round(side, 1) for side in box.size]
        bed = (s.printer.bed_x_mm, s.printer.bed_y_mm, s.printer.bed_z_mm)
        words = (
            f"{name} is {size[0]:g} x {size[1]:g} x {size[2]:g} mm, larger than the printer's bed."
        )
        require(all(side <= most for side, most in zip(size, bed, strict=True)), words)
        solid.label = name
        export_step(solid, str(out / "step" / f"{name}.step"), timestamp=_TIMESTAMP)
        rows[name] = {
            "title": PARTS[name].title,
            "quantity": len(d.sides) if name == "side_lamp" else PARTS[name].quantity,
            "size_mm": size,
            "mass_g": round(solid.volume / 1000.0 * sizes.DENSITY_G_PER_CM3, 1),
        }
    stack = list(STACK_BELOW if s.rig.below else STACK)
    stack[2:2] = [name for name in ("side_lamp", *FILM_PARTS) if name in solids]
    turn = Rot(180, 0, 0) if s.rig.below else Rot(0, 0, 0)
    shapes = []
    for name in stack:
        for place in side_places(d) if name == "side_lamp" else [Location()]:
            shapes.append(turn * (place * solids[name]))
            shapes[-1].label = name
    export_step(
        Compound(label="rig", children=shapes), str(out / "assembly.step"), timestamp=_TIMESTAMP
    )
    _renumber(out / "assembly.step")
    facts = {"assembly": stack, "parts": rows, "dimensions": dimension_table(d)}
    (out / "parts.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return facts


def _renumber(path: Path) -> None:
    """Number the uses of parts from 1: the writer goes on counting for as long as the program
    runs."""
    number = count(1)
    use = re.compile(rb"(= NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+'")
    path.write_bytes(
        use.sub(lambda match: match.group(1) + b"%d'" % next(number), path.read_bytes())
    )


def dimension_table(d: RigDimensions) -> dict[str, Any]:
    """The dimensions of the rig and of its parts, mm and degrees."""
    table: dict[str, Any] = {
        "picture_mm": [round(side, 2) for side in d.field_mm],
        "total_height_mm": round(d.top_z_mm - d.base_z_mm, 2),
        "nail_height_mm": d.nail_mm,
        "calibration_disc_diameter_mm": 2 * d.disc_radius_mm,
        "lens_opening_diameter_mm": round(2 * d.lens_hole_mm, 2),
        "tip_stops_at_y_mm": round(d.stop_y_mm, 2),
    }
    heights = ("base", "groove", "floor", "frame", "board", "box", "lid", "top")
    table["heights_over_finger_plane_mm"] = {
        name: round(getattr(d, f"{name}_z_mm"), 2) for name in heights
    }
    table["leds"] = [_led(hole) for hole in d.holes]
    if d.films is not None:
        mounts = film_mounts(d)
        table["films"] = {
            "kind": mounts.kind,
            "piece_mm": round(mounts.piece_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
            "analyser_piece_mm": round(mounts.analyser_piece_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
            "axes_of_leds": [axis or None for _, _, axis in mounts.windows],
        }
    if d.sides:
        table["side_lights"] = {
            "piece_mm": round(side_lamp(d).film_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
            "leds": [
                {**_led(hole), "film_axis_deg": round(side_film_deg(hole.light_mm.tolist()), 1)}
                for hole in d.sides
            ],
        }
    return table


def _led(hole: LedHole) -> dict[str, Any]:
    x, y, z = (round(float(value), 3) for value in hole.light_mm)
    azimuth = round(math.degrees(math.atan2(y, x)) % 360.0, 2)
    return {
        "led": hole.index, "band": hole.band, "position_mm": [x, y, z], "azimuth_deg": azimuth,
        "tilt_deg": round(hole.tilt_deg, 2), "hole_diameter_mm": round(2 * hole.radius_mm, 2),
    }  # fmt: skip


def main() -> None:
    """Draw what the command line asks for."""
    options = sizes.arguments(__doc__ or "", "parts")
    facts = write_parts(options.out, sizes.read_dimensions(options.dimensions))
    for name, part in facts["parts"].items():
        size = " x ".join(f"{side:.0f}" for side in part["size_mm"])
        print(f"{name:22s} {part['quantity']} x, {size} mm, {part['mass_g']:.1f} g")
    high = facts["dimensions"]["total_height_mm"]
    print(
        f"The rig stands {high:.0f} mm high. Written to {options.out}: stl/, step/, assembly.step,"
        " parts.json."
    )


if __name__ == "__main__":
    try:
        main()
    except BadInput as error:
        sys.exit(str(error))
