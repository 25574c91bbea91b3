"""A whole capture of a finger between mirrors, with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splitknit import Camera, Capture, Mirror, Rig
from splitknit.errors import require
from splitknit.model import Array, BoolArray
from splitknit_simulator.camera.lens import picture_on_plane
from splitknit_simulator.finger.finger import (
    FingerPose,
    PoseRanges,
    SimulatedFinger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.raycast import PlacedFinger, Placement
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import SkinMap, skin_map
from splitknit_simulator.light.skin import SkinOptics
from splitknit_simulator.mirror_scene import MirrorScene
from splitknit_simulator.mirror_view import ReflectedView, as_built, mirror_view
from splitknit_simulator.rigs import mirror_rig, stop_y_mm
from splitknit_simulator.scene import TwinSettings, places_truth, surface_truth, take_capture
from splitknit_simulator.surface import Truth, soft_step


def rig_with_mirrors(settings: TwinSettings) -> Rig:
    """Return the rig as drawn: the one that is given, else the thesis's with a camera that sees the
    mirrors too."""
    views = settings.mirrors
    if settings.rig is None:
        return mirror_rig(views, settings.scale, settings.rig_seed)
    rig, names = settings.rig, [mirror.name for mirror in settings.rig.mirrors]
    unknown = [name for name in views.names if name not in names]
    require(
        not unknown,
        f"the rig has no {unknown[0] if unknown else ''} mirror; it has"
        f" {', '.join(names) or 'none'}: add it to the rig file, or leave out the rig.",
    )
    mirrors = tuple(
        mirror for mirror in rig.mirrors if not views.names or mirror.name in views.names
    )
    return replace(rig, leds=views.leds_of(rig), mirrors=mirrors)


def poses_between_mirrors(ranges: PoseRanges, settings: TwinSettings, camera: Camera) -> PoseRanges:
    """The ranges with the tip at its stop, unless they or the rig are given."""
    if settings.rig is not None or ranges.insertion_mm != PoseRanges().insertion_mm:
        return ranges
    stop = stop_y_mm(camera) - picture_on_plane(camera)[1]
    low, high = 28.7, 30.3  # mm, from the lower image border to the tip; cut to the tip's stop
    return replace(ranges, insertion_mm=(min(low, stop), min(high, stop)))


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What a seed stands for."""

    finger: SimulatedFinger
    pose: FingerPose
    rig: Rig
    skin: SkinOptics
    photo_seed: np.random.SeedSequence  # seed of background and noise


def photograph_between_mirrors(
    drawn: Drawn, seed: int, settings: TwinSettings
) -> tuple[Capture, Truth]:
    """Photograph a finger between the mirrors of a rig under every LED; the truth's arrays:
    ``docs/explain/simulator.md``.

    The capture's rig has the mirrors as drawn; they truly stand a little elsewhere, by `seed`.
    Raises BadInput if a mirror shows nothing of the finger, or the finger touches one.
    """
    finger, pose, rig, skin = drawn.finger, drawn.pose, drawn.rig, drawn.skin
    camera, views = rig.camera, settings.mirrors
    mirrors = as_built(rig.mirrors, views, seed)
    body, master = FingerBody(finger.shape), finger.master()
    worn = _bare_behind(skin_map(master, finger.skin), body, views.ridges_to_deg)
    placement = placement_of(body, pose, camera)
    for mirror in mirrors:
        _check_apart(body, placement, mirror)
    workers = settings.render.workers
    surface = finger_surface(
        replace(finger, printed=master), pose, camera, workers=workers, skin=worn
    )
    placed = PlacedFinger(body, worn, placement)
    seen = [mirror_view(placed, camera, mirror, workers=workers) for mirror in mirrors]
    background_seed, noise_seed = drawn.photo_seed.spawn(2)
    scene = MirrorScene((surface, rig, skin), seen, settings, background_seed)
    truth = surface_truth(surface)
    if surface.chart is not None:
        truth["chart_mm"] = surface.chart
    truth |= _view_truth(seen, scene.masks)
    capture = take_capture(scene.front, scene.photograph, noise_seed, truth)
    truth |= _body_truth(body, worn, placement, views.truth_pitch_mm)
    return capture, truth


def _bare_behind(skin: SkinMap, body: FingerBody, ridges_to_deg: float) -> SkinMap:
    """Let the ridged skin end at an angle from the pad's top, at the sides as at the tip: the back
    has no ridges.

    The map grows, as it would be continued, so that it reaches all around the finger.
    """
    if ridges_to_deg >= 180.0:
        return skin
    shape = body.shape
    y = np.array([0.5 * shape.length_mm])
    edge = _section_points(body, y, np.array([np.deg2rad(ridges_to_deg)]))
    # where the master print ends, its continuation has ridges that meet at angles: they are to be
    # faint there
    limit = min(float(body.distance_and_chart(*edge)[1][0]), -skin.u0_mm - 0.5)
    reach = shape.length_mm - shape.tip_length_mm
    # how far the skin's map exceeds the master print, to either side and beyond the tip, in mm
    around, over_tip = (int(np.ceil(wide / skin.pitch_mm)) for wide in (12.0, 10.0))
    grown = ((over_tip, 0), (around, around))
    coefficients = np.asarray(np.pad(skin.coefficients, grown, mode="reflect"), dtype=np.float64)
    pigment = np.asarray(np.pad(skin.pigment, grown, mode="reflect"), dtype=np.float32)
    u0, v0 = skin.u0_mm - around * skin.pitch_mm, skin.v0_mm + over_tip * skin.pitch_mm
    rows, columns = coefficients.shape
    across = u0 + skin.pitch_mm * np.arange(columns)
    beyond = np.maximum(v0 - skin.pitch_mm * np.arange(rows) - reach, 0.0)
    arc = np.hypot(across[None, :], beyond[:, None])
    fraction = soft_step(0.5 - (arc - limit) / 3.0)  # ridges fade over 3 mm
    shaded = np.asarray(1.0 - fraction * (1.0 - pigment), dtype=np.float32)
    return replace(skin, coefficients=coefficients * fraction, pigment=shaded, u0_mm=u0, v0_mm=v0)


