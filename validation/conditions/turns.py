"""Which way the finger points, for any turn: ``python validation/conditions/turns.py``.

Simulated fingers (``--seeds``) are photographed in a large frame, then images and LEDs are turned together by 0 to 345
deg and cut to pictures of three shapes. Counted: direction found within 15 deg of the truth, wrong with and without a
warning, refused; the counts are written to ``tables/turns.csv``. ``--whole N`` reconstructs the widest pictures of the
first finger in N turns and matches the result with that of the finger pointing up.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.finger.mask import finger_mask
from splitknit.finger.orientation import find_upright
from splitknit.imaging.band import linear_survey
from splitknit.model import Band, Capture, Led, default_rig, surface_of
from splitknit.pipeline import reconstruct
from splitknit_match.matching.ridge import ridge_match
from splitknit_match.matching.surface import surface_template
from splitknit_simulator.finger.finger import PoseRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

SEEDS = (7511, 7512, 7513)
SCALE = 0.2
SIDE = 900
SHAPES = {"wide, 29 x 42 mm": (440, 640), "tall, 42 x 29 mm": (640, 440), "square, 37 x 37 mm": (560, 560)}
"""Rows and columns."""
OTHERS = {"small, 20 x 26 mm": (300, 400), "whole finger part inside, 59 x 59 mm": (900, 900)}
"""Harder pictures: less of the finger, and a finger that a mask cuts off inside the picture."""
WRONG_DEG = 15.0
TABLE = Path(__file__).with_name("tables") / "turns.csv"


def large_capture(seed: int) -> tuple[Capture, float]:
    """A finger that lies right across the middle of a square frame, and its yaw in degrees."""
    rig = default_rig(SCALE)
    rig = replace(rig, camera=replace(rig.camera, image_size=(SIDE, SIDE)))
    settings = TwinSettings(rig=rig, pose=PoseRanges(insertion_mm=(40.0, 42.0)))
    capture, truth = simulate_capture(seed, settings=settings)
    return capture, float(np.rad2deg(truth["landmark_yaw_rad"]))


def turned(capture: Capture, angle_deg: float, size: tuple[int, int]) -> Capture:
    """Images and lights turned counter-clockwise together about the middle, cut to `size` (rows, columns)."""
    rows, columns = capture.shape
    turn = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    turn[:, 2] += np.array([(size[1] - columns) / 2, (size[0] - rows) / 2])
    cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))

    def image(pixels: NDArray[Any]) -> NDArray[Any]:
        return cv2.warpAffine(pixels, turn, (size[1], size[0]), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def led(one: Led) -> Led:
        assert one.position_mm is not None
        x, y, z = one.position_mm
        return replace(one, position_mm=(cosine * x - sine * y, sine * x + cosine * y, z))

    def band(one: Band) -> Band:
        ambient = None if one.ambient is None else image(one.ambient)
        return replace(one, pixels=np.stack([image(pixels) for pixels in one.pixels]), ambient=ambient)

    rig = replace(
        capture.rig,
        camera=replace(capture.rig.camera, image_size=size),
        leds=tuple(led(one) for one in capture.rig.leds),
    )
    return replace(capture, rig=rig, bands={name: band(one) for name, one in capture.bands.items()})


def outline_of(capture: Capture) -> NDArray[np.bool_]:
    """The finger's mask, as a reconstruction finds it."""
    mean, _ = linear_survey(capture.bands["white"], capture.encoding)
    return finger_mask(mean, capture.rig.camera.px_per_mm)


def verdict(mask: NDArray[np.bool_], truth_deg: float) -> tuple[str, str]:
    """``right``, ``right, warned``, ``wrong, warned`` or ``WRONG``, and what was said."""
    upright = find_upright(mask)
    error = (np.rad2deg(upright.yaw_rad) - truth_deg + 180.0) % 360.0 - 180.0
    name = ("right" if abs(error) <= WRONG_DEG else "wrong") + (", warned" if upright.note else "")
    return "WRONG" if name == "wrong" else name, f"{error:.1f} deg off; {upright.note}"


def cut_inside(mask: NDArray[np.bool_], truth_deg: float) -> NDArray[np.bool_]:
    """A mask that ends the finger 27 mm below its tip, inside the picture."""
    upright = find_upright(mask, truth_deg)
    across, along, offset = upright.upright_from_input[1]
    rows, columns = np.indices(mask.shape)
    below = across * columns + along * rows + offset - upright.tip_row
    return mask & (below < 27.0 * default_rig(SCALE).camera.px_per_mm)


def main() -> None:
    """Turn, find, count, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--turns", type=int, default=24)
    parser.add_argument("--whole", type=int, default=0)
    parser.add_argument("--table", type=Path, default=TABLE)
    options = parser.parse_args()
    counts: dict[str, Counter[str]] = {name: Counter() for name in (*SHAPES, *OTHERS)}
    for seed in options.seeds:
        capture, yaw = large_capture(seed)
        capture = replace(capture, bands={"white": capture.bands["white"]})
        for angle in np.arange(options.turns) * 360.0 / options.turns:
            for name, size in {**SHAPES, **OTHERS}.items():
                try:
                    mask = outline_of(turned(capture, float(angle), size))
                    if size == (SIDE, SIDE):
                        mask = cut_inside(mask, yaw + float(angle))
                    found, said = verdict(mask, yaw + float(angle))
                except BadInput as refusal:
                    found, said = "refused", str(refusal)
                counts[name][found] += 1
                if found != "right":
                    print(seed, angle, name, found, said, flush=True)
    names = ("right", "right, warned", "wrong, warned", "WRONG", "refused")
    lines = [["picture", "right", "right_warned", "wrong_warned", "wrong_not_warned", "refused"]]
    lines += [[shape, *(str(count[name]) for name in names)] for shape, count in counts.items()]
    with options.table.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)
    print("\n".join(", ".join(line) for line in lines))
    if options.whole:
        print(matched(options.seeds[0], options.whole))


def matched(seed: int, turns: int) -> str:
    """How similar the ridges of a turned finger are to those of another impression that points up."""
    capture, _ = large_capture(seed)
    size = (560, 560)
    templates = []
    for angle in np.arange(turns) * 360.0 / turns:
        result = reconstruct(turned(capture, float(angle), size), "metric")
        templates.append(surface_template(surface_of(result)))
    scores = [ridge_match(one, templates[0]).similarity for one in templates[1:]]
    return (
        f"Finger {seed}, square, `metric`: similarity of {len(scores)} turned captures with the upright one "
        f"{min(scores):.2f} to {max(scores):.2f}."
    )


if __name__ == "__main__":
    main()
