"""Direct and global light from shifted checkerboards at four times as many phases as there are images.

Derivation. A checkerboard with equal checks has the brightness 1/2 + chi / 2 with chi = +1 or -1. Light adds up, so
that an image under it is L = W / 2 + D / 2: W is the image under full light, D the response to chi (of either sign).
Moved by one check along one axis chi changes its sign everywhere, and so does D. A period is two checks; with an *odd*
number n of equal steps along it no step is a whole check, so that each image gives D at four phases: its own, the two a
check away along one axis (-D), and the one a check away along both (+D). Images in steps of 2 / n of a check hold D in
steps of 1 / n: 25 images know it at 100 phases.

Maximum minus minimum over *all* phases is the largest D. It lies between the known phases: a parabola through the
largest one and its neighbours along each axis finds it. Which one is the largest is decided on D averaged over three
phases each way, all channels together: where D has a flat top (surface reflection, opaque matter) that takes its
middle, from where a parabola adds nothing, rather than its rim, from where it would overshoot.

A projector whose dark checks have the brightness b throws (1 + b) / 2 + (1 - b) chi / 2, so that
D = (2 L - (1 + b) W) / (1 - b).
"""

from __future__ import annotations

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
    by_rows,
    check_contrast,
    check_fraction,
    check_repeats,
    check_shifts,
    light_stack,
)


def by_symmetry(
    stack: Any,
    *,
    white: Any = None,
    dark: float = 0.0,
    check_px: float | None = None,
    shifts: Any = None,
    period: Any = None,
    mask: Any = None,
    settings: StackSettings = DEFAULTS,
) -> Separation:
    """Separate direct from global light (Nayar et al. 2006, equations 3 and 4) by n x n shifts of a checkerboard, n
    odd.

    For *clean* stacks: D is twice an image, its noise too, and on noisy skin the result is worse than plain maximum
    minus minimum. For checks of n pixels or more: then the phases of the result are not finer than a pixel. Half of the
    pattern is lit, and its n steps along each axis are equal and fill one period. Raises BadInput if the number of
    images is not an odd square, shifts are missing, repeated, unequal or do not fill the period, neighbouring phases
    contradict each other (order, period, noise), the white image does not belong to the stack, checks are too small, or
    the stack is unusable as for :func:`splitknit.separation.binary.checkerboard`.

    stack : (n n, H, W) or (n n, H, W, C), n odd, 9 images at least, linear light, black level removed
        Without `shifts` the shift along one axis changes from image to image, along the other after each n images.
    white : (H, W) or (H, W, C), the image under the whole source, which makes the result on skin 5 to 10 dB better
        None takes 2 / (1 + dark) times the stack's mean, true but for the n-th harmonics of the pattern.
    dark : brightness of the unlit checks relative to the lit ones, in [0, 1)
    check_px : side of a check on the camera's pixels, optional; only checked
    shifts : (n n, 2), optional, of each image's pattern, in any order; needs `period`
    period : number or pair, of the pattern (two checks) in the units of `shifts`
    mask : (H, W) bool, optional

    >>> board = np.kron([[1.0, 0.0] * 2, [0.0, 1.0] * 2] * 2, np.ones((5, 5)))
    >>> patterns = [np.roll(board, (2 * i, 2 * j), axis=(0, 1)) for i in range(5) for j in range(5)]
    >>> parts = by_symmetry(0.3 * np.stack(patterns) + 0.5 * 0.2)
    >>> bool(abs(parts.white - 0.5).max() < 0.02)
    True
    """
    check_fraction(dark, "dark")
    images = light_stack(stack, least=9, mask=mask, settings=settings)
    count = len(images.light)
    steps = round(count**0.5)
    fault = f"separation by symmetry needs the square of an odd number of images (9, 25, 49), but there are {count}"
    cure = "without them take maximum and minimum (method checkerboard)."
    require(steps**2 == count and steps % 2 == 1, f"{fault}; {cure}")
    good = check_px is None or check_px >= steps
    fault = f"separation by symmetry with {steps} shifts each way needs checks of {steps} pixels or more,"
    require(good, f"{fault} but check_px is {check_px}; take maximum and minimum (method checkerboard).")
    light = images.light if shifts is None else images.light[_row_by_row(shifts, period, count, steps)]
    low, high = light.min(axis=0), light.max(axis=0)
    words = ("never lit or never dark", "let the patterns reach every pixel, or give a mask")
    check_contrast(low, high, images.mask, settings, words)
    check_repeats(images.light, images.mask, settings)
    total = np.asarray(light.mean(axis=0, dtype=np.float64) * 2 / (1 + dark), dtype=np.float32)
    if white is not None:
        total = _check_white(white, total, images)
    _check_neighbours(light, total, dark, images)
    direct = np.empty_like(total)

    def work(rows: slice) -> None:
        direct[rows] = _largest(_responses(light[:, rows], total[rows], dark))

    by_rows(6 * light[:, 0].size, light.shape[1], work)
    return Separation(images.shaped(direct), images.shaped(total - direct))


