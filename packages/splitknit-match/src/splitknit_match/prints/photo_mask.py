"""The finger in a photograph, before any background: an outline that has the shape of a fingertip, and what is in it.

A tip between two parallel sides is sought among the edges, at every place, turn and width. The best of them are fitted
to edges and colours, and rated by shape, colour and ridges. Nothing is assumed of the background.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray

_SOUGHT, _FITTED, _FINE = 96, 256, 512
"""Longer side of the picture in which fingers are sought, fitted, and in which the outline is found."""
_WIDTHS = tuple(0.11 * 1.18**k for k in range(11))
"""Of fingers, in longer sides of the picture."""
_TURNS, _BINS = 32, 16
"""Directions of the tip, and of edges."""
_WEIGHTS = np.array([0.6, 1.5, 1.5], np.float32)
"""Of L*, a* and b*: a finger's flanks and shadows differ in lightness alone."""
_TIP = 0.6
"""Length of the tip's half ellipse, in widths of the finger."""
_TRIED = 7
"""Places that are fitted."""
_LENGTH, _WHOLE = 2.2, 5.0
"""Of the outline, in widths: that is rated, and at most."""
_STEP, _ACROSS = 0.05, 41
"""Step along an outline, in widths; places across it that are tried."""
_BESIDE = 0.8
"""From the middle of the finger, in widths: one of both sides shows so much, or ridges may be taken for the outline."""
_BLOCK, _BLOCKS, _WIDTH_PX = 48, 40, 400
"""Side and number of the windows in which ridges are sought, and width of the finger at most, pixels."""
_RIDGES = (23.5, 61.0)
"""Of a finger's width: it is some 38 ridges wide."""
_MOST, _NO_RIDGES = 0.6, 0.2
"""Standard deviation of the logarithm of light in windows of skin, at most: drawn fingers have up to 0.2; and what is
left of the likeness without ridges."""
_LEAST, MIN_LIKENESS, _IN_BOX = 0.01, 0.17, 0.01
"""Likeness by shape and colour of what is searched for ridges. With them, drawn fingers have 0.18 to 1, pictures
without one less than 0.16 (validation/match/telephone.py); and where somebody says that there is one."""
Pixels = NDArray[np.uint8] | NDArray[np.uint16]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A finger in a picture, lengths in its longer sides."""

    tip: Array
    """(2,) x and y."""
    ahead: Array
    """(2,) direction of the tip, a unit vector."""
    width: float
    points: Array
    """(N, 2) from the left base around the tip to the right one; empty before it is fitted."""
    edges: float = 0.0
    """0 to 1: how well edges follow it, where it is in view."""

    @property
    def middle(self) -> Array:
        """(2,) of the last phalanx."""
        return self.tip - 0.7 * self.width * self.ahead

    def places(self, vectors: Array) -> Array:
        """Vectors (N, 2) of the model, x to the right and y back from the tip in widths, in the picture."""
        right = np.array([-self.ahead[1], self.ahead[0]])
        return np.asarray(vectors[:, :1] * right - vectors[:, 1:] * self.ahead)

    def corners(self, shape: tuple[int, ...], first: float = _WHOLE + 1, shrunk: float = 1.0) -> Array:
        """(N, 2) pixels of a picture: around the part from the tip to `first` widths behind it."""
        kept = self.points[(self.tip - self.points) @ self.ahead < first * self.width]
        centre = self.tip - _TIP * self.width * self.ahead
        return (centre + (kept - centre) * shrunk) * max(shape[:2]) - 0.5


@dataclass(frozen=True, slots=True, eq=False)
class FingerFound:
    """The finger that was chosen."""

    mask: BoolArray
    """(H, W)."""
    direction_deg: float
    """Of its tip: 0 = up, counter-clockwise."""
    width_px: float
    others: int
    """Further fingers in the picture."""


def finger_in_photo(pixels: Pixels, box: tuple[int, int, int, int] | None = None) -> FingerFound:
    """Find the clearest finger of a photograph (H, W, 3) of 8 or 16 bits; raises BadInput where there is none.

    `box`: left, top, width and height in pixels of the part in which it lies.
    """
    height, width = pixels.shape[:2]
    left, top, wide, high = box or (0, 0, width, height)
    inside = left >= 0 and top >= 0 and min(wide, high) >= _BLOCK and left + wide <= width and top + high <= height
    require(
        box is None or inside,
        f"`box` must lie in the picture of {width} x {height} pixels, {_BLOCK} or more wide and high, but it is "
        f"{left},{top},{wide},{high}.",
    )
    margin = 0 if box is None else max(wide, high) // 8  # what lies beside it shows where it ends
    first = max(left - margin, 0), max(top - margin, 0)
    part = pixels[first[1] : top + high + margin, first[0] : left + wide + margin]
    low, most = (np.array(one, dtype=float) for one in ((left - first[0], top - first[1]), (wide, high)))
    fine, side = _colours(part, _FINE), max(part.shape[:2])
    lab = _reduced(fine, _FITTED)
    bins = _bins(lab)
    shaped: list[tuple[float, Outline]] = []
    for one in _sought(_reduced(fine, _SOUGHT)):
        for reach in (0.3, 0.2):
            one = _fitted(one, lab, bins, _LENGTH, reach)  # noqa: PLW2901
        if ((one.middle * side >= low) & (one.middle * side <= low + most)).all():
            shaped.append((_likeness(one, lab), one))
    shaped.sort(key=lambda item: -item[0])
    rated: list[tuple[float, Outline]] = []
    for value, one in shaped:
        if value > max(_LEAST, 0.5 * max((of for of, _ in rated), default=0.0)):  # ridges only lower it
            rated.append((value * _by_ridges(part, one), one))
    rated.sort(key=lambda item: -item[0])
    require(
        rated and rated[0][0] >= (MIN_LIKENESS if box is None else _IN_BOX),
        "no finger was found in this picture in colour: no part of it, its tip in view, has the shape, the colour and "
        "the ridges of one; photograph one finger from near, pad to the camera, in focus, or save a print in grey.",
    )
    best = rated[0][1]
    beside = (best.tip + best.width * best.places(np.array([[-_BESIDE, 0.4], [_BESIDE, 0.4]]))) * side
    require(
        box is not None or ((beside >= 0) & (beside <= np.array(part.shape[1::-1]))).all(axis=1).any(),
        "the finger fills the picture from side to side; photograph it from farther, sides and its tip in view.",
    )
    others: list[Outline] = []
    for value, one in rated[1:]:
        apart = all(np.linalg.norm(one.middle - two.middle) > 0.8 * best.width for two in (best, *others))
        aside = abs((one.middle - best.middle) @ np.array([-best.ahead[1], best.ahead[0]])) > 0.6 * best.width
        if value > 0.5 * rated[0][0] and apart and aside and 0.5 < one.width / best.width < 1.6:
            others.append(one)
    bins = _bins(fine)
    best = _fitted(best, fine, bins, _WHOLE, 0.2)
    sides = (best.tip + best.width * best.places(np.array([[-0.5, 1.1], [0.5, 1.1]]))) * side
    if ((sides >= 0) & (sides <= np.array(part.shape[1::-1]))).all():
        for reach in (0.15, 0.08):
            best = _fitted(best, fine, bins, _WHOLE, reach)
    mask = np.zeros((height, width), np.bool_)
    # pixels that its sides cross make a finger a pixel wider
    inside = _filled(best.corners(part.shape, shrunk=1 - 1 / (best.width * side)), part.shape)
    mask[first[1] : first[1] + part.shape[0], first[0] : first[0] + part.shape[1]] = inside
    direction_deg = float(np.degrees(np.arctan2(-best.ahead[0], -best.ahead[1])))
    return FingerFound(mask, direction_deg, best.width * side, len(others))


def _colours(pixels: Pixels, side: int) -> FloatArray:
    """The picture in weighted CIELAB, (H, W, 3), reduced to a longer side."""
    coded = (_reduced(pixels, side) / np.iinfo(pixels.dtype).max).astype(np.float32)
    return cv2.cvtColor(coded, cv2.COLOR_RGB2Lab) * _WEIGHTS


def _reduced(picture: NDArray[Any], side: int) -> NDArray[Any]:
    factor = min(1.0, side / max(picture.shape[:2]))
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def _filled(corners: Array, shape: tuple[int, ...]) -> BoolArray:
    """(H, W) the inside of a polygon of pixels (N, 2), and the pixels that its sides cross."""
    mask = np.zeros(shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(16 * corners).astype(np.int32)], 1, shift=4)
    return mask > 0


def _tip_at(turn: Array) -> tuple[Array, Array]:
    """(N, 2) points of the model's tip and their normals."""
    points = np.column_stack([0.5 * np.sin(turn), _TIP * (1 - np.cos(turn))])
    normals = np.column_stack([np.sin(turn) / 0.5, -np.cos(turn) / _TIP])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _sides_at(back: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """(N, 2) points of the model's left and right side and their normals."""
    sides = tuple((np.column_stack([np.full(len(back), x), back]), np.tile([2 * x, 0.0], (len(back), 1)))
                  for x in (-0.5, 0.5))  # fmt: skip
    return sides[0], sides[1]


@lru_cache(maxsize=2)
def _model(length: float) -> tuple[Array, Array]:
    """(N, 2) points of a finger's outline, from the left base around the tip, and normals."""
    back = np.arange(length, _TIP, -_STEP)
    tip = _tip_at(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * round(0.86 / _STEP) + 1))
    left, right = _sides_at(back)
    points, normals = (np.vstack([left[k], tip[k], right[k][::-1]]) for k in (0, 1))
    return points, normals


