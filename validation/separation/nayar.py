"""The four ways to separate direct from global light that the thesis compares (3.2.5), on the same
simulated skin.

    python validation/separation/nayar.py  # a minute; writes tables/nayar.csv beside this file

Truth: maximum minus minimum over all phases of a checkerboard of 0.42 mm. PSNR in dB of the direct
light, peak of the white image, without noise and with the sensor's.

S. K. Nayar, G. Krishnan, M. D. Grossberg and R. Raskar, "Fast separation of direct and global
components of a scene using high frequency illumination", ACM Transactions on Graphics 25(3), 2006.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from patches import (
    PATCH_SIZE,
    PX_PER_MM,
    Patch,
    decibels,
    draw_patches,
    inner,
    noisy_images,
    photograph,
    truth_of,
)

from patterns import checkerboard
from projector import Checkerboard

CHECK_MM = 0.42
TABLE = Path(__file__).with_name("tables") / "nayar.csv"
BLOCK_PX = 32
"""Pixels a side of a block of the single image: two checks."""


@dataclass(frozen=True)
class Shifted:
    """A pattern in some shifts; stands where the simulator takes its checkerboard."""

    kind: str
    check_mm: float = CHECK_MM

    @property
    def steps(self) -> int:
        """Root of the number of shifts, at least."""
        return int(np.ceil(len(self.shifts_mm()) ** 0.5))

    def shifts_mm(self) -> np.ndarray:
        """(N, 2) displacements in mm."""
        if self.kind == "sinusoid":
            along = 2 * self.check_mm * np.arange(3) / 3
        elif self.kind == "line":
            reach = 0.75 * max(PATCH_SIZE) / PX_PER_MM
            along = np.arange(-reach, reach, 0.5 * self.check_mm)
        else:
            return Checkerboard(self.check_mm).shifts_mm()
        return np.stack([along, np.zeros_like(along)], axis=1)

    def state(self, x: np.ndarray, y: np.ndarray, shift_mm: np.ndarray, _: float) -> np.ndarray:
        """Light of the source at points of the finger plane."""
        u, v = x - shift_mm[0], y - shift_mm[1]
        if self.kind == "sinusoid":
            return np.asarray(0.5 + 0.5 * np.sin(np.pi * u / self.check_mm), dtype=np.float32)
        if self.kind == "line":
            return np.asarray(np.abs(u) > 0.5 * self.check_mm, dtype=np.float32)
        hole, period = 2 * self.check_mm * 0.5**0.5, 2 * self.check_mm
        return np.asarray((u % period < hole) & (v % period < hole), dtype=np.float32)


def by_occluder(images: np.ndarray, lit: float) -> tuple[np.ndarray, np.ndarray]:
    """Direct and global light of images (N, ...) under a moving shadow; `lit`: fraction of the
    source that passes."""
    low = images.min(axis=0)
    high = images.max(axis=0)
    return high - low, low / lit


def by_sinusoid(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direct and global light of three images (3, ...) under a sinusoid moved by thirds of its
    period."""
    first, second, third = images
    mean = images.mean(axis=0)
    amplitude = np.sqrt(3 * (second - third) ** 2 + (2 * first - second - third) ** 2) / 3
    return 2 * amplitude, 2 * (mean - amplitude)


def by_one_image(image: np.ndarray, block: int, check_px: float) -> np.ndarray:
    """Direct light (h, w, C) in blocks of one image (H, W, C) under a checkerboard: from valley to
    valley and from peak to peak (opening and closing by a window that holds a lit and a dark
    check), means over blocks."""
    reach = int(np.ceil(0.75 * check_px))
    window = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * reach + 1, 2 * reach + 1))
    rim = 2 * reach
    rows, columns = (n // block for n in image.shape[:2])
    ends = []
    for kind in (cv2.MORPH_OPEN, cv2.MORPH_CLOSE):
        whole: Any = cv2.morphologyEx(np.asarray(image, dtype=np.float32), kind, window)
        whole = cv2.copyMakeBorder(
            whole[rim:-rim, rim:-rim], rim, rim, rim, rim, cv2.BORDER_REPLICATE
        )
        blocks = whole[: rows * block, : columns * block].reshape(rows, block, columns, block, -1)
        ends.append(blocks.mean(axis=(1, 3), dtype=np.float64))
    return np.asarray(ends[1] - ends[0])


def direct_of(kind: str, images: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Direct light (h, w, C) by one of the ways."""
    if kind == "checkerboard":
        return np.asarray(checkerboard(images, mask=mask, clip_level=None).direct)
    if kind == "sinusoid":
        return by_sinusoid(images)[0]
    if kind == "single image":
        small = by_one_image(images[0], BLOCK_PX, CHECK_MM * PX_PER_MM).astype(np.float32)
        size = small.shape[1] * BLOCK_PX, small.shape[0] * BLOCK_PX
        large: Any = cv2.resize(small, size, interpolation=cv2.INTER_CUBIC)
        down, right = images.shape[1] - size[1], images.shape[2] - size[0]
        return np.asarray(cv2.copyMakeBorder(large, 0, down, 0, right, cv2.BORDER_REPLICATE))
    return by_occluder(images, 1.0 if kind == "line" else 0.5)[0]


def compared(patches: dict[str, Patch]) -> list[dict[str, Any]]:
    """A row for each way and patch."""
    rows = []
    for name, patch in patches.items():
        truth = truth_of(patch, CHECK_MM)
        mask = inner(patch[0], truth)
        real, white = truth.direct[:, mask], truth.white[:, mask]
        stacks = {kind: photograph(patch, Shifted(kind)) for kind in ("sinusoid", "line", "mesh")}
        stacks["checkerboard"] = photograph(patch, Checkerboard(CHECK_MM))
        stacks["single image"] = stacks["checkerboard"][:1]
        for kind, clean in stacks.items():
            row: dict[str, Any] = {"surface": name, "way": kind, "images": len(clean)}
            for what, images in (("no noise", clean), ("noise", noisy_images(clean, truth, mask))):
                error = direct_of(kind, images, mask)[mask].T - real
                row[f"{what}, dB"] = f"{decibels(error, real, white)['white_peak']:.1f}"
                row[f"{what}, mean error %"] = f"{100 * float(error.mean() / real.mean()):+.0f}"
            rows.append(row)
    return rows


def main() -> None:
    """Compare, print and store."""
    rows = compared(draw_patches(False))
    for row in rows:
        print(*row.values(), sep=", ")
    with TABLE.open("w", encoding="ascii", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
