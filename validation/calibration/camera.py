"""How well ``splitknit calibrate camera`` finds a known camera: built rigs of the twin,
photographed with noise.

    python validation/calibration/camera.py [--seeds 8] [--scale 0.25] [--out FILE.json]

Each seed is another rig as a person builds it (focal length, principal point, distortion, height
and tilt off the drawing) and 15 other photographs of a checkerboard held by hand. Prints a table:
mean and worst error over the seeds, and an interval of 95 % for the mean (bootstrap over seeds).
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.model import Rig
from splitknit_rig.calibration.camera import CameraCalibration, fit_camera, fit_lens
from splitknit_rig.calibration.plane import PlanePose, mean_pose, plane_pose
from splitknit_rig.calibration.targets import Board, find_board
from splitknit_simulator.calibration_set import bench, flat
from splitknit_simulator.camera.device import LitScene
from splitknit_simulator.rigs import built_rig

BOARD = Board(9, 6, 3.0)
PRINTED = flat.PrintedBoard(columns=9, rows=6, square_mm=3.0)
LIT = tuple(range(7))
PRINT_ERROR_MM = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Photos:
    """What one seed's rig shows."""

    rig: Rig
    corners: list[np.ndarray]
    planes: list[np.ndarray]
    normal: np.ndarray
    """(3,) of the base, true."""


def photographs(
    seed: int, scale: float, *, count: int = 15, f_number: float | None = None
) -> Photos:
    """Photograph a board by hand and on the base; a pinhole unless there is an f-number."""
    rig = built_rig(seed, scale=scale)
    focal_mm = float(rig.camera.matrix[0, 0]) / scale * 1.12e-3
    opening = 0.0 if f_number is None else 1 / (1 / focal_mm + 1 / rig.camera.height_mm) / f_number
    common: dict[str, Any] = {
        "camera": rig.camera,
        "leds": rig.leds,
        "bench": bench.BenchSettings(aperture_mm=opening),
    }

    def photo(scene: LitScene, number: int) -> np.ndarray:
        exposure = bench.well_exposed(scene, [LIT])
        return bench.photograph_bench(scene, LIT, 1000 * seed + number, exposure=exposure)

    corners = []
    for k, pose in enumerate(flat.board_poses(seed, count, rig.camera, PRINTED)):
        held = flat.BoardScene(**common, board=PRINTED, **pose)
        corners.append(find_board(photo(held, k), BOARD))
    tilt = rig.provenance["base_tilt_deg"]
    planes = []
    for k, shift in enumerate(((0.7, -0.3), (-1.5, 0.8))):
        turn = (float(np.deg2rad(tilt[0])), float(np.deg2rad(tilt[1])), 0.0)
        # a point of the base at x, y lies at z = -(nx x + ny y) / nz
        normal = flat.BoardScene(**common, board=PRINTED, rotation_vector=turn).plane.axes[:, 2]
        middle = (*shift, -float(normal[:2] @ shift) / float(normal[2]))
        level = flat.BoardScene(
            **common, board=PRINTED, rotation_vector=turn, translation_mm=middle
        )
        planes.append(find_board(photo(level, 500 + k), BOARD))
    detected = [corner_set for corner_set in corners if corner_set is not None]
    return Photos(rig, detected, [p for p in planes if p is not None], normal)


def errors_of(photos: Photos, fit: CameraCalibration | Any) -> dict[str, float]:
    """Errors of one calibration."""
    lens = fit.lens if isinstance(fit, CameraCalibration) else fit
    truth = photos.rig.camera
    true = np.asarray(truth.matrix)
    focal = float(lens.matrix[0, 0])
    by_board = mean_pose(
        [
            plane_pose(BOARD.points_mm, plane, lens.matrix, lens.distortion)
            for plane in photos.planes
        ],
        focal,
    )

    def tilt_error(pose: PlanePose) -> float:
        return float(np.degrees(np.arccos(min(1.0, float(pose.normal @ photos.normal)))))

    return {
        "focal_percent": 100 * abs(focal / true[0, 0] - 1),
        "focal_deviations": abs(focal - true[0, 0]) / lens.deviations["fx"],
        "principal_point_px": float(np.linalg.norm(lens.matrix[:2, 2] - true[:2, 2])),
        "board_px_per_mm_percent": 100 * abs(by_board.px_per_mm / truth.px_per_mm - 1),
        "board_tilt_deg": tilt_error(by_board),
        "rms_px": lens.rms_px,
    }


def measure(seed: int, scale: float) -> dict[str, dict[str, float]]:
    """All cases of one seed."""
    sharp = photographs(seed, scale)
    size = sharp.rig.camera.image_size
    cases = {
        f"{count} photographs": errors_of(sharp, fit_camera(sharp.corners[:count], BOARD, size))
        for count in (15, 8, 5)
    }
    moved = BOARD.points_mm + np.random.default_rng([seed, 1]).normal(0, PRINT_ERROR_MM, (54, 2))
    cases["15, corners printed 10 um off"] = errors_of(sharp, fit_lens(moved, sharp.corners, size))
    blurred = photographs(seed, scale, f_number=2.0)
    cases["15, lens at f/2"] = errors_of(blurred, fit_camera(blurred.corners, BOARD, size))
    return cases


def summary(runs: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, dict[str, float]]]:
    """Mean, interval of 95 % for it, and worst over the seeds."""
    rng = np.random.default_rng(0)
    picks = rng.integers(0, len(runs), (4000, len(runs)))
    result: dict[str, dict[str, dict[str, float]]] = {}
    for case in runs[0]:
        result[case] = {}
        for name in runs[0][case]:
            values = np.array([run[case][name] for run in runs])
            low, high = np.percentile(values[picks].mean(axis=1), (2.5, 97.5))
            result[case][name] = {
                "mean": round(float(values.mean()), 5),
                "low": round(float(low), 5),
                "high": round(float(high), 5),
                "worst": round(float(values.max()), 5),
            }
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    runs = []
    for seed in range(options.seeds):
        runs.append(measure(seed, options.scale))
        print(
            f"seed {seed}: focal length {runs[-1]['15 photographs']['focal_percent']:.4f} % off",
            flush=True,
        )
    facts = summary(runs)
    for case, figures in facts.items():
        print(f"\n{case}")
        for name, figure in figures.items():
            limits = f"({figure['low']:.4f} to {figure['high']:.4f})"
            print(f"  {name:26s} {figure['mean']:8.4f} {limits}, worst {figure['worst']:.4f}")
    if options.out is not None:
        document = {"scale": options.scale, "seeds": options.seeds, "cases": facts}
        options.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
