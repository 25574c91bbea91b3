"""The finger in a photograph, before any background: an outline that has the shape of a fingertip,
and what is in it.

A tip between two parallel sides is sought among the edges, at every place, turn and width. The best
of them are fitted to edges and colours, and rated by shape, colour and ridges. Nothing is assumed
of the background.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from splitknit.errors import require
from splitknit.finger.regions import reduce_image
from splitknit.imaging.areas import filled
from splitknit.model import Array, BoolArray, FloatArray, PixelArray

_CAP = 0.6
"""Length of the tip's half ellipse, in widths of the finger. Chosen on: simulated fingers (100
drawn photographs over natural pictures, 16 pictures without a finger)."""
_MAX_LENGTH = 5.0
"""Greatest length of the outline, in widths of the finger. Chosen on: simulated fingers (100 drawn
photographs over natural pictures, 16 pictures without a finger)."""


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

    @property
    def right(self) -> Array:
        """(2,) unit vector."""
        return np.array([-self.ahead[1], self.ahead[0]])

    def turned(self, vectors: Array) -> Array:
        """Vectors (N, 2) of the model, x to the right and y back from the tip, as the picture has
        them."""
        return vectors[:, :1] * self.right - vectors[:, 1:] * self.ahead

    def places(self, vectors: Array) -> Array:
        """(N, 2) places in the picture of the model's vectors (N, 2), widths."""
        return self.tip + self.width * self.turned(vectors)

    def in_view(self, back: float, offset: float, shape: tuple[int, ...]) -> BoolArray:
        """(2,) whether the picture shows the places `offset` widths left and right, and `back`
        behind the tip."""
        places = self.places(np.array([[-offset, back], [offset, back]])) * max(shape)
        return np.asarray(((places >= 0) & (places <= np.array(shape[1::-1]))).all(axis=1))

    def corners(self, side: int, length: float = _MAX_LENGTH + 1, scale: float = 1.0) -> Array:
        """(N, 2) pixels, of a picture with this longer side, around the part from the tip to
        `length` widths behind."""
        kept = self.points[(self.tip - self.points) @ self.ahead < length * self.width]
        centre = self.tip - _CAP * self.width * self.ahead
        return (centre + (kept - centre) * scale) * side - 0.5


@dataclass(frozen=True, slots=True, eq=False)
class PhotographedFinger:
    """The finger that was chosen."""

    mask: BoolArray
    """(H, W)."""
    direction_deg: float
    """Of its tip: 0 = up, counter-clockwise."""
    width_px: float
    others: int
    """Further fingers in the picture."""


_SEARCH_PX = 96
"""Longer side of the picture in which fingers are sought. Chosen on: speed."""
_FIT_PX = 256
"""Longer side of the picture in which fingers are fitted. Chosen on: speed."""
_RATED_LENGTH = 2.2
"""Length of the outline that is rated, in widths of the finger. Chosen on: simulated fingers (100
drawn photographs over natural pictures, 16 pictures without a finger)."""
_BESIDE = 0.8
"""How far one of both sides must be seen from the middle of the finger, or ridges may be taken for
the outline, in widths of the finger. Chosen on: simulated fingers (100 drawn photographs over
natural pictures, 16 pictures without a finger)."""
_BLOCK = 48
"""Side of the windows in which ridges are sought, in px. Chosen on: simulated fingers (100 drawn
photographs over natural pictures, 16 pictures without a finger)."""
_CLEAR_RIDGES = 0.3
"""From this likeness by ridges on, the contrast of a tip is judged by its ground's variation.
Chosen on: drawn photographs on pale grounds (tests/prints/test_fingerphoto.py); smooth strips have
0.2."""
_SEARCHED_LIKENESS = 0.01
"""Least likeness by shape and colour of what is searched for ridges. Chosen on: speed."""
_MIN_LIKENESS = 0.17
"""Least likeness of a finger: drawn fingers have 0.18 to 1, pictures without one less than 0.16.
Chosen on: simulated fingers (drawn photographs, validation/match/telephone.py). Range: 0.16 to
0.18."""
_MIN_IN_BOX = 0.01
"""Least likeness where somebody states that there is a finger. Chosen on: simulated fingers (100
drawn photographs over natural pictures, 16 pictures without a finger)."""


