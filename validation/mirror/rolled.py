"""The rolled-equivalent finger on the twin: coverage, surface, ridges by slant.

    python validation/mirror/rolled.py --fingers 8 --folder /tmp/rolled-captures

simulates fingers between two mirrors at rolls of 0, +-10 and +-20 deg (each capture with a pose,
dust and noise of its own), rolls them, compares them with the truth, and writes
``validation/mirror/rolled.json``. A run that is stopped goes on where it was; captures are deleted
once they are measured. The settings were tuned on the fingers 11, 101 and 102 only.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rolled_measure import measure

from splitknit.errors import BadInput

HERE = Path(__file__).resolve().parent
ROLLS_DEG = (0, 20, -20, 10, -10)
SCALE = 0.6
"""Of the camera of 44 px/mm: 26.4 px/mm."""


def simulated(folder: Path, seed: int, number: int, scale: float, model: str) -> Path:
    """The capture of a finger at one of the rolls, from the folder or made now."""
    out = folder / f"{seed}_{number}"
    if not (out / "capture.json").is_file():
        roll = ROLLS_DEG[number]
        arguments = ["simulate", "--out", out, "--seed", seed, "--scale", scale]
        arguments += ["--mirrors", "left,right", "--no-nir", "--impression", number]
        arguments += ["--set", f"pose.roll_deg=[{roll},{roll}]", "--set", f"mirrors.model={model}"]
        program = [sys.executable, "-m", "splitknit.cli.main"]
        if subprocess.run([*program, *map(str, arguments), "--json"], check=False).returncode:
            raise SystemExit(f"{out} could not be simulated.")
    return out


def kept(  # noqa: PLR0917
    folder: Path, seed: int, number: int, keep: bool, scale: float, model: str
) -> dict[str, Any]:
    """Row of one capture, from the folder or made now."""
    file = folder / f"{seed}_{number}.json"
    if not file.is_file():
        capture = simulated(folder, seed, number, scale, model)
        row: dict[str, Any] = {"seed": seed, "roll_deg": ROLLS_DEG[number]}
        try:
            row |= measure(capture)
        except BadInput as refusal:
            row["refused"] = str(refusal)
        file.write_text(json.dumps(row))
        if not keep:
            shutil.rmtree(capture)
        print(seed, ROLLS_DEG[number], row.get("refused") or row["rolled"], flush=True)
    return dict(json.loads(file.read_text()))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians and ranges over the captures."""

    def spread(values: list[float | None]) -> list[float] | None:
        known = [value for value in values if value is not None]
        if not known:
            return None
        return [round(float(v), 3) for v in (np.median(known), min(known), max(known))]

    result: dict[str, Any] = {
        "captures": len(rows),
        "fingers": len({row["seed"] for row in rows}),
        "coverage_deg": spread([row["coverage_deg"] for row in rows]),
        "coverage_front_deg": spread([row["coverage_front_deg"] for row in rows]),
        "ridges_apart_um": spread(
            [value for row in rows for value in row["ridges_apart_um"].values()]
        ),
        "views_cut": sum(len(row["cut"]) for row in rows),
    }
    for name in ("rolled", "front"):
        result[name] = {band: spread([row[name][band] for row in rows]) for band in rows[0][name]}
    result["surface_rms_mm"] = spread([row["surface_rms_mm"] for row in rows])
    return result


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fingers", type=int, default=8)
    parser.add_argument("--seed", type=int, default=103)
    parser.add_argument(
        "--rolls", type=int, default=len(ROLLS_DEG), help="how many of 0, 20, -20, 10, -10 deg"
    )
    parser.add_argument(
        "--scale",
        type=float,
        default=SCALE,
        help="of the camera of 44 px/mm; each in its own folder",
    )
    parser.add_argument(
        "--model", default="orthographic", help="or perspective; each in its own folder"
    )
    parser.add_argument("--folder", type=Path, default=Path("/tmp/rolled-captures"))
    parser.add_argument("--keep", action="store_true", help="keep the captures")
    parser.add_argument("--out", type=Path, default=HERE / "rolled.json")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    fingers = range(options.seed, options.seed + options.fingers)
    all_rows = [
        kept(options.folder, seed, number, options.keep, options.scale, options.model)
        for number in range(options.rolls)
        for seed in fingers
    ]
    rows = [row for row in all_rows if "refused" not in row]
    refused = [row for row in all_rows if "refused" in row]
    facts = {
        "scale": options.scale,
        "camera": options.model,
        "mirrors": ["left", "right"],
        "values": (
            "median, least, largest over the captures; correlation of the ridge band by slant (deg)"
        ),
        "summary": summary(rows),
        "refused": refused,
        "captures": rows,
    }
    options.out.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts["summary"], indent=1))


if __name__ == "__main__":
    main()
