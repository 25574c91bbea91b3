"""From a capture with mirrors to its views: where each shows the finger, and how the mirrors lie."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.fuse import Plane
from splitknit.preprocess import find_crease, find_upright, finger_mask
from splitknit.radiance import linear_survey, pick_channel
from splitknit.recipe.presets import PipelineSettings
from splitknit.recipe.rolled import MirrorView
from splitknit.recipe.rolled_light import Glass
from splitknit.shape import find_views, mirror_shape, view_binning
from splitknit.types import BoolArray, Capture, FloatArray, Mirror

Array = NDArray[np.float64]
SIDES = ("left", "right")
NO_MIRRORS = (
    "the capture has no mirrors beside the finger, so that it shows the finger from the front only; name them in its "
    "rig.json (docs/rolled.md), or print with --method unroll."
)


def check_mirrors(capture: Capture) -> None:
    """Refuse what has no mirrors, or a camera whose rays spread.

    Raises
    ------
    BadInput
        In these cases.
    """
    names = [mirror.name for mirror in capture.rig.mirrors]
    require(any(name in SIDES for name in names), NO_MIRRORS)
    require("white" in capture.bands, "the capture has no band 'white', in which ridges are seen.")
    model = capture.rig.camera.model
    require(
        model == "orthographic",
        f"a rolled finger needs parallel rays, but the rig's camera is {model}; use a telecentric lens, or print with "
        "--method unroll.",
    )


def find_mirror_views(capture: Capture, settings: PipelineSettings) -> list[MirrorView]:
    """Views of the finger in one picture, and mirrors where the views' outlines have them.

    Raises
    ------
    BadInput
        If there are no mirrors beside the finger, or fewer than two views can be used.
    """
    check_mirrors(capture)
    camera = capture.rig.camera
    binning = view_binning(camera.px_per_mm)
    mean, _ = linear_survey(capture.bands["white"], capture.encoding, binning)
    mirrors = {mirror.name: mirror for mirror in capture.rig.mirrors}
    views = find_views(mean, camera, mirrors, partial(finger_mask, settings=settings.mask), binning)
    seen = [name for name in SIDES if name in views.mirrors]
    require(
        bool(seen),
        "only the front view of the finger can be used: no mirror beside it shows it; turn the mirrors towards the "
        "finger, or print with --method unroll.",
    )
    shape = mirror_shape(views, camera, mirrors, tip_direction_deg=capture.tip_direction_deg or 0.0)
    front = _enlarged(views.front, capture.shape, binning)
    found = [MirrorView("front", _above_crease(front, views.front, mean, capture, settings, binning))]
    cut = shape.facts.get("views_cut_off", ())
    for name, mirror in mirrors.items():
        usable = name in seen and name not in cut
        mask = _enlarged(views.mirrors[name], capture.shape, binning) if usable else None
        found.append(MirrorView(name, mask, _glass(mirror, *shape.plane(mirror))))
    require(
        any(view.glass is not None and view.mask is not None for view in found),
        "only the front view of the finger can be used: the mirrors cut its sides off; lay it in their middle.",
    )
    return found


def _glass(mirror: Mirror, normal: Array, offset_mm: float) -> Glass:
    """A mirror in the plane that was found; its outline is the drawn one, laid into that plane."""
    corners = np.asarray(mirror.corners_mm, dtype=np.float64)
    corners = corners - (corners @ normal - offset_mm)[:, None] * normal
    return Glass(mirror.name, Plane(corners.mean(axis=0), normal), corners, mirror.reflectance)


def _above_crease(  # noqa: PLR0917
    mask: BoolArray, small: BoolArray, mean: FloatArray, capture: Capture, settings: PipelineSettings, binning: int
) -> BoolArray:
    """The front's mask without what lies beyond the finger's first crease."""
    if not settings.cut_at_crease:
        return mask
    upright = find_upright(small, capture.tip_direction_deg, settings.orientation)
    px_per_mm = capture.rig.camera.px_per_mm / binning
    crease = find_crease(pick_channel(mean, "grey"), small, upright, px_per_mm, settings.crease)
    if not crease.found:
        return mask
    across, along, offset = upright.upright_from_input[1]
    columns = (np.arange(mask.shape[1], dtype=np.float32) + 0.5) / binning - 0.5
    rows = (np.arange(mask.shape[0], dtype=np.float32) + 0.5) / binning - 0.5
    beyond = np.float32(crease.row + MARGIN_MM * px_per_mm)
    return np.asarray(mask & (columns[None, :] * across + rows[:, None] * along + offset < beyond))


MARGIN_MM = 2.5
"""Skin beyond the crease is kept this far: light from it reaches the phalange under the skin."""


def _enlarged(mask: BoolArray, shape: tuple[int, int], factor: int) -> BoolArray:
    """A mask of blocks on the full grid, its outline smooth."""
    if factor == 1:
        return mask
    size = (mask.shape[1] * factor, mask.shape[0] * factor)
    large = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5
    return np.pad(large, ((0, shape[0] - large.shape[0]), (0, shape[1] - large.shape[1])), mode="edge")
