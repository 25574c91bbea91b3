"""Other people's data: photographs and a list of light directions become a capture."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, check_lights, naming, require
from splitknit.imaging.band import (
    block_means,
    coarse_flat,
    decode_table,
    linear_image,
    pick_channel,
    shading_is_srgb,
    srgb_code,
)
from splitknit.imaging.light_field import few_lights
from splitknit.imaging.polarised import NOT_SPECULAR, split_mosaic
from splitknit.io.content import check_content, mask_from_image
from splitknit.io.images import STACK_BYTES
from splitknit.io.light_list import read_light_list
from splitknit.io.photos import FORMATS, RAW_SUFFIXES, SUFFIXES, Photo, encoding_of, read_photo
from splitknit.io.provenance import file_hash
from splitknit.io.rig import read_rig
from splitknit.model import (
    UNKNOWN_SCALE,
    Band,
    Camera,
    Capture,
    FloatArray,
    Led,
    PixelArray,
    Rig,
    camera_without_scale,
    vector_at_origin,
)
from splitknit.steps import IN_MEMORY, large_array, let_go

Background = float | str | os.PathLike[str] | None
_SAME_DEG = 0.5
"""Lights whose directions differ by less are one light, as in :func:`splitknit.errors.check_lights`."""
_MAX_PHOTOS = 1000
_NO_CAMERA = Camera(1.0, (1, 1))
_ASKED, _ASKED_PIXELS = 24, 20_000
"""Photographs and pixels of each that show the encoding."""
_LARGE_MEGAPIXELS, _MANY_MEGAPIXELS = 16.0, 300.0
"""Of one photograph and of all: what needs more is announced."""
_FIXED_GB, _GB_PER_MEGAPIXEL, _MESH_MB = 0.3, 0.115, 19.5
"""Memory of a run, and of each megapixel, as docs/experiments/performance.md measures them; and a megapixel's mesh."""
_BRIGHTEST = 0.9
"""What the brightest value of photographs of floats becomes, of the full scale of 16 bits."""


@dataclass(frozen=True, slots=True)
class PhotographOptions:
    """What is known of photographs beside their lights and their scale."""

    mask: str | os.PathLike[str] | None = None
    """Image file, white = object; in a folder by default ``mask.png`` (or another format), where there is one."""
    material: str = "opaque"
    """``opaque`` or ``skin``."""
    encoding: str | None = None
    """``linear`` or ``srgb``; by default by :func:`splitknit.io.photos.encoding_of`."""
    background: Background = None
    """Stored value of no light that was added to every pixel (a number), or an image with all lights off."""
    tip_direction_deg: float | None = None
    """Where a finger's tip points (0 = up, counter-clockwise)."""
    max_megapixels: float | None = None
    """Larger photographs are reduced to so many pixels, by means over areas of linear light."""
    crossed: str | os.PathLike[str] | None = None
    """Folder of the same photographs through a crossed analyser; the others are then the parallel series."""
    mosaic: str | None = None
    """``mono`` or ``colour``: of a camera with films on its pixels, see
    :func:`splitknit.imaging.polarised.split_mosaic`."""
    film_deg: float = 90.0
    """Direction of the film before the LEDs, for a mosaic."""
    flat: str | os.PathLike[str] | None = None
    """Folder of photographs of a flat matt surface, one for each light in the same order; images are divided by
    them."""
    shading: str | os.PathLike[str] | None = None
    """Calibration of ``splitknit calibrate shading``, by which slopes are found instead of by the lights."""
    nir: str | os.PathLike[str] | None = None
    """Folder, or pattern, of photographs under near-infrared lights: the band ``nir``. Their lights are the NIR LEDs of
    the rig, or those of a list in their own folder."""

    def __post_init__(self) -> None:
        require(
            self.material in ("skin", "opaque"), f"material must be 'skin' or 'opaque', but it is '{self.material}'."
        )
        known = self.encoding in ("linear", "srgb", None)
        require(known, f"encoding must be 'linear' or 'srgb', but it is '{self.encoding}'.")
        require(
            self.mosaic in ("mono", "colour", None), f"mosaic must be 'mono' or 'colour', but it is '{self.mosaic}'."
        )
        plain = (self.encoding, self.max_megapixels, self.background_image, self.crossed) in (
            (None, None, None, None), ("linear", None, None, None)
        )  # fmt: skip
        require(
            self.mosaic is None or plain,
            "a mosaic of films is linear and holds both series in each frame: leave out --encoding srgb, --max-size, "
            "--crossed and a --background that is a photograph.",
        )
        alone = self.nir is None or (self.mosaic is None and self.shading is None)
        require(alone, "`nir` goes with neither `mosaic` nor `shading`.")

    @property
    def background_image(self) -> str | os.PathLike[str] | None:
        """The image with all lights off, if there is one."""
        return None if isinstance(self.background, float | int) else self.background


