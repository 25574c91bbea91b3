"""What ``splitknit rig optimise`` leaves behind: a table, pictures and one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from splitknit.io.atomic import write_file
from splitknit.io.csv_table import csv_text
from splitknit.report import template
from splitknit.report.charts import Cell, Dot, heat_map, scatter, standalone
from splitknit.rig.candidates import CAMERAS, MATERIALS, METHODS, RigCandidate, Study
from splitknit.rig.optimise import THESIS

AXES = {
    "height_mm": "height of camera and LEDs (mm)",
    "radius_mm": "radius of the circle of LEDs (mm)",
    "power_w": "power of one LED (W)",
    "tilt_deg": "tilt of the beams (deg)",
    "px_per_mm": "resolution (px/mm)",
}
FIGURES = {
    "hausdorff_mm": ("Hausdorff distance", "mm"),
    "hausdorff95_mm": ("95 % Hausdorff distance", "mm"),
    "rms_mm": ("rms distance", "mm"),
    "whole_mm": ("Hausdorff distance of the whole phalange", "mm"),
    "normals_deg": ("error of the normals", "deg"),
}
SHORT = {
    "leds_in_view": "LEDs in view",
    "direct_light": "light in lens",
    "room": "no room",
    "printer": "printer",
    "beam": "beam",
    "glare": "glare",
    "exposure_white": "exposure",
    "exposure_nir": "exposure",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Rig:
    """A record of the sweep, with what the summary holds of it."""

    candidate: RigCandidate
    record: Mapping[str, Any]
    figure: Mapping[str, Any] | None
    """Its figure with interval, against the best; None where it was refused or failed."""
    front: bool
    """Whether it is on the Pareto front."""

    @property
    def as_good(self) -> bool:
        """Whether it is indistinguishable from the best by an interval."""
        return self.figure is not None and self.figure["as_good"] and self.figure["worse_low"] is not None


def _rig(record: Mapping[str, Any], summary: Mapping[str, Any]) -> _Rig:
    candidate = RigCandidate(**{name: value for name, value in record["candidate"].items() if name != "name"})
    return _Rig(candidate, record, summary["compared"].get(candidate.name), candidate.name in summary["pareto"])


def write_all(
    out: Path, records: Sequence[Mapping[str, Any]], summary: Mapping[str, Any], study: Study
) -> dict[str, str]:
    """Write table, pictures and page into `out`; return what each file is."""
    rigs = [_rig(one, summary) for one in records]
    pictures = _pictures(rigs, summary)
    content = {f"{name}.svg": (standalone(picture), "picture") for name, picture in pictures.items()}
    content["results.csv"] = (_table(rigs), "all rigs, one line each")
    content["index.html"] = (_page(rigs, summary, study, pictures), "the page to open")
    for name, (data, _) in content.items():
        write_file(out / name, data)
    return {name: what for name, (_, what) in sorted(content.items())}


def _table(rigs: Sequence[_Rig]) -> bytes:
    """All candidates as CSV, one line each."""
    figures = list(dict.fromkeys(name for one in rigs for name in (one.record["mean"] or {})))
    compared = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
    names = ["name", *AXES, "volume_l", "status", "reason", *figures, *compared, "pareto"]
    rows: list[list[Any]] = [names]
    for one in rigs:
        row: dict[str, Any] = {"name": one.candidate.name, "volume_l": f"{one.candidate.volume_l:.4f}"}
        row |= {axis: getattr(one.candidate, axis) for axis in AXES}
        row["tilt_deg"] = "centre" if one.candidate.tilt_deg is None else one.candidate.tilt_deg
        row |= {"status": one.record["status"], "reason": one.record["reason"], **_rounded(one.record["mean"] or {})}
        if one.figure is not None:
            row |= {**_rounded({name: one.figure[name] for name in compared}), "pareto": one.front}
        rows.append([row.get(name, "") for name in names])
    return csv_text(rows).encode()


def _pictures(rigs: Sequence[_Rig], summary: Mapping[str, Any]) -> dict[str, Markup]:
    """Pictures by the name of their file: heat map, Pareto front, and a chart for every further axis."""
    what, unit = FIGURES[summary["figure"]]
    pictures = {"heat_map": _heat_map(rigs, what, unit), "pareto_front": _pareto(rigs, f"{what} ({unit})")}
    best = next(one.candidate for one in rigs if one.candidate.name == summary["best"])
    for axis in ("power_w", "tilt_deg", "px_per_mm"):
        dots = _along(rigs, best, axis)
        if len(dots) > 1:
            title = f"{what} against {AXES[axis].split(' (')[0]}, the best rig otherwise"
            pictures[axis] = scatter(dots, AXES[axis], f"{what} ({unit})", title=title, log_x=axis == "power_w")
    return pictures


def _page(rigs: Sequence[_Rig], summary: Mapping[str, Any], study: Study, pictures: Mapping[str, Markup]) -> bytes:
    """One HTML file that needs nothing else."""
    what, unit = FIGURES[summary["figure"]]
    best = next(one for one in rigs if one.candidate.name == summary["best"])
    measured = [(one.figure["value"], one.candidate.name, one) for one in rigs if one.figure is not None]
    html = template("optimise.html").render(
        what=what,
        unit=unit,
        summary=summary,
        fingers=study.fingers,
        study=(METHODS[study.method], MATERIALS[study.material], CAMERAS[study.camera]),
        best=rig_in_words(best.record),
        verdict=verdict(summary),
        pictures=list(pictures.values()),
        rigs=[one for _, _, one in sorted(measured, key=lambda row: row[:2])],
        findings=[one["words"] for one in best.record["constraints"]],
        reasons=list(summary["reasons"].items()),
    )
    return str(html).encode()


def verdict(summary: Mapping[str, Any]) -> str:
    """One sentence on the thesis's choice."""
    what, unit = FIGURES[summary["figure"]]
    thesis, best = summary["thesis"], summary["compared"][summary["best"]]
    if thesis is None:
        return "The thesis's choice (140 mm, 52.5 mm, 1 W) is not among the rigs that were measured."
    if thesis["best"]:
        return f"The thesis's choice is the best of them, with a {what} of {thesis['value']:.3g} {unit}."
    said = f"The thesis's choice has a {what} of {thesis['value']:.3g} {unit}, the best one {best['value']:.3g} {unit}"
    if thesis["worse_low"] is None:
        return f"{said}; one finger gives no interval."
    between = f"{thesis['worse_low']:.3g} to {thesis['worse_high']:.3g} {unit}"
    if thesis["as_good"]:
        return f"{said}: the difference, {between} at 95 %, may be nothing."
    return f"{said}: {between} more at 95 %, so it is not the best."


