"""Which part of one image shows the finger itself, and which parts show it in mirrors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.finger.mask import finger_outline, finger_region
from splitknit.imaging.areas import blanked, box_around, enlarged_box, filled, grown, mirror_outline
from splitknit.imaging.band import block_means
from splitknit.model import Array, BoolArray, FloatArray, Rig

_PX_PER_MM = 22.0  # scale of the copy on which the outlines are found
_REACH_MM = 3.0  # a mirror's picture is looked for this far beyond its nominal outline

_NO_FINGER = "no finger was found beside the mirrors: check the exposure, the LEDs and the finger's place."
SEARCH_PX_PER_MM = 4.0  # views are looked for on a copy of about this scale where their outlines are found apart


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Masks of one finger's views in one image, on blocks of `binning` pixels a side."""

    front: BoolArray  # (h, w)
    mirrors: Mapping[str, BoolArray]  # (h, w) by the mirrors' names; those that show no finger are left out
    binning: int


def view_binning(px_per_mm: float) -> int:
    """How many pixels a side are averaged before views are looked for."""
    return max(1, round(px_per_mm / _PX_PER_MM))


def views_in(image: FloatArray, rig: Rig, binning: int) -> Views:
    """Find the finger itself and its mirror images.

    The front view is the finger in the image without the mirrors' nominal outlines; each mirror's view is the finger
    around that mirror's outline, without the front view. A mirror's frame, second reflections and the finger's far
    parts are left out because one piece of skin is wanted from each. It is looked for on a small copy of the image, and
    the outlines are found in the image around what was seen there. Raises BadInput if there are no
    mirrors, none shows a finger, a view is cut by a mirror's edge, or there are two fingers.

    image : (h, w, C) float32, linear, in blocks of `binning` pixels a side of the camera's image
    rig : its camera, and where its mirrors nominally are
    """
    require(rig.mirrors, "the rig has no mirrors: name them in rig.json, or take the shape from light.")
    factor = max(1, int(rig.camera.px_per_mm / binning / SEARCH_PX_PER_MM))
    size = (image.shape[0] // factor, image.shape[1] // factor)
    small = block_means(image[: size[0] * factor, : size[1] * factor], size, factor) if factor > 1 else image
    views = _outlined(image, rig, _rough_views(small, rig, binning * factor), factor)
    for name, view in views.mirrors.items():
        px_per_mm = rig.camera.px_per_mm / views.binning
        good = int((grown(views.front, 0.6 * px_per_mm) & view).sum()) < (1.0 * px_per_mm) ** 2
        require(good, f"the finger touches the edge of the {name} mirror: lay it in the middle between the mirrors.")
    return views


def _rough_views(image: FloatArray, rig: Rig, binning: int) -> Views:
    """Views, to a pixel of a small copy."""
    px_per_mm = rig.camera.px_per_mm / binning
    outlines = {mirror.name: mirror_outline(mirror, rig.camera, binning) for mirror in rig.mirrors}
    in_any = _in_any(outlines, (image.shape[0], image.shape[1]))
    front = _largest_in(image, ~in_any, px_per_mm)
    if front is None:
        raise BadInput(_NO_FINGER)
    _refuse_second(image, front, in_any, px_per_mm)

    seen = {
        name: _largest_in(image, _allowed(name, outlines, front, px_per_mm), px_per_mm) for name in sorted(outlines)
    }
    return _with_views(front, seen, binning)


def _outlined(image: FloatArray, rig: Rig, rough: Views, factor: int) -> Views:
    """Views whose outlines are found in `image`, around the rough ones."""
    binning = rough.binning // factor
    px_per_mm = rig.camera.px_per_mm / binning
    outlines = {mirror.name: mirror_outline(mirror, rig.camera, binning) for mirror in rig.mirrors}

    def found(mask: BoolArray, name: str, front: BoolArray | None) -> BoolArray | None:
        cells = box_around(mask, max(3.0, _REACH_MM) * px_per_mm / factor)
        box = enlarged_box(cells, factor, mask.shape, image.shape)
        corner = np.array([box[1].start, box[0].start])
        inside = {other: outline - corner for other, outline in outlines.items()}
        shape = (box[0].stop - box[0].start, box[1].stop - box[1].start)
        allowed = ~_in_any(inside, shape) if front is None else _allowed(name, inside, front[box], px_per_mm)
        try:
            part = finger_outline(blanked(image[box], allowed, px_per_mm), mask[cells], px_per_mm) & allowed
        except BadInput:
            return None
        whole = np.zeros(image.shape[:2], dtype=np.bool_)
        whole[box] = part
        return whole if part.any() else None

    front = found(rough.front, "", None)
    if front is None:
        raise BadInput(_NO_FINGER)
    seen = {name: found(mask, name, front) for name, mask in rough.mirrors.items()}
    return _with_views(front, seen, binning)


def _with_views(front: BoolArray, seen: Mapping[str, BoolArray | None], binning: int) -> Views:
    """Front view and what mirrors show."""
    found = {name: view for name, view in seen.items() if view is not None}
    fault = "no mirror shows the finger: check that the rig file's mirrors are the ones in the picture,"
    require(found, f"{fault} or take the shape from light (`shape` nir or white).")
    return Views(front, found, binning)


def _in_any(outlines: Mapping[str, Array], shape: tuple[int, int]) -> BoolArray:
    """Which pixels lie in one of the mirrors' nominal outlines."""
    return np.asarray(np.logical_or.reduce([filled(outline, shape) for outline in outlines.values()]))


def _allowed(name: str, outlines: Mapping[str, Array], front: BoolArray, px_per_mm: float) -> BoolArray:
    """Where a mirror's picture may be: around its nominal outline, beside the front view and the other mirrors."""
    shape = (front.shape[0], front.shape[1])
    allowed = grown(filled(outlines[name], shape), _REACH_MM * px_per_mm) & ~grown(front, 0.4 * px_per_mm)
    for other, outline in outlines.items():
        if other != name:
            allowed &= ~filled(outline, shape)
    return allowed


def _largest_in(image: FloatArray, allowed: BoolArray, px_per_mm: float) -> BoolArray | None:
    """The finger in the part of the image that is `allowed`, or None."""
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    if rows.size < 20 or columns.size < 20:
        return None
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    inside = allowed[window]
    part = blanked(image[window], inside, px_per_mm)
    try:
        mask = finger_region(part, px_per_mm) & inside
    except BadInput:
        return None
    whole = np.zeros(allowed.shape, dtype=np.bool_)
    whole[window] = mask
    return whole if mask.any() else None


def _refuse_second(image: FloatArray, front: BoolArray, in_any: BoolArray, px_per_mm: float) -> None:
    """Refuse another finger beside the first: about as bright, and nearly as large."""
    light = image if image.ndim == 2 else image.sum(axis=2)
    other = (light > 0.5 * float(np.median(light[front]))) & ~in_any & ~grown(front, 1.5 * px_per_mm)
    _, _, stats, _ = cv2.connectedComponentsWithStats(other.astype(np.uint8))
    largest = max((int(area) for area in stats[1:, cv2.CC_STAT_AREA]), default=0)
    fault = "there are two fingers in the picture, or a mirror that the rig file does not name"
    require(largest < 0.25 * float(front.sum()), f"{fault}: lay one finger there at a time, and name all mirrors.")
