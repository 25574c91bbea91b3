"""Photometric stereo under near LEDs, for a known (current) surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.errors import require
from splitknit.imaging.chunks import for_each_chunk, gather
from splitknit.imaging.light_field import light_vectors_at, surface_array
from splitknit.imaging.view import View, view_of
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import (
    back_substitute,
    factorise,
    moment_matrix,
    moment_vector,
    surface_by_chunks,
)
from splitknit.photometric.forward import Explanation, glossy_fit
from splitknit.photometric.robust import robust_fit


@dataclass(frozen=True, slots=True, eq=False)
class _NearScene:
    """What a chunk of rows is cut from."""

    images: FloatArray
    """(C, L, H, W)."""
    rig: Rig
    surface: FloatArray
    mask: BoolArray
    view: View

    def cut(self, chunk: slice) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Mask (h, W) of some rows, and the light vectors (L, 3, n) and images (C, L, n) of its n
        pixels."""
        here = self.mask[chunk]
        z = np.where(here, self.surface[chunk], 0.0)
        x, y, z = self.view.points(z, chunk)
        lights = self.view.turned(
            light_vectors_at(self.rig, x[here], y[here], z[here]), chunk, here
        )
        return here, lights, np.stack([gather(channel, chunk, here) for channel in self.images])


