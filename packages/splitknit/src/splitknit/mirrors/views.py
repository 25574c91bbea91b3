"""Which part of one image shows the finger itself, and which parts show it in mirrors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.finger.mask import finger_mask
from splitknit.imaging.areas import blanked, filled, grown, mirror_outline
from splitknit.imaging.geometry import bounding_box
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
    out. Raises BadInput if there are no mirrors, none shows a finger, a view is cut by a mirror's
    edge, or there are two fingers.

    image : (h, w, C) float32, linear, in blocks of `binning` pixels a side of the camera's image
    rig : its camera, and where its mirrors nominally are
    """
    require(
        rig.mirrors, "the rig has no mirrors: name them in rig.json, or take the shape from light."
    )
    px_per_mm = rig.camera.px_per_mm / binning
    outlines = {mirror.name: mirror_outline(mirror, rig.camera, binning) for mirror in rig.mirrors}
    shape = (image.shape[0], image.shape[1])
    beside = _allowed("", outlines, None, shape, px_per_mm)
    front = _finger_in(image, beside, px_per_mm)
    if front is None:
        raise BadInput(_NO_FINGER)
    _refuse_second(image, front, beside, px_per_mm)
    views = {}
    for name in sorted(outlines):
        allowed = _allowed(name, outlines, front, shape, px_per_mm)
        view = _finger_in(image, allowed, px_per_mm)
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


_REACH_MM = 3.0
"""A mirror's picture is searched for this far beyond its nominal outline."""


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


def _finger_in(image: FloatArray, allowed: BoolArray, px_per_mm: float) -> BoolArray | None:
    """The finger in the part of the image that is `allowed`, or None."""
    if not allowed.any():
        return None
    window = bounding_box(allowed)
    inside = allowed[window]
    if min(inside.shape) < 20:
        return None
    try:
        mask = finger_mask(blanked(image[window], inside, px_per_mm), px_per_mm) & inside
    except BadInput:
        return None
    whole = np.zeros(allowed.shape, dtype=np.bool_)
    whole[window] = mask
    return whole if mask.any() else None


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
