"""Drawn telephone photographs: any finger of a hand, any direction, paper, gardens and rooms;
scores.

    python validation/match/telephone.py --work FOLDER [--count 40]

A pinhole camera 110 to 250 mm from the finger sees elliptic, tapered fingers with the ridges of the
simulator's master prints: one, a second beside it, a hand of four, or one before a fist. Drawn for
each photograph: scale, pose (roll and pitch, turned at will), section, colour of skin, ridges'
contrast, light, gloss, shadow, background, defocus, shake, noise, smoothing, sharpening, JPEG
quality. Everything here is drawn by us: no photograph of a real finger.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import skimage.data
from fvc import FAR_0
from impostors import ship
from numpy.typing import NDArray
from pressed_prints import SENSORS, press
from scipy.ndimage import map_coordinates
from scipy.special import ellipeinc
from unseen import Pairs, table

from splitknit.errors import BadInput
from splitknit.io.csv_table import csv_text
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.fusion import fused_photo
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template
from splitknit_match.prints.fingerphoto import MIN_QUALITY, finger_of_photo
from splitknit_simulator.finger.finger import draw_finger

TABLES = Path(__file__).resolve().parent / "tables"
PICTURES = Path(skimage.data.__file__).parent
SEED = 47_000
CANVAS = (1632, 1224)
"""Rows, columns: half of a telephone's 3264 x 2448."""
PRESSES = ("fvc2002_db2b", "fvc2004_db1b")
HANDS = ("one finger", "second finger", "hand", "fist")
SCENES = ("paper", "garden", "room", "picture")
NATURAL = (
    "astronaut.png",
    "brick.png",
    "chelsea.png",
    "coffee.png",
    "grass.png",
    "gravel.png",
    "motorcycle_left.png",
    "rocket.jpg",
)
TINTS = {
    "grass.png": (0.55, 0.8, 0.35),
    "gravel.png": (1.0, 0.93, 0.85),
    "brick.png": (0.9, 0.6, 0.5),
}
"""Colours of what is stored in grey."""
Picture = NDArray[np.uint8]
Light = NDArray[np.float64]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Telephone:
    """A photograph and the truth."""

    pixels: Picture
    masks: tuple[NDArray[np.bool_], ...]
    """Of the finger in front, and of those beside it."""
    px_per_mm: float
    width_mm: float
    hand: str
    scene: str


def linear(picture: Picture | Light) -> Light:
    """sRGB to linear light."""
    value = picture / 255.0
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


def encoded(light: Light) -> Picture:
    """Linear light to sRGB."""
    light = np.clip(light, 0.0, 1.0)
    value = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.rint(255.0 * value).astype(np.uint8)


@lru_cache(maxsize=8)
def ridges(number: int) -> tuple[Array, Array, float, float, float]:
    """Ridges of a finger (H, W), and of its skin: heights of them, pitch and the place of (u, v) =
    0 in the map."""
    master = draw_finger(SEED + number).master()
    pitch = float(master.u_mm[1] - master.u_mm[0])
    height = master.ridge.astype(np.float64) - master.ridge.mean()
    return (
        height,
        cv2.GaussianBlur(height, (0, 0), 3),
        pitch,
        float(master.u_mm[0]),
        float(master.v_mm[0]),
    )


@dataclass(frozen=True, slots=True)
class Body:
    """One finger, mm: half its width, depth over width, taper per mm, and where its tip begins."""

    half_mm: float
    depth: float
    taper: float
    length_mm: float
    pad_mm: float
    aside_mm: float = 0.0
    behind_mm: float = 0.0
    ahead_mm: float = 0.0
    number: int = 0


def body_of(number: int) -> Body:
    """The finger of a number, the same in each of its photographs."""
    rng = np.random.default_rng([number, 1])
    half = rng.normal(8.4, 0.8)
    return Body(
        half,
        rng.uniform(0.7, 0.95),
        rng.uniform(0.0, 0.006),
        rng.uniform(1.0, 1.3) * half,
        rng.uniform(14, 17),
        number=number,
    )


