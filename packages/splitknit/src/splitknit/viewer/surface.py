"""A result as the viewer needs it: heights and relief on the finger's part of the grid, places in the upright frame;
where a ray meets it, sections, and its surface as a file.

Places are those of ``phalange.ply``: x right, y to the fingertip, z to the camera. All lengths are in mm; where the
result's scale is unknown, of a scale of 1 px/mm, so that the page shows the same numbers as pixels (`unit`).
"""

from __future__ import annotations

import math
import struct
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.geometry import bounding_box
from splitknit.io.images import decode_image
from splitknit.io.mesh import glb_chunks, stl_chunks, stl_size, surface_mesh, write_ply
from splitknit.io.pictures import upright_turn
from splitknit.io.results import axes_of, read_fields
from splitknit.model import BoolArray, FloatArray
from splitknit.units import MILLIMETRES, LengthUnit, pixels
from splitknit.viewer.catalogue import CatalogueEntry, Reply, open_below, read_below

_LONGEST_MM, _LONGEST_PX = 1000.0, 40_000.0
_RAYS = ("x_mm", "y_mm")
TILE = 96
_FIRST_VIEW = 70_000  # points of the first view
_FINE = 1024  # values are sent as multiples of this part of their distance: 13 nm at the finest level of a full frame
_HEAD = struct.Struct("<8id")
_Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ResultSurface:
    """The finger's box of a result."""

    height_mm: FloatArray
    """(h, w), NaN outside the mask."""
    ridge_mm: FloatArray
    """(h, w), zero where it is not known."""
    x_mm: FloatArray
    """(h, w)."""
    y_mm: FloatArray
    """(h, w)."""
    mask: BoolArray
    """(h, w) where there is a height."""
    corner: tuple[int, int]
    """Row and column of the box in the input."""
    size: tuple[int, int]
    """Rows and columns of the input."""
    pitch_mm: float
    turn: _Values
    """(2, 2): from (x, y) of the rig's frame to the upright one."""
    input_from_upright: _Values
    """(3, 3) on (column, row, 1)."""
    upright_size: tuple[int, int]
    low_mm: tuple[float, float, float]
    """Least x, y, z."""
    high_mm: tuple[float, float, float]
    highest_relief_mm: float
    """Largest distance of the relief from zero."""
    unit: LengthUnit = MILLIMETRES
    """What the page shows lengths in."""

    @property
    def longest_mm(self) -> float:
        """No place of an object is as far from the origin."""
        return _LONGEST_MM if self.unit.known else _LONGEST_PX * self.pitch_mm

    @property
    def nbytes(self) -> int:
        """Memory that its arrays take."""
        arrays = (self.height_mm, self.ridge_mm, self.x_mm, self.y_mm, self.mask)
        return sum(array.nbytes for array in arrays)

    @property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns of the box in the input."""
        (top, left), (height, width) = self.corner, self.mask.shape
        return slice(top, top + height), slice(left, left + width)

    @property
    def count(self) -> int:
        """Number of heights."""
        return int(self.mask.sum())

    def plan(self, column: _Values, row: _Values) -> _Values:
        """(2, N) x and y, mm, of places of the input's grid if the camera's rays were parallel."""
        x = (column - (self.size[1] - 1) / 2) * self.pitch_mm
        y = ((self.size[0] - 1) / 2 - row) * self.pitch_mm
        return np.asarray(self.turn @ np.stack([x, y]))

    def grid_of_plan(self, x_mm: _Values, y_mm: _Values) -> _Values:
        """(2, N) column and row in the box; the inverse of :meth:`plan`."""
        x, y = self.turn.T @ np.stack([x_mm, y_mm])
        column = x / self.pitch_mm + (self.size[1] - 1) / 2 - self.corner[1]
        row = (self.size[0] - 1) / 2 - y / self.pitch_mm - self.corner[0]
        return np.stack([column, row])

    def locate(self, x_mm: _Values, y_mm: _Values) -> _Values:
        """(2, N) column and row in the box where the surface has these x and y; iterated where the rays spread."""
        place = self.grid_of_plan(x_mm, y_mm)
        for _ in range(4):
            measured = np.stack([sample(self.x_mm, place), sample(self.y_mm, place)])
            error = np.nan_to_num(np.stack([x_mm, y_mm]) - measured)
            if float(np.abs(error).max(initial=0.0)) < 1e-6:
                break
            back = self.grid_of_plan(error[0], error[1]) - self.grid_of_plan(np.zeros(1), np.zeros(1))
            place = place + back
        return place

    def read(self, x_mm: _Values, y_mm: _Values) -> tuple[_Values, _Values]:
        """Heights (N,) and relief (N,), mm, at x and y (N,)."""
        place = self.locate(x_mm, y_mm)
        return sample(self.height_mm, place), sample(self.ridge_mm, place)

    @property
    def strides(self) -> list[int]:
        """Strides of all levels of tiles, powers of two, the coarsest first: that of the first view."""
        stride = 1
        while self.count / stride**2 > _FIRST_VIEW:
            stride *= 2
        return [stride >> k for k in range(stride.bit_length())]

    def filled_tiles(self, stride: int) -> list[tuple[int, int]]:
        """Row and column of each tile of a level that holds a piece of the surface."""
        mask = self.mask[::stride, ::stride]
        blocks = np.pad(mask, [(0, -side % TILE) for side in mask.shape])
        blocks = blocks.reshape(blocks.shape[0] // TILE, TILE, -1, TILE)
        return [(int(row), int(column)) for row, column in np.argwhere(blocks.any(axis=(1, 3)))]

    def tile(self, stride: int, row: int, column: int) -> bytes:
        """Return one tile. Raises BadInput if there is no such stride or tile."""
        require(stride in self.strides, f"there is no level of stride {stride}.")
        height, width = self.mask.shape
        high, wide = math.ceil(height / stride), math.ceil(width / stride)
        require(0 <= row * TILE < high and 0 <= column * TILE < wide, f"there is no tile {row}, {column}.")
        # one value before the tile, and TILE, one shared with the next tile, one behind it
        rows = np.arange(row * TILE - 1, min(row * TILE + TILE + 2, high + 1)) * stride
        columns = np.arange(column * TILE - 1, min(column * TILE + TILE + 2, wide + 1)) * stride
        inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
        place = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
        known = self.mask[place] & inside
        quantum = max(self.pitch_mm * stride / _FINE, 2.0**-20)  # 32 bits hold _LONGEST_PX
        first = (int(rows[0]) + self.corner[0], int(columns[0]) + self.corner[1])
        fields = (self.x_mm, self.y_mm, self.height_mm, self.ridge_mm)
        planes = [known.tobytes(), *(_packed(field[place], known, quantum) for field in fields)]
        total = _HEAD.size + sum(map(len, planes))
        head = _HEAD.pack(total, stride, row, column, len(rows), len(columns), *first, quantum)
        return head + b"".join(planes)

    def first_view(self) -> bytes:
        """Tiles of the coarsest level, one after the other."""
        stride = self.strides[0]
        return b"".join(self.tile(stride, row, column) for row, column in self.filled_tiles(stride))


def read_surface(folder: Path) -> ResultSurface:
    """Read the heights of a result folder; where their scale is unknown, all lengths are in pixels. Raises BadInput if
    ``height.npz`` is missing or damaged, or an array is missing or of another kind than a result's.
    """
    arrays = fields_of(folder, ("height_mm", "ridge_mm"), _RAYS, unscaled=True)
    again = f"{folder / 'height.npz'} is not a result's: reconstruct the capture again"
    mask, shape = arrays["mask"], arrays["mask"].shape
    pitch_mm, matrix = arrays["pitch_mm"], arrays["input_from_upright"]
    mask = mask & np.isfinite(arrays["height_mm"])
    require(bool(mask.any()), f"{again} (it holds no heights).")
    box = bounding_box(mask)
    inside = np.ascontiguousarray(mask[box])
    turn = upright_turn(matrix)
    require(bool(np.abs(turn @ turn.T - np.eye(2)).max() < 1e-3), f"{again} (its frame is not a rotation).")
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused below
        x, y = _places(arrays, shape, box, pitch_mm, turn)
        inside &= np.isfinite(x) & np.isfinite(y)
        require(bool(inside.any()), f"{again} (its heights have no places).")
        height = np.where(inside, arrays["height_mm"][box], np.float32(np.nan))
        ridge = np.where(inside, np.nan_to_num(arrays["ridge_mm"][box]), np.float32(0.0))
    corner = (box[0].start, box[1].start)
    low, high = zip(*((float(v.min()), float(v.max())) for v in (x[inside], y[inside], height[inside])), strict=True)
    relief = max(float(ridge.max()), -float(ridge.min()))
    surface = ResultSurface(
        height, ridge, x, y, inside, corner, (shape[0], shape[1]), pitch_mm, turn, matrix, arrays["upright_size"],
        low, high, relief, MILLIMETRES if arrays["scale_known"] else pixels(pitch_mm),
    )  # fmt: skip
    within = max(*np.abs([*low, *high]), relief) < surface.longest_mm  # not of NaN either
    places = f"{surface.longest_mm:g} {surface.unit.name}"
    require(bool(within), f"{again} (it holds places beyond {places}, which no result has).")
    return surface


def fields_of(folder: Path, names: Sequence[str], optional: Sequence[str] = (), *, unscaled: bool = False) -> Any:
    """Fields of a result, as :func:`splitknit.io.results.read_fields`, but no link. Raises BadInput."""
    path = folder / "height.npz"
    require(path.is_file() and not path.is_symlink(), f"'{folder}' is not a result: it holds no height.npz.")
    return read_fields(path, names, optional, unscaled=unscaled)


def _places(
    arrays: Mapping[str, NDArray[Any]], size: tuple[int, int], box: tuple[slice, slice], pitch_mm: float, turn: _Values
) -> tuple[FloatArray, FloatArray]:
    """Upright x and y (h, w) of the pixels."""
    rows, columns = (np.arange(side.start, side.stop, dtype=np.float64) for side in box)
    x: NDArray[Any] = ((columns - (size[1] - 1) / 2) * pitch_mm)[None, :]
    y: NDArray[Any] = (((size[0] - 1) / 2 - rows) * pitch_mm)[:, None]
    if all(name in arrays for name in _RAYS):
        x, y = (arrays[name][box].astype(np.float32) for name in _RAYS)
    across = (turn[0, 0] * x + turn[0, 1] * y).astype(np.float32)
    along = (turn[1, 0] * x + turn[1, 1] * y).astype(np.float32)
    return across, along


def _packed(values: FloatArray, known: BoolArray, quantum: float) -> bytes:
    """Whole numbers of quanta as what gzip packs well: differences along columns and rows, zigzag, byte by byte."""
    # what is unknown repeats the value before it
    before = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), 0), axis=1)
    whole = np.where(known, np.rint(np.nan_to_num(values) / quantum), 0.0).astype(np.int32)
    whole = np.take_along_axis(whole, before, axis=1)
    step = np.diff(np.diff(whole, axis=0, prepend=0), axis=1, prepend=0)
    zigzag = ((step << 1) ^ (step >> 31)).astype("<i4")
    return zigzag.reshape(-1, 1).view(np.uint8).T.tobytes()


# Where a ray meets a surface, and what lies between two points of it: from the result's own values.

_RIDGE_SIGMA_MM = 0.32
_MAX_SAMPLES = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A cut through the surface between two points, and its figures."""

    along_mm: _Values  # (N,) distance in the finger plane from the first point
    x_mm: _Values
    y_mm: _Values
    height_mm: _Values  # (N,), NaN where there is no surface
    relief_um: _Values  # (N,), NaN likewise
    figures: dict[str, float | int | None]