_NO_OPTIONS = PhotographOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """Photographs as a capture, and what is to be known about how they became one."""

    capture: Capture
    skipped: tuple[str, ...]
    """Files of the folder that were not used, each with the reason."""
    notes: tuple[str, ...]
    """What was assumed or done, one sentence each."""


def capture_from_photographs(
    folder: str | os.PathLike[str],
    lights: str | os.PathLike[str] | NDArray[np.float64] | Rig | None = None,
    px_per_mm: float | None = None,
    options: PhotographOptions = _NO_OPTIONS,
    announce: Callable[[str], None] | None = None,
) -> Photographs:
    """Make a capture of a folder of photographs, one for each light.

    Raises BadInput as :func:`capture_from_plain_images`; also if the folder holds no photographs, their number is not
    that of the lights, or the lights' file names one that is not there.

    folder : of JPEG, PNG, TIFF, WEBP, BMP, HEIC or RAW files, all of one size, in the order of their names; or a
        pattern of their names, such as ``photos/white_{light}.png``, in the order of the lights' numbers
    lights : list (:mod:`splitknit.io.light_list`), rig file (its white LEDs in order, and its camera), directions
        (L, 3) or rig; by default ``lights.txt`` in the folder, or the only ``.lp`` file there
    px_per_mm : pixels a millimetre on the object; None where it is unknown: heights are then in pixels
    options : mask, material, encoding and others
    announce : called with a sentence on memory and disk before many or large photographs are read

    >>> found = capture_from_photographs("photos", px_per_mm=20.0)  # doctest: +SKIP
    >>> found.skipped  # doctest: +SKIP
    ('notes.docx (not a photograph)',)
    """
    root = Path(folder)
    require(_home(root).is_dir(), f"{_home(root)} is not a folder; name the folder of the photographs.")
    table, rig, names = _lights_of(root, lights)
    named = (options.mask, options.background_image, table)
    own = [Path(os.path.realpath(value)) for value in named if value is not None]
    found, masks, skipped = photographs_in(root, table, names, own, find_mask=options.mask is None)
    options = replace(options, mask=masks[0]) if masks else options
    left_out = f"; skipped: {some_of(skipped)}" if skipped else ""
    require(len(found) > 0, f"{root} holds no photographs ({FORMATS}){left_out}.")
    require(
        options.shading is None or len(found) > 1,
        f"{root} holds one photograph; the surface under three coloured lights at once is measured, and written with "
        f"'Save result', by 'splitknit view --live {root} --shading FILE'.",
    )
    require(
        len(found) == len(rig.leds),
        f"{root} holds {len(found)} photographs ({found[0].name} to {found[-1].name}), but {table} has "
        f"{len(rig.leds)} lights{left_out}; let each of its lines begin with the name of a photograph.",
    )
    crossed: list[Path] = []
    if options.crossed is not None:
        second = Path(options.crossed)
        require(
            second.is_dir(), f"{second} is not a folder; name the folder of the crossed photographs with --crossed."
        )
        crossed, _, _ = photographs_in(second, table, names, own)
        require(
            len(crossed) == len(found),
            f"{root} holds {len(found)} photographs, but {second} {len(crossed)}; both series need one photograph a "
            "light, in the same order.",
        )
    capture, notes = _assembled(found, rig, px_per_mm, options, announce, crossed)
    if table.is_file():
        capture = replace(capture, hashes={**capture.hashes, table.name: file_hash(table)})
    if skipped:
        notes.append(f"skipped in {root}: {some_of(skipped)}.")
    white = Photographs(capture, tuple(skipped), tuple(notes))
    if options.nir is None:
        return white
    own_rig = isinstance(lights, Rig) or table.suffix.lower() == ".json"
    require(
        own_rig or _home(Path(options.nir)) != _home(root),
        f"white and near-infrared photographs lie in one folder, {_home(root)}, but have lights of their own: give "
        "them by a rig file, or put each series into a folder with its list.",
    )
    encoding = options.encoding or (capture.encoding if options.max_megapixels is None else None)
    near = replace(options, nir=None, crossed=None, flat=None, mask=None, encoding=encoding)
    rig_nir = _of_band(lights if isinstance(lights, Rig) else read_rig(table), str(table), "nir") if own_rig else None
    infrared = capture_from_photographs(options.nir, rig_nir, px_per_mm, near, announce)
    return _with_nir(white, infrared, Path(options.nir))


