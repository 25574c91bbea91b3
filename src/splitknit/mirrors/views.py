"""Which part of one image shows the finger itself, and which parts show it in mirrors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.view import pixels_of
from splitknit.model import BoolArray, Camera, FloatArray, Mirror

_PX_PER_MM = 22.0
"""Scale of the copy on which the outlines are found."""
_REACH_MM = 3.0
"""A mirror's picture is looked for this far beyond its nominal outline."""

# Areas of a picture: outlines filled, grown and shrunk, the boxes around them, and what is left out of them.


def _bin_image(image: FloatArray, factor: int) -> FloatArray:
    """Means over blocks of `factor` pixels a side of an image (h, w) or (h, w, C); what fills no block is dropped."""
    if factor == 1:
        return image
    height, width = (n // factor for n in image.shape[:2])
    cut = image[: height * factor, : width * factor]
    return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _enlarged_box(
    cells: tuple[slice, slice], factor: int, small: tuple[int, ...], large: tuple[int, ...]
) -> tuple[slice, slice]:
    """Rows and columns of an image that blocks of `factor` pixels cover; the last ones take what fills no block."""
    ends = [n if c.stop == k else c.stop * factor for c, k, n in zip(cells, small, large[:2], strict=True)]
    return slice(cells[0].start * factor, ends[0]), slice(cells[1].start * factor, ends[1])


def _around(mask: BoolArray, margin: float) -> tuple[slice, slice]:
    """Rows and columns that hold a mask and `margin` pixels around it."""
    found = []
    for axis in (1, 0):
        places = np.flatnonzero(mask.any(axis=axis))
        low, high = int(places[0] - margin), int(places[-1] + margin) + 2
        found.append(slice(max(0, low), min(high, mask.shape[1 - axis])))
    return found[0], found[1]


def _blanked(image: FloatArray, inside: BoolArray, px_per_mm: float) -> FloatArray:
    """The image whose pixels outside `inside` look like the background beside them."""
    if inside.all():
        return image
    done = image.copy()
    ring = inside & ~_shrunk(inside, max(2.0, 0.4 * px_per_mm))
    done[~inside] = np.median(done[ring], axis=0) if ring.any() else np.float32(0.0)
    return done


def _filled(outline: Array, shape: tuple[int, int]) -> BoolArray:
    """(h, w) pixels inside an outline (n, 2) of columns and rows."""
    canvas = np.zeros(shape, dtype=np.uint8)
    cv2.fillPoly(canvas, [np.round(outline * 16).astype(np.int32)], 1, shift=4)
    return np.asarray(canvas, dtype=np.bool_)


def _grown(mask: BoolArray, radius: float) -> BoolArray:
    """A mask and what lies within `radius` pixels of it along rows and columns."""
    size = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)), dtype=np.bool_)


def _shrunk(mask: BoolArray, radius: float) -> BoolArray:
    """What of a mask lies further than that from its outline."""
    return ~_grown(~mask, radius)


Array = NDArray[np.float64]
SEARCH_PX_PER_MM = 4.0
"""Views are looked for on a copy of about this scale where their outlines are found apart."""
FindFinger = Callable[[FloatArray, float], BoolArray]
"""From an image (h, w, C) and its px_per_mm to the mask of the finger in it."""
FindOutline = Callable[[FloatArray, BoolArray, float], BoolArray]
"""From an image (h, w, C), a rough mask of the same piece of the scene and px_per_mm to the finger's mask (h, w)."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Masks of one finger's views in one image, on blocks of `binning` pixels a side."""

    front: BoolArray
    """(h, w)."""
    mirrors: Mapping[str, BoolArray]
    """(h, w) by the mirrors' names; those that show no finger are left out."""
    binning: int


def view_binning(px_per_mm: float) -> int:
    """How many pixels a side are averaged before views are looked for."""
    return max(1, round(px_per_mm / _PX_PER_MM))


def mirror_outline(mirror: Mirror, camera: Camera, binning: int = 1) -> Array:
    """(n, 2) column and row of a mirror's nominal outline in an image of blocks of `binning` pixels a side."""
    full = pixels_of(camera, np.asarray(mirror.corners_mm, dtype=np.float64))
    return np.asarray((full - 0.5 * (binning - 1)) / binning)


