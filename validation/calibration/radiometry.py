"""How well a rig's light is known after ``splitknit calibrate radiometry``, on rigs as people build
them.

    python validation/calibration/radiometry.py  # 20 rigs: about six minutes of one core
    python validation/calibration/radiometry.py --rigs 2 --out FILE

Each rig is drawn from the tolerances of ``simulate.built_rig``: camera, lens, places, aims, beams
and brightness of 14 LEDs. The twin photographs a white card; the calibration knows the camera and
the LEDs' places (exactly or not) and finds the rest. Judged are all pixels of all 14 images against
the twin's own noise-free light on an even card, with one factor free for the whole rig. Figures go
to ``validation/calibration/radiometry.json``, tables to the screen; with ``--tables FOLDER`` as
CSV, too (``tables/`` holds those of the stored figures).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
HEIGHTS_MM = (0.0, 2.5, 5.0, 7.5, 10.0)
PIXEL_STEP = 4
FIRST_SEED = 100
SCALE = 0.12
"""Of the images."""


def main(arguments: Sequence[str] | None = None) -> int:
    # before numpy is imported
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--rigs", type=int, default=20, help="built rigs (default: 20)")
    parser.add_argument("--out", type=Path, default=HERE / "radiometry.json")
    parser.add_argument("--tables", type=Path, help="folder for the tables as CSV")
    options = parser.parse_args(arguments)
    seeds = range(FIRST_SEED, FIRST_SEED + options.rigs)
    results: dict[str, Any] = {
        "format": "splitknit-calibration-radiometry",
        "version": 1,
        "rigs": options.rigs,
        "first_seed": FIRST_SEED,
        "scale": SCALE,
        "plane": plane(seeds, SCALE),
        "heights": heights(seeds, SCALE),
    }
    options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="ascii")
    print(summary(results))
    if options.tables is not None:
        write_tables(results, options.tables)
    return 0


def plane(seeds: Sequence[int], scale: float) -> list[dict[str, Any]]:
    """Errors on the finger plane, and how often a calibration was refused, for every case."""
    from radiometry_cards import CASES

    from splitknit.errors import BadInput

    rows = []
    for case in CASES:
        mean, worst, residual, refused = [], [], [], []
        for seed in seeds:
            try:
                _, error, rms = measure(seed, scale, case)
            except BadInput as reason:
                refused.append(str(reason))
                continue
            mean.append(error["mean"])
            worst.append(error["worst"])
            residual.append(rms)
        rows.append(
            {
                "case": case.name,
                "mean_percent": interval(mean),
                "worst_percent": interval(worst),
                "residual_percent": interval(residual),
                "refused": refused,
            }
        )
        print(
            rows[-1]["case"],
            rows[-1]["mean_percent"],
            rows[-1]["worst_percent"],
            len(refused),
            flush=True,
        )
    return rows


def measure(seed: int, scale: float, case: Any) -> tuple[Any, dict[str, float], float]:
    """Calibrate one rig; return its flat field, its errors on the plane, and the residuals' largest
    rms."""
    from radiometry_cards import as_placed, card_of, photograph

    from splitknit_rig.calibration.card_model import CardPlane
    from splitknit_rig.calibration.radiometry import fit_radiometry
    from splitknit_simulator.rigs import built_rig

    rig = built_rig(seed, scale=scale)
    stored = as_placed(rig, case.error_mm, seed)
    tilt = tuple(rig.provenance["base_tilt_deg"]) if case.base_tilt == "known" else (0.0, 0.0)
    capture = photograph(card_of(rig, case), stored, case, seed)
    fit = fit_radiometry(capture, stored, CardPlane(0.0, (float(tilt[0]), float(tilt[1]))))
    truth = card_of(rig, case, even=True)
    return fit, errors(fit.rig, truth, 0.0), float(fit.flat_field.rms_percent.max())


def errors(rig: Any, truth: Any, height_mm: float) -> dict[str, float]:
    """Mean and largest departure in per cent of the flat field from the twin's light at a height,
    one factor free."""
    import numpy as np

    ratio = _model(rig, height_mm) / _light(truth)
    departure = np.abs(ratio / np.median(ratio) - 1)
    return {"mean": 100 * float(departure.mean()), "worst": 100 * float(departure.max())}


def heights(seeds: Sequence[int], scale: float) -> list[dict[str, Any]]:
    """Model against division by the card's images, for an even surface at heights above the
    plane."""
    import numpy as np
    from radiometry_cards import CASES, card_of

    from splitknit_simulator.rigs import built_rig

    case = next(case for case in CASES if case.name == "LEDs 0.5 mm off")
    by_height: dict[tuple[float, str], dict[str, list[float]]] = {}
    for seed in seeds:
        rig = built_rig(seed, scale=scale)
        calibrated = measure(seed, scale, case)[0].rig
        card = _light(card_of(rig, case, even=True))
        for z in HEIGHTS_MM:
            truth = _light(card_of(rig, case, z, even=True))
            towards = _directions(rig, z)
            flat = _directions(rig, 0.0)[..., 2]  # a card's image has its cosine in it
            nothing = _directions_weight(rig, z)
            ways = {
                "model": _model(calibrated, z),
                "division by the card": card * towards[..., 2] / flat,
                "no flat field": nothing * towards[..., 2],
            }
            for way, light in ways.items():
                ratio = light / truth
                common = ratio / np.median(ratio)
                own = by_height.setdefault(
                    (z, way), {"worst": [], "lights": [], "lean": [], "worst_lean": []}
                )
                own["worst"].append(100 * float(np.abs(common - 1).max()))
                spread = [ratio[b] / ratio[b].mean(axis=0) - 1 for b in (slice(0, 7), slice(7, 14))]
                own["lights"].append(100 * float(np.sqrt(np.mean(np.concatenate(spread) ** 2))))
                lean = np.concatenate(
                    [_lean(ratio[b], towards[b]) for b in (slice(0, 7), slice(7, 14))]
                )
                own["lean"].append(float(np.sqrt(np.mean(lean**2))))
                own["worst_lean"].append(float(lean.max()))
    return [
        {
            "height_mm": z,
            "way": way,
            "worst_percent": interval(own["worst"]),
            "lights_percent": interval(own["lights"]),
            "lean_deg": interval(own["lean"]),
            "worst_lean_deg": interval(own["worst_lean"]),
        }
        for (z, way), own in by_height.items()
    ]


def _pixels(rig: Any) -> Any:
    import numpy as np

    rows, columns = np.mgrid[
        0 : rig.camera.image_size[0] : PIXEL_STEP, 0 : rig.camera.image_size[1] : PIXEL_STEP
    ]
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)


def _light(card: Any) -> Any:
    """(14, N) the twin's light."""
    import numpy as np

    return np.stack(
        [card.light((k,))[::PIXEL_STEP, ::PIXEL_STEP, 0].ravel() for k in range(len(card.leds))]
    ).astype(np.float64)


