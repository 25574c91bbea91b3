"""Presentation attack detection on simulated captures and on others' light: `python
validation/pad/run.py`.

Captures are simulated, reconstructed and measured one by one; each is written to --out and not made
twice. Optics of the skin, rig and camera are drawn for 7 of 10. Then `--jpeg 20` measures live
fingers that are not part of the fit as JPEG, `--fresh 60` others as they are, `--foreign
../shared/data` the path-traced fingers in five versions each, `--gather` puts all into
``tables/captures.json``, `--score` writes ``tables/answers.csv`` from there, leaving out one
species or fold at a time, and `--write` fits the model, ``model.json`` (needs scikit-learn).
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from attacks import SPECIES, simulate_attack
from detector import pad_features, pad_images

import splitknit
from splitknit.capture import Capture
from splitknit.nominal import default_rig
from splitknit_simulator.light.skin import Boundary, SkinOptics, SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import twin_settings

CONDITIONS = ("wet", "dry", "dusty", "scarred", "glossy")
TABLES = Path(__file__).parent / "tables"


def drawn(rng: np.random.Generator, live: bool) -> tuple[TwinSettings, dict[str, object]]:
    """Settings of a capture: the usual ones, or optics, lights and camera drawn; a third of live
    fingers not clean."""
    changes: dict[str, object] = {"render.workers": 1}
    scale = float(rng.choice([0.19, 0.2, 0.22, 0.25]))
    facts: dict[str, object] = {
        "variant": "plain" if rng.random() < 0.3 else "drawn",
        "state": "clean",
    }
    if live and rng.random() < 0.3:
        facts["state"] = str(rng.choice(CONDITIONS))
        changes |= {
            "condition.kind": facts["state"],
            "condition.severity": float(rng.uniform(0.1, 0.6)),
        }
    if facts["variant"] == "plain":
        return twin_settings(0.2, changes), facts
    refraction = 0.0 if rng.random() < 0.35 else float(rng.uniform(0, 0.7))
    base = SkinOptics(
        boundary=Boundary(refraction=refraction, entry_power=float(rng.uniform(0.2, 1.2))),
        scattering_power=float(rng.uniform(0.9, 1.8)),
        layers=tuple(float(factor) for factor in np.exp(0.25 * rng.standard_normal(4))),
    )
    skin = SkinRanges(
        base=base,
        scattering_factor=(0.5, 2.0),
        melanin=(0.0002, 0.015),
        blood=(0.002, 0.02),
        roughness=(0.12, 0.5),
        glare=(0.3, 2.0),
        relief_gain=(0.4, 2.0),
    )
    rig = default_rig(scale, int(rng.integers(1e6)), float(rng.uniform(0, 0.2)))
    ring, height = (float(np.exp(0.15 * rng.standard_normal())) for _ in range(2))
    places = [
        np.array(led.position_mm) * [ring, ring, height] + rng.normal(0, 1.0, 3) for led in rig.leds
    ]
    leds = tuple(
        replace(led, position_mm=tuple(place)) for led, place in zip(rig.leds, places, strict=True)
    )
    changes |= {
        "sensor.full_well_e": float(np.exp(rng.uniform(np.log(1500), np.log(15000)))),
        "sensor.demosaic": bool(rng.random() < 0.3),
        "sensor.exposure": float(rng.uniform(0.45, 0.8)),
        "background.ambient": float(rng.uniform(0, 0.02)),
    }
    facts |= {
        "refraction": round(refraction, 3),
        "ring": round(ring, 3),
        "height": round(height, 3),
        "scale": scale,
    }
    return replace(twin_settings(scale, changes), skin=skin, rig=replace(rig, leds=leds)), facts


def measured(
    name: str, seed: int, out: Path, change: Callable[[Capture], Capture] = lambda capture: capture
) -> None:
    """One simulated capture: its features, or why there is no result."""
    settings, facts = drawn(np.random.default_rng([seed, 0xAD2]), name.startswith("live"))
    kept(
        name,
        seed,
        out,
        facts,
        lambda: change(simulate_attack(seed, name.partition(",")[0], settings)[0]),
    )


def kept(
    name: str, seed: int, out: Path, facts: dict[str, object], capture_of: Callable[[], Capture]
) -> None:
    """Measure a capture unless it was before, and write its features."""
    path = out / f"{name}-{seed}.json"
    if path.exists():
        return
    facts = {"name": name, "seed": seed, **facts}
    try:
        capture = capture_of()
        features = pad_features(pad_images(capture), splitknit.reconstruct(capture, "metric"))
        facts["features"] = {feature: round(value, 5) for feature, value in features.items()}
    except splitknit.BadInput as error:
        facts["failed"] = str(error)
    path.write_text(json.dumps(facts))
    print(name, seed, facts.get("state", ""), facts.get("failed", ""), flush=True)


def as_jpeg(capture: Capture) -> Capture:
    """The capture as a telephone would save it: sRGB, JPEG of quality 95, colour at half
    resolution."""
    how = [
        cv2.IMWRITE_JPEG_QUALITY,
        95,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]

    def saved(image: np.ndarray) -> np.ndarray:
        light = image / np.iinfo(image.dtype).max
        coded = np.where(
            light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
        )
        data = cv2.imencode(".jpg", np.round(255 * coded).astype(np.uint8), how)[1]
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED)).reshape(image.shape)

    bands = {}
    for name, band in capture.bands.items():
        ambient = band.ambient
        if ambient is not None:
            ambient = replace(ambient, pixels=saved(ambient.pixels))
        pixels = np.stack([saved(image) for image in band.pixels])
        bands[name] = replace(band, pixels=pixels, ambient=ambient)
    return replace(capture, bands=bands, encoding="srgb")


def changed(capture: Capture, how: str) -> Capture:
    """A version of a capture: `how` is as it is, jpeg, half, five lights or noisy."""
    rng = np.random.default_rng(48)
    if how == "jpeg":
        return as_jpeg(capture)
    bands = {}
    for name, band in capture.bands.items():
        pixels = band.pixels
        keep = range(len(band.leds))
        if how == "half":
            pixels = np.stack(
                [
                    cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                    for image in pixels
                ]
            )
            pixels = pixels.reshape(*pixels.shape[:3], -1)
        if how == "noisy":
            full = np.iinfo(pixels.dtype).max
            light = pixels / full
            light = light + np.sqrt(light / 3000 + 1e-6) * rng.standard_normal(pixels.shape)
            pixels = np.round(full * np.clip(light, 0, 1)).astype(pixels.dtype)
        if how == "five lights":
            keep = [k for k in keep if k % 7 not in (2, 5)]
        at = list(keep)
        bands[name] = replace(
            band,
            pixels=pixels[at],
            leds=tuple(band.leds[k] for k in at),
            exposure=band.exposure[at],
            black_level=band.black_level[at],
        )
    camera = capture.rig.camera
    if how == "half":
        camera = replace(
            camera,
            px_per_mm=camera.px_per_mm / 2,
            image_size=tuple(bands["white"].pixels.shape[1:3]),
        )
    return replace(capture, bands=bands, rig=replace(capture.rig, camera=camera))


def simulate(out: Path, live: int = 60, per_species: int = 5) -> None:
    """Live fingers and instruments of all species side by side, so that every stop leaves a fair
    mixture."""
    copies = [
        (name, 5000 + 100 * k + j) for j in range(per_species) for k, name in enumerate(SPECIES)
    ]
    fingers = [("live", 1000 + j) for j in range(live)]
    for pair in itertools.zip_longest(fingers, copies):
        for name, seed in filter(None, pair):
            measured(name, seed, out)


def foreign(out: Path, data: Path) -> None:
    """The path-traced fingers, in five versions each."""
    folders = ("loop", "print", "polarised/d17_pol", "side_lights/d41_pol")
    for number, how in itertools.product(
        range(len(folders)), ("as it is", "jpeg", "half", "five lights", "noisy")
    ):
        capture = splitknit.read_capture(data / "path_traced" / folders[number])
        kept(f"path-traced, {how}", number, out, {}, lambda: changed(capture, how))  # noqa: B023


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("validation/out/pad"))
    parser.add_argument("--jpeg", type=int, help="number of live fingers to measure as JPEG")
    parser.add_argument(
        "--fresh", type=int, help="number of live fingers to measure that are not part of the fit"
    )
    parser.add_argument("--foreign", type=Path, help="folder with path_traced")
    parser.add_argument(
        "--gather", action="store_true", help="put what is in --out into tables/captures.json"
    )
    parser.add_argument("--score", action="store_true", help="write tables/answers.csv")
    parser.add_argument("--write", action="store_true", help="fit the shipped model")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    captures = TABLES / "captures.json"
    if options.gather:
        rows = [json.loads(path.read_text()) for path in sorted(options.out.glob("*.json"))]
        captures.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    elif options.score or options.write:
        import model  # needs scikit-learn

        rows = json.loads(captures.read_text())
        if options.write:
            print(model.ship(rows))
        else:
            with (TABLES / "answers.csv").open("w", newline="") as stream:
                writer = csv.DictWriter(
                    stream, ("group", "tried", "live", "attack", "unknown"), lineterminator="\n"
                )
                writer.writeheader()
                writer.writerows(model.rates(rows))
            print((TABLES / "answers.csv").read_text(), *model.summary(rows), sep="\n")
    elif options.jpeg:
        for seed in range(7000, 7000 + options.jpeg):
            measured("live, JPEG 95, 4:2:0", seed, options.out, as_jpeg)
    elif options.fresh:
        for seed in range(8000, 8000 + options.fresh):
            measured("live, drawn anew", seed, options.out)
    elif options.foreign:
        foreign(options.out, options.foreign)
    else:
        simulate(options.out)
