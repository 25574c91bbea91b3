"""Fingers photographed by random walks in their volume: other light and skin than the fast twin's.

    python validation/path_traced/make.py --out DIR              # a run that was stopped goes on
    python validation/path_traced/make.py --out DIR --polarised  # behind linear films
    python validation/path_traced/make.py --out DIR --names third_matt no_ridges  # some of them
    python validation/path_traced/make.py --out DIR --drawn 10 --seed 7  # small, of drawn optics

Needs the group ``reference`` (numba). Each finger becomes a capture folder with ``truth.npz`` and
``info.json``, which has all optics and the noise of the walks; of polarised fingers these lie
beside the folder, as ``NAME_truth.npz`` and ``NAME_info.json``. The same arguments give the same
bytes, whatever the number of threads.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from walked_finger import (
    FingerLight,
    FingerOptics,
    draw_optics,
    photograph_finger,
    walk_finger,
    without_walk_noise,
)

from splitknit.errors import BadInput, require
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import write_capture
from splitknit.io.npz import read_npz, write_npz
from splitknit.model import Rig
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger
from splitknit_simulator.light.films import FilmSettings
from splitknit_simulator.rigs import with_side_lights
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import lay_down


@dataclass(frozen=True, slots=True)
class Case:
    """One finger."""

    name: str
    seed: int
    pattern: str
    optics: FingerOptics
    ridges: bool = True


@dataclass(frozen=True, slots=True)
class CutCase:
    """One finger, behind films if any, cut out of the picture."""

    name: str
    seed: int
    pattern: str
    ridge_um: float
    optics: FingerOptics
    films: FilmSettings | None
    ridges: bool = True
    moved_mm: tuple[float, float] = (0.0, 0.0)
    as_walked: str = ""
    """Case whose walks it shares."""
    size_px: tuple[int, int] = (540, 640)
    """Rows and columns of its pictures at scale 0.5."""
    width_mm: float = 15.0
    """Of the finger, at most."""
    entering: int = 1
    """Rays along each side of a cell, see :func:`walked_finger.render_finger`."""
    side_lights: int = 0
    """White LEDs to the side of the finger."""


def _fingers() -> Iterator[Case | CutCase]:
    """Rows of ``fingers.csv``; films by the kept part of once-scattered light, axis in deg,
    extinction, angle error in deg, and transmission in red, green and blue."""
    with Path(__file__).with_name("fingers.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            finger = row["name"], int(row["seed"]), row["pattern"]
            optics = FingerOptics(**{f.name: float(row[f.name]) for f in fields(FingerOptics)})
            ridges = row["ridges"] == "yes"
            if not row["films"]:
                yield Case(*finger, optics, ridges)
                continue
            kept, axis, extinction, off, *tint = map(json.loads, row["films"].split())
            films = FilmSettings("analyser", axis, off, extinction, tuple(tint), kept)
            yield CutCase(*finger, float(row["ridge_um"]), optics, films, ridges)


FINGERS = tuple(_fingers())
CASES = tuple(finger for finger in FINGERS if isinstance(finger, Case))
_P01, *_BEHIND_FILMS = (finger for finger in FINGERS if isinstance(finger, CutCase))
_P01 = replace(_P01, size_px=(640, 700), width_mm=16.5, entering=2)
_WITHOUT_SIDE_LIGHTS = (_P01, *_BEHIND_FILMS)


def _behind(extinction: float, off_deg: float) -> FilmSettings | None:
    return _P01.films and replace(_P01.films, extinction=extinction, misalignment_deg=off_deg)


POLARISED = (
    *_WITHOUT_SIDE_LIGHTS,
    replace(_P01, name="p01_ext", films=_behind(100, 0.5), as_walked="p01"),
    replace(_P01, name="p01_angle", films=_behind(1000, 3.0), as_walked="p01"),
    replace(_P01, name="p01_motion", moved_mm=(0.15, -0.13), as_walked="p01"),
    *(replace(case, name=f"{case.name}_side", side_lights=7) for case in _WITHOUT_SIDE_LIGHTS),
)
RIDGES_UM = (25.0, 90.0)
"""Heights of ridges of drawn cases."""
DRAWN_PX, DRAWN_MM = (310, 400), 9.6
"""Rows and columns of their pictures at scale 0.5, and the finger's width."""
OVERSAMPLING = 3
"""Pixels of the reflecting skin along each side of one of the camera's."""


