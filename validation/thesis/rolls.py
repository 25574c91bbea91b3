"""Roll between two captures, estimated from their surfaces, beside the simulated truth (section 5.1).

The thesis discards fingers whose roll differs between sessions and does not say how it finds that. Here the difference
is estimated from the surfaces (:func:`roll_between`); what the rules then keep stands beside what they keep by the
truth.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from compared import each, keep
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from splitknit.model import Reconstruction
from splitknit_match.batch.reading import Place, stored_places, surface_of
from splitknit_match.evaluation.pair import _matched_points, _ridges_on_each_other, _Side, _turn_of
from tables import Row

CASES = ("metric", "snk")
"""The first of these that a store has: its shape's tilt is measured."""
LIMITS_DEG = (8.0, 10.0, 15.0)
_ROLL_STEP_MM, _ROLL_BLOCK_MM, _ROLL_REPLICATES, _ROLL_ERROR_DEG = 0.1, 4.0, 50, 0.9
"""Pixels, blocks and draws of :func:`roll_between`, and the error of the shape, as measured here."""


def roll_between(a: Reconstruction, b: Reconstruction) -> tuple[float, float]:
    """Roll of a finger between two captures, from their surfaces: its turn about its own axis.

    The ridges say which points are the same skin; the rotation that lays B's points on A's has the roll as its turn
    about the finger's axis, after pitch and yaw are taken off. Returns the roll in A less that in B (deg; positive
    where A's skin has moved to its right) and its standard deviation (deg), of a bootstrap of blocks of 4 mm (skin that
    shifts, noise), and 0.9 deg for the shape, as measured with `metric` on simulated fingers. A shape by
    Frankot-Chellappa (`snk`) has lost part of its tilt: the roll comes out 5 to 16 % too small, and is off by 1.5 to
    1.9 deg (rms). Raises BadInput if a scale is unknown, a result holds no surface, or the ridges are not those of one
    finger. Source: Kabsch 1976, A solution for the best rotation to relate two sets of vectors; the thesis discards
    fingers by roll (section 5.1) and does not say how it finds it.
    """
    one, two = (_Side(side, max(_ROLL_STEP_MM, a.pitch_mm, b.pitch_mm)) for side in (a, b))
    first, second, firm = _matched_points(one, two, _ridges_on_each_other(one, two)[1])

    def roll(chosen: NDArray[np.intp]) -> float:
        turn = _turn_of(first[chosen], second[chosen], firm[chosen])[0].as_matrix()
        upright = [np.linalg.inv(side.input_from_upright[:2, :2]) for side in (a, b)]
        frames = [Rotation.from_euler("z", np.arctan2(part[0, 1], part[0, 0])).as_matrix() for part in upright]
        return float(Rotation.from_matrix(frames[0] @ turn @ frames[1].T).as_euler("ZXY", degrees=True)[2])

    _, block = np.unique(np.floor(second[:, :2] / _ROLL_BLOCK_MM), axis=0, return_inverse=True)
    members = [np.flatnonzero(block == number) for number in range(int(block.max()) + 1)]
    rng = np.random.default_rng(0)
    drawn = [rng.integers(0, len(members), len(members)) for _ in range(_ROLL_REPLICATES)]
    deviation = float(np.std([roll(np.concatenate([members[number] for number in one_draw])) for one_draw in drawn]))
    return roll(np.arange(len(firm))), float(np.hypot(deviation, _ROLL_ERROR_DEG))


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
