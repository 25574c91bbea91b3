"""Where the finger is, how it lies, and whether the capture is any good."""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.findings import Finding, Severity
from splitknit.finger.mask import (
    MIN_OBJECT_CONTOUR,
    BeyondView,
    NoFinger,
    finger_mask,
    finger_masks,
    left_out_part,
    object_before_wall,
    touched_borders,
)
from splitknit.finger.motion import MotionSettings, motion_findings, shot_motion
from splitknit.finger.orientation import Upright, as_it_lies, find_upright
from splitknit.finger.phalange import Crease, find_crease, phalange_mask
from splitknit.finger.quality import (
    capture_quality,
    outline_figures,
    photometric_mask,
    quality_findings,
)
from splitknit.finger.regions import dilate, reduce_image, reduction
from splitknit.imaging.areas import without_mirrors
from splitknit.imaging.geometry import bounding_box, enlarged
from splitknit.imaging.light_field import few_lights
from splitknit.imaging.pixels import Window, pick_channel
from splitknit.model import BoolArray, FloatArray
from splitknit.observation.coloured import LightsSettings, colour_factors
from splitknit.observation.light import LIGHT_BYTES
from splitknit.observation.observe import Observation
from splitknit.plausible import FINGER_WIDTH
from splitknit.settings import Checked

MUCH_LEFT_OUT = 0.05
"""Fraction of an object missing from its outline above which a doubt is raised: 0.3 on a key, 0 to
0.02 on rounder things. Source: validation/objects (glossy)."""
_NO_FINGER = (
    "no finger was found in the white images ({}): nothing stands out from the background in colour"
    " or brightness; check the exposure, the LEDs, the dark background and the scale, or give a"
    " mask."
)
_NO_OBJECT = (
    "no object was found in the photographs ({}): nothing stands out from the background in colour"
    " or brightness; check the exposure, the LEDs, the dark background and the scale, or give a"
    " mask (`mask` all, where the object fills the view)."
)
_OBJECT_BEYOND_VIEW = (
    "the object touches three borders of the image or all: move it back so that all of it is in"
    " view, or give a mask (`mask` all, where the object fills the view)."
)
_MUCH_SMALLER = 0.2  # of an object that reaches a border: a whole one of that area is meant instead
_OTHER_LEFT_OUT = Finding(
    "background-left-out",
    "a larger thing reaches a border of the image and was left out: see in the report that the"
    " object is the one you mean, or give a `mask`.",
)
_WALL_LEFT_OUT = Finding(
    "background-left-out",
    "what lies behind the object reaches a border of the image and was left out, being far darker:"
    " see in the report that the object is whole, or give a `mask`.",
)


@dataclass(frozen=True, slots=True)
class FingerSettings(Checked):
    """How a capture is read, and how the finger is found in it."""

    _group = ""
    camera: Literal["calibrated", "orthographic"] = "calibrated"
    """``calibrated``: rays run as in the rig file's camera model; ``orthographic``: parallel,
    whatever the model is."""
    lights: LightsSettings = field(default_factory=LightsSettings)
    cut_at_crease: bool = True
    """Keep the first phalange alone."""
    motion: MotionSettings = field(default_factory=MotionSettings)
    keep: bool = False
    """Go on where the photographs of skin contradict each other or their lights so much that the
    surface is spoilt."""


@dataclass(frozen=True, slots=True, eq=False)
class Finger:
    """What is known of the finger before photometric stereo."""

    mask: BoolArray
    """(H, W) pixels that are reconstructed and kept."""
    wider: BoolArray
    """(H, W) pixels that are reconstructed: `mask` and a margin beyond the crease."""
    window: Window
    """Rows and columns around `wider`."""
    upright: Upright
    facts: Mapping[str, Any]
    quality: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()

    @property
    def inside(self) -> BoolArray:
        """(h, w) pixels of the window that are reconstructed."""
        return self.wider[self.window]


