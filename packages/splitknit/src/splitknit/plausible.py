"""What a number that a person types, or what follows from it, can be: one table of ranges, with
their sources.

A value outside `usual` is odd and gets a note; one outside `possible` is a slip, as of a unit, and
is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

from splitknit.errors import require
from splitknit.findings import Finding


@dataclass(frozen=True, slots=True)
class _Plausible:
    """A quantity and its ranges, in the unit that people give it in."""

    code: str
    what: str
    unit: str
    usual: tuple[float, float]
    possible: tuple[float, float]

    def notes(self, value: float, remedy: str) -> tuple[Finding, ...]:
        """A note where `value` is odd, none where it is usual. Raises BadInput where it is not
        possible.

        >>> print(*CAMERA_HEIGHT.notes(500.0, "check `square_mm`"))
        the camera's height above the finger plane is 500 mm, where 40 to 400 mm is usual: check
        `square_mm`.
        """
        unit, number = self.unit, ".3g" if value < 1e3 else ".0f"
        (low, high), possible = self.usual, self.possible[0] <= value <= self.possible[1]
        only, word, (lowest, highest) = (
            ("", "usual", self.usual) if possible else ("only ", "possible", self.possible)
        )
        note = Finding(
            self.code,
            f"{self.what} is {{:{number} {unit}}}, where {only}{{:g {unit}-}} to {{:g {unit}}} is"
            f" {word}: {remedy}.",
            lengths_mm=tuple(
                each / (1000.0 if unit == "um" else 1.0) for each in (value, lowest, highest)
            ),
        )
        require(possible, str(note))
        return () if low <= value <= high else (note,)


ANY = float("inf")
VIEW = _Plausible(
    "odd-view", "the longer side of the pictures of a finger", "mm", (10.0, 200.0), (3.0, 400.0)
)
"""From a part of a fingertip to a whole hand."""
OBJECT_VIEW = _Plausible(
    "odd-view", "the longer side of the pictures", "mm", (0.2, 3000.0), (0.0, ANY)
)
"""From a coin's letter under a microscope to a wall painting; a scale in mm a pixel lies
outside."""
FINGER_WIDTH = _Plausible("odd-finger-width", "the finger's width", "mm", (6.0, 30.0), (2.0, 60.0))
"""Adults' fingers are 14 to 25 mm wide (T. M. Greiner, Hand anthropometry of U.S. Army personnel,
1991)."""
RIDGE_PERIOD = _Plausible(
    "odd-ridge-period", "the distance of the ridges", "mm", (0.3, 0.7), (0.2, 1.0)
)
"""0.43 mm in women and 0.48 mm in men, 8 % between people (H. Cummins, W. J. Waits and J. T.
McQuitty, Am. J. Anat. 68, 1941); children's from 0.3 mm."""
USUAL_RIDGE_PERIOD_MM = 0.45
"""Between 0.43 mm in women and 0.48 mm in men: what is assumed of a finger without a scale. Source:
as `RIDGE_PERIOD`."""
RELIEF = _Plausible(
    "odd-relief", "the ridges' height (5th to 95th percentile)", "um", (0.0, 400.0), (0.0, ANY)
)
"""Ridges are some 50 to 150 um high; 130 um on simulated fingers, 4000 um on a render that was
taken for skin."""
DEPTH = _Plausible(
    "odd-depth",
    "the surface's depth, from its highest point to its lowest,",
    "mm",
    (0.0, 20.0),
    (0.0, 60.0),
)
"""A finger is up to 25 mm thick, of which the camera sees the upper half."""
CAMERA_HEIGHT = _Plausible(
    "odd-camera-height",
    "the camera's height above the finger plane",
    "mm",
    (40.0, 400.0),
    (15.0, 1000.0),
)
"""140 mm in the drawn rig; at a metre the drawn camera has 4 pixels a ridge."""
LED_DISTANCE = _Plausible(
    "odd-led-distance",
    "the distance of the LEDs from the finger (the nearest, the farthest)",
    "mm",
    (20.0, 600.0),
    (5.0, 5000.0),
)
"""90 to 170 mm in the drawn rig; position_mm in metres or micrometres lies outside."""
TOP = _Plausible(
    "odd-top",
    "the highest point above the finger plane (top_mm)",
    "mm",
    (-5.0, 30.0),
    (-100.0, 100.0),
)
"""A finger is up to 25 mm thick."""
