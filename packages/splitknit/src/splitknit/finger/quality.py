"""How good a capture is, in numbers and sentences.

Ridge contrast is measured on a copy of about 24 px/mm, specks on one of 12 px/mm, everything else
on whatever stack is given (a reduced one will do; saturation is best counted at full resolution).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.finger.mask import touched_borders
from splitknit.finger.regions import (
    blur,
    depth_inside,
    erode,
    fill_holes,
    largest_component,
    quantile,
    reduce_image,
    reduce_mask,
    reduction,
)
from splitknit.imaging.geometry import bounding_box
from splitknit.model import Array, BoolArray, FloatArray

# Specks on the skin: dark ones as dust makes them, bright ones as the scales of dry skin do.
#
# A speck is dark, or bright, under every light, and short in every direction. Valleys, wrinkles,
# hairs and scars are long in one direction; shading and specular reflection change from light to
# light; pores are too small and too weak to count much. Everything is measured on a copy of one
# scale, 12 px/mm, so that finer cameras see no other specks; lines are laid over it at twice that
# scale, so that a thin hair does not fall into beads.


_SPECK_ENLARGEMENT = 2
"""Lines are laid over the copy enlarged by this factor, so that a thin hair does not fall into
beads. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17).
Range: 2 to 4 (validation/parameters)."""
_SPECK_LEVEL_MM = 0.3
"""Brightness is relative to its surroundings, smoothed by a Gaussian of this sigma. Chosen on:
simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17)."""
_SPECK_PX_PER_MM = 12.0
"""Scale of the copy on which specks are measured; coarser images are not. Chosen on: simulated
fingers (seeds 7401 to 7406 in every condition, people S16 and S17). Range: 8.4 to 12
(validation/parameters)."""
_DARK_SPECK_MM = 0.35
"""Dark marks that are longer in any direction are valleys, wrinkles or hairs. Chosen on: simulated
fingers (seeds 7401 to 7406 in every condition, people S16 and S17). Range: 0.245 to 0.7
(validation/parameters)."""
_DARK_SPECK_DEPTH = 0.08
"""How much darker than its surroundings a pixel of a dark speck is. Chosen on: simulated fingers
(seeds 7401 to 7406 in every condition, people S16 and S17). Range: 0.056 to 0.112
(validation/parameters)."""
_BRIGHT_SPECK_MM = 0.5
"""Bright marks that are longer in any direction are ridges. Chosen on: simulated fingers (seeds
7401 to 7406 in every condition, people S16 and S17)."""
_BRIGHT_SPECK_RISE = 0.08
"""How much brighter than its surroundings a pixel of a bright speck is. Chosen on: simulated
fingers (seeds 7401 to 7406 in every condition, people S16 and S17)."""


def _speck_fractions(
    stack: FloatArray, mask: BoolArray, px_per_mm: float
) -> tuple[float | None, float | None]:
    """Fractions of the finger, but its edge, under dark and under bright specks; None below 12
    px/mm (less a twentieth). Images (L, H, W) are divided by their surroundings; a pixel is dark by
    its brighter half of the images, bright by its darker half. The least of closings by lines in
    all directions fills marks that hold no line; openings find bright ones. Source: P. Soille, H.
    Talbot, Directional morphological filtering, IEEE PAMI 23(11), 2001.
    """
    if px_per_mm < 0.95 * _SPECK_PX_PER_MM:
        return None, None
    scale = min(1.0, _SPECK_PX_PER_MM / px_per_mm)
    px = px_per_mm * scale
    box, core = _core(mask, scale, px)
    if not core.any():
        return None, None
    relative = []
    for image in stack:
        small = reduce_image(image, scale)[box]
        level = blur(small, _SPECK_LEVEL_MM * px)
        relative.append(small / np.maximum(level, 0.05 * max(quantile(level[core][::4]), 1e-12)))
    images = np.sort(np.stack(relative), axis=0)
    half = max(1, len(images) // 2)
    lit = _finer(images[-half:].mean(axis=0), px)
    dim = _finer(images[:half].mean(axis=0), px)
    core = np.repeat(np.repeat(core, _SPECK_ENLARGEMENT, axis=0), _SPECK_ENLARGEMENT, axis=1)
    filled = _short_marks_filled(lit, _DARK_SPECK_MM * px * _SPECK_ENLARGEMENT)
    levelled = -_short_marks_filled(-dim, _BRIGHT_SPECK_MM * px * _SPECK_ENLARGEMENT)
    dark = lit[core] < (1.0 - _DARK_SPECK_DEPTH) * filled[core]
    bright = dim[core] > (1.0 + _BRIGHT_SPECK_RISE) * levelled[core]
    return float(dark.mean()), float(bright.mean())


def _core(mask: BoolArray, scale: float, px: float) -> tuple[tuple[slice, slice], BoolArray]:
    """Box of the finger on a reduced copy of `px` pixels a millimetre, and what of it there is not
    near its outline."""
    inside = reduce_mask(mask, scale) > 0.99
    depth = depth_inside(inside)
    box = bounding_box(inside) if inside.any() else (slice(0), slice(0))
    # pixels nearer to the outline are left out: skin is slanted there
    return box, depth[box] > min(1.5 * px, 0.4 * float(depth.max()))


_SPECK_DIRECTIONS = 16
"""Directions of the lines that a mark may hold. Chosen on: simulated fingers (seeds 7401 to 7406 in
every condition, people S16 and S17)."""


def _short_marks_filled(image: FloatArray, length_px: float) -> FloatArray:
    """Fill the dark marks of an (H, W) image that hold no straight line of `length_px` in any
    direction."""
    filled = np.full_like(image, np.inf)
    reach = int(np.ceil(0.5 * length_px))
    along = np.linspace(-0.5 * length_px, 0.5 * length_px, 4 * reach + 1)
    for angle in np.pi * np.arange(_SPECK_DIRECTIONS) / _SPECK_DIRECTIONS:
        line = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
        rows = np.rint(reach - along * np.sin(angle)).astype(np.intp)
        columns = np.rint(reach + along * np.cos(angle)).astype(np.intp)
        line[rows, columns] = 1
        np.minimum(filled, cv2.morphologyEx(image, cv2.MORPH_CLOSE, line), out=filled)
    return filled


_SPECK_BLUR_MM = 0.04
"""Sigma of a Gaussian before lines are laid: pixels of the copy leave no steps. Chosen on:
simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17). Range: 0.02 to 0.056
(validation/parameters)."""


def _finer(image: FloatArray, px: float) -> FloatArray:
    large = cv2.resize(
        image, None, fx=_SPECK_ENLARGEMENT, fy=_SPECK_ENLARGEMENT, interpolation=cv2.INTER_LINEAR
    )
    return blur(np.asarray(large), _SPECK_BLUR_MM * px * _SPECK_ENLARGEMENT)


_SATURATION = 0.98
"""Values from here on are saturated, unless the caller gives another level, in full scale."""


def capture_quality(
    stack: FloatArray,
    mask: BoolArray,
    px_per_mm: float,
    *,
    finger: bool = True,
    lights: Array | None = None,
    ambient: FloatArray | None = None,
    saturation: float | Array = _SATURATION,
) -> dict[str, Any]:
    """Measure focus, exposure, ambient light, coverage and the brightness of every LED.

    Returns what JSON can hold: ``ridge_contrast`` (relative, mean of the images),
    ``ridge_contrast_per_image``, ``sharpness`` (mean modified Laplacian over mean brightness),
    ``dark_specks`` and ``bright_specks`` (fractions of the finger; None where the stack is too
    coarse), ``saturated_per_image``, ``brightness`` (median of the mean image), ``ambient_share``
    (or None), ``area_mm2``, ``length_mm``, ``width_mm``, ``frame_share``, ``borders``,
    ``led_relative`` (measured over promised brightness, median one; or None). Source: Nayar, S. K.
    and Nakagawa, Y., "Shape from focus", IEEE PAMI 16(8), 1994 (modified Laplacian). `stack`: (L,
    H, W) float32 linear grey, ambient removed; `mask`: (H, W) bool, the finger; `px_per_mm`: of the
    stack that is given; `lights`: (L, 3) vectors whose length is the relative irradiance the rig
    promises (``Rig.light_vectors``); `ambient`: (H, W) linear image with all LEDs off;
    `saturation`: value at which all images saturate, or (L,) at which each does.
    """
    # a median needs no more pixels than that
    stride = max(1, round(float(np.sqrt(mask.sum() / 200_000))))
    grid = np.s_[::stride, ::stride]
    grid = grid if mask[grid].any() else np.s_[::1, ::1]
    light = [image[grid][mask[grid]] for image in stack]
    medians = np.array([quantile(image) for image in light])
    brightness = quantile(np.mean(light, axis=0))
    limits = np.broadcast_to(saturation, (len(stack),))
    saturated = [
        float((image[mask] >= limit).mean()) for image, limit in zip(stack, limits, strict=True)
    ]
    figures, sharpness = _ridge_contrast(stack, mask, px_per_mm, finger=finger)
    if finger:
        figures["dark_specks"], figures["bright_specks"] = _speck_fractions(stack, mask, px_per_mm)
    led_relative = None
    if lights is not None:  # a light counts with its z, as facing the camera
        ratio = medians / np.maximum(lights[:, 2], 1e-6)
        middle = float(np.median(ratio))
        led_relative = (ratio / middle if middle > 0 else 0.0 * ratio).tolist()
    return {
        **figures,
        "sharpness": sharpness,
        "saturated_per_image": saturated,
        "brightness": brightness,
        "brightness_per_image": medians.tolist(),
        "ambient_share": (
            None if ambient is None else quantile(ambient[mask]) / max(brightness, 1e-12)
        ),
        **outline_figures(mask, px_per_mm),
        "led_relative": led_relative,
    }


def outline_figures(mask: BoolArray, px_per_mm: float) -> dict[str, Any]:
    """What :func:`capture_quality` reports of the finger's outline alone."""
    rows, columns = bounding_box(mask)
    return {
        "area_mm2": float(mask.sum()) / px_per_mm**2,
        "length_mm": float(rows.stop - rows.start) / px_per_mm,
        "width_mm": float(columns.stop - columns.start) / px_per_mm,
        "frame_share": float(mask.mean()),
        "borders": list(touched_borders(mask)),
    }


