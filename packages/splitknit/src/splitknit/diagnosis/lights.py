"""Whether the LEDs stand where the rig states: their height and the middle of their ring, fitted with the surface."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.band import bin_mean, has_colour, linear_channels
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, Capture, FloatArray, Led, Rig
from splitknit.skin.light import fresnel_transmission

_SAMPLED_MM, PLACES_MM = 0.1, 0.8
"""Distance of the pixels, and side of their blocks, in which the lights' places are looked for: ridges are smaller."""
_FEWEST = 6
"""Lights from which three of each pixel's values are spare."""
_PLANE_MM = 1.0
"""Assumed mean height of the skin above the finger plane."""
_STEEPEST_NZ = (0.5, 0.65)
"""z component of the normals between which a pixel comes to count."""
_CURVE = 0.15
"""Exponent of the cosine by which skin darkens beside Fresnel's law: 0.1 to 0.4 fit sound fingers."""
_DARKENING, _DARKENING_SD = 0.3, 0.04
"""Fall of the logarithm of the albedo over 1 - n_z on sound fingers, and its weight: of 0.015, 0.04 and 0.12 the one
with the narrowest heights on 80 simulated fingers."""
_LEFT, _INDEPENDENT = 0.005, 60.0
"""Light left over on sound fingers, relative, and number of places whose rests do not depend on each other."""
_PRIOR = np.array([0.7, 25.0, 25.0])
"""Standard deviations of the three unknowns: logarithm of the height's factor, mm, mm."""
_STEPS = np.array([0.02, 0.5, 0.5])
_OF_SOUND = np.array([0.0, 0.0, -1.5])
"""What is fitted to sound fingers (mean), which scattering and the finger's shape leave."""
_UNFIT = 0.025
"""Light left over from which places do not follow: 0.003 to 0.023 on dry fingers, up to 0.13 on wet ones."""
_HEIGHT, _SHIFT_MM, _CLEAN = 0.18, 6.0, 0.012
"""Logarithm of the height's factor, and shift, that are doubted: sound fingers have -0.09 to 0.15, glossy ones 0.19,
and up to 5.8 mm. Where more light is left than `_CLEAN`, both limits grow with it."""


_SURE_HEIGHT, _SURE_SHIFT_MM = 0.4, 13.0
"""The same from which they are doubted and not merely noted: of some 230 sound fingers in all conditions
and tones of skin one had 0.35, five others up to 0.22 and 11 mm."""


class LightPlaces(NamedTuple):
    """Where a ring of lights seems to stand."""

    height: float
    """Height of the lights over the stated one. A ring of another radius looks the same, by the inverse factor."""
    shift_mm: tuple[float, float]
    """x and y of the ring's middle beyond the stated one."""
    residual: float
    """Light that is left, relative (rms)."""


def fitted_places(  # noqa: PLR0917
    stack: FloatArray, rig: Rig, mask: BoolArray, depth_mm: FloatArray, view: View, pitch_mm: float
) -> LightPlaces | None:
    """Fit the height and the middle of the lights together with the surface that they show.

    Each pixel's albedo and normal follow by least squares (variable projection: G. H. Golub and V. Pereyra, Inverse
    Problems 19, 2003), three Gauss-Newton unknowns are around them. Lights that are nearer to one side of the finger
    leave there what no normal explains; at a wrong height all slopes are off by one factor, and the albedo, the length
    of the least-squares solution, then changes with the slant (P. N. Belhumeur, D. J. Kriegman and A. L. Yuille, "The
    bas-relief ambiguity", IJCV 35, 1999).

    Parameters
    ----------
    stack : (L, h, w)
        Linear light on a coarse grid (0.5 to 1 mm), ridges smoothed away; `rig.leds[k]` lights image k.
    rig : Rig
        With near LEDs, all on one ring about the finger.
    mask, depth_mm : (h, w)
        The finger, and each pixel's distance from its outline in mm.
    view, pitch_mm
        Where the pixels look, and their size.

    Returns
    -------
    LightPlaces, or None where the lights are too few, distant or in mirrors, or too little of the finger is seen.
    """
    plain = all(
        led.position_mm and led.shade is None and not any(one.reflected for one in led.also) for led in rig.leds
    )
    if len(rig.leds) < _FEWEST or not plain:
        return None
    height_mm = np.zeros(mask.shape, dtype=np.float32)
    inside = mask.copy()
    stated = np.zeros(3)
    for _ in range(2):
        _, _, normals = _solved(stack, rig, view, height_mm, inside, stated)
        nz = np.zeros(mask.shape, dtype=np.float32)
        nz[inside] = np.maximum(normals[:, 2], 0.15)
        slopes = [np.zeros(mask.shape, dtype=np.float32) for _ in range(2)]
        for axis, slope in enumerate(slopes):
            slope[inside] = -normals[:, axis] / nz[inside]
        height_mm = np.nan_to_num(poisson(slopes[0], slopes[1], mask, nz)) * pitch_mm
    low, high = _STEEPEST_NZ
    chosen = mask & (depth_mm > 1.0) & (nz > low)
    if chosen.sum() < 2 * _INDEPENDENT:
        return None
    weight = np.sqrt(np.clip((nz[chosen] - low) / (high - low), 0.02, 1.0)).astype(np.float64)
    share = weight / (_LEFT * np.sqrt(weight.sum() / _INDEPENDENT))

    def rest(unknowns: Array) -> Array:
        left, albedo, n = _solved(stack, rig, view, height_mm, chosen, unknowns)
        columns = np.column_stack([weight, (1 - n[:, 2]) * weight])
        fall = np.linalg.lstsq(columns, np.log(albedo) * weight, rcond=None)[0][1]
        of_albedo = [(fall + _DARKENING) / _DARKENING_SD]
        return np.concatenate([(left * share).ravel(), of_albedo, unknowns / _PRIOR])

    unknowns, now = stated, rest(stated)
    for _ in range(6):
        slope = np.column_stack([(rest(unknowns + step) - now) / step.sum() for step in np.diag(_STEPS)])
        move = -np.linalg.lstsq(slope, now, rcond=None)[0]
        trial = rest(unknowns + move)
        while trial @ trial > now @ now and np.abs(move / _STEPS).max() > 0.1:
            move = move / 2
            trial = rest(unknowns + move)
        if trial @ trial >= now @ now:
            break
        unknowns, now = unknowns + move, trial
        if np.abs(move / _STEPS).max() < 0.2:
            break
    left = _solved(stack, rig, view, height_mm, chosen, unknowns)[0]
    found = unknowns - _OF_SOUND
    return LightPlaces(
        float(np.exp(found[0])), (float(found[1]), float(found[2])), float(np.sqrt((left**2 * weight**2).mean()))
    )


