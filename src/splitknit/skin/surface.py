"""The recipe: shape and relief of a finger of skin, in turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.imaging.band import bin_mean
from splitknit.imaging.geometry import normals_from_gradients
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits, check_fields
from splitknit.skin import relief as fine
from splitknit.skin.coarse import CoarsePrior, CoarseStep, compare, integrate, slopes_inside, start_shape
from splitknit.skin.diffusion import Diffusion, SkinSettings, diffusion
from splitknit.skin.grid import BandImages, Grid, coarsen, refine
from splitknit.skin.learned import Network, ridge_tensor, slopes_by_network
from splitknit.skin.light import Lighting, fine_lighting
from splitknit.skin.relief import LocalWienerSettings, ReliefEstimate

# The shape on the coarse grid, as it is refined from all bands.


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
        """(h, w) on the coarse grid; its mean is undefined."""
        self.step: CoarseStep | None = None
        """What the last comparison found."""
        self._weights = np.ones(self.low.shape, dtype=np.float32)

    @classmethod
    def of(cls, bands: tuple[BandImages, ...], grid: Grid, skin: SkinSettings, settings: MetricSettings) -> CoarseShape:
        """Start at the pitch and height that the settings say."""
        return cls(bands, grid, skin, pitch_mm=settings.coarse_pitch_mm, plane_mm=settings.plane_mm)

    def correct(self, prior: CoarsePrior) -> None:
        """Predict the images of the shape, compare, and correct the shape."""
        low, shape = self.low, self.shape_mm
        added = slopes_inside(shape - self._first, low)
        step = compare(self.bands, low, self.height(), self.optics, added, prior)
        self._weights = self._facing()
        self.shape_mm = shape + integrate(step.slope_x - added[0], step.slope_y - added[1], low, self._weights)
        self.step = step

    def mend(self, network: Network, relief_mm: FloatArray) -> None:
        """Add the slopes that the network of the shape finds missing, given the ridges (H, W) found so far."""
        ridges = ridge_tensor(relief_mm, self.fine, self.factor, self.low)
        missing = slopes_by_network(self.bands, self.low, self.height(), self.optics, ridges, network)
        self.shape_mm = self.shape_mm + integrate(*missing, self.low, self._weights)

    def see_colour(self) -> None:
        """Let the absorption follow the colour that the last comparison found."""
        first = self.found.brightness[self.white[0]]
        self.colour = {name: self.found.brightness[name] / first for name in self.white}
        self.optics = self.optics_of()

    def optics_of(self, scattering: float = 1.0) -> dict[str, Diffusion]:
        """Assumed optics of every channel, with `scattering` times the assumed scattering."""
        colour = self.colour if len(self.colour) > 1 else {}
        return {
            name: diffusion(self.skin.scattering(name) * scattering, self.skin.absorption(name, colour.get(name)))
            for name in self.names
        }

    @property
    def found(self) -> CoarseStep:
        """What the last comparison found."""
        assert self.step is not None
        return self.step

    def facts(self) -> dict[str, Any]:
        """Optics and specular reflection, for the report."""
        optics = self.optics
        return {
            "scattering_per_mm": {name: optics[name].scattering_per_mm for name in sorted(optics)},
            "absorption_per_mm": {name: optics[name].absorption_per_mm for name in sorted(optics)},
            "scattering_assumed": True,
            "colour": dict(self.colour),
            "glare": {name: {"roughness": r, "strength": s} for name, (r, s) in self.found.glare.items()},
            "working_pitch_mm": self.fine.pitch_mm,
        }

    def height(self) -> FloatArray:
        """(h, w) at its assumed height above the finger plane, on the coarse grid, zero outside the mask."""
        return self._lifted() * self.low.mask

    def placed(self) -> FloatArray:
        """(H, W) the same on the fine grid, continued beyond the mask."""
        return refine(self._lifted(), self.low.mask, self.factor, self.fine.shape)

    def light(self) -> Lighting:
        """The white lights on the shape without what ridges leave on the coarse grid."""
        height = refine(self._lifted(), self.low.mask, 1, self.low.shape)
        smooth = np.asarray(cv2.GaussianBlur(height, (0, 0), 0.25 / self.low.pitch_mm), dtype=np.float32)
        return fine_lighting(self.bands[0].rig, self.low, smooth, self.factor, self.fine)

    def _facing(self) -> FloatArray:
        """z component of the shape's normals."""
        return normals_from_gradients(*slopes_inside(self.shape_mm, self.low))[..., 2]

    def _lifted(self) -> FloatArray:
        mean = np.float32(self.shape_mm[self.low.mask].mean(dtype=np.float64))
        return self.shape_mm - mean + np.float32(self.plane_mm)

    @property
    def _blocks(self) -> tuple[Any, ...]:
        rows, columns = self.low.shape
        return (..., slice(rows * self.factor), slice(columns * self.factor))


# The relief by the colours of the white band alone: a linear estimate, refined by prediction and comparison.


_SEED = 0
"""Seed of the noise that is sent through the filters to learn its spectrum."""


@dataclass(frozen=True, slots=True)
class ColourSettings(Checked):
    """Relief and glare separated by their colours."""

    _group = "metric.by_colour"
    steps: Annotated[int, Limits(1)] = 2
    """Corrections of the relief in each round."""
    model_error: Annotated[float, Limits(0)] = 0.5
    """Error of the relief that is not noise (glare taken for relief, flanks too steep to be resolved), as a part of the
    relief's local rms height; measured on simulated fingers, see docs/experiments/accuracy.md."""
    denoise: LocalWienerSettings = field(default_factory=LocalWienerSettings)
    """Removal of the noise from the relief."""


