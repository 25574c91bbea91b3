"""Picture table of ``docs/experiments/conditions.md``: ``python validation/conditions/pictures.py``.

Writes docs/images/conditions.jpg.

One finger, clean and in every condition at severities 0.5 and 1: white light 3 (sRGB), and the print of the relief that
``metric`` makes of the worst.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from run import KINDS

from splitknit.finger.ridges import surface_print
from splitknit.model import Capture, surface_of
from splitknit.pipeline import reconstruct
from splitknit_simulator.finger.conditions import Condition
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

OUT = Path(__file__).resolve().parents[2] / "docs" / "images" / "conditions.jpg"
SEED, LIGHT, SIDE_MM, SIDE_PX, MIDDLE_MM = 7, 3, 9.0, 260, (0.3, 0.0)


def photo(capture: Capture) -> np.ndarray:
    """The middle of the pad under one light, sRGB, BGR."""
    band, px = capture.bands["white"], capture.rig.camera.px_per_mm
    image = band.pixels[LIGHT].astype(np.float64) / 255.0
    rows, columns = image.shape[:2]
    half = 0.5 * SIDE_MM * px
    row, column = 0.5 * rows - MIDDLE_MM[1] * px, 0.5 * columns + MIDDLE_MM[0] * px
    part = image[int(row - half) : int(row + half), int(column - half) : int(column + half)]
    encoded = np.where(part <= 0.0031308, 12.92 * part, 1.055 * np.maximum(part, 1e-9) ** (1 / 2.4) - 0.055)
    return tile(np.round(255 * np.clip(encoded[..., ::-1], 0, 1)).astype(np.uint8))


def tile(image: np.ndarray) -> np.ndarray:
    """One picture of the table."""
    return cv2.resize(image, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)


def relief(capture: Capture) -> np.ndarray:
    """The middle of the relief's print, turned back as the camera sees the finger."""
    image = surface_print(surface_of(reconstruct(capture, "metric")))[:, ::-1]
    half = int(0.5 * SIDE_MM * 500.0 / 25.4)
    row, column = image.shape[0] // 2, image.shape[1] // 2
    part = image[row - half : row + half, column - half : column + half]
    return tile(cv2.cvtColor(np.ascontiguousarray(part), cv2.COLOR_GRAY2BGR))


def main() -> None:
    """Photograph, reconstruct, arrange, write."""
    cv2.setNumThreads(1)
    base = TwinSettings(scale=0.4, render=RenderSettings(workers=1))
    columns = []
    for kind, severities in (("none", (0.0, 0.0)), *((kind, (0.5, 1.0)) for kind in KINDS)):
        pictures = []
        for severity in severities[:1] if kind == "none" else severities:
            settings = base if kind == "none" else replace(base, condition=Condition(kind, severity))
            capture, _ = simulate_capture(SEED, settings=settings)
            pictures.append(photo(capture))
        if kind == "none":
            pictures.append(np.full_like(pictures[0], 255))
        pictures.append(relief(capture))
        column = np.vstack([np.pad(one, ((0, 6), (0, 6), (0, 0)), constant_values=255) for one in pictures])
        head = np.full((30, column.shape[1], 3), 255, dtype=np.uint8)
        cv2.putText(
            head, "clean" if kind == "none" else kind, (6, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA
        )
        columns.append(np.vstack([head, column]))
    quality = 88
    table = np.hstack(columns)
    while True:
        good, data = cv2.imencode(".jpg", table, [cv2.IMWRITE_JPEG_QUALITY, quality])
        assert good
        if data.size < 190_000:
            break
        quality -= 4
    OUT.write_bytes(data.tobytes())
    print(OUT, data.size, quality)


if __name__ == "__main__":
    main()
