"""Other people's data: photographs and a list of light directions become a capture."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, check_lights, read_bytes, require
from splitknit.imaging.light_field import few_lights
from splitknit.io.content import check_content, mask_from_image
from splitknit.io.images import STACK_BYTES
from splitknit.io.photos import FORMATS, RAW_SUFFIXES, SRGB_SUFFIXES, SUFFIXES, Photo, read_photo
from splitknit.io.provenance import file_hash
from splitknit.model import UNKNOWN_SCALE, Band, Camera, Capture, Led, PixelArray, Rig, camera_without_scale

Background = float | str | os.PathLike[str] | None
_SAME_DEG = 0.5
"""Lights whose directions differ by less are one light, as in :func:`splitknit.errors.check_lights`."""
_MAX_PHOTOS = 1000
_BRIGHTEST = 0.9
"""What the brightest value of photographs of floats becomes, of the full scale of 16 bits."""


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """Photographs as a capture, and what is to be known about how they became one."""

    capture: Capture
    skipped: tuple[str, ...]
    """Files of the folder that were not used, each with the reason."""
    notes: tuple[str, ...]
    """What was assumed or done, one sentence each."""


def read_lights_txt(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read light directions (L, 3) from a text file: x, y, z a line, apart by spaces or commas.

    A first line with a single number is the count of the lights that follow; ``#`` starts a comment. A line may begin
    or end with the name of its photograph (:func:`read_named_lights`).

    Raises
    ------
    BadInput
        Naming the file and the line.
    """
    return read_named_lights(path)[0]


