"""Direct and global light of a scene under shifted checkerboards, in linear light (the thesis's
section 3.2.5, after Nayar et al. 2006): the truth that the network `direct` is trained on.

    python training/patterns.py FOLDER --out DIR [--check-px 8] [--patterns WHERE]

All PNG, TIFF and JPEG images of FOLDER are taken, except `black` (source off), `mask` (white where
a result is wanted) and `white`. DIR gets `direct.tiff` and `global.tiff` (float32, 1 = full scale
of the files, NaN outside the mask), 8-bit previews of both, and `report.json`.

- Clean images: maximum and minimum. With 25 images direct light is 1 to 2 % low.
- Noisy images of skin: `--check-px N`, with `--patterns WHERE` if the states are known; if not,
  checks of 5 pixels or more.
- Noisy images of matter in which light does not spread: `--patterns WHERE`, or `estimate`. On skin
  this is a quarter too low.

A pixel whose surface point the pattern lights with brightness s (1 = lit, `dark` = unlit) records
L = s L_direct + k L_global: direct light follows the pattern, global light (scattered in the skin
or between surfaces) sees only the pattern's mean brightness k, because it gathers many checks. With
a fraction `alpha` of the source lit, k = alpha + dark (1 - alpha).

Maximum and minimum over *noisy* images are biased: of 25 images with noise of standard deviation
sigma the direct light comes out about 3.3 sigma too large. Least squares with states that are
known, or found with :func:`estimate_patterns`, has no such bias and less variance.

In skin some global light comes from less than a check away: a pixel at the rim of a lit check
records less than one in its middle. Maximum minus minimum is what it records in the middle; the
mean over all lit and dark images is a fifth to a third less. With `check_px` the spread of the
light is fitted too, and the result is that of the middle.

Source: S. K. Nayar, G. Krishnan, M. D. Grossberg and R. Raskar, "Fast separation of direct and
global components of a scene using high frequency illumination", ACM Transactions on Graphics 25(3),
2006.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import BadInput, naming, require
from splitknit.files import read_bytes
from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.pixels import srgb_code
from splitknit.io.atomic import atomic_folder
from splitknit.io.content import mask_from_image
from splitknit.io.images import (
    MAX_BYTES,
    read_header,
    read_stacks,
    write_float_tiff,
    write_image,
)
from splitknit.io.photograph_files import natural_order
from splitknit.io.provenance import json_text, provenance
from splitknit.io.targets import check_target
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.stored import decode_table, linear_image

MARKER = "direct.tiff"
LINEAR = "linear light, 1 = full scale of the images"


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """Direct and global light under the whole source, NaN outside the mask: together the image that
    it gives."""

    direct: FloatArray
    """(H, W) or (H, W, C): single reflection at the surface, and all transport shorter than the
    pattern's period."""
    # (H, W) or (H, W, C): light that came round, through the skin or from other surfaces
    global_: FloatArray

    @property
    def white(self) -> FloatArray:
        """The image under the whole source: direct plus global light."""
        return self.direct + self.global_


@dataclass(frozen=True, slots=True, eq=False)
class LightStack:
    """A stack that passed the checks."""

    light: FloatArray  # (N, H, W, C) linear light
    mask: BoolArray  # (H, W), true where a result is wanted
    grey: bool  # whether the images came without an axis for channels
    names: tuple[str, ...]  # what messages call the images

    def shaped(self, values: NDArray[Any]) -> FloatArray:
        """`values` (H, W, C) as a result: float32, NaN outside the mask, without the channel axis
        if grey."""
        result = np.array(values, dtype=np.float32)
        result[~self.mask] = np.nan
        return result[..., 0] if self.grey else result

    def separation(
        self, low: NDArray[Any], high: NDArray[Any], alpha: float, dark: float
    ) -> Separation:
        """Direct and global light of the light recorded dark (`low`) and lit (`high`), shaped.

        With k = alpha + dark (1 - alpha): direct = (high - low) / (1 - dark), global = (low - dark
        high) / (k (1 - dark)). S. K. Nayar et al. 2006, eq. 7 and 8, for one fraction alpha in all
        images.
        """
        k = mean_brightness(alpha, dark)
        lit, unlit = np.asarray(high, dtype=np.float64), np.asarray(low, dtype=np.float64)
        parts = (lit - unlit) / (1.0 - dark), (unlit - dark * lit) / (k * (1.0 - dark))
        return Separation(*map(self.shaped, parts))


