"""Prints and minutiae from files: at which resolution they are, and brought to 500 pixels per inch."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.iso19794 import read_iso19794
from splitknit.io.minutiae_record import FINGER_CODES, FingerView, pixels_per_cm
from splitknit.io.print_formats import read_prints
from splitknit.io.prints import PrintFile, read_print_png
from splitknit.matching.minutiae import at_500_ppi
from splitknit.matching.minutiae_record import PPI, Minutiae, no_minutiae
from splitknit.model import BoolArray
from splitknit.prints.make import Print, enhance, minutiae_by_phase
from splitknit.prints.pressed import pressed_ridges
from splitknit.prints.print_map import plane_map

USUAL_PERIOD_MM = 0.46
"""Between ridges of adults' fingers; people differ by 8 %."""
MIN_PPI, MAX_PPI = 200.0, 5080.0
"""Below there are no ridges (telephones and browsers state 72 and 96, of screens); no scanner is above."""
_USUAL_PPI, _SNAP = (500, 1000), 0.2
_LARGEST_SPECTRUM = 1024
_PERIODS_PX = 2.2, 64.0
_MIN_SIDE_PX = 40
_CLEAR = 15.0
"""Of the ridges' peak over the spectrum's median, red noise taken out: prints have 30 to 100."""


def read_print_file(path: str | os.PathLike[str], input_ppi: float | None = None) -> tuple[PrintFile | FingerView, ...]:
    """Read the prints of a file, of known resolution, or its minutiae.

    `path`: of any format of :data:`splitknit.io.print_formats.FORMATS`; `input_ppi`: resolution of pictures, whatever
    they state. Raises BadInput as :func:`splitknit.io.print_formats.read_prints`; if a picture does not state its
    resolution, with the one that its ridges suggest; or if it is below 200 or above 5080 ppi.
    """
    require(
        input_ppi is None or MIN_PPI <= input_ppi <= MAX_PPI,
        f"`input_ppi` must be a number from {MIN_PPI:g} to {MAX_PPI:g}, but it is {input_ppi}.",
    )
    found = read_prints(path)
    return tuple(_resolved(one, os.fspath(path), input_ppi) if isinstance(one, PrintFile) else one for one in found)


def read_one_finger(path: Path, input_ppi: float | None = None) -> PrintFile | FingerView:
    """Read the only print, or the minutiae of the only finger, of a file.

    Raises BadInput as :func:`read_print_file`, or if the file holds several.
    """
    found = read_print_file(path, input_ppi)
    require(len(found) == 1, f"{path} holds {len(found)} prints; take them apart: splitknit import {path} --out DIR.")
    return found[0]


def read_print_folder(folder: Path) -> tuple[PrintFile, FingerView | None]:
    """Read what ``splitknit print`` wrote: the print, and its minutiae if they were found.

    Raises BadInput if a file is damaged, or the print states no resolution.
    """
    picture, record = read_print_png(folder / "print.png"), folder / "minutiae.iso"
    require(picture.resolution_ppi is not None, f"'{folder}' states no resolution; make the print again.")
    return picture, read_iso19794(record).views[0] if record.is_file() else None


def print_at_500_ppi(item: PrintFile) -> PrintFile:
    """Bring a print of known resolution to 500 ppi; one that has as many pixels as at 500 ppi stays as it is.

    Raises BadInput if it were larger than any print.
    """
    ppi = item.resolution_ppi or PPI
    image = at_500_ppi(item.image, ppi)
    return item if image.shape == item.image.shape else dataclasses.replace(item, image=image, resolution_ppi=PPI)


def _resolved(item: PrintFile, name: str, input_ppi: float | None) -> PrintFile:
    stated = item.resolution_ppi
    if input_ppi is None and (stated is None or stated < MIN_PPI):
        said = "does not state its resolution" if stated is None else f"states {stated:.0f} ppi, too few for ridges"
        raise BadInput(f"{name} {said}; {_suggestion(item.image)}.")
    ppi = input_ppi or stated or 0.0
    require(
        ppi <= MAX_PPI, f"{name} states {ppi:.0f} ppi, more than {MAX_PPI:g}; give the true value: `input_ppi` 500."
    )
    return dataclasses.replace(item, resolution_ppi=float(ppi))


def _suggestion(image: NDArray[np.uint8]) -> str:
    period = _ridge_period_px(image)
    if period is None:
        return "it shows no ridges to measure it by: give it in pixels per inch, such as `input_ppi` 500"
    ppi = period * 25.4 / USUAL_PERIOD_MM
    near = next((usual for usual in _USUAL_PPI if abs(ppi / usual - 1) <= _SNAP), 50 * max(1, round(ppi / 50)))
    return (
        f"its ridges lie {period:.1f} pixels apart, which suggests about {near} pixels per inch: give the true value, "
        f"such as `input_ppi` {near}"
    )


