"""Whether the LEDs stand at their stated places: height and middle of a finger's ring, fitted with
the surface; places of near lights whose directions alone were stated, by the ground beside a thing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from splitknit.diagnosis.samples import SKIN_MM, in_blocks
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.finger.regions import depth_inside
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.pixels import bin_mean
from splitknit.imaging.view import View
from splitknit.integration.poisson import poisson
from splitknit.model import Array, BoolArray, FloatArray, Led, Rig
from splitknit.observation.observe import Observation
from splitknit.photometric.equations import length, shading, solve, unit_normals
from splitknit.photometric.places import GROUND_POINTS, places_by_ground, plain_ground
from splitknit.skin.light import fresnel_transmission

EXPLAINED = 0.2
"""Logarithm of the ground's misfit under distant lights over that under near ones, where these were
not fitted, from which lights are near: 0.46 on a photographed dome, -0.02 to 0.01 on 14 rendered
sets of distant lights. Range: 0.01 to 0.46."""
_SURROUNDINGS = 0.1  # of an object, over the root of its area: what it shades or reflects light on
CERTAIN = 0.3  # 95 % interval of a place over its distance, at most
NEAR = (
    "the lights are near: the ground beside the object puts them on a dome of {:.0f} mm radius,"
    " each +-{:.0f} mm (95 %), and these places are used; if the ground is not flat and matt,"
    " measure them (`calibrate lights`), or keep the directions (`lights.places` stated)."
)

ELSEWHERE = (
    "the ground shows another light than the stated one in {}: check these files, and the order of"
    " the lights."
)
_ODD = 2.8
"""Deviation of a light from its stated direction over the median light's, from which a photograph
is under another one: up to 2.0 on two sound sets, up to 3.0 where neighbours are exchanged, which
the fitted places undo. Chosen on: a photographed coin with its ground."""


def with_places_by_ground(
    observation: Observation, finger: Finger
) -> tuple[Observation, dict[str, Any], list[Finding]]:
    """Photographs of an opaque thing whose lights were stated as directions, with places where the
    ground shows that they are near; facts, and a finding.
    """
    white, camera = observation.white, observation.rig.camera
    leds = white.rig.leds
    near = any(led.position_mm or led.also for led in leds)
    if white.flattened or near or white.colours or not camera.scale_known:
        return observation, {}, []
    step = math.ceil(math.sqrt(finger.mask.size / GROUND_POINTS))
    stack = white.at(step, (slice(None), slice(None))).grey
    stack /= np.array([led.intensity for led in leds], dtype=np.float32)[:, None, None]
    margin = 2 * round(_SURROUNDINGS * math.sqrt(finger.mask.sum()) / step) + 1
    around = np.ones((margin, margin), np.uint8)
    covered = cv2.dilate(bin_mean(finger.mask.astype(np.float32), step), around) > 0
    ground = plain_ground(stack, step, camera, covered)
    if ground is None:
        return observation, {}, []
    picture_mm = max(camera.image_size) * camera.pitch_mm
    fit, explained = places_by_ground(white.rig.light_vectors(), ground, picture_mm)
    places = fit.places_mm
    interval_mm = float(np.median(fit.interval_mm))
    distance_mm = float(np.median(np.linalg.norm(places, axis=1)))
    if explained < EXPLAINED or interval_mm > CERTAIN * distance_mm:
        return observation, {}, []
    moved = {
        led: replace(led, direction=None, position_mm=(x, y, z), lobe_exponent=fit.lobe_exponent)
        for led, (x, y, z) in zip(leds, places.tolist(), strict=True)
    }
    rig = replace(observation.rig, leds=tuple(moved.get(led, led) for led in observation.rig.leds))
    facts = {
        "light_places_mm": np.round(places, 2).tolist(),
        "light_places_sd": round(interval_mm / 1.96 / distance_mm, 4),
    }
    findings = [Finding("near-lights", NEAR.format(fit.dome_mm[3], interval_mm))]
    odd = np.flatnonzero(fit.off_stated > _ODD * max(float(np.median(fit.off_stated)), 0.25))
    if odd.size:
        files = tuple(white.image_names[k] for k in odd)
        words = ELSEWHERE.format(", ".join(files))
        findings.append(Finding("light-order", words, Severity.DOUBT, files))
    return observation.under(rig), facts, findings


class LightPlaces(NamedTuple):
    """Where a ring of lights seems to stand."""

    height: float
    """Height of the lights over the stated one. A ring of another radius looks the same, by the
    inverse factor."""
    shift_mm: tuple[float, float]
    """x and y of the ring's middle beyond the stated one."""
    residual: float
    """Relative (rms)."""