def finger_in_photo(
    pixels: PixelArray, box: tuple[int, int, int, int] | None = None
) -> PhotographedFinger:
    """Find the clearest finger of a photograph (H, W, 3) of 8 or 16 bits; raises BadInput where
    there is none.

    `box`: left, top, width and height in pixels of the part in which it lies.
    """
    rows, columns = pixels.shape[:2]
    left, top, width, height = box or (0, 0, columns, rows)
    require(
        min(width, height) >= _BLOCK and left + width <= columns and top + height <= rows,
        f"`box` must lie in the picture of {columns} x {rows} pixels, {_BLOCK} or more wide and "
        f"high, but it is {left},{top},{width},{height}.",
    )
    # what lies beside it shows where it ends
    margin = 0 if box is None else max(width, height) // 8
    first_column = max(left - margin, 0)
    first_row = max(top - margin, 0)
    part = pixels[first_row : top + height + margin, first_column : left + width + margin]
    shape = part.shape[:2]
    side = max(shape)
    low = np.array([left - first_column, top - first_row])
    high = low + np.array([width, height])

    fine = _lab(part)
    lab = reduce_image(fine, _FIT_PX / max(fine.shape))
    rated = []
    for candidate in _candidates(reduce_image(fine, _SEARCH_PX / max(fine.shape))):
        outline = _fitted(candidate, lab, _RATED_LENGTH, 0.3)
        outline = _fitted(outline, lab, _RATED_LENGTH, 0.2)
        likeness, on_plain_ground = _likeness(outline, lab)
        middle = outline.middle * side
        if on_plain_ground > _SEARCHED_LIKENESS and ((middle >= low) & (middle <= high)).all():
            ridges = _ridge_likeness(part, outline)
            # where ridges are seen, a pale ground may have nearly the colour of skin
            likeness = on_plain_ground if ridges > _CLEAR_RIDGES else likeness
            rated.append((likeness * ridges, outline))
    rated.sort(key=itemgetter(0), reverse=True)
    require(
        rated and rated[0][0] >= (_MIN_LIKENESS if box is None else _MIN_IN_BOX),
        "no finger was found in this picture in colour: no part of it, its tip in view, has the "
        "shape, the colour and the ridges of one; photograph one finger from near, pad to the "
        "camera, in focus, or save a print in grey.",
    )
    best_likeness, best = rated[0]
    require(
        box is not None or best.in_view(0.4, _BESIDE, shape).any(),
        "the finger fills the picture from side to side; photograph it from farther, sides and its"
        " tip in view.",
    )
    fingers = [best]
    for likeness, outline in rated[1:]:
        apart = all(
            np.linalg.norm(outline.middle - each.middle) > 0.8 * best.width for each in fingers
        )
        beside = abs((outline.middle - best.middle) @ best.right) > 0.6 * best.width
        if (
            likeness > 0.5 * best_likeness
            and apart
            and beside
            and 0.5 < outline.width / best.width < 1.6
        ):
            fingers.append(outline)

    best = _fitted(best, fine, _MAX_LENGTH, 0.2)
    if best.in_view(1.1, 0.5, shape).all():
        for reach in (0.15, 0.08):
            best = _fitted(best, fine, _MAX_LENGTH, reach)
    mask = np.zeros((rows, columns), np.bool_)
    # pixels that its sides cross make a finger a pixel wider
    inside = filled(best.corners(side, scale=1 - 1 / (best.width * side)), shape)
    mask[first_row : first_row + shape[0], first_column : first_column + shape[1]] = inside
    direction_deg = float(np.degrees(np.arctan2(-best.ahead[0], -best.ahead[1])))
    return PhotographedFinger(mask, direction_deg, best.width * side, len(fingers) - 1)