def _with_nir(white: Photographs, nir: Photographs, folder: Path) -> Photographs:
    """One capture of both bands; the mask is that of the white photographs."""
    one, other = white.capture, nir.capture
    require(
        one.shape == other.shape and one.encoding == other.encoding,
        f"the photographs of {folder} are of {other.shape[0]} x {other.shape[1]} pixels, {other.encoding}, and the "
        f"white ones of {one.shape[0]} x {one.shape[1]}, {one.encoding}; both must agree (`encoding`).",
    )
    count, band = len(one.rig.leds), other.bands["white"]
    leds = (*one.rig.leds, *(replace(led, band="nir") for led in other.rig.leds))
    band = replace(band, name="nir", leds=tuple((count + k,) for k in range(len(band.leds))))
    hashes = {**one.hashes, **{f"nir/{name}": value for name, value in other.hashes.items()}}
    capture = replace(one, rig=replace(one.rig, leds=leds), bands={**one.bands, "nir": band}, hashes=hashes)
    notes = [note if note in white.notes else f"NIR: {note}" for note in nir.notes]
    return Photographs(capture, white.skipped + nir.skipped, tuple(dict.fromkeys([*white.notes, *notes])))


def _home(folder: Path) -> Path:
    """The folder of photographs that are named by their folder, or by a pattern."""
    return folder.parent if "{light}" in folder.name else folder


def _lights_of(root: Path, lights: Any) -> tuple[Path, Rig, tuple[str, ...]]:
    """The file of the lights, or a word for what was given instead; the white LEDs and the camera; names, if any."""
    if isinstance(lights, Rig):
        return Path("the rig"), _of_band(lights, "the rig"), ()
    if lights is not None and not isinstance(lights, str | os.PathLike):
        return Path("lights"), _distant_rig(np.asarray(lights, dtype=np.float64)), ()
    root = _home(root)
    listed = sorted(root.glob("*.lp")) if lights is None and not (root / "lights.txt").is_file() else []
    table = listed[0] if len(listed) == 1 else root / "lights.txt" if lights is None else Path(lights)
    require(
        lights is not None or table.is_file(),
        f"{root} holds no lights.txt; name the file of the light directions by `lights`.",
    )
    if table.suffix.lower() == ".json":
        return table, _of_band(read_rig(table), os.fspath(table)), ()
    vectors, names, places = read_light_list(table)
    return table, _distant_rig(vectors, table if places else None), names


def _of_band(rig: Rig, name: str, band: str = "white") -> Rig:
    """The rig with the LEDs of one band, as white ones."""
    leds = tuple(replace(led, band="white") for led in rig.leds if led.band == band)
    require(len(leds) > 0, f"{name} has no LED of the band '{band}'.")
    return replace(rig, leds=leds)


