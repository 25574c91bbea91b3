"""Integrators on the finger that the border cuts, against their peers in the same run."""

from __future__ import annotations

import argparse

import cv2
import numpy as np

from cases import finger_case
from peers import library, masked_system, pyamg_solver, shapelets_scale_by_scale
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelets
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    case = finger_case()
    mask = case.mask
    p = case.gradient_x.astype(np.float32)
    q = case.gradient_y.astype(np.float32)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((51, 51), np.uint8), borderValue=1) > 0
    fraction = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 24)

    def rms(height: np.ndarray) -> str:
        """Rms of the error in px: whole surface and ridge band (Gaussian high-pass of 24 px, 25 px
        inside the rim)."""
        error = np.where(mask, height - case.height, 0)
        error = np.where(mask, error - error[mask].mean(), 0)
        band = error - cv2.GaussianBlur(error, (0, 0), 24) / np.maximum(fraction, 1e-3)
        return f"{np.std(error[mask]):.4g} / {np.std(band[inner]):.4g}"

    print(f"Integrators, {mask.shape[0]} x {mask.shape[1]}, {machine('scipy', 'pyamg')}")
    masked = {
        "poisson, masked": lambda: poisson(p, q, mask),
        "poisson, masked, weighted": lambda: poisson(
            p, q, mask, weights=np.where(mask, case.normals[..., 2], 0)
        ),
    }
    if pyamg := library("pyamg"):
        # its matrix and hierarchy are made beforehand; a larger tolerance leaves it less accurate
        solve = pyamg_solver(pyamg, masked_system(case.gradient_x, case.gradient_y, mask), mask)
        masked["pyamg: Ruge-Stueben with CG, double (rtol 1e-09)"] = lambda: solve(1e-9)
    print_table("Masked", race(masked, max(rounds // 2, 1)), rms, "rms px, whole / ridge band")
    bank = {
        "shapelets": lambda: shapelets(p, q, settings=ShapeletSettings(scales=3)),
        "numpy: scale by scale (Kovesi)": lambda: shapelets_scale_by_scale(p, q, 3),
    }
    rows = race(bank, rounds)
    peer = rows[1].result

    def agreement(height: np.ndarray) -> str:
        return f"{np.corrcoef(height[inner], peer[inner])[0, 1]:.4f}"

    print_table("Shapelets, n = 3", rows, agreement, "correlation with the peer's height")


if __name__ == "__main__":
    main()
