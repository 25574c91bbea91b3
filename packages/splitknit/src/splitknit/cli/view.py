"""``splitknit view``: a result's surface in the browser."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import KW_ONLY, dataclass
from typing import Annotated

from splitknit.cli.verb import Verb, wants_json
from splitknit.errors import require
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Help, Job, Progress, path


def _port(text: str) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 6 else -1
    require(0 <= value <= 65535, f"'{text}' must be a port from 0 to 65535 (0: any free one)")
    return value


@dataclass(frozen=True, slots=True)
class ViewJob(Job):
    """Look at a result's surface in the browser, on this machine only."""

    # fmt: off
    result: Annotated[AnyPath, Help("folder of a result", positional=True)]
    _: KW_ONLY
    port: Annotated[int, Limits(0, 65535), Help("port to listen on (default: any free one)", "N", read=_port)] = 0
    browser: Annotated[bool, Help("do not open the page, only print its address")] = True
    # fmt: on

    def run(self, progress: Progress) -> None:
        """Serve until Ctrl-C; messages are printed before."""
        from splitknit.io.results import read_result
        from splitknit.viewer.server import opened_page, pages_of, start

        folder = path(self.result)
        with contextlib.ExitStack() as stack:
            server = start(pages_of(read_result(folder), folder.name), self.port)
            stack.callback(server.server_close)
            shown = self.browser and stack.enter_context(opened_page(server.url))
            facts = {"url": server.url, "port": server.server_port}
            lines = [f"{server.url}", f"{'Shown in the browser' if shown else 'Open this address'}; Ctrl-C ends it."]
            print(json.dumps(facts, indent=1) if wants_json() else "\n".join(lines), file=sys.stdout, flush=True)
            server.run()


VIEW = Verb(ViewJob, lambda nothing, job: ({}, []))