_LED_RANGE = (0.5, 2.0)
"""Brightness of an image relative to what its LED should give; outside, the LED is suspect."""


def quality_findings(
    quality: Mapping[str, Any],
    *,
    finger: bool = True,
    names: Sequence[str] = (),
    promised: bool = True,
) -> Iterator[Finding]:
    """What is wrong with a capture, by its :func:`capture_quality`, and what to do. Without
    `finger` ridges, skin and tip are left out, without `promised` the lights' brightness. `names`:
    of the photographs' files.
    """
    names = names or [f"image {k}" for k in range(len(quality["saturated_per_image"]))]
    # median brightness of the mean image, below which it is called dark, in full scale
    if quality["brightness"] < 0.02:
        yield Finding(
            "dark-photographs",
            f"the images are dark (median {quality['brightness']:.3f} of full scale): lengthen the"
            " exposure.",
        )
    worst = int(np.argmax(quality["saturated_per_image"]))
    saturated = quality["saturated_per_image"][worst]
    if saturated > 0.02:  # fraction of the finger that may be saturated in any image
        what, remedy = ("finger", " or dry the finger") if finger else ("surface", "")
        yield Finding(
            "saturated-photograph",
            f"{100 * saturated:.0f} % of the {what} is saturated in {names[worst]}: shorten the"
            f" exposure{remedy}.",
            files=(names[worst],),
        )
    ambient = quality["ambient_share"] or 0.0
    if ambient > 0.3:  # ambient light as a fraction of the median lit brightness
        yield Finding(
            "ambient-light",
            f"ambient light is {100 * ambient:.0f} % of the LEDs' light: close the box, dim the"
            " room.",
        )
    for name, relative in zip(
        names, quality["led_relative"] or () if promised else (), strict=False
    ):
        if relative < 0.1:  # relative brightness below which an LED is called dead
            yield Finding(
                "dead-led",
                f"{name} is almost black: its LED seems dead; check its wiring.",
                files=(name,),
            )
        elif not _LED_RANGE[0] <= relative <= _LED_RANGE[1]:
            yield Finding(
                "led-brightness",
                f"{name} is {relative:.2f} times as bright as the rig file promises: check the LED,"
                " or calibrate the rig again.",
                files=(name,),
            )
    if finger:
        yield from _findings_on_skin(quality)