def read_named_lights(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read light directions (L, 3) and the photographs' names, as :func:`read_lights_txt`.

    Returns
    -------
    lights : (L, 3)
    names : of the photographs, one for each light; empty where the file holds none

    Raises
    ------
    BadInput
        Naming the file and the line; also where only some of the lines hold a name.
    """
    name = os.fspath(path)
    try:
        text = read_bytes(path, 1_000_000).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not a text file.") from error
    rows: list[list[float]] = []
    names: list[str] = []
    count: int | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        if len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
            continue
        first = len(words) > 3 and _as_numbers(words[-3:]) is not None
        values = _as_numbers(words[-3:] if first else words[:3])
        if values is None or len(words) < 3 or not all(abs(value) <= 1e6 for value in values):
            raise BadInput(
                f"{name}, line {number}: three finite numbers x y z are expected, none beyond a million, perhaps with "
                f"a file's name before or after them, but it is {line.strip()[:60]!a}."
            )
        file = " ".join(words[:-3] if first else words[3:])
        require(
            not file or _as_numbers([file]) is None,
            f"{name}, line {number}: three finite numbers x y z are expected, but there are more: "
            f"{line.strip()[:60]!a}.",
        )
        rows.append(values)
        names += [file] if file else []
    require(len(rows) > 0, f"{name} holds no lights: a line x y z for each image is expected.")
    require(
        count is None or count == len(rows), f"{name} states {count} lights in its first line, but {len(rows)} follow."
    )
    require(len(names) in (0, len(rows)), f"{name} names a file in some of its lines only; name one in all or in none.")
    twice = [one for k, one in enumerate(names) if one in names[:k]]
    require(not twice, f"{name} names {twice[0] if twice else ''!a} twice.")
    return np.array(rows, dtype=np.float64), tuple(names)


def _as_numbers(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def capture_from_photographs(
    folder: str | os.PathLike[str],
    lights: str | os.PathLike[str] | None = None,
    px_per_mm: float | None = None,
    *,
    mask: str | os.PathLike[str] | None = None,
    material: str = "opaque",
    encoding: str | None = None,
    background: Background = None,
    tip_direction_deg: float | None = None,
) -> Photographs:
    """Make a capture of a folder of photographs, one for each light.

    Parameters
    ----------
    folder : of JPEG, PNG, TIFF, WEBP, BMP, HEIC or RAW files, all of one size, in the order of their names
    lights : text file (:func:`read_named_lights`), by default ``lights.txt`` in the folder
    px_per_mm : pixels a millimetre on the object; None where it is unknown: heights are then in pixels
    mask : image file, white = object; by default ``mask.png`` (or another format) in the folder, where there is one
    material, background, tip_direction_deg : as for :func:`capture_from_plain_images`
    encoding : ``linear`` or ``srgb``; by default ``srgb`` for JPEG, WEBP and HEIC, else ``linear``

    Returns
    -------
    Photographs

    Raises
    ------
    BadInput
        As :func:`capture_from_plain_images`; also if the folder holds no photographs, their number is not that of the
        lights, or the lights' file names one that is not there.

    Examples
    --------
    >>> found = capture_from_photographs("photos", px_per_mm=20.0)  # doctest: +SKIP
    >>> found.skipped  # doctest: +SKIP
    ('notes.docx (not a photograph)',)
    """
    root = Path(folder)
    require(root.is_dir(), f"{os.fspath(folder)} is not a folder; name the folder of the photographs.")
    table = root / "lights.txt" if lights is None else Path(lights)
    require(
        lights is not None or table.is_file(),
        f"{root} holds no lights.txt; name the file of the light directions with --lights.",
    )
    directions, names = read_named_lights(table)
    own = [file for value in (mask, background if not isinstance(background, float | int) else None, table)
           if value is not None for file in [Path(value).resolve()]]  # fmt: skip
    found, masks, skipped = photographs_in(root, table, names, own, find_mask=mask is None)
    mask = masks[0] if masks else mask
    left_out = f"; skipped: {_listed(skipped)}" if skipped else ""
    require(len(found) > 0, f"{root} holds no photographs ({FORMATS}){left_out}.")
    require(
        len(found) == len(directions),
        f"{root} holds {len(found)} photographs ({found[0].name} to {found[-1].name}), but {table} has "
        f"{len(directions)} lights{left_out}; let each of its lines begin with the name of a photograph.",
    )
    notes = []
    if encoding is None:
        encoding = _encoding_of(found)
        notes.append(f"encoding {encoding} is assumed of {found[0].suffix.lower()} files (--encoding changes it).")
    capture, more = _assembled(
        found, directions, px_per_mm, None, mask, material, encoding, background, tip_direction_deg
    )
    capture = replace(capture, hashes={**capture.hashes, table.name: file_hash(table)})
    if skipped:
        notes.append(f"skipped in {root}: {_listed(skipped)}.")
    return Photographs(capture, tuple(skipped), (*notes, *more))


def _listed(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def photographs_in(
    folder: Path, table: Path, names: Sequence[str] = (), own: Sequence[Path] = (), *, find_mask: bool = True
) -> tuple[list[Path], list[Path], list[str]]:
    """Photographs of a folder in the order of the lights.

    Parameters
    ----------
    folder : Path
    table : file of the lights, for messages
    names : of photographs, from that file (:func:`read_named_lights`); empty: all, photo_2 before photo_10
    own : files that have another use
    find_mask : whether a ``mask.png`` (or another format) is looked for

    Returns
    -------
    photographs, masks : files
    skipped : what else is there, each with the reason

    Raises
    ------
    BadInput
        If the folder cannot be read, holds more than 1000 photographs, or lacks one that is named.
    """
    found, skipped = _photos_in(folder, own)
    masks = [file for file in found if find_mask and file.stem.lower() == "mask"]
    found = [file for file in found if file not in masks]
    for file in [file for file in found if "mask" in file.stem.lower()]:
        found.remove(file)
        skipped.append(f"{file.name} (a mask? name it with --mask)")
    if names:
        found, unused = _by_name(found, names, table)
        skipped += [f"{file.name} (not in {table.name})" for file in unused]
    return found, masks, skipped


def _photos_in(folder: Path, own: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Photographs of a folder, photo_2 before photo_10, and what else is there; `own` are named otherwise."""
    found, skipped = [], []
    try:
        files = sorted(folder.iterdir(), key=lambda file: _words(file.name))
    except OSError as error:
        raise BadInput(f"{folder} cannot be read ({error.strerror}).") from error
    for file in files:
        if file.name.startswith(".") or file.resolve() in own:
            continue
        if file.is_file() and file.suffix.lower() in SUFFIXES:
            found.append(file)
        elif file.name != "lights.txt":
            skipped.append(f"{file.name} ({'a folder' if file.is_dir() else 'not a photograph'})")
    require(len(found) <= _MAX_PHOTOS, f"{folder} holds {len(found)} photographs; at most {_MAX_PHOTOS} are read.")
    return found, skipped


def _words(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name[:300])]


