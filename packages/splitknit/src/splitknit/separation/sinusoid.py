"""Direct and global light, and where the light came from, from phase-shifted sinusoids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.separation.stacks import (
    DEFAULTS,
    LightStack,
    Separation,
    StackSettings,
    check_contrast,
    check_fraction,
    check_repeats,
    light_stack,
)


@dataclass(frozen=True, slots=True, eq=False)
class PhaseSeparation(Separation):
    """Direct and global light, and the phase that identifies which line of the projector lit a pixel."""

    phase_rad: FloatArray
    """(H, W) in [-pi, pi]: phase of the pattern at the pixel in the image of phase zero. It is *wrapped*: it gives
    the place within one period of the pattern, not which period."""
    modulation: FloatArray  # (H, W): amplitude over mean, all channels, 0 to 1; where small, the phase is noise


def sinusoid(
    stack: Any,
    phases_rad: Any = None,
    *,
    dark: float = 0.0,
    noise_std: float = 0.0,
    mask: Any = None,
    settings: StackSettings = DEFAULTS,
) -> PhaseSeparation:
    """Separate direct from global light under the pattern 1/2 + 1/2 sin(phase + phases_rad[n]) in image n.

    Least squares over the images at each pixel: L = A + B sin(phase + shift), direct = 2 B / (1 - dark), direct plus
    global = 2 A / (1 + dark). Three images determine A, B and the phase (S. K. Nayar et al. 2006, section 5.3); more
    lower the noise. All channels share one phase.

    B is the length of a noisy vector and so biased upwards, by v / (2 B) for a variance v of its two components (H.
    Gudbjartsson and S. Patz, "The Rician distribution of noisy MRI data", Magnetic Resonance in Medicine 34(6), 1995).
    With `noise_std`, of one image in units of linear light, this bias is taken off, to second order in noise over B
    (sound where B exceeds about three standard deviations).

    `stack`: (N, H, W) or (N, H, W, C) linear light, black level removed, three images at least; `phases_rad`: (N,),
    equal steps of 2 pi / N where None; `dark`: least brightness of the source relative to its greatest, in [0, 1);
    `mask`: (H, W) bool. Raises BadInput if there are fewer than three images, two phases agree, they do not determine a
    sinusoid, the images do not follow them, or the stack is unusable as for
    :func:`splitknit.separation.binary.checkerboard`.
    """
    check_fraction(dark, "dark")
    require(bool(np.isfinite(noise_std)) and noise_std >= 0, f"noise_std must not be negative, but it is {noise_std}.")
    images = light_stack(stack, least=3, mask=mask, settings=settings)
    phases = _check_phases(phases_rad, len(images.light))
    apart = np.square(np.sin((phases[:, None] - phases[None, :]) / 2))
    check_repeats(images.light, images.mask, settings, expected=apart)
    design = np.stack([np.ones_like(phases), np.sin(phases), np.cos(phases)], axis=1)
    inverse = np.linalg.pinv(design)
    mean, along, across = np.einsum("kn,nhwc->khwc", inverse, images.light)
    _check_residual(images, design, inverse)
    phase = np.arctan2(across.sum(axis=-1), along.sum(axis=-1))
    amplitude = along * np.cos(phase)[..., None] + across * np.sin(phase)[..., None]
    if noise_std > 0:
        covariance = np.linalg.inv(design.T @ design)
        amplitude = _unbiased(amplitude, float(noise_std**2 * (covariance[1, 1] + covariance[2, 2]) / 2))
    swing = np.abs(amplitude).astype(np.float32)
    low, high = (mean - swing).astype(np.float32), (mean + swing).astype(np.float32)
    check_contrast(low, high, images.mask, settings, ("never modulated", "light them, or leave them out with a mask"))
    direct = 2 * amplitude / (1 - dark)
    total = 2 * mean / (1 + dark)
    modulation = amplitude.sum(axis=-1) / np.maximum(mean.sum(axis=-1), 1e-12)
    parts = images.shaped(direct), images.shaped(total - direct)
    return PhaseSeparation(*parts, _inside(phase, images), _inside(modulation, images))


def _check_phases(phases_rad: Any, count: int) -> NDArray[np.float64]:
    if phases_rad is None:
        return np.asarray(2 * np.pi * np.arange(count) / count)
    phases = np.asarray(phases_rad, dtype=np.float64)
    wanted = f"phases_rad must hold {count} finite numbers, one for each image"
    sound = phases.shape == (count,) and bool(np.isfinite(phases).all())
    require(sound, f"{wanted}, but it has the shape {phases.shape}.")
    apart = np.abs(np.sin((phases[:, None] - phases[None, :]) / 2)) + np.eye(count)
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    fault = f"images {min(i, j)} and {max(i, j)} have the same phase"
    require(bool(apart[i, j] > 1e-3), f"{fault}: a shift is repeated, and another one may be missing.")
    singular = np.linalg.svd(np.stack([np.ones(count), np.sin(phases), np.cos(phases)]), compute_uv=False)
    fault = "the phases lie too close together to determine a sinusoid"
    require(bool(singular[-1] > 0.1 * singular[0]), f"{fault}; spread them over the whole period.")
    return phases


def _check_residual(images: LightStack, design: NDArray[np.float64], inverse: NDArray[np.float64]) -> None:
    """Refuse images that do not follow their phases; noise is independent in neighbouring pixels and does not count."""
    if len(design) == 3 or images.light.shape[2] < 2:
        return
    step = max(1, images.light.shape[1] // 64)
    grey = (images.light[:, ::step] * images.mask[::step, :, None]).mean(axis=-1, dtype=np.float64)
    parts = np.einsum("kn,nhw->khw", inverse, grey)
    left = grey - np.einsum("nk,khw->nhw", design, parts)
    amount = float((left[:, :, 1:] * left[:, :, :-1]).sum(axis=0).mean()) / (len(design) - 3)
    signal = float((parts[1:, :, 1:] * parts[1:, :, :-1]).sum(axis=0).mean())
    ratio = float(np.sqrt(max(amount, 0.0) / max(signal, 1e-30)))
    fault = f"the images do not follow their phases: what no sinusoid explains is {ratio:.1f} times the sinusoid"
    cure = "check their order, and that the pattern is a sinusoid in linear light."
    require(amount <= 0.1 * max(signal, 1e-30) or amount <= 1e-12 * float(np.mean(parts[0] ** 2)), f"{fault}; {cure}")


def _unbiased(amplitude: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Amplitudes (H, W, C) along their common phase, without the bias that fitting this phase to noise gives."""
    channels = amplitude.shape[-1]
    total = channels * variance
    power = np.maximum(np.square(amplitude.sum(axis=-1, keepdims=True)) - total, total)
    return np.asarray(amplitude - variance / np.sqrt(power) + amplitude * total / (2 * power))


def _inside(values: NDArray[np.float64], images: LightStack) -> FloatArray:
    return np.where(images.mask, values, np.nan).astype(np.float32)