def drawn_cases(count: int, seed: int) -> tuple[CutCase, ...]:
    """Fingers of drawn optics and ridge heights, without films; the spread of entering light goes
    from 0 to 1."""
    cases = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        ridge_um = round(float(rng.uniform(*RIDGES_UM)), 1)
        optics = replace(draw_optics(rng), spread=number / max(count - 1, 1))
        pattern = ("loop", "whorl", "arch")[number % 3]
        cases.append(
            CutCase(
                f"drawn_{seed}_{number}",
                100 * seed + number,
                pattern,
                ridge_um,
                optics,
                None,
                size_px=DRAWN_PX,
                width_mm=DRAWN_MM,
            )
        )
    return tuple(cases)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description="Fingers photographed by random walks in their volume."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the captures")
    parser.add_argument(
        "--scale",
        type=float,
        help="of the images; 1 is 2200 x 3200 pixels; whole fingers 0.3, parts 0.5",
    )
    parser.add_argument("--walks", type=float, default=16.0, help="for each pixel and channel")
    parser.add_argument("--threads", type=int, default=2, help="the result does not depend on it")
    parser.add_argument("--polarised", action="store_true", help="fingers behind films")
    parser.add_argument("--drawn", type=int, help="this many small fingers of drawn optics")
    parser.add_argument("--seed", type=int, default=0, help="of drawn fingers")
    parser.add_argument("--names", nargs="+", help="which of them")
    options = parser.parse_args(arguments)
    try:
        cases: Sequence[Case | CutCase] = POLARISED if options.polarised else CASES
        if options.drawn:
            cases = drawn_cases(options.drawn, options.seed)
        known = {case.name: case for case in cases}
        names = options.names or list(known)
        require(
            set(names) <= set(known),
            f"--names are some of {', '.join(known)}, not {', '.join(names)}.",
        )
        for case in (known[name] for name in names):
            if isinstance(case, CutCase):
                if not (options.out / f"{case.name}_info.json").exists():
                    make_cut(
                        case,
                        options.out,
                        options.scale or 0.5,
                        options.walks,
                        options.threads,
                    )
            elif not (options.out / case.name / "info.json").exists():
                make(
                    case,
                    options.out / case.name,
                    options.scale or 0.3,
                    options.walks,
                    options.threads,
                )
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def make(case: Case, folder: Path, scale: float, walks: float, threads: int) -> None:
    """Photograph one finger and write its folder."""
    started = time.perf_counter()

    def progress(step: str, fraction: float) -> None:
        if sys.stderr.isatty():
            print(
                f"\r{case.name}: {step} {100 * fraction:3.0f} %   ",
                end="",
                file=sys.stderr,
                flush=True,
            )

    surface, drawn = lay_down(case.seed, case.pattern, TwinSettings(scale=scale))
    surface = surface if case.ridges else without_ridges(surface)
    capture, truth, info = photograph_finger(
        surface,
        drawn.rig,
        case.optics,
        walks=walks,
        rays=max(round(0.8 * walks), 2),
        threads=threads,
        seed=case.seed,
        progress=progress,
    )
    info |= {"name": case.name, "pattern": case.pattern, "ridges": case.ridges, "scale": scale}
    with atomic_folder(folder) as target:
        write_capture(capture, target, truth, overwrite=True)
        (target / "info.json").write_text(json.dumps(info, indent=1) + "\n")
    worst = max(channel["noise"]["common"] for channel in info["channels"].values())
    print(
        f"{case.name}: {time.perf_counter() - started:.0f} s, noise of the walks"
        f" {100 * worst:.1f} %",
        flush=True,
    )


