"""The folder of a comparison of two measurements: one HTML page that needs nothing else, the facts,
a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.imaging.geometry import bounding_box
from splitknit.io.atomic import atomic_folder
from splitknit.io.pictures import colour, on_paper
from splitknit.io.provenance import json_text, provenance, report_head
from splitknit.io.results import write_picture
from splitknit.model import FloatArray
from splitknit.report import template
from splitknit.report.photos import Picture, captioned, colour_bar
from splitknit.report.surface import PageSurface, scene, upright_surface
from splitknit_match.evaluation.pair import BANDS_MM, PROTOCOLS, SLANTS_DEG, PairComparison

FORMAT = "splitknit-comparison"
_MAIN = next(iter(SLANTS_DEG))


def write_comparison(
    pair: PairComparison,
    out: Path,
    names: Sequence[Path],
    protocol: str | None,
    repeat: PairComparison | None,
) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``difference.png``, all or nothing; return what
    the JSON holds. `protocol`: one of :data:`splitknit_match.evaluation.pair.PROTOCOLS`, whose
    simulated error is stated; `repeat`: B and a second B, which measures B's own error.
    """
    turn = np.rad2deg(np.arccos(np.clip((np.trace(pair.rotation) - 1.0) / 2.0, -1.0, 1.0)))
    facts = {
        **report_head(FORMAT),
        "a": str(names[0]),
        "b": str(names[1]),
        "fit": pair.fit,
        "similarity": pair.similarity,
        "scale": pair.scale,
        "turn_deg": float(turn),
        "rotation": pair.rotation.tolist(),
        "shift_mm": pair.shift_mm.tolist(),
        "shifted_patches_um": 1e3 * pair.strain_mm,
        "bands": pair.figures,
        "own_error": _own_error(pair, protocol, repeat),
        "findings": [finding.facts for finding in pair.findings],
        "files": ["report.html", "report.json", "difference.png"],
    }
    surfaces = []  # both in A's frame, so that one section cuts them in one place
    for title, height_mm, relief_um in zip("AB", pair.height_mm, pair.relief_um, strict=True):
        fields = height_mm, relief_um / 1000
        surface = upright_surface(
            fields, np.isfinite(height_mm), pair.pitch_mm, np.eye(3), xy_mm=None
        )
        surfaces.append(PageSurface(title, surface))
    difference_um = pair.relief_um[0] - pair.relief_um[1]
    apart = "Blue: A is too low, orange: too high. Ridges seen here have the wrong height."
    pictures = [
        _picture(
            pair, "A", pair.relief_um[0], "What is tested, waves below 1.7 mm. Yellow is high."
        ),
        _picture(pair, "B", pair.relief_um[1], "The reference, laid on A."),
        _picture(pair, "A - B", difference_um, apart, diverging=True),
    ]
    page = template(Path(__file__).with_name("pair.html")).render(
        scene=scene(surfaces),
        facts=facts,
        headline=headline(facts),
        pictures=pictures,
        bands=list(pair.figures),
        slants=list(SLANTS_DEG),
        main=_MAIN,
        cell=_cell,
    )
    with atomic_folder(out) as folder:
        write_picture(
            folder / "difference.png", _coloured(difference_um, diverging=True)[0], provenance()
        )
        (folder / "report.html").write_text(str(page), encoding="utf-8")
        (folder / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _own_error(
    pair: PairComparison, protocol: str | None, repeat: PairComparison | None
) -> dict[str, Any]:
    """By source and band: the rms in um that A's error does not explain, and what is left without
    it (squares add)."""
    errors: dict[str, Any] = {}

    def explain(source: str, band: str, own_um: float, gain: float | None = None) -> None:
        if _MAIN in pair.figures.get(band, {}):
            total_um = pair.figures[band][_MAIN]["rms_um"]["value"]
            left_um = float(np.sqrt(max(total_um**2 - own_um**2, 0.0)))
            errors.setdefault(source, {})[band] = {
                "rms_um": float(own_um),
                "gain": gain,
                "left_um": left_um,
            }

    if protocol is not None:
        for band, figures in zip(BANDS_MM, PROTOCOLS[protocol], strict=False):
            explain(f"{protocol}, simulated", band, *figures)
    if repeat is not None:  # B and its repetition err alike: each has half of the variance
        for band, slants in repeat.figures.items():
            if _MAIN in slants:
                explain("B, repeated", band, slants[_MAIN]["rms_um"]["value"] / np.sqrt(2.0))
    return errors


def headline(facts: Mapping[str, Any]) -> list[str]:
    """The main figures, in lines."""
    lines = []
    for band in ("relief", "0.25 to 0.8 mm"):
        figures = facts["bands"][band].get(_MAIN)
        if figures is not None:
            lines.append(
                f"{band}, slant {_MAIN} deg: correlation {_cell(figures['correlation'], 3)}, gain"
                f" {_cell(figures['gain'], 2)}, rms of A - B {_cell(figures['rms_um'], 1)} um; B's"
                f" own waves {figures['std_um']:.1f} um"
            )
    return lines


def _cell(figure: Mapping[str, Any], digits: int) -> str:
    value = f"{figure['value']:.{digits}f}"
    return (
        value
        if figure["low"] is None
        else f"{value} ({figure['low']:.{digits}f} to {figure['high']:.{digits}f})"
    )


_LONGEST_PX = 700  # longest side of a picture
_APART_UM = 20.0  # largest difference that has a colour of its own
_HIGH_UM = 60.0  # largest height that has a colour of its own


def _coloured(values_um: FloatArray, *, diverging: bool) -> tuple[Any, float]:
    """The surface's box in colours, at most `_LONGEST_PX` a side; and pixels of the surface in
    one."""
    limit = _APART_UM if diverging else _HIGH_UM
    known = np.isfinite(values_um)
    box = bounding_box(known, 4)
    picture = on_paper(
        colour(values_um[box], -limit, limit, diverging=diverging), known[box].astype(np.float32)
    )
    factor = min(1.0, _LONGEST_PX / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return small, max(picture.shape[:2]) / max(small.shape[:2])


def _picture(
    pair: PairComparison,
    title: str,
    values_um: FloatArray,
    caption: str,
    *,
    diverging: bool = False,
) -> Picture:
    limit = _APART_UM if diverging else _HIGH_UM
    picture, coarser = _coloured(values_um, diverging=diverging)
    legend = colour_bar(-limit, limit, "µm", diverging=diverging)
    return captioned(title, picture, caption, pair.pitch_mm * coarser, legend)
