"""Ridges of a print: the orientation fields of the classes, and ridges grown from noise along them.

Frame of all master prints (the *skin frame*): the finger pad as a camera above it sees it, tip up,
arc length in millimetres. u points right, v towards the tip, v = 0 lies on the first flexion
crease. An inked print is the mirror image of that view, and classes are named after the print: the
legs of a ``left_loop`` leave to the left on the print, so towards u > 0 here. Minutiae are not
placed; they remain where the ridges of the noise could not join.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from scipy import sparse
from scipy.sparse.linalg import spsolve

from splitknit.errors import require
from splitknit.model import Array, FloatArray
from splitknit_simulator.surface import Window

Point = tuple[float, float]

PATTERNS = ("arch", "tented_arch", "left_loop", "right_loop", "whorl", "twin_loop")


@dataclass(frozen=True, slots=True, eq=False)
class OrientationField:
    """Ridge directions on a grid, and the singular points they turn about."""

    angle_rad: Array  # (H, W) direction of the ridges, counter-clockwise from u, defined up to pi
    cores_mm: tuple[Point, ...]  # (u, v) of the cores: the direction turns by +pi around each
    deltas_mm: tuple[Point, ...]  # (u, v) of the deltas: the direction turns by -pi around each


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], sigma_px: float) -> Array:
    """Return (H, W) Gaussian noise, blurred by `sigma_px`, with unit standard deviation in
    expectation.

    It is drawn on a grid of about sigma/2 and interpolated, so its cost does not grow with
    `sigma_px`.
    """
    step = max(sigma_px / 2.0, 1.0)
    coarse = (int(np.ceil(shape[0] / step)) + 8, int(np.ceil(shape[1] / step)) + 8)
    white = rng.standard_normal(coarse)
    sigma = sigma_px / step
    blurred = cv2.GaussianBlur(white, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    blurred *= 2.0 * np.sqrt(np.pi) * sigma
    if step > 1.0:
        size = (round(coarse[1] * step), round(coarse[0] * step))
        blurred = cv2.resize(blurred, size, interpolation=cv2.INTER_CUBIC)
    offset = int(3 * step)
    return np.asarray(
        blurred[offset : offset + shape[0], offset : offset + shape[1]], dtype=np.float64
    )


def around(
    shape: tuple[int, ...], row: float, column: float, reach: int
) -> tuple[Window, Array, Array]:
    """Window of the grid `shape` within `reach` of a place, and there the rows (h, 1) and columns
    (1, w) from it."""
    top, left = max(int(row) - reach, 0), max(int(column) - reach, 0)
    bottom, right = min(int(row) + reach + 1, shape[0]), min(int(column) + reach + 1, shape[1])
    dy, dx = np.arange(top, bottom)[:, None] - row, np.arange(left, right)[None, :] - column
    return (slice(top, bottom), slice(left, right)), np.asarray(dy), np.asarray(dx)


def orientation_field(
    pattern: str, rng: np.random.Generator, u_mm: Array, v_mm: Array
) -> OrientationField:
    """Draw the orientation field of one finger on a grid of the skin frame; `u_mm` (W,), `v_mm`
    (H,), falling with the row.

    The zero-pole model (Sherlock and Monro 1993, eq. 5) places cores and deltas; each singularity
    bends its own angle (after Vizcaya and Gerhardt 1996, A nonlinear orientation model), an
    envelope lays the upper ridges along the outline of the tip, and smooth noise warps the plane
    and the angle. Below the first crease the field relaxes to the slightly oblique transverse
    ridges of the middle phalanx.
    """
    require(
        pattern in PATTERNS,
        f"pattern '{pattern}' is not known; choose one of {', '.join(PATTERNS)}.",
    )
    pitch = float(u_mm[1] - u_mm[0])
    shape = (v_mm.size, u_mm.size)
    u, v = np.meshgrid(u_mm, v_mm)
    warp = rng.uniform(0.4, 1.1)
    wu, wv = (axis + warp * smooth_noise(rng, shape, 5.0 / pitch) for axis in (u, v))
    center = (rng.uniform(-1.6, 1.6), rng.uniform(10.5, 17.0))
    cores, deltas = _singularities(pattern, rng, center)
    angle = (
        _arch(rng, wu, wv, center) if pattern == "arch" else _zero_pole(rng, wu, wv, cores, deltas)
    )
    angle += _envelope(rng, wu - center[0], wv - center[1], pattern)
    angle += rng.uniform(0.05, 0.14) * smooth_noise(rng, shape, 2.5 / pitch)
    angle += rng.uniform(-0.15, 0.15)
    tilt = rng.uniform(-0.35, 0.35)
    wave = tilt + 0.18 * smooth_noise(rng, angle.shape, 4.0 / pitch) + rng.uniform(-0.03, 0.03) * u
    weight = 1.0 / (1.0 + np.exp(-(v - 1.0) / 0.7))
    doubled = weight * np.exp(2j * angle) + (1.0 - weight) * np.exp(2j * wave)
    angle = np.asarray(0.5 * np.angle(doubled), dtype=np.float64)
    places = (
        tuple(_unwarp(point, wu, wv, u_mm, v_mm) for point in points) for points in (cores, deltas)
    )
    return OrientationField(angle, *places)


def _singularities(
    pattern: str, rng: np.random.Generator, center: Point
) -> tuple[tuple[Point, ...], tuple[Point, ...]]:
    """Cores and deltas (u, v) in the skin frame."""
    cu, cv = center
    if pattern == "arch":
        return (), ()
    if pattern == "tented_arch":
        cv -= rng.uniform(1.0, 4.0)
        return ((cu, cv),), ((cu + rng.uniform(-0.8, 0.8), cv - rng.uniform(2.0, 5.0)),)
    if pattern in ("left_loop", "right_loop"):
        # where the delta lies: across from the open legs
        side = -1.0 if pattern == "left_loop" else 1.0
        return ((cu, cv),), ((cu + side * rng.uniform(2.5, 8.0), cv - rng.uniform(4.0, 10.0)),)
    left = (cu - rng.uniform(4.0, 8.5), cv - rng.uniform(4.0, 9.5))
    right = (cu + rng.uniform(4.0, 8.5), cv - rng.uniform(4.0, 9.5))
    if pattern == "whorl":
        gap, lean = rng.uniform(0.4, 4.0), rng.uniform(-0.5, 0.5)
    else:
        gap, lean = rng.uniform(3.5, 6.5), rng.choice((-1.0, 1.0)) * rng.uniform(0.5, 1.15)
    du, dv = 0.5 * gap * np.sin(lean), 0.5 * gap * np.cos(lean)
    return ((cu + du, cv + dv - 0.4 * gap), (cu - du, cv - dv - 0.4 * gap)), (left, right)


def _zero_pole(
    rng: np.random.Generator,
    u: Array,
    v: Array,
    cores: tuple[Point, ...],
    deltas: tuple[Point, ...],
) -> Array:
    angle = np.zeros(u.shape)
    for sign, points in ((0.5, cores), (-0.5, deltas)):
        for pu, pv in points:
            about = np.arctan2(v - pv, u - pu)
            # strong bends make cores fan
            bend = rng.uniform(-1.0, 1.0, 2) * (0.2 if sign > 0 else 0.3)
            phase = rng.uniform(-np.pi, np.pi, 2)
            bent = (
                about
                + bend[0] * np.sin(about + phase[0])
                + 0.5 * bend[1] * np.sin(2 * about + phase[1])
            )
            angle += sign * bent
    return angle


def _arch(rng: np.random.Generator, u: Array, v: Array, center: Point) -> Array:
    """Ridges that rise and fall across the finger: the steepness peaks at some height and dies at
    the crease."""
    width = rng.uniform(3.0, 6.0)
    steep = rng.uniform(0.5, 1.5)
    peak = center[1] - rng.uniform(1.0, 5.0)
    spread = rng.uniform(3.5, 6.5)
    skew = rng.uniform(-0.06, 0.06)
    x = (u - center[0] - skew * (v - peak)) / width
    profile = np.exp(-0.5 * ((v - peak) / spread) ** 2)
    return np.asarray(
        np.arctan(-steep * profile * 1.65 * x * np.exp(-0.5 * x * x)), dtype=np.float64
    )


def _envelope(rng: np.random.Generator, u: Array, v: Array, pattern: str) -> Array:
    """Extra fall of the ridges towards both sides above the core, where they follow the outline of
    the tip."""
    strength = rng.uniform(0.15, 0.65) + (0.35 if pattern in ("arch", "tented_arch") else 0.0)
    width = rng.uniform(4.0, 8.0)
    onset = rng.uniform(-8.0, 0.0)
    reach = rng.uniform(3.0, 6.0)
    skew = rng.uniform(-0.8, 0.8)
    return np.asarray(
        -strength * np.tanh((u + skew) / width) / (1.0 + np.exp(-(v - onset) / (0.5 * reach))),
        dtype=np.float64,
    )


def _unwarp(point: Point, wu: Array, wv: Array, u_mm: Array, v_mm: Array) -> Point:
    """Grid position whose warped coordinates are nearest to `point`."""
    row, column = np.unravel_index(
        int(np.argmin((wu - point[0]) ** 2 + (wv - point[1]) ** 2)), wu.shape
    )
    return float(u_mm[column]), float(v_mm[row])


def fan_log_period(angle_rad: Array, pitch_mm: float) -> Array:
    """Logarithm of the ridge period that lets ridges fan out with the fewest new ones, smooth and
    zero on average.

    A pattern of period p across unit normals n has no minutiae where curl(n / p) = 0 (Larkin and
    Fletcher 2007: the curl of the phase gradient is the density of minutiae): along a ridge, log p
    grows by the divergence of the ridges. The least-squares solution is found on a coarse grid.
    """
    step = max(1, round(0.5 / pitch_mm))
    rows, columns = (size // step + 1 for size in angle_rad.shape)
    doubled = np.exp(2j * angle_rad)
    real, imaginary = (
        cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
        for part in (doubled.real, doubled.imag)
    )
    small = real + 1j * imaginary
    h = pitch_mm * angle_rad.shape[0] / rows
    # sign is free: it cancels in the product with the divergence
    along = np.exp(0.5j * np.angle(small))
    # Divergence of the ridge direction t from the doubled angle: div t = t_perp . grad(angle).
    du, dv = (np.zeros_like(small) for _ in range(2))
    du[:, 1:-1] = small[:, 2:] - small[:, :-2]
    dv[1:-1] = small[:-2] - small[2:]
    turn_u, turn_v = (0.5 * np.imag(np.conj(small) * d) / (2 * h) for d in (du, dv))
    divergence = np.clip(-along.imag * turn_u + along.real * turn_v, -0.5, 0.5)
    gradient_u, gradient_v = _difference_matrices(rows, columns, h)
    cosine, sine = (sparse.diags_array(part.ravel()) for part in (along.real, along.imag))
    streamwise = cosine @ gradient_u + sine @ gradient_v
    # keeps the logarithm of the period small, against its fit to the divergence; 1/mm^2
    system = streamwise.T @ streamwise + 0.02 * sparse.eye_array(rows * columns)
    system += 0.3 * (gradient_u.T @ gradient_u + gradient_v.T @ gradient_v)
    solution = spsolve(sparse.csc_array(system), streamwise.T @ divergence.ravel()).reshape(
        rows, columns
    )
    solution -= float(solution.mean())
    return np.asarray(
        cv2.resize(solution, angle_rad.shape[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float64
    )


def _difference_matrices(
    rows: int, columns: int, h: float
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Central differences along u (columns) and v (against the rows), zero on the border."""

    def line(size: int, sign: float) -> sparse.csr_array:
        matrix = sparse.diags_array([-sign, sign], offsets=[-1, 1], shape=(size, size)).tolil()
        matrix[0, :] = 0.0
        matrix[size - 1, :] = 0.0
        return sparse.csr_array(matrix / (2 * h))

    return (
        sparse.csr_array(sparse.kron(sparse.eye_array(rows), line(columns, 1.0))),
        sparse.csr_array(sparse.kron(line(rows, -1.0), sparse.eye_array(columns))),
    )