def _model(rig: Any, height_mm: float) -> Any:
    import numpy as np

    from splitknit_rig.calibration.card_model import CardPlane, card_light

    return np.stack(
        [card_light(rig.camera, led, _pixels(rig), CardPlane(height_mm)) for led in rig.leds]
    )


def _directions(rig: Any, height_mm: float) -> Any:
    """(14, N, 3) true directions to the LEDs from what the pixels see at a height."""
    import numpy as np

    from splitknit_rig.calibration.card_model import CardPlane, rays_to_led

    points = CardPlane(height_mm).points(rig.camera, _pixels(rig))
    return np.stack([rays_to_led(led, points)[0] for led in rig.leds])


def _directions_weight(rig: Any, height_mm: float) -> Any:
    """(14, N) inverse squares of the true distances: LEDs all equal, without beams, and no lens."""
    import numpy as np

    from splitknit_rig.calibration.card_model import CardPlane, rays_to_led

    points = CardPlane(height_mm).points(rig.camera, _pixels(rig))
    return np.stack([1e4 / np.pi / rays_to_led(led, points)[1] ** 2 for led in rig.leds])


def _lean(ratio: Any, towards: Any) -> Any:
    """(N,) angle in deg by which a facing surface leans when images are divided by light that is
    `ratio` too bright."""
    import numpy as np

    lights = towards.transpose(1, 0, 2)  # (N, 7, 3)
    rendered = lights[..., 2] / ratio.T
    moments = np.einsum("nlc,nld->ncd", lights, lights)
    normals = np.linalg.solve(moments, np.einsum("nlc,nl->nc", lights, rendered)[..., None])[..., 0]
    return np.rad2deg(np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), normals[:, 2]))


