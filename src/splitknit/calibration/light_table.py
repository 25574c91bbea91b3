"""The table of nail and shadow tips that the lights are calibrated from, and which of its LEDs can be trusted.

One row a photograph: which LED was lit (`band`, and `led`, 0 to 6 within it), which place the nail stood at (`nail`,
any whole number), the nail's pixel and that of its shadow's tip (x along the columns, y down the rows, as image
viewers show them).

References
----------
The thesis, section 4.3.2 and figure 5.1.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, refusing, require
from splitknit.imaging.view import plane_points
from splitknit.model import Camera

BANDS = ("white", "nir")
LEDS_PER_BAND = 7
COLUMNS = ("band", "led", "nail", "nail_x_px", "nail_y_px", "tip_x_px", "tip_y_px")
_BEYOND = 0.02
"""Part of the image's size by which a pixel may lie beyond its border: clicked beside the last pixel, not elsewhere."""


@dataclass(frozen=True, slots=True)
class Tip:
    """One row: what one LED's photograph of one nail position shows."""

    band: str
    led: int
    nail: int
    nail_px: tuple[float, float]
    """Column and row of the nail."""
    tip_px: tuple[float, float]
    """Column and row of its shadow's tip."""

    @property
    def name(self) -> str:
        """Such as ``white 3, nail 2``, for messages."""
        return f"{_led_name(self.band, self.led)}, nail {self.nail}"


def _led_name(band: str, led: int) -> str:
    """Such as ``white 3`` or ``NIR 0``."""
    return f"{'NIR' if band == 'nir' else band} {led}"


def read_tips(text: str, name: str = "the table") -> tuple[Tip, ...]:
    """Read the rows of a table in CSV; lines that are empty or begin with ``#`` are skipped, other columns ignored.

    Parameters
    ----------
    text : the table, its first line the names of the columns
    name : of the file, for messages

    Returns
    -------
    Rows in the order white before NIR, LED, nail.

    Raises
    ------
    BadInput
        Naming the line: a column is missing, something is no number, a band or LED is not known, or the same band,
        LED and nail come twice.
    """
    lines = [(k, line) for k, line in enumerate(text.lstrip("\ufeff").splitlines(), start=1)]
    lines = [(k, line) for k, line in lines if line.strip(" \t,") and not line.lstrip().startswith("#")]
    require(bool(lines), f"{name} is empty; its first line must be {','.join(COLUMNS)}.")
    header = [cell.lower() for cell in _cells(lines[0][1], name)]
    missing = [column for column in COLUMNS if column not in header]
    require(
        not missing,
        f"{name} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}; its first line must be "
        f"{','.join(COLUMNS)}.",
    )
    require(len(set(header)) == len(header), f"{name} names a column twice in its first line.")
    tips: dict[tuple[str, int, int], tuple[int, Tip]] = {}
    for number, line in lines[1:]:
        tip = _tip(line, header, f"{name}, line {number}")
        key = (tip.band, tip.led, tip.nail)
        if key in tips:
            raise BadInput(
                f"{name}, lines {tips[key][0]} and {number} are both for {tip.name}; keep one of them, or correct its "
                f"numbers."
            )
        tips[key] = (number, tip)
    require(bool(tips), f"{name} has no rows below its first line; add one for every LED and nail position.")
    return tuple(sorted((tip for _, tip in tips.values()), key=lambda tip: (BANDS.index(tip.band), tip.led, tip.nail)))


