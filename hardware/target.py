"""Draw the printed target: ``python -m hardware.target [--columns 9 --rows 6 --square-mm 3] [--out
target.pdf]``.

One page of vectors as PDF: checkerboards for the small field of view, the calibration disc, and a
ruler to check the print. ``splitknit rig target`` writes the one that is drawn without options.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from splitknit.errors import require

POINTS_PER_MM = 72.0 / 25.4
A4_MM = (210.0, 297.0)
PRODUCER = b"/Producer (splitknit)"
_CIRCLE_HANDLE = 4.0 / 3.0 * (math.sqrt(2.0) - 1.0)
"""Length of the handles with which four cubic curves make a circle (to 2.7e-4 of its radius)."""
RULER_MM = 100.0
_RULER_BELOW_MM = 10.0  # from its line to the boards: strokes and numbers
DOT_MM = 1.5  # diameter of a dot of the disc
DOT_SPACING_MM = 10.0  # from dot to dot
DISC_RADIUS_MM = 45.0  # where the disc is cut out
CARD_MARGIN_MM = 4.0  # white paper around a board, within the line along which it is cut out
_PAGE_MARGIN_MM = 12.0  # which printers leave free
RULER_Y_MM = A4_MM[1] - _PAGE_MARGIN_MM - 18  # where the ruler's line is
_BOARDS_MM = RULER_Y_MM - _RULER_BELOW_MM - (_PAGE_MARGIN_MM + 2 * DISC_RADIUS_MM + 4)
"""Height of the sheet that is left for the boards, between ruler and disc."""
DISC_MM = (A4_MM[0] / 2, _PAGE_MARGIN_MM + DISC_RADIUS_MM)  # centre of the disc on the sheet


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """What is printed."""

    columns: int = 9
    """Inner corners of a checkerboard, along its width."""
    rows: int = 6
    """And along its height."""
    square_mm: float = 3.0
    """Side of a square: 9 x 6 inner corners of 3 mm are 30 x 21 mm, in a field of view of about 42
    x 29 mm."""

    def __post_init__(self) -> None:
        corners = (
            f"a board to print must have 3 to 60 inner corners each way, but it is {self.columns} x"
            f" {self.rows}."
        )
        require(3 <= self.columns <= 60 and 3 <= self.rows <= 60, corners)
        squares = f"squares to print must have 0.5 to 40 mm a side, but it is {self.square_mm:g}."
        require(0.5 <= self.square_mm <= 40, squares)
        width, height = self.card_mm
        free = A4_MM[0] - 2 * _PAGE_MARGIN_MM
        require(
            width <= free and height <= _BOARDS_MM,
            f"a card of {width:g} x {height:g} mm does not fit on the sheet beside the disc"
            f" ({free:g} x {_BOARDS_MM:g} mm are free); use smaller or fewer squares.",
        )

    @property
    def board_mm(self) -> tuple[float, float]:
        """Width and height of the squares together."""
        return (self.columns + 1) * self.square_mm, (self.rows + 1) * self.square_mm

    @property
    def card_mm(self) -> tuple[float, float]:
        """Width and height of what is cut out."""
        width, height = self.board_mm
        return width + 2 * CARD_MARGIN_MM, height + 2 * CARD_MARGIN_MM

    @property
    def copies(self) -> tuple[int, int]:
        """Boards across and down the sheet."""
        width, height = self.card_mm
        across = int((A4_MM[0] - 2 * _PAGE_MARGIN_MM + 3) // (width + 3))
        return min(across, 6), min(int((_BOARDS_MM + 3) // (height + 3)), 6)


def target_pdf(settings: TargetSettings | None = None) -> bytes:
    """Return the target as a PDF file; equal settings give equal bytes. BadInput if the parts do
    not fit."""
    settings = settings or TargetSettings()
    scale = _number(POINTS_PER_MM)
    marks = [*_words(settings), *_ruler(), *_boards(settings), *_disc()]
    width, height = (_number(side * POINTS_PER_MM) for side in A4_MM)
    radius, (board_width, board_height) = DOT_MM / 2, settings.board_mm
    box = _number(radius + 0.1)
    objects = [
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        (
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 4 0 R "
            "/Resources << /Font << /F 5 0 R >> /XObject << /Board 6 0 R /Dot 7 0 R >> >> >>"
        ),
        _stream("", "\n".join([f"{scale} 0 0 {scale} 0 0 cm", *marks])),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        _shape(
            _rectangles(_squares(settings)), f"0 0 {_number(board_width)} {_number(board_height)}"
        ),
        _shape(_circle(radius), f"-{box} -{box} {box} {box}"),
        f"<< /Title (splitknit calibration target) {PRODUCER.decode()} >>",
    ]
    data, places = b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n", []
    for k, item in enumerate(objects, start=1):
        places.append(len(data))
        data += f"{k} 0 obj\n{item}\nendobj\n".encode("ascii")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    tail = (
        f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R /Info"
        f" {count - 1} 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    )
    return data + tail.encode("ascii")


# What stands on the sheet, as PDF's operators; lengths in mm, the origin is the lower left corner,
# x right, y up.


def _stream(entries: str, content: str) -> str:
    return f"<< {entries}/Length {len(content)} >>\nstream\n{content}\nendstream"


def _shape(drawing: str, box: str) -> str:
    """A drawing that is placed many times."""
    return _stream(f"/Type /XObject /Subtype /Form /BBox [{box}] ", f"0 g {drawing} f")


def _placed(name: str, x: float, y: float) -> str:
    return f"q 1 0 0 1 {_number(x)} {_number(y)} cm /{name} Do Q"


def _line(start: tuple[float, float], end: tuple[float, float], width: float) -> str:
    (x, y), (u, v) = start, end
    return f"{_number(width)} w 0 G {_number(x)} {_number(y)} m {_number(u)} {_number(v)} l S"


def _cut_line(drawing: str, x: float, y: float) -> str:
    """The outline of a drawing about a place, along which it is cut out."""
    return f"q 1 0 0 1 {_number(x)} {_number(y)} cm 0.05 w 0.6 G {drawing} S Q"


def _text(words: str, x: float, y: float, size: float = 2.8) -> str:
    """A line in Helvetica, which every reader has."""
    return f"BT /F {_number(size)} Tf {_number(x)} {_number(y)} Td ({words}) Tj ET"


def _rectangles(corners: Sequence[tuple[float, float, float, float]]) -> str:
    """Paths of rectangles: lower left x and y, width, height of each."""
    return " ".join(
        f"{_number(x)} {_number(y)} {_number(w)} {_number(h)} re" for x, y, w, h in corners
    )


def _circle(radius: float) -> str:
    """Path of a circle about the origin."""
    r, h = radius, radius * _CIRCLE_HANDLE
    curves = [
        (r, h, h, r, 0, r),
        (-h, r, -r, h, -r, 0),
        (-r, -h, -h, -r, 0, -r),
        (h, -r, r, -h, r, 0),
    ]
    return " ".join(
        [f"{_number(r)} 0 m", *(" ".join(map(_number, curve)) + " c" for curve in curves), "h"]
    )


def _number(value: float) -> str:
    """A length as PDF writes it: no exponent, 0.1 um and no trailing zeros."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def dots_mm() -> list[tuple[float, float]]:
    """Centres of the disc's dots about its middle, those that lie wholly on it with 1 mm to
    spare."""
    most = int(DISC_RADIUS_MM // DOT_SPACING_MM)
    steps = [DOT_SPACING_MM * k for k in range(-most, most + 1)]
    reach = DISC_RADIUS_MM - DOT_MM / 2 - 1
    return [(x, y) for y in steps for x in steps if math.hypot(x, y) <= reach]


def _words(settings: TargetSettings) -> list[str]:
    x, y = _PAGE_MARGIN_MM, A4_MM[1] - _PAGE_MARGIN_MM - 4
    board = (
        f"checkerboards of {settings.columns} x {settings.rows} inner corners, squares"
        f" {settings.square_mm:g} mm \\(board {settings.columns}x{settings.rows}, square"
        f" {settings.square_mm:g}\\)"
    )
    disc = f"disc with dots of {DOT_MM:g} mm every {DOT_SPACING_MM:g} mm"
    check = (
        f"Print at 100 % on matt paper. The ruler must measure {RULER_MM:g} mm: if not, multiply"
        f" the square and the dot spacing by what it measures / {RULER_MM:g}."
    )
    return [_text(f"splitknit: {board}; {disc}.", x, y), _text(check, x, y - 5)]


def _ruler() -> list[str]:
    x, y = (A4_MM[0] - RULER_MM) / 2, RULER_Y_MM
    marks = [_line((x, y), (x + RULER_MM, y), 0.2)]
    for k in range(11):
        at, number = x + RULER_MM * k / 10, f"{RULER_MM * k / 10:g}"
        marks.append(_line((at, y - (3 if k % 10 == 0 else 1.5)), (at, y), 0.1))
        marks.append(
            _text(number + (" mm" if k == 10 else ""), at - 0.75 * len(number), y - 6, 2.5)
        )
    return marks


def _squares(settings: TargetSettings) -> list[tuple[float, float, float, float]]:
    side, (_, height) = settings.square_mm, settings.board_mm
    places = [
        (i, j)
        for i in range(settings.rows + 1)
        for j in range(settings.columns + 1)
        if (i + j) % 2 == 0
    ]
    return [(j * side, height - (i + 1) * side, side, side) for i, j in places]


def _boards(settings: TargetSettings) -> list[str]:
    marks = []
    (across, down), (width, height) = settings.copies, settings.card_mm
    free, top = A4_MM[0] - across * width, RULER_Y_MM - _RULER_BELOW_MM
    for row, column in itertools.product(range(down), range(across)):
        x = free * (column + 1) / (across + 1) + column * width
        y = top - (row + 1) * height - 3 * row
        marks.append(_cut_line(_rectangles([(0, 0, width, height)]), x, y))
        marks.append(_placed("Board", x + CARD_MARGIN_MM, y + CARD_MARGIN_MM))
    return marks


def _disc() -> list[str]:
    x, y = DISC_MM
    dots = [_placed("Dot", x + across, y + up) for across, up in dots_mm()]
    return [_cut_line(_circle(DISC_RADIUS_MM), x, y), *dots]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--columns", type=int, default=9, help="inner corners along a board's width"
    )
    parser.add_argument("--rows", type=int, default=6, help="and along its height")
    parser.add_argument("--square-mm", type=float, default=3.0)
    parser.add_argument("--out", type=Path, default=Path("target.pdf"))
    options = parser.parse_args()
    options.out.write_bytes(
        target_pdf(TargetSettings(options.columns, options.rows, options.square_mm))
    )
