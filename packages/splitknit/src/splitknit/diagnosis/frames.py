"""Whether photographs and lights go together: the light left unexplained, the lights' order, and their frame.

A matt surface under L distant lights gives photographs of rank three: what least squares leaves of them is small if
each photograph is given its own light. Where lights lie evenly on a ring, a cyclic shift or a reversal of their order
explains the photographs as well, by a surface whose normals are turned or mirrored about the camera's axis; so does a
list of directions in another frame. The true surface is integrable and convex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_lights, check_mask, check_stack, require
from splitknit.findings import Finding, Severity
from splitknit.imaging.geometry import bounding_box, gaussian_mean
from splitknit.model import Array, BoolArray, FloatArray, Led, Rig
from splitknit.photometric.lambertian import lambertian

FRAMES: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "right-up": ((1, 0), (0, 1)),
    "right-down": ((1, 0), (0, -1)),
    "left-up": ((-1, 0), (0, 1)),
    "left-down": ((-1, 0), (0, -1)),
    "up-left": ((0, -1), (1, 0)),
    "down-right": ((0, 1), (-1, 0)),
    "up-right": ((0, 1), (1, 0)),
    "down-left": ((0, -1), (-1, 0)),
}
"""Where x and y point in the image, and the matrix that turns such a vector's x and y to x right, y up."""
_BLUR = 0.02
"""Blur (sigma) of the slopes, as a fraction of the mask's longer side: shape is judged, not noise and texture."""
_FINE_BLUR = 0.006
"""The same of a relief: text of a coin, hairs of a carving."""
_CURL, _LESS_CURL, _FALLS_OFF = 0.15, 0.25, 0.1
"""Part of the slopes' change that is curl from which lights are doubted: up to 0.03 on sound objects, 0.3 to 0.6 in a
mirrored or turned frame; what another frame may leave of it; and how clearly it must fall off outwards to be a hill."""
_STEEPEST = 1.5
"""Normals beyond this slope, often in shadow, are shortened to it and left out of the curl."""
_WORSE = 2.0
"""Another frame must be more integrable by this factor to be named; where only there the surface is wholly convex, it
need not be less integrable."""
_CONVEX, _WHOLLY_CONVEX = 0.4, 0.8
"""Net divergence over its absolute sum from which a surface counts as one convex object: 0.6 to 1 on objects and
fingers, 0.07 on a field of balls."""
_ONE_THING = 0.4
"""Part of the slopes that a blur over an eighth of the object leaves, below which it is not one convex thing: 0.6 to
0.9 on objects and fingers, 0.07 to 0.23 on a field of balls."""
HIGH_RESIDUAL = 0.2
"""Light left unexplained, as a fraction, from which photographs do not fit their lights: 0.01 to 0.15 on objects and
fingers under their own lights (docs/experiments/objects.md)."""
_NO_RESIDUAL = 0.03
"""Up to here no other order is looked for."""
_FEWEST = 5
"""Lights from which the residual determines an order; with five another order must be better still."""
_BETTER, _BETTER_OF_FIVE = (0.8, 0.6), (0.4, 0.4)
"""The residual in another order over the given one, from which the order is named: with the photographs' brightness
free, and of the photographs that change their light. Real objects with brightness wrong by 20 % or directions by 2 deg
stay above."""
_LESS = 0.9
"""An order that leaves less than this part of the residual is not merely a turn of the lights."""
_STRANGE = 0.7
"""A photograph does not belong to the others where without it less than this part of the residual is left that would be
for one light less: at least 0.99 of it on simulated, path-traced and polarised fingers, 0.2 to 0.65 where a photograph
is noise, turned, a copy of another or of another finger."""
_FEWEST_OF_STRANGE = 6
_UNEQUAL = 0.5
"""Brightness is at fault where less than this part of the residual is left once every photograph has its own: 0.96 and
more under lights of known brightness, 0.25 where that is 10 to 20 % off."""
_TURNS_DEG = 0.5
"""A strange photograph of an object is named where it turns the surface by more."""
TURNED = "left-down"
HOLLOW = (
    "the object comes out hollow; if it is a hill, its lights were measured with x pointing left and y down in the "
    "image: then give `light_frame` left-down, or leave out the one that was given."
)
"""Photographs of a hollow are those of a hill whose lights are turned by 180 deg: both are possible of an object."""
_ONE_LIGHT = 0.03
"""Photographs of a finger that differ by less than this are under one light: 0.13 and more under their own."""
SPOILT_DEG, SPOILT_RESIDUAL = 3.0, 0.3
"""From this turn of the normals on, or so much unexplained light, a surface is not worth having: on a simulated finger
photographs that turn them by 3 to 11 deg cost up to 0.7 mm (``validation/damaged``)."""
_NO_SURFACE = (
    "{:.0f} % of the change of the slopes belongs to no surface (up to 3 % is usual), and no other order or frame of "
    "the lights mends that: heights are wrong; check their directions, photograph by photograph."
)
_SEEDS = 300
_LARGEST_SEARCH = 48
"""With more lights the search starts from the given order and its shifts alone."""
_PIXELS = 20_000


