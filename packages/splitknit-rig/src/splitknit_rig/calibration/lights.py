"""Positions of the LEDs from a nail and the tips of its shadows: the thesis's construction, and its
consistency.

The ray from the tip of the shadow through the nail, seen from above, meets the circle on which the
LEDs sit on the far side of the nail; the LED is there, at the height of the circle. Its direction
is that of its position seen from the centre of the circle on the finger plane. Every position of
the nail gives one direction; the thesis takes the mean of two. Their disagreement is the only sign
of a bad table, and it is reported for each LED.

The table has one row a photograph: which LED was lit (`band`, and `led`, 0 to 6 within it), which
place the nail stood at (`nail`, any whole number), the nail's pixel and that of its shadow's tip (x
along the columns, y down the rows, as image viewers show them).

Source: the thesis, section 4.3.2 and figure 5.1, with step 5 corrected: the ray runs through the
nail and the tip, not through the centre.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitknit import Camera, Led
from splitknit.errors import refusing, require
from splitknit.imaging.view import plane_points
from splitknit.io.csv_table import csv_text
from splitknit.model import Array, Point

BANDS = ("white", "nir")
LEDS_PER_BAND = 7
"""Source: the thesis's rig of seven white and seven NIR LEDs."""
COLUMNS = ("band", "led", "nail", "nail_x_px", "nail_y_px", "tip_x_px", "tip_y_px")


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: ``white 1, white 3 and nir 0``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]])) or "no LED"


@dataclass(frozen=True, slots=True)
class Tip:
    """One row: what one LED's photograph of one nail position shows."""

    band: str
    led: int
    nail: int
    nail_px: tuple[float, float]  # column and row of the nail
    tip_px: tuple[float, float]  # column and row of its shadow's tip

    @property
    def lit(self) -> tuple[str, int]:
        """Band and number of the LED."""
        return self.band, self.led

    @property
    def name(self) -> str:
        """Such as ``white 3, nail 2``, for messages."""
        return f"{name_of_led(self.band, self.led)}, nail {self.nail}"


def name_of_led(band: str, led: int) -> str:
    """Such as ``white 3`` or ``NIR 0``."""
    return f"{'NIR' if band == 'nir' else band} {led}"


def led_name(leds: Sequence[Led], index: int) -> str:
    """Such as ``white 3``: an LED of a rig by its band and its number in it."""
    band = leds[index].band
    return f"{band} {sum(led.band == band for led in leds[:index])}"


def led_of_file(path: Path) -> tuple[str, int] | None:
    """Band and number of the LED that a photograph is named after, as ``white_3.png`` is."""
    match = re.fullmatch(r"(white|nir)[_.-]?(\d+)", path.stem.lower())
    return (match[1], int(match[2])) if match else None


def read_tips(text: str, name: str = "the table") -> tuple[Tip, ...]:
    """Read the rows of a table in CSV, in the order white before NIR, LED, nail; ``#`` starts a
    comment. Raises BadInput naming the row: a column is missing, something is not a number, a band
    or LED is not known, or a row comes twice.
    """
    lines = [
        line
        for line in text.lstrip("\ufeff").splitlines()
        if line.strip(" \t,") and line.lstrip()[0] != "#"
    ]
    require(lines, f"{name} is empty; its first line must be {','.join(COLUMNS)}.")
    # such as a line of a hundred thousand characters without a comma
    with refusing(f"{name} is not a table in CSV."):
        header, *rows = ([cell.strip() for cell in row] for row in csv.reader(lines))
    header = [cell.lower() for cell in header]
    missing = ", ".join(column for column in COLUMNS if column not in header)
    require(not missing, f"{name} lacks {missing}; its first line must be {','.join(COLUMNS)}.")
    tips: dict[tuple[str, int, int], Tip] = {}
    for number, row in enumerate(rows, start=1):
        where = f"{name}, row {number}"
        require(
            len(row) == len(header),
            f"{where} has {len(row)} fields, but the first line names {len(header)}.",
        )
        tip = _tip(dict(zip(header, row, strict=True)), where)
        key = (tip.band, tip.led, tip.nail)
        require(
            key not in tips, f"{where} is for {tip.name}, as an earlier row is; keep one of them."
        )
        tips[key] = tip
    require(
        tips,
        f"{name} has no rows below its first line; add one for every LED and nail position.",
    )
    return tuple(sorted(tips.values(), key=lambda tip: (BANDS.index(tip.band), tip.led, tip.nail)))


