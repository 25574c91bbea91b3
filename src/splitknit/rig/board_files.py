"""Files of the laid-out board: KiCad's board file, Gerbers with drill files for a maker, and the wiring picture.

References
----------
Ucamco, "The Gerber Layer Format Specification", 2024.02; KiCad, "File formats: board file format", version 20221018.
"""

from __future__ import annotations

import html
import io
import itertools
import math
import uuid
import zipfile
from collections.abc import Sequence

from splitknit.model import Rig
from splitknit.rig.board import (
    EDGE_MM,
    HOLE_MM,
    PLANE_CLEARANCE_MM,
    SPOKE_MM,
    TRACK_MM,
    VIA_DRILL_MM,
    VIA_MM,
    Board,
    spokes,
)
from splitknit.rig.circuit import Circuit

Point = tuple[float, float]
_SCREW_CLEAR_MM = 6.6
"""Diameter without copper around a screw."""
_MASK_MM = 0.05
"""How far the solder mask stays off a pad."""
_LETTER_MM = 1.0
# strokes of letters on a cell of 2 x 4, y down: enough for references
_STROKES = {
    "0": "00 20 24 04 00", "1": "01 10 14", "2": "00 20 22 02 04 24", "3": "00 20 24 04 02 22 02 04",
    "4": "00 02 22 20 24", "5": "20 00 02 22 24 04", "6": "20 00 04 24 22 02", "7": "00 20 14",
    "8": "00 20 24 04 00 02 22", "9": "22 02 00 20 24 04", "C": "20 00 04 24", "D": "00 10 21 23 14 04 00",
    "F": "20 00 02 12 02 04", "J": "20 24 04 03", "Q": "00 20 24 04 00 04 24 13", "R": "04 00 20 22 02 12 24",
    "A": "04 01 10 21 24 23 03", "K": "00 04 02 20 02 24", "+": "02 22 12 11 13", "-": "02 22",
}  # fmt: skip


def _letters(text: str, left: float, top: float) -> list[list[Point]]:
    """Strokes of a text, its upper left corner given."""
    size = _LETTER_MM / 4
    lines = []
    for k, letter in enumerate(text):
        points = [(left + (3 * k + int(at[0])) * size, top + int(at[1]) * size) for at in _STROKES[letter].split()]
        lines.append(points)
    return lines


def _silk(board: Board) -> list[list[Point]]:
    """Lines of the front's print: bodies, references, anode marks of the LEDs' headers."""
    lines = []
    for placed in board.parts:
        (x, y), (left, top, right, bottom) = placed.at_mm, placed.outline_mm
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
        lines.append([(x + u, y + v) for u, v in corners])
        width = 3 * len(placed.part.ref) * _LETTER_MM / 4
        lines += _letters(placed.part.ref, x + (left + right - width) / 2, y + (top + bottom) / 2 - _LETTER_MM / 2)
        if placed.part.symbol == "LED":  # beside the outer pin, which is the anode
            lines += _letters("A", placed.pads[1].at_mm[0] - 0.25, y + bottom + 0.3)
        if placed.part.ref.startswith("Q"):  # the flat side
            lines.append([(x + left, y + bottom - 0.3), (x + right, y + bottom - 0.3)])
        if placed.part.ref == "J1":
            lines += _letters("1", x - 0.25, y + 1.3)
        if placed.part.ref == "C1":
            lines += _letters("+", x - 0.25, y + 1.3)
        if placed.part.ref == "D90":
            lines.append([(x + left + 0.6, y + top), (x + left + 0.6, y + bottom)])
    return lines


class _Gerber:
    """One layer in the making; y is turned up, as Gerber has it."""

    def __init__(self, board: Board, function: str, polarity: str = "Positive") -> None:
        self._height = board.size_mm[1]
        self._sizes: dict[float, int] = {}
        self._body: list[str] = []
        self._head = [
            "G04 splitknit rig circuit*", f"%TF.FileFunction,{function}*%", f"%TF.FilePolarity,{polarity}*%",
            "%FSLAX46Y46*%", "%MOMM*%", "G01*",
        ]  # fmt: skip

    def _xy(self, at: Point) -> str:
        return f"X{round(at[0] * 1e6)}Y{round((self._height - at[1]) * 1e6)}"

    def _use(self, size_mm: float) -> None:
        code = self._sizes.setdefault(round(size_mm, 4), 10 + len(self._sizes))
        self._body.append(f"D{code}*")

    def dark(self, dark: bool) -> None:
        self._body.append("%LPD*%" if dark else "%LPC*%")

    def flash(self, at: Point, size_mm: float) -> None:
        self._use(size_mm)
        self._body.append(f"{self._xy(at)}D03*")

    def line(self, corners: Sequence[Point], width_mm: float) -> None:
        self._use(width_mm)
        self._body.append(f"{self._xy(corners[0])}D02*")
        self._body += [f"{self._xy(corner)}D01*" for corner in corners[1:]]

    def region(self, corners: Sequence[Point]) -> None:
        self._body += ["G36*", f"{self._xy(corners[0])}D02*"]
        self._body += [f"{self._xy(corner)}D01*" for corner in [*corners[1:], corners[0]]]
        self._body.append("G37*")

    def text(self) -> str:
        sizes = [f"%ADD{code}C,{size:.4f}*%" for size, code in self._sizes.items()]
        return "\n".join([*self._head, *sizes, *self._body, "M02*"]) + "\n"


