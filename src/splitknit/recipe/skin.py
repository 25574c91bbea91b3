"""Our way from images of skin to a surface: grids, images on them, networks, and back to the input's pixels."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from splitknit.imaging import Window, has_colour, linear_channels
from splitknit.imaging.view import view_of
from splitknit.model import Band, BoolArray, Capture, FloatArray
from splitknit.networks.unet import load_network, run_network
from splitknit.recipe.finer import FACTOR, coarser, finer_grid, finer_images
from splitknit.recipe.finger import Finger
from splitknit.recipe.presets import PipelineSettings
from splitknit.recipe.stopwatch import Stopwatch
from splitknit.recipe.surfaces import SurfaceParts, facts_of, ridge_and_shape_bands
from splitknit.skin import Networks, can_learn, reconstruct_skin
from splitknit.skin.grid import BandImages, Grid

NO_NETWORK = (
    "the network of the relief needs six white lights all around the finger and at least 12 pixels a millimetre; "
    "relief and glare are told apart by their colours alone."
)
HOW = {
    "network": "glare and scattering by a network that was trained on simulated skin (modelled)",
    "colour": "glare by colour, scattering by its transfer function (modelled)",
}


def metric_skin(capture: Capture, finger: Finger, settings: PipelineSettings, watch: Stopwatch) -> SurfaceParts:
    """Near lights, glare told by its colour, the skin's blur undone: see :mod:`splitknit.skin`."""
    white, nir, warnings = ridge_and_shape_bands(capture, settings)
    with watch("light"):
        grid, bands, binning = skin_images(capture, finger, settings)
    able = can_learn(bands[0], grid.pitch_mm)
    finer = not able and settings.metric.relief == "network" and can_learn(bands[0], grid.pitch_mm / FACTOR)
    if finer:
        grid, bands, able = finer_grid(grid), tuple(finer_images(band) for band in bands), True
    networks = shipped_networks(settings) if able else None
    with watch("surface"):
        skin = reconstruct_skin(
            bands, grid, settings.skin, settings.metric, lambda share: watch.report("surface", share), networks
        )
    if not has_colour(white):
        warnings = (*warnings, "the white images are grey: glare cannot be told from skin by its colour.")
    elif not able and settings.metric.relief == "network":
        warnings = (*warnings, NO_NETWORK)
    size = finger.wider[finger.window].shape
    shape, ridge, albedo, deviation = (
        _enlarged(coarser(part) if finer else part, (size[0], size[1]), binning)
        for part in (skin.shape_mm, skin.relief_mm, skin.albedo, skin.deviation_mm)
    )
    facts = {
        **facts_of(capture, settings, white, nir),
        "separation": HOW[skin.facts["relief_by"]],
        "optics": skin.facts,
    }
    return SurfaceParts(shape + ridge, ridge, shape, albedo, deviation * np.float32(1000.0), facts, warnings)


def skin_images(
    capture: Capture, finger: Finger, settings: PipelineSettings
) -> tuple[Grid, tuple[BandImages, ...], int]:
    """Fine grid, linear images on it (the white band first), and how many pixels a side make one of its blocks."""
    white, nir, _ = ridge_and_shape_bands(capture, settings)
    binning = max(1, round(settings.metric.working_pitch_mm / capture.rig.camera.pitch_mm))
    names = ("red", "green", "blue") if has_colour(white) else ("green",)
    bands = [_images(capture, white, names, finger.window, binning)]
    if nir is not white:
        grey = linear_channels(nir, capture.encoding, ("grey",), finger.window, binning)
        bands.append(BandImages(("nir",), grey, capture.rig.select(nir.leds)))
    return _grid(capture, finger, binning), tuple(bands), binning


def shipped_networks(settings: PipelineSettings) -> Networks | None:
    """The networks of relief and shape, or None where the settings do without."""
    metric = settings.metric
    if metric.relief != "network":
        return None

    def runner(name: str) -> Callable[[FloatArray], FloatArray]:
        network = load_network(name)
        return lambda fields: run_network(network, fields[None], tile=metric.tile_px)[0]

    return Networks(runner(metric.network), runner(metric.shape_network) if metric.shape_network else None)


def _grid(capture: Capture, finger: Finger, binning: int) -> Grid:
    """The working grid: blocks of pixels that all belong to the finger."""
    rows, columns = finger.window
    mask = finger.wider[rows, columns]
    height, width = (n // binning for n in mask.shape)
    blocks = mask[: height * binning, : width * binning].reshape(height, binning, width, binning)
    inside: BoolArray = np.asarray(blocks.all(axis=(1, 3)), dtype=np.bool_)
    full = capture.shape
    cut = (
        rows.start == 0 and bool(inside[0].any()),
        rows.stop >= full[0] and bool(inside[-1].any()),
        columns.start == 0 and bool(inside[:, 0].any()),
        columns.stop >= full[1] and bool(inside[:, -1].any()),
    )
    view = view_of(capture.rig.camera, rows, columns, binning=binning, along_rays=True)
    return Grid(inside, view.x_mm, view.y_mm, capture.rig.camera.pitch_mm * binning, cut, view.apex_mm)


def _images(capture: Capture, band: Band, names: tuple[str, ...], window: Window, binning: int) -> BandImages:
    wanted = names if len(names) == 3 else ("grey",)
    return BandImages(
        names, linear_channels(band, capture.encoding, wanted, window, binning), capture.rig.select(band.lights)
    )


def _enlarged(field: FloatArray, shape: tuple[int, int], factor: int) -> FloatArray:
    """A field of blocks on the window's pixels."""
    if factor > 1:
        size = (field.shape[1] * factor, field.shape[0] * factor)
        field = np.asarray(cv2.resize(field, size, interpolation=cv2.INTER_CUBIC), dtype=np.float32)
    missing = ((0, shape[0] - field.shape[0]), (0, shape[1] - field.shape[1]))
    return np.pad(field, missing, mode="edge")
