"""Real objects whose normals are known: how far each preset's are from them.

    python validation/accuracy/objects.py [FILE.npz ...] [--sphere FOLDER ...]

A file has ``images`` (N, H, W) linear, ``lights`` (N, 3) towards the lights (x right, y up, z to
the camera), ``mask`` (H, W) and ``normals`` (H, W, 3). A sphere's folder has photographs
``*.N.png``, a mask ``*.mask.png`` and, in it or above it, ``lights.txt``; its normals follow from
its outline. Without arguments: the objects of SPLITKNIT_DATA.

It prints the table that ``tables/objects.csv`` holds and docs/experiments/real-things.md quotes:
mean angular error in degrees of the normals as photometric stereo measured them, and of the
integrated surface; with all lights, and with seven of them (mean, min to max of DRAWS draws).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitknit import reconstruct
from splitknit.capture import Band, Capture
from splitknit.errors import BadInput, require
from splitknit.io.light_list import read_light_list
from splitknit.io.npz import read_npz
from splitknit.io.photographs import GivenPhotographs
from splitknit.model import BoolArray, Camera, FloatArray, Led, Rig
from splitknit.observation.plain import capture_from_photographs

PRESETS = {
    "metric": ("metric", {}),
    "ea": ("ea", {}),
    "snk": ("snk", {}),
    "pr": ("pr", {}),
    "pr, linear contrast": ("pr", {"enhance.cells.grey": "linear"}),
}
FEW_LIGHTS = 7
"""Lights of a rig."""
DRAWS = 5
PX_PER_MM = 5.0
"""The scale that is stated; no preset's normals should depend on it, but those that smooth do so in
mm."""
STEEPEST_DEG = 75
"""Of a sphere's slopes: its rim is blurred by its outline."""


@dataclass(frozen=True, slots=True, eq=False)
class Object:
    """Photographs and the truth."""

    name: str
    images: np.ndarray
    lights: FloatArray
    mask: BoolArray
    normals: FloatArray

    def capture(self, chosen: Sequence[int]) -> Capture:
        """The photographs under some of the lights."""
        units = self.lights / np.linalg.norm(self.lights, axis=1, keepdims=True)
        leds = tuple(
            Led("white", direction=tuple(float(part) for part in units[k])) for k in chosen
        )
        count = len(leds)
        frames = tuple((k,) for k in range(count))
        band = Band(
            "white", self.images[list(chosen)][..., None], frames, np.ones(count), np.zeros(count)
        )
        rig = Rig(Camera(PX_PER_MM, self.mask.shape), leds)
        return Capture(rig, {"white": band}, material="opaque", mask=self.mask)

    def error_deg(self, normals: FloatArray) -> float:
        """Mean angle between `normals` and the truth."""
        where = self.mask & (np.linalg.norm(self.normals, axis=-1) > 0.5)
        cosine = np.clip((normals * self.normals).sum(axis=-1)[where], -1, 1)
        return float(np.degrees(np.arccos(cosine)).mean())


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the objects that are named, or those of SPLITKNIT_DATA."""
    parser = argparse.ArgumentParser(
        description="How far the presets' normals are from those of real objects."
    )
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE.npz")
    parser.add_argument("--sphere", nargs="*", type=Path, default=[], metavar="FOLDER")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("SPLITKNIT_DATA", "../shared/data"))
    if not options.files and not options.sphere:
        options.files, options.sphere = (
            sorted((data / "diligent").glob("*.npz")),
            [data / "psm_spheres" / "gray"],
        )
    try:
        objects = [scanned(file) for file in options.files] + [
            sphere(folder) for folder in options.sphere
        ]
        for line in table(objects):
            print(line, flush=True)
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def scanned(file: Path) -> Object:
    """Read an object with scanned normals."""
    held = read_npz(file)
    missing = {"images", "lights", "mask", "normals"} - set(held)
    require(not missing, f"'{file}' has no {', '.join(sorted(missing))}.")
    mask = np.asarray(held["mask"], dtype=np.bool_)
    return Object(
        file.stem, held["images"], np.asarray(held["lights"]), mask, np.asarray(held["normals"])
    )


def sphere(folder: Path) -> Object:
    """Read photographs of a sphere; its outline gives its normals."""
    masks = sorted(folder.glob("*.mask.png"))
    require(len(masks) == 1, f"'{folder}' must hold one *.mask.png.")
    lights_file = folder / "lights.txt"
    lights = read_light_list(
        lights_file if lights_file.is_file() else folder.parent / "lights.txt"
    ).lights
    stem = masks[0].name.removesuffix(".mask.png")
    photographs = GivenPhotographs(
        folder / f"{stem}.{{light}}.png", lights, PX_PER_MM, mask=masks[0], encoding="linear"
    )
    capture, _ = capture_from_photographs(photographs)
    assert capture.mask is not None
    rows, columns = np.nonzero(capture.mask)
    radius = (np.ptp(columns) + np.ptp(rows) + 2) / 4
    i, j = np.mgrid[0 : capture.shape[0], 0 : capture.shape[1]]
    x = (j - (columns.min() + columns.max()) / 2) / radius
    y = ((rows.min() + rows.max()) / 2 - i) / radius
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    normals = np.where((z > np.cos(np.radians(STEEPEST_DEG)))[..., None], np.dstack([x, y, z]), 0.0)
    grey = capture.bands["white"].pixels.mean(axis=-1)
    directions = np.array([led.direction for led in capture.rig.leds])
    return Object(
        f"{stem} sphere", grey.round().astype(np.uint16), directions, capture.mask, normals
    )


def table(objects: Sequence[Object]) -> Iterator[str]:
    """Lines of the page's table."""
    yield "| object, lights | preset | measured normals, deg | of the surface, deg |"
    yield "| --- | --- | --- | --- |"
    for target in objects:
        count = len(target.lights)
        rng = np.random.default_rng(0)
        few = [
            sorted(rng.choice(count, FEW_LIGHTS, replace=False).tolist())
            for _ in range(DRAWS if count > FEW_LIGHTS else 0)
        ]
        for draws in [[list(range(count))], *([few] if few else [])]:
            for preset, (base, changes) in PRESETS.items():
                errors = np.array([errors_of(target, chosen, base, changes) for chosen in draws])
                cells = " | ".join(_cell(column) for column in errors.T)
                yield f"| {target.name}, {len(draws[0])} | `{preset}` | {cells} |"


def errors_of(
    target: Object, chosen: Sequence[int], preset: str, changes: dict[str, str]
) -> tuple[float, float]:
    result = reconstruct(target.capture(chosen), preset, changes)
    measured = result.normals_measured
    measured_deg = np.nan if measured is None else target.error_deg(measured)
    return measured_deg, target.error_deg(result.normals)


def _cell(errors: np.ndarray) -> str:
    if np.isnan(errors).any():
        return "none"
    spread = f" ({errors.min():.1f} to {errors.max():.1f})" if len(errors) > 1 else ""
    return f"{errors.mean():.1f}{spread}"


if __name__ == "__main__":
    sys.exit(main())
