"""How much of the shape from mirrors may come from white light: `metric` and `snk` with mirrors, by detail_mm.

    python validation/mirror/detail.py --seeds 1 2 3 4 5 6 7 8 --folder /tmp/detail

simulates fingers between two mirrors (scale 0.4, captures are kept), and writes ``tables/detail.csv``:
rms of the surface (mm) and mean error of its normals (deg).
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitknit
from splitknit.methods import METHODS, method_for
from splitknit.methods.photographs import finger_photographs, mirror_views, on_mirror_shape, placed
from splitknit.presets import preset_settings
from splitknit_simulator.twin import simulate_to_folder

DETAIL_MM = 5.0, 2.0, 1.5, 1.0
TABLE = Path(__file__).resolve().parent / "tables/detail.csv"


def measured(folder: Path, seed: int) -> list[list[object]]:
    """Rows: finger, preset, detail_mm, rms, normals."""
    out = folder / f"{seed}"
    if not out.exists():
        simulate_to_folder(
            out, seed=seed, scale=0.4, changes={"mirrors.names": ("left", "right"), "mirrors.nir": False}
        )
    with np.load(out / "truth.npz") as arrays:
        truth = dict(arrays)
    rows: list[list[object]] = []
    for preset in ("snk", "metric"):
        chosen = preset_settings(preset)
        chosen = replace(chosen, shape=replace(chosen.shape, source="mirror"))
        photographs = finger_photographs(splitknit.read_capture(out), chosen)
        seen, finger = mirror_views(photographs.capture, chosen), photographs.finger
        surface = METHODS[method_for(photographs, chosen)](photographs, chosen)
        for detail in DETAIL_MM if preset == "metric" else (DETAIL_MM[0],):  # `snk` takes none
            photographs.finger = finger
            mirror = replace(chosen.shape.mirror, detail_mm=detail)
            each = replace(chosen, shape=replace(chosen.shape, mirror=mirror))
            result = placed(photographs, on_mirror_shape(photographs, surface, seen, each), chosen.top_mm)
            found = splitknit.compare(result, truth).figures
            figures = f"{found['surface_rms_mm']:.3f}", f"{found['normals_mean_deg']:.2f}"
            rows.append([seed, preset, detail if preset == "metric" else "", *figures])
            print(*rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1, 9)))
    parser.add_argument("--folder", type=Path, default=Path("/tmp/detail"))
    given = parser.parse_args()
    rows = [row for seed in given.seeds for row in measured(given.folder, seed)]
    with TABLE.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["finger", "preset", "detail_mm", "surface_rms_mm", "normals_mean_deg"])
        writer.writerows(rows)
