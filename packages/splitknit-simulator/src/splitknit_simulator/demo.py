"""The demonstration: a simulated finger, photographed, reconstructed by two methods, compared with
its true surface."""

from __future__ import annotations

import time
from pathlib import Path

from splitknit.arguments import AnyPath, Natural, Progress, Report, Scale, checked, silent

PRESETS = ("metric", "ea")
WRITTEN = {
    "report.html": "both results beside the truth; open it in a browser",
    "report.json": "the same figures for programs",
    "capture": "the simulated capture (14 images, the rig, the truth)",
    "metric": "the result of the preset metric: mesh, heights, normals, print, report",
    "ea": "the result of plain photometric stereo on the same images",
}


@checked
def demo(
    *,
    out: AnyPath = Path("demo"),
    seed: Natural = 1,
    scale: Scale = 0.5,
    progress: Progress = silent,
) -> Report:
    """Simulate a finger, reconstruct it, compare it with the truth.

    Parameters
    ----------
    out
        Folder to write: ``capture``, ``metric``, ``ea`` and the report that compares them, all or
        nothing.
    seed
        Which finger.
    scale
        Size of the images, 1 = 3200 x 2200 pixels.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If `out` holds anything but an earlier demonstration.

    Examples
    --------
    >>> facts = demo(out="demo", scale=0.1).facts  # doctest: +SKIP
    >>> facts["comparison"]["metric"]["ridge_correlation"]  # doctest: +SKIP
    0.97
    """
    from splitknit import read_capture, reconstruct, write_capture
    from splitknit.io.atomic import atomic_folder
    from splitknit.io.targets import check_target
    from splitknit.report.result import make_report, write_results
    from splitknit_simulator.accuracy import compare
    from splitknit_simulator.twin import simulate_capture, twin_settings

    started, folder = time.perf_counter(), Path(out)
    check_target(folder, "capture/truth.npz", "an earlier demonstration")
    with atomic_folder(folder) as target:
        progress("simulating a finger", 0.02)
        simulated, truth = simulate_capture(seed, None, twin_settings(scale, None))
        progress("writing the capture", 0.35)
        write_capture(simulated, target / "capture", truth)
        del simulated
        capture = read_capture(target / "capture")
        results = []
        comparisons = []
        for k, preset in enumerate(PRESETS):
            progress(f"reconstructing, {preset}", 0.4 + 0.25 * k)
            results.append(reconstruct(capture, preset))
            comparisons.append(compare(results[-1], truth))
            write_results(results[-1], capture, target / preset, comparisons[-1:])
        progress("comparing", 0.92)
        title = "splitknit demo: a simulated 3D fingerprint"
        report = make_report(results[0], capture, comparisons, results[1:], title)
        facts = report.write(target, list(WRITTEN))
    progress("done", 1.0)
    total_s = time.perf_counter() - started
    lines = [
        "A simulated finger was photographed, reconstructed and compared with the truth in"
        f" {total_s:.0f} s."
    ]
    for preset, figure in facts["comparison"].items():
        lines.append(
            f"  {preset:7s} surface rms {figure['surface_rms_mm']:.3f} mm, ridge correlation"
            f" {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}"
        )
    lines.append(f"Open {folder / 'report.html'} in a browser. Also written:")
    lines += [f"  {folder / name}: {what}" for name, what in WRITTEN.items()]
    return Report({**facts, "out": str(out), "written": WRITTEN, "total_s": total_s}, tuple(lines))
