"""Reconstruct one case by several presets and measure it against its truth."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import splitknit
import splitknit_simulator
from splitknit.reconstruction import Reconstruction
from splitknit_simulator.accuracy import Comparison, compare
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

CREASE_TOLERANCE_MM = 1.0
"""A cut that lies further below the crease has kept skin of the next phalanx."""
SIDE_LINES_MM = 3.4
"""Lines beside the crease belong to the same joint; where a finger has any, a cut at the uppermost
is right as well."""
IN_VIEW_MM = 1.5
"""A crease nearer to the lower border than this is too close to judge."""


Truth = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Case:
    """One capture of one finger; everything is drawn from the twin's own ranges."""

    seed: int
    impression: int = 0
    scale: float = 0.5

    @property
    def name(self) -> str:
        """Unique, fit for a file."""
        return f"population_{self.impression}_{self.seed:05d}"


def source_hash() -> str:
    """SHA-256 of the sources of core and simulator: results of other code are not mixed with
    these."""
    digest = hashlib.sha256()
    for folder in (
        Path(str(member.__file__)).parent for member in (splitknit, splitknit_simulator)
    ):
        for file in sorted(folder.rglob("*")):
            if file.suffix in (".py", ".npz", ".onnx"):
                digest.update(file.relative_to(folder.parent).as_posix().encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()


def measure(case: Case, presets: Sequence[str]) -> dict[str, Any]:
    """Everything that is known of one case, as plain numbers and words."""
    started = time.perf_counter()
    settings = TwinSettings(scale=case.scale)
    capture, truth = simulate_capture(case.seed, None, settings, impression=case.impression)
    measured: dict[str, Any] = {
        "seed": case.seed,
        "impression": case.impression,
        "drawn": _drawn(truth),
        "simulate_s": time.perf_counter() - started,
        "presets": {},
    }
    side_lines = draw_finger(case.seed).skin.creases[0].side_lines > 0
    for preset in presets:
        measured["presets"][preset] = _attempt(capture, truth, preset, side_lines)
    return measured


def _attempt(capture: Any, truth: Truth, preset: str, side_lines: bool) -> dict[str, Any]:
    started = time.perf_counter()
    try:
        result = splitknit.reconstruct(capture, preset)
        seconds = time.perf_counter() - started
        comparison = compare(result, truth)
    except splitknit.BadInput as error:  # a refusal is a result: it is counted
        return {"refused": str(error)}
    except Exception as error:  # so is an internal error
        return {"refused": f"{type(error).__name__}: {error}"}
    figures = {
        **comparison.figures,
        **_pose_figures(result, truth, side_lines),
        **_honesty(result, comparison),
    }
    return {"figures": figures, "seconds": seconds, "warnings": list(result.warnings)}


def _drawn(truth: Truth) -> dict[str, Any]:
    """What the finger, its skin and its pose are."""
    names = [n for n in truth if n.startswith("skin_") and truth[n].size == 1] + [
        f"landmark_{n}"
        for n in ("pattern", "yaw_rad", "pitch_rad", "roll_rad", "insertion_mm", "period_mm")
    ]
    return {name.removeprefix("landmark_"): truth[name].item() for name in names}


def _pose_figures(result: Reconstruction, truth: Truth, side_lines: bool) -> dict[str, float]:
    """Yaw, and whether the first crease was found, or rightly not found."""
    yaw = result.facts["yaw_deg"] - float(np.rad2deg(truth["landmark_yaw_rad"]))
    figures = {"yaw_error_deg": abs(yaw)}
    distance = crease_distance_mm(result.facts, truth["landmark_crease_px_0"], result.pitch_mm)
    view = _crease_in_view(truth, result.pitch_mm)
    if distance is not None:
        figures["crease_error_mm"] = abs(distance)
    above = SIDE_LINES_MM if side_lines else CREASE_TOLERANCE_MM
    right = distance is not None and -CREASE_TOLERANCE_MM < distance < above
    if view is None:  # at the border of the picture: seeing it and not seeing it are both right
        right = right or not result.facts["crease_found"]
    elif not view:
        right = not result.facts["crease_found"]
    return {**figures, "crease_right": float(right)}


def _crease_in_view(truth: Truth, pitch_mm: float) -> bool | None:
    """Whether the first crease is in the picture; None where it is at its lower border."""
    points = truth["landmark_crease_px_0"]
    if len(points) < 4:
        return False
    below_mm = (truth["mask"].shape[0] - 1 - points[:, 1]) * pitch_mm
    if float(np.quantile(below_mm, 0.25)) > IN_VIEW_MM:
        return True
    return False if float(np.quantile(below_mm, 0.75)) < 0.3 * IN_VIEW_MM else None


def crease_distance_mm(
    facts: Mapping[str, Any], points: NDArray[Any], pitch_mm: float
) -> float | None:
    """Median distance of the line that was found from the middle half of the true crease (N, 2);
    positive: above it."""
    if not facts.get("crease_found") or not facts.get("crease_line") or len(points) < 4:
        return None
    first, last = sorted(
        (np.asarray(end, dtype=np.float64) for end in facts["crease_line"]), key=lambda end: end[0]
    )
    low, high = np.quantile(points[:, 0], (0.25, 0.75))
    middle = points[(points[:, 0] >= low) & (points[:, 0] <= high)]
    along = (last - first) / np.linalg.norm(last - first)
    offset = middle - first
    return float(np.median(offset[:, 1] * along[0] - offset[:, 0] * along[1])) * pitch_mm


def _honesty(result: Reconstruction, comparison: Comparison) -> dict[str, float]:
    """How the ridge band's error compares with the uncertainty that the result carries."""
    if result.uncertainty_um is None:
        return {}
    error = np.abs(comparison.ridge_error_um[comparison.band])
    expected = result.uncertainty_um[comparison.band]
    known = np.isfinite(error) & np.isfinite(expected)
    error, expected = error[known], expected[known]
    return {
        "uncertainty_ratio": float(np.sqrt(np.mean(error**2) / np.mean(expected**2))),
        "within_one_sigma": float(np.mean(error <= expected)),
    }
