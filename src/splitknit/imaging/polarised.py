"""Photographs behind linear films: light as without them, and the light that the surface itself reflects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.band import CHUNK_ROWS, linear_stack
from splitknit.imaging.geometry import bounding_box, wide_blur
from splitknit.model import Capture, FloatArray

NOT_SPECULAR = (
    "the crossed photographs are as bright as the parallel ones: were their folders exchanged, or did the camera "
    "change its exposure between the series?"
)
_EVEN_MM = 0.5
"""Over which a specular picture is made even: a ridge's period."""
_AS_ALIKE = 0.1
"""Of correlations: images whose LEDs lie halfway between two are as much like either."""
_FILMS_DEG = ((90, 45), (135, 0))
"""Of Sony's IMX250MZR and IMX250MYR: directions of the films on the pixels of a block of two rows and two columns."""


def without_films(capture: Capture) -> Capture:
    """The capture whose white light is the mean of its parallel and its crossed series, where it has both.

    Half of unpolarised light passes either analyser, so that the mean has half its brightness, and its shading.
    The mean is taken where images are made linear (:func:`splitknit.imaging.band.linear_channels`).

    Examples
    --------
    >>> import splitknit
    >>> capture = without_films(splitknit.read_capture("polarised"))  # doctest: +SKIP
    """
    crossed = capture.bands.get("white_crossed")
    if crossed is None:
        return capture
    return replace(capture, bands={**capture.bands, "white": replace(capture.bands["white"], crossed=crossed)})


