"""The heights that films measure, and their stated error, on drawn specular images: seconds a
finger, no random walk.

    python validation/path_traced/drawn_films.py [--names a,b,...] [--lights 14]

Only the films' step of `metric` runs (:func:`splitknit.skin.polarised.polarised_heights`). What
films leave is drawn: GGX facets finer than a pixel, cast shadows under lights from the side, films,
once-scattered light, the lens's blur, noise. The step's start, a network's in the program, is drawn
from the truth, with errors like a network's, and up to 3 mm too low or high. Constants of the
stated error were chosen on a, c, g, i and j.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.geometry import nearest_known
from splitknit.model import Rig
from splitknit.nominal import default_rig
from splitknit.skin.grid import Grid
from splitknit.skin.light import slant_of
from splitknit.skin.polarised import SpecularImages, polarised_heights
from splitknit_simulator.finger.finger import FingerPose, draw_finger
from splitknit_simulator.light.films import FilmSettings, mounted_films
from splitknit_simulator.light.lighting import dot, towards
from splitknit_simulator.light.skin import fresnel
from splitknit_simulator.rigs import with_side_lights
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import lay_down

sys.path.insert(0, str(Path(__file__).parent))

from score import score
from walked_finger import LENS_PX, pixel_means, pixel_places, reflected, specular

Array = NDArray[np.floating[Any]]
IMAGE_SIZE = (420, 520)
SCALE = 0.5
OVERSAMPLING = 2
"""Samples across a pixel of the images before noise."""
RING = 7
"""Lights around the finger, the first ones; the others stand at its side."""
CLASSES = ("_0_15", "_15_30", "_30_45", "_45_60", "")
NOISE = 0.004
"""Standard deviation of the noise at full scale."""


@dataclass(frozen=True)
class Case:
    """A finger: its seed and pattern, ridges in um, roughness, and the part of once-scattered light
    that stays polarised."""

    seed: int
    pattern: str
    ridge_um: float
    roughness: float
    kept: float


CASES = {
    "a": Case(9301, "loop", 60, 0.30, 0.25),
    "b": Case(9302, "whorl", 30, 0.40, 0.25),
    "c": Case(9303, "loop", 45, 0.50, 0.35),
    "d": Case(9304, "arch", 75, 0.20, 0.25),
    "e": Case(9305, "whorl", 50, 0.13, 0.25),
    "f": Case(9306, "loop", 25, 0.25, 0.15),
    "g": Case(9307, "whorl", 85, 0.35, 0.30),
    "h": Case(9308, "loop", 35, 0.16, 0.20),
    "i": Case(9311, "whorl", 70, 0.15, 0.25),
    "j": Case(9312, "loop", 40, 0.22, 0.25),
    "k": Case(9313, "loop", 90, 0.26, 0.20),
    "l": Case(9314, "arch", 55, 0.45, 0.30),
    "m": Case(9315, "whorl", 65, 0.18, 0.20),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--names", default=",".join(CASES), help="fingers, with commas")
    parser.add_argument("--lights", type=int, default=14, choices=(7, 14), help="7: the ring alone")
    options = parser.parse_args()
    print(
        f"{options.lights} lights: correlation / gain / rms um / error over stated, by slant and"
        " below 60 deg"
    )
    for name in options.names.split(","):
        case = CASES[name]
        images, grid, start, deviation, truth = drawn(name, case, options.lights)
        height, stated, facts = polarised_heights(images, grid, start, deviation)
        result = {
            "height_mm": np.where(grid.mask, height, np.nan),
            "mask": grid.mask,
            "uncertainty_um": 1000 * stated,
        }
        figures = score(result, truth)
        cells = [
            f"{figures[f'ridge_corr{c}']:.3f} / {figures[f'ridge_gain{c}']:.2f} /"
            f" {figures[f'ridge_rms_um{c}']:.1f} / {figures[f'error_over_stated{c}']:.2f}"
            for c in CLASSES
            if f"ridge_corr{c}" in figures
        ]
        print(
            f"| {name}, {case.ridge_um} um, {case.roughness} ({facts['roughness']:.2f}) |"
            f" {' | '.join(cells)} |",
            flush=True,
        )


def drawn(
    name: str, case: Case, lights: int
) -> tuple[SpecularImages, Grid, Array, Array, dict[str, NDArray[np.generic]]]:
    """Images that films leave, their grid, start and its deviation, and the truth."""
    camera = replace(default_rig(SCALE).camera, image_size=IMAGE_SIZE)
    ring = tuple(led for led in default_rig(SCALE, None).leds if led.band == "white")
    rig = with_side_lights(Rig(camera, ring), 7)
    finger = draw_finger(case.seed, case.pattern)
    width_mm = min(finger.shape.width_mm, 13.0)
    finger = replace(
        finger,
        shape=replace(finger.shape, width_mm=width_mm),
        skin=replace(finger.skin, ridge_depth_um=float(case.ridge_um)),
    )
    settings = TwinSettings(
        rig=rig, pose=FingerPose(insertion_mm=round(IMAGE_SIZE[0] * camera.pitch_mm - 1.1, 1))
    )
    closer = replace(
        camera,
        px_per_mm=OVERSAMPLING * camera.px_per_mm,
        image_size=(OVERSAMPLING * IMAGE_SIZE[0], OVERSAMPLING * IMAGE_SIZE[1]),
    )
    surface, fine = (
        lay_down(
            case.seed, None, replace(settings, rig=replace(rig, camera=resolution)), finger=finger
        )[0]
        for resolution in (camera, closer)
    )
    mask, pitch = surface.mask, camera.pitch_mm
    whole = pixel_means(fine.mask.astype(float), surface) == 1
    height = np.where(
        whole, pixel_means(np.where(fine.mask, fine.height_mm, 0), surface), surface.height_mm
    )  # of the facets that are seen

    images, diffuse = _images(case, rig, surface, fine, lights)
    rng = np.random.default_rng(sum(map(ord, name)))
    exposure = 0.7 / np.percentile(diffuse[:, mask], 99.9)
    sigma = NOISE * np.sqrt(np.maximum(2 * diffuse + images, 0) * exposure / 0.7 / 3) * 0.7
    stack = (images * exposure + sigma * rng.standard_normal(images.shape)).astype(np.float32)
    x, y = pixel_places(camera)
    grid = Grid(mask, x[0], y[:, 0], pitch, (False, True, False, False))
    start, deviation = _start(height, surface.shape_mm, mask, pitch, rng)
    specular = SpecularImages(
        np.where(mask, stack, 0).astype(np.float32),
        _noise(stack, mask),
        replace(rig, leds=rig.leds[:lights]),
    )
    truth = {
        "height_mm": height,
        "shape_mm": surface.shape_mm,
        "mask": mask,
        "px_mm": np.float64(pitch),
    }
    return specular, grid, start, deviation, truth


def _images(case: Case, rig: Rig, surface: Any, fine: Any, lights: int) -> tuple[Array, Array]:
    """(L, H, W) parallel less crossed series, and (L, H, W) diffuse light, whose noise both
    have."""
    camera = rig.camera
    mask = surface.mask
    normals = surface.normals.astype(float)
    pitch, refraction = camera.pitch_mm, 1.42
    angle = float(case.seed % 7 * 20)
    films = mounted_films(
        FilmSettings("analyser", angle, 0.5, 1000.0, (0.85,) * 3, case.kept),
        rig.leds,
        np.random.default_rng(case.seed),
    )
    x, y = pixel_places(camera)
    z = np.where(mask, surface.height_mm, 0.0)
    seen, camera_way = [], (0, 0, 1.0)
    diffuse = []
    for k, led in enumerate(rig.leds[:lights]):
        way, strength = towards(led, (x, y, z))
        passed = films.specular(0, k, way, camera_way) - films.specular(1, k, way, camera_way)
        once = films.once_scattered(0, k, way, camera_way) - films.once_scattered(
            1, k, way, camera_way
        )
        if k < RING:  # hardly any skin hides the ring
            gloss = passed * pixel_means(reflected(fine, led, case.roughness), surface)
        else:
            gloss = passed * specular(surface, led, case.roughness, fine)
        cosines = (
            np.maximum(dot(way, np.moveaxis(normals, -1, 0)), 0),
            normals[..., 2].clip(0, 1),
        )
        inside = [np.sqrt(1 - (1 - cosine * cosine) / refraction**2) for cosine in cosines]
        scattered = (
            strength
            * cosines[0]
            * (1 - fresnel(cosines[0]))
            * (1 - fresnel(cosines[1]))
            / refraction**2
        )
        scattered = np.where(
            mask, scattered / (inside[0] + inside[1]) / (4 * np.pi) * 0.75, 0
        ).astype(np.float32)
        spread = (
            cv2.GaussianBlur(scattered, (0, 0), 0.1 / pitch)
            + cv2.GaussianBlur(scattered, (0, 0), 0.25 / pitch)
        ) / 2
        seen.append(cv2.GaussianBlur((gloss + spread * once).astype(np.float32), (0, 0), LENS_PX))
        diffuse.append((strength * cosines[0] / np.pi * 0.35 * 0.25 * mask).astype(np.float32))
    return np.stack(seen), np.stack(diffuse)


def _start(
    height: Array, shape: Array, mask: NDArray[np.bool_], pitch: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """A start like a network's: ridges blurred, too low, with errors that grow with the slant; and
    their deviation."""

    def blurred(field: Array, sigma_mm: float) -> Array:
        return cv2.GaussianBlur(field.astype(np.float64), (0, 0), sigma_mm / pitch)

    slant = slant_of(np.where(mask, shape, shape[mask].min()).astype(np.float32), pitch)
    relief = np.where(mask, height - shape, 0)
    rms = relief[mask].std()
    noise = rng.standard_normal(mask.shape)
    noise = blurred(noise, 0.05) - blurred(noise, 0.15)
    noise /= noise[mask].std()
    part = np.interp(slant, (0, 15, 30, 45, 60, 75), (0.2, 0.22, 0.28, 0.38, 0.5, 0.7))
    gain = np.interp(slant, (0, 30, 60, 75), (0.92, 0.85, 0.9, 0.8))
    bend = blurred(rng.standard_normal(mask.shape), 1.5)
    ridges = gain * blurred(relief, 0.025) + part * rms * noise
    lower = rng.uniform(-3, 3)  # a photograph does not show how high the finger lies
    start = np.where(mask, shape + ridges + 0.05 * bend / bend[mask].std() - lower, np.nan)
    deviation = np.maximum(np.hypot(part * rms, (1 - gain) * rms), 1e-3)
    return nearest_known(np.nan_to_num(start).astype(np.float32), mask).astype(
        np.float32
    ), deviation.astype(np.float32)


def _noise(stack: Array, mask: NDArray[np.bool_]) -> float:
    """Standard deviation of the images' noise, from their Laplacian."""
    sides = stack[:, :-2, 1:-1] + stack[:, 2:, 1:-1] + stack[:, 1:-1, :-2] + stack[:, 1:-1, 2:]
    return float(
        np.median(np.abs((4 * stack[:, 1:-1, 1:-1] - sides)[:, mask[1:-1, 1:-1]]))
        / 0.6745
        / np.sqrt(20)
    )


if __name__ == "__main__":
    main()