def pick(
    surface: ResultSurface, origin_mm: _Values, direction: _Values, exaggeration: float = 1.0
) -> tuple[float, float, float] | None:
    """Return the first point of the surface on a ray of any length, or None where the ray misses it. `exaggeration`:
    factor of the relief in the picture that was pointed at; the point is on the true surface. Raises BadInput if the
    ray has no direction or is not finite.
    """
    ray = np.concatenate([origin_mm, direction])
    length = float(np.linalg.norm(direction))
    require(bool(np.isfinite(ray).all()) and length > 1e-9, "a ray needs a finite origin and a direction.")
    unit = direction / length
    span = _inside_box(surface, origin_mm, unit, abs(exaggeration - 1.0))
    if span is None:
        return None
    count = int(np.clip((span[1] - span[0]) / (0.5 * surface.pitch_mm), 16, _MAX_SAMPLES))
    t = np.linspace(span[0], span[1], count)
    points = origin_mm[:, None] + unit[:, None] * t
    place = surface.locate(points[0], points[1])
    above = points[2] - _shown(surface, place, exaggeration)
    known = np.isfinite(above)
    crossed = np.flatnonzero(known[:-1] & known[1:] & (np.sign(above[:-1]) != np.sign(above[1:])))
    if crossed.size == 0:
        return None
    k = int(crossed[0])
    fraction = float(above[k] / (above[k] - above[k + 1]))
    x, y = (float(points[axis, k] + fraction * (points[axis, k + 1] - points[axis, k])) for axis in (0, 1))
    z = float(sample(surface.height_mm, surface.locate(np.array([x]), np.array([y])))[0])
    return (x, y, z) if np.isfinite(z) else None


