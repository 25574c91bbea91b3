"""Several fingers of one hand in one view, cut into a capture of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import Any

import cv2
import numpy as np

from splitknit.capture import Band, Capture
from splitknit.errors import require
from splitknit.finger.mask import finger_masks
from splitknit.imaging.areas import blanked, enlarged_box
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, PixelArray
from splitknit.observation.crop import cropped
from splitknit.observation.observe import observe
from splitknit.plausible import VIEW

_DIGITS = ("index", "middle", "ring", "little")


def fingers_apart(
    capture: Capture, names: str | Sequence[str] = "auto", *, keep: bool = False
) -> dict[str, Capture]:
    """Cut a view of several fingers of one hand, side by side, into a capture of each, by name,
    from left to right.

    Each finger is what stands out from the background in one piece. It gets its bounding box with 4
    mm around it; what is nearer to another finger there is filled with the background's brightness.
    Images, lights and camera are otherwise those of the view, in the frame of the part
    (:func:`splitknit.observation.crop.cropped`). Raises BadInput if another number of fingers
    stands apart, the tips do not show which hand it is, or the scale is unknown; without `keep`
    also if the tips are those of the other hand. `capture`: pads to the camera, tips up (or as
    `tip_direction_deg` says), background between them. `names`: of the fingers from left to right
    in the picture; or ``right``, ``left``: index to little finger of that hand; or ``auto``: the
    hand follows from which end of the four has the shorter finger, the little one.
    """
    scale = capture.rig.camera.px_per_mm
    require(
        capture.rig.camera.scale_known,
        "fingers are told apart by their size: give the scale, `px_per_mm`.",
    )
    VIEW.notes(max(capture.shape) / scale, f"check the scale of {scale:g} px/mm (`px_per_mm`)")
    # several fingers are searched for on images reduced to about this scale
    binning = max(1, int(scale / 10.0))
    mean, _ = observe(capture).white.at(binning).survey()
    parts = finger_masks(mean, scale / binning)
    turn = np.deg2rad(capture.tip_direction_deg or 0.0)
    # of rows, columns: right, up
    frame = np.array([[-np.sin(turn), -np.cos(turn)], [np.cos(turn), -np.sin(turn)]])
    places = sorted(
        ((np.argwhere(part) @ frame, part) for part in parts),
        key=lambda place: float(place[0][:, 0].mean()),
    )
    named = _named(names, [float(place[:, 1].max()) * binning / scale for place, _ in places], keep)
    beside = (~np.logical_or.reduce(parts)).astype(np.uint8)
    _, nearest = cv2.distanceTransformWithLabels(beside, cv2.DIST_L2, cv2.DIST_MASK_5)
    fingers = {}
    for name, (_, part) in zip(named, places, strict=True):
        # background that is kept around each finger, where the view has it
        box = bounding_box(part, ceil(4.0 * scale / binning))
        own = cropped(capture, enlarged_box(box, binning, mean.shape[:2], capture.shape))
        near = np.isin(nearest[box], np.unique(nearest[part])).astype(np.uint8)
        inside = cv2.resize(near, own.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
        bands = {key: _alone(band, inside, scale) for key, band in own.bands.items()}
        mask = None if own.mask is None else own.mask & inside
        fingers[name] = replace(
            own, bands=bands, mask=mask, subject={**capture.subject, "finger": name}
        )
    return fingers


def _named(names: str | Sequence[str], tips_mm: Sequence[float], keep: bool) -> Sequence[str]:
    """Names of the fingers, whose tips lie so far up, from left to right."""
    wanted = len(_DIGITS) if isinstance(names, str) else len({*names})
    require(
        len(tips_mm) == wanted,
        f"fingers that stand apart in the view: {len(tips_mm)}; named by `fingers`: {wanted}. Name"
        " all in view, from left to right, and spread them so that the background shows between"
        " them.",
    )
    if isinstance(names, str):
        lower = tips_mm[0] - tips_mm[-1]
        hand = names
        # the little finger's tip lies at least this far behind the tip of the index finger
        clear = abs(lower) >= 3.0
        seen = "right" if lower < 0 else "left"
        if hand == "auto":
            require(clear, "the outer tips lie equally far up: give `fingers` left or right.")
            hand = seen
        require(
            keep or not clear or hand == seen,
            f"the tips are those of a {seen} hand (the outer ones differ by {abs(lower):.0f} mm),"
            f" not of a {hand} one; correct `fingers`, or give `keep`.",
        )
        # pads to the camera: a right hand's thumb lies to the right
        return [f"{hand}_{digit}" for digit in (_DIGITS[::-1] if hand == "right" else _DIGITS)]
    require(
        all(name.isidentifier() for name in names),
        "`fingers` must be names of letters, digits and _, or a hand.",
    )
    return names


def _alone(band: Band, inside: BoolArray, px_per_mm: float) -> Band:
    """The band with the background's brightness outside `inside`."""

    def own(image: PixelArray) -> Any:
        return blanked(image, inside, px_per_mm)

    ambient = band.ambient
    if ambient is not None:
        ambient = replace(ambient, pixels=own(ambient.pixels))
    return replace(band, pixels=np.stack(list(map(own, band.pixels))), ambient=ambient)
