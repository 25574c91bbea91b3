"""Height maps of surface metrology: X3P and TMD, in and out; and a relightable picture of a surface, PTM.

Source: ISO 25178-72:2017 and Amd 1:2020 (X3P), read and written by the package x3pio; GelSight Inc., gsmatlab,
``readtmd`` and ``writetmd`` (layout of TMD version 2); T. Malzbender and D. Gelb, "Polynomial Texture Map (.ptm) File
Format", version 1.2, HP Laboratories, 2001; T. Malzbender, D. Gelb and H. Wolters, "Polynomial texture maps", SIGGRAPH
2001.
"""

from __future__ import annotations

import datetime
import io
import os
import struct
import zipfile
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import importing, open_file, read_bytes, refusing, require
from splitknit.io.npz import plain_zip
from splitknit.model import FloatArray

_NEEDS_X3PIO = "X3P files need the package x3pio: pip install 'splitknit[x3p]' ({error})."
_TMD = b"Binary TrueMap Data File v2.0\r\n\0"
_TMD_COMMENT = b"Created by splitknit \r\n\0"  # 24 bytes, for readers that take its length for granted
_MAX_PIXELS = 40_000_000
_MAX_BYTES = 1_000_000_000
_MAX_XML, _MAX_PARTS = 32_000_000, 2_000_000
"""Bytes of an X3P file's description, and of its tags and attributes: a surface of a megapixel as text."""
_LIGHTS = 400  # directions of the hemisphere that a relightable picture is fitted under
Grid = tuple[FloatArray, tuple[float, float]]
"""Heights (H, W) in mm, NaN where nothing was measured, row 0 at the top (largest y); steps along x and y in mm."""


def read_x3p(path: str | os.PathLike[str]) -> Grid:
    """Read the surface of an X3P file, the first layer of several.

    Returns `height_mm`, (H, W) float32, z towards the observer, row 0 at the largest y; `steps_mm`, along x and y.
    Raises BadInput if the package x3pio is missing, the file is damaged, too large, or holds a profile, a cloud of
    points or a grid of uneven steps.

    >>> height_mm, steps_mm = read_x3p("casing.x3p")  # doctest: +SKIP
    """
    with importing(_NEEDS_X3PIO):
        import x3pio
    name = os.fspath(path)
    damaged = f"{name} cannot be read as X3P: it is damaged or of another format; write it again."
    with open_file(path, _MAX_BYTES) as (stream, packed), refusing(damaged):
        with plain_zip(stream, packed, damaged) as archive:
            size = sum(one.file_size for one in archive.infolist())
            require(size <= _MAX_BYTES, f"{name} holds {size} bytes unpacked, but at most {_MAX_BYTES} are read.")
            for one in archive.infolist():
                if one.filename.replace("\\", "/").rsplit("/", 1)[-1] == "main.xml":
                    _check_xml(name, archive, one)
        stream.seek(0)
        about = x3pio.info(stream)
        even = about.header.x.is_incremental and about.header.y.is_incremental
        require(len(about.shape) == 2 and even, f"{name} holds no surface on an even grid; export it as a surface.")
        _check_size(name, about.shape)
        layers = about.layer_count * about.shape[0] * about.shape[1]
        require(layers <= _MAX_PIXELS, f"{name} holds {layers} points in its layers, but {_MAX_PIXELS} are read.")
        stream.seek(0)
        layer = x3pio.read(stream).layers[0]
        steps = tuple(1000.0 * float(one.increment) for one in (about.header.x, about.header.y))
        return (layer.z[::-1] * 1000.0).astype(np.float32), (_step(name, steps[0]), _step(name, steps[1]))