_STEEPEST_NZ = (0.5, 0.65)  # z component of the normals between which a pixel comes to count
_DARKENING = 0.3
"""Fall of the logarithm of the albedo over 1 - n_z on sound fingers. Chosen on: simulated
fingers."""
_DARKENING_SD = 0.04
"""Standard deviation of that fall: among 0.015, 0.04 and 0.12 the one that scatters the estimated
heights least on 80 simulated fingers. Chosen on: simulated fingers (80)."""
_PLACES_NOISE = 0.005
"""Relative residual on sound fingers. Chosen on: simulated fingers."""
_INDEPENDENT_PLACES = 60.0  # number of places whose residuals do not depend on each other
_PLACES_PRIOR = (0.7, 25.0, 25.0)
"""Standard deviations of the three unknowns: logarithm of the height's factor, and both shifts, in
none, mm, mm."""
_PLACES_STEPS = (0.02, 0.5, 0.5)
"""Steps of the numerical derivatives by the three unknowns, in none, mm, mm."""
_PLACES_OF_SOUND = (0.0, 0.0, -1.5)
"""Mean of the three unknowns fitted to sound fingers, a bias by scattering and the finger's shape,
in none, mm, mm. Chosen on: simulated fingers."""


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
    if len(rig.leds) < 6 or not near:  # lights from which three of each pixel's values are spare
        return None
    height_mm = np.zeros(mask.shape, dtype=np.float32)
    nz = np.zeros(mask.shape, dtype=np.float32)
    slopes = np.zeros((2, *mask.shape), dtype=np.float32)
    for _ in range(2):
        _, _, normals = _solved(stack, rig, view, height_mm, mask, np.zeros(3))
        nz[mask] = np.maximum(normals[2], 0.15)
        slopes[:, mask] = -normals[:2] / nz[mask]
        height_mm = np.nan_to_num(poisson(slopes[0], slopes[1], mask, nz)) * pitch_mm
    low, high = _STEEPEST_NZ
    chosen = mask & (depth_mm > 1.0) & (nz > low)
    if chosen.sum() < 2 * _INDEPENDENT_PLACES:
        return None
    weight = np.sqrt(np.clip((nz[chosen] - low) / (high - low), 0.02, 1.0)).astype(np.float64)
    scale = weight / (_PLACES_NOISE * np.sqrt(weight.sum() / _INDEPENDENT_PLACES))

    def residuals(unknowns: Array) -> Array:
        residual, albedo, n = _solved(stack, rig, view, height_mm, chosen, unknowns)
        columns = np.column_stack([weight, (1 - n[2]) * weight])
        fall = np.linalg.lstsq(columns, np.log(albedo) * weight, rcond=None)[0][1]
        return np.concatenate(
            [
                (residual * scale).ravel(),
                [(fall + _DARKENING) / _DARKENING_SD],
                unknowns / _PLACES_PRIOR,
            ]
        )

    unknowns = np.zeros(3)
    for _ in range(6):  # two suffice where the lights stand as stated
        now = residuals(unknowns)
        slope = np.column_stack(
            [(residuals(unknowns + step) - now) / step.sum() for step in np.diag(_PLACES_STEPS)]
        )
        unknowns += np.linalg.lstsq(slope, -now, rcond=None)[0]
    residual = _solved(stack, rig, view, height_mm, chosen, unknowns)[0]
    height, x_mm, y_mm = (float(each) for each in unknowns - _PLACES_OF_SOUND)
    return LightPlaces(
        float(np.exp(height)), (x_mm, y_mm), float(np.sqrt((residual**2 * weight**2).mean()))
    )


_DARKENING_EXPONENT = 0.15
"""Exponent of the cosine by which skin darkens beside Fresnel's law: 0.1 to 0.4 fit sound fingers.
Chosen on: simulated fingers. Range: 0.1 to 0.4."""


