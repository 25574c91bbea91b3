"""Photometric stereo on the partly shadowed stack, against its peers in the same run."""

from __future__ import annotations

import argparse

import numpy as np

from cases import shadow_case
from peers import batched_weighted_photometric_stereo
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
        "numpy: batched solve, shadow-aware": lambda: batched_weighted_photometric_stereo(
            stack, lights
        ),
    }
    print_table("Shadow-aware", race(contenders, rounds), error, "mean error deg, lit / shadowed")


if __name__ == "__main__":
    main()
