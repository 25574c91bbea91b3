"""Photographs of simulated fingers, as a telephone takes them, against presses of the same fingers.

    nice python validation/match/fingerphotos.py --work FOLDER                 # 24 fingers, 20 minutes of one core
    nice python validation/match/fingerphotos.py --work FOLDER --fingers 4     # a quick look

One photograph of each finger in a pose of its own, before blue-grey paper, at 30 px/mm by the drawn rig's perspective
camera, as an sRGB JPEG with noise: by a flash beside the lens, and by the rig's seven white LEDs together (daylight).
Its print is made on the plane and unrolled by the mean shape, with its scale known and assumed. Contact: one press of
each finger on two models of sensors. Each photograph is compared with its own finger's presses and with those of the
next 12 fingers, by the default matcher. Both sides are our simulator's. Intervals of 95 % draw fingers. FOLDER keeps
what is made, so an interrupted run goes on. `--write` renews the table of impostor scores that `match` uses, too.
"""

from __future__ import annotations

import argparse
import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from contactless import SENSORS, rates
from fvc import FAR_0, kept
from numpy.typing import NDArray
from pressed_prints import press

from splitknit.errors import BadInput
from splitknit.model import Led, Rig, nominal_rig
from splitknit_match.evaluation.intervals import BootstrapSettings
from splitknit_match.evaluation.scores import Scores, ids_of
from splitknit_match.matching import methods
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template
from splitknit_match.prints.fingerphoto import source_of_photo
from splitknit_match.prints.make import make_print
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.scene import BackgroundSettings, TwinSettings
from splitknit_simulator.twin import FingerScene

OUT = Path(__file__).with_suffix(".json")
SEED = 98_000
OTHERS = 12
STRANGERS = 30
"""Other fingers, pressed on each sensor, with which the photographs by flash are compared for the table alone."""
PRESSES = ("fvc2002_db2b", "fvc2004_db1b")
PAPER = BackgroundSettings(colour=(0.25, 0.30, 0.35, 0.30))
KINDS = {
    "flash, plane, scale known": ("flash", None, True),
    "flash, unrolled, scale known": ("flash", "free", True),
    "flash, plane, scale assumed": ("flash", None, False),
    "flash, unrolled, scale assumed": ("flash", "free", False),
    "daylight, unrolled, scale known": ("daylight", "free", True),
    "daylight, unrolled, scale assumed": ("daylight", "free", False),
}


def telephone() -> Rig:
    """The drawn rig's camera, a flash beside its lens, and the seven white LEDs."""
    rig = nominal_rig(0.4)
    return replace(rig, leds=(Led("white", (0.0, 12.0, 100.0)), *(one for one in rig.leds if one.band == "white")))


def photographs(number: int) -> tuple[dict[str, NDArray[np.uint8]], float]:
    """Pictures of a finger (H, W, 3) by light, and their scale in px/mm."""
    scene = FingerScene(SEED + number, settings=TwinSettings(rig=telephone(), background=PAPER))
    found = {}
    for name, lit in (("flash", [0]), ("daylight", range(1, 8))):
        light = scene.light(lit)
        light = np.clip(light / np.percentile(light, 99.8), 0.0, 1.0)
        srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
        noisy = 255.0 * srgb + np.random.default_rng([number, lit[0]]).normal(0.0, 2.0, light.shape)
        pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        _, data = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        found[name] = np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]).astype(np.uint8)
    return found, scene.camera.px_per_mm


def made(number: int, folder: Path) -> tuple[dict[str, Template], list[Template], dict[str, float]]:
    """Templates of a finger's photographs (those that cannot be made are missing) and presses, and errors of scale."""
    file = folder / f"photo_{number}.pickle"
    if not file.is_file():
        pictures, px_per_mm = photographs(number)
        found, errors = {}, {}
        for kind, (light, surface, known) in KINDS.items():
            try:
                source = source_of_photo(pictures[light], px_per_mm if known else None)
                found[kind] = print_template(make_print(source, "photo", surface).image)
            except BadInput as error:
                print(f"finger {number}, {kind}: {error}", flush=True)
                continue
            if known:
                pitch = source.pitch_mm
            elif surface:
                errors[light] = source.pitch_mm / pitch - 1.0
        master = draw_finger(SEED + number).master()
        presses = [print_template(press(master, k, SENSORS[name])) for k, name in enumerate(PRESSES)]
        kept(file, (found, presses, errors))
    result: tuple[dict[str, Template], list[Template], dict[str, float]] = pickle.loads(file.read_bytes())
    return result


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=24)
    parser.add_argument("--write", action="store_true", help=f"write {OUT.name}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    count = options.fingers
    everything = [made(k, options.work) for k in range(count)]
    presses = [[Prepared(one) for one in part] for _, part, _ in everything]
    pairs = [(i, (i + step) % count, k)
             for i in range(count) for step in range(min(OTHERS + 1, count)) for k in range(len(PRESSES))]  # fmt: skip
    facts: dict[str, Any] = {"what": "simulated fingers and presses", "fingers": count, "rates": {}, "scale_error": {}}
    for light in ("flash", "daylight"):
        off = np.array([errors[light] for _, _, errors in everything if light in errors])
        facts["scale_error"][light] = [round(100 * float(v), 1) for v in (off.mean(), off.std(), np.abs(off).max())]
    for kind in KINDS:
        file = options.work / f"scores_{count}_{kind}.pickle"
        if not file.is_file():
            probes = [Prepared(found[kind]) if kind in found else None for found, _, _ in everything]
            kept(file, [_score(probes[i], presses[j][k]) for i, j, k in pairs])
        score = np.array(pickle.loads(file.read_bytes()))
        ids = ids_of([i for i, _, _ in pairs], [j for _, j, _ in pairs])
        scores = Scores(ids.same, score, finger=ids, name=kind)
        settings = BootstrapSettings(targets=(0.01, 0.001, FAR_0), curve_points=0)
        row = rates(scores, settings)
        at = methods.similarity_at(1e-3, "fusion")
        row["far_at_prints_0.1"] = round(100 * float(np.nanmean(scores.impostor >= at)), 2)
        facts["rates"][kind] = row | {"failures": int(np.isnan(scores.genuine).sum())}
        print(f"{kind:36s}", facts["rates"][kind], flush=True)
    print(facts["scale_error"])
    if options.write:
        strangers([found for found, _, _ in everything], options.work)
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def strangers(photos: list[dict[str, Template]], folder: Path) -> None:
    """Scores of photographs by flash, unrolled and scale assumed, with presses of fingers that nobody photographed."""
    file = folder / "strangers.pickle"
    if not file.is_file():
        masters = [draw_finger(SEED + 1000 + k).master() for k in range(STRANGERS)]
        sides = [Prepared(print_template(press(one, k, SENSORS[name])))
                 for one in masters for k, name in enumerate(PRESSES)]  # fmt: skip
        probes = [Prepared(one["flash, unrolled, scale assumed"]) for one in photos]
        kept(file, [_score(one, side) for one in probes for side in sides])
    scores: list[float] = pickle.loads(file.read_bytes())
    print("strangers", len(scores), "largest", sorted(scores)[-6:], flush=True)


def _score(a: Prepared | None, b: Prepared) -> float:
    if a is None:
        return float("nan")
    found = fused_match(a, b)
    return found.similarity if found.compared else float("nan")


if __name__ == "__main__":
    main()
