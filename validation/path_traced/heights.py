"""How bright the heights of ridges are, by the angle at which light meets the skin, on captures with truth.

    python validation/path_traced/heights.py FOLDER [FOLDER ...]

FOLDER: a capture with ``truth.npz`` and ``info.json``, as ``make.py`` writes them. For skin that slants by 30 to 60
degrees, the relative brightness of every light's image in the band of ridges is explained by least squares from the
relief's height, height times ln(1 / cos t), t the angle between the light and the skin without ridges, the slope
towards the light and the specular reflection. Printed for each channel: the first two in %/um, and the second over the
first and over the square root of the effective attenuation. Coarse images reduce all of them by the same factor, so
that the ratio is what :meth:`splitknit_simulator.light.skin.Boundary.oblique_signal` follows.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import splitknit
from splitknit.imaging.band import linear_channels
from splitknit.model import Capture
from splitknit_simulator.light.lighting import towards
from splitknit_simulator.light.skin import ChannelOptics

BAND_MM = 0.32
"""Standard deviation of the Gaussian whose mean is taken away."""
CHANNELS = ("red", "green", "blue")
Array = NDArray[np.float32]


def normals(height: Array, pitch_mm: float) -> Array:
    """(3, h, w) unit normals of a height map."""
    down, right = np.gradient(height, pitch_mm)
    return np.stack([-right, down, np.ones_like(height)]) / np.sqrt(1 + right**2 + down**2)


def brightness_of_heights(
    capture: Capture, truth: dict[str, Array], roughness: float
) -> dict[str, tuple[float, float]]:
    """For each channel: brightness of heights under light along the normal, and what ln(1 / cos t) adds, in %/um."""
    pitch = capture.rig.camera.pitch_mm
    mask = truth["mask"].astype(bool)
    inside = mask.astype(np.float32)

    def mean(values: Array) -> Array:
        blur = [cv2.GaussianBlur(np.where(mask, v, 0), (0, 0), BAND_MM / pitch) for v in (values, inside)]
        return np.asarray(blur[0] / np.maximum(blur[1], 1e-3), dtype=np.float32)

    def band(values: Array) -> Array:
        return np.where(mask, values - mean(values), 0).astype(np.float32)

    height, shape = (np.nan_to_num(truth[name]).astype(np.float32) for name in ("height_mm", "shape_mm"))
    smooth, ridged = normals(shape, pitch), normals(height, pitch)
    relief = band((height - shape) * smooth[2] * 1e3)
    rows, columns = mask.shape
    x = ((np.arange(columns) - (columns - 1) / 2) * pitch).astype(np.float32)[None]
    y = (((rows - 1) / 2 - np.arange(rows)) * pitch).astype(np.float32)[:, None]
    far = cv2.erode(mask.astype(np.uint8), np.ones((15, 15))) > 0
    slanted = far & (smooth[2] > 0.5) & (smooth[2] < np.sqrt(0.75))
    white = capture.bands["white"]
    images = np.asarray(linear_channels(white, capture.encoding, CHANNELS))
    rows_of: list[Array] = []
    seen: list[list[Array]] = [[] for _ in CHANNELS]
    for k, led in enumerate(capture.rig.select(white.lights).leds):
        light = np.stack([np.broadcast_to(v, mask.shape) for v in towards(led, x, y, height)[:3]])
        facing, cosine = (np.sum(light * n, axis=0) for n in (ridged, smooth))
        half = light + np.array([0, 0, 1])[:, None, None]
        towards_half = np.clip(np.sum(half * ridged, axis=0) / np.linalg.norm(half, axis=0), 0, 1)
        gloss = 1 / (towards_half**2 * (roughness**2 - 1) + 1) ** 2 / np.maximum(ridged[2], 0.1)
        chosen = slanted & (cosine > 0.1)
        oblique = -np.log(np.clip(cosine, 0.1, 1))
        slope = band(facing / np.maximum(cosine, 0.1))
        for c in range(len(CHANNELS)):
            level = np.maximum(mean(images[c, k]), 1e-6)
            seen[c].append((band(images[c, k]) / level)[chosen])
        level = np.maximum(mean(images[:, k].mean(axis=0)), 1e-6)
        parts = relief, relief * oblique, slope, slope * oblique, band(gloss) / level
        rows_of.append(np.stack([part[chosen] for part in parts], axis=1))
    terms = np.concatenate(rows_of).astype(np.float64)
    found = [np.linalg.lstsq(terms, np.concatenate(one), rcond=None)[0] for one in seen]
    return {name: (100 * float(one[0]), 100 * float(one[1])) for name, one in zip(CHANNELS, found, strict=True)}


def main() -> None:
    """Measure folders and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folders", nargs="+", type=Path)
    for folder in parser.parse_args().folders:
        info = json.loads((folder / "info.json").read_text("utf-8"))
        with np.load(folder / "truth.npz") as file:
            truth = {name: file[name] for name in ("mask", "height_mm", "shape_mm")}
        found = brightness_of_heights(splitknit.read_capture(folder), truth, info["optics"]["roughness"])
        for name, (upright, oblique) in found.items():
            medium = info["channels"][name]
            optics = ChannelOptics(medium["scattering_per_mm"], medium["absorption_per_mm"], 0.0)
            over = 10 * oblique / np.sqrt(optics.attenuation_per_mm)
            print(
                f"{folder.name} {name}: {upright:.3f} %/um + {oblique:.3f} %/um ln(1 / cos t), {over:.2f} of the root"
            )


if __name__ == "__main__":
    main()