def _solved(  # noqa: PLR0917
    stack: FloatArray,
    rig: Rig,
    view: View,
    height_mm: FloatArray,
    where: BoolArray,
    unknowns: Array,
) -> tuple[Array, Array, Array]:
    """Relative residual (L, n), albedo (n,) and normals (3, n) at the pixels `where`, under moved
    lights."""
    height = float(np.exp(unknowns[0]))

    def moved(led: Led) -> Led:
        assert led.position_mm is not None
        x, y, z = led.position_mm
        place = (x + unknowns[1], y + unknowns[2], z * height)
        return replace(led, position_mm=place, also=tuple(moved(each) for each in led.also))

    surface = (height_mm * height + SKIN_MM).astype(np.float32)  # slopes go with the height
    field = light_vectors_at(replace(rig, leds=tuple(map(moved, rig.leds))), *view.points(surface))
    vectors = view.turned(field)[:, :, where].astype(np.float64)
    images = stack[:, where].astype(np.float64)
    lights = vectors
    for _ in range(3):
        g = solve(images, lights, None)
        normals, albedo = unit_normals(g)
        cosine = np.maximum(shading(normals, vectors) / length(np.moveaxis(vectors, 1, 0)), 0.05)
        entering = fresnel_transmission(cosine) * cosine**_DARKENING_EXPONENT
        residual = (images - shading(g, lights)) / np.maximum(images.mean(axis=0), 1e-12)
        lights = vectors * entering[:, None]
    return np.asarray(residual), np.maximum(albedo, 1e-12), np.asarray(normals, np.float64)


def findings_on_places(observation: Observation, finger: Finger) -> list[Finding]:
    """A doubt, or a note, where the white LEDs seem to stand elsewhere than the rig states."""
    white, camera = observation.white, observation.rig.camera
    if white.colours or any(led.position_mm is None for led in observation.rig.leds):
        return []
    # side of the blocks of pixels in which the lights' places are looked for: ridges are smaller
    blocks = in_blocks(white, finger.mask, finger.window, max(1, round(0.8 * camera.px_per_mm)))
    inside = blocks.inside
    if not inside.any():
        return []
    images = blocks.light.stack
    images /= np.maximum(images[..., inside].mean(axis=(1, 2)), 1e-9)[:, None, None, None]
    pitch_mm = blocks.light.pitch_mm
    depth_mm = depth_inside(inside) * pitch_mm
    rig = white.rig
    places = fitted_places(images.sum(axis=0), rig, inside, depth_mm, blocks.view, pitch_mm)
    doubt = places and doubt_of_places(places, rig)
    return [doubt] if doubt else []


_UNFIT_RESIDUAL = 0.025
"""Residual from which places do not follow: 0.003 to 0.023 on dry fingers, up to 0.13 on wet ones.
Chosen on: simulated fingers (in all conditions)."""
_NOTED_HEIGHT = 0.18
"""Logarithm of the height's factor that is noted: sound fingers have -0.09 to 0.15, glossy ones
0.19. Chosen on: simulated fingers (in all conditions)."""
_NOTED_SHIFT_MM = 6.0
"""Shift that is noted: sound fingers have up to 5.8 mm. Chosen on: simulated fingers (in all
conditions)."""
_SURE_HEIGHT = 0.4
"""Logarithm of the height's factor that is doubted: of the sound fingers one had 0.35, five others
up to 0.22 and shifts of up to 11 mm. Chosen on: simulated fingers (some 230 in all conditions and
tones of skin)."""
_SURE_SHIFT_MM = 13.0
"""Shift that is doubted. Chosen on: simulated fingers (some 230 in all conditions and tones of
skin)."""


def doubt_of_places(places: LightPlaces, rig: Rig) -> Finding | None:
    """A note where the fitted places clearly differ from the stated ones, a doubt where no sound
    finger's do so."""
    if places.residual > _UNFIT_RESIDUAL:
        return None
    x, y = places.shift_mm
    shift_mm = float(np.hypot(x, y))
    # the noted height and shift grow with a residual above this
    unsure = max(1.0, places.residual / 0.012)
    factor = abs(np.log(places.height))
    words = []
    if factor > _NOTED_HEIGHT * unsure:
        words.append(
            f"the LEDs seem to be {places.height:.2f} times as high as the rig states, or their"
            f" ring {1 / places.height:.2f} times as wide (all heights are then"
            f" {100 / places.height:.0f} % of the true ones)"
        )
    if shift_mm > _NOTED_SHIFT_MM * unsure:
        height_mm = np.mean([led.position_mm[2] for led in rig.leds if led.position_mm])
        words.append(
            f"the middle of the LEDs' ring seems to lie {shift_mm:.0f} mm from where the rig states"
            f" (x {x:+.0f}, y {y:+.0f} mm), which tilts the surface by"
            f" {np.rad2deg(np.arctan(shift_mm / height_mm)):.0f} deg"
        )
    if not words:
        return None
    severity = (
        Severity.DOUBT if factor > _SURE_HEIGHT or shift_mm > _SURE_SHIFT_MM else Severity.NOTE
    )
    return Finding(
        "led-places", f"{'; '.join(words)}: measure position_mm, or calibrate the lights.", severity
    )