_MAX_DARK_SPECKS = 0.002
"""Fraction of the finger that dark specks may cover. Chosen on: simulated fingers (seeds 7401 to
7406 in every condition, people S16 and S17)."""
_MAX_BRIGHT_SPECKS = 0.005
"""Fraction of the finger that bright specks may cover. Chosen on: simulated fingers (seeds 7401 to
7406 in every condition, people S16 and S17)."""


def _findings_on_skin(quality: Mapping[str, Any]) -> Iterator[Finding]:
    """Those on ridges, skin and tip."""
    # minimum relative contrast (standard deviation over mean) of the ridge band
    if quality["ridge_contrast"] < 0.006:
        yield Finding(
            "faint-ridges",
            f"ridges hardly show (contrast {100 * quality['ridge_contrast']:.2f} %): focus the"
            " camera on the finger, clean the lens, dry a wet finger, or moisten a worn one.",
        )
    dark = quality.get("dark_specks") or 0.0
    bright = quality.get("bright_specks") or 0.0
    if dark > _MAX_DARK_SPECKS:  # at most one sentence: dust has bright grains too
        yield Finding(
            "dark-specks",
            f"dark specks cover {100 * dark:.1f} % of the finger: wipe the finger, and the lens or"
            " its cover.",
        )
    elif bright > _MAX_BRIGHT_SPECKS:
        remedy = "wipe it if it is dusty, moisten it if its skin is dry."
        yield Finding(
            "bright-specks", f"bright specks cover {100 * bright:.1f} % of the finger: {remedy}"
        )
    if quality["length_mm"] < 12.0:  # visible length of the finger below which a warning is given
        yield Finding(
            "short-finger",
            "only {:.0f mm} of the finger are in view: push it further in, or check px_per_mm.",
            lengths_mm=(quality["length_mm"],),
        )
    borders = set(quality["borders"])
    if borders >= {"top", "bottom"} or borders >= {"left", "right"}:
        yield Finding(
            "finger-crosses-view",
            "the finger crosses the whole image, so its tip is not in view: move it back.",
        )


