"""Tables (kept in ``tables/``) and picture of docs/experiments/rig-optimise.md, from the figures of ``optimise.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from plots import Cell, heat_map

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
COMPARED = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
FIGURE = {"hausdorff": "hausdorff_mm", "whole": "whole_mm", "rms": "rms_mm"}
AXES = {
    "height_mm": "height of camera and LEDs (mm)",
    "radius_mm": "radius of the circle of LEDs (mm)",
    "power_w": "power of one LED (W)",
    "tilt_deg": "tilt of the beams (deg)",
    "px_per_mm": "resolution (px/mm)",
}
SHORT = {
    "leds_in_view": "LEDs in view",
    "direct_light": "light in lens",
    "room": "no room",
    "printer": "printer",
    "beam": "beam",
    "glare": "specular",
    "exposure_white": "exposure",
    "exposure_nir": "exposure",
}
PLANES = {
    "ea_opaque": "thesis's method, opaque finger",
    "ea_poisson_opaque": "its normals, integrated within the mask, opaque finger",
    "ea_skin": "thesis's method, skin",
    "metric_skin": "preset `metric`, skin",
}
Row = Mapping[str, Any]


def write_report(results: Mapping[str, Any]) -> str:
    """Write the picture; return the tables as Markdown."""
    parts = [_optima(results, "hausdorff"), _optima(results, "whole")]
    parts += [_axis(results, axis) for axis in ("power_w", "tilt_deg", "px_per_mm")]
    parts += [_renderer(results), _near(results)]
    if "ea_opaque" in results:
        _write("heat-ea-opaque", _heat(results["ea_opaque"], "hausdorff", PLANES["ea_opaque"]))
    return "\n\n".join(part for part in parts if part)


def _done(sweep: Mapping[str, Any]) -> list[Row]:
    return [row for row in sweep["rows"] if row["status"] == "done"]


def _against(row: Row, objective: str) -> dict[str, Any]:
    return dict(zip(COMPARED, row["compared"][objective], strict=True))


def _thesis(rows: Sequence[Row]) -> Row | None:
    its = [row for row in rows if (row["height_mm"], row["radius_mm"], row["power_w"]) == (140.0, 52.5, 1.0)]
    return its[0] if its else None


def _optima(results: Mapping[str, Any], objective: str) -> str:
    lines = [
        f"Height and radius at 1 W, 10 px/mm; `{FIGURE[objective]}` with 95 % intervals over fingers:",
        "",
        "| | fingers | best (height / radius) | its error | thesis's error | more than the best | all rigs | as good |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, words in PLANES.items():
        if name not in results:
            continue
        rows, figure = _done(results[name]), FIGURE[objective]
        best = next(row for row in rows if row["name"] == results[name]["best"][objective])
        thesis = _thesis(rows)
        assert thesis is not None
        more = _against(thesis, objective)
        values = [row[figure] for row in rows]
        count = sum(_against(row, objective)["as_good"] for row in rows)
        lines.append(
            f"| {words} | {results[name]['fingers']} | {best['height_mm']:g} / {best['radius_mm']:g} mm "
            f"| {_interval(best, objective)} | {_interval(thesis, objective)} "
            f"| {more['worse_by']:+.2f} ({more['worse_low']:+.2f} to {more['worse_high']:+.2f}) "
            f"| {min(values):.2f} to {max(values):.2f} | {count} of {len(rows)} |"
        )
    return "\n".join(lines)


def _interval(row: Row, objective: str) -> str:
    its = _against(row, objective)
    return f"{row[FIGURE[objective]]:.2f} ({its['low']:.2f} to {its['high']:.2f})"


def _axis(results: Mapping[str, Any], axis: str) -> str:
    name = {"power_w": "power", "tilt_deg": "tilt", "px_per_mm": "resolution"}[axis]
    names = [f"{name}_{kind}" for kind in ("ea_opaque", "metric_skin")]
    if any(one not in results for one in names):
        return ""
    pair = [results[one] for one in names]
    thesis, swept = ({_value(row, axis): row for row in sweep["rows"]} for sweep in pair)
    lines = [
        f"At 140 mm and 52.5 mm, {AXES[axis].split(' (')[0]} ({pair[0]['fingers']} and {pair[1]['fingers']} fingers):",
        "",
        f"| {AXES[axis]} | exposure | thesis's, opaque: Hausdorff | rms | ridge correlation "
        "| `metric`, skin: Hausdorff | rms | ridge correlation |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for value, row in thesis.items():
        cells = [value, _exposure(row)]
        for one in (row, swept.get(value)):
            if one is None or one["status"] != "done":
                cells += ["-" if one is None else "/".join(SHORT[rule] for rule in one["broken"]), "", ""]
            else:
                cells += [f"{one['hausdorff_mm']:.3f}", f"{one['rms_mm']:.3f}", f"{one['ridge_correlation']:.3f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _value(row: Row, axis: str) -> str:
    return "at the middle (20.6)" if row[axis] is None else f"{row[axis]:g}"


def _exposure(row: Row) -> str:
    if row["status"] != "done":
        return "refused"
    said = f"{1000 * row['exposure_s_white']:.3g} ms"
    if row["gain_white"] > 1.005:
        said += f", gain {row['gain_white']:.2g}"
    return said if row["level_white"] > 0.69 else f"{said}, {100 * row['level_white']:.0f} % of full scale"


def _renderer(results: Mapping[str, Any]) -> str:
    if "renderer_power" not in results:
        return ""
    lines = [
        "One fixed exposure (white = 1 W/(m² sr)), bare lamps, 8 bits sRGB; thesis's method, opaque, 140 / 52.5 mm:",
        "",
        "| lamp (W) | brightest skin over white | Hausdorff | rms | normals (deg) | ridge correlation |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in _done(results["renderer_power"]):
        lines.append(
            f"| {row['power_w']:g} | {row['level_white']:.2f} | {row['hausdorff_mm']:.3f} | {row['rms_mm']:.3f} "
            f"| {row['normals_deg']:.2f} | {row['ridge_correlation']:.3f} |"
        )
    if "renderer" in results:
        lines += ["", "Height, radius and power together, under the same exposure:", ""]
        lines += ["| height (mm) | radius (mm) | " + " | ".join(f"{p:g} W" for p in (0.3, 1, 3)) + " |"]
        lines += ["| --- | --- | --- | --- | --- |"]
        table: dict[tuple[float, float], dict[float, str]] = {}
        for row in results["renderer"]["rows"]:
            said = f"{row['hausdorff_mm']:.2f}" if row["status"] == "done" else SHORT[row["broken"][0]]
            if row["name"] == results["renderer"]["best"]["hausdorff"]:
                said = f"**{said}**"
            table.setdefault((row["height_mm"], row["radius_mm"]), {})[row["power_w"]] = said
        for (height, radius), said_by in table.items():
            lines.append(f"| {height:g} | {radius:g} | " + " | ".join(said_by.values()) + " |")
    return "\n".join(lines)


def _near(results: Mapping[str, Any]) -> str:
    if "near_ea_opaque" not in results or "parallel_ea_opaque" not in results:
        return ""
    count = results["near_ea_opaque"]["fingers"]
    lines = [f"Lower still (thesis's method, opaque finger, {count} fingers; Hausdorff of the print in mm):", ""]
    rows = results["near_ea_opaque"]["rows"]
    radii = sorted({row["radius_mm"] for row in rows})
    lines += ["| height (mm) | " + " | ".join(f"radius {r:g}" for r in radii) + " |"]
    lines += ["| --- |" + " --- |" * len(radii)]
    for height in sorted({row["height_mm"] for row in rows}):
        cells = [
            f"{row['hausdorff_mm']:.2f}" if row["status"] == "done" else SHORT[row["broken"][0]]
            for row in rows
            if row["height_mm"] == height
        ]
        lines.append(f"| {height:g} | " + " | ".join(cells) + " |")
    lines += ["", "A camera with parallel rays in the place of the perspective one (the same):", ""]
    lines += ["| height (mm) | radius (mm) | perspective | parallel rays |", "| --- | --- | --- | --- |"]
    perspective = {(r["height_mm"], r["radius_mm"]): r for r in _done(results["ea_opaque"])}
    for row in _done(results["parallel_ea_opaque"]):
        other = perspective[row["height_mm"], row["radius_mm"]]
        lines.append(
            f"| {row['height_mm']:g} | {row['radius_mm']:g} | {other['hausdorff_mm']:.2f} | {row['hausdorff_mm']:.2f} |"
        )
    return "\n".join(lines)


def _heat(sweep: Mapping[str, Any], objective: str, title: str) -> Any:
    cells = []
    for row in sweep["rows"]:
        done = row["status"] == "done"
        cells.append(
            Cell(
                column=row["radius_mm"],
                row=row["height_mm"],
                value=row[FIGURE[objective]] if done else None,
                note="" if done else SHORT[row["broken"][0]],
                best=row["name"] == sweep["best"][objective],
                as_good=done and bool(_against(row, objective)["as_good"]),
                thesis=(row["height_mm"], row["radius_mm"]) == (140.0, 52.5),
            )
        )
    title = title.replace("`", "")
    return heat_map(cells, AXES["radius_mm"], AXES["height_mm"], "Hausdorff distance, mm", title=title)


def _write(name: str, picture: Any) -> None:
    IMAGES.mkdir(exist_ok=True)
    (IMAGES / f"rig-optimise-{name}.svg").write_bytes(picture)
