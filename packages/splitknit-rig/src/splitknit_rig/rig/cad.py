"""What ``splitknit rig cad`` does: a rig file in, printable parts out.

Into the folder go ``stl/`` (as printed), ``step/`` and ``assembly.step`` (in the rig's frame), ``pictures/``, and
``parts.json`` with dimensions, sizes, masses and checks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import (
    BadInput,
    Progress,
    atomic_file,
    atomic_folder,
    check_target,
    default_rig,
    file_hash,
    json_text,
    no_progress,
    override,
    provenance,
    read_rig,
    stl_chunks,
)
from splitknit_rig.rig.assembly import (
    FILM_KINDS,
    SIDE_KIND,
    STACK,
    STACK_BELOW,
    RigPart,
    as_printed,
    build_parts,
    half_of,
    placed,
    require_build123d,
    triangles_of,
    write_assembly,
    write_step,
)
from splitknit_rig.rig.dimension_checks import check_dimensions
from splitknit_rig.rig.dimensions import dimensions_of
from splitknit_rig.rig.films import with_films, with_side_lights
from splitknit_rig.rig.part_reports import dimension_table, report_part
from splitknit_rig.rig.part_settings import PartSettings


def cad_to_folder(
    out: Path,
    *,
    rig_file: Path | None = None,
    changes: Mapping[str, Any] | None = None,
    below: bool = False,
    films: str | None = None,
    side: int = 0,
    pictures: bool = True,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Draw, check and write all parts of a rig; return the document of ``parts.json`` and the folder's name.

    `rig_file`: None for the thesis's; `changes`: of :class:`splitknit_rig.rig.part_settings.PartSettings`; `below`: the
    assembly's camera is below the finger; `films`, `side`: see :mod:`splitknit_rig.rig.films`. Raises BadInput if the
    rig cannot be built, a setting is out of range, or build123d is not installed.
    """
    check_target(out, "parts.json", "an earlier set of parts")
    rig = default_rig() if rig_file is None else read_rig(rig_file)
    hashes = {} if rig_file is None else {rig_file.name: file_hash(rig_file)}
    settings = override(PartSettings(), changes or {})
    try:
        rig = with_side_lights(with_films(rig, films), side)
        dimensions = dimensions_of(rig, settings)
        check_dimensions(dimensions)
    except BadInput as error:
        raise BadInput(f"{rig_file}: {error}" if rig_file is not None else str(error)) from error
    require_build123d()
    with atomic_folder(out) as target:
        for name in ("stl", "step"):
            (target / name).mkdir()
        parts = build_parts(dimensions, lambda name, fraction: progress(f"drawing {name}", 0.45 * fraction))
        reports = {}
        for done, part in enumerate(parts):
            name = part.kind.name
            progress(f"checking {name}", 0.45 + 0.35 * done / len(parts))
            triangles = as_printed(part, triangles_of(part))
            with atomic_file(target / "stl" / f"{name}.stl") as stream:
                faces = np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)
                stream.writelines(stl_chunks(triangles.reshape(-1, 3), faces, name))
            reports[name] = report_part(part.kind, triangles, settings.printer)
            write_step(target / "step" / f"{name}.step", part)
        by_name = {part.kind.name: part for part in parts}
        stack = list(STACK_BELOW if below else STACK)
        stack[2:2] = [name for name in (kind.name for kind in (SIDE_KIND, *FILM_KINDS)) if name in by_name]
        progress("assembling", 0.80)
        write_assembly(target / "assembly.step", [by_name[name] for name in stack], below=below)
        drawn = []
        if pictures:
            progress("pictures", 0.9)
            (target / "pictures").mkdir()
            drawn = _write_pictures(target / "pictures", by_name, stack, below=below)
        facts = {
            **provenance(asdict(settings), hashes),
            "camera": "below" if below else "above",
            "assembly": stack,
            "dimensions": dimension_table(rig, dimensions),
            "parts": reports,
            "pictures": drawn,
        }
        document = json_text(facts)
        (target / "parts.json").write_text(document, encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


# Line drawings of the parts, each from above and from below, of the exploded rig, and of a cut through it.

_ABOVE, _BELOW = (-0.37, -0.64, 0.67), (-0.41, -0.71, -0.57)
"""Directions from a part towards the viewer: the hand is at the front, at -y."""
_EXPLODED, _SECTION = (0.48, -0.77, 0.41), (0.86, -0.46, 0.21)
_GAP_MM = 32.0  # between the parts of the exploded rig
_FAR_MM = 10_000.0


def _write_pictures(folder: Path, parts: Mapping[str, RigPart], names: Sequence[str], *, below: bool) -> list[str]:
    """Draw everything, and the parts `names` of the rig, lowest first; return the names of the files."""
    from build123d import Compound, Pos, Rot  # large, and only parts need it

    for name, part in parts.items():
        _draw(folder / f"{name}.svg", part.solid, (_ABOVE, _BELOW))
    stack = [parts[name] for name in names]
    turn = Rot(180, 0, 0) if below else Rot(0, 0, 0)
    level = np.cumsum([not part.places for part in stack]) - 1  # lamps stay with the cylinder
    apart = [Pos(0, 0, _GAP_MM * k) * one for k, part in zip(level, stack, strict=True) for one in placed(part)]
    for title, shapes, (x, y, z) in (
        ("exploded", apart, _EXPLODED),
        ("section", [half_of(one) for part in stack for one in placed(part)], _SECTION),
    ):
        _draw(folder / f"{title}.svg", turn * Compound(children=shapes), ((x, -y if below else y, z),))
    return [*(f"{name}.svg" for name in parts), "exploded.svg", "section.svg"]


def _draw(path: Path, shape: Any, views: Sequence[tuple[float, float, float]]) -> None:
    """Draw the visible edges of a shape, its views beside each other, in mm."""
    from build123d import Compound, ExportSVG, Pos

    drawing, left = ExportSVG(margin=5.0, line_weight=0.3), 0.0
    for view in views:
        middle = shape.bounding_box().center()
        eye = tuple(at + _FAR_MM * way for at, way in zip(middle, view, strict=True))
        edges = Compound(children=list(shape.project_to_viewport(eye, (0, 0, 1), middle)[0]))
        box = edges.bounding_box()
        drawing.add_shape(Pos(left - box.min.X, -box.center().Y, 0) * edges)
        left += box.size.X + 10.0
    drawing.write(str(path))
