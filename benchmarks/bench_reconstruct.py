"""The command line from disk to disk: seconds, processor time and peak memory of whole runs.

    python benchmarks/bench_reconstruct.py  # full and half scale, metric, snk and ea
    python benchmarks/bench_reconstruct.py --photographs 200x3 8x45

The numbers after ``--photographs``: number x megapixels.

Every run is a process of its own (what it loads counts). The captures are simulated once into
``benchmarks/out`` and carry no truth: comparing is not part of a reconstruction.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from timing import machine

OUT = Path(__file__).resolve().parent / "out"
STAGES = ("reading", "finger", "light", "normals", "surface", "result")
SEED = 3
READ = """
import cv2, json, pathlib, sys, time
files = sorted(pathlib.Path(sys.argv[1]).glob("*.png"))
begun = time.process_time()
for file in files:
    cv2.imread(str(file), -1)
print(json.dumps({"cpu_s": time.process_time() - begun}))
"""


@dataclass(frozen=True, slots=True)
class Run:
    """What one process took."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    facts: dict[str, Any]


def run_process(command: Sequence[str]) -> Run:
    """Run one process to its end and measure it alone; it must succeed and print JSON or
    nothing."""
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout as stream:
        text = stream.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - started
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)} ended with exit code {process.returncode}.")
    unit = 1e6 if sys.platform == "darwin" else 1e3
    peak_mb = usage.ru_maxrss / unit
    return Run(
        wall, usage.ru_utime + usage.ru_stime, peak_mb, json.loads(text) if text.strip() else {}
    )


def run_warm(command: Sequence[str]) -> Run:
    """Run one process after another one used 2 GB for a moment.

    A virtual machine gives free memory back to its host and waits for it at its next use, up to 2.5
    ms a MB: no cost of the program that comes next.
    """
    subprocess.run([sys.executable, "-c", "b'1' * int(2e9)"], check=True)
    return run_process(command)


def splitknit(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "splitknit.cli.main", *arguments, "--json"]


def prepare(scale: float) -> tuple[Path, Run]:
    """Simulate a capture and take its truth away; its cost is that of the twin."""
    folder = OUT / f"capture_{scale:g}"
    shutil.rmtree(folder, ignore_errors=True)
    cost = run_process(
        splitknit("simulate", "--out", str(folder), "--seed", str(SEED), "--scale", str(scale))
    )
    content = json.loads((folder / "capture.json").read_text())
    content.pop("truth")
    (folder / "capture.json").write_text(json.dumps(content))
    (folder / "truth.npz").unlink()
    return folder, cost


def seconds_of(work: Callable[[], object], rounds: int) -> float:
    """Least seconds of some rounds."""
    durations = []
    for _ in range(rounds):
        started = time.perf_counter()
        work()
        durations.append(time.perf_counter() - started)
    return min(durations)


def peers(folder: Path, result: Path, rounds: int) -> list[tuple[str, float]]:
    """The usual ways of reading the images and writing the arrays, in this process."""
    import cv2
    import numpy as np

    files = sorted(folder.glob("*.png"))
    with np.load(result / "height.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    target = OUT / "peer.npz"
    rows = [
        (
            "OpenCV, imread of all images, one after the other",
            lambda: [cv2.imread(str(f), -1) for f in files],
        ),
        (
            "numpy.savez_compressed of height.npz's arrays",
            lambda: np.savez_compressed(target, **arrays),
        ),
        ("numpy.savez (not compressed) of the same", lambda: np.savez(target, **arrays)),
    ]
    times = [(words, seconds_of(work, rounds)) for words, work in rows]
    target.unlink()
    return times


def import_seconds(rounds: int = 10) -> tuple[float, float]:
    """Median seconds of ``import splitknit`` beyond a bare interpreter, and with all that
    reconstruct loads."""

    def least(code: str) -> float:
        times = []
        for _ in range(rounds):
            started = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - started)
        return statistics.median(times)

    bare = least("pass")
    return least("import splitknit") - bare, least("import splitknit; splitknit.reconstruct") - bare


