"""Contrast of the ridges on the one film frame of real skin, beside both simulators.

    python validation/real_skin/film.py [--data FOLDER]    # prints and writes tables/film.csv

The frame: `author_film` of the project's data (one finger, one white LED, H.264). Contrast is the
amplitude of the ridges over the local mean: in patches of five ridges, the power in the lobe of the
ridges less the noise beside it. A colour's is what of it is in phase with the luma. The frame's red
is clipped and its chroma has no ridges, so simulated frames are compared after the same chain.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import read_capture
from splitknit_simulator import simulate_capture

Array = NDArray[np.float64]
Row = dict[str, str]

TABLE = Path(__file__).with_name("tables") / "film.csv"
HEADS = (
    "figure",
    "red",
    "green",
    "blue",
    "luma",
    "nir",
    "red_over_green",
    "nir_over_green",
    "second_harmonic",
)
"""Contrasts in percent, and ratios; with the range of twelve fingers, or 95 % of patches drawn
again."""
DATA = Path(os.environ.get("SPLITKNIT_DATA", Path(__file__).parents[3] / "shared" / "data"))
FILM_PX_PER_MM = 235.0 / 16.0
"""The finger is 235 px wide in the white frame; its width of 16 mm is assumed."""
CREASE_ROW = 490
"""The frame's patches lie above the crease."""
BORDER_MM = 1.5
"""No patch comes nearer to the outline."""
PATCH_PX = 32
PERIODS_PX = (4.2, 9.5)
"""Where the ridges' period is looked for."""
LOBE = 0.05
"""Radius of the ridges' lobe in the spectrum, cycles a pixel: what the window leaves of a line."""
LUMA = np.array((0.299, 0.587, 0.114))
SEEDS = range(12)
SCALE = 0.5
"""Of the simulated frames before they are reduced to the film's."""
CODED_GREEN = 0.286
"""Mean of the film's green, to which simulated frames are exposed."""
CODED_CLIP = 0.363
"""At which the film's red is clipped, all over the finger."""
QUALITIES = (95, 75)
"""Of the JPEG, with 4:2:0 chroma, that stands for the film's codec."""
CROP_FROM_FRAME = np.array(((2.3217, 0.3483, -663.5), (-0.3461, 2.3236, -298.9)), dtype=np.float32)
"""Where the frame's pixels lie in the film's enlarged grey picture, to begin with."""
ACROSS = np.linspace(-0.8, 0.8, 17)
"""Places across the finger, of half its width, for the profile of its brightness."""
RESAMPLES = 2000
LENS_PX = (0.0, 0.75)
"""Standard deviation of the film's blur beyond the simulated lens: none, and as wide as its dust
specks."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Sums over the ridges' lobe in N patches, relative to the patch's means."""

    own: Array
    """(N, C) power of each channel."""
    shared: Array
    """(N, C) what it shares with the guide."""
    guide: Array
    """(N,) power of the guide."""
    period_px: Array
    second: Array
    """(N,) power of the guide at half the period."""

    def amplitudes(self, rows: NDArray[np.int64] | slice = slice(None)) -> Array:
        """(C,) of each channel in phase with the guide."""
        return np.asarray(self.shared[rows].mean(0) / np.sqrt(max(self.guide[rows].mean(), 1e-12)))

    def alone(self, rows: NDArray[np.int64] | slice = slice(None)) -> Array:
        """(C,) of each channel, in whatever phase; negative where the noise beside is larger."""
        power = self.own[rows].mean(0)
        return np.asarray(np.sign(power) * np.sqrt(np.abs(power)))

    def harmonic(self, rows: NDArray[np.int64] | slice = slice(None)) -> float:
        """Amplitude at half the period over that at the period."""
        ratio = self.second[rows].mean() / max(self.guide[rows].mean(), 1e-12)
        return float(np.sqrt(max(ratio, 0.0)))