# Ridges grown from noise: repeated filtering along a field of directions and periods.


def grow_ridges(
    noise: FloatArray, angle_rad: Array, period_px: Array, *, iterations: int = 5
) -> FloatArray:
    """Grow a ridge pattern (H, W) from seeded `noise` by an iterated, spatially varying Gabor-like
    filter.

    Every pass smooths along the ridges (a kernel bent along the streamlines of `angle_rad`,
    counter-clockwise from the columns' direction, rows pointing down), keeps the local frequency (a
    bank of ring filters, blended by `period_px`) and limits the amplitude; fewer passes leave more
    defects (minutiae). The wave has about unit amplitude and no harmonics, and is positive on
    ridges.

    Cappelli, Maio and Maltoni 2000, Synthetic fingerprint-database generation (iterated contextual
    filtering). Cabral and Leedom 1993, Imaging vector fields using line integral convolution.
    """
    mean_period = float(np.median(period_px))
    # Passes of (3, 4, 3) / 10 at distances d, 2 d and 4 d make a bell along the streamline; d is
    # too short to alias.
    # the bell's standard deviation is 1.1 periods
    distances = [factor * 1.1 * mean_period for factor in (0.26, 0.52, 1.04)]
    maps = [_streamline_maps(angle_rad, distance, 2 + k) for k, distance in enumerate(distances)]
    bank = _ring_bank(noise.shape, period_px)
    ridges = wave = noise.astype(np.float32)
    for _ in range(iterations):
        for pair in maps:
            total = 2.0 * ridges
            for x, y in pair:
                total = total + 1.5 * cv2.remap(
                    ridges, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
                )
            ridges = np.asarray(total * np.float32(0.2), dtype=np.float32)
        spectrum = scipy.fft.rfft2(ridges)
        out = np.zeros_like(ridges)
        for ring, weight in bank:
            out += weight * scipy.fft.irfft2(spectrum * ring, s=noise.shape)
        power = cv2.GaussianBlur(
            out * out, (0, 0), 1.6 * mean_period, borderType=cv2.BORDER_REFLECT
        )
        wave = out / np.sqrt(2.0 * power + 1e-12)
        ridges = np.tanh(1.84 * wave)
    return np.asarray(wave, dtype=np.float32)


