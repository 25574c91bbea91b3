"""``splitknit view``: look at results in the browser."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from pathlib import Path
from typing import Any

from splitknit.cli.gallery_options import add_key
from splitknit.cli.verb import Outcome, new_verb


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


def _run(options: argparse.Namespace) -> Outcome:
    """Serve until Ctrl-C; messages are printed before."""
    from splitknit.viewer.server import open_paths, opened_page, start

    service = open_paths(options.paths, options.capture, options.key_file)
    server = start(service, options.port)
    facts = {"url": server.url, "port": server.server_port, "results": len(service.catalogue.entries)}
    with contextlib.ExitStack() as stack:
        stack.callback(server.server_close)
        shown = not options.no_browser and stack.enter_context(opened_page(server.url))
        lines = [f"{server.url}", f"{'Shown in the browser' if shown else 'Open this address'}; Ctrl-C ends it."]
        print(json.dumps(facts, indent=1) if options.json else "\n".join(lines), file=sys.stdout, flush=True)
        server.run()
    return {}, []


def _port(text: str) -> int:
    value = int(text) if text.isascii() and text.isdigit() and len(text) < 6 else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"'{text}' must be a port from 0 to 65535 (0: any free one)")
    return value
