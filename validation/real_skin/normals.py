"""Curl and creases of measured normals, on simulated fingers: ``python validation/real_skin/normals.py [SEED ...]``.

Published normals of two people's finger knuckles (seven LEDs, plain least squares) are not those of any surface: their
slopes have a curl (rms over the mask) of 0.6 to 0.8 of their divergence. And their albedo falls with curvature
(correlation -0.46 to -0.50): creases are dark. Here the same is measured on the simulator's photographs, with single
parts of the simulation switched on, off, or made worse. The white band, grey, distant lights, least squares; slopes
averaged over 0.07, 0.13 and 0.27 mm.

- curl: rms of d(dz/dx)/dy - d(dz/dy)/dx over rms of their sum of second derivatives (the divergence);
- curvature: mean curvature of the integrated surface, positive in valleys; correlation with the albedo that least
  squares gives, over the mask, and where a flexion crease runs (2 mm on each side) alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.imaging.band import linear_stack
from splitknit.imaging.geometry import gradients_from_normals, height_gradients
from splitknit.integration.poisson import poisson
from splitknit.photometric.lambertian import lambertian
from splitknit_simulator.finger.finger import SimulatedFinger, draw_finger
from splitknit_simulator.twin import simulate_capture

RESULTS = Path(__file__).with_name("normals.json")
SEEDS = (1000, 1001)
SCALE = 0.2
"""15 pixels a millimetre."""
AVERAGED = (1, 2, 4)
"""Pixels a side."""
CREASE_MM = 2.0
Array = NDArray[Any]


def dark_creases(finger: SimulatedFinger) -> SimulatedFinger:
    """The finger with creases that lose two and a half times as much light."""
    creases = tuple(replace(one, darkening=min(2.5 * one.darkening, 0.8)) for one in finger.skin.creases)
    return replace(finger, skin=replace(finger.skin, creases=creases))


def dark_valleys(capture: Any, truth: Mapping[str, Any]) -> Any:
    """Every valley darker, by 1 % a micrometre below its surroundings (sigma 0.3 mm), as blood or dirt might be."""
    relief = np.where(truth["mask"], truth["height_mm"] - truth["shape_mm"], 0.0)
    deep = ndimage.gaussian_filter(relief, 0.3 * capture.rig.camera.px_per_mm) - relief
    return _multiplied(capture, np.exp(-10.0 * np.clip(deep, 0.0, 0.1))[None])


def shadows(capture: Any, truth: Mapping[str, Any], elevation_deg: float = 25.0) -> Any:
    """Light that comes as low as `elevation_deg`: what is hidden from it along its azimuth is dark (half of it)."""
    height, pitch = np.where(truth["mask"], truth["height_mm"], -20.0), capture.rig.camera.pitch_mm
    lit = []
    for led in [capture.rig.leds[k[0]] for k in capture.bands["white"].leds]:
        x, y, _ = led.position_mm
        x, y = np.array([x, y]) / np.hypot(x, y)
        hidden = np.zeros(height.shape, dtype=bool)
        for step in np.arange(pitch, 1.5, pitch):
            ahead = ndimage.shift(height, (step * y / pitch, -step * x / pitch), order=1, mode="nearest")
            hidden |= ahead - height > step * np.tan(np.deg2rad(elevation_deg))
        lit.append(1.0 - 0.5 * hidden)
    return _multiplied(capture, np.stack(lit))


def _multiplied(capture: Any, factor: Array) -> Any:
    white = capture.bands["white"]
    pixels = np.clip(np.round(white.pixels * factor[..., None]), 0, 255).astype(np.uint8)
    return replace(capture, bands={"white": replace(white, pixels=pixels)})


VARIANTS: dict[str, dict[str, Any]] = {
    "as simulated": {},
    "no noise, 16 bits": {"settings": {"sensor.noise": False, "sensor.bits": 16, "sensor.raw_bits": 16}},
    "no specular reflection": {"settings": {"skin.glare": [0, 0]}},
    "twice the specular reflection": {"settings": {"skin.glare": [2, 2]}},
    "lights 5 deg wrong": {"wrong_deg": 5.0},
    "brightness of LEDs unknown (10 %)": {"equal": True},
    "finger moves by 0.05 mm": {"settings": {"motion.amplitude_mm": 0.05}},
    "finger moves by 0.2 mm": {"settings": {"motion.amplitude_mm": 0.2}},
    "creases 2.5 times as dark": {"finger": dark_creases},
    "valleys darker": {"change": dark_valleys},
    "cast shadows, light from 25 deg": {"change": shadows},
}


def measured(seed: int, variant: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Figures of one finger by pixels' side."""
    finger = draw_finger(seed)
    maker: Callable[[SimulatedFinger], SimulatedFinger] | None = variant.get("finger")
    settings = {"scale": SCALE, **variant.get("settings", {})}
    capture, truth = simulate_capture(seed, settings=settings, finger=maker(finger) if maker else finger)
    if "change" in variant:
        capture = variant["change"](capture, truth)
    band = capture.bands["white"]
    stack = linear_stack(band, capture.encoding)
    lights = capture.rig.select(band.leds).light_vectors()
    rng = np.random.default_rng([seed, 71])
    lights = lights + np.deg2rad(variant.get("wrong_deg", 0.0)) * rng.standard_normal(lights.shape) / np.sqrt(2.0)
    if variant.get("equal"):
        lights = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    return {f"{side}": _figures(stack, lights, truth, capture.rig.camera.pitch_mm, side) for side in AVERAGED}


