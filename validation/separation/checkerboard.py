"""The checkerboard separation against the twin's own direct light, on palms and fingers.

    python validation/separation/checkerboard.py [--smoke]

takes a quarter of an hour on one core (``--smoke`` seconds), writes ``checkerboard.json`` beside this file and prints a
Markdown summary. The truth is the maximum minus the minimum over *all* phases of a checkerboard of that check
size, in steps of a pixel; what is judged sees only the shifts that a projector takes.

- ``noise_free``: PSNR of direct and global light (peak: 99.9th percentile of that truth), by check size and shifts;
  from 25 images also by symmetry (``symmetry.py``), with the white image or without.
- ``ideal``: opaque skin, where the pattern is ideal: largest error relative to the brightest pixel.
- ``noise``: shot and read noise of the twin's sensor: raw maximum and minimum, against least squares with known states,
  over all lit and dark images or only those in which the pixel lies in the middle of a check, and with states found in
  the images.
- ``ratio``: direct light over surface reflection by check size, a whole finger and a palm under the seven white LEDs.
- ``centred``: the fast truth against the one over all phases; with the projector at its LED, and in the camera's axis.

``--only PART ...`` measures some of them anew and keeps the rest.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from summary import summary
from symmetry import by_symmetry

from splitknit.separate.patterns import checkerboard, estimate_patterns
from splitknit.simulate.diffusion import load_walks
from splitknit.simulate.finger import Pose, draw_finger, finger_surface
from splitknit.simulate.palm import draw_palm, palm_surface
from splitknit.simulate.projector import Checkerboard, pattern_states
from splitknit.simulate.renderer import RenderSettings
from splitknit.simulate.rig import default_rig
from splitknit.simulate.separation import Separated, checkerboard_stack, separate_truth
from splitknit.simulate.skin import ChannelOptics, SkinRanges, SkinSettings
from splitknit.simulate.surface import Surface
from splitknit.types import Camera, Led

HERE = Path(__file__).resolve().parent
PX_PER_MM = 37.85
CHECKS_MM = (0.11, 0.21, 0.42, 0.85)
STEPS = (5, 7, 9)
"""Odd: an even number of shifts shows every checkerboard twice."""
SIZE = (224, 240)
LEDS = default_rig().leds
COAXIAL = Led("white", direction=(0.0, 0.0, 1.0))
OPAQUE = [ChannelOptics(scattering_per_mm=1e6, absorption_per_mm=1e5, relief_gain_per_um=0.0)]
WELL, READ_NOISE = 4700.0, 2.5
"""Electrons, as in the twin's sensor; one colour channel of one pixel, exposed to 0.7 of full scale."""
RENDER = RenderSettings(reach_mm=3.0, workers=1)
"""A shorter reach than the captures': of the light beyond 3 mm the checkerboard leaves nothing."""
WALKS = load_walks()


def surfaces(smoke: bool) -> dict[str, tuple[Surface, SkinSettings, Led]]:
    """Crops of palms and fingers with skins drawn from the population's ranges."""
    size = (96, 104) if smoke else SIZE
    camera = Camera(PX_PER_MM, size)
    result = {}
    for k in range(1 if smoke else 2):
        skin = SkinRanges().draw(np.random.default_rng([17, k]))
        result[f"palm {k}"] = (palm_surface(draw_palm(500 + k), camera), skin, LEDS[k])
        # the pad fills most of the crop, its flank and outline the rest
        pose = Pose(x_mm=3.5 * (-1) ** k, insertion_mm=size[0] / PX_PER_MM + 6.0, roll_rad=0.1)
        finger = finger_surface(draw_finger(500 + k, ("whorl", "left_loop")[k]), pose, camera, workers=1)
        result[f"finger {k}"] = (finger, skin, LEDS[k + 3])
    return result


def inner(surface: Surface, truth: Separated) -> np.ndarray:
    """Pixels that are judged: on the skin, not on its outline, not grazing, lit."""
    mask = cv2.erode(surface.mask[truth.window].astype(np.uint8), np.ones((5, 5))) > 0
    slope = surface.shape_normals[truth.window][..., 2] > 0.5
    lit = truth.white[0] > 0.05 * np.percentile(truth.white[0][mask], 99)
    return np.asarray(mask & slope & lit)


def psnr(error: np.ndarray, truth: np.ndarray) -> float:
    """Peak: the 99.9th percentile of the truth."""
    return float(20 * np.log10(np.percentile(truth, 99.9) / np.sqrt(np.mean(np.square(error, dtype=np.float64)))))