def _rim(board: Board, inset_mm: float) -> list[Point]:
    width, height = board.size_mm
    return [(inset_mm, inset_mm), (width - inset_mm, inset_mm), (width - inset_mm, height - inset_mm),
            (inset_mm, height - inset_mm)]  # fmt: skip


def _copper(board: Board, side: int) -> str:
    layer = _Gerber(board, f"Copper,L{side + 1},{('Top', 'Bot')[side]}")
    tracks = [(net, corners) for net, at, corners in board.tracks if at == side]
    if side == 1:
        layer.region(_rim(board, EDGE_MM))
        layer.dark(False)
        for hole in board.holes_mm:
            layer.flash(hole, _SCREW_CLEAR_MM)
        for net, corners in tracks:
            if net != "GND":
                layer.line(corners, TRACK_MM + 2 * PLANE_CLEARANCE_MM)
        for net, via in board.vias:
            if net != "GND":
                layer.flash(via, VIA_MM + 2 * PLANE_CLEARANCE_MM)
        for pad in board.pads:
            layer.flash(pad.at_mm, pad.size_mm + 2 * PLANE_CLEARANCE_MM)
        layer.dark(True)
        for pad, end in spokes(board):
            layer.line((pad.at_mm, end), SPOKE_MM)
    for _, corners in tracks:
        layer.line(corners, TRACK_MM)
    for _, via in board.vias:
        layer.flash(via, VIA_MM)
    for pad in board.pads:
        layer.flash(pad.at_mm, pad.size_mm)
    return layer.text()


def _drill(board: Board, holes: Sequence[tuple[Point, float]], plated: bool) -> str:
    """Excellon, decimal mm."""
    sizes = sorted({size for _, size in holes})
    lines = ["M48", f"; #@! TF.FileFunction,{'Plated,1,2,PTH' if plated else 'NonPlated,1,2,NPTH'}", "FMAT,2", "METRIC"]
    lines += [f"T{k}C{size:.3f}" for k, size in enumerate(sizes, start=1)]
    lines += ["%", "G90", "G05"]
    for k, size in enumerate(sizes, start=1):
        lines.append(f"T{k}")
        lines += [f"X{x:.4f}Y{board.size_mm[1] - y:.4f}" for (x, y), drill in holes if drill == size]
    return "\n".join([*lines, "M30"]) + "\n"


def _gerbers(board: Board) -> dict[str, str]:
    """Return the files that a maker of boards wants, by name: two of copper, solder mask and print, edge, drills."""
    files = {"board-F_Cu.gbr": _copper(board, 0), "board-B_Cu.gbr": _copper(board, 1)}
    for side, name in ((0, "F"), (1, "B")):
        mask = _Gerber(board, f"Soldermask,{('Top', 'Bot')[side]}", "Negative")
        for pad in board.pads:
            mask.flash(pad.at_mm, pad.size_mm + 2 * _MASK_MM)
        for hole in board.holes_mm:
            mask.flash(hole, HOLE_MM + 2 * _MASK_MM)
        files[f"board-{name}_Mask.gbr"] = mask.text()
    silk = _Gerber(board, "Legend,Top")
    for line in _silk(board):
        silk.line(line, 0.15)
    files["board-F_Silkscreen.gbr"] = silk.text()
    edge = _Gerber(board, "Profile,NP")
    rim = _rim(board, 0.0)
    edge.line([*rim, rim[0]], 0.1)
    files["board-Edge_Cuts.gbr"] = edge.text()
    plated = [(pad.at_mm, pad.drill_mm) for pad in board.pads] + [(via, VIA_DRILL_MM) for _, via in board.vias]
    files["board-PTH.drl"] = _drill(board, plated, True)
    files["board-NPTH.drl"] = _drill(board, [(hole, HOLE_MM) for hole in board.holes_mm], False)
    return files