def measured(image: Array, guide: Array, mask: NDArray[np.bool_]) -> Patches:
    """Measure `image` (H, W, C) where `guide` (H, W) has ridges."""
    size = PATCH_PX
    window = np.outer(np.hanning(size + 2)[1:-1], np.hanning(size + 2)[1:-1])
    across, down = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size))
    radius = np.hypot(across, down)
    ring = (radius > 1 / PERIODS_PX[1]) & (radius < 1 / PERIODS_PX[0])
    # twice the mean square is the square of the amplitude
    norm = 2.0 / (size * size * np.sum(window**2))
    rows = []
    for y in range(0, mask.shape[0] - size + 1, size):
        for x in range(0, mask.shape[1] - size + 1, size):
            cut = np.s_[y : y + size, x : x + size]
            if not mask[cut].all():
                continue
            stack = np.concatenate([guide[cut][..., None], image[cut]], axis=2)
            means = np.average(stack.reshape(-1, stack.shape[2]), axis=0, weights=window.ravel())
            spectra = np.fft.fft2((stack / means - 1.0) * window[..., None], axes=(0, 1))
            power = np.abs(spectra[..., 0]) ** 2
            peak = np.unravel_index(np.argmax(np.where(ring, power, -1.0)), power.shape)
            place = across[peak], down[peak]

            def excess(values: Array, order: int, place: tuple[float, float] = place) -> Array:
                """Sum over the lobes at `order` times the peak, less the noise beside them."""
                u, v = order * place[0], order * place[1]
                near = np.hypot(across - u, down - v) < LOBE
                near |= np.hypot(across + u, down + v) < LOBE
                beside = (np.abs(radius - np.hypot(u, v)) < LOBE) & ~near
                noise = near.sum() * values[beside].mean(0)
                return np.asarray(norm * (values[near].sum(0) - noise), dtype=np.float64)

            cross = np.real(spectra[..., 1:] * np.conj(spectra[..., :1]))
            own = np.abs(spectra[..., 1:]) ** 2
            second = excess(power, 2) if 2 * radius[peak] < 0.45 else np.nan
            rows.append(
                (excess(own, 1), excess(cross, 1), excess(power, 1), 1 / radius[peak], second)
            )
    own, shared, first, period, second = (np.array(part) for part in zip(*rows, strict=True))
    return Patches(own, shared, first, period, np.nan_to_num(second))


def linear(coded: Array) -> Array:
    """sRGB's transfer."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def coded(light: Array) -> Array:
    """Its inverse."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def with_luma(image: Array) -> Array:
    """(H, W, 4) red, green, blue and their luma."""
    return np.concatenate([image, (image @ LUMA)[..., None]], axis=2)


def inner(mask: NDArray[np.bool_], px_per_mm: float) -> NDArray[np.bool_]:
    """Pixels of `mask` away from its outline; the finger may run out of the picture."""
    distance = ndimage.distance_transform_edt(np.pad(mask, 1, mode="edge"))[1:-1, 1:-1]
    return np.asarray(distance > BORDER_MM * px_per_mm)


def frame(path: Path) -> Array:
    """(H, W, 3) coded values, 0 to 1."""
    stored = np.asarray(cv2.imread(str(path)))
    return np.asarray(stored[..., ::-1], dtype=np.float64) / 255


def through_film(
    light: Array, mask: NDArray[np.bool_], code: bool, blur: float, quality: int
) -> Array:
    """(H, W, 3) what the film would show of linear `light`: exposure, clipped red, blur, transfer
    (`code`: sRGB, else none), 4:2:0 and quantisation."""
    seen = light if blur == 0 else cv2.GaussianBlur(light, (0, 0), blur)
    levels = (linear(np.array(CODED_GREEN)), linear(np.array(CODED_CLIP)))
    green, clip = levels if code else (CODED_GREEN, CODED_CLIP)
    seen = seen * (green / seen[mask][:, 1].mean())
    seen[..., 0] *= clip / np.percentile(seen[mask][:, 0], 1)
    seen[..., 0] = np.minimum(seen[..., 0], clip)
    values = np.rint(255 * (coded(seen) if code else np.clip(seen, 0, 1))).astype(np.uint8)
    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    _, bytes_ = cv2.imencode(
        ".jpg", values[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality, *sampling]
    )
    shown = np.asarray(cv2.imdecode(bytes_, cv2.IMREAD_COLOR))
    return np.asarray(shown[..., ::-1], dtype=np.float64) / 255


@dataclass(frozen=True, slots=True, eq=False)
class Finger:
    """Linear frames (L, H, W, 3) of a simulated finger on the film's pixels."""

    white: Array
    nir: Array
    outline: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    """Where patches lie: away from the outline."""


def reduced(bands: dict[str, Array], mask: NDArray[np.bool_], px_per_mm: float) -> Finger:
    """Bring frames to the film's pixels."""
    factor = FILM_PX_PER_MM / px_per_mm

    def small(image: Array) -> Array:
        resized = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        return np.asarray(resized, dtype=np.float64).reshape(*resized.shape[:2], -1)

    white, nir = (np.stack([small(image) for image in bands[name]]) for name in ("white", "nir"))
    inside = small(mask.astype(np.float64))[..., 0] > 0.999
    return Finger(white, nir, inside, inner(inside, FILM_PX_PER_MM))


def simulated() -> Iterator[Finger]:
    """Fingers of the project's simulator."""
    for seed in SEEDS:
        capture, truth = simulate_capture(seed, None, {"scale": SCALE})
        bands = {
            name: band.pixels / float(np.iinfo(band.pixels.dtype).max)
            for name, band in capture.bands.items()
        }
        yield reduced(bands, truth["mask"], capture.rig.camera.px_per_mm)