def noise_free(cases: dict[str, Any], checks: Iterable[float], steps: Iterable[int]) -> list[dict[str, Any]]:
    """PSNR of the separation by check size and number of shifts."""
    rows = []
    for name, (surface, skin, led) in cases.items():
        for check in checks:
            truth = separate_truth(surface, led, skin, check_mm=check, walks=WALKS, settings=RENDER)
            mask = inner(surface, truth)
            for count in steps:
                pattern = Checkerboard(check, steps=count)
                stack = checkerboard_stack(surface, led, skin, pattern, walks=WALKS, settings=RENDER)
                found = checkerboard(np.moveaxis(stack, 1, -1), shifts=pattern.shifts_mm(), period=2 * check, mask=mask)
                rows += [
                    _judged((name, check, count**2, "maximum - minimum"), (found.direct, found.global_), truth, mask)
                ]
                if count == 5:
                    light, white = np.moveaxis(stack, 1, -1), np.moveaxis(truth.white, 0, -1)
                    rows += [_judged((name, check, 25, "symmetry"), by_symmetry(light), truth, mask)]
                    rows += [_judged((name, check, 25, "symmetry, white"), by_symmetry(light, white), truth, mask)]
                print(f"  {name} {check} mm {count**2} shifts: {rows[-1]['direct_psnr_db']:.1f} dB", flush=True)
    return rows


def _judged(what: tuple[str, float, int, str], found: tuple[Any, Any], truth: Separated, mask: Any) -> dict[str, Any]:
    """One row: direct and global light (h, w, C) as found against the truth."""
    direct, global_ = (part[mask].T for part in found)
    real, rest, white = truth.direct[:, mask], truth.global_[:, mask], truth.white[:, mask]
    return {
        **dict(zip(("surface", "check_mm", "shifts", "method"), what, strict=True)),
        "check_px": what[1] * PX_PER_MM,
        "direct_psnr_db": psnr(direct - real, real),
        "channels_db": [psnr(direct[c] - real[c], real[c]) for c in range(len(real))],
        "in_units_of_white_db": psnr(direct - real, white),
        "global_psnr_db": psnr(global_ - rest, rest),
        "mean_error": float((direct - real).mean() / real.mean()),
        "direct_share": float(real.mean() / white.mean()),
    }


def ideal(cases: dict[str, Any]) -> list[dict[str, Any]]:
    """Opaque skin: light leaves where it entered, so direct light is all light."""
    rows = []
    for name, (surface, skin, led) in cases.items():
        for check, alpha, dark in ((0.21, 0.5, 0.0), (0.42, 0.5, 0.1), (0.42, 0.25, 0.0), (0.42, 0.75, 0.05)):
            pattern = Checkerboard(check, alpha=alpha, dark=dark)
            truth = separate_truth(surface, led, skin, check_mm=check, walks=WALKS, settings=RENDER, optics=OPAQUE)
            stack = checkerboard_stack(surface, led, skin, pattern, walks=WALKS, settings=RENDER, optics=OPAQUE)
            mask = inner(surface, truth)
            # squares of a quarter of the plane: a pixel on a steep flank may see too few shifts to be lit throughout
            found = checkerboard(np.moveaxis(stack, 1, -1), alpha=alpha, dark=dark, mask=mask)
            error = np.abs(found.direct[..., 0] - truth.direct[0])[mask]
            peak = float(truth.direct[0][mask].max())
            rows.append(
                {
                    "surface": name,
                    "check_mm": check,
                    "alpha": alpha,
                    "dark": dark,
                    "largest_error": float(error.max()) / peak,
                    "global_share": float(np.abs(found.global_[..., 0][mask]).max()) / peak,
                }
            )
    return rows


def noise(cases: dict[str, Any], check: float) -> list[dict[str, Any]]:
    """Bias and error of three estimates on a noisy stack of 25 images."""
    rows = []
    pattern = Checkerboard(check)
    for name, (surface, skin, led) in cases.items():
        truth = separate_truth(surface, led, skin, check_mm=check, walks=WALKS, settings=RENDER)
        mask = inner(surface, truth)
        clean = np.moveaxis(checkerboard_stack(surface, led, skin, pattern, walks=WALKS, settings=RENDER), 1, -1)
        scale = WELL * 0.7 / np.percentile(truth.white[0][mask], 99.9)
        rng = np.random.default_rng(5)
        spread = np.sqrt(np.maximum(clean * scale, 0) + READ_NOISE**2)
        noisy = ((clean * scale + spread * rng.standard_normal(clean.shape)) / scale).astype(np.float32)
        # a blurred state is 1 or 0 only in the middle of a check
        known, middle = (
            _states(surface, led, truth, mask, Checkerboard(check, edge_mm=edge * check)) for edge in (0.0, 0.6)
        )
        found = [estimate_patterns(stack, mask=mask) for stack in (clean, noisy)]
        for method, patterns in (
            ("maximum - minimum", (None, None)),
            ("known states", (known, known)),
            ("known states, middle of the check", (middle, middle)),
            ("states found", found),
        ):
            quiet, loud = (
                checkerboard(stack, mask=mask, patterns=states).direct[mask].T
                for stack, states in zip((clean, noisy), patterns, strict=True)
            )
            real = truth.direct[:, mask]
            rows.append(
                {
                    "surface": name,
                    "check_mm": check,
                    "method": method,
                    "psnr_db": psnr(loud - real, real),
                    "noise_free_psnr_db": psnr(quiet - real, real),
                    "bias_by_noise": [float((loud - quiet)[c].mean() / real[c].mean()) for c in range(3)],
                    "bias": [float((loud - real)[c].mean() / real[c].mean()) for c in range(3)],
                    "rms": [float(np.sqrt(np.mean((loud - real)[c] ** 2)) / real[c].mean()) for c in range(3)],
                }
            )
            print(f"  {name} {method}: {rows[-1]['psnr_db']:.1f} dB", flush=True)
    return rows