def pressed_print(item: PrintFile, inside: BoolArray | None = None) -> Print:
    """Print of 500 ppi from a file, where its ridges are, and the same with even contrast.

    `inside`: (H, W) bool at 500 ppi, where there may be ridges; by default everywhere. Raises BadInput if it has no
    ridges, or is smaller than 2 mm.
    """
    image = print_at_500_ppi(item).image
    require(min(image.shape) >= _MIN_SIDE_PX, "the print must be at least 2 mm wide and high.")
    pressed = pressed_ridges(image)
    ridges = pressed.inside if inside is None else pressed.inside & inside
    require(bool(ridges.any()), "the print has no ridges; check focus and light of the capture.")
    ppi = item.resolution_ppi or PPI
    rows, columns = item.image.shape
    mirrored = np.array([[-1.0, 0.0, columns - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # prints are, camera images not
    there = dataclasses.replace(plane_map(25.4 / ppi, mirrored, (rows, columns), PPI), surface="paper")
    light = (np.float32(255.0) - image).astype(np.float32)
    weight = ridges.astype(np.float32)
    return Print(image, weight, there, light, in_mm=False, even=pressed.image, confidence=pressed.confidence)


def _ridge_period_px(image: NDArray[np.uint8]) -> float | None:
    """Distance of the ridges of a print (H, W) of unknown resolution, in pixels; None where none stand out.

    The peak of the spectrum's mean over all directions, times the frequency to the power 2.5, which makes up for what
    pictures without ridges lose towards high frequencies.
    """
    if min(image.shape) < 64:
        return None
    shrink = min(1.0, _LARGEST_SPECTRUM / max(image.shape))
    grey = image.astype(np.float32)
    if shrink < 1.0:
        grey = np.asarray(cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.float32)
    window = np.outer(np.hanning(grey.shape[0]), np.hanning(grey.shape[1])).astype(np.float32)
    side = _LARGEST_SPECTRUM
    power = np.abs(np.fft.rfft2((grey - grey.mean()) * window, (side, side))) ** 2
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    edges = np.exp(np.arange(-np.log(_PERIODS_PX[1]), -np.log(_PERIODS_PX[0]), 0.04))
    place = np.digitize(frequency.ravel(), edges)
    total, count = (np.bincount(place, weights, len(edges) + 1)[1:-1] for weights in (power.ravel(), None))
    middle = np.sqrt(edges[1:] * edges[:-1])
    energy = np.convolve(total / np.maximum(count, 1) * middle**2.5, np.full(5, 0.2), "same")
    best = int(np.argmax(energy))
    clear = energy[best] > _CLEAR * float(np.median(energy)) and 2 < best < len(middle) - 3
    return float(1.0 / (middle[best] * shrink)) if clear else None


def finger_view(found: Minutiae, quality: int, finger: object = "unknown", impression: str = "unknown") -> FingerView:
    """Minutiae of 500 ppi as a record has them; a finger that records have no code for is ``unknown``."""
    return FingerView(
        x_px=found.x_px,
        y_px=found.y_px,
        direction_rad=found.direction_rad,
        type=found.type,
        quality=found.quality,
        size=found.size,
        finger_quality=quality,
        finger=coded_finger(finger),
        impression=impression,
        resolution_ppcm=pixels_per_cm(PPI),
    )


def print_minutiae(image: NDArray[np.uint8]) -> Minutiae:
    """Minutiae of a print (H, W) of 500 ppi, as ``splitknit print`` and ``export`` find them; none without ridges."""
    try:
        made = pressed_print(PrintFile(image, PPI, {}))
        return minutiae_by_phase(made, enhance(made, PPI), PPI)
    except BadInput:
        return no_minutiae((image.shape[0], image.shape[1]))


def coded_finger(finger: object) -> str:
    """A finger's name, or ``unknown`` where records have no code for it."""
    return finger if isinstance(finger, str) and finger in FINGER_CODES else "unknown"


def minutiae_of(view: FingerView) -> Minutiae:
    """Minutiae of a record, on the pixel grid of 500 ppi; qualities that are not known become 0.

    Raises BadInput if its image is larger than any print.
    """
    usual = pixels_per_cm(PPI)[0]
    scales = [1.0 if ppcm == usual else PPI / (ppcm * 2.54) for ppcm in view.resolution_ppcm]
    size = max(1, round(view.size[0] * scales[1])), max(1, round(view.size[1] * scales[0]))
    x, y = (
        np.clip(np.rint(np.asarray(pixels) * scale), 0, side - 1).astype(np.int32)
        for pixels, scale, side in zip((view.x_px, view.y_px), scales, size[::-1], strict=True)
    )
    quality = np.where(np.asarray(view.quality) <= 100, view.quality, 0).astype(np.uint8)
    kind = np.asarray(view.type, dtype=np.uint8)
    return Minutiae(x, y, np.asarray(view.direction_rad, dtype=np.float64), kind, quality, size)
