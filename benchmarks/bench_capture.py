"""A capture session in the twin, from the command to the folder, and what its checks cost a frame.

    python benchmarks/bench_capture.py [--rounds 3] [--scales 0.5 1]

The twin's devices have a clock of their own: "by the design" are the seconds that the rig needs for the shots, without
what the computer in the rig needs for checks; those are measured in the second table, on one core of this machine.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Callable
from statistics import median

import numpy as np

from bench_reconstruct import OUT, run_process, splitknit
from splitknit.devices import Frame
from splitknit.io.capture import read_capture
from splitknit.io.images import encode_image
from splitknit_rig.capture.exposure import grey_light, measure_focus
from splitknit_rig.capture.shots import CheckSettings, Examiner
from timing import machine

PX_PER_MM = 75.7


def sessions(scale: float, rounds: int) -> str:
    """One line of the table of sessions."""
    runs = []
    for _ in range(rounds):
        folder = OUT / f"session_{scale:g}"
        shutil.rmtree(folder, ignore_errors=True)
        runs.append(
            run_process(
                splitknit("capture", "--device", "twin", "--out", str(folder), "--scale", str(scale), "--seed", "3")
            )
        )
    facts = runs[0].facts
    rows, columns = facts["image_size"]
    return (
        f"| {columns} x {rows} | {min(run.wall_s for run in runs):.1f} / {median(run.wall_s for run in runs):.1f} | "
        f"{min(run.cpu_s for run in runs):.1f} | {max(run.peak_mb for run in runs):.0f} | {facts['seconds']:.2f} | "
        f"{facts['seconds_per_frame']:.3f} |"
    )


def checks(scale: float, rounds: int) -> None:
    """Print what is done to each frame, on the images of the last session."""
    import cv2

    cv2.setNumThreads(1)
    capture = read_capture(OUT / f"session_{scale:g}")
    with np.load(str(capture.truth)) as truth:
        region = truth["mask"][::4, ::4]
    white, px = capture.bands["white"], PX_PER_MM * scale
    frames = [Frame(pixels, 0.01, 1.0) for pixels in white.pixels]
    assert white.ambient is not None
    examiner = Examiner(np.ascontiguousarray(region), px, CheckSettings())
    looks = [examiner.look(frame) for frame in frames]
    dark = examiner.look(Frame(white.ambient, 0.01, 1.0))
    columns = capture.shape[1]
    middle = slice(capture.shape[0] // 2 - 378, None), slice(columns // 2 - 378, columns // 2 + 378)
    light = grey_light(white.pixels[0][middle])[:757]
    everything = np.ones(light.shape, dtype=np.bool_)
    work = {
        "look at a frame: light, saturation, ridges": lambda: examiner.look(frames[0]),
        "motion against the frame before": lambda: examiner.shift_mm(looks[0], looks[1], columns),
        "drift of a band (once a band)": lambda: examiner.drift(looks, dark, columns),
        "focus (once a measurement)": lambda: measure_focus(light, everything, px),
        "PNG of a frame (after the last shot)": lambda: encode_image(white.pixels[0], ".png"),
    }
    print(f"\n### Checks, {columns} x {capture.shape[0]}, one core, processor time\n\n| what | ms |\n| --- | --- |")
    for name, one in work.items():
        print(f"| {name} | {1e3 * processor_seconds(one, max(rounds, 3)):.0f} |")


def processor_seconds(work: Callable[[], object], rounds: int) -> float:
    """Least processor time of some rounds: other programs do not count."""
    found = []
    for _ in range(rounds):
        started = time.process_time()
        work()
        found.append(time.process_time() - started)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--scales", type=float, nargs="+", default=[0.5, 1.0])
    options = parser.parse_args()
    print(f"Sessions in the twin, {machine()}, {time.strftime('%Y-%m-%d')}")
    print(
        "\n| images | seconds, least / median | processor time | peak MB | by the design: 14 frames, s | a frame, s |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    OUT.mkdir(exist_ok=True)
    for scale in options.scales:
        print(sessions(scale, options.rounds), flush=True)
    checks(options.scales[-1], options.rounds)


if __name__ == "__main__":
    main()
