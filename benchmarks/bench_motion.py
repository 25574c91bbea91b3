"""What it costs to bring the shots of a moving finger onto one of them: seconds, at full size.

    python benchmarks/bench_motion.py

The capture is simulated at a third of the size and enlarged; what it shows does not matter to the time. Beside it: the
peer that most people would take, OpenCV's ECC (translation and turn) from shot to shot, which takes light for motion.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from splitknit.pipeline import preset_settings
from splitknit.recipe.finger import find_finger
from splitknit.recipe.steady import find_steady_finger
from splitknit.recipe.stopwatch import Stopwatch
from splitknit.settings import override
from splitknit.simulate.twin import TwinSettings, simulate_capture
from splitknit.types import Capture
from timing import machine


def enlarged(capture: Capture, factor: float) -> Capture:
    """The capture with images of more pixels."""
    camera = capture.rig.camera
    size = tuple(round(n * factor) for n in camera.image_size)

    def large(image: np.ndarray) -> np.ndarray:
        return cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_LINEAR)

    bands = {
        name: replace(
            band,
            pixels=np.stack([large(image) for image in band.pixels]),
            ambient=None if band.ambient is None else large(band.ambient),
        )
        for name, band in capture.bands.items()
    }
    camera = replace(camera, px_per_mm=camera.px_per_mm * factor, image_size=(size[0], size[1]))
    return replace(capture, rig=replace(capture.rig, camera=camera), bands=bands)


def least(work: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Least wall and processor seconds of some rounds."""
    found = []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        found.append((time.perf_counter() - wall, time.process_time() - cpu))
    return min(found)[0], min(cpu for _, cpu in found)


def ecc(capture: Capture) -> None:
    """Register every green image to the middle one."""
    pixels = capture.bands["white"].pixels[:, ::3, ::3, 1]
    for image in pixels:
        warp = np.eye(2, 3, dtype=np.float32)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-4)
        cv2.findTransformECC(np.ascontiguousarray(pixels[3]), image, warp, cv2.MOTION_EUCLIDEAN, criteria, None, 5)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--scale", type=float, default=1.0)
    options = parser.parse_args()
    small = options.scale / 3.0
    capture = enlarged(simulate_capture(3, None, TwinSettings(scale=small))[0], 3.0)
    on = override(preset_settings("metric"), {"motion.correct": "on"})
    alone = least(lambda: find_finger(capture, on, Stopwatch()), options.rounds)
    steady = least(lambda: find_steady_finger(capture, on, Stopwatch()), options.rounds)
    peer = least(lambda: ecc(capture), 1)
    rows, columns = capture.shape
    print(f"A capture of {columns} x {rows}, 14 images, {machine()}\n\n| work | wall s | CPU s |\n| --- | --- | --- |")
    print(f"| finding the finger, once (as for a still one) | {alone[0]:.2f} | {alone[1]:.2f} |")
    undone = [s - 2 * a for s, a in zip(steady, alone, strict=True)]
    print(f"| registration and resampling (it is then found again) | {undone[0]:.2f} | {undone[1]:.2f} |")
    print(f"| OpenCV's ECC, 7 images at a third of the size | {peer[0]:.2f} | {peer[1]:.2f} |")


if __name__ == "__main__":
    main()