def write_tips(tips: Sequence[Tip]) -> str:
    """Return the table as text that :func:`read_tips` reads, pixels to two digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for tip in tips:
        pixels = [f"{value:.2f}" for value in (*tip.nail_px, *tip.tip_px)]
        writer.writerow([tip.band, tip.led, tip.nail, *pixels])
    return stream.getvalue()


def check_tips(tips: Sequence[Tip], image_size: tuple[int, int], name: str = "the table") -> None:
    """Check that the table is complete and that its pixels lie in the image.

    Of every band that occurs all seven LEDs must be there, each at two nail positions at least (one, where the nail
    stood in one place only).

    Parameters
    ----------
    tips : rows of the table
    image_size : rows, columns
    name : of the table, for messages

    Raises
    ------
    BadInput
        Naming the LED and the nail.
    """
    rows, columns = image_size
    for tip in tips:
        for what, (x, y) in (("nail", tip.nail_px), ("shadow's tip", tip.tip_px)):
            inside = -_BEYOND * columns <= x <= (1 + _BEYOND) * columns and -_BEYOND * rows <= y <= (1 + _BEYOND) * rows
            require(
                inside,
                f"{name}: {tip.name}: the {what} at x = {x:g}, y = {y:g} lies outside the image of {columns} columns "
                f"and {rows} rows; correct the row, or the image size (rows, columns).",
            )
    nails = sorted({tip.nail for tip in tips})
    for band in [band for band in BANDS if any(tip.band == band for tip in tips)]:
        present = {(tip.led, tip.nail) for tip in tips if tip.band == band}
        absent = [led for led in range(LEDS_PER_BAND) if not any(led == one for one, _ in present)]
        require(
            not absent,
            f"{name} has no row for {' and '.join(_led_name(band, led) for led in absent)}; every LED from 0 to "
            f"{LEDS_PER_BAND - 1} of a band that occurs needs its rows.",
        )
        for led in range(LEDS_PER_BAND):
            seen = [nail for nail in nails if (led, nail) in present]
            lost = [str(nail) for nail in nails if nail not in seen]
            require(
                len(seen) >= min(2, len(nails)),
                f"{name} has {_led_name(band, led)} at nail {seen[0]} only, and not at nail {' and '.join(lost)}; add "
                f"the row, because one position cannot be checked.",
            )


def pixels(tips: Sequence[Tip]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows (N, 2) of the nails and of the shadows' tips."""
    nails = np.array([tip.nail_px for tip in tips], dtype=np.float64).reshape(-1, 2)
    ends = np.array([tip.tip_px for tip in tips], dtype=np.float64).reshape(-1, 2)
    return nails, ends


def _tip(line: str, header: Sequence[str], where: str) -> Tip:
    cells = _cells(line, where)
    require(
        len(cells) == len(header),
        f"{where} has {len(cells)} fields, but the first line names {len(header)}; correct the line.",
    )
    row = dict(zip(header, cells, strict=True))
    band = row["band"].lower()
    require(band in BANDS, f"{where}: the band must be white or nir, but it is {row['band'][:60]!a}.")
    led = _whole(row["led"], where, "led")
    require(
        led < LEDS_PER_BAND,
        f"{where}: led must be 0 to {LEDS_PER_BAND - 1}, counted within its band, but it is {row['led'][:60]!a}.",
    )
    numbers = [_number(row[column], where, column) for column in COLUMNS[3:]]
    return Tip(band, led, _whole(row["nail"], where, "nail"), (numbers[0], numbers[1]), (numbers[2], numbers[3]))


def _cells(line: str, where: str) -> list[str]:
    with refusing(
        f"{where} is no line of a CSV table."
    ):  # such as one of a hundred thousand characters without a comma
        return [cell.strip() for cell in next(csv.reader([line]))]


def _whole(text: str, where: str, column: str) -> int:
    sound = text.isascii() and text.isdigit() and len(text) <= 9
    require(sound, f"{where}: {column} must be a whole number that is not negative, but it is {text[:60]!a}.")
    return int(text)


