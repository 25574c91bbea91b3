"""An image that the reconstruction has not seen, predicted by what was found in the others; no
truth is needed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from splitknit import reconstruct
from splitknit.capture import Capture
from splitknit.errors import require
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.pixels import bin_mean
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.observation.observe import observe
from splitknit.photometric.near_light import pseudo_normals
from splitknit.presets import PipelineSettings
from splitknit.reconstruction import Reconstruction
from splitknit.skin.diffusion import diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import skin_images
from splitknit.skin.light import Lighting, fresnel_transmission, microfacet_glare, predict, slant_of

MIN_IMAGES = 5
"""Of the band: plain photometric stereo needs three, and one more leaves something to be
explained."""
RIDGE_BAND_MM = 0.3
"""Standard deviation of the Gaussian mean that ridges are relative to."""
FROM_OUTLINE_MM = 0.4
"""Nearer to the outline nothing is compared: light from beyond it is not predicted."""
DARK = 0.1
"""Pixels darker than this fraction of the image's median are not compared: they lie in shadow."""
SLANTS_DEG = (0, 20, 40, 60)
WAYS = ("model", "neighbours", "lambertian")
"""The reconstruction; the mean of the two lights next to it in azimuth; plain photometric
stereo."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFit:
    """What the reconstruction found, on the grid of the images."""

    points_mm: tuple[FloatArray, FloatArray, FloatArray]
    """(h, w) x, y, z in the rig's frame."""
    normals: FloatArray
    """(h, w, 3) means over each block, in the rig's frame."""
    slant_deg: FloatArray
    """(h, w) of the shape without its ridges."""
    optics: dict[str, Any] | None
    """As the reconstruction reports them; None where no scattering was undone."""


def without(capture: Capture, name: str, image: int) -> Capture:
    """The capture without one image of the band `name`; its LED stays in the rig, and lights
    nothing."""
    band = capture.bands[name]
    kept = [k for k in range(len(band.leds)) if k != image]
    rest = replace(
        band,
        pixels=band.pixels[kept],
        leds=tuple(band.leds[k] for k in kept),
        exposure=band.exposure[kept],
        black_level=band.black_level[kept],
        files=tuple(band.files[k] for k in kept) if band.files else (),
    )
    return replace(capture, bands={**capture.bands, name: rest})


def left_out(
    capture: Capture,
    name: str,
    image: int,
    settings: PipelineSettings,
    surface: Reconstruction | None = None,
) -> dict[str, Any]:
    """Figures of one image of the band `name`: every way of predicting it against the image itself,
    by channel.

    The surface is reconstructed from the other images, unless it is given: then the images were
    taken through crossed polarisers, of the same still finger, and no specular reflection is
    predicted.
    """
    count = len(capture.bands[name].leds)
    require(
        not capture.rig.colours_of(capture.bands[name].leds),
        f"the band '{name}' was lit by coloured LEDs; leave out a white one.",
    )
    require(
        count >= MIN_IMAGES,
        f"the band '{name}' has {count} images; leaving one out needs {MIN_IMAGES} at least.",
    )
    result = (
        reconstruct(without(capture, name, image), settings=settings)
        if surface is None
        else surface
    )
    same = result.mask.shape == capture.shape
    require(
        same,
        "the surface is of images of another size; take both captures with one camera and one rig.",
    )
    grid, band, fit = seen_and_found(capture, name, result, settings.metric.plane_mm)
    model, gloss = by_model(band, grid, fit, image, crossed=surface is not None)
    predicted = {
        "model": model,
        "neighbours": by_neighbours(band, image),
        "lambertian": by_lambertian(band, grid, image, settings.metric.plane_mm),
    }
    channels = {}
    for c, channel in enumerate(band.channels):
        seen = band.stack[c]
        ways = {way: stack[c] for way, stack in predicted.items()}
        channels[channel] = {
            way: figures(ways[way], seen, image, grid, fit.slant_deg) for way in WAYS
        }
    relief_by = fit.optics["relief_by"] if fit.optics else "photometric stereo"
    return {
        "band": name,
        "image": image,
        "relief_by": relief_by,
        "gloss": gloss,
        "channels": channels,
    }


