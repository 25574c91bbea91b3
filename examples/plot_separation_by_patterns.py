"""Direct and global light by measurement: a simulated finger under 25 shifted checkerboards.

The twin photographs a patch of skin under a projector's checkerboards, knows the direct light at
that check size, and the images are separated in three ways, without and with noise. Maximum minus
minimum (the thesis's) is best without noise; in noisy images it invents direct light, and the known
places of the checks help::

    python examples/plot_separation_by_patterns.py --out pictures

With real images, put them in a folder: ``python training/patterns.py FOLDER --out DIR``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from splitknit.io.images import write_image
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.light.skin import SkinOptics

sys.path.append(str(Path(__file__).resolve().parents[1] / "training"))

from patterns import Separation, checkerboard
from projector import (
    Checkerboard,
    checkerboard_stack,
    pattern_states,
    separate_truth,
)

CHECK_MM, PX_PER_MM, SIDE_PX = 0.4, 20.0, 96


def photograph() -> tuple[np.ndarray, np.ndarray, Separation]:
    """Return 25 noise-free images (N, H, W, 3), the states (N, H, W) of their pixels, and the
    truth."""
    pose = FingerPose(insertion_mm=SIDE_PX / PX_PER_MM + 6.0)
    finger = finger_surface(
        draw_finger(11, "whorl"), pose, Camera(PX_PER_MM, (SIDE_PX, SIDE_PX)), workers=1
    )
    projector = default_rig().leds[1]
    skin = SkinOptics()
    pattern = Checkerboard(CHECK_MM)
    truth = separate_truth(finger, projector, skin, check_mm=CHECK_MM)
    stack = checkerboard_stack(finger, projector, skin, pattern).transpose(0, 2, 3, 1)
    white = float(truth.white.max())
    direct, global_ = (part.transpose(1, 2, 0) / white for part in (truth.direct, truth.global_))
    return stack / white, pattern_states(finger, projector, pattern), Separation(direct, global_)


def decibels(direct: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of the direct light; the peak is the brightest pixel under full light."""
    return float(-10 * np.log10(np.mean((direct - truth) ** 2)))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description="Separate direct from global light of simulated skin."
    )
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    stack, states, truth = photograph()
    check_px = CHECK_MM * PX_PER_MM
    print(
        f"true direct light: {100 * truth.direct.mean() / truth.white.mean():.0f} % of the light,"
        f" {CHECK_MM} mm checks"
    )
    print(f"{'':38s}{'no noise':>18s}{'noise 1 %':>18s}{'noise 3 %':>18s}")
    rows: dict[str, list[str]] = {}
    for sigma in (0.0, 0.01, 0.03):
        noisy = stack + np.random.default_rng(1).normal(0, sigma, stack.shape)
        methods = {
            "maximum - minimum": checkerboard(noisy, clip_level=None),
            "known states": checkerboard(noisy, patterns=states, clip_level=None),
            "known states, middle of the checks": checkerboard(
                noisy, patterns=states, check_px=check_px, clip_level=None
            ),
        }
        for name, parts in methods.items():
            gain = parts.direct.mean() / truth.direct.mean()
            rows.setdefault(name, []).append(
                f"{decibels(parts.direct, truth.direct):.1f} dB, x {gain:.2f}"
            )
        if options.out is not None and sigma == 0:
            for name, light in (
                ("direct", truth.direct),
                ("global", truth.global_),
                ("pattern", stack[0]),
            ):
                picture = np.clip(light / light.max(), 0, 1) ** (1 / 2.2)
                write_image(options.out / f"{name}.png", np.round(255 * picture).astype(np.uint8))
    for name, cells in rows.items():
        print(f"{name:38s}" + "".join(f"{cell:>18s}" for cell in cells))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
