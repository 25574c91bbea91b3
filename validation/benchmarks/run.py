"""Public benchmarks, for whoever has them: one command a benchmark, with the folder's path.

    python validation/benchmarks/run.py diligent FOLDER  # DiLiGenT, DiLiGenT-Pi: a folder an object
    python validation/benchmarks/run.py luces FOLDER     # LUCES: near lights, depth in mm
    python validation/benchmarks/run.py prints FOLDER --pattern '{finger}_{sample}.png'
    python validation/benchmarks/run.py prints PHOTOS --pattern '{finger}/{sample}.jpg' \\
        --against PRINTS --against-pattern '{finger}_{sample}.bmp'  # PolyU, ISPFD, ZJUT-EIFD

An object's row has the mean angle between the normals and the truth in degrees (as photometric
stereo measured them, and of the surface) and, where the truth has depth, the mean absolute error in
mm after the mean is removed. A set of prints, photographs or result folders has its equal error
rate, and the rates at the decision of ``match``, with 95 % intervals by finger. `--json FILE` keeps
every row.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from splitknit import reconstruct
from splitknit.capture import Band, Capture
from splitknit.errors import BadInput, require
from splitknit.io.images import read_image
from splitknit.model import Camera, Led, Rig
from splitknit_match import match
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching.match import make_template

PRESETS = ("metric", "ea")
PX_PER_MM = 5.0
"""Where lights are distant, the scale that is stated; normals do not depend on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Photographs of an object, and the truth in this project's frame (x right, y up, z to the
    camera)."""

    name: str
    capture: Capture
    normals: np.ndarray
    height_mm: np.ndarray | None = None

    def row(self, preset: str) -> dict[str, Any]:
        """Errors of a preset."""
        result = reconstruct(self.capture, preset)
        figures: dict[str, Any] = {
            "object": self.name,
            "preset": preset,
            "lights": len(self.capture.rig.leds),
        }
        measured = result.normals_measured
        figures["measured_deg"] = None if measured is None else self.error_deg(measured)
        figures["surface_deg"] = self.error_deg(result.normals)
        if self.height_mm is not None:
            error = (result.height_mm - self.height_mm)[result.mask & np.isfinite(self.height_mm)]
            figures["height_mm"] = float(np.mean(np.abs(error - error.mean())))
        return figures

    def error_deg(self, normals: np.ndarray) -> float:
        """Mean angle to the truth."""
        assert self.capture.mask is not None
        where = self.capture.mask & (np.linalg.norm(self.normals, axis=-1) > 0.5)
        cosine = np.clip((normals * self.normals).sum(axis=-1)[where], -1, 1)
        return float(np.degrees(np.arccos(cosine)).mean())


def photographs(
    files: Sequence[Path],
    strengths: np.ndarray,
    mask: np.ndarray,
    leds: Sequence[Led],
    camera: Camera,
) -> Capture:
    """Grey photographs (linear), each colour divided by its light's strength (L, 3)."""
    stack = []
    for file, strength in zip(files, strengths, strict=True):
        pixels = read_image(file)
        require(pixels.shape[:2] == mask.shape, f"'{file}' has another size than the mask.")
        stack.append((pixels / strength[: pixels.shape[-1]]).mean(axis=-1))
    images = np.asarray(stack) * (60_000 / np.max(stack))
    count = len(files)
    band = Band(
        "white",
        images.round().astype(np.uint16)[..., None],
        tuple((k,) for k in range(count)),
        np.ones(count),
        np.zeros(count),
    )
    return Capture(Rig(camera, tuple(leds)), {"white": band}, material="opaque", mask=mask)


def mask_of(folder: Path) -> np.ndarray:
    """The object's mask, (H, W) bool."""
    return np.asarray(read_image(folder / "mask.png").max(axis=-1) > 0)


def diligent(folder: Path) -> Scene:
    """An object of DiLiGenT or DiLiGenT-Pi: distant lights, normals by a scanner."""
    names = (folder / "filenames.txt").read_text(encoding="utf-8").split()
    lights = np.loadtxt(folder / "light_directions.txt", ndmin=2)
    strengths = np.loadtxt(folder / "light_intensities.txt", ndmin=2)
    require(
        len(names) == len(lights) == len(strengths),
        f"{folder}: the lists of names and lights differ in length.",
    )
    normals = np.asarray(loadmat(folder / "Normal_gt.mat")["Normal_gt"], dtype=np.float64)
    mask = mask_of(folder)
    leds = [
        Led("white", direction=tuple(float(part) for part in light / np.linalg.norm(light)))
        for light in lights
    ]
    files = [folder / name for name in names]
    return Scene(
        folder.name,
        photographs(files, strengths, mask, leds, Camera(PX_PER_MM, mask.shape)),
        normals,
    )


