"""What the verbs do, without the command line: files in, files and facts out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit.apps.outputs import FILES, write_files
from splitknit.apps.targets import check_target
from splitknit.errors import BadInput, require
from splitknit.io import atomic_folder, read_capture, read_npz, read_rig, with_rig, write_capture
from splitknit.model import Capture, Rig
from splitknit.pipeline import preset_settings, reconstruct
from splitknit.settings import override
from splitknit.simulator.rigs import coloured_rig
from splitknit.simulator.scene import TwinSettings
from splitknit.simulator.twin import simulate_capture

Progress = Callable[[str, float], None]

TRUTH_ARRAYS = ("height_mm", "shape_mm", "mask", "normals")


def no_progress(stage: str, share: float) -> None:
    """Say nothing."""


def reconstruct_to_folder(
    capture_folder: Path,
    out: Path,
    *,
    preset: str = "metric",
    rig: Path | None = None,
    changes: Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Read a capture, reconstruct it, write all results; return the facts of ``report.json`` and more.

    `rig` names a rig file that replaces the capture's own, such as a later calibration.
    """
    started = time.perf_counter()
    settings = dict(changes or {})
    override(preset_settings(preset), settings)  # a wrong setting is refused before the images are read
    check_target(out, "height.npz", "an earlier result", keep=capture_folder)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        capture = read_capture(capture_folder)
        if rig is not None:
            capture = with_rig(capture, rig)
        read_s = time.perf_counter() - started
        with _naming(capture_folder):
            result = reconstruct(
                capture, preset, settings, progress=lambda stage, share: progress(stage, 0.15 + 0.65 * share)
            )
            result = replace(result, timings_s={"reading": read_s, **result.timings_s})
            progress("writing", 0.8)
            capture = _shown_of(capture)
            facts = write_files(result, capture, target, truth_of(capture))
    progress("done", 1.0)
    return {
        **facts,
        "out": str(out),
        "files": list(FILES),
        "area_mm2": facts["result"]["area_mm2"],
        "total_s": time.perf_counter() - started,
    }


@contextmanager
def _naming(folder: Path) -> Iterator[None]:
    """Let what stages refuse, which know arrays only, name the capture."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{folder}: {error}") from error


def _shown_of(capture: Capture) -> Capture:
    """The capture with the images that a report shows; the others are let go, for the sake of memory."""
    bands = {
        name: band if name == "white" else replace(band, pixels=band.pixels[:0].copy(), ambient=None)
        for name, band in capture.bands.items()
    }
    return replace(capture, bands=bands)


def truth_of(capture: Capture) -> dict[str, Any] | None:
    """Read a simulator's truth, if the capture names one, and only what is compared."""
    if capture.truth is None:
        return None
    truth = read_npz(capture.truth, TRUTH_ARRAYS)  # only what is compared: the rest is large
    for name, array in truth.items():
        expected = (*capture.shape, 3) if name == "normals" else capture.shape
        require(
            array.shape == expected and array.dtype.kind in "fiub",
            f"{capture.truth}: the truth's {name} has the shape {array.shape}, but the images have {capture.shape}; "
            "simulate the capture again.",
        )
    return dict(truth)


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
        require(scale is None, "the rig file says how large the images are; leave out the scale.")
        settings = replace(settings, rig=read_rig(rig))
    if lights != "white":
        settings = replace(settings, rig=coloured_lights(lights, settings))
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


# Coloured LEDs of a simulated capture: what ``--lights`` stands for.

EXPOSURES = {"coloured": 2, "coloured9": 3}


def coloured_lights(lights: str, settings: TwinSettings) -> Rig:
    """The rig with coloured LEDs in place of its white ones.

    Raises
    ------
    BadInput
        If something else is asked for that has LEDs of its own, or takes them one by one.
    """
    require(settings.rig is None, "a rig file says which LEDs there are; leave out --lights, or --rig.")
    require(not settings.mirrors.names, "mirrors have white LEDs in the twin; leave out --mirrors or --lights.")
    return coloured_rig(settings.scale, settings.rig_seed, settings.intensity_spread, EXPOSURES[lights])