def seen(body: Body, rays: Array, eye: Array) -> tuple[NDArray[np.bool_], Array, Array, Array]:
    """Where rays (H, W, 3) from `eye` meet a finger along y, tip ahead: hits, points, normals and
    (u, v) in mm."""
    middle = np.array([body.aside_mm, body.ahead_mm, -body.behind_mm])
    start = eye - middle
    a, c, length, k = body.half_mm, body.half_mm * body.depth, body.length_mm, body.taper
    best = np.full(rays.shape[:2], np.inf)
    where = np.zeros(rays.shape[:2], np.int8)
    scale_x, scale_z = 1 / a**2, 1 / c**2
    dx, dy, dz = rays[..., 0], rays[..., 1], rays[..., 2]
    for part in (0, 1):  # the cone of the body, the ellipsoid of the tip
        if part == 0:
            w0, wd = 1 - k * start[1], -k * dy
            qa = dx**2 * scale_x + dz**2 * scale_z - wd**2
            qb = dx * start[0] * scale_x + dz * start[2] * scale_z - w0 * wd
            qc = start[0] ** 2 * scale_x + start[2] ** 2 * scale_z - w0**2
        else:
            qa = dx**2 * scale_x + dz**2 * scale_z + dy**2 / length**2
            qb = dx * start[0] * scale_x + dz * start[2] * scale_z + dy * start[1] / length**2
            qc = start[0] ** 2 * scale_x + start[2] ** 2 * scale_z + start[1] ** 2 / length**2 - 1
        root = qb**2 - qa * qc
        with np.errstate(invalid="ignore", divide="ignore"):
            t = (-qb - np.sqrt(root)) / qa
        y = start[1] + t * dy
        good = (root > 0) & (t > 0) & (t < best) & ((y > 0) if part else (y <= 0) & (y > -95))
        best[good], where[good] = t[good], part
    hit = np.isfinite(best)
    t = np.where(hit, best, 0.0)
    point = start + t[..., None] * rays
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    tip = where == 1
    normal = np.stack([x * scale_x, np.where(tip, y / length**2, k * (1 - k * y)), z * scale_z], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    phi = np.arctan2(x / a, z / c)
    round_tip = np.sqrt(np.clip(1 - (np.clip(y, 0, length) / length) ** 2, 0, 1))
    u = a * ellipeinc(phi, 1 - body.depth**2) * np.where(tip, round_tip, 1 - k * y)
    v = body.pad_mm + np.where(tip, length * np.arcsin(np.clip(y / length, -1, 1)), y)
    return hit, point + middle, normal, np.stack([u, v], -1)


def skin_light(body: Body, normal: Array, uv: Array, lit: dict[str, Any]) -> Array:
    """(H, W) light of the skin, ridges, creases and gloss in it."""
    height, smooth, pitch, u0, v0 = ridges(body.number % 1000)
    rows = (v0 - uv[..., 1]) / pitch
    rows = (
        np.abs((rows + len(height)) % (2 * len(height)) - len(height))
        if rows.max() > len(height)
        else rows
    )
    columns = (uv[..., 0] - u0) / pitch
    places = np.stack([np.clip(rows, 0, len(height) - 1), np.clip(columns, 0, height.shape[1] - 1)])
    sharp, soft = (
        map_coordinates(relief.astype(np.float32), places, order=1) for relief in (height, smooth)
    )
    slope = np.stack(np.gradient(smooth), 0) / pitch
    down, right = (
        map_coordinates(component.astype(np.float32), places, order=1) for component in slope
    )
    light = lit["direction"]
    lambert = np.clip(normal @ light, 0, None)
    tilt = 0.025 * lit["relief"] * (light[1] * down - light[0] * right)
    shade = lit["ambient"] * (0.55 + 0.45 * normal[..., 2]) + (1 - lit["ambient"]) * np.clip(
        lambert + tilt, 0, None
    )
    shade *= 1 + lit["contrast"] * (0.5 * sharp + 0.5 * soft)
    for crease in (0.0, 1.6, -24.0, -26.0, -46.0):
        shade *= 1 - 0.35 * np.exp(
            -(((uv[..., 1] - crease - 0.03 * uv[..., 0] ** 2 * 0.3) / 0.35) ** 2)
        )
    half = light + np.array([0, 0, 1.0])
    half /= np.linalg.norm(half)
    return shade + lit["gloss"] * np.clip(normal @ half, 0, 1) ** 40


def colour_of_skin(rng: np.random.Generator) -> Array:
    """Linear RGB of skin of any tone."""
    drawn = np.float32([[[rng.uniform(42, 78), rng.uniform(8, 20), rng.uniform(10, 24)]]])
    return linear(255.0 * cv2.cvtColor(drawn, cv2.COLOR_LAB2RGB)[0, 0].astype(np.float64))


def behind(scene: str, rng: np.random.Generator) -> Light:
    """A background on the canvas, in linear light."""
    rows, columns = CANVAS
    if scene == "paper":
        row, column = np.indices(CANVAS) / max(CANVAS)
        level = rng.uniform(0.35, 0.85) * (
            1 + rng.uniform(-0.4, 0.4) * row + rng.uniform(-0.4, 0.4) * column
        )
        return level[..., None] * np.array([1.0, rng.uniform(0.93, 1.0), rng.uniform(0.8, 1.0)])
    name = {
        "garden": ("grass.png", "gravel.png")[rng.integers(2)],
        "room": ("coffee.png", "motorcycle_left.png")[rng.integers(2)],
    }.get(scene) or NATURAL[rng.integers(len(NATURAL))]
    stored = cv2.imread(str(PICTURES / name), cv2.IMREAD_COLOR)
    assert stored is not None, name
    scale = max(rows / stored.shape[0], columns / stored.shape[1]) * rng.uniform(1.0, 1.8)
    picture = cv2.resize(stored[..., ::-1], None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    top, left = (rng.integers(0, picture.shape[k] - CANVAS[k] + 1) for k in (0, 1))
    light = linear(picture[top : top + rows, left : left + columns]) * TINTS.get(
        name, (1.0, 1.0, 1.0)
    )
    if scene == "garden":
        for _ in range(rng.integers(4, 30)):  # leaves, dry ones too
            green = rng.uniform(0.2, 1.0)
            tone = np.array(
                [rng.uniform(0.05, 0.5), 0.1 + 0.4 * green, rng.uniform(0.02, 0.15)]
            ) * rng.uniform(0.3, 1.2)
            leaf = np.zeros(CANVAS, np.float32)
            size = rng.uniform(30, 260)
            place = (int(rng.uniform(0, columns)), int(rng.uniform(0, rows)))
            cv2.ellipse(
                leaf,
                place,
                (int(size), int(size * rng.uniform(0.2, 0.6))),
                rng.uniform(0, 180),
                0,
                360,
                1,
                -1,
            )
            light = light * (1 - leaf[..., None]) + leaf[..., None] * tone
    blur = rng.choice([0.0, 2.0, 6.0, 15.0])
    return np.asarray(cv2.GaussianBlur(light, (0, 0), blur)) if blur else light


def bodies_of(body: Body, hand: str, rng: np.random.Generator) -> list[Body]:
    """The finger and what is beside or behind it."""
    bodies = [body]
    for k in {"second finger": (1,), "hand": (1, -1, 2)}.get(hand, ()):
        extra = body_of(body.number + 500 + k)
        gap = (2.0 + rng.uniform(0.02, 0.6)) * body.half_mm * k
        deep = rng.uniform(0, 6) if hand == "hand" else rng.uniform(2, 15)
        ahead = rng.uniform(-14, 4)
        bodies.append(replace(extra, aside_mm=gap, behind_mm=deep, ahead_mm=ahead))
    for k in range(4 if hand == "fist" else 0):
        aside, deep, ahead = rng.uniform(-14, 14), rng.uniform(4, 14), rng.uniform(-62, -42)
        bodies.append(Body(11 + k, 0.9, 0, 12, 10, aside, deep, ahead, 999))
    return bodies


def developed(picture: Light, rng: np.random.Generator) -> Picture:
    """What a telephone makes of light: defocus, noise, smoothing, sharpening, JPEG."""
    soft = rng.choice([0.7, 1.0, 1.5, 2.2])
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), soft))
    pixels = encoded(picture)
    pixels = np.clip(pixels + rng.normal(0, rng.uniform(1, 5), pixels.shape), 0, 255).astype(
        np.uint8
    )
    if rng.random() < 0.4:
        pixels = np.asarray(cv2.bilateralFilter(pixels, 7, 25, 3), dtype=np.uint8)
    if rng.random() < 0.6:
        pixels = np.clip(
            1.6 * pixels.astype(float) - 0.6 * cv2.GaussianBlur(pixels, (0, 0), 1.5), 0, 255
        ).astype(np.uint8)
    data = cv2.imencode(
        ".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 96))]
    )[1]
    return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1], dtype=np.uint8)


