"""What is done to a capture of a simulated finger, whether it is refused, and what the surface is
with ``keep``.

``python validation/damaged/run.py`` (simulator; some minutes) writes ``tables/damaged.csv``: a row
for each damage and finger. With ``--sound N`` it counts how many of N sound captures are doubted;
``--first`` is the first's seed, and ``--factor 2`` states twice their scale, which is to be
doubted. ``--mistakes`` makes mistakes of the camera and the rig instead (``tables/mistakes.csv``):
``named`` is 1 where a doubt has the cause's word.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit import BadInput, compare, reconstruct
from splitknit.model import Capture
from splitknit_simulator import simulate_capture

TABLES = Path(__file__).parent / "tables"
COLUMNS = (
    "damage",
    "finger",
    "refused",
    "noted",
    "named",
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
    }


def graded(
    capture: Capture, names: str, change: Callable[[Pixels, int], Pixels], *, ambient: bool = True
) -> Capture:
    """Every image (H, W, C) in [0, 1], and its number, changed; the ambient one is number -1, or
    left out."""

    def whole(pixels: Pixels, k: int) -> Pixels:
        top = float(np.iinfo(pixels.dtype).max)
        return np.clip(np.rint(top * change(pixels.astype(np.float32) / top, k)), 0, top).astype(
            pixels.dtype
        )

    bands = dict(capture.bands)
    for name in names.split():
        band = bands[name]
        room = None if band.ambient is None or not ambient else whole(band.ambient, -1)
        images = np.stack([whole(image, k) for k, image in enumerate(band.pixels)])
        bands[name] = replace(band, pixels=images, ambient=room)
    return replace(capture, bands=bands)


def stated(
    capture: Capture, across: float = 1.0, up_mm: float = 0.0, aside_mm: float = 0.0
) -> Capture:
    """A rig file whose LEDs stand elsewhere: their ring `across` times as wide, higher, and moved
    along x."""
    leds = [(led, led.position_mm) for led in capture.rig.leds]
    moved = tuple(
        replace(led, position_mm=(across * at[0] + aside_mm, across * at[1], at[2] + up_mm))
        for led, at in leds
        if at
    )
    return replace(capture, rig=replace(capture.rig, leds=moved))


def mistakes(capture: Capture, truth: dict[str, Any], seed: int) -> dict[str, tuple[Capture, str]]:
    """What people do wrong with a camera or a rig file, and the word that names it."""
    rng = np.random.default_rng(seed)
    both = "white nir"
    gains = 1 + rng.uniform(-0.15, 0.15, (9, 3)).astype(np.float32)
    level = float(np.quantile(capture.bands["white"].pixels[:, truth["mask"]], 0.9)) / 255
    facing = np.nan_to_num(np.clip(truth["normals"] @ [0.3, 0.2, 0.93], 0, 1)).astype(np.float32)[
        ..., None
    ]
    px = capture.rig.camera.px_per_mm
    row, column = np.argwhere(truth["mask"]).mean(axis=0)
    i, j = np.indices(truth["mask"].shape)
    plaster = (np.abs(i - row) < 4 * px) & (np.abs(j - column) < 5 * px)

    def around(x: Pixels, sigma: float) -> Pixels:
        return cv2.GaussianBlur(x.mean(axis=2), (0, 0), sigma)[..., None]

    def covered(x: Pixels, _: int) -> Pixels:
        smooth = cv2.GaussianBlur(x, (0, 0), 0.6 * px).reshape(x.shape)
        beige = smooth.mean(axis=2, keepdims=True) * np.linspace(
            1.1, 0.8, x.shape[2], dtype=np.float32
        )
        weave = 1 + 0.04 * np.sin(2 * np.pi * i / (0.3 * px)) * np.sin(2 * np.pi * j / (0.3 * px))
        return np.where(plaster[..., None], beige * weave[..., None], x).astype(np.float32)

    curves: dict[str, tuple[Callable[[Pixels, int], Pixels], str, str]] = {
        "BGR for RGB": (lambda x, _: x[..., ::-1], "white", "blue, green, red"),
        "white balance +-15 % an image": (
            lambda x, k: x * gains[k][: x.shape[2]],
            both,
            "white balance",
        ),
        "gamma 0.8": (lambda x, _: x**0.8, both, "gamma"),
        "S curve": (lambda x, _: x * x * (3 - 2 * x), both, "tone curve"),
        "film's curve": (lambda x, _: 1.5 * x / (x + 0.5), both, "tone curve"),
        "night mode": (
            lambda x, _: x * 0.33 / (0.15 + around(x, x.shape[1] / 30)),
            both,
            "night mode",
        ),
        "local contrast": (
            lambda x, _: x * np.sqrt(0.3 / np.maximum(around(x, 2 * px), 0.05)),
            both,
            "local contrast",
        ),
        "clipped at 1.6 times": (lambda x, _: 1.6 * x, both, "clipped"),
        "plaster on the pad": (covered, both, "no ridges"),
    }
    without = {
        "room lamp 30 %": (lambda x, _: x + 0.3 * level * facing, both, "room"),
        "haze": (
            lambda x, _: 0.8 * cv2.GaussianBlur(x, (0, 0), 1.2).reshape(x.shape) + 0.12,
            both,
            "haze",
        ),
    }
    return {
        "none": (capture, ""),
        **{
            name: (graded(capture, on, change), word) for name, (change, on, word) in curves.items()
        },
        **{
            name: (graded(capture, on, change, ambient=False), word)
            for name, (change, on, word) in without.items()
        },
        "LEDs 40 mm lower than stated": (stated(capture, up_mm=40), "LEDs"),
        "LEDs 60 mm higher than stated": (stated(capture, up_mm=-60), "LEDs"),
        "ring 8 mm aside": (stated(capture, aside_mm=8), "LEDs"),
        "ring of 40 for 52.5 mm": (stated(capture, across=40 / 52.5), "LEDs"),
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
        row |= {"refused": 1, "first_words": str(refusal)[:90], "said": str(refusal)}
        try:
            result = reconstruct(capture, "metric", {"keep": True})
        except BadInput:
            return row
    else:
        row["noted"] = int(any(finding.severity != "note" for finding in result.findings))
        row["first_words"] = result.warnings[0][:90] if row["noted"] else ""
        row["said"] = " ".join(result.warnings)
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
    parser.add_argument("--mistakes", action="store_true")
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
        if options.mistakes:
            cases = mistakes(capture, dict(truth), finger)
        else:
            cases = {
                name: (damaged, "") for name, damaged in damages(capture, second_finger).items()
            }
        for name, (damaged, word) in cases.items():
            row = row_of(name, finger, damaged, dict(truth))
            warnings = row.pop("said", "")
            row["named"] = int(bool(word) and word in warnings)
            rows.append(row)
            print(row, flush=True)
    columns = COLUMNS if options.mistakes else tuple(name for name in COLUMNS if name != "named")
    with (TABLES / ("mistakes.csv" if options.mistakes else "damaged.csv")).open(
        "w", newline=""
    ) as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
