"""Print the tables of ``results.json``, ``inversion.json`` and ``chain.json``, and write the first into
``docs/experiments/simulator-reference.md``, between its markers.

python validation/twin/tables.py
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "experiments" / "simulator-reference.md"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"
CHANNELS = ("blue", "green", "red", "nir")
BOUNDARIES = ("diffuse", "smooth")
SLANTS = ("below_20_deg", "20_to_40_deg")


def main() -> int:
    results = json.loads((HERE / "results.json").read_text())
    blocks = [*ridge_tables(results["ridges"]), *other_tables(results), *range_table(results["ranges"])]
    inversion = HERE / "inversion.json"
    if inversion.exists():
        blocks += inversion_table(json.loads(inversion.read_text())["crops"])
    chain = HERE / "chain.json"
    if chain.exists():
        blocks += chain_table(json.loads(chain.read_text()))
    print("\n\n".join(blocks))
    before, rest = PAGE.read_text().split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(before + BEGIN + "\n\n" + "\n\n".join(blocks[:2]) + "\n\n" + END + after)
    return 0


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "| " + " | ".join("---" for _ in head) + " |"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def ridge_tables(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    usual = [r for r in rows if _at(r, 75.0, 1.0) and r["print_seed"] == 5]
    yield (
        "**Ridges of 75 um** (flat crop of 1.7 mm, mean of seven LEDs). Contrast: standard deviation over mean. With "
        "height, with slope: relative light per standard deviation of the relief's height (23 um), and of its slope "
        "towards the LED (0.28). Drift: how far each LED's light comes out on the LED's far side, in units of "
        "sin(refracted angle) / (scattering + 0.35 absorption)."
    )
    head = ("boundary, channel", "k, %/um: reference / twin", "contrast: reference / twin",
            "with height: reference / twin", "with slope: reference / twin", "drift")  # fmt: skip
    body = [
        [
            f"{r['boundary']}, {r['channel']}",
            f"{pm(r, 'k_percent_per_um', 'k_error')} / {r['k_twin']:.3f}",
            f"{pm(r, 'contrast', 'contrast_error')} / {r['contrast_twin']:.3f}",
            f"{pm(r, 'with_height', 'with_height_error', 4)} / {r['with_height_twin']:.4f}",
            f"{pm(r, 'with_slope', 'with_slope_error', 4)} / {r['with_slope_twin']:.4f}",
            pm(r, "drift", "drift_error", 2),
        ]
        for r in usual
    ]
    yield table(head, body)
    own = [r for r in rows if r["print_seed"] == 5]
    depths = {f"{d:g} um": [r for r in own if _at(r, d, 1.0)] for d in (40.0, 60.0, 75.0, 90.0)}
    factors = {f"x{f:g}": [r for r in own if _at(r, 75.0, f)] for f in (0.5, 0.7, 1.0, 1.4, 2.0)}
    yield "**Relief gain** k / (effective attenuation), dimensionless; the twin's is 0.78. By ridge depth:"
    yield _grid(depths, "relief_gain")
    yield "By scattering factor, at 75 um:"
    yield _grid(factors, "relief_gain")
    yield "**Drift**, by scattering factor, at 75 um:"
    yield _grid(factors, "drift")
    blue = [r for r in rows if _at(r, 75.0, 1.0) and r["channel"] == "blue"]
    parts = [
        f"{boundary} "
        + ", ".join(pm(r, "relief_gain", "relief_gain_error", 2) for r in blue if r["boundary"] == boundary)
        for boundary in BOUNDARIES
    ]
    yield f"Three prints (blue, 75 um), relief gain: {'; '.join(parts)}."


def _at(row: dict[str, Any], depth_um: float, factor: float) -> bool:
    return bool(row["depth_um"] == depth_um and row["factor"] == factor)


def _grid(columns: dict[str, list[dict[str, Any]]], what: str) -> str:
    body = []
    for boundary in BOUNDARIES:
        for channel in CHANNELS:
            line = [f"{boundary}, {channel}"]
            for rows in columns.values():
                found = [r for r in rows if r["boundary"] == boundary and r["channel"] == channel]
                line.append(pm(found[0], what, what + "_error", 2) if found else "")
            if any(line[1:]):
                body.append(line)
    return table(("boundary, channel", *columns), body)


def other_tables(results: dict[str, Any]) -> Iterator[str]:
    if results.get("glare"):
        yield "**Glare** (flat crop; the twin's level over the reference's, contrast of both, pixel correlation):"
        yield table(
            ("ridges, roughness", "level", "contrast: reference / twin", "correlation", "reflected twice or more"),
            [
                [
                    f"{r['depth_um']:g} um, {r['roughness']:g}",
                    pm(r, "level_twin_over_reference", "level_error"),
                    f"{r['contrast']:.3f} / {r['contrast_twin']:.3f}",
                    f"{r['correlation']:.4f}",
                    f"{100 * r['reflected_twice_or_more']:.1f} %",
                ]
                for r in results["glare"]
            ],
        )
    if results.get("finger"):
        yield (
            "**Low frequencies** of a whole finger (12.7 mm square of its pad, mean over 0.6 mm, one scale for all "
            "LEDs of a channel and range of slants): relative rms difference, the reference's noise taken out."
        )
        yield table(
            ("boundary, channel", "slant below 20 deg", "20 to 40 deg", "level there: twin / reference"),
            [
                [
                    f"{r['boundary']}, {r['channel']}",
                    *(_rms(r[part]) for part in SLANTS),
                    " and ".join(f"{r[part]['level_twin_over_reference']:.2f}" for part in SLANTS),
                ]
                for r in results["finger"]
            ],
        )  # fmt: skip


def _rms(part: dict[str, float]) -> str:
    if part["rms"] < 0.5 * part["noise"]:
        return f"below the noise of {100 * part['noise']:.0f} %"
    return f"{100 * part['rms']:.1f} %"


def range_table(ranges: dict[str, Any]) -> Iterator[str]:
    low, high = ranges["relief_gain_drawn_from"]
    yield (
        f"**Ranges** over the cases with scattering 0.7 to 1.4 (5th to 95th percentile; fingers are drawn with relief "
        f"gains of {low:g} to {high:g}, and without drift):"
    )
    yield table(
        ("boundary", "cases", "relief gain: mean, range", "drift: mean, range"),
        [
            [
                boundary,
                str(ranges[boundary]["relief_gain"]["cases"]),
                *(
                    f"{one['weighted_mean']:.2f}, {one['low']:.2f} to {one['high']:.2f}"
                    for one in (ranges[boundary]["relief_gain"], ranges[boundary]["drift"])
                ),
            ]
            for boundary in ("diffuse", "smooth")
            if boundary in ranges
        ],
    )
    outside = ", ".join(
        f"{c['boundary']} {c['channel']} {c['depth_um']:g} um x{c['factor']:g} ({c['relief_gain']:.2f})"
        for c in ranges["cases_outside"]
    )
    yield (
        f"Cases whose 90 % interval lies outside what fingers are drawn from: {outside or 'none'} of {ranges['cases']}."
    )


def inversion_table(crops: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield (
        "**Inversion of the blur on the reference's light** (flat crop of 3.4 mm, diffuse boundary, seven white LEDs; "
        "correlation, gain, rms in um of the ridge band):"
    )
    rows = []
    for crop in crops:
        for kind in (k for k in ("volume", "with_glare", "twin") if k in crop):
            ways = ("blue_blurred", "red", "green", "blue", "all")
            label = f"{crop['depth_um']:g} um, x{crop['factor']:g} (assumed x{crop['assumed_factor']:g}), {kind}"
            rows.append([label.replace("_", " "), *(three(crop[kind][way]) for way in ways)])
    painted = "; 'twin': the fast twin's volume light, without noise" if any("twin" in crop for crop in crops) else ""
    yield f"'volume': glare left out; 'with glare': left in{painted}."
    yield table(("crop", "blue, not inverted", "red", "green", "blue", "all three"), rows)


def chain_table(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield (
        "**The whole `metric` chain** on a curved crop of 5 mm, without outline and near-infrared band (glare left in "
        "except for 'volume'; drift: volume light moved away from each LED by so many drifts):"
    )
    head = ("crop", "way", "light", "correlation, gain, rms um")
    yield table(head, [[r["crop"].split("-r8")[0], r["way"], r["light"], three(r)] for r in rows])


def three(found: dict[str, float]) -> str:
    return f"{found['correlation']:.3f}, {found['gain']:.2f}, {found['rms_um']:.1f}"


def pm(row: dict[str, Any], value: str, error: str, digits: int = 3) -> str:
    if value == "drift" and row[value] > 2.49:
        return "over 2.5"  # the end of the search
    return f"{row[value]:.{digits}f} +- {row[error]:.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())