_FINE_PX = 512
"""Longer side of the picture in which the outline is found. Chosen on: speed."""
_LAB_WEIGHTS = np.array([0.6, 1.5, 1.5], np.float32)
"""Weights of L*, a* and b*: a finger's flanks and shadows differ in lightness alone. Chosen on:
simulated fingers (100 drawn photographs over natural pictures, 16 pictures without a finger)."""


def _lab(pixels: NDArray[Any]) -> FloatArray:
    """The picture in weighted CIELAB, (H, W, 3), reduced."""
    coded = reduce_image(pixels, _FINE_PX / max(pixels.shape)) / np.iinfo(pixels.dtype).max
    return cv2.cvtColor(coded.astype(np.float32), cv2.COLOR_RGB2Lab) * _LAB_WEIGHTS


def _tip_model(turn: Array) -> tuple[Array, Array]:
    """(N, 2) points of the model's tip and their normals."""
    points = np.column_stack([0.5 * np.sin(turn), _CAP * (1 - np.cos(turn))])
    normals = np.column_stack([np.sin(turn) / 0.5, -np.cos(turn) / _CAP])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _side_model(x: float, back: Array) -> tuple[Array, Array]:
    """(N, 2) points of the model's side at `x` and their normals."""
    return np.column_stack([np.full(len(back), x), back]), np.tile([2 * x, 0.0], (len(back), 1))


_OUTLINE_STEP = 0.05
"""Step along an outline, in widths of the finger. Chosen on: simulated fingers (100 drawn
photographs over natural pictures, 16 pictures without a finger)."""


def _model(length: float) -> tuple[Array, Array]:
    """(N, 2) points of a finger's outline, from the left base around the tip, and normals."""
    back = np.arange(length, _CAP, -_OUTLINE_STEP)
    tip = _tip_model(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * round(0.86 / _OUTLINE_STEP) + 1))
    parts = _side_model(-0.5, back), tip, _side_model(0.5, back[::-1])
    points, normals = map(np.vstack, zip(*parts, strict=True))
    return points, normals


_WIDTHS = tuple(0.11 * 1.18**k for k in range(11))
"""Widths of fingers that are tried, in longer sides of the picture. Chosen on: simulated fingers
(100 drawn photographs over natural pictures, 16 pictures without a finger)."""
_CANDIDATES = 7
"""Places that are fitted. Chosen on: speed."""


def _candidates(lab: FloatArray) -> list[Outline]:
    """Places, turns and widths at which edges look like a fingertip, the best first.

    Votes of edges by their direction: the structure tensor along each of the model's normals, over
    its trace.
    """
    smooth = cv2.GaussianBlur(lab, (0, 0), 0.8)
    right = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    products = [(right * right).sum(-1), (right * down).sum(-1), (down * down).sum(-1)]
    tensor = cv2.GaussianBlur(np.stack(products, axis=-1), (0, 0), 1.0)
    tensor = tensor / (tensor[..., [0]] + tensor[..., [2]] + 1.0)
    skin = _skin_likeness(smooth.astype(np.float32))
    votes = [vote for width in _WIDTHS for vote in _votes(width, tensor.astype(np.float32), skin)]
    kept: list[Outline] = []
    for _, outline in sorted(votes, key=itemgetter(0), reverse=True):
        if len(kept) < _CANDIDATES and not any(
            np.linalg.norm(outline.middle - better.middle) < 0.35 * max(outline.width, better.width)
            and outline.ahead @ better.ahead > 0.5
            and 0.66 < outline.width / better.width < 1.5
            for better in kept
        ):
            kept.append(outline)
    return kept


_TIP_TURNS = 32
"""Directions of the tip that are tried. Chosen on: simulated fingers (100 drawn photographs over
natural pictures, 16 pictures without a finger)."""
_EDGE_TURNS = 16
"""Directions of edges that are told apart. Chosen on: simulated fingers (100 drawn photographs over
natural pictures, 16 pictures without a finger)."""


