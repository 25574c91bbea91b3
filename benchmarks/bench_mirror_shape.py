"""The shape from one image and mirrors, of 3000 x 2000 pixels: finding the views, the fit, and z over every pixel.

    python benchmarks/bench_mirror_shape.py [--rounds 5]

One simulated finger is drawn flat: its views' masks as a picture of skin colour on a dark background, with noise. On a
busy machine the processor's seconds show more than those on the wall; given are the minimum of the rounds, and the
median of the processor's.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.views import view_binning, views_in
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface, placement_of
from splitknit_simulator.finger.raycast import PlacedFinger
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map
from splitknit_simulator.mirror_view import mirror_view
from splitknit_simulator.rigs import MirrorSettings, mirror_rig
from timing import machine

SIZE = (2000, 3000)
PX_PER_MM = 40.0


def drawn() -> tuple[dict[str, np.ndarray], Any]:
    """Masks (H, W) of all views, and the rig."""
    rig = mirror_rig(
        MirrorSettings(names=("left", "right", "tip"), nir=False, px_per_mm=PX_PER_MM, image_size=SIZE), 1.0
    )
    finger = draw_finger(9002)
    body, master = FingerBody(finger.shape), finger.master()
    pose = FingerPose(yaw_rad=0.06, insertion_mm=24.0)
    placement, skin = placement_of(body, pose, rig.camera), skin_map(master, finger.skin)
    masks = {"front": finger_surface(replace(finger, printed=master), pose, rig.camera).mask}
    for mirror in rig.mirrors:
        masks[mirror.name] = mirror_view(PlacedFinger(body, skin, placement), rig.camera, mirror).mask
    return masks, rig


def picture(masks: dict[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1] with these mirrors."""
    mask = np.logical_or.reduce([masks[name] for name in ("front", *names)])
    rng = np.random.default_rng(0)
    image = np.where(mask[..., None], np.float32([0.6, 0.42, 0.33]), np.float32(0.02))
    image = cv2.GaussianBlur(image, (0, 0), 2.0) + rng.normal(0.0, 0.01, image.shape).astype(np.float32)
    return np.asarray(image, dtype=np.float32)


def timed(work: Callable[[], Any], rounds: int) -> tuple[Any, dict[str, float]]:
    """Result, the least seconds on the wall, and the least and the middle ones of the processor."""
    seconds = []
    for _ in range(rounds):
        wall, processor = time.perf_counter(), time.process_time()
        result = work()
        seconds.append((time.perf_counter() - wall, time.process_time() - processor))
    wall, processor = (sorted(column) for column in zip(*seconds, strict=True))
    found = {"wall_s": wall[0], "processor_s": processor[0], "processor_median_s": processor[len(processor) // 2]}
    return result, {name: round(value, 3) for name, value in found.items()}


def bench(image: np.ndarray, rig: Any, names: tuple[str, ...], rounds: int) -> dict[str, Any]:
    """All steps with these mirrors alone."""
    binning = view_binning(rig.camera.px_per_mm)
    rig = replace(rig, mirrors=tuple(mirror for mirror in rig.mirrors if mirror.name in names))

    def views() -> Any:
        size = (image.shape[1] // binning, image.shape[0] // binning)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return views_in(small, rig, binning)

    found, first = timed(views, rounds)
    shape, second = timed(lambda: mirror_shape(found, rig), rounds)
    rows, columns = (np.flatnonzero(found.front.any(axis=k)) * binning for k in (1, 0))
    window = slice(int(rows[0]), int(rows[-1])), slice(int(columns[0]), int(columns[-1]))
    (_, _, z), third = timed(lambda: shape.points(*window), rounds)
    steps = {"views": first, "fit": second, "heights": third}
    total = {name: round(sum(step[name] for step in steps.values()), 3) for name in first}
    return {**steps, "total": total, "pixels": int(np.isfinite(z).sum())}


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    cases = (("left",), ("left", "right"), ("left", "right", "tip"))
    masks, rig = drawn()
    found = {" ".join(names): bench(picture(masks, names), rig, names, options.rounds) for names in cases}
    print(json.dumps({"machine": machine(), **found}, indent=1))


if __name__ == "__main__":
    main()
