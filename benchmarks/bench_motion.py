"""What it costs to bring the shots of a moving finger onto one of them: seconds, at full size.

    python benchmarks/bench_motion.py

A finger that moves by 0.5 mm is simulated at a third of the size, and its images enlarged. Beside it: the peer that
most people would take, OpenCV's ECC (translation and turn) from shot to shot, which takes light for motion. Seconds are
the least of the rounds, and the processor's also the middle one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from splitknit.finger.locate import find_finger
from splitknit.finger.steady import register, resampled
from splitknit.model import Capture
from splitknit.presets import preset_settings
from splitknit.settings import override
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture
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


def timed(work: Callable[[], object], rounds: int) -> tuple[float, float, float]:
    """Least seconds on the wall, least and middle ones of the processor, of some rounds."""
    found = []
    for _ in range(rounds):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        found.append((time.perf_counter() - wall, time.process_time() - processor))
    walls, processors = (sorted(column) for column in zip(*found, strict=True))
    return walls[0], processors[0], processors[len(processors) // 2]


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
    twin = TwinSettings(scale=small, motion=HandMotion(amplitude_mm=0.5))
    capture = enlarged(simulate_capture(3, None, twin)[0], 3.0)
    on = override(preset_settings("metric"), {"motion.correct": "on"})
    finger = find_finger(capture, on)
    registered = register(capture, finger, on)
    times = {
        "finding the finger (once for a still one, twice for one that moved)": timed(
            lambda: find_finger(capture, on), options.rounds
        ),
        "registration": timed(lambda: register(capture, finger, on), options.rounds),
        "resampling": timed(lambda: resampled(capture, finger, registered), options.rounds),
        "OpenCV's ECC, 7 images at a third of the size": timed(lambda: ecc(capture), 1),
    }
    rows, columns = capture.shape
    print(f"A capture of {columns} x {rows}, 14 images, {machine()}\n")
    print("| work | wall s | CPU s | CPU s, median |\n| --- | --- | --- | --- |")
    for name, seconds in times.items():
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in seconds) + " |")


if __name__ == "__main__":
    main()