def view(body: Body, hand: str, rng: np.random.Generator) -> tuple[Array, Array, Array, float]:
    """Rays (H, W, 3) of the pixels and the eye in the finger's frame, turn of that frame, and px/mm
    at the finger."""
    rows, columns = CANVAS
    far = rng.uniform(110, 250)
    width_px = rng.uniform(0.22, 0.45 if hand == "one finger" else 0.34) * columns
    px_per_mm = width_px / (2 * body.half_mm)
    focal = px_per_mm * far
    turn = rng.uniform(-np.pi, np.pi)
    cos = np.cos(turn)
    sin = np.sin(turn)
    ahead = np.array([-sin, -cos])  # of the tip, in the image (right, down)
    tip = (
        np.array([columns, rows]) / 2
        + ahead * rng.uniform(-0.05, 0.3) * np.array([columns, rows]) / 2
    )
    tip += rng.uniform(-0.1, 0.1, 2) * columns
    row, column = np.indices(CANVAS).astype(np.float64)
    x, y = (column - tip[0]) / focal, -(row - tip[1]) / focal
    rays = np.stack([cos * x + sin * y, -sin * x + cos * y, -np.ones(CANVAS)], -1)
    roll = np.radians(rng.normal(0, 8))
    pitch = np.radians(rng.normal(0, 9))
    rx = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    ry = np.array([[np.cos(roll), 0, np.sin(roll)], [0, 1, 0], [-np.sin(roll), 0, np.cos(roll)]])
    rotation = ry @ rx
    eye = np.array([0, 0, far]) @ rotation + np.array([0, body.length_mm, 0])
    return rays @ rotation, eye, rotation, px_per_mm


