"""Rendered objects under anybody's lights: what is noticed, and how accurate the surface is.

    python validation/objects/measure.py [lights] [faults] [sound] [brightness] [gloss] [encoding]

Each writes tables/NAME.json. Objects are those of render.py, with seeds that nothing was tuned on.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import glossy
import mistakes
import numpy as np
from render import PX_PER_MM, SHAPES, Rendered, rendered, spoilt

import splitknit
from splitknit.errors import BadInput
from splitknit.imaging.pixels import srgb_code
from splitknit.observation.plain import capture_of_arrays
from splitknit.pipeline import located

TABLES = Path(__file__).with_name("tables")
FIRST_SEED = 200
"""Seeds below it served while thresholds were chosen."""


def errors(
    target: Rendered, images: np.ndarray | None = None, intensities: np.ndarray | None = None
):
    """Mean angle in degrees of the measured normals, rms height in um, and the result."""
    used = target.images if images is None else images
    result = splitknit.reconstruct_images(used, target.lights, target.mask, PX_PER_MM, intensities)
    inside = result.mask & target.mask & np.isfinite(result.height_mm)
    cosine = np.clip((result.normals_measured * target.normals).sum(axis=2)[inside], -1, 1)
    height = (result.height_mm - target.height_mm)[inside]
    return float(np.degrees(np.arccos(cosine)).mean()), 1000 * float(np.std(height)), result


def spread(values: list[float]) -> dict[str, float]:
    """Median and range."""
    low, middle, high = np.percentile(values, (5, 50, 95))
    return {
        "median": round(float(middle), 2),
        "p5": round(float(low), 2),
        "p95": round(float(high), 2),
    }


def by_lights() -> dict[str, object]:
    """Accuracy by the number of lights: twelve objects, each under 24 lights, of which so many are
    taken evenly."""
    objects = [rendered(FIRST_SEED + seed, lights=24) for seed in range(2 * len(SHAPES))]
    rows = {}
    for count in (3, 4, 5, 6, 8, 12, 24):
        taken = np.arange(count) * 24 // count
        lit_by_count = [
            replace(target, images=target.images[taken], lights=target.lights[taken])
            for target in objects
        ]
        error_pairs = [errors(target)[:2] for target in lit_by_count]
        rows[str(count)] = {
            "deg": spread([error_pair[0] for error_pair in error_pairs]),
            "um": spread([error_pair[1] for error_pair in error_pairs]),
        }
    return rows


def faults() -> dict[str, object]:
    """One photograph in eight spoilt: whether it is named, and the height error over the good
    set's."""
    rows: dict[str, object] = {}
    good = {seed: errors(rendered(FIRST_SEED + seed))[1] for seed in range(10)}
    for kind in ("blurred", "moved", "double", "overexposed"):
        named, others, ratios, refused = 0, 0, [], 0
        for seed in range(10):
            target = rendered(FIRST_SEED + seed)
            rng = np.random.default_rng(seed)
            k = int(rng.integers(8))
            try:
                _, height, result = errors(target, spoilt(target.images, k, kind, rng))
            except BadInput as error:
                named, refused = named + (f"image {k}" in str(error)), refused + 1
                continue
            files = {file for finding in result.findings for file in finding.files}
            named += f"image {k}" in files
            others += bool(files - {f"image {k}"})
            ratios.append(height / good[seed])
        rows[kind] = {
            "sets": 10,
            "named": named,
            "refused": refused,
            "others_named": others,
            "um_over_good": spread(ratios),
        }
    return rows


