"""What leaves the viewer as a file: a result's surface as PLY, STL or GLB, of all values or every 2nd, 4th or 8th."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.images import decode_image
from splitknit.io.mesh import glb_chunks, stl_chunks, stl_size, surface_mesh
from splitknit.io.ply import write_ply
from splitknit.model import FloatArray
from splitknit.viewer.catalogue import CatalogueEntry, Reply, open_below, read_below
from splitknit.viewer.surface import ResultSurface, fields_of

KINDS = {"ply": "application/octet-stream", "stl": "model/stl", "glb": "model/gltf-binary"}
STEPS = (1, 2, 4, 8)


def export(entry: CatalogueEntry, surface: ResultSurface, kind: str, step: int) -> Reply:
    """Make a file of every `step`-th value along rows and columns. Raises BadInput if the kind or the step is not
    known, or the result lacks an array.
    """
    require(kind in KINDS, f"a surface is exported as {', '.join(KINDS)}, not as {kind[:20]!a}.")
    require(step in STEPS, "every 1st, 2nd, 4th or 8th value can be exported.")
    name = f"{_ascii(entry.name)}{'' if step == 1 else f'-every-{step}'}.{kind}"
    saved = {"Content-Disposition": f'attachment; filename="{name}"'}
    if kind == "ply" and step == 1:
        try:
            return Reply.of_file(open_below(entry.folder, "phalange.ply"), KINDS[kind], saved)
        except BadInput:
            pass  # made anew below
    vertices, faces, index = surface_mesh(
        surface.x_mm[::step, ::step], surface.y_mm[::step, ::step], surface.height_mm[::step, ::step]
    )
    require(len(faces) > 0, "nothing is left of the surface at this step; export more values.")
    if kind == "stl":
        title = f"{entry.report.get('preset', '')} {name}"
        return Reply(KINDS[kind], stl_size(len(faces)), stl_chunks(vertices, faces, title), saved)
    used = index >= 0
    normals = _normals(entry, surface)[::step, ::step][used]
    intensity = _albedo(entry, surface)[::step, ::step][used]
    facts = _origin(entry, step, "mm" if surface.scale_known else "pixel, the scale is unknown")
    if kind == "glb":
        size, chunks = glb_chunks(vertices, normals, intensity, faces, facts)
        return Reply(KINDS[kind], size, chunks, saved)
    with tempfile.TemporaryDirectory(prefix="splitknit-") as folder:
        comments = [f"{key} {value}" for key, value in facts.items()]
        plain = [text.encode("ascii", "replace").decode("ascii") for text in comments]
        write_ply(Path(folder) / name, vertices, normals, intensity, faces, plain)
        return Reply.of_file(open_below(Path(folder), name), KINDS[kind], saved)  # open: it outlives its name


def _origin(entry: CatalogueEntry, step: int, unit: str) -> dict[str, Any]:
    report = entry.report
    software = report.get("software", {})
    facts = {
        "generator": f"splitknit {software.get('version', '')}, preset {report.get('preset', '')}".strip(),
        "unit": f"{unit}; x right, y to the fingertip, z to the camera",
        "sampling": f"every {step}. value of the result",
    }
    try:  # the mesh that was written with the result states its hashes
        with open_below(entry.folder, "phalange.ply") as stream:
            head = stream.read(4096).split(b"end_header")[0].decode("ascii", "replace")
    except BadInput:
        return facts
    for line in head.splitlines():
        key, _, value = line.removeprefix("comment ").partition(" ")
        if line.startswith("comment ") and key in ("settings_sha256", "inputs_sha256"):
            facts[key] = value
    return facts


def _normals(entry: CatalogueEntry, surface: ResultSurface) -> FloatArray:
    arrays: FloatArray = fields_of(entry.folder, ("normals",), unscaled=True)["normals"]
    require(arrays.shape == (*surface.size, 3), "the result's normals have another shape than its heights.")
    normals = arrays[surface.box].astype(np.float32)
    require(not (np.abs(normals) > 1.01).any(), "the result's normals are not of unit length.")
    normals[..., :2] = normals[..., :2] @ surface.turn.astype(np.float32).T
    return normals


def _albedo(entry: CatalogueEntry, surface: ResultSurface) -> NDArray[np.uint8]:
    """Grey value of each pixel of the box; white where the result has no picture of it."""
    white = np.full(surface.mask.shape, 255, dtype=np.uint8)
    try:
        pixels: NDArray[Any] = decode_image(read_below(entry.folder, "albedo.png"), "albedo.png")
    except BadInput:
        return white
    if (pixels.shape[0], pixels.shape[1]) != surface.size or pixels.dtype != np.uint8:
        return white
    return np.asarray(pixels[..., 0][surface.box], dtype=np.uint8)


def _ascii(name: str) -> str:
    kept = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_") else "-" for letter in name)
    return kept.strip("-")[-60:] or "finger"