CLIP_LEVEL = 0.99  # of full scale: linear light from which on a value counts as clipped


def light_stack(
    stack: Any,
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    *,
    files: Sequence[str] = (),
) -> LightStack:
    """Check a stack of linear light, (N, H, W), (N, H, W, C) or a sequence of images, C = 1 or 3,
    and its mask (H, W).

    `clip_level`: linear light from which on a value counts as clipped; None where the images cannot
    clip. Values beyond 1 show that the stack is not a file's [0, 1] scale, and nothing is looked
    for. `files`: the images' names, for messages. Raises BadInput if there are fewer than two
    images, sizes differ, values are not finite, or an image is black or overexposed.
    """
    images = [np.asarray(image) for image in stack]
    require(len(images) >= 2, f"at least 2 images are needed, but there are {len(images)}.")
    names = tuple(f"image {k} ({file})" for k, file in enumerate(files))
    names = names or tuple(f"image {k}" for k in range(len(images)))
    first = images[0].shape
    for name, image in zip(names, images, strict=True):
        require(
            image.shape == first,
            f"{name} has the shape {image.shape}, but {names[0]} has {first}; all must be of one"
            " size and kind.",
        )
    grey = len(first) == 2
    require(
        (grey or (len(first) == 3 and first[2] in (1, 3))) and min(first) > 0,
        "an image must have the shape (H, W) or (H, W, C) with 1 or 3 channels, but it has"
        f" {first}.",
    )
    light = np.stack([np.atleast_3d(image) for image in images]).astype(np.float32)
    for name, image in zip(names, light, strict=True):
        require(np.isfinite(image).all(), f"{name} contains NaN or infinite values.")
    checked = LightStack(light, check_mask(mask, first[:2]), grey, names)
    _check_exposure(checked, clip_level)
    return checked


def _check_exposure(images: LightStack, clip_level: float | None) -> None:
    light, mask = images.light, images.mask
    peaks = np.array([np.quantile(_thinned(image.max(axis=-1), mask), 0.999) for image in light])
    usual = float(np.median(peaks))
    require(peaks.max() > 0, "every image is black; check the light source and capture again.")
    k = int(np.argmin(peaks))
    # an image whose bright pixels stay below this fraction of the other images' is black
    require(
        peaks[k] > 0.03 * usual,
        f"{images.names[k]} is black: its bright pixels reach {peaks[k]:.3g}, those of the others "
        f"{usual:.3g}; its pattern lights nothing, capture it again or leave it out.",
    )
    brightest = light.max(axis=(0, -1))
    if clip_level is None or brightest.max() > 1.0001:
        return
    fraction = float((brightest[mask] >= clip_level).mean())
    # a stack with more clipped pixels is refused: its maximum, so its direct light, is wrong
    require(
        fraction <= 0.02,
        f"{percent(fraction)} of the pixels are saturated (linear value {clip_level:g} or more) in "
        "their brightest image; capture again with a shorter exposure.",
    )


def mean_brightness(alpha: float, dark: float) -> float:
    """Mean brightness k of a pattern of which a fraction `alpha` is lit and the rest has the
    brightness `dark`."""
    require(0 < alpha <= 1, f"alpha must lie in (0, 1], but it is {alpha:g}.")
    require(0 <= dark < 1, f"dark must lie in [0, 1), but it is {dark:g}.")
    return alpha + dark * (1.0 - alpha)