def _distant_rig(vectors: NDArray[np.float64], places: Path | None = None) -> Rig:
    """A rig of lights in directions (L, 3), or at places in mm of the file that is named; its camera is a dummy."""
    good = vectors.ndim == 2 and vectors.shape[1] == 3 and len(vectors) > 0
    require(good, f"lights must have the shape (L, 3), but it has {vectors.shape}.")
    lengths = np.linalg.norm(vectors, axis=1)
    require(bool(np.isfinite(lengths).all()), "lights contains NaN or infinite values.")
    require(bool((lengths > 0).all()), f"lights contains a zero vector (light {int(np.argmin(lengths))}).")
    require(
        bool((vectors[:, 2] > 0).all()),
        f"light {int(np.argmin(vectors[:, 2]))} points away from the camera (z <= 0); lights point towards the light.",
    )
    require(
        places is None or bool((vectors[:, 2] >= 1.0).all()),
        f"{places}: places of lights are in mm above the object (the third number at least 1).",
    )
    units = vectors / lengths[:, None]
    leds = [
        Led("white", direction=(float(x), float(y), float(z))) if places is None
        else Led("white", position_mm=(float(x), float(y), float(z)))
        for x, y, z in (units if places is None else vectors)
    ]  # fmt: skip
    return Rig(_NO_CAMERA, tuple(leds), {"source": f"plain images, {'distant' if places is None else 'near'} lights"})


def some_of(names: Sequence[str], most: int = 8) -> str:
    """The first of many names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def photographs_in(
    folder: Path, table: Path, names: Sequence[str] = (), own: Sequence[Path] = (), *, find_mask: bool = True
) -> tuple[list[Path], list[Path], list[str]]:
    """Photographs of a folder in the order of the lights; masks; and what else is there, each with the reason.

    `table`: file of the lights, for messages; `names`: of photographs, from that file; empty: all, photo_2 before
    photo_10; `own`: files that have another use; `find_mask`: whether a ``mask.png`` (or another format) is looked for.
    Raises BadInput if the folder cannot be read, holds more than 1000 photographs, or lacks one that is named.
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
    if folder != _home(folder):
        return _of_pattern(folder), []
    try:
        files = sorted(folder.iterdir(), key=lambda file: natural_order(file.name))
    except OSError as error:
        raise BadInput(f"{folder} cannot be read ({error.strerror}).") from error
    for file in files:
        if file.name.startswith(".") or Path(os.path.realpath(file)) in own:
            continue
        if file.is_file() and file.suffix.lower() in SUFFIXES:
            found.append(file)
        elif file.name != "lights.txt":
            skipped.append(f"{file.name} ({'a folder' if file.is_dir() else 'not a photograph'})")
    require(len(found) <= _MAX_PHOTOS, f"{folder} holds {len(found)} photographs; at most {_MAX_PHOTOS} are read.")
    return found, skipped


def _of_pattern(pattern: Path) -> list[Path]:
    """Files whose names have a number in the place of ``{light}``, by that number; two of one number are refused."""
    before, _, after = pattern.name.partition("{light}")
    form = re.compile(rf"{re.escape(before)}(\d{{1,6}}){re.escape(after)}", flags=re.IGNORECASE)
    found: dict[int, Path] = {}
    for file in sorted(_home(pattern).iterdir()):
        match = form.fullmatch(file.name)
        if match and file.is_file():
            other = found.setdefault(int(match[1]), file)
            require(other == file, f"{other} and {file.name} are both of light {int(match[1])}; keep one of them.")
    require(len(found) <= _MAX_PHOTOS, f"{pattern} fits {len(found)} photographs; at most {_MAX_PHOTOS} are read.")
    return [found[number] for number in sorted(found)]


def natural_order(name: str) -> list[tuple[int, str]]:
    """Key by which photo_2 comes before photo_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name[:300])]


def _by_name(found: Sequence[Path], names: Sequence[str], table: Path) -> tuple[list[Path], list[Path]]:
    """Photographs that the lights' file names, in its order, and the others; suffixes and capitals need not agree."""
    chosen = []
    for name in names:
        ways = (str, str.lower, lambda word: Path(word.lower()).stem)
        tries = ([file for file in found if name == file.stem or way(name) == way(file.name)] for way in ways)
        fits = next(filter(None, tries), [])
        require(len(fits) > 0, f"{table} names {name!a}, but there is no such photograph.")
        require(len(fits) == 1, f"{table} names {name!a}, which fits {some_of([file.name for file in fits])}.")
        chosen.append(fits[0])
    return chosen, [file for file in found if file not in chosen]