def _check_apart(body: FingerBody, placement: Placement, mirror: Mirror) -> None:
    along, around = np.meshgrid(
        np.linspace(-20.0, body.shape.length_mm - 1e-3, 60),
        np.linspace(-np.pi, np.pi, 72, endpoint=False),
    )
    points = np.stack(_section_points(body, along.ravel(), around.ravel()), axis=-1)
    points = points @ placement.rotation.T + placement.shift
    gap = (points - mirror.point_mm) @ mirror.normal
    require(
        gap.min() > 0.3,
        f"the finger touches the {mirror.name} mirror; move the finger away or set the mirror"
        " further off.",
    )


# What the twin knows of a finger between mirrors: the views, the true mirrors, the skin all around.


def _view_truth(views: Sequence[ReflectedView], masks: Sequence[BoolArray]) -> Truth:
    """The true mirrors, and what each view shows where `masks` (H, W) leave it visible: behind its
    mirror."""
    truth: Truth = {"mirror_names": np.array([view.mirror.name for view in views])}
    for view, mask in zip(views, masks, strict=True):
        mirror, surface = view.mirror, view.surface
        arrays = {
            "height_mm": (surface.height_mm, np.nan),
            "shape_mm": (surface.shape_mm, np.nan),
            "normals": (surface.normals, 0.0),
            "relief_um": (surface.relief_um, 0.0),
            "chart_mm": (surface.chart, np.nan),
            **{name: (place, np.nan) for name, place in places_truth(surface).items()},
        }
        truth[f"view_{mirror.name}_mask"] = mask
        for key, (array, empty) in arrays.items():
            if array is not None:
                truth[f"view_{mirror.name}_{key}"] = np.where(
                    mask if array.ndim == mask.ndim else mask[..., None], array, np.float32(empty)
                )
        for key in ("corners_mm", "normal", "point_mm", "reflectance"):
            truth[f"mirror_{mirror.name}_{key}"] = np.asarray(getattr(mirror, key))
    return truth


def _body_truth(body: FingerBody, skin: SkinMap, placement: Placement, pitch_mm: float) -> Truth:
    """The whole finger on a grid of places along it and angles around it, in the rig's frame.

    Rows are evenly spaced along the finger's axis, from behind the first crease to the tip; columns
    are evenly spaced angles about the axis of the section, 0 at the pad's top, positive towards the
    finger's +x.
    """
    shape = body.shape
    along = np.arange(-6.0, shape.length_mm, pitch_mm)  # from 6 mm beyond the first crease
    around = 2 * max(8, round(0.5 * 2.0 * np.pi * 0.5 * shape.width_mm / pitch_mm))
    angle = (np.arange(around) + 0.5) / around * 2.0 * np.pi - np.pi
    y, theta = (grid.ravel() for grid in np.meshgrid(along, angle, indexing="ij"))
    points = _section_points(body, y, theta)
    _, gx, gy, gz = body.value_and_gradient(*points)
    normals = placement.normal_to_camera(gx, gy, gz)
    _, u, v = body.distance_and_chart(*points)
    relief = skin.displacement(u, v)
    smooth = np.stack(points, axis=-1) @ placement.rotation.T + placement.shift
    skinned = smooth + relief[:, None] * normals
    size = along.size, angle.size
    return {
        "body_y_mm": along,
        "body_theta_rad": angle,
        "body_shape_mm": smooth.reshape(*size, 3).astype(np.float32),
        "body_points_mm": skinned.reshape(*size, 3).astype(np.float32),
        "body_normals": normals.reshape(*size, 3).astype(np.float32),
        "body_chart_mm": np.stack([u, v], axis=-1).reshape(*size, 2).astype(np.float32),
        "body_relief_um": (1e3 * relief).reshape(size).astype(np.float32),
        "body_rotation": placement.rotation,
        "body_shift_mm": placement.shift,
    }


def _section_points(body: FingerBody, y: Array, theta: Array) -> tuple[Array, Array, Array]:
    """x, y, z (N,) in the finger's frame of the smooth skin at places `y` and angles `theta` about
    the axis."""
    axis, drop = body.axis_line(y)
    sine, cosine = np.sin(theta), np.cos(theta)

    def value_and_rise(radius: Array) -> tuple[Array, Array]:
        value, gx, _, gz = body.value_and_gradient(axis + radius * sine, y, drop + radius * cosine)
        return value, gx * sine + gz * cosine

    low, high = (
        np.zeros_like(y),
        np.full_like(y, 1.5 * max(body.shape.width_mm, body.shape.thickness_mm)),
    )
    for _ in range(8):  # bisection: the sections are star-shaped about the axis
        middle = 0.5 * (low + high)
        inside = value_and_rise(middle)[0] < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    radius = high
    # Newton from outside, where the function rises more steeply than it needs to
    for _ in range(5):
        value, rise = value_and_rise(radius)
        radius = np.clip(radius - value / np.maximum(rise, 1e-9), low, high)
    return axis + radius * sine, y, drop + radius * cosine
