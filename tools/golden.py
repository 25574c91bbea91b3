"""Results of every preset, matcher, print and calibration: a change of the code's structure keeps
them within a thousandth of their spread.

    python tools/golden.py            compares with tools/golden.json (exit code 1: they differ)
    python tools/golden.py --write    after a change that is meant to change results: writes it anew

Everything goes through the command line, whose verbs stay while modules move. Of every array are
stored its shape, type, mean, spread (standard deviation) and the means of a coarse grid of blocks,
which show a change in one place.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import json
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np

GOLDEN = Path(__file__).with_name("golden.json")
TOLERANCE = 1e-3
"""Difference of a mean, a spread or a block's mean over the spread."""
SENSITIVE = {"match minutiae": 0.1, "match ": 2e-2}
"""Scores count what lies beside a threshold: between two processors the same code gave similarities
of 0.780 and 0.787, and of minutiae, of which one more or less agrees, 4.85 and 5.13."""
BLOCKS = 8
"""Blocks along each of an image's sides."""
Entry = dict[str, Any]
QUICK = ["--set", "metric.rounds=1"]
PRESETS = ("metric", "snk", "pr", "ea", "kumar", "zheng")
METHODS = ("ridge", "thesis", "minutiae")


def run(*words: object) -> str:
    """Run a verb in this process; return what it printed."""
    (script,) = metadata.entry_points(group="console_scripts", name="splitknit")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = script.load()([str(word) for word in words])
    if code != 0:
        raise RuntimeError(
            f"splitknit {' '.join(map(str, words))}: exit code {code}: {printed.getvalue()}"
        )
    return printed.getvalue()


def entry(array: Any) -> Entry:
    """Summary of an array."""
    values = np.asarray(array)
    numbers = values.astype(np.float64)
    finite = numbers[np.isfinite(numbers)]
    return {
        "shape": list(values.shape),
        "type": str(values.dtype),
        "mean": float(finite.mean()) if finite.size else 0.0,
        "spread": float(finite.std()) if finite.size else 0.0,
        "blocks": _block_means(numbers),
    }


def _block_means(numbers: Any) -> list[float | None]:
    """Mean of the finite values of each block of an image's rows and columns; None without any."""
    if numbers.ndim < 2:
        return []
    rows, columns = (np.linspace(0, side, BLOCKS + 1).astype(int) for side in numbers.shape[:2])
    means: list[float | None] = []
    for top, bottom in itertools.pairwise(rows):
        for left, right in itertools.pairwise(columns):
            block = numbers[top:bottom, left:right]
            block = block[np.isfinite(block)]
            means.append(float(f"{block.mean():.7g}") if block.size else None)
    return means


def result_of(folder: Path) -> dict[str, Entry]:
    """Arrays of ``height.npz``, and the print's pixels where there is one."""
    with np.load(folder / "height.npz") as arrays:
        entries = {
            name: entry(arrays[name])
            for name in sorted(arrays.files)
            if arrays[name].dtype.kind != "U"
        }
    return (
        {**entries, "print": entry(pixels(folder / "print.png"))}
        if (folder / "print.png").is_file()
        else entries
    )


def pixels(file: Path) -> Any:
    """An image as stored."""
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED)


def edited(
    capture: Path,
    target: Path,
    change: Callable[[dict[str, Any]], None],
    file: str = "capture.json",
) -> Path:
    """A copy of a capture with one JSON document changed."""
    target.mkdir()
    for source in capture.iterdir():
        (target / source.name).write_bytes(source.read_bytes())
    document = json.loads((target / file).read_text())
    change(document)
    (target / file).write_text(json.dumps(document))
    return target


def as_grey(document: dict[str, Any]) -> None:
    """White light only."""
    document["bands"] = {"white": document["bands"]["white"]}


def with_lens(document: dict[str, Any]) -> None:
    """The same pictures, said to come from a camera with a lens."""
    camera = document["camera"]
    rows, columns = camera["image_size"]
    focal = camera["px_per_mm"] * camera["height_mm"]
    matrix = [[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]]
    camera |= {"model": "perspective", "matrix": matrix, "distortion": [0.0] * 5}


