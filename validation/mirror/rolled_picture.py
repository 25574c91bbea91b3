"""The picture of docs/guide/rolled.md: a capture, its rolled print, and what its front alone gives.

    python validation/mirror/rolled_picture.py CAPTURE MEASURED.npz docs/images/rolled.jpg

MEASURED is what ``validation/mirror/rolled.py --keep`` leaves beside the capture.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

HEIGHT = 500


def main() -> None:
    """Draw."""
    capture, measured, out = (Path(argument) for argument in sys.argv[1:4])
    photo = cv2.imread(str(capture / "white_1.png"))
    middle = photo[photo.shape[0] * 2 // 5 :]
    scale = HEIGHT / middle.shape[0]
    small = cv2.resize(middle, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    panels = [np.clip(small.astype(np.float64) * 1.5, 0, 255).astype(np.uint8)]
    with np.load(measured) as arrays:
        for name in ("rolled_image", "front_image"):
            print_ = arrays[name]
            room = max(HEIGHT - print_.shape[0], 0)
            padded = np.pad(print_, ((room // 2, room - room // 2), (12, 12)), constant_values=255)
            if padded.shape[0] > HEIGHT:
                size = round(padded.shape[1] * HEIGHT / padded.shape[0]), HEIGHT
                padded = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)
            panels.append(cv2.cvtColor(padded, cv2.COLOR_GRAY2BGR))
    cv2.imwrite(str(out), np.hstack(panels), [cv2.IMWRITE_JPEG_QUALITY, 75])


if __name__ == "__main__":
    main()