def _frame_of(turn: Array | None) -> str:
    """The frame of :data:`FRAMES` in which the lights must have been measured, by :func:`_fit_turn` of the normals.

    Only the right one, and that turned by 180 deg, give slopes without curl (R. T. Frankot and R. Chellappa, IEEE
    Trans. PAMI 10, 1988); of the two, the right one is convex (P. N. Belhumeur, D. J. Kriegman and A. L. Yuille, "The
    bas-relief ambiguity", IJCV 35, 1999). ``right-up`` where nothing speaks against it.
    """
    if turn is None:
        return "right-up"
    likeness = {name: float(np.sum(turn * np.array(matrix))) for name, matrix in FRAMES.items()}  # 2 cos(difference)
    best = max(likeness, key=lambda name: likeness[name])
    return best if likeness[best] > _SAME_TURN else "right-up"


@dataclass(frozen=True, slots=True)
class LightFit:
    """How well photographs fit the lights that they are given, and which order or frame fits better."""

    residual: float
    """Root of the fraction of the photographs' squared light that least squares leaves, 0 to 1."""
    residual_per_image: tuple[float, ...]
    """The same of every photograph."""
    order: tuple[int, ...]
    """The light, from 0, that every photograph seems to be under; its own where nothing speaks against it."""
    residual_in_order: float
    """What would be left in that order."""
    frame: str
    """Name in :data:`FRAMES`; ``right-up`` while the residual is high or an order is clearly better."""
    strange: int | None = None
    """The photograph that does not belong to the others."""
    brightness: tuple[float, ...] = ()
    """Of every light over what is stated of it, mean 1, where that explains the photographs far better."""
    turned_deg: float = 0.0
    """Median angle by which another order, brightness, or the strange photograph turns the normals."""
    variety: float = 1.0
    """How much the photographs differ, but for their brightness: 0 to 1."""
    curl: float = 0.0
    """Part of the slopes' change that belongs to no surface, of a relief: 0 to 1."""

    @property
    def in_order(self) -> bool:
        """Whether every photograph seems to be under its own light."""
        return self.order == tuple(range(len(self.order)))

    @property
    def spoils_skin(self) -> bool:
        """Whether what is wrong of skin makes its surface worthless."""
        bad = self.residual > SPOILT_RESIDUAL or self.variety < _ONE_LIGHT
        turned = (self.strange is not None or bool(self.brightness)) and self.turned_deg > SPOILT_DEG
        return not self.in_order or self.frame != "right-up" or bad or turned


