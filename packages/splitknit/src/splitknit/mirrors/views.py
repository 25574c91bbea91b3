"""Which part of one image shows the finger itself, and which parts show it in mirrors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.finger.mask import finger_outline, finger_region
from splitknit.imaging.areas import blanked, enlarged_box, filled, grown, mirror_outline
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import block_means
from splitknit.model import Array, BoolArray, FloatArray, Rig

_NO_FINGER = (
    "no finger was found beside the mirrors: check the exposure, the LEDs and the finger's place."
)
_NO_MIRROR = (
    "no mirror shows the finger: check that the rig file's mirrors are the ones in the picture, or "
    "take the shape from light (`shape` nir or white)."
)


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Masks of one finger's views in one image, on blocks of `binning` pixels a side."""

    front: BoolArray  # (h, w)
    # (h, w) by the mirrors' names; those that show no finger are left out
    mirrors: Mapping[str, BoolArray]
    binning: int


def view_binning(px_per_mm: float) -> int:
    """How many pixels a side are averaged before views are looked for."""
    return max(1, round(px_per_mm / 22.0))  # px/mm


def views_in(image: FloatArray, rig: Rig, binning: int) -> Views:
    """Find the finger itself and its mirror images.

    The front view is the finger in the image without the mirrors' nominal outlines; each mirror's
    view is the finger around that mirror's outline, without the front view. Each view is one
    connected region, so a mirror's frame, second reflections and the finger's far parts are left
    out. It is looked for on a small copy of the image, and the outlines are found in the image
    around what was seen there. Raises BadInput if there are no mirrors, none shows a finger, a view
    is cut by a mirror's edge, or there are two fingers.

    image : (h, w, C) float32, linear, in blocks of `binning` pixels a side of the camera's image
    rig : its camera, and where its mirrors nominally are
    """
    require(
        rig.mirrors, "the rig has no mirrors: name them in rig.json, or take the shape from light."
    )
    px_per_mm = rig.camera.px_per_mm / binning
    factor = max(1, int(px_per_mm / 4.0))  # px/mm
    small_size = (image.shape[0] // factor, image.shape[1] // factor)
    small = image
    if factor > 1:
        whole_blocks = image[: small_size[0] * factor, : small_size[1] * factor]
        small = block_means(whole_blocks, small_size, factor)
    rough_front, rough_views = _rough_views(small, rig, binning * factor)
    outlines = _mirror_outlines(rig, binning)
    front = _outlined(image, rough_front, "", None, outlines, px_per_mm)
    require(front is not None, _NO_FINGER)
    assert front is not None
    views = {}
    for name, rough in rough_views.items():
        view = _outlined(image, rough, name, front, outlines, px_per_mm)
        if view is not None:
            views[name] = view
            overlap_px = int((grown(front, 0.6 * px_per_mm) & view).sum())
            require(
                overlap_px < px_per_mm**2,
                f"the finger touches the edge of the {name} mirror: lay it in the middle between"
                " the mirrors.",
            )
    require(views, _NO_MIRROR)
    return Views(front, views, binning)


def _mirror_outlines(rig: Rig, binning: int) -> dict[str, Array]:
    return {mirror.name: mirror_outline(mirror, rig.camera, binning) for mirror in rig.mirrors}


def _rough_views(
    image: FloatArray, rig: Rig, binning: int
) -> tuple[BoolArray, dict[str, BoolArray]]:
    """Front view and mirrors' views, to a pixel of a small copy."""
    px_per_mm = rig.camera.px_per_mm / binning
    outlines = _mirror_outlines(rig, binning)
    shape = (image.shape[0], image.shape[1])
    beside = _allowed("", outlines, None, shape, px_per_mm)
    front = _largest_in(image, beside, px_per_mm)
    require(front is not None, _NO_FINGER)
    assert front is not None
    _refuse_second(image, front, beside, px_per_mm)
    views = {}
    for name in sorted(outlines):
        allowed = _allowed(name, outlines, front, shape, px_per_mm)
        view = _largest_in(image, allowed, px_per_mm)
        if view is not None:
            views[name] = view
    return front, views


_REACH_MM = 3.0
"""A mirror's picture is searched for this far beyond its nominal outline."""


def _outlined(  # noqa: PLR0917
    image: FloatArray,
    rough: BoolArray,
    name: str,
    front: BoolArray | None,
    outlines: Mapping[str, Array],
    px_per_mm: float,
) -> BoolArray | None:
    """A view whose outline is measured in `image` near the rough outline from a small copy; the
    front view if `front` is not given."""
    factor = image.shape[0] // rough.shape[0]
    cells = bounding_box(rough, ceil(_REACH_MM * px_per_mm / factor))
    box = enlarged_box(cells, factor, rough.shape, image.shape)
    part = image[box]
    corner = np.array([box[1].start, box[0].start])
    allowed = _allowed(
        name,
        {mirror: outline - corner for mirror, outline in outlines.items()},
        None if front is None else front[box],
        (part.shape[0], part.shape[1]),
        px_per_mm,
    )
    try:
        mask = finger_outline(blanked(part, allowed, px_per_mm), rough[cells], px_per_mm)
    except BadInput:
        return None
    return _on_image(mask & allowed, box, image.shape)


def _allowed(
    name: str,
    outlines: Mapping[str, Array],
    front: BoolArray | None,
    shape: tuple[int, int],
    px_per_mm: float,
) -> BoolArray:
    """Search region of a mirror's view: around its nominal outline, excluding the front view and
    the other mirrors; without `front`, that of the front view: outside all mirrors."""
    allowed = np.ones(shape, dtype=np.bool_)
    if front is not None:
        allowed = grown(filled(outlines[name], shape), _REACH_MM * px_per_mm)
        allowed &= ~grown(front, 0.4 * px_per_mm)
    for mirror, outline in outlines.items():
        if mirror != name:
            allowed &= ~filled(outline, shape)
    return allowed


def _largest_in(image: FloatArray, allowed: BoolArray, px_per_mm: float) -> BoolArray | None:
    """The finger in the part of the image that is `allowed`, or None."""
    if not allowed.any():
        return None
    window = bounding_box(allowed)
    inside = allowed[window]
    if min(inside.shape) < 20:
        return None
    try:
        mask = finger_region(blanked(image[window], inside, px_per_mm), px_per_mm)
    except BadInput:
        return None
    return _on_image(mask & inside, window, image.shape)


def _on_image(
    part: BoolArray, box: tuple[slice, slice], shape: tuple[int, ...]
) -> BoolArray | None:
    """A mask of a part of an image on the whole image; None if it is empty."""
    whole = np.zeros(shape[:2], dtype=np.bool_)
    whole[box] = part
    return whole if part.any() else None


def _refuse_second(
    image: FloatArray, front: BoolArray, beside: BoolArray, px_per_mm: float
) -> None:
    """Refuse another finger beside the first: about as bright, and nearly as large."""
    light = image if image.ndim == 2 else image.sum(axis=2)
    bright = light > 0.5 * float(np.median(light[front]))
    second = bright & beside & ~grown(front, 1.5 * px_per_mm)
    _, _, stats, _ = cv2.connectedComponentsWithStats(second.astype(np.uint8))
    largest = max((int(area) for area in stats[1:, cv2.CC_STAT_AREA]), default=0)
    require(
        largest < 0.25 * float(front.sum()),
        "there are two fingers in the picture, or a mirror that the rig file does not name: lay one"
        " finger there at a time, and name all mirrors.",
    )
