"""The demonstration: a simulated finger, photographed, reconstructed by two methods, compared with its true surface."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit import read_capture, reconstruct, write_capture
from splitknit.accuracy import TRUTH_ARRAYS
from splitknit.io.atomic import atomic_folder
from splitknit.io.targets import check_target
from splitknit.model import no_progress
from splitknit.report.result import make_report, write_results
from splitknit.verbs import Progress
from splitknit_simulator.twin import simulate_capture, twin_settings

PRESETS = ("metric", "ea")
WRITTEN = {
    "report.html": "both results beside the truth; open it in a browser",
    "report.json": "the same figures for programs",
    "capture": "the simulated capture (14 images, the rig, the truth)",
    "metric": "the result of the preset metric: mesh, heights, normals, print, report",
    "ea": "the result of plain photometric stereo on the same images",
}


def demo(out: Path, *, seed: int = 1, scale: float = 0.5, progress: Progress = no_progress) -> dict[str, Any]:
    """Write ``capture``, ``metric``, ``ea`` and the report that compares them into `out`, all or nothing; return its
    facts, with ``out``, ``written`` (name to words) and ``total_s``.
    """
    started = time.perf_counter()
    check_target(out, "capture/truth.npz", "an earlier demonstration")
    with atomic_folder(out) as target:
        progress("simulating a finger", 0.02)
        simulated, truth = simulate_capture(seed, None, twin_settings(scale, None))
        progress("writing the capture", 0.35)
        write_capture(simulated, target / "capture", truth)
        del simulated
        capture = read_capture(target / "capture")
        compared = {name: truth[name] for name in TRUTH_ARRAYS}
        results = []
        for k, preset in enumerate(PRESETS):
            progress(f"reconstructing, {preset}", 0.4 + 0.25 * k)
            results.append(reconstruct(capture, preset))
            write_results(results[-1], capture, target / preset, compared)
        progress("comparing", 0.92)
        title = "splitknit demo: a simulated 3D fingerprint"
        report = make_report(results[0], replace(capture, truth=None), compared, results[1:], title)
        facts = report.write(target, list(WRITTEN))
    progress("done", 1.0)
    return {**facts, "out": str(out), "written": WRITTEN, "total_s": time.perf_counter() - started}