def interval(values: Sequence[float]) -> dict[str, float | int] | None:
    """Mean with its 95 % interval (Student's), and the largest value, over rigs."""
    import numpy as np
    from scipy.stats import t

    if len(values) == 0:
        return None
    array = np.asarray(values, dtype=np.float64)
    half = (
        float(t.ppf(0.975, len(array) - 1) * array.std(ddof=1) / np.sqrt(len(array)))
        if len(array) > 1
        else 0.0
    )
    return {
        "mean": round(float(array.mean()), 4),
        "half": round(half, 4),
        "largest": round(float(array.max()), 4),
        "count": len(array),
    }


def summary(results: dict[str, Any]) -> str:
    """The figures as Markdown tables."""
    lines = [
        "| case | mean error | largest error | largest of all rigs | refused |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in results["plane"]:
        mean, worst = row["mean_percent"], row["worst_percent"]
        cells = (
            ("-", "-", "-")
            if mean is None
            else (_words(mean), _words(worst), f"{worst['largest']:.2f} %")
        )
        lines.append(f"| {row['case']} | {' | '.join(cells)} | {len(row['refused'])} |")
    lines += [
        "",
        "| height mm | way | largest error | between LEDs, rms | lean, rms | lean, largest |",
        "| --- " * 6 + "|",
    ]
    for row in results["heights"]:
        worst, lights, lean, far = (
            row[k] for k in ("worst_percent", "lights_percent", "lean_deg", "worst_lean_deg")
        )
        lines.append(
            f"| {row['height_mm']:g} | {row['way']} | {_words(worst, 1)} | {_words(lights)} |"
            f" {lean['mean']:.2f} deg | {far['mean']:.2f} deg |"
        )
    return "\n".join(lines)


def write_tables(results: dict[str, Any], folder: Path) -> None:
    """``radiometry.csv`` (the finger plane) and ``radiometry_heights.csv``; intervals as half their
    width."""
    errors_of = ["mean_error_percent", "mean_error_half_interval", "largest_error_percent"]
    plane_rows = [
        [
            "case",
            *errors_of,
            "largest_error_half_interval",
            "largest_of_all_rigs_percent",
            "refused",
        ]
    ]
    for row in results["plane"]:
        mean, worst = row["mean_percent"], row["worst_percent"]
        cells = (
            [""] * 5 if mean is None else [*_half(mean), *_half(worst), f"{worst['largest']:.2f}"]
        )
        plane_rows.append([row["case"], *cells, str(len(row["refused"]))])
    errors_of = ["largest_error_percent", "largest_error_half_interval", "between_leds_rms_percent"]
    height_rows = [
        [
            "height_mm",
            "way",
            *errors_of,
            "between_leds_half_interval",
            "lean_rms_deg",
            "lean_largest_deg",
        ]
    ]
    for row in results["heights"]:
        lean = [f"{row[name]['mean']:.2f}" for name in ("lean_deg", "worst_lean_deg")]
        figures = [*_half(row["worst_percent"], 1), *_half(row["lights_percent"]), *lean]
        height_rows.append([f"{row['height_mm']:g}", row["way"], *figures])
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in (("radiometry", plane_rows), ("radiometry_heights", height_rows)):
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


def _half(value: dict[str, Any], digits: int = 2) -> list[str]:
    return [f"{value['mean']:.{digits}f}", f"{value['half']:.{digits}f}"]


def _words(value: dict[str, Any], digits: int = 2) -> str:
    return f"{value['mean']:.{digits}f} ± {value['half']:.{digits}f} %"


if __name__ == "__main__":
    raise SystemExit(main())
