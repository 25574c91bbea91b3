"""The surface of a result in files of other programs: meshes of trimesh, closed solids, and
textured models."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.errors import importing, require
from splitknit.imaging.geometry import bounding_box
from splitknit.io.results import Mesh, axes_of, mesh_of, surface_colours
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
    mesh = mesh_of(result) if base_mm is None else _solid(result, base_mm)
    require(len(mesh.faces) > 0, _NO_SURFACE)
    visual = _texture(result, mesh)
    if kind != "glb":
        # of a solid, the base has the colours of the surface above it
        colours = np.resize(surface_colours(result)[mesh.known], (len(mesh.places), 3))
        visual = trimesh.visual.ColorVisuals(vertex_colors=np.insert(colours, 3, 255, axis=1))
    facts = {"vertices": len(mesh.places), "faces": len(mesh.faces), "unit": "mm"}
    words = {"title": title, "axes": axes_of(result.facts.get("material"))}
    body = trimesh.Trimesh(
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
        sides = Trimesh(top.places, top.faces, process=False)
        border = sides.edges[group_rows(sides.edges_sorted, require_count=1)]
        crossing = np.bincount(border[:, 0], minlength=len(top.places)) > 1
        if not crossing.any():
            break
        mask = top.known.copy()
        mask[mask] = ~crossing
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
        top.known,
    )


def _texture(result: Reconstruction, mesh: Mesh) -> Any:
    """The colours of the surface as a picture on its mesh."""
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    box = bounding_box(result.mask)
    picture = surface_colours(result)[box]
    down, right = (
        (pixel + 0.5) / length
        for pixel, length in zip(np.nonzero(mesh.known[box]), picture.shape, strict=False)
    )
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(picture),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    return TextureVisuals(np.column_stack([right, 1.0 - down]), material=material)
