"""Several fingers of one hand in one view, cut into a capture of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.finger.mask import finger_masks
from splitknit.imaging.areas import blanked, box_around, enlarged_box
from splitknit.imaging.band import linear_survey
from splitknit.imaging.crop import cropped
from splitknit.model import BoolArray, Capture, PixelArray

_DIGITS = ("index", "middle", "ring", "little")
_SURVEY_PX_PER_MM = 10.0
_BESIDE_MM = 4.0
"""Of background around each finger, where the view has it."""
_SHORTER_MM = 3.0
"""By which the little finger's tip lies behind that of the index finger, at least."""


def fingers_apart(capture: Capture, names: str | Sequence[str] = "auto") -> dict[str, Capture]:
    """Cut a view of several fingers of one hand, side by side, into a capture of each.

    Each finger is what stands out from the background in one piece. It gets its bounding box with 4 mm around it; what
    is nearer to another finger there is filled with the background's brightness. Images, lights and camera are
    otherwise those of the view, in the frame of the part (:func:`splitknit.imaging.crop.cropped`).

    Parameters
    ----------
    capture : Capture
        Pads to the camera, tips up (or as `tip_direction_deg` says), background between them. A `mask` may mark them.
    names : str or sequence of str
        Of the fingers from left to right in the picture; or ``right``, ``left``: index to little finger of that hand;
        or ``auto``: the hand follows from which end of the four has the shorter finger, the little one.

    Returns
    -------
    dict of Capture
        By name, such as ``right_index``, from left to right; also in `subject`, as ``finger``.

    Raises
    ------
    BadInput
        If another number of fingers stands apart, names repeat, the hand cannot be told by the fingers' tips, or the
        view's scale is unknown.
    """
    px_per_mm = capture.rig.camera.px_per_mm
    require(
        capture.rig.camera.scale_known, "fingers are told apart by their size: give the view's scale (`px_per_mm`)."
    )
    binning = max(1, int(px_per_mm / _SURVEY_PX_PER_MM))
    mean, grey = linear_survey(capture.bands["white"], capture.encoding, binning)
    given = capture.mask
    if given is not None:
        small = cv2.resize(given.astype(np.uint8), grey.shape[:0:-1], interpolation=cv2.INTER_NEAREST)
        mean = small.astype(np.float32)[..., None]
    parts = finger_masks(mean, px_per_mm / binning)
    turn = np.deg2rad(capture.tip_direction_deg or 0.0)
    places = [np.argwhere(part) @ [[-np.sin(turn), -np.cos(turn)], [np.cos(turn), -np.sin(turn)]] for part in parts]
    order = np.argsort([place[:, 0].mean() for place in places])
    tips_mm = [float(places[k][:, 1].max()) * binning / px_per_mm for k in order]
    named = _named(names, tips_mm)
    _, nearest = cv2.distanceTransformWithLabels(
        (~np.logical_or.reduce(parts)).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5
    )
    found = {}
    for name, k in zip(named, order, strict=True):
        box = box_around(parts[k], _BESIDE_MM * px_per_mm / binning)
        window = enlarged_box(box, binning, grey.shape[1:], capture.shape)
        shape = tuple(part.stop - part.start for part in window)
        near = np.isin(nearest[box], np.unique(nearest[parts[k]])).astype(np.uint8)
        inside = cv2.resize(near, shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
        own = _alone(cropped(capture, window), inside)
        found[name] = replace(own, subject={**capture.subject, "finger": name})
    return found


def _named(names: str | Sequence[str], tips_mm: Sequence[float]) -> Sequence[str]:
    """Names of the fingers, whose tips lie so far up, from left to right."""
    count = len(tips_mm)
    wanted = len(_DIGITS) if isinstance(names, str) else len(names)
    require(
        count == wanted,
        f"{count} {'finger stands' if count == 1 else 'fingers stand'} apart in the view, but {wanted} are named by "
        f"`fingers`; name those that are in view, from left to right, and spread them so that background shows between.",
    )
    if not isinstance(names, str):
        good = len({*names}) == count and all(name.isidentifier() for name in names)
        require(good, "`fingers` must be different names of letters, digits and _, from left to right.")
        return names
    hand, lower = names, tips_mm[0] - tips_mm[-1]
    if hand == "auto":
        require(
            abs(lower) >= _SHORTER_MM,
            "the hand cannot be told by the tips of the outer fingers, which lie equally far up; give `fingers` left or "
            "right.",
        )
        hand = "right" if lower < 0 else "left"
    # pads to the camera: a right hand's thumb lies to the right
    return [f"{hand}_{digit}" for digit in (_DIGITS[::-1] if hand == "right" else _DIGITS)]


def _alone(capture: Capture, inside: BoolArray) -> Capture:
    """The capture with the background's brightness outside `inside`."""
    scale = capture.rig.camera.px_per_mm

    def own(pixels: PixelArray) -> PixelArray:
        return np.stack([blanked(image, inside, scale) for image in pixels])

    bands = {}
    for name, band in capture.bands.items():
        ambient = None if band.ambient is None else own(band.ambient[None])[0]
        bands[name] = replace(band, pixels=own(band.pixels), ambient=ambient)
    return replace(capture, bands=bands, mask=None if capture.mask is None else capture.mask & inside)
