"""The folder of a comparison of two measurements: one HTML page that needs nothing else, the facts, a picture."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.imaging.geometry import bounding_box
from splitknit.io.atomic import atomic_folder
from splitknit.io.pictures import colour, on_paper
from splitknit.io.provenance import json_text, provenance
from splitknit.io.results import write_picture
from splitknit.report import template
from splitknit.report.photos import Picture, captioned, colour_bar
from splitknit.report.surface import PageSurface, scene, upright_surface
from splitknit_match.evaluation.pair import BANDS_MM, PROTOCOLS, SLANTS_DEG, PairComparison

FORMAT = "splitknit-comparison"
_MAIN = next(iter(SLANTS_DEG))
_LONGEST_PX, _APART_UM = 700, 20.0


def write_comparison(
    pair: PairComparison,
    out: Path,
    names: Sequence[Path],
    protocol: str | None = None,
    repeat: PairComparison | None = None,
) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``difference.png``, all or nothing; return what the JSON holds.
    `protocol`: one of :data:`splitknit_match.evaluation.pair.PROTOCOLS`, whose simulated error is stated; `repeat`: B
    and a second B, which measures B's own error.
    """
    turn = np.rad2deg(np.arccos(np.clip((np.trace(pair.rotation) - 1.0) / 2.0, -1.0, 1.0)))
    facts: dict[str, Any] = {
        "format": FORMAT, "version": 1, "software": {"name": "splitknit", "version": provenance()["version"]},
        "written_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "a": str(names[0]), "b": str(names[1]), "fit": pair.fit, "similarity": pair.similarity, "scale": pair.scale,
        "turn_deg": float(turn), "rotation": pair.rotation.tolist(), "shift_mm": pair.shift_mm.tolist(),
        "shifted_patches_um": 1e3 * pair.strain_mm, "bands": pair.figures,
        "own_error": _own_error(pair, protocol, repeat), "notes": list(pair.notes),
        "files": ["report.html", "report.json", "difference.png"],
    }  # fmt: skip
    pictures = _pictures(pair)
    page = template(Path(__file__).with_name("pair.html")).render(
        scene=scene([_side(pair, k) for k in range(2)]),
        facts=facts,
        headline=headline(facts),
        pictures=pictures,
        bands=list(pair.figures),
        slants=list(SLANTS_DEG),
        main=_MAIN,
        cell=_cell,
    )
    with atomic_folder(out) as folder:
        write_picture(folder / "difference.png", _coloured(pair.difference_um, _APART_UM)[0], provenance())
        (folder / "report.html").write_text(str(page), encoding="utf-8")
        (folder / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _side(pair: PairComparison, number: int) -> PageSurface:
    """A or B in A's frame, so that one section cuts both in one place."""
    height_mm, ridge_mm = pair.height_mm[number], pair.relief_um[number] / 1000
    known = np.isfinite(height_mm)
    surface = upright_surface((height_mm, ridge_mm), known, pair.pitch_mm, np.eye(3), xy_mm=None)
    return PageSurface("AB"[number], surface)


def _own_error(pair: PairComparison, protocol: str | None, repeat: PairComparison | None) -> dict[str, Any]:
    """By source and band: the rms in um that A's error does not explain, and what is left without it (squares add)."""
    sources: dict[str, dict[str, tuple[float, float | None]]] = {}
    if protocol is not None:
        sources[f"{protocol}, simulated"] = dict(zip(BANDS_MM, PROTOCOLS[protocol], strict=False))
    if repeat is not None:  # B and its repetition err alike: each has half of the variance
        seen = {band: rows[_MAIN] for band, rows in repeat.figures.items() if _MAIN in rows}
        sources["B, repeated"] = {band: (one["rms_um"]["value"] / np.sqrt(2.0), None) for band, one in seen.items()}
    found: dict[str, Any] = {}
    for source, bands in sources.items():
        for band, (own, gain) in bands.items():
            if _MAIN in pair.figures.get(band, {}):
                left = np.sqrt(max(pair.figures[band][_MAIN]["rms_um"]["value"] ** 2 - own**2, 0.0))
                found.setdefault(source, {})[band] = {"rms_um": float(own), "gain": gain, "left_um": float(left)}
    return found


def headline(facts: Mapping[str, Any]) -> list[str]:
    """The main figures, in lines."""
    lines = []
    for band in ("relief", "0.25 to 0.8 mm"):
        one = facts["bands"][band].get(_MAIN)
        if one is not None:
            fits = f"correlation {_cell(one['correlation'], 3)}, gain {_cell(one['gain'], 2)}"
            apart = f"rms of A - B {_cell(one['rms_um'], 1)} um; B's own waves {one['std_um']:.1f} um"
            lines.append(f"{band}, slant {_MAIN} deg: {fits}, {apart}")
    return lines


def _cell(figure: Mapping[str, Any], digits: int) -> str:
    value, low, high = (figure[name] for name in ("value", "low", "high"))
    return f"{value:.{digits}f}" + ("" if low is None else f" ({low:.{digits}f} to {high:.{digits}f})")


def _coloured(values: Any, limit: float) -> tuple[Any, float]:
    """Micrometres of the surface's box as colours, at most `_LONGEST_PX` a side; and pixels of the surface in one."""
    known = np.isfinite(values)
    box = bounding_box(known, 4)
    picture = on_paper(colour(values[box], -limit, limit, diverging=limit == _APART_UM), known[box].astype(np.float32))
    factor = min(1.0, _LONGEST_PX / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return small, max(picture.shape[:2]) / max(small.shape[:2])


def _pictures(pair: PairComparison) -> list[Picture]:
    high, apart = "What is tested, waves below 1.7 mm. Yellow is high.", "Blue: A is too low, orange: too high."
    shown = (
        ("A", pair.relief_um[0], 60.0, high),
        ("B", pair.relief_um[1], 60.0, "The reference, laid on A."),
        ("A - B", pair.difference_um, _APART_UM, f"{apart} Ridges seen here have the wrong height."),
    )
    pictures = []
    for name, values, limit, caption in shown:
        picture, coarser = _coloured(values, limit)
        legend = colour_bar(-limit, limit, "µm", diverging=limit == _APART_UM)
        pictures.append(captioned(name, picture, caption, pair.pitch_mm * coarser, legend))
    return pictures