def _number(text: str, where: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    require(
        math.isfinite(value) and abs(value) < 1e6,
        f"{where}: {column} must be a number of pixels, but it is {text[:60]!a}.",
    )
    return value


Points = NDArray[np.float64]
OK, DISAGREES, COPIED, UNCHECKED, STRAYS = "ok", "disagrees", "copied", "unchecked", "off the circle"


@dataclass(frozen=True, slots=True)
class LightLimits:
    """What is refused."""

    limit_deg: float = 5.0
    """Directions of one LED that are further apart than this disagree."""
    copy_mm: float = 0.4
    """Shadow tips of two nail positions that are nearer than this, on the finger plane, repeat: a true tip moves
    further than its nail. The thesis's copies lie up to 0.22 mm apart."""
    move_mm: float = 1.0
    """Nail positions that are nearer than this are one position."""
    same_nail_mm: float = 1.0
    """The nail's pixel may differ so much between the rows of one position."""

    def __post_init__(self) -> None:
        require(0 < self.limit_deg <= 90, f"limit_deg must lie between 0 and 90 deg, but it is {self.limit_deg}.")
        for name in ("copy_mm", "move_mm", "same_nail_mm"):
            require(0 <= getattr(self, name) <= 100, f"LightLimits: {name} must lie between 0 and 100 mm.")
        require(self.copy_mm <= self.move_mm, "LightLimits: copy_mm must not exceed move_mm.")


def copied_leds(tips: Sequence[Tip], camera: Camera, limits: LightLimits | None = None) -> set[tuple[str, int]]:
    """Return the LEDs, band and number, whose shadow tips repeat although the nail moved: copying errors.

    A tip always moves further than its nail, so that no true pair of tips can come under the limit.
    """
    limits = limits or LightLimits()
    nails, ends = (plane_points(camera, part) for part in pixels(tips))
    found = set()
    for i, first in enumerate(tips):
        for j in range(i + 1, len(tips)):
            if (first.band, first.led) == (tips[j].band, tips[j].led):
                moved = float(np.linalg.norm(nails[i] - nails[j]))
                if np.linalg.norm(ends[i] - ends[j]) <= limits.copy_mm and moved > limits.move_mm:
                    found.add((first.band, first.led))
    return found


def check_nails(tips: Sequence[Tip], camera: Camera, limits: LightLimits | None = None) -> None:
    """Check that a nail number is one place, and two numbers two places.

    Raises
    ------
    BadInput
        Naming the nail numbers.
    """
    limits = limits or LightLimits()
    nails = plane_points(camera, pixels(tips)[0])
    middles: dict[tuple[str, int], Points] = {}
    for band, nail in dict.fromkeys((tip.band, tip.nail) for tip in tips):
        places = nails[[(tip.band, tip.nail) == (band, nail) for tip in tips]]
        middle = np.median(places, axis=0)
        spread = float(np.linalg.norm(places - middle, axis=1).max())
        require(
            spread <= limits.same_nail_mm,
            f"nail {nail} of the {band} LEDs stands at places {spread:.1f} mm from each other; a nail number is one "
            f"position, so correct its pixels or give each position a number of its own.",
        )
        middles[band, nail] = middle
    for (band, nail), middle in middles.items():
        for (other_band, other), place in middles.items():
            distance = float(np.linalg.norm(middle - place))
            require(
                band != other_band or nail >= other or distance > limits.move_mm,
                f"nails {nail} and {other} of the {band} LEDs stand {distance:.2f} mm from each other, which is one "
                f"position; move the nail by a centimetre between them, or correct its pixels.",
            )


@dataclass(frozen=True, slots=True)
class Judged:
    """One LED and what is thought of it."""

    band: str
    led: int
    disagreement_deg: float | None
    verdict: str

    @property
    def refused(self) -> bool:
        """Whether it must not be used without a word from the user."""
        return self.verdict not in (OK, UNCHECKED)

    @property
    def name(self) -> str:
        """Such as ``white 3``."""
        return _led_name(self.band, self.led)


def judge(
    found: Sequence[tuple[str, int, float | None]],
    copied: Set[tuple[str, int]],
    strays: Set[tuple[str, int]] = frozenset(),
    limit_deg: float = 5.0,
) -> tuple[Judged, ...]:
    """Give every LED (band, number, disagreement in degrees or None) its verdict.

    ``copied`` goes before ``off the circle``, that before ``disagrees``; ``unchecked`` is an LED that one position of
    the nail shows.
    """
    judged = []
    for band, led, apart in found:
        if (band, led) in copied:
            word = COPIED
        elif (band, led) in strays:
            word = STRAYS
        elif apart is None:
            word = UNCHECKED
        else:
            word = DISAGREES if apart > limit_deg else OK
        judged.append(Judged(band, led, apart, word))
    return tuple(judged)


def refusal(judged: Sequence[Judged], limit_deg: float, stray_mm: float = 10.0) -> str | None:
    """One sentence that names every LED that is refused and what to do; None where there is none."""
    apart = [f"{one.name} ({one.disagreement_deg:.1f} deg)" for one in judged if one.verdict == DISAGREES]
    same = [one.name for one in judged if one.verdict == COPIED]
    away = [one.name for one in judged if one.verdict == STRAYS]
    parts = []
    if apart:
        parts.append(f"two nail positions disagree by more than {limit_deg:g} deg about {_listed(apart)}")
    if same:
        parts.append(f"the shadow tips of {_listed(same)} are copies: they repeat although the nail moved")
    if away:
        parts.append(f"{_listed(away)} would stand more than {stray_mm:g} mm outside or inside the LED circle")
    if not parts:
        return None
    return (
        f"{', and '.join(parts)}; correct the pixels or photograph the nail again under these LEDs, or keep them as "
        f"they are (--keep)."
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