def gerber_zip(board: Board) -> bytes:
    """Return the Gerbers in the archive that is sent to a maker; equal boards give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in _gerbers(board).items():
            archive.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), text, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


_LAYERS = (
    (0, "F.Cu", "signal"), (31, "B.Cu", "signal"), (36, "B.SilkS", "user"), (37, "F.SilkS", "user"),
    (38, "B.Mask", "user"), (39, "F.Mask", "user"), (44, "Edge.Cuts", "user"), (46, "B.CrtYd", "user"),
    (47, "F.CrtYd", "user"), (48, "B.Fab", "user"), (49, "F.Fab", "user"),
)  # fmt: skip


def kicad_board(board: Board, version: str) -> str:
    """Return the board as KiCad 7 and later read it, its ground plane as a zone to be filled (key B)."""
    nets = {name: k for k, name in enumerate(dict.fromkeys(["", "GND", *(pad.net for pad in board.pads)]))}
    layers = "\n".join(f'    ({number} "{name}" {kind})' for number, name, kind in _LAYERS)
    lines = [
        f'(kicad_pcb (version 20221018) (generator "splitknit {version}")',
        "  (general (thickness 1.6))",
        '  (paper "A4")',
        f"  (layers\n{layers}\n  )",
        f"  (setup (pad_to_mask_clearance {_MASK_MM:g}))",
        *(f"  (net {number} {quoted(name)})" for name, number in nets.items()),
    ]
    for placed in board.parts:
        part, (x, y) = placed.part, placed.at_mm
        left, top, right, bottom = placed.outline_mm
        middle = f"(at {_mm((left + right) / 2)} {_mm((top + bottom) / 2)})"
        font = "(effects (font (size 1 1) (thickness 0.15)))"
        lines += [
            f'  (footprint {quoted("splitknit:" + part.footprint.partition(":")[2])} (layer "F.Cu") '
            f"(tstamp {_stamp(part.ref)}) (at {_mm(x)} {_mm(y)})",
            f'    (fp_text reference {quoted(part.ref)} {middle} (layer "F.SilkS") {font})',
            f'    (fp_text value {quoted(part.value)} {middle} (layer "F.Fab") {font})',
            f"    (fp_rect (start {_mm(left)} {_mm(top)}) (end {_mm(right)} {_mm(bottom)}) "
            '(stroke (width 0.15) (type solid)) (fill none) (layer "F.SilkS"))',
        ]
        for pad in placed.pads:
            net = f" (net {nets[pad.net]} {quoted(pad.net)})" if pad.net else ""
            lines.append(
                f'    (pad "{pad.pin}" thru_hole circle (at {_mm(pad.at_mm[0] - x)} {_mm(pad.at_mm[1] - y)}) '
                f'(size {pad.size_mm:g} {pad.size_mm:g}) (drill {pad.drill_mm:g}) (layers "*.Cu" "*.Mask"){net})'
            )
        lines.append("  )")
    for k, hole in enumerate(board.holes_mm, start=1):
        lines.append(
            f'  (footprint "splitknit:MountingHole_3.2mm" (layer "F.Cu") (tstamp {_stamp(f"H{k}")}) '
            f'(at {_mm(hole[0])} {_mm(hole[1])}) (attr exclude_from_pos_files exclude_from_bom)\n    (pad "" '
            f'np_thru_hole circle (at 0 0) (size {HOLE_MM} {HOLE_MM}) (drill {HOLE_MM}) (layers "*.Cu" "*.Mask"))\n  )'
        )
    for net, side, corners in board.tracks:
        for first, last in itertools.pairwise(corners):
            lines.append(
                f"  (segment (start {_mm(first[0])} {_mm(first[1])}) (end {_mm(last[0])} {_mm(last[1])}) "
                f'(width {TRACK_MM}) (layer "{"FB"[side]}.Cu") (net {nets[net]}))'
            )
    for net, via in board.vias:
        lines.append(
            f"  (via (at {_mm(via[0])} {_mm(via[1])}) (size {VIA_MM}) (drill {VIA_DRILL_MM}) "
            f'(layers "F.Cu" "B.Cu") (net {nets[net]}))'
        )
    rim = _rim(board, 0.0)
    for first, last in zip(rim, [*rim[1:], rim[0]], strict=True):
        lines.append(
            f"  (gr_line (start {_mm(first[0])} {_mm(first[1])}) (end {_mm(last[0])} {_mm(last[1])}) "
            '(stroke (width 0.1) (type solid)) (layer "Edge.Cuts"))'
        )
    polygon = " ".join(f"(xy {_mm(x)} {_mm(y)})" for x, y in _rim(board, EDGE_MM))
    lines.append(
        f'  (zone (net {nets["GND"]}) (net_name "GND") (layer "B.Cu") (tstamp {_stamp("zone")}) (hatch edge 0.5)\n'
        f"    (connect_pads (clearance {PLANE_CLEARANCE_MM})) (min_thickness 0.25)\n"
        f"    (fill (thermal_gap {PLANE_CLEARANCE_MM}) (thermal_bridge_width {SPOKE_MM}))\n"
        f"    (polygon (pts {polygon})))"
    )
    return "\n".join([*lines, ")"]) + "\n"


def _mm(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".").replace("-0", "0") if abs(value) < 5e-5 else f"{value:.4f}"


def _stamp(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"splitknit:board:{name}"))


def quoted(text: str) -> str:
    """Text in KiCad's files."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


