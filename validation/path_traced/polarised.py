"""Heights with and without polarising films, on fingers whose light the fast twin did not make.

    python validation/path_traced/polarised.py FOLDER...
    python validation/path_traced/polarised.py --twins FIRST LAST [SCALE]

FOLDER: a capture with ``NAME_truth.npz`` beside it, or a folder of them. ``--twins``: fingers of
the fast simulator with these seeds, behind films, with seven lights to the side.

For each capture that has a parallel and a crossed series: `metric` on it, and on the mean of both
series, which is the photograph without films. It prints a table, and JSON with ``--json``. Captures
are made by ``make.py --polarised``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitknit
from splitknit.capture import Capture
from splitknit.errors import BadInput, require
from splitknit.io.npz import read_npz
from splitknit_simulator import simulate_capture

sys.path.insert(0, str(Path(__file__).parent))

from score import score

CLASSES = ("", "_0_15", "_15_30", "_30_45", "_45_60")


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in words
    try:
        if words[:1] == ["--twins"]:
            seeds = words[1:3]
            require(
                len(seeds) == 2 and all(seed.isdigit() for seed in seeds),
                "give two seeds: --twins FIRST LAST.",
            )
            twins(
                range(int(seeds[0]), int(seeds[1]) + 1), float(words[3] if len(words) > 3 else 0.2)
            )
            return 0
        folders = [folder for word in words if word != "--json" for folder in _captures(Path(word))]
        require(bool(folders), "give folders of polarised captures with their truth beside them.")
        figures = {folder.name: both_ways(folder) for folder in folders}
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(figures, indent=1) if as_json else table(figures))
    return 0


def _captures(folder: Path) -> Iterator[Path]:
    """The capture `folder`, or those in it."""
    for candidate in (folder, *sorted(folder.iterdir())) if folder.is_dir() else ():
        if (candidate / "capture.json").is_file() and _truth(candidate).is_file():
            yield candidate


def _truth(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}_truth.npz")


def both_ways(folder: Path) -> dict[str, dict[str, float]]:
    """Figures of :func:`score.score` from both series, and from their mean."""
    capture = splitknit.read_capture(folder)
    truth = read_npz(_truth(folder))
    truth.setdefault("px_mm", np.float64(capture.rig.camera.pitch_mm))
    ways = {"films": capture, "no films": without_films(capture)}
    return {way: _figures(series, truth) for way, series in ways.items()}


def twins(seeds: Sequence[int], scale: float) -> None:
    """Print surface (mm), and correlation, gain, rms (um) and error over stated by slant, with
    lights to the side."""
    rows = []
    for seed in seeds:
        capture, truth = simulate_capture(seed, settings={"scale": scale, **TWINS})
        truth["px_mm"] = np.float64(capture.rig.camera.pitch_mm)
        figures = _figures(capture, truth)
        parts = ("ridge_corr", "ridge_gain", "ridge_rms_um", "error_over_stated")
        names = [
            "surface_rms_mm",
            *(f"{part}{slant_class}" for slant_class in (*CLASSES[1:], "") for part in parts),
        ]
        rows.append([figures.get(name, np.nan) for name in names])
        print(seed, *(f"{value:.3f}" for value in rows[-1]), flush=True)
    require(bool(rows), "the last seed is before the first.")
    print("mean", *(f"{value:.3f}" for value in np.nanmean(rows, axis=0)))


TWINS = {"films.kind": "analyser", "side_lights": 7}
"""The simulator's settings; those of its fingers' skin and pose are drawn."""


def without_films(capture: Capture) -> Capture:
    """The photographs as they were without films: half the sum of both series."""
    require(
        capture.encoding == "linear" and "white_crossed" in capture.bands,
        "the capture is not polarised and linear.",
    )
    white, crossed = capture.bands["white"], capture.bands["white_crossed"]
    mean = (np.asarray(white.pixels, np.uint32) + np.asarray(crossed.pixels)) // 2
    bands = {name: band for name, band in capture.bands.items() if name != "white_crossed"}
    bands["white"] = replace(white, pixels=mean.astype(white.pixels.dtype), polarisation="")
    return replace(capture, bands=bands)


def _figures(capture: Capture, truth: dict[str, np.ndarray]) -> dict[str, float]:
    result = splitknit.reconstruct(capture)
    figures = score(
        {name: getattr(result, name) for name in ("height_mm", "mask", "uncertainty_um")}, truth
    )
    specular = result.facts["optics"].get("specular", {})
    return figures | {f"fitted_{name}": value for name, value in specular.items()}


def table(figures: dict[str, dict[str, dict[str, float]]]) -> str:
    """Correlation, gain and rms error of the ridges, by slant; no films in brackets."""
    lines = [
        "finger | surface mm | "
        + " | ".join(name[1:].replace("_", " to ") or "below 60 deg" for name in CLASSES)
        + " | error over stated | false um"
    ]
    for name, ways in figures.items():
        a, b = ways["films"], ways["no films"]
        cells = [f"{a['surface_rms_mm']:.3f} ({b['surface_rms_mm']:.3f})"]
        for slant_class in CLASSES:
            keys = [f"ridge_{figure}{slant_class}" for figure in ("corr", "gain", "rms_um")]
            texts = [
                f"{w[keys[0]]:.3f}, {w[keys[1]]:.2f}, {w[keys[2]]:.1f}" if keys[0] in w else "-"
                for w in (a, b)
            ]
            cells.append(f"{texts[0]} ({texts[1]})")
        cells.append(
            f"{a.get('error_over_stated', np.nan):.2f} ({b.get('error_over_stated', np.nan):.2f})"
        )
        cells.append(
            f"{a['false_relief_um']:.1f} ({b['false_relief_um']:.1f})"
            if "false_relief_um" in a
            else "-"
        )
        lines.append(" | ".join([name, *cells]))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