def _states(surface: Surface, led: Led, truth: Separated, mask: np.ndarray, pattern: Checkerboard) -> np.ndarray:
    """The pattern's states in the window; beside the judged pixels, where any will do, those of the finger plane."""
    x, y = np.meshgrid(np.arange(mask.shape[1]) / PX_PER_MM, np.arange(mask.shape[0]) / PX_PER_MM)
    states = pattern_states(surface, led, pattern)[(slice(None), *truth.window)]
    beside = np.stack([pattern.state(x, y, shift, 1.0 / PX_PER_MM) for shift in pattern.shifts_mm()])
    return np.where(mask, states, beside)


def ratios(smoke: bool) -> list[dict[str, Any]]:
    """Direct light over surface reflection for the default skin, summed over a surface and the white LEDs."""
    camera = Camera(20.0 if smoke else PX_PER_MM, (200, 200) if smoke else (1060, 720))
    finger = finger_surface(draw_finger(500, "whorl"), Pose(insertion_mm=26.0), camera, workers=1)
    rows = []
    for name, surface in (("finger", finger), ("palm", palm_surface(draw_palm(500), camera))):
        for check in CHECKS_MM:
            total = np.zeros((2, 3))
            for led in LEDS[:7]:
                truth = separate_truth(
                    surface, led, SkinSettings(), check_mm=check, walks=WALKS, settings=RENDER, phases="centred"
                )
                total += truth.direct.sum(axis=(1, 2), dtype=np.float64), np.full(3, truth.glare.sum(dtype=np.float64))
            rows.append({"surface": name, "check_mm": check, "direct_over_glare": (total[0] / total[1]).tolist()})
    return rows


def centred(cases: dict[str, Any], checks: Iterable[float]) -> list[dict[str, Any]]:
    """The fast truth against the full one."""
    rows = []
    for name, (surface, skin, led) in cases.items():
        for check in checks:
            row: dict[str, Any] = {"surface": name, "check_mm": check}
            for place, projector in (("led", led), ("coaxial", COAXIAL)):
                full, fast = (
                    separate_truth(
                        surface, projector, skin, check_mm=check, walks=WALKS, settings=RENDER, phases=phases
                    )
                    for phases in ("all", "centred")
                )
                mask = inner(surface, full)
                real, difference = full.direct[:, mask], (fast.direct - full.direct)[:, mask]
                row[f"{place}_rms"] = float(np.sqrt(np.mean(difference**2)) / real.mean())
                row[f"{place}_mean"] = float(difference.mean() / real.mean())
                row[f"{place}_psnr_db"] = psnr(difference, real)
            rows.append(row)
            print(f"  {name} {check} mm centred: {row}", flush=True)
    return rows


def main() -> None:
    """Run everything and store it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoke", action="store_true", help="small crops, one check size, nothing stored")
    parser.add_argument("--only", nargs="+", help="parts to measure")
    parser.add_argument("--out", type=Path, default=HERE / "checkerboard.json")
    arguments = parser.parse_args()
    start = time.monotonic()
    cases = surfaces(arguments.smoke)
    checks = (0.21,) if arguments.smoke else CHECKS_MM
    one = {name: case for name, case in cases.items() if name.endswith("0")}
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "noise_free": lambda: noise_free(cases, checks, STEPS[:1] if arguments.smoke else STEPS),
        "ideal": lambda: ideal(cases),
        "noise": lambda: noise(one, checks[-1] if arguments.smoke else 0.42),
        "ratio": lambda: ratios(arguments.smoke),
        "centred": lambda: centred(one, checks[:3]),
    }
    results: dict[str, Any] = {"px_per_mm": PX_PER_MM, "size": list(SIZE)}
    if arguments.only:
        results |= json.loads(arguments.out.read_text(encoding="utf-8"))
    results |= {name: part() for name, part in parts.items() if name in (arguments.only or parts)}
    print(summary(results))
    print(f"{time.monotonic() - start:.0f} s")
    if not arguments.smoke:
        arguments.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