def _sought(lab: FloatArray) -> list[Outline]:
    """Places, turns and widths at which edges look like a fingertip, the best first.

    Votes of edges by their direction: the structure tensor along each of the model's normals, over its trace.
    """
    smooth = np.asarray(cv2.GaussianBlur(lab, (0, 0), 0.8), np.float32)
    down, right = (cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / 8) for order in ((0, 1), (1, 0)))
    pairs = ((right, right), (right, down), (down, down))
    xx, xy, yy = (cv2.GaussianBlur((one * two).sum(-1), (0, 0), 1.0) for one, two in pairs)
    tensor = [part / (xx + yy + 1.0) for part in (xx, xy, yy)]
    skin = _skin(smooth)
    rated = [item for width in _WIDTHS for item in _of_width(width, tensor, skin)]
    kept: list[Outline] = []
    for _, outline in sorted(rated, key=lambda item: -item[0]):
        if len(kept) < _TRIED and not any(_alike(outline, earlier) for earlier in kept):
            kept.append(outline)
    return kept


def _alike(one: Outline, two: Outline) -> bool:
    near = bool(np.linalg.norm(one.middle - two.middle) < 0.35 * max(one.width, two.width))
    return near and bool(one.ahead @ two.ahead > 0.5) and 0.66 < one.width / two.width < 1.5


