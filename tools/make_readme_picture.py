"""Make the README's picture from a demonstration: photograph, relief, shaded surface and print of one finger.

make demo
.venv/bin/python tools/make_readme_picture.py [--demo demo] [--out docs/images/result.png]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

import splitknit
from splitknit.finger.ridges import relief_print
from splitknit.imaging.band import linear_image
from splitknit.io.pictures import PictureFrame, on_paper, to_frame, upright_frame
from splitknit.model import Capture, Reconstruction
from splitknit.report.figures import small_fields
from splitknit.report.result import PRINT_PPI

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "validation" / "thesis"))
from oblique import oblique_view

HEIGHT_PX = 400
GAP_PX = 12
LEVELS = (256, 64, 48, 32, 24)
"""Levels of each channel, as many as fit: smooth shades survive few."""
MAX_BYTES = 400_000
Picture = np.ndarray


def photograph(capture: Capture, result: Reconstruction, frame: PictureFrame) -> Picture:
    """One white image as it is stored, upright, on its own background."""
    band = capture.bands["white"]
    light = linear_image(band.pixels[0], capture.encoding)
    everywhere = np.ones(result.mask.shape, dtype=np.bool_)
    colour, weight = to_frame(light, everywhere, frame)
    brightest = np.percentile(colour[weight > 0.5], 99.5)
    shown = np.clip(colour / brightest, 0.0, 1.0) ** (1 / 2.2)
    return np.round(255 * shown * weight[..., None]).astype(np.uint8)


def relief(result: Reconstruction, frame: PictureFrame) -> Picture:
    """The ridges alone, valleys dark."""
    values, weight = to_frame(1000.0 * result.ridge_mm, result.mask, frame)
    level = np.clip((values + 45.0) / 90.0 * 255.0, 0, 255).astype(np.uint8)
    return on_paper(np.repeat(level[..., None], 3, axis=2), weight)


def fitted(picture: Picture, paper: int) -> Picture:
    """Scale to the height of the row, on `paper` where the picture is lower."""
    rows, columns = picture.shape[:2]
    size = (round(columns * HEIGHT_PX / rows), HEIGHT_PX)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.pad(small, ((0, 0), (0, GAP_PX), (0, 0)), constant_values=paper)


def encoded(picture: Picture, levels: int) -> bytes | None:
    """PNG file with so many levels a channel, or None if it is too large."""
    step = 255 / (levels - 1)
    coarse = np.round(np.round(picture / step) * step).astype(np.uint8)
    done, data = cv2.imencode(".png", coarse[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return bytes(data) if done and data.nbytes <= MAX_BYTES else None


def main() -> None:
    """Reconstruct the demonstration's capture once more and lay four pictures side by side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demo", type=Path, default=Path("demo"))
    parser.add_argument("--out", type=Path, default=Path("docs/images/result.png"))
    options = parser.parse_args()
    capture = splitknit.read_capture(options.demo / "capture")
    result = splitknit.reconstruct(capture)
    frame = upright_frame(result, 2 * HEIGHT_PX, margin_mm=0.6)
    inked = relief_print(
        result.ridge_mm,
        result.mask,
        1 / result.pitch_mm,
        result.input_from_upright,
        result.upright_size,
        ppi=PRINT_PPI,
    )
    rows, columns = np.nonzero(inked < 250)
    inked = inked[max(rows.min() - 12, 0) : rows.max() + 13, max(columns.min() - 12, 0) : columns.max() + 13]
    small = small_fields(result, upright_frame(result, 2 * HEIGHT_PX))
    shaded = oblique_view(small.exaggerated(1.6), turn_deg=28, tilt_deg=48)
    shaded = np.minimum(255, shaded * (255 / shaded[0, 0, 0])).astype(np.uint8)  # on white, as the others
    panels = [
        photograph(capture, result, frame),
        relief(result, frame),
        shaded,
        np.repeat(inked[..., None], 3, axis=2),
    ]
    row = np.hstack([fitted(panel, 255) for panel in panels])[:, :-GAP_PX]
    data = next(filter(None, (encoded(row, levels) for levels in LEVELS)), None)
    if data is None:
        raise SystemExit(f"the picture does not fit into {MAX_BYTES} bytes.")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(data)
    sys.stdout.write(f"{options.out}: {row.shape[1]} x {row.shape[0]} pixels, {len(data)} bytes\n")


if __name__ == "__main__":
    main()
