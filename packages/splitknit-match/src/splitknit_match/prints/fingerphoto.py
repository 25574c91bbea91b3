"""Fingerphotos: one photograph of a finger, by a telephone or any camera, as a print.

The finger is segmented, turned tip up and given a scale and a mean shape: an elliptic cross-section
as wide as the outline. Its print is made by unrolling each cross-section. The camera is taken to
look straight at the pad from afar; nothing is known of the relief.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.checks import check_mask
from splitknit.errors import naming, require
from splitknit.files import read_bytes
from splitknit.findings import Finding
from splitknit.finger.mask import check_borders
from splitknit.finger.orientation import Upright, find_upright
from splitknit.finger.phalange import find_crease, phalange_mask
from splitknit.finger.regions import largest_component, reduce_image
from splitknit.finger.ridge_period import PEOPLE
from splitknit.imaging.areas import disc
from splitknit.imaging.geometry import bounding_box
from splitknit.io.images import MAX_BYTES, read_header
from splitknit.io.photos import SUFFIXES, Photo, decode_photo, read_photo
from splitknit.model import BoolArray, FloatArray, GreyArray, PixelArray
from splitknit.plausible import FINGER_WIDTH
from splitknit_match.prints.enhance import node_amplitudes
from splitknit_match.prints.from_file import USUAL_PERIOD_MM, ridge_period_px
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.prints.photo_mask import finger_in_photo, fraction_of_skin
from splitknit_match.prints.pressed import PressedRidges, pressed_ridges, without_shading
from splitknit_match.prints.print_map import NOWHERE, PrintMap, plane_map, resample
from splitknit_match.prints.ridge_field import RidgeField, ridge_field
from splitknit_match.records.minutiae_record import PPI
from splitknit_match.records.pictures import is_coloured

PHOTOGRAPH = "fingerphoto"
"""Code of the finding of every photograph of a finger."""
PRINTS = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"})
"""Suffixes of pictures that may be prints."""
USUAL_WIDTH_MM = 17.0
"""Usual width of a finger: most adults' fingers other than thumbs are 14 to 20 mm wide. Source: T.
M. Greiner, "Hand anthropometry of U.S. Army personnel", 1991."""
_WIDTH_SPREAD = 0.12
"""Relative standard deviation of the width of fingers. Source: T. M. Greiner, 1991."""
SCALE_SPREAD = float(np.hypot(PEOPLE, _WIDTH_SPREAD))
"""Relative standard deviation of the distance of ridges where the width gives the scale."""
USUAL_RIDGES = (USUAL_PERIOD_MM / 25.4 * PPI, SCALE_SPREAD)
"""Distance of two ridges in pixels at 500 ppi, and its relative standard deviation. Source:
derived."""


def fingerphoto(path: str | os.PathLike[str]) -> Photo | None:
    """A file that is a picture in colour, or of a kind that prints never are; damaged ones are
    refused elsewhere."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES or not Path(path).is_file():
        return None
    try:
        data = read_bytes(path, MAX_BYTES)
        # grey pictures are prints, and need not be decoded; HEIC has another suffix than it should
        heic = data[4:8] == b"ftyp"
        if suffix in PRINTS and not heic and read_header(data, os.fspath(path)).channels == 1:
            return None
        photo = decode_photo(data, os.fspath(path))
    except BadInput:
        if suffix in PRINTS:
            return None
        raise
    return photo if suffix not in PRINTS or is_coloured(photo.pixels) else None


@dataclass(frozen=True, slots=True, eq=False)
class FingerPhoto:
    """A photograph of a finger, its skin laid flat row by row."""

    flat: GreyArray
    """(h, w) print at 500 ppi, ridges dark."""
    pressed: PressedRidges
    """Its ridges."""
    map: PrintMap
    """Where its pixels lie in the photograph, reduced where the finger is wide."""
    pitch_mm: float
    """Of that photograph."""
    findings: tuple[Finding, ...]
    """What was taken for what, how well the scale is known, and what to change."""
    quality: float
    """0 to 100."""
    hashes: Mapping[str, str] = field(default_factory=dict)


