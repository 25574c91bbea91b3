"""Figures of a print's quality, NFIQ 2, and what they should foretell, for captures of a population and a store.

Used by ``validation/prints/quality.py``.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from splitknit.io.npz import read_npz
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.reading import stored_places
from splitknit_match.batch.store import Store
from splitknit_match.batch.surfaces import unpack_surface
from splitknit_match.matching.minutiae import extract, nfiq2
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.template import unpack
from splitknit_match.prints.folder import advice
from splitknit_match.prints.make import Print, enhance, make_print, measured
from splitknit_match.prints.sources import Source

HALF_PERIOD_PX = 5.0
"""A true minutia is found if one lies within half a ridge period."""
MARGIN_PX = 13
"""True minutiae nearer to the outline are not asked for."""


def facts_of(source: Source, minutiae_px: np.ndarray | None) -> dict:
    """Quality of the unrolled print of a finger, NFIQ 2, and the fraction of the true minutiae that are found in it."""
    made = make_print(source, "unroll")
    found = measured(made, enhance(made, 500.0), 500.0)
    facts = {
        "figures": asdict(found.figures),
        "ours": found.score,
        "nfiq2": nfiq2(made.image),
        "advice": list(advice(found)),
    }
    if minutiae_px is not None:
        facts["recall"] = recall(made, minutiae_px)
    return facts


def recall(made: Print, minutiae_px: np.ndarray) -> float | None:
    """Fraction of the true minutiae (N, 2; column, row of the input) that mindtct finds on the print; None below 10."""
    true = made.map.print_from_input(minutiae_px)
    inside = cv2.erode((made.weight > 0.5).astype(np.uint8), np.ones((2 * MARGIN_PX + 1,) * 2)) > 0
    rows, columns = inside.shape
    known = np.isfinite(true).all(axis=1) & (true > 0).all(axis=1) & (true < [columns - 1, rows - 1]).all(axis=1)
    at = np.rint(true[known]).astype(int)
    true = true[known][inside[at[:, 1], at[:, 0]]]
    got = extract(made.image)
    if len(true) < 10:
        return None
    if len(got.x_px) == 0:
        return 0.0
    distance, _ = cKDTree(np.stack([got.x_px, got.y_px], axis=1)).query(true)
    return float((distance < HALF_PERIOD_PX).mean())


def capture_facts(store: Store, population: Path, names: list[str], case: str = "metric") -> list[dict]:
    """Facts of captures, with the mean similarity of each with the finger's other sessions."""
    places = stored_places(store.files("features", case))
    rows = []
    for name in names:
        chunk = read_chunk(places[name].file, ["images"])["images"]
        surface = unpack_surface(chunk[places[name].row])
        source = Source(
            "result", surface.mask, surface.pitch_mm, surface.input_from_upright, surface.upright_size, None,
            surface.ridge_mm, surface.shape_mm,
        )  # fmt: skip
        truth = read_npz(population / name / "truth.npz")
        facts = facts_of(source, truth["landmark_minutiae_px"])
        subject, session, finger = name.split("/")
        others = [f"{subject}/session_{k}/{finger}" for k in range(1, 5) if f"session_{k}" != session]
        templates = {
            other: read_chunk(places[other].file, ["template"])["template"][places[other].row]
            for other in [name, *others]
            if other in places
        }
        own = unpack(templates.pop(name))
        similar = [ridge_match(own, unpack(payload)).similarity for payload in templates.values() if payload]
        facts["similarity"] = float(np.mean(similar)) if similar else None
        facts["partial"] = bool(truth["impression_partial"])
        facts["moisture"] = float(truth["impression_moisture"])
        rows.append({"capture": name, **facts})
    return rows