def fit_lights(stack: Any, lights: Any, mask: Any = None, *, relief: bool = False) -> LightFit:
    """Compare photographs with the lights that they are given, in this and in every other order and frame.

    Raises BadInput as :func:`splitknit.photometric.lambertian.lambertian`, whose parameters these are; `mask` is the
    whole object, and a few hundred pixels a side are enough. `relief`: the thing is matt, so that what is fine on it
    shows the frame too, be it convex or not.

    Sources: rank three, A. Shashua, "On photometric issues in 3D visual recognition from a single 2D image", IJCV 21
    (1997). The best order is a quadratic assignment of the photographs' inner products to the lights', searched by
    exchanges of two: R. E. Burkard, M. Dell'Amico and S. Martello, "Assignment Problems" (2009), section 8.2.

    >>> import numpy as np
    >>> y, x = np.mgrid[30:-31:-1, -30:31] / 40.0
    >>> ball, inside = np.dstack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0.01))]), x**2 + y**2 < 0.5
    >>> angles = 2 * np.pi * np.arange(7) / 7
    >>> lights = np.column_stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(7, 0.9)])
    >>> stack = np.clip(np.moveaxis(ball @ lights.T, -1, 0), 0, None)
    >>> fit_lights(np.roll(stack, -2, axis=0), lights, inside).order
    (2, 3, 4, 5, 6, 0, 1)
    """
    images = check_stack(stack, least=3)
    vectors = check_lights(lights, len(images))
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    light = images[:, inside]
    some = light[:, :: max(1, light.shape[1] // _PIXELS)].astype(np.float64)
    gram = np.einsum("kn,ln->kl", some, some)
    residual, each = _residual(gram, vectors)
    own = under = np.arange(len(vectors))  # the light of every photograph

    def curl_in(order: NDArray[np.int64]) -> tuple[Array | None, float]:
        return _relief_turn(lambertian(images, vectors[order], inside)[0], inside) if relief else (None, 0.0)

    if len(vectors) >= _FEWEST and residual > _NO_RESIDUAL:
        under = _better_order(gram, vectors)
        if (under != own).any() and curl_in(under)[1] > curl_in(own)[1]:
            under = own  # one photograph may be of something else
    given = bool((under == own).all())
    frame, curl = "right-up", 0.0
    if residual < HIGH_RESIDUAL or not given or relief:
        convex = residual < HIGH_RESIDUAL or not given  # gloss and deep shadows bend what is slow
        turn = _fit_turn(lambertian(images, vectors[under], inside)[0], inside) if convex else None
        of_relief, curl = curl_in(under)
        turn = of_relief if turn is None else turn
        frame = _frame_of(turn) if given else "right-up"
        if turn is not None:
            turned = _turned_order(vectors, turn)[under]
            if _residual(gram, vectors[turned])[0] < _residual(gram, vectors[under])[0] / _LESS:
                under = turned
        if curl > _CURL and frame == "right-up" and (under == own).all():
            other = _best_order(gram, vectors)  # of lights that lie unevenly; brightness may explain the given one
            under = other if curl_in(other)[1] < _LESS_CURL * curl else under
    best, _ = _residual(gram, vectors[under])
    if best < _LESS * residual:
        frame = "right-up"
    given, unequal = bool((under == own).all()), False
    if given and residual > _NO_RESIDUAL and len(vectors) >= _FEWEST_OF_STRANGE:  # fewer fit any brightness
        brightness = _brightness(gram, vectors)
        equal = gram / np.outer(brightness, brightness)
        unequal = _residual(equal, vectors)[0] < _UNEQUAL * residual and _strange(equal, vectors) is None
    strange = _strange(gram, vectors) if given and not unequal else None
    kept, turned_deg = [k for k in range(len(under)) if k != strange], 0.0
    if strange is not None or unequal or not given:
        better = vectors * brightness[:, None] if unequal else vectors[under]
        both = (lambertian(images, vectors, inside)[0], lambertian(images[kept], better[kept], inside)[0])
        cosine = (both[0] * both[1])[inside].sum(axis=1)
        turned_deg = float(np.rad2deg(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    second, first = np.linalg.eigvalsh(gram / np.outer(size, size))[-2:]
    order = tuple(int(k) for k in under)
    variety = float(np.sqrt(max(second, 0.0) / first))
    of_lights = tuple(float(one) for one in brightness) if unequal else ()
    return LightFit(residual, tuple(each.tolist()), order, best, frame, strange, of_lights, turned_deg, variety, curl)


def _strange(gram: Array, lights: Array) -> int | None:
    """The photograph without which the others fit their lights far better."""
    count = len(lights)
    if count < _FEWEST_OF_STRANGE:
        return None
    others = [[k for k in range(count) if k != one] for one in range(count)]
    left = [_residual(gram[np.ix_(kept, kept)], lights[kept])[0] for kept in others]
    one = int(np.argmin(left))
    expected = float(np.sqrt((count - 4) / (count - 3))) * _residual(gram, lights)[0]
    return one if left[one] < _STRANGE * expected else None


def doubt_of_lights(fit: LightFit, names: Sequence[str] = (), material: str = "skin") -> Finding | None:
    """What is wrong with photographs that do not fit their lights or each other, or fit in another order or frame.

    `names` are the photographs', by default ``image 0`` and so on. Of skin it may spoil the surface; of an opaque thing
    it is a doubt, and that it may be a hollow a note.
    """
    names = names or [f"image {k}" for k in range(len(fit.order))]
    code, words = _fault_of_lights(fit, names, material)
    if not code:
        return None
    severity = Severity.SPOILS if material == "skin" and fit.spoils_skin else Severity.DOUBT
    if code == "hollow":
        severity = Severity.NOTE
    files = (names[fit.strange],) if code == "strange-photograph" and fit.strange is not None else ()
    return Finding(code, words, severity, files, fit.turned_deg or None)


def _fault_of_lights(fit: LightFit, names: Sequence[str], material: str) -> tuple[str, str]:  # noqa: PLR0911
    """Code and sentence of :func:`doubt_of_lights`, empty where nothing is wrong."""
    if material == "skin" and fit.variety < _ONE_LIGHT:
        return "one-light", f"the photographs {names[0]} to {names[-1]} are all under one light: light each LED alone."
    turned = f"that turns the surface by {fit.turned_deg:.1f} deg (median)"
    if fit.brightness:
        most = int(np.argmax(np.abs(np.log(fit.brightness))))
        spread = 100 * float(np.std(np.log(fit.brightness)))
        return "unequal-lights", (
            f"the lights are not as bright as is stated of them: they seem to differ by {spread:.0f} % (most that of "
            f"{names[most]}, {fit.brightness[most]:.2f} of the mean), and {turned}; calibrate their brightness."
        )
    if fit.strange is not None and (material == "skin" or fit.turned_deg > _TURNS_DEG):
        return "strange-photograph", (
            f"{names[fit.strange]} does not belong to the other photographs: {turned}; check that it is of the same "
            "thing in the same place, under its own light, or capture it again."
        )
    if material == "opaque" and fit.frame == TURNED:
        return "hollow", HOLLOW
    left = f"{100 * fit.residual:.0f} % of the light"
    moved = [k for k, light in enumerate(fit.order) if light != k]
    if moved:
        words = _order_words(fit.order, names)
        if fit.frame != "right-up":
            frame = _frame_words(fit.frame, material).rstrip(".")
            return "light-order", f"{frame}; or their order is another: {words}."
        others = "the photographs seem to be under other lights than those they are given"
        if fit.residual_in_order < _LESS * fit.residual:
            better = f"{100 * fit.residual_in_order:.0f} % would in another order"
            return "light-order", f"{others}: {left} does not fit them, {better}, and {turned}: {words}."
        only = "only in another order do one surface's slopes follow from them"
        return "light-order", f"{others}, shifted or reversed along the ring: {only}; {words}."
    if fit.frame != "right-up":
        return "light-frame", _frame_words(fit.frame, material)
    if fit.curl > _CURL:
        return "no-surface", _NO_SURFACE.format(100 * fit.curl)
    if fit.residual < HIGH_RESIDUAL:
        return "", ""
    usual = float(np.median(fit.residual_per_image))
    odd = [names[k] for k in np.argsort(fit.residual_per_image)[::-1] if fit.residual_per_image[k] > 1.4 * usual][:4]
    return "light-residual", (
        f"the photographs do not fit the lights they are given: {left} is none that a matt surface reflects (1 to 15 % "
        f"is usual){'; most in ' + ', '.join(odd) if odd else ''}; check the order and directions of the lights, "
        "their brightness, `encoding` and `background`; shine and deep shadows leave much too."
    )


def _frame_words(frame: str, material: str) -> str:
    across, along = frame.split("-")
    opposite = next(name for name, axes in FRAMES.items() if not (np.array(axes) + FRAMES[frame]).any())
    hollow = f" ({opposite} if what is raised comes out hollow)" if material == "opaque" else ""
    return (
        f"the directions of the lights seem to be measured with x pointing {across} and y {along} in the image, not "
        "right and up: only so do the slopes that were found belong to one surface; if they are, give "
        f"`light_frame` {frame}{hollow}, or leave out the one that was given."
    )


def _order_words(order: Sequence[int], names: Sequence[str]) -> str:
    """The lights' order, counted from 1."""
    moved = [k for k, light in enumerate(order) if light != k]
    if len(moved) == 2:
        return f"exchange the lights of {names[moved[0]]} and {names[moved[1]]}"
    return "give the lights, counted from 1, in the order " + " ".join(str(light + 1) for light in order)


def rig_of_frame(rig: Rig, frame: str) -> Rig:
    """The rig whose LEDs (directions, positions, aims) were measured in `frame`, with x right and y up.

    Raises BadInput if the frame is none of :data:`FRAMES`.
    """
    require(frame in FRAMES, f"the frame of the lights must be one of {', '.join(FRAMES)}, but it is '{frame}'.")
    (a, b), (c, d) = FRAMES[frame]

    def turned(vector: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if vector is None else (a * vector[0] + b * vector[1], c * vector[0] + d * vector[1], vector[2])

    def led(one: Led) -> Led:
        vectors = {name: turned(getattr(one, name)) for name in ("position_mm", "direction", "aim")}
        return replace(one, **vectors, also=tuple(led(other) for other in one.also))  # type: ignore[arg-type]

    return replace(rig, leds=tuple(led(one) for one in rig.leds))


_ON_A_LIGHT = 0.2
"""A turned light falls on another within this fraction of the distance of the two closest lights."""
_SAME_TURN = 2.0 * np.cos(np.deg2rad(20.0))


def _fit_turn(normals: FloatArray, inside: BoolArray) -> Array | None:
    """The turn or mirroring (2, 2) of x and y that makes normals those of one convex, integrable surface.

    None where the normals are such already, or those of no single convex surface.
    """
    smooth = _smooth_slopes(normals, inside)
    if _coarse_part(smooth[0], smooth[1], inside) < _ONE_THING:
        return None  # a field of bumps: each is convex, and nothing is of the whole
    given, fits = _least_curls(*smooth)
    convex_ones = [(fit.curl, abs(fit.convex), fit.turn * (1.0 if fit.convex > 0 else -1.0)) for fit in fits]
    convex_ones = [fit for fit in convex_ones if fit[1] > _CONVEX]
    if not convex_ones:
        return None
    least, convex, turn = min(convex_ones, key=lambda fit: fit[0])
    ratio = given.curl / max(least, 1e-12)
    opposite = float(np.trace(turn)) < -_SAME_TURN  # no curl either; only the outline distinguishes it
    worse = 1.0 if given.convex < _CONVEX and convex > _WHOLLY_CONVEX else _WORSE
    return turn if opposite or ratio > worse else None


def _relief_turn(normals: FloatArray, inside: BoolArray) -> tuple[Array | None, float]:
    """The turn or mirroring (2, 2) of x and y that leaves the relief's slopes without curl, None where none does or
    they have none; and how much of their change is curl now.

    A hollow is as free of curl as a hill: of the two the one that falls off towards its outline is returned, and where
    neither does, the one that leaves x to the right.
    """
    given, fits = _least_curls(*_smooth_slopes(normals, inside, _FINE_BLUR))
    best = min(fits, key=lambda fit: fit.part)
    if given.part < _CURL or best.part > _LESS_CURL * given.part:
        return None, given.part
    outwards = best.convex if abs(best.convex) > _FALLS_OFF else float(best.turn[0, 0])
    return best.turn * (1.0 if outwards > 0 else -1.0), given.part


class _Curl(NamedTuple):
    """What slopes have after a turn."""

    curl: float
    """Sum of squares."""
    part: float
    """The same over that of curl and divergence: 0.5 of noise, and of a relief whose frame is mirrored."""
    convex: float
    """Net divergence over its absolute sum, positive where the surface falls off outwards."""
    turn: Array


def _least_curls(p: FloatArray, q: FloatArray, weight: FloatArray) -> tuple[_Curl, list[_Curl]]:
    """Slopes as they are, and after the best turn of each hand: turned by an angle t, they have the curl
    cos t * curl - sin t * divergence, whose least sum of squares is an eigenvalue.
    """
    slope_x, slope_y, share = (part.astype(np.float64) for part in (p, q, weight))
    dp_dx, dp_dy, dq_dx, dq_dy = (
        sign * np.gradient(part, axis=axis) for part in (slope_x, slope_y) for sign, axis in ((1.0, 1), (-1.0, 0))
    )

    def turned(cosine: float, sine: float, mirrored: float) -> _Curl:
        both = dp_dy - mirrored * dq_dx, dp_dx + mirrored * dq_dy
        curl, divergence = cosine * both[0] - sine * both[1], cosine * both[1] + sine * both[0]
        squares = float(np.sum(share * curl**2)), float(np.sum(share * divergence**2))
        convex = -float(np.sum(share * divergence)) / max(float(np.sum(share * np.abs(divergence))), 1e-12)
        turn = np.array([[cosine, -mirrored * sine], [sine, mirrored * cosine]])
        return _Curl(squares[0], squares[0] / max(sum(squares), 1e-12), convex, turn)

    fits = []
    for mirrored in (1.0, -1.0):
        curl, divergence = dp_dy - mirrored * dq_dx, dp_dx + mirrored * dq_dy
        mixed = -float(np.sum(share * curl * divergence))
        squares = [[np.sum(share * curl**2), mixed], [mixed, np.sum(share * divergence**2)]]
        cosine, sine = np.linalg.eigh(np.array(squares))[1][:, 0]
        fits.append(turned(float(cosine), float(sine), mirrored))
    return turned(1.0, 0.0, 1.0), fits


def _coarse_part(p: FloatArray, q: FloatArray, inside: BoolArray) -> float:
    """Rms of slopes (h, w) blurred over an eighth of the object, over their own; the same in every frame."""
    within = inside[bounding_box(inside)]
    cover = within.astype(np.float32)
    sigma = 0.12 * max(cover.shape)
    mean = np.maximum(gaussian_mean(cover, sigma), 1e-6)
    coarse = sum(float(((gaussian_mean(part * cover, sigma) / mean)[within] ** 2).sum()) for part in (p, q))
    own = sum(float((part[within] ** 2).sum()) for part in (p, q))
    return float(np.sqrt(coarse / max(own, 1e-12)))


def _turned_order(lights: Array, turn: Array) -> NDArray[np.int64]:
    """The light that each light falls on when all are turned; each itself where they fall on none."""
    units = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    turned = np.column_stack([np.einsum("ij,kj->ki", turn, units[:, :2]), units[:, 2]])
    apart = np.linalg.norm(units[:, None] - units[None], axis=2) + np.where(np.eye(len(units)) > 0, np.inf, 0.0)
    away = np.linalg.norm(turned[:, None] - units[None], axis=2)
    nearest = np.argmin(away, axis=1)
    fits = len(set(nearest.tolist())) == len(units) and float(away.min(axis=1).max()) < _ON_A_LIGHT * float(apart.min())
    return np.asarray(nearest) if fits else np.arange(len(units))


def _unexplained(gram: Array, lights: Array) -> Array:
    """(L,) squared light of the photographs that no surface under these lights explains."""
    rest = np.eye(len(lights)) - _explaining(lights)
    return np.asarray(np.maximum(np.einsum("kj,kj->k", np.einsum("ki,ij->kj", rest, gram), rest), 0.0))


def _explaining(lights: Array) -> Array:
    """(L, L) projection of photographs onto those that a surface under these lights has."""
    return np.asarray(np.einsum("ki,il->kl", lights, np.linalg.pinv(lights)))


def _residual(gram: Array, lights: Array) -> tuple[float, Array]:
    left, own = _unexplained(gram, lights), np.maximum(np.diag(gram), 1e-300)
    return float(np.sqrt(left.sum() / own.sum())), np.sqrt(left / own)


def _brightness(gram: Array, lights: Array) -> Array:
    """(L,) brightness of every photograph over that of its light, mean 1, found by alternation."""
    explaining, scale = _explaining(lights), np.ones(len(gram))
    for _ in range(30):
        scaled = gram / np.outer(scale, scale)
        shown = np.einsum("ij,jk->ik", explaining, scaled)
        both = np.einsum("ij,ji->i", shown, explaining)
        scale *= np.diag(shown) / np.maximum(both, 1e-300)
        scale = np.maximum(scale / scale.mean(), 1e-3)
    return scale


def _of_free_brightness(gram: Array, lights: Array) -> float:
    """The residual where every photograph has a brightness of its own."""
    scale = _brightness(gram, lights)
    return _residual(gram / np.outer(scale, scale), lights)[0]


def _better_order(gram: Array, lights: Array) -> NDArray[np.int64]:
    """The light of every photograph in the order that explains them best; their own unless that is clearly worse."""
    own, under = np.arange(len(lights)), _best_order(gram, lights)
    order = np.argsort(under)
    moved = order != own
    there = gram[np.ix_(order, order)]
    before, after = _unexplained(gram, lights), _unexplained(there, lights)
    free, own_fraction = _BETTER if len(lights) > _FEWEST else _BETTER_OF_FIVE
    clearly = (
        float(np.sqrt(after[moved].sum() / max(before[moved].sum(), 1e-300))) < own_fraction
        and _of_free_brightness(there, lights) < free * _of_free_brightness(gram, lights)
    ) if moved.any() else False  # fmt: skip
    return under if clearly else own


def _best_order(gram: Array, lights: Array) -> NDArray[np.int64]:
    """The light of every photograph in the order that explains them best."""
    count = len(lights)
    own = np.arange(count)
    # a start says which photograph belongs to every light: the given one, shifts and reversals of it, and any
    starts = [np.roll(line, step) for line in (own, own[::-1]) for step in range(count)]
    explaining = _explaining(lights)
    score = [float(np.sum(explaining * gram[np.ix_(start, start)])) for start in starts]
    few = count <= _LARGEST_SEARCH
    starts = [own, *(starts[k] for k in np.argsort(score)[::-1][:8] if few or score[k] > score[0])]
    if few and (_climbed(explaining, gram, own)[0] != own).any():
        random = np.random.default_rng(0)
        starts += [random.permutation(count) for _ in range(_SEEDS)]
    order = max((_climbed(explaining, gram, start) for start in starts), key=lambda found: found[1])[0]
    return np.argsort(order)


def _climbed(explaining: Array, gram: Array, start: NDArray[np.int64]) -> tuple[NDArray[np.int64], float]:
    """The best order that exchanges of two photographs lead to, each the best one, and the light that it explains."""
    order = start.copy()
    own = np.diag(explaining)
    while True:
        there = gram[np.ix_(order, order)]
        light = np.diag(there)
        both = np.einsum("rk,sk->rs", explaining, there)
        mixed = both + both.T - np.diag(both)[:, None] - np.diag(both)
        mixed -= (own[:, None] - explaining) * (there - light[:, None])
        mixed -= (explaining - own) * (light - there)
        gain = 2.0 * mixed - (own[:, None] - own) * (light[:, None] - light)
        first, second = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[first, second] <= 1e-9 * float(np.trace(gram)):
            return order, float(np.sum(explaining * there))
        order[[first, second]] = order[[second, first]]


def _smooth_slopes(
    normals: FloatArray, inside: BoolArray, blur: float = _BLUR
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes (h, w) of the object, y up, blurred inside the mask, and the weight that is left of every pixel."""
    window = bounding_box(inside)
    part, cover = normals[window], inside[window].astype(np.float32)
    nz = np.maximum(part[..., 2], 1e-3)
    slopes = [-part[..., axis] / nz for axis in (0, 1)]
    steep = np.maximum(np.hypot(*slopes) / _STEEPEST, 1.0)
    sigma = max(1.0, blur * max(cover.shape))
    mean = np.maximum(gaussian_mean(cover, sigma), 1e-3)
    p, q = (gaussian_mean(slope / steep * cover, sigma) / mean for slope in slopes)
    believed = cv2.erode((steep <= 1.0).astype(np.float32) * cover, np.ones((2 * round(sigma) + 1,) * 2))
    return p, q, np.asarray(believed)
