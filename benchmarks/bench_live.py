"""Frames a second of `splitknit view --live` at 640 x 480, and what each stage of a frame takes.

python benchmarks/bench_live.py [--seconds N]

A folder of rendered frames of a gel sensor is the source, so that no camera is needed; a program polls the server as
the page does. On a busy machine the processor's milliseconds show more than the clock's: two cores have 2000 of them a
second. The browser's own work (colours and drawing) comes on top, in another process.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import argparse
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench_viewer import processor_seconds
from timing import machine

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from gel_frames import cap, dots, frame, places, shading
from splitknit.io.images import write_image
from splitknit.photometric.shading import shading_slopes, write_shading
from splitknit_rig.capture.live import HeightMeter

SIZE = (480, 640)
MARKER_PX = 9
FRAMES = 12


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0)
    options = parser.parse_args()
    print(machine("opencv-python-headless", "scipy"))
    flat = shading(SIZE)
    # as a calibration by many balls has it: every term also varies over the field
    sensor = replace(flat, weights=np.concatenate([flat.weights, *[0.0 * flat.weights] * 9]),
                     covariance=np.zeros((200, 200)))  # fmt: skip
    print("\n| stage, ms of the clock (median of 20) | no markers | markers |\n| --- | --- | --- |")
    columns = [stages(sensor, marks) for marks in (False, True)]
    for name in columns[0]:
        print(f"| {name} | {columns[0][name]:.1f} | {columns[1][name]:.1f} |")
    print("\n| as a process | frames a second | processor ms a frame | frames a second that two cores allow |")
    print("| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for marks in (False, True):
            rate, spent = served(sensor, Path(folder), marks, options.seconds)
            row = f"{rate:.1f} | {spent:.0f} | {2000 / spent:.0f}"
            print(f"| {'markers' if marks else 'no markers'} | {row} |")


def picture(k: int, marks: bool) -> Any:
    """A ball that wanders, and waves."""
    x, y = places(SIZE)
    turn = 2 * np.pi * k / FRAMES
    height = cap(320 + 60 * np.cos(turn), 240 + 60 * np.sin(turn), 160, 80, SIZE)
    height += 2 * np.exp(-((x - 500) ** 2 + (y - 120) ** 2) / 3000) * np.cos((x + y) / 3)
    return frame(cv2.GaussianBlur(height, (0, 0), 2), dots(50, MARKER_PX, 5, SIZE) if marks else None)


def stages(sensor: Any, marks: bool) -> dict[str, float]:
    meter = HeightMeter(partial(shading_slopes, sensor), sensor.pitch_mm, SIZE, marker_px=MARKER_PX * marks)
    meter.take_flat(frame(np.zeros(SIZE), dots(50, MARKER_PX, 3, SIZE) if marks else None))
    pictures = [picture(k, marks) for k in range(4)]
    taken, spent = [], []
    for k in range(24):
        begin = time.process_time()
        taken.append(meter(pictures[k % 4]).times_ms)
        spent.append(1000 * (time.process_time() - begin))
    times = {name: statistics.median(one[name] for one in taken[4:]) for name in taken[0]}
    return {**times, "all": sum(times.values()), "all, of the processor": statistics.median(spent[4:])}


def served(sensor: Any, folder: Path, marks: bool, seconds: float) -> tuple[float, float]:
    """Frames a second and processor milliseconds a frame of the verb, polled as the page does."""
    frames = folder / f"frames-{marks}"
    frames.mkdir()
    for k in range(FRAMES):
        write_image(frames / f"{k:02d}.png", picture(k, marks))
    write_image(folder / "flat.png", frame(np.zeros(SIZE), dots(50, MARKER_PX, 3, SIZE) if marks else None))
    write_shading(folder / "shading.npz", sensor)
    command = [sys.executable, "-m", "splitknit.cli.main", "view", "--live", str(frames), "--fps", "20", "--json"]
    command += ["--shading", str(folder / "shading.npz"), "--flat", str(folder / "flat.png"), "--no-browser"]
    command += ["--marker-px", str(MARKER_PX)] if marks else []
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    try:
        text = ""
        while not text.endswith("}\n"):
            text += server.stdout.readline()  # type: ignore[union-attr]
        address, after, count = json.loads(text)["url"] + "api/live/frame?after=", 0, -5
        while True:
            with urllib.request.urlopen(address + str(after)) as answer:
                if not answer.read():
                    continue  # two seconds without a frame
                after = json.loads(answer.headers["X-Frame"])["number"]
            count += 1
            if count == 0:
                begin, spent = time.monotonic(), processor_seconds(server.pid)
            if count > 0 and time.monotonic() - begin > seconds:
                break
        elapsed, spent = time.monotonic() - begin, processor_seconds(server.pid) - spent
    finally:
        server.send_signal(signal.SIGINT)
        server.wait()
    return count / elapsed, 1000 * spent / count


if __name__ == "__main__":
    main()
