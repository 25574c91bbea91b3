"""Whether photographs and lights go together: the light left unexplained, the lights' order, and
their frame.

A matt surface under L distant lights gives photographs of rank three: what least squares leaves of
them is small if each photograph is given its own light. Where lights lie evenly on a ring, a cyclic
shift or a reversal of their order explains the photographs as well, by a surface whose normals are
turned or mirrored about the camera's axis; so does a list of directions in another frame. The true
surface is integrable and convex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.diagnosis.samples import median_angle_deg
from splitknit.errors import require
from splitknit.findings import Finding, Severity
from splitknit.imaging.geometry import bounding_box, smoothed
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
"""Where x and y point in the image, and the matrix that turns such a vector's x and y to x right, y
up."""
_OPPOSITE = {"right": "left", "left": "right", "up": "down", "down": "up"}
TURNED = "left-down"
HOLLOW = (
    "the object comes out hollow; if it is a hill, its lights were measured with x pointing left"
    " and y down in the image: then give `light_frame` left-down, or leave out the one that was"
    " given."
)
"""Photographs of a hollow are those of a hill whose lights are turned by 180 deg: both are possible
of an object."""
_NO_SURFACE = (
    "{:.0f} % of the change of the slopes belongs to no surface (up to 3 % is usual), and no other"
    " order or frame of the lights mends that: heights are wrong; check their directions,"
    " photograph by photograph."
)
_SAME_TURN = 2.0 * np.cos(np.deg2rad(20.0))
"""Trace of the product of a frame of the lights and the measured turn from which the frame is
named: they differ by 20 deg at most."""
_ONE_LIGHT = 0.03
"""Photographs of a finger that differ by less than this are under one light: 0.13 and more under
their own. Chosen on: judgement. Range: up to 0.13."""
SPOILT_DEG = 3.0
"""A surface whose normals are turned by this angle is refused: on a simulated finger photographs
that turn them by 3 to 11 deg cost up to 0.7 mm (``validation/damaged``). Chosen on: simulated
fingers (validation/damaged)."""


@dataclass(frozen=True, slots=True)
class LightFit:
    """How well photographs fit the lights that they are given, and which order or frame fits
    better."""

    residual: float
    """Root of the fraction of the photographs' squared light that least squares leaves, 0 to 1."""
    residual_per_image: tuple[float, ...]
    """The same of every photograph."""
    order: tuple[int, ...]
    """Estimated light of each photograph, from 0: its own unless the photographs contradict it."""
    frame: str
    """Name in :data:`FRAMES`; ``right-up`` while the residual is high or an order is clearly
    better."""
    strange: int | None = None
    """The photograph that does not belong to the rest."""
    brightness: tuple[float, ...] = ()
    """Brightness of every light relative to the stated one, mean 1, where it explains the
    photographs far better."""
    turned_deg: float = 0.0
    """Median angle by which another order, brightness, or the strange photograph turns the
    normals."""
    variety: float = 1.0
    """How much the photographs differ, but for their brightness: 0 to 1."""
    curl: float = 0.0
    """Curl of a relief as a fraction of its slopes' change: it belongs to no surface. 0 to 1."""

    @property
    def in_order(self) -> bool:
        """Whether the estimated light of every photograph is its own."""
        return self.order == tuple(range(len(self.order)))

    @property
    def spoils_skin(self) -> bool:
        """Whether what is wrong of skin makes its surface worthless."""
        turned = self.turned_deg > SPOILT_DEG and (
            self.strange is not None or bool(self.brightness)
        )
        # light left unexplained beyond which photographs and lights contradict each other
        contradicted = self.residual > 0.3 or self.variety < _ONE_LIGHT
        return not self.in_order or self.frame != "right-up" or contradicted or turned


_NO_RESIDUAL = 0.03  # light left unexplained up to which no other order is looked for
_HIGHLIGHT = 2.0
"""Light of an opaque thing over the median of its lights up to which it counts: 1.5 to 2.5 give the
same on DiLiGenT's bear and ball and on a photographed coin."""
_FEWEST_OF_STRANGE = 6  # photographs from which one is looked for that does not belong to the rest


