"""Prints of a phalange at full resolution, and enhancement of real prints beside its peers.

    python benchmarks/bench_prints.py [--rounds 5] [--scale 1.0] [--prints FOLDER]

The phalange is a drawn finger's true surface (nothing is reconstructed). `--prints` names a folder
of 500-ppi PNG files (default: the ten first of ../shared/data/fvc2002_db1b). Peers are
`fingerprint-enhancer` and `pyfing` where SPLITKNIT_PEERS leads to them (peers.py). Quality is NFIQ
2 of the enhanced prints.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import cv2
import numpy as np

from peers import library
from splitknit.finger.orientation import find_upright
from splitknit.nominal import default_rig
from splitknit_match.prints.curvature import curvature
from splitknit_match.prints.enhance import gabor_enhance
from splitknit_match.prints.make import Print, enhance, make_print
from splitknit_match.prints.minutiae import nfiq2
from splitknit_match.prints.sources import Source
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from timing import machine, print_table, race

PRINTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "fvc2002_db1b"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--prints", type=Path, default=PRINTS)
    parser.add_argument("--count", type=int, default=10)
    options = parser.parse_args()
    cv2.setNumThreads(2)
    print(f"Prints, {machine()}, two threads")
    phalange(options.scale, options.rounds)
    files = sorted(options.prints.glob("*.png"))[: options.count] if options.prints.is_dir() else []
    if files:
        real_prints(files, options.rounds)
    else:
        print(f"\nNo prints in {options.prints}: the comparison with peers is left out.")


def phalange(scale: float, rounds: int) -> None:
    """Time each conversion of one finger."""
    camera = default_rig(scale).camera
    seen = finger_surface(draw_finger(1), FingerPose(insertion_mm=26.0), camera, workers=2)
    upright = find_upright(seen.mask)
    relief = seen.height_mm - seen.shape_mm
    source = Source(
        "result",
        seen.mask,
        camera.pitch_mm,
        upright.input_from_upright,
        upright.size,
        seen.height_mm,
        relief,
        seen.shape_mm,
    )
    rows, columns = (int(np.ptp(np.flatnonzero(seen.mask.any(axis=axis)))) + 1 for axis in (1, 0))
    unrolled: Print = make_print(source, "unroll")
    work: dict[str, Callable[[], Any]] = {
        "unrolled print (free)": lambda: make_print(source, "unroll")
    }
    work["unrolled print (arc)"] = lambda: make_print(source, "unroll", "arc")
    work["relief print"] = lambda: make_print(source, "relief")
    for degree, word in ((2, "quadratic"), (3, "cubic")):
        work[f"curvature map, {word}"] = partial(
            curvature, seen.height_mm, seen.mask, camera.pitch_mm, degree=degree
        )
    work["Gabor enhancement of the unrolled print"] = lambda: enhance(unrolled)
    print_table(
        f"A phalange of {rows} x {columns} pixels ({camera.px_per_mm:.1f} px/mm)",
        race(work, rounds),
    )
    print(f"\nThe print has {unrolled.image.shape[0]} x {unrolled.image.shape[1]} pixels.")


def real_prints(files: list[Path], rounds: int) -> None:
    """Time and judge enhancement of real prints."""
    images = [
        np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for file in files
    ]
    size = " x ".join(map(str, images[0].shape))
    methods: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "splitknit Gabor": lambda image: gabor_enhance(image).image,
    }
    if enhancer := library("fingerprint_enhancer"):
        methods["fingerprint-enhancer"] = lambda image: np.where(
            enhancer.enhance_fingerprint(image.copy(), resize=False) > 0, 0, 255
        ).astype(np.uint8)
    if pyfing := classical_pyfing():
        methods["pyfing: GMFS, GBFOE, XSFFE, GBFEN"] = lambda image: by_pyfing(pyfing, image)
    for name, run in methods.items():
        done = [image for image in images if _works(run, image)]
        if len(done) < len(images):
            print(
                f"\n{name} fails on {len(images) - len(done)} of the {len(images)} prints: left out"
                " for all."
            )
        images = done
    work = {name: lambda run=run: [run(image) for image in images] for name, run in methods.items()}

    def quality(enhanced: list[np.ndarray]) -> str:
        scores = [score for score in (nfiq2(image) for image in enhanced) if score <= 100]
        return f"{statistics.median(scores):g} / {statistics.mean(scores):.1f}"

    print(f"\nNFIQ 2 of the prints as they are, median / mean: {quality(images)}.")
    title = (
        f"Enhancement of {len(images)} real prints, the first of {size} pixels, everything"
        " estimated"
    )
    print_table(title, race(work, rounds), quality, "NFIQ 2, median / mean")


def _works(run: Callable[[np.ndarray], np.ndarray], image: np.ndarray) -> bool:
    try:
        run(image)
    except Exception:
        return False
    return True


def classical_pyfing() -> Any:
    """pyfing without keras: the methods run here are the classical ones."""
    for name in ("keras", "keras.layers", "keras.models", "keras.ops"):
        sys.modules.setdefault(name, MagicMock())
    return library("pyfing")


def by_pyfing(pyfing: Any, image: np.ndarray) -> np.ndarray:
    mask = pyfing.fingerprint_segmentation(image, method="GMFS")
    field = pyfing.orientation_field_estimation(image, mask, method="GBFOE")
    field = field[0] if isinstance(field, tuple) else field
    periods = pyfing.frequency_estimation(image, field, mask, method="XSFFE")
    # its ridges are white
    return 255 - pyfing.fingerprint_enhancement(image, field, periods, mask, method="GBFEN")


if __name__ == "__main__":
    main()