def rig_in_words(record: Mapping[str, Any]) -> str:
    """The rig of a record of the sweep, as a sentence."""
    one = record["candidate"]
    tilt = "aimed at the middle" if one["tilt_deg"] is None else f"tilted by {one['tilt_deg']:g} deg"
    return (
        f"height {one['height_mm']:g} mm, radius {one['radius_mm']:g} mm, {one['power_w']:g} W, beams {tilt}, "
        f"{one['px_per_mm']:g} px/mm"
    )


def _heat_map(rigs: Sequence[_Rig], what: str, unit: str) -> Markup:
    """Over height and radius; of several powers, tilts and resolutions the best one."""
    cells: dict[tuple[float, float], _Rig] = {}
    for one in sorted(rigs, key=lambda one: np.inf if one.figure is None else float(one.figure["value"])):
        cells.setdefault((one.candidate.radius_mm, one.candidate.height_mm), one)
    drawn = []
    for (radius, height), one in sorted(cells.items(), key=lambda cell: cell[0]):
        broken = [rule["name"] for rule in one.record["constraints"] if rule["hard"] and not rule["ok"]]
        drawn.append(
            Cell(
                column=radius,
                row=height,
                value=None if one.figure is None else one.figure["value"],
                note=SHORT.get(broken[0], broken[0]) if broken else "failed",
                best=one.figure is not None and one.figure["best"],
                as_good=one.as_good,
                thesis=radius == THESIS["radius_mm"] and height == THESIS["height_mm"],
            )
        )
    return heat_map(drawn, AXES["radius_mm"], AXES["height_mm"], f"{what}, {unit}", title=what)


def _pareto(rigs: Sequence[_Rig], y_label: str) -> Markup:
    """Error against the size of the box; powers are series."""
    done = [(one.candidate, one.figure["value"], one.front) for one in rigs if one.figure is not None]
    powers = {candidate.power_w for candidate, _, _ in done}
    named = ("height_mm", "radius_mm", *(("power_w",) if len(powers) > 1 else ()))
    dots = [
        Dot(
            x=candidate.volume_l,
            y=value,
            label="/".join(f"{getattr(candidate, name):g}" for name in named) if front else "",
            front=front,
            thesis=all(getattr(candidate, name) == value for name, value in THESIS.items()),
            series=f"{candidate.power_w:g} W" if len(powers) > 1 else "",
        )
        for candidate, value, front in sorted(done, key=lambda one: one[0].power_w)
    ]
    title = f"Pareto front (filled; height/radius{'/power' if len(powers) > 1 else ''})"
    return scatter(dots, "volume between LEDs and finger (litres)", y_label, title=title)


def _along(rigs: Sequence[_Rig], best: RigCandidate, axis: str) -> list[Dot]:
    """Rigs that differ from the best one along one axis only."""
    others = [name for name in AXES if name != axis]
    dots = []
    for one in rigs:
        if one.figure is None or any(getattr(one.candidate, name) != getattr(best, name) for name in others):
            continue
        x = one.candidate.beam_deg if axis == "tilt_deg" else getattr(one.candidate, axis)
        dots.append(Dot(x=float(x), y=one.figure["value"], low=one.figure["low"], high=one.figure["high"]))
    return sorted(dots, key=lambda dot: dot.x)


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: float(f"{v:.6g}") if isinstance(v, float) else v for name, v in values.items()}
