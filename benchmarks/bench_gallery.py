"""An integrator's times: a template, a comparison of two templates, a gallery's first search and
the later ones, an enrolment that looks for duplicates, the file and the memory.

    python benchmarks/bench_gallery.py [--captures 10000] [--rounds 5]

Presses of simulated fingers; the gallery's captures are 24 of them with minutiae moved at random,
so that no two agree. Run it without ``OPENBLAS_NUM_THREADS``: the library limits its threads
itself.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import splitknit_match
from splitknit_match.gallery.file import Entry, NewCapture
from splitknit_match.gallery.identify import TEMPLATES_HASH
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.template import Template, pack
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print
from timing import machine, print_table, race

PPI = 500
MASTERS = 24
FINGER = MasterPrintSettings(half_width_mm=8.0, distal_mm=18.0, proximal_mm=2.0)


def press(seed: int, noise: float) -> NDArray[np.uint8]:
    image = np.pad(ink_print(master_print("left_loop", seed, FINGER)), 20, constant_values=255)
    drawn = noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.roll(image, int(noise), 1) + drawn, 0, 255).astype(np.uint8)


def impostor(template: Template, rng: np.random.Generator) -> bytes:
    """Another finger's template, as far as an index of minutiae sees."""
    minutiae = template.minutiae
    assert minutiae is not None
    x, y = (
        np.clip(place + rng.integers(-60, 60, place.shape), 0, side - 1).astype(np.int32)
        for place, side in zip((minutiae.x_px, minutiae.y_px), minutiae.size[::-1], strict=True)
    )
    turns = rng.uniform(0, 2 * np.pi, minutiae.count)
    return pack(replace(template, minutiae=replace(minutiae, x_px=x, y_px=y, direction_rad=turns)))


def seconds(work: Callable[[], Any]) -> tuple[float, float]:
    """Wall and processor time."""
    wall, busy = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - busy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"Galleries, {machine()}")
    pictures = [press(1, 0.0), press(1, 9.0), press(2, 0.0)]
    templates = [
        splitknit_match.make_template(each, resolution_ppi=PPI).payload for each in pictures
    ]
    contenders = {
        "a template of a print": lambda: splitknit_match.make_template(
            pictures[0], resolution_ppi=PPI
        ),
        "match of two templates, one finger": lambda: splitknit_match.match(
            templates[0], templates[1]
        ),
        "match of two templates, two fingers": lambda: splitknit_match.match(
            templates[0], templates[2]
        ),
    }
    print_table("One to one", race(contenders, options.rounds))

    rng = np.random.default_rng(0)
    masters = [print_template(press(100 + k, 0.0)) for k in range(MASTERS)]
    area_mm2 = masters[0].area_mm2
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "people.skg"
        gallery = splitknit_match.Gallery(path)
        entries = (
            NewCapture(
                Entry(f"P{k}", "right_index", "1", "template", f"{k:064x}", area_mm2),
                impostor(masters[k % MASTERS], rng),
            )
            for k in range(options.captures)
        )
        gallery.add(entries, TEMPLATES_HASH)
        rows = [("first search", *seconds(lambda: gallery.identify(templates[1])))]
        later = np.array(
            [seconds(lambda: gallery.identify(templates[1])) for _ in range(options.rounds)]
        )
        rows.append(("later search", *np.median(later, axis=0).tolist()))
        rows.append(
            (
                "enrolment, gallery open",
                *seconds(lambda: gallery.enroll(templates[0], "A", "left_index")),
            )
        )
        gallery.close()
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
        rows.append(
            (
                "enrolment, gallery opened for it",
                *seconds(lambda: splitknit_match.enroll(path, templates[2], "B", "left_index")),
            )
        )
        print(
            f"\n{options.captures} captures, {path.stat().st_size / 1e6:.0f} MB on disk,"
            f" peak memory {peak_mb:.0f} MB\n\n| | s | processor s |\n| --- | --- | --- |"
        )
        for name, wall, busy in rows:
            print(f"| {name} | {wall:.2f} | {busy:.2f} |")


if __name__ == "__main__":
    main()