def capture_from_plain_images(
    images: Sequence[str | os.PathLike[str]],
    lights: NDArray[np.float64],
    px_per_mm: float | None,
    options: PhotographOptions = _NO_OPTIONS,
    intensities: Sequence[float] | None = None,
) -> Capture:
    """Make a capture of images of one object under distant lights; all of them form the band ``white``.

    Photographs under one light (directions within 0.5 deg) are averaged. Photographs of floats are brought to 16 bits
    by one factor. Raises BadInput if files are missing, damaged, of different sizes or turned differently by their EXIF
    data, lights and images differ in number, the lights do not determine a normal, an image is black or overexposed.

    images : files of :func:`splitknit.io.photos.read_photo`, of one size, at least three, in the order of the lights
    lights : (L, 3) directions *towards* the lights, x right, y up, z to the camera, of any length
    px_per_mm : pixels a millimetre on the object; heights scale with it. None where it is unknown
    options : mask, material and others; without an encoding the images are linear
    intensities : relative strength of each light; equal where None
    """
    files = [Path(image) for image in images]
    rig = _distant_rig(np.asarray(lights, dtype=np.float64))
    strengths = [1.0] * len(rig.leds) if intensities is None else [float(value) for value in intensities]
    require(
        len(strengths) == len(rig.leds),
        f"there are {len(strengths)} intensities for {len(rig.leds)} lights; give one each.",
    )
    rig = replace(rig, leds=tuple(replace(led, intensity=one) for led, one in zip(rig.leds, strengths, strict=True)))
    return _assembled(files, rig, px_per_mm, replace(options, encoding=options.encoding or "linear"))[0]


def _assembled(  # noqa: PLR0917
    files: Sequence[Path],
    rig: Rig,
    px_per_mm: float | None,
    options: PhotographOptions,
    announce: Callable[[str], None] | None = None,
    crossed: Sequence[Path] = (),
) -> tuple[Capture, list[str]]:
    """The capture, and notes on it."""
    require(len(files) >= 3, f"at least three images are needed, but there are {len(files)}.")
    every = [*files, *crossed]
    places = [os.path.realpath(file) for file in every]  # unlike resolve(), which raises where links form a circle
    twice = [file for k, file in enumerate(every) if places[k] in places[:k]]
    require(not twice, f"{twice[0] if twice else ''} is named twice; name each photograph once.")
    encoding, mask, background = options.encoding, options.mask, options.background
    linear = [file.name for file in every if file.suffix.lower() in RAW_SUFFIXES]
    require(not linear or encoding != "srgb", f"{linear[0] if linear else ''} is camera RAW, whose light is linear.")
    require(
        len(rig.leds) == len(files),
        f"lights and images differ in number: {len(rig.leds)} lights for {len(files)} images.",
    )
    groups = _same_lights(rig)
    leds = tuple(_together([rig.leds[k] for k in group]) for group in groups)
    check_lights(replace(rig, leds=leds).light_vectors())
    notes = []
    if options.mosaic is not None:
        encoding = "linear"
    elif encoding is None:
        encoding, note = encoding_of(files, lambda: _shading_is_srgb(files, rig.light_vectors()))
        notes.append(note)
    reading = _Reading(every, encoding, options)
    camera = _camera_of(rig.camera, reading, px_per_mm)
    require(
        camera.scale_known or all(led.position_mm is None for led in leds),
        "lights at places in mm need the scale of the photographs; give `px_per_mm`, or directions of the lights.",
    )
    if announce is not None and (cost := reading.cost()):
        announce(cost)
    stack, turn, hashes = reading.stack()
    others = {}
    for what, file in (("mask", mask), ("background", options.background_image)):
        if file is not None:
            photo = read_photo(Path(file))
            others[what] = reading.reduced(photo, Path(file))
            if what == "mask" and others[what].dtype.kind == "f":
                others[what] = (others[what] > 0.5).astype(np.uint8) * np.uint8(255)
            hashes[Path(file).name] = photo.sha256
    black = reading.level(float(background)) if isinstance(background, float | int) else 0.0
    count, series = len(groups), len(stack) // len(files)
    groups += [[len(files) + k for k in group] for group in groups] if series == 2 else []
    flat, read = _flat_of(options, groups[:count], encoding)
    hashes |= read
    pixels, ambient, black = _as_integers(stack, others.get("background"), black, groups)
    encoding = reading.encoding_after
    if reading.factor > 1:
        notes.append(
            f"the photographs of {reading.megapixels:.3g} megapixels were reduced to "
            f"{pixels[0, ..., 0].size / 1e6:.3g} (--max-size), by means over {reading.factor:g} x "
            f"{reading.factor:g} pixels."
        )
    band = Band(
        name="white",
        pixels=pixels[:count],
        leds=tuple((k,) for k in range(count)),
        exposure=np.ones(count),
        black_level=np.full(count, black),
        ambient=ambient,
        shading=camera.shading,
        flat=flat,
        files=tuple(str(files[group[0]]) for group in groups[:count]),
        polarisation="parallel" if series == 2 else "",
    )
    bands = {"white": band}
    if series == 2:
        names = tuple(str(every[group[0] % len(every)]) for group in groups[count:])
        bands["white_crossed"] = replace(
            band, name="white_crossed", pixels=pixels[count:], files=names, polarisation="crossed"
        )
        parallel, other = (float(one.pixels[:, ::8, ::8].mean(dtype=np.float64)) for one in bands.values())
        notes += [NOT_SPECULAR] if other >= parallel else []
    for one in bands.values():
        check_content(one)
    capture = Capture(
        rig=replace(rig, camera=camera, leds=leds),
        bands=bands,
        encoding=encoding,
        material=options.material,
        tip_direction_deg=options.tip_direction_deg,
        mask=None if mask is None else mask_from_image(others["mask"], str(mask)),
        hashes=hashes,
        shading=None if options.shading is None else Path(options.shading),
    )
    return capture, [*notes, *_notes(capture, files, groups[:count], turn)]


