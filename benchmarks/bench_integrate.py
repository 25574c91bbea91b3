"""Integrators on the finger that the border cuts, against their peers in the same run."""

from __future__ import annotations

import argparse

import cv2
import numpy as np

from cases import finger_case
from peers import (
    cg_dct_solver,
    dct_poisson,
    frankot_chellappa_plain,
    library,
    loosest,
    masked_system,
    pyamg_solver,
    shapelets_scale_by_scale,
)
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelets
from timing import machine, print_table, race

WANTED = 1e-5
"""Of the rms height: the masked solver's own tolerance."""


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
    double = case.gradient_x, case.gradient_y
    whole = {
        "poisson, whole rectangle": lambda: poisson(p, q),
        "scipy: DCT Poisson, double": lambda: dct_poisson(*double),
        "scipy: DCT Poisson, single": lambda: dct_poisson(p, q),
        "frankot_chellappa, zero": lambda: frankot_chellappa(p, q),
        "frankot_chellappa, mirror": lambda: frankot_chellappa(p, q, padding="mirror"),
        "numpy: Frankot-Chellappa, zero-filled, double": lambda: frankot_chellappa_plain(*double),
    }
    print_table("Whole rectangle", race(whole, rounds), rms, "rms px, whole / ridge band")
    masked = {
        "poisson, masked": lambda: poisson(p, q, mask),
        "poisson, masked, weighted": lambda: poisson(
            p, q, mask, weights=np.where(mask, case.normals[..., 2], 0)
        ),
    }
    system = masked_system(*double, mask)
    single, both = (cg_dct_solver(system, mask, dtype) for dtype in (np.float32, np.float64))
    exact = both(1e-9)
    print(
        "\nMasked solvers stop when they are as close to the exact solution as `poisson` is asked"
        f" to be, {WANTED:g} of"
    )
    print(
        "the rms height; peers have matrix, eigenvalues and multigrid hierarchy at hand, `poisson`"
        " makes its own."
    )
    solvers = {
        "scipy: CG preconditioned by the DCT, single": single,
        "scipy: the same, double": both,
    }
    if pyamg := library("pyamg"):
        solvers["pyamg: Ruge-Stueben with CG, double"] = pyamg_solver(pyamg, system, mask)
    for name, solve in solvers.items():
        tolerance = loosest(solve, exact, WANTED)
        masked[f"{name} (rtol {tolerance:g})"] = lambda solve=solve, t=tolerance: solve(t)
    masked["scipy: making the matrix alone"] = lambda: masked_system(*double, mask) and exact
    scale = float(np.sqrt(np.nanmean(np.square(exact))))

    def accuracy(height: np.ndarray) -> str:
        centred = height - np.nanmean(height)
        return f"{rms(height)} / {np.sqrt(np.nanmean(np.square(centred - exact))) / scale:.1g}"

    head = "rms px, whole / ridge band / from the exact solution, of the rms height"
    print_table("Masked", race(masked, max(rounds // 2, 1)), accuracy, head)
    for scales in (3, 7):
        bank = {
            "shapelets": lambda n=scales: shapelets(p, q, settings=ShapeletSettings(scales=n)),
            "numpy: scale by scale (Kovesi)": lambda n=scales: shapelets_scale_by_scale(p, q, n),
        }
        rows = race(bank, rounds)
        peer = rows[1].result

        def agreement(height: np.ndarray, peer: np.ndarray = peer) -> str:
            return f"{np.corrcoef(height[inner], peer[inner])[0, 1]:.4f}"

        print_table(
            f"Shapelets, n = {scales}", rows, agreement, "correlation with the peer's height"
        )


if __name__ == "__main__":
    main()