def write_tips(tips: Sequence[Tip]) -> str:
    """Return the table as text that :func:`read_tips` reads, pixels to two digits."""
    rows: list[list[object]] = [list(COLUMNS)]
    for tip in tips:
        pixels = [f"{value:.2f}" for value in (*tip.nail_px, *tip.tip_px)]
        rows.append([tip.band, tip.led, tip.nail, *pixels])
    return csv_text(rows)


def pixels(tips: Sequence[Tip]) -> tuple[Array, Array]:
    """Columns and rows (N, 2) of the nails and of the shadows' tips."""
    nails = np.array([tip.nail_px for tip in tips], dtype=np.float64).reshape(-1, 2)
    ends = np.array([tip.tip_px for tip in tips], dtype=np.float64).reshape(-1, 2)
    return nails, ends


def _tip(row: Mapping[str, str], where: str) -> Tip:
    band = row["band"].lower()
    require(
        band in BANDS, f"{where}: the band must be white or nir, but it is {row['band'][:60]!a}."
    )
    led = _whole(row["led"], where, "led")
    require(
        led < LEDS_PER_BAND,
        f"{where}: led must be 0 to {LEDS_PER_BAND - 1}, counted within its band, but it is"
        f" {row['led'][:60]!a}.",
    )
    numbers = [_number(row[column], where, column) for column in COLUMNS[3:]]
    return Tip(
        band,
        led,
        _whole(row["nail"], where, "nail"),
        (numbers[0], numbers[1]),
        (numbers[2], numbers[3]),
    )


def _whole(text: str, where: str, column: str) -> int:
    sound = text.isascii() and text.isdigit() and len(text) <= 9
    require(
        sound,
        f"{where}: {column} must be a whole number that is not negative, but it is {text[:60]!a}.",
    )
    return int(text)


def _number(text: str, where: str, column: str) -> float:
    words = f"{where}: {column} must be a number of pixels, but it is {text[:60]!a}."
    with refusing(words):
        value = float(text)
    require(abs(value) < 1e6, words)
    return value


@dataclass(frozen=True, slots=True)
class Circle:
    """The circle on which the LEDs sit, as measured with a ruler."""

    radius_mm: float
    height_mm: float  # height of the LEDs above the finger plane
    # its centre on the finger plane, in the rig's frame
    centre_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        require(
            1.0 <= self.radius_mm <= 1e4,
            f"the LED circle's radius must be 0.1 to 1000 cm, not {self.radius_mm}.",
        )
        require(
            1.0 <= self.height_mm <= 1e4,
            f"the LEDs' height must be 0.1 to 1000 cm, not {self.height_mm / 10}.",
        )
        require(np.isfinite(self.centre_mm).all(), "the LED circle's centre must be finite.")

    @property
    def foot_mm(self) -> Array:
        """(3,) the centre on the finger plane, from which directions are measured."""
        return np.array([*self.centre_mm, 0.0])


@dataclass(frozen=True, slots=True)
class CalibratedLed:
    """Position of an LED, and its uncertainty."""

    band: str
    led: int
    direction: Point
    """Unit, towards the LED."""
    position_mm: Point | None
    """In the rig's frame; None for a distant light."""
    disagreement_deg: float | None = None
    """Largest angle between the directions from two nail positions; None if there was only one."""
    verdict: str = "unchecked"
    """``ok``, ``disagrees``, ``copied``, ``off the circle`` or ``unchecked``."""
    kept: bool = True
    interval_deg: float | None = None
    """Half of the 95 % interval (joint fit only); `interval_mm` likewise."""
    interval_mm: float | None = None
    image: str | None = None
    """The photograph of a ball that shows the LED."""
    strength: float | None = None
    """Brightness from a matt ball's shading, relative to the mean."""


def point_of(place: Array) -> Point:
    """Three numbers of an array (3,)."""
    x, y, z = place.tolist()
    return x, y, z


