"""Time, processor time and memory of `splitknit import` of a finger-sized cloud, and the error of its heights.

    python benchmarks/bench_clouds.py [--points 1e7] [--kinds lattice,scattered,text]

The cloud is an exact cylinder of 8 mm radius with ridges; the whole command is timed, its result folder included.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from splitknit.io.results import read_result

HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "end_header\n"
)


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Of the cylinder and its ridges, mm."""
    return np.sqrt(64.0 - x**2) - 3 + 0.03 * np.cos(2 * np.pi * np.hypot(x, y - 2) / 0.45)


def points_of(kind: str, count: int) -> np.ndarray:
    """(N, 3) float32, mm."""
    side = round(np.sqrt(count))
    x, y = np.meshgrid(np.linspace(-7, 7, side), np.linspace(9, -5, side))
    if kind == "scattered":
        x, y = np.random.default_rng(0).uniform((-7, -5), (7, 9), (count, 2)).T
    return np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3).astype("<f4")


def main() -> None:
    """Measure each kind once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=float, default=1e7)
    parser.add_argument("--kinds", default="lattice,scattered,text")
    options = parser.parse_args()
    for kind in options.kinds.split(","):
        with tempfile.TemporaryDirectory() as folder:
            points, file = points_of(kind, int(options.points)), Path(folder) / ("a.xyz" if kind == "text" else "a.ply")
            with file.open("wb") as stream:
                if kind == "text":
                    for start in range(0, len(points), 1 << 18):
                        np.savetxt(stream, points[start : start + (1 << 18)], fmt="%.5f")
                else:
                    stream.write(HEADER.format(len(points)).encode() + points.tobytes())
            words = [sys.executable, "-m", "splitknit", "import", str(file), "--out", f"{folder}/out"]
            before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
            subprocess.run(words, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL)
            wall, used = time.monotonic() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
            result = read_result(f"{folder}/out/height.npz")
            row, column = np.nonzero(result.mask)
            x, y = points[:, 0].min() + column * result.pitch_mm, points[:, 1].max() - row * result.pitch_mm
            error = result.height_mm[result.mask] - height(np.clip(x, -7, 7), y)
            print(
                f"{kind}: {len(points):,} points, {wall:.1f} s, {cpu:.1f} s of processor time, peak so far "
                f"{used.ru_maxrss / 1e6:.2f} GB, heights within {1000 * np.sqrt((error**2).mean()):.2f} um rms"
            )


if __name__ == "__main__":
    main()
