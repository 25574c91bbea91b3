"""The fields of a reconstruction as files, and back: fields on the input's pixel grid, the mesh
upright (``docs/explain/conventions.md``, frames of the results).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.files import AnyPath
from splitknit.findings import Finding
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import srgb_code, srgb_light
from splitknit.io.atomic import write_file
from splitknit.io.fields import converted, parse_json, read_document
from splitknit.io.images import read_image, size_check
from splitknit.io.mesh import triangulate, write_ply
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.pictures import normal_colours, upright_places, upright_turn
from splitknit.io.prints import encode_png, provenance_texts
from splitknit.io.provenance import JsonValue, canonical_json, settings_hash
from splitknit.model import BoolArray, FloatArray
from splitknit.reconstruction import NO_SCALE, Reconstruction

Origin = dict[str, JsonValue]
_FRAME = ("mask", "pitch_mm", "input_from_upright", "upright_size")
_AGAIN = "reconstruct the capture again"


class _Origin(Struct):
    inputs: dict[str, str] = {}


class _Report(Struct):
    preset: str = ""
    findings: tuple[Finding, ...] = ()
    settings: dict[str, Any] = {}
    quality: dict[str, Any] = {}
    facts: dict[str, Any] = {}
    timings_s: dict[str, Any] = {}


def read_result(path: AnyPath) -> Reconstruction:
    """Read a result folder, as :func:`splitknit.reconstruct` and ``splitknit reconstruct`` leave
    it.

    Parameters
    ----------
    path : path
        The folder, or its ``height.npz``; then the albedo is NaN and there are no facts.

    Returns
    -------
    Reconstruction
        Albedo and colour are relative, in 255 steps. Where its scale is unknown, `scale_known` is
        false and 1 px/mm is assumed, as the file has heights in pixels.

    Raises
    ------
    BadInput
        If a file is missing or damaged.

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
    >>> splitknit.reconstruct(capture, "ea").save("result", capture)
    >>> splitknit.read_result("result").preset
    'ea'
    """
    folder = Path(path)
    file = folder / "height.npz" if folder.is_dir() else folder
    names = ("height_mm", "ridge_mm", "shape_mm", "normals")
    optional = (
        "x_mm",
        "y_mm",
        "uncertainty_um",
        "normals_measured",
        "specular",
        "misfit",
        "whole",
        "provenance",
    )
    arrays = read_fields(file, names, optional, unscaled=True)
    stated = parse_json(str(arrays.pop("provenance", "{}")).encode("utf-8", "replace"), str(file))
    origin = converted(stated, _Origin, f"{file}: provenance")
    report = _Report()
    albedo = np.full(arrays["mask"].shape, np.nan, dtype=np.float32)
    if (folder / "report.json").is_file():
        report, _ = read_document(folder / "report.json", _Report)
    grey_file, colour_file = folder / "albedo.png", folder / "colour.png"
    if grey_file.is_file():
        grey = read_image(grey_file, size_check(albedo.shape, str(file), str(grey_file)))
        albedo = np.where(arrays["mask"], grey[..., 0] / np.float32(255), np.nan)
    colour = None
    if colour_file.is_file():
        colours = read_image(colour_file, size_check(albedo.shape, str(file), str(colour_file)))
        require(
            colours.shape[2] == 3 and colours.dtype == np.uint8,
            f"{colour_file} is not a picture of 8 bits in colour; {_AGAIN}.",
        )
        colour = srgb_light(colours / np.float32(255))
    return Reconstruction(
        **arrays, albedo=albedo, colour=colour, hashes=origin.inputs, **asdict(report)
    )


def read_fields(
    path: Path, names: Sequence[str], optional: Sequence[str] = (), *, unscaled: bool = False
) -> dict[str, Any]:
    """Fields of a result's ``height.npz``, those of `names` and, where there, `optional`, with its
    frame (``mask``, ``pitch_mm``, ``input_from_upright``, ``upright_size``), checked. `unscaled`:
    take unknown scales, as 1 px/mm with a false ``scale_known``. Raises BadInput if the file is
    damaged, an array is missing, of another shape, or impossible, or the scale is unknown.
    """
    pixel_names = {f"{name.removesuffix('_mm')}_px": name for name in names if name.endswith("_mm")}
    arrays: dict[str, Any] = dict(read_npz(path, (*_FRAME, *names, *optional, *pixel_names)))
    lengths_px = {name: arrays.pop(pixel) for pixel, name in pixel_names.items() if pixel in arrays}
    known = "pitch_mm" in arrays or not lengths_px
    require(known or unscaled, f"{path}: {NO_SCALE}")
    if not known:
        arrays |= {**lengths_px, "pitch_mm": np.array(1.0)}
    for name in (*names, *_FRAME):
        remedy = (
            f"it has no scale, so calibrate the camera and {_AGAIN}"
            if name == "pitch_mm"
            else _AGAIN
        )
        require(name in arrays, f"{path} holds no '{name}'; {remedy}.")
    shape = arrays["mask"].shape
    sizes = {
        "pitch_mm": (),
        "provenance": (),
        "whole": (),
        "input_from_upright": (3, 3),
        "upright_size": (2,),
    }
    sizes["normals"] = sizes["normals_measured"] = (*shape, 3)
    kinds = {"provenance": "U", "upright_size": "iu"}
    for name, array in arrays.items():
        fits = (
            array.shape == sizes.get(name, shape)
            and array.dtype.kind in kinds.get(name, "fiub")
            and len(shape) == 2
        )
        require(fits, f"{path}: '{name}' has another shape than a result's; {_AGAIN}.")
    matrix = arrays.pop("input_from_upright").astype(np.float64)
    rows, columns = arrays.pop("upright_size").tolist()
    require(
        float(np.abs(matrix).max()) < 1e7  # not with NaN
        and abs(float(np.linalg.det(matrix[:2, :2]))) > 1e-9
        and 0 < rows <= 20_000
        and 0 < columns <= 20_000
        and rows * columns <= 100_000_000,
        f"{path}: 'input_from_upright' or 'upright_size' cannot be used; {_AGAIN}.",
    )
    pitch = float(arrays.pop("pitch_mm"))
    require(
        not known or 0 < pitch * max(rows, columns) <= 1000.0,
        f"{path} has no scale (pitch_mm is {pitch}): calibrate the camera and {_AGAIN}.",
    )
    fields: dict[str, Any] = {
        "pitch_mm": pitch,
        "input_from_upright": matrix,
        "upright_size": (rows, columns),
    }
    if unscaled:
        fields["scale_known"] = known
    if "whole" in arrays:
        fields["whole"] = bool(arrays.pop("whole"))
    for name, array in arrays.items():
        kind = np.bool_ if name == "mask" else np.float32
        fields[name] = array if name == "provenance" else array.astype(kind, copy=False)
    return fields


def write_arrays(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write ``height.npz``: all fields on the input's pixel grid; in pixels, and named so, without
    a scale."""
    unit = result.unit
    arrays: dict[str, Any] = {
        f"height_{unit.name}": unit.heights(result.height_mm),
        f"ridge_{unit.name}": unit.heights(result.ridge_mm),
        f"shape_{unit.name}": unit.heights(result.shape_mm),
        "mask": result.mask,
        **({"pitch_mm": np.float64(result.pitch_mm)} if unit.known else {}),
        "normals": result.normals,
        "input_from_upright": result.input_from_upright,
        "upright_size": np.asarray(result.upright_size, dtype=np.int64),
    }
    others = ("x_mm", "y_mm", "uncertainty_um", "normals_measured", "specular", "misfit")
    arrays |= {name: getattr(result, name) for name in others if getattr(result, name) is not None}
    if result.whole:
        arrays["whole"] = np.True_
    arrays["provenance"] = np.array(canonical_json(origin))
    write_npz(path, arrays)


