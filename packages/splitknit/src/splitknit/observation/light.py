"""Linear light of a band's photographs; code that uses it need not know how they are stored."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.capture import Band
from splitknit.errors import require
from splitknit.imaging.pixels import CHANNELS, Window, pick_channel
from splitknit.imaging.view import lens_shading
from splitknit.io.paging import chosen
from splitknit.model import COLOURS, Array, BoolArray, FloatArray, PixelArray, Rig
from splitknit.observation.stored import (
    decode_table,
    flat_at,
    flat_light,
    linear_image,
)

FULL_SCALE = 0.985
"""Fraction of the full scale from which a stored value counts as clipped."""
LIGHT_BYTES = 250_000_000
"""Bytes of linear light that one call should return at most, where it can be asked for in strips;
a full frame's band has 197 million."""


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """What all photographs of a series share: made once for all of them."""

    ambient: FloatArray | None
    """(h, w, C) light with all LEDs off."""
    lens: FloatArray | None
    """(h, w, 1) brightness of the lens relative to the picture's centre."""
    flats: FloatArray | None
    """(L, rows, columns) brightness of a flat surface, on the coarse grid."""
    crossed: _Shared | None
    """The same of the crossed series."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Light:
    """Linear light of the photographs of one band, on the camera's pixels or coarser.

    Encoding, exposure, black level, ambient light, the lens's fall-off, flat photographs, the
    crosstalk of coloured LEDs, films, and motion between the shots are undone when light is asked
    for. Values are relative to the full scale of the stored ones; noise may make dark ones
    negative, and clipping these would bias dark pixels upwards.
    """

    stored: Band
    built: Rig
    """The whole rig, whose LEDs the band numbers; :attr:`rig` has those of the images."""
    encoding: str
    window: Window = (slice(None), slice(None))
    """Rows and columns of the camera's pixels."""
    every: int = 1
    """Every so many of the camera's pixels are looked at, along rows and columns."""
    binning: float = 1
    """Pixels a side, of those looked at, whose mean is one value: a multiple of 1/8."""
    gains: Array | None = None
    """(photographs, C) by which images are divided: films, or lamps that differ in brightness."""
    promised: FloatArray | None = None
    """(L, h, w) light of a flat surface by the rig: what flat photographs are brought to."""
    moves: tuple[Array | None, ...] = ()
    """(2, 3) from columns and rows of an image, as it should be, to the stored photograph's."""
    crossed: Light | None = None
    """The series behind crossed films, image by image: the light is then the mean of both, as
    without films."""

    def __repr__(self) -> str:
        return f"Light({self.stored!r}, {self.binning:g} px a side)"

    # What the photographs are.

    @property
    def name(self) -> str:
        """``white``, ``white_crossed`` or ``nir``."""
        return self.stored.name

    @property
    def colours(self) -> tuple[tuple[str, ...], ...]:
        """Colours of the LEDs of each photograph; nothing where all are white."""
        return self.built.colours_of(self.stored.leds)

    @property
    def has_colour(self) -> bool:
        """Whether the images carry red, green and blue of one light."""
        return self.stored.pixels.shape[-1] == 3 and not self.colours

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of :attr:`stack`."""
        return COLOURS if self.has_colour else ("grey",)

    @property
    def lights(self) -> tuple[tuple[int, ...], ...]:
        """LEDs of every image, those of coloured exposures colour by colour, with those of a
        crossed series."""
        own = self.built.lights_of(self.stored.leds)
        if self.crossed is None:
            return own
        return tuple(
            tuple(dict.fromkeys(a + b)) for a, b in zip(own, self.crossed.lights, strict=True)
        )

    @property
    def rig(self) -> Rig:
        """The rig whose `leds[k]` lights image k."""
        return self.built.select(self.lights)

    @property
    def image_names(self) -> tuple[str, ...]:
        """Names of the images' files, those of coloured exposures with the colour; numbers without
        files."""
        files = [Path(file).name for file in self.stored.files] or [
            f"image {k}" for k in range(self.photographs)
        ]
        if not self.colours:
            return tuple(files)
        pairs = zip(files, self.colours, strict=True)
        named = (
            (file, colour) for file, own in pairs for colour in (*COLOURS, "") if colour in own
        )
        return tuple(f"{file}, {colour}" if colour else file for file, colour in named)

    @property
    def photographs(self) -> int:
        """Number of exposures; coloured LEDs give several images of each."""
        return len(self.stored.pixels)

    @property
    def exposure(self) -> Array:
        """(photographs,) exposure time times gain, relative; the light is divided by it."""
        return self.stored.exposure

    @property
    def polarised(self) -> bool:
        """Whether it passed films, or is the mean of two series that did."""
        return bool(self.stored.polarisation) or self.crossed is not None

    @property
    def flattened(self) -> bool:
        """Whether images are divided by those of a flat surface."""
        return self.stored.flat is not None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns of an image."""
        rows, columns = (
            len(range(*part.indices(side))[:: self.every])
            for part, side in zip(self.window, self._size, strict=True)
        )
        return int(rows // self.binning), int(columns // self.binning)

    @property
    def pitch_mm(self) -> float:
        """Side of a pixel on the finger plane."""
        return self.built.camera.pitch_mm * self.every * self.binning

    # Other views of the same photographs.

    def at(self, binning: float = 1, window: Window | None = None) -> Light:
        """The light in blocks of `binning` pixels a side, inside a window of the camera's pixels;
        rows and columns that fill no block are dropped."""
        return self._both(binning=binning, window=window or self.window)

    def sampled(self, every: int) -> Light:
        """The light at every so many pixels of rows and columns."""
        return self._both(every=every)

    def of_images(self, kept: Sequence[int]) -> Light:
        """The light of some of the photographs."""
        rows = list(kept)
        return replace(
            self,
            stored=_of_images(self.stored, rows),
            gains=None if self.gains is None else self.gains[rows],
            promised=None if self.promised is None else self.promised[rows],
            moves=tuple(self.moves[k] for k in rows) if self.moves else (),
            crossed=None if self.crossed is None else self.crossed.of_images(rows),
        )

    def divided_by(self, gains: Array) -> Light:
        """The light with its images divided by (L, C) `gains`."""
        return replace(self, gains=gains if self.gains is None else self.gains * gains)

    def moved_by(self, moves: Sequence[Array | None]) -> Light:
        """The light with each photograph resampled: `moves[k]` (2, 3) goes from columns and rows of
        image k to where they lie in what it shows now; None: it stays."""
        before = self.moves or (None,) * self.photographs
        return replace(self, moves=tuple(map(_after, before, moves)))

    def as_if_stored(self, encoding: str) -> Light:
        """The light as if the files had another encoding."""
        return self._both(encoding=encoding)

    def under(self, rig: Rig) -> Light:
        """The light as if it came from another rig with the same LEDs."""
        return self._both(built=rig)

    def _both(self, **changes: Any) -> Light:
        """The light with changes that hold for its crossed series too."""
        crossed = None if self.crossed is None else replace(self.crossed, **changes)
        return replace(self, crossed=crossed, **changes)

    # The light.

    @property
    def grey(self) -> FloatArray:
        """(L, h, w) float32; coloured LEDs that share an exposure have an image each."""
        return np.asarray(self._channels(("grey",))[0])

    @property
    def stack(self) -> FloatArray:
        """(C, L, h, w) float32 in :attr:`channels`."""
        return self._channels(self.channels)

    @property
    def grey_and_stack(self) -> FloatArray:
        """(1 + C, L, h, w): :attr:`grey` before :attr:`stack`."""
        return self._channels(("grey", *self.channels))

    def survey(self) -> tuple[FloatArray, FloatArray]:
        """Mean (h, w, C) over all images with all channels (grey for coloured LEDs, which light
        different sides), and :attr:`grey`; never all channels of all images in memory."""
        if self.colours:
            grey = self.grey
            return grey.mean(axis=0)[..., None], grey
        height, width = self.shape
        total = np.zeros((height, width, self.stored.pixels.shape[3]), dtype=np.float32)
        grey = np.empty((self.photographs, height, width), dtype=np.float32)
        shared = self._shared
        with ThreadPoolExecutor(2) as pool:
            lit = pool.map(lambda k: self._lit(k, shared), range(self.photographs))
            for k, light in enumerate(lit):
                grey[k] = pick_channel(light, "grey")
                total += light
        return total / self.photographs, grey

    @property
    def ambient(self) -> FloatArray | None:
        """(h, w) light with all LEDs off, grey; None where it was not photographed."""
        dark = self._ambient
        return None if dark is None else pick_channel(dark, "grey")

    @property
    def clips_at(self) -> Array:
        """(L,) light at which each image clips; ambient light is not subtracted from clipped
        values."""
        first = self._first_images()
        levels = self._clip_levels()
        if self.gains is not None and not self.stored.polarisation:
            levels = levels * (1.0 / self.gains).mean(axis=1)
        return np.repeat(levels, np.diff([*first, len(self.lights)]))

    @property
    def clipped(self) -> BoolArray:
        """(L, h, w) whether a channel of the stored photographs clips; not of blocks of pixels."""
        level = int(FULL_SCALE * np.iinfo(self.stored.pixels.dtype).max)
        photographs = map(self._photograph, range(self.photographs))
        return np.stack([(image >= level).any(axis=-1) for image in photographs])

    def most_clipped(self, inside: BoolArray) -> tuple[float, int, int]:
        """Largest part of the pixels `inside` (h, w) at the highest stored value of its channel, in
        a photograph; the photograph, and the channel. The highest value is that of all photographs:
        clipped ones may have been darkened later.
        """
        pixels = np.stack([self._photograph(k)[inside] for k in range(self.photographs)])
        top = pixels.max(axis=(0, 1))
        part = (pixels >= top - top // 100).mean(axis=1)
        image, channel = np.unravel_index(int(np.argmax(part)), part.shape)
        return float(part.max()), int(image), int(channel)

    def _channels(self, names: Sequence[str]) -> FloatArray:
        require(
            not self.colours or set(names) <= {"grey"},
            f"the band '{self.name}' was lit by coloured LEDs, one colour an image; it has no"
            " channels of one light.",
        )
        stack = np.empty((len(names), len(self.lights), *self.shape), dtype=np.float32)
        shared = self._shared
        first = self._first_images()

        def work(k: int) -> None:
            light = self._lit(k, shared)
            if self.colours and self.colours[k][0]:
                separated = self._colours_apart(k, light)
                stack[:, first[k] : first[k] + len(separated)] = separated
                return
            for c, channel in enumerate(names):
                stack[c, first[k]] = pick_channel(light, channel)

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(work, range(self.photographs)))
        return stack

    @property
    def _size(self) -> tuple[int, int]:
        """Rows, columns of a photograph."""
        rows, columns = self.stored.pixels.shape[1:3]
        return int(rows), int(columns)

    @property
    def _pixels(self) -> Window:
        """Rows and columns of a photograph that are looked at."""
        rows, columns = (
            slice(*part.indices(side)[:2], self.every)
            for part, side in zip(self.window, self._size, strict=True)
        )
        return rows, columns

    def _photograph(self, k: int) -> PixelArray:
        """(h, w, C) stored values of photograph k on the pixels that are looked at."""
        rows, columns = self._pixels
        move = self.moves[k] if self.moves else None
        if move is None:
            return self.stored.pixels[k, rows][:, columns]
        image = self.stored.pixels[k]
        place = np.array([[self.every, 0, columns.start], [0, self.every, rows.start], [0, 0, 1]])
        size = len(range(*columns.indices(self._size[1]))), len(range(*rows.indices(self._size[0])))
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(
            image, move @ place, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(warped, dtype=image.dtype).reshape(*size[::-1], -1)

    @property
    def _ambient(self) -> FloatArray | None:
        """(h, w, C) light of the ambient image."""
        dark = self.stored.ambient
        if dark is None:
            return None
        pixels = dark.pixels[self._pixels]
        return linear_image(pixels, self.encoding, dark.exposure, dark.black_level, self.binning)

    @property
    def _corner(self) -> tuple[int, int]:
        """Row and column of the first pixel that is looked at, in steps of `every`."""
        rows, columns = self._pixels
        return rows.start // self.every, columns.start // self.every

    @property
    def _looked_at(self) -> tuple[int, int]:
        """Rows, columns of a whole photograph in steps of `every`."""
        rows, columns = self._size
        return -(-rows // self.every), -(-columns // self.every)

    @property
    def _shared(self) -> _Shared:
        band, camera = self.stored, self.built.camera
        lens = flats = None
        if camera.shading:
            lens = lens_shading(
                camera.shading, self._looked_at, *self._corner, self.binning, self.shape
            )[..., None]
        if band.flat is not None:
            flats = flat_light(band, self.encoding)
            flats = flats / flats.mean()
            if self.promised is not None:
                flats = flats / self.promised
        crossed = None if self.crossed is None else self.crossed._shared
        return _Shared(self._ambient, lens, flats, crossed)

    def _lit(self, k: int, shared: _Shared) -> FloatArray:
        """(h, w, C) light of photograph k; of two polarised series their mean. Where either clips
        in two channels, all have the light at which the parallel one does, so that it counts as
        clipped.
        """
        parallel = self._of_series(k, shared)
        if self.crossed is None or shared.crossed is None:
            return parallel
        crossed = self.crossed._of_series(k, shared.crossed)
        clipped = self._clips(k, parallel, shared.ambient)
        clipped |= self.crossed._clips(k, crossed, shared.crossed.ambient)
        level = np.float32(self._clip_levels()[k])
        return np.where(clipped, np.maximum(parallel, level), 0.5 * (parallel + crossed))

    def _of_series(self, k: int, shared: _Shared) -> FloatArray:
        """(h, w, C) light of photograph k of one series."""
        band = self.stored
        light = linear_image(
            self._photograph(k),
            self.encoding,
            float(band.exposure[k]),
            float(band.black_level[k]),
            self.binning,
        )
        if shared.ambient is not None:
            # clipped values stay as they are, and still count as clipped
            np.subtract(light, shared.ambient, out=light, where=light < self._clip_levels()[k])
        if shared.lens is not None:
            light /= shared.lens
        if shared.flats is not None:
            light /= flat_at(
                shared.flats[k], self._looked_at, self._corner, self.binning, light.shape
            )[..., None]
        if self.gains is not None:
            light /= self.gains[k].astype(np.float32)
        return light

    def _clips(self, k: int, light: FloatArray, ambient: FloatArray | None) -> BoolArray:
        """(h, w, 1) where the light of photograph k clips in two channels."""
        whole = light if self.gains is None else light * self.gains[k].astype(np.float32)
        whole = whole if ambient is None else whole + ambient
        clipping = (whole >= self._clip_levels()[k]).sum(axis=-1, keepdims=True)
        return np.asarray(clipping >= min(2, light.shape[-1]))

    def _clip_levels(self) -> Array:
        """(photographs,) light at which each clips."""
        table = decode_table(self.stored.pixels.dtype, self.encoding)
        black = np.interp(self.stored.black_level, np.arange(table.size), table)
        return np.asarray((FULL_SCALE - black) / self.stored.exposure)

    def _first_images(self) -> list[int]:
        """For each photograph the first of its images."""
        counts = [len(set(own)) for own in self.colours] or [1] * self.photographs
        return [sum(counts[:k]) for k in range(len(counts))]

    def _colours_apart(self, k: int, light: FloatArray) -> FloatArray:
        """(n, h, w) light of each colour of photograph k (h, w, C), in the order red, green, blue.
        Light that clips in a channel is kept as stored, so that it still counts as clipped.
        """
        present = [c for colour, c in CHANNELS.items() if colour in self.colours[k]]
        if light.shape[2] == 1:
            return np.moveaxis(light, 2, 0)
        own = np.moveaxis(light[..., present], 2, 0)
        crosstalk = self.built.camera.crosstalk
        if crosstalk is None:
            return np.ascontiguousarray(own)
        inverse = np.linalg.inv(crosstalk)[present]
        apart = cv2.transform(light, inverse).reshape(*light.shape[:2], len(present))
        level = float(self._clip_levels()[k])
        return np.where(own >= level, own, np.moveaxis(apart, 2, 0)).astype(np.float32)


def _of_images(band: Band, rows: list[int]) -> Band:
    """The band of some of its photographs."""
    return replace(
        band,
        pixels=chosen(band.pixels, rows),
        leds=tuple(band.leds[k] for k in rows),
        exposure=band.exposure[rows],
        black_level=band.black_level[rows],
        files=tuple(band.files[k] for k in rows) if band.files else (),
        flat=None if band.flat is None else band.flat[rows],
    )


def _after(first: Array | None, second: Array | None) -> Array | None:
    """The move (2, 3) of both, where the second is of the image that the first one gives."""
    if first is None or second is None:
        return first if second is None else second
    return np.asarray(first @ np.vstack([second, [0.0, 0.0, 1.0]]))