def _votes(width: float, tensor: FloatArray, skin: FloatArray) -> Iterator[tuple[float, Outline]]:
    """The best places of each turn of a width, with their votes."""
    rows, columns = skin.shape
    side = max(skin.shape)
    px = width * side
    pad = int(2 * px) + 2
    step = max(1, int(0.08 * px))
    sigma = max(0.06 * px, 0.3)
    border = pad, pad, pad, pad, cv2.BORDER_CONSTANT, None
    smooth = cv2.copyMakeBorder(
        cv2.GaussianBlur(tensor, (0, 0), sigma), *border, (0.2, 0.0, 0.2, 0.0)
    )
    plain = 0.5 * skin - cv2.GaussianBlur(tensor[..., 0] + tensor[..., 2], (0, 0), 2 * sigma)
    angle = np.pi * np.arange(_EDGE_TURNS) / _EDGE_TURNS
    weights = np.stack(
        [np.cos(angle) ** 2, 2 * np.cos(angle) * np.sin(angle), np.sin(angle) ** 2], axis=1
    )
    edges = np.tensordot(weights.astype(np.float32), smooth, (1, 2))
    maps = [*edges, cv2.copyMakeBorder(plain, *border, -0.25)]

    # seven places about the tip, six on each side, eight on the skin
    tip = _tip_model(np.radians([-75.0, -50, -25, 0, 25, 50, 75]))
    back = np.linspace(_CAP + 0.1, 1.6, 6)
    points, normals = map(
        np.vstack, zip(tip, _side_model(-0.5, back), _side_model(0.5, back), strict=True)
    )
    inner = np.array([[x, y] for y in (0.35, 0.65, 0.95, 1.25) for x in (-0.2, 0.2)])
    for turn in 2 * np.pi * np.arange(_TIP_TURNS) / _TIP_TURNS:
        outline = Outline(
            np.zeros(2), np.array([np.sin(turn), -np.cos(turn)]), width, np.zeros((0, 2))
        )
        across = outline.turned(normals)
        numbers = (
            np.rint(np.arctan2(across[:, 1], across[:, 0]) / np.pi * _EDGE_TURNS).astype(int)
            % _EDGE_TURNS
        )
        places = np.rint(outline.turned(np.vstack([points, inner])) * px).astype(int) + pad
        values = [
            maps[number][y : y + rows : step, x : x + columns : step]
            for number, (x, y) in zip([*numbers, *[_EDGE_TURNS] * len(inner)], places, strict=True)
        ]
        parts = [
            np.mean(values[:7], axis=0),
            np.mean(values[7:13], axis=0),
            np.mean(values[13:19], axis=0),
        ]
        votes = np.mean(parts, axis=0) + np.min(parts, axis=0) + np.mean(values[19:], axis=0)
        for best in np.argpartition(-votes, min(2, votes.size - 1), axis=None)[:3]:
            row, column = np.unravel_index(best, votes.shape)
            centre = np.array([column * step + 0.5, row * step + 0.5]) / side
            yield float(votes[row, column]), replace(outline, tip=centre)


def _skin_likeness(lab: FloatArray) -> FloatArray:
    """0 to 1: whether a colour can be skin's; `lab` as of :func:`_lab`."""
    a = lab[..., 1] / _LAB_WEIGHTS[1]
    b = lab[..., 2] / _LAB_WEIGHTS[2]
    chroma = np.hypot(a, b)
    off_hue = np.maximum(0.0, np.abs(np.degrees(np.arctan2(b, a)) - 42.0) - 38.0)
    likeness = np.exp(-((off_hue / 20.0) ** 2)) * np.clip(chroma / 8.0, 0.15, 1.0)
    return np.asarray(likeness * np.clip((60.0 - chroma) / 20.0, 0, 1), np.float32)


def fraction_of_skin(pixels: PixelArray) -> float:
    """Fraction of a photograph (H, W, 3) of 8 or 16 bits that has the colour of skin."""
    return float((_skin_likeness(_lab(pixels)) > 0.5).mean())


