"""The live part of ``splitknit view``: a gel sensor, frame by frame."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit import path, require

if TYPE_CHECKING:
    from collections.abc import Callable

    from splitknit import ViewJob
    from splitknit_rig.capture.live import LiveFrame, LiveService


def open_live(job: ViewJob, stack: contextlib.ExitStack) -> tuple[LiveService, dict[str, Any]]:
    """Open the source and start measuring; both end with `stack`."""
    from splitknit import (
        BETWEEN,
        flat_of_fall_off,
        read_image,
        read_shading,
        shading_slopes,
        write_image,
        write_results,
    )
    from splitknit_rig.capture.live import HeightMeter, Live, LiveService, open_frames

    assert job.live is not None
    out, encoding = path(job.out or "live"), job.encoding or "linear"
    shading = None if job.shading is None else read_shading(job.shading)
    exposure_s = None if job.exposure_ms is None else job.exposure_ms / 1000.0
    size = None if shading is None else shading.image_size
    source = open_frames(job.live, encoding, size, exposure_s)
    if job.fps is not None:
        require(0 < job.fps <= 1000, f"`fps` must lie between 0 and 1000, not {job.fps:g}.")
        source = replace(source, period_s=1.0 / job.fps)
    stack.callback(source.close)
    meter: HeightMeter | None = None
    if shading is not None:
        slopes = partial(shading_slopes, shading)
        meter = HeightMeter(slopes, shading.pitch_mm, shading.image_size, source.encoding, job.marker_px or 0.0)
        if job.flat is not None:
            meter.take_flat(read_image(job.flat))
        elif shading.facts.get("flat") == BETWEEN:
            meter.divide_by(flat_of_fall_off(shading.fall_off, shading.image_size))

    def save_photo(frame: LiveFrame[Any]) -> str:
        file = _next(out, ".png")
        write_image(file, frame.pixels)
        return f"written to {file}"

    actions: dict[str, Callable[[LiveFrame[Any]], str]] = {"photo": save_photo}
    facts: dict[str, Any] = {"source": source.name, "encoding": source.encoding}
    if meter is not None:
        taken = meter

        def take_flat(frame: LiveFrame[Any]) -> str:
            taken.take_flat(frame.pixels)
            return "this frame is the flat one now"

        def save_result(frame: LiveFrame[Any]) -> str:
            folder = _next(out, "")
            write_results(frame.measured.result(), None, folder)
            return f"written to {folder}"

        actions |= {"flat": take_flat, "save": save_result}
    live = stack.enter_context(Live(source, lambda pixels: None if meter is None else meter(pixels)))
    page = {"title": source.name, "pitch_mm": 1.0 if shading is None else shading.pitch_mm, "facts": {}}
    return LiveService(live, page, actions), facts


def _next(folder: Path, suffix: str) -> Path:
    """The first free name in a folder, which is made: 0001, 0002 ..."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return next(place for k in count(1) if not (place := folder / f"{k:04d}{suffix}").exists())
