"""What calibration buys: fingers photographed by rigs as people build them, reconstructed with what
is known of them.

Every rig is another person's (``simulate --bench``): its camera, lights and brightness are
calibrated from photographs by the command line, as a person does it. One finger is photographed by
the true rig, and reconstructed with the true rig, with the calibrated one, with the drawings, and
with one part of the calibration left out at a time.

    python validation/calibration/ablation.py [--rigs 6] [--scale 0.5] [--write FILE.csv]

Finished parts are kept: a second call goes on. Results: ``ablation.json`` in
``validation/out/calibration`` and a table on stdout, with ``--write FILE.csv`` in a file too
(``tables/ablation.csv`` is the one of docs/experiments).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.capture import Capture
from splitknit.io.csv_table import csv_text
from splitknit.io.rig import read_rig
from splitknit.model import Led, Rig
from splitknit.nominal import nominal_rig
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Reconstruction
from splitknit_simulator.accuracy import compare
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

FIRST_FINGER = 2000
FIGURES = (
    "surface_rms_mm",
    "misplaced_mm",
    "scale_error",
    "normals_deg",
    "ridge_correlation",
    "ridge_gain",
)


def run(out: Path, rigs: int, scale: float) -> list[dict[str, Any]]:
    """Calibrate, photograph and reconstruct; one record for each rig and row."""
    records = []
    for seed in range(rigs):
        folder = out / f"rig_{seed}_{scale:g}"
        record = folder / "figures.json"
        if not record.is_file():
            calibrated = calibrate(folder, seed, scale)
            rows = measure(seed, read_rig(folder / "bench" / "rig_true.json"), calibrated)
            record.write_text(json.dumps(rows, indent=1) + "\n")
        records += json.loads(record.read_text())
        print(f"rig {seed} done", file=sys.stderr, flush=True)
    return records


def calibrate(folder: Path, seed: int, scale: float) -> Rig:
    """Take all photographs of a built rig and calibrate it by the command line."""
    bench = folder / "bench"

    def call(*words: object) -> None:
        command = [sys.executable, "-m", "splitknit.cli.main", *(str(word) for word in words)]
        code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
        if code != 0:
            raise SystemExit(f"splitknit {' '.join(str(w) for w in words)} ended with {code}")

    if not bench.is_dir():
        call("simulate", "--bench", "--seed", seed, "--scale", scale, "--out", bench)
    with_camera, with_lights, with_radiometry = (folder / f"rig_{k}.json" for k in (1, 2, 3))
    call(
        "calibrate",
        "camera",
        bench / "board",
        "--board",
        "9x6",
        "--square-mm",
        3,
        "--plane",
        bench / "plane.png",
        "--rig",
        bench / "rig_drawn.json",
        "--out",
        with_camera,
    )
    call(
        "calibrate",
        "lights",
        "--images",
        bench / "nail",
        "--rig",
        with_camera,
        "--out",
        with_lights,
    )
    call("calibrate", "radiometry", bench / "card", "--rig", with_lights, "--out", with_radiometry)
    return read_rig(with_radiometry)


def rows(true: Rig, calibrated: Rig, drawn: Rig) -> dict[str, tuple[Rig, dict[str, Any]]]:
    """Rig and settings of every row of the table."""

    def lights(places: Rig, light: Rig) -> tuple[Led, ...]:
        """LEDs of `places` with brightness, beam and aim of `light`."""
        return tuple(
            replace(p, intensity=b.intensity, lobe_exponent=b.lobe_exponent, aim=b.aim)
            for p, b in zip(places.leds, light.leds, strict=True)
        )

    plain = tuple(
        replace(led, intensity=1.0, lobe_exponent=0.0, aim=None) for led in calibrated.leds
    )
    return {
        "true rig": (true, {}),
        "calibrated": (calibrated, {}),
        "drawings only": (drawn, {}),
        "calibrated, but distant lights": (
            replace(calibrated, leds=tuple(distant(led) for led in calibrated.leds)),
            {},
        ),
        "calibrated, but places from the drawings": (
            replace(calibrated, leds=lights(drawn, calibrated)),
            {},
        ),
        "calibrated, but no flat field": (
            replace(calibrated, leds=plain, camera=replace(calibrated.camera, shading=())),
            {},
        ),
        "calibrated, but brightness alone": (
            replace(
                calibrated,
                leds=tuple(
                    replace(led, lobe_exponent=0.0, aim=None, intensity=at_origin(led))
                    for led in calibrated.leds
                ),
                camera=replace(calibrated.camera, shading=()),
            ),
            {},
        ),
        "calibrated, but an orthographic camera": (calibrated, {"camera": "orthographic"}),
        "true rig, but an orthographic camera": (true, {"camera": "orthographic"}),
    }


def at_origin(led: Led) -> float:
    """Brightness of an LED in the middle of the finger plane, its beam included."""
    towards = -np.asarray(led.position_mm) / np.linalg.norm(np.asarray(led.position_mm))
    return float(led.intensity * (led.axis @ towards) ** led.lobe_exponent)


def distant(led: Led) -> Led:
    """The same light from infinitely far: direction and brightness at the origin."""
    place = np.asarray(led.position_mm)
    far = float(np.linalg.norm(place))
    x, y, z = (float(v) for v in place / far)
    return Led(led.band, direction=(x, y, z), intensity=at_origin(led) * (140.0 / far) ** 2)


def measure(seed: int, true: Rig, calibrated: Rig) -> list[dict[str, Any]]:
    """Photograph one finger with the true rig and reconstruct it in every row's way."""
    scale = true.camera.image_size[0] / 2200
    capture, truth = simulate_capture(FIRST_FINGER + seed, settings=TwinSettings(rig=true))
    records = []
    for name, (rig, settings) in rows(true, calibrated, nominal_rig(scale)).items():
        result = reconstruct(replace(capture, rig=rig), settings=settings)
        records.append({"rig": seed, "row": name, **figures(result, capture, truth)})
    return records


