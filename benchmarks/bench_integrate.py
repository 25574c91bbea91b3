"""Integrators on the finger that the border cuts, against their peers in the same run."""

from __future__ import annotations

import argparse
import importlib.util

import cv2
import numpy as np

from cases import finger_case
from peers import (
    dct_poisson,
    frankot_chellappa_plain,
    masked_cg_dct,
    masked_pyamg,
    shapelets_scale_by_scale,
)
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import PoissonSettings, poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelets
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    case = finger_case()
    mask = case.mask
    p, q = case.gradient_x.astype(np.float32), case.gradient_y.astype(np.float32)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((51, 51), np.uint8), borderValue=1) > 0
    fraction = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 24)

    def rms(height: np.ndarray) -> str:
        """Rms of the error in px: whole surface and ridge band (Gaussian high-pass of 24 px, 25 px inside the rim)."""
        error = np.where(mask, height - case.height, 0)
        error = np.where(mask, error - error[mask].mean(), 0)
        band = error - cv2.GaussianBlur(error, (0, 0), 24) / np.maximum(fraction, 1e-3)
        return f"{np.std(error[mask]):.4g} / {np.std(band[inner]):.4g}"

    print(f"Integrators, {mask.shape[0]} x {mask.shape[1]}, {machine()}")
    whole = {
        "poisson, whole rectangle": lambda: poisson(p, q),
        "scipy: DCT Poisson": lambda: dct_poisson(p, q),
        "frankot_chellappa, zero": lambda: frankot_chellappa(p, q),
        "frankot_chellappa, mirror": lambda: frankot_chellappa(p, q, padding="mirror"),
        "numpy: Frankot-Chellappa, zero-filled": lambda: frankot_chellappa_plain(p, q),
    }
    print_table("Whole rectangle", race(whole, rounds), rms, "rms px, whole / ridge band")
    masked = {
        "poisson, masked": lambda: poisson(p, q, mask),
        "poisson, masked, cubic rule": lambda: poisson(p, q, mask, settings=PoissonSettings(quadrature="cubic")),
        "poisson, masked, weighted": lambda: poisson(p, q, mask, weights=np.where(mask, case.normals[..., 2], 0)),
        "scipy: CG preconditioned by the DCT": lambda: masked_cg_dct(p, q, mask),
    }
    if importlib.util.find_spec("pyamg") is not None:
        masked["pyamg: Ruge-Stueben"] = lambda: masked_pyamg(p, q, mask)
    print_table("Masked", race(masked, max(rounds // 2, 1)), rms, "rms px, whole / ridge band")
    for scales in (3, 7):
        chosen = [ShapeletSettings(scales=scales, padding=padding) for padding in ("mirror", "zero")]
        bank = {
            "shapelets, mirror": lambda s=chosen[0]: shapelets(p, q, settings=s),
            "shapelets, zero": lambda s=chosen[1]: shapelets(p, q, settings=s),
            "numpy: scale by scale (Kovesi)": lambda n=scales: shapelets_scale_by_scale(p, q, n),
        }
        rows = race(bank, rounds)
        peer = rows[2].result

        def agreement(height: np.ndarray, peer: np.ndarray = peer) -> str:
            return f"{np.corrcoef(height[inner], peer[inner])[0, 1]:.4f}"

        print_table(f"Shapelets, n = {scales}", rows, agreement, "correlation with the peer's height")


if __name__ == "__main__":
    main()