def _streamline_maps(
    angle_rad: Array, distance_px: float, steps: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Sampling positions (x, y) at `distance_px` forwards and backwards along the field."""
    doubled = [f(2.0 * angle_rad).astype(np.float32) for f in (np.cos, np.sin)]
    rows, columns = angle_rad.shape
    grid_x, grid_y = np.meshgrid(
        np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32)
    )
    start = (np.cos(angle_rad).astype(np.float32), -np.sin(angle_rad).astype(np.float32))
    maps = []
    for sign in (1.0, -1.0):
        x, y = grid_x, grid_y
        heading_x, heading_y = sign * start[0], sign * start[1]
        for _ in range(steps):
            x = x + heading_x * (distance_px / steps)
            y = y + heading_y * (distance_px / steps)
            c, s = (
                cv2.remap(f, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                for f in doubled
            )
            half = 0.5 * np.arctan2(s, c)
            new_x, new_y = np.cos(half), -np.sin(half)
            turn = np.where(new_x * heading_x + new_y * heading_y < 0, -1.0, 1.0).astype(np.float32)
            heading_x, heading_y = turn * new_x, turn * new_y
        maps.append((x.astype(np.float32), y.astype(np.float32)))
    return maps


def _ring_bank(shape: tuple[int, ...], period_px: Array) -> list[tuple[FloatArray, FloatArray]]:
    """Ring filters at geometrically spaced frequencies, each with the (H, W) weights that blend it
    with neighbours."""
    low, high = float(np.log(period_px.min())), float(np.log(period_px.max()))
    # neighbouring rings differ in frequency by a factor of 1.16 at most
    count = max(2, int(np.ceil((high - low) / np.log(1.16))) + 1)
    centers = np.linspace(low, high, count)
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
    position = (np.log(period_px) - low) / max(high - low, 1e-9) * (count - 1)
    bank = []
    for k, center in enumerate(centers):
        f0 = float(np.exp(-center))
        # a ring's width (standard deviation) is a fifth of its frequency
        ring = np.exp(-0.5 * ((frequency - f0) / (0.2 * f0)) ** 2).astype(np.float32)
        bank.append((ring, np.clip(1.0 - np.abs(position - k), 0.0, 1.0).astype(np.float32)))
    return bank


def phase_singularities(wave: FloatArray, angle_rad: Array) -> Array:
    """Find the minutiae of a zero-mean ridge pattern (H, W): the points about which its phase turns
    by 2 pi.

    `angle_rad`: ridge direction, counter-clockwise from the columns' direction, rows pointing down.
    Returns (N, 3): column, row, and the direction (rad, likewise) towards the side with one more
    ridge.

    Larkin, Bone and Oldfield 2001, Natural demodulation of two-dimensional fringe patterns (spiral
    phase quadrature). Larkin and Fletcher 2007, A coherent framework for fingerprint analysis: are
    fingerprints holograms?
    """
    frequency_x = np.fft.fftfreq(wave.shape[1])[None, :]
    frequency_up = -np.fft.fftfreq(wave.shape[0])[:, None]
    spiral = (frequency_x + 1j * frequency_up) / np.maximum(
        np.hypot(frequency_x, frequency_up), 1e-12
    )
    vortex = scipy.fft.ifft2(scipy.fft.fft2(wave) * spiral)
    across = np.exp(1j * (angle_rad + 0.5 * np.pi))
    signal = wave + 1j * np.real(-1j * np.conj(across) * vortex)
    # counter-clockwise, rows down
    corners = (np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:], np.s_[:-1, :-1])
    reference = across[corners[0]]
    loop = []
    for corner in corners:
        same = np.real(np.conj(reference) * across[corner]) >= 0
        loop.append(np.where(same, signal[corner], np.conj(signal[corner])))
    turns = sum(np.angle(loop[(k + 1) % 4] * np.conj(loop[k])) for k in range(4)) / (2 * np.pi)
    rows, columns = np.nonzero(np.abs(turns) > 0.5)
    towards = np.angle(reference[rows, columns] * -1j * np.sign(turns[rows, columns]))
    return np.stack([columns + 0.5, rows + 0.5, towards], axis=1)
