"""Point clouds and vertices of meshes of other scanners: PLY, PCD, XYZ, OBJ, STL; and height maps as points on a grid.

Source: G. Turk, The PLY Polygon File Format, 1994; Point Cloud Library, "The PCD (Point Cloud Data) file format";
Wavefront Technologies, "Advanced Visualizer", appendix B1; 3D Systems, StereoLithography Interface Specification, 1989.
"""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, open_file, refusing, require
from splitknit.io.height_maps import read_tmd, read_x3p
from splitknit.io.mesh import HEADER_BYTES, RECORD, stl_size
from splitknit.model import FloatArray

MAX_POINTS = 40_000_000
UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
FAR_MM = 500.0  # a cloud that begins further from the origin is moved there: single precision would not do
_COARSEST_MM = 0.01  # steps of coordinates that are fine enough for ridges: 100 m from the origin in single precision
_MAX_BYTES = 4_000_000_000
_ROWS, _BLOCK = 1 << 18, 1 << 23
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_XYZ, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
_SEPARATORS = bytes.maketrans(b",;\t", b"   ")
_Rows = Iterator[NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points of a surface, in mm."""

    points_mm: FloatArray
    """(N, 3), or (H, W, 3) where neighbours in the grid are neighbours on the surface; NaN: not measured."""
    kind: str
    """Such as ``PLY``."""
    normals: FloatArray | None = None
    """(N, 3), towards the outside."""
    quality: FloatArray | None = None
    """(N,) brightness of the surface, in any unit."""
    notes: tuple[str, ...] = ()


def read_cloud(path: str | os.PathLike[str], unit: str | None = None) -> Cloud:
    """Read a point cloud, the vertices of a mesh, or a height map; its suffix, of :data:`CLOUDS`, shows which.

    `unit`: of the coordinates, a key of :data:`UNITS_MM`, mm by default; X3P and TMD state theirs. Raises BadInput if
    the file is damaged, of another kind, too large, or states its unit while `unit` is given.

    >>> read_cloud("finger.ply").points_mm.shape  # doctest: +SKIP
    (412345, 3)
    """
    name, suffix = os.fspath(path), Path(path).suffix.lower()
    require(suffix in CLOUDS, f"{name} is not a point cloud; its suffix must be one of {', '.join(CLOUDS)}.")
    if suffix in (".x3p", ".tmd"):
        require(unit is None, f"{name} states its unit itself; leave `unit` out.")
        height_mm, steps_mm = read_x3p(path) if suffix == ".x3p" else read_tmd(path)
        rows, columns = np.indices(height_mm.shape, dtype=np.float32)
        points = np.stack([columns * np.float32(steps_mm[0]), -rows * np.float32(steps_mm[1]), height_mm], axis=2)
        return Cloud(points, suffix[1:].upper())
    damaged = f"{name} cannot be read as {suffix[1:].upper()}: it is damaged or of another format; write it again."
    try:
        with open_file(path, _MAX_BYTES) as (stream, size), refusing(damaged), warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy's, of text that is not a number
            return _READERS[suffix](stream, size, UNITS_MM[unit or "mm"], damaged)
    except BadInput as error:  # a format's reader knows the stream alone
        raise error if name in str(error) else BadInput(f"{name}: {error}") from error


def _records(stream: BinaryIO, dtype: np.dtype[Any], count: int, damaged: str) -> _Rows:
    for start in range(0, count, _ROWS):
        wanted = min(_ROWS, count - start) * dtype.itemsize
        data = stream.read(wanted)
        require(len(data) == wanted, damaged)
        yield np.frombuffer(data, dtype)


def _text(stream: BinaryIO, damaged: str, prefix: bytes = b"", count: int = MAX_POINTS + 1, columns: int = 0) -> _Rows:
    """Rows (n, columns) of numbers, `count` at most, of lines with `prefix`, by default as many as the first has."""
    rest = b""
    while count > 0 and (block := stream.read(_BLOCK) or rest):
        whole = rest + block if block is not rest else rest + b"\n"
        end = whole.rfind(b"\n") + 1
        require(end > 0 or len(whole) < 1 << 16, damaged)  # what has no lines is not text
        lines, rest = whole[:end], whole[end:]
        if prefix:
            stripped = (line.lstrip() for line in lines.splitlines(keepends=True))
            lines = b"".join(line[len(prefix) :] for line in stripped if line.startswith(prefix))
        if lines.strip():
            columns = columns or len(_numbers(lines.lstrip().partition(b"\n")[0]))
            values = _numbers(lines)[: count * columns]
            require(columns >= 3 and len(values) % columns == 0, damaged)
            count -= len(values) // columns
            yield values.reshape(-1, columns)


def _numbers(text: bytes) -> NDArray[np.float64]:
    return np.fromstring(text.translate(_SEPARATORS), dtype=np.float64, sep=" ")


def _cloud(rows: Iterable[NDArray[Any]], columns: Mapping[str, Any], unit_mm: float, kind: str) -> Cloud:
    """All points of a file, of rows and the place of each column in them."""
    require(all(axis in columns for axis in _XYZ), "its points have no x, y and z.")
    bright = [one for one in ("quality", "intensity", "scalar_intensity", "green") if one in columns][:1]
    wanted = (_XYZ, _NORMAL if all(axis in columns for axis in _NORMAL) else (), bright)
    found: list[list[FloatArray]] = [[], [], []]
    origin: NDArray[np.float64] | None = None
    total = 0
    for row in rows:
        part = [[row[columns[k]] if row.dtype.names else row[:, columns[k]] for k in names] for names in wanted]
        place = np.stack(part[0], axis=1).astype(np.float64) * unit_mm
        total += len(place)
        require(total <= MAX_POINTS, f"the file has more than {MAX_POINTS} points; reduce them.")
        known = np.isfinite(place).all(axis=1) & (np.abs(place).max(axis=1) < 1e9)
        place[~known] = np.nan
        if origin is None and bool(known.any()):
            first = place[int(np.argmax(known))]
            origin = first.round() * (np.abs(first).max() > FAR_MM)
            stored = row.dtype[columns["x"]] if row.dtype.names else row.dtype
            if stored.itemsize == 4 and stored.kind == "f":
                apart = float(np.spacing(np.float32(np.abs(first).max())))
                far = f"its points lie {np.abs(first).max() / 1000:.3g} m from the origin, where coordinates in single "
                fine = f"precision are {apart:.2g} mm apart; move the cloud to the origin and export it again."
                require(apart <= _COARSEST_MM, far + fine)
        found[0].append((place if origin is None else place - origin).astype(np.float32))
        for values, given in zip(found[1:], part[1:], strict=True):
            values.extend([np.stack(given, axis=1).astype(np.float32)] if given else [])
    require(origin is not None, "the file holds no point.")
    points, normals, quality = (np.concatenate(one) if one else None for one in found)
    assert points is not None and origin is not None
    notes = ("its coordinates were moved to the origin.",) if origin.any() else ()
    return Cloud(points, kind, normals, None if quality is None else quality[:, 0], notes)


def _header(stream: BinaryIO, last: bytes, damaged: str) -> list[list[str]]:
    lines: list[list[str]] = []
    while not lines or lines[-1][:1] != [last.decode()]:
        line = stream.readline(4096)
        require(line.endswith(b"\n") and len(lines) < 1000, damaged)
        lines.append(line.decode("latin-1").split())
    return lines


def _table(  # noqa: PLR0917
    stream: BinaryIO, size: int, count: int, types: Mapping[str, str], damaged: str, unit_mm: float, kind: str
) -> Cloud:
    """So many points, a row each, in records of these types, or a text (``=``)."""
    text = next(iter(types.values()), "=").startswith("=")
    dtype = np.dtype(list(types.items()))
    require(0 < count * (2 * len(types) if text else dtype.itemsize) <= size, damaged)
    if text:
        rows = _text(stream, damaged, count=count, columns=len(types))
        cloud = _cloud(rows, {name: k for k, name in enumerate(types)}, unit_mm, kind)
    else:
        cloud = _cloud(_records(stream, dtype, count, damaged), {name: name for name in types}, unit_mm, kind)
    require(len(cloud.points_mm) == count, damaged)
    return cloud


def _ply(stream: BinaryIO, size: int, unit_mm: float, damaged: str) -> Cloud:
    lines = _header(stream, b"end_header", damaged)
    require(lines[0] == ["ply"] and lines[1][0] == "format", damaged)
    order = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}[lines[1][1]]
    elements = [k for k, words in enumerate(lines) if words[:1] == ["element"]]
    require(lines[elements[0]][1] == "vertex", "its vertices must be the first element; write it again so.")
    own = lines[elements[0] + 1 : (elements[1:] or [len(lines)])[0]]
    types = {words[2]: order + _TYPES[words[1]] for words in own if words[:1] == ["property"]}
    count = int(lines[elements[0]][2])
    return _table(stream, size, count, types, damaged, unit_mm, "PLY")


def _pcd(stream: BinaryIO, size: int, unit_mm: float, damaged: str) -> Cloud:
    header = {words[0]: words[1:] for words in _header(stream, b"DATA", damaged) if words}
    kind, names = header["DATA"][0], header["FIELDS"]
    require(kind != "binary_compressed", "it is a compressed PCD file; save it as binary.")
    each = zip(names, header["TYPE"], header["SIZE"], header.get("COUNT", ["1"] * len(names)), strict=True)
    types: dict[str, str] = {}
    for name, letter, n, more in each:
        columns = [name.replace("normal_", "n"), *(f"{name} {k}" for k in range(1, min(int(more), 64)))]
        types |= dict.fromkeys(columns[: int(more)], f"{'=' if kind == 'ascii' else '<'}{letter.lower()}{int(n)}")
    width, height, count = (int(header[key][0]) for key in ("WIDTH", "HEIGHT", "POINTS"))
    require(kind in ("ascii", "binary") and width * height == count, damaged)
    cloud = _table(stream, size, count, types, damaged, unit_mm, "PCD")
    return replace(cloud, points_mm=cloud.points_mm.reshape(height, width, 3)) if min(width, height) > 1 else cloud


def _xyz(stream: BinaryIO, _: int, unit_mm: float, damaged: str) -> Cloud:
    """Lines ``x y z``; a fourth number is brightness, three more are normals where they have unit length."""
    start, first = 0, b"#"
    while first[:1].isalpha() or first[:1] in (b"#", b"/", b"\n") or (start < 4096 and len(first.split()) == 1):
        start, first = stream.tell(), stream.readline(4096).translate(_SEPARATORS).lstrip(b" ")
        require(first != b"" and start < 65536, damaged)
    stream.seek(start)
    rows = _text(stream, damaged)
    part = next(rows)
    columns = _XYZ + (("intensity",) if part.shape[1] == 4 else ())
    if part.shape[1] >= 6 and bool((np.abs(np.linalg.norm(part[:, 3:6], axis=1) - 1.0) < 0.02).all()):
        columns = _XYZ + _NORMAL
    return _cloud(itertools.chain([part], rows), {name: k for k, name in enumerate(columns)}, unit_mm, "XYZ")


def _obj(stream: BinaryIO, _: int, unit_mm: float, damaged: str) -> Cloud:
    return _cloud(_text(stream, damaged, b"v "), {name: k for k, name in enumerate(_XYZ)}, unit_mm, "OBJ")


def _stl(stream: BinaryIO, size: int, unit_mm: float, damaged: str) -> Cloud:
    """Corners of the triangles, each once, in the order in which they come first."""
    head = stream.read(HEADER_BYTES + 4)
    count = int.from_bytes(head[HEADER_BYTES:], "little")
    rows: _Rows = (part["corners"].reshape(-1, 3) for part in _records(stream, RECORD, count, damaged))
    if size != stl_size(count):
        require(head[:5].lower() == b"solid", damaged)
        stream.seek(0)
        rows = _text(stream, damaged, b"vertex ")
    cloud = _cloud(rows, {name: k for k, name in enumerate(_XYZ)}, unit_mm, "STL")
    corners = np.ascontiguousarray(cloud.points_mm).view("V12")[:, 0]
    return replace(cloud, points_mm=cloud.points_mm[np.sort(np.unique(corners, return_index=True)[1])])


_READERS = {".ply": _ply, ".pcd": _pcd, ".xyz": _xyz, ".asc": _xyz, ".obj": _obj, ".stl": _stl}
CLOUDS = (*_READERS, ".x3p", ".tmd")  # suffixes of :func:`read_cloud`