def relief_by_colour(  # noqa: PLR0917
    white: BandImages,
    grid: Grid,
    smooth_mm: FloatArray,
    light: Lighting,
    optics: Mapping[str, Diffusion],
    other: Mapping[str, Diffusion],
    brightness: Mapping[str, float],
    before_mm: FloatArray,
    settings: ColourSettings,
) -> ReliefEstimate:
    """Relief that explains the slopes of all channels behind blur and glare.

    Parameters
    ----------
    white : the white band
    grid : fine grid
    smooth_mm : (h, w) the shape without the relief
    light : lights on that shape
    optics : assumed transfer function of each channel
    other : the same one standard deviation of the scattering away
    brightness : diffuse brightness of each channel over the prediction for an albedo of one
    before_mm : (h, w) the relief so far
    settings : ColourSettings
    """
    relief = before_mm
    measured = fine.measure(white, grid, smooth_mm, light, optics, brightness)
    for _ in range(settings.steps):
        lacking = fine.lacking_slopes(measured, grid, smooth_mm + relief)
        mix = fine.unmixing(measured, grid, _with_relief(lacking.slopes, measured, grid, relief), lacking.glare)
        raw = fine.update(measured, grid, lacking.slopes, mix, relief)
        relief, noise = fine.denoise(raw, grid, mix, settings.denoise, _SEED)
    sensitivity = abs(fine.scattering_sensitivity(measured, grid, mix, other, relief))
    height = np.sqrt(np.maximum(grid.smooth(relief * relief, grid.mask, 0.6), np.float32(0.0)))
    model = np.float32(np.hypot(sensitivity, settings.model_error)) * height
    return ReliefEstimate(
        relief_mm=relief,
        deviation_mm=np.sqrt(noise**2 + model**2).astype(np.float32),
        trust=measured.trust,
        albedo=np.sqrt((measured.pseudo_normals[0] ** 2).sum(axis=-1)),
        facts={"relief_by": "colour", "gain_sensitivity": sensitivity},
    )


def _with_relief(
    slopes: list[tuple[FloatArray, FloatArray]], measured: fine.Measured, grid: Grid, relief: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """The slopes that the channels would lack without the current relief."""
    if not relief.any():
        return slopes
    spectrum = grid.forward(relief)
    wx, wy, _ = grid.omega
    return [
        (x + grid.inverse(spectrum * (1j * wx) * t), y + grid.inverse(spectrum * (1j * wy) * t))
        for (x, y), t in zip(slopes, measured.transfer, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class MetricSettings(Checked):
    """Grids and iterations of the `metric` preset on skin."""

    working_pitch_mm: Annotated[float, Limits(0, above=True)] = 0.0264
    """Pitch of the fine grid: skin passes less than 2 % of anything that a finer one could show."""
    coarse_pitch_mm: float = 0.106
    """Pitch of the coarse grid."""
    plane_mm: float = 1.0
    """Assumed mean height of the visible skin above the finger plane (it moves the lights only)."""
    rounds: Annotated[int, Limits(1)] = 2
    """Estimates of the relief, each on the shape that the one before it mended."""
    coarse_steps: Annotated[int, Limits(1)] = 3
    """Corrections of the shape on the coarse grid."""
    coarse: CoarsePrior = field(default_factory=CoarsePrior)
    """What is expected of shape and glare on the coarse grid."""
    relief: Literal["network", "colour"] = "network"
    """``network``, or ``colour``: relief and glare separated by their colours alone. Grey images, and rigs with too
    few lights for the network, take the second way whatever is said here."""
    network: str = "relief"
    """Name of a network in the package, or path of an ``.onnx`` file with its card beside it."""
    shape_network: str = "shape"
    """The same for what mends the shape in the last round; empty: none."""
    tile_px: int = 704
    """Side in pixels of a square as large as what the network works on at once; memory grows with its square."""
    by_colour: ColourSettings = field(default_factory=ColourSettings)
    """The second way."""

    def __post_init__(self) -> None:
        check_fields(self)
        ordered = self.working_pitch_mm <= self.coarse_pitch_mm
        require(ordered, "metric.working_pitch_mm must be at most metric.coarse_pitch_mm.")


@dataclass(frozen=True, slots=True, eq=False)
class SkinSurface:
    """Reconstructed skin on the fine grid; heights are finite everywhere and mean something inside the mask."""

    shape_mm: FloatArray
    relief_mm: FloatArray
    deviation_mm: FloatArray
    """Standard deviation of the relief: noise, what denoising took, unknown scattering, and model error."""
    albedo: FloatArray
    """Diffuse brightness of the first channel, relative."""
    facts: Mapping[str, Any]


def first_shape(bands: tuple[BandImages, ...], grid: Grid, skin: SkinSettings, settings: MetricSettings) -> FloatArray:
    """(h, w) shape on the fine grid after the first turn's corrections, before there is any relief.

    What the network of the relief is given in the first turn; its training starts here. Parameters as for
    :func:`splitknit.pipeline.reconstruct_skin`.
    """
    shape = CoarseShape.of(bands, grid, skin, settings)
    for _ in range(settings.coarse_steps):
        shape.correct(settings.coarse)
    return shape.placed()
