"""What is done to a capture of a simulated finger, whether it is refused, and what the surface is
with ``keep``.

``python validation/damaged/run.py`` (simulator; some minutes) writes ``tables/damaged.csv``: a row
for each damage and finger. With ``--sound N`` it counts how many of N sound captures are doubted;
``--first`` is the first's seed, and ``--factor 2`` states twice their scale, which is to be
doubted.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit import BadInput, reconstruct
from splitknit.capture import Capture
from splitknit.io.csv_table import csv_text
from splitknit_simulator import compare, simulate_capture

TABLES = Path(__file__).parent / "tables"
COLUMNS = (
    "damage",
    "finger",
    "refused",
    "noted",
    "first_words",
    "surface_rms_mm",
    "ridge_correlation",
    "ridge_gain",
)
Pixels = np.ndarray[Any, Any]


def changed(capture: Capture, names: str, change: Callable[[Pixels], Pixels]) -> Capture:
    """The capture with the images (L, H, W, C) of some bands changed."""
    bands = {
        name: replace(band, pixels=change(band.pixels.copy())) if name in names.split() else band
        for name, band in capture.bands.items()
    }
    return replace(capture, bands=bands)


def ordered(*order: int) -> Callable[[Pixels], Pixels]:
    """Images in another order."""
    return lambda pixels: pixels[list(order)]


def image_changed(k: int, change: Callable[[Pixels], Pixels]) -> Callable[[Pixels], Pixels]:
    """Image k changed."""

    def work(pixels: Pixels) -> Pixels:
        pixels[k] = change(pixels[k]).reshape(pixels[k].shape)
        return pixels

    return work


def jpeg(quality: int) -> Callable[[Pixels], Pixels]:
    """All images through JPEG."""

    def work(pixels: Pixels) -> Pixels:
        for k, image in enumerate(pixels):
            _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
            back = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
            pixels[k] = back.reshape(image.shape)[..., ::-1]
        return pixels

    return work


def sharpened(pixels: Pixels) -> Pixels:
    """All images after an unsharp mask of 1.5 px."""
    for k, image in enumerate(pixels):
        wide = cv2.GaussianBlur(image, (0, 0), 1.5).reshape(image.shape)
        pixels[k] = np.clip(2.0 * image - wide, 0, 255).astype(np.uint8)
    return pixels


def damages(capture: Capture, second_finger: Capture) -> dict[str, Capture]:
    """Damaged captures by name."""
    rng = np.random.default_rng(0)
    both = "white nir"

    def noisy(image: Pixels) -> Pixels:
        return np.clip(image + rng.normal(0.0, 1.5, image.shape), 0, 255).astype(np.uint8)

    def noise(image: Pixels) -> Pixels:
        return rng.integers(10, 200, image.shape).astype(np.uint8)

    unequal = np.array([0.75, 1.0, 0.8, 0.78, 1.0, 0.7, 0.74])[:, None, None, None]
    first = {name: band.pixels[0] for name, band in capture.bands.items()}
    second_pixels = {name: band.pixels for name, band in second_finger.bands.items()}
    leds = tuple(
        replace(led, position_mm=(-led.position_mm[0], *led.position_mm[1:]))
        if led.position_mm
        else led
        for led in capture.rig.leds
    )
    return {
        "none": capture,
        "NIR 0 and 3 exchanged": changed(capture, "nir", ordered(3, 1, 2, 0, 4, 5, 6)),
        "NIR shifted by one": changed(capture, "nir", ordered(1, 2, 3, 4, 5, 6, 0)),
        "white 0 and 1 exchanged": changed(capture, "white", ordered(1, 0, 2, 3, 4, 5, 6)),
        "both shifted by 3": changed(capture, both, ordered(3, 4, 5, 6, 0, 1, 2)),
        "NIR 1 a noisy copy of NIR 0": changed(
            capture, "nir", image_changed(1, lambda _: noisy(first["nir"]))
        ),
        "white 1 a noisy copy of white 0": changed(
            capture, "white", image_changed(1, lambda _: noisy(first["white"]))
        ),
        "all white under one light": changed(
            capture, "white", lambda p: np.stack([noisy(first["white"]) for _ in p])
        ),
        "NIR 2 turned by 180 deg": changed(
            capture, "nir", image_changed(2, lambda image: image[::-1, ::-1])
        ),
        "NIR 2 noise": changed(capture, "nir", image_changed(2, noise)),
        "white 2 noise": changed(capture, "white", image_changed(2, noise)),
        "white 2 blurred by 3 px": changed(
            capture, "white", image_changed(2, lambda image: cv2.GaussianBlur(image, (0, 0), 3))
        ),
        "all NIR of another finger": changed(capture, "nir", lambda _: second_pixels["nir"]),
        "white 3 of another finger": changed(
            capture, "white", image_changed(3, lambda _: second_pixels["white"][3])
        ),
        "NIR 3 of another finger": changed(
            capture, "nir", image_changed(3, lambda _: second_pixels["nir"][3])
        ),
        "LEDs mirrored": replace(capture, rig=replace(capture.rig, leds=leds)),
        "LEDs 12 % unequal": changed(
            capture, both, lambda pixels: (pixels * unequal).astype(np.uint8)
        ),
        "images flipped": changed(
            capture, both, lambda pixels: np.ascontiguousarray(pixels[:, :, ::-1])
        ),
        "values times two, wrapped round": changed(
            capture, both, lambda pixels: pixels * np.uint8(2)
        ),
        "JPEG, quality 75": changed(capture, both, jpeg(75)),
        "JPEG, quality 95": changed(capture, both, jpeg(95)),
        "sharpened": changed(capture, both, sharpened),
    }


def row_of(name: str, finger: int, capture: Capture, truth: dict[str, Any]) -> dict[str, Any]:
    """Reconstruct, and again with `keep` where that is refused."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | {
        "damage": name,
        "finger": finger,
        "refused": 0,
        "noted": 0,
    }
    try:
        result = reconstruct(capture, "metric")
    except BadInput as refusal:
        row |= {"refused": 1, "first_words": str(refusal)[:90]}
        try:
            result = reconstruct(capture, "metric", {"keep": True})
        except BadInput:
            return row
    else:
        row["noted"] = int(any(finding.severity != "note" for finding in result.findings))
        row["first_words"] = result.warnings[0][:90] if row["noted"] else ""
    figures = compare(result, truth).figures
    return row | {
        key: round(figures[key], 3) for key in ("surface_rms_mm", "ridge_correlation", "ridge_gain")
    }