def read_fingerphoto(
    path: str | os.PathLike[str],
    px_per_mm: float | None,
    where: PhotoFinger | None = None,
    photo: Photo | None = None,
) -> FingerPhoto:
    """Read a photograph of a finger, any picture of :func:`splitknit.io.photos.read_photo` in
    colour.

    `px_per_mm`: its scale on the finger; None: by the finger's width and its ridges, known to some
    8 %; `where`: which finger; `photo`: the file, if it was read. Raises BadInput as
    :func:`finger_of_photo`, naming the file.
    """
    photo = photo or read_photo(path)
    where = where or PhotoFinger()
    finger = naming(
        path,
        lambda: finger_of_photo(
            photo.pixels, px_per_mm, where.pixels(photo.pixels.shape[:2]), where.corners()
        ),
    )
    return replace(finger, hashes={Path(path).name: photo.sha256})


_MIN_WIDTH_PX = 130  # smallest width of a finger in a photograph
_KEPT_WIDTH_PX = 700
"""Largest width of a finger in the picture that is kept; a larger picture is reduced. Chosen on:
speed."""
MIN_QUALITY = 10
"""Least quality of a photograph; without ridges in view it is 0 to 22, in %. Chosen on: simulated
fingers (drawn telephone photographs, validation/match/telephone.py)."""
_PHOTO_FAINT_WAVE = 0.003
"""Least height of a ridge's wave over the light around it: steps of 8 bits look like half as
much."""
_NEARER = 1.04
"""Scale of the pad over that of the outline, 7 mm behind it, for a camera about 18 cm away."""


