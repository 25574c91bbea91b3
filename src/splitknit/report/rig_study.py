"""What ``splitknit rig optimise`` leaves behind: a table, pictures and one self-contained page.

Its charts are SVG: a heat map over height and radius, a scatter of the Pareto front, error bars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from splitknit.io.csv_table import csv_text
from splitknit.io.pictures import colour
from splitknit.report import template
from splitknit.report.charts import (
    BOLD,
    INK,
    SERIES_COLOURS,
    axis_over,
    chart_frame,
    open_svg,
    segment,
    standalone,
    text_at,
)
from splitknit.rig.candidates import CAMERAS, MATERIALS, METHODS, Candidate, Study
from splitknit.rig.optimise import THESIS

_HALO = ' paint-order="stroke" stroke="#ffffff" stroke-width="3" stroke-linejoin="round"'
"""Words stay legible over points."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One rig in the heat map."""

    column: float
    row: float
    value: float | None
    """None where it was refused or failed."""
    note: str
    """What is said in the cell in the place of a value."""
    best: bool = False
    as_good: bool = False
    thesis: bool = False


@dataclass(frozen=True, slots=True)
class Dot:
    """One rig in a scatter or on an axis."""

    x: float
    y: float
    label: str = ""
    front: bool = False
    thesis: bool = False
    low: float | None = None
    high: float | None = None
    series: str = ""
    """In the legend; dots of one are joined by a line where none is on the front."""


def heat_map(cells: Sequence[Cell], x_label: str, y_label: str, unit: str, *, title: str = "") -> Markup:
    """A table of coloured cells: low values are dark, the best has a frame, those as good a dot, others stripes."""
    columns, rows = sorted({one.column for one in cells}), sorted({one.row for one in cells}, reverse=True)
    known = [one.value for one in cells if one.value is not None]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    wide, tall, left, top = 76, 40, 64, 30
    half = 3.0 * len(y_label) + 4  # of the upright label, which few rows are too short for
    middle = max(top + tall * len(rows) / 2, half)
    width, height = max(left + wide * len(columns) + 12, left + 220), max(top + tall * len(rows) + 78, middle + half)
    parts = [open_svg(width, height, title or f"{y_label} against {x_label}"), _STRIPES]
    parts.append(text_at(left, 16, title, "start", BOLD))
    for one in cells:
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.value is None:
            fill, ink, words = "url(#stripes)", "#555555", one.note
        else:
            shade = colour(np.array([[one.value]], dtype=np.float32), low, max(high, low + 1e-9))[0, 0]
            red, green, blue = (int(part) for part in shade)
            fill = f"rgb({red},{green},{blue})"
            ink = "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 130 else INK
            words = f"{one.value:#.3g}".rstrip(".") + (" •" if one.as_good and not one.best else "")
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" fill="{fill}" stroke="#ffffff" stroke-width="1.5"/>'
        )
        parts.append(
            text_at(x + wide / 2, y + tall / 2 + 4, words, "middle", f' fill="{ink}"{BOLD if one.best else ""}')
        )
    for one in cells:  # frames last: no neighbour covers them
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.best:
            parts.append(_frame(x + 2, y + 2, wide - 4, tall - 4, f'stroke="{SERIES_COLOURS[1]}"'))
        if one.thesis:
            inset = 6 if one.best else 2
            parts.append(_frame(x + inset, y + inset, wide - 2 * inset, tall - 2 * inset, _DASHED))
    for k, value in enumerate(columns):
        parts.append(text_at(left + wide * (k + 0.5), top + tall * len(rows) + 14, f"{value:g}", "middle"))
    for k, value in enumerate(rows):
        parts.append(text_at(left - 6, top + tall * (k + 0.5) + 4, f"{value:g}", "end"))
    bottom = top + tall * len(rows)
    parts.append(text_at(left + wide * len(columns) / 2, bottom + 30, x_label, "middle"))
    parts.append(
        f'<text x="14" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 14 {middle:.1f})">'
        f"{escape(y_label)}</text>"
    )
    parts.append(text_at(left, bottom + 50, unit, "start"))
    parts.append(text_at(left, bottom + 66, "orange: best; •: as good; dashed: the thesis's", "start"))
    return Markup("".join(parts) + "</svg>")


def scatter(dots: Sequence[Dot], x_label: str, y_label: str, *, title: str = "", log_x: bool = False) -> Markup:
    """Points over two axes; those on the front are filled, the thesis's has a ring; error bars where there are any."""
    own = sorted({dot.x for dot in dots})
    any_front = any(dot.front for dot in dots)
    x = axis_over(x_label, np.array(own), pad=0.06, log=log_x)
    if len(own) <= 10 and not any_front:
        x = replace(x, marks=tuple((value, f"{value:.3g}") for value in own))
    y = axis_over(y_label, np.array([v for dot in dots for v in (dot.y, dot.low, dot.high) if v is not None]), pad=0.06)
    series = list(dict.fromkeys(dot.series for dot in dots))
    legend = [name for name in series if name]
    parts, points = chart_frame(x, y, title, 258, legend)
    paints = {name: SERIES_COLOURS[k % len(SERIES_COLOURS)] for k, name in enumerate(series)}
    if not any_front:
        for name, paint in paints.items():
            along = sorted((dot.x, dot.y) for dot in dots if dot.series == name)
            line = " ".join(f"{px:.1f},{py:.1f}" for px, py in points(*np.array(along).T))
            parts.append(f'<polyline points="{line}" fill="none" stroke="{paint}" opacity="0.6"/>')
    places = [(*points(dot.x, dot.y), dot.label) for dot in dots]
    parts += _labels([place for place in places if place[2]], [place[:2] for place in places], points(x.high, y.low)[0])
    for dot in sorted(dots, key=lambda dot: dot.front):  # over the words' halos
        (px, py), paint = points(dot.x, dot.y), paints[dot.series]
        if dot.low is not None and dot.high is not None:
            parts.append(segment(points(dot.x, dot.low), points(dot.x, dot.high), paint))
        solid = dot.front or not any_front
        fill = paint if solid else "#ffffff"
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="{4 if solid else 3}" fill="{fill}" stroke="{paint}"/>')
        if dot.thesis:
            parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="8" fill="none" {_DASHED}/>')
    return Markup("".join(parts) + "</svg>")


