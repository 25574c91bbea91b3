"""A rig of one's own in Python: its LEDs from the shadows of a nail, and what a wrong place costs.

    python examples/plot_calibrate_rig.py [--nails 4] [--tip-error-px 1]

The nail stands in some places under a rig as people build them (simulated); the shadow tips are
read with an error. The thesis's construction and the joint fit are compared with the truth, for the
LEDs of the white band.
"""

from __future__ import annotations

import argparse

import numpy as np

from splitknit.model import Rig
from splitknit_rig.calibration.lights import Circle, Tip, by_circle
from splitknit_rig.calibration.nail import by_joint_fit
from splitknit_simulator.calibration_set.solids import NailScene
from splitknit_simulator.rigs import built_rig

PLACES_MM = ((-5.0, -3.5), (5.5, -3.0), (4.5, 4.0), (-5.5, 3.5))


def read_tips(rig: Rig, nails: int, error_px: float) -> list[Tip]:
    """The table that a person would type: nail tips and shadow tips in pixels."""
    rng = np.random.default_rng(0)
    tips = []
    for nail, place in enumerate(PLACES_MM[:nails], start=1):
        tilt = rig.provenance["base_tilt_deg"]
        scene = NailScene(
            camera=rig.camera, leds=rig.leds, position_mm=place, tilt_deg=(tilt[0], tilt[1])
        )
        seen = scene.tip_px() + error_px * rng.standard_normal(2)
        shadows = scene.shadow_tips_px() + error_px * rng.standard_normal((len(rig.leds), 2))
        for led in range(7):
            tips.append(
                Tip(
                    "white",
                    led,
                    nail,
                    (float(seen[0]), float(seen[1])),
                    tuple(map(float, shadows[led])),
                )
            )
    return sorted(tips, key=lambda tip: (tip.led, tip.nail))


def angle_deg(estimate: np.ndarray, true: np.ndarray) -> float:
    """Between the directions from the middle of the finger plane."""
    cosine = estimate @ true / (np.linalg.norm(estimate) * np.linalg.norm(true))
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nails", type=int, default=4, choices=(2, 3, 4))
    parser.add_argument("--tip-error-px", type=float, default=1.0)
    options = parser.parse_args(arguments)
    rig = built_rig(7)
    tips = read_tips(rig, options.nails, options.tip_error_px)
    circle = Circle(52.5, 140.0)
    plain, height = by_circle(tips, rig.camera, circle)
    joint = by_joint_fit(tips, rig.camera, circle)
    print(
        f"{len(tips)} tips; the nail is {joint.nail_height_mm:.1f} mm high by the joint fit,"
        f" {height:.1f} by the circle"
    )
    print("LED      circle, mean of nails   joint fit   stated (95 %)   as drawn")
    for k, (circle_led, joint_led) in enumerate(zip(plain, joint.leds, strict=True)):
        true = np.asarray(rig.leds[k].position_mm)
        drawn = 52.5 * np.array([np.cos(2 * np.pi * k / 7), np.sin(2 * np.pi * k / 7), 140 / 52.5])
        errors = [
            angle_deg(np.asarray(p), true)
            for p in (circle_led.position_mm, joint_led.position_mm, drawn)
        ]
        print(
            f"white {k}  {errors[0]:14.2f} deg {errors[1]:13.2f} deg"
            f" {joint_led.interval_deg:9.2f} deg {errors[2]:11.2f} deg"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
