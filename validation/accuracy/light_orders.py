"""Photographs under other lights than those they are given: the residual, what is advised, and what obeying it gains.

    python validation/accuracy/light_orders.py

Objects, path-traced fingers and the field of balls of SPLITKNIT_DATA, and three simulated fingers, each with its lights
in their own order, in wrong orders, and in another frame. It prints the table that
``tables/light_orders.csv`` holds; docs/experiments/objects.md has the conclusions.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import splitknit
import splitknit_simulator
from objects import scanned, sphere
from splitknit.finger.locate import reduced
from splitknit.imaging.band import linear_stack
from splitknit.io.images import read_image
from splitknit.io.light_list import read_light_list
from splitknit.io.npz import read_npz
from splitknit.model import BoolArray, Capture, FloatArray
from splitknit.photometric.frames import LightFit, fit_lights
from splitknit.photometric.lambertian import lambertian

SIDE = 300
"""Pixels a side of what is compared, as in a reconstruction."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Small photographs, their lights, and the true normals where they are known."""

    name: str
    stack: FloatArray
    lights: FloatArray
    mask: BoolArray
    normals: FloatArray | None = None

    def error(self, order: tuple[int, ...], given: FloatArray) -> str:
        """Mean angle between the truth and the normals of the photographs in an order, deg."""
        if self.normals is None:
            return "-"
        found, _ = lambertian(self.stack[list(order)], given, self.mask)
        where = self.mask & (np.linalg.norm(self.normals, axis=-1) > 0.5)
        cosine = np.clip((found * self.normals).sum(axis=-1)[where], -1, 1)
        return f"{np.degrees(np.arccos(cosine)).mean():.1f}"


def main() -> int:
    """Measure all that is there."""
    data = Path(os.environ.get("SPLITKNIT_DATA", "../shared/data"))
    print("| data, lights | order | left, % | error, deg | advice | left then, % | error then, deg |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for scene in scenes(data):
        for line in rows(scene):
            print(line, flush=True)
    return 0


def scenes(data: Path) -> Iterator[Scene]:
    """All that is there."""
    for one in [scanned(data / "diligent" / "bear.npz"), sphere(data / "psm_spheres" / "gray")]:
        every = max(1, max(one.mask.shape) // SIDE)
        step = np.s_[::every, ::every]
        stack = one.images[:, ::every, ::every].astype(np.float32) / np.float32(one.images.max())
        yield Scene(one.name, stack, np.asarray(one.lights), one.mask[step], one.normals[step])
    phalange = data / "blender_finger" / "phalange"
    stack = np.maximum(_small([phalange / f"light_{k:02d}.png" for k in range(12)]) - 71.0, 0.0)
    inside = _small([phalange / "mask.png"])[0] > 127
    yield Scene("sculpted phalange (rendered)", stack, read_light_list(phalange / "lights.txt").lights, inside)
    for name in ("BGA-001", "Flat-001"):
        files = [data / "elastomer" / name / f"image{k:02d}.png" for k in range(7, 13)]
        stack = _small(files)
        what = "field of balls" if name == "BGA-001" else "flat gel"
        yield Scene(what, stack, lights_of_balls(data), np.ones(stack.shape[1:], dtype=bool))
    for name in ("loop", "print"):
        mask = read_npz(data / "path_traced" / f"{name}_truth.npz")["mask"].astype(bool)
        yield _of_capture(f"path-traced {name}", splitknit.read_capture(data / "path_traced" / name), mask)
    for seed in (1, 2, 3):
        capture, truth = splitknit_simulator.simulate_capture(seed, settings={"scale": 0.12})
        yield _of_capture(f"simulated finger {seed}", capture, np.asarray(truth["mask"], dtype=bool))


def rows(scene: Scene) -> Iterator[str]:
    """Lines of the table."""
    count = len(scene.lights)
    own = np.arange(count)
    middle = count // 2
    orders = {
        "right": own,
        "reversed": own[::-1],
        "shifted by 1": np.roll(own, -1),
        "two neighbours exchanged": np.r_[: middle - 1, middle, middle - 1, middle + 1 : count],
        "shuffled": np.random.default_rng(1).permutation(count),
    }
    for name, order in orders.items():
        fit = fit_lights(scene.stack[order], scene.lights, scene.mask)
        yield _row(scene, name, tuple(order.tolist()), fit, scene.lights)
    down = scene.lights * np.array([1.0, -1.0, 1.0])
    yield _row(scene, "y measured downwards", tuple(range(count)), fit_lights(scene.stack, down, scene.mask), down)


def _row(scene: Scene, name: str, order: tuple[int, ...], fit: LightFit, given: FloatArray) -> str:
    obeyed = given[list(fit.order)]
    if fit.order == tuple(range(len(order))):
        advice = "none" if fit.frame == "right-up" else f"`{fit.frame}`"
        if fit.frame == "right-down":
            obeyed = given * np.array([1.0, -1.0, 1.0])
    else:
        advice = "the right order" if fit.order == order else "an order"
        advice += "" if fit.frame == "right-up" else f", or `{fit.frame}`"
    left, then = f"{100 * fit.residual:.1f}", f"{100 * fit.residual_in_order:.1f}"
    errors = scene.error(order, given), scene.error(order, obeyed)
    return f"| {scene.name}, {len(order)} | {name} | {left} | {errors[0]} | {advice} | {then} | {errors[1]} |"


def lights_of_balls(data: Path) -> FloatArray:
    """Light vectors of the gel's six lights, by least squares on the tops of the balls whose outlines are listed."""
    text = (data / "elastomer" / "BGA-001" / "scan.yaml").read_text()
    files = [data / "elastomer" / "BGA-001" / f"image{k:02d}.png" for k in range(7, 13)]
    stack = np.stack([read_image(file)[..., 0] for file in files]).astype(np.float64)
    normals, light = [], []
    for found in re.findall(r"r: ([\d.]+)\s+x: ([\d.-]+)\s+y: ([\d.-]+)", text):
        radius, column, row = (float(value) for value in found)
        reach, x0, y0 = int(0.6 * radius), round(column), round(row)
        if min(x0, y0) < reach or x0 + reach >= stack.shape[2] or y0 + reach >= stack.shape[1]:
            continue
        down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius
        top = across**2 + down**2 < 0.36
        up = np.sqrt(np.maximum(1.0 - across**2 - down**2, 0.0))
        normals.append(np.stack([across, -down, up], axis=-1)[top])
        light.append(stack[:, y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1][:, top].T)
    return np.linalg.lstsq(np.concatenate(normals), np.concatenate(light), rcond=None)[0].T / 255.0


def _small(files: list[Path]) -> FloatArray:
    """Grey images (L, h, w) of some 300 pixels a side."""
    images = [read_image(file).mean(axis=2, dtype=np.float32) for file in files]
    every = max(1, max(images[0].shape) // SIDE)
    size = (images[0].shape[1] // every, images[0].shape[0] // every)
    return np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images])


def _of_capture(name: str, capture: Capture, mask: BoolArray) -> Scene:
    band = capture.bands["white"]
    stack = linear_stack(band, capture.encoding, "grey", binning=max(1, max(capture.shape) // SIDE))
    lights = capture.rig.select(band.lights).light_vectors()
    return Scene(name, stack, lights, reduced(mask, stack.shape[1:]))


if __name__ == "__main__":
    sys.exit(main())
