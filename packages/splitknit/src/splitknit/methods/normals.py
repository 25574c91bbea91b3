"""The surface of a normal map that another program made, and the photographs that contradict it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from splitknit.checks import check_mask
from splitknit.errors import refusing, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.finger.locate import Finger, FingerSettings
from splitknit.finger.orientation import as_it_lies
from splitknit.imaging.geometry import bounding_box, gradients_from_normals, smoothed
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import view_of
from splitknit.integration.poisson import piecewise
from splitknit.io.normal_maps import unit_vectors
from splitknit.io.photographs import SCALES
from splitknit.methods.photographs import FingerPhotographs, FingerSurface, placed
from splitknit.methods.photometry import IMPOSSIBLE, SLOW_MM, strips
from splitknit.model import BoolArray, Camera, FloatArray, Rig, camera_without_scale
from splitknit.observation.observe import Observation
from splitknit.reconstruction import UNKNOWN_SCALE, Reconstruction
from splitknit.settings import check_value

PRESET = "normals"
"""Preset named in results that were integrated from a normal map."""


def surface_of_normals(
    normals: Any,
    mask: Any = None,
    px_per_mm: float | None = None,
    *,
    camera: Camera | None = None,
    y: Literal["up", "down"] | None = None,
) -> Reconstruction:
    """Integrate a normal map to heights, whose steps it keeps.

    Parameters
    ----------
    normals : (H, W, 3) of floats, uint8 or uint16
        x right, y up, z to the camera; integers go from -1 at zero to 1 at the highest. Where they
        have not the length 1 there is no surface.
    mask : (H, W) bool, optional
        The object; by default wherever there are normals.
    px_per_mm : float, optional
        Scale on the object; without it heights are in pixels.
    camera : Camera, optional
        Instead, one whose scale, and rays, are known; by default rays are parallel.
    y : {'up', 'down'}, optional
        Where y of the normals points in the image; by default up, or down where only that makes a
        surface of them, which a finding reports.

    Returns
    -------
    Reconstruction
        Its `normals_measured` are the given ones, with y up; its albedo is 1.

    Raises
    ------
    BadInput
        If they are no normals, sizes differ, or no surface has such normals.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[1:-1:80j, -1:1:80j]
    >>> ball = np.dstack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0.1))])
    >>> result = surface_of_normals(ball, x**2 + y**2 < 0.8, px_per_mm=4.0)
    >>> print(f"{np.nanmax(result.height_mm) - np.nanmin(result.height_mm):.1f} mm")
    5.5 mm
    """
    with refusing("`normals` must be numbers of the shape (H, W, 3)."):
        stored = np.asarray(normals)
        require(stored.ndim == 3 and stored.shape[2] == 3, "")
    shape = stored.shape[:2]
    check_value("`px_per_mm`", SCALES, px_per_mm)
    if camera is None:
        unknown = camera_without_scale(shape)
        camera = unknown if px_per_mm is None else Camera(float(px_per_mm), shape)
    require(
        camera.image_size == shape,
        f"the normal map has {shape[0]} x {shape[1]} pixels, but the camera"
        f" {camera.image_size[0]} x {camera.image_size[1]}.",
    )
    units = unit_vectors(stored, "`normals`")
    inside = check_mask(mask, shape) & units.any(axis=2)
    require(inside.any(), "the normal map has no normals inside the mask.")
    window = bounding_box(inside)
    units, here = units[window], inside[window]
    ratio = curl_ratio(units, here)
    down = y == "down" or (y is None and ratio > _CLEARLY)
    upward = units * np.array([1, -1 if down else 1, 1], dtype=np.float32)
    findings = notes_on_y(ratio, down, y is not None)
    view = view_of(camera, *window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(upward, -1, 0)[None])[0], 0, -1)
    slopes = gradients_from_normals(own, here, _MAX_SLOPE)
    height_px = piecewise(*slopes, here)
    deepest = float(np.hypot(*slopes).max()) * sum(here.any(axis=k).sum() for k in (0, 1))
    require(np.nanmax(height_px) - np.nanmin(height_px) <= max(deepest, 1.0), IMPOSSIBLE)
    height_mm = height_px * camera.pitch_mm
    shape_mm = smoothed(height_mm, here, SLOW_MM * camera.px_per_mm)
    facts = {"heights": "measured", "shape_source": "normal map", "y": "down" if down else "up"}
    albedo = np.ones(here.shape, dtype=np.float32)
    surface = FingerSurface(height_mm, height_mm - shape_mm, shape_mm, albedo, upward, facts=facts)
    finger = Finger(inside, inside, window, as_it_lies(inside), {}, {})
    observation = Observation(Rig(camera, ()), {}, "opaque")
    result = placed(FingerPhotographs(observation, finger, FingerSettings()), surface, 0.0)
    if not camera.scale_known:
        findings = (*findings, Finding("scale-unknown", UNKNOWN_SCALE))
    return replace(result, preset=PRESET, findings=worst_first(findings))


_MAX_SLOPE = 20.0
"""Steeper slopes are shortened to this (87 deg). Chosen on: the scans of two objects, whose normals
had a noise of 0 to 13 deg; 6 takes five times the error at 0. Range: 20 to 100."""
_CLEARLY = 1.5
"""Ratio of the curl with y up to that with y down, or the reverse, from which the direction of y is
decided."""


def curl_ratio(normals: FloatArray, inside: BoolArray) -> float:
    """Curl of the slopes of normals (h, w, 3) over that with y reversed: below 1 where y is
    right."""
    weight = inside * normals[..., 2] ** 4  # 1 / variance of a slope, of a normal's noise
    p, q = (smoothed(part, inside, 1.5) for part in gradients_from_normals(normals, inside))
    p_down, q_right = np.gradient(p, axis=0), np.gradient(q, axis=1)
    inner = cv2.erode(weight.astype(np.float32), np.ones((9, 9), np.uint8), borderValue=0)
    as_given, reversed_y = (np.sum(inner * np.abs(p_down + sign * q_right)) for sign in (1, -1))
    return float((as_given + 1e-9) / (reversed_y + 1e-9))


def notes_on_y(ratio: float, down: bool, stated: bool) -> tuple[Finding, ...]:
    """A note where y was found to point down, and a doubt where what was stated makes no
    surface."""
    way, reversed_way = ("down", "up") if down else ("up", "down")
    times = f"leaves {max(ratio, 1 / ratio):.1f} times as much curl in the slopes as"
    if not stated:
        text = f"y of the normal map is taken to point down, as y up {times} y down (`normals_y`)."
        return (Finding("normals-y", text),) if down else ()
    if (1 / ratio if down else ratio) < _CLEARLY:
        return ()
    text = f"y {way}, as `normals_y` states it, {times} y {reversed_way}, so that heights are wrong"
    return (Finding("normals-y", f"{text}.", Severity.DOUBT),)


def compared(
    result: Reconstruction, photographs: FingerPhotographs, photometric: Reconstruction
) -> Reconstruction:
    """A surface of given normals with the albedo of photographs, and the part of their light that
    no matt surface with these normals explains.

    A pixel contradicts the normals where the `photometric` ones, which the photographs themselves
    give, explain it better and differ from them by more than `CONTRADICTED_DEG`. The findings are
    those of the photographs, and the regions that contradict.
    """
    window = bounding_box(result.mask)
    inside = result.mask[window]
    given, measured = _known(result.normals_measured), _known(photometric.normals_measured)
    misfit, albedo = matt_misfit(photographs, result, given)
    own, _ = matt_misfit(photographs, result, measured)
    off_deg = _angle_deg(*(_smooth(part[window], inside) for part in (given, measured)))
    worse = smoothed(misfit - own, inside, CONTRADICTED_PX) > 0
    area = int(inside.sum())
    regions = _regions(inside & worse & (off_deg > CONTRADICTED_DEG), 0.01 * area)
    wrong = sum(region.pixels for region in regions) / area
    findings = [*result.findings, *photometric.findings]
    if regions:
        places = "; ".join(
            f"{100 * region.pixels / area:.0f} % about column {window[1].start + region.column},"
            f" row {window[0].start + region.row}"
            for region in regions[:3]
        )
        text = (
            f"the photographs contradict the normal map by more than {CONTRADICTED_DEG:g} deg on"
            f" {100 * wrong:.0f} % of the surface ({places}); misfit.png shows where."
        )
        findings.append(Finding("normals-contradicted", text, Severity.DOUBT))
    whole = np.full(result.mask.shape, np.nan, dtype=np.float32)
    of_albedo = whole.copy()
    whole[window], of_albedo[window] = misfit, albedo
    middle, of_own = (float(np.median(part[inside])) for part in (misfit, own))
    facts = {"misfit": middle, "photometric_misfit": of_own, "contradicted": wrong}
    return replace(
        result,
        albedo=of_albedo,
        misfit=whole,
        quality=photometric.quality,
        facts={**result.facts, **facts},
        findings=worst_first(findings),
        hashes={**result.hashes, **photometric.hashes},
    )


CONTRADICTED_DEG = 15.0
"""Angle between given and photometric normals. Chosen on: DiLiGenT's bear under 24 lights; about
two thirds of a region that is turned by 20 deg are found, and 1.3 % of its scanned normals exceed
it. Range: 10 to 20."""
CONTRADICTED_PX = 3.0
"""Gaussian over which both are averaged, sigma in pixels."""


def _known(normals: FloatArray | None) -> FloatArray:
    assert normals is not None  # of what is opaque
    return normals


def _smooth(normals: FloatArray, inside: BoolArray) -> FloatArray:
    parts = [smoothed(part, inside, CONTRADICTED_PX) for part in np.moveaxis(normals, -1, 0)]
    return np.stack(parts, axis=-1)


def _angle_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    """Angle between vectors (h, w, 3)."""
    lengths = np.linalg.norm(first, axis=2) * np.linalg.norm(second, axis=2)
    cosine = np.einsum("hwc,hwc->hw", first, second) / np.maximum(lengths, 1e-9)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def matt_misfit(
    photographs: FingerPhotographs, result: Reconstruction, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Part (h, w) of the light of a surface's window that is not that of a matt surface with these
    normals (H, W, 3), as rms over rms, and its albedo by least squares; NaN outside the mask.

    Clipped values do not count.
    """
    window = bounding_box(result.mask)
    light = photographs.observation.white.at(1, window)
    x, y = view_of(light.built.camera, *window).on_plane()
    z = result.height_mm[window]
    x, y = (np.broadcast_to(axis, z.shape) for axis in (x, y))
    if result.x_mm is not None and result.y_mm is not None:
        x, y = result.x_mm[window], result.y_mm[window]
    misfit, albedo = np.full_like(z, np.nan), np.full_like(z, np.nan)
    for part, strip in strips(light, channels=6):
        inside = result.mask[window][part]
        places = (axis[part][inside] for axis in (x, y, z))
        towards = light_vectors_at(light.rig, *places)  # (L, 3, n)
        facing = normals[window][part][inside]
        shading = np.maximum(np.einsum("kin,ni->kn", towards, facing), 0.0)
        images = strip.grey[:, inside]
        counted = ~strip.clipped[:, inside]
        power = np.einsum("kn,kn->n", counted * shading, shading)
        shade = np.einsum("kn,kn->n", counted * images, shading) / np.maximum(power, 1e-9)
        total = np.einsum("kn,kn->n", counted * images, images)
        left = np.einsum("kn,kn->n", counted, np.square(images - shade * shading))
        misfit[part][inside] = np.sqrt(left / np.maximum(total, 1e-12))
        albedo[part][inside] = shade
    return misfit, albedo


class _Region(NamedTuple):
    pixels: int
    column: int
    row: int  # of its middle


def _regions(mask: BoolArray, least: float) -> list[_Region]:
    """The connected parts of a mask of at least so many pixels, the largest first."""
    count, _, figures, middles = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    regions = [
        _Region(int(figures[k, cv2.CC_STAT_AREA]), round(middles[k][0]), round(middles[k][1]))
        for k in range(1, count)
    ]
    return sorted((each for each in regions if each.pixels >= least), reverse=True)