def sound() -> dict[str, object]:
    """Notes on good sets of eight photographs: none is due but that it shines, as some do, and on a
    dish that it comes out hollow."""
    alarms, hollow, shine = {}, [], 0
    seeds = (*range(FIRST_SEED, FIRST_SEED + 50), *range(2 * FIRST_SEED, 2 * FIRST_SEED + 50))
    for seed in seeds:
        findings = errors(rendered(seed))[2].findings
        if SHAPES[seed % len(SHAPES)] == "dish":
            hollow += [seed] if any(finding.code == "hollow" for finding in findings) else []
            findings = tuple(finding for finding in findings if finding.code != "hollow")
        shine += any(finding.code == "glossy" for finding in findings)
        of_gloss = {"glossy", "height-factor"}
        findings = tuple(finding for finding in findings if finding.code not in of_gloss)
        if findings:
            alarms[str(seed)] = [str(finding) for finding in findings]
    return {
        "sets": len(seeds),
        "with_alarm": len(alarms),
        "alarms": alarms,
        "dishes_named_hollow": len(hollow),
        "named_glossy": shine,
    }


def brightness() -> dict[str, object]:
    """Lights of unequal brightness and colour: degrees above those with equal lights."""
    rows: dict[str, list[float]] = {
        "given": [],
        "estimated": [],
        "eight_colours": [],
        "eight_colours_given": [],
    }
    for seed in range(FIRST_SEED, FIRST_SEED + 12):
        equal = rendered(seed)
        unequal = rendered(seed, strengths=0.3)
        base = errors(equal)[0]
        rows["given"].append(errors(unequal, intensities=unequal.intensities)[0] - base)
        rows["estimated"].append(errors(unequal)[0] - base)
        colours = np.random.default_rng(seed).uniform(0.25, 1.0, (8, 3))
        images = np.rint(equal.images[..., None] * colours[:, None, None]).astype(np.uint16)
        rows["eight_colours"].append(errors(equal, images)[0] - base)
        rows["eight_colours_given"].append(errors(equal, images, colours)[0] - base)
    return {name: spread(values) for name, values in rows.items()}


def gloss() -> dict[str, object]:
    """Median error of the normals of gloss and metal, by the default and by a matt model; near
    lights are given as distant ones."""
    rows: dict[str, object] = {}
    for name, thing in glossy.THINGS.items():
        target = glossy.photographed(*thing)
        units = target.lights / np.linalg.norm(target.lights, axis=1, keepdims=True)
        of_method = {}
        for label, method in (("default", "near_light"), ("matt", "robust")):
            capture, _ = capture_of_arrays(target.images, units, target.mask, PX_PER_MM, None)
            settings = {"normals.method": method}
            result = splitknit.reconstruct(capture, settings=settings)
            cosine = (result.normals_measured * target.normals).sum(axis=2)[target.mask]
            off = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))
            of_method[f"{label}_deg"] = round(off, 2)
        rows[name] = of_method
    return rows


def encoding() -> dict[str, object]:
    """As what photographs of 8 bits are read whose encoding nobody states: both of things rendered
    here, and of photographed ones (of which bear, ball and coin served to choose the limit)."""
    things = {f"rendered {seed}": rendered(FIRST_SEED + seed) for seed in range(2 * len(SHAPES))}
    things |= {name: glossy.photographed(*thing[:4]) for name, thing in glossy.THINGS.items()}
    stacks = {
        name: (target.images / 65535.0, target.lights, target.mask)
        for name, target in things.items()
    }
    rows: dict[str, object] = {}
    for name in (*stacks, *mistakes.THINGS):
        light, lights, mask = stacks[name] if name in stacks else mistakes.thing(name)
        units = lights / np.linalg.norm(lights, axis=1, keepdims=True)
        light = np.clip(light / light.max(), 0.0, 1.0)
        rows[name] = {
            stored: located(
                capture_of_arrays(np.rint(255 * code(light)).astype(np.uint8), units, mask, 10.0)[0]
            ).observation.encoding
            for stored, code in (("linear", np.asarray), ("srgb", srgb_code))
        }
    return rows


PARTS: dict[str, Callable[[], dict[str, object]]] = {
    "lights": by_lights,
    "faults": faults,
    "sound": sound,
    "brightness": brightness,
    "gloss": gloss,
    "encoding": encoding,
}

if __name__ == "__main__":
    TABLES.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PARTS:
        table = PARTS[name]()
        (TABLES / f"{name}.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
        sys.stdout.write(f"{name}: {json.dumps(table)}\n")
        sys.stdout.flush()