def make_cut(case: CutCase, out: Path, scale: float, walks: float, threads: int) -> None:
    """Photograph one finger that is cut out; write its folder, and truth and info beside it."""
    started = time.perf_counter()
    rows, columns = case.size_px
    size = round(rows * 2 * scale), round(columns * 2 * scale)
    camera = replace(default_rig(scale).camera, image_size=size)
    white = [led for led in default_rig(scale, None).leds if led.band == "white"]
    rig = with_side_lights(
        Rig(camera, (*white, *(replace(led, band="nir") for led in white))), case.side_lights
    )
    finger = draw_finger(case.seed, case.pattern)
    width = min(finger.shape.width_mm, case.width_mm)
    thickness = finger.shape.thickness_mm
    if case.films is None:
        thickness = min(thickness, width)
    finger = replace(
        finger,
        shape=replace(finger.shape, width_mm=width, thickness_mm=thickness),
        skin=replace(finger.skin, ridge_depth_um=case.ridge_um),
    )
    settings = TwinSettings(
        rig=rig, pose=FingerPose(insertion_mm=round(size[0] * camera.pitch_mm - 1.1, 1))
    )
    closer = replace(
        camera,
        px_per_mm=OVERSAMPLING * camera.px_per_mm,
        image_size=(OVERSAMPLING * size[0], OVERSAMPLING * size[1]),
    )
    surface, fine = (
        lay_down(
            case.seed, None, replace(settings, rig=replace(rig, camera=resolution)), finger=finger
        )[0]
        for resolution in (camera, closer)
    )
    if not case.ridges:
        surface, fine = without_ridges(surface), without_ridges(fine)

    def walk() -> FingerLight:
        rays = max(round(0.6 * walks), 2)
        return walk_finger(
            surface,
            rig,
            case.optics,
            walks=walks,
            rays=rays,
            threads=threads,
            seed=case.seed,
            entering=case.entering,
        )

    light = without_walk_noise(_walked(case, out, walk), surface)
    capture, truth, info = photograph_finger(
        surface,
        rig,
        case.optics,
        walks=walks,
        seed=case.seed,
        light=light,
        films=case.films,
        moved_mm=case.moved_mm,
        fine=fine,
    )
    info |= {
        "name": case.name,
        "pattern": case.pattern,
        "ridges": case.ridges,
        "ridge_depth_um": case.ridge_um,
    }
    with atomic_folder(out / case.name) as target:
        write_capture(capture, target, overwrite=True)
    write_npz(out / f"{case.name}_truth.npz", truth)
    (out / f"{case.name}_info.json").write_text(json.dumps(info, indent=1) + "\n")
    print(f"{case.name}: {time.perf_counter() - started:.0f} s", flush=True)


def _walked(case: CutCase, out: Path, walk: Callable[[], FingerLight]) -> FingerLight:
    """The light of a case, kept in a file that cases share."""
    kept = out / f".{case.as_walked or case.name}_light.npz"
    parts = ("diffuse", "once")
    bands = ("white", "nir")
    if kept.exists():
        arrays = read_npz(kept)
        diffuse, once = ({name: arrays[f"{part}_{name}"] for name in bands} for part in parts)
        return FingerLight(diffuse, once, json.loads(str(arrays["channels"])))
    light = walk()
    kept.parent.mkdir(parents=True, exist_ok=True)
    light_arrays = {
        f"{part}_{name}": getattr(light, part)[name] for part in parts for name in bands
    }
    write_npz(kept, {"channels": np.array(json.dumps(dict(light.channels))), **light_arrays})
    return light


def without_ridges(surface: SimulatedSurface) -> SimulatedSurface:
    """The same finger with smooth skin."""
    return replace(
        surface,
        height_mm=surface.shape_mm,
        normals=surface.shape_normals,
        relief_um=0.0 * surface.relief_um,
    )


if __name__ == "__main__":
    sys.exit(main())