def find_views(  # noqa: PLR0917
    image: FloatArray,
    camera: Camera,
    mirrors: Mapping[str, Mirror],
    find_finger: FindFinger,
    binning: int,
    find_outline: FindOutline | None = None,
) -> Views:
    """Find the finger itself and its mirror images.

    The front view is what `find_finger` sees of the image without the mirrors' nominal outlines; each mirror's view is
    what it sees around that mirror's outline, without the front view. A mirror's frame, second reflections and the
    finger's far parts are left out because one piece of skin is wanted from each. With `find_outline`, `find_finger`
    works on a small copy of the image, and the outlines are found in the image around what was seen there.

    Parameters
    ----------
    image : (h, w, C) float32
        Linear, in blocks of `binning` pixels a side of the camera's image.
    camera : Camera
    mirrors : by name, where they nominally are
    find_finger : mask of the finger in an image, :func:`splitknit.finger.finger_mask` say
    binning : int
    find_outline : outline of a finger roughly known, :func:`splitknit.finger.finger_outline` say, optional

    Raises
    ------
    BadInput
        If there are no mirrors, none shows a finger, a view is cut by a mirror's edge, or there are two fingers.
    """
    require(bool(mirrors), "the rig has no mirrors: name them in rig.json, or take the shape from light.")
    factor = 1
    if find_outline is not None:
        factor = max(1, int(camera.px_per_mm / binning / SEARCH_PX_PER_MM))
    rough = _rough_views(_bin_image(image, factor), camera, mirrors, find_finger, binning * factor)
    views = rough
    if find_outline is not None:
        views = _outlined(image, camera, mirrors, rough, find_outline, factor)
    for name, view in views.mirrors.items():
        _refuse_contact(name, view, views.front, camera.px_per_mm / views.binning)
    return views


def _rough_views(
    image: FloatArray,
    camera: Camera,
    mirrors: Mapping[str, Mirror],
    find_finger: FindFinger,
    binning: int,
) -> Views:
    """Views as `find_finger` sees them."""
    px_per_mm = camera.px_per_mm / binning
    outlines = {name: mirror_outline(mirror, camera, binning) for name, mirror in mirrors.items()}
    in_any = _in_any(outlines, (image.shape[0], image.shape[1]))
    front = _largest_in(image, ~in_any, px_per_mm, find_finger)
    if front is None:
        raise BadInput("no finger was found beside the mirrors: check the exposure, the LEDs and the finger's place.")
    _refuse_second(image, front, in_any, px_per_mm)

    def look(name: str) -> BoolArray | None:
        return _largest_in(image, _allowed(name, outlines, front, px_per_mm), px_per_mm, find_finger)

    with ThreadPoolExecutor(2) as pool:
        seen = dict(zip(sorted(mirrors), pool.map(look, sorted(mirrors)), strict=True))
    return _with_views(front, seen, binning)


def _outlined(  # noqa: PLR0917
    image: FloatArray,
    camera: Camera,
    mirrors: Mapping[str, Mirror],
    rough: Views,
    find_outline: FindOutline,
    factor: int,
) -> Views:
    """Views whose outlines are found in `image`, around the rough ones."""
    binning = rough.binning // factor
    px_per_mm = camera.px_per_mm / binning
    outlines = {name: mirror_outline(mirror, camera, binning) for name, mirror in mirrors.items()}

    def found(mask: BoolArray, name: str, front: BoolArray | None) -> BoolArray | None:
        cells = _around(mask, max(3.0, _REACH_MM) * px_per_mm / factor)
        box = _enlarged_box(cells, factor, mask.shape, image.shape)
        corner = np.array([box[1].start, box[0].start])
        inside = {other: outline - corner for other, outline in outlines.items()}
        shape = (box[0].stop - box[0].start, box[1].stop - box[1].start)
        allowed = ~_in_any(inside, shape) if front is None else _allowed(name, inside, front[box], px_per_mm)
        try:
            part = find_outline(_blanked(image[box], allowed, px_per_mm), mask[cells], px_per_mm) & allowed
        except BadInput:
            return None
        whole = np.zeros(image.shape[:2], dtype=np.bool_)
        whole[box] = part
        return whole if part.any() else None

    front = found(rough.front, "", None)
    if front is None:
        raise BadInput("no finger was found beside the mirrors: check the exposure, the LEDs and the finger's place.")
    seen = {name: found(mask, name, front) for name, mask in rough.mirrors.items()}
    return _with_views(front, seen, binning)


