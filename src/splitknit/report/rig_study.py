"""What ``splitknit rig optimise`` leaves behind: a table, pictures and one self-contained page.

Its charts are SVG: a heat map over height and radius, a scatter of the Pareto front, error bars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from splitknit.io.csv_table import csv_text
from splitknit.io.pictures import colour
from splitknit.report import render
from splitknit.report.charts import INK, SERIES_COLOURS
from splitknit.rig.candidates import CAMERAS, MATERIALS, METHODS, RigCandidate, Study
from splitknit.rig.optimise import THESIS

BLUE, ORANGE, GREEN, GREY = SERIES_COLOURS
BORDER = "#ffffff"


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
    series: int = 0


def heat_map(cells: Sequence[Cell], x_label: str, y_label: str, unit: str, *, title: str = "") -> Markup:
    """A table of coloured cells: low values are dark, the best has a frame, those as good a dot, others stripes."""
    columns, rows = sorted({one.column for one in cells}), sorted({one.row for one in cells}, reverse=True)
    known = [one.value for one in cells if one.value is not None]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    wide, tall, left, top = 76, 40, 64, 30
    half = 3.0 * len(y_label) + 4  # of the upright label, which few rows are too short for
    middle = max(top + tall * len(rows) / 2, half)
    width, height = max(left + wide * len(columns) + 12, left + 220), max(top + tall * len(rows) + 78, middle + half)
    parts = [_open(width, height, title or f"{y_label} against {x_label}"), _stripes()]
    parts.append(_text(left, 16, title, "start", bold=True))
    for one in cells:
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.value is None:
            fill, ink, words = "url(#stripes)", "#555555", one.note
        else:
            red, green, blue = _shade(one.value, low, high)
            fill = f"rgb({red},{green},{blue})"
            ink = "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 130 else INK
            words = f"{one.value:#.3g}".rstrip(".") + (" •" if one.as_good and not one.best else "")
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" fill="{fill}" stroke="{BORDER}" stroke-width="1.5"/>'
        )
        parts.append(_text(x + wide / 2, y + tall / 2 + 4, words, "middle", ink=ink, bold=one.best))
    for one in cells:  # frames last: no neighbour covers them
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.best:
            parts.append(_frame(x + 2, y + 2, wide - 4, tall - 4, paint=ORANGE))
        if one.thesis:
            inset = 6 if one.best else 2
            parts.append(_frame(x + inset, y + inset, wide - 2 * inset, tall - 2 * inset, paint="#000000", dash="4 3"))
    for k, value in enumerate(columns):
        parts.append(_text(left + wide * (k + 0.5), top + tall * len(rows) + 14, f"{value:g}", "middle"))
    for k, value in enumerate(rows):
        parts.append(_text(left - 6, top + tall * (k + 0.5) + 4, f"{value:g}", "end"))
    bottom = top + tall * len(rows)
    parts.append(_text(left + wide * len(columns) / 2, bottom + 30, x_label, "middle"))
    parts.append(
        f'<text x="14" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 14 {middle:.1f})">'
        f"{escape(y_label)}</text>"
    )
    parts.append(_text(left, bottom + 50, unit, "start"))
    parts.append(_text(left, bottom + 66, "orange: best; •: as good; dashed: the thesis's", "start"))
    return Markup("".join(parts) + "</svg>")


def scatter(
    dots: Sequence[Dot], x_label: str, y_label: str, *, series: Sequence[str] = (), title: str = "", log_x: bool = False
) -> Markup:
    """Points over two axes; those on the front are filled, the thesis's has a ring; error bars where there are any.

    Points of a series are joined by a line where no series has a front.
    """
    width, height, left, right, top, bottom = 520, 300, 56, 16, 42, 42
    x_values = np.array([_place(dot.x, log_x) for dot in dots])
    y_values = np.array([v for dot in dots for v in (dot.y, dot.low, dot.high) if v is not None])
    x_low, x_high = _padded(float(x_values.min()), float(x_values.max()))
    y_low, y_high = _padded(float(y_values.min()), float(y_values.max()))

    def to_x(value: float) -> float:
        return left + (_place(value, log_x) - x_low) / (x_high - x_low) * (width - left - right)

    def to_y(value: float) -> float:
        return height - bottom - (value - y_low) / (y_high - y_low) * (height - top - bottom)

    parts = [_open(width, height, title or f"{y_label} against {x_label}"), _text(left, 14, title, "start", bold=True)]
    own = sorted({dot.x for dot in dots})
    marks = own if len(own) <= 10 and not any(dot.front for dot in dots) else _nice(x_low, x_high, log_x)
    for mark in marks:
        parts.append(_line(to_x(mark), top, to_x(mark), height - bottom, "#e2e2e2"))
        parts.append(_text(to_x(mark), height - bottom + 14, f"{mark:.3g}", "middle"))
    for mark in _nice(y_low, y_high, False):
        parts.append(_line(left, to_y(mark), width - right, to_y(mark), "#e2e2e2"))
        parts.append(_text(left - 5, to_y(mark) + 4, f"{mark:g}", "end"))
    parts.append(_text((left + width - right) / 2, height - 8, x_label, "middle"))
    parts.append(_text(4, 32, y_label, "start"))
    offset = float(width - right)
    for k, name in reversed(list(enumerate(series))):
        parts.append(_text(offset, 32, name, "end"))
        offset -= 6.2 * len(name) + 10
        parts.append(f'<circle cx="{offset:.1f}" cy="28" r="4" fill="{SERIES_COLOURS[k % 4]}"/>')
        offset -= 14
    if not any(dot.front for dot in dots):
        for k in sorted({dot.series for dot in dots}):
            along = sorted((dot for dot in dots if dot.series == k), key=lambda dot: dot.x)
            points = " ".join(f"{to_x(dot.x):.1f},{to_y(dot.y):.1f}" for dot in along)
            parts.append(f'<polyline points="{points}" fill="none" stroke="{SERIES_COLOURS[k % 4]}" opacity="0.6"/>')
    places = [(to_x(dot.x), to_y(dot.y), dot.label) for dot in dots]
    parts += _labels([place for place in places if place[2]], [place[:2] for place in places], width - right)
    for dot in sorted(dots, key=lambda dot: dot.front):  # over the words' halos
        x, y, paint = to_x(dot.x), to_y(dot.y), SERIES_COLOURS[dot.series % 4]
        if dot.low is not None and dot.high is not None:
            parts.append(_line(x, to_y(dot.low), x, to_y(dot.high), paint))
        solid = dot.front or not any(one.front for one in dots)
        fill = paint if solid else "#ffffff"
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4 if solid else 3}" fill="{fill}" stroke="{paint}"/>')
        if dot.thesis:
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="#000000" stroke-dasharray="4 3"/>'
            )
    return Markup("".join(parts) + "</svg>")


def standalone(chart: Markup) -> bytes:
    """The chart as an SVG file."""
    text = str(chart)  # plain text first: the markup's own replace() would escape what is put in
    return text.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).encode()


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
                parts.append(_text(start, level, words, "start", halo=True))
                break
    return parts


def _shade(value: float, low: float, high: float) -> tuple[int, int, int]:
    shades = colour(np.array([[value]], dtype=np.float32), low, max(high, low + 1e-9))[0, 0]
    return int(shades[0]), int(shades[1]), int(shades[2])


def _padded(low: float, high: float) -> tuple[float, float]:
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def _place(value: float, log: bool) -> float:
    return float(np.log10(value)) if log else value


def _nice(low: float, high: float, log: bool) -> list[float]:
    """Round numbers between two limits (logarithms of the limits where `log`)."""
    if log:
        return [10.0**k for k in range(int(np.ceil(low)), int(np.floor(high)) + 1)]
    step = 10.0 ** np.floor(np.log10((high - low) / 5))
    step *= next((m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= 6), 10)
    return [round(k * step, 10) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _open(width: float, height: float, title: str) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img" '
        f'aria-label="{escape(title)}" font-family="sans-serif" font-size="11" fill="{INK}">'
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>'
    )


def _stripes() -> str:
    return (
        '<defs><pattern id="stripes" width="8" height="8" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><rect width="8" height="8" fill="#f4f4f4"/>'
        '<rect width="3" height="8" fill="#e0e0e0"/></pattern></defs>'
    )


def _text(
    x: float, y: float, words: str, anchor: str, *, ink: str = INK, bold: bool = False, halo: bool = False
) -> str:
    weight = ' font-weight="600"' if bold else ""
    if halo:  # words stay legible over points
        weight += ' paint-order="stroke" stroke="#ffffff" stroke-width="3" stroke-linejoin="round"'
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{ink}"{weight}>{escape(words)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, paint: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{paint}"/>'


def _frame(x: float, y: float, width: float, height: float, *, paint: str, dash: str = "") -> str:
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke="{paint}" stroke-width="2" '
        f'stroke-dasharray="{dash}"/>'
    )


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
    html = render(
        "optimise.html",
        what=what,
        unit=unit,
        summary=summary,
        fingers=study.fingers,
        asked=(METHODS[study.method], MATERIALS[study.material], CAMERAS[study.camera]),
        best=describe_rig(by_name[summary["best"]]),
        verdict=verdict(summary),
        pictures=list(pictures.values()),
        rows=[_row(by_name[name], summary["compared"][name], name in summary["pareto"]) for name in listed],
        findings=[one["words"] for one in by_name[summary["best"]]["constraints"]],
        reasons=list(summary["reasons"].items()),
    )
    return html.encode()


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


def describe_rig(record: Mapping[str, Any]) -> str:
    """A rig as a sentence."""
    one = _candidate_of(record)
    tilt = "aimed at the middle" if one.tilt_deg is None else f"tilted by {one.tilt_deg:g} deg"
    return (
        f"height {one.height_mm:g} mm, radius {one.radius_mm:g} mm, {one.power_w:g} W, beams {tilt}, "
        f"{one.px_per_mm:g} px/mm"
    )


def _candidate_of(record: Mapping[str, Any]) -> RigCandidate:
    """The candidate of a record."""
    return RigCandidate(**{name: value for name, value in record["candidate"].items() if name != "name"})


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

    def named(candidate: RigCandidate) -> tuple[float, ...]:
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


def _along(records: Records, summary: Mapping[str, Any], best: RigCandidate, axis: str) -> list[Dot]:
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
