"""Prints of a phalange at full resolution, and enhancement of real prints beside its peers.

    python benchmarks/bench_prints.py [--rounds 5] [--scale 1.0] [--prints FOLDER] [--peers PYTHON]

The phalange is a drawn finger's true surface (nothing is reconstructed). `--prints` names a folder of 500-ppi PNG files
(default: the ten first of ../shared/data/fvc2002_db1b); `--peers` an interpreter in an environment of its own with
`fingerprint-enhancer` and `pyfing` (neither is needed by this project). Quality is NFIQ 2 of the enhanced prints. On a
busy machine the processor's seconds show more than those on the wall; both are given.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.finger.orientation import find_upright
from splitknit.matching.minutiae import nfiq2
from splitknit.model import default_rig
from splitknit.prints.curvature import CurvatureSettings, curvature
from splitknit.prints.enhance import gabor_enhance, ridge_mask, stft_enhance, thin
from splitknit.prints.make import Print, enhance, make_print
from splitknit.prints.sources import Source
from splitknit.simulator.finger.finger import Pose, draw_finger, finger_surface
from timing import machine

PRINTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "fvc2002_db1b"

PEERS = """
import json, sys, time
from pathlib import Path
import cv2, numpy as np
out, files = Path(sys.argv[1]), sys.argv[2:]
cv2.setNumThreads(2)
seconds = {}
def note(name, start, cpu):
    seconds.setdefault(name, []).append((time.perf_counter() - start, time.process_time() - cpu))
import fingerprint_enhancer
try:
    import keras
except ImportError:  # the methods run here are the classical ones
    from unittest.mock import MagicMock
    for name in ("keras", "keras.layers", "keras.models", "keras.ops"):
        sys.modules[name] = MagicMock()
import pyfing
for index, file in enumerate(files):
    image = cv2.imread(file, 0)
    for repeat in range(2):  # the first warms up
        seconds_before = {k: list(v) for k, v in seconds.items()}
        start, cpu = time.perf_counter(), time.process_time()
        try:
            made = fingerprint_enhancer.enhance_fingerprint(image.copy(), resize=False)
            made = np.where(made > 0, 0, 255).astype(np.uint8)
            note("fingerprint-enhancer", start, cpu)
            cv2.imwrite(str(out / f"fingerprint-enhancer_{index}.png"), made)
        except Exception as error:
            print("fingerprint-enhancer", file, error, file=sys.stderr)
        start, cpu = time.perf_counter(), time.process_time()
        mask = pyfing.fingerprint_segmentation(image, method="GMFS")
        field = pyfing.orientation_field_estimation(image, mask, method="GBFOE")
        field = field[0] if isinstance(field, tuple) else field
        periods = pyfing.frequency_estimation(image, field, mask, method="XSFFE")
        begin, begin_cpu = time.perf_counter(), time.process_time()
        made = pyfing.fingerprint_enhancement(image, field, periods, mask, method="GBFEN")
        note("pyfing GBFEN alone", begin, begin_cpu)
        note("pyfing GMFS + GBFOE + XSFFE + GBFEN", start, cpu)
        cv2.imwrite(str(out / f"pyfing_{index}.png"), 255 - made)  # its ridges are white
        if repeat == 0:
            seconds = seconds_before
print(json.dumps(seconds))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--prints", type=Path, default=PRINTS)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--peers", type=Path, default=None)
    options = parser.parse_args()
    cv2.setNumThreads(2)
    print(f"Prints, {machine()}, two threads")
    phalange(options.scale, options.rounds)
    files = sorted(options.prints.glob("*.png"))[: options.count] if options.prints.is_dir() else []
    if files:
        real_prints(files, options.peers, options.rounds)
    else:
        print(f"\nNo prints in {options.prints}: the comparison with peers is left out.")


def timed(run: Callable[[], Any], rounds: int) -> tuple[Any, float, float]:
    """Return the result, the least seconds on the wall, and the least seconds of the processor."""
    result, walls, processors = run(), [], []
    for _ in range(rounds):
        wall, processor = time.perf_counter(), time.process_time()
        run()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return result, min(walls), min(processors)