def _solved(  # noqa: PLR0917
    stack: FloatArray, rig: Rig, view: View, height_mm: FloatArray, where: BoolArray, unknowns: Array
) -> tuple[Array, Array, Array]:
    """Light left over (L, n), relative, albedo (n,) and normals (n, 3) at the pixels `where`, under moved lights."""
    raised = float(np.exp(unknowns[0]))
    moved = replace(rig, leds=tuple(_moved(led, raised, unknowns[1], unknowns[2]) for led in rig.leds))
    surface = (height_mm * raised + _PLANE_MM).astype(np.float32)  # slopes go with the height
    vectors = view.turned(light_vectors_at(moved, *view.points(surface)))[:, :, where].astype(np.float64)
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
        entering = fresnel_transmission(cosine) * cosine**_CURVE
    left = (images - np.einsum("kan,na->kn", lights, g)) / np.maximum(images.mean(axis=0), 1e-12)
    return left, albedo, normals


def _moved(led: Led, raised: float, x_mm: float, y_mm: float) -> Led:
    assert led.position_mm is not None
    x, y, z = led.position_mm
    also = tuple(_moved(one, raised, x_mm, y_mm) for one in led.also)
    return replace(led, position_mm=(x + x_mm, y + y_mm, z * raised), also=also)


def findings_on_places(capture: Capture, finger: Finger) -> list[Finding]:
    """A doubt, or a note, where the white LEDs seem to stand elsewhere than the rig states."""
    band, camera = capture.bands["white"], capture.rig.camera
    if band.colours or any(led.position_mm is None for led in capture.rig.leds):
        return []
    every = max(1, round(_SAMPLED_MM * camera.px_per_mm))
    binning = max(1, round(PLACES_MM * camera.px_per_mm / every))
    names = ("red", "green", "blue") if has_colour(band) else ("grey",)
    images = bin_mean(linear_channels(band.sampled(every), capture.encoding, names), binning)
    inside = bin_mean(finger.mask[::every, ::every].astype(np.float32), binning) > 0.99
    rows, columns = (n // (every * binning) for n in capture.shape)
    images, inside = images[..., :rows, :columns], inside[:rows, :columns]
    if not inside.any():
        return []
    levelled = (image / max(float(image[:, inside].mean()), 1e-9) for image in images)
    stack = sum(levelled, np.zeros_like(images[0]))
    pitch_mm = every * binning * camera.pitch_mm
    depth_mm = cv2.distanceTransform(np.pad(inside, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch_mm
    view = view_of(camera, binning=every * binning, along_rays=True)
    rig = capture.rig.select(band.lights)
    places = fitted_places(stack, rig, inside, depth_mm, view, pitch_mm)
    doubt = None if places is None else doubt_of_places(places, rig)
    return [] if doubt is None else [doubt]


def doubt_of_places(places: LightPlaces, rig: Rig) -> Finding | None:
    """A note where the fitted places clearly differ from the stated ones, a doubt where no sound finger's do so."""
    if places.residual > _UNFIT:
        return None
    (x, y), stated = places.shift_mm, np.array([led.position_mm for led in rig.leds], dtype=np.float64)
    height_mm, away_mm = float(stated[:, 2].mean()), float(np.hypot(x, y))
    radius_mm = float(np.linalg.norm(stated[:, :2] - stated[:, :2].mean(axis=0), axis=1).mean())
    unsure = max(1.0, places.residual / _CLEAN)
    wrong = []
    if abs(np.log(places.height)) > _HEIGHT * unsure:
        up, wide = height_mm * (places.height - 1), radius_mm * (1 / places.height - 1)
        words = ("higher", "narrower") if up > 0 else ("lower", "wider")
        wrong.append(
            f"the LEDs seem to be {abs(up):.0f} mm {words[0]} than the rig states, or their ring {abs(wide):.0f} mm "
            f"{words[1]} in radius (all heights are then {100 / places.height:.0f} % of the true ones)"
        )
    if away_mm > _SHIFT_MM * unsure:
        wrong.append(
            f"the middle of the LEDs' ring seems to lie {away_mm:.0f} mm from where the rig states (x {x:+.0f}, "
            f"y {y:+.0f} mm), which tilts the surface by {np.rad2deg(np.arctan(away_mm / height_mm)):.0f} deg"
        )
    if not wrong:
        return None
    sure = abs(np.log(places.height)) > _SURE_HEIGHT or away_mm > _SURE_SHIFT_MM
    sentence = f"{'; '.join(wrong)}: measure position_mm, or calibrate the lights."
    return Finding("led-places", sentence, Severity.DOUBT if sure else Severity.NOTE)