def _check_xml(name: str, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Refuse a description whose tree does not fit into memory, by its elements and attributes, some 100 bytes each."""
    text, parts = 0, 0
    with archive.open(member) as stream:
        while block := stream.read(1 << 20):
            text, parts = text + len(block), parts + block.count(b"<") + block.count(b"=")
            small = text <= _MAX_XML and parts <= _MAX_PARTS
            most = f"{_MAX_XML} bytes and {_MAX_PARTS // 2} elements are read"
            require(small, f"{name}: its {member.filename} is too large: at most {most}; export the points as binary.")


def x3p_bytes(height_mm: FloatArray, pitch_mm: float, comment: str, date: datetime.date | None = None) -> bytes:
    """Bytes of an X3P file (ISO 25178-72:2017, metres, NaN where nothing was measured) of a surface (H, W).

    `height_mm`: row 0 at the top; `pitch_mm`: step along both axes; `comment`: one line; `date`: of the measurement,
    1980-01-01 where it is not known, since the standard asks for one. Raises BadInput without the package x3pio.
    """
    with importing(_NEEDS_X3PIO):
        import x3pio
    day = datetime.datetime.combine(date or datetime.date(1980, 1, 1), datetime.time(), datetime.UTC)
    about = x3pio.Metadata.for_software("splitknit", comment.split(",", maxsplit=1)[0], date=day)
    about.comment = comment
    stream, step = io.BytesIO(), pitch_mm / 1000.0
    metres = height_mm[::-1].astype(np.float64) / 1000.0
    revision = x3pio.Revision.ISO5436_2000  # which more programs read than the amendment's
    x3pio.write(stream, metres, x_scale=step, y_scale=step, metadata=about, revision=revision)
    return stream.getvalue()


def read_tmd(path: str | os.PathLike[str]) -> Grid:
    """Read a TMD file (TrueMap, GelSight): heights in mm on a grid. Raises as :func:`read_x3p`."""
    name = os.fspath(path)
    data = read_bytes(path, _MAX_BYTES)
    end = data.find(b"\0", len(_TMD), len(_TMD) + 257) + 1
    known = data[: len(_TMD) - 3] == _TMD[:-3] and 0 < end <= len(data) - 24
    require(known, f"{name} is not a TMD file of version 2; export it again.")
    columns, rows, width, length, _, _ = struct.unpack_from("<IIffff", data, end)
    _check_size(name, (rows, columns))
    size = end + 24 + 4 * rows * columns
    require(len(data) >= size, f"{name} is cut short: {size} bytes are expected, it has {len(data)}.")
    steps = _step(name, width / columns), _step(name, length / rows)
    height = np.frombuffer(data, "<f4", rows * columns, end + 24).reshape(rows, columns)
    return np.where(np.abs(height) < 1e6, height, np.float32(np.nan)), steps


def tmd_bytes(height_mm: FloatArray, pitch_mm: float) -> bytes:
    """Bytes of a TMD file of a surface (H, W) in mm, row 0 at the top; NaN where nothing was measured."""
    rows, columns = height_mm.shape
    sides = struct.pack("<IIffff", columns, rows, columns * pitch_mm, rows * pitch_mm, 0.0, 0.0)
    return _TMD + _TMD_COMMENT + sides + height_mm.astype("<f4").tobytes()


def _check_size(name: str, shape: tuple[int, ...]) -> None:
    fits = min(shape) >= 2 and shape[0] * shape[1] <= _MAX_PIXELS
    require(fits, f"{name} is a grid of {shape[0]} x {shape[1]}; 2 x 2 to {_MAX_PIXELS} points are read.")


def _step(name: str, step_mm: float) -> float:
    require(1e-7 < step_mm < 1e3, f"{name}: its points lie {step_mm:g} mm apart, which is not a step of a surface.")
    return step_mm


def ptm_chunks(normals: FloatArray, albedo: NDArray[np.uint8]) -> Iterator[bytes]:
    """Yield the bytes of a polynomial texture map (PTM 1.2, LRGB) of a matt surface, for RTIViewer, Relight, OpenLIME.

    Per pixel, brightness under a light from (u, v) is a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v + a5, which is fitted to
    max(0, n . l) over the hemisphere (equal areas of the disc) by least squares. `normals`: (H, W, 3), x right, y up, z
    to the camera; zero where there is no surface; `albedo`: (H, W) grey value.
    """
    disc = (np.arange(_LIGHTS) + 0.5) / _LIGHTS  # sunflower: radius sqrt(k / n), steps of the golden angle
    radius, angle = np.sqrt(disc), np.arange(_LIGHTS) * np.pi * (3.0 - np.sqrt(5.0))
    u, v = radius * np.cos(angle), radius * np.sin(angle)
    lights = np.stack([u, v, np.sqrt(1.0 - disc)]).astype(np.float32)
    terms = np.stack([u * u, v * v, u * v, u, v, np.ones(_LIGHTS)], axis=1)
    solve = np.linalg.pinv(terms).T.astype(np.float32) * 255
    fitted = np.empty((*normals.shape[:2], 6), dtype=np.float32)
    for row, across in enumerate(normals):
        fitted[row] = np.maximum(across @ lights, 0) @ solve
    low, high = (each(axis=(0, 1)).astype(np.float64) for each in (fitted.min, fitted.max))
    scale = np.maximum((high - low) / 255.0, 1e-3)
    bias = np.round(-low / scale)
    yield f"PTM_1.2\nPTM_FORMAT_LRGB\n{albedo.shape[1]}\n{albedo.shape[0]}\n".encode("ascii")
    yield (" ".join(f"{one:.6f}" for one in scale) + "\n" + " ".join(f"{one:.0f}" for one in bias) + "\n").encode()
    for across in fitted[::-1]:  # rows run from the bottom to the top
        yield np.clip(np.round(across / scale + bias), 0, 255).astype(np.uint8).tobytes()
    for grey in albedo[::-1]:
        yield np.repeat(grey[:, None], 3, axis=1).tobytes()
