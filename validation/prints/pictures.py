"""The pictures of ``docs/explain/prints.md`` and the comparison of quadratic with cubic fits.

    python validation/prints/pictures.py CAPTURE RESULT --out docs/images

The result is a reconstruction of the capture, which is a simulated one (its ``truth.npz`` is used). Prints one JSON
object: how far noise on the surface changes the shape index, in the middle and at the edge of the mask.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from splitknit.io.npz import read_npz
from splitknit_match.prints.curvature import curvature, window_side
from splitknit_match.prints.make import enhance, make_print
from splitknit_match.prints.sources import read_source


def beside(panels: list[np.ndarray], gap: int = 10) -> np.ndarray:
    """Pictures in a row on white."""
    tall = max(panel.shape[0] for panel in panels)
    padded = [
        np.pad(panel, ((0, tall - panel.shape[0]), (0, gap)) + ((0, 0),) * (panel.ndim - 2), constant_values=255)
        for panel in panels
    ]
    return np.hstack(padded)


def save(path: Path, picture: np.ndarray, width: int = 1400) -> None:
    """Write a JPEG no wider than `width`."""
    if picture.shape[1] > width:
        picture = cv2.resize(picture, None, fx=width / picture.shape[1], fy=width / picture.shape[1], interpolation=3)
    colours = picture if picture.ndim == 2 else picture[..., ::-1]
    quality = 82
    while True:
        data = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(data) < 200_000:
            break
        quality -= 6
    path.write_bytes(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    surface = read_source(options.result, photo=False, surface=True)
    photo = replace(surface, photo=read_source(options.capture, photo=True, surface=False).photo)
    rows = []
    for method in ("relief", "unroll", "curvature", "photo"):
        made = make_print(photo, method)
        rows.append((made.image, enhance(made, 500.0).image))
    tall = max(image.shape[0] for image, _ in rows)
    upper, lower = (
        beside([np.pad(row[k], ((0, tall - row[k].shape[0]), (0, 0)), constant_values=255) for row in rows])
        for k in range(2)
    )
    save(options.out / "prints-methods.jpg", np.vstack([upper, lower]), 1500)
    unrolled = make_print(photo, "unroll")
    enhanced = enhance(unrolled, 500.0)
    steps = [unrolled.image, enhanced.image]
    middle = unrolled.image.shape[0] // 2, unrolled.image.shape[1] // 2
    window = slice(middle[0] - 110, middle[0] + 110), slice(middle[1] - 110, middle[1] + 110)
    zoomed = [cv2.resize(step[window], None, fx=1.6, fy=1.6, interpolation=cv2.INTER_CUBIC) for step in steps]
    save(options.out / "prints-steps.jpg", beside(zoomed))
    kinds = [make_print(photo, "unroll", kind) for kind in ("free", "arc")]
    save(options.out / "prints-unrolled.jpg", beside([made.image for made in kinds]))
    print(json.dumps(fits(options.capture, surface), indent=1))


def fits(capture: Path, surface) -> dict[str, dict[str, float]]:
    """Quadratic against cubic under noise on the true surface."""
    pitch = surface.pitch_mm
    truth = read_npz(capture / "truth.npz")
    height, mask = truth["height_mm"], surface.mask & np.isfinite(truth["height_mm"])
    half = window_side(1 / pitch) // 2
    deep = cv2.erode(np.pad(mask.astype(np.uint8), 1), np.ones((2 * half + 1,) * 2))[1:-1, 1:-1] > 0
    rim = mask & ~deep
    rng = np.random.default_rng(1)
    facts = {}
    for degree, word in ((2, "quadratic"), (3, "cubic")):
        clean = curvature(height, mask, pitch, degree=degree).shape_index
        for sigma_um in (0.5, 2.0, 5.0):
            noise = rng.standard_normal(height.shape).astype(np.float32) * np.float32(sigma_um / 1000)
            noisy = curvature(np.where(mask, height + noise, height), mask, pitch, degree=degree).shape_index
            row = {}
            for zone, where in (("full_windows", deep), ("cut_windows", rim)):
                both = where & np.isfinite(clean) & np.isfinite(noisy)
                row[zone] = round(float(np.sqrt(np.mean((noisy - clean)[both] ** 2))), 4)
            facts[f"{word}, noise {sigma_um} um"] = row
    return facts


if __name__ == "__main__":
    main()