def walked(data: Path, name: str) -> Finger:
    """A finger of the path tracer."""
    capture = read_capture(data / "path_traced" / name)
    bands = {key: band.pixels / 65535.0 for key, band in capture.bands.items()}
    with np.load(data / "path_traced" / f"{name}_truth.npz") as truth:
        return reduced(bands, truth["mask"], capture.rig.camera.px_per_mm)


def of_finger(finger: Finger, code: bool) -> Array:
    """(7,) contrast of red, green, blue, luma, NIR, red over green, NIR over green: mean of the
    lights."""
    rows = []
    for white, nir in zip(finger.white, finger.nir, strict=True):
        image, dark = (coded(white), coded(nir)) if code else (white, nir)
        image = with_luma(image)
        at = measured(image, image[..., 3], finger.mask).amplitudes()
        infrared = measured(dark[..., :1], image[..., 3], finger.mask).alone()
        rows.append([*at, *infrared, at[0] / at[1], infrared[0] / at[1]])
    return np.asarray(np.mean(rows, axis=0))


def of_film(finger: Finger, code: bool, blur: float, quality: int) -> Array:
    """(3,) contrast of luma, red over green and second harmonic after the film's chain: mean of
    the lights."""
    rows = []
    for white in finger.white:
        image = with_luma(through_film(white, finger.mask, code, blur, quality))
        patches = measured(image, image[..., 3], finger.mask)
        at = patches.amplitudes()
        rows.append([at[3], at[0] / at[1], patches.harmonic()])
    return np.asarray(np.mean(rows, axis=0))


