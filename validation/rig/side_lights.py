"""Where seven more lights measure slopes best: ``python validation/rig/side_lights.py`` writes tables/side_lights.csv.

Deviations of a slope by band of slant, from the information of mirror reflections behind films (``splitknit rig
optimise --objective slopes``): the thesis's ring alone, and with side lights of several numbers and places.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from splitknit import csv_text
from splitknit_rig.rig.candidates import RigCandidate, candidate_rig, grid, led_intensities, planned_exposure
from splitknit_rig.rig.optimise import Study, evaluate_candidate, slope_deviations

TABLE = Path(__file__).with_name("tables") / "side_lights.csv"
COUNTS, RADII_MM, HEIGHTS_MM = (0, 2, 3, 4, 5, 6, 7), (90.0, 120.0), (20.0, 30.0, 45.0, 60.0, 80.0)
FIGURES = ("slope_0_15", "slope_15_30", "slope_30_45", "slope_45_60", "slope_median_30_45", "slope_median_45_60")


def main() -> None:
    """Write the table."""
    rows: list[list[object]] = [["side lights", "radius mm", "height mm", *FIGURES, "slope_deviation"]]
    for one in grid((140.0,), (52.5,), (1.0,), (None,), (12.0,), COUNTS, RADII_MM, HEIGHTS_MM):
        record = evaluate_candidate(one, Study("information", 1))
        figures = [f"{record['mean'][name]:.3g}" for name in (*FIGURES, "slope_deviation")]
        place = (one.side_radius_mm, one.side_height_mm) if one.side else ("", "")
        rows.append([one.side, *place, *figures])
    study = Study("information", 1)
    rig = candidate_rig(seven := RigCandidate(140.0, 52.5, 1.0, side=7), study.build, led_intensities(
        seven, study.build, ("white",)))  # fmt: skip
    ring = [led.position_mm for led in rig.leds[:7]]
    around = [(90.0 * math.cos(a), 90.0 * math.sin(a), 30.0) for a in (2 * math.pi * k / 7 for k in range(7))]
    circle = [replace(led, position_mm=place) for led, place in zip(rig.leds, ring + around, strict=True)]
    plan = planned_exposure(rig.leds, "white", study.photons)
    for words, leds, axis in (
        ("7 around the whole circle", circle, None),
        ("7, films along x", rig.leds, 0.0),
        ("7, films along y", rig.leds, math.pi / 2),
    ):
        found = slope_deviations(leds, plan, axis)
        rows.append([words, 90.0, 30.0, *(f"{found[name]:.3g}" for name in (*FIGURES, "slope_deviation"))])
    TABLE.write_text(csv_text(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
