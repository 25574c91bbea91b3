"""Simulated fingers before natural pictures, as telephones photograph them: how well the finger is segmented.

    python validation/match/composited.py POPULATION [--count 100] [--pictures FOLDER] [--look FILE.png]

POPULATION: a folder of ``splitknit simulate population`` with near-whole views. Each finger is lit by all white LEDs or
by one, has a drawn colour of skin (CIELAB, L* 40 to 75, a* 8 to 18, b* 10 to 22), is turned by up to 40 deg, laid over
one of the natural pictures that come with scikit-image (or those of FOLDER), and changed as the condition says. The
truth is the finger's outline. Overlap is intersection over union; figures have 95 % intervals by the binomial
distribution. Pictures without a finger have to be refused.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from splitknit.errors import BadInput
from splitknit_match.prints.fingerphoto import source_of_photo
from splitknit_match.prints.photo_mask import finger_in_photo

OUT = Path(__file__).resolve().parent / "tables" / "composited.csv"
CONDITIONS = (
    "daylight",
    "flash",
    "shade",
    "second finger",
    "blurred background",
    "out of focus",
    "JPEG 60",
    "smoothed",
)
NATURAL = ("astronaut.png", "brick.png", "chelsea.png", "coffee.png", "grass.png", "gravel.png", "motorcycle_left.png",
           "rocket.jpg")  # fmt: skip
TINTS = {"grass.png": (0.55, 0.8, 0.35), "gravel.png": (1.0, 0.93, 0.85), "brick.png": (0.9, 0.6, 0.5)}
"""Colours of what is stored in grey."""
CANVAS = (1600, 1200)
"""Rows, columns."""
WANTED = 0.95
Picture = NDArray[np.uint8]
Light = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Composite:
    """A photograph and the truth."""

    pixels: Picture
    mask: NDArray[np.bool_]
    condition: str
    background: str


def linear(picture: Picture | Light) -> Light:
    """sRGB to linear light."""
    value = picture / 255.0
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


def encoded(light: Light) -> Picture:
    """Linear light to sRGB."""
    light = np.clip(light, 0.0, 1.0)
    value = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * value).astype(np.uint8)


def background(name: str, folder: Path, rng: np.random.Generator) -> Light:
    """A part of a natural picture, in linear light, that fills the canvas."""
    stored = cv2.imread(str(folder / name), cv2.IMREAD_COLOR)
    assert stored is not None, name
    picture = np.asarray(stored[..., ::-1], dtype=np.uint8)
    least = max(CANVAS[0] / picture.shape[0], CANVAS[1] / picture.shape[1])
    scale = least * rng.uniform(1.0, 1.5)
    picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC))
    top, left = (rng.integers(0, picture.shape[k] - CANVAS[k] + 1) for k in (0, 1))
    return linear(picture[top : top + CANVAS[0], left : left + CANVAS[1]]) * TINTS.get(name, (1.0, 1.0, 1.0))


def finger(capture: Path, leds: Sequence[int], rng: np.random.Generator) -> tuple[Light, Light]:
    """Linear light (H, W, 3) of a capture under some of its LEDs, as bright as it is lit, and its outline (H, W)."""
    pictures = [cv2.imread(str(capture / f"white_{k}.png"), cv2.IMREAD_UNCHANGED) for k in leds]
    light = np.sum([one.astype(np.float64) for one in pictures], axis=0)[..., ::-1]
    with np.load(capture / "truth.npz") as truth:
        mask = truth["mask"].astype(np.float64)
    drawn = np.float32([[[rng.uniform(40, 75), rng.uniform(8, 18), rng.uniform(10, 22)]]])
    skin = cv2.cvtColor(drawn, cv2.COLOR_LAB2RGB)[0, 0]
    return light / light[mask > 0].mean(axis=0) * linear(255.0 * skin), mask


def laid(light: Light, mask: Light, rng: np.random.Generator) -> tuple[Light, Light]:
    """A finger on the canvas: turned, scaled, its cut base below the lower border."""
    rows, columns = np.nonzero(mask > 0)
    width = np.ptp(columns[rows > rows.max() - 5])
    scale, angle = rng.uniform(400, 700) / width, np.radians(rng.uniform(-40, 40))
    turn = scale * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    tip = np.array([columns[rows == rows.min()].mean(), rows.min()])
    base = np.array([[columns[rows == rows.max()].min(), rows.max()], [columns[rows == rows.max()].max(), rows.max()]])
    aim = np.array([rng.uniform(0.35, 0.65) * CANVAS[1], rng.uniform(0.15, 0.35) * CANVAS[0]])
    shift = aim - turn @ tip
    highest = (base @ turn.T + shift)[:, 1].min()
    shift[1] += max(0.0, CANVAS[0] + 3 - highest)
    matrix = np.column_stack([turn, shift])
    both = [cv2.warpAffine(part, matrix, CANVAS[::-1], flags=cv2.INTER_LINEAR) for part in (light, mask)]
    return both[0], cv2.GaussianBlur(both[1], (0, 0), 0.8)


def composite(number: int, captures: Sequence[Path], folder: Path, names: Sequence[str]) -> Composite:
    """The photograph of that number: conditions and backgrounds by turns, the rest drawn."""
    rng = np.random.default_rng([47, number])
    condition, name = CONDITIONS[number % len(CONDITIONS)], names[number // len(CONDITIONS) % len(names)]
    behind = background(name, folder, rng)
    leds = [int(rng.integers(0, 7))] if condition == "flash" else range(7)
    light, mask = laid(*finger(captures[number % len(captures)], leds, rng), rng)
    if condition == "second finger":
        other, outline = laid(*finger(captures[(number + 1) % len(captures)], range(7), rng), rng)
        moved = np.float64([[1, 0, rng.choice([-1, 1]) * rng.uniform(450, 700)], [0, 1, rng.uniform(0, 300)]])
        other, outline = (
            cv2.GaussianBlur(cv2.warpAffine(part, moved, CANVAS[::-1]), (0, 0), 5) for part in (other, outline)
        )
        behind = behind * (1 - outline[..., None]) + other * outline[..., None]
    if condition == "blurred background":
        behind = np.asarray(cv2.GaussianBlur(behind, (0, 0), 12))
    scene = behind * (1 - mask[..., None]) + light * mask[..., None]
    if condition == "out of focus":
        scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), 2.5))
    if condition == "shade":
        scene = scene * 0.25 * np.array([0.85, 1.0, 1.2])
    scene = scene * rng.uniform(0.92, 1.08, 3)
    pixels = encoded(scene)
    pixels = np.clip(pixels + rng.normal(0, 3 if condition == "shade" else 2, pixels.shape), 0, 255).astype(np.uint8)
    if condition == "smoothed":
        pixels = np.asarray(cv2.bilateralFilter(pixels, 7, 30, 3), dtype=np.uint8)
        blurred = cv2.GaussianBlur(pixels, (0, 0), 1.5)
        pixels = np.clip(1.8 * pixels.astype(float) - 0.8 * blurred, 0, 255).astype(np.uint8)
    quality = 60 if condition == "JPEG 60" else 92
    data = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded = np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1], dtype=np.uint8)
    return Composite(decoded, mask > 0.5, condition, name)


def overlap(one: Composite) -> float:
    """Intersection over union of the segmentation and the truth; 0 where the photograph is refused."""
    try:
        found = finger_in_photo(one.pixels).mask
    except BadInput:
        return 0.0
    return float(np.count_nonzero(found & one.mask) / np.count_nonzero(found | one.mask))


def interval(hits: int, count: int) -> str:
    """Percent with its 95 % interval (Clopper and Pearson)."""
    low = beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{100 * hits / count:.0f} [{100 * low:.0f}, {100 * high:.0f}]"


def main() -> int:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("population", type=Path)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--pictures", type=Path, help="folder of backgrounds, in colour")
    parser.add_argument("--look", type=Path, help="write a sheet of the photographs with the found outlines")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    captures = sorted(file.parent for file in options.population.rglob("truth.npz"))
    folder = options.pictures or default_pictures()
    names = NATURAL if options.pictures is None else sorted(file.name for file in folder.iterdir())
    rows, sheet = [], []
    for number in range(options.count):
        one = composite(number, captures, folder, names)
        value = overlap(one)
        rows.append({"number": number, "condition": one.condition, "background": one.background, "overlap": value})
        print(number, one.condition, one.background, f"{value:.3f}", flush=True)
        if options.look is not None:
            sheet.append(thumbnail(one))
    refused = {
        (name, seed): nothing(background(name, folder, np.random.default_rng(seed)))
        for name in names
        for seed in (5, 6)
    }
    with options.out.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**row, "overlap": f"{row['overlap']:.4g}"} for row in rows)
    for group in ("condition", "background"):
        of = Counter(row[group] for row in rows)
        good = Counter(row[group] for row in rows if row["overlap"] >= WANTED)
        print({name: interval(good[name], of[name]) for name in of})
    good_all = sum(row["overlap"] >= WANTED for row in rows)
    median = np.median([row["overlap"] for row in rows])
    print(f"overlap of {WANTED} in {interval(good_all, len(rows))} %; median {median:.3f}")
    print("pictures without a finger:", refused)
    if options.look is not None:
        columns = 10
        sheet += [np.zeros_like(sheet[0])] * (-len(sheet) % columns)
        lines = [np.hstack(sheet[k : k + columns]) for k in range(0, len(sheet), columns)]
        cv2.imwrite(str(options.look), np.vstack(lines)[..., ::-1])
    return 0


def default_pictures() -> Path:
    """Where scikit-image keeps its pictures."""
    import skimage.data

    return Path(skimage.data.__file__).parent


def nothing(scene: Light) -> str:
    """What is said of a picture without a finger."""
    try:
        found = source_of_photo(encoded(scene))
    except BadInput as error:
        return str(error)[:60]
    return f"taken for a finger of quality {found.quality}"


def thumbnail(one: Composite) -> Picture:
    """A small picture with the outline that was found (green) and the true one (blue)."""
    pixels = one.pixels.copy()
    marks = [(one.mask, (0, 0, 255))]
    try:
        marks.append((finger_in_photo(one.pixels).mask, (0, 255, 0)))
    except BadInput:
        pixels[:, :, 1:] //= 3
    for mask, colour in marks:
        outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(pixels, outlines, -1, colour, 10)
    return np.asarray(cv2.resize(pixels, (150, 200), interpolation=cv2.INTER_AREA), dtype=np.uint8)


if __name__ == "__main__":
    sys.exit(main())