def _by_name(found: Sequence[Path], names: Sequence[str], table: Path) -> tuple[list[Path], list[Path]]:
    """The photographs that the lights' file names, in its order, and the others; a name may lack its suffix."""
    chosen = []
    for name in names:
        fits = [file for file in found if file.name == name] or [file for file in found if file.stem == name]
        require(len(fits) > 0, f"{table} names {name!a}, but there is no such photograph.")
        require(len(fits) == 1, f"{table} names {name!a}, which fits {_listed([file.name for file in fits])}.")
        chosen.append(fits[0])
    return chosen, [file for file in found if file not in chosen]


def _encoding_of(files: Sequence[Path]) -> str:
    kinds = {file.suffix.lower() in SRGB_SUFFIXES for file in files}
    require(
        len(kinds) == 1,
        "the photographs are of several formats, some with a tone curve (JPEG, WEBP, HEIC) and some without; give "
        "--encoding.",
    )
    return "srgb" if kinds == {True} else "linear"


def capture_from_plain_images(
    images: Sequence[str | os.PathLike[str]],
    lights: NDArray[np.float64],
    px_per_mm: float | None,
    *,
    intensities: Sequence[float] | None = None,
    mask: str | os.PathLike[str] | None = None,
    material: str = "opaque",
    encoding: str = "linear",
    background: Background = None,
    tip_direction_deg: float | None = None,
) -> Capture:
    """Make a capture of images of one object under distant lights; all of them form the band ``white``.

    Photographs under one light (directions within 0.5 deg) are averaged. Photographs of floats are brought to 16 bits
    by one factor.

    Parameters
    ----------
    images : files of :func:`splitknit.io.photos.read_photo`, of one size, at least three, in the order of the lights
    lights : (L, 3) directions *towards* the lights, x right, y up, z to the camera, of any length
    px_per_mm : pixels a millimetre on the object; heights scale with it. None where it is unknown
    intensities : relative strength of each light; equal where None
    mask : image file, white = object
    material : ``opaque`` (default) or ``skin``
    encoding : ``linear`` or ``srgb``
    background : stored value of no light that was added to every pixel (a number), or an image with all lights off
    tip_direction_deg : where a finger's tip points (0 = up, counter-clockwise)

    Returns
    -------
    Capture
        Write it with :func:`splitknit.write_capture`.

    Raises
    ------
    BadInput
        If files are missing, damaged, of different sizes or turned differently by their EXIF data, lights and images
        differ in number, the lights do not determine a normal, an image is black or overexposed.
    """
    files = [Path(image) for image in images]
    return _assembled(files, lights, px_per_mm, intensities, mask, material, encoding, background, tip_direction_deg)[0]


