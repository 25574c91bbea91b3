"""Master prints: one finger's ridges and pores on an unrolled map, before depth, skin or pose.

The map lies in the skin frame of :mod:`splitknit_simulator.finger.ridges`: as a camera sees the
pad, tip up, in arc length. :func:`ink_print` shows it as ink on paper does, mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray, GreyArray
from splitknit.settings import Checked, Limits, check_fields
from splitknit_simulator.finger.ridges import (
    PATTERNS,
    OrientationField,
    fan_log_period,
    grow_ridges,
    orientation_field,
    phase_singularities,
    smooth_noise,
)

# Sweat pores: small dips along the crests of the ridges.


def scatter_pores(
    rng: np.random.Generator,
    wave: FloatArray,
    pitch_mm: float,
    period_mm: float,
    pores_mm: tuple[float, float],
) -> FloatArray:
    """Return (H, W) pore depth in [0, 1] on the grid of `wave`; `pores_mm`: their spacing and their
    diameter.

    Candidates lie on a jittered grid, climb onto the nearest crest of `wave`, and are thinned so
    that neighbours keep more than half of the spacing. Sizes vary by a quarter (Roddy and Stosz
    1997, Fingerprint features: 9 to 18 pores per centimetre of ridge, 60 to 250 um across).
    """
    spacing_mm, diameter_mm = pores_mm
    rows, columns = wave.shape
    cell = float(np.sqrt(0.4 * spacing_mm * period_mm)) / pitch_mm
    grid_x, grid_y = np.meshgrid(
        np.arange(0.5 * cell, columns, cell), np.arange(0.5 * cell, rows, cell)
    )
    jitter = rng.uniform(-0.5, 0.5, (2, *grid_x.shape)) * cell
    x = np.clip((grid_x + jitter[0]).ravel(), 2, columns - 3)
    y = np.clip((grid_y + jitter[1]).ravel(), 2, rows - 3)
    smooth = np.asarray(
        cv2.GaussianBlur(wave, (0, 0), 0.12 * period_mm / pitch_mm), dtype=np.float32
    )
    slope_x, slope_y = (
        np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=0.125), dtype=np.float32)
        for axis in ((1, 0), (0, 1))
    )
    gain = (period_mm / pitch_mm / (2 * np.pi)) ** 2  # one Newton step on a cosine's crest
    for _ in range(12):
        x = np.clip(x + gain * _sample(slope_x, x, y), 2, columns - 3)
        y = np.clip(y + gain * _sample(slope_y, x, y), 2, rows - 3)
    keep = _thin(np.stack([x, y], 1), rng.permutation(x.size), 0.55 * spacing_mm / pitch_mm)
    keep &= _sample(smooth, x, y) > 0.5
    x, y = x[keep], y[keep]
    sideways = rng.normal(0.0, 0.05 * period_mm / pitch_mm, (2, x.size))
    sigma = (
        diameter_mm / 2.355 / pitch_mm * np.exp(0.25 * rng.standard_normal(x.size)).clip(0.7, 1.6)
    )
    depth = rng.uniform(0.4, 1.0, x.size)
    return _stamp((rows, columns), x + sideways[0], y + sideways[1], sigma, depth)


def _sample(image: FloatArray, x: Array, y: Array) -> Array:
    return np.asarray(
        image[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)], dtype=np.float64
    )


def _thin(points: Array, order: NDArray[np.intp], distance: float) -> BoolArray:
    """Greedy thinning: in a random order, a point survives if no survivor lies within
    `distance`."""
    rank = np.empty(len(points), dtype=np.intp)
    rank[order] = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    first = np.where(rank[pairs[:, 0]] < rank[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    second = pairs.sum(axis=1) - first
    keep = np.ones(len(points), dtype=np.bool_)
    for k in np.lexsort((second, rank[first])):
        if keep[first[k]]:
            keep[second[k]] = False
    return keep


def _stamp(shape: tuple[int, int], x: Array, y: Array, sigma: Array, depth: Array) -> FloatArray:
    reach = 6
    image = np.zeros((shape[0] + 2 * reach + 2, shape[1] + 2 * reach + 2), dtype=np.float64)
    column, row = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            distance = (column + dx - x) ** 2 + (row + dy - y) ** 2
            value = depth * np.exp(-0.5 * distance / sigma**2)
            np.maximum.at(image, (row + dy + reach, column + dx + reach), value)
    return np.asarray(image[reach : reach + shape[0], reach : reach + shape[1]], dtype=np.float32)


PROXIMAL_WIDENING = 0.14
"""How much wider ridges are at the first crease than at the core. Source: Gutierrez-Redomero 2008,
where ridges there are fewer per area."""
_PORE_SPACING_MM = 0.65
"""Mean distance of the pores along a ridge. Source: Roddy and Stosz 1997, 9 to 18 a centimetre."""
_PORE_DIAMETER_MM = 0.13
"""Mean full width at half depth of a pore. Source: Roddy and Stosz 1997, 60 to 250 um across."""


@dataclass(frozen=True, slots=True)
class MasterPrintSettings(Checked):
    """How a master print is drawn."""

    period_mm: Annotated[float, Limits(0.0, above=True)] = 0.43
    """Mean ridge period of the population: 23 ridges per cm."""
    period_spread: Annotated[float, Limits(0.0, 0.15)] = 0.07
    """Standard deviation between fingers, relative to `period_mm`."""
    half_width_mm: Annotated[float, Limits(0.0, above=True)] = 15.0
    """The map spans u in [-half_width_mm, half_width_mm]."""
    distal_mm: Annotated[float, Limits(0.0, above=True)] = 33.0
    """The map's extent from the first crease towards the tip."""
    proximal_mm: Annotated[float, Limits(0.0, above=True)] = 24.0
    """The map's extent from the first crease towards the palm."""
    pitch_mm: Annotated[float, Limits(0.0, above=True)] = 0.04
    """Grid pitch of the map."""
    iterations: Annotated[int, Limits(1)] = 5
    """Passes of the growth filter; fewer leave more minutiae (5: about 0.2 per square millimetre,
    as people have)."""
    steepness: tuple[float, float] = (1.5, 2.2)
    """Range of the ridges' profile: 0.5 is rounded like a sine, 2.5 flat-topped with steep
    flanks."""
    duty: tuple[float, float] = (0.15, 0.5)
    """Range of the ridges' breadth: 0 as broad as the valleys, 0.5 twice as broad, below 0
    narrower."""
    pattern_scale: Annotated[float, Limits(0.5, 2.0)] = 1.0
    """Size of the pattern (cores, deltas and the bends of its ridges, not their period): a finger's
    over the mean."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.pitch_mm <= self.period_mm / 8,
            "master_print.pitch_mm must be an eighth of the ridge period or less, but it is"
            f" {self.pitch_mm}.",
        )


@dataclass(frozen=True, slots=True, eq=False)
class MasterPrint:
    """Ridges of one finger in the skin frame: u to the right, v towards the tip, v = 0 on the first
    crease."""

    pattern: str
    seed: int
    ridge: (
        # (H, W) skin height without pores: about 0 in valleys, below but near 1 on the flat tops of
        # ridges
        FloatArray
    )
    pores: FloatArray  # (H, W) 1 at the bottom of a pore, 0 on plain skin
    u_mm: Array  # (W,) coordinate of the columns
    v_mm: Array  # (H,) coordinate of the rows; falls with the row
    period_mm: float  # this finger's mean ridge period around the core
    cores_mm: tuple[tuple[float, float], ...]  # (u, v) of the cores
    deltas_mm: tuple[tuple[float, float], ...]  # (u, v) of the deltas
    # (N, 3) u_mm, v_mm and direction (rad, counter-clockwise from u) towards the side that has one
    # more ridge
    minutiae: Array


def master_print(
    pattern: str, seed: int, settings: MasterPrintSettings | None = None
) -> MasterPrint:
    """Draw one finger's master print; the same seed gives the same bytes whatever the number of
    threads.

    `pattern`: ``arch``, ``tented_arch``, ``left_loop``, ``right_loop``, ``whorl``, ``twin_loop``,
    or ``loop`` (the seed decides its side), else BadInput. Sides are those of the inked print.

    Examples
    --------
    >>> small = MasterPrintSettings(half_width_mm=5, distal_mm=20, proximal_mm=2)
    >>> master_print("whorl", seed=1, settings=small).ridge.shape
    (576, 256)
    """
    settings = settings or MasterPrintSettings()
    draws = np.random.default_rng([seed, 0x9A17]).spawn(6)
    if pattern == "loop":
        pattern = str(draws[5].choice(("left_loop", "right_loop")))
    require(
        pattern in PATTERNS,
        f"pattern '{pattern}' is not known; choose one of loop, {', '.join(PATTERNS)}.",
    )
    coarse = 2 * settings.pitch_mm
    u_mm, v_mm = _axes(settings, coarse)
    field = _scaled_field(pattern, draws[0], u_mm, v_mm, settings.pattern_scale)
    mean_period, period = _periods(draws[1], settings, field, u_mm, v_mm)
    noise = draws[2].standard_normal((v_mm.size, u_mm.size)).astype(np.float32)
    wave = grow_ridges(noise, field.angle_rad, period / coarse, iterations=settings.iterations)
    minutiae = phase_singularities(wave, field.angle_rad)
    minutiae[:, 0] = u_mm[0] + coarse * minutiae[:, 0]
    minutiae[:, 1] = v_mm[0] - coarse * minutiae[:, 1]
    fine = twice_as_fine(wave)
    fine_u, fine_v = _fine_axes(settings)
    return MasterPrint(
        pattern,
        seed,
        ridge_profile(draws[3], fine, settings),
        scatter_pores(
            draws[4], fine, settings.pitch_mm, mean_period, (_PORE_SPACING_MM, _PORE_DIAMETER_MM)
        ),
        fine_u,
        fine_v,
        mean_period,
        field.cores_mm,
        field.deltas_mm,
        minutiae,
    )


def _scaled_field(
    pattern: str, rng: np.random.Generator, u_mm: Array, v_mm: Array, scale: float
) -> OrientationField:
    """The orientation field of a finger whose pattern is `scale` times as large as the mean."""
    field = orientation_field(pattern, rng, u_mm / scale, v_mm / scale)
    cores, deltas = (
        tuple((scale * u, scale * v) for u, v in points)
        for points in (field.cores_mm, field.deltas_mm)
    )
    return OrientationField(field.angle_rad, cores, deltas)


def _axes(settings: MasterPrintSettings, pitch: float) -> tuple[Array, Array]:
    """Coarse axes whose lengths suit the Fourier transform; the nominal extent is covered."""
    columns = scipy.fft.next_fast_len(
        int(np.ceil(2 * settings.half_width_mm / pitch)) + 1, real=True
    )
    rows = scipy.fft.next_fast_len(
        int(np.ceil((settings.distal_mm + settings.proximal_mm) / pitch)) + 1, real=True
    )
    u_mm = (np.arange(columns, dtype=np.float64) - (columns - 1) / 2) * pitch
    return u_mm, settings.distal_mm - np.arange(rows, dtype=np.float64) * pitch


def _fine_axes(settings: MasterPrintSettings) -> tuple[Array, Array]:
    """u of the columns and v of the rows of a master print: two for each of the coarse axes."""
    u_mm, v_mm = _axes(settings, 2 * settings.pitch_mm)
    columns, rows = (settings.pitch_mm * np.arange(2 * axis.size) for axis in (u_mm, v_mm))
    return u_mm[0] + columns, v_mm[0] - rows


def _periods(
    rng: np.random.Generator,
    settings: MasterPrintSettings,
    field: OrientationField,
    u_mm: Array,
    v_mm: Array,
) -> tuple[float, Array]:
    """Mean period around the core and (H, W) local periods, mm."""
    mean = settings.period_mm * float(
        np.exp(settings.period_spread * np.clip(rng.standard_normal(), -2.2, 2.2))
    )
    center = field.cores_mm[0][1] if field.cores_mm else 14.0
    pitch = float(u_mm[1] - u_mm[0])
    shape = (v_mm.size, u_mm.size)
    widening = PROXIMAL_WIDENING * rng.uniform(0.4, 1.6)
    # the period varies by 5 % (standard deviation) over about 5 mm
    logs = 0.05 * np.clip(smooth_noise(rng, shape, 4.0 / pitch), -2.5, 2.5)
    # how far ridges that fan out widen before new ones start: 0 not at all, 1 as far as they can
    logs += 0.8 * fan_log_period(field.angle_rad, pitch)
    logs = 0.2 * np.tanh(logs / 0.2)
    logs += (widening * 0.5 * (1.0 - np.tanh((v_mm - 0.45 * center) / 4.0)))[:, None]
    logs += (rng.uniform(-0.02, 0.08) * np.clip(np.abs(u_mm) / 10.0, 0.0, 1.5) ** 2)[None, :]
    return mean, mean * np.exp(logs)


def twice_as_fine(wave: FloatArray) -> FloatArray:
    """Band-limited interpolation to half the pitch (the wave is periodic on its grid)."""
    rows, columns = wave.shape
    spectrum = scipy.fft.rfft2(wave)
    padded = np.zeros((2 * rows, columns + 1), dtype=spectrum.dtype)
    half_row, half_column = (rows + 1) // 2, (columns + 1) // 2
    padded[:half_row, :half_column] = spectrum[:half_row, :half_column]
    padded[-(rows - half_row) :, :half_column] = spectrum[half_row:, :half_column]
    return np.asarray(4.0 * scipy.fft.irfft2(padded, s=(2 * rows, 2 * columns)), dtype=np.float32)


def ridge_profile(
    rng: np.random.Generator, wave: FloatArray, settings: MasterPrintSettings
) -> FloatArray:
    """Flat ridges and narrower valleys: a soft step of the wave, its duty varying over the finger.

    The last blur takes the harmonics that the map's pitch cannot carry; edges stay steeper than
    skin's.
    """
    pitch = settings.pitch_mm
    narrowest = min(0.0, settings.duty[0] - 0.15)
    duty = np.clip(
        rng.uniform(*settings.duty) + 0.1 * smooth_noise(rng, wave.shape, 2.5 / pitch),
        narrowest,
        0.6,
    )
    rough = smooth_noise(rng, wave.shape, 0.09 / pitch)
    steep = rng.uniform(*settings.steepness)
    wave = np.tanh(1.2 * wave) / np.tanh(1.2)  # evens out the amplitude
    flank = np.maximum(1.0 - wave * wave, 0.0)
    # flanks are irregular by 6 % of the ridge's amplitude (standard deviation)
    level = steep * (wave + duty + 0.06 * flank * rough)
    low = np.tanh(steep * (duty - 1.1))  # interpolation overshoots 1 a little
    ridge = ((np.tanh(level) - low) / (1.0 - low)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(ridge, (0, 0), 0.02 / pitch), dtype=np.float32)


def master_of_print(
    image: GreyArray, seed: int = 0, settings: MasterPrintSettings | None = None
) -> MasterPrint:
    """The master print of a finger that left a real print: its own forks, breaks, scars, pores and
    widths.

    `image` (H, W): 500 pixels an inch, as ink or a scanner shows it, mirrored against the finger,
    tip up, ridges dark; `seed`: of the ridges' profile, which a print does not show; `settings`:
    profile, extent, and about the period; ridges lie where the print has them. The print's middle
    lies where a pad is pressed down, 13.5 mm above the first crease. Beyond the print the skin is
    smooth, at the mean height of its ridges. Class, cores, deltas and minutiae are not known and
    left empty. Raises BadInput if the image is not grey, shows no ridges, or is larger than a
    finger.

    Examples
    --------
    >>> own = ink_print(master_print("whorl", seed=1))
    >>> master_of_print(own).pattern
    'print'
    """
    settings = settings or MasterPrintSettings()
    require(image.ndim == 2, f"a print is a grey image, but this one has the shape {image.shape}.")
    step = settings.pitch_mm * 500.0 / 25.4
    rows, columns = (round(length / step) for length in image.shape)
    u_mm, v_mm = _fine_axes(settings)
    require(
        0 < rows <= v_mm.size and 0 < columns <= u_mm.size,
        f"a print of {0.1 * settings.pitch_mm * columns:.3g} x {0.1 * settings.pitch_mm * rows:.3g}"
        " cm is too large; check its resolution.",
    )
    how = cv2.INTER_AREA if step > 1 else cv2.INTER_CUBIC
    turned = np.ascontiguousarray(image[:, ::-1], dtype=np.float32)
    grey = np.asarray(
        cv2.resize(turned, (columns, rows), interpolation=how), dtype=np.float32
    ) / np.float32(255)

    def mean(field: FloatArray, sigma_mm: float) -> FloatArray:
        return np.asarray(
            cv2.GaussianBlur(field, (0, 0), sigma_mm / settings.pitch_mm), dtype=np.float32
        )

    # a Gaussian of 0.05 mm removes a scanner's noise
    band = mean(grey, 0.05) - mean(grey, settings.period_mm)
    strength = np.sqrt(np.maximum(mean(band * band, 1.5 * settings.period_mm), 0))
    usual = float(np.quantile(strength, 0.9))
    require(usual > 0.02, "the image shows no ridges.")  # contrast relative to white
    faintest = np.float32(0.35 * usual)
    weight = (mean((strength > faintest).astype(np.float32), 2 * settings.period_mm) > 0.5).astype(
        np.float32
    )
    border = round(1.5 * settings.period_mm / settings.pitch_mm)
    weight[:border] = weight[-border:] = weight[:, :border] = weight[:, -border:] = 0
    weight = mean(weight, 0.5 * settings.period_mm)
    wave = np.clip(-band / (np.sqrt(np.float32(2)) * np.maximum(strength, faintest)), -1.3, 1.3)
    ridge = ridge_profile(np.random.default_rng([seed, 0x9A18]), wave, settings)
    require(float(weight.max()) > 0.9, "the image shows hardly any ridges.")
    level = np.float32((ridge * weight).sum(dtype=np.float64) / weight.sum(dtype=np.float64))
    middle = (np.argmin(np.abs(v_mm - _PAD_CENTRE_MM)), np.argmin(np.abs(u_mm)))
    shift = [
        int(m - round(float(c)))
        for m, c in zip(middle, ndimage.center_of_mass(weight), strict=True)
    ]
    laid = np.full((v_mm.size, u_mm.size), level, dtype=np.float32)
    r, c = (
        slice(max(s, 0), min(s + n, size))
        for s, n, size in zip(shift, weight.shape, laid.shape, strict=True)
    )
    own = (
        slice(r.start - shift[0], r.stop - shift[0]),
        slice(c.start - shift[1], c.stop - shift[1]),
    )
    laid[r, c] += (ridge[own] - level) * weight[own]
    flat = np.zeros_like(laid)
    return MasterPrint(
        "print", seed, laid, flat, u_mm, v_mm, settings.period_mm, (), (), np.zeros((0, 3))
    )


_PAD_CENTRE_MM = 13.5
"""Height of the middle of a pressed pad above the first crease. Source: derived, the middle of the
contact of :func:`ink_print`, 3 to 24 mm."""


def ink_print(master: MasterPrint, *, half_width_mm: float = 7.5) -> GreyArray:
    """Print the distal pad as ink on paper: mirrored against the skin frame, ridges dark, 8 bit,
    500 pixels an inch.

    The contact patch is an ellipse from 3 to 24 mm above the first crease, as a finger laid flat
    leaves it.
    """
    step = 25.4 / 500.0
    top, bottom = 24.0, 3.0
    rows, columns = round((top - bottom) / step), round(2 * half_width_mm / step)
    v = top - (np.arange(rows) + 0.5) * step
    u = half_width_mm - (np.arange(columns) + 0.5) * step  # mirrored
    pitch = float(master.u_mm[1] - master.u_mm[0])
    x, y = np.meshgrid((u - master.u_mm[0]) / pitch, (master.v_mm[0] - v) / pitch)
    skin = np.clip(master.ridge - 0.6 * master.pores, 0.0, 1.0)
    blurred = cv2.GaussianBlur(skin, (0, 0), max(0.4 * step / pitch, 0.3))
    ink = cv2.remap(blurred, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
    shape = np.hypot(
        u[None, :] / half_width_mm, (v[:, None] - 0.5 * (top + bottom)) / (0.5 * (top - bottom))
    )
    contact = 1.0 / (1.0 + np.exp((shape - 0.97) / 0.015))
    dark = contact / (1.0 + np.exp(-(ink - 0.65) / 0.1))
    return np.asarray(np.round(255.0 * (1.0 - 0.92 * dark)), dtype=np.uint8)