def _of_width(width: float, tensor: list[FloatArray], skin: FloatArray) -> Iterator[tuple[float, Outline]]:
    """The best places of each turn of a width, rated."""
    shape, side = skin.shape, max(skin.shape)
    px = width * side
    pad, step, blur = int(2 * px) + 2, max(1, int(0.08 * px)), max(0.06 * px, 0.3)
    around = (pad, pad, pad, pad, cv2.BORDER_CONSTANT, None)
    plain = 0.5 * skin - cv2.GaussianBlur(tensor[0] + tensor[2], (0, 0), 2 * blur)
    beyond = [(cv2.GaussianBlur(one, (0, 0), blur), value) for one, value in zip(tensor, (0.2, 0.0, 0.2), strict=True)]
    xx, xy, yy, inside = (cv2.copyMakeBorder(part, *around, value) for part, value in [*beyond, (plain, -0.25)])
    bins = [(np.cos(t), np.sin(t)) for t in np.pi * np.arange(_BINS) / _BINS]
    weights = np.array([(c * c, 2 * c * s, s * s) for c, s in bins], np.float32)
    maps = [*np.tensordot(weights, np.stack([xx, xy, yy]), 1), inside]
    for one, looked, places in _sought_places():
        seen = [
            maps[b][y : y + shape[0] : step, x : x + shape[1] : step]
            for b, (x, y) in zip(looked, (np.rint(places * px).astype(int) + pad).tolist(), strict=True)
        ]
        front, left, right, inner = (sum(seen[k : k + n]) / n for k, n in ((0, 7), (7, 6), (13, 6), (19, 8)))
        value = (front + left + right) / 3 + np.minimum(np.minimum(front, left), right) + inner
        for best in np.argpartition(-value, 2, axis=None)[:3] if value.size > 3 else range(value.size):
            i, j = np.unravel_index(best, value.shape)
            tip = np.array([j * step + 0.5, i * step + 0.5]) / side
            yield float(value[i, j]), replace(one, tip=tip, width=width)


