"""A simulated capture as a folder, with its truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit.errors import require
from splitknit.io.atomic import atomic_folder
from splitknit.io.capture import write_capture
from splitknit.io.rig import read_rig
from splitknit.io.targets import check_target
from splitknit.model import Progress, Rig, no_progress
from splitknit.settings import override
from splitknit.simulator.rigs import coloured_rig
from splitknit.simulator.scene import TwinSettings
from splitknit.simulator.twin import simulate_capture


def twin_settings(scale: float | None, changes: Mapping[str, Any] | None) -> TwinSettings:
    """Return the twin's settings with `scale` and single fields replaced."""
    settings = override(TwinSettings(), dict(changes or {}))
    settings = settings if scale is None else replace(settings, scale=scale)
    require(0.05 <= settings.scale <= 1.0, f"scale must lie between 0.05 and 1, but it is {settings.scale:g}.")
    return settings


def simulate_to_folder(
    out: Path,
    *,
    seed: int = 0,
    pattern: str | None = None,
    scale: float | None = None,
    rig: Path | None = None,
    lights: str = "white",
    impression: int = 0,
    changes: Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Simulate a capture and write its folder with the truth; return what was made."""
    started = time.perf_counter()
    settings = twin_settings(scale, changes)
    if rig is not None:
        require(scale is None, "the rig file sets how large the images are; leave out the scale.")
        settings = replace(settings, rig=read_rig(rig))
    if lights != "white":
        settings = replace(settings, rig=_coloured_lights(lights, settings))
    check_target(out, "truth.npz", "an earlier simulated capture")
    with atomic_folder(out) as target:
        progress("simulating", 0.0)
        capture, truth = simulate_capture(seed, pattern, settings, impression=impression)
        progress("writing", 0.8)
        write_capture(capture, target, truth, overwrite=True)
    progress("done", 1.0)
    rows, columns = capture.shape
    return {
        "out": str(out),
        "seed": seed,
        "pattern": str(truth.get("landmark_pattern", pattern or "finger")),
        "images": sum(len(band.leds) for band in capture.bands.values()),
        "image_size": [rows, columns],
        "px_per_mm": capture.rig.camera.px_per_mm,
        "total_s": time.perf_counter() - started,
    }


EXPOSURES = {"coloured": 2, "coloured9": 3}


def _coloured_lights(lights: str, settings: TwinSettings) -> Rig:
    """The rig with coloured LEDs in place of its white ones. Raises BadInput if something else is asked for that has
    LEDs of its own, or takes them one by one.
    """
    require(settings.rig is None, "a rig file defines the LEDs; leave out --lights, or --rig.")
    require(not settings.mirrors.names, "mirrors have white LEDs in the twin; leave out --mirrors or --lights.")
    return coloured_rig(settings.scale, settings.rig_seed, settings.intensity_spread, EXPOSURES[lights])
