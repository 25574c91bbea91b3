"""A matt finger between two mirrors, by formulas: an elliptic cylinder with a round tip, ridges."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

from splitknit.capture import Band, Capture
from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.reflection import Glass, Plane
from splitknit.mirrors.views import Views
from splitknit.model import Camera, Led, Mirror, Rig
from splitknit_match.rolled.views import MirrorView, MirrorViews

A, B, CAP, TOP = 8.0, 6.5, 8.0, -0.5
"""Half breadth, half height, length of the cap, height of the pad; mm."""
PX, SIZE = 18.0, (430, 1240)
LEAN = 30.0
"""The mirrors' planes are |x| - z = LEAN: at 45 deg."""
DEPTH_MM = 0.03
CORNERS = np.array([[14.0, -14.0], [14.0, 14.0], [36.0, 14.0], [36.0, -14.0]])


def mirrors(names: tuple[str, ...] = ("left", "right")) -> tuple[Mirror, ...]:
    built = []
    for name in names:
        sign = 1.0 if name == "right" else -1.0
        corners = tuple((sign * float(x), float(y), float(x) - LEAN) for x, y in CORNERS)
        built.append(Mirror(name, corners, 0.8))
    return tuple(built)


def rig(names: tuple[str, ...] = ("left", "right")) -> Rig:
    azimuth = 2 * np.pi * np.arange(7) / 7
    leds = tuple(
        Led("white", position_mm=(52.5 * np.cos(a), 52.5 * np.sin(a), 140.0)) for a in azimuth
    )
    return Rig(Camera(PX, SIZE), leds, {}, mirrors(names))


def phase(points: np.ndarray) -> np.ndarray:
    """Of the ridges: no mirror image of themselves; one ridge each 0.6 mm or so."""
    x, y, z = np.moveaxis(points, -1, 0)
    angle = np.arctan2(x / A, (z - TOP + B) / B)
    return 10.5 * (0.8 * y + 0.6 * 7.2 * angle + 0.35 * np.sin(0.7 * y + 1.1 * angle))


def ridges(points: np.ndarray) -> np.ndarray:
    """(...,) relief in mm."""
    return DEPTH_MM * np.sin(phase(points))


