"""The two-layer fit on real photographs with known normals: no skin, but no twin either."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from xie_ways import SHIPPED, error_deg

from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust

SUBSETS = 5


def on_photographs(*, smoke: bool = False) -> dict[str, Any] | None:
    """Mean errors on DiLiGenT's bear with 24 lights and with seven of them; None where it is absent."""
    data = os.environ.get("SPLITKNIT_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")
    path = Path(data) / "diligent" / "bear.npz"
    if not path.is_file():
        return None
    with np.load(path) as bear:
        step = 4 if smoke else 1
        stack = bear["images"][:, ::step, ::step].astype(np.float32) / 65535
        mask, truth = bear["mask"][::step, ::step].astype(bool), bear["normals"][::step, ::step]
        lights = bear["lights"]
    choices = {"24 lights": np.arange(24)}
    for seed in range(1 if smoke else SUBSETS):
        choices[f"7 lights, draw {seed}"] = np.sort(np.random.default_rng(seed).choice(24, 7, replace=False))
    found: dict[str, Any] = {}
    for name, chosen in choices.items():
        some, their = stack[chosen], lights[chosen]
        fields = {
            "lambertian": lambertian(some, their, mask)[0],
            "lambertian robust": robust(some, their, mask)[0],
            "layers": hanrahan_krueger(some, their, mask, replace(SHIPPED, weights="equal"))[0],
            "layers robust": hanrahan_krueger(some, their, mask, replace(SHIPPED, weights="robust"))[0],
        }
        found[name] = {way: float(error_deg(normals, truth)[mask].mean()) for way, normals in fields.items()}
    return found
