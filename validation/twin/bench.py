"""The bench of the twin in figures and in one picture: time, corners, highlights, and where a shadow's end is.

Run ``python validation/twin/bench.py [--picture docs/images/bench.jpg]``: a minute or two on one core.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.model import nominal_rig
from splitknit_simulator.calibration_set.bench import BenchSettings, photograph_bench, well_exposed
from splitknit_simulator.calibration_set.flat import BoardScene, CardScene, PrintedBoard, board_poses
from splitknit_simulator.calibration_set.solids import NailScene, SphereScene
from splitknit_simulator.camera.device import LitScene
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.rigs import built_rig


def things(seed: int, scale: float) -> dict[str, Any]:
    """Camera and LEDs of a built rig."""
    rig = built_rig(seed, scale=scale)
    return {"camera": rig.camera, "leds": rig.leds}


def board_scene(seed: int, scale: float, **changes: Any) -> BoardScene:
    """A board held in one way."""
    camera = built_rig(seed, scale=scale).camera
    places = board_poses(seed, 1, camera)[0]
    return BoardScene(**things(seed, scale), **places, **changes)


def print_times() -> None:
    """Processor time of the first light of a scene and of a further one."""
    for scale in (0.2, 1.0):
        own = things(1, scale)
        makers: dict[str, Callable[[], LitScene]] = {
            "card": lambda own=own: CardScene(**own),
            "board": lambda scale=scale: board_scene(1, scale),
            "nail": lambda own=own: NailScene(**own, position_mm=(3.0, 2.0)),
            "chrome ball": lambda own=own: SphereScene(**own),
            "matt ball": lambda own=own: SphereScene(**own, chrome=False),
        }
        for name, make in makers.items():
            start = time.process_time()
            scene = make()
            scene.light([0])
            middle = time.process_time()
            scene.light([1])
            end = time.process_time()
            print(f"scale {scale:g}, {name:11}: {middle - start:5.2f} s, each further light {end - middle:5.2f} s")


def print_corners() -> None:
    """Distance of OpenCV's sub-pixel corners from the truth, without noise."""
    for blur in (0.0, 0.02):
        squares, mean = [], []
        for seed in range(4):
            scene = board_scene(seed, 0.3, board=PrintedBoard(print_blur_mm=blur))
            light = scene.light([0, 2, 4])[..., 1]
            image = np.clip(light * (250 / light.max()), 0, 255).astype(np.uint8)
            truth = scene.truth_corners()
            start = truth.astype(np.float32)[:, None].copy()
            found = cv2.cornerSubPix(image, start, (7, 7), (-1, -1), (3, 100, 1e-5))[:, 0]
            squares.append(np.sum((found - truth) ** 2, axis=1))
            mean.append((found - truth).mean(axis=0))
        print(
            f"corners, print blur {blur:g} mm: rms {np.sqrt(np.mean(squares)):.3f} px, "
            f"means up to {np.abs(mean).max():.3f} px (scale 0.3)"
        )


def print_highlights() -> None:
    """Distance of the chrome ball's brightest spots from the truth."""
    scene = SphereScene(**things(2, 0.3), position_mm=(-4.0, 2.0), surround=0.0, ground=0.0)
    row, column = np.indices(scene.camera.image_size)
    worst = 0.0
    for k, place in enumerate(scene.highlights_px()):
        light = scene.light([k])[..., 1] - scene.light([])[..., 1]
        middle = [float((light * axis).sum() / light.sum()) for axis in (column, row)]
        worst = max(worst, float(np.hypot(*(np.array(middle) - place))))
    print(f"highlights of 14 LEDs: at most {worst:.3f} px (scale 0.3)")


def print_shadow_ends() -> None:
    """Where the shadow of a nail 13 mm high ends, measured from its tip's middle, by the tip's and the LED's radius."""
    rig = nominal_rig(1.0)
    for led_radius in (0.0, 1.5):
        for tip_radius in (0.05, 0.15, 0.3):
            own = {"camera": rig.camera, "leds": rig.leds[:1], "bench": BenchSettings(0.0, led_radius)}
            nail = NailScene(**own, nail_mm=13.0, tip_radius_mm=tip_radius)
            fraction = nail.light([0])[..., 1] / CardScene(**own, reflectance=nail.ground).light([0])[..., 1]
            tip = nail.shadow_tips_px()[0]  # on the row through the middle, to the left
            reach = np.linspace(-1.0, 1.0, 401)
            places = np.stack([tip[0] - reach * rig.camera.px_per_mm, np.full(401, tip[1])], axis=1).astype(np.float32)
            along = cv2.remap(fraction, places[None, :, 0], places[None, :, 1], cv2.INTER_LINEAR)[0]
            ends = [reach[int(np.argmax(along > level))] for level in (0.1, 0.5, 0.9)]
            print(
                f"LED radius {led_radius:g} mm, tip radius {tip_radius:g} mm: the shadow falls to 10, 50, 90 % at "
                + ", ".join(f"{end:+.2f}" for end in ends)
                + " mm behind the tip's shadow"
            )


def picture() -> np.ndarray:
    """All things on the bench as the camera stores them, sRGB."""
    scale, sensor = 0.2, SensorSettings(encoding="srgb")
    own = things(1, scale)
    tilt = tuple(built_rig(1).provenance["base_tilt_deg"])
    scenes: list[tuple[LitScene, list[int]]] = [
        (CardScene(**own, tilt_deg=tilt), [0]),
        (board_scene(1, scale), [3]),
        (board_scene(2, scale), [0, 2, 4]),
        (NailScene(**own, position_mm=(3.0, 2.0), tilt_deg=tilt), [2]),
        (SphereScene(**own, tilt_deg=tilt), [0, 2, 3, 5]),
        (SphereScene(**own, chrome=False, ground=0.3, tilt_deg=tilt), [5]),
    ]
    tiles = []
    for scene, lit in scenes:
        level = well_exposed(CardScene(**own), [lit], 0.7 if lit != [0, 2, 3, 5] else 6.0)
        tiles.append(photograph_bench(scene, lit, 1, exposure=level, sensor=sensor))
    rows = [np.hstack(tiles[:3]), np.hstack(tiles[3:])]
    whole = np.vstack(rows)
    return cv2.resize(whole, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def main() -> None:
    """Print the figures, or make the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path, help="JPEG to write instead")
    options = parser.parse_args()
    if options.picture:
        done, data = cv2.imencode(".jpg", picture()[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
        assert done
        options.picture.write_bytes(data.tobytes())
        return
    print_times()
    print_corners()
    print_highlights()
    print_shadow_ends()


if __name__ == "__main__":
    main()
