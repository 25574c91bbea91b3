"""From a capture with mirrors to the shape on the finger's window: views, slopes of the skin in
white light, and the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.finger.locate import Finger
from splitknit.imaging.areas import mirror_outline
from splitknit.imaging.geometry import height_gradients, local_mean, normals_from_gradients
from splitknit.imaging.pixels import bin_mean
from splitknit.imaging.view import View, pixels_of, view_of
from splitknit.integration.knit import crossover, unevenness
from splitknit.mirrors.body import Slopes
from splitknit.mirrors.mirror import MirrorShape, mirror_shape
from splitknit.mirrors.outline import medial_line
from splitknit.mirrors.reflection import (
    Glass,
    facing_fraction,
    glass_in,
    led_image,
    mirrored_fraction,
    shade_of,
)
from splitknit.mirrors.views import Views, view_binning, views_in
from splitknit.model import Array, BoolArray, FloatArray, Rig
from splitknit.observation.observe import Observation
from splitknit.photometric.near_light import pseudo_normals


@dataclass(frozen=True, slots=True, eq=False)
class SeenInMirrors:
    """Views of a capture with mirrors, and the shape that follows from them."""

    views: Views
    shape: MirrorShape
    rig: Rig


_DETAIL_MM = 1.5
"""Detail finer than this comes from white light (creases); light that arrives through the mirrors
distorts wider structure. With 5 mm the surface of eight fingers is 0.189 mm off, with 1.5 mm 0.160
mm. Chosen on: simulated fingers (eight, docs/explain/tried.md, "Mirrors"). Range: 1.05 to 1.5
(validation/parameters)."""


def mirror_shape_of(
    finger: Finger, seen: SeenInMirrors, detail_mm: FloatArray | None
) -> tuple[FloatArray, BoolArray, dict[str, Any]]:
    """The shape (h, w) from mirrors on the finger's window, in mm; the finger's mask (H, W) as far
    as the mirrors show it; and facts for the result. Every pixel of the front view has its own z of
    the shape, so that relief and shape need no other mapping. `detail_mm`: (h, w) a shape from
    light, of which what is finer than 1.5 mm is kept: creases, and what no smooth section has;
    None: nothing is.
    """
    camera = seen.rig.camera
    window = finger.window
    inside = finger.inside
    shape, known = seen.shape.continued(*window)
    if camera.model != "orthographic":  # heights along the rays that the result is made from
        shape = view_of(camera, *window, along_rays=True).along(shape)
        shape = shape - unevenness(shape, inside, camera, window)
    if detail_mm is not None:
        cut = 2.0 * np.pi * camera.pitch_mm / _DETAIL_MM
        from_light = np.where(inside, detail_mm, 0)
        finer = crossover(from_light, shape, lambda w: 1.0 - np.exp(-0.5 * (w / cut) ** 2), inside)
        shape = np.where(inside, finer, shape)
    kept = finger.mask.copy()
    kept[window] &= known
    require(
        kept.any(),
        "the mirrors show another part of the finger than the front view; check the rig file.",
    )
    facts = {
        "shape_source": "mirror",
        "mirror_shape": seen.shape.facts,
        "mirror_drawing": _drawing(seen),
    }
    return shape, kept, facts


def _drawing(seen: SeenInMirrors) -> dict[str, Any]:
    """Masks' outlines, medial lines and the fitted body's outlines of all views, columns and rows
    of the image."""
    rig = seen.rig
    binning = seen.views.binning
    masks = {}
    for name, mask in {"front": seen.views.front, **seen.views.mirrors}.items():
        contours, _ = cv2.findContours(
            mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        outline = cv2.approxPolyDP(max(contours, key=cv2.contourArea), 0.7, True)[:, 0]
        masks[name] = (outline + 0.5) * binning - 0.5
    medial_lines = {}
    for name, rows in seen.shape.rows.items():
        slope, offset = medial_line(rows)
        ends = rows.along_mm[np.isfinite(rows.width_mm)][[0, -1]]
        places = np.outer(ends, rows.axis) + np.outer(slope * ends + offset, rows.across)
        medial_lines[name] = pixels_of(rig.camera, places)
    lines: dict[str, Mapping[str, FloatArray]] = {
        "masks": masks,
        "medial_lines": medial_lines,
        "mirrors": {mirror.name: mirror_outline(mirror, rig.camera) for mirror in rig.mirrors},
        "fitted": {name: line[::4] for name, line in seen.shape.drawn().items()},
    }
    return {
        kind: {name: np.round(line, 1).tolist() for name, line in views.items()}
        for kind, views in lines.items()
    }


def seen_in_mirrors(observation: Observation) -> SeenInMirrors:
    """Views and shape of a finger; BadInput if the rig has no mirrors, or they do not show one
    finger."""
    views, grey = found_views(observation)
    tip = observation.tip_direction_deg or 0.0
    slopes_on = partial(skin_slopes, observation.white.rig, grey, views)
    shape = mirror_shape(views, observation.rig, tip_direction_deg=tip, slopes_on=slopes_on)
    return SeenInMirrors(views, shape, observation.rig)


def found_views(observation: Observation) -> tuple[Views, FloatArray]:
    """The views, direct and in mirrors, and the white images (L, h, w) in which they were found.
    Raises BadInput as :func:`splitknit.mirrors.views.views_in`.
    """
    rig = observation.rig
    binning = view_binning(rig.camera.px_per_mm)
    mean, grey = observation.white.at(binning).survey()
    return views_in(mean, rig, binning), grey


_RIM_MM = 1.2  # skin nearer to the outline than this is not used: light is lost there


def skin_slopes(rig: Rig, grey: FloatArray, views: Views, shape: MirrorShape) -> Slopes | None:
    """Slopes of the skin in the front view, by photometric stereo with the LEDs and their images in
    the mirrors. `rig`: `leds[k]` lights image k; `grey`: (L, h, w) white images on the views' grid;
    `shape`: a first one: it gives where each light reaches the skin.
    """
    camera = rig.camera
    pitch = camera.pitch_mm * views.binning
    factor = max(1, round(0.25 / pitch))  # pitch of the images from which slopes are measured
    inside: BoolArray = bin_mean(views.front.astype(np.float32), factor) > 0.999
    depth = (
        cv2.distanceTransform(np.pad(inside, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        * pitch
        * factor
    )
    if len(grey) < 3 or not (depth > _RIM_MM).any():
        return None
    block = factor * views.binning
    block_mm = pitch * factor
    view = view_of(camera, binning=block)
    rows, columns = (slice(0, side * block) for side in inside.shape)
    x, y, z = shape.points(rows, columns, block)
    inside &= np.isfinite(z)
    surface = np.where(inside, z, np.nanmin(z))
    rig = _with_images(
        rig,
        [glass_in(mirror, shape.plane(mirror)) for mirror in rig.mirrors],
        np.stack([x, y, surface], axis=-1).astype(np.float64),
        normals_from_gradients(*height_gradients(np.where(inside, z, np.nan), block_mm)).astype(
            np.float64
        ),
        view,
    )
    normals = pseudo_normals(bin_mean(grey, factor), rig, surface, inside, view=view)
    length = np.linalg.norm(normals, axis=2)
    level = 1e-3 * np.median(length[inside])
    upward = np.maximum(normals[..., 2], level)
    known = inside & (normals[..., 2] > 0.3 * length)
    smooth = [local_mean(-normals[..., k] / upward, known, 0.5 / block_mm)[0] for k in range(2)]
    step = max(1, round(1.0 / block_mm))  # distance of the places whose slopes are used
    chosen = np.zeros_like(inside)
    chosen[step // 2 :: step, step // 2 :: step] = True
    chosen &= (depth > _RIM_MM) & known
    places = np.column_stack([x[chosen], y[chosen]]).astype(np.float64)
    return Slopes(
        places, smooth[0][chosen].astype(np.float64), smooth[1][chosen].astype(np.float64)
    )


def _with_images(
    rig: Rig, glasses: Sequence[Glass], points_mm: Array, normals: Array, view: View
) -> Rig:
    """The rig (`rig.leds[k]` lights image k) with the LEDs' images in mirrors `glasses`, each where
    it reaches the skin. `points_mm`, `normals`: (h, w, 3) of the skin at the pixels of `view`.
    """

    exposures = []
    for exposure in rig.leds:
        members = [replace(led, also=()) for led in (exposure, *exposure.also)]
        lights = [(led, facing_fraction(points_mm, normals, led)) for led in members]
        for glass in glasses:
            for led in members:
                image = led_image(led, glass.plane, glass.reflectance)
                through = mirrored_fraction(points_mm, image, glass.plane, glass.corners_mm)
                lights.append((image, facing_fraction(points_mm, normals, image) * through))
        first, *also = (replace(led, shade=shade_of(part, view)) for led, part in lights)
        exposures.append(replace(first, also=tuple(also)))
    return replace(rig, leds=tuple(exposures))