def on_finger(first: np.ndarray, y: np.ndarray, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (..., 3) of the finger on lines along x or z through (`first`, y), and which lines
    meet it.

    `axis` is ``z`` (from the camera; first is x), ``+x`` or ``-x`` (from the sides; first is z).
    """
    cap = np.maximum(y, 0.0) / CAP
    breadth, height = (A, B) if axis == "z" else (B, A)
    across = first / breadth if axis == "z" else (first - TOP + B) / breadth
    rest = 1.0 - across**2 - cap**2
    far = height * np.sqrt(np.maximum(rest, 0.0))
    if axis == "z":
        points = np.stack(np.broadcast_arrays(first, y, far + TOP - B), axis=-1)
    else:
        points = np.stack(np.broadcast_arrays(far if axis == "+x" else -far, y, first), axis=-1)
    return points, rest > 0


def bumped(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (..., 3) of the smooth finger and of the ridged one."""
    x, y, z = np.moveaxis(points, -1, 0)
    smooth = np.stack([x / A**2, np.maximum(y, 0.0) / CAP**2, (z - TOP + B) / B**2], axis=-1)
    smooth /= np.linalg.norm(smooth, axis=-1, keepdims=True)
    step = 1e-3
    slope = np.stack(
        [(ridges(points + step * e) - ridges(points - step * e)) / (2 * step) for e in np.eye(3)],
        axis=-1,
    )
    slope -= (slope * smooth).sum(-1, keepdims=True) * smooth
    ridged = smooth - slope
    return smooth, ridged / np.linalg.norm(ridged, axis=-1, keepdims=True)


def off_surface_mm(points: np.ndarray) -> np.ndarray:
    """Distance from the drawn finger as it lies in the picture, for points near to it."""
    x, y, z = np.moveaxis(points - np.array([0.0, 2.0, 0.0]), -1, 0)
    ellipsoid = (x / A) ** 2 + (np.maximum(y, 0) / CAP) ** 2 + ((z - TOP + B) / B) ** 2
    return (np.sqrt(ellipsoid) - 1.0) * 7.0


def shaded(points: np.ndarray, lights: list[tuple[np.ndarray, float]]) -> np.ndarray:
    smooth, normals = bumped(points)
    total = np.zeros(points.shape[:-1])
    for position, strength in lights:
        towards = position - points
        distance = np.linalg.norm(towards, axis=-1)
        facing = np.maximum((towards * normals).sum(-1), 0.0) * ((towards * smooth).sum(-1) > 0)
        total += strength * 1e4 * facing / distance**3
    return total


def image_of(position: np.ndarray, name: str) -> np.ndarray:
    """Reflected in a mirror: x - z = LEAN on the right, -x - z = LEAN on the left."""
    x, y, z = position
    sign = 1.0 if name == "right" else -1.0
    return np.array([sign * (z + LEAN), y, sign * x - LEAN])


def on_rays(start: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (..., 3) of the finger on rays, and which rays meet it."""
    met, hit = np.zeros(way.shape), np.zeros(way.shape[:-1], dtype=bool)
    for cap in (0.0, 1.0 / CAP):
        scale = np.array([1.0 / A, cap, 1.0 / B])
        p, d = (start - [0.0, 0.0, TOP - B]) * scale, way * scale
        a, b, c = (d * d).sum(-1), (p * d).sum(-1), (p * p).sum(-1) - 1.0
        root = b * b - a * c
        points = start + ((-b - np.sqrt(np.maximum(root, 0.0))) / a)[..., None] * way
        here = (root > 0) & ((points[..., 1] >= 0) == (cap > 0))
        met[here], hit = points[here], hit | here
    return met, hit


def perspective(
    names: tuple[str, ...] = ("left", "right"),
) -> tuple[Capture, dict[str, np.ndarray]]:
    """As :func:`capture`, under a camera 140 mm above the finger plane."""
    focal, (row, column) = PX * 140.0, (np.array(SIZE) - 1) / 2
    matrix = np.array([[focal, 0.0, column], [0.0, focal, row], [0.0, 0.0, 1.0]])
    near = replace(rig(names), camera=Camera(PX, SIZE, 140.0, "perspective", matrix))
    x = (np.arange(SIZE[1]) - column) / PX
    y = (row - np.arange(SIZE[0])) / PX
    way = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -140.0), axis=-1)
    start = np.array([0.0, -2.0, 140.0])
    views = {"front": (*on_rays(start, way), np.abs(x)[None] < 12.0, 1.0)}
    for name in names:
        sign = 1.0 if name == "right" else -1.0
        turned = np.stack([sign * way[..., 2], way[..., 1], sign * way[..., 0]], axis=-1)
        points, met = on_rays(image_of(start, name), turned)
        views[name] = (points, met, sign * x[None] > 13.0, 0.8)
    return _photographed(near, views, names)


def capture(names: tuple[str, ...] = ("left", "right")) -> tuple[Capture, dict[str, np.ndarray]]:
    """The capture, and masks by view."""
    x = (np.arange(SIZE[1]) - (SIZE[1] - 1) / 2) / PX
    y = ((SIZE[0] - 1) / 2 - np.arange(SIZE[0])) / PX
    x, y = np.meshgrid(x, y - 2.0)
    views = {"front": (*on_finger(x, y, "z"), np.abs(x) < A + 0.5, 1.0)}
    for name in names:
        sign = 1.0 if name == "right" else -1.0
        points, met = on_finger(sign * x - LEAN, y, "+x" if sign > 0 else "-x")
        inside = (sign * x > 14.0) & (sign * x < 36.0) & (np.abs(y + 2.0) < 14.0)
        views[name] = (points, met, inside, 0.8)
    return _photographed(rig(names), views, names)


def _photographed(
    rig: Rig, views: dict, names: tuple[str, ...]
) -> tuple[Capture, dict[str, np.ndarray]]:
    shift = np.array([0.0, 2.0, 0.0])  # the finger lies 2 mm further up in the picture
    masks, frames = {}, np.zeros((7, *SIZE))
    for name, (points, met, inside, strength) in views.items():
        mask = met & inside
        masks[name] = mask
        for k, led in enumerate(rig.leds):
            position = np.array(led.position_mm) - shift
            lights = [(position, 1.0), *((image_of(position, mirror), 0.8) for mirror in names)]
            frames[k][mask] = strength * shaded(points[mask], lights)
    pixels = np.round(60000 * frames / frames.max()).astype(np.uint16)[..., None]
    band = Band("white", pixels, tuple((k,) for k in range(7)), np.ones(7), np.zeros(7))
    return Capture(rig, {"white": band}, material="opaque"), masks


def body_between_mirrors(views: Views, rig: Rig) -> SimpleNamespace:
    """What the outlines determine: body, planes of the mirrors that are used, and which views are
    cut, or useless."""
    shape = mirror_shape(views, rig, cut_too=True)
    planes = {
        mirror.name: shape.plane(mirror) for mirror in rig.mirrors if mirror.name in shape.fit.poses
    }
    cut = tuple(name for name in shape.facts["views_cut_off"] if name in planes)
    return SimpleNamespace(
        body=shape.fit.body, planes=planes, cut=cut, useless=tuple(shape.facts["views_useless"])
    )


def views_of(capture: Capture, masks: dict[str, np.ndarray]) -> MirrorViews:
    """All views with their true masks and mirrors, and the body that fits their outlines."""
    built = {mirror.name: mirror for mirror in capture.rig.mirrors}
    sides = {name: mask for name, mask in masks.items() if name != "front"}
    with patch("splitknit.mirrors.mirror.SQUARENESS", 0.0):  # ellipses
        body = body_between_mirrors(Views(masks["front"], sides, 1), capture.rig).body
    glasses = {
        name: Glass(
            name,
            Plane(mirror.point_mm, mirror.normal),
            np.asarray(mirror.corners_mm),
            mirror.reflectance,
        )
        for name, mirror in built.items()
    }
    return MirrorViews(
        tuple(MirrorView(name, mask, glasses.get(name)) for name, mask in masks.items()), body
    )
