"""Photographs of the nail that calibrates lights: reading them, detecting the tips, and a picture
of the result."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit import Camera
from splitknit.errors import require
from splitknit.files import read_bytes
from splitknit.io.atomic import write_file
from splitknit.io.images import MAX_BYTES, decode_image, write_image
from splitknit.io.photograph_files import natural_order
from splitknit.io.photos import decode_photo, encoding_of
from splitknit.io.pictures import ORANGE, PAPER, SKY, ColourArray
from splitknit.io.targets import check_file
from splitknit.model import Array, FloatArray, PixelArray, Progress
from splitknit.observation.stored import linear_image
from splitknit_rig.calibration.lights import BANDS, LEDS_PER_BAND, Tip, led_of_file, write_tips
from splitknit_rig.calibration.shadow import NailView, find_nail
from splitknit_rig.calibration.written import check_picture

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
Files = dict[tuple[int, str], list[Path]]
"""Files by nail position and band, in the order of the LEDs."""
_Tile = tuple[str, FloatArray, NailView, int]
"""Name, reduced image, detected nail and shadow, and the LED."""


def tips_of_photos(
    folder: Path,
    camera: Camera,
    *,
    encoding: str | None,
    show: Path | None,
    table: Path | None,
    progress: Progress,
) -> tuple[list[Tip], dict[str, str], list[str]]:
    """Find nail and shadow tips in the photographs of a folder; write the picture and the table of
    them. Returns the tips by LED and place, SHA-256s by name, and files whose shadow leaves the
    picture.
    """
    check_picture(show, folder)
    check_file(
        table, "a table of tips", lambda data: data.startswith(write_tips([]).encode("ascii"))
    )
    files = _nail_files(folder)
    if encoding is None:  # a shadow's tip lies where it lies; nothing else decides
        encoding, _ = encoding_of([path for paths in files.values() for path in paths], "linear")
    tips: list[Tip] = []
    tiles: list[_Tile] = []
    hashes: dict[str, str] = {}
    lost: list[str] = []
    for done, ((nail, band), paths) in enumerate(files.items()):
        progress(f"nail {nail}, {band}", done / len(files))
        stack, digests = read_stack(paths, camera.image_size, encoding)
        hashes |= {path.relative_to(folder).as_posix(): digest for path, digest in digests.items()}
        names = [str(path) for path in paths]
        view = find_nail(stack, camera.px_per_mm, names)
        step = max(1, -(-max(camera.image_size) // 480))
        for led, tip in enumerate(view.tips_px):
            tiles.append(
                (
                    f"{band} {led}, nail {nail}",
                    np.ascontiguousarray(stack[led, ::step, ::step]),
                    view,
                    led,
                )
            )
            if np.isfinite(tip).all():
                nail_px = (float(view.nail_px[0]), float(view.nail_px[1]))
                tips.append(Tip(band, led, nail, nail_px, (float(tip[0]), float(tip[1]))))
            else:
                lost.append(f"{band} {led} at nail {nail}")
    tips.sort(key=lambda tip: (BANDS.index(tip.band), tip.led, tip.nail))
    if show is not None:
        write_image(show, _nail_overview(tiles, camera.image_size))
    if table is not None:
        write_file(table, write_tips(tips).encode("ascii"))
    require(
        tips,
        f"{folder}: all shadows leave the picture; use a shorter nail or move it to the middle.",
    )
    return tips, hashes, lost


def _nail_files(folder: Path) -> Files:
    """Images of a folder: white_0.png ... nir_6.png in it, or in a subfolder for each nail
    position. BadInput if one is missing.
    """
    require(
        folder.is_dir(),
        f"{folder} is not a folder; name the folder with the photographs of the nail.",
    )
    places = sorted(
        (path for path in folder.iterdir() if path.is_dir()),
        key=lambda path: natural_order(path.name),
    )
    places = [place for place in places if _bands(place)] or [folder]
    files: Files = {}
    for nail, place in enumerate(places, start=1):
        bands = _bands(place)
        require(
            bands,
            f"{place} holds no photographs of the nail; they are named white_0 to white_6 and"
            " nir_0 to nir_6 (.tiff, .png or .jpg), in a subfolder for each position of the nail.",
        )
        for band in [band for band in BANDS if band in bands]:
            absent = [led for led in range(LEDS_PER_BAND) if led not in bands[band]]
            names = " and ".join(f"{band}_{led}" for led in absent)
            require(
                not absent,
                f"{place} lacks the image {names}; every LED of a band that occurs needs one.",
            )
            files[nail, band] = [bands[band][led] for led in range(LEDS_PER_BAND)]
    return files


def read_stack(
    paths: Sequence[Path], size: tuple[int, int], encoding: str, *, upright: bool = False
) -> tuple[FloatArray, dict[Path, str]]:
    """Grey linear light (L, H, W) of images, minus the ambient image beside them, turned `upright`
    by EXIF; and all SHA-256s."""
    hashes: dict[Path, str] = {}
    images = []
    for path in paths:
        image, hashes[path] = _read(path, size, encoding, upright=upright)
        images.append(image)
    band = re.split(r"[_.-]", paths[0].stem)[0].lower()
    for suffix in SUFFIXES:
        ambient = paths[0].with_name(f"ambient_{band}{suffix}")
        if ambient.is_file():
            dark, hashes[ambient] = _read(ambient, size, encoding, upright=upright)
            images = [np.maximum(image - dark, 0) for image in images]
            break
    return np.stack(images), hashes


def image_of_size(
    path: Path, size: tuple[int, int] | None, other: str, *, upright: bool = False
) -> tuple[PixelArray, str]:
    """Pixels of an image of a size (rows, columns), if one is known, and its SHA-256; `other`: what
    has this size, and what to do."""
    data = read_bytes(path, MAX_BYTES)

    def check(rows: int, columns: int) -> None:
        require(
            size is None or (rows, columns) == size,
            f"{path} has {rows} x {columns} pixels (rows x columns), but {other}.",
        )

    pixels: Any = decode_photo(data, str(path), check).pixels if upright else None
    if pixels is None:
        pixels = decode_image(data, str(path), check=check)
    return pixels, hashlib.sha256(data).hexdigest()


def _read(
    path: Path, size: tuple[int, int], encoding: str, *, upright: bool
) -> tuple[FloatArray, str]:
    other = (
        f"the rig's camera has {size[0]} x {size[1]}; give the rig or `image_size` that belongs to"
        " the photographs"
    )
    pixels, digest = image_of_size(path, size, other, upright=upright)
    require(pixels.dtype.kind == "u", f"{path} holds floats; save it as 16-bit PNG or TIFF.")
    return np.asarray(linear_image(pixels, encoding).mean(axis=2), dtype=np.float32), digest


def _bands(place: Path) -> Mapping[str, dict[int, Path]]:
    """Photographs by band and LED."""
    bands: dict[str, dict[int, Path]] = {}
    for path in sorted(place.iterdir()):
        name = led_of_file(path)
        if name is not None and path.suffix.lower() in SUFFIXES and path.is_file():
            band, led = name
            leds = bands.setdefault(band, {})
            require(
                led < LEDS_PER_BAND,
                f"{path}: the LED must be 0 to {LEDS_PER_BAND - 1}, counted in its band.",
            )
            require(
                led not in leds,
                f"{path} and {leds.get(led)} are both for one LED; keep one of them.",
            )
            leds[led] = path
    return bands


# A picture of the tips in the photographs.


def _nail_overview(tiles: Sequence[_Tile], image_size: tuple[int, int]) -> ColourArray:
    """Photographs of the nail, small, seven a row: nail tip (cross), shadow tip (ring), ray to the
    LED (line)."""
    drawn = [_nail_tile(tile, image_size) for tile in tiles]
    drawn += [np.full_like(drawn[0], 255)] * (-len(drawn) % 7)
    return np.concatenate(
        [np.concatenate(drawn[k : k + 7], axis=1) for k in range(0, len(drawn), 7)], axis=0
    )


_NAIL_TILE_PX = 400  # width of one photograph


def _nail_tile(tile: _Tile, image_size: tuple[int, int]) -> ColourArray:
    name, image, view, led = tile
    scale = _NAIL_TILE_PX / image_size[1]
    grey = cv2.resize(
        image, (_NAIL_TILE_PX, max(1, round(image_size[0] * scale))), interpolation=cv2.INTER_AREA
    )
    top = max(float(np.percentile(grey, 99.5)), 1e-6)
    shade = np.rint(255.0 * np.clip(grey / top, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    picture = np.ascontiguousarray(np.repeat(shade[..., None], 3, axis=2))
    tip_px = view.tips_px[led]
    nail = _at(view.nail_px, scale)
    if np.isfinite(tip_px).all():
        towards_led = (view.nail_px - tip_px) / max(
            float(np.linalg.norm(view.nail_px - tip_px)), 1e-9
        )
        beyond = view.nail_px + towards_led * float(sum(image_size))
        cv2.line(picture, _at(tip_px, scale), _at(beyond, scale), SKY, 1, cv2.LINE_AA)
        cv2.circle(picture, _at(tip_px, scale), 6, ORANGE, 1, cv2.LINE_AA)
    else:
        name += ": out of the picture"
    cv2.drawMarker(picture, nail, PAPER, cv2.MARKER_CROSS, 13)
    for colour, thickness in (((255, 255, 255), 3), ((0, 0, 0), 1)):
        cv2.putText(
            picture, name, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, thickness, cv2.LINE_AA
        )
    picture[-1] = 255
    picture[:, -1] = 255
    return picture


def _at(place: Array, scale: float) -> tuple[int, int]:
    """Position in the tile of a pixel of the photograph."""
    x, y = (place + 0.5) * scale - 0.5
    return round(float(x)), round(float(y))
