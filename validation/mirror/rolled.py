"""The rolled-equivalent finger on the twin: coverage, ridges by slant, seams, and what roll between sessions costs.

    python validation/mirror/rolled.py --fingers 8 --folder /tmp/rolled-captures

simulates fingers between two mirrors at rolls of 0, +-10 and +-20 deg (each capture with a pose, dust and noise of its
own), rolls them, compares them with the truth and with each other, and writes ``validation/mirror/rolled.json``.
A run that is stopped goes on where it was; captures are deleted once they are measured. The settings were tuned on the
fingers 11, 101 and 102 only.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rolled_measure import measure

from splitknit.errors import BadInput
from splitknit_match.matching.minutiae import extract, minutiae_match
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import Template, make_template

HERE = Path(__file__).resolve().parent
ROLLS_DEG = (0, 20, -20, 10, -10)
SCALE = 0.6
"""Of the camera of 44 px/mm: 26.4 px/mm."""
PRINT_PITCH_MM = 25.4 / 500.0


def simulated(folder: Path, seed: int, number: int, scale: float = SCALE, model: str = "orthographic") -> Path:
    """The capture of a finger at one of the rolls, from the folder or made now."""
    out = folder / f"{seed}_{number}"
    if not (out / "capture.json").is_file():
        roll = ROLLS_DEG[number]
        arguments = [
            "simulate",
            "--out",
            str(out),
            "--seed",
            str(seed),
            "--scale",
            str(scale),
            "--mirrors",
            "left,right",
        ]
        arguments += ["--no-nir", "--impression", str(number), "--set", f"pose.roll_deg=[{roll},{roll}]"]
        arguments += ["--set", f"mirrors.model={model}"]
        program = [sys.executable, "-m", "splitknit.cli.main"]
        if subprocess.run([*program, *arguments, "--json"], check=False).returncode != 0:
            raise SystemExit(f"{out} could not be simulated.")
    return out


def kept(  # noqa: PLR0917
    folder: Path, seed: int, number: int, keep: bool, scale: float = SCALE, model: str = "orthographic"
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Row and prints of one capture, from the folder or made now."""
    file = folder / f"{seed}_{number}.npz"
    if not file.is_file():
        capture = simulated(folder, seed, number, scale, model)
        arrays = {}
        row: dict[str, Any] = {"seed": seed, "roll_deg": ROLLS_DEG[number]}
        try:
            made = measure(capture)
        except BadInput as refusal:
            row["refused"] = str(refusal)
        else:
            row |= made.row
            for name, (image, values, known) in made.prints.items():
                arrays |= {f"{name}_image": image, f"{name}_values": values, f"{name}_known": known}
        with file.open("wb") as stream:
            np.savez_compressed(stream, row=np.array(json.dumps(row)), **arrays)
        if not keep:
            shutil.rmtree(capture)
        print(seed, ROLLS_DEG[number], row.get("refused") or row["rolled"], flush=True)
    with np.load(file) as arrays:
        return json.loads(str(arrays["row"])), {name: arrays[name] for name in arrays.files if name != "row"}


def ridges_of(prints: dict[str, Any], kind: str) -> Template:
    """Template of a print's relief, for the ridge matcher."""
    return make_template(ridge_band(prints[f"{kind}_values"], prints[f"{kind}_known"], PRINT_PITCH_MM))


def compared(sides: dict[tuple[int, int], dict[str, Any]]) -> list[dict[str, Any]]:
    """Scores of all pairs of different sessions, front alone and rolled, by ridges and by minutiae."""
    ridges = {kind: {key: ridges_of(prints, kind) for key, prints in sides.items()} for kind in ("front", "rolled")}
    points = {
        kind: {key: extract(prints[f"{kind}_image"]) for key, prints in sides.items()} for kind in ("front", "rolled")
    }
    rows = []
    for first, second in itertools.combinations(sorted(sides), 2):
        if first[1] == second[1]:
            continue
        row: dict[str, Any] = {
            "genuine": first[0] == second[0],
            "fingers": [first[0], second[0]],
            "apart_deg": abs(ROLLS_DEG[first[1]] - ROLLS_DEG[second[1]]),
        }
        for kind in ("front", "rolled"):
            row[f"{kind}_ridge"] = round(float(ridge_match(ridges[kind][first], ridges[kind][second]).similarity), 4)
            row[f"{kind}_minutiae"] = float(minutiae_match(points[kind][first], points[kind][second]))
        rows.append(row)
    return rows


def interval(values: np.ndarray, fingers: np.ndarray, seed: int = 0) -> list[float]:
    """Mean, and the middle 95 % of the means of fingers drawn with replacement."""
    rng = np.random.default_rng(seed)
    names = np.unique(fingers)
    groups = [values[fingers == name] for name in names]
    means = [
        float(np.concatenate([groups[k] for k in rng.integers(0, len(names), len(names))]).mean()) for _ in range(2000)
    ]
    return [round(float(v), 4) for v in (values.mean(), *np.percentile(means, [2.5, 97.5]))]


