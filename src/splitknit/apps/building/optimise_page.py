"""What ``splitknit rig optimise`` leaves behind: a table, pictures and one self-contained page."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from splitknit.apps.building.optimise_charts import Cell, Dot, heat_map, scatter, standalone
from splitknit.report import render
from splitknit.rig.candidates import CAMERAS, MATERIALS, METHODS, Candidate, Study
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
Records = Sequence[Mapping[str, Any]]


def table(records: Records, summary: Mapping[str, Any]) -> bytes:
    """All candidates as CSV, one line each."""
    figures = list(dict.fromkeys(name for one in records for name in (one["mean"] or {})))
    compared = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
    names = ["name", *AXES, "volume_l", "status", "reason", *figures, *compared, "pareto"]
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    for one in records:
        candidate = _candidate_of(one)
        row: dict[str, Any] = {"name": candidate.name, "volume_l": f"{candidate.volume_l:.4f}"}
        row |= {axis: getattr(candidate, axis) for axis in AXES}
        row["tilt_deg"] = "centre" if candidate.tilt_deg is None else candidate.tilt_deg
        row |= {"status": one["status"], "reason": one["reason"], **_rounded(one["mean"] or {})}
        its = summary["compared"].get(candidate.name)
        if its is not None:
            row |= _rounded({name: its[name] for name in compared})
            row["pareto"] = candidate.name in summary["pareto"]
        writer.writerow(row)
    return text.getvalue().encode()


def charts(records: Records, summary: Mapping[str, Any]) -> dict[str, Markup]:
    """Pictures by the name of their file: heat map, Pareto front, and a chart for every further axis."""
    what, unit = FIGURES[summary["figure"]]
    pictures = {
        "heat_map": _heat_map(records, summary, what, unit),
        "pareto_front": _pareto(records, summary, what, unit),
    }
    best = _candidate_of(next(one for one in records if one["candidate"]["name"] == summary["best"]))
    for axis in ("power_w", "tilt_deg", "px_per_mm"):
        dots = _along(records, summary, best, axis)
        if len(dots) > 1:
            title = f"{what} against {AXES[axis].split(' (')[0]}, the best rig otherwise"
            label = f"{what} ({unit})"
            pictures[axis] = scatter(dots, AXES[axis], label, title=title, log_x=axis == "power_w")
    return pictures


def page(records: Records, summary: Mapping[str, Any], study: Study, pictures: Mapping[str, Markup]) -> bytes:
    """One HTML file that needs nothing else."""
    what, unit = FIGURES[summary["figure"]]
    by_name = {one["candidate"]["name"]: one for one in records}
    listed = sorted(summary["compared"], key=lambda name: (summary["compared"][name]["value"], name))
    html = render(
        "optimise.html",
        what=what,
        unit=unit,
        summary=summary,
        fingers=study.fingers,
        asked=(METHODS[study.method], MATERIALS[study.material], CAMERAS[study.camera]),
        best=describe(by_name[summary["best"]]),
        verdict=verdict(summary),
        pictures=list(pictures.values()),
        rows=[_row(by_name[name], summary["compared"][name], name in summary["pareto"]) for name in listed],
        findings=[one["words"] for one in by_name[summary["best"]]["constraints"]],
        reasons=list(summary["reasons"].items()),
    )
    return html.encode()


def write_all(out: Path, records: Records, summary: Mapping[str, Any], study: Study) -> dict[str, str]:
    """Write table, pictures and page into `out`; return what each file is."""
    from splitknit.io.atomic import atomic_file  # noqa: PLC0415

    pictures = charts(records, summary)
    content = {f"{name}.svg": (standalone(picture), "picture") for name, picture in pictures.items()}
    content["results.csv"] = (table(records, summary), "all rigs, one line each")
    content["index.html"] = (page(records, summary, study, pictures), "the page to open")
    for name, (data, _) in content.items():
        with atomic_file(out / name) as stream:
            stream.write(data)
    return {name: what for name, (_, what) in sorted(content.items())}


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


def describe(record: Mapping[str, Any]) -> str:
    """A rig as a sentence."""
    one = _candidate_of(record)
    tilt = "aimed at the middle" if one.tilt_deg is None else f"tilted by {one.tilt_deg:g} deg"
    return (
        f"height {one.height_mm:g} mm, radius {one.radius_mm:g} mm, {one.power_w:g} W, beams {tilt}, "
        f"{one.px_per_mm:g} px/mm"
    )


def _candidate_of(record: Mapping[str, Any]) -> Candidate:
    """The candidate of a record."""
    return Candidate(**{name: value for name, value in record["candidate"].items() if name != "name"})


def _heat_map(records: Records, summary: Mapping[str, Any], what: str, unit: str) -> Markup:
    """Over height and radius; of several powers, tilts and resolutions the best one."""
    cells: dict[tuple[float, float], Mapping[str, Any]] = {}
    for one in records:
        place = (one["candidate"]["radius_mm"], one["candidate"]["height_mm"])
        before = cells.get(place)
        if before is None or _order(one, summary) < _order(before, summary):
            cells[place] = one
    drawn = []
    for (radius, height), one in sorted(cells.items()):
        its = summary["compared"].get(one["candidate"]["name"])
        drawn.append(
            Cell(
                column=radius,
                row=height,
                value=None if its is None else its["value"],
                note=_why(one),
                best=its is not None and its["best"],
                as_good=its is not None and its["as_good"] and its["worse_low"] is not None,
                thesis=radius == THESIS["radius_mm"] and height == THESIS["height_mm"],
            )
        )
    return heat_map(drawn, AXES["radius_mm"], AXES["height_mm"], f"{what}, {unit}", title=what)


def _order(record: Mapping[str, Any], summary: Mapping[str, Any]) -> float:
    its = summary["compared"].get(record["candidate"]["name"])
    return float("inf") if its is None else float(its["value"])


def _why(record: Mapping[str, Any]) -> str:
    """The first constraint that a rig breaks, in two words."""
    broken = [one["name"] for one in record["constraints"] if one["hard"] and not one["ok"]]
    return SHORT.get(broken[0], broken[0]) if broken else "failed"


def _pareto(records: Records, summary: Mapping[str, Any], what: str, unit: str) -> Markup:
    """Error against the size of the box; powers are series."""
    done = [one for one in records if one["candidate"]["name"] in summary["compared"]]
    powers = sorted({one["candidate"]["power_w"] for one in done})

    def named(candidate: Candidate) -> tuple[float, ...]:
        many = (candidate.power_w,) if len(powers) > 1 else ()
        return (candidate.height_mm, candidate.radius_mm, *many)

    dots = []
    for one in done:
        candidate = _candidate_of(one)
        front = candidate.name in summary["pareto"]
        dots.append(
            Dot(
                x=candidate.volume_l,
                y=summary["compared"][candidate.name]["value"],
                label="/".join(f"{value:g}" for value in named(candidate)) if front else "",
                front=front,
                thesis=all(getattr(candidate, name) == value for name, value in THESIS.items()),
                series=powers.index(candidate.power_w),
            )
        )
    series = [f"{power:g} W" for power in powers] if 1 < len(powers) <= 4 else []
    title = f"Pareto front (filled; height/radius{'/power' if len(powers) > 1 else ''})"
    return scatter(dots, "volume between LEDs and finger (litres)", f"{what} ({unit})", series=series, title=title)


def _along(records: Records, summary: Mapping[str, Any], best: Candidate, axis: str) -> list[Dot]:
    """Rigs that differ from the best one in one thing alone."""
    others = [name for name in AXES if name != axis]
    dots = []
    for one in records:
        candidate = _candidate_of(one)
        its = summary["compared"].get(candidate.name)
        if its is None or any(getattr(candidate, name) != getattr(best, name) for name in others):
            continue
        x = candidate.beam_deg if axis == "tilt_deg" else getattr(candidate, axis)
        dots.append(Dot(x=float(x), y=its["value"], low=its["low"], high=its["high"]))
    return sorted(dots, key=lambda dot: dot.x)


def _row(record: Mapping[str, Any], its: Mapping[str, Any], front: bool) -> dict[str, Any]:
    candidate, mean = _candidate_of(record), record["mean"]
    return {
        "candidate": candidate,
        "tilt": "centre" if candidate.tilt_deg is None else f"{candidate.tilt_deg:g}",
        "value": f"{its['value']:.3f}",
        "interval": "" if its["low"] is None else f"{its['low']:.3f} to {its['high']:.3f}",
        "worse": f"{its['worse_by']:+.3f}",
        "as_good": its["as_good"] and its["worse_low"] is not None,
        "best": its["best"],
        "front": front,
        "exposure": f"{1000 * mean['exposure_s_white']:.3g} ms, gain {mean['gain_white']:.2g}",
        "ridges": f"{mean['ridge_correlation']:.3f}",
    }


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: float(f"{v:.6g}") if isinstance(v, float) else v for name, v in values.items()}