@lru_cache(maxsize=1)
def _sought_places() -> list[tuple[Outline, list[int], Array]]:
    """For each turn: an outline, and where its edges and skin are looked up: of which map, and (27, 2) where."""
    parts = (_tip_at(np.radians([-75.0, -50, -25, 0, 25, 50, 75])), *_sides_at(np.linspace(_TIP + 0.1, 1.6, 6)))
    inner = np.array([[x, y] for y in (0.35, 0.65, 0.95, 1.25) for x in (-0.2, 0.2)])
    points, normals = (np.vstack([part[k] for part in parts]) for k in (0, 1))
    found = []
    for turn in 2 * np.pi * np.arange(_TURNS) / _TURNS:
        one = Outline(np.zeros(2), np.array([np.sin(turn), -np.cos(turn)]), 1.0, np.zeros((0, 2)))
        across = one.places(normals)
        bins = np.rint(np.arctan2(across[:, 1], across[:, 0]) / np.pi * _BINS).astype(int) % _BINS
        found.append((one, [*bins.tolist(), *[_BINS] * len(inner)], one.places(np.vstack([points, inner]))))
    return found


def _skin(lab: FloatArray) -> FloatArray:
    """0 to 1: whether a colour can be skin's; `lab` as of :func:`_colours`."""
    a, b = lab[..., 1] / _WEIGHTS[1], lab[..., 2] / _WEIGHTS[2]
    chroma, hue_deg = np.hypot(a, b), np.degrees(np.arctan2(b, a))
    value = np.exp(-((np.maximum(0.0, np.abs(hue_deg - 42.0) - 38.0) / 20.0) ** 2))
    return np.asarray(value * np.clip(chroma / 8.0, 0.15, 1.0) * np.clip((60.0 - chroma) / 20.0, 0, 1), np.float32)