def seen_and_found(
    capture: Capture, name: str, result: Reconstruction, plane_mm: float
) -> tuple[Grid, BandImages, SurfaceFit]:
    """All images of the band `name` on one grid, and on it what was found."""
    rows, columns = (np.flatnonzero(result.mask.any(axis=axis)) for axis in (1, 0))
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    lit = observe(capture)
    bands = tuple(lit.bands[n] for n in dict.fromkeys(("white", name)))
    grid, images, binning = skin_images(bands, window, result.mask[window])

    def on_grid(field: FloatArray) -> FloatArray:
        return bin_mean(np.nan_to_num(field[window]).astype(np.float32), binning) * grid.mask

    normals = np.stack([on_grid(result.normals[..., axis]) for axis in range(3)], axis=-1)
    height = on_grid(result.height_mm)
    shape = on_grid(result.shape_mm)
    if result.x_mm is not None and result.y_mm is not None:
        points = on_grid(result.x_mm), on_grid(result.y_mm), height
    else:
        points = grid.view.points(
            (height - height[grid.mask].mean() + np.float32(plane_mm)) * grid.mask
        )
    inner = np.where(grid.mask, shape, np.float32(np.nan)).astype(np.float32)
    slant = np.nan_to_num(slant_of(inner, grid.pitch_mm))
    return grid, images[-1], SurfaceFit(points, normals, slant, result.facts.get("optics"))


def by_model(
    band: BandImages, grid: Grid, fit: SurfaceFit, image: int, crossed: bool = False
) -> tuple[FloatArray, float]:
    """(C, L, h, w) all images by the surface and optics found; and the strength of the specular
    reflection.

    The albedo of every pixel, and that strength (over the one that was found; zero behind crossed
    polarisers), explain the other images best.
    """
    vectors = light_vectors_at(band.rig, *fit.points_mm)
    length = np.sqrt((vectors * vectors).sum(axis=1))
    unit = fit.normals / np.maximum(
        np.linalg.norm(fit.normals, axis=-1, keepdims=True), 1e-9
    ).astype(np.float32)
    cosine = np.einsum("lihw,hwi->lhw", vectors, unit) / np.maximum(length, np.float32(1e-12))
    rest = [k for k in range(len(vectors)) if k != image]
    trust = (
        np.clip((cosine[rest] - np.float32(0.05)) / np.float32(0.15), 0, 1) + np.float32(1e-3)
    ) * grid.mask
    if fit.optics is None:
        light = Lighting(vectors, np.ones_like(cosine), np.ones_like(cosine))
        matt = predict(light, grid, fit.normals, [np.ones((), np.float32)] * len(band.channels))
        return _albedo(matt[:, rest], band.stack[:, rest], trust)[:, None] * matt, 0.0
    light = Lighting(
        vectors, fresnel_transmission(np.maximum(cosine, np.float32(0.05))), np.ones_like(cosine)
    )
    per_mm = fit.optics["scattering_per_mm"], fit.optics["absorption_per_mm"]
    transfers = [
        grid.sampled(diffusion(*(p[channel] for p in per_mm))) for channel in band.channels
    ]
    diffuse = predict(light, grid, fit.normals, transfers)
    glare = fit.optics["glare"][band.channels[-1]]
    mirrored = microfacet_glare(unit, vectors) * np.float32(glare)

    def lacking(stack: FloatArray) -> FloatArray:
        """What no albedo explains."""
        albedo = _albedo(diffuse[:, rest], stack, trust)[:, None]
        return np.asarray((stack - albedo * diffuse[:, rest]) * trust, dtype=np.float32)

    alone = lacking(np.broadcast_to(mirrored[rest], diffuse[:, rest].shape))
    product = float((alone * lacking(band.stack[:, rest])).sum(dtype=np.float64))
    gloss = (
        0.0
        if crossed
        else max(product, 0.0) / max(float((alone * alone).sum(dtype=np.float64)), 1e-12)
    )
    mirrored = mirrored * np.float32(gloss)
    return _albedo(diffuse[:, rest], band.stack[:, rest] - mirrored[rest], trust)[
        :, None
    ] * diffuse + mirrored, gloss


def _albedo(expected: FloatArray, seen: FloatArray, trust: FloatArray) -> FloatArray:
    """(C, h, w) factor on `expected` (C, L, h, w) that explains `seen` best, by weighted least
    squares."""
    power = np.maximum((trust * expected * expected).sum(axis=1), np.float32(1e-9))
    return np.asarray((trust * expected * seen).sum(axis=1) / power, dtype=np.float32)


