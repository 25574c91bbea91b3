"""What ``splitknit rig cad`` does: a rig file in, printable parts out.

Into the folder go ``stl/`` (as printed), ``step/`` and ``assembly.step`` (in the rig's frame), ``pictures/``, and
``parts.json`` with dimensions, sizes, masses and checks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.io.atomic import atomic_folder
from splitknit.io.images import write_image
from splitknit.io.pictures import ColourArray
from splitknit.io.provenance import file_hash, json_text, provenance
from splitknit.io.rig import read_rig
from splitknit.io.targets import check_target
from splitknit.model import Progress, Rig, default_rig, no_progress
from splitknit.rig.assembly import (
    STACK,
    STACK_BELOW,
    RigPart,
    Triangles,
    as_printed,
    build_parts,
    half_of,
    read_stl,
    require_build123d,
    triangles_of,
    write_assembly,
    write_step,
    write_stl,
)
from splitknit.rig.dimension_checks import check_dimensions
from splitknit.rig.dimensions import dimensions_of
from splitknit.rig.part_reports import dimension_table, report_part
from splitknit.rig.part_settings import PartSettings
from splitknit.settings import override

# Pictures of parts: a z-buffer renderer of triangle meshes, in numpy.
#
# Parallel projection, flat shading by two lamps, and dark lines where the depth or the direction of the surface jumps.

_SUPERSAMPLING = 2
_BACKGROUND = np.array([0.965, 0.965, 0.965])
_KEY = np.array([-0.45, 0.75, 0.80])
_FILL = np.array([0.45, -0.25, 0.85])
_LARGEST = 64
_CANDIDATES = 2_000_000
"""Pixels of triangles that are looked at together."""


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """Something to draw."""

    triangles: NDArray[np.float32]
    """(N, 3, 3), x, y, z."""
    colour: tuple[float, float, float]
    """Red, green, blue in [0, 1]."""
    label: str = ""
    label_at: tuple[float, float, float] | None = None
    """Point that the label belongs to."""


@dataclass(frozen=True, slots=True)
class _View:
    """Where the viewer stands."""

    azimuth_deg: float = -60.0
    """Counter-clockwise about z; -90 looks along +y, from the hand's side."""
    elevation_deg: float = 28.0
    """Above the horizon; negative looks up from below."""


def _draw(
    bodies: Sequence[_Body], view: _View, size: tuple[int, int] = (640, 800), margin: float = 0.06, labels: float = 0.0
) -> ColourArray:
    """Draw bodies so that they fill the picture.

    Parameters
    ----------
    bodies : what to draw, in one frame, mm
    view : View
    size : rows, columns
    margin : free border, as a part of the picture
    labels : part of the picture's width, at its right, that is kept free for labels

    Returns
    -------
    (rows, columns, 3) uint8
    """
    rows, columns = (_SUPERSAMPLING * n for n in size)
    basis = _basis(view)
    points = np.concatenate([body.triangles.reshape(-1, 3) for body in bodies]).astype(np.float64) @ basis.T
    low, high = points.min(axis=0), points.max(axis=0)
    width = columns * (1.0 - labels)
    scale = (1.0 - 2 * margin) * min(width / (high[0] - low[0]), rows / (high[1] - low[1]))
    centre = (low + high) / 2
    screen = np.empty_like(points)
    screen[:, 0] = width / 2 + scale * (points[:, 0] - centre[0])
    screen[:, 1] = rows / 2 - scale * (points[:, 1] - centre[1])
    screen[:, 2] = scale * (points[:, 2] - centre[2])
    corners = screen.reshape(-1, 3, 3)
    depth, nearest = _z_buffer(corners, (rows, columns))
    normals = _facing(points.reshape(-1, 3, 3))
    counts = [len(body.triangles) for body in bodies]
    colours = np.repeat(np.array([body.colour for body in bodies]), counts, axis=0)
    owner = np.repeat(np.arange(len(bodies)), counts)
    picture = _shaded(depth, nearest, normals, colours)
    picture *= _lines(depth, nearest, normals, owner)[..., None]
    small = cv2.resize(picture.astype(np.float32), (size[1], size[0]), interpolation=cv2.INTER_AREA)
    result = np.asarray(np.round(np.clip(small, 0.0, 1.0) * 255), dtype=np.uint8)
    if labels > 0:
        anchors = [body.label_at for body in bodies]
        places = [
            None if anchor is None else _placed(np.asarray(anchor) @ basis.T, centre, scale, width, rows)
            for anchor in anchors
        ]
        _write_labels(result, [body.label for body in bodies], places, int(width / _SUPERSAMPLING))
    return result


