"""Whether the LEDs stand where the rig states: their height and the middle of their ring, fitted
with the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from splitknit.diagnosis.parameters import (
    CLEAN_RESIDUAL,
    DARKENING,
    DARKENING_EXPONENT,
    DARKENING_SD,
    FEWEST_PLACED,
    INDEPENDENT_PLACES,
    NOTED_HEIGHT,
    NOTED_SHIFT_MM,
    PLACES_EXACT,
    PLACES_MM,
    PLACES_NOISE,
    PLACES_OF_SOUND,
    PLACES_PLANE_MM,
    PLACES_PRIOR,
    PLACES_ROUNDS,
    PLACES_STEPS,
    SAMPLED_MM,
    STEEPEST_NZ,
    SURE_HEIGHT,
    SURE_SHIFT_MM,
    UNFIT_RESIDUAL,
)
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.band import bin_mean, has_colour, linear_channels
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, Capture, FloatArray, Led, Rig
from splitknit.skin.light import fresnel_transmission


class LightPlaces(NamedTuple):
    """Where a ring of lights seems to stand."""

    height: float
    """Height of the lights over the stated one. A ring of another radius looks the same, by the
    inverse factor."""
    shift_mm: tuple[float, float]
    """x and y of the ring's middle beyond the stated one."""
    residual: float
    """Relative (rms)."""


def fitted_places(  # noqa: PLR0917
    stack: FloatArray, rig: Rig, mask: BoolArray, depth_mm: FloatArray, view: View, pitch_mm: float
) -> LightPlaces | None:
    """Fit the height and the middle of the lights together with the surface that they show.

    Each pixel's albedo and normal follow by least squares (variable projection: G. H. Golub and V.
    Pereyra, Inverse Problems 19, 2003), three Gauss-Newton unknowns are around them. Lights that
    are nearer to one side of the finger leave there what no normal explains; at a wrong height all
    slopes are off by one factor, and the albedo, the length of the least-squares solution, then
    changes with the slant (P. N. Belhumeur, D. J. Kriegman and A. L. Yuille, "The bas-relief
    ambiguity", IJCV 35, 1999).

    Parameters
    ----------
    stack : (L, h, w)
        Linear light on a coarse grid (0.5 to 1 mm), ridges smoothed away; `rig.leds[k]` lights
        image k.
    rig : Rig
        With near LEDs, all on one ring about the finger.
    mask, depth_mm : (h, w)
        The finger, and each pixel's distance from its outline in mm.
    view, pitch_mm
        Where the pixels look, and their size.

    Returns
    -------
    LightPlaces, or None where the lights are too few, distant or in mirrors, or too little of the
    finger is seen.
    """
    near = all(
        led.position_mm and led.shade is None and not any(each.reflected for each in led.also)
        for led in rig.leds
    )
    if len(rig.leds) < FEWEST_PLACED or not near:
        return None
    height_mm = np.zeros(mask.shape, dtype=np.float32)
    nz = np.zeros(mask.shape, dtype=np.float32)
    slopes = np.zeros((2, *mask.shape), dtype=np.float32)
    for _ in range(2):
        _, _, normals = _solved(stack, rig, view, height_mm, mask, np.zeros(3))
        nz[mask] = np.maximum(normals[:, 2], 0.15)
        slopes[:, mask] = -normals[:, :2].T / nz[mask]
        height_mm = np.nan_to_num(poisson(slopes[0], slopes[1], mask, nz)) * pitch_mm
    low, high = STEEPEST_NZ
    chosen = mask & (depth_mm > 1.0) & (nz > low)
    if chosen.sum() < 2 * INDEPENDENT_PLACES:
        return None
    weight = np.sqrt(np.clip((nz[chosen] - low) / (high - low), 0.02, 1.0)).astype(np.float64)
    scale = weight / (PLACES_NOISE * np.sqrt(weight.sum() / INDEPENDENT_PLACES))

    def residuals(unknowns: Array) -> Array:
        residual, albedo, n = _solved(stack, rig, view, height_mm, chosen, unknowns)
        columns = np.column_stack([weight, (1 - n[:, 2]) * weight])
        fall = np.linalg.lstsq(columns, np.log(albedo) * weight, rcond=None)[0][1]
        return np.concatenate(
            [
                (residual * scale).ravel(),
                [(fall + DARKENING) / DARKENING_SD],
                unknowns / PLACES_PRIOR,
            ]
        )

    unknowns = _least_squares(residuals, np.zeros(3))
    residual = _solved(stack, rig, view, height_mm, chosen, unknowns)[0]
    height, x_mm, y_mm = (float(each) for each in unknowns - PLACES_OF_SOUND)
    return LightPlaces(
        float(np.exp(height)), (x_mm, y_mm), float(np.sqrt((residual**2 * weight**2).mean()))
    )


def _least_squares(residuals: Callable[[Array], Array], unknowns: Array) -> Array:
    """Unknowns (3,) with the least sum of squares, by Gauss-Newton steps that are halved while it
    grows; importing ``scipy.optimize`` would take longer than the fit."""
    scale = np.array(PLACES_STEPS)
    now = residuals(unknowns)
    for _ in range(PLACES_ROUNDS):
        slopes = [(residuals(unknowns + step) - now) / step.sum() for step in np.diag(scale)]
        change = np.linalg.lstsq(np.column_stack(slopes), -now, rcond=None)[0]
        change = np.clip(change, -np.array(PLACES_PRIOR), PLACES_PRIOR)
        then = residuals(unknowns + change)
        while not then @ then <= now @ now and np.abs(change / scale).max() > PLACES_EXACT:
            change /= 2
            then = residuals(unknowns + change)
        unknowns, now = unknowns + change, then
        if np.abs(change / scale).max() <= PLACES_EXACT:
            break
    return unknowns