def phalange(scale: float, rounds: int) -> None:
    """Time each conversion of one finger."""
    camera = default_rig(scale).camera
    seen = finger_surface(draw_finger(1), Pose(insertion_mm=26.0), camera, workers=2)
    upright = find_upright(seen.mask)
    relief = seen.height_mm - seen.shape_mm
    source = Source(
        "result", seen.mask, camera.pitch_mm, upright.input_from_upright, upright.size, seen.height_mm, relief,
        seen.shape_mm,
    )  # fmt: skip
    rows, columns = (int(np.ptp(np.flatnonzero(seen.mask.any(axis=axis)))) + 1 for axis in (1, 0))
    print(f"\n### A phalange of {rows} x {columns} pixels ({camera.px_per_mm:.1f} px/mm)\n")
    print("| what | wall s | processor s |\n| --- | --- | --- |")

    def row(name: str, run: Callable[[], Any]) -> Any:
        result, wall, processor = timed(run, rounds)
        print(f"| {name} | {wall:.3f} | {processor:.3f} |")
        return result

    unrolled: Print = row("unrolled print (free)", lambda: make_print(source, "unroll"))
    for kind in ("arc", "tube", "cylinder"):
        row(f"unrolled print ({kind})", lambda kind=kind: make_print(source, "unroll", kind))
    row("relief print", lambda: make_print(source, "relief"))
    for degree, word in ((2, "quadratic"), (3, "cubic")):
        settings = CurvatureSettings(degree=degree)
        row(f"curvature map, {word}", lambda s=settings: curvature(seen.height_mm, seen.mask, camera.pitch_mm, s))
    enhanced = row("Gabor enhancement of the unrolled print", lambda: enhance(unrolled, 500.0))
    row("STFT enhancement of it", lambda: stft_enhance(unrolled.image, 500.0, unrolled.weight > 0.5))
    row("black and white, thinned", lambda: thin(ridge_mask(enhanced)))
    print(f"\nThe print has {unrolled.image.shape[0]} x {unrolled.image.shape[1]} pixels.")


def real_prints(files: list[Path], peers: Path | None, rounds: int) -> None:
    """Time and judge enhancement of real prints."""
    images = [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for file in files]
    size = " x ".join(map(str, images[0].shape))
    print(f"\n### Enhancement of {len(files)} real prints, the first of {size} pixels, everything estimated\n")
    print(
        "| what | wall ms, median | processor ms, median | NFIQ 2, median | NFIQ 2, mean |\n"
        "| --- | --- | --- | --- | --- |"
    )

    def line(name: str, seconds: list[tuple[float, float]], made: list[np.ndarray]) -> None:
        walls, processors = (1000 * statistics.median(s[k] for s in seconds) if seconds else None for k in range(2))
        scores = [score for score in (nfiq2(image) for image in made) if score <= 100]
        times = "- | -" if walls is None else f"{walls:.0f} | {processors:.0f}"
        print(f"| {name} | {times} | {statistics.median(scores):g} | {statistics.mean(scores):.1f} |")

    line("as they are", [], images)
    for name, run in (("splitknit Gabor", gabor_enhance), ("splitknit STFT", stft_enhance)):
        seconds, made = [], []
        for image in images:
            result, wall, processor = timed(lambda image=image, run=run: run(image), rounds)
            seconds.append((wall, processor))
            made.append(result.image)
        line(name, seconds, made)
    if peers is None:
        return
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "peers.py"
        script.write_text(PEERS)
        run = subprocess.run(
            [str(peers), str(script), folder, *map(str, files)], capture_output=True, text=True, check=True
        )
        measured = json.loads(run.stdout.splitlines()[-1])
        for name, seconds in measured.items():
            prefix = "pyfing" if name.startswith("pyfing") else name
            made = [
                np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
                for path in sorted(Path(folder).glob(f"{prefix}_*.png"))
            ]
            line(name, seconds, made)
        if run.stderr.strip():
            print("\n" + run.stderr.strip()[-500:])


if __name__ == "__main__":
    main()