def near_light(
    stack: Any,
    rig: Rig,
    surface_mm: Any,
    mask: Any = None,
    view: View | None = None,
    *,
    gloss: Explanation | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo with a light vector of its own for every pixel, from LED positions and the
    current surface.

    Parameters
    ----------
    stack : (L, H, W) float32
        Linear light; image k is lit by `rig.leds[k]`.
    rig : Rig
        LEDs at positions (inverse square, lobe) or at directions, several together where they share
        an exposure.
    surface_mm : (H, W) or a number
        z of the current surface in mm; NaN is allowed outside the mask. The result depends on it
        weakly: 1 mm at 140 mm turns a light by less than 0.2 deg.
    mask : (H, W) bool, optional
        The surface; by default where `surface_mm` is finite.
    view : View, optional
        Where the pixels look, for a window or binned images; the camera's own by default. If it is
        one along the rays, `surface_mm` is the height along them and the normals are those of the
        pixels' own frames (:mod:`splitknit.imaging.view`).
    gloss : Explanation, optional
        Lobe of a surface that shines (:func:`splitknit.photometric.forward.fitted_gloss`); without
        it the surface is matt.

    Returns
    -------
    normals : (H, W, 3) float32
        Unit vectors; zero outside the mask, (0, 0, 1) where all images are black.
    albedo : (H, W) float32
        In units of the images at a light of strength one (the mean LED at the origin); NaN outside
        the mask.

    Raises
    ------
    BadInput
        If shapes or numbers disagree, values are not finite inside the mask, or the lights are
        fewer than three, duplicate or coplanar.

    References
    ----------
    Y. Queau, B. Durix, T. Wu, D. Cremers, F. Lauze and J.-D. Durou, "LED-based photometric stereo:
    modeling, calibration and numerical solution", JMIV 60 (2018), eq. 2.5 and 3.1.
    """
    scene = _near_scene(check_stack(stack, least=3)[None], rig, surface_mm, mask, view)

    def solved(chunk: slice, _: BoolArray) -> FloatArray:
        _, lights, images = scene.cut(chunk)
        if gloss is not None:
            return glossy_fit(images[0], lights, gloss)
        return robust_fit(images[0], lights)

    return surface_by_chunks(scene.mask, scene.images.shape[1], solved)


def pseudo_normals(
    stack: Any,
    rig: Rig,
    surface_mm: Any,
    mask: Any = None,
    weights: Any = None,
    *,
    view: View | None = None,
    entering: Any = None,
) -> FloatArray:
    """Albedo times normal, (H, W, 3), zero outside the mask: linear in the images for given
    weights.

    Parameters
    ----------
    stack : (L, H, W) or (C, L, H, W) linear light
        Several channels share one factorisation.
    rig, surface_mm, mask, view
        As of :func:`near_light`.
    weights : (L, H, W), 0 or more, optional
        What each light counts at each pixel; without them all count equally.
    entering : (L, H, W), 0 or more, optional
        Fraction of each light that enters the surface at each pixel (Fresnel); all of it without.

    Returns
    -------
    (H, W, 3) or (C, H, W, 3) float32
        Length: the albedo, relative; direction: out of the skin.

    Raises
    ------
    BadInput
        As :func:`near_light`, and if weights or fractions have another shape, or are negative or
        not finite.
    """
    array = np.asarray(stack)
    channels = array.ndim == 4
    images = check_stack(array.reshape(-1, *array.shape[-2:]) if channels else array, least=3)
    colours = array.shape[0] if channels else 1
    count, (rows, columns) = images.shape[0] // colours, images.shape[1:]
    grouped = images.reshape(colours, count, rows, columns)
    scene = _near_scene(grouped, rig, surface_mm, mask, view)
    shape = count, rows, columns
    trusted = None if weights is None else _check_weights(weights, shape, "weights")
    let_in = None if entering is None else _check_weights(entering, shape, "entering")
    # a plane a component: faster to write and read
    planes = np.zeros((colours, 3, rows, columns), dtype=np.float32)

    def work(chunk: slice) -> None:
        if not scene.mask[chunk].any():
            return
        here, lights, part = scene.cut(chunk)
        if let_in is not None:
            lights = lights * gather(let_in, chunk, here)[:, None]
        trust = None if trusted is None else gather(trusted, chunk, here)
        factors = factorise(moment_matrix(lights, trust))  # one serves all channels
        for channel, image in zip(planes, part, strict=True):
            g = back_substitute(factors, moment_vector(image, lights, trust))
            for room, values in zip(channel[:, chunk], g, strict=True):
                room[here] = values

    for_each_chunk(work, rows, columns, count)
    result = np.moveaxis(planes, 1, -1)
    return result if channels else result[0]


def _near_scene(
    images: FloatArray, rig: Rig, surface_mm: Any, mask: Any, view: View | None
) -> _NearScene:
    """Check what near lights shine on; parameters and errors as for :func:`near_light`."""
    count, shape = images.shape[1], (images.shape[2], images.shape[3])
    check_lights(rig.light_vectors(), count, name="the rig's lights")
    surface = surface_array(surface_mm, shape)
    finite = np.isfinite(surface)
    inside = finite if mask is None else check_mask(mask, shape)
    require(inside.any(), "surface_mm is NaN everywhere: there is no surface to light.")
    require(
        finite[inside].all(),
        "surface_mm contains NaN or infinite values inside the mask; fill them or take those pixels"
        " out of the mask.",
    )
    view = view_of(rig.camera) if view is None else view
    pixels = np.broadcast_shapes(*(axis.shape for axis in view.on_plane()))
    require(
        pixels == shape,
        f"the view is of {pixels} pixels, but the images have {shape}; give the `view` of a part of"
        " the image.",
    )
    heights = [led.position_mm[2] for led in rig.leds if led.position_mm is not None]
    require(
        float(surface.max(where=inside, initial=-np.inf)) < min(heights, default=np.inf),
        "surface_mm reaches the LEDs; it must be in mm above the finger plane.",
    )
    return _NearScene(images, rig, surface, inside, view)


def _check_weights(weights: Any, shape: tuple[int, int, int], name: str) -> FloatArray:
    array = np.asarray(weights, dtype=np.float32)
    require(
        array.shape == shape,
        f"{name} must have the shape {shape}, but it has the shape {array.shape}.",
    )
    require(
        np.isfinite(array).all() and float(array.min()) >= 0,
        f"{name} must be finite and not negative.",
    )
    return array
