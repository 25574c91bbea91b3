"""From a capture with mirrors to its views: where each shows the finger, and how the mirrors lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from splitknit import Capture
from splitknit.errors import require
from splitknit.finger.locate import BEYOND_CREASE_MM, FingerSettings, enlarged_mask
from splitknit.finger.orientation import find_upright
from splitknit.finger.phalange import find_crease
from splitknit.imaging.band import linear_survey, pick_channel
from splitknit.mirrors.body import Body
from splitknit.mirrors.captured import skin_slopes
from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.reflection import glass_in
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.mirrors.views import view_binning, views_in
from splitknit.model import BoolArray, FloatArray
from splitknit_match.rolled.work import MirrorView, MirrorViews

Array = NDArray[np.float64]
SIDES = ("left", "right")
NO_MIRRORS = (
    "the capture has no mirrors beside the finger, so that it shows the finger from the front only; name them in its "
    "rig.json (docs/guide/rolled.md), or print with `method` unroll."
)


def find_mirror_views(capture: Capture, settings: FingerSettings, mirror: MirrorShapeSettings) -> MirrorViews:
    """Views of the finger in one picture, and mirrors where the views' outlines have them. Raises BadInput if there are
    no mirrors beside the finger, or fewer than two views can be used.
    """
    names = [mirror.name for mirror in capture.rig.mirrors]
    require(any(name in SIDES for name in names), NO_MIRRORS)
    require("white" in capture.bands, "the capture has no band 'white', in which ridges are seen.")
    camera = capture.rig.camera
    binning = view_binning(camera.px_per_mm)
    mean, grey = linear_survey(capture.bands["white"], capture.encoding, binning)
    mirrors = {mirror.name: mirror for mirror in capture.rig.mirrors}
    views = views_in(mean, capture.rig, binning)
    seen = [name for name in SIDES if name in views.mirrors]
    cure = "turn the mirrors towards the finger, or print with `method` unroll."
    require(bool(seen), f"only the front view of the finger can be used: no mirror beside it shows it; {cure}")
    sides = replace(views, mirrors={name: views.mirrors[name] for name in seen})
    shape = mirror_shape(
        sides,
        capture.rig,
        replace(mirror, method="outlines"),
        tip_direction_deg=capture.tip_direction_deg or 0.0,
        slopes_on=partial(skin_slopes, capture, grey, views),
        cut_too=True,
    )
    used = {} if shape.fit is None else shape.fit.poses
    cut, useless = [name for name in shape.facts["views_cut_off"] if name in used], shape.facts["views_useless"]
    front = enlarged_mask(views.front, capture.shape, binning)
    if settings.cut_at_crease:
        front = _above_crease(front, views.front, mean, capture, binning)
    found = [MirrorView("front", front)]
    for name, glass in mirrors.items():
        mask = enlarged_mask(views.mirrors[name], capture.shape, binning) if name in used else None
        found.append(MirrorView(name, mask, glass_in(glass, shape.plane(glass)), name in cut))
    unseen = [name for name in SIDES if name in mirrors and name not in seen]
    beyond = [name for name in mirrors if name not in SIDES]
    assert isinstance(shape.model, Body)
    return MirrorViews(tuple(found), shape.model, (*shape.doubts, *_notes(cut, useless, unseen, beyond)))


def _notes(
    cut: Sequence[str], useless: Sequence[str], unseen: Sequence[str], beyond: Sequence[str] = ()
) -> tuple[str, ...]:
    """What became of views that are not as they should be."""
    found = [
        f"the view in the {name} mirror is cut off at the picture's border or the mirror's, so that its outline shows "
        "less of where the mirror lies: lay the finger in the middle, so that the mirror shows all of its pad."
        for name in cut
    ]
    found += [
        f"the view in the {name} mirror is cut off so much that it is left out, and that side of the finger is missing "
        "from the print: lay the finger in the middle."
        for name in useless
    ]
    found += [
        f"no finger was found in the {name} mirror, so that that side of it is missing from the print: check the "
        "mirror's pose in rig.json, and the light on that side."
        for name in unseen
    ]
    found += [f"the {name} mirror gives light only: its view is not used for the print." for name in beyond]
    return tuple(found)


def _above_crease(mask: BoolArray, small: BoolArray, mean: FloatArray, capture: Capture, binning: int) -> BoolArray:
    """The front's mask without what lies beyond the finger's first crease."""
    upright = find_upright(small, capture.tip_direction_deg or 0.0)
    px_per_mm = capture.rig.camera.px_per_mm / binning
    crease = find_crease(pick_channel(mean, "grey"), small, upright, px_per_mm)
    if not crease.found:
        return mask
    across, along, offset = upright.upright_from_input[1]
    columns = (np.arange(mask.shape[1], dtype=np.float32) + 0.5) / binning - 0.5
    rows = (np.arange(mask.shape[0], dtype=np.float32) + 0.5) / binning - 0.5
    beyond = np.float32(crease.row + BEYOND_CREASE_MM * px_per_mm)
    return np.asarray(mask & (columns[None, :] * across + rows[:, None] * along + offset < beyond))
