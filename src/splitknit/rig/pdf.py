"""One page of vectors as PDF: shapes drawn once and placed many times, a line, a line of text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from splitknit.errors import require

POINTS_PER_MM = 72.0 / 25.4
A4_MM = (210.0, 297.0)
PRODUCER = b"/Producer (splitknit)"
_CIRCLE = 4.0 / 3.0 * (math.sqrt(2.0) - 1.0)
"""Length of the handles with which four cubic curves make a circle (to 2.7e-4 of its radius)."""


@dataclass(slots=True)
class Page:
    """A page in the making; all lengths are mm, the origin is its lower left corner, x right, y up."""

    size_mm: tuple[float, float] = A4_MM
    title: str = ""
    _marks: list[str] = field(default_factory=list)
    _shapes: dict[str, tuple[str, tuple[float, float, float, float]]] = field(default_factory=dict)

    def shape(self, name: str, drawing: str, box_mm: tuple[float, float, float, float]) -> None:
        """Keep a drawing (of :func:`rectangles` or :func:`circle`) within a box under a name, to be placed."""
        require(name.isalpha() and name.isascii(), f"a shape's name must be ASCII letters, but it is '{name}'.")
        self._shapes[name] = drawing, box_mm

    def place(self, name: str, x_mm: float, y_mm: float) -> None:
        """Draw a shape with its origin at a place."""
        require(name in self._shapes, f"there is no shape '{name}' on the page.")
        self._marks.append(f"q 1 0 0 1 {number(x_mm)} {number(y_mm)} cm /{name} Do Q")

    def line(self, points_mm: Sequence[tuple[float, float]], width_mm: float = 0.1, grey: float = 0.0) -> None:
        """Draw a line through points."""
        require(len(points_mm) >= 2, "a line needs two points at least.")
        (x, y), *rest = points_mm
        path = " ".join([f"{number(x)} {number(y)} m", *(f"{number(u)} {number(v)} l" for u, v in rest)])
        self._marks.append(f"{number(width_mm)} w {number(grey)} G {path} S")

    def outline(self, drawing: str, x_mm: float, y_mm: float, width_mm: float = 0.1, grey: float = 0.0) -> None:
        """Draw the outline of :func:`rectangles` or :func:`circle` about a place."""
        self._marks.append(
            f"q 1 0 0 1 {number(x_mm)} {number(y_mm)} cm {number(width_mm)} w {number(grey)} G {drawing} S Q"
        )

    def text(self, words: str, x_mm: float, y_mm: float, size_mm: float = 2.8) -> None:
        """Write a line of ASCII in Helvetica, which every reader has."""
        require(words.isascii() and words.isprintable(), "text on a page must be printable ASCII.")
        escaped = words.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        self._marks.append(f"BT /F {number(size_mm)} Tf {number(x_mm)} {number(y_mm)} Td ({escaped}) Tj ET")

    def to_bytes(self) -> bytes:
        """Return the file; equal pages give equal bytes."""
        scale = number(POINTS_PER_MM)
        content = "\n".join([f"{scale} 0 0 {scale} 0 0 cm", *self._marks])
        names = list(self._shapes)
        first = 6  # 1 catalogue, 2 pages, 3 page, 4 content, 5 font, then the shapes, then the title
        shapes = " ".join(f"/{name} {first + k} 0 R" for k, name in enumerate(names))
        width, height = (number(side * POINTS_PER_MM) for side in self.size_mm)
        objects = [
            "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 4 0 R "
            f"/Resources << /Font << /F 5 0 R >> /XObject << {shapes} >> >> >>",
            _stream("", content),
            "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        ]
        for name in names:
            drawing, box = self._shapes[name]
            sides = " ".join(number(side) for side in box)
            objects.append(_stream(f"/Type /XObject /Subtype /Form /BBox [{sides}] ", f"0 g {drawing} f"))
        objects.append(f"<< /Title ({self.title}) {PRODUCER.decode()} >>")
        return _file(objects)


def rectangles(corners: Sequence[tuple[float, float, float, float]]) -> str:
    """Paths of rectangles: lower left x and y, width, height of each, in mm."""
    return " ".join(f"{number(x)} {number(y)} {number(w)} {number(h)} re" for x, y, w, h in corners)


def circle(radius_mm: float) -> str:
    """Path of a circle about the origin."""
    r, h = radius_mm, radius_mm * _CIRCLE
    curves = [(r, h, h, r, 0, r), (-h, r, -r, h, -r, 0), (-r, -h, -h, -r, 0, -r), (h, -r, r, -h, r, 0)]
    return " ".join([f"{number(r)} 0 m", *(" ".join(map(number, curve)) + " c" for curve in curves), "h"])


def number(value: float) -> str:
    """A length as PDF writes it: no exponent, 0.1 um and no trailing zeros."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _stream(entries: str, content: str) -> str:
    return f"<< {entries}/Length {len(content)} >>\nstream\n{content}\nendstream"


def _file(objects: Sequence[str]) -> bytes:
    """Objects with the table of their places; the catalogue is the first, the title the last."""
    data = b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n"
    places = []
    for k, item in enumerate(objects, start=1):
        places.append(len(data))
        data += f"{k} 0 obj\n{item}\nendobj\n".encode("ascii")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    tail = (
        f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R /Info {count - 1} 0 R >>\n"
        f"startxref\n{len(data)}\n%%EOF\n"
    )
    return data + tail.encode("ascii")