Reading = Callable[[_Values, _Values], tuple[_Values, _Values]]
"""As :meth:`ResultSurface.read`."""


def section(
    surface: ResultSurface, start_mm: tuple[float, float], end_mm: tuple[float, float], read: Reading | None = None
) -> Section:
    """Cut the surface between two points given by x and y; `read` gives the values of another one in its frame. Raises
    BadInput if the points are not finite, far away, equal, or neither lies on the surface.
    """
    ends = np.array([start_mm, end_mm], dtype=np.float64)
    sound = bool(np.isfinite(ends).all()) and float(np.abs(ends).max()) <= surface.longest_mm
    require(sound, "the two points must be finite and on the surface.")
    flat_mm = float(np.hypot(*(ends[1] - ends[0])))
    require(flat_mm >= surface.pitch_mm, "the two points are the same; choose two that are apart.")
    count = int(min(_MAX_SAMPLES, max(2.0, np.ceil(flat_mm / surface.pitch_mm)))) + 1
    fraction = np.linspace(0.0, 1.0, count)
    x, y = (ends[0, axis] + fraction * (ends[1, axis] - ends[0, axis]) for axis in (0, 1))
    height, ridge = (read or surface.read)(x, y)
    relief = np.where(np.isfinite(height), surface.unit.small_per_mm * ridge, np.nan)
    require(bool(np.isfinite(height).any()), "no surface lies between the two points; choose points on the surface.")
    along = fraction * flat_mm
    return Section(along, x, y, height, relief, _figures(along, height, relief, ridges=surface.unit.known))


