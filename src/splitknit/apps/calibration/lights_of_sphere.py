"""What ``splitknit calibrate lights`` does with photographs of a ball."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.calibration.lights_inputs import RigInputs, rig_inputs, write_lights
from splitknit.apps.calibration.lights_of_images import SUFFIXES, read_stack
from splitknit.apps.verb import Outcome
from splitknit.calibration.light_table import BANDS
from splitknit.calibration.sphere import Ball, ball_of_mask, chrome_directions, find_ball, grey_directions
from splitknit.errors import require
from splitknit.io import file_hash, image_size, plain_json, provenance, read_image
from splitknit.model import Camera, Led, Rig


@dataclass(frozen=True, slots=True)
class _Photograph:
    band: str
    led: int
    path: Path


def lights_of_sphere(options: argparse.Namespace) -> Outcome:
    """Find the direction of the light of every image in a folder.

    Without ``--rig`` or ``--px-per-cm`` no scale is known, and none is needed: the directions go into a rig of one
    pixel per mm. With ``--led-height-cm`` LEDs are placed at that height, as a near light must be.
    """
    photographs = _photographs(options.images)
    size = image_size(photographs[0].path)
    known = options.rig is not None or options.px_per_cm is not None
    inputs = rig_inputs(options) if known else RigInputs(Camera(1.0, size), None)
    hashes: dict[str, str] = {}
    paths = [one.path for one in photographs]
    stack = read_stack(paths, inputs.camera.image_size, options.encoding, hashes, options.images)
    ball = _ball(options.mask, stack, size, hashes)
    strengths: NDArray[np.float64] | None = None
    if options.sphere == "chrome":
        directions = chrome_directions(stack, ball)
    else:
        directions, strengths = grey_directions(stack, ball)
    low = [str(one.path) for one, way in zip(photographs, directions, strict=True) if way[2] <= 0.05]
    require(not low, f"{' and '.join(low)}: the light stands beside or behind the ball; correct the mask or the image.")
    height = None if options.led_height_cm is None else 10.0 * options.led_height_cm
    facts, leds, lines = [], [], [f"{len(photographs)} lights from a {options.sphere} ball:"]
    for k, (one, way) in enumerate(zip(photographs, directions, strict=True)):
        unit = (float(way[0]), float(way[1]), float(way[2]))
        place = None if height is None else (height * unit[0] / unit[2], height * unit[1] / unit[2], height)
        strength = 1.0 if strengths is None else float(strengths[k] / strengths.mean())
        # a near light's strength falls with the square of its distance
        intensity = strength if place is None else strength * (float(np.linalg.norm(place)) / 100.0) ** 2
        leds.append(Led(one.band, position_mm=place, direction=unit if place is None else None, intensity=intensity))
        facts.append(
            {
                "band": one.band,
                "led": one.led,
                "image": one.path.name,
                "direction": list(unit),
                "position_mm": None if place is None else list(place),
                "strength": None if strengths is None else strength,
                "disagreement_deg": None,
                "verdict": "unchecked",
                "kept": True,
            }
        )
        lines.append(f"  {one.path.name}  towards ({unit[0]:+.4f}, {unit[1]:+.4f}, {unit[2]:+.4f})")
    origin = provenance({"sphere": options.sphere, "ball": ball}, hashes)
    before = dict(inputs.base.provenance) if inputs.base is not None else {}
    mirrors = inputs.base.mirrors if inputs.base is not None else ()
    said = {**before, "lights": {"method": options.sphere, "provenance": plain_json(origin)}}
    rig = Rig(inputs.camera, tuple(leds), said, mirrors)
    outline = {"column": ball.column, "row": ball.row, "radius_px": ball.radius_px}
    return write_lights(rig, options.out, {"method": options.sphere, "ball": outline, "leds": facts}, lines)


def _photographs(folder: Path) -> list[_Photograph]:
    """Images by name: ``white_3.png`` tells the LED; others count as white in the order of the numbers in them."""
    require(folder.is_dir(), f"{folder} is not a folder; name the folder with the photographs of the ball.")
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    files = [path for path in files if "mask" not in path.stem.lower() and not path.stem.lower().startswith("ambient")]
    require(bool(files), f"{folder} holds no photographs (PNG, TIFF or JPEG).")
    named = {path: re.fullmatch(r"(white|nir)[_.-]?(\d+)", path.stem.lower()) for path in files}
    if all(match is not None for match in named.values()):
        found = [_Photograph(match.group(1), int(match.group(2)), path) for path, match in named.items() if match]
        return sorted(found, key=lambda one: (BANDS.index(one.band), one.led))
    files.sort(key=lambda path: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)])
    return [_Photograph("white", k, path) for k, path in enumerate(files)]


def _ball(mask: Path | None, stack: NDArray[np.float32], size: tuple[int, int], hashes: dict[str, str]) -> Ball:
    if mask is None:
        return find_ball(stack)
    pixels = read_image(mask)
    require(
        pixels.shape[:2] == size,
        f"{mask} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but the photographs have "
        f"{size[0]} x {size[1]}.",
    )
    hashes[mask.name] = file_hash(mask)
    return ball_of_mask(pixels.mean(axis=2) > np.iinfo(pixels.dtype).max / 2)
