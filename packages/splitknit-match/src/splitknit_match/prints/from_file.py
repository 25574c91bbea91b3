"""Prints and minutiae from files: at which resolution they are, and brought to 500 pixels per
inch."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import require
from splitknit.findings import Finding, Severity
from splitknit.finger.regions import dilate, fill_holes, largest_component
from splitknit.imaging.pixels import bin_mean
from splitknit.model import BoolArray, FloatArray, GreyArray
from splitknit_match.prints.make import Print
from splitknit_match.prints.minutiae import at_500_ppi, is_a_fingers
from splitknit_match.prints.pressed import PressedRidges, frame, pressed_ridges, usual_contrast
from splitknit_match.prints.print_map import PrintMap, plane_map
from splitknit_match.prints.ridge_field import closed_opened
from splitknit_match.records.minutiae_files import read_minutiae_record
from splitknit_match.records.minutiae_record import (
    FINGER_CODES,
    PPI,
    RESOLUTION_500_PPI,
    FingerView,
    Minutiae,
)
from splitknit_match.records.pictures import PrintFile, read_print_png
from splitknit_match.records.print_formats import read_prints

UNKNOWN_POLARITY = Finding(
    "unknown-polarity",
    "it does not show whether its ridges are dark, and they are taken for dark: if they are light,"
    " give `ridges` light.",
)
SEVERAL = "the picture shows prints of several fingers; cut them apart, one print a picture."
WHITE_RIDGES = Finding("white-ridges", "its ridges are light and have been turned dark.")
MIN_PPI = 200.0  # below there are no ridges (telephones and browsers state 72 and 96, of screens)
MAX_PPI = 5080.0  # highest resolution of a print: no scanner is above


def read_print_file(
    path: str | os.PathLike[str], resolution_ppi: float | None = None, ridges: str | None = None
) -> tuple[PrintFile | FingerView, ...]:
    """Read the prints of a file, of known resolution, or its minutiae.

    Light ridges are turned dark, which a finding of the print says.

    `path`: of any format of :data:`splitknit_match.records.print_formats.FORMATS`;
    `resolution_ppi`: resolution of pictures, whatever they state; `ridges`: ``dark`` or ``light``,
    where it is known. Raises BadInput as
    :func:`splitknit_match.records.print_formats.read_prints`; if a picture does not state its
    resolution, with the one that its ridges suggest; or if it is below 200 or above 5080 ppi.
    """
    require(
        resolution_ppi is None or MIN_PPI <= resolution_ppi <= MAX_PPI,
        f"`resolution_ppi` must be a number from {MIN_PPI:g} to {MAX_PPI:g}, but it is"
        f" {resolution_ppi}.",
    )
    return tuple(
        (
            prepared(_resolved(item, os.fspath(path), resolution_ppi), ridges)
            if isinstance(item, PrintFile)
            else item
        )
        for item in read_prints(path)
    )


def read_one_finger(
    path: Path, resolution_ppi: float | None = None, ridges: str | None = None
) -> PrintFile | FingerView:
    """Read the only print, or the minutiae of the only finger, of a file.

    Raises BadInput as :func:`read_print_file`, or if the file holds several.
    """
    prints = read_print_file(path, resolution_ppi, ridges)
    require(
        len(prints) == 1,
        f"{path} holds {len(prints)} prints; take them apart with 'splitknit import'.",
    )
    return prints[0]


def read_print_folder(folder: Path) -> tuple[PrintFile, FingerView | None]:
    """Read what ``splitknit print`` wrote: the print, and its minutiae if they were found.

    Raises BadInput if a file is damaged, or the print states no resolution.
    """
    picture, record = read_print_png(folder / "print.png"), folder / "minutiae.iso"
    require(
        picture.resolution_ppi is not None,
        f"'{folder}' states no resolution; make the print again.",
    )
    return picture, read_minutiae_record(record)[0] if record.is_file() else None


def print_at_500_ppi(item: PrintFile) -> PrintFile:
    """Bring a print of known resolution to 500 ppi; one that has as many pixels as at 500 ppi stays
    as it is.

    Raises BadInput if it were larger than any print.
    """
    ppi = item.resolution_ppi or PPI
    image = at_500_ppi(item.image, ppi)
    return (
        item if image.shape == item.image.shape else replace(item, image=image, resolution_ppi=PPI)
    )


def _resolved(item: PrintFile, name: str, resolution_ppi: float | None) -> PrintFile:
    stated = item.resolution_ppi
    if resolution_ppi is None and (stated is None or stated < MIN_PPI):
        fault = (
            "does not state its resolution"
            if stated is None
            else f"states {stated:.0f} ppi, too few for ridges"
        )
        raise BadInput(f"{name} {fault}; {_suggestion(item.image)}.")
    ppi = resolution_ppi or stated or 0.0
    require(
        ppi <= MAX_PPI,
        f"{name} states {ppi:.0f} ppi, more than {MAX_PPI:g}; give the true value:"
        " `resolution_ppi` 500.",
    )
    return replace(item, resolution_ppi=float(ppi))


def _suggestion(image: GreyArray) -> str:
    period = ridge_period_px(image)
    if period is None:
        return (
            "it shows no ridges to measure it by: give it in pixels per inch, such as"
            " `resolution_ppi` 500"
        )
    return (
        f"its ridges lie {period:.1f} pixels apart, which fits {_usual_ppi(period)}: give the value"
        " of the scanner's data sheet, such as `resolution_ppi` 500"
    )


USUAL_PERIOD_MM = 0.46  # usual distance between ridges of adults' fingers; people differ by 8 %
_USUAL_PERIODS = (0.76, 1.47)
"""Lowest and highest distance of ridges over the usual one: those of 95 % of 280 real prints.
Chosen on: real prints (280 prints of seven sensors, validation/prints/any_print.py)."""


def _usual_ppi(period_px: float) -> str:
    """Resolutions at which ridges so far apart are usual."""
    low, high = (
        10 * round(period_px * 2.54 / (USUAL_PERIOD_MM * times)) for times in _USUAL_PERIODS[::-1]
    )
    return f"{low} to {high} pixels per inch"


_TILE_PX = 32  # side of a tile in whose spectrum ridges are sought
_BLANK_LEVEL = 4.0
"""Standard deviation in grey levels below which a picture is blank."""


def _waves(image: NDArray[Any], step: int) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Parallel ridges in tiles `step` pixels apart: part of the power in the strongest wave, its
    period in pixels, whether the tile has the contrast of the picture's strong ones, and whether
    its ridges run across rather than down; (n, m) each.

    Waves of 5 to 11 pixels count; a tile whose power is largest at another period holds none.
    """
    windows = sliding_window_view(image, (_TILE_PX, _TILE_PX))[::step, ::step]
    rows = [_tile_waves(tiles) for tiles in windows]  # a row at a time bounds the memory
    purity, period, turn, contrast = (np.array(values) for values in zip(*rows, strict=True))
    strong = contrast > max(_BLANK_LEVEL, 0.3 * usual_contrast(contrast))
    # ridges run on into the tiles beside
    cosine, sine, around = (cv2.blur(part, (3, 3)) for part in (turn.real, turn.imag, purity))
    agreement = np.hypot(cosine, sine) / np.maximum(around, 1e-6)
    return np.where(strong, purity * agreement, 0.0), period, strong, turn.real < 0