def figures(result: Reconstruction, capture: Capture, truth: dict[str, Any]) -> dict[str, float]:
    """What `compare` gives, and where the points lie."""
    figure = dict(compare(result, truth).figures)
    seen = result.mask & truth["mask"] & np.isfinite(truth["height_mm"])
    height = result.height_mm[seen].astype(float)
    true = truth["height_mm"][seen].astype(float)
    above = true - true.mean()
    rows_px, columns_px = capture.shape
    if result.x_mm is None or result.y_mm is None:
        x = np.broadcast_to(
            (np.arange(columns_px) - (columns_px - 1) / 2) * result.pitch_mm, seen.shape
        )[seen]
        y = np.broadcast_to(
            ((rows_px - 1) / 2 - np.arange(rows_px))[:, None] * result.pitch_mm, seen.shape
        )[seen]
    else:
        x, y = result.x_mm[seen], result.y_mm[seen]
    # a rig file's origin is its own principal ray: only differences of places count
    dx, dy = x - truth["x_mm"][seen], y - truth["y_mm"][seen]
    misplaced = np.hypot(dx - dx.mean(), dy - dy.mean())
    return {
        "surface_rms_mm": float(figure["surface_rms_mm"]),
        "misplaced_mm": float(np.sqrt((misplaced**2).mean())),
        "scale_error": float(((height - height.mean()) * above).sum() / (above**2).sum() - 1),
        "normals_deg": float(figure["normals_mean_deg"]),
        "ridge_correlation": float(figure["ridge_correlation"]),
        "ridge_gain": float(figure["ridge_gain"]),
    }


def table(records: list[dict[str, Any]]) -> list[list[str]]:
    """Means over the rigs with 95 % intervals (bootstrap over rigs), and the surface's rms over the
    true rig's."""
    names = list(dict.fromkeys(record["row"] for record in records))
    values = {
        name: {f: np.array([r[f] for r in records if r["row"] == name]) for f in FIGURES}
        for name in names
    }
    columns = [*FIGURES, "surface_rms_over_true_rig"]
    rows = [
        [
            "known_of_the_rig",
            *(f"{column}{end}" for column in columns for end in ("", "_low", "_high")),
        ]
    ]
    base = values["true rig"]["surface_rms_mm"]
    for name in names:
        own = values[name]["surface_rms_mm"]
        ratio = interval(np.stack([own, base], axis=1), lambda v: v[:, 0].mean() / v[:, 1].mean())
        rows.append(
            [name, *(cell for f in FIGURES for cell in interval(values[name][f], np.mean)), *ratio]
        )
    return rows


def interval(values: np.ndarray, statistic: Callable[[np.ndarray], Any]) -> list[str]:
    """The statistic, and the ends of its interval over resampled rigs."""
    rng = np.random.default_rng(0)
    drawn = [
        float(statistic(values[rng.integers(0, len(values), len(values))])) for _ in range(2000)
    ]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return [f"{float(value):.3f}" for value in (statistic(values), low, high)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--out", type=Path, default=Path("validation/out/calibration"))
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--scale", type=float, default=0.5)
    parser.add_argument("--write", type=Path, default=None, help="CSV file for the table")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    records = run(options.out, options.rigs, options.scale)
    (options.out / "ablation.json").write_text(json.dumps(records, indent=1) + "\n")
    rows = table(records)
    for row in rows:
        print(", ".join(row))
    if options.write is not None:
        options.write.write_text(csv_text(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