def finger_of_photo(
    pixels: PixelArray,
    px_per_mm: float | None = None,
    mask: BoolArray | None = None,
    box: tuple[int, int, int, int] | None = None,
) -> FingerPhoto:
    """Find the finger in a photograph (H, W, 3) and unroll it; `px_per_mm` as of
    :func:`read_fingerphoto`.

    `mask`: (H, W) of the finger; `box`: left, top, width and height in pixels of where it lies.
    Raises BadInput if the photograph is not in colour, no part of it looks like a finger, the
    finger is too small or has an impossible width by the given scale, or its quality is below
    :data:`MIN_QUALITY`. Source of the chain of steps: C. Stein, C. Nickel and C. Busch,
    "Fingerphoto recognition with smartphone cameras", BIOSIG 2012.
    """
    require(is_coloured(pixels), "a photograph of a finger has to be in colour, of 8 or 16 bits.")
    require(
        px_per_mm is None or px_per_mm > 0, f"`px_per_mm` must be positive, but it is {px_per_mm}."
    )
    require(
        min(pixels.shape[:2]) >= _MIN_WIDTH_PX,
        "the photograph is too small to show the ridges of a finger.",
    )
    if mask is None and box is None and (skin := _flat_skin(pixels, px_per_mm)) is not None:
        return skin
    mask, direction_deg, width, note = _segmented(pixels, mask, box)
    require(
        width >= _MIN_WIDTH_PX,
        f"the finger is {width:.0f} pixels wide, too few for ridges; photograph it from nearer.",
    )
    # the finger alone, reduced, turned upright, and cut at the first crease
    reduction = min(1.0, _KEPT_WIDTH_PX / width)
    part = bounding_box(mask, round(0.1 * width))
    light = reduce_image(pixels[(*part, 1)].astype(np.float32), reduction)
    inside = reduce_image(mask[part].astype(np.float32), reduction) > 0.5
    upright = find_upright(inside, direction_deg)
    row, column = (np.arange(side, dtype=np.float32) for side in inside.shape)
    across, along, offset = upright.upright_from_input[1]
    # kept: about to the first crease
    inside &= (
        across * column + (along * row + offset)[:, None] < upright.tip_row + 1.5 * upright.width_px
    )

    # its print at the usual width, and how much of it shows ridges
    by_width = _NEARER * upright.width_px / USUAL_WIDTH_MM
    unrolled = _unrolled(inside, upright, by_width * 25.4 / PPI)
    values, weight = resample(light, inside, 1.0 / by_width, unrolled)
    image, finger_px = _even(values, weight)
    ridges = pressed_ridges(image, USUAL_RIDGES)
    field = ridge_field(
        *((ridges.image, PPI, ridges.inside) if ridges.inside.any() else (image, PPI, finger_px))
    )
    amplitude = np.abs(node_amplitudes(values, field, 0.75))
    clear = field.mask & (field.at_nodes(ridges.confidence) > 0.4)
    clear &= amplitude > _PHOTO_FAINT_WAVE * field.at_nodes(values)
    finger = field.at_nodes(weight) > 0.5
    quality = 100.0 * float((clear & finger).sum()) / max(int(finger.sum()), 1)
    brightness = light[inside] / np.iinfo(pixels.dtype).max
    change = _to_change(clear & finger, finger, field, amplitude, width_px=width, light=brightness)
    require(
        round(quality) >= MIN_QUALITY,
        f"the photograph's quality is {quality:.0f} of 100, below {MIN_QUALITY}; {change}, and"
        " photograph it again.",
    )

    # its scale
    if px_per_mm is None:
        scale, known = _usual_scale(field, clear, by_width, upright.width_px)
        odd: tuple[Finding, ...] = ()
    else:
        scale = px_per_mm * reduction
        width_mm = upright.width_px / scale
        known = f"by the given scale it is {width_mm:.1f} mm wide."
        odd = FINGER_WIDTH.notes(width_mm, "check the scale")
    findings = [Finding(PHOTOGRAPH, f"{note} {known}"), *odd]
    if not upright.clear:
        findings.append(
            Finding(
                "unsure-tip",
                "which way its tip points is not clear; turn the photograph upright.",
            )
        )
    # from 50 on nothing has to be changed
    cure = f": {change}" if quality < 50 else ""
    findings.append(Finding("fingerphoto-quality", f"quality {quality:.0f} of 100{cure}."))

    # the last phalanx at 500 ppi
    phalange = phalange_mask(inside, find_crease(light, inside, upright, scale), upright)
    visible = (
        cv2.remap(phalange.view(np.uint8), unrolled.columns, unrolled.rows, cv2.INTER_NEAREST) > 0
    )

    def scaled(values: NDArray[Any], beyond: int = 0) -> NDArray[Any]:
        factor = by_width / scale
        return cv2.resize(
            np.where(visible, values, values.dtype.type(beyond)), None, fx=factor, fy=factor
        )

    pressed = PressedRidges(
        scaled(ridges.image, 255),
        scaled(ridges.inside.view(np.uint8)) > 0,
        scaled(ridges.confidence),
    )
    size = pressed.image.shape[::-1]
    columns, rows = (
        cv2.resize(part, size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
        for part in (unrolled.columns, unrolled.rows)
    )
    print_map = replace(unrolled, columns=columns, rows=rows)
    return FingerPhoto(
        scaled(image, 255), pressed, print_map, 1.0 / scale, tuple(findings), round(quality, 1)
    )


_ALL_SKIN = 0.85
"""Fraction of a picture of skin to its edges that has its colour: crops of a real finger have 0.9.
Chosen on: real photographs (one finger)."""
_ALL_RIDGES = 70.0
"""Least quality of such a picture: crops of fingers have 74 to 100 %, pictures of other things that
were given its colour 64 at most. Chosen on: crops of one real and four path-traced fingers."""


def _flat_skin(pixels: PixelArray, px_per_mm: float | None) -> FingerPhoto | None:
    """The print of a photograph (H, W, 3) that is ridged skin to its edges; None of all others.

    `px_per_mm` as of :func:`read_fingerphoto`: by default ridges lie as far apart as is usual.
    """
    if fraction_of_skin(pixels) < _ALL_SKIN:
        return None
    reduction = min(1.0, _KEPT_WIDTH_PX / max(pixels.shape))
    light = reduce_image(pixels[..., 1].astype(np.float32), reduction)
    everywhere = np.ones(light.shape, np.bool_)
    period_px = ridge_period_px(_even(light, everywhere)[0])
    if period_px is None:
        return None
    pitch_mm = 1.0 / (px_per_mm * reduction) if px_per_mm else USUAL_PERIOD_MM / period_px
    flat = plane_map(pitch_mm, np.eye(3), light.shape)
    image, whole = _even(*resample(light, everywhere, pitch_mm, flat))
    period_mm = period_px * pitch_mm
    ridges = pressed_ridges(image, (period_mm / 25.4 * PPI, PEOPLE))
    quality = 100.0 * float((ridges.confidence[whole] > 0.4).mean())
    if ridges.lacks or quality < _ALL_RIDGES:
        return None
    known = "given" if px_per_mm else f"assumed, to about {100 * PEOPLE:.0f} %"
    words = (
        f"taken for a photograph of skin to its edges; its scale is {known}: ridges"
        f" {period_mm:.2f} mm apart."
    )
    findings = (Finding(PHOTOGRAPH, words),)
    return FingerPhoto(image, ridges, flat, pitch_mm, findings, round(quality, 1))


def _segmented(
    pixels: NDArray[Any], mask: BoolArray | None, box: tuple[int, int, int, int] | None
) -> tuple[BoolArray, float | None, float, str]:
    """Mask (H, W) of the finger, direction of its tip in degrees where it is known, width in
    pixels, and a note."""
    note = "taken for a photograph of a finger;"
    if mask is None:
        chosen = finger_in_photo(pixels, box)
        if chosen.others:
            note += f" it is the clearest of {chosen.others + 1}, choose another by `box`;"
        return chosen.mask, chosen.direction_deg, chosen.width_px, note
    mask = largest_component(check_mask(mask, pixels.shape[:2]))
    check_borders(mask)
    return mask, None, find_upright(mask).width_px, note


def _even(values: FloatArray, weight: NDArray[Any]) -> tuple[GreyArray, BoolArray]:
    """(h, w) a print of light without its shading, and where; contrast is raised alike everywhere,
    so that blocks of JPEG that lost their ridges stay flat.
    """
    whole = scipy.ndimage.binary_erosion(weight > 0.5, disc(8) > 0)
    known = whole.astype(np.float32)
    detail, _ = without_shading(np.log(np.maximum(values, 1.0)) * known, known, 9.0)
    usual = 1.48 * float(np.median(np.abs(detail[whole]))) if whole.any() else 1.0
    grey = 127.5 - 127.5 * np.clip(detail / max(2.5 * usual, 1e-6), -1.0, 1.0)
    return np.round(grey).astype(np.uint8), whole


def _to_change(
    clear: BoolArray,
    finger: BoolArray,
    field: RidgeField,
    amplitude: FloatArray,
    *,
    width_px: float,
    light: FloatArray,
) -> str:
    """The one thing to change in a photograph.

    `clear`, `finger`: (n, m) nodes of the field of its print with clear ridges, and on the finger;
    `amplitude`: (n, m) of the ridges; `width_px`: of the finger in the photograph; `light`: (N,) of
    its pixels, 0 to 1.
    """
    causes = {
        "focus on the finger": 0.3,
        "come nearer, until it is 400 pixels wide (distance)": 400.0 / width_px - 1.0,
        "use more light": 4.0 * (0.3 - float(np.median(light))),
        "turn finger or light so that nothing shines (glare)": (
            10.0 * float((light > 0.97).mean()) - 0.2
        ),
    }
    if 100 * clear.sum() >= MIN_QUALITY * finger.sum() > 0:
        offset = abs(np.nonzero(clear)[1].mean() - np.nonzero(finger)[1].mean())
        causes["turn its pad to the camera"] = (offset * field.step_px * 25.4 / PPI - 2.0) / 3.0
        height = amplitude[clear]
        turn = np.exp(2j * field.orientation_rad[clear])
        uneven = (height * turn).sum() / height.sum() - turn.mean()  # ridges along the motion stay
        causes["hold finger and camera still (shake)"] = 4.0 * float(abs(uneven)) - 0.4
    return max(causes, key=lambda cause: causes[cause])


_THICKNESS = 0.8  # depth over breadth of a fingertip


def _unrolled(inside: BoolArray, upright: Upright, step: float) -> PrintMap:
    """Where each pixel of the unrolled print lies: along the top line, then along the elliptic
    cross-section.

    `inside`: (H, W) of the finger; `step`: pixels of the photograph in one of the print.
    """
    # middle and half width of the smoothed outline in the upright frame
    rows, columns = upright.size
    turned = (
        cv2.warpAffine(inside.view(np.uint8), upright.upright_from_input[:2], (columns, rows)) > 0
    )
    known = np.flatnonzero(turned.any(axis=1))
    ends = turned[known].argmax(axis=1), columns - 1 - turned[known, ::-1].argmax(axis=1)
    lines = np.stack([np.interp(np.arange(rows), known, side) for side in ends])
    size = 2 * round(0.12 * upright.width_px) + 1, 1
    smooth = cv2.GaussianBlur(lines, size, 0.03 * upright.width_px, borderType=cv2.BORDER_REPLICATE)
    left, right = smooth[:, known[0] : known[-1] + 1]
    middle = 0.5 * (left + right)
    half = np.maximum(0.5 * (right - left), 1.0)

    along = np.concatenate([[0.0], np.cumsum(np.hypot(1.0, _THICKNESS * np.diff(half)))])
    # of an ellipse, whose point lies at sin(turn) from the middle
    turn = np.linspace(0.0, 0.5 * np.pi, 200)
    arc = scipy.special.ellipeinc(turn, 1.0 - _THICKNESS**2)
    # skin steeper than 70 deg is left out
    steepest = np.arctan(np.tan(np.radians(70.0)) / _THICKNESS)
    size = (
        int(along[-1] / step) + 1,
        2 * int(half.max() * np.interp(steepest, turn, arc) / step) + 1,
    )
    row = np.interp(np.arange(size[0]) * step, along, np.arange(len(along)))[:, None]
    centre, radius = (np.interp(row, np.arange(len(along)), part) for part in (middle, half))
    across = (size[1] // 2 - np.arange(size[1])) * step / radius  # mirrored, as paper shows it
    at = np.sign(across) * np.interp(np.abs(across), arc, turn)
    places = np.stack(np.broadcast_arrays(centre + radius * np.sin(at), row + known[0]), axis=-1)
    places = cv2.transform(places.astype(np.float32), upright.input_from_upright[:2])
    print_columns, print_rows = np.where(
        np.abs(at) < steepest, np.moveaxis(places, -1, 0), np.float32(NOWHERE)
    )
    return PrintMap(
        "arc", PPI, print_columns, print_rows, upright.input_from_upright, np.zeros((0, 0, 2))
    )


_PAD = (0.3, 1.1)
"""Range from the tip along the skin where ridges are as far apart as contact prints show them;
below they are wider apart, in widths of the finger."""


def _usual_scale(
    field: RidgeField, clear: BoolArray, by_width: float, width_px: float
) -> tuple[float, str]:
    """Pixels a millimetre by which width and ridges are as usual as they can be together, and how
    well it is known.

    Raises BadInput where both do not fit a finger. `field`: ridges of the unrolled print at the
    scale `by_width`, by which the width alone is usual; `clear`: (n, m) where they count.
    """
    back = (np.arange(len(clear)) + 0.5) * field.step_px * (25.4 / PPI / USUAL_WIDTH_MM)
    on_pad = clear & ((back > _PAD[0]) & (back < _PAD[1]))[:, None]
    periods = field.period_mm(PPI)[on_pad if on_pad.any() else clear]
    by_ridges = by_width * float(np.median(periods)) / USUAL_PERIOD_MM
    require(
        abs(np.log(by_ridges / by_width)) < 3.0 * SCALE_SPREAD,
        "what was found is not a finger, or its scale is wrong: its lines are too far apart or"
        " close for its width; mark the finger by `box` or `mask`, or give the scale of the"
        " photograph.",
    )
    weight = PEOPLE**-2 / (PEOPLE**-2 + _WIDTH_SPREAD**-2)
    scale = by_ridges**weight * by_width ** (1.0 - weight)
    note = (
        f"its scale is assumed, to about {100 * PEOPLE:.0f} %: {_NEARER * width_px / scale:.1f} mm"
        f" wide, ridges on its pad {USUAL_PERIOD_MM * by_ridges / scale:.2f} mm apart."
    )
    return scale, note