def _tile_waves(
    tiles: NDArray[Any],
) -> tuple[FloatArray, FloatArray, NDArray[np.complex64], FloatArray]:
    """Of N tiles: part of the power in the strongest wave, its period, its direction doubled, times
    that part, and the standard deviation.
    """
    hann = np.hanning(_TILE_PX + 2)[1:-1].astype(np.float32)
    taper = np.outer(hann, hann)
    down, right = np.meshgrid(np.fft.fftfreq(_TILE_PX), np.fft.rfftfreq(_TILE_PX), indexing="ij")
    radius = np.hypot(down, right)
    mean = np.tensordot(tiles, taper, 2) / taper.sum()
    power = np.abs(np.fft.rfft2((tiles - mean[:, None, None]) * taper)) ** 2
    power *= radius >= 1.5 / _TILE_PX
    # each wave is there twice, but those of the first column, which are halved
    power[..., 1:] *= 2.0
    total = power.sum(axis=(1, 2)) + 1e-6
    power = np.moveaxis(power, 0, -1)
    near = cv2.blur(power, (3, 3), borderType=cv2.BORDER_REFLECT_101) * 9.0
    near = near.reshape(radius.size, -1)
    down, right, radius = down.ravel(), right.ravel(), radius.ravel()
    best = near.argmax(axis=0)
    close = (
        np.maximum(np.abs(down[:, None] - down[best]), np.abs(right[:, None] - right[best]))
        < 1.5 / _TILE_PX
    )
    weight = np.where(close, power.reshape(near.shape), 0.0)
    weight /= weight.sum(axis=0) + 1e-9
    frequency = np.hypot(
        (weight * down[:, None]).sum(axis=0), (weight * right[:, None]).sum(axis=0)
    )
    in_band = (radius[best] >= 1 / 11.5) & (radius[best] <= 1 / 4.9) & (frequency > 1 / 11.5)
    purity = np.where(in_band, np.minimum(near.max(axis=0) / total, 1), 0)
    turn = (np.exp(2j * np.arctan2(down[best], right[best])) * purity).astype(np.complex64)
    period = (1.0 / np.maximum(frequency, 1e-3)).astype(np.float32)
    return purity, period, turn, np.sqrt(total) / (taper.sum() * 0.6)


