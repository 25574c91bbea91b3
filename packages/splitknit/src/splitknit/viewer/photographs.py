"""Photographs as the viewer shows them: 8 bits, sRGB, straight from their folder, each with where its light is."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.band import srgb_code
from splitknit.io.capture_file import read_plan
from splitknit.io.images import decode_image
from splitknit.io.light_list import read_named_lights
from splitknit.io.photos import FORMATS, decode_photo, encoding_of
from splitknit.io.plain import photographs_in
from splitknit.model import vector_at_origin
from splitknit.viewer.catalogue import CatalogueEntry, read_below

_WIDEST = 4096


@dataclass(frozen=True, slots=True)
class _LitPhoto:
    """One photograph."""

    name: str  # relative to its folder
    band: str
    number: int  # within the band, from 0
    encoding: str
    light: tuple[float, float, float] | None
    """Unit vector towards the light: x right, y up, z to the camera; None where it is not known."""


@dataclass(frozen=True, slots=True)
class _PhotoFolder:
    """The photographs of a folder, and what a person should know of them."""

    photos: tuple[_LitPhoto, ...]
    plain: bool  # a folder of photographs, no capture
    facts: tuple[tuple[str, str], ...] = ()  # name and value, empty where it is not known
    notes: tuple[str, ...] = ()
    command: str = ""  # what reconstructs them


@lru_cache(maxsize=16)
def photographs_of(folder: Path) -> _PhotoFolder:
    """Return the photographs of a capture, or of any folder that holds some, band by band. Raises BadInput if
    ``capture.json`` or its rig cannot be read, or there are no photographs.
    """
    where = shlex.quote(str(folder))
    out = shlex.quote(f"{folder.name}-result")
    if not (folder / "capture.json").is_file():
        return _plain(folder, where, out)
    plan = read_plan(folder / "capture.json")
    capture, rig = plan.capture, plan.capture.rig
    photos = tuple(
        _LitPhoto(name, band, number, capture.encoding, _unit(sum(vector_at_origin(rig.leds[k]) for k in leds)))
        for band, shots in plan.bands.items()
        for number, (name, leds) in enumerate(zip(shots.band.files, shots.band.leds, strict=True))
    )
    camera, about = rig.camera, capture.subject
    facts = (
        ("Photographs", ", ".join(f"{len(shots.files)} {band}" for band, shots in plan.bands.items())),
        ("Pixels", f"{camera.image_size[1]} x {camera.image_size[0]}"),
        ("Scale", camera.scale.removeprefix("scale ")),
        ("Stored", "sRGB" if capture.encoding == "srgb" else capture.encoding),
        ("Material", capture.material),
        ("Finger", str(about.get("finger") or "")),
        ("Person", str(about.get("id") or "")),
    )
    return _PhotoFolder(photos, False, facts, (), f"splitknit reconstruct {where} --out {out}")


def _plain(folder: Path, where: str, out: str) -> _PhotoFolder:
    table, notes = folder / "lights.txt", []
    lights: Sequence[Any] = ()
    try:
        directions, names = read_named_lights(table)
        lights = list(directions)
        files, masks, skipped = photographs_in(folder, table, names)
    except BadInput as error:
        lacking = "No lights.txt is here: name the lights' directions with --lights."
        notes.append(f"{error}" if table.exists() else lacking)
        lights = ()
        files, masks, skipped = photographs_in(folder, table)
    files = [file for file in files if not file.is_symlink()]
    require(len(files) > 0, f"'{folder}' holds no photographs ({FORMATS}).")
    if len(lights) not in (0, len(files)):
        differ = f"lights.txt has {len(lights)} lights for {len(files)} photographs"
        notes.append(f"{differ}: which belongs to which is open.")
        lights = ()
    notes += [f"Not used: {', '.join(skipped[:8])}{' and more' if len(skipped) > 8 else ''}."] if skipped else []
    curve, _ = encoding_of(files[:1], lambda: False)
    towards = [_unit(lights[k]) if lights else None for k in range(len(files))]
    photos = tuple(_LitPhoto(file.name, "white", k, curve, towards[k]) for k, file in enumerate(files))
    facts = (
        ("Photographs", str(len(photos))),
        ("Lights", f"{len(lights)} directions" if lights else "not known"),
        ("Stored", "sRGB (assumed)" if curve == "srgb" else "linear (assumed; --encoding srgb changes it)"),
        ("Mask", masks[0].name if masks else "none"),
    )
    named = "" if table.is_file() else "--lights FILE "
    return _PhotoFolder(photos, True, facts, tuple(notes), f"splitknit reconstruct --images {where} {named}--out {out}")


def _unit(vector: Any) -> tuple[float, float, float] | None:
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length == 0:
        return None
    x, y, z = (float(value) / length for value in vector)
    return x, y, z


def photo_jpeg(entry: CatalogueEntry, number: int, width: int) -> bytes:
    """Return a photograph as JPEG, at most `width` pixels wide. Raises BadInput if there is no such photograph, it
    cannot be read, or it is not the one that the result was made from.
    """
    if entry.capture is None:
        raise BadInput("the photographs are not at hand; name their folder with --capture.")
    found = photographs_of(entry.capture)
    require(0 <= number < len(found.photos), f"there is no photograph number {number}.")
    require(16 <= width <= _WIDEST, f"a width must lie between 16 and {_WIDEST} pixels.")
    photo = found.photos[number]
    hashes: Any = entry.report.get("inputs_sha256", {})
    return _jpeg(entry.capture, photo, str(hashes.get(photo.name)) if entry.result else "", found.plain, width)


@lru_cache(maxsize=64)
def _jpeg(folder: Path, photo: _LitPhoto, sha256: str, plain: bool, width: int) -> bytes:
    data = read_below(folder, photo.name)
    same = not sha256 or hashlib.sha256(data).hexdigest() == sha256
    require(same, f"{photo.name} is not the file that this result was made from: its hash is another.")
    pixels: NDArray[Any] = decode_photo(data, photo.name).pixels if plain else decode_image(data, photo.name)
    if pixels.shape[1] > width:
        size = (width, max(1, round(pixels.shape[0] * width / pixels.shape[1])))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else max(float(pixels.max()), 1e-12)
    level = pixels.astype(np.float32) / np.float32(white)
    if photo.encoding == "linear":
        level = srgb_code(np.maximum(level, 0))
    image = np.round(255.0 * np.clip(level, 0.0, 1.0)).astype(np.uint8)
    if image.ndim == 3:
        image = image[..., 0] if image.shape[2] == 1 else image[..., ::-1]
    done, encoded = cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, 88])
    if not done:
        raise RuntimeError("a photograph could not be encoded")
    return encoded.tobytes()
