"""Roll between two captures, estimated from their surfaces, beside the simulated truth (section 5.1).

The thesis discards fingers whose roll differs between sessions and does not say how it finds that. Here the difference
is estimated from the surfaces (:func:`splitknit_match.evaluation.pair.roll_between`); what the rules then keep stands
beside what they keep by the truth.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from compared import each, keep

from splitknit.model import Reconstruction
from splitknit_match.batch.reading import Place, stored_places, surface_of
from splitknit_match.evaluation.pair import roll_between
from tables import Row

CASES = ("metric", "snk")
"""The first of these that a store has: its shape's tilt is measured."""
LIMITS_DEG = (8.0, 10.0, 15.0)


def estimated(files: Sequence[Any], names: Sequence[str], scratch: Path, jobs: int) -> list[Row]:
    """One row for each two captures of a finger: ``a``, ``b``, ``roll_deg`` and ``deviation_deg``.

    The last two are None where the ridges do not match. Each finger is kept in `scratch`.
    """
    places = stored_places(list(files))
    fingers: dict[str, list[str]] = {}
    for name in sorted(names):
        subject, _, finger = name.split("/")
        fingers.setdefault(f"{subject}_{finger}", []).append(name)
    scratch.mkdir(parents=True, exist_ok=True)
    each(partial(_keep, places, scratch), list(fingers.items()), jobs)
    return [row for finger in fingers for row in json.loads((scratch / f"{finger}.json").read_text(encoding="utf-8"))]


def _keep(places: Mapping[str, Place], scratch: Path, finger: tuple[str, Sequence[str]]) -> None:
    file = scratch / f"{finger[0]}.json"
    if file.is_file():
        return
    results = {name: found for name in finger[1] if (found := _result(places.get(name))) is not None}
    names = sorted(results)
    rows: list[Row] = []
    for k, b in enumerate(names):
        for a in names[:k]:
            try:
                roll, deviation = roll_between(results[a], results[b])
            except ValueError:  # the ridges of the two do not match: a failure to compare
                roll, deviation = None, None
            rows.append({"a": a, "b": b, "roll_deg": roll, "deviation_deg": deviation})
    keep(file, lambda stream: stream.write(json.dumps(rows).encode("ascii")))


def _result(place: Place | None) -> Reconstruction | None:
    surface = None if place is None else surface_of(place)
    if surface is None:
        return None
    return Reconstruction(
        height_mm=surface.shape_mm + surface.ridge_mm,
        ridge_mm=surface.ridge_mm,
        shape_mm=surface.shape_mm,
        mask=surface.mask,
        normals=surface.normals,
        albedo=surface.ridge_mm,
        pitch_mm=surface.pitch_mm,
        input_from_upright=surface.input_from_upright,
        upright_size=surface.upright_size,
        preset="",
        whole=surface.whole,
    )


def beside_truth(rows: Sequence[Row], truth: Mapping[str, Row]) -> list[Row]:
    """The same rows with ``true_deg``."""
    both = [[float(truth[row[side]]["roll_deg"]) for side in ("a", "b")] for row in rows]
    return [row | {"true_deg": a - b} for row, (a, b) in zip(rows, both, strict=True)]


def agreement(rows: Sequence[Row], seed: int) -> Row:
    """How far estimates and truth agree; intervals of 95 % drawn by finger."""
    known = [row for row in rows if row["roll_deg"] is not None]
    if len(known) < 3:
        return {"pairs": len(known), "without": len(rows) - len(known)}
    true, found, deviation = (
        np.array([row[key] for row in known]) for key in ("true_deg", "roll_deg", "deviation_deg")
    )
    finger = np.unique([row["a"].split("/")[0] + row["a"].split("/")[2] for row in known], return_inverse=True)[1]
    rng = np.random.default_rng([seed, 51])

    def of(chosen: Any) -> dict[str, float]:
        error = found[chosen] - true[chosen]
        return {
            "rms_deg": float(np.sqrt(np.mean(error**2))),
            "median_deg": float(np.median(np.abs(error))),
            "slope": float(np.polyfit(true[chosen], found[chosen], 1)[0]) if np.ptp(true[chosen]) > 0 else np.nan,
            "within_two_deviations": float(np.mean(np.abs(error) < 2.0 * deviation[chosen])),
        }

    members = [np.flatnonzero(finger == k) for k in range(int(finger.max()) + 1)]
    draws = [of(np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))])) for _ in range(300)]
    facts: Row = {"pairs": len(known), "without": len(rows) - len(known), "fingers": len(members)}
    for name, value in of(slice(None)).items():
        low, high = np.nanquantile([draw[name] for draw in draws], (0.025, 0.975))
        facts[name] = [round(value, 3), round(float(low), 3), round(float(high), 3)]
    for limit in LIMITS_DEG:
        by_truth, by_estimate = np.abs(true) > limit, np.abs(found) > limit
        both = by_truth & by_estimate
        counts = (("by truth", by_truth), ("by estimate", by_estimate), ("by both", both))
        facts[f"above_{limit:g}_deg"] = {words: int(part.sum()) for words, part in counts}
    return facts