def prepared(item: PrintFile, ridges: str | None = None) -> PrintFile:
    """A print of known resolution with its ridges dark, and what is in doubt of it; `ridges`:
    ``dark`` or ``light``, where it is known."""
    if ridges == "light":
        item = replace(item, image=255 - item.image)
    if not is_a_fingers(item.image, item.resolution_ppi or PPI):  # is refused where it is used
        return item
    doubt = resolution_doubt(item)
    item = item if doubt is None else _noted(item, doubt)
    return item if ridges else _dark_ridges(item)


def _noted(item: PrintFile, finding: Finding) -> PrintFile:
    return replace(item, findings=(*item.findings, finding))


_TILE_PURITY = 0.5  # part of a tile's power that lies in one wave, where it shows ridges
_CLOSE = 0.86
"""Distance of ridges over the usual one below which a note says so, across and down: in none of 320
real prints, in 77 of them that state 1.25 times their resolution. Chosen on: real prints (320
prints of eight sensors, validation/prints/any_print.py)."""
_RIDGES = 0.4
"""Fraction of a picture's strong tiles with ridges from which on they lie as its resolution has
them; else they are sought at other scales."""


def resolution_doubt(item: PrintFile) -> Finding | None:
    """A doubt where a print's resolution cannot be right: its ridges would lie farther apart, or
    closer, than in people; a note where they would be close for people, across and down.

    None of 320 real prints is doubted, at half or twice their resolution 299 and 301 are
    (validation/prints/any_print.py).
    """
    ppi = item.resolution_ppi or PPI
    scale = 380.0 / ppi  # usual ridges lie 7 pixels apart
    period = closest = None
    if min(item.image.shape) * scale >= 3 * _TILE_PX:
        small = cv2.resize(item.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        purity, periods, strong, across = _waves(small, _TILE_PX // 2)
        ridges = purity > _TILE_PURITY
        # 25 mm2 of ridges at least
        if ridges.sum() >= max(_RIDGES * strong.sum(), 25.0 / (_TILE_PX // 2 * 25.4 / 380.0) ** 2):
            period = float(np.median(periods[ridges])) / scale
            # a finger that is swept over a sensor is compressed one way
            ways = [periods[ridges & way] for way in (across, ~across)]
            closest = max(float(np.median(way)) for way in ways if way.size >= 5) / scale
    period = period or ridge_period_px(item.image)
    if period is None:
        return None
    period_mm = period * 25.4 / ppi
    usual = 0.9 * _USUAL_PERIODS[0] < period_mm / USUAL_PERIOD_MM < 1.1 * _USUAL_PERIODS[1]
    if usual and (closest is None or closest * 25.4 / ppi >= _CLOSE * USUAL_PERIOD_MM):
        return None
    return Finding(
        "odd-resolution",
        f"at {ppi:.0f} ppi its ridges are {period_mm:.2f} mm apart, which is unusual: check the"
        f" resolution, {_usual_ppi(period)} would fit.",
        Severity.NOTE if usual else Severity.DOUBT,
    )


def pressed_print(item: PrintFile, pressed: PressedRidges | None = None) -> Print:
    """Print of 500 ppi from a file, where its ridges are, and the same with even contrast.

    `pressed`: its ridges, where they were found before. Raises BadInput if it has no ridges, those
    of several fingers, or is smaller than 2 mm.
    """
    image = print_at_500_ppi(item).image
    require(min(image.shape) >= 40, "the print must be at least 2 mm wide and high.")
    pressed = pressed or pressed_ridges(image)
    require(pressed.inside.any(), "the print has no ridges; check focus and light of the capture.")
    require(not pressed.several, SEVERAL)
    require(not pressed.lacks, f"the picture shows {pressed.lacks}; name a print.")
    ppi = item.resolution_ppi or PPI
    mirrored = np.diag([-1.0, 1.0, 1.0])  # prints are, camera images not
    mirrored[0, 2] = item.image.shape[1] - 1.0
    paper = replace(plane_map(25.4 / ppi, mirrored, item.image.shape, PPI), surface="paper")
    return contact_print(image, pressed, paper)


def contact_print(image: GreyArray, pressed: PressedRidges, print_map: PrintMap) -> Print:
    """Print of what shows light (H, W), where it has ridges."""
    light = (255.0 - image).astype(np.float32)
    weight = pressed.inside.astype(np.float32)
    return Print(
        image,
        weight,
        print_map,
        light,
        in_mm=False,
        even=pressed.image,
        confidence=pressed.confidence,
    )


_FINE_PPI = 1000.0
"""Above, the level of ridges is sought in a copy of 500 ppi. Chosen on: speed."""
_DARK = 0.15
"""Mean level beside a print, at its rim and at the picture's edge over that of its middle, from
which on its ridges are dark; 280 real prints have -0.1 to 0.9, in contrasts of the ridges. Chosen
on: real prints (280 prints of seven sensors, validation/prints/any_print.py)."""
_WHITE = -0.5
"""The same level up to which ridges are surely white; wet prints on a dark ground come near -0.2,
in contrasts of the ridges. Chosen on: real prints (280 prints of seven sensors,
validation/prints/any_print.py)."""


def _dark_ridges(item: PrintFile) -> PrintFile:
    """The print with its ridges dark, turned where they are white, by what lies beside it and at
    its rim.

    Where a finger does not touch, a picture looks as its valleys do; its rim fades out towards
    that.
    """
    ppi = item.resolution_ppi or PPI
    image = item.image
    if ppi > _FINE_PPI:  # work grows with the pixels
        image = at_500_ppi(image, ppi)
        ppi = PPI
    side = max(2, round(8 * ppi / PPI))
    if min(image.shape) < 8 * side:
        return _noted(item, UNKNOWN_POLARITY)
    grey = image.astype(np.float32)
    mean, square, framed = (
        bin_mean(part, side) for part in (grey, grey * grey, frame(image).astype(np.float32))
    )
    usable = framed == 0
    deviation = np.sqrt(np.maximum(square - mean * mean, 0)) * usable
    strong = deviation > max(_BLANK_LEVEL, 0.35 * usual_contrast(deviation))
    whole = closed_opened(strong, 5, 2, 6)
    if not whole.any():
        return item
    whole = fill_holes(largest_component(whole))

    middle = ~dilate(~whole, 4)
    rim = whole & dilate(~whole, 1) & usable
    outside = ~dilate(whole, 1)
    beside = outside & usable & dilate(whole, 4)
    edge = outside.copy()
    edge[1:-1, 1:-1] = False
    regions = [region for region in (beside, rim, edge) if int(region.sum()) > 8]
    if not regions or int(middle.sum()) <= 8:
        return _noted(item, UNKNOWN_POLARITY)
    contrast = 2.6 * float(np.median(deviation[middle])) + 1e-6
    level = float(np.median(mean[middle]))
    levels = [(float(np.median(mean[region])) - level) / contrast for region in regions]
    if len(regions) == 3 and np.mean(levels) < _WHITE and max(levels) < 0:
        return _noted(replace(item, image=255 - item.image), WHITE_RIDGES)
    return item if np.mean(levels) > _DARK else _noted(item, UNKNOWN_POLARITY)


_CLEAR_SCORE = 0.2
"""Score of a picture's ridges from which their distance is measured; 280 real prints have 0.25 or
more. Chosen on: real prints (280 prints of seven sensors, validation/prints/any_print.py)."""


def ridge_period_px(image: GreyArray) -> float | None:
    """Distance of the ridges of a print (H, W) of unknown resolution, in pixels; None where none
    stand out.

    The picture is sought for waves at one size after the other, a factor of the square root of 2
    apart.
    """
    best = 0.0
    period = None
    for k in range(-1, 9):
        scale = 2.0 ** (-k / 2)
        side = min(image.shape) * min(scale, 1)
        if side < 1.5 * _TILE_PX or (k < 0 and image.size > 4_000_000):
            continue
        kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=kind)
        tiles_apart = 0.25 if side < 3 * _TILE_PX else 0.5 if small.size < 1_000_000 else 2
        purity, periods, strong, _ = _waves(small, round(tiles_apart * _TILE_PX))
        count = max(int(strong.sum()) // 8, 12)
        if purity.size < count:
            continue
        score = float(np.sort(purity, axis=None)[-count:].mean())
        score *= (float((purity > _TILE_PURITY).sum()) / max(int(strong.sum()), 1)) ** 0.25
        if score > max(best, _CLEAR_SCORE):
            best = score
            period = float(np.median(periods[purity >= 0.7 * score])) / scale
    return period


def finger_view(minutiae: Minutiae, quality: float, finger: object, impression: str) -> FingerView:
    """Minutiae of 500 ppi as a record has them; a finger that records have no code for is
    ``unknown``."""
    return FingerView(
        minutiae.x_px,
        minutiae.y_px,
        minutiae.direction_rad,
        minutiae.type,
        minutiae.quality,
        minutiae.size,
        finger_quality=round(quality),
        finger=coded_finger(finger),
        impression=impression,
    )


def coded_finger(finger: object) -> str:
    """A finger's name, or ``unknown`` where records have no code for it."""
    return finger if isinstance(finger, str) and finger in FINGER_CODES else "unknown"


def minutiae_of(view: FingerView) -> Minutiae:
    """Minutiae of a record, on the pixel grid of 500 ppi.

    Raises BadInput if its image is larger than any print.
    """
    usual = RESOLUTION_500_PPI[0]
    right, down = (1.0 if ppcm == usual else PPI / (ppcm * 2.54) for ppcm in view.resolution_ppcm)
    rows = max(1, round(view.size[0] * down))
    columns = max(1, round(view.size[1] * right))
    x = np.clip(np.rint(view.x_px * right), 0, columns - 1).astype(np.int32)
    y = np.clip(np.rint(view.y_px * down), 0, rows - 1).astype(np.int32)
    return Minutiae(x, y, view.direction_rad, view.type, view.quality, (rows, columns))