def by_neighbours(band: BandImages, image: int) -> FloatArray:
    """(C, L, h, w) the images, and for this one the mean of the two next to it, each over its
    light's brightness."""
    towards = band.rig.light_vectors()
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    turned = np.mod(azimuth - azimuth[image], 2 * np.pi)
    turned[image] = np.nan
    two = [int(np.nanargmin(turned)), int(np.nanargmax(turned))]
    size = np.linalg.norm(towards, axis=1).astype(np.float32)
    result = band.stack.copy()
    result[:, image] = np.mean([band.stack[:, k] * (size[image] / size[k]) for k in two], axis=0)
    return result


def by_lambertian(band: BandImages, grid: Grid, image: int, plane_mm: float) -> FloatArray:
    """(C, L, h, w) by a matt surface under near lights: a normal for each pixel, an albedo for each
    of its channels."""
    rest = [k for k in range(len(band.rig.leds)) if k != image]
    others = Rig(band.rig.camera, tuple(band.rig.leds[k] for k in rest))
    plane = np.full(grid.shape, plane_mm, dtype=np.float32)
    normals = pseudo_normals(
        band.stack[:, rest].sum(axis=0), others, plane, grid.mask, view=grid.view
    )
    vectors = grid.view.turned(light_vectors_at(band.rig, *grid.view.points(plane)))
    shading = np.maximum(np.einsum("lihw,hwi->lhw", vectors, normals), 0)[None]
    albedo = _albedo(shading[:, rest], band.stack[:, rest], grid.mask.astype(np.float32))
    return np.asarray(albedo[:, None] * shading, dtype=np.float32)


def figures(
    predicted: FloatArray, seen: FloatArray, image: int, grid: Grid, slant_deg: FloatArray
) -> dict[str, float]:
    """How well one image of `seen` (L, h, w) is predicted, after one scale factor.

    ``rms`` and ``rms_A_B`` (slants from A to B deg): root mean square of (predicted - seen) / seen.
    ``ridges``: fraction of the variance in the ridge band that is predicted: one less the mean
    square of what is left over that of the image. ``change``: the same of what the image's ridge
    band has beyond that of the mean of the other images: only there is the light's direction seen.
    ``gain``: that change in the image over the predicted one, by regression.
    """
    left_out_image = seen[image]
    rest = [k for k in range(len(seen)) if k != image]
    region = grid.mask & (grid.depth_mm > FROM_OUTLINE_MM) & (slant_deg < SLANTS_DEG[-1])
    region &= left_out_image > DARK * np.median(left_out_image[region])
    require(
        int(region.sum()) > 100, "too little of the finger is lit to compare a prediction with it."
    )
    scale = np.float32(
        np.median(left_out_image[region] / np.maximum(predicted[image][region], np.float32(1e-6)))
    )
    relative = (scale * predicted[image] - left_out_image) / np.maximum(
        left_out_image, np.float32(1e-6)
    )
    result = {"rms": _rms(relative[region])}
    for low, high in pairwise(SLANTS_DEG):
        part = region & (slant_deg >= low) & (slant_deg < high)
        if int(part.sum()) > 100:
            result[f"rms_{low}_{high}"] = _rms(relative[part])
    inner = cv2.erode(region.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    ridges, likely, always, expected = (
        ridge_band(field, region, grid)[inner]
        for field in (
            left_out_image,
            predicted[image],
            seen[rest].mean(axis=0),
            predicted[rest].mean(axis=0),
        )
    )
    result["ridges"] = 1 - _rms(likely - ridges) ** 2 / _rms(ridges) ** 2
    result["change"] = (
        1 - _rms(likely - expected - ridges + always) ** 2 / _rms(ridges - always) ** 2
    )
    result["gain"] = float(
        np.mean((ridges - always) * (likely - expected)) / np.mean((likely - expected) ** 2)
    )
    result["contrast"] = _rms(ridges)
    return result


def ridge_band(image: FloatArray, region: BoolArray, grid: Grid) -> FloatArray:
    """(h, w) what an image has beyond its mean over 0.3 mm, relative to that mean."""
    mean = grid.smooth(image, region, RIDGE_BAND_MM)
    return np.asarray(image / np.maximum(mean, np.float32(1e-6)) - 1, dtype=np.float32)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))