def _thinned(values: NDArray[Any], mask: BoolArray) -> NDArray[Any]:
    """Values inside the mask, thinned to about 200,000 of them."""
    inside = values[mask]
    return inside[:: max(1, inside.size // 200_000)]


def percent(fraction: float) -> str:
    """`fraction` (0 to 1) as a percentage for people, never rounded to nothing."""
    return (
        f"{100 * fraction:.1f} %"
        if fraction >= 0.001 or fraction == 0
        else f"{100 * fraction:.1g} %"
    )


# Whether a stack can hold what its patterns are to show: pixels that change.


_LIT_LEVEL = 0.1
"""Only pixels brighter than this fraction of the brightest ones are checked: no black background,
and nothing that 8 bits cannot resolve."""
_MIN_CONTRAST = 0.005
"""A pixel that changes by less than this fraction of its maximum was never lit, or never dark."""


def check_contrast(low: FloatArray, high: FloatArray, mask: BoolArray) -> None:
    """Refuse a stack in which too many bright pixels do not change."""
    dark, bright = low.max(axis=-1), high.max(axis=-1)
    looked_at = mask & (bright > _LIT_LEVEL * float(np.quantile(_thinned(bright, mask), 0.999)))
    constant = looked_at & (bright - dark <= _MIN_CONTRAST * bright)
    fraction = float(constant.sum()) / max(1.0, float(looked_at.sum()))
    if fraction <= 0.05:  # a stack with more such pixels among the bright ones is refused
        return
    row, column = np.argwhere(constant)[0]
    raise BadInput(
        f"{percent(fraction)} of the bright pixels were never lit or never dark (first at row"
        f" {row}, column {column}): they change by less than {100 * _MIN_CONTRAST:g} % from image"
        " to image; let the patterns reach every pixel, or give a mask."
    )


def check_change(light: FloatArray) -> None:
    """Refuse a stack whose images differ by noise alone, which is independent from pixel to
    pixel."""
    rows = light[:, :: max(1, light[0, ..., 0].size // 60_000)].mean(axis=-1, dtype=np.float64)
    change = rows - rows.mean(axis=0)
    power = float((change * change).mean())
    covariance = max(
        abs(float((change[..., away:] * change[..., :-away]).mean())) for away in (1, 2)
    )
    require(
        covariance > 3.0 / np.sqrt(change[0].size) * power,
        "the images differ by noise at most: the patterns never light the scene; check the"
        " projector, or whether the direct light is too weak to be seen.",
    )


_DECIDED_PART = 1 - 2 * 0.2
"""Part of half the range of its neighbours beyond which a pixel's state is decided."""


def estimate_patterns(
    stack: Any,
    *,
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    files: Sequence[str] = (),
) -> FloatArray:
    """Find the states (N, H, W) of unknown patterns from the images themselves: 1 lit, 0 dark, 0.5
    undecided.

    A pixel's state is read from the mean of its *neighbours* (a Gaussian of one pixel without its
    centre), relative to their own maximum and minimum over the images; in the middle three fifths
    of that range it is undecided. The neighbours share its state and not its noise, so that least
    squares with these states is unbiased in all but the faintest pixels; there it falls short,
    towards zero, where maximum and minimum would invent direct light. Checks must be wider than
    about five pixels.
    """
    images = light_stack(stack, mask, clip_level, files=files)
    kernel = cv2.getGaussianKernel(9, 1.0, cv2.CV_64F)
    around = kernel @ kernel.T
    around[4, 4] = 0.0
    around /= around.sum()
    greys = (np.ascontiguousarray(image.mean(axis=-1)) for image in images.light)
    means = np.stack(
        [cv2.filter2D(grey, cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT) for grey in greys]
    )
    low, high = means.min(axis=0), means.max(axis=0)
    middle = (high + low) / 2
    half = np.maximum((high - low) / 2, 1e-20)
    states = np.full(means.shape, 0.5, dtype=np.float32)
    states[means >= middle + _DECIDED_PART * half] = 1.0
    states[means <= middle - _DECIDED_PART * half] = 0.0
    return states


STATE_EDGE = 0.1
"""Known states are lit from one less this, dark up to this; the rim of a check is left out."""


def check_patterns(patterns: Any, images: LightStack) -> FloatArray:
    """Return known states (N, H, W), checked against the stack they belong to."""
    states = np.asarray(patterns, dtype=np.float32)
    shape = images.light.shape[:3]
    require(
        states.shape == shape,
        f"patterns must have the shape {shape} of the images, but it has {states.shape}.",
    )
    require(
        bool(np.isfinite(states).all()) and states.min() >= 0 and states.max() <= 1,
        "patterns must hold states from 0 (dark) to 1 (lit), without NaN.",
    )
    for reached, word in ((states >= 1 - STATE_EDGE, "lit"), (states <= STATE_EDGE, "dark")):
        never = images.mask & ~reached.any(axis=0)
        if never.any():
            row, column = np.argwhere(never)[0]
            raise BadInput(
                f"{percent(never.sum() / images.mask.sum())} of the pixels are never {word} by the"
                f" patterns (first at row {row}, column {column}): a shift is missing; capture it,"
                " or leave these pixels out with a mask."
            )
    _check_order(images, states)
    return states


def _check_order(images: LightStack, states: FloatArray) -> None:
    step = max(1, int(np.count_nonzero(images.mask)) // 40_000)
    light = images.light.mean(axis=-1)[:, images.mask][:, ::step].astype(np.float64)
    light -= light.mean(axis=0)
    known = states[:, images.mask][:, ::step].astype(np.float64)
    known = np.ma.masked_inside(known, STATE_EDGE, 1 - STATE_EDGE)  # undecided
    decided = ~np.ma.getmaskarray(known)
    known = (known - known.mean(axis=0)).filled(0.0)
    power = (known * known).sum(axis=1) * ((light * light) @ decided.T)
    correlation = light @ known.T / np.sqrt(np.maximum(power, 1e-30))
    for k, best in enumerate(np.argmax(correlation, axis=1)):
        require(
            correlation[k, k] > 0.02,
            f"{images.names[k]} does not show its pattern at all; check that images and patterns"
            " belong together.",
        )
        require(
            correlation[k, best] < correlation[k, k] + 0.02,
            f"{images.names[k]} shows pattern {best} instead of its own: a shift is repeated,"
            " missing or out of order.",
        )


def checkerboard(
    stack: Any,
    *,
    alpha: float = 0.5,
    dark: float = 0.0,
    patterns: Any = None,
    check_px: float | None = None,
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    files: Sequence[str] = (),
) -> Separation:
    """Separate direct from global light.

    Without `patterns`: each pixel's maximum and minimum over the images (Nayar et al.; the thesis's
    3.54 to 3.57). With `patterns`: least squares of L = s L_direct + k L_global over a pixel's
    images, s = dark + (1 - dark) P, with images left out in which the pixel lies on the rim of a
    check (P neither lit nor dark: there P is uncertain and the direct light partly missing). It is
    unbiased, since the states do not depend on the noise.

    With `patterns` and `check_px`, for matter in which light spreads: least squares of L = a + b s
    + c m, where m is s averaged over a square of 0.8 checks around the pixel, with the weights |2 m
    - 1|, evaluated where the pixel lies nearest to the middle of a lit and of a dark check. These
    places are known: no bias by noise. Raises BadInput if the stack is inconsistent: pixels never
    lit or never dark, saturated or black images, sizes that differ, NaN, images that do not show
    their patterns.

    stack : (N, H, W) or (N, H, W, C), N >= 2, linear light, black level removed; all patterns have
    the same `alpha`
    alpha : fraction of the source that is lit, in (0, 1]
    dark : brightness of the unlit part over the lit one, in [0, 1); zero where a "black" image was
    subtracted
    patterns : (N, H, W) in [0, 1], state P of the pattern at each camera pixel: 1 lit, 0 dark
    check_px : side of a check on the camera's pixels, for skin; without, global light is the same
    under all shifts
    mask : (H, W) bool
    clip_level, files : of :func:`light_stack`

    Source: S. K. Nayar et al., "Fast separation of direct and global components of a scene using
    high frequency illumination", ACM Transactions on Graphics 25(3), 2006, section 3.

    >>> import numpy as np
    >>> board = np.kron([[1.0, 0.0], [0.0, 1.0]], np.ones((4, 4)))
    >>> patterns = np.stack([board, np.roll(board, 4, axis=1)])
    >>> parts = checkerboard(0.3 * patterns + 0.5 * 0.2, patterns=patterns)
    >>> bool(np.allclose(parts.direct, 0.3) and np.allclose(parts.global_, 0.2))
    True
    """
    mean_brightness(alpha, dark)
    require(
        check_px is None or patterns is not None,
        "check_px needs patterns, the states of the pixels.",
    )
    require(
        check_px is None or 1 <= check_px <= 1e4,
        f"check_px must be at least 1, but it is {check_px}.",
    )
    images = light_stack(stack, mask, clip_level, files=files)
    if patterns is None:
        low, high = images.light.min(axis=0), images.light.max(axis=0)
        check_contrast(low, high, images.mask)
        check_change(images.light)
        return images.separation(low, high, alpha, dark)
    states = check_patterns(patterns, images)
    if check_px is None:
        return Separation(*map(images.shaped, _by_states(images.light, states, alpha, dark)))
    low, high = _in_the_middle(images.light, states, check_px)
    return images.separation(low, high, alpha, dark)


def _by_states(
    light: FloatArray, states: FloatArray, alpha: float, dark: float
) -> tuple[FloatArray, FloatArray]:
    """Direct and global light (H, W, C) by least squares over the images in which a pixel is lit or
    dark."""
    k = mean_brightness(alpha, dark)
    direct = np.empty(light.shape[1:], dtype=np.float32)
    global_ = np.empty_like(direct)

    def work(rows: slice) -> None:
        state = states[:, rows].astype(np.float64)
        terms = np.stack([np.ones_like(state), dark + (1 - dark) * state], axis=-1)
        fitted = _fitted(terms, _decided(state), light[:, rows])
        direct[rows] = fitted[:, :, 1]
        global_[rows] = fitted[:, :, 0] / k

    for_each_chunk(work, light.shape[1], light.shape[2], 4 * light[:, 0, 0].size)
    return direct, global_


def _in_the_middle(
    light: FloatArray, states: FloatArray, check_px: float
) -> tuple[FloatArray, FloatArray]:
    """Light (H, W, C) of each pixel where it is nearest to the middle of a dark and of a lit check.
    The pattern's mean over a square somewhat smaller than a check, 1 or 0 in its middle and 1/2 at
    its rim, stands for the light from around, and weighs the images.
    """
    around = np.stack([_square_mean(state, 0.8 * check_px) for state in states])
    low = np.empty(light.shape[1:], dtype=np.float32)
    high = np.empty_like(low)

    def work(rows: slice) -> None:
        near = around[:, rows].astype(np.float64)
        terms = np.stack([np.ones_like(near), states[:, rows], near], axis=-1)
        weights = _decided(states[:, rows]) * np.abs(2 * near - 1)
        fitted = _fitted(terms, weights, light[:, rows])
        for part, image in ((low, near.argmin(axis=0)), (high, near.argmax(axis=0))):
            term = np.take_along_axis(terms, image[None, ..., None], axis=0)[0]
            part[rows] = np.einsum("hwk,hwkc->hwc", term, fitted)

    for_each_chunk(work, light.shape[1], light.shape[2], 6 * light[:, 0, 0].size)
    return low, high


def _decided(states: FloatArray) -> BoolArray:
    """Whether a pixel is lit or dark, and not at the rim of a check."""
    return (states <= STATE_EDGE) | (states >= 1 - STATE_EDGE)


def _fitted(terms: FloatArray, weights: FloatArray | BoolArray, light: FloatArray) -> Array:
    """Coefficients (h, W, K, C) of terms (N, h, W, K) by weighted least squares in each pixel of
    `light` (N, h, W, C)."""
    weighted = terms * weights[..., None]
    normal = np.einsum("nhwk,nhwl->hwkl", weighted, terms)
    # where no shift separates the terms they share the light; far too little to bias what is known
    normal += 1e-9 * np.trace(normal, axis1=2, axis2=3)[..., None, None] * np.eye(terms.shape[-1])
    return np.asarray(np.linalg.solve(normal, np.einsum("nhwk,nhwc->hwkc", weighted, light)))


def _square_mean(state: FloatArray, side_px: float) -> FloatArray:
    """Mean (H, W) over a square around each pixel, whose side need not be whole pixels."""
    reach = int(np.ceil(max(side_px - 1, 0) / 2))
    fraction = np.ones(2 * reach + 1)
    if reach > 0:
        fraction[[0, -1]] = (side_px - (2 * reach - 1)) / 2
    fraction /= fraction.sum()
    return np.asarray(
        cv2.sepFilter2D(state, cv2.CV_32F, fraction, fraction, borderType=cv2.BORDER_REFLECT)
    )


# Photographs of a scene under patterns, as linear light.


ESTIMATE = "estimate"
_NOT_LIT = ("black", "white", "mask")
_SUFFIXES = {".png", ".tif", ".tiff", ".jpg", ".jpeg"}


@dataclass(frozen=True, slots=True, eq=False)
class PatternLight:
    """The images of a folder as linear light without the black level."""

    names: tuple[str, ...]  # of the images
    stack: FloatArray  # (N, H, W) or (N, H, W, 3)
    patterns: FloatArray | None  # (N, H, W) given states
    mask: BoolArray | None  # (H, W)
    clip_level: float  # value at which the files clip
    hashes: dict[str, str]  # SHA-256 by name


def lit_images(folder: Path) -> list[Path]:
    """The images of a folder but for ``black``, ``white`` and ``mask``."""
    return [file for file in _images_in(folder) if file.stem.lower() not in _NOT_LIT]


def read_light(folder: Path, states: Path | None = None, encoding: str = "linear") -> PatternLight:
    """Read all images of a folder, and of a folder of `states`, in the order of their names
    (``a_2`` before ``a_10``), ``black`` and ``mask`` apart and without ``white``; hashes go by
    names relative to the folder, wherever that lies.
    """
    for place in (folder, *([] if states is None else [states])):
        kind = "images" if place == folder else f"patterns (nor the word '{ESTIMATE}')"
        require(place.is_dir(), f"'{place}' is not a folder of {kind}.")
    files = _images_in(folder)
    roles = {file.stem.lower(): file for file in files if file.stem.lower() in ("black", "mask")}
    images = lit_images(folder)
    require(
        len(images) > 0, f"'{folder}' holds no PNG, TIFF or JPEG images; name the folder that does."
    )
    groups = {"images": images, **{role: [file] for role, file in roles.items()}}
    if states is not None:
        groups["states"] = _images_in(states)
    first = str(images[0])
    header = read_header(read_bytes(first, MAX_BYTES), first)
    stacks, hashes = read_stacks(groups, (header.rows, header.columns), first)
    pixels = stacks["images"]
    singles = {role: stacks[role][0] for role in roles}
    channels = pixels.shape[3]

    black = np.zeros(1, dtype=np.float32)
    if "black" in singles:
        light = linear_image(singles["black"], encoding)
        black = light if light.shape[2] == channels else light.mean(axis=-1, keepdims=True)
    stack = np.empty(pixels.shape, dtype=np.float32)
    for k, image in enumerate(pixels):
        stack[k] = linear_image(image, encoding) - black
    table = decode_table(pixels.dtype, encoding)
    some = 0 if channels == 1 else slice(None)
    patterns = None
    if states is not None:
        of_states = [linear_image(image, "linear") for image in stacks["states"]]
        patterns = np.stack([image.mean(axis=-1) for image in of_states])
    named = {Path(name): value for name, value in hashes.items()}
    return PatternLight(
        tuple(file.name for file in images),
        stack[..., some],
        patterns,
        mask_from_image(singles["mask"], str(roles["mask"])) if "mask" in singles else None,
        float(table[int(0.994 * (table.size - 1))]) - float(np.median(black)),
        {
            (p.relative_to(folder).as_posix() if p.is_relative_to(folder) else p.name): v
            for p, v in named.items()
        },
    )


def _images_in(folder: Path) -> list[Path]:
    files = [
        file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file()
    ]
    return sorted(files, key=lambda file: (natural_order(file.stem), file.name))


# A folder in, a folder out.


NO_CHECK_PX = (
    "global light was taken to be the same under all shifts; on skin it is not, and direct light"
    " comes out a quarter too low: give --check-px for skin."
)
NEGATIVE = (
    "global light is negative in {:.0f} % of the lit pixels: check alpha, dark and the black image."
)
_REPORTED_LEVEL = 0.1
"""Figures of the report are over pixels brighter than this fraction of the brightest."""


def light_picture(light: FloatArray) -> NDArray[np.uint8]:
    """8 bits for people: black to the 99.9th percentile, sRGB curve; black where nothing is
    known."""
    top = max(float(np.nanquantile(light, 0.999)), 1e-12)
    scaled = np.clip(np.nan_to_num(light) / top, 0.0, 1.0)
    return np.asarray(np.round(255 * srgb_code(scaled)), dtype=np.uint8)


def separate_folder(
    folder: Path,
    out: Path,
    *,
    alpha: float = 0.5,
    dark: float = 0.0,
    patterns: str | None = None,
    encoding: str = "linear",
    check_px: float | None = None,
) -> dict[str, Any]:
    """Separate the images in `folder`, write all results into `out`, return the facts of
    ``report.json``.

    `alpha`, `dark`, `check_px`: of :func:`checkerboard`; `patterns`: a folder of state images, or
    ``estimate``. Raises BadInput naming the file or the folder at fault; nothing is left
    half-written.
    """
    if patterns is None and check_px is not None:  # of use only with states
        patterns = ESTIMATE
    require(
        patterns != ESTIMATE or (check_px or 5) >= 5,
        f"{folder}: states can be found in the images where checks have 5 pixels or more, but "
        f"check_px is {check_px}; give the states as patterns.",
    )
    states_folder = None if patterns in (None, ESTIMATE) else Path(str(patterns))
    check_target(out, MARKER, "an earlier separation", keep=folder)
    with atomic_folder(out) as target:
        light = read_light(folder, states_folder, encoding)
        common: dict[str, Any] = {
            "mask": light.mask,
            "clip_level": light.clip_level,
            "files": light.names,
        }
        model = {"alpha": alpha, "dark": dark, "check_px": check_px}

        def separated() -> Separation:
            states = light.patterns
            if patterns == ESTIMATE:
                states = estimate_patterns(light.stack, **common)
            return checkerboard(light.stack, patterns=states, **model, **common)

        parts = naming(folder, separated)
        choices = {
            **model,
            "encoding": encoding,
            "patterns": "given" if states_folder else patterns,
        }
        origin = provenance({"separate": choices}, light.hashes)
        for name, part in (("direct", parts.direct), ("global", parts.global_)):
            write_float_tiff(target / f"{name}.tiff", part, LINEAR, origin)
            write_image(target / f"{name}.png", light_picture(part))
        facts = {**origin, **_figures(parts, light)}
        if patterns is not None and check_px is None:
            facts["notes"].append(NO_CHECK_PX)
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _figures(parts: Separation, light: PatternLight) -> dict[str, Any]:
    total = parts.white
    grey = total if total.ndim == 2 else total.mean(axis=-1)
    lit = grey > _REPORTED_LEVEL * np.nanquantile(grey, 0.999)  # NaN is not
    require(lit.any(), "nothing is lit; the images are black.")
    negative = float((parts.global_[lit] < 0).mean())
    return {
        "images": list(light.names),
        "image_size": list(light.stack.shape[1:3]),
        "direct_share": float(np.median(parts.direct[lit] / np.maximum(total[lit], 1e-9))),
        "negative_global_share": negative,
        "notes": [NEGATIVE.format(100 * negative)] if negative > 0.05 else [],
    }


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--alpha", type=float, default=0.5, help="fraction that is lit")
    parser.add_argument("--dark", type=float, default=0.0, help="brightness of the unlit part")
    parser.add_argument("--patterns", help="folder of states (white = lit), or 'estimate'")
    parser.add_argument("--encoding", choices=("linear", "srgb"), default="linear")
    parser.add_argument("--check-px", type=float, help="side of a check on the images, for skin")
    try:
        facts = separate_folder(**vars(parser.parse_args(words)))
    except BadInput as error:
        sys.stderr.write(f"patterns.py: error: {error}\n")
        return 2
    direct = f"{100 * facts['direct_share']:.0f} % of the light is direct in the median"
    print(f"{len(facts['images'])} images separated: {direct}.", *facts["notes"], sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