def _figures(stack: Array, lights: Array, truth: Mapping[str, Any], pitch_mm: float, side: int) -> dict[str, float]:
    rows, columns = (length // side for length in stack.shape[1:])
    small = np.stack([cv2.resize(one, (columns, rows), interpolation=cv2.INTER_AREA) for one in stack])
    weight = cv2.resize(truth["mask"].astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    mask, pitch = weight > 0.99, pitch_mm * side
    normals, albedo = lambertian(small, lights, mask)
    right, up = gradients_from_normals(normals, mask, 3.0)
    xx, xy = height_gradients(np.where(mask, right, np.nan).astype(np.float32), pitch)
    yx, yy = height_gradients(np.where(mask, up, np.nan).astype(np.float32), pitch)
    inner = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch > 0.6
    inner &= normals[..., 2] > 0.5
    height = poisson(right, up, mask) * np.float32(pitch)
    gx, gy = height_gradients(height, pitch)
    length = np.sqrt(1.0 + gx**2 + gy**2)
    parts = (np.where(mask, part / length, np.nan).astype(np.float32) for part in (gx, gy))
    one, two = parts
    curvature = 0.5 * (height_gradients(one, pitch)[0] + height_gradients(two, pitch)[1])
    near = np.zeros(truth["mask"].shape, dtype=np.uint8)
    for name, places in truth.items():
        if name.startswith("landmark_crease_px"):
            for x, y in np.asarray(places).reshape(-1, 2):
                cv2.circle(near, (int(x), int(y)), round(CREASE_MM / pitch_mm), 1, -1)
    crease = inner & (cv2.resize(near, (columns, rows), interpolation=cv2.INTER_NEAREST) > 0)
    found = {"curl": float(np.std((xy - yx)[inner]) / np.std((xx + yy)[inner]))}
    found["albedo"] = float(np.corrcoef(albedo[inner], curvature[inner])[0, 1])
    found["crease_curl"] = float(np.std((xy - yx)[crease]) / np.std((xx + yy)[crease])) if crease.any() else np.nan
    found["crease_albedo"] = float(np.corrcoef(albedo[crease], curvature[crease])[0, 1]) if crease.any() else np.nan
    return {name: round(value, 3) for name, value in found.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure every variant and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="*", default=SEEDS)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    results: dict[str, Any] = json.loads(options.out.read_text()) if options.out.is_file() else {}
    for name, variant in VARIANTS.items():
        for seed in options.seeds:
            if str(seed) not in results.setdefault(name, {}):
                results[name][str(seed)] = measured(seed, variant)
                options.out.write_text(json.dumps(results, indent=1) + "\n")
        print(f"{name} done", file=sys.stderr, flush=True)
    heads = [f"{0.066 * side:.2f} mm: curl, albedo (crease alone)" for side in AVERAGED]
    print(f"| simulated | {' | '.join(heads)} |")
    print(f"|{' --- |' * (1 + len(AVERAGED))}")
    for name, fingers in results.items():
        cells = []
        for side in AVERAGED:
            rows = [one[str(side)] for one in fingers.values()]
            of = {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}
            cells.append(f"{of['curl']:.2f}, {of['albedo']:+.2f} ({of['crease_curl']:.2f}, {of['crease_albedo']:+.2f})")
        print(f"| {name} | {' | '.join(cells)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
