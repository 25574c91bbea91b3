"""Many objects, each photographed into a folder of its own: a result of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.arguments import Device, Progress
from splitknit.errors import Refused
from splitknit.folders import reconstruct_to_folder
from splitknit.io.enrolment import PLAN_FILE
from splitknit.io.photograph_files import natural_order
from splitknit.io.photographs import GivenPhotographs
from splitknit.io.photos import SUFFIXES


def objects_in(folder: Path) -> list[Path]:
    """Folders of photographs, and capture folders, in a folder that is no population."""
    if not folder.is_dir() or (folder / PLAN_FILE).is_file():
        return []
    inner = sorted(folder.iterdir(), key=lambda path: natural_order(path.name))
    return [path for path in inner if path.is_dir() and _is_object(path)]


def _is_object(folder: Path) -> bool:
    names = (path.name.lower() for path in folder.iterdir())
    return any(name == "capture.json" or name.endswith(tuple(SUFFIXES)) for name in names)


def reconstruct_objects(
    objects: list[Path],
    out: Path,
    photographs: GivenPhotographs,
    device: Device,
    progress: Progress,
) -> dict[str, Any]:
    """Write a result of each object to a folder of its name in `out`, unless it is there; return
    the facts.

    `photographs`: what is known of the photographs of all. Raises Refused, when all else is done,
    if some cannot be reconstructed.
    """
    facts: dict[str, Any] = {"out": str(out), "found": 0, "objects": {}, "failures": {}}
    for number, source in enumerate(objects):
        progress(source.name, number / len(objects))
        target = out / source.name
        if (target / "report.json").is_file():
            facts["found"] += 1
            continue
        capture = source if (source / "capture.json").is_file() else None
        own = replace(photographs, images=None if capture else source)
        try:
            report = reconstruct_to_folder(capture, out=target, device=device, photographs=own)
        except BadInput as error:
            facts["failures"][source.name] = str(error)
            continue
        findings = [finding["message"] for finding in report.facts["findings"]]
        facts["objects"][source.name] = {"result": report.facts["result"], "findings": findings}
    if failures := facts["failures"]:
        first = next(iter(failures.values()))
        raise Refused(
            f"{len(failures)} of {len(objects)} objects were not reconstructed, the others are"
            f" done; the first: {first}",
            facts,
        )
    return facts
