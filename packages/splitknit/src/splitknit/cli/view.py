"""``splitknit view``: look at results in the browser, or at what a camera sees now."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from splitknit.cli.verb import Verb, wants_json
from splitknit.errors import require
from splitknit.registry import RIG, VIEWS, extension
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Encoding, Help, Job, KeyFile, Progress, path, refuse_given

if TYPE_CHECKING:
    from splitknit.viewer.server import Answering

_LIVE = "live: a gel sensor under three colours, frame by frame"
_OF_LIVE = ("shading", "flat", "marker_px", "exposure_ms", "fps", "encoding", "out")


def _port(text: str) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 6 else -1
    require(0 <= value <= 65535, f"'{text}' must be a port from 0 to 65535 (0: any free one)")
    return value


@dataclass(frozen=True, slots=True)
class ViewJob(Job):
    """Look at results and photographs in the browser, on this machine only."""

    # fmt: off
    paths: Annotated[tuple[AnyPath, ...], Help(
        "a result, a folder of results, two results to compare, a capture or a folder of photographs, or a gallery; "
        "nothing: a page to drop results onto", "PATH", positional=True)] = ()
    _: KW_ONLY
    capture: Annotated[AnyPath | None, Help("photographs the results are from", "FOLDER")] = None
    key_file: KeyFile = None
    port: Annotated[int, Limits(0, 65535), Help("port to listen on (default: any free one)", "N", read=_port)] = 0
    browser: Annotated[bool, Help("do not open the page, only print its address")] = True
    live: Annotated[str | None, Help(
        "camera number (0), or a film or folder of frames to play", "SOURCE", group=_LIVE)] = None
    shading: Annotated[AnyPath | None, Help(
        "calibration; without it the frames alone are shown", "FILE", group=_LIVE)] = None
    flat: Annotated[AnyPath | None, Help(
        "frame of the gel with nothing on it (default: the first)", "FILE", group=_LIVE)] = None
    marker_px: Annotated[float | None, Help(
        "diameter of the dots on the gel (default: no dots)", "PX", group=_LIVE)] = None
    exposure_ms: Annotated[float | None, Help("of the camera (default: as it is set)", "MS", group=_LIVE)] = None
    fps: Annotated[float | None, Help("at which a folder of frames is played (default: 10)", "N", group=_LIVE)] = None
    encoding: Annotated[Encoding | None, Help("how frames of files store light (default: linear)", group=_LIVE)] = None
    out: Annotated[AnyPath | None, Help("folder for what the page saves (default: live)", "DIR", group=_LIVE)] = None
    # fmt: on

    def open(self, stack: contextlib.ExitStack) -> tuple[Answering, dict[str, Any]]:
        """What is served, until `stack` ends, and facts on it."""
        refuse_given(self, () if self.live is not None else _OF_LIVE, "belongs to `live` SOURCE.")
        if self.live is None:
            from splitknit.viewer.server import open_paths  # a live view needs none of it

            service = open_paths([path(one) for one in self.paths], path(self.capture), path(self.key_file))
            return service, {"results": len(service.catalogue.entries)}
        require(not (self.paths or self.capture), "a live view is shown alone; name no results beside `live`.")
        refuse_given(self, () if self.shading is not None else ("flat", "marker_px"), "needs `shading` FILE.")
        found: tuple[Answering, dict[str, Any]] = extension(VIEWS, "live", "the live view", RIG)(self, stack)
        return found

    def run(self, progress: Progress) -> None:
        """Serve until Ctrl-C; messages are printed before."""
        from splitknit.viewer.server import opened_page, start

        with contextlib.ExitStack() as stack:
            service, facts = self.open(stack)
            server = start(service, self.port)
            stack.callback(server.server_close)
            facts = {"url": server.url, "port": server.server_port, **facts}
            shown = self.browser and stack.enter_context(opened_page(server.url))
            lines = [f"{server.url}", f"{'Shown in the browser' if shown else 'Open this address'}; Ctrl-C ends it."]
            print(json.dumps(facts, indent=1) if wants_json() else "\n".join(lines), file=sys.stdout, flush=True)
            server.run()


VIEW = Verb(ViewJob, lambda nothing, job: ({}, []))
