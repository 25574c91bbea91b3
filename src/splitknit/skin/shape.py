"""The shape on the coarse grid, as it is refined from all bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from splitknit.imaging import bin_mean
from splitknit.imaging.geometry import height_gradients
from splitknit.model import FloatArray
from splitknit.skin.bands import BandImages
from splitknit.skin.coarse import CoarsePrior, CoarseStep, compare, integrate, start_shape, unit
from splitknit.skin.diffusion import Diffusion, SkinSettings, diffusion
from splitknit.skin.facets import Facets, ridged_normals
from splitknit.skin.grid import Grid, coarsen, refine
from splitknit.skin.learned import Network, slopes_by_network
from splitknit.skin.light import FineLight, fine_lighting
from splitknit.skin.relief import mean_normals


class CoarseShape:
    """A shape between corrections: images, optics and prediction on the coarse grid belong to it."""

    def __init__(
        self, bands: tuple[BandImages, ...], grid: Grid, skin: SkinSettings, *, pitch_mm: float, plane_mm: float
    ) -> None:
        """Start from near-light photometric stereo of the last band.

        Parameters
        ----------
        bands : on the fine grid
        grid : the fine grid
        skin : assumed optics
        pitch_mm : of the coarse grid, about
        plane_mm : mean height above the finger plane
        """
        self.fine = grid
        self.factor = max(1, round(pitch_mm / grid.pitch_mm))
        self.low = coarsen(grid, self.factor)
        self.plane_mm = plane_mm
        self.skin = skin
        self.names = tuple(name for band in bands for name in band.channels)
        self.white = bands[0].channels
        self.bands = tuple(
            BandImages(b.channels, bin_mean(b.stack[self._blocks], self.factor) * self.low.mask, b.rig) for b in bands
        )
        self.colour: Mapping[str, float] = {}
        """Brightness of the white band's channels over that of its first."""
        self.optics = self.optics_of()
        start = start_shape(self.bands[-1], self.low, plane_mm)
        self._first = self.low.smooth(start, self.low.mask, 0.5) * self.low.mask
        self.shape_mm = self._first
        """(h, w) on the coarse grid; its mean says nothing."""
        self.step: CoarseStep | None = None
        """What the last comparison found."""
        self._weights = np.ones(self.low.shape, dtype=np.float32)

    def correct(self, relief_mm: FloatArray, facets: Facets | None, prior: CoarsePrior) -> None:
        """Predict the images of shape, relief and facets, compare, and correct the shape."""
        low, shape = self.low, self.shape_mm
        ridged = np.moveaxis(mean_normals(self.placed() + relief_mm, self.fine), -1, 0)[self._blocks]
        normals = np.ascontiguousarray(np.moveaxis(bin_mean(np.ascontiguousarray(ridged), self.factor), 0, -1))
        normals = ridged_normals(normals, shape, low, facets)
        added = height_gradients(np.where(low.mask, shape - self._first, np.float32(np.nan)), low.pitch_mm)
        step = compare(self.bands, low, self.height(), normals, self.optics, added, prior, facets)
        self._weights = unit(normals)[..., 2]
        self.shape_mm = shape + integrate(step.slope_x - added[0], step.slope_y - added[1], low, self._weights)
        self.step = step

    def mend(self, network: Network, facets: Facets) -> None:
        """Add the slopes that the network of the shape finds missing."""
        missing = slopes_by_network(self.bands, self.low, self.height(), self.optics, facets, network)
        self.shape_mm = self.shape_mm + integrate(*missing, self.low, self._weights)

    def see_colour(self) -> None:
        """Let the absorption follow the colour that the last comparison found."""
        assert self.step is not None
        first = self.step.brightness[self.white[0]]
        self.colour = {name: self.step.brightness[name] / first for name in self.white}
        self.optics = self.optics_of()

    def optics_of(self, scattering: float = 1.0) -> dict[str, Diffusion]:
        """Assumed optics of every channel, with `scattering` times the assumed scattering."""
        colour = self.colour if len(self.colour) > 1 else {}
        return {
            name: diffusion(self.skin.scattering(name) * scattering, self.skin.absorption(name, colour.get(name)))
            for name in self.names
        }

    def height(self) -> FloatArray:
        """(h, w) at its assumed height above the finger plane, on the coarse grid, zero outside the mask."""
        return self._lifted() * self.low.mask

    def placed(self) -> FloatArray:
        """(H, W) the same on the fine grid, continued beyond the mask."""
        return refine(self._lifted(), self.low.mask, self.factor, self.fine.shape)

    def light(self) -> FineLight:
        """The white lights on the shape without what ridges leave on the coarse grid."""
        height = refine(self._lifted(), self.low.mask, 1, self.low.shape)
        smooth = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / self.low.pitch_mm), dtype=np.float32)
        return fine_lighting(self.bands[0].rig, self.low, smooth, self.factor, self.fine)

    def _lifted(self) -> FloatArray:
        mean = np.float32(self.shape_mm[self.low.mask].mean(dtype=np.float64))
        return self.shape_mm - mean + np.float32(self.plane_mm)

    @property
    def _blocks(self) -> tuple[Any, ...]:
        rows, columns = self.low.shape
        return (..., slice(rows * self.factor), slice(columns * self.factor))