def _labels(
    wanted: Sequence[tuple[float, float, str]], points: Sequence[tuple[float, float]], right: float
) -> list[str]:
    """Labels beside their points; one that would cover another, or a point, is left out."""
    taken = [(x - 4.0, x + 4.0, y + 4.0) for x, y in points]
    parts = []
    for x, y, words in wanted:
        long = 6.0 * len(words)
        sides = [start for start in (x + 8, x - 8 - long) if start >= 60 and start + long < right]
        for start, level in ((side, y + shift) for side in sides for shift in (4, -9, 17)):
            if all(abs(level - other) > 9 or start > end or start + long < begin for begin, end, other in taken):
                taken.append((start, start + long, level))
                parts.append(text_at(start, level, words, "start", _HALO))
                break
    return parts


_DASHED = 'stroke="#000000" stroke-dasharray="4 3"'
_STRIPES = (
    '<defs><pattern id="stripes" width="8" height="8" patternUnits="userSpaceOnUse" '
    'patternTransform="rotate(45)"><rect width="8" height="8" fill="#f4f4f4"/>'
    '<rect width="3" height="8" fill="#e0e0e0"/></pattern></defs>'
)


def _frame(x: float, y: float, width: float, height: float, stroke: str) -> str:
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke-width="2" {stroke}/>'


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


def _table(records: Records, summary: Mapping[str, Any]) -> bytes:
    """All candidates as CSV, one line each."""
    figures = list(dict.fromkeys(name for one in records for name in (one["mean"] or {})))
    compared = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
    names = ["name", *AXES, "volume_l", "status", "reason", *figures, *compared, "pareto"]
    rows: list[list[Any]] = [names]
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
        rows.append([row.get(name, "") for name in names])
    return csv_text(rows).encode()


def _charts(records: Records, summary: Mapping[str, Any]) -> dict[str, Markup]:
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


def _page(records: Records, summary: Mapping[str, Any], study: Study, pictures: Mapping[str, Markup]) -> bytes:
    """One HTML file that needs nothing else."""
    what, unit = FIGURES[summary["figure"]]
    by_name = {one["candidate"]["name"]: one for one in records}
    listed = sorted(summary["compared"], key=lambda name: (summary["compared"][name]["value"], name))
    html = template("optimise.html").render(
        what=what,
        unit=unit,
        summary=summary,
        fingers=study.fingers,
        asked=(METHODS[study.method], MATERIALS[study.material], CAMERAS[study.camera]),
        best=rig_in_words(by_name[summary["best"]]),
        verdict=verdict(summary),
        pictures=list(pictures.values()),
        rows=[_row(by_name[name], summary["compared"][name], name in summary["pareto"]) for name in listed],
        findings=[one["words"] for one in by_name[summary["best"]]["constraints"]],
        reasons=list(summary["reasons"].items()),
    )
    return str(html).encode()


def write_all(out: Path, records: Records, summary: Mapping[str, Any], study: Study) -> dict[str, str]:
    """Write table, pictures and page into `out`; return what each file is."""
    from splitknit.io.atomic import atomic_file

    pictures = _charts(records, summary)
    content = {f"{name}.svg": (standalone(picture), "picture") for name, picture in pictures.items()}
    content["results.csv"] = (_table(records, summary), "all rigs, one line each")
    content["index.html"] = (_page(records, summary, study, pictures), "the page to open")
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


def rig_in_words(record: Mapping[str, Any]) -> str:
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
    powers = {one["candidate"]["power_w"] for one in done}
    named = ("height_mm", "radius_mm", *(("power_w",) if len(powers) > 1 else ()))
    dots = []
    for one in sorted(done, key=lambda one: one["candidate"]["power_w"]):
        candidate = _candidate_of(one)
        front = candidate.name in summary["pareto"]
        dots.append(
            Dot(
                x=candidate.volume_l,
                y=summary["compared"][candidate.name]["value"],
                label="/".join(f"{getattr(candidate, name):g}" for name in named) if front else "",
                front=front,
                thesis=all(getattr(candidate, name) == value for name, value in THESIS.items()),
                series=f"{candidate.power_w:g} W" if len(powers) > 1 else "",
            )
        )
    title = f"Pareto front (filled; height/radius{'/power' if len(powers) > 1 else ''})"
    return scatter(dots, "volume between LEDs and finger (litres)", f"{what} ({unit})", title=title)


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