_ACROSS = 41
"""Places across an outline that are tried. Chosen on: simulated fingers (100 drawn photographs over
natural pictures, 16 pictures without a finger)."""


def _fitted(outline: Outline, lab: FloatArray, length: float, reach: float) -> Outline:
    """The smooth outline that follows edges and parts colours best, within `reach` widths of where
    it was expected.

    Each place across the outline is rated by its edge, and by how the colours before it resemble
    those inside, those beyond it those around; dynamic programming finds the path.
    """
    side = max(lab.shape)
    px = outline.width * side
    points, normals = _model(length)
    base = outline.tip * side - 0.5 + px * outline.turned(points)
    offsets = np.linspace(-reach, reach, _ACROSS) * px
    places = base[:, None] + offsets[None, :, None] * outline.turned(normals)[:, None]
    places = places.astype(np.float32)
    visible = ((places >= -0.5) & (places <= np.array(lab.shape[1::-1]) - 0.5)).all(-1)
    step = 2 * reach * px / (_ACROSS - 1)
    layers = cv2.merge([lab, _resemblance(outline, lab, length, reach)])
    x, y = cv2.split(places)
    values = cv2.remap(layers, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = cv2.GaussianBlur(values, (0, 0), sigmaX=0.01, sigmaY=0.6)
    change = np.linalg.norm(np.gradient(values[..., :3], step, axis=1), axis=-1)
    edge = np.where(visible, change / (change + 1.5), 0.0)
    inside = np.cumsum(np.where(visible, values[..., 3], 0.0), axis=1) * step / px
    gain = (
        edge + (inside - inside.mean(axis=1, keepdims=True)) - 0.3 * (offsets / (reach * px)) ** 2
    )
    came = np.zeros(gain.shape, np.intp)
    index = np.arange(_ACROSS)
    best = gain[0]
    ways = np.full((3, _ACROSS), -np.inf)  # from the place before, the same, the one beyond
    for k in range(1, len(gain)):
        ways[0, 1:] = best[:-1] - 0.15
        ways[1] = best
        ways[2, :-1] = best[1:] - 0.15
        way = ways.argmax(axis=0)
        came[k] = index + way - 1
        best = ways[way, index] + gain[k]
    path = np.full(len(gain), best.argmax())
    for k in range(len(gain) - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    along = np.arange(len(gain)), path
    where = places[along].astype(float)
    visible = visible[along]
    near = visible & (points[:, 1] < 2.5)
    edges = float(edge[along][near].mean()) if near.any() else 0.0
    return replace(
        _moved(outline, where, points[:, 1], visible, side),
        points=(where + 0.5) / side,
        edges=edges,
    )


def _moved(outline: Outline, where: Array, back: Array, visible: BoolArray, side: int) -> Outline:
    """With tip, direction and width of its points `where` (N, 2), pixels, which lay `back` widths
    behind the tip."""
    count = int((back > _CAP + 0.01).sum()) // 2
    both = visible[:count] & visible[::-1][:count] & (back[:count] < 3.0)
    if both.sum() < 5:
        return outline
    left = where[:count][both]
    right = where[::-1][:count][both]
    middle = 0.5 * (left + right)
    line = cv2.fitLine(middle.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()[:2]
    ahead = line.astype(float) * (np.sign(line @ outline.ahead) or 1.0)
    moved = replace(outline, ahead=ahead if ahead @ outline.ahead > 0.9 else outline.ahead)
    front = np.sort(where[visible] @ moved.ahead)[-3:].mean()
    tip = np.median(middle @ moved.right) * moved.right + front * moved.ahead
    width = max(float(np.median(np.abs((right - left) @ moved.right))), 2.0)
    return replace(moved, tip=(tip + 0.5) / side, width=width / side)


def _resemblance(outline: Outline, lab: FloatArray, length: float, reach: float) -> FloatArray:
    """(H, W) log-likelihood ratio of each colour: inside over around the outline."""
    low = lab.reshape(-1, 3).min(0)
    ranges = np.stack([low, low + 160.0], axis=1).ravel().tolist()  # bins of 5
    picture = [lab], [0, 1, 2]

    def within(wider: float, longer: float = 0.0) -> BoolArray:
        vectors = _model(length)[0] * np.array([wider, 1.0]) + np.array(
            [0.0, 0.5 * (1 - wider) - longer]
        )
        return filled(outline.places(vectors) * max(lab.shape), lab.shape[:2])

    def density(region: BoolArray) -> FloatArray:
        counts = cv2.calcHist(*picture, region.view(np.uint8), [32] * 3, ranges)
        return gaussian_filter(counts / max(int(region.sum()), 1), 1.0)

    inside = density(within(1 - reach))
    around = density(within(2.4) & ~within(1 + reach, 0.2 * reach))
    ratio = np.clip(np.log((inside + 2e-4) / (around + 2e-4)), -2, 2)
    return np.asarray(cv2.calcBackProject(*picture, ratio, ranges, 1))


_FULL_CONTRAST = 12.0
"""Contrast of a tip to any ground from which on more does not count, in weighted CIELAB. Chosen on:
simulated fingers (100 drawn photographs over natural pictures, 16 pictures without a finger)."""
_PLAIN_CONTRAST = 5.0
"""The same to a ground without any texture, in weighted CIELAB. Chosen on: drawn photographs on
pale grounds (tests/prints/test_fingerphoto.py). Range: 4 to 6 found the same fingers."""


def _likeness(outline: Outline, lab: FloatArray) -> tuple[float, float]:
    """How much an outline and the colours in it are like a finger's, 0 to 1: by the contrast of its
    tip, and by that contrast relative to how much the ground beyond varies."""
    side = max(lab.shape)
    inside = filled(outline.corners(side, 1.4, 0.85), lab.shape[:2])
    if inside.sum() < 30:
        return 0.0, 0.0
    tip, _ = _tip_model(np.linspace(-1.3, 1.3, 15))
    vectors = np.vstack([tip * 0.85 + np.array([0.0, 0.09]), tip * 1.25 - np.array([0.0, 0.15])])
    x, y = (outline.places(vectors) * side).astype(np.float32).T
    values = cv2.remap(lab, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    within, beyond = values.reshape(2, len(tip), 3)
    steps = np.linalg.norm(within - beyond, axis=1)
    varied = 2 * float(np.linalg.norm(beyond.std(axis=0)))
    full = _FULL_CONTRAST, min(max(varied, _PLAIN_CONTRAST), _FULL_CONTRAST)
    contrast, relative = (float(np.clip(steps / each, 0, 1).mean()) for each in full)
    spread = float(np.linalg.norm(lab[inside].std(axis=0)[1:]))
    shape = np.clip((outline.edges - 0.4) / 0.45, 0, 1) * np.exp(-((spread / 8.0) ** 2))
    likeness = float(shape * _skin_likeness(lab[inside]).mean())
    return likeness * contrast**2, likeness * relative**2


_BLOCK_STEP = 24
"""Step from one of these windows to the next, in px. Chosen on: simulated fingers (100 drawn
photographs over natural pictures, 16 pictures without a finger)."""
_MAX_BLOCKS = 40
"""Windows that are looked at, at most. Chosen on: speed."""
_SEARCHED_WIDTH_PX = 400
"""Largest width of the finger in the picture that is searched for ridges. Chosen on: speed."""
_RIDGE_COUNTS = (23.5, 61.0)
"""Fewest and most ridges to a finger's width; some 38 are usual, in ridges. Chosen on: simulated
fingers (100 drawn photographs over natural pictures, 16 pictures without a finger)."""
_MAX_CONTRAST = 0.6
"""Greatest standard deviation of the logarithm of light in windows of skin. Chosen on: simulated
fingers (drawn photographs have up to 0.2)."""
_NO_RIDGES = 0.2
"""What is left of the likeness of an outline without ridges. Chosen on: simulated fingers (100
drawn photographs over natural pictures, 16 pictures without a finger)."""


def _ridge_likeness(pixels: PixelArray, outline: Outline) -> float:
    """Part of an outline's likeness that its ridges leave: how much of the fine detail is one wave
    as far apart as ridges, running on from window to window, in the better half of the windows; 0
    where they vary more than skin does.
    """
    side = max(pixels.shape)
    scale = min(1.0, _SEARCHED_WIDTH_PX / (outline.width * side))
    coarsest, finest = (count / (scale * outline.width * side) for count in _RIDGE_COUNTS)
    near = (
        outline.points[(outline.tip - outline.points) @ outline.ahead < 1.4 * outline.width] * side
    )
    low = np.maximum(near.min(axis=0).astype(int), 0)
    high = near.max(axis=0).astype(int) + 1
    green = pixels[low[1] : high[1], low[0] : high[0], 1].astype(np.float32)
    light = reduce_image(green, scale)
    light = np.log(light + 8 * np.iinfo(pixels.dtype).max / 255)
    inside = filled((near - low) * scale, light.shape).astype(np.float32)
    whole = (
        cv2.boxFilter(inside, -1, (_BLOCK, _BLOCK), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
        > 0.9
    )
    rows, columns = (max(size - _BLOCK, 0) for size in light.shape)
    places = np.argwhere(whole[:rows:_BLOCK_STEP, :columns:_BLOCK_STEP]) * _BLOCK_STEP
    if not len(places):
        return _NO_RIDGES
    places = places[np.linspace(0, len(places) - 1, min(len(places), _MAX_BLOCKS)).astype(np.intp)]
    blocks = np.stack(
        [light[row : row + _BLOCK, column : column + _BLOCK] for row, column in places]
    )
    blocks -= blocks.mean(axis=(1, 2), keepdims=True)
    ramp = np.arange(_BLOCK, dtype=np.float32) - (_BLOCK - 1) / 2
    for slope in (ramp[:, None], ramp):  # shading is not detail
        blocks -= (
            (blocks * slope).sum(axis=(1, 2), keepdims=True) / (_BLOCK * (ramp**2).sum()) * slope
        )
    if np.median(blocks.std(axis=(1, 2))) > _MAX_CONTRAST:
        return 0.0
    power = np.abs(np.fft.rfft2(blocks * np.hanning(_BLOCK)[:, None] * np.hanning(_BLOCK))) ** 2
    down = np.fft.fftfreq(_BLOCK)[:, None]
    right = np.fft.rfftfreq(_BLOCK)[None]
    frequency = np.hypot(down, right)
    ridges = power * ((frequency > coarsest) & (frequency < finest))
    row, column = np.unravel_index(ridges.reshape(len(blocks), -1).argmax(axis=1), frequency.shape)
    peak_down = down[row, 0]
    peak_right = right[0, column]
    wave = (
        np.hypot(down - peak_down[:, None, None], right - peak_right[:, None, None]) < 2.2 / _BLOCK
    )
    detail = (power * (frequency > 0.5 * coarsest)).sum(axis=(1, 2))
    part = (ridges * wave).sum(axis=(1, 2)) / np.maximum(detail, 1e-12)
    turn = np.exp(2j * np.arctan2(peak_down, peak_right))
    period = np.log(np.maximum(frequency[row, column], 0.5 * coarsest))
    agreement = np.clip((turn[:, None] * turn.conj()).real, 0, 1)
    agreement *= np.exp(-(((period[:, None] - period) / 0.25) ** 2))
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    beside = part * ((apart > 0) & (apart < 1.5 * _BLOCK_STEP))
    part *= (agreement * beside).sum(axis=1) / np.maximum(beside.sum(axis=1), 1e-9)
    return float(np.clip(np.mean(np.sort(part)[len(part) // 2 :]) / 0.3, _NO_RIDGES, 1))
