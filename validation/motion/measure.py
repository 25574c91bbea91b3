"""One moving finger, reconstructed as it is, with its motion undone, and with the true motion
undone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from captures import capture_folder
from numpy.typing import NDArray

from splitknit import read_capture, reconstruct
from splitknit.capture import Capture
from splitknit.errors import BadInput
from splitknit.reconstruction import Reconstruction
from splitknit_simulator.accuracy import compare

Truth = Mapping[str, NDArray[Any]]
MARGIN_MM = 1.0


def loaded(folder: Path) -> tuple[Capture, dict[str, NDArray[Any]]]:
    """Capture and truth of a folder."""
    with np.load(folder / "truth.npz") as archive:
        return read_capture(folder), {name: archive[name] for name in archive.files}


def figures(result: Reconstruction, truth: Truth) -> dict[str, float]:
    """What counts of a comparison with the truth."""
    compared = compare(result, truth).figures
    return {
        "ridge_correlation": compared["ridge_correlation"],
        "shape_rms_mm": compared["shape_rms_mm"],
    }


def still_row(seed: int, scale: float) -> dict[str, Any]:
    """A finger that lies still, with the default settings."""
    capture, truth = loaded(capture_folder(seed, 0.0, scale))
    result = reconstruct(capture)
    plain = reconstruct(capture, settings={"motion.correct": "off"})
    same = all(
        np.array_equal(getattr(result, n), getattr(plain, n), equal_nan=True)
        for n in ("height_mm", "ridge_mm")
    )
    return {
        "seed": seed,
        "still": figures(result, truth),
        "left_alone": "motion" not in result.facts,
        "same": same,
    }


def moved_row(seed: int, amplitude_mm: float, scale: float) -> dict[str, Any]:
    """A finger that moves."""
    capture, truth = loaded(capture_folder(seed, amplitude_mm, scale))
    row: dict[str, Any] = {"seed": seed, "amplitude_mm": amplitude_mm}
    plain = reconstruct(capture, settings={"motion.correct": "off"})
    row["uncorrected"] = figures(plain, truth)
    try:
        result = reconstruct(capture)
    except BadInput as error:
        row["refused"] = str(error)
    else:
        row["corrected"] = figures(result, truth)
        row["undone"] = "motion" in result.facts
        if row["undone"]:
            row["error_um"] = {name: flow_error_um(result, truth, name) for name in capture.bands}
    row["oracle"] = figures(
        reconstruct(undone(capture, truth), settings={"motion.correct": "off"}), truth
    )
    return row


def true_maps(truth: Truth, shot: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows (H, W) at which a shot shows the skin of the reference, continued beyond the
    finger."""
    rows, columns = truth["motion_rows"], truth["motion_columns"]
    flow = truth["motion_flow_px"][shot]
    known = np.isfinite(flow[0])
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    height, width = truth["mask"].shape
    step = rows[1] - rows[0]
    place = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    on_grid = [
        ((p - first) / step).astype(np.float32)
        for p, first in zip(place, (columns[0], rows[0]), strict=True)
    ]
    maps = []
    for part, where in zip(flow, place, strict=True):
        values = np.zeros(labels.max() + 1, dtype=np.float32)
        values[labels[known]] = part[known]
        shift = cv2.remap(
            values[labels], *on_grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        maps.append((where + shift).astype(np.float32))
    return maps[0], maps[1]


def undone(capture: Capture, truth: Truth) -> Capture:
    """The capture with the true motion undone."""
    bands, shot = {}, 0
    for name, band in capture.bands.items():
        pixels = band.pixels.copy()
        for k in range(len(pixels)):
            if shot != int(truth["motion_reference"]):
                pixels[k] = cv2.remap(
                    band.pixels[k],
                    *true_maps(truth, shot),
                    cv2.INTER_CUBIC,
                    borderMode=cv2.BORDER_REPLICATE,
                )
            shot += 1
        bands[name] = replace(band, pixels=pixels)
    return replace(capture, bands=bands)


def flow_error_um(result: Reconstruction, truth: Truth, name: str) -> float:
    """Root mean square of the error of a band's shifts, over the finger's core and all its shots.

    The shifts are those that the report gives: mean and turn of every shot, which is all that the
    default undoes.
    """
    reported = result.facts[f"motion_{name}"]
    rows, columns = truth["motion_rows"], truth["motion_columns"]
    core = (
        cv2.erode(
            result.mask.astype(np.uint8),
            np.ones((3, 3)),
            iterations=round(MARGIN_MM / result.pitch_mm),
        )
        > 0
    )
    inside = core[np.ix_(rows, columns)] & np.isfinite(truth["motion_flow_px"][0, 0])
    first = 0 if name == "white" else 7
    total = []
    for k, (shift, turn) in enumerate(zip(reported["shift_mm"], reported["turn_deg"], strict=True)):
        true_x, true_y = (
            part[inside] * result.pitch_mm for part in truth["motion_flow_px"][first + k]
        )
        x, y = (part[inside] * result.pitch_mm for part in np.meshgrid(columns, rows))
        centre = reported["centre_mm"]
        angle = -np.deg2rad(turn)  # rows run downwards
        across, down = x - centre[0], y - centre[1]
        total.append(
            (shift[0] - angle * down - true_x) ** 2 + (-shift[1] + angle * across - true_y) ** 2
        )
    return 1000.0 * float(np.sqrt(np.mean(total)))