SURVEY_PX_PER_MM = 26.0
"""The finger is searched for on images reduced to about this scale. Chosen on: speed."""
BEYOND_CREASE_MM = 2.5
"""Skin beyond the crease is reconstructed too, and then cut: light from it reaches the phalange
under the skin. Chosen on: judgement. Range: 1.25 to 5 (validation/parameters)."""


def find_finger(observation: Observation, settings: FingerSettings) -> Finger:
    """Mask, orientation, crease and quality, on images of about 26 px/mm.

    An opaque thing is not a finger: it is not cut at a crease, may touch every border, and stays as
    it lies unless a `tip_direction_deg` is given. Raises BadInput if there is no finger, or it
    touches three borders.
    """
    px_per_mm = observation.rig.camera.px_per_mm
    white = observation.white
    rows, columns = observation.shape
    # 200 photographs are many
    fits = math.ceil(math.sqrt(4.0 * len(white.lights) * rows * columns / LIGHT_BYTES))
    # the reduced images keep this many pixels a side, where the image has them, whatever scale was
    # stated
    binning = max(1, min(int(px_per_mm / SURVEY_PX_PER_MM), min(rows, columns) // 64), fits)
    mean, stack = white.at(binning).survey()
    grey = pick_channel(mean, "grey")
    image = mean if white.has_colour else grey
    small_px = px_per_mm / binning
    skin = observation.material == "skin"
    stated_mask = observation.mask is not None
    wall: tuple[Finding, ...] = ()
    if observation.mask is not None:
        outline = reduced(observation.mask, grey.shape)
        require(
            outline.any(),
            "the given mask is too small: not one block of pixels lies inside it; mark all of it.",
        )
    else:
        outline, wall = _outline(observation, image, stack, binning)
    quality, of_quality = _quality(observation, stack, outline, binning)
    stated = observation.tip_direction_deg is not None
    searched = skin and not stated and not observation.rig.mirrors
    upright = as_it_lies(outline)
    if skin or stated:
        direction = None if searched else observation.tip_direction_deg or 0.0
        upright = find_upright(outline, direction)
    crease = Crease()
    if skin:
        crease = find_crease(grey, outline, upright, small_px)
    cut = settings.cut_at_crease and not stated_mask and skin
    kept = usable = phalange_mask(outline, crease, upright) if cut else outline
    if observation.mask is not None:
        mask = wide = np.asarray(observation.mask)
    else:
        usable = photometric_mask(stack, kept, small_px, saturation=white.clips_at)
        beyond = crease._replace(row=crease.row + BEYOND_CREASE_MM * small_px)
        wider = phalange_mask(outline, beyond, upright) if cut else outline
        wide = enlarged_mask(wider & (usable | ~kept), observation.shape, binning)
        mask = enlarged_mask(usable, observation.shape, binning) & wide
    findings: list[Finding] = []
    if skin and not stated_mask and not observation.rig.mirrors:
        findings += _other_fingers(image, small_px)
    findings += wall
    findings += (
        _check_width(usable, small_px, stated_mask) if skin else _at_border(outline, stated_mask)
    )
    if upright.note:
        findings.append(Finding("unsure-tip", upright.note))
    if cut and not crease.detected:
        findings.append(crease.verdict)
    facts = {
        "yaw_deg": float(np.rad2deg(upright.yaw_rad)),
        "tip_direction": (
            "given" if stated else "found" if searched and upright.clear else "assumed"
        ),
        "mask": "given" if stated_mask else "found",
        "crease_found": bool(crease.detected and cut),
        "crease_distance_mm": float(crease.distance_mm) if crease.detected else None,
        "crease_line": (
            [[(v + 0.5) * binning - 0.5 for v in end] for end in crease.line]
            if crease.line
            else None
        ),
    }
    window = bounding_box(wide, round(0.5 * px_per_mm))
    return Finger(
        mask, wide, window, _scaled(upright, binning), facts, quality, (*findings, *of_quality)
    )


def _other_fingers(image: FloatArray, px_per_mm: float) -> tuple[Finding, ...]:
    """A doubt where several fingers lie side by side in the view."""
    scale = reduction(image.shape[:2], px_per_mm, SURVEY_PX_PER_MM / 3, 600)
    try:
        count = len(finger_masks(reduce_image(image, scale), px_per_mm * scale))
    except BadInput:
        return ()
    return (
        (
            Finding(
                "several-fingers",
                f"the view shows {count} fingers, of which one is reconstructed: photograph it"
                " alone, or mark it in a mask.",
                Severity.DOUBT,
            ),
        )
        if count > 1
        else ()
    )


def _outline(
    observation: Observation, image: FloatArray, stack: FloatArray, binning: int
) -> tuple[BoolArray, tuple[Finding, ...]]:
    """Mask of the finger itself, not of its mirror images, in the mean of the white images; of an
    object, without the wall behind it, and a note where one was left out."""
    camera = observation.rig.camera
    if observation.rig.mirrors:
        mirrors = {mirror.name: mirror for mirror in observation.rig.mirrors}
        image = without_mirrors(image, camera, mirrors, binning)
    skin = observation.material == "skin"
    try:
        outline = finger_mask(image, camera.px_per_mm / binning)
    except (NoFinger, BeyondView) as error:
        part = None if skin else object_before_wall(stack)
        if part is not None:
            return part, (_WALL_LEFT_OUT,)
        if isinstance(error, BeyondView):
            if skin:
                raise
            raise BadInput(_OBJECT_BEYOND_VIEW) from error
        rows_mm, columns_mm = (side / camera.px_per_mm for side in observation.shape)
        view = f"{columns_mm:.3g} x {rows_mm:.3g} mm at {camera.px_per_mm:g} px/mm"
        words = _NO_FINGER if skin else _NO_OBJECT
        raise BadInput(words.format(view if camera.scale_known else "of unknown scale")) from error
    if skin:
        return outline, ()
    if touched_borders(outline):
        part = object_before_wall(stack)
        if part is not None and outline[part].mean() > MIN_OBJECT_CONTOUR:
            return part, (_WALL_LEFT_OUT,)
        whole = _whole_object(image, outline, camera.px_per_mm / binning)
        if whole is not None:
            return whole, (_OTHER_LEFT_OUT,)
    return outline, _left_out(image, outline)


def _whole_object(image: FloatArray, outline: BoolArray, px_per_mm: float) -> BoolArray | None:
    """An object that touches no border and is not much smaller than the outlined one, which touches
    one; None without."""
    beside = dilate(outline, 0.05 * max(outline.shape))
    ground = np.median(image[~beside], axis=0) if not beside.all() else 0.0
    covered = beside if image.ndim == 2 else beside[..., None]
    with suppress(NoFinger, BeyondView):
        whole = finger_mask(np.where(covered, ground, image), px_per_mm)
        if not touched_borders(whole) and whole.sum() > _MUCH_SMALLER * outline.sum():
            return whole
    return None


def _left_out(image: FloatArray, outline: BoolArray) -> tuple[Finding, ...]:
    """A doubt where the outline that was found holds only a part of an object."""
    part = left_out_part(image, outline)
    return (
        (
            Finding(
                "part-left-out",
                f"the outline that was found leaves out {100 * part:.0f} % of the object, which is"
                " narrow there: give a `mask`.",
                Severity.DOUBT,
            ),
        )
        if part > MUCH_LEFT_OUT
        else ()
    )


def _check_width(mask: BoolArray, px_per_mm: float, stated: bool) -> tuple[Finding, ...]:
    """Refuse a mask that is nowhere wide enough to hold a surface, or wider than a finger; note an
    odd one."""
    padded = np.pad(mask[bounding_box(mask)].astype(np.uint8), 1)
    width_mm = (
        2.0
        * float(cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).max())
        / px_per_mm
    )
    least_mm = FINGER_WIDTH.possible[0]
    narrow = (
        f"only a strip of {width_mm:.1f} mm of the finger is bright enough in all images; capture"
        " it again with more light, or give a mask."
    )
    if stated:
        narrow = (
            f"the given mask is too small: it is nowhere wider than {width_mm:.1f} mm, and"
            f" {least_mm:g} mm are needed; mark the whole finger, or check the rig's px_per_mm."
        )
    require(width_mm >= least_mm, narrow)
    odd = FINGER_WIDTH.notes(
        width_mm, "check the scale (`px_per_mm`) that all lengths come from, or the mask"
    )
    return tuple(replace(finding, severity=Severity.DOUBT) for finding in odd)


def _quality(
    observation: Observation, white: FloatArray, outline: BoolArray, binning: int
) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Quality figures and findings of every band, on images reduced by `binning`."""
    px_per_mm = observation.rig.camera.px_per_mm / binning
    # background around the finger that quality is measured with: the widest filter that measures
    # motion reaches so far
    rows, columns = bounding_box(outline, round(3.0 * px_per_mm))
    window = (
        slice(rows.start * binning, rows.stop * binning),
        slice(columns.start * binning, columns.stop * binning),
    )
    inside = outline[rows, columns]
    skin = observation.material == "skin"
    promised = skin or not observation.rig.intensities_assumed

    def of_band(name: str) -> tuple[dict[str, Any], list[Finding]]:
        light = observation.bands[name].at(binning, window)
        stack = white[:, rows, columns] if name == "white" else light.grey
        lights = light.rig.light_vectors()
        if light.colours:  # skin is brighter in red than in blue, whatever the LEDs are
            lights = lights * colour_factors(stack, light.rig, inside)[:, None]
        figures = capture_quality(
            stack,
            inside,
            px_per_mm,
            finger=skin,
            lights=lights,
            ambient=None if (dark := light.ambient) is None else np.maximum(dark, 0.0),
            saturation=light.clips_at,
        )
        figures |= outline_figures(outline, px_per_mm)
        names = light.image_names
        findings = [
            *few_lights(lights),
            *quality_findings(figures, finger=skin, names=names, promised=promised),
        ]
        if len(stack) >= 4 and skin:
            motion = shot_motion(stack, inside, px_per_mm)
            figures["motion_mm"] = np.hypot(*motion.shift_mm.T).tolist()
            figures["motion_reliability"] = motion.reliability.tolist()
            findings += motion_findings(motion, names)
        return figures, [
            replace(finding, message=f"{name} band: {finding.message}") for finding in findings
        ]

    with ThreadPoolExecutor(2) as pool:
        bands = dict(zip(observation.bands, pool.map(of_band, observation.bands), strict=True))
    quality = {name: figures for name, (figures, _) in bands.items()}
    return quality, tuple(finding for _, findings in bands.values() for finding in findings)


def reduced(mask: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """A mask on a smaller grid: pixels that lie in it by more than half."""
    return np.asarray(
        cv2.resize(mask.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
        > 0.5
    )


def _at_border(outline: BoolArray, stated: bool) -> tuple[Finding, ...]:
    """A note where the outline that was found of an object touches a border of the image."""
    borders = () if stated else touched_borders(outline)
    return (
        (
            Finding(
                "outline-at-border",
                f"the outline that was found touches a border of the image ({', '.join(borders)}):"
                " see in the report that it is the object's alone, or give a `mask`.",
            ),
        )
        if borders
        else ()
    )


def enlarged_mask(mask: BoolArray, shape: tuple[int, int], factor: int) -> BoolArray:
    """A mask of blocks on the full grid, its outline smooth."""
    return (
        mask if factor == 1 else np.asarray(enlarged(mask.astype(np.float32), factor, shape) > 0.5)
    )


def _scaled(upright: Upright, factor: int) -> Upright:
    grow = np.array(
        [[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]], dtype=np.float64
    )
    column, row = upright.tip
    return replace(
        upright,
        input_from_upright=grow @ upright.input_from_upright @ np.linalg.inv(grow),
        size=(upright.size[0] * factor, upright.size[1] * factor),
        tip=((column + 0.5) * factor - 0.5, (row + 0.5) * factor - 0.5),
        width_px=upright.width_px * factor,
    )