def luces(folder: Path) -> Scene:
    """An object of LUCES: 52 near LEDs around a perspective camera, distances in mm along the
    camera's axis.

    ``led_params.txt`` has the camera (number of images, rows, columns, focal length and principal
    point in pixels, mean distance) in its second line, then position, axis, strength in red, green
    and blue, and the exponent of the lobe of each LED, in the camera's frame (x right, y down, z
    away). A setup with one strength a light is read as well.
    """
    lines = (folder / "led_params.txt").read_text(encoding="utf-8").rstrip().splitlines()
    count, _, _, focal, x0, y0, distance = (float(word) for word in lines[1].split())
    table = np.array([[float(word) for word in line.split()] for line in lines[2:]])
    require(
        len(table) == int(count),
        f"{folder}: led_params.txt names {int(count)} lights and lists {len(table)}.",
    )
    colours = 3 if table.shape[1] > 10 else 1
    strengths = np.broadcast_to(table[:, 6 : 6 + colours], (len(table), 3))
    lobes = table[:, 6 + colours]
    mask = mask_of(folder)
    matrix = np.array([[focal, 0, x0], [0, focal, y0], [0, 0, 1]])
    camera = Camera(focal / distance, mask.shape, distance, "perspective", matrix)
    leds = [
        Led("white", position_mm=(x, -y, distance - z), lobe_exponent=float(lobe), aim=(a, -b, -c))
        for (x, y, z, a, b, c), lobe in zip(table[:, :6].tolist(), lobes, strict=True)
    ]
    files = [folder / f"{k + 1:02d}.png" for k in range(len(table))]
    stored = read_image(folder / "normals.png")
    normals = stored / np.iinfo(stored.dtype).max * 2 - 1
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    with np.load(folder / "zgt.npz") as held:
        depth = np.asarray(held["zgt"], dtype=np.float64)
    height = np.where(mask & (depth > 0), distance - depth, np.nan)
    return Scene(
        folder.name,
        photographs(files, strengths, mask, leds, camera),
        np.where(mask[..., None], normals, 0),
        height,
    )


def scenes(kind: str, folder: Path) -> Iterator[Scene]:
    """Every object below a folder, or the object that the folder is."""
    table = {"diligent": "light_directions.txt", "luces": "led_params.txt"}[kind]
    folders = sorted(
        {
            file.parent
            for file in [
                *folder.glob(table),
                *folder.glob(f"*/{table}"),
                *folder.glob(f"*/*/{table}"),
            ]
        }
    )
    require(len(folders) > 0, f"no folder at or below {folder} has a {table}.")
    read = {"diligent": diligent, "luces": luces}[kind]
    yield from (read(scene) for scene in folders)


def listed(folder: Path, pattern: str) -> dict[tuple[str, str], Path]:
    """Files (or result folders) by finger and sample, from a pattern of their paths."""
    require(
        "{finger}" in pattern and "{sample}" in pattern, "a pattern needs {finger} and {sample}."
    )
    parts = re.split(r"\{(finger|sample)\}", pattern)
    form = "".join(
        re.escape(part) if k % 2 == 0 else f"(?P<{part}>[^/]+?)" for k, part in enumerate(parts)
    )
    files = {}
    for path in sorted(folder.rglob("*")):
        if fits := re.fullmatch(form, path.relative_to(folder).as_posix()):
            files[fits["finger"], fits["sample"]] = path
    require(len(files) > 1, f"fewer than two files below {folder} fit the pattern {pattern}.")
    return files


def prints(
    folder: Path, pattern: str, against: Path | None, against_pattern: str | None, ppi: float | None
) -> dict[str, Any]:
    """Rates of the default matcher on all pairs of a set, or of one set against another."""
    sides = [listed(folder, pattern)]
    sides += [] if against is None else [listed(against, against_pattern or pattern)]
    pairs = list(
        itertools.product(*sides) if against is not None else itertools.combinations(sides[0], 2)
    )
    labels = []
    scores = []
    decided = []
    missing = set()
    with tempfile.TemporaryDirectory() as scratch:
        templates = []
        for k, side in enumerate(sides):
            templates.append({})
            for number, (key, path) in enumerate(side.items()):
                template = Path(scratch) / f"{k}-{number}.skt"
                try:
                    make_template(path, template, resolution_ppi=ppi)
                    templates[k][key] = template
                except BadInput as error:
                    missing.add(f"{path.name}: {error}")
        for a, b in pairs:
            first = templates[0].get(a)
            second = templates[-1].get(b)
            answer = match(first, second) if first is not None and second is not None else None
            labels.append(a[0] == b[0])
            scores.append(answer.similarity if answer is not None and answer.compared else np.nan)
            decided.append(
                answer is not None and answer.decision is not None and answer.decision.match
            )
    label = np.array(labels)
    score = np.array(scores)
    accepted = np.array(decided)
    require(
        label.any() and not label.all(),
        "the pairs need two samples of one finger, and two fingers.",
    )
    fingers = ids_of([a[0] for a, _ in pairs], [b[0] for _, b in pairs])
    figures = bootstrap(
        Scores(label, score, finger=fingers), "finger", BootstrapSettings(curve_points=0)
    ).figures
    eer = figures["eer"]
    return {
        "genuine": int(label.sum()),
        "impostors": int((~label).sum()),
        "failures": sorted(missing),
        "eer_percent": [round(100 * value, 2) for value in (eer.value, eer.low, eer.high)],
        "genuine_accepted": int(accepted[label].sum()),
        "impostors_accepted": int(accepted[~label].sum()),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("benchmark", choices=["diligent", "luces", "prints"])
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--pattern", default="{finger}_{sample}.png", help="of prints: paths below FOLDER"
    )
    parser.add_argument("--against", type=Path, help="of prints: the other set")
    parser.add_argument("--against-pattern")
    parser.add_argument(
        "--resolution-ppi", type=float, help="of prints: resolution where files do not state it"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    rows = []
    try:
        if options.benchmark == "prints":
            rows.append(
                prints(
                    options.folder,
                    options.pattern,
                    options.against,
                    options.against_pattern,
                    options.resolution_ppi,
                )
            )
            print(json.dumps(rows[0]))
        else:
            for scene in scenes(options.benchmark, options.folder):
                for preset in PRESETS:
                    rows.append(scene.row(preset))
                    print(json.dumps(rows[-1]), flush=True)
    except (BadInput, OSError, KeyError, ValueError) as error:
        print(f"{options.folder}: {error}", file=sys.stderr)
        return 2
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
