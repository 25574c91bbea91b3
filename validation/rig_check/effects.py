"""What a rig at the limit of each question of `splitknit rig check` does to a finger.

    python validation/rig_check/effects.py                  # two fingers, about ten minutes

The twins of :mod:`twins`, each with one defect whose size gives the limit of a question, and twice
that. The finger's surface is that of the default method, against the truth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from twins import (  # noqa: E402
    PUPIL_MM,
    SCALE,
    Lit,
    Store,
    Twin,
    dimmed,
    finger_of,
    leaking,
    moved,
    other_lens,
    tilted,
    turned,
    twin,
)

from splitknit import Led, reconstruct  # noqa: E402
from splitknit.io.csv_table import csv_text  # noqa: E402
from splitknit_simulator import compare  # noqa: E402
from splitknit_simulator.rigs import built_rig  # noqa: E402
from splitknit_simulator.twin import FingerScene, twin_settings  # noqa: E402

FIGURES = ("surface_rms_mm", "normals_mean_deg", "height_band_correlation", "height_band_rms_um")
LED = 3
"""The one that has the defect."""


def stored(change: Callable[[Any], Any]) -> Store:
    """A camera that changes its pictures (parts of full scale)."""
    return lambda pixels: np.rint(255.0 * np.clip(change(pixels / 255.0), 0, 1)).astype(np.uint8)


def tilting(rig: Twin, deg: float) -> Lit:
    """LEDs as unequal as a card seems tilted by: brighter on one side."""
    lit = rig.finger
    places = np.array([led.position_mm for led in rig.rig.leds])
    factors = 1.0 + np.deg2rad(deg) * places[:, 0] / places[:, 2]
    leds = lit.dark + factors[:, None, None, None].astype(np.float32) * (lit.leds - lit.dark)
    return Lit(leds, lit.dark)


def shifted(lit: Lit, seed: int, mm: float, px_per_mm: float) -> Lit:
    """A finger that moves from shot to shot, by `mm` at most."""
    steps = np.random.default_rng([seed, 0x33]).standard_normal((len(lit.leds), 2))
    steps *= mm * px_per_mm / np.linalg.norm(steps, axis=1).max()
    return lit.warped([np.array([[1.0, 0.0, x], [0.0, 1.0, y]]) for x, y in steps])


def with_led(rig: Twin, change: Callable[[Led], Led]) -> Twin:
    """One LED is not where, or does not point where, the rig file has it."""
    leds = tuple(change(led) if k == LED else led for k, led in enumerate(rig.rig.leds))
    built = replace(rig.rig, leds=leds)
    return replace(rig, rig=built, finger=finger_of(rig.seed, built))


def defects(rig: Twin, times: int) -> Iterator[tuple[str, str, Twin]]:
    """Question, size and twin, at some times the limit."""
    px = rig.rig.camera.px_per_mm
    yield "dark level", f"{times} %", replace(rig, store=stored(lambda v: v + 0.01 * times))
    power = 1.0 - 0.074 * times  # twice the limit; 0.9 departs by 1.35 to 1.44 %
    yield "linearity", f"{times} %", replace(rig, store=stored(lambda v: v**power))
    level = 25.0 / times
    yield "darkest card", f"{level:g} %", replace(rig, exposure=level / 57.0)
    size = 3.0 * times
    dim = replace(rig, finger=dimmed(rig.finger, LED, 1.0 - size / 100.0))
    yield "brightness by light", f"one LED {size:g} %", dim
    deg = 1.74 * times  # 10 deg changed the light by 5.8 % (8.6 % in tables/answers.csv)
    tilted_rig = with_led(rig, lambda led: tilted(led, deg))
    yield "light across the card", f"{times} %, one LED tilted", tilted_rig
    flat = replace(rig, finger=tilting(rig, times))
    yield "flatness of the card", f"{times} deg", flat
    yield "light leaks", f"{times} %", replace(rig, finger=leaking(rig.finger, times / 100.0))
    yield "radius of the ball", f"{2 * times} %", other_lens(rig, 1.0 + times / 50.0)
    place = 2.19 * times  # 3 mm turn it by 1.33 to 1.37 deg
    elsewhere = with_led(rig, lambda led: moved(led, place))
    yield "direction of each LED", f"{times} deg, one LED", elsewhere
    turn = np.asarray(cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(times)]))[0])
    leds_turned = tuple(turned(led, turn) for led in rig.file.leds)
    all_turned = replace(rig, file=replace(rig.file, leds=leds_turned))
    yield "turn of all LEDs together", f"{times} deg", all_turned
    mm = 0.13 * times
    still = replace(rig, finger=shifted(rig.finger, rig.seed, mm, px))
    yield "motion of the finger", f"{mm:g} mm", still
    out = 3.0 * times
    blurred = finger_of(rig.seed, rig.rig, 1.5 + out)
    yield "focus", f"{out:g} mm", replace(rig, finger=blurred)
    leds = rig.finger.leds.copy()
    nir = [led.band == "nir" for led in rig.rig.leds]
    leds[nir] = blurred.leds[nir]
    shift = replace(rig, finger=Lit(leds, rig.finger.dark))
    yield "focus, NIR alone", f"{out:g} mm", shift


def rows_of(seed: int) -> Iterator[dict[str, Any]]:
    """A row for each defect."""
    sound = twin(seed)
    lens = {"render.aperture_mm": PUPIL_MM, "render.focus_depth_mm": 1.5}
    settings = replace(twin_settings(None, lens), rig=built_rig(seed, scale=SCALE))
    truth = FingerScene(seed, None, settings).truth()
    twins = chain([("none", "", sound)], defects(sound, 1), defects(sound, 2))
    for question, size, rig in twins:
        capture = rig._capture(rig.finger, np.random.SeedSequence([seed, 0xEF]), "skin")
        result = reconstruct(capture, "metric", {"keep": True})
        figures = compare(result, truth).figures
        row = {name: f"{figures[name]:.4g}" for name in FIGURES}
        print(seed, question, size, *row.values(), flush=True)
        yield {"seed": seed, "question": question, "size": size, **row}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[2000, 2001])
    parser.add_argument("--out", type=Path, default=HERE / "tables" / "effects.csv")
    chosen = parser.parse_args(arguments)
    rows = [row for seed in chosen.seeds for row in rows_of(seed)]
    table = csv_text([rows[0], *(row.values() for row in rows)])
    chosen.out.write_text(table, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