def _flat_of(
    options: PhotographOptions, groups: Sequence[Sequence[int]], encoding: str
) -> tuple[PixelArray | None, dict[str, str]]:
    """Flat images on the coarse grid, as stored, and the SHA-256 of their files; None where none are given."""
    if options.flat is None:
        return None, {}
    flat, hashes = read_flat(Path(options.flat), sum(map(len, groups)), encoding)
    flat = np.stack([flat[list(group)].mean(axis=0) for group in groups])
    code = srgb_code(flat) if encoding == "srgb" else flat
    return np.rint(65535.0 * np.clip(code, 0.0, 1.0)).astype(np.uint16), hashes


def read_flat(folder: Path, count: int, encoding: str) -> tuple[FloatArray, dict[str, str]]:
    """Photographs of a flat surface (L, h, w) on the coarse grid, linear light with its black level; and SHA-256s. One
    colour photograph serves three lights. Raises BadInput if they are missing, not `count`, or black in places.
    """
    require(folder.is_dir(), f"{folder} is not a folder; name the folder of the flat photographs with `flat`.")
    files, _, _ = photographs_in(folder, folder / "lights.txt")
    light, hashes = [], {}
    for file in files:
        photo = read_photo(file)
        require(photo.pixels.dtype.kind == "u", f"{file} holds floats; save it as 16-bit PNG or TIFF.")
        image = linear_image(photo.pixels, encoding)
        coloured = len(files) == 1 < count and image.shape[2] == 3
        channels = [image[..., k] for k in range(3)] if coloured else [pick_channel(image, "grey")]
        light += [naming(file, partial(coarse_flat, np.ascontiguousarray(one))) for one in channels]
        hashes[f"{folder.name}/{file.name}"] = photo.sha256
    require(
        len(light) == count,
        f"{folder} holds {len(files)} flat photographs, but there are {count} lights; give one for each, in the order "
        "of their names.",
    )
    return np.stack(light), hashes


