"""Where seven more lights measure slopes best: ``python validation/thesis/rig_side_lights.py`` writes a table.

Deviations of a slope by band of slant, from the information of mirror reflections behind films: the thesis's ring
alone, and with side lights of several numbers and places. A calculation: no finger is drawn.
"""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rig_candidates import (
    ALBEDO,
    FULL_PX_PER_MM,
    FULL_WELL_E,
    READ_NOISE_E,
    BuildSettings,
    PhotonSettings,
    PlannedExposure,
    RigCandidate,
    candidate_rig,
    grid,
    led_intensities,
    planned_exposure,
)
from scipy import stats

from splitknit.model import Led, side_lights
from splitknit_simulator.calibration_set.solids import unit
from splitknit_simulator.light.films import fresnel_amplitudes, reflected_through, turned_film_rad
from splitknit_simulator.light.lighting import irradiance

Array = NDArray[np.float64]
TABLE = Path(__file__).with_name("tables") / "rig" / "side_lights.csv"
COUNTS, RADII_MM, HEIGHTS_MM = (0, 2, 3, 4, 5, 6, 7), (90.0, 120.0), (20.0, 30.0, 45.0, 60.0, 80.0)
FIGURES = ("slope_0_15", "slope_15_30", "slope_30_45", "slope_45_60", "slope_median_30_45", "slope_median_45_60")


SLANTS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)  # bounds of the bands of slant
_FACET_MM, _FACET_ROUGHNESS = 1 / 37.85, 0.3
"""Side of the facet, a pixel of half the full resolution, and its GGX alpha."""


def slope_deviations(
    leds: Sequence[Led], plan: PlannedExposure | None, analyser_rad: float | None = None
) -> dict[str, float]:
    """How well a facet's slope can be known from its mirror reflection under near white `leds`, behind films.

    The difference of the parallel and the crossed image shows the reflection alone, with the noise of both images: of
    their electrons, at the planned exposure, and of reading them out. The inverse of the Fisher information of both
    slopes (S. Kay, Fundamentals of Statistical Signal Processing, 1993, equation 3.31) is the least covariance that any
    unbiased estimate has; roughness and strength are taken as known. The facet is a GGX one (B. Walter et al., EGSR
    2007, equations 20, 33, 34) in the middle of the finger plane; no finger shadows it. `analyser_rad`: axis of films
    as they are mounted, which weaken the reflection of lights in their plane; None: all reflect as unpolarised light.
    Returns for each band of slant, as ``slope_45_60``, the root mean square over azimuths, and as
    ``slope_median_45_60`` the median; ``slope_deviation`` is the geometric mean of the former over all bands.
    """
    assert plan is not None
    towards = unit(np.array([led.position_mm for led in leds]))
    halves = unit(towards + np.array([0.0, 0.0, 1.0]))
    mirror = 0.5 * np.sum(np.square(fresnel_amplitudes(halves[:, 2])), axis=0)
    if analyser_rad is not None:
        aside, to_camera = side_lights(leds), (0.0, 0.0, 1.0)
        for k, way in enumerate(towards):
            film = turned_film_rad(way, analyser_rad) if k in aside else analyser_rad
            mirror[k] = reflected_through(way, to_camera, film, analyser_rad, 0.0)
    light = np.array([float(irradiance(led, (0.0, 0.0, 0.0), way)) for led, way in zip(leds, towards, strict=True)])
    light *= plan.level / (0.5 * ALBEDO / np.pi * light.max())  # half of the diffuse light is in either image
    squared = _FACET_ROUGHNESS**2

    def masking(cosine: Array) -> Array:
        return np.asarray(2 * cosine / (cosine + np.sqrt(squared + (1 - squared) * cosine * cosine)))

    def mirrored(p: Array, q: Array) -> tuple[Array, Array]:
        normal = unit(np.stack([-p, -q, np.ones_like(p)], axis=-1))
        lit, half = np.clip(normal @ towards.T, 1e-4, 1.0), normal @ halves.T
        lobe = squared / (np.pi * (half * half * (squared - 1) + 1) ** 2)
        shine = lobe * masking(lit) * masking(normal[..., 2:]) * mirror / (4 * normal[..., 2:])
        return np.where(lit > 1e-3, light * shine, 0.0), light * lit

    step, pixels, full_e = 1e-4, (_FACET_MM * FULL_PX_PER_MM) ** 2, FULL_WELL_E / plan.gain
    figures: dict[str, float] = {}
    azimuth = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    for low, high in itertools.pairwise(SLANTS_DEG):
        slope = np.tan(np.deg2rad(np.linspace(low, high, 9)))[:, None]
        p, q = slope * np.cos(azimuth), slope * np.sin(azimuth)
        shine, lit = mirrored(p, q)
        by = [(mirrored(p + a, q + b)[0] - mirrored(p - a, q - b)[0]) / (2 * step) for a, b in ((step, 0), (0, step))]
        variance = ((shine + ALBEDO / np.pi * lit) / full_e + 2 * (READ_NOISE_E / full_e) ** 2) / pixels
        pp, pq, qq = (np.sum(by[i] * by[j] / variance, axis=-1) for i, j in ((0, 0), (0, 1), (1, 1)))
        error = (pp + qq) / np.maximum(2 * (pp * qq - pq * pq), 1e-12)
        for name, average in (("slope", np.mean), ("slope_median", np.median)):
            figures[f"{name}_{low:.0f}_{high:.0f}"] = float(np.sqrt(average(error)))
    overall = [value for name, value in figures.items() if "median" not in name]
    return {**figures, "slope_deviation": float(stats.gmean(overall))}


def of_candidate(candidate: RigCandidate) -> tuple[tuple[Led, ...], PlannedExposure | None]:
    """White LEDs of a candidate, and their exposure."""
    build = BuildSettings()
    leds = candidate_rig(candidate, build, led_intensities(candidate, build, ("white",))).leds
    return leds, planned_exposure(leds, "white", PhotonSettings())


def main() -> None:
    """Write the table."""
    rows: list[list[object]] = [["side lights", "radius mm", "height mm", *FIGURES, "slope_deviation"]]
    for one in grid((140.0,), (52.5,), (1.0,), (None,), (12.0,), COUNTS, RADII_MM, HEIGHTS_MM):
        found = slope_deviations(*of_candidate(one))
        place = (one.side_radius_mm, one.side_height_mm) if one.side else ("", "")
        rows.append([one.side, *place, *(f"{found[name]:.3g}" for name in (*FIGURES, "slope_deviation"))])
    seven, plan = of_candidate(RigCandidate(140.0, 52.5, 1.0, side=7))
    ring = [led.position_mm for led in seven[:7]]
    around = [(90.0 * math.cos(a), 90.0 * math.sin(a), 30.0) for a in (2 * math.pi * k / 7 for k in range(7))]
    circle = [replace(led, position_mm=place) for led, place in zip(seven, ring + around, strict=True)]
    for words, leds, axis in (
        ("7 around the whole circle", circle, None),
        ("7, films along x", seven, 0.0),
        ("7, films along y", seven, math.pi / 2),
    ):
        found = slope_deviations(leds, plan, axis)
        rows.append([words, 90.0, 30.0, *(f"{found[name]:.3g}" for name in (*FIGURES, "slope_deviation"))])
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
