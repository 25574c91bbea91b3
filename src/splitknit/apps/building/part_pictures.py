"""Pictures of parts: a z-buffer renderer of triangle meshes, in numpy.

Parallel projection, flat shading by two lamps, and dark lines where the depth or the direction of the surface jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.pictures import ColourArray

_SUPERSAMPLING = 2
_BACKGROUND = np.array([0.965, 0.965, 0.965])
_KEY = np.array([-0.45, 0.75, 0.80])
_FILL = np.array([0.45, -0.25, 0.85])
_LARGEST = 64
_CANDIDATES = 2_000_000
"""Pixels of triangles that are looked at together."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Something to draw."""

    triangles: NDArray[np.float32]
    """(N, 3, 3), x, y, z."""
    colour: tuple[float, float, float]
    """Red, green, blue in [0, 1]."""
    label: str = ""
    label_at: tuple[float, float, float] | None = None
    """Point that the label belongs to."""


@dataclass(frozen=True, slots=True)
class View:
    """Where the viewer stands."""

    azimuth_deg: float = -60.0
    """Counter-clockwise about z; -90 looks along +y, from the hand's side."""
    elevation_deg: float = 28.0
    """Above the horizon; negative looks up from below."""


def draw(
    bodies: Sequence[Body], view: View, size: tuple[int, int] = (640, 800), margin: float = 0.06, labels: float = 0.0
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


def _basis(view: View) -> NDArray[np.float64]:
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
    depth: NDArray[np.float64],
    nearest: NDArray[np.int64],
    normals: NDArray[np.float64],
    colours: NDArray[np.float64],
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
    depth: NDArray[np.float64],
    nearest: NDArray[np.int64],
    normals: NDArray[np.float64],
    owner: NDArray[np.int64],
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