def _fitted(one: Outline, lab: FloatArray, bins: NDArray[np.intp], length: float, reach: float) -> Outline:
    """The smooth outline that follows edges and parts colours best, within `reach` widths of where it was expected.

    Each place across the outline is rated by its edge, and by how the colours before it resemble those inside, those
    beyond it those around; dynamic programming finds the path.
    """
    side = max(lab.shape[:2])
    px = one.width * side
    points, normals = _model(length)
    base, out = one.tip * side - 0.5 + px * one.places(points), one.places(normals)
    offsets = np.linspace(-reach, reach, _ACROSS) * px
    places = (base[:, None] + offsets[None, :, None] * out[:, None]).astype(np.float32)
    seen = ((places >= -0.5) & (places <= np.array(lab.shape[1::-1]) - 0.5)).all(-1)
    step, x, y = 2 * reach * px / (_ACROSS - 1), places[..., 0], places[..., 1]
    stack = cv2.merge([lab, _resemblance(one, bins, length, reach)])
    values = cv2.remap(stack, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = cv2.GaussianBlur(values, (0, 0), sigmaX=0.01, sigmaY=0.6)
    change = np.linalg.norm(np.gradient(values[..., :3], step, axis=1), axis=-1)
    edge = np.where(seen, change / (change + 1.5), 0.0)
    inside = np.cumsum(np.where(seen, values[..., 3], 0.0), axis=1) * step / px
    gain = edge + (inside - inside.mean(axis=1, keepdims=True)) - 0.3 * (offsets / (reach * px)) ** 2
    came, index, best = np.zeros(gain.shape, np.intp), np.arange(_ACROSS), gain[0]
    ways = np.full((3, _ACROSS), -np.inf)  # from the place before, the same, the one beyond
    for k in range(1, len(gain)):
        ways[0, 1:], ways[1], ways[2, :-1] = best[:-1] - 0.15, best, best[1:] - 0.15
        way = ways.argmax(axis=0)
        came[k], best = index + way - 1, ways[way, index] + gain[k]
    path = np.full(len(gain), best.argmax())
    for k in range(len(gain) - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    row = np.arange(len(gain))
    where, shown = places[row, path].astype(float), seen[row, path]
    near = shown & (points[:, 1] < 2.5)
    follow = float(edge[row, path][near].mean()) if near.any() else 0.0
    return replace(_moved(one, where, points[:, 1], shown, side), points=(where + 0.5) / side, edges=follow)


def _moved(one: Outline, where: Array, back: Array, shown: BoolArray, side: int) -> Outline:
    """With tip, direction and width of its outline's points (N, 2), pixels, which lay `back` widths behind the tip."""
    count = int((back > _TIP + 0.01).sum()) // 2
    both = shown[:count] & shown[::-1][:count] & (back[:count] < 3.0)
    if both.sum() < 5:
        return one
    left, right = where[:count][both], where[::-1][:count][both]
    line = cv2.fitLine((0.5 * (left + right)).astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()[:2]
    ahead = line.astype(float) * (np.sign(line @ one.ahead) or 1.0)
    ahead = ahead if ahead @ one.ahead > 0.9 else one.ahead
    across = np.array([-ahead[1], ahead[0]])
    front = np.sort(where[shown] @ ahead)[-3:].mean()
    tip = np.median(0.5 * (left + right) @ across) * across + front * ahead
    width = max(float(np.median(np.abs((right - left) @ across))), 2.0)
    return replace(one, tip=(tip + 0.5) / side, ahead=ahead, width=width / side)


def _bins(lab: FloatArray) -> NDArray[np.intp]:
    """(H, W) numbers of the colours' bins in a histogram (32^3,)."""
    part = np.minimum((lab - lab.reshape(-1, 3).min(0)) / 5.0, 31).astype(np.intp)
    return np.asarray((part[..., 0] * 32 + part[..., 1]) * 32 + part[..., 2])


def _resemblance(one: Outline, bins: NDArray[np.intp], length: float, reach: float) -> FloatArray:
    """(H, W) log-likelihood ratio of each colour, by its bin: inside over around the outline."""

    def within(wider: float, longer: float) -> BoolArray:
        vectors = _model(length)[0] * np.array([wider, 1.0]) + np.array([0.0, 0.5 * (1 - wider) - longer])
        return _filled((one.tip + one.width * one.places(vectors)) * max(bins.shape), bins.shape)

    inside, around = (
        gaussian_filter((np.bincount(bins[part], minlength=32**3) / max(int(part.sum()), 1)).reshape(32, 32, 32), 1.0)
        for part in (within(1 - reach, 0.0), within(2.4, 0.0) & ~within(1 + reach, 0.2 * reach))
    )
    ratio = np.log((inside + 2e-4) / (around + 2e-4))
    return np.clip(ratio, -2, 2).astype(np.float32).ravel()[bins]


def _likeness(one: Outline, lab: FloatArray) -> float:
    """How much an outline and the colours in it are like a finger's, 0 to 1."""
    side, inside = max(lab.shape[:2]), _filled(one.corners(lab.shape, 1.4, 0.85), lab.shape)
    if inside.sum() < 30:
        return 0.0
    tip = _tip_at(np.linspace(-1.3, 1.3, 15))[0]
    vectors = np.stack([tip * 0.85 + np.array([0.0, 0.09]), tip * 1.25 - np.array([0.0, 0.15])])
    x, y = ((one.tip + one.width * one.places(vectors.reshape(-1, 2))) * side).astype(np.float32).T
    seen = cv2.remap(lab, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    within, ahead = seen.reshape(2, len(tip), 3)
    contrast = float(np.clip(np.linalg.norm(within - ahead, axis=1) / 12.0, 0, 1).mean())
    spread = float(np.linalg.norm(lab[inside].std(axis=0)[1:]))
    value = np.clip((one.edges - 0.4) / 0.45, 0, 1) * contrast**2 * np.exp(-((spread / 8.0) ** 2))
    return float(value * _skin(lab[inside]).mean())


def _by_ridges(pixels: Pixels, one: Outline) -> float:
    """Part of an outline's likeness that its ridges leave: how much of the fine detail is one wave as far apart as
    ridges, running on from window to window, in the better half of the windows; 0 where they vary more than skin does.
    """
    size = max(pixels.shape[:2])
    scale = min(1.0, _WIDTH_PX / (one.width * size))
    coarsest, finest = (count / (scale * one.width * size) for count in _RIDGES)
    near = one.points[(one.tip - one.points) @ one.ahead < 1.4 * one.width] * size
    low, high = np.maximum(near.min(axis=0).astype(int), 0), near.max(axis=0).astype(int) + 1
    green = pixels[low[1] : high[1], low[0] : high[0], 1].astype(np.float32)
    light = cv2.resize(green, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    light = np.log(light + 8 * np.iinfo(pixels.dtype).max / 255)
    inside = _filled((near - low) * scale, light.shape).astype(np.float32)
    whole = cv2.boxFilter(inside, -1, (_BLOCK, _BLOCK), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT) > 0.9
    places = np.argwhere(whole[: max(len(light) - _BLOCK, 0) : 24, : max(light.shape[1] - _BLOCK, 0) : 24]) * 24
    if not len(places):
        return _NO_RIDGES
    places = places[np.linspace(0, len(places) - 1, min(len(places), _BLOCKS)).astype(np.intp)]
    blocks = np.stack([light[i : i + _BLOCK, j : j + _BLOCK] for i, j in places])
    blocks -= blocks.mean(axis=(1, 2), keepdims=True)
    ramp = np.arange(_BLOCK, dtype=np.float32) - (_BLOCK - 1) / 2
    for slope in (ramp[:, None], ramp):  # shading is not detail
        blocks -= (blocks * slope).sum(axis=(1, 2), keepdims=True) / (_BLOCK * (ramp**2).sum()) * slope
    if np.median(blocks.std(axis=(1, 2))) > _MOST:
        return 0.0
    power = np.abs(np.fft.rfft2(blocks * np.hanning(_BLOCK)[:, None] * np.hanning(_BLOCK))) ** 2
    along, across = np.fft.fftfreq(_BLOCK)[:, None], np.fft.rfftfreq(_BLOCK)[None, :]
    frequency = np.hypot(along, across)
    ridges = power * ((frequency > coarsest) & (frequency < finest))
    i, j = np.unravel_index(ridges.reshape(len(blocks), -1).argmax(axis=1), frequency.shape)
    wave = np.hypot(along - along[i][:, :, None], across - across[0, j][:, None, None]) < 2.2 / _BLOCK
    detail = (power * (frequency > 0.5 * coarsest)).sum(axis=(1, 2))
    part = (ridges * wave).sum(axis=(1, 2)) / np.maximum(detail, 1e-12)
    turn = np.exp(2j * np.arctan2(along[i, 0], across[0, j]))
    period = np.log(np.maximum(frequency[i, j], 0.5 * coarsest))
    agree = np.clip((turn[:, None] * turn.conj()).real, 0, 1) * np.exp(-(((period[:, None] - period) / 0.25) ** 2))
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    beside = part * ((apart > 0) & (apart < 1.5 * 24))
    part *= (agree * beside).sum(axis=1) / np.maximum(beside.sum(axis=1), 1e-9)
    return float(np.clip(np.mean(np.sort(part)[len(part) // 2 :]) / 0.3, _NO_RIDGES, 1))