_FRONT, _BACK, _INK, _QUIET, _GREEN = "#B03A2E", "#2E5FB0", "#222222", "#555555", "#E3EDE3"
_COLOURS = {"white": "#C9A400", "nir": "#8E2A8E"}


def wiring_svg(board: Board, circuit: Circuit, rig: Rig) -> str:
    """Return the wiring picture: the Pi, its cable, the board from its front, the ring of LEDs from the box's side."""
    scale, left, top = 8.0, 250.0, 90.0
    width, height = board.size_mm[0] * scale, board.size_mm[1] * scale
    ring = (left + width + 300.0, top + height / 2)
    page = ring[0] + 240.0, top + height + 90.0
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page[0]:.0f}" height="{page[1]:.0f}" '
        f'viewBox="0 0 {page[0]:.0f} {page[1]:.0f}" font-family="sans-serif" font-size="13" role="img" '
        'aria-label="Wiring of Raspberry Pi, LED board and LEDs">',
        f'<rect width="{page[0]:.0f}" height="{page[1]:.0f}" fill="white"/>',
        words(20, 34, "Wiring: Raspberry Pi, LED board, LEDs. Wire with the power off.", size=20),
        f'<g transform="translate({left:g},{top:g}) scale({scale:g})">{_board_picture(board)}</g>',
    ]
    jack = next(p for p in board.parts if p.part.ref == "J2").at_mm
    header = next(p for p in board.parts if p.part.ref == "J1")
    pin_1 = (left + header.at_mm[0] * scale, top + header.at_mm[1] * scale)
    jack_y = top + jack[1] * scale
    parts += [
        # the adapter
        f'<rect x="30" y="{jack_y - 30:g}" width="120" height="60" rx="6" fill="#eeeeee" stroke="{_INK}"/>',
        words(90, jack_y - 4, f"{circuit.settings.supply_v:g} V adapter", "middle"),
        words(90, jack_y + 14, "centre +", "middle"),
        f'<path d="M150,{jack_y:g} H{left - 8:g}" stroke="{_INK}" stroke-width="5" fill="none"/>',
        # the Pi
        f'<rect x="30" y="{top + height - 170:g}" width="150" height="170" rx="6" fill="#e6f2e6" stroke="{_INK}"/>',
        words(105, top + height - 60, "Raspberry Pi", "middle", size=15),
        words(105, top + height - 40, "own USB-C supply", "middle", fill=_QUIET),
        f'<rect x="44" y="{top + height - 158:g}" width="122" height="20" fill="#333333"/>',
        f'<circle cx="50" cy="{top + height - 142:g}" r="3.4" fill="white"/>',
        words(44, top + height - 116, "40 pins; pin 1 marked", fill=_QUIET, size=11),
        # the cable goes under the board's lower row of parts
        f'<path d="M166,{top + height - 148:g} C 220,{top + height - 148:g} 200,{pin_1[1] - 10:g} {pin_1[0] - 44:g},'
        f'{pin_1[1] - 10:g}" stroke="#888888" stroke-width="14" fill="none" opacity="0.75"/>',
        words(20, top + height - 214, "ribbon cable, 40 ways,", fill=_QUIET),
        words(20, top + height - 198, "pin 1 to pin 1", fill=_QUIET),
        words(left, top + height + 24, "The board from its front. Red: tracks on the front; blue: on "
               "the back, in the ground plane.", fill=_QUIET),
        words(left, top + height + 42, "A: anode, the LED's longer leg. Black edge of Q: its flat side. "
               f"Each LED on its own pair of wires: D1 to D{len(circuit.channels)}.", fill=_QUIET),
    ]  # fmt: skip
    reach = max((math.hypot(led.position_mm[0], led.position_mm[1]) for led in rig.leds if led.position_mm), default=1)
    radius = 150.0
    parts.append(
        f'<circle cx="{ring[0]:g}" cy="{ring[1]:g}" r="{radius:g}" fill="none" stroke="#BBBBBB" '
        'stroke-dasharray="4 4"/>'
    )
    for channel, led in zip(circuit.channels, rig.leds, strict=True):
        if led.position_mm is None:
            continue
        u, v = (side / max(reach, 1e-6) * radius for side in led.position_mm[:2])
        x, y, out = ring[0] + u, ring[1] - v, 1 + 34 / max(math.hypot(u, v), 1e-6)
        parts += [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{_COLOURS[led.band]}" stroke="{_INK}"/>',
            words(ring[0] + u * out, ring[1] - v * out + 1, f"D{channel.number}", "middle", size=14),
            words(ring[0] + u * out, ring[1] - v * out + 14, channel.name, "middle", size=10, fill=_QUIET),
        ]
    parts += [
        f'<rect x="{ring[0] - 22:g}" y="{ring[1] - 18:g}" width="44" height="36" fill="#dddddd" stroke="{_INK}"/>',
        words(ring[0], ring[1] + 4, "camera", "middle", size=11),
        words(ring[0], top + 6, "The LEDs seen from the box, as the rig file has them", "middle"),
        words(ring[0], top + 24, "(top: the fingertip's side)", "middle", fill=_QUIET),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _board_picture(board: Board) -> str:
    """The board in mm."""
    width, height = board.size_mm
    parts = [
        f'<rect width="{width:g}" height="{height:g}" rx="0.5" fill="{_GREEN}" stroke="{_INK}" stroke-width="0.2"/>'
    ]
    for side, colour in ((1, _BACK), (0, _FRONT)):
        for _, at, corners in board.tracks:
            if at == side:
                points = " ".join(f"{x:g},{y:g}" for x, y in corners)
                parts.append(
                    f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="0.3" opacity="0.55"/>'
                )
    for pad in board.pads:
        (x, y), radius = pad.at_mm, pad.size_mm / 2
        parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="#B8963E"/>')
        parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{pad.drill_mm / 2:g}" fill="white"/>')
    for x, y in board.holes_mm:
        parts.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{HOLE_MM / 2:g}" fill="white" stroke="{_INK}" stroke-width="0.15"/>'
        )
    for placed in board.parts:
        (x, y), (left, top, right, bottom) = placed.at_mm, placed.outline_mm
        led = placed.part.symbol == "LED"
        colour = _COLOURS["nir" if placed.part.value.startswith("nir") else "white"] if led else "none"
        parts.append(
            f'<rect x="{x + left:g}" y="{y + top:g}" width="{right - left:g}" height="{bottom - top:g}" '
            f'fill="{colour}" fill-opacity="0.5" stroke="{_INK}" stroke-width="0.15"/>'
        )
        if placed.part.ref.startswith("Q"):
            parts.append(
                f'<rect x="{x + left:g}" y="{y + bottom - 0.5:g}" width="{right - left:g}" height="0.5" fill="{_INK}"/>'
            )
        if placed.part.ref == "J1":
            parts.append(words(x, y + 2.6, "pin 1", "middle", size=1.5))
        if placed.part.ref == "C1":
            parts.append(words(x, y - 1.3, "+", "middle", size=2.2))
        if placed.part.ref == "D90":
            parts.append(
                f'<rect x="{x + left + 0.5:g}" y="{y + top:g}" width="0.6" height="{bottom - top:g}" fill="{_INK}"/>'
            )
        label = placed.part.ref if placed.part.ref[0] != "R" else f"{placed.part.ref} {placed.part.value.split()[0]}"
        middle_y = y + (top + bottom) / 2 + 0.5
        if led:  # above or below, free of the pins
            outside = -1.9 if y < height / 2 else 2.9
            middle_y = y + outside
            parts.append(words(placed.pads[1].at_mm[0] + 1.0, middle_y, "A", "middle", size=1.3))
        parts.append(words(x + (left + right) / 2 - (0.6 if led else 0.0), middle_y, label, "middle", size=1.5))
    return "".join(parts)


def words(x: float, y: float, text: str, anchor: str = "start", *, size: float = 13, fill: str = _INK) -> str:
    """Text of a drawing, x and y in its units."""
    escaped = html.escape(text).replace("&#x27;", "&#39;").replace("&quot;", "&#34;")
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="{size:g}" fill="{fill}">{escaped}</text>'