def measure(folder: Path) -> dict[str, dict[str, Entry]]:
    """Everything, by name."""
    cases: dict[str, dict[str, Entry]] = {}

    def reconstructed(name: str, capture: Path, *options: str) -> Path:
        out = folder / f"result_{name}"
        run("reconstruct", capture, "--out", out, *options)
        cases[name] = result_of(out)
        return out

    capture, again = folder / "capture", folder / "again"
    run("simulate", "--seed", 3, "--scale", 0.15, "--out", capture)
    run("simulate", "--seed", 3, "--scale", 0.15, "--impression", 1, "--out", again)
    cases["simulated"] = {file.stem: entry(pixels(file)) for file in sorted(capture.glob("*.png"))}
    for preset in PRESETS:
        reconstructed(preset, capture, "--preset", preset)
    reconstructed(
        "opaque",
        edited(capture, folder / "opaque", lambda document: document.update(material="opaque")),
        *QUICK,
    )
    reconstructed(
        "perspective", edited(capture, folder / "perspective", with_lens, "rig.json"), *QUICK
    )
    grey = edited(capture, folder / "grey", as_grey)
    for file in grey.glob("*white*.png"):
        image = pixels(file)
        cv2.imwrite(
            str(file), cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        )
    reconstructed("grey", grey, *QUICK)
    run("simulate", "--seed", 4, "--scale", 0.08, "--out", folder / "coarse")
    reconstructed("coarse", folder / "coarse")
    run(
        "simulate",
        "--seed",
        4,
        "--scale",
        0.12,
        "--lights",
        "coloured",
        "--out",
        folder / "coloured",
    )
    reconstructed("lin", folder / "coloured", "--preset", "lin")
    mirrors = folder / "mirrors"
    run("simulate", "--seed", 9002, "--scale", 0.15, "--mirrors", "left,right", "--out", mirrors)
    reconstructed("mirror", mirrors, "--shape", "mirror", *QUICK)
    for method in METHODS:
        facts = json.loads(run("match", capture, again, "--method", method, "--json"))
        cases[f"match {method}"] = {"similarity": entry(np.float64(facts["similarity"]))}
    run("match", folder / "result_metric", "--template", folder / "a.skt")
    facts = json.loads(run("match", folder / "a.skt", folder / "result_snk", "--json"))
    cases["match template"] = {"similarity": entry(np.float64(facts["similarity"]))}
    for method in ("unroll", "relief", "curvature"):
        run(
            "print",
            folder / "result_metric",
            "--method",
            method,
            "--out",
            folder / f"print_{method}",
        )
        cases[f"print {method}"] = prints_of(folder / f"print_{method}")
    run("print", mirrors, "--method", "rolled", "--out", folder / "rolled")
    cases["print rolled"] = prints_of(folder / "rolled")
    run("simulate", "--bench", "--scale", 0.1, "--seed", 2, "--out", folder / "bench")
    run("calibrate", "camera", folder / "bench" / "board", "--out", folder / "rig.json")
    camera = json.loads((folder / "rig.json").read_text())["camera"]
    numbers = {key: value for key, value in camera.items() if isinstance(value, (int, float, list))}
    cases["calibrated camera"] = {
        key: entry(np.asarray(numbers[key], dtype=float)) for key in sorted(numbers)
    }
    return cases


def prints_of(folder: Path) -> dict[str, Entry]:
    """Pixels of all pictures in a folder."""
    return {file.stem: entry(pixels(file)) for file in sorted(folder.glob("*.png"))}


def differences(wanted: dict[str, Any], measured: dict[str, Any]) -> list[str]:
    """What is not as it was, a line each."""
    lines = [f"{name} is new or gone" for name in sorted(wanted.keys() ^ measured.keys())]
    for case in sorted(wanted.keys() & measured.keys()):
        before, now = wanted[case], measured[case]
        lines += [f"{case}, {name}: new or gone" for name in sorted(before.keys() ^ now.keys())]
        wider = (part for name, part in SENSITIVE.items() if case.startswith(name))
        part = next(wider, TOLERANCE)
        for name in sorted(before.keys() & now.keys()):
            if not _near(before[name], now[name], part):
                means = f"mean {before[name]['mean']:.9g} -> {now[name]['mean']:.9g}"
                lines.append(f"{case}, {name}: {means}")
    return lines


def _near(stored: Entry, new: Entry, part: float) -> bool:
    """Whether two summaries agree within `part` of the spread; a number alone, of itself."""
    if any(stored[key] != new[key] for key in ("shape", "type")):
        return False
    slack = part * (stored["spread"] or abs(stored["mean"]) or 1e-9)
    if any(abs(stored[key] - new[key]) > slack for key in ("mean", "spread")):
        return False
    pairs = zip(stored["blocks"], new["blocks"], strict=True)
    return all(
        before == now if before is None or now is None else abs(before - now) <= slack
        for before, now in pairs
    )


def main() -> int:
    """Compare or write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(Path(folder))
    if options.write:
        GOLDEN.write_text(json.dumps(measured) + "\n", encoding="ascii")
        return 0
    lines = differences(json.loads(GOLDEN.read_text(encoding="ascii")), measured)
    sys.stdout.write("\n".join([*lines, f"{len(measured)} cases, {len(lines)} differences"]) + "\n")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