def fit_lights(stack: Any, lights: Any, mask: Any = None, *, relief: bool = False) -> LightFit:
    """Compare photographs with the lights that they are given, in this and in every other order and
    frame.

    Raises BadInput as :func:`splitknit.photometric.lambertian.lambertian`, whose parameters these
    are; `mask` is the whole object, and a few hundred pixels a side are enough. `relief`: the
    object is matt, so that what is fine on it shows the frame too, be it convex or not.

    Sources: rank three, A. Shashua, "On photometric issues in 3D visual recognition from a single
    2D image", IJCV 21 (1997). The best order is a quadratic assignment of the photographs' inner
    products to the lights', searched by exchanges of two: R. E. Burkard, M. Dell'Amico and S.
    Martello, "Assignment Problems" (2009), section 8.2.

    >>> import numpy as np
    >>> y, x = np.mgrid[30:-31:-1, -30:31] / 40.0
    >>> ball = np.dstack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0.01))])
    >>> inside = x**2 + y**2 < 0.5
    >>> angles = 2 * np.pi * np.arange(7) / 7
    >>> lights = np.column_stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(7, 0.9)])
    >>> stack = np.clip(np.moveaxis(ball @ lights.T, -1, 0), 0, None)
    >>> fit_lights(np.roll(stack, -2, axis=0), lights, inside).order
    (2, 3, 4, 5, 6, 0, 1)
    """
    images = check_stack(stack, least=3)
    vectors = check_lights(lights, len(images))
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    values = images[:, inside]
    # about so many pixels of the object are fitted
    values = values[:, :: max(1, values.shape[1] // 20_000)].astype(np.float64)
    if relief:  # highlights, by which a ball of lacquer and a coin showed no order
        values = np.minimum(values, _HIGHLIGHT * np.median(values, axis=0))
    gram = np.einsum("kn,ln->kl", values, values)
    residual, residual_per_image = _residual(gram, vectors)
    order, frame, curl = _order_and_frame(images, vectors, inside, gram, residual, relief)
    own = np.arange(len(vectors))
    in_order = bool((order == own).all())
    gains = np.ones(len(vectors))
    strange = None
    if in_order and not relief:  # of an opaque thing the forward model is asked
        # fewer fit any brightness
        if residual > _NO_RESIDUAL and len(vectors) >= _FEWEST_OF_STRANGE:
            gains = _explained_gains(gram, vectors, residual)
        strange = _strange(gram, vectors) if (gains == 1.0).all() else None
    unequal = bool((gains != 1.0).any())
    turned_deg = 0.0
    if strange is not None or unequal or not in_order:
        kept = own[own != strange]
        stated = lambertian(images, vectors, inside)[0]
        better = lambertian(images[kept], (vectors[order] * gains[:, None])[kept], inside)[0]
        turned_deg = median_angle_deg(stated[inside], better[inside])
    norms = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    second, first = np.linalg.eigvalsh(gram / np.outer(norms, norms))[-2:]
    return LightFit(
        residual,
        tuple(residual_per_image.tolist()),
        tuple(order.tolist()),
        frame,
        strange,
        tuple(gains.tolist()) if unequal else (),
        turned_deg,
        float(np.sqrt(max(second, 0.0) / first)),
        curl,
    )


_DOUBTED_CURL = 0.15
"""Curl as a fraction of the slopes' change from which lights are doubted: up to 0.03 on sound
objects, 0.3 to 0.6 in a mirrored or turned frame. Chosen on: simulated objects (24 of eight kinds).
Range: 0.03 to 0.3."""
_CURL_LEFT = 0.25  # fraction of the stated lights' curl that another frame or order may leave
HIGH_RESIDUAL = 0.2
"""Light left unexplained, as a fraction, from which photographs do not fit their lights: 0.01 to
0.15 on objects and fingers under their own lights (docs/experiments/faults.md). Chosen on:
judgement. Range: from 0.15."""
_FEWEST_ORDERED = 5
"""Lights from which the residual determines an order; with five another order must be better
still."""
_LESS_RESIDUAL = 0.9
"""An order that leaves less than this fraction of the residual is not merely a turn of the
lights."""


def _order_and_frame(  # noqa: PLR0917
    images: FloatArray, lights: Array, inside: BoolArray, gram: Array, residual: float, relief: bool
) -> tuple[NDArray[np.int64], str, float]:
    """The light of every photograph, the frame in which they were measured, and a relief's curl."""

    def surface_in(order: NDArray[np.int64]) -> tuple[FloatArray, Array | None, float]:
        normals = lambertian(images, lights[order], inside)[0]
        return normals, *(_relief_turn(normals, inside) if relief else (None, 0.0))

    own = order = np.arange(len(lights))
    normals, turn, curl = surface_in(own)
    if len(lights) >= _FEWEST_ORDERED and residual > _NO_RESIDUAL:
        better = _better_order(gram, lights)
        if (better != own).any():
            surface = surface_in(better)
            if surface[2] <= curl:  # else one photograph may be of something else
                order = better
                normals, turn, curl = surface
    in_order = bool((order == own).all())
    if residual < HIGH_RESIDUAL or not in_order:  # gloss and deep shadows bend what is slow
        turn_of_shape = _fit_turn(normals, inside)
        turn = turn if turn_of_shape is None else turn_of_shape
    frame = "right-up"
    if turn is not None:
        if in_order:
            likeness = {name: float(np.sum(turn * np.array(axes))) for name, axes in FRAMES.items()}
            nearest = max(FRAMES, key=lambda name: likeness[name])
            frame = nearest if likeness[nearest] > _SAME_TURN else frame  # 2 cos(difference)
        turned = _turned_order(lights, turn)[order]
        if _residual(gram, lights[turned])[0] < _residual(gram, lights[order])[0] / _LESS_RESIDUAL:
            order = turned
    if curl > _DOUBTED_CURL and frame == "right-up" and (order == own).all():
        # of lights that lie unevenly; brightness may explain the stated one
        best = _best_order(gram, lights)
        order = best if surface_in(best)[2] < _CURL_LEFT * curl else order
    clearly_better = _residual(gram, lights[order])[0] < _LESS_RESIDUAL * residual
    return order, "right-up" if clearly_better else frame, curl


def _explained_gains(gram: Array, lights: Array, residual: float) -> Array:
    """(L,) brightness of the lights where that explains the photographs far better, else ones."""
    gains, equalised = _equalised(gram, lights)
    # brightness is at fault where less than this fraction of the residual is left once every
    # photograph has its own: 0.96 and more under lights of known brightness, 0.25 where that is 10
    # to 20 % off. Range: 0.25 to 0.96
    explains = (
        _residual(equalised, lights)[0] < 0.5 * residual and _strange(equalised, lights) is None
    )
    return gains if explains else np.ones(len(gram))


_STRANGE = 0.7
"""A photograph does not belong to the rest if leaving it out lowers the residual below this part
of what leaving out any one light would: at least 0.99 on simulated, path-traced and polarised
fingers, 0.2 to 0.65 where a photograph is noise, turned, a copy of a second one or of a second
finger. Chosen on: simulated fingers (and path-traced and polarised ones). Range: 0.65 to 0.99."""


def _strange(gram: Array, lights: Array) -> int | None:
    """The photograph without which the rest fit their lights far better."""
    count = len(lights)
    if count < _FEWEST_OF_STRANGE:
        return None
    kept = [np.delete(np.arange(count), k) for k in range(count)]
    residuals = [_residual(gram[np.ix_(rest, rest)], lights[rest])[0] for rest in kept]
    k = int(np.argmin(residuals))
    expected = float(np.sqrt((count - 4) / (count - 3))) * _residual(gram, lights)[0]
    return k if residuals[k] < _STRANGE * expected else None


def doubt_of_lights(
    fit: LightFit, names: Sequence[str] = (), material: str = "skin"
) -> Finding | None:
    """What is wrong with photographs that do not fit their lights or each other, or fit in another
    order or frame.

    `names` are the photographs', by default ``image 0`` and so on. Of skin it may spoil the
    surface; of an opaque object it is a doubt, and that it may be a hollow a note.
    """
    fault = _fault_of_lights(fit, names or [f"image {k}" for k in range(len(fit.order))], material)
    if fault is None or fault.code == "hollow":
        return fault
    severity = Severity.SPOILS if material == "skin" and fit.spoils_skin else Severity.DOUBT
    return replace(fault, severity=severity, effect_deg=fit.turned_deg or None)


def _fault_of_lights(  # noqa: PLR0911
    fit: LightFit, names: Sequence[str], material: str
) -> Finding | None:
    """What :func:`doubt_of_lights` names, a note."""
    if material == "skin" and fit.variety < _ONE_LIGHT:
        return Finding(
            "one-light",
            f"the photographs {names[0]} to {names[-1]} are all under one light: light each LED"
            " alone.",
        )
    turned = f"that turns the surface by {fit.turned_deg:.1f} deg (median)"
    if fit.brightness:
        logs = np.log(fit.brightness)
        most = int(np.argmax(np.abs(logs)))
        return Finding(
            "unequal-lights",
            "the lights are not as bright as is stated of them: they seem to differ by"
            f" {100 * logs.std():.0f} % (most that of {names[most]}, {fit.brightness[most]:.2f}"
            f" of the mean), and {turned}; calibrate their brightness.",
        )
    if fit.strange is not None:
        return Finding(
            "strange-photograph",
            f"{names[fit.strange]} does not belong to the other photographs: {turned}; check that"
            " it is of the same thing in the same place, under its own light, or capture it again.",
            files=(names[fit.strange],),
        )
    if material == "opaque" and fit.frame == TURNED:
        return Finding("hollow", HOLLOW)
    advice = []
    if fit.frame != "right-up":
        across, along = fit.frame.split("-")
        opposite = f"{_OPPOSITE[across]}-{_OPPOSITE[along]}"
        hollow = f" ({opposite} if what is raised comes out hollow)" if material == "opaque" else ""
        advice.append(
            f"if they were measured with x pointing {across} and y {along} in the image, not right"
            f" and up, give `light_frame` {fit.frame}{hollow}, or leave out the one that was given"
        )
    moved = [k for k, light in enumerate(fit.order) if light != k]
    if len(moved) == 2:
        advice.append(f"exchange the lights of {names[moved[0]]} and {names[moved[1]]}")
    elif moved:
        numbers = " ".join(str(light + 1) for light in fit.order)
        advice.append(f"give the lights, counted from 1, in the order {numbers}")
    if advice:
        effect = f" ({turned})" if moved else ""
        words = (
            "the photographs seem to be under other lights than those they are given"
            f"{effect}: {'; or '.join(advice)}."
        )
        return Finding("light-order" if moved else "light-frame", words)
    if fit.curl > _DOUBTED_CURL:
        return Finding("no-surface", _NO_SURFACE.format(100 * fit.curl))
    if fit.residual < HIGH_RESIDUAL or material == "opaque":  # of which the forward model is asked
        return None
    worst = [names[k] for k in np.argsort(fit.residual_per_image)[:-4:-1]]
    return Finding(
        "light-residual",
        "the photographs do not fit the lights they are given:"
        f" {100 * fit.residual:.0f} % of the light does not fit a matt surface under these lights"
        f" (1 to 15 % is usual); most in {', '.join(worst)}; check the order and directions of the"
        " lights, their brightness, `encoding` and `background`; shine and deep shadows leave much"
        " too.",
    )


def rig_of_frame(rig: Rig, frame: str) -> Rig:
    """The rig whose LEDs (directions, positions, aims) were measured in `frame`, with x right and y
    up.

    Raises BadInput if the frame is none of :data:`FRAMES`.
    """
    require(
        frame in FRAMES,
        f"the frame of the lights must be one of {', '.join(FRAMES)}, but it is '{frame}'.",
    )
    (a, b), (c, d) = FRAMES[frame]

    def turned(led: Led) -> Led:
        vectors: dict[str, Any] = {}
        for name in ("position_mm", "direction", "aim"):
            if vector := getattr(led, name):
                x, y, z = vector
                vectors[name] = (a * x + b * y, c * x + d * y, z)
        return replace(led, **vectors, also=tuple(turned(each) for each in led.also))

    return replace(rig, leds=tuple(turned(led) for led in rig.leds))


_CONVEX = 0.4
"""Net divergence over its absolute sum from which a surface counts as one convex object: 0.6 to 1
on objects and fingers, 0.07 on a field of balls. Chosen on: judgement. Range: 0.07 to 0.6."""


def _fit_turn(normals: FloatArray, inside: BoolArray) -> Array | None:
    """The turn or mirroring (2, 2) of x and y that makes normals those of one convex, integrable
    surface.

    Only in the right frame, and that turned by 180 deg, have the slopes no curl (R. T. Frankot and
    R. Chellappa, IEEE Trans. PAMI 10, 1988); of the two, the right one is convex (P. N. Belhumeur,
    D. J. Kriegman and A. L. Yuille, "The bas-relief ambiguity", IJCV 35, 1999). None where the
    normals are such already, or of no single convex surface.
    """
    # blur (sigma) of the slopes, as a fraction of the mask's longer side: shape is judged, not
    # noise and texture
    p, q, weight = _smooth_slopes(normals, inside, 0.02)
    # fraction of the slopes that a blur over an eighth of the object leaves, below which it is not
    # one convex object: 0.6 to 0.9 on objects and fingers, 0.07 to 0.23 on a field of balls. Range:
    # 0.23 to 0.6
    if _coarse_fraction(p, q, inside) < 0.4:
        return None  # a field of bumps: each is convex, and nothing is of the whole
    stated, turns = _least_curls(p, q, weight)
    turns = [each for each in turns if abs(each.convex) > _CONVEX]
    if not turns:
        return None
    least = min(turns, key=lambda each: each.curl)
    turn = least.turn * (1.0 if least.convex > 0 else -1.0)
    # no curl either; only the outline distinguishes it
    half_turn = np.trace(turn) < -_SAME_TURN
    ratio = stated.curl / max(least.curl, 1e-12)
    # another frame must be twice as integrable to be named; where only there the surface is wholly
    # convex, it need not be
    worse = 1.0 if stated.convex < _CONVEX and abs(least.convex) > 0.8 else 2.0
    return turn if half_turn or ratio > worse else None


def _relief_turn(normals: FloatArray, inside: BoolArray) -> tuple[Array | None, float]:
    """The turn or mirroring (2, 2) of x and y after which the relief's slopes have no curl, None
    where there is none or they have none already; and the fraction of their change that is curl at
    present.

    A hollow is as free of curl as a hill: of the two the one that falls off towards its outline is
    returned, and where neither does, the one that leaves x to the right.
    """
    # blur (sigma) of the slopes of a relief, such as the text of a coin or the hairs of a carving,
    # as a fraction of the mask's longer side
    stated, turns = _least_curls(*_smooth_slopes(normals, inside, 0.006))
    least = min(turns, key=lambda each: each.curl)
    if stated.curl < _DOUBTED_CURL or least.curl > _CURL_LEFT * stated.curl:
        return None, stated.curl
    # how clearly a relief must fall off outwards to be a hill
    outwards = least.convex if abs(least.convex) > 0.1 else float(least.turn[0, 0])
    return least.turn * (1.0 if outwards > 0 else -1.0), stated.curl


class _Curl(NamedTuple):
    """What slopes have after a turn."""

    curl: float
    """Sum of squares over that of curl and divergence: 0.5 of noise, and of a relief whose frame is
    mirrored."""
    convex: float
    """Net divergence over its absolute sum, positive where the surface falls off outwards."""
    turn: Array


def _least_curls(p: FloatArray, q: FloatArray, weight: FloatArray) -> tuple[_Curl, list[_Curl]]:
    """Slopes as they are, and after the best turn of each hand: a turn by t
    multiplies the field divergence + i curl by exp(-i t).
    """
    p_down, p_right = np.gradient(p.astype(np.float64))
    q_down, q_right = np.gradient(q.astype(np.float64))

    def turned(hand: float, angle: float | None = None) -> _Curl:
        field = p_right - hand * q_down - 1j * (p_down + hand * q_right)  # divergence + i curl
        if angle is None:
            angle = 0.5 * float(np.angle(np.sum(weight * field**2)))
        cosine, sine = np.cos(angle), np.sin(angle)
        field *= cosine - 1j * sine
        power = float(np.sum(weight * np.abs(field) ** 2))
        spread = float(np.sum(weight * np.abs(field.real)))
        return _Curl(
            float(np.sum(weight * field.imag**2)) / max(power, 1e-12),
            -float(np.sum(weight * field.real)) / max(spread, 1e-12),
            np.array([[cosine, -hand * sine], [sine, hand * cosine]]),
        )

    return turned(1.0, 0.0), [turned(1.0), turned(-1.0)]


def _coarse_fraction(p: FloatArray, q: FloatArray, inside: BoolArray) -> float:
    """Rms of slopes (h, w) blurred over an eighth of the object, over their own; the same in every
    frame."""
    within = inside[bounding_box(inside)]
    sigma = 0.12 * max(within.shape)
    coarse, own = (
        float(np.linalg.norm([slope[within] for slope in slopes]))
        for slopes in ([smoothed(slope, within, sigma) for slope in (p, q)], (p, q))
    )
    return coarse / max(own, 1e-6)


def _turned_order(lights: Array, turn: Array) -> NDArray[np.int64]:
    """Index of the light at whose place each light lies after all are turned; their own where they
    meet none."""
    units = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    turned = np.column_stack([units[:, :2] @ turn.T, units[:, 2]])
    apart = np.linalg.norm(units[:, None] - units, axis=2)
    closest = float(apart[~np.eye(len(units), dtype=bool)].min())
    away = np.linalg.norm(turned[:, None] - units, axis=2)
    nearest = np.argmin(away, axis=1)
    # a turned light falls on another within this fraction of the distance of the two closest lights
    falls = len(np.unique(nearest)) == len(units) and away.min(axis=1).max() < 0.2 * closest
    return np.asarray(nearest) if falls else np.arange(len(units))


def _unexplained(gram: Array, lights: Array) -> Array:
    """(L,) squared light of the photographs that no surface under these lights explains."""
    rest = np.eye(len(lights)) - _explaining(lights)
    return np.asarray(np.maximum(np.diag(rest @ gram @ rest), 0.0))


def _explaining(lights: Array) -> Array:
    """(L, L) projection of photographs onto those that a surface under these lights has."""
    return np.asarray(lights @ np.linalg.pinv(lights))


def _residual(gram: Array, lights: Array) -> tuple[float, Array]:
    """Residual of all photographs, and (L,) of each."""
    unexplained = _unexplained(gram, lights)
    power = np.maximum(np.diag(gram), 1e-300)
    return float(np.sqrt(unexplained.sum() / power.sum())), np.asarray(np.sqrt(unexplained / power))


def _equalised(gram: Array, lights: Array) -> tuple[Array, Array]:
    """(L,) brightness of every photograph over that of its light, mean 1, by alternation; and
    `gram` without it."""
    explaining = _explaining(lights)
    scale = np.ones(len(gram))
    for _ in range(30):
        predicted = explaining @ (gram / np.outer(scale, scale))
        scale *= np.diag(predicted) / np.maximum(np.diag(predicted @ explaining), 1e-300)
        scale = np.maximum(scale / scale.mean(), 1e-3)
    return scale, gram / np.outer(scale, scale)


_BETTER = (0.8, 0.6)
"""Another order is named if its residual over the stated order's is below both: that of all
photographs, their brightness free, and that of the photographs whose light changes. Real objects
with brightness wrong by 20 % or directions by 2 deg stay above. Chosen on: real photographs
(objects, with brightness wrong by 20 % or directions by 2 deg)."""
_BETTER_OF_FIVE = (0.4, 0.4)  # the two ratios of `_BETTER` under five lights


def _better_order(gram: Array, lights: Array) -> NDArray[np.int64]:
    """The light of every photograph in the order that explains them best; their own unless that is
    clearly worse."""
    own = np.arange(len(lights))
    best = _best_order(gram, lights)
    order = np.argsort(best)
    moved = order != own
    if not moved.any():
        return own
    ordered = gram[np.ix_(order, order)]
    before, after = (_unexplained(each, lights)[moved].sum() for each in (gram, ordered))
    before_free, after_free = (
        _residual(_equalised(each, lights)[1], lights)[0] for each in (gram, ordered)
    )
    free, own_fraction = _BETTER if len(lights) > _FEWEST_ORDERED else _BETTER_OF_FIVE
    clearly = (
        np.sqrt(after / max(before, 1e-300)) < own_fraction and after_free < free * before_free
    )
    return best if clearly else own


def _best_order(gram: Array, lights: Array) -> NDArray[np.int64]:
    """The light of every photograph in the order that explains them best."""
    count = len(lights)
    own = np.arange(count)
    # a start says which photograph belongs to every light: the stated one, shifts and reversals of
    # it, and any
    starts = [np.roll(line, step) for line in (own, own[::-1]) for step in range(count)]
    explaining = _explaining(lights)
    score = [float(np.sum(explaining * gram[np.ix_(start, start)])) for start in starts]
    # with more lights than this the search starts from the stated order and its shifts alone
    few = count <= 48
    starts = [own, *(starts[k] for k in np.argsort(score)[::-1][:8] if few or score[k] > score[0])]
    if few and (_climbed(explaining, gram, own)[0] != own).any():
        random = np.random.default_rng(0)
        # random orders from which the search for a better order of the lights starts
        starts += [random.permutation(count) for _ in range(300)]
    order, _ = max((_climbed(explaining, gram, start) for start in starts), key=itemgetter(1))
    return np.argsort(order)


def _climbed(
    explaining: Array, gram: Array, start: NDArray[np.int64]
) -> tuple[NDArray[np.int64], float]:
    """The best order that exchanges of two photographs lead to, each the best one, and the light
    that it explains."""
    order = start.copy()
    own = np.diag(explaining)
    while True:
        ordered = gram[np.ix_(order, order)]
        power = np.diag(ordered)
        both = explaining @ ordered.T
        mixed = both + both.T - np.diag(both)[:, None] - np.diag(both)
        mixed -= (own[:, None] - explaining) * (ordered - power[:, None])
        mixed -= (explaining - own) * (power - ordered)
        gain = 2.0 * mixed - (own[:, None] - own) * (power[:, None] - power)
        first, second = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[first, second] <= 1e-9 * float(np.trace(gram)):
            return order, float(np.sum(explaining * ordered))
        order[[first, second]] = order[[second, first]]


def _smooth_slopes(
    normals: FloatArray, inside: BoolArray, blur: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes (h, w) of the object, y up, blurred inside the mask, and the weight that is left of
    every pixel."""
    window = bounding_box(inside)
    part = normals[window]
    within = inside[window]
    slopes = -np.moveaxis(part[..., :2], -1, 0) / np.maximum(part[..., 2], 1e-3)
    # normals beyond this slope, often in shadow, are shortened to it and left out of the curl
    steep = np.maximum(np.hypot(*slopes) / 1.5, 1.0)
    sigma = max(1.0, blur * max(within.shape))
    p, q = (smoothed(slope / steep, within, sigma) for slope in slopes)
    side = 2 * round(sigma) + 1
    weight = cv2.erode(((steep <= 1.0) & within).astype(np.float32), np.ones((side, side)))
    return p, q, np.asarray(weight)