def split_mosaic(mosaic: NDArray[Any], film_deg: float, *, colour: bool = False) -> tuple[NDArray[Any], NDArray[Any]]:
    """The parallel and the crossed image in one frame of a camera that has films on its pixels.

    The light behind films of four directions gives its Stokes parameters, and they the light behind a film of any
    direction: I(a) = (S0 + S1 cos 2a + S2 sin 2a) / 2. Light of each direction is interpolated to the middle of its
    block of 2 x 2 pixels first: an edge would seem polarised otherwise. Raises BadInput if the frame has several
    channels or sides that hold no whole blocks. Source: E. Collett, "Field Guide to Polarization", 2005: Stokes
    parameters, Malus's law.

    `mosaic`: (H, W) or (H, W, 1) uint8 or uint16, linear, blocks of 90, 45 / 135, 0 degrees (Sony IMX250MZR);
    `film_deg`: direction of the film before the LEDs, as the camera states its own: 0 along the rows; `colour`: whether
    the blocks lie behind a Bayer pattern (red, green / green, blue; Sony IMX250MYR). Returns (H / 2, W / 2, C) of the
    mosaic's type, the parallel image clipped where one of a block's pixels is.

    >>> import numpy as np
    >>> mirrored = np.tile(np.array([[200, 100], [100, 0]], np.uint8), (4, 4))  # polarised along 90 degrees
    >>> [int(image[2, 2, 0]) for image in split_mosaic(mirrored, film_deg=90.0)]
    [200, 0]
    """
    rows, columns, block = *mosaic.shape[:2], 4 if colour else 2
    require(
        mosaic.size == rows * columns and mosaic.dtype.kind == "u" and rows % block == 0 and columns % block == 0,
        f"a mosaic of films has one channel of integers and sides that are multiples of {block}, but it is "
        f"{mosaic.shape} {mosaic.dtype}.",
    )
    full = np.iinfo(mosaic.dtype).max
    light, clips = {}, np.zeros((rows // 2, columns // 2), dtype=np.bool_)
    for row, column in np.ndindex(2, 2):
        part = np.ascontiguousarray(mosaic.reshape(rows, columns)[row::2, column::2])
        clips |= part >= 0.985 * full
        if colour:
            part = cv2.cvtColor(part, cv2.COLOR_BayerRGGB2RGB)
        shift = np.array([[1, 0, 0.25 - 0.5 * column], [0, 1, 0.25 - 0.5 * row]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        light[_FILMS_DEG[row][column]] = cv2.warpAffine(
            part.astype(np.float32), shift, part.shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE
        ).reshape(rows // 2, columns // 2, -1)
    clips = cv2.dilate(clips.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0  # as far as light was interpolated
    total = (light[0] + light[45] + light[90] + light[135]) / 2
    angle = np.deg2rad(2 * film_deg)
    part = (light[0] - light[90]) * np.float32(np.cos(angle)) + (light[45] - light[135]) * np.float32(np.sin(angle))
    parallel, crossed = (np.clip(np.rint((total + sign * part) / 2), 0, full) for sign in (1, -1))
    parallel[clips] = full
    return parallel.astype(mosaic.dtype), crossed.astype(mosaic.dtype)


def separate_polarised(parallel: FloatArray, crossed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Specular and diffuse light of linear images through a parallel and a crossed analyser.

    What the surface reflects keeps its polarisation and passes the parallel analyser alone; half of what the skin has
    depolarised passes either. Light that was scattered once or twice stays in part with the specular light. Raises
    BadInput if the two differ in shape. Source: S. L. Jacques, J. C. Ramella-Roman and K. Lee, "Imaging skin pathology
    with polarized light", 2002.

    Parameters
    ----------
    parallel, crossed : (..., H, W) or (..., H, W, C) linear light of one exposure

    Returns
    -------
    specular, diffuse : of the same shape
        The difference, zero where noise makes it negative, and the crossed images as they are.

    Examples
    --------
    >>> specular, diffuse = separate_polarised(np.full((1, 4, 4), 0.5), np.full((1, 4, 4), 0.3))
    >>> float(specular[0, 0, 0].round(3)), float(diffuse[0, 0, 0])
    (0.2, 0.3)
    """
    require(
        parallel.shape == crossed.shape,
        f"parallel and crossed images must have one shape, but they have {parallel.shape} and {crossed.shape}.",
    )
    return np.maximum(parallel - crossed, np.float32(0.0)), crossed


def doubts_of_series(parallel: FloatArray, crossed: FloatArray, mask: NDArray[np.bool_]) -> tuple[str, ...]:
    """Warnings where two series (L, H, W) are exchanged, or images of theirs were not lit from the same sides."""
    series = [np.maximum(stack[:, mask], np.float32(1e-6)) for stack in (parallel, crossed)]
    if series[1].mean() >= series[0].mean():
        return (NOT_SPECULAR,)
    shares = [light / light.mean(axis=0) for light in series]  # what shows from where each image was lit
    alike = np.corrcoef(*shares)[: len(parallel), len(parallel) :]
    wrong = np.flatnonzero(np.diag(alike) < alike.max(axis=0) - _AS_ALIKE)
    return tuple(
        f"crossed image {k} is lit as parallel image {int(alike[:, k].argmax())} is, not as image {k}: list both "
        "series in the same order of lights."
        for k in wrong[:1].tolist()
    )


def specular_picture(specular: FloatArray, mask: NDArray[np.bool_], sigma_px: float) -> FloatArray:
    """One specular image of all lights, of even brightness and contrast: the most legible picture of a finger.

    Parameters
    ----------
    specular : (L, H, W) specular light, or (1, H, W) its mean
    mask : (H, W) where it is looked at
    sigma_px : standard deviation, in pixels, of the Gaussian over which brightness and contrast are made even; about a
        ridge's period

    Returns
    -------
    (H, W) float32
        Standard deviations from the local mean, NaN outside the mask. Bright is skin that is turned towards half the
        angle between camera and a light: where it faces the camera, both flanks of a ridge; elsewhere one of them.

    Examples
    --------
    >>> specular_picture(np.random.default_rng(0).random((7, 40, 40)), np.ones((40, 40), bool), 5.0).shape
    (40, 40)
    """
    light = np.asarray(specular.mean(axis=0), dtype=np.float32)
    weight = mask.astype(np.float32)

    def smooth(values: FloatArray) -> FloatArray:
        return np.asarray(wide_blur(values * weight, sigma_px) / around, dtype=np.float32)

    around = np.asarray(np.maximum(wide_blur(weight, sigma_px), np.float32(1e-3)), dtype=np.float32)
    detail = light - smooth(light)
    contrast = np.sqrt(smooth(detail * detail))
    least = np.float32(1e-3) * max(float(contrast[mask].max(initial=0.0)), 1e-9)
    return np.where(mask, detail / np.maximum(contrast, least), np.float32(np.nan))


def specular_of(capture: Capture, mask: NDArray[np.bool_]) -> FloatArray | None:
    """The :func:`specular_picture` (H, W) of a capture of :func:`without_films` inside `mask`; None without films."""
    white = capture.bands["white"]
    if white.crossed is None:
        return None
    rows, columns = bounding_box(mask)
    specular = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
    for top in range(rows.start, rows.stop, CHUNK_ROWS):  # of all images a few rows at a time
        window = (slice(top, min(top + CHUNK_ROWS, rows.stop)), columns)
        series = (
            linear_stack(band, capture.encoding, "grey", window)
            for band in (replace(white, crossed=None), white.crossed)
        )
        specular[top - rows.start : window[0].stop - rows.start] = separate_polarised(*series)[0].mean(axis=0)
    picture = np.full(mask.shape, np.nan, dtype=np.float32)
    sigma_px = _EVEN_MM * capture.rig.camera.px_per_mm
    picture[rows, columns] = specular_picture(specular[None], mask[rows, columns], sigma_px)
    return picture


def picture_bytes(picture: FloatArray) -> NDArray[np.uint8]:
    """A specular picture (H, W) in 8 bits: its local mean 102, a standard deviation 51, 0 where it is not known."""
    return np.where(np.isfinite(picture), np.clip(np.nan_to_num(51 * picture + 102), 1, 255), 0).astype(np.uint8)
