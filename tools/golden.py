"""Results of every preset, matcher, print and calibration, as hashes: a change of the code's
structure keeps them.

    python tools/golden.py            compares with tools/golden.json (exit code 1: they differ)
    python tools/golden.py --write    after a change that is meant to change results: writes it anew

Everything goes through the command line, whose verbs stay while modules move. Arrays, pixels and
scores are hashed, not files, since these carry settings and versions. Sums of floating-point
numbers differ in the last bits from one processor to another, even between two with the same
instructions. Where the bytes differ, mean and spread are therefore compared: within a millionth of
the spread on the processor and libraries of the file, within a thousandth on others. How many
arrays have the same bytes is printed.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import platform
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np

GOLDEN = Path(__file__).with_name("golden.json")
SAME, TOLERANCE = 1e-6, 1e-3
"""Of mean and spread on the same kind of processor and on another, relative to the spread."""
SENSITIVE, WIDER = ("match ", "template"), 2e-2
"""Cases that count what lies beside a threshold, and their tolerance on another processor: the same
code gave a similarity of 0.780 on one kind and 0.787 on another, and one minutia more in the
template."""
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
    """Hash and summary of an array."""
    values = np.asarray(array)
    digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:32]
    finite = values[np.isfinite(values)] if values.dtype.kind in "fiub" else np.zeros(0)
    numbers = finite.astype(np.float64) if finite.size else np.zeros(1)
    return {
        "shape": list(values.shape),
        "type": str(values.dtype),
        "sha256": digest,
        "mean": float(numbers.mean()),
        "spread": float(numbers.std()),
    }


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
    cases["template"] = {"bytes": entry(np.frombuffer((folder / "a.skt").read_bytes(), np.uint8))}
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


def machine() -> dict[str, str]:
    """What the last bits depend on."""
    keys = ("flags", "Features", "vendor_id", "cpu family", "model", "stepping", "cache size")
    lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
    features = "".join(line for line in lines if line.startswith(keys))
    names = ("numpy", "scipy", "opencv-python-headless", "onnxruntime")
    return {
        "processor": platform.machine() + hashlib.sha256(features.encode()).hexdigest()[:12],
        **{name: metadata.version(name) for name in names},
    }


def differences(wanted: dict[str, Any], measured: dict[str, Any]) -> list[str]:
    """What is not as it was, a line each."""
    exact = wanted["machine"] == measured["machine"]
    lines = [
        f"{name} is new or gone"
        for name in sorted(wanted["cases"].keys() ^ measured["cases"].keys())
    ]
    for case in sorted(wanted["cases"].keys() & measured["cases"].keys()):
        before, now = wanted["cases"][case], measured["cases"][case]
        lines += [f"{case}, {name}: new or gone" for name in sorted(before.keys() ^ now.keys())]
        for name in sorted(before.keys() & now.keys()):
            stored, new = before[name], now[name]
            part = SAME if exact else WIDER if case.startswith(SENSITIVE) else TOLERANCE
            slack = part * max(stored["spread"], abs(stored["mean"]), 1e-9)
            same = stored["sha256"] == new["sha256"] or all(
                abs(stored[key] - new[key]) <= slack for key in ("mean", "spread")
            )
            sizes = exact or not case.startswith(SENSITIVE)
            if (
                not same
                or stored["type"] != new["type"]
                or (sizes and stored["shape"] != new["shape"])
            ):
                lines.append(f"{case}, {name}: mean {stored['mean']:.9g} -> {new['mean']:.9g}")
    return lines


def main() -> int:
    """Compare or write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = {"machine": machine(), "cases": measure(Path(folder))}
    if options.write:
        GOLDEN.write_text(json.dumps(measured, indent=1) + "\n", encoding="ascii")
        return 0
    wanted = json.loads(GOLDEN.read_text(encoding="ascii"))
    lines = differences(wanted, measured)
    others = [
        f"{name} {wanted['machine'].get(name)} -> {now}"
        for name, now in measured["machine"].items()
        if wanted["machine"].get(name) != now
    ]
    same = [
        stored["sha256"] == now.get(name, {}).get("sha256")
        for case, now in measured["cases"].items()
        for name, stored in wanted["cases"].get(case, {}).items()
    ]
    where = (
        f"not the machine of golden.json ({', '.join(others)}): tolerance {TOLERANCE:g}; "
        if others
        else ""
    )
    sys.stdout.write(f"{where}{sum(same)} of {len(same)} arrays have the same bytes\n")
    sys.stdout.write(
        "\n".join([*lines, f"{len(measured['cases'])} cases, {len(lines)} differences"]) + "\n"
    )
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
