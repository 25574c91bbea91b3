"""Images of skin on the working grid of the `metric` method, the networks for them, and the way
back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from math import ceil
from typing import Annotated, Literal

import cv2
import numpy as np

from splitknit.findings import Finding
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.pixels import Window, bin_mean, block_means
from splitknit.imaging.view import view_of
from splitknit.model import Array, BoolArray, Camera, FloatArray, Rig
from splitknit.networks.unet import load_network, run_network
from splitknit.observation.films import contrast
from splitknit.observation.light import Light
from splitknit.settings import Checked, Limits
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.learned import Networks, can_learn
from splitknit.steps import step


@dataclass(frozen=True, slots=True)
class MetricSettings(Checked):
    """Grids and iterations of the `metric` preset on skin."""

    plane_mm: float = 1.0
    """Assumed mean height of the visible skin above the finger plane (it moves the lights only)."""
    rounds: Annotated[int | None, Limits(1)] = None
    """Number of relief estimates; networks refine the shape between two of them. None: three behind
    films with lights to the side, else two."""
    coarse_steps: Annotated[int, Limits(1)] = 3
    """Gauss-Newton steps of the shape on the coarse grid."""
    relief: Literal["network", "shading"] = "network"
    """``network``, or ``shading``: ridges from the shading of one channel alone, blue. Grey images,
    and rigs with too few lights for the network, are always reconstructed by shading."""
    network: str = "relief"
    """Name of a network in the package, or path of an ``.onnx`` file with its card beside it."""
    shape_network: str = "shape"
    """The same for the network that refines the shape in the last round; empty: none."""


NO_NETWORK = (
    "the network of the relief needs six white lights all around the finger and at least 12 pixels"
    " a millimetre; ridges follow from the shading of one channel."
)
GREY = "the white images are grey: glare is indistinguishable from skin by its colour."
SEPARATED_BY = {
    "network": "glare and scattering by a network that was trained on simulated skin (modelled)",
    "shading": "scattering by its transfer function (modelled), glare not separated",
    "polarised": "specular reflection by crossed films, ridges from its image (measured)",
    "side": "specular reflection by its colour, ridges from its image and a network (modelled)",
}


@dataclass(frozen=True, slots=True, eq=False)
class SkinImages:
    """Linear images of the finger's window on the working grid."""

    grid: Grid
    bands: tuple[BandImages, ...]  # the white band first
    crossed: BandImages | None
    """The white band behind crossed films, where it was photographed so too, without what films
    leak of specular light; `bands` are as without films."""
    # the rig of the white band's own LEDs; those of a crossed series may stand beside them
    parallel: Rig
    side: tuple[BandImages, BandImages | None, Rig] | None
    """The same three for the lights to the side of the finger: both series' mean, crossed, rig of
    the parallel ones. Without films only where the networks can read the images."""
    networks: Networks | None  # relief and shape network, where they can read the images
    binning: float  # pixels a side that make a block of the camera's grid
    # whether the working grid has half the blocks' pitch, so that the networks can read it
    finer: bool
    place: Window  # rows and columns of the window that the grid covers: those of the finger
    size: tuple[int, int]  # rows, columns of the window
    findings: tuple[Finding, ...]

    def on_pixels(self, field: FloatArray) -> FloatArray:
        """A field of the working grid on the window's pixels."""
        if self.finer:
            field = bin_mean(field, FACTOR)
        if self.binning > 1:
            by = self.binning
            field = np.asarray(cv2.resize(field, None, fx=by, fy=by, interpolation=cv2.INTER_CUBIC))
        covered = field[tuple(slice(part.stop - part.start) for part in self.place)]
        before = np.array([part.start for part in self.place])
        after = np.array(self.size) - before - covered.shape
        return np.pad(covered, np.stack([before, after], axis=1), mode="edge")


@step("light")
def working_images(
    bands: tuple[Light, ...],
    beside: Light | None,
    window: Window,
    inside: BoolArray,
    settings: MetricSettings,
) -> SkinImages:
    """Linear images on a grid that the networks can read, where there is one; and the networks.

    `bands`: the white one, and the near-infrared one if there is one; `beside`: the white light
    from the side of the finger; `window`: of the finger;
    `inside`: (h, w) pixels of it that are reconstructed.
    """
    # 0.1 mm beside the outline, for speed
    rows, columns = bounding_box(inside, round(0.1 * bands[0].built.camera.px_per_mm))
    top, left = window[0].start, window[1].start
    of_finger = (
        slice(top + rows.start, top + rows.stop),
        slice(left + columns.start, left + columns.stop),
    )
    grid, images, binning = skin_images(bands, of_finger, inside[rows, columns])
    white = bands[0].at(binning, of_finger)
    crossed = _crossed(white, images[0])
    wanted = settings.relief == "network"
    coarse = not can_learn(images[0], grid.pitch_mm)
    finer = wanted and coarse and can_learn(images[0], grid.pitch_mm / FACTOR)
    readable = finer or not coarse

    def fine(band: BandImages) -> BandImages:
        return finer_images(band) if finer else band

    side = None
    if beside is not None and (crossed is not None or (wanted and readable)):
        light = beside.at(binning, of_finger)
        both = BandImages(images[0].channels, light.stack, light.rig)
        of_side = _crossed(light, both)
        side = fine(both), of_side and fine(of_side), replace(light, crossed=None).rig
    findings: tuple[Finding, ...] = ()
    if not white.has_colour:
        findings = (Finding("grey-photographs", GREY),)
    elif wanted and not readable:
        findings = (Finding("no-network", NO_NETWORK),)
    return SkinImages(
        grid=finer_grid(grid) if finer else grid,
        bands=tuple(map(fine, images)),
        crossed=crossed and fine(crossed),
        parallel=replace(white, crossed=None).rig,
        side=side,
        networks=shipped_networks(settings) if readable else None,
        binning=binning,
        finer=finer,
        place=(rows, columns),
        size=(inside.shape[0], inside.shape[1]),
        findings=findings,
    )