def _camera_of(camera: Camera, reading: _Reading, px_per_mm: float | None) -> Camera:
    """The rig's camera, or one of the scale that was given, for the photographs as they were read."""
    size, factor = reading.shape[:2], reading.factor
    small = (int(size[0] // factor), int(size[1] // factor))
    if camera is not _NO_CAMERA:
        require(
            camera.image_size == size,
            f"the rig's camera takes images of {camera.image_size[0]} x {camera.image_size[1]} pixels (rows x "
            f"columns), but the photographs have {size[0]} x {size[1]}; give `lights` a list of lights instead.",
        )
        require(
            px_per_mm is None or not camera.scale_known,
            f"`px_per_mm` and the rig file ({camera.px_per_mm:g} px/mm) both give the scale; leave out the first.",
        )
        if px_per_mm is None and not camera.scale_known:
            return camera_without_scale(small)
        matrix = camera.matrix
        if matrix is not None and factor > 1:  # the middle of the first pixel is 0
            matrix = np.array([[1, 0, 0.5 - factor / 2], [0, 1, 0.5 - factor / 2], [0, 0, factor]]) @ matrix / factor
        scale = (camera.px_per_mm if px_per_mm is None else float(px_per_mm)) / factor
        return replace(camera, image_size=small, px_per_mm=scale, scale_known=True, matrix=matrix)
    return camera_without_scale(small) if px_per_mm is None else Camera(float(px_per_mm) / factor, small)


def _notes(capture: Capture, files: Sequence[Path], groups: Sequence[Sequence[int]], turn: int) -> list[str]:
    notes = [UNKNOWN_SCALE] if not capture.rig.camera.scale_known else []
    if turn != 1:
        notes.append(
            f"photographs are turned as their EXIF data say (orientation {turn}); lights are for them upright."
        )
    together = [" + ".join(files[k].name for k in group) for group in groups if len(group) > 1]
    if together:
        notes.append(f"photographs under the same light were averaged: {some_of(together, 4)}.")
    return notes + few_lights(capture.rig.light_vectors())


def _together(leds: Sequence[Led]) -> Led:
    """The light of several photographs that are averaged: the mean direction of distant ones, else the first place."""
    intensity = float(np.mean([led.intensity for led in leds]))
    if leds[0].direction is None or len(leds) == 1:
        return replace(leds[0], intensity=intensity)
    mean = np.mean([vector_at_origin(replace(led, intensity=1.0)) for led in leds], axis=0)
    x, y, z = mean / np.linalg.norm(mean)
    return replace(leds[0], direction=(float(x), float(y), float(z)), intensity=intensity)


def _same_lights(rig: Rig) -> list[list[int]]:
    """Photographs under one light together, in the order of the first of them."""
    vectors = rig.light_vectors()
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
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


def _shading_is_srgb(files: Sequence[Path], lights: NDArray[np.float64]) -> bool:
    """Whether the shading in photographs of 8 bits is that of sRGB values; some of many photographs decide."""
    chosen = np.unique(np.linspace(0, len(files) - 1, min(len(files), _ASKED)).astype(int))
    codes = []
    for k in chosen:
        photo = read_photo(files[k]).pixels
        step = max(1, round((photo.shape[0] * photo.shape[1] / _ASKED_PIXELS) ** 0.5))
        codes.append(photo[::step, ::step, photo.shape[2] // 2].ravel() / np.float32(255.0))
    same = len({one.size for one in codes}) == 1  # else refused where all are read
    return same and shading_is_srgb(np.stack(codes), lights[chosen])


class _Reading:
    """Photographs of one size and kind, read one after the other and reduced where a limit demands it."""

    def __init__(self, files: Sequence[Path], encoding: str, options: PhotographOptions) -> None:
        self.files, self.encoding, self.options = files, encoding, options
        max_megapixels = options.max_megapixels
        self.first, *_ = self.photos(files[0], STACK_BYTES)
        self.series = 1 if options.mosaic is None else 2
        self.shape: tuple[int, ...] = self.first.pixels.shape
        rows, columns, _ = self.shape
        self.megapixels = rows * columns / 1e6
        over = 1.0 if max_megapixels is None else self.megapixels / max_megapixels
        self.factor = max(1.0, math.ceil(8.0 * math.sqrt(over)) / 8.0)
        """Pixels a side that become one, in eighths as :func:`splitknit.imaging.band.linear_image` takes them."""
        large = self.factor == 1 or min(rows, columns) // self.factor >= 16
        require(large, "`max_megapixels` leaves less than 16 pixels a side; give more.")
        floats = self.first.pixels.dtype.kind == "f"
        self.encoding_after = encoding if self.factor == 1 or floats else "linear"
        self.dtype = self.first.pixels.dtype if self.factor == 1 or floats else np.dtype(np.uint16)

    def photos(self, file: Path, room: int) -> list[Photo]:
        """The photograph of a file; of a mosaic the parallel and the crossed one."""
        photo = read_photo(file, room=room)
        if self.options.mosaic is None:
            return [photo]
        colour, film_deg = self.options.mosaic == "colour", self.options.film_deg
        halves = naming(file, lambda: split_mosaic(photo.pixels, film_deg, colour=colour))
        return [replace(photo, pixels=half) for half in halves]

    def cost(self) -> str:
        """A sentence on memory and disk, where they are much."""
        count, used = self.series * len(self.files), self.megapixels / self.factor**2
        memory = _FIXED_GB + used * _GB_PER_MEGAPIXEL
        if max(used / _LARGE_MEGAPIXELS, count * used / _MANY_MEGAPIXELS) < 1:
            return ""
        disk = count * used * self.shape[2] * self.dtype.itemsize / 1e3
        stored = (
            f", {disk:.1f} GB of disk for the photographs while they are worked on" if 1e9 * disk > IN_MEMORY else ""
        )
        smaller = "" if used < _LARGE_MEGAPIXELS else "; --max-size 10 reduces them to 10 megapixels"
        return (
            f"{count} photographs of {used:.1f} megapixels need about {memory:.1f} GB of memory{stored}, and a mesh of "
            f"the whole picture takes {used * _MESH_MB:.0f} MB{smaller}."
        )

    def level(self, stored: float) -> float:
        """A stored value, on the scale of :meth:`stack`."""
        if self.factor == 1 or self.dtype.kind == "f":
            return stored
        table = decode_table(self.first.pixels.dtype, self.encoding)
        require(0 <= stored < len(table), f"the background must lie between 0 and {len(table) - 1}, not {stored:g}.")
        return 65535.0 * float(np.interp(stored, np.arange(len(table)), table))

    def reduced(self, photo: Photo, file: Path) -> NDArray[Any]:
        """Pixels of a photograph (H, W, C), linear where they are reduced."""
        rows, columns = photo.pixels.shape[:2]
        require(
            (rows, columns) == self.shape[:2],
            f"{file} has {rows} x {columns} pixels (rows x columns), but {self.shape[0]} x {self.shape[1]} are "
            f"expected by {self.files[0]}.",
        )
        if self.factor == 1:
            return photo.pixels
        small = (int(rows // self.factor), int(columns // self.factor))
        if photo.pixels.dtype.kind == "f":
            return np.asarray(block_means(photo.pixels, small, self.factor).reshape(*small, -1))
        light = linear_image(photo.pixels, self.encoding, binning=self.factor)
        return np.asarray(np.rint(np.clip(light, 0.0, 1.0) * np.float32(65535.0)).astype(np.uint16))

    def stack(self) -> tuple[NDArray[Any], int, dict[str, str]]:
        """Photographs (L, h, w, C), EXIF's orientation of them, and the SHA-256 of each file by its name."""
        first, hashes = self.first, {}
        rows, columns, channels = self.shape
        shape = (self.series * len(self.files), int(rows // self.factor), int(columns // self.factor), channels)
        require(
            math.prod(shape) * self.dtype.itemsize <= STACK_BYTES,
            f"{self.files[0]} and the photographs with it take more than {STACK_BYTES / 1e9:g} GB; name fewer, or "
            "reduce them by `max_megapixels`.",
        )
        stack = large_array(shape, self.dtype)
        for k, file in enumerate(self.files):
            for part, photo in enumerate(self.photos(file, first.pixels.nbytes * (3 if self.series == 1 else 12))):
                require(
                    photo.orientation == first.orientation,
                    f"{file} is turned differently by its EXIF data (orientation {photo.orientation}) than "
                    f"{self.files[0].name} ({first.orientation}), as a telephone that looks straight down guesses it; "
                    "give all one orientation.",
                )
                pixels = self.reduced(photo, file)
                require(
                    photo.pixels.shape == self.shape and photo.pixels.dtype == first.pixels.dtype,
                    f"{file} is {_kind(photo.pixels)}, but {self.files[0]} is {_kind(first.pixels)}; all must agree.",
                )
                stack[k + part * len(self.files)] = pixels
                let_go(stack)
                name = file.name if file.name not in hashes else f"{file.parent.name}/{file.name}"
            hashes[name] = photo.sha256
        return stack, first.orientation, hashes


def _kind(pixels: NDArray[Any]) -> str:
    return f"{'RGB' if pixels.shape[2] == 3 else 'grey'} of {pixels.dtype}"


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
