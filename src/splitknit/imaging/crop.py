"""A part of a capture's picture as a capture of its own, with the camera and the lights in that part's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.band import Window, decode_table, flat_at, flat_light
from splitknit.imaging.view import lens_shading
from splitknit.model import Band, Capture, FloatArray, Led, PixelArray, Rig, coarse_grid

_BRIGHTEST = 0.9
"""Of a flat image, in full scale."""


def cropped(capture: Capture, window: Window) -> Capture:
    """The capture as if its camera had only the rows and columns of a window (slices with both ends).

    Under parallel rays the origin moves to the window's middle, and near LEDs move against it; a perspective camera
    keeps its axis, and its principal point moves. The lens's fall-off, which has its middle in the whole picture,
    becomes a flat image. `rig.provenance` gets ``cut_from``; the truth stays behind. Raises BadInput beside mirrors,
    and where a calibration of shading belongs to the whole picture.
    """
    require(
        not capture.rig.mirrors and capture.shading is None,
        "captures between mirrors, or with a calibration of shading, cannot be cut: both belong to the whole picture.",
    )
    rows, columns = window
    bands = {name: _band(band, capture.encoding, window) for name, band in capture.bands.items()}
    mask = None if capture.mask is None else capture.mask[rows, columns]
    return replace(capture, rig=_rig(capture.rig, window), bands=bands, mask=mask, truth=None, hashes={})


def _rig(rig: Rig, window: Window) -> Rig:
    camera, films = rig.camera, rig.films
    spans = np.array([[part.start, part.stop - 1] for part in window], dtype=np.float64)
    away = spans.mean(axis=1) - (np.array(camera.image_size) - 1) / 2  # of both middles, rows and columns
    matrix, origin = camera.matrix, np.zeros(2)
    if camera.model == "orthographic":
        origin = away[::-1] * camera.pitch_mm * (1.0, -1.0)
    elif matrix is not None:
        matrix = matrix - np.array([[0, 0, spans[1, 0]], [0, 0, spans[0, 0]], [0, 0, 0]])
    rows, columns = (part.stop - part.start for part in window)
    if films is not None:
        right, down = (1.0 - films.scale) * -away[::-1] + films.shift_px
        films = replace(films, shift_px=(float(right), float(down)))
    cut = {"rows": [window[0].start, window[0].stop], "columns": [window[1].start, window[1].stop]}
    return replace(
        rig,
        camera=replace(camera, image_size=(rows, columns), matrix=matrix, shading=()),
        leds=tuple(_led(led, origin) for led in rig.leds),
        films=films,
        provenance={**rig.provenance, "cut_from": {**cut, "image_size": list(camera.image_size)}},
    )


def _led(led: Led, origin: NDArray[np.float64]) -> Led:
    if led.position_mm is None or not origin.any():
        return led
    x, y, z = led.position_mm
    ax, ay, az = led.axis
    aim = (float(ax), float(ay), float(az)) if led.aim is not None or led.lobe_exponent > 0 else None
    return replace(led, position_mm=(x - float(origin[0]), y - float(origin[1]), z), aim=aim)


def _band(band: Band, encoding: str, window: Window) -> Band:
    ambient = None if band.ambient is None else band.ambient[window]
    flat = None if band.flat is None and not band.shading else _flat(band, encoding, window)
    return replace(band, pixels=band.pixels[:, *window], ambient=ambient, flat=flat, shading=())


def _flat(band: Band, encoding: str, window: Window) -> PixelArray:
    """(L, h, w) flat images of the window, the lens's fall-off in them, as stored."""
    size, corner = band.pixels.shape[1:3], (window[0].start, window[1].start)
    shape = (window[0].stop - corner[0], window[1].stop - corner[1])
    lens = lens_shading(band.shading, size, *corner, shape=shape)
    light: FloatArray = np.ones((len(band.pixels), 2, 2), dtype=np.float32)
    light = light if band.flat is None else flat_light(band, encoding)
    seen = np.stack([coarse_grid(flat_at(one, size, corner, 1, shape) * lens) for one in light])
    table, full = decode_table(np.dtype(np.uint16), encoding), np.iinfo(band.pixels.dtype).max
    exposed = seen * band.exposure[:, None, None]
    black = np.interp(65535 / full * band.black_level, np.arange(table.size), table)[:, None, None]
    stored = np.searchsorted(table, black + (_BRIGHTEST - black) * exposed / exposed.max())
    return np.minimum(stored, 65535).astype(np.uint16)
