"""What ``splitknit rig cad`` does: a rig file in, printable parts out.

Into the folder go ``stl/`` (as printed), ``step/`` and ``assembly.step`` (in the rig's frame), ``pictures/``, and
``parts.json`` with dimensions, sizes, masses and checks.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splitknit.apps.building.rig_pictures import write_pictures
from splitknit.apps.targets import check_target
from splitknit.errors import BadInput
from splitknit.io import atomic_folder, file_hash, plain_json, provenance, read_rig
from splitknit.model import Rig
from splitknit.rig.assembly import STACK, STACK_BELOW, build_parts, require_build123d
from splitknit.rig.dimension_checks import check_dimensions
from splitknit.rig.dimension_table import dimension_table
from splitknit.rig.dimensions import dimensions_of
from splitknit.rig.part_files import as_printed, triangles_of, write_assembly, write_step
from splitknit.rig.part_reports import report_part
from splitknit.rig.part_settings import PartSettings
from splitknit.rig.stl import read_stl, write_stl
from splitknit.settings import override
from splitknit.simulator.rig import default_rig

Progress = Callable[[str, float], None]


def cad_to_folder(
    out: Path,
    *,
    rig_file: Path | None = None,
    changes: Mapping[str, Any] | None = None,
    below: bool = False,
    pictures: bool = True,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Draw, check and write all parts of a rig; return the document of ``parts.json`` and the folder's name.

    Parameters
    ----------
    out : folder to write; appears whole or not at all
    rig_file : rig file, or None for the thesis's rig
    changes : fields of :class:`splitknit.rig.part_settings.PartSettings` to replace
    below : put the assembly together with the camera below the finger
    pictures : draw them, too
    progress : called with what is at work and the share done

    Raises
    ------
    BadInput
        In one sentence: a rig that cannot be built, a setting out of range, build123d not installed.
    """
    say: Progress = progress or (lambda what, share: None)
    check_target(out, "parts.json", "an earlier set of parts")
    rig, hashes = _rig(rig_file)
    settings = override(PartSettings(), changes or {})
    try:
        dimensions = dimensions_of(rig, settings)
        check_dimensions(dimensions)
    except BadInput as error:
        raise BadInput(f"{rig_file}: {error}" if rig_file is not None else str(error)) from error
    require_build123d()
    with atomic_folder(out) as target:
        for name in ("stl", "step", "pictures"):
            (target / name).mkdir()
        parts = build_parts(dimensions, lambda name, share: say(f"drawing {name}", 0.45 * share))
        reports, placed = {}, {}
        for done, part in enumerate(parts):
            name = part.kind.name
            say(f"checking {name}", 0.45 + 0.35 * done / len(parts))
            placed[name] = triangles_of(part)
            file = target / "stl" / f"{name}.stl"
            write_stl(file, as_printed(part, placed[name]), name)
            reports[name] = report_part(part.kind, read_stl(file), settings.printer)
            write_step(target / "step" / f"{name}.step", part)
        stack = STACK_BELOW if below else STACK
        say("assembling", 0.80)
        by_name = {part.kind.name: part for part in parts}
        write_assembly(target / "assembly.step", [by_name[name] for name in stack], below=below)
        drawn = write_pictures(target / "pictures", by_name, placed, below=below, progress=say) if pictures else []
        if not pictures:
            (target / "pictures").rmdir()
        facts = {
            **provenance(asdict(settings), hashes),
            "camera": "below" if below else "above",
            "assembly": list(stack),
            "dimensions": dimension_table(rig, dimensions),
            "parts": reports,
            "pictures": drawn,
        }
        document = json.dumps(plain_json(facts), indent=1, allow_nan=False) + "\n"
        (target / "parts.json").write_text(document, encoding="utf-8")
    say("done", 1.0)
    return {**facts, "out": str(out)}


def _rig(file: Path | None) -> tuple[Rig, dict[str, str]]:
    if file is None:
        return default_rig(), {}
    rig = read_rig(file)
    return rig, {file.name: file_hash(file)}