def axes_of(material: Any) -> str:
    """Description of a mesh's axes, for its header."""
    return f"x right, y {'up' if material == 'opaque' else 'to the fingertip'}, z to the camera"


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A surface as triangles, tip along +y; one vertex for each pixel that is kept, row by row."""

    places: FloatArray
    """(N, 3) in the unit of the result."""
    normals: FloatArray
    """(N, 3)."""
    faces: NDArray[np.int32]
    """(M, 3), counter-clockwise seen from outside."""
    known: BoolArray
    """(H, W) pixels of the vertices on the input's grid."""


def mesh_of(result: Reconstruction) -> Mesh:
    """The surface of a result."""
    kept = bounding_box(result.mask)
    known = result.mask & np.isfinite(result.height_mm)
    valid = known[kept]
    faces, _ = triangulate(valid)
    frame = result.input_from_upright
    xy_mm = None if result.x_mm is None or result.y_mm is None else (result.x_mm, result.y_mm)
    x, y = upright_places(result.mask.shape, result.pitch_mm, frame, kept, xy_mm)
    fields = (x[valid], y[valid], result.height_mm[kept][valid])
    places = np.stack(fields, axis=1, dtype=np.float32, casting="same_kind")
    normals = result.normals[kept][valid]
    normals[:, :2] = normals[:, :2] @ upright_turn(frame).T.astype(np.float32)
    return Mesh(result.unit.heights(places), normals, faces, known)


