"""The table of nail and shadow tips that the lights are calibrated from, and which of its LEDs can be trusted.

One row a photograph: which LED was lit (`band`, and `led`, 0 to 6 within it), which place the nail stood at (`nail`,
any whole number), the nail's pixel and that of its shadow's tip (x along the columns, y down the rows, as image
viewers show them).

Source: the thesis, section 4.3.2 and figure 5.1.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, refusing, require
from splitknit.io.csv_table import csv_text

BANDS = ("white", "nir")
LEDS_PER_BAND = 7
COLUMNS = ("band", "led", "nail", "nail_x_px", "nail_y_px", "tip_x_px", "tip_y_px")


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
        return f"{name_of_led(self.band, self.led)}, nail {self.nail}"


def name_of_led(band: str, led: int) -> str:
    """Such as ``white 3`` or ``NIR 0``."""
    return f"{'NIR' if band == 'nir' else band} {led}"


def read_tips(text: str, name: str = "the table") -> tuple[Tip, ...]:
    """Read the rows of a table in CSV, in the order white before NIR, LED, nail; lines that are empty or begin with
    ``#`` are skipped. Raises BadInput naming the line: a column is missing, something is no number, a band or LED is
    not known, or the same band, LED and nail come twice.
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
    rows: list[list[object]] = [list(COLUMNS)]
    for tip in tips:
        pixels = [f"{value:.2f}" for value in (*tip.nail_px, *tip.tip_px)]
        rows.append([tip.band, tip.led, tip.nail, *pixels])
    return csv_text(rows)


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
