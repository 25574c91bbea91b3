"""Fingerphotos: one photograph of a finger, by a telephone or any camera, as a source of prints.

The finger is segmented by its colour, turned tip up and given a scale and a mean shape: an elliptic cross-section as
wide as the outline. Its print is then made as that of a capture's photograph is, on the plane or unrolled. The camera
is taken to look straight at the pad from afar; nothing is known of the relief.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from splitknit.errors import BadInput, naming, require
from splitknit.finger.mask import check_borders
from splitknit.finger.orientation import Upright, find_upright
from splitknit.finger.phalange import find_crease, phalange_mask
from splitknit.finger.regions import fill_holes, largest_component, reduce_image, remove_spurs
from splitknit.finger.ridge_period import PEOPLE
from splitknit.imaging.geometry import bounding_box
from splitknit.io.photos import SUFFIXES, read_photo
from splitknit.io.prints import is_coloured
from splitknit.matching.minutiae_record import PPI
from splitknit.model import BoolArray, FloatArray
from splitknit.plausible import FINGER_WIDTH
from splitknit.prints.from_file import USUAL_PERIOD_MM
from splitknit.prints.make import enhance, make_print
from splitknit.prints.sources import Source

PRINTS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"})
"""Suffixes of pictures that may be prints."""
USUAL_WIDTH_MM = 17.0
_PEOPLE_WIDTH = 0.12
"""Of fingers other than thumbs, and its relative standard deviation; most adults' are 14 to 20 mm wide (T. M. Greiner,
"Hand anthropometry of U.S. Army personnel", 1991)."""
_THICKNESS = 0.8
"""Depth over breadth of a fingertip."""
_LENGTH = 1.5
"""From the tip, in widths, that is kept: about to the first crease."""
_SEGMENTED_SIDE, _NARROWEST, _WIDEST = 480, 130, 700
"""Longer side of the picture that is segmented; widths of the finger: at least, and in the picture that is kept."""
_REDDER, _ROUNDS = 0.05, 4
"""By which skin's (Cr - Cb) / Y, the same in light and shade, lies above the background's at least; of GrabCut."""


def is_fingerphoto(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a picture in colour, or of a kind that prints never are; damaged ones are refused elsewhere."""
    suffix = Path(path).suffix.lower()
    if suffix not in PRINTS:
        return suffix in SUFFIXES and Path(path).is_file()
    try:
        return is_coloured(read_photo(path).pixels)
    except BadInput:
        return False


def read_fingerphoto(path: str | os.PathLike[str], px_per_mm: float | None = None) -> Source:
    """Read a photograph of one finger, any picture of :func:`splitknit.io.photos.read_photo` in colour.

    `px_per_mm`: its scale on the finger; None: by the finger's width and its ridges, known to some 8 %. Raises BadInput
    as :func:`source_of_photo`, naming the file. Returns what :func:`splitknit.prints.make.make_print` prints with the
    method ``photo``; its `scale` says what was taken for what.

    >>> from splitknit.prints.make import make_print
    >>> make_print(read_fingerphoto("thumb.jpg"), "photo", "free").image.shape  # doctest: +SKIP
    (492, 431)
    """
    photo = read_photo(path)
    found = naming(path, lambda: source_of_photo(photo.pixels, px_per_mm))
    return replace(found, hashes={Path(path).name: photo.sha256})


def source_of_photo(pixels: NDArray[np.uint8] | NDArray[np.uint16], px_per_mm: float | None = None) -> Source:
    """Find the finger in a photograph (H, W, 3); parameters as of :func:`read_fingerphoto`.

    Raises BadInput if it is not in colour, nothing in it is redder than the rest and lies like a finger, or the finger
    touches three borders, is too small, shows no ridges, or has an impossible width by the given scale. Source: C.
    Rother, V. Kolmogorov and A. Blake, "GrabCut", ACM Transactions on Graphics 23, 2004 (segmentation); C. Stein, C.
    Nickel and C. Busch, "Fingerphoto recognition with smartphone cameras", BIOSIG 2012 (the chain of steps).
    """
    require(is_coloured(pixels), "a photograph of a finger has to be in colour, of 8 or 16 bits.")
    require(px_per_mm is None or px_per_mm > 0, f"`px_per_mm` must be positive, but it is {px_per_mm}.")
    mask = finger_mask_of_photo(pixels)
    width = find_upright(mask).width_px
    require(
        width >= _NARROWEST, f"the finger is {width:.0f} pixels wide, too few for ridges; photograph it from nearer."
    )
    reduction = min(1.0, _WIDEST / width)
    box = bounding_box(mask, round(0.1 * width))
    light = reduce_image(np.ascontiguousarray(pixels[(*box, 1)], dtype=np.float32), reduction)
    inside = reduce_image(mask[box].astype(np.float32), reduction) > 0.5
    upright = find_upright(inside)
    inside &= _upright_places(inside.shape, upright)[1] < upright.tip_row + _LENGTH * upright.width_px
    shape, scale = _mean_shape(inside, upright), upright.width_px / USUAL_WIDTH_MM
    found = Source(
        "photo", inside, 1.0 / scale, upright.input_from_upright, upright.size, shape_mm=shape / np.float32(scale),
        photo=light,
    )  # fmt: skip
    if px_per_mm is None:
        scale, note = _usual_scale(found, upright.width_px)
    else:
        scale = px_per_mm * reduction
        note = f"by the given scale it is {upright.width_px / scale:.1f} mm wide."
        note = " ".join([note, *FINGER_WIDTH.notes(upright.width_px / scale, "check the scale")])
    note += "" if upright.clear else " Which way its tip points is not clear; turn the photograph upright."
    return replace(
        found, mask=phalange_mask(inside, find_crease(light, inside, upright, scale), upright), pitch_mm=1.0 / scale,
        shape_mm=shape / np.float32(scale), scale=f"taken for a photograph of a finger; {note}",
    )  # fmt: skip