def roll_table(pairs: list[dict[str, Any]]) -> dict[str, Any]:
    """Genuine scores by roll apart, impostor scores, and how far they lie from each other."""
    table: dict[str, Any] = {}
    for column in ("front_ridge", "rolled_ridge", "front_minutiae", "rolled_minutiae"):
        impostors = np.array([p[column] for p in pairs if not p["genuine"]])
        part: dict[str, Any] = {
            "impostor": {
                "pairs": int(impostors.size),
                "mean": round(float(impostors.mean()), 4) if impostors.size else None,
                "max": round(float(impostors.max()), 4) if impostors.size else None,
            }
        }
        for apart in sorted({p["apart_deg"] for p in pairs if p["genuine"]}):
            some = [p for p in pairs if p["genuine"] and p["apart_deg"] == apart]
            values, fingers = np.array([p[column] for p in some]), np.array([p["fingers"][0] for p in some])
            above = float((values > impostors.max()).mean()) if impostors.size else None
            part[f"genuine {apart} deg"] = {
                "pairs": len(some),
                "mean [95 %]": interval(values, fingers),
                "min": round(float(values.min()), 4),
                "above every impostor": above if above is None else round(above, 3),
            }
        table[column] = part
    return table


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians and ranges over the captures."""

    def spread(values: list[float | None]) -> list[float] | None:
        known = [value for value in values if value is not None]
        if not known:
            return None
        return [round(float(v), 3) for v in (np.median(known), min(known), max(known))]

    steps = [seam for row in rows for seam in row["seams"].values() if seam]

    def pooled(word: str) -> float:
        """Root mean square over all seams, each weighing by its length."""
        squares = [seam[word] ** 2 * seam["length_mm"] for seam in steps]
        return round(float(np.sqrt(sum(squares) / max(sum(seam["length_mm"] for seam in steps), 1e-9))), 2)

    result: dict[str, Any] = {
        "captures": len(rows),
        "fingers": len({row["seed"] for row in rows}),
        "coverage_deg": spread([row["coverage_deg"] for row in rows]),
        "coverage_front_deg": spread([row["coverage_front_deg"] for row in rows]),
        "seams": len(steps),
        "seams_above_10_um": sum(seam["faded_um"] > 10.0 for seam in steps),
        "seam_step_pooled_um": pooled("faded_um"),
        "same_step_beside_the_seams_pooled_um": pooled("no_seam_um"),
        "ridges_apart_um": spread([value for row in rows for value in row["ridges_apart_um"].values()]),
        "views_cut": sum(len(row["cut"]) for row in rows),
        "seam_step_um": spread([seam["faded_um"] for seam in steps]),
        "same_step_beside_the_seams_um": spread([seam["no_seam_um"] for seam in steps]),
        "seam_step_hard_cut_um": spread([seam["cut_um"] for seam in steps]),
    }
    for name in ("rolled", "front"):
        result[name] = {band: spread([row[name][band] for row in rows]) for band in rows[0][name]}
    result["surface_rms_mm"] = spread([row["surface_rms_mm"] for row in rows])
    return result


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=8)
    parser.add_argument("--seed", type=int, default=103)
    parser.add_argument("--rolls", type=int, default=len(ROLLS_DEG), help="how many of 0, 20, -20, 10, -10 deg")
    parser.add_argument("--scale", type=float, default=SCALE, help="of the camera of 44 px/mm; each in its own folder")
    parser.add_argument("--model", default="orthographic", help="or perspective; each in its own folder")
    parser.add_argument("--folder", type=Path, default=Path("/tmp/rolled-captures"))
    parser.add_argument("--keep", action="store_true", help="keep the captures")
    parser.add_argument("--done", action="store_true", help="only what is there already")
    parser.add_argument("--out", type=Path, default=HERE / "rolled.json")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows, refused, sides = [], [], {}
    for number in range(options.rolls):
        for seed in range(options.seed, options.seed + options.fingers):
            if options.done and not (options.folder / f"{seed}_{number}.npz").is_file():
                continue
            row, prints = kept(options.folder, seed, number, options.keep, options.scale, options.model)
            if "refused" in row:
                refused.append(row)
                continue
            rows.append(row)
            sides[seed, number] = prints
    pairs = compared(sides)
    facts = {
        "scale": options.scale,
        "camera": options.model,
        "mirrors": ["left", "right"],
        "values": "median, least, largest over the captures; correlation of the ridge band by slant (deg)",
        "summary": summary(rows),
        "refused": refused,
        "roll": roll_table(pairs) if any(pair["genuine"] for pair in pairs) else None,
        "captures": rows,
    }
    options.out.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(facts["summary"], indent=1))


if __name__ == "__main__":
    main()
