"""Are these two captures of one finger? Three captures, reconstructed and compared by ridges and by
minutiae.

    python examples/plot_match.py --out pictures

Two captures are of one finger, laid down twice (another roll, yaw and insertion, other noise); the
third is another person's. Higher similarity means more similar; the false match rate gives how
often impostors reach as much.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

import splitknit
from splitknit.finger.ridges import surface_print
from splitknit.io.images import write_image
from splitknit.reconstruction import surface_of
from splitknit_match.matching.methods import rate
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.surface import surface_template
from splitknit_match.prints.minutiae import extract
from splitknit_match.records.minutiae_record import Minutiae
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


def marked(image: np.ndarray, minutiae: Minutiae) -> np.ndarray:
    """The print with its minutiae: a circle, and a line along the direction."""
    picture = np.repeat(image[..., None], 3, axis=2)
    blue = (0, 90, 178)
    for x, y, direction in zip(minutiae.x_px, minutiae.y_px, minutiae.direction_rad, strict=True):
        start = round(float(x)), round(float(y))
        end = round(float(x + 11 * np.cos(direction))), round(float(y - 11 * np.sin(direction)))
        cv2.circle(picture, start, 4, blue, 1, cv2.LINE_AA)
        cv2.line(picture, start, end, blue, 1, cv2.LINE_AA)
    return picture


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scale", type=float, default=0.35)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    twin = TwinSettings(scale=options.scale)
    captures = {"Ada, first session": (1, 0), "Ada, second session": (1, 1), "Ben": (3, 0)}
    templates, prints = {}, {}
    for name, (seed, impression) in captures.items():
        capture, _ = simulate_capture(seed, "left_loop", twin, impression=impression)
        surface = surface_of(splitknit.reconstruct(capture))
        templates[name] = surface_template(surface)
        image = surface_print(surface)
        prints[name] = image, extract(image, 500.0)
    first, *others = captures
    for reference in others:
        match = ridge_match(templates[first], templates[reference])
        fmr = rate(match.similarity, "ridge", None).fmr
        score = minutiae_match(prints[first][1], prints[reference][1])
        print(f"{first} against {reference}:")
        often = (
            "always"
            if fmr is None or fmr >= 0.999
            else f"in at most {100 * fmr:.2g} % of comparisons"
        )
        print(
            f"  by ridges {match.similarity:.2f} (turned by {match.rotation_deg:+.1f} deg,"
            f" {match.overlap_mm2:.0f} mm2 in common); impostors reach that {often}"
        )
        print(f"  by minutiae {score:.2f}")
    if options.out is not None:
        tall = max(image.shape[0] for image, _ in prints.values())
        panels = [
            np.pad(
                marked(*image_and_minutiae),
                ((0, tall - image_and_minutiae[0].shape[0]), (0, 12), (0, 0)),
                constant_values=255,
            )
            for image_and_minutiae in prints.values()
        ]
        write_image(options.out / "prints-with-minutiae.png", np.hstack(panels))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