def _crossed(light: Light, both: BandImages) -> BandImages | None:
    """The crossed series beside the mean of `both`, where there is one, without the specular light
    that films leak."""
    if light.crossed is None:
        return None
    stack = light.crossed.stack
    for k, film_contrast in enumerate(contrast(light.built.films, light).astype(np.float32)):
        stack[:, k] -= (1 / film_contrast - 1) * (both.stack[:, k] - stack[:, k])
    return BandImages(both.channels, stack, light.crossed.rig)


WORKING_PITCH_MM = 0.0264
"""Pitch of the fine grid. The skin's blur leaves less than 2 % of any finer detail, and the
networks were trained near it."""


def skin_images(
    bands: tuple[Light, ...],
    window: Window,
    inside: BoolArray,
    pitch_mm: float = WORKING_PITCH_MM,
) -> tuple[Grid, tuple[BandImages, ...], float]:
    """Grid of about `pitch_mm`, linear images on it, and how many pixels a side make one of its
    blocks. Parameters as for :func:`working_images`.
    """
    camera = bands[0].built.camera
    binning = max(1.0, round(8 * pitch_mm / camera.pitch_mm) / 8)
    white, *others = (light.at(binning, window) for light in bands)
    channels = white.channels if white.has_colour else ("green",)
    images = [BandImages(channels, white.stack, white.rig)]
    images += [BandImages(("nir",), nir.grey[None], nir.rig) for nir in others]
    return _grid(camera, window, inside, binning), tuple(images), binning


def shipped_networks(settings: MetricSettings) -> Networks | None:
    """The networks of relief and shape, or None where the settings do without."""
    if settings.relief != "network":
        return None

    def runner(name: str) -> Callable[[FloatArray], FloatArray]:
        network = load_network(name)
        return lambda fields: run_network(network, fields[None], tile=704)[0]

    return Networks(
        runner(settings.network), runner(settings.shape_network) if settings.shape_network else None
    )


def _grid(camera: Camera, window: Window, mask: BoolArray, binning: float) -> Grid:
    """The working grid: blocks of pixels that all belong to the finger."""
    rows, columns = window
    height, width = (int(n // binning) for n in mask.shape)
    covered = mask[: ceil(height * binning), : ceil(width * binning)].astype(np.float32)
    if binning > 1:
        covered = block_means(covered, (height, width), binning)
    inside: BoolArray = covered > 0.999
    cut = (
        rows.start == 0 and bool(inside[0].any()),
        rows.stop >= camera.image_size[0] and bool(inside[-1].any()),
        columns.start == 0 and bool(inside[:, 0].any()),
        columns.stop >= camera.image_size[1] and bool(inside[:, -1].any()),
    )
    view = view_of(camera, rows, columns, binning=binning, along_rays=True)
    return Grid(inside, view.x_mm, view.y_mm, camera.pitch_mm * binning, cut, view.apex_mm)


# Images of a coarse camera on a grid twice as fine.
#
# The networks were trained on pixels of 17 to 41 um. A camera of 12 to 25 pixels a millimetre shows
# ridges well enough (6 to 11 pixels a period), in pixels that are too large for them: the images
# are interpolated to half the pitch.

FACTOR = 2
"""Pixels of the finer grid on a side of a pixel. Source: definition."""


def finer_grid(grid: Grid) -> Grid:
    """The grid with each of its pixels divided into 2 x 2."""
    mask = grid.mask.repeat(FACTOR, axis=0).repeat(FACTOR, axis=1)
    x, y = (reduce(_halved, range(places.ndim), places) for places in (grid.x_mm, grid.y_mm))
    return Grid(mask, x, y, grid.pitch_mm / FACTOR, grid.cut, grid.apex_mm)


def finer_images(band: BandImages) -> BandImages:
    """Images of a band on :func:`finer_grid`, bicubic."""
    height, width = band.stack.shape[2:]
    shape = height * FACTOR, width * FACTOR
    fine = np.empty((*band.stack.shape[:2], *shape), dtype=np.float32)
    for place in np.ndindex(fine.shape[:2]):
        cv2.resize(band.stack[place], shape[::-1], dst=fine[place], interpolation=cv2.INTER_CUBIC)
    return BandImages(band.channels, fine, band.rig)


def _halved(values: Array, axis: int) -> Array:
    """Values at the middles of both halves of each pixel along `axis`, straight between their
    neighbours."""
    if values.shape[axis] < 2:
        return np.repeat(values, FACTOR, axis=axis)
    quarter = np.gradient(values, axis=axis) / 4
    both = np.stack([values - quarter, values + quarter], axis=axis + 1)
    shape = list(values.shape)
    shape[axis] *= FACTOR
    return np.asarray(both.reshape(shape), dtype=np.float64)