def table(scale: float, presets: Sequence[str], rounds: int) -> None:
    folder, cost = prepare(scale)
    rows, columns = (int(n) for n in cost.facts["image_size"])
    print(
        f"\n### {columns} x {rows}, {cost.facts['images']} images and two ambient frames, 8-bit"
        " PNG\n"
    )
    print(f"simulate: {cost.wall_s:.1f} s wall, {cost.cpu_s:.1f} s CPU, {cost.peak_mb:.0f} MB\n")
    print(f"| preset | wall s, least / median | CPU s | peak MB | {' | '.join(STAGES)} | writing |")
    print("| --- | --- | --- | --- |" + " --- |" * (len(STAGES) + 1))
    ratios = {}
    for preset in presets:
        target = OUT / f"result_{preset}"
        command = splitknit("reconstruct", str(folder), "--out", str(target), "--preset", preset)
        runs, times = [], []
        for _ in range(rounds):
            runs.append(run_warm(command))
            reading = run_process([sys.executable, "-c", READ, str(folder)]).facts["cpu_s"]
            times.append(runs[-1].cpu_s / reading)
        ratios[preset] = statistics.median(times)
        best = min(runs, key=lambda run: run.wall_s)
        stages = best.facts["timings_s"]
        writing = best.facts["total_s"] - sum(stages.values())
        cells = [f"{stages.get(stage, 0.0):.2f}" for stage in STAGES] + [f"{writing:.2f}"]
        median = statistics.median(run.wall_s for run in runs)
        cpu = min(run.cpu_s for run in runs)
        peak = max(run.peak_mb for run in runs)
        print(
            f"| `{preset}` | {best.wall_s:.2f} / {median:.2f} | {cpu:.2f} | {peak:.0f} |"
            f" {' | '.join(cells)} |"
        )
    words = ", ".join(f"`{preset}` {ratio:.2f}" for preset, ratio in ratios.items())
    print(
        "\nprocessor time over that of OpenCV's imread of the files, round by round, median:"
        f" {words}"
    )
    print("\n| peer | seconds |\n| --- | --- |")
    for words, seconds in peers(folder, OUT / f"result_{presets[0]}", rounds):
        print(f"| {words} | {seconds:.2f} |")


def photographs(case: str) -> None:
    """Print a row on photographs of a bumpy ball, such as ``200x3``: a drawn JPEG file of each
    light, opaque."""
    import cv2
    import numpy as np

    count, megapixels = (int(word) for word in case.split("x"))
    folder = OUT / f"photographs_{case}"
    if not (folder / "lights.txt").is_file():
        folder.mkdir(exist_ok=True)
        rows, columns = (int(np.sqrt(megapixels * 1e6 * ratio)) for ratio in (3 / 4, 4 / 3))
        y, x = np.ogrid[-1 : 1 : rows * 1j, -4 / 3 : 4 / 3 : columns * 1j]
        inner = np.clip(1 - (x**2 + y**2) / 0.9, 0, 1).astype(np.float32)
        normal = [
            (part + 0.1 * np.sin(60 * part)).astype(np.float32) for part in (x + 0 * y, y + 0 * x)
        ]
        angles = np.arange(count) * 2.4
        tilts = np.deg2rad(np.linspace(10, 50, count))
        lights = np.stack(
            [np.sin(tilts) * np.cos(angles), np.sin(tilts) * np.sin(angles), np.cos(tilts)], axis=1
        )
        for k, (a, b, c) in enumerate(lights):
            shade = (normal[0] * a - normal[1] * b + np.sqrt(inner) * c) * (inner > 0)
            colour = [
                (np.clip(0.02 + a * shade, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)
                for a in (0.4, 0.6, 0.8)
            ]
            cv2.imwrite(
                str(folder / f"photo_{k}.jpg"), cv2.merge(colour), [cv2.IMWRITE_JPEG_QUALITY, 90]
            )
        np.savetxt(folder / "lights.txt", lights)
    target = OUT / "result_photographs"
    command = splitknit(
        "reconstruct", "--images", str(folder), "--px-per-mm", "20", "--out", str(target)
    )
    run = run_process(command)
    result_mb = sum(file.stat().st_size for file in target.iterdir()) / 1e6
    mesh_mb = (target / "surface.ply").stat().st_size / 1e6
    cells = (
        f"{run.wall_s:.0f} | {run.cpu_s:.0f} | {run.peak_mb:.0f} | {mesh_mb:.0f} | {result_mb:.0f}"
    )
    print(f"| {count} of {megapixels} MP | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--scales", type=float, nargs="+", default=[1.0, 0.5])
    parser.add_argument("--presets", nargs="+", default=["metric", "snk", "ea"])
    parser.add_argument(
        "--photographs", nargs="+", metavar="COUNTxMP", help="memory of photographs alone"
    )
    options = parser.parse_args()
    OUT.mkdir(exist_ok=True)
    # modules are compiled once, as where the package is installed
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if options.photographs:
        print("| photographs | wall s | CPU s | peak MB | mesh MB | result MB |")
        print("| --- | --- | --- | --- | --- | --- |")
        for case in options.photographs:
            photographs(case)
        return
    print(f"Whole runs from disk to disk, {machine()}")
    lean, loaded = import_seconds()
    print(
        f"\nimport splitknit: {lean:.3f} s; with all that reconstruct needs: {loaded:.2f} s (beyond"
        " a bare Python)"
    )
    for scale in options.scales:
        table(scale, options.presets, options.rounds)


if __name__ == "__main__":
    main()