def photographed(number: int, take: int, hand: str, scene: str) -> Telephone:
    """Photograph `take` of a finger, the same each time."""
    rng = np.random.default_rng([number, take, 2])
    rows, columns = CANVAS
    body = body_of(number)
    rays, eye, rotation, px_per_mm = view(body, hand, rng)
    bodies = bodies_of(body, hand, rng)
    direction = np.array([rng.normal(0, 0.5), rng.normal(0.3, 0.5), 1.0])
    lit = {
        "direction": direction / np.linalg.norm(direction),
        "ambient": rng.uniform(0.25, 0.7),
        "contrast": rng.uniform(0.03, 0.14),
        "relief": rng.uniform(0.5, 2.0),
        "gloss": rng.choice([0, 0.05, 0.2]),
    }
    skin = colour_of_skin(rng)
    picture = behind(scene, rng)
    masks = [np.zeros(CANVAS, np.bool_) for _ in bodies]
    hits = []
    for finger in bodies:
        hit, point, normal, uv = seen(finger, rays, eye)
        hits.append((hit, np.where(hit, np.linalg.norm(point - eye, axis=-1), np.inf), normal, uv))
    owner = np.argmin([view[1] for view in hits], axis=0)
    covered = np.any([view[0] for view in hits], axis=0)
    if scene == "paper" and rng.random() < 0.7:
        shift = rng.uniform(-60, 60, 2)
        moved = np.float32([[1, 0, shift[0]], [0, 1, shift[1]]])
        shadow = cv2.warpAffine(covered.astype(np.float64), moved, CANVAS[::-1])
        picture *= (
            1
            - rng.uniform(0.2, 0.6)
            * cv2.GaussianBlur(shadow, (0, 0), rng.uniform(8, 40))[..., None]
        )
    mottle = cv2.resize(
        rng.normal(0, 1, (rows // 40, columns // 40)), CANVAS[::-1], interpolation=cv2.INTER_CUBIC
    )
    for k, (finger, (hit, _, normal, uv)) in enumerate(zip(bodies, hits, strict=True)):
        visible = hit & (owner == k)
        masks[k] = visible
        if not visible.any():
            continue
        box = np.argwhere(visible)
        part = tuple(slice(low, high + 1) for low, high in zip(box.min(0), box.max(0), strict=True))
        value = skin_light(finger, normal[part] @ rotation.T, uv[part], lit)
        flank = 1 - np.clip((normal[part] @ rotation.T)[..., 2], 0, 1)
        tone = skin * np.exp(-flank[..., None] * np.array([0.1, 0.45, 0.4]))
        tone = tone * (1 + 0.04 * mottle[part][..., None] * np.array([0.5, 1.0, 1.0]))
        picture[part][visible[part]] = (1.25 * value[..., None] * tone)[visible[part]]
    picture *= rng.uniform(0.92, 1.08, 3)
    if rng.random() < 0.3:
        picture *= rng.uniform(0.4, 0.8)  # shade
    decoded = developed(picture, rng)
    return Telephone(decoded, tuple(masks), px_per_mm, 2 * body.half_mm, hand, scene)


def drawn(number: int, take: int, work: Path) -> Telephone:
    """Photograph of a finger, each hand and scene in turn; kept in `work`."""
    file = work / f"photo_{number}_{take}.pickle"
    if not file.is_file():
        hand, scene = HANDS[(number + take) % 4], SCENES[(number // 4 + take) % 4]
        file.write_bytes(pickle.dumps(photographed(number, take, hand, scene)))
    kept: Telephone = pickle.loads(file.read_bytes())
    return kept


def side_of(number: int, take: int, work: Path) -> tuple[Template | None, float]:
    """Template of a photograph, whose finger is known, and its quality; None where it is
    refused."""
    file = work / f"side_{number}_{take}.pickle"
    if not file.is_file():
        photo = drawn(number, take, work)
        try:
            source = finger_of_photo(photo.pixels, mask=photo.masks[0])
            kept = print_template(source.flat, pressed=source.pressed), source.quality or 0.0
        except BadInput as error:
            print(number, take, error, flush=True)
            kept = None, 0.0
        file.write_bytes(pickle.dumps(kept))
    template_and_quality: tuple[Template | None, float] = pickle.loads(file.read_bytes())
    return template_and_quality


def scores(count: int, work: Path, write: bool) -> None:
    """Photographs against presses of all fingers, and those of the same and the next six: the best
    scale's score."""
    presses = []
    for number in range(count):
        master = draw_finger(SEED + number).master()
        presses.append(
            Prepared(print_template(press(master, number % 2, SENSORS[PRESSES[number % 2]])))
        )
    photos = [
        (number, take, *side_of(number, take, work)) for take in (0, 1) for number in range(count)
    ]
    rows: list[Row] = []
    for k, (i, take, template, quality) in enumerate(photos):
        side = None if template is None else Prepared(template)
        others = [(f"press {j}", presses[j], quality) for j in range(count)]
        others += [
            (f"{j}.{other_take}", None if other is None else Prepared(other), min(quality, least))
            for j, other_take, other, least in photos[k + 1 :]
            if (j - i) % count <= 6
        ]
        for name, other, least in others:
            score = -np.inf
            if side is not None and other is not None:
                free = True, not name.startswith("press")
                score = fused_photo(side, other, free)[0].similarity
            rows.append(Row(f"{i}.{take}", name, round(least), round(float(score), 3)))
        print(i, take, f"{quality:.0f}", flush=True)
    (TABLES / "telephone_scores.csv").write_text(csv_text([Row._fields, *rows]), encoding="utf-8")
    for pressed, (kind, what) in KINDS.items():
        of_kind = [row for row in rows if row.pressed == pressed]
        if write:
            words = f"drawn telephone photographs of {count} simulated fingers, {what}"
            by = "validation/match/telephone.py --write"
            ship(f"fingerphotos {kind}", table(impostors_of(of_kind), words, by))
        rated(kind, of_kind)


class Row(NamedTuple):
    """A comparison of a photograph with another one, or with a press."""

    a: str
    b: str
    quality: int
    score: float

    @property
    def pressed(self) -> bool:
        """Whether the other side is a press."""
        return self.b.startswith("press")

    @property
    def fingers(self) -> tuple[str, str]:
        """Of both sides."""
        return self.a.split(".")[0], self.b.removeprefix("press ").split(".")[0]

    @property
    def same(self) -> bool:
        """Whether both sides are of one finger."""
        return len(set(self.fingers)) == 1


def impostors_of(rows: list[Row]) -> Pairs:
    """Compared pairs of two fingers."""
    kept = [row for row in rows if not row.same and np.isfinite(row.score)]
    a, b = np.array([row.fingers for row in kept], int).T
    score = np.array([row.score for row in kept])
    return Pairs(a, b, a, b, score, np.zeros(len(kept), bool))


KINDS = {True: ("and prints", "against presses"), False: ("alone", "against each other")}


def rated(kind: str, rows: list[Row]) -> None:
    """Equal error rate and misses above every impostor's score, by least quality; intervals of 95 %
    draw fingers."""
    settings = BootstrapSettings(replicates=300, targets=(FAR_0,), curve_points=0)
    for least in (0, MIN_QUALITY, 30, 50):
        part = [row for row in rows if row.quality >= least]
        if not any(row.same for row in part):
            continue
        ids = ids_of(*zip(*(row.fingers for row in part), strict=True))
        score = np.array([row.score if np.isfinite(row.score) else np.nan for row in part])
        pairs = Scores(ids.same, score, finger=ids, name=kind)
        figures = bootstrap(pairs, "finger", settings).figures
        eer, gar = figures["eer"], figures[f"gar@{FAR_0:g}"]
        print(
            f"{kind}, quality {least:g} or more: {pairs.genuine.size} genuine pairs,"
            f" {pairs.impostor.size} impostors: EER {100 * eer.value:.1f} [{100 * eer.low:.1f},"
            f" {100 * eer.high:.1f}] %, FNMR above all impostors {100 - 100 * gar.value:.1f}"
            f" [{100 - 100 * gar.high:.1f}, {100 - 100 * gar.low:.1f}] %",
            flush=True,
        )


def main() -> int:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--work", type=Path, required=True, help="keeps the photographs")
    parser.add_argument(
        "--write", action="store_true", help="write the table of impostor scores of `match`"
    )
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    scores(options.count, options.work, options.write)
    return 0


if __name__ == "__main__":
    sys.exit(main())