def _assembled(  # noqa: PLR0917
    files: Sequence[Path],
    lights: NDArray[np.float64],
    px_per_mm: float | None,
    intensities: Sequence[float] | None,
    mask: str | os.PathLike[str] | None,
    material: str,
    encoding: str,
    background: Background,
    tip_direction_deg: float | None,
) -> tuple[Capture, list[str]]:
    """The capture, and notes on it."""
    require(len(files) >= 3, f"at least three images are needed, but there are {len(files)}.")
    places = [file.resolve() for file in files]
    twice = [file for k, file in enumerate(files) if places[k] in places[:k]]
    require(not twice, f"{twice[0] if twice else ''} is named twice; name each photograph once.")
    require(material in ("skin", "opaque"), f"material must be 'skin' or 'opaque', but it is '{material}'.")
    require(encoding in ("linear", "srgb"), f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.")
    linear = [file.name for file in files if file.suffix.lower() in RAW_SUFFIXES]
    require(not linear or encoding == "linear", f"{linear[0] if linear else ''} is camera RAW, whose light is linear.")
    vectors = np.asarray(lights, dtype=np.float64)
    groups = _same_lights(vectors, len(files))
    strengths = [1.0] * len(files) if intensities is None else [float(value) for value in intensities]
    require(
        len(strengths) == len(files), f"there are {len(strengths)} intensities for {len(files)} lights; give one each."
    )
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    rays = check_lights(np.array([units[group].mean(axis=0) for group in groups]))
    leds = [
        Led("white", direction=(float(x), float(y), float(z)), intensity=float(np.mean([strengths[k] for k in group])))
        for (x, y, z), group in zip(rays / np.linalg.norm(rays, axis=1, keepdims=True), groups, strict=True)
    ]
    stack, turn, hashes = _read_stack(files)
    size = (stack.shape[1], stack.shape[2])
    others = {}
    for what, file in (("mask", mask), ("background", None if isinstance(background, float | int) else background)):
        if file is not None:
            photo = _read_photo_of(Path(file), size, files[0])
            others[what] = photo.pixels
            hashes[Path(file).name] = photo.sha256
    black = float(background) if isinstance(background, float | int) else 0.0
    pixels, ambient, black = _as_integers(stack, others.get("background"), black, groups)
    camera = camera_without_scale(size) if px_per_mm is None else Camera(px_per_mm=float(px_per_mm), image_size=size)
    band = Band(
        name="white",
        pixels=pixels,
        leds=tuple((k,) for k in range(len(groups))),
        exposure=np.ones(len(groups)),
        black_level=np.full(len(groups), black),
        ambient=ambient,
        files=tuple(str(files[group[0]]) for group in groups),
    )
    check_content(band)
    capture = Capture(
        rig=Rig(camera, tuple(leds), {"source": "plain images, distant lights"}),
        bands={"white": band},
        encoding=encoding,
        material=material,
        tip_direction_deg=tip_direction_deg,
        mask=None if mask is None else mask_from_image(_as_bytes(others["mask"]), str(mask)),
        hashes=hashes,
    )
    return capture, _notes(capture, files, groups, turn)


def _notes(capture: Capture, files: Sequence[Path], groups: Sequence[Sequence[int]], turn: int) -> list[str]:
    notes = [UNKNOWN_SCALE] if not capture.rig.camera.scale_known else []
    if turn != 1:
        notes.append(
            f"photographs are turned as their EXIF data say (orientation {turn}); lights are for them upright."
        )
    together = [" + ".join(files[k].name for k in group) for group in groups if len(group) > 1]
    if together:
        notes.append(f"photographs under the same light were averaged: {_listed(together, 4)}.")
    return notes + few_lights(capture.rig.light_vectors())


def _same_lights(vectors: NDArray[np.float64], count: int) -> list[list[int]]:
    """Photographs under one light together, in the order of the first of them."""
    good = vectors.ndim == 2 and vectors.shape[1] == 3 and len(vectors) > 0
    require(good, f"lights must have the shape (L, 3), but it has {vectors.shape}.")
    require(len(vectors) == count, f"lights and images differ in number: {len(vectors)} lights for {count} images.")
    lengths = np.linalg.norm(vectors, axis=1)
    require(bool(np.isfinite(lengths).all()), "lights contains NaN or infinite values.")
    require(bool((lengths > 0).all()), f"lights contains a zero vector (light {int(np.argmin(lengths))}).")
    require(
        bool((vectors[:, 2] > 0).all()),
        f"light {int(np.argmin(vectors[:, 2]))} points away from the camera (z <= 0); lights point towards the light.",
    )
    units = vectors / lengths[:, None]
    groups: list[list[int]] = []
    for k, unit in enumerate(units):
        same = [group for group in groups if unit @ units[group[0]] > np.cos(np.deg2rad(_SAME_DEG))]
        if same:
            same[0].append(k)
        else:
            groups.append([k])
    require(
        len(groups) >= 3,
        f"three different light directions are needed at least, but there are {len(groups)} (within {_SAME_DEG:g} deg "
        "they are one light, and photographs under it are averaged).",
    )
    return groups


def _read_stack(files: Sequence[Path]) -> tuple[NDArray[Any], int, dict[str, str]]:
    """Photographs (L, H, W, C), EXIF's orientation of them, and the SHA-256 of each file by its name."""
    stack: NDArray[Any] | None = None
    first: Photo | None = None
    hashes: dict[str, str] = {}
    for k, file in enumerate(files):
        if stack is None or first is None:
            first = read_photo(file, room=STACK_BYTES // len(files))
            stack = np.empty((len(files), *first.pixels.shape), first.pixels.dtype)
        photo = first if k == 0 else read_photo(file, room=first.pixels.nbytes * 3)
        require(
            photo.orientation == first.orientation,
            f"{file} is turned differently by its EXIF data (orientation {photo.orientation}) than {files[0].name} "
            f"({first.orientation}), as a telephone that looks straight down guesses it; give all one orientation.",
        )
        _check_like(photo, first.pixels.shape[:2], file, files[0])
        require(
            photo.pixels.shape == first.pixels.shape and photo.pixels.dtype == first.pixels.dtype,
            f"{file} is {_kind(photo.pixels)}, but {files[0]} is {_kind(first.pixels)}; all must agree.",
        )
        stack[k] = photo.pixels
        hashes[file.name] = photo.sha256
    if stack is None or first is None:
        raise BadInput("there are no photographs.")
    return stack, first.orientation, hashes


def _read_photo_of(file: Path, size: tuple[int, int], first: Path) -> Photo:
    photo = read_photo(file)
    _check_like(photo, size, file, first)
    return photo


def _check_like(photo: Photo, size: tuple[int, ...], file: Path, first: Path) -> None:
    rows, columns = photo.pixels.shape[:2]
    require(
        (rows, columns) == tuple(size),
        f"{file} has {rows} x {columns} pixels (rows x columns), but {size[0]} x {size[1]} are expected by {first}.",
    )


def _kind(pixels: NDArray[Any]) -> str:
    return f"{'RGB' if pixels.shape[2] == 3 else 'grey'} of {pixels.dtype}"


def _as_bytes(pixels: NDArray[Any]) -> PixelArray:
    return (pixels > 0.5).astype(np.uint8) * np.uint8(255) if pixels.dtype.kind == "f" else pixels


def _as_integers(
    stack: NDArray[Any], ambient: NDArray[Any] | None, black: float, groups: Sequence[Sequence[int]]
) -> tuple[PixelArray, PixelArray | None, float]:
    """Integers with their ambient image and black level; photographs under one light are averaged."""
    floats = stack.dtype.kind == "f"
    require(
        ambient is None or (ambient.dtype.kind == "f") == floats,
        "the background image is of floats and the photographs are not, or the reverse; save both in one format.",
    )
    top = float(stack.max()) if floats else float(np.iinfo(stack.dtype).max)
    require(top > 0, "the photographs are black: not one value is above zero.")
    require(0.0 <= black < top, f"the background must lie between 0 and {top:g}, but it is {black:g}.")
    if not floats and len(groups) == len(stack):
        return stack, ambient, black
    factor = 65535.0 * (_BRIGHTEST if floats else 1.0) / top

    def scaled(values: NDArray[Any]) -> NDArray[np.uint16]:
        return np.clip(np.rint(values * factor), 0, 65535).astype(np.uint16)

    pixels = np.stack([scaled(np.asarray(np.mean(stack[group], axis=0, dtype=np.float64))) for group in groups])
    if ambient is not None and not floats:
        ambient = np.rint(ambient * (65535.0 / float(np.iinfo(ambient.dtype).max))).astype(np.uint16)
    elif ambient is not None:
        ambient = scaled(ambient)
    return pixels, ambient, black * factor