def _solved(  # noqa: PLR0917
    stack: FloatArray,
    rig: Rig,
    view: View,
    height_mm: FloatArray,
    where: BoolArray,
    unknowns: Array,
) -> tuple[Array, Array, Array]:
    """Relative residual (L, n), albedo (n,) and normals (n, 3) at the pixels `where`, under moved
    lights."""
    height = float(np.exp(unknowns[0]))

    def moved(led: Led) -> Led:
        assert led.position_mm is not None
        x, y, z = led.position_mm
        place = (x + unknowns[1], y + unknowns[2], z * height)
        return replace(led, position_mm=place, also=tuple(moved(each) for each in led.also))

    surface = (height_mm * height + PLACES_PLANE_MM).astype(np.float32)  # slopes go with the height
    field = light_vectors_at(replace(rig, leds=tuple(map(moved, rig.leds))), *view.points(surface))
    vectors = view.turned(field)[:, :, where].astype(np.float64)
    images = stack[:, where].astype(np.float64)
    length = np.sqrt((vectors * vectors).sum(axis=1))
    entering = np.ones_like(length)
    for _ in range(3):
        lights = vectors * entering[:, None]
        moments = np.einsum("kan,kbn->nab", lights, lights)
        g = np.linalg.solve(moments, np.einsum("kan,kn->na", lights, images)[..., None])[..., 0]
        albedo = np.maximum(np.sqrt((g * g).sum(axis=1)), 1e-12)
        normals = g / albedo[:, None]
        cosine = np.maximum(np.einsum("kan,na->kn", vectors, normals) / length, 0.05)
        entering = fresnel_transmission(cosine) * cosine**DARKENING_EXPONENT
    residual = (images - np.einsum("kan,na->kn", lights, g)) / np.maximum(
        images.mean(axis=0), 1e-12
    )
    return residual, albedo, normals


def findings_on_places(capture: Capture, finger: Finger) -> list[Finding]:
    """A doubt, or a note, where the white LEDs seem to stand elsewhere than the rig states."""
    band, camera = capture.bands["white"], capture.rig.camera
    if band.colours or any(led.position_mm is None for led in capture.rig.leds):
        return []
    every = max(1, round(SAMPLED_MM * camera.px_per_mm))
    binning = max(1, round(PLACES_MM * camera.px_per_mm / every))
    names = ("red", "green", "blue") if has_colour(band) else ("grey",)
    images = bin_mean(linear_channels(band.sampled(every), capture.encoding, names), binning)
    inside = bin_mean(finger.mask[::every, ::every].astype(np.float32), binning) > 0.99
    rows, columns = (n // (every * binning) for n in capture.shape)
    images, inside = images[..., :rows, :columns], inside[:rows, :columns]
    if not inside.any():
        return []
    stack = (
        images / np.maximum(images[..., inside].mean(axis=(1, 2)), 1e-9)[:, None, None, None]
    ).sum(axis=0)
    pitch_mm = every * binning * camera.pitch_mm
    depth_mm = (
        cv2.distanceTransform(np.pad(inside, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        * pitch_mm
    )
    view = view_of(camera, binning=every * binning, along_rays=True)
    rig = capture.rig.select(band.lights)
    places = fitted_places(stack, rig, inside, depth_mm, view, pitch_mm)
    doubt = places and doubt_of_places(places, rig)
    return [doubt] if doubt else []


def doubt_of_places(places: LightPlaces, rig: Rig) -> Finding | None:
    """A note where the fitted places clearly differ from the stated ones, a doubt where no sound
    finger's do so."""
    if places.residual > UNFIT_RESIDUAL:
        return None
    x, y = places.shift_mm
    shift_mm = float(np.hypot(x, y))
    stated = np.array([led.position_mm for led in rig.leds], dtype=np.float64)
    height_mm = float(stated[:, 2].mean())
    radius_mm = float(np.linalg.norm(stated[:, :2] - stated[:, :2].mean(axis=0), axis=1).mean())
    unsure = max(1.0, places.residual / CLEAN_RESIDUAL)
    factor = abs(np.log(places.height))
    words = []
    if factor > NOTED_HEIGHT * unsure:
        up = height_mm * (places.height - 1)
        wide = radius_mm * (1 / places.height - 1)
        words.append(
            f"the LEDs seem to be {abs(up):.0f} mm {'higher' if up > 0 else 'lower'} than the rig"
            f" states, or their ring {abs(wide):.0f} mm {'narrower' if up > 0 else 'wider'} in"
            f" radius (all heights are then {100 / places.height:.0f} % of the true ones)"
        )
    if shift_mm > NOTED_SHIFT_MM * unsure:
        words.append(
            f"the middle of the LEDs' ring seems to lie {shift_mm:.0f} mm from where the rig states"
            f" (x {x:+.0f}, y {y:+.0f} mm), which tilts the surface by"
            f" {np.rad2deg(np.arctan(shift_mm / height_mm)):.0f} deg"
        )
    if not words:
        return None
    severity = Severity.DOUBT if factor > SURE_HEIGHT or shift_mm > SURE_SHIFT_MM else Severity.NOTE
    return Finding(
        "led-places", f"{'; '.join(words)}: measure position_mm, or calibrate the lights.", severity
    )
