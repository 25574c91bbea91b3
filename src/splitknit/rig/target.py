"""The printed target: checkerboards for the small field of view, the calibration disc, and a ruler to check the print.

All on one sheet of A4, as vectors at true scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from splitknit.errors import require
from splitknit.rig.pdf import A4_MM, Page, circle, rectangles

RULER_MM = 100.0


@dataclass(frozen=True, slots=True)
class TargetSettings:
    """What is printed."""

    columns: int = 9
    """Inner corners of a checkerboard, along its width."""
    rows: int = 6
    """And along its height."""
    square_mm: float = 3.0
    """Side of a square: 9 x 6 inner corners of 3 mm are 30 x 21 mm, in a field of view of about 42 x 29 mm."""
    dot_mm: float = 1.5
    """Diameter of a dot of the disc."""
    spacing_mm: float = 10.0
    """Of the dots."""
    disc_radius_mm: float = 45.0
    """Where the disc is cut out."""
    card_margin_mm: float = 4.0
    """White paper around a board, within the line along which it is cut out."""
    page_margin_mm: float = 12.0
    """Which printers leave free."""

    def __post_init__(self) -> None:
        require(
            3 <= self.columns <= 60 and 3 <= self.rows <= 60,
            f"a board to print must have 3 to 60 inner corners each way, but it is {self.columns} x {self.rows}.",
        )
        require(
            0.5 <= self.square_mm <= 40,
            f"squares to print must have 0.5 to 40 mm a side, but it is {self.square_mm:g}.",
        )
        require(
            0.5 <= self.dot_mm < 0.6 * self.spacing_mm,
            f"dots must be 0.5 mm wide at least and less than 0.6 of their spacing, but they are {self.dot_mm:g} mm at "
            f"every {self.spacing_mm:g} mm.",
        )
        require(
            self.spacing_mm + self.dot_mm <= self.disc_radius_mm <= 60,
            f"the disc's radius must hold two dots and be at most 60 mm, but it is {self.disc_radius_mm:g} mm.",
        )
        width, height = self.card_mm
        free = A4_MM[0] - 2 * self.page_margin_mm
        require(
            width <= free and height <= self.boards_height_mm,
            f"a card of {width:g} x {height:g} mm does not fit on the sheet beside the disc ({free:g} x "
            f"{self.boards_height_mm:g} mm are free); use smaller or fewer squares.",
        )

    @property
    def board_mm(self) -> tuple[float, float]:
        """Width and height of the squares together."""
        return (self.columns + 1) * self.square_mm, (self.rows + 1) * self.square_mm

    @property
    def card_mm(self) -> tuple[float, float]:
        """Width and height of what is cut out."""
        width, height = self.board_mm
        return width + 2 * self.card_margin_mm, height + 2 * self.card_margin_mm

    @property
    def boards_height_mm(self) -> float:
        """Height of the sheet that is left for the boards, between ruler and disc."""
        return self.ruler_y_mm - 10 - (self.page_margin_mm + 2 * self.disc_radius_mm + 4)

    @property
    def ruler_y_mm(self) -> float:
        """Of the ruler's line."""
        return A4_MM[1] - self.page_margin_mm - 18

    @property
    def disc_centre_mm(self) -> tuple[float, float]:
        """On the sheet."""
        return A4_MM[0] / 2, self.page_margin_mm + self.disc_radius_mm

    @property
    def copies(self) -> tuple[int, int]:
        """Boards across and down the sheet."""
        width, height = self.card_mm
        across = int((A4_MM[0] - 2 * self.page_margin_mm + 3) // (width + 3))
        return min(across, 6), min(int((self.boards_height_mm + 3) // (height + 3)), 6)


def target_pdf(settings: TargetSettings | None = None) -> bytes:
    """Return the target as a PDF file; equal settings give equal bytes.

    Raises
    ------
    BadInput
        If a setting cannot be, or the parts do not fit on the sheet.
    """
    settings = settings or TargetSettings()
    page = Page(title="splitknit calibration target")
    _words(page, settings)
    _ruler(page, settings)
    _boards(page, settings)
    _disc(page, settings)
    return page.to_bytes()


def dots_mm(settings: TargetSettings) -> list[tuple[float, float]]:
    """Centres of the disc's dots about its middle, those that lie wholly on it with 1 mm to spare."""
    most = int(settings.disc_radius_mm // settings.spacing_mm)
    steps = [settings.spacing_mm * k for k in range(-most, most + 1)]
    reach = settings.disc_radius_mm - settings.dot_mm / 2 - 1
    return [(x, y) for y in steps for x in steps if math.hypot(x, y) <= reach]


def _words(page: Page, settings: TargetSettings) -> None:
    x, y = settings.page_margin_mm, A4_MM[1] - settings.page_margin_mm - 4
    board = f"checkerboards of {settings.columns} x {settings.rows} inner corners, squares {settings.square_mm:g} mm"
    disc = f"disc with dots of {settings.dot_mm:g} mm every {settings.spacing_mm:g} mm"
    page.text(f"splitknit: {board}; {disc}.", x, y)
    page.text(
        f"Print at 100 % on matt paper. The ruler must measure {RULER_MM:g} mm: if not, multiply --square-mm and "
        f"--dot-mm by what it measures / {RULER_MM:g}.",
        x,
        y - 5,
    )


def _ruler(page: Page, settings: TargetSettings) -> None:
    x, y = (A4_MM[0] - RULER_MM) / 2, settings.ruler_y_mm
    page.line([(x, y), (x + RULER_MM, y)], 0.2)
    for k in range(11):
        at = x + RULER_MM * k / 10
        page.line([(at, y - (3 if k % 10 == 0 else 1.5)), (at, y)], 0.1)


def _boards(page: Page, settings: TargetSettings) -> None:
    side = settings.square_mm
    width, height = settings.board_mm
    squares = [
        (j * side, height - (i + 1) * side, side, side)
        for i in range(settings.rows + 1)
        for j in range(settings.columns + 1)
        if (i + j) % 2 == 0
    ]
    page.shape("Board", rectangles(squares), (0, 0, width, height))
    across, down = settings.copies
    card_width, card_height = settings.card_mm
    top = settings.ruler_y_mm - 10
    for row in range(down):
        for column in range(across):
            free = A4_MM[0] - across * card_width
            x = free * (column + 1) / (across + 1) + column * card_width
            y = top - (row + 1) * card_height - 3 * row
            page.outline(rectangles([(0, 0, card_width, card_height)]), x, y, 0.05, 0.6)
            page.place("Board", x + settings.card_margin_mm, y + settings.card_margin_mm)


def _disc(page: Page, settings: TargetSettings) -> None:
    x, y = settings.disc_centre_mm
    radius = settings.dot_mm / 2
    box = radius + 0.1
    page.shape("Dot", circle(radius), (-box, -box, box, box))
    page.outline(circle(settings.disc_radius_mm), x, y, 0.05, 0.6)
    for across, up in dots_mm(settings):
        page.place("Dot", x + across, y + up)