def _ridge_contrast(
    stack: FloatArray, mask: BoolArray, px_per_mm: float, *, finger: bool
) -> tuple[dict[str, Any], float]:
    """Of a finger the relative standard deviation of the ridge band; and the mean modified
    Laplacian of the mean."""
    scale = reduction(mask.shape, px_per_mm, 24.0, 1200)
    px = px_per_mm * scale
    box, core = _core(mask, scale, px)
    contrast = []
    total = np.zeros(core.shape, dtype=np.float32)
    for image in stack if core.any() else ():
        small = reduce_image(image, scale)[box]
        total += small
        if finger:
            fine = blur(small, 0.06 * px)[core]
            wide = blur(small, 0.2 * px)[core]
            level = np.maximum(wide, 0.05 * max(quantile(wide[::8]), 1e-12))
            # robust deviation: glints do not count
            contrast.append(quantile(np.abs((fine - wide) / level), 0.683))
    contrast = contrast or [0.0] * len(stack)
    figures = (
        {"ridge_contrast": float(np.mean(contrast)), "ridge_contrast_per_image": contrast}
        if finger
        else {}
    )
    if not core.any():
        return figures, 0.0
    smooth = blur(total, 0.06 * px)
    laplacian = np.abs(cv2.filter2D(smooth, -1, _SECOND_DIFFERENCE)) + np.abs(
        cv2.filter2D(smooth, -1, _SECOND_DIFFERENCE.T)
    )
    return figures, float(laplacian[core].mean()) / max(float(total[core].mean()), 1e-12)


_SECOND_DIFFERENCE = np.array([[-1.0, 2.0, -1.0]], dtype=np.float32)
"""Second difference along a row. Source: definition."""


# Which of the finger's pixels carry enough light for photometric stereo.

_MIN_LIGHTS = 3
"""Lights that must reach a pixel unsaturated. Source: definition (three determine a normal)."""


def photometric_mask(
    stack: FloatArray,
    finger: BoolArray,
    px_per_mm: float,
    *,
    saturation: float | Array = _SATURATION,
) -> BoolArray:
    """Drop pixels that too few lights reach: (H, W) inside `finger`, one component without
    pinholes, at full resolution. The thesis's threshold (3.3.1.5, refined mask) follows the
    finger's own brightness here, and three lights must pass it. `saturation`: at which each image
    of `stack` (L, H, W) saturates, or (L,). Raises BadInput if nothing is left.
    """
    box = bounding_box(finger)
    inside = finger[box]
    least = min(_MIN_LIGHTS, len(stack))
    ceilings = np.broadcast_to(saturation, (len(stack),))
    sample = stack[:, box[0], box[1]][:, ::4, ::4][:, inside[::4, ::4]]
    sample = sample if sample.size else stack[:, finger]
    # a light reaches a pixel if it is brighter than this fraction of the finger's median brightness
    floor = 0.03 * float(np.median(sample))
    count = np.zeros(inside.shape, dtype=np.uint8)
    for image, ceiling in zip(stack[:, box[0], box[1]], ceilings, strict=True):
        count += (image > floor) & (image < np.float32(ceiling))
    # holes up to this area are filled: a few unreliable pixels harm less than a hole in the surface
    good = fill_holes(inside & (count >= least), 1.0 * px_per_mm**2)
    # an isolated dark pixel at the outline would leave a bay one pixel wide, and a bridge as thin
    # is not a surface
    good = largest_component(good & inside)
    dark = (
        f"hardly any pixel of the mask is reached by {least} lights without saturating: correct the"
        " exposure."
    )
    require(erode(good, 2.0).any(), dark)
    result = np.zeros(finger.shape, dtype=np.bool_)
    result[box] = good
    return result
