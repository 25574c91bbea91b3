"""The picture of docs/explain/published-systems.md: normals and albedo of one set of images, and the voted minutiae.

python validation/family/voted_picture.py CAPTURE docs/images/zheng.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from splitknit.io.capture import read_capture
from splitknit.presets import preset_settings
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.voted_minutiae import PICTURES, left_out_pictures, vote


def main() -> None:
    """Draw."""
    found = list(left_out_pictures(read_capture(Path(sys.argv[1])), preset_settings("zheng")))
    voted = vote([extract(one.print_image) for one in found])
    shown = [cv2.cvtColor(one.print_image, cv2.COLOR_GRAY2BGR) for one in found[: len(PICTURES)]]
    last = shown[-1].copy()
    for x, y, direction in zip(voted.x_px, voted.y_px, voted.direction_rad, strict=True):
        end = (round(float(x + 12 * np.cos(direction))), round(float(y - 12 * np.sin(direction))))
        cv2.circle(last, (int(x), int(y)), 5, (30, 60, 230), 2, cv2.LINE_AA)
        cv2.line(last, (int(x), int(y)), end, (30, 60, 230), 2, cv2.LINE_AA)
    rows = np.flatnonzero((shown[-1] < 255).any(axis=(1, 2)))
    picture = np.hstack([image[rows[0] : rows[-1] + 1] for image in (*shown, last)])
    small = cv2.resize(picture, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    cv2.imwrite(sys.argv[2], small, [cv2.IMWRITE_JPEG_QUALITY, 72])


if __name__ == "__main__":
    main()
