"""``splitknit forget --person NAME PLACE...``: erase all that is kept of a person."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from splitknit.cli.gallery_options import add_key, count
from splitknit.cli.verb import Outcome, new_verb
from splitknit.errors import Refused, printable


def add_forget(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "forget", "erase all that is kept of a person in galleries and folders", _run)
    verb.add_argument(
        "places", type=Path, nargs="+", metavar="PLACE",
        help="galleries, and folders that are searched with all that is in them: captures, populations, results, "
        "shards, stores of batches, exports",
    )  # fmt: skip
    verb.add_argument(
        "--person", action="append", required=True, metavar="NAME",
        help="as galleries and captures have it; repeated where a person has several (Ann and S01)",
    )  # fmt: skip
    verb.add_argument("--yes", action="store_true", help="erase without asking")
    add_key(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Show what is there, ask, erase."""
    from splitknit.batch.forget import forget  # verbs import what they need
    from splitknit.gallery.key import key_of

    key = key_of(options.key_file)
    if not options.yes:
        facts = forget(options.person, options.places, key=key, erase=False)
        if options.json or not _agreed(facts):
            raise Refused("nothing was erased; give --yes to erase what was found.", facts)
    facts = forget(options.person, options.places, key=key, erase=True)
    lines = [f"Erased {line}" for line in _found(facts)] or ["Nothing was found."]
    lines += [f"Please note: {path} still holds the name; look at it." for path in facts["mentions"]]
    if facts["unnamed"]:
        files = count(len(facts["unnamed"]), "file")
        lines.append(f"Please note: {files} of fingers state no person (first: {facts['unnamed'][0]}); look at them.")
    lines.append("Not reached: copies elsewhere, backups, snapshots, object storage, and what was printed or sent.")
    return facts, lines


def _agreed(facts: dict[str, Any]) -> bool:
    unreached = (f"Not looked into: {one['path']}: {one['reason']}" for one in facts["unreached"])
    for line in ("This would be erased:", *(f"  {line}" for line in _found(facts)), *unreached):
        print(printable(line))
    if not sys.stdin.isatty():
        return False
    print("Erase it, for good? Type yes: ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() == "yes"


def _found(facts: dict[str, Any]) -> list[str]:
    lines = [f"{count(one['records'], 'record')} of {one['path']} ({one['what']})" for one in facts["found"]]
    return [*lines, *(f"{folder} (shards, which are made anew)" for folder in facts["shards"])]
