"""The surface of a result in files of other programs: meshes of trimesh, closed solids, textured
models, and maps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import importing, require
from splitknit.imaging.geometry import bounding_box, smoothed
from splitknit.io.prints import encode_png, provenance_texts
from splitknit.io.results import Mesh, Origin, axes_of, mesh_of, surface_colours
from splitknit.model import FloatArray
from splitknit.reconstruction import Reconstruction, require_scale

_NEEDS_TRIMESH = (
    "Surfaces of other programs need the package trimesh: pip install 'splitknit-match[mesh]'"
    " ({error})."
)
_NO_SURFACE = "the result holds no surface; reconstruct the capture again."
Facts = dict[str, Any]


def surface_bytes(
    result: Reconstruction, kind: str, title: str, base_mm: float | None = None
) -> tuple[Facts, bytes]:
    """Return facts of a file of the surface, and the bytes of the file.

    `title`: one line, stated in the file; `kind`: ``stl`` or ``obj`` (in mm), meshes as
    ``phalange.ply``, or ``glb`` (in metres, as glTF wants it), a model with a texture; `base_mm`:
    of ``stl``, a closed solid with a flat base so far below the lowest point. Raises BadInput if
    the result has no scale or no surface, or trimesh is missing.
    """
    require_scale(result)
    with importing(_NEEDS_TRIMESH):
        import trimesh
    if kind == "glb":
        mesh, visual = _textured(result)
    else:
        mesh = mesh_of(result) if base_mm is None else _solid(result, base_mm)
        opaque = np.full(len(mesh.places), 255, dtype=np.uint8)
        colours = surface_colours(result)[mesh.pixels]
        visual = trimesh.visual.ColorVisuals(vertex_colors=np.column_stack([colours, opaque]))
    require(len(mesh.faces) > 0, _NO_SURFACE)
    facts = {"vertices": len(mesh.places), "faces": len(mesh.faces), "unit": "mm"}
    words = {"title": title, "axes": axes_of(result.facts.get("material"))}
    body: Any = trimesh.Trimesh(
        mesh.places * (0.001 if kind == "glb" else 1.0),
        mesh.faces,
        vertex_normals=mesh.normals,
        visual=visual,
        metadata=words,
        process=False,
    )
    header = {"header": f"unit mm, {', '.join(words.values())}"} if kind == "obj" else {}
    written = body.export(file_type=kind, **header)
    written = written if isinstance(written, bytes) else written.encode("ascii")
    if kind == "stl":  # whose header is free
        written = (
            f"splitknit, unit mm {title}".encode("ascii", "replace")[:80].ljust(80) + written[80:]
        )
    return facts, written


def _solid(result: Reconstruction, base_mm: float) -> Mesh:
    """The surface with walls down to a plane `base_mm` below its lowest point.

    Pixels at which the outline meets itself are left out: the wall below them would have four
    sides.
    """
    from trimesh import Trimesh
    from trimesh.grouping import group_rows

    while True:
        top = mesh_of(result)
        require(len(top.faces) > 0, _NO_SURFACE)
        sides: Any = Trimesh(top.places, top.faces, process=False)
        border = sides.edges[group_rows(sides.edges_sorted, require_count=1)]
        crossing = np.bincount(border[:, 0], minlength=len(top.places)) > 1
        if not crossing.any():
            break
        mask = result.mask.copy()
        mask[tuple(axis[crossing] for axis in top.pixels)] = False
        result = replace(result, mask=mask)
    count = len(top.places)
    below = top.places.copy()
    below[:, 2] = top.places[:, 2].min() - base_mm
    first, second = border.T
    walls = [(second, first, first + count), (second, first + count, second + count)]
    faces = [top.faces, top.faces[:, ::-1] + count, *(np.column_stack(wall) for wall in walls)]
    return Mesh(
        np.concatenate([top.places, below]),
        np.tile(top.normals, (2, 1)),
        np.concatenate(faces),
        (np.tile(top.pixels[0], 2), np.tile(top.pixels[1], 2)),
    )


_MODEL_VERTICES = 100_000
"""Vertices of a model with a texture, about: so many a browser turns without a pause; finer detail
is in its normal map."""


def _textured(result: Reconstruction) -> tuple[Mesh, Any]:
    """A light mesh, with the colours in a texture and the detail that it lacks in a normal map."""
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    known = result.mask & np.isfinite(result.height_mm)
    require(known.any(), _NO_SURFACE)
    step = int(np.ceil(np.sqrt(known.sum() / _MODEL_VERTICES)))
    coarse = result
    if step > 1:
        fields = [np.where(known, result.height_mm, 0.0), *np.moveaxis(result.normals, -1, 0)]
        height, *normal = (smoothed(field, known, step / 2) for field in fields)
        coarse = replace(
            result, mask=known, height_mm=height.astype(np.float32), normals=_unit(*normal)
        )
    mesh = mesh_of(coarse, step)
    rows, columns = bounding_box(result.mask)
    height_px, width_px = rows.stop - rows.start, columns.stop - columns.start
    uv = np.column_stack(
        [
            (mesh.pixels[1] - columns.start + 0.5) / width_px,
            1.0 - (mesh.pixels[0] - rows.start + 0.5) / height_px,
        ]
    )
    maps: dict[str, NDArray[Any]] = {"baseColorTexture": surface_colours(result)[rows, columns]}
    if step > 1:
        detail = _in_frames_of(coarse.normals[rows, columns], result.normals[rows, columns])
        maps["normalTexture"] = normal_levels(detail, np.uint8)
    scale = 4096 / max(height_px, width_px)  # px, which nearly all graphics cards take
    if scale < 1.0:
        size = (round(scale * width_px), round(scale * height_px))
        maps = {
            name: np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
            for name, picture in maps.items()
        }
    pictures = {name: Image.fromarray(picture) for name, picture in maps.items()}
    material = PBRMaterial(metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True, **pictures)
    return mesh, TextureVisuals(uv, material=material)


def _unit(*parts: FloatArray) -> FloatArray:
    """Vectors (H, W, 3) of length one; towards the camera where there is none."""
    vectors = np.stack(parts, axis=-1)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.maximum(length, 1e-12), (0.0, 0.0, 1.0)).astype(
        np.float32
    )


def _in_frames_of(coarse: FloatArray, fine: FloatArray) -> FloatArray:
    """Normals (H, W, 3) in the tangent frames of coarse ones: along the rows, up, outwards."""
    nx, _, nz = np.moveaxis(coarse, -1, 0)
    along = _unit(nz, np.zeros_like(nx), -nx)
    up = np.cross(coarse, along)
    return _unit(*(np.einsum("hwi,hwi->hw", axis, fine) for axis in (along, up, coarse)))


def map_files(
    result: Reconstruction, normals: str, origin: Origin
) -> Iterator[tuple[str, Facts, bytes]]:
    """Name, facts and bytes of the maps of a surface, PNG files of 16 bits on the input's pixel
    grid.

    ``height``: levels from 1 at the lowest point to 65535 at the highest, 0 outside the mask, with
    its scale in the texts by which Gwyddion knows it; ``normals``: x to the right, y up (`normals`
    ``opengl``) or down (``directx``), z to the camera.
    """
    known = result.mask & np.isfinite(result.height_mm)
    require(known.any(), _NO_SURFACE)
    unit = result.unit
    heights = unit.heights(result.height_mm)
    low, high = float(heights[known].min()), float(heights[known].max())
    step = max(high - low, 1e-6) / 65534
    levels = np.where(known, np.round((np.where(known, heights, low) - low) / step) + 1, 0)
    facts = {
        "unit": unit.name,
        "pitch": result.pitch_mm * unit.per_mm,
        "level_0": low - step,
        "level_65535": high,
    }
    metres = 0.001 if unit.known else 1.0
    rows, columns = known.shape
    lengths = {
        "XReal": columns * facts["pitch"],
        "YReal": rows * facts["pitch"],
        "ZMin": facts["level_0"],
        "ZMax": high,
    }
    texts = {f"Gwy::{name}": f"{value * metres:.9g}" for name, value in lengths.items()}
    texts |= dict.fromkeys(("Gwy::XYUnit", "Gwy::ZUnit"), "m") if unit.known else {}
    texts |= provenance_texts(origin)
    ppi = 25.4 / result.pitch_mm if unit.known else None
    yield "height", facts, encode_png(levels.astype(np.uint16), texts, ppi)
    facing = np.where(known[..., None], result.normals, np.array([0.0, 0.0, 1.0], dtype=np.float32))
    facing[..., 1] *= -1.0 if normals == "directx" else 1.0
    picture = normal_levels(facing, np.uint16)[..., ::-1]  # OpenCV: blue first
    yield "normals", {"normals": normals}, cv2.imencode(".png", picture)[1].tobytes()


def normal_levels(normals: FloatArray, kind: type[np.unsignedinteger[Any]]) -> NDArray[Any]:
    """Unit normals (H, W, 3) as levels of 8 or 16 bits: x, y, z from -1 to 1."""
    return np.round((normals + 1.0) * (np.iinfo(kind).max / 2)).astype(kind)