def _figures(along: _Values, height: _Values, relief: _Values, *, ridges: bool) -> dict[str, float | int | None]:
    known = np.isfinite(height)
    whole = bool(known[0] and known[-1])
    steps = np.hypot(np.diff(along), np.diff(height))
    both = known[:-1] & known[1:]
    r = relief[known]
    count, period = _ridges(along, relief) if ridges else (None, None)
    rise = float(height[-1] - height[0]) if whole else None
    return {
        "flat_mm": float(along[-1]),
        "straight_mm": None if rise is None else float(np.hypot(along[-1], rise)),
        "along_surface_mm": float(steps.sum()) if bool(both.all()) else None,
        "height_difference_mm": rise,
        "relief_um": float(np.subtract(*np.percentile(r, (95, 5)))),
        "relief_rms_um": float(r.std()),
        "ridges": count,
        "ridge_period_mm": period,
        "missing_share": float(1.0 - known.mean()),
    }


def _ridges(along: _Values, relief: _Values) -> tuple[int, float | None]:
    """Count ridges by the crossings of the mean of their surroundings; their mean distance."""
    known = np.isfinite(relief)
    step = along[1] - along[0]
    weight = _blur(known.astype(np.float64), _RIDGE_SIGMA_MM / step)
    band = np.where(known, relief, 0.0)
    band = np.where(known, band - _blur(band, _RIDGE_SIGMA_MM / step) / np.maximum(weight, 1e-3), 0.0)
    level = 0.35 * float(band[known].std())
    if level <= 0:
        return 0, None
    state = np.where(band > level, 1, np.where(band < -level, -1, 0))
    known = np.flatnonzero(state)
    rising = known[1:][(state[known[1:]] == 1) & (state[known[:-1]] == -1)]
    places = along[rising]
    if len(places) < 2:
        return len(places), None
    return len(places), float((places[-1] - places[0]) / (len(places) - 1))


def _blur(values: _Values, sigma: float) -> _Values:
    blurred: Any = cv2.GaussianBlur(values[None], (0, 0), max(sigma, 0.3), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred[0], dtype=np.float64)


def sample(field: FloatArray, place: _Values) -> _Values:
    """Bilinear values (N,) of `field` (h, w) at columns and rows (2, N); NaN beyond its border."""
    column, row = (np.ascontiguousarray(axis[None], dtype=np.float32) for axis in place)
    pieces = [
        cv2.remap(
            field, column[:, k : k + 16_384], row[:, k : k + 16_384], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=(float("nan"),),
        )[0]
        for k in range(0, column.shape[1], 16_384)
    ]  # fmt: skip
    return np.concatenate(pieces).astype(np.float64)


