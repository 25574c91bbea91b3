"""A part of a capture's picture as a capture of its own, with the camera and the lights in that
part's frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.capture import Band, Capture
from splitknit.errors import require
from splitknit.imaging.light_field import flat_promised
from splitknit.imaging.pixels import Window, coarse_grid
from splitknit.imaging.view import lens_shading
from splitknit.model import Led, PixelArray, Rig
from splitknit.observation.stored import decode_table, flat_at, flat_light


def cropped(capture: Capture, window: Window) -> Capture:
    """The capture as if its camera had only the rows and columns of a window (slices with both
    ends).

    Under parallel rays the origin moves to the window's middle, and near LEDs move against it; a
    perspective camera keeps its axis, and its principal point moves. The lens's fall-off, which has
    its middle in the whole picture, becomes a flat image. `rig.provenance` gets ``cut_from``; the
    truth stays behind. Raises BadInput beside mirrors.
    """
    require(not capture.rig.mirrors, "captures between mirrors cannot be cut.")
    bands = {}
    for name, band in capture.bands.items():
        ambient = band.ambient
        if ambient is not None:
            ambient = replace(ambient, pixels=ambient.pixels[window])
        shading = capture.rig.camera.shading
        flat = None
        if band.flat is not None or shading:
            flat = _flat(band, capture.rig, capture.encoding, window)
        pixels = np.stack([image[window] for image in band.pixels])
        bands[name] = replace(band, pixels=pixels, ambient=ambient, flat=flat)
    mask = None if capture.mask is None else capture.mask[window]
    return replace(
        capture, rig=_rig(capture.rig, window), bands=bands, mask=mask, truth=None, hashes={}
    )


def _rig(rig: Rig, window: Window) -> Rig:
    camera = rig.camera
    films = rig.films
    matrix = camera.matrix
    (top, bottom), (left, right) = ends = [(part.start, part.stop) for part in window]
    # middle from middle: columns, rows
    away = (np.array([left + right, top + bottom]) - camera.image_size[::-1]) / 2
    x_mm, y_mm = away * camera.pitch_mm * (1, -1) if camera.model == "orthographic" else (0.0, 0.0)
    if matrix is not None:
        matrix = matrix - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
    if films is not None:
        sideways, down = (films.scale - 1) * away + films.shift_px
        films = replace(films, shift_px=(float(sideways), float(down)))

    def moved(led: Led) -> Led:
        if led.position_mm is None or camera.model == "perspective":
            return led
        x, y, z = led.position_mm
        ax, ay, az = led.axis.tolist()
        return replace(led, position_mm=(float(x - x_mm), float(y - y_mm), z), aim=(ax, ay, az))

    small = replace(camera, image_size=(bottom - top, right - left), matrix=matrix, shading=())
    cut = {"rows": list(ends[0]), "columns": list(ends[1]), "image_size": list(camera.image_size)}
    leds = tuple(moved(led) for led in rig.leds)
    provenance = {**rig.provenance, "cut_from": cut}
    return replace(rig, camera=small, leds=leds, films=films, provenance=provenance)


def _flat(band: Band, rig: Rig, encoding: str, window: Window) -> PixelArray:
    """(L, h, w) flat images of the window, the lens's fall-off in them, as stored. Without flat
    photographs, those that the rig promises, so that the lens alone is divided out.
    """
    size = band.pixels.shape[1:3]
    corner = (window[0].start, window[1].start)
    shape = (window[0].stop - corner[0], window[1].stop - corner[1])
    lens = lens_shading(rig.camera.shading, size, *corner, shape=shape)
    if band.flat is None:
        coarse = (len(band.pixels), *(max(2, side // 4) for side in size))
        light = flat_promised(rig.select(rig.lights_of(band.leds)), coarse)
    else:
        light = flat_light(band, encoding)
    exposed = np.stack(
        [coarse_grid(flat_at(image, size, corner, 1, shape) * lens) for image in light]
    )
    exposed *= band.exposure[:, None, None].astype(np.float32)
    table = decode_table(np.dtype(np.uint16), encoding)
    full = np.iinfo(band.pixels.dtype).max
    black = np.interp(65535 / full * band.black_level, np.arange(table.size), table)[:, None, None]
    brightest = black + (0.9 - black) * exposed / exposed.max()  # of the full scale
    return np.asarray(np.searchsorted(table, brightest), dtype=np.uint16)
