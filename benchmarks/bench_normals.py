"""Photometric stereo on the partly shadowed stack, against its peers in the same run."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from cases import shadow_case
from peers import batched_weighted_photometric_stereo, pinv_photometric_stereo
from splitknit.model import Camera, Led, Rig
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light, pseudo_normals
from splitknit.photometric.robust import robust
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    case = shadow_case()
    stack, lights, mask, dark = case.stack, case.lights, case.mask, case.shadowed

    def error(normals: np.ndarray) -> str:
        angle = np.degrees(np.arccos(np.clip((normals * case.normals).sum(axis=-1), -1, 1)))
        return f"{angle[mask & ~dark].mean():.3f} / {angle[dark].mean():.3f}"

    fraction = 100 * dark.sum() / mask.sum()
    print(
        f"Photometric stereo, {' x '.join(map(str, stack.shape))}, {fraction:.1f} % shadowed,"
        f" {machine()}"
    )
    contenders = {
        "robust (shadow-aware)": lambda: robust(stack, lights, mask)[0],
        "lambertian": lambda: lambertian(stack, lights, mask)[0],
        "numpy: pinv": lambda: pinv_photometric_stereo(stack, lights),
        "numpy: batched solve, shadow-aware": lambda: batched_weighted_photometric_stereo(
            stack, lights
        ),
    }
    rows = race(contenders, rounds)
    print(
        "\nAll in single precision. Each against its like: shadow-aware, and all images of equal"
        " weight."
    )
    for title, pair in (("Shadow-aware", (0, 3)), ("Equal weights", (1, 2))):
        print_table(title, [rows[k] for k in pair], error, "mean error deg, lit / shadowed")
    azimuth = 2 * np.pi * np.arange(7) / 7
    leds = tuple(
        Led("white", position_mm=(52.5 * np.cos(a), 52.5 * np.sin(a), 140.0)) for a in azimuth
    )
    rig = Rig(Camera(75.7, mask.shape), leds)
    colours = np.stack([stack] * 3)
    weights = np.ones_like(stack)
    near = {
        "near_light, robust": lambda: near_light(stack, rig, 3.0, mask),
        "pseudo_normals, three channels, weights": lambda: pseudo_normals(
            colours, rig, 3.0, mask, weights
        ),
    }
    print_table("Near lights (time alone)", race(near, max(rounds // 2, 1)))
    folder = Path(
        os.environ.get("SPLITKNIT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    )
    bear = folder / "diligent" / "bear.npz"
    if bear.is_file():
        with np.load(bear) as data:
            photographs = data["images"].astype(np.float32) / 65535
            directions = data["lights"]
            inside = data["mask"].astype(bool)
            truth = data["normals"]
        real = {
            "lambertian": lambda: lambertian(photographs, directions, inside)[0],
            "robust": lambda: robust(photographs, directions, inside)[0],
        }

        def bear_error(normals: np.ndarray) -> str:
            cosine = np.clip((normals * truth).sum(axis=-1), -1, 1)
            return f"{np.degrees(np.arccos(cosine))[inside].mean():.2f}"

        print_table("DiLiGenT bear, 24 lights", race(real, rounds), bear_error, "mean error deg")


if __name__ == "__main__":
    main()