def doubted(count: int, first: int, factor: float) -> int:
    """How many of `count` sound captures are refused, or said to be spoilt: skin light and dark,
    dry, wet, dusty, scarred and glossy; bare lights, films and lights to the side; a tenth of them
    larger. `factor`: of their scale.
    """
    conditions = (None, "wet", "dry", "dusty", "scarred", "glossy")
    tones, rigs = (0.0003, 0.002, 0.008, 0.03), ({}, {"films.kind": "analyser"}, {"side_lights": 7})
    doubted_count = 0
    for seed in range(first, first + count):
        tone, condition = tones[seed // 6 % 4], conditions[seed % 6]
        twin = {"scale": 0.2 if seed % 10 == 7 else 0.12, "skin.melanin": (tone, tone)}
        twin |= rigs[seed % 3 if seed % 2 else 0] | (
            {"condition.kind": condition} if condition else {}
        )
        capture, _ = simulate_capture(seed, settings=twin, impression=seed % 3)
        camera = replace(capture.rig.camera, px_per_mm=factor * capture.rig.camera.px_per_mm)
        capture = replace(capture, rig=replace(capture.rig, camera=camera))
        try:
            result = reconstruct(capture, "metric")
        except BadInput as refusal:
            words = str(refusal)
        else:
            words = "".join(
                str(finding) for finding in result.findings[:1] if finding.severity != "note"
            )
        doubted_count += bool(words)
        print(*([seed, words] if words else []), end="\n" if words else "", flush=True)
    return doubted_count


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, nargs="+", default=[3, 8])
    parser.add_argument("--scale", type=float, default=0.12)
    parser.add_argument("--sound", type=int, default=0)
    parser.add_argument("--first", type=int, default=1120)
    parser.add_argument("--factor", type=float, default=1.0)
    options = parser.parse_args()
    if options.sound:
        doubted_count = doubted(options.sound, options.first, options.factor)
        print(f"{doubted_count} of {options.sound} sound captures are refused or doubted")
        return
    rows = []
    for finger in options.fingers:
        (capture, truth), (second_finger, _) = (
            simulate_capture(seed, settings={"scale": options.scale})
            for seed in (finger, finger + 18)
        )
        for name, damaged in damages(capture, second_finger).items():
            row = row_of(name, finger, damaged, dict(truth))
            rows.append(row)
            print(row, flush=True)
    table = csv_text([COLUMNS, *(row.values() for row in rows)])
    (TABLES / "damaged.csv").write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()
