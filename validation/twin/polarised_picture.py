"""The picture of docs/explain/polarised.md: parallel and crossed image of one light, and their difference.

splitknit simulate --seed 7001 --scale 0.5 --set films.kind=analyser --out CAPTURE
python validation/twin/polarised_picture.py CAPTURE docs/images/polarised.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from splitknit.imaging.band import linear_channels, srgb_code
from splitknit.io.capture import read_capture

SIDE_MM = 9.0
"""Of the square about the brightest specular reflection."""


def main() -> None:
    """Draw."""
    capture = read_capture(Path(sys.argv[1]))
    names = ("blue", "green", "red")  # as OpenCV stores them
    parallel, crossed = (
        np.moveaxis(linear_channels(capture.bands[name], capture.encoding, names)[:, 2], 0, 2)
        for name in ("white", "white_crossed")
    )
    difference = np.maximum(parallel - crossed, 0.0)
    side = round(SIDE_MM * capture.rig.camera.px_per_mm)
    spread = cv2.GaussianBlur(difference[..., 1], (0, 0), side / 4)
    middle = np.unravel_index(int(spread.argmax()), spread.shape)
    first = [int(np.clip(at - side // 2, 0, n - side)) for at, n in zip(middle, spread.shape, strict=True)]
    window = (slice(first[0], first[0] + side), slice(first[1], first[1] + side))
    top = float(np.percentile(parallel[window], 99))
    own = float(np.percentile(difference[window], 99.5))
    tiles = [
        np.clip(image[window] / level, 0, 1) for image, level in ((parallel, top), (crossed, top), (difference, own))
    ]
    shown = [
        cv2.resize(np.rint(255 * srgb_code(tile)).astype(np.uint8), (420, 420), interpolation=cv2.INTER_AREA)
        for tile in tiles
    ]
    cv2.imwrite(sys.argv[2], np.hstack(shown), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main()
