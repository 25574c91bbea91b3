"""Mistakes made on purpose with real photographs: which are named.

    python validation/objects/mistakes.py [NAME ...]

Bear and ball of DiLiGenT, a grey sphere, the coin and the fossil of a home-made dome, where the data
lie ($SPLITKNIT_DATA). Limits were chosen on bear, ball and coin; sphere and fossil were looked at
while some changed.
Writes tables/mistakes.csv: the mistake's effect on least-squares normals (median, in degrees), and
what is said.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from dome import BALLS, DATA, calibrated
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.imaging.pixels import srgb_code
from splitknit.io.csv_table import csv_text
from splitknit.methods.photographs import FingerPhotographs
from splitknit.observation.plain import capture_of_arrays
from splitknit.photometric.lambertian import lambertian
from splitknit.pipeline import located

TABLE = Path(__file__).with_name("tables") / "mistakes.csv"
Array = NDArray[np.float64]
Photographed = tuple[Array, Array, Array | None]
"""Linear light (L, H, W), unit vectors to the lights (L, 3), and the object (H, W)."""


def thing(name: str) -> Photographed:
    """One of :data:`THINGS`."""
    if name in {"bear", "ball"}:
        with np.load(DATA / "diligent" / f"{name}.npz") as data:
            images = data["images"].astype(np.float64)
            mask = data["mask"] if "mask" in data else images.mean(0) > 0.02 * images.mean(0).max()
            return images / images.max(), data["lights"].astype(np.float64), mask.astype(bool)
    if name == "sphere":
        lines = (DATA / "psm_spheres" / "lights.txt").read_text("ascii").split()
        lights = np.array(lines[1:], dtype=np.float64).reshape(-1, 3)
        gray = DATA / "psm_spheres" / "gray"
        files = [gray / f"gray.{k}.png" for k in range(len(lights))]
        mask = cv2.imread(str(gray / "gray.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
        return np.stack([cv2.imread(str(each), 0) / 255.0 for each in files]), lights, mask
    if name == "coin":
        images, lights = of_dome("birr", BALLS["birr"][0], np.s_[495:995, 898:1398], 2)
        y, x = 2 * np.mgrid[: images.shape[1], : images.shape[2]]
        return images, lights, np.hypot(x - 250, y - 250) < 238
    return *of_dome("ammonite", BALLS["ammonite"][0], np.s_[:, 300:2000], 3), None


def of_dome(name: str, ball: str, box: tuple[slice, slice], every: int) -> tuple[Array, Array]:
    """Reduced photographs under a dome, and directions from the glints on one of its balls."""
    with tempfile.TemporaryDirectory() as folder:
        lights = Path(folder) / "lights.lp"
        calibrated(DATA / "dome" / name, [ball], lights)
        rows = [line.split() for line in lights.read_text("utf-8").splitlines()[1:]]
    codes = np.linspace(0, 1, 4096)
    images = []
    for file, *_ in rows:
        stored = cv2.imread(str(DATA / "dome" / name / file))[box] / 255.0
        linear = np.interp(stored, srgb_code(codes), codes).mean(axis=2)
        size = (linear.shape[1] // every, linear.shape[0] // every)
        images.append(cv2.resize(linear, size, interpolation=cv2.INTER_AREA))
    return np.stack(images), np.array([row[1:4] for row in rows], dtype=np.float64)


THINGS = ("bear", "ball", "coin", "sphere", "fossil")


def mistakes(images: Array, lights: Array, inside: Array) -> Iterator[tuple[str, Array, Array]]:
    """What is done, the photographs, and their lights."""
    count = len(lights)
    k = count // 3
    yield "none", images, lights
    yield "lights reversed", images, lights[::-1]
    yield "lights shifted by one", images, np.roll(lights, 1, axis=0)
    first, second = np.argsort(np.arctan2(lights[:, 1], lights[:, 0]))[k : k + 2]
    exchanged = lights.copy()
    exchanged[[first, second]] = exchanged[[second, first]]
    yield "two neighbours exchanged", images, exchanged
    yield "y points down", images, lights * [1, -1, 1]
    yield "turned by 90 deg", images, np.column_stack([-lights[:, 1], lights[:, 0], lights[:, 2]])
    lamps = np.exp(0.12 * np.random.default_rng(7).standard_normal(count))
    yield "lamps differ by 12 %", images * lamps[:, None, None], lights
    yield "stored as sRGB, stated linear", srgb_code(images.clip(0, 1)), lights
    yield "tone curve, exponent 0.8", images**0.8, lights
    yield "ambient light, 15 %", images + 0.15 * np.median(images[:, inside]), lights
    spoilt = images.copy()
    spoilt[k] = cv2.GaussianBlur(images[k], (0, 0), 3)
    yield "one blurred by 3 px", spoilt, lights
    spoilt = images.copy()
    spoilt[k] = np.roll(images[k], (3, 3), (0, 1))
    yield "one moved by 4 px", spoilt, lights
    spoilt = images.copy()
    spoilt[k] = 0.97 * images[(k + count // 2) % count]
    yield "one under another light", spoilt, lights
    spoilt = images.copy()
    spoilt[k] *= 0.4
    yield "one lamp at 0.4", spoilt, lights
    slant = np.hypot(lights[:, 0], lights[:, 1])
    up = np.arctan2(lights[:, 2], slant) + np.deg2rad(12)
    level = lights[:, :2] * (np.cos(up) / np.maximum(slant, 1e-9))[:, None]
    yield "lights stated 12 deg too high", images, np.column_stack([level, np.sin(up)])


def photographs_of(images: Array, lights: Array, mask: Array | None) -> FingerPhotographs:
    """The object in photographs stored as 16 bits, and what is wrong with them."""
    codes = np.clip(images / images.max() * 65535, 0, 65535).astype(np.uint16)
    return located(capture_of_arrays(codes, lights, mask, 10.0)[0])


def said(images: Array, lights: Array, mask: Array | None) -> str:
    """Codes of the findings on photographs."""
    try:
        findings = photographs_of(images, lights, mask).findings
    except BadInput as error:
        return f"refused: {error}"
    left_open = {"overexposed-photograph", "saturated-photograph", "scale-unknown"}
    return "; ".join(sorted({each.code for each in findings} - left_open))


def main() -> None:
    """Measure, and write the table."""
    rows = [["thing", "mistake", "effect_deg", "said"]]
    for name in sys.argv[1:] or THINGS:
        images, lights, mask = thing(name)
        lights /= np.linalg.norm(lights, axis=1, keepdims=True)
        if mask is None:
            mask = photographs_of(images, lights, None).finger.mask
        sound = lambertian(images, lights, mask)[0]
        for mistake, spoilt, stated in mistakes(images, lights, mask):
            cosine = (lambertian(spoilt, stated, mask)[0] * sound).sum(axis=2)[mask]
            effect = np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))
            row = [name, mistake, f"{effect:.1f}", said(spoilt, stated, mask)]
            print(*row, sep="  ", flush=True)
            rows.append(row)
    if not sys.argv[1:]:
        TABLE.write_text(csv_text(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
