"""``splitknit view``: look at results in the browser."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from splitknit.cli.verb import Verb, wants_json
from splitknit.errors import require
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Help, Job, KeyFile, Progress, path

if TYPE_CHECKING:
    from splitknit.viewer.server import Answering


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
    # fmt: on

    def open(self, stack: contextlib.ExitStack) -> tuple[Answering, dict[str, Any]]:
        """What is served, until `stack` ends, and facts on it."""
        from splitknit.viewer.server import open_paths

        service = open_paths([path(one) for one in self.paths], path(self.capture), path(self.key_file))
        return service, {"results": len(service.catalogue.entries)}

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