def nail_points(camera: Camera, nail_px: Array, height_mm: float) -> Array:
    """Position of the nail on the finger plane, (N, 2), from the pixel of its tip. A perspective
    camera sees the tip further out, because of the nail's `height_mm`.
    """
    points = plane_points(camera, nail_px)
    if camera.model == "perspective":
        points = points * (1.0 - height_mm / camera.height_mm)
    return points


def by_circle(
    tips: Sequence[Tip], camera: Camera, circle: Circle, *, known_height_mm: float | None = None
) -> tuple[tuple[CalibratedLed, ...], float]:
    """Find every LED by the thesis's construction, in the order of the rows, and the nail's height
    in mm, from the lengths of the shadows unless known. Raises BadInput, naming LED and nail
    position, if there is no shadow or the nail stands outside the circle.
    """
    nail_px, tip_px = pixels(tips)
    ends = plane_points(camera, tip_px)
    height = known_height_mm or 0.0
    # the height matters to where a perspective camera sees the nail, and follows from it
    for _ in range(12):
        nails = nail_points(camera, nail_px, height)
        _check_shadows(tips, nails, ends, circle)
        along = nails - ends
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        out = nails - np.asarray(circle.centre_mm)
        half = (along * out).sum(axis=1)
        inside = circle.radius_mm**2 - (out * out).sum(axis=1)
        step = np.sqrt(half * half + inside) - half
        positions = np.column_stack(
            [nails + step[:, None] * along, np.full(len(along), circle.height_mm)]
        )
        # The nail's height, by similar triangles from the lengths of its shadows
        shadow = np.linalg.norm(ends - nails, axis=1)
        ratio = shadow / np.maximum(np.linalg.norm(positions[:, :2] - nails, axis=1), 1e-9)
        measured = float(np.median(positions[:, 2] * ratio / (1.0 + ratio)))
        if (
            camera.model != "perspective"
            or known_height_mm is not None
            or abs(measured - height) < 1e-6
        ):
            break
        height = min(measured, 0.6 * circle.height_mm)
    estimates = []
    for band, led in dict.fromkeys(tip.lit for tip in tips):
        rows = [k for k, tip in enumerate(tips) if tip.lit == (band, led)]
        estimates.append(combine(band, led, positions[rows], circle))
    return tuple(estimates), measured if known_height_mm is None else known_height_mm


def combine(band: str, led: int, singles: Array, circle: Circle) -> CalibratedLed:
    """Combine the LED positions (K, 3) from single nail positions: their mean, and their
    disagreement."""
    arms = singles - circle.foot_mm
    units = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    mean = units.mean(axis=0)
    # at the mean height, in the mean direction: for arms of one length, the mean position
    position = circle.foot_mm + mean * (arms[:, 2].mean() / mean[2])
    # angles by the chord, which is exact for small ones where the cosine is not
    chords = np.linalg.norm(units[:, None] - units[None], axis=2)
    largest_deg = float(np.degrees(2.0 * np.arcsin(np.clip(chords.max() / 2.0, 0.0, 1.0))))
    disagreement_deg = largest_deg if len(units) > 1 else None
    direction = mean / np.linalg.norm(mean)
    return CalibratedLed(band, led, point_of(direction), point_of(position), disagreement_deg)


def _check_shadows(tips: Sequence[Tip], nails: Array, ends: Array, circle: Circle) -> None:
    away = np.linalg.norm(nails - np.asarray(circle.centre_mm), axis=1)
    shadow = np.linalg.norm(nails - ends, axis=1)
    for k, tip in enumerate(tips):
        require(
            shadow[k] >= 0.2,  # mm
            f"{tip.name}: there is no shadow, for its tip lies {shadow[k]:.2f} mm from the nail;"
            " correct the row, or photograph a longer nail.",
        )
        require(
            away[k] < circle.radius_mm,
            f"{tip.name}: the line from the shadow to the LED does not start inside the LED circle:"
            f" the nail stands {away[k]:.1f} mm from the circle's centre and its radius is"
            f" {circle.radius_mm:g} mm; correct the row, the centre, the radius or px-per-cm.",
        )