def profile(channel: Array, mask: NDArray[np.bool_], rows: Sequence[int]) -> Array:
    """(8,) logarithm of the brightness across the finger, both sides' mean, from the middle out."""
    lines = []
    for row in rows:
        columns = np.flatnonzero(mask[row])
        middle, half = columns[[0, -1]].mean(), 0.5 * np.ptp(columns[[0, -1]])
        lines.append(np.interp(middle + ACROSS * half, np.arange(len(mask[row])), channel[row]))
    mean = np.mean(lines, axis=0)
    mean = (mean + mean[::-1])[len(ACROSS) // 2 :]
    return np.asarray(np.log(mean[1:] / mean[0]))


def exponents(finger: Finger, film: Array) -> list[float]:
    """Power of linear light that the film's profile has: 1 linear, about 0.5 sRGB's transfer."""
    top = np.flatnonzero(finger.outline.any(axis=1))[0]
    rows = [top + round(millimetres * FILM_PX_PER_MM) for millimetres in np.arange(6.0, 20.0, 0.5)]
    rows = [row for row in rows if row < len(finger.outline)]
    powers = []
    for white in finger.white:
        green = np.asarray(cv2.GaussianBlur(white[..., 1], (0, 0), 4.0), dtype=np.float64)
        light = profile(green, finger.outline, rows)
        powers.append(float(light @ film / (light @ light)))
    return powers


def resampled(patches: Patches, alone: bool = False) -> Array:
    """(RESAMPLES, C) contrast in patches drawn again."""
    rng = np.random.default_rng(1)
    count = len(patches.guide)
    draws = rng.integers(0, count, (RESAMPLES, count))
    of = patches.alone if alone else patches.amplitudes
    return np.array([of(rows) for rows in draws])


def finger_of(image: Array) -> NDArray[np.bool_]:
    """Mask of the film's white frame: the largest bright part."""
    labels, _ = ndimage.label(ndimage.binary_opening(image[..., 0] > 0.12, iterations=3))
    return np.asarray(
        ndimage.binary_fill_holes(labels == 1 + np.argmax(np.bincount(labels.flat)[1:]))
    )


def enlarged_over_frame(luma: Array, crop: Array, inside: NDArray[np.bool_]) -> float:
    """Contrast of the enlarged picture over the frame's, on the same ridges."""
    fine = cv2.GaussianBlur((255 * crop).astype(np.float32), (0, 0), 2.0)
    band = (255 * luma).astype(np.float32)
    band -= cv2.GaussianBlur(band, (0, 0), 4.0)
    _, place = cv2.findTransformECC(
        band,
        fine - cv2.GaussianBlur(fine, (0, 0), 9.0),
        CROP_FROM_FRAME.copy(),
        cv2.MOTION_AFFINE,
        (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 300, 1e-7),
        inside.astype(np.uint8),
        5,
    )
    # a pixel of the frame is 2.3 of the picture wide: take its mean
    fine = cv2.boxFilter((255 * crop).astype(np.float32), -1, (2, 2))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpAffine(fine, place, band.shape[::-1], flags=flags).astype(np.float64)
    patches = measured(seen[..., None], luma, inside & (seen > 30))
    return float(patches.amplitudes()[0] / np.sqrt(patches.guide.mean()))


def with_range(values: Array) -> list[str]:
    """Each column's median, and its range where it has more than one value."""
    return [
        f"{np.median(column):.3g}"
        + (f" [{np.min(column):.3g}, {np.max(column):.3g}]" if len(column) > 1 else "")
        for column in np.asarray(values).T
    ]


def of_frames(folder: Path) -> tuple[list[Row], Array]:
    """Rows of the film, and the profile of its green."""
    white, nir = frame(folder / "white_raw.png"), frame(folder / "nir_raw.png")
    outline = finger_of(white)
    inside = inner(outline, FILM_PX_PER_MM)
    inside[CREASE_ROW:] = False
    luma = white @ LUMA

    def contrasts(name: str, patches: Patches, alone: bool = False) -> Row:
        value = patches.alone() if alone else patches.amplitudes()
        low, high = np.percentile(resampled(patches, alone), (2.5, 97.5), axis=0)
        cells = [
            f"{100 * v:.2f} [{100 * a:.2f}, {100 * b:.2f}]"
            for v, a, b in zip(value, low, high, strict=True)
        ]
        row = {"figure": f"film, {name}", **dict(zip(HEADS[1:5], cells, strict=True))}
        return row if alone else row | {"red_over_green": f"{value[0] / value[1]:.2f}"}

    patches = measured(with_luma(white), luma, inside)
    as_linear = measured(with_luma(linear(white)), luma, inside)
    infrared = measured(with_luma(nir), luma, inside)
    chroma = np.stack([white[..., 0] - luma, white[..., 2] - luma], axis=2) + 1.0
    share = measured(chroma, luma, inside).amplitudes()
    share /= patches.amplitudes()[3] * luma[inside].mean()
    red = cv2.GaussianBlur(255 * white[..., 0], (0, 0), 3.0)[inside]
    low, middle, high = np.percentile(red, (1, 50, 99))
    ratio = enlarged_over_frame(luma, frame(folder / "grey_crop.png")[..., 1], inside)
    rows = [
        contrasts(f"white, coded, {len(patches.guide)} patches", patches)
        | {"second_harmonic": f"{patches.harmonic():.3g}"},
        contrasts("white, linear if its code is sRGB's", as_linear),
        contrasts("near infrared, coded, at the white frame's ridges", infrared, alone=True),
        {
            "figure": "film, ridges in red and blue less luma over those in luma",
            "red": f"{share[0]:.3f}",
            "blue": f"{share[1]:.3f}",
        },
        {
            "figure": "film, smoothed red, of 255: median, 1st and 99th percentile",
            "red": f"{middle:.1f} [{low:.1f}, {high:.1f}]",
        },
        {"figure": "film, enlarged grey picture over the frame", "luma": f"{ratio:.3f}"},
    ]
    green = np.asarray(cv2.GaussianBlur(white[..., 1], (0, 0), 4.0), dtype=np.float64)
    return rows, profile(green, outline, range(260, 470, 7))


def of_fingers(name: str, fingers: Sequence[Finger], film: Array) -> Iterator[Row]:
    """Rows of simulated fingers, as they are and through the film."""
    powers = [[power] for finger in fingers for power in exponents(finger, film)]
    (cell,) = with_range(np.array(powers))
    yield {"figure": f"film's profile of green as a power of that of {name}", "green": cell}
    for code in (False, True):
        transfer = "sRGB code" if code else "linear"
        values = np.array([of_finger(finger, code) for finger in fingers])
        values[:, :5] *= 100
        yield dict(zip(HEADS, [f"{name}, {transfer}", *with_range(values)], strict=False))
        for blur, quality in itertools.product(LENS_PX, QUALITIES):
            values = np.array([of_film(finger, code, blur, quality) for finger in fingers])
            values[:, 0] *= 100
            cells = with_range(values)
            label = f"{name} through the film, {transfer}, blur {blur:g} px, quality {quality}"
            names = ("luma", "red_over_green", "second_harmonic")
            yield {"figure": label, **dict(zip(names, cells, strict=True))}


def main() -> int:
    """Print and write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=DATA)
    data = parser.parse_args().data
    rows, film = of_frames(data / "author_film")
    for name in ("loop", "print"):
        rows += of_fingers(f"path-traced {name}", [walked(data, name)], film)
    rows += of_fingers("simulator", list(simulated()), film)
    print("\n".join("; ".join(row.values()) for row in rows))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, HEADS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