def write_mesh(path: Path, result: Reconstruction, origin: Origin) -> None:
    """Write the mesh: the surface, tip up; one vertex for each pixel of the mask, row by row."""
    comments = [
        f"splitknit {origin['version']}, preset {result.preset}",
        f"unit {result.unit.title}; {axes_of(result.facts.get('material'))}",
        f"settings_sha256 {origin['settings_sha256']}",
        f"inputs_sha256 {settings_hash(origin['inputs'])}",
    ]
    mesh = mesh_of(result)
    intensity = albedo_bytes(result)[mesh.known] * np.float32(1.0 / 255.0)
    colours = None if result.colour is None else surface_colours(result)[mesh.known]
    write_ply(path, (mesh.places, mesh.normals, intensity), mesh.faces, comments, colours)


def normals_picture(result: Reconstruction, normals: FloatArray) -> NDArray[np.uint8]:
    """Normals (H, W, 3) of a result as colours on the input's pixel grid, black outside the
    mask."""
    picture = np.zeros((*result.mask.shape, 3), dtype=np.uint8)
    box = bounding_box(result.mask)
    picture[box] = normal_colours(normals[box]) * result.mask[box][..., None]
    return picture


def albedo_bytes(result: Reconstruction) -> NDArray[np.uint8]:
    """Albedo (H, W) with its 99.9th percentile at 255, 0 outside the mask."""
    return np.round(_up_to_255(result.albedo, result.mask)).astype(np.uint8)


def surface_colours(result: Reconstruction) -> NDArray[np.uint8]:
    """Albedo (H, W, 3) as sRGB, grey where there is no colour; brightness as of
    :func:`albedo_bytes`."""
    albedo = result.albedo[..., None] if result.colour is None else result.colour
    code = np.round(255.0 * srgb_code(_up_to_255(albedo, result.mask) / 255.0)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(code, (*result.mask.shape, 3)))


def _up_to_255(albedo: FloatArray, mask: BoolArray) -> FloatArray:
    """Albedo (H, W) or (H, W, C) with its 99.9th percentile at 255, 0 outside the mask."""
    box = bounding_box(mask)
    picture = np.zeros(albedo.shape, dtype=np.float32)
    known = mask[box].reshape(*mask[box].shape, *[1] * (albedo.ndim - 2)) & np.isfinite(albedo[box])
    if known.any():
        values = np.where(known, albedo[box], 0.0)
        white = max(float(np.percentile(values[known][::7], 99.9)), 1e-12)
        picture[box] = np.clip(values * np.float32(255.0 / white), 0, 255)
    return picture


def write_picture(path: Path, picture: NDArray[np.uint8], origin: Origin) -> None:
    """Write a grey or RGB picture as PNG, with its provenance."""
    write_file(path, encode_png(picture, provenance_texts(origin)))
