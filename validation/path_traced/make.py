"""Eight fingers photographed by random walks in their volume: other light and skin than the fast twin's.

    python validation/path_traced/make.py --out DIR            # a run that was stopped goes on
    python validation/path_traced/make.py --out DIR --smoke    # two tiny fingers, half a minute

Needs the extra ``reference`` (numba). Each finger becomes a capture folder with ``truth.npz`` and ``info.json``, which
has all optics and the noise of the walks. The same arguments give the same bytes, whatever the number of threads.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from walked_finger import FingerOptics, photograph_finger

from splitknit.errors import BadInput
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import write_capture
from splitknit.simulator.scene import TwinSettings
from splitknit.simulator.surface import SimulatedSurface
from splitknit.simulator.twin import lay_down


@dataclass(frozen=True, slots=True)
class Case:
    """One finger."""

    name: str
    seed: int
    pattern: str
    optics: FingerOptics
    ridges: bool = True


THIRD = 1 / 3
CASES = (
    # spread, scattering, epidermis, melanin, blood, mottle, mottle size, roughness, gloss, noise
    Case("third_matt", 9101, "loop", FingerOptics(THIRD, 0.5, 0.12, 0.002, 0.006, 0.15, 1.0, 0.25, 0.0, 0.005)),
    Case("refracted_glossy", 9102, "whorl", FingerOptics(0.0, 0.6, 0.10, 0.0015, 0.005, 0.10, 1.5, 0.30, 1.0, 0.005)),
    Case("diffuse_glossy", 9103, "loop", FingerOptics(1.0, 0.8, 0.20, 0.004, 0.008, 0.20, 0.7, 0.20, 1.0, 0.004)),
    Case("third_dark_glossy", 9104, "whorl", FingerOptics(THIRD, 0.4, 0.25, 0.006, 0.010, 0.20, 2.0, 0.40, 1.3, 0.007)),
    Case("refracted_matt", 9105, "arch", FingerOptics(0.0, 1.0, 0.05, 0.001, 0.004, 0.15, 0.5, 0.15, 0.0, 0.003)),
    Case("diffuse_matt", 9106, "whorl", FingerOptics(1.0, 1.5, 0.15, 0.003, 0.012, 0.25, 3.0, 0.25, 0.0, 0.010)),
    Case("no_ridges", 9107, "loop", FingerOptics(THIRD, 0.6, 0.15, 0.002, 0.006, 0.20, 0.6, 0.30, 1.0, 0.005), False),
    Case("thin_glossy", 9108, "loop", FingerOptics(THIRD, 0.3, 0.08, 0.002, 0.004, 0.10, 1.0, 0.45, 1.0, 0.008)),
)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Fingers photographed by random walks in their volume.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the captures")
    parser.add_argument("--fingers", type=int, default=len(CASES), help="how many, 1 to 8")
    parser.add_argument("--scale", type=float, default=0.3, help="of the images; 1 is 2200 x 3200 pixels")
    parser.add_argument("--walks", type=float, default=16.0, help="for each pixel and channel")
    parser.add_argument("--threads", type=int, default=2, help="the result does not depend on it")
    parser.add_argument("--smoke", action="store_true", help="two tiny fingers of few walks")
    options = parser.parse_args(arguments)
    if options.smoke:
        options.fingers, options.scale, options.walks = 2, 0.08, 2.0
    try:
        for case in CASES[: options.fingers]:
            folder = options.out / case.name
            if not (folder / "info.json").exists():
                make(case, folder, options.scale, options.walks, options.threads)
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def make(case: Case, folder: Path, scale: float, walks: float, threads: int) -> None:
    """Photograph one finger and write its folder."""
    started = time.perf_counter()

    def progress(step: str, fraction: float) -> None:
        if sys.stderr.isatty():
            print(f"\r{case.name}: {step} {100 * fraction:3.0f} %   ", end="", file=sys.stderr, flush=True)

    laid = lay_down(case.seed, case.pattern, TwinSettings(scale=scale))
    surface = laid.surface if case.ridges else without_ridges(laid.surface)
    capture, truth, info = photograph_finger(
        surface, laid.rig, case.optics, walks=walks, rays=max(round(0.8 * walks), 2), threads=threads, seed=case.seed,
        progress=progress,
    )  # fmt: skip
    info |= {"name": case.name, "pattern": case.pattern, "ridges": case.ridges, "scale": scale}
    with atomic_folder(folder) as target:
        write_capture(capture, target, truth, overwrite=True)
        (target / "info.json").write_text(json.dumps(info, indent=1) + "\n")
    worst = max(channel["noise"]["common"] for channel in info["channels"].values())
    print(f"{case.name}: {time.perf_counter() - started:.0f} s, noise of the walks {100 * worst:.1f} %", flush=True)


def without_ridges(surface: SimulatedSurface) -> SimulatedSurface:
    """The same finger with smooth skin."""
    return replace(
        surface, height_mm=surface.shape_mm, normals=surface.shape_normals, relief_um=0.0 * surface.relief_um
    )


if __name__ == "__main__":
    sys.exit(main())