def _shown(surface: ResultSurface, place: _Values, exaggeration: float) -> _Values:
    """Height (N,) in a picture whose relief is exaggerated, less so on steep flanks (as the page's shader does)."""
    height = sample(surface.height_mm, place)
    if exaggeration == 1.0:
        return height
    step = np.array([[1.0], [0.0]])
    z, sides = surface.height_mm, (step, step[::-1])
    slopes = [(sample(z, place + d) - sample(z, place - d)) / (2 * surface.pitch_mm) for d in sides]
    facing = 1.0 / (1.0 + np.nan_to_num(slopes[0]) ** 2 + np.nan_to_num(slopes[1]) ** 2)
    fade = np.clip(2.0 * facing, 0.0, 1.0)
    return np.asarray(height + (exaggeration - 1.0) * fade * sample(surface.ridge_mm, place))


def _inside_box(surface: ResultSurface, origin: _Values, unit: _Values, extra: float) -> tuple[float, float] | None:
    """Where a ray enters and leaves the box around the surface."""
    margin = surface.pitch_mm + extra * surface.highest_relief_mm
    low, high = np.array(surface.low_mm) - margin, np.array(surface.high_mm) + margin
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a side never meets it
        ends = np.stack([low - origin, high - origin]) / unit
    near, far = max(float(np.nanmax(ends.min(axis=0))), 0.0), float(np.nanmin(ends.max(axis=0)))
    return (near, far) if far > near else None


KINDS = {"ply": "application/octet-stream", "stl": "model/stl", "glb": "model/gltf-binary"}
STEPS = (1, 2, 4, 8)


def export(entry: CatalogueEntry, surface: ResultSurface, kind: str, step: int) -> Reply:
    """Make a file of every `step`-th value; BadInput if kind or step is not known, or the result lacks an array."""
    require(kind in KINDS, f"a surface is exported as {', '.join(KINDS)}, not as {kind[:20]!a}.")
    require(step in STEPS, "every 1st, 2nd, 4th or 8th value can be exported.")
    plain = "".join(one if one.isascii() and (one.isalnum() or one in "-_") else "-" for one in entry.name).strip("-")
    name = f"{plain[-60:] or 'finger'}{'' if step == 1 else f'-every-{step}'}.{kind}"
    saved = {"Content-Disposition": f'attachment; filename="{name}"'}
    if kind == "ply" and step == 1:
        try:
            return Reply.of_file(open_below(entry.folder, _mesh(entry)), KINDS[kind], saved)
        except BadInput:
            pass  # made anew below
    x, y, z = (field[::step, ::step] for field in (surface.x_mm, surface.y_mm, surface.height_mm))
    vertices, faces, index = surface_mesh(x, y, z)
    require(len(faces) > 0, "nothing is left of the surface at this step; export more values.")
    if kind == "stl":
        title = f"{entry.report.get('preset', '')} {name}"
        return Reply(KINDS[kind], stl_size(len(faces)), stl_chunks(vertices, faces, title), saved)
    used = index >= 0
    normals = _normals(entry, surface)[::step, ::step][used]
    intensity = _albedo(entry, surface)[::step, ::step][used]
    facts = _origin(entry, step, surface.unit.title)
    if kind == "glb":
        size, chunks = glb_chunks(vertices, normals, intensity, faces, facts)
        return Reply(KINDS[kind], size, chunks, saved)
    with tempfile.TemporaryDirectory(prefix="splitknit-") as folder:
        comments = [f"{key} {value}" for key, value in facts.items()]
        comments = [text.encode("ascii", "replace").decode("ascii") for text in comments]
        write_ply(Path(folder) / name, vertices, normals, intensity, faces, comments)
        return Reply.of_file(open_below(Path(folder), name), KINDS[kind], saved)  # open: it outlives its name


def _mesh(entry: CatalogueEntry) -> str:
    """The mesh that was written with a result: of a finger, or of an opaque thing."""
    return "surface.ply" if (entry.folder / "surface.ply").is_file() else "phalange.ply"


def _origin(entry: CatalogueEntry, step: int, unit: str) -> dict[str, Any]:
    report = entry.report
    software = report.get("software", {})
    facts = {
        "generator": f"splitknit {software.get('version', '')}, preset {report.get('preset', '')}".strip(),
        "unit": f"{unit}; {axes_of('opaque' if _mesh(entry) == 'surface.ply' else 'skin')}",
        "sampling": f"every {step}. value of the result",
    }
    try:  # the mesh that was written with the result states its hashes
        with open_below(entry.folder, _mesh(entry)) as stream:
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