def _placed(
    point: NDArray[np.float64], centre: NDArray[np.float64], scale: float, width: float, rows: int
) -> tuple[float, float]:
    column = (width / 2 + scale * (point[0] - centre[0])) / _SUPERSAMPLING
    return float(column), float((rows / 2 - scale * (point[1] - centre[1])) / _SUPERSAMPLING)


def _basis(view: _View) -> NDArray[np.float64]:
    """Rows: right, up, and towards the viewer."""
    azimuth, elevation = np.deg2rad(view.azimuth_deg), np.deg2rad(view.elevation_deg)
    towards = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def _facing(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals (N, 3) in the viewer's frame, turned towards the viewer."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return np.asarray(np.where(normals[:, 2:] < 0, -normals, normals))


def _z_buffer(corners: NDArray[np.float64], shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Depth (larger is nearer; -inf where nothing is) and nearest triangle (-1) of each pixel."""
    depth = np.full(shape[0] * shape[1], -np.inf)
    nearest = np.full(shape[0] * shape[1], -1, dtype=np.int64)
    low = np.floor(corners[..., :2].min(axis=1)).astype(np.int64)
    extent = np.ceil(corners[..., :2].max(axis=1)).astype(np.int64) - low + 1
    done = np.zeros(len(corners), dtype=np.bool_)
    block = 4
    while not bool(done.all()):
        largest = block > _LARGEST
        some = np.flatnonzero(~done & (largest | (extent <= block).all(axis=1)))
        done[some] = True
        if largest:
            for index in some:
                _paint(corners, np.array([index]), low[[index]], tuple(extent[index]), shape, depth, nearest)
        else:
            for part in np.array_split(some, max(1, len(some) * block * block // _CANDIDATES)):
                _paint(corners, part, low[part], (block, block), shape, depth, nearest)
        block *= 2
    return depth.reshape(shape), nearest.reshape(shape)


def _paint(  # noqa: PLR0917 - arrays of one picture
    corners: NDArray[np.float64],
    index: NDArray[np.int64],
    low: NDArray[np.int64],
    block: tuple[int, ...],
    shape: tuple[int, int],
    depth: NDArray[np.float64],
    nearest: NDArray[np.int64],
) -> None:
    """Paint triangles whose bounds start at `low` (N, 2) and are no larger than `block` pixels."""
    if len(index) == 0:
        return
    x = low[:, 0, None, None] + np.arange(block[0])[None, None, :]
    y = low[:, 1, None, None] + np.arange(block[1])[None, :, None]
    a, b, c = (corners[index, k][:, None, None, :] for k in range(3))
    area = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    safe = np.where(np.abs(area) > 1e-9, area, np.inf)
    v = ((x - a[..., 0]) * (c[..., 1] - a[..., 1]) - (y - a[..., 1]) * (c[..., 0] - a[..., 0])) / safe
    w = ((b[..., 0] - a[..., 0]) * (y - a[..., 1]) - (b[..., 1] - a[..., 1]) * (x - a[..., 0])) / safe
    edge = 1e-9
    inside = (v >= -edge) & (w >= -edge) & (v + w <= 1 + edge) & np.isfinite(safe)
    inside &= (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    z = a[..., 2] + v * (b[..., 2] - a[..., 2]) + w * (c[..., 2] - a[..., 2])
    number, row, column = np.nonzero(inside)
    if len(number) == 0:
        return
    pixel = (low[number, 1] + row) * shape[1] + low[number, 0] + column
    near = z[number, row, column]
    order = np.argsort(near, kind="stable")  # the nearest comes last and stays
    order = order[near[order] > depth[pixel[order]]]
    depth[pixel[order]] = near[order]
    nearest[pixel[order]] = index[number[order]]


def _shaded(
    depth: NDArray[np.float64], nearest: NDArray[np.int64], normals: NDArray[np.float64], colours: NDArray[np.float64]
) -> NDArray[np.float64]:
    key = np.clip(normals @ (_KEY / np.linalg.norm(_KEY)), 0.0, 1.0)
    fill = np.clip(normals @ (_FILL / np.linalg.norm(_FILL)), 0.0, 1.0)
    light = 0.34 + 0.48 * key + 0.34 * fill
    lit = np.clip(colours * light[:, None], 0.0, 1.0)
    picture = np.where((nearest >= 0)[..., None], lit[np.maximum(nearest, 0)], _BACKGROUND)
    return np.asarray(picture * _recess(depth)[..., None])


def _recess(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Less light (0.6 to 1) where the surface lies deeper than what is around it."""
    seen = np.isfinite(depth)
    if not bool(seen.any()):
        return np.ones(depth.shape)
    plain = np.where(seen, depth, 0.0).astype(np.float32)
    weight = seen.astype(np.float32)
    sigma = 14.0
    around = cv2.GaussianBlur(plain, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
    below = np.clip((around - plain) / 60.0, 0.0, 1.0) * weight
    return np.asarray(1.0 - 0.4 * below)


def _lines(
    depth: NDArray[np.float64], nearest: NDArray[np.int64], normals: NDArray[np.float64], owner: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Brightness (0.25 to 1) of edges: outlines, steps, and creases sharper than 25 deg."""
    index = np.maximum(nearest, 0)
    seen = nearest >= 0
    normal = np.where(seen[..., None], normals[index], 0.0)
    body = np.where(seen, owner[index], -1)
    near = np.where(seen, depth, -1e6)
    dark = np.zeros(nearest.shape, dtype=np.bool_)
    for axis in (0, 1):
        first = tuple(slice(None, -1) if k == axis else slice(None) for k in (0, 1))
        second = tuple(slice(1, None) if k == axis else slice(None) for k in (0, 1))
        both = seen[first] & seen[second]
        crease = both & (np.einsum("ijk,ijk->ij", normal[first], normal[second]) < np.cos(np.deg2rad(25.0)))
        lean = np.minimum(normal[first][..., 2], normal[second][..., 2])
        step = np.abs(near[first] - near[second]) > 3.0 + 2.0 / np.maximum(lean, 0.15)
        edge = crease | step | (body[first] != body[second])
        dark[first] |= edge
    return np.where(dark, 0.35, 1.0)


def _write_labels(
    picture: ColourArray, labels: Sequence[str], places: Sequence[tuple[float, float] | None], column: int
) -> None:
    """Write each label at the right, with a thin line to its place; labels keep their distance."""
    entries = sorted(
        (place[1], place[0], label) for place, label in zip(places, labels, strict=True) if place is not None and label
    )
    row = -1e9
    for wanted, start, label in entries:
        row = max(wanted, row + 26.0)
        ends = (round(start), round(wanted)), (column, round(row))
        cv2.line(picture, ends[0], ends[1], (120, 120, 120), 1, cv2.LINE_AA)
        cv2.circle(picture, ends[0], 2, (120, 120, 120), -1, cv2.LINE_AA)
        cv2.putText(
            picture, label, (column + 6, round(row) + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (40, 40, 40), 1, cv2.LINE_AA
        )


def cad_to_folder(
    out: Path,
    *,
    rig_file: Path | None = None,
    changes: Mapping[str, Any] | None = None,
    below: bool = False,
    pictures: bool = True,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Draw, check and write all parts of a rig; return the document of ``parts.json`` and the folder's name.

    Parameters
    ----------
    out : folder to write; appears whole or not at all
    rig_file : rig file, or None for the thesis's rig
    changes : fields of :class:`splitknit.rig.part_settings.PartSettings` to replace
    below : put the assembly together with the camera below the finger
    pictures : draw them, too
    progress : called with what is at work and the fraction done

    Raises
    ------
    BadInput
        In one sentence: a rig that cannot be built, a setting out of range, build123d not installed.
    """
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
        parts = build_parts(dimensions, lambda name, fraction: progress(f"drawing {name}", 0.45 * fraction))
        reports, placed = {}, {}
        for done, part in enumerate(parts):
            name = part.kind.name
            progress(f"checking {name}", 0.45 + 0.35 * done / len(parts))
            placed[name] = triangles_of(part)
            file = target / "stl" / f"{name}.stl"
            write_stl(file, as_printed(part, placed[name]), name)
            reports[name] = report_part(part.kind, read_stl(file), settings.printer)
            write_step(target / "step" / f"{name}.step", part)
        stack = STACK_BELOW if below else STACK
        progress("assembling", 0.80)
        by_name = {part.kind.name: part for part in parts}
        write_assembly(target / "assembly.step", [by_name[name] for name in stack], below=below)
        drawn = (
            _write_pictures(target / "pictures", by_name, placed, below=below, progress=progress) if pictures else []
        )
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
        document = json_text(facts)
        (target / "parts.json").write_text(document, encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _rig(file: Path | None) -> tuple[Rig, dict[str, str]]:
    if file is None:
        return default_rig(), {}
    rig = read_rig(file)
    return rig, {file.name: file_hash(file)}


# Pictures of a rig's parts: each one from above and from below, the exploded rig, and a cut through it.

_DARK = (0.55, 0.61, 0.69)
_PALE = (0.93, 0.92, 0.88)
_COLOURS = {
    "base": (0.85, 0.56, 0.33),
    "window_base": (0.85, 0.56, 0.33),
    "cylinder": (0.55, 0.61, 0.69),
    "frame": (0.42, 0.66, 0.58),
    "box": (0.62, 0.62, 0.72),
    "lid": (0.78, 0.72, 0.52),
}
_TITLES = {
    "base": "base",
    "window_base": "window base",
    "cylinder": "cylinder",
    "frame": "LED and camera frame",
    "box": "circuit box",
    "lid": "lid",
}
_GAP_MM = 32.0
_EXPLODED = _View(-58.0, 24.0)
_EXPLODED_BELOW = _View(58.0, 24.0)
"""Turned over, the hand's side is +y."""
_SECTION = _View(-28.0, 12.0)
_SECTION_BELOW = _View(28.0, 12.0)


def _write_pictures(
    folder: Path, parts: Mapping[str, RigPart], placed: Mapping[str, Triangles], *, below: bool, progress: Progress
) -> list[str]:
    """Draw everything into a folder; return the names of the files.

    `folder`: an existing folder; `parts`: all parts by name; `placed`: their triangles in the rig's frame; `below`: the
    camera is below the finger; `progress`: called with what is drawn and the fraction done.
    """
    names = []
    for done, (name, triangles) in enumerate(placed.items()):
        progress(f"picture of {name}", 0.82 + 0.12 * done / len(placed))
        write_image(folder / f"{name}.png", _part_picture(triangles, parts[name].kind.colour))
        names.append(f"{name}.png")
    stack = STACK_BELOW if below else STACK
    progress("exploded view", 0.94)
    write_image(folder / "exploded.png", _exploded_picture(placed, stack, below=below))
    progress("section", 0.97)
    cut = {name: half_of(parts[name]) for name in stack}
    write_image(folder / "section.png", _section_picture(cut, below=below))
    return [*names, "exploded.png", "section.png"]


def _part_picture(triangles: Triangles, colour: str) -> ColourArray:
    """Return a part seen from above, and from below beside it."""
    body = _Body(triangles, _PALE if colour == "white" else _DARK)
    return np.hstack([_draw([body], _View(-60.0, 42.0), (480, 600)), _draw([body], _View(-60.0, -35.0), (480, 600))])


def _exploded_picture(placed: Mapping[str, Triangles], stack: Sequence[str], *, below: bool) -> ColourArray:
    """Return the stack with gaps between its parts, and their names."""
    view = _EXPLODED_BELOW if below else _EXPLODED
    azimuth = np.deg2rad(view.azimuth_deg + 40.0)
    bodies = []
    for place, name in enumerate(stack):
        triangles = _turned(placed[name] + np.array([0.0, 0.0, _GAP_MM * place], dtype=np.float32), below)
        low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
        radius = 0.88 * float(high[0])
        middle = (radius * np.cos(azimuth), radius * np.sin(azimuth), float(low[2] + high[2]) / 2)
        bodies.append(_Body(triangles, _COLOURS[name], _TITLES[name], middle))
    return _draw(bodies, view, (1000, 860), labels=0.26)


def _section_picture(cut: Mapping[str, Triangles], *, below: bool) -> ColourArray:
    """Return the assembled rig cut open along the finger."""
    bodies = [_Body(_turned(triangles, below), _COLOURS[name]) for name, triangles in cut.items()]
    return _draw(bodies, _SECTION_BELOW if below else _SECTION, (900, 640))


def _turned(triangles: Triangles, below: bool) -> NDArray[np.float32]:
    """Turn the rig over where the camera is below."""
    if not below:
        return triangles
    return np.asarray(triangles * np.array([1.0, -1.0, -1.0], dtype=np.float32))
