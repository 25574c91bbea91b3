"""``splitknit view``: look at results in the browser, or at what a camera sees now."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.gallery_options import add_key
from splitknit.cli.verb import Outcome, new_verb, refuse_given

if TYPE_CHECKING:
    from collections.abc import Callable

    from splitknit.capture.live import LiveFrame
    from splitknit.viewer.live import LiveService
    from splitknit.viewer.service import Service

_LIVE = ("shading", "flat", "marker_px", "exposure_ms", "fps", "encoding", "out")
"""Options of a live view."""


def add_view(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "view", "look at results and photographs in the browser, on this machine only", _run)
    verb.add_argument(
        "paths",
        type=Path,
        nargs="*",
        metavar="PATH",
        help="a result, a folder of results, two results to compare, a capture or a folder of photographs, or a "
        "gallery; nothing: a page to drop results onto",
    )
    verb.add_argument("--capture", type=Path, metavar="FOLDER", help="photographs the results are from")
    add_key(verb)
    verb.add_argument("--port", type=_port, default=0, metavar="N", help="port to listen on (default: any free one)")
    verb.add_argument("--no-browser", action="store_true", help="do not open the page, only print its address")
    live = verb.add_argument_group("live: a gel sensor under three colours, frame by frame")
    live.add_argument("--live", metavar="SOURCE", help="camera number (0), or a film or folder of frames to play")
    live.add_argument("--shading", type=Path, metavar="FILE", help="calibration; without it the frames alone are shown")
    live.add_argument(
        "--flat", type=Path, metavar="FILE", help="frame of the gel with nothing on it (default: the first)"
    )
    live.add_argument(
        "--marker-px", type=float, metavar="PX", help="diameter of the dots on the gel (default: no dots)"
    )
    live.add_argument("--exposure-ms", type=float, metavar="MS", help="of the camera (default: as it is set)")
    live.add_argument("--fps", type=float, metavar="N", help="at which a folder of frames is played (default: 10)")
    live.add_argument(
        "--encoding", choices=("linear", "srgb"), help="how frames of files store light (default: linear)"
    )
    live.add_argument("--out", type=Path, metavar="DIR", help="folder for what the page saves (default: live)")


def _run(options: argparse.Namespace) -> Outcome:
    """Serve until Ctrl-C; messages are printed before."""
    from splitknit.errors import require
    from splitknit.viewer.server import open_paths, opened_page, start

    refuse_given(options, () if options.live is not None else _LIVE, "belongs to --live SOURCE.")
    with contextlib.ExitStack() as stack:
        service: Service | LiveService
        if options.live is not None:
            require(
                not (options.paths or options.capture), "a live view is shown alone; name no results beside --live."
            )
            service, facts = _open_live(options, stack)
        else:
            service = open_paths(options.paths, options.capture, options.key_file)
            facts = {"results": len(service.catalogue.entries)}
        server = start(service, options.port)
        stack.callback(server.server_close)
        facts = {"url": server.url, "port": server.server_port, **facts}
        shown = not options.no_browser and stack.enter_context(opened_page(server.url))
        lines = [f"{server.url}", f"{'Shown in the browser' if shown else 'Open this address'}; Ctrl-C ends it."]
        print(json.dumps(facts, indent=1) if options.json else "\n".join(lines), file=sys.stdout, flush=True)
        server.run()
    return {}, []


def _open_live(options: argparse.Namespace, stack: contextlib.ExitStack) -> tuple[LiveService, dict[str, Any]]:
    """Open the source and start measuring; both end with `stack`."""
    from dataclasses import replace
    from functools import partial

    from splitknit.capture.live import Live, open_frames
    from splitknit.capture.live_heights import HeightMeter
    from splitknit.errors import require
    from splitknit.io.images import read_image, write_image
    from splitknit.photometric.shading import BETWEEN, flat_of_fall_off, read_shading, shading_slopes
    from splitknit.report.result import write_results
    from splitknit.viewer.live import LiveService

    refuse_given(options, () if options.shading is not None else ("flat", "marker_px"), "needs --shading FILE.")
    out = options.out or Path("live")
    encoding = options.encoding or "linear"
    shading = None if options.shading is None else read_shading(options.shading)
    exposure_s = None if options.exposure_ms is None else options.exposure_ms / 1000.0
    size = None if shading is None else shading.image_size
    source = open_frames(options.live, encoding, size, exposure_s)
    if options.fps is not None:
        require(0 < options.fps <= 1000, f"--fps must lie between 0 and 1000, not {options.fps:g}.")
        source = replace(source, period_s=1.0 / options.fps)
    stack.callback(source.close)
    meter: HeightMeter | None = None
    if shading is not None:
        slopes = partial(shading_slopes, shading)
        meter = HeightMeter(slopes, shading.pitch_mm, shading.image_size, source.encoding, options.marker_px or 0.0)
        if options.flat is not None:
            meter.take_flat(read_image(options.flat))
        elif shading.facts.get("flat") == BETWEEN:
            meter.divide_by(flat_of_fall_off(shading.fall_off, shading.image_size))

    def save_photo(frame: LiveFrame[Any]) -> str:
        path = _next(out, ".png")
        write_image(path, frame.pixels)
        return f"written to {path}"

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
    from itertools import count

    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return next(path for k in count(1) if not (path := folder / f"{k:04d}{suffix}").exists())


def _port(text: str) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 6 else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"'{text}' must be a port from 0 to 65535 (0: any free one)")
    return value
