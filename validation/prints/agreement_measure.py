"""What is measured of one capture's prints; plain numbers, kept on disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from agreement_compare import table
from agreement_phase import phase_minutiae
from agreement_truth import Truth, true_source
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.observation.observe import observe
from splitknit_match.batch.store import Store
from splitknit_match.prints.make import Print, enhance, make_print
from splitknit_match.prints.minutiae import extract
from splitknit_match.prints.sources import Source
from splitknit_match.records.minutiae_record import Minutiae, pack_minutiae

PX_PER_MM = 500.0 / 25.4
METHODS = {"metric": ("relief", "unroll", "curvature", "photo")}
OTHERS = ("relief", "unroll", "curvature")
"""Of the other presets and of the true surface; the photograph is the same for all."""
Array = NDArray[np.float64]


class Surfaces:
    """Reconstructions in a store."""

    def __init__(self, folder: Path) -> None:
        self.store = Store(folder)
        self.places: dict[str, Any] = {}

    def source(self, case: str, capture: str) -> Source | None:
        """A reconstruction as prints need it; its height is shape and relief together."""
        if case not in self.places:
            self.places[case] = self.store.places("features", case)
        where = self.places[case].get(capture)
        s = None if where is None else where.surface()
        if s is None:
            return None
        return Source(
            "result",
            s.mask,
            s.pitch_mm,
            s.input_from_upright,
            s.upright_size,
            s.ridge_mm + s.shape_mm,
            s.ridge_mm,
            s.shape_mm,
            preset=case,
        )


def photograph(folder: Path) -> NDArray[np.float32]:
    """As ``--method photo`` prints it."""
    capture = read_capture(folder)
    light = observe(capture).white.stack[2]
    return np.asarray(light.mean(axis=0), dtype=np.float32)


def prints_of(source: Source, truth: Truth, methods: tuple[str, ...]) -> dict[str, Any]:
    """Records of all methods on one surface."""
    rows: dict[str, Any] = {}
    for method in methods:
        try:
            finger_print = make_print(source, method)
            better = enhance(finger_print)
        except BadInput as error:
            rows[method] = {"refused": str(error)}
            continue
        rows[method] = {
            "print": against_truth(extract(finger_print.image), finger_print, truth),
            "enhanced": against_truth(extract(better.image), finger_print, truth),
            "phase": against_truth(phase_minutiae(finger_print.image, better), finger_print, truth),
        }
    return rows


def border_px(known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) distance from the nearest pixel that is not `known`, beyond the picture none is."""
    padded = np.pad(known.astype(np.uint8), 1)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1])


def directions_on_print(laid, points, angles_rad):
    """Directions (N,) on the print of directions at places (N, 2) of the input; both
    counter-clockwise as seen."""
    step = 0.5 * np.stack([np.cos(angles_rad), -np.sin(angles_rad)], axis=1)  # rows run downwards
    along = laid.print_from_input(points + step) - laid.print_from_input(points - step)
    return np.arctan2(-along[:, 1], along[:, 0])


def against_truth(minutiae: Minutiae, finger_print: Print, truth: Truth) -> dict[str, Any]:
    """Record of a print's minutiae; true ones are those whose place in the picture the print
    shows."""
    border = border_px(finger_print.weight > 0.5)
    there = finger_print.map.print_from_input(truth.places_px)
    angle = np.full(len(there), np.nan)
    known = np.isfinite(truth.directions_rad) & np.isfinite(there).all(axis=1)
    angle[known] = directions_on_print(
        finger_print.map, truth.places_px[known], truth.directions_rad[known]
    )
    on = _sampled(border, there) > 0
    true = {
        "place": there[on],
        "direction": angle[on],
        "border": _sampled(border, there)[on],
        "slant": truth.slant_at(truth.places_px)[on],
    }
    place = np.stack([minutiae.x_px, minutiae.y_px], 1).astype(np.float64)
    back = finger_print.map.input_from_print(place)
    beside = ~np.isfinite(back).all(axis=1)
    back[beside] = -100.0
    detected = {
        "place": place,
        "direction": minutiae.direction_rad,
        "border": _sampled(border, place),
        "slant": truth.slant_at(back),
    }
    record = table(detected, true, 0.5 * truth.period_mm * PX_PER_MM)
    return record | {"minutiae": pack_minutiae(minutiae).hex()}


def _sampled(values: NDArray[np.float32], places: Array) -> Array:
    """Nearest value; 0 beside the picture."""
    result = np.zeros(len(places))
    good = np.isfinite(places).all(axis=1)
    at = np.rint(places[good]).astype(np.intp)
    inside = (at >= 0).all(axis=1) & (at[:, 0] < values.shape[1]) & (at[:, 1] < values.shape[0])
    rows = np.flatnonzero(good)[inside]
    result[rows] = values[at[inside, 1], at[inside, 0]]
    return result


def capture_record(
    population: Path, surfaces: Surfaces, truth: Truth, capture: tuple[str, int, str], preset: str
) -> dict[str, Any] | None:
    """All prints of one capture by one preset (``truth``: of the true surface, on the mask of
    ``metric``); None where the store lacks it."""
    subject, session, finger = capture
    name = f"{subject}/session_{session}/{finger}"
    source = surfaces.source("metric" if preset == "truth" else preset, name)
    if source is None:
        return None
    if preset == "truth":
        source = true_source(truth, source)
    methods = METHODS.get(preset, OTHERS)
    if "photo" in methods:
        source = replace(source, photo=photograph(population / name))
    return prints_of(source, truth, methods)
