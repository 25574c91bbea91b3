"""``splitknit forget --person NAME PLACE...``: erase all that is kept of a person."""

from __future__ import annotations

import sys
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any

from splitknit import AnyPath, Help, Job, KeyFile, Outcome, Progress, Refused, Verb, count, path, printable, wants_json


@dataclass(frozen=True, slots=True)
class ForgetJob(Job):
    """Erase all that is kept of a person in galleries and folders."""

    # fmt: off
    places: Annotated[tuple[AnyPath, ...], Help(
        "galleries, and folders that are searched with all that is in them: captures, populations, results, shards, "
        "stores of batches, exports", "PLACE", positional=True)]
    _: KW_ONLY
    person: Annotated[tuple[str, ...], Help(
        "as galleries and captures have it; repeated where a person has several (Ann and S01)", "NAME")]
    yes: Annotated[bool, Help("erase without asking")] = False
    key_file: KeyFile = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Show what is there, ask, erase."""
        from splitknit_match.batch.forget import forget  # verbs import what they need
        from splitknit_match.gallery.key import key_of

        key, places = key_of(self.key_file), [path(one) for one in self.places]
        if not self.yes:
            facts = forget(self.person, places, key=key, erase=False)
            if wants_json() or not _agreed(facts):
                raise Refused("nothing was erased; give `yes` to erase what was found.", facts)
        return forget(self.person, places, key=key, erase=True)


def _show(facts: dict[str, Any], job: ForgetJob) -> Outcome:
    lines = [f"Erased {line}" for line in _found(facts)] or ["Nothing was found."]
    lines += [f"Please note: {path} still holds the name; look at it." for path in facts["mentions"]]
    if facts["unnamed"]:
        files = count(len(facts["unnamed"]), "file")
        lines.append(f"Please note: {files} of fingers state no person (first: {facts['unnamed'][0]}); look at them.")
    lines.append("Not reached: copies elsewhere, backups, snapshots, object storage, and what was printed or sent.")
    return facts, lines


FORGET = Verb(ForgetJob, _show)


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