def finger_mask_of_photo(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> BoolArray:
    """Mask (H, W) of the finger in a photograph (H, W, 3) before a background that is less red; raises BadInput where
    there is none.

    Otsu's threshold on Cr - Cb, which neither brightness nor tone of skin decides alone, starts GrabCut.
    """
    require(min(pixels.shape[:2]) >= _NARROWEST, "the photograph is too small to show the ridges of a finger.")
    factor = min(1.0, _SEGMENTED_SIDE / max(pixels.shape[:2]))
    small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    picture = np.asarray(small if pixels.dtype == np.uint8 else small // 257, dtype=np.uint8)
    chroma = cv2.cvtColor(picture, cv2.COLOR_RGB2YCrCb).astype(np.float32)
    red = np.clip(chroma[..., 1] - chroma[..., 2] + 128.0, 0, 255).astype(np.uint8)
    level, _ = cv2.threshold(cv2.GaussianBlur(red, (0, 0), 2.0), 0, 255, cv2.THRESH_OTSU)
    seed = largest_component(red > level)
    parts = [chroma[part].mean(axis=0) for part in (seed, ~seed) if bool(part.any())]
    redness = [float(cr - cb) / max(float(y), 1.0) for y, cr, cb in parts]
    require(
        len(redness) == 2 and redness[0] - redness[1] >= _REDDER,
        "no finger was found in this picture in colour: nothing is redder than the rest; photograph one finger, its "
        "pad to the camera, before a background that is not of skin's colour, or save a print in grey.",
    )
    marks = np.where(seed, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    whole = 0, 0, picture.shape[1], picture.shape[0]  # not used where a mask is given
    cv2.grabCut(picture, marks, whole, *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    found = (marks == cv2.GC_FGD) | (marks == cv2.GC_PR_FGD)
    found = remove_spurs(fill_holes(largest_component(found)), 0.4)
    require(bool(found.any()), "no finger was found in the photograph; move it closer, before a plain background.")
    check_borders(found)
    large = cv2.resize(found.astype(np.float32), pixels.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.GaussianBlur(large, (0, 0), max(0.5 / factor, 0.3)) > 0.5)


def _upright_places(shape: tuple[int, ...], upright: Upright) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(H, W) column and row in the upright frame of every pixel."""
    row, column = np.indices(shape[:2])
    to = upright.upright_from_input
    return to[0, 0] * column + to[0, 1] * row + to[0, 2], to[1, 0] * column + to[1, 1] * row + to[1, 2]


def _mean_shape(inside: BoolArray, upright: Upright) -> FloatArray:
    """(H, W) height in pixels of half an elliptic cylinder whose cross-sections are as wide as the outline."""
    across, along = _upright_places(inside.shape, upright)
    row = np.clip(np.rint(along), 0, upright.size[0] - 1).astype(np.intp)
    rows = row[inside]
    ends = [np.full(upright.size[0], start) for start in (np.inf, -np.inf)]
    np.minimum.at(ends[0], rows, across[inside])
    np.maximum.at(ends[1], rows, across[inside])
    known = np.flatnonzero(ends[0] <= ends[1])
    every = np.arange(upright.size[0])
    left, right = (
        gaussian_filter1d(np.interp(every, known, side[known]), 0.03 * upright.width_px, mode="nearest")
        for side in ends
    )
    half = np.maximum(0.5 * (right - left), 1.0)
    aside = (across - 0.5 * (left + right)[row]) / half[row]
    height = _THICKNESS * half[row] * np.sqrt(np.clip(1.0 - aside**2, 0.0, 1.0))
    return np.where(inside, height, 0.0).astype(np.float32)


def _usual_scale(source: Source, width_px: float) -> tuple[float, str]:
    """Pixels a millimetre by which width and ridges are as usual as they can be together, and how well it is known.

    `source`: at the scale by which the width alone is usual; the ridges are measured on its unrolled print.
    """
    field = enhance(make_print(source, "photo", "free"), PPI).field
    by_width = 1.0 / source.pitch_mm
    by_ridges = by_width * float(np.median(field.period_mm(PPI)[field.mask])) / USUAL_PERIOD_MM
    weight = PEOPLE**-2 / (PEOPLE**-2 + _PEOPLE_WIDTH**-2)
    scale = by_ridges**weight * by_width ** (1.0 - weight)
    note = (
        f"its scale is assumed, to about {100 * PEOPLE:.0f} %: {width_px / scale:.1f} mm wide, ridges "
        f"{USUAL_PERIOD_MM * by_ridges / scale:.2f} mm apart."
    )
    if abs(np.log(by_ridges / by_width)) > 3.0 * np.hypot(PEOPLE, _PEOPLE_WIDTH):
        note += " Both together are unusual; give the scale."
    return scale, note