def _row_by_row(shifts: Any, period: Any, count: int, steps: int) -> NDArray[np.intp]:
    """Order of the images in which the second axis's shift changes fastest."""
    require(period is not None, "separation by symmetry needs the period of the shifts, in their units.")
    check_shifts(shifts, count, period)
    table = np.asarray(shifts, dtype=np.float64)
    length = np.broadcast_to(np.asarray(period, dtype=np.float64), (2,))
    require(table.shape == (count, 2), "separation by symmetry needs shifts along two axes, a pair for each image.")
    places = (table - table.min(axis=0)) * steps / length
    places -= np.round(places[0]) - places[0]  # which phase counts as the first does not matter
    whole = np.round(places).astype(np.int64) % steps
    require(
        float(np.abs(places - np.round(places)).max()) < 0.05
        and np.unique(whole[:, 0] * steps + whole[:, 1]).size == count,
        f"separation by symmetry needs {steps} equal steps along each axis that fill the period {period}; take maximum "
        f"and minimum (method checkerboard) with other shifts.",
    )
    return np.argsort(whole[:, 0] * steps + whole[:, 1], kind="stable")


def _check_white(white: Any, found: FloatArray, images: LightStack) -> FloatArray:
    """Return the white image (H, W, C) if twice the mean image confirms it."""
    given = np.asarray(white, dtype=np.float32)
    shape = found.shape[:2] if images.grey else found.shape
    require(given.shape == shape, f"white must have the shape {shape} of the images, but it has {given.shape}.")
    require(bool(np.isfinite(given).all()), "white contains NaN or infinite values.")
    given = given.reshape(found.shape)
    bright = images.mask[..., None] & (found > 0.1 * float(np.quantile(found[images.mask], 0.999)))
    ratio = float(np.median(given[bright] / found[bright]))
    cure = "check exposure, black level and dark, and that the shifts fill one period in equal steps."
    require(abs(ratio - 1) < 0.1, f"the white image is {ratio:.2f} times what the mean of the images promises; {cure}")
    return given


def _check_neighbours(light: FloatArray, total: FloatArray, dark: float, images: LightStack) -> None:
    """Refuse responses that do not go on from phase to phase: their correlation is 1 - 2 / n under an ideal pattern."""
    step = max(1, light.shape[1] // 128)
    inside, every = images.mask[::step, :, None], (*light[:, ::step], total[::step])
    grey = [part.mean(axis=-1, keepdims=True, dtype=np.float32) * inside for part in every]
    found = _responses(np.stack(grey[:-1]), grey[-1], dark)
    power = float(np.mean(np.square(found, dtype=np.float64)))
    for axis in (0, 1):
        correlation = float(np.mean(found * _next(found, axis), dtype=np.float64)) / max(power, 1e-30)
        require(
            correlation > 0.75 * (1 - 2 / len(found)),
            f"neighbouring phases of the pattern have little in common (correlation {correlation:.2f}): the images are "
            f"out of order, their shifts do not fill one period in equal steps, or there is too much noise; give "
            f"shifts and period, or take maximum and minimum (method checkerboard).",
        )


def _responses(light: FloatArray, total: FloatArray, dark: float) -> FloatArray:
    """Response D (n, n, h, w, C) to +-1 checks at the phases from 0 to (n - 1) / n of a check along both axes."""
    steps = round(len(light) ** 0.5)
    result = np.empty((steps, steps, *total.shape), dtype=np.float32)
    for k, image in enumerate(light):
        rows, columns = (2 * place for place in divmod(k, steps))  # phase in n-ths of a check
        sign = np.float32(1 if (rows < steps) == (columns < steps) else -1)
        result[rows % steps, columns % steps] = sign * (2 * image - np.float32(1 + dark) * total) / np.float32(1 - dark)
    return result


def _next(responses: FloatArray, axis: int, step: int = 1) -> FloatArray:
    """Responses one phase further along an axis (or back, `step` -1); beyond a check they come again, negative."""
    result = np.roll(responses, -step, axis=axis)
    crossed: list[slice | int] = [slice(None)] * result.ndim
    crossed[axis] = -1 if step > 0 else 0
    result[tuple(crossed)] *= -1
    return result


def _largest(responses: FloatArray) -> FloatArray:
    """Largest response (h, w, C) over all phases of the period."""
    steps, _, *size = responses.shape
    score = responses.sum(axis=-1)
    for axis in (0, 1):
        score = score + _next(score, axis) + _next(score, axis, -1)
    score = score.reshape(steps * steps, *size[:2])
    best = np.abs(score).argmax(axis=0)[None]
    sign = np.sign(np.take_along_axis(score, best, axis=0)[0])[..., None]

    def there(values: FloatArray) -> FloatArray:
        flat = values.reshape(steps * steps, *size)
        return np.asarray(sign * np.take_along_axis(flat, best[..., None], axis=0)[0])

    here = there(responses)
    result = here.copy()
    for axis in (0, 1):
        below, above = there(_next(responses, axis, -1)), there(_next(responses, axis))
        slope, bend = (above - below) / 2, above + below - 2 * here
        arched = bend < -1e-6 * np.abs(here)
        place = np.where(arched, np.clip(-slope / np.where(arched, bend, -1), -1, 1), np.sign(slope))
        result += slope * place + bend * place**2 / 2
    return result