def _with_views(front: BoolArray, seen: Mapping[str, BoolArray | None], binning: int) -> Views:
    """Front view and what mirrors show."""
    found = {name: view for name, view in seen.items() if view is not None}
    require(
        bool(found),
        "no mirror shows the finger: check that the rig file's mirrors are the ones in the picture, or take the shape "
        "from light (--shape nir or white).",
    )
    return Views(front, found, binning)


def _in_any(outlines: Mapping[str, Array], shape: tuple[int, int]) -> BoolArray:
    """Which pixels lie in one of the mirrors' nominal outlines."""
    return np.asarray(np.logical_or.reduce([_filled(outline, shape) for outline in outlines.values()]))


def _allowed(name: str, outlines: Mapping[str, Array], front: BoolArray, px_per_mm: float) -> BoolArray:
    """Where a mirror's picture may be: around its nominal outline, beside the front view and the other mirrors."""
    shape = (front.shape[0], front.shape[1])
    allowed = _grown(_filled(outlines[name], shape), _REACH_MM * px_per_mm) & ~_grown(front, 0.4 * px_per_mm)
    for other, outline in outlines.items():
        if other != name:
            allowed &= ~_filled(outline, shape)
    return allowed


def without_mirrors(image: FloatArray, camera: Camera, mirrors: Mapping[str, Mirror], binning: int) -> FloatArray:
    """The image (h, w) or (h, w, C) with the mirrors' nominal outlines filled with the background beside them."""
    shape = (image.shape[0], image.shape[1])
    outlines = [_filled(mirror_outline(mirror, camera, binning), shape) for mirror in mirrors.values()]
    return _blanked(image, ~np.logical_or.reduce(outlines), camera.px_per_mm / binning)


def _largest_in(image: FloatArray, allowed: BoolArray, px_per_mm: float, find_finger: FindFinger) -> BoolArray | None:
    """The finger in the part of the image that is `allowed`, or None."""
    rows, columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
    if rows.size < 20 or columns.size < 20:
        return None
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    inside = allowed[window]
    part = _blanked(image[window], inside, px_per_mm)
    try:
        mask = find_finger(part, px_per_mm) & inside
    except BadInput:
        return None
    whole = np.zeros(allowed.shape, dtype=np.bool_)
    whole[window] = mask
    return whole if mask.any() else None


def _refuse_second(image: FloatArray, front: BoolArray, in_any: BoolArray, px_per_mm: float) -> None:
    """Refuse another finger beside the first: about as bright, and nearly as large."""
    light = image if image.ndim == 2 else image.sum(axis=2)
    other = (light > 0.5 * float(np.median(light[front]))) & ~in_any & ~_grown(front, 1.5 * px_per_mm)
    _, _, stats, _ = cv2.connectedComponentsWithStats(other.astype(np.uint8))
    largest = max((int(area) for area in stats[1:, cv2.CC_STAT_AREA]), default=0)
    require(
        largest < 0.25 * float(front.sum()),
        "there are two fingers in the picture, or a mirror that the rig file does not name: lay one finger there at a "
        "time, and name all mirrors.",
    )


def _refuse_contact(name: str, view: BoolArray, front: BoolArray, px_per_mm: float) -> None:
    """Refuse a finger that lies on its own mirror image."""
    near = _grown(front, 0.6 * px_per_mm) & view
    require(
        int(near.sum()) < (1.0 * px_per_mm) ** 2,
        f"the finger touches the edge of the {name} mirror: lay it in the middle between the mirrors.",
    )
