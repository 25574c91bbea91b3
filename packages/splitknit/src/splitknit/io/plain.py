"""Other people's data: photographs and a list of light directions become a capture."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, check_lights, check_mask, naming, refusing, require
from splitknit.findings import Finding
from splitknit.imaging.band import (
    block_means,
    coarse_flat,
    decode_table,
    linear_image,
    pick_channel,
    srgb_code,
)
from splitknit.imaging.polarised import NOT_SPECULAR, split_mosaic
from splitknit.imaging.response import FEWEST, shading_is_srgb
from splitknit.io.content import check_contents, mask_from_image
from splitknit.io.images import STACK_BYTES
from splitknit.io.light_list import read_intensities, read_light_list
from splitknit.io.photographs import PhotographOptions
from splitknit.io.photos import FORMATS, RAW_SUFFIXES, SUFFIXES, Photo, encoding_of, read_photo
from splitknit.io.provenance import file_hash
from splitknit.io.rig import read_rig
from splitknit.model import (
    UNKNOWN_SCALE,
    Band,
    BoolArray,
    Camera,
    Capture,
    FloatArray,
    Led,
    PixelArray,
    Rig,
    camera_without_scale,
)
from splitknit.steps import large_array, let_go

_MAX_PHOTOS = 1000
_NO_CAMERA = Camera(1.0, (1, 1))
_ASKED, _ASKED_PIXELS = 24, 20_000  # photographs and pixels of each that show the encoding
_NEGATIVE = 0.02
"""Values below minus this part of the brightest are more than noise, if they are more than this part of all."""
_BRIGHTEST = 0.9  # what the brightest value of photographs of floats becomes, of the full scale of 16 bits


_LISTS, _INTENSITIES = ("lights.txt", "light_directions.txt"), "light_intensities.txt"
"""Names of lists beside photographs, DiLiGenT's among them."""
MASK_ALL = "all"  # in place of a mask: the object fills the photographs
_OTHER_CURVE = (
    "the photographs shade as {0}, not as {1}, which was stated of them: heights are then wrong by a factor of about "
    "two; give `encoding` {0}, or leave it out. Gloss on a shallow relief looks so too."
)
UNKNOWN = "unknown"  # in place of the lights: nobody knows their directions, which are estimated
_NO_OPTIONS = PhotographOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """Photographs as a capture, and what is to be known about how they became one."""

    capture: Capture
    skipped: tuple[str, ...]
    """Files of the folder that were not used, each with the reason."""
    notes: tuple[Finding, ...]
    """What was assumed or done, one sentence each."""


def capture_from_photographs(
    folder: str | os.PathLike[str],
    lights: str | os.PathLike[str] | NDArray[np.float64] | Rig | None = None,
    px_per_mm: float | None = None,
    options: PhotographOptions = _NO_OPTIONS,
) -> Photographs:
    """Make a capture of a folder of photographs, one for each light.

    Photographs of floats are brought to 16 bits by one factor. Raises BadInput if files are missing, damaged, of
    different sizes or turned differently by their EXIF data, their number is not that of the lights, the lights do not
    determine a normal or their file names a photograph that is not there, an image is black or overexposed.

    `folder`: of JPEG, PNG, TIFF, WEBP, BMP, HEIC
    or RAW files, all of one size, in the order of their names; or a pattern of their names, such as
    ``photos/white_{light}.png``, in the order of the lights' numbers; or one file; `lights`: list
    (:mod:`splitknit.io.light_list`), rig file (its white LEDs in order, and its camera), directions (L, 3) or rig; by
    default ``lights.txt`` in the folder, or the only ``.lp`` file there; `px_per_mm`: pixels a mm on the object,
    None where it is unknown (heights in pixels); `options`: mask, material, encoding and others.

    >>> found = capture_from_photographs("photos", px_per_mm=20.0)  # doctest: +SKIP
    >>> found.skipped  # doctest: +SKIP
    ('notes.docx (not a photograph)',)
    """
    root = Path(folder)
    require(_home(root).is_dir(), f"{_home(root)} is not a folder; name the folder of the photographs.")
    table, rig, names, colours = _lights_of(root, lights)
    if options.brightness is not None:
        require(
            options.brightness == "equal" or len(rig.leds) >= 5 or table == Path(UNKNOWN),
            f"brightness is estimated of five lights or more, but there are {len(rig.leds)}: state it in the list.",
        )
        leds = tuple(replace(led, intensity=1.0) for led in rig.leds)
        origin = {"intensities": options.brightness}
        rig = replace(rig, leds=leds, provenance={**rig.provenance, **origin})
        colours = None
    named = (options.mask, options.background_image, table)
    own = [Path(os.path.realpath(value)) for value in named if value is not None]
    found, masks, skipped = photographs_in(root, table, names, own, find_mask=options.mask is None)
    options = replace(options, mask=masks[0]) if masks else options
    left_out = f"; skipped: {some_of(skipped)}" if skipped else ""
    require(len(found) > 0, f"{root} holds no photographs ({FORMATS}){left_out}.")
    if table == Path(UNKNOWN):
        rig = _unknown_rig(len(found))
    if len(found) == 1 and len(rig.leds) == 3:  # three coloured lights at once: its channels are the photographs
        found = found * 3
    holds = f"{root} holds {len(found)} photographs"
    remedy = "let each of its lines begin with the name of a photograph."
    require(
        len(found) == len(rig.leds),
        f"{holds} ({found[0].name} to {found[-1].name}), but {table} has {len(rig.leds)} lights{left_out}; {remedy}",
    )
    crossed: list[Path] = []
    if options.crossed is not None:
        second = Path(options.crossed)
        remedy = "name the folder of the crossed photographs with `crossed`."
        require(second.is_dir(), f"{second} is not a folder; {remedy}")
        crossed, _, _ = photographs_in(second, table, names, own)
        remedy = "both series need one photograph a light, in the same order."
        require(len(crossed) == len(found), f"{holds}, but {second} {len(crossed)}; {remedy}")
    capture, notes = _assembled(found, rig, px_per_mm, options, crossed=crossed, colours=colours)
    if table.is_file():
        capture = replace(capture, hashes={**capture.hashes, table.name: file_hash(table)})
    if masks:
        notes.append(Finding("assumed-mask", f"the mask is {masks[0].name}, which lies beside the photographs."))
    if skipped:
        notes.append(Finding("skipped-files", f"skipped in {root}: {some_of(skipped)}."))
    white = Photographs(capture, tuple(skipped), tuple(notes))
    if options.nir is None:
        return white
    own_rig = isinstance(lights, Rig) or table.suffix.lower() == ".json"
    remedy = "give them by a rig file, or put each series into a folder with its list."
    require(
        own_rig or _home(Path(options.nir)) != _home(root),
        f"white and near-infrared photographs lie in one folder, {_home(root)}, but have lights of their own: {remedy}",
    )
    encoding: Any = options.encoding or (capture.encoding if options.max_megapixels is None else None)
    near = replace(options, nir=None, crossed=None, flat=None, mask=None, encoding=encoding)
    rig_nir = _of_band(lights if isinstance(lights, Rig) else read_rig(table), str(table), "nir") if own_rig else None
    infrared = capture_from_photographs(options.nir, rig_nir, px_per_mm, near)
    return _with_nir(white, infrared, Path(options.nir))


def _with_nir(white: Photographs, nir: Photographs, folder: Path) -> Photographs:
    """One capture of both bands; the mask is that of the white photographs."""
    one = white.capture
    other = nir.capture
    ours, theirs = (f"{each.shape[0]} x {each.shape[1]} pixels, {each.encoding}" for each in (one, other))
    require(
        ours == theirs,
        f"the photographs of {folder} are of {theirs}, and the white ones of {ours}; both must agree (`encoding`).",
    )
    count = len(one.rig.leds)
    band = other.bands["white"]
    leds = (*one.rig.leds, *(replace(led, band="nir") for led in other.rig.leds))
    band = replace(band, name="nir", leds=tuple((count + k,) for k in range(len(band.leds))))
    hashes = {**one.hashes, **{f"nir/{name}": value for name, value in other.hashes.items()}}
    capture = replace(one, rig=replace(one.rig, leds=leds), bands={**one.bands, "nir": band}, hashes=hashes)
    notes = [note if note in white.notes else note.of_band("nir") for note in nir.notes]
    return Photographs(capture, white.skipped + nir.skipped, tuple(dict.fromkeys([*white.notes, *notes])))


def _home(folder: Path) -> Path:
    """The folder of photographs that are named by their folder, by a pattern, or by one file."""
    return folder.parent if "{light}" in folder.name or folder.is_file() else folder


def _lights_of(root: Path, lights: Any) -> tuple[Path, Rig, tuple[str, ...], NDArray[np.float64] | None]:
    """The file of the lights, or a word for them; the white LEDs and camera; names, if any; and (L, 3) their relative
    brightness in red, green and blue, where given.
    """
    if isinstance(lights, Rig):
        return Path("the rig"), _of_band(lights, "the rig"), (), None
    if isinstance(lights, str | os.PathLike) and os.fspath(lights) == UNKNOWN:
        return Path(UNKNOWN), _unknown_rig(1), (), None
    if lights is not None and not isinstance(lights, str | os.PathLike):
        return Path("lights"), _distant_rig(check_lights(lights)), (), None
    root = _home(root)
    listed = sorted(root.glob("*.lp")) if lights is None and not (root / "lights.txt").is_file() else []
    usual = next((root / one for one in _LISTS if (root / one).is_file()), root / "lights.txt")
    table = listed[0] if len(listed) == 1 else usual if lights is None else Path(lights)
    require(
        lights is not None or table.is_file(),
        f"{root} holds no lights.txt; name the file of the light directions by `lights`.",
    )
    if table.suffix.lower() == ".json":
        return table, _of_band(read_rig(table), os.fspath(table)), (), None
    found = read_light_list(table)
    rig = _distant_rig(check_lights(found.lights), table if found.places else None)
    bright = found.intensities
    beside = next((one / _INTENSITIES for one in (table.parent, root) if (one / _INTENSITIES).is_file()), None)
    if bright is None and beside is not None:
        bright = read_intensities(beside, len(rig.leds))
    if bright is None:
        return table, rig, found.names, None
    colours = bright / bright.mean(axis=1, keepdims=True) if bright.shape[1] == 3 else None
    return table, _as_bright(rig, bright / bright.mean()), found.names, colours


def _as_bright(rig: Rig, bright: NDArray[np.float64]) -> Rig:
    """The rig with the brightness (L, 1 or 3) of its lights."""
    leds = [replace(led, intensity=float(own.mean())) for led, own in zip(rig.leds, bright, strict=True)]
    return replace(rig, leds=tuple(leds), provenance={**rig.provenance, "intensities": "stated"})


def _of_band(rig: Rig, name: str, band: str = "white") -> Rig:
    leds = tuple(replace(led, band="white") for led in rig.leds if led.band == band)
    require(len(leds) > 0, f"{name} has no LED of the band '{band}'.")
    return replace(rig, leds=leds)


def _distant_rig(vectors: NDArray[np.float64], places: Path | None = None) -> Rig:
    """A rig of lights in directions (L, 3), or at places in mm of the file that is named; its camera is a dummy."""
    lowest = int(np.argmin(vectors[:, 2]))
    require(
        bool(vectors[lowest, 2] > 0),
        f"light {lowest} points away from the camera (z <= 0); lights point towards the light.",
    )
    require(
        places is None or bool((vectors[:, 2] >= 1.0).all()),
        f"{places}: places of lights are in mm above the object (the third number at least 1).",
    )
    kind = "distant" if places is None else "near"
    if places is None:
        leds = [
            Led("white", direction=(x, y, z))
            for x, y, z in (vectors / np.linalg.norm(vectors, axis=1)[:, None]).tolist()
        ]
    else:
        leds = [Led("white", position_mm=(x, y, z)) for x, y, z in vectors.tolist()]
    return Rig(_NO_CAMERA, tuple(leds), {"source": f"plain images, {kind} lights", "intensities": "assumed equal"})


def spread_lights(count: int) -> NDArray[np.float64]:
    """(L, 3) directions that all differ, in place of unknown ones."""
    k = np.arange(count)
    slant = np.deg2rad(15.0 + 35.0 * (k + 0.5) / count)
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * k
    return np.column_stack([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)])


def _unknown_rig(count: int) -> Rig:
    rig = _distant_rig(spread_lights(count))
    return replace(rig, provenance={**rig.provenance, "lights": UNKNOWN})


def some_of(names: Sequence[str]) -> str:
    """The first of many names, and how many more there are."""
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


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
    doubtful = [file for file in found if "mask" in file.stem.lower() and file not in masks]
    skipped += [f"{file.name} (a mask? name it with `mask`)" for file in doubtful]
    found = [file for file in found if file not in (*masks, *doubtful)]
    if names:
        found, unused = _by_name(found, names, table)
        skipped += [f"{file.name} (not in {table.name})" for file in unused]
    return found, masks, skipped


def _photos_in(folder: Path, own: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Photographs of a folder, photo_2 before photo_10, and what else is there; `own` are named otherwise."""
    found = []
    skipped = []
    if folder != _home(folder):
        return [folder] if folder.is_file() else _of_pattern(folder), []
    try:
        files = sorted(folder.iterdir(), key=lambda file: natural_order(file.name))
    except OSError as error:
        raise BadInput(f"{folder} cannot be read ({error.strerror}).") from error
    for file in files:
        if file.name.startswith(".") or Path(os.path.realpath(file)) in own:
            continue
        if file.is_file() and file.suffix.lower() in SUFFIXES:
            found.append(file)
        elif file.name not in {*_LISTS, _INTENSITIES}:
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


def capture_of_arrays(
    images: Any, lights: Any, mask: Any = None, px_per_mm: float | None = None, intensities: Any = None
) -> tuple[Capture, list[Finding]]:
    """Make a capture of arrays, and notes on it; as :func:`splitknit.pipeline.reconstruct_images` takes them."""
    with refusing("`images` must be one array, or arrays of one shape."):
        stack = np.asarray(images)
    shape = stack.shape
    kind = stack.dtype
    require(
        stack.ndim in {3, 4} and (stack.ndim == 3 or shape[3] == 3) and stack.size > 0,
        f"`images` must have the shape (L, H, W) or (L, H, W, 3), but it has {shape}.",
    )
    known = kind in (np.dtype(np.uint8), np.dtype(np.uint16)) or kind.kind == "f"
    require(known, f"`images` must be of uint8, uint16 or floats, but they are of {kind}.")
    require(kind.kind != "f" or bool(np.isfinite(stack).all()), "`images` contains NaN or infinite values.")
    with refusing("`lights` must be numbers of the shape (L, 3), `intensities` of (L,) or (L, 3), `px_per_mm` one."):
        scale = None if px_per_mm is None else float(px_per_mm)
        vectors = spread_lights(len(stack)) if lights is None else np.asarray(lights, dtype=np.float64)
        bright = None if intensities is None else np.asarray(intensities, dtype=np.float64).reshape(len(vectors), -1)
    require(scale is None or 1e-3 <= scale <= 1e5, f"`px_per_mm` must be a number from 0.001 to 100000, not {scale}.")
    rig = _unknown_rig(len(stack)) if lights is None else _distant_rig(check_lights(vectors, len(stack)))
    stack = stack.reshape(*shape[:3], -1)
    if bright is not None:
        good = bright.shape[1] in {1, 3} and bool(np.isfinite(bright).all()) and float(bright.min()) > 0
        require(good, "`intensities` must be positive, one for each light, or three (red, green, blue).")
        rig = _as_bright(rig, bright)
    camera = camera_without_scale(shape[1:3]) if scale is None else Camera(scale, shape[1:3])
    encoding = "linear"
    why = "was assumed"
    if kind == np.uint8:
        step = max(1, math.isqrt(stack[0, ..., 0].size // _ASKED_PIXELS))
        codes = stack[:, ::step, ::step, shape[-1] // 2 if stack.ndim == 4 and stack.shape[3] == 3 else 0]
        curved = None
        if lights is not None:
            codes = codes.reshape(len(stack), -1) / np.float32(255.0)
            curved = shading_is_srgb(codes, rig.light_vectors(), known=not rig.intensities_assumed)
        encoding = "linear" if curved is False else "srgb"
        why = "was assumed" if curved is None else "fits the shading"
    pixels, _, _ = _as_integers(stack, None, 0.0)
    count = len(pixels)
    coloured = bright is not None and bright.shape[1] == 3 and pixels.shape[3] == 3
    band = Band(
        name="white",
        pixels=pixels,
        leds=tuple((k,) for k in range(count)),
        exposure=np.ones(count),
        black_level=np.zeros(count),
        transmission=bright / bright.mean(axis=1, keepdims=True) if coloured and bright is not None else None,
    )
    check_contents([band])
    inside = None if mask is None else check_mask(mask, shape[1:3])
    rig = replace(rig, camera=camera)
    notes = [Finding("scale-unknown", UNKNOWN_SCALE)] if scale is None else []
    if kind == np.uint8:
        notes.append(Finding("assumed-encoding", f"the encoding {encoding} {why} of images of 8 bits."))
    return Capture(rig, {"white": band}, encoding, "opaque", mask=inside), notes


def _assembled(
    files: Sequence[Path],
    rig: Rig,
    px_per_mm: float | None,
    options: PhotographOptions,
    *,
    crossed: Sequence[Path],
    colours: NDArray[np.float64] | None,
) -> tuple[Capture, list[Finding]]:
    """The capture, and notes on it; `colours`: (L, 3) light of each photograph's red, green and blue, relative."""
    require(len(files) >= 3, f"at least three images are needed, but there are {len(files)}.")
    every = [*files, *crossed]
    different = _each_once(every, options)
    background = options.background
    raw = next((file.name for file in every if file.suffix.lower() in RAW_SUFFIXES), None)
    require(raw is None or options.encoding != "srgb", f"{raw} is camera RAW, whose light is linear.")
    require(
        len(rig.leds) == len(files),
        f"lights and images differ in number: {len(rig.leds)} lights for {len(files)} images.",
    )
    check_lights(rig.light_vectors())
    encoding, notes = _encoding(files, rig, options)
    reading = _Reading(different, encoding, options)
    camera = _camera_of(rig.camera, reading, px_per_mm)
    require(
        camera.scale_known or all(led.position_mm is None for led in rig.leds),
        "lights at places in mm need the scale of the photographs; give `px_per_mm`, or directions of the lights.",
    )
    stack, turn, hashes = reading.stack()
    stack = _of_white_light(stack, colours, reading, options)
    ambient = None
    if options.background_image is not None:
        photo = read_photo(Path(options.background_image))
        ambient = reading.reduced(photo, Path(options.background_image))
        hashes[Path(options.background_image).name] = photo.sha256
    inside, how = _inside(options.mask, reading, hashes)
    notes += [Finding("assumed-mask", how)] if how else []
    black = reading.level(float(background)) if isinstance(background, float | int) else 0.0
    count = len(files)
    series = len(stack) // len(files)
    flat, hashes = _flat_of(options, count, encoding, hashes)
    pixels, ambient, black = _as_integers(stack, ambient, black)
    notes += reading.notes()
    band = Band(
        name="white",
        pixels=pixels[:count],
        leds=tuple((k,) for k in range(count)),
        exposure=np.ones(count),
        black_level=np.full(count, black),
        ambient=ambient,
        shading=camera.shading,
        flat=flat,
        files=tuple(map(str, files)),
        polarisation="parallel" if series == 2 else "",
    )
    bands = {"white": band}
    if series == 2:
        names = tuple(map(str, crossed or files))
        other = replace(band, name="white_crossed", pixels=pixels[count:], files=names, polarisation="crossed")
        bands["white_crossed"] = other
        parallel, crossed_mean = (float(one.pixels[:, ::8, ::8].mean(dtype=np.float64)) for one in bands.values())
        notes += [Finding("not-specular", NOT_SPECULAR)] if crossed_mean >= parallel else []
    check_contents(bands.values())
    capture = Capture(
        rig=replace(rig, camera=camera),
        bands=bands,
        encoding=reading.encoding_after,
        material=options.material or ("opaque" if options.nir is None else "skin"),  # by near-infrared light a finger
        tip_direction_deg=options.tip_direction_deg,
        mask=inside,
        hashes=hashes,
    )
    if not camera.scale_known:
        notes.append(Finding("scale-unknown", UNKNOWN_SCALE))
    if turn != 1:
        notes.append(
            Finding(
                "turned-photographs",
                f"photographs are turned as their EXIF data say (orientation {turn}); lights are for them upright.",
            )
        )
    return capture, notes


def _inside(
    mask: str | os.PathLike[str] | None, reading: _Reading, hashes: dict[str, str]
) -> tuple[BoolArray | None, str]:
    """Mask (h, w) of a file, of the word ``all``, or of the photographs' own transparency, None without any; and a note
    where it was found in a picture. The file's SHA-256 joins `hashes`.
    """
    if mask is not None and os.fspath(mask) == MASK_ALL:
        return np.ones(reading.small, dtype=np.bool_), ""
    if mask is None and reading.opaque is None:
        return None, ""
    photo = reading.first if mask is None else read_photo(Path(mask))
    white = reading.opaque if mask is None else photo.opaque
    name = "the photographs" if mask is None else os.fspath(mask)
    if mask is not None:
        hashes[Path(mask).name] = photo.sha256
    pixels = photo.pixels if white is None else white.astype(np.uint8)[..., None] * np.uint8(255)
    if pixels.dtype.kind == "f":
        pixels = np.rint(255.0 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8)
    note = "" if white is None else f"the mask is what is not transparent in {name}."
    white = mask_from_image(pixels, name)
    small = reading.reduced(replace(photo, pixels=white.astype(np.uint8)[..., None] * np.uint8(255)), Path(name))
    return mask_from_image(small, name), note


def _each_once(files: Sequence[Path], options: PhotographOptions) -> Sequence[Path]:
    """The files; the one file of three coloured lights once. Raises BadInput if others are named twice."""
    places = [os.path.realpath(file) for file in files]  # unlike resolve(), which raises where links form a circle
    if len(set(files)) == 1:
        require(options.mosaic is None, f"{files[0]}, one photograph under three lights, goes without `mosaic`.")
        return files[:1]
    twice = [file for k, file in enumerate(files) if places[k] in places[:k]]
    require(not twice, f"{twice[0] if twice else ''} is named twice; name each photograph once.")
    return files


def _flat_of(
    options: PhotographOptions, count: int, encoding: str, hashes: dict[str, str]
) -> tuple[PixelArray | None, dict[str, str]]:
    """Flat images on the coarse grid, as stored, None where none are given; `hashes` and the SHA-256 of their files."""
    if options.flat is None:
        return None, hashes
    flat, own = read_flat(Path(options.flat), count, encoding)
    hashes = hashes | own
    code = srgb_code(flat) if encoding == "srgb" else flat
    return np.rint(65535.0 * np.clip(code, 0.0, 1.0)).astype(np.uint16), hashes


def read_flat(folder: Path, count: int, encoding: str) -> tuple[FloatArray, dict[str, str]]:
    """Photographs of a flat surface (L, h, w) on the coarse grid, linear light with its black level; and SHA-256s. One
    colour photograph serves three lights. Raises BadInput if they are missing, not `count`, or black in places.
    """
    require(folder.is_dir(), f"{folder} is not a folder; name the folder of the flat photographs with `flat`.")
    files, _, _ = photographs_in(folder, folder / "lights.txt")
    light = []
    hashes = {}
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
        f"{folder} holds {len(files)} flat photographs, but there are {count} lights"
        "; give one for each, in the order of their names.",
    )
    require(
        all(one.shape == light[0].shape for one in light),
        f"the flat photographs in {folder} differ in size; take all with the camera as it stands.",
    )
    return np.stack(light), hashes


def _camera_of(camera: Camera, reading: _Reading, px_per_mm: float | None) -> Camera:
    """The rig's camera, or one of the scale that was given, for the photographs as they were read."""
    size = reading.shape[:2]
    factor = reading.factor
    small = reading.small
    if camera is not _NO_CAMERA:
        rows, columns = camera.image_size
        require(
            (rows, columns) == size,
            f"the rig's camera takes images of {rows} x {columns} pixels (rows x columns), but the photographs have "
            f"{size[0]} x {size[1]}; give `lights` a list of lights instead.",
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


def _encoding(files: Sequence[Path], rig: Rig, options: PhotographOptions) -> tuple[str, list[Finding]]:
    """The encoding that is stated, or found by :func:`splitknit.io.photos.encoding_of`; and notes on it."""
    if options.mosaic is not None:
        return "linear", []
    if options.encoding is None:
        encoding, note = encoding_of(files, lambda: _shading_is_srgb(files, rig, options))
        return encoding, [Finding("assumed-encoding", note)]
    if options.material == "skin" or options.flat is not None:
        return options.encoding, []
    curved = _shading_is_srgb(files, rig, options, np.uint8, np.uint16)
    right = curved is None or curved == (options.encoding == "srgb")
    words = _OTHER_CURVE.format("srgb" if curved else "linear", options.encoding)
    return options.encoding, [] if right else [Finding("other-encoding", words)]


def _shading_is_srgb(
    files: Sequence[Path], rig: Rig, options: PhotographOptions, *kinds: type[np.unsignedinteger]
) -> bool | None:
    """Whether the shading in photographs of 8 bits (or `kinds`) is that of sRGB values, None where it decides nothing;
    some of many photographs decide. What is calibrated by `flat` is an industrial camera's, and linear."""
    if options.flat is not None:
        return False
    if rig.provenance.get("lights") == UNKNOWN or len(files) < FEWEST:
        return None
    chosen = np.unique(np.linspace(0, len(files) - 1, min(len(files), _ASKED)).astype(int))
    codes = []
    for k in chosen:
        photo = read_photo(files[k]).pixels
        if photo.dtype not in (kinds or (np.uint8,)):
            return None
        step = max(1, round((photo.shape[0] * photo.shape[1] / _ASKED_PIXELS) ** 0.5))
        codes.append(photo[::step, ::step, photo.shape[2] // 2].ravel() / np.float32(np.iinfo(photo.dtype).max))
    same = len({one.size for one in codes}) == 1  # else refused where all are read
    some = replace(rig, leds=tuple(rig.leds[k] for k in chosen))
    known = not rig.intensities_assumed
    return shading_is_srgb(np.stack(codes), some.light_vectors(), known=known) if same else None


class _Reading:
    """Photographs of one size and kind, read one after the other and reduced where a limit demands it."""

    def __init__(self, files: Sequence[Path], encoding: str, options: PhotographOptions) -> None:
        self.files, self.encoding, self.options = files, encoding, options
        max_megapixels = options.max_megapixels
        self.first_read = self.photos(files[0], STACK_BYTES)
        self.first = self.first_read[0]
        self.series = 1 if options.mosaic is None else 2
        self.shape: tuple[int, ...] = self.first.pixels.shape
        rows, columns, _ = self.shape
        self.megapixels = rows * columns / 1e6
        over = 1.0 if max_megapixels is None else self.megapixels / max_megapixels
        self.factor = max(1.0, math.ceil(8.0 * math.sqrt(over)) / 8.0)
        """Pixels a side that become one, in eighths as :func:`splitknit.imaging.band.linear_image` takes them."""
        self.small = int(rows // self.factor), int(columns // self.factor)
        require(
            self.factor == 1 or min(self.small) >= 16, "`max_megapixels` leaves less than 16 pixels a side; give more."
        )
        floats = self.first.pixels.dtype.kind == "f"
        self.encoding_after = encoding if self.factor == 1 or floats else "linear"
        self.dtype = self.first.pixels.dtype if self.factor == 1 or floats else np.dtype(np.uint16)
        self.opaque: BoolArray | None = None
        """(H, W) what is transparent in none of the photographs, once they are read; None where all is opaque."""

    def photos(self, file: Path, room: int) -> list[Photo]:
        """The photograph of a file; of a mosaic the parallel and the crossed one."""
        photo = read_photo(file, room=room)
        if self.options.mosaic is None:
            return [photo]
        colour = self.options.mosaic == "colour"
        film_deg = self.options.film_deg
        halves = naming(file, lambda: split_mosaic(photo.pixels, film_deg, colour=colour))
        return [replace(photo, pixels=half) for half in halves]

    def notes(self) -> list[Finding]:
        """That photographs were reduced, where they were."""
        if self.factor == 1:
            return []
        return [
            Finding(
                "reduced-photographs",
                f"the photographs of {self.megapixels:.3g} megapixels were reduced to "
                f"{math.prod(self.small) / 1e6:.3g} (`max_megapixels`), by means over "
                f"{self.factor:g} x {self.factor:g} pixels.",
            )
        ]

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
            f"{file} has {rows} x {columns} pixels (rows x columns), but "
            f"{self.shape[0]} x {self.shape[1]} are expected by {self.files[0]}.",
        )
        if self.factor == 1:
            return photo.pixels
        if photo.pixels.dtype.kind == "f":
            return block_means(photo.pixels, self.small, self.factor).reshape(*self.small, -1)
        light = linear_image(photo.pixels, self.encoding, binning=self.factor)
        return np.asarray(np.rint(np.clip(light, 0.0, 1.0) * 65535.0).astype(np.uint16))

    def stack(self) -> tuple[NDArray[Any], int, dict[str, str]]:
        """Photographs (L, h, w, C), EXIF's orientation of them, and the SHA-256 of each file by its name."""
        first = self.first
        hashes = {}
        shape = (self.series * len(self.files), *self.small, self.shape[2])
        require(
            math.prod(shape) * self.dtype.itemsize <= STACK_BYTES,
            f"{self.files[0]} and the photographs with it take more than {STACK_BYTES / 1e9:g} GB"
            "; name fewer, or reduce them by `max_megapixels`.",
        )
        stack = large_array(shape, self.dtype)
        for k, file in enumerate(self.files):
            room = first.pixels.nbytes * (3 if self.series == 1 else 12)
            for part, photo in enumerate(self.photos(file, room) if k else self.first_read):
                require(
                    photo.orientation == first.orientation,
                    f"{file} is turned differently by its EXIF data (orientation {photo.orientation}) than"
                    f" {self.files[0].name} ({first.orientation}), "
                    "as a telephone that looks straight down guesses it; give all one orientation.",
                )
                pixels = self.reduced(photo, file)
                if photo.opaque is not None and self.series == 1:
                    self.opaque = photo.opaque if self.opaque is None else self.opaque & photo.opaque
                alike = photo.pixels.shape == self.shape and photo.pixels.dtype == first.pixels.dtype
                require(
                    alike,
                    f"{file} is {_kind(photo.pixels)}, but {self.files[0]} is {_kind(first.pixels)}; all must agree.",
                )
                stack[k + part * len(self.files)] = pixels
                let_go(stack)
                name = file.name if file.name not in hashes else f"{file.parent.name}/{file.name}"
            hashes[name] = photo.sha256
        return stack, first.orientation, hashes


def _of_white_light(
    stack: NDArray[Any], colours: NDArray[np.float64] | None, reading: _Reading, options: PhotographOptions
) -> NDArray[Any]:
    """Photographs (L, H, W, 3) as even white light gives them, linear, clipping kept; or one, as its three channels."""
    if len(reading.files) == 1:
        require(
            stack.shape[3] == 3,
            f"{reading.files[0]} is grey; one photograph under three lights at once must be in colour.",
        )
        return np.ascontiguousarray(np.moveaxis(stack[0], -1, 0)[..., None])
    if colours is None or stack.shape[3] == 1:
        return stack
    alone = all(one is None for one in (options.background, options.crossed, options.mosaic, options.flat))
    require(alone, "lights with a brightness for each colour go without `background`, `crossed`, `mosaic`, `flat`.")
    encoding, reading.encoding_after = reading.encoding_after, "linear"
    factors = (colours.min() / colours).astype(np.float32)
    if stack.dtype.kind == "f":
        return np.asarray(stack * factors[:, None, None])
    balanced = large_array(stack.shape, np.dtype(np.uint16))
    full = np.iinfo(stack.dtype).max
    for k, image in enumerate(stack):
        light = linear_image(image, encoding) * factors[k]
        balanced[k] = np.where(image == full, 65535, np.rint(65535.0 * light)).astype(np.uint16)
        let_go(balanced)
    return balanced


def _kind(pixels: NDArray[Any]) -> str:
    return f"{'RGB' if pixels.shape[2] == 3 else 'grey'} of {pixels.dtype}"


def _as_integers(
    stack: NDArray[Any], ambient: NDArray[Any] | None, black: float
) -> tuple[PixelArray, PixelArray | None, float]:
    """Integers with their ambient image and black level."""
    floats = stack.dtype.kind == "f"
    require(
        ambient is None or (ambient.dtype.kind == "f") == floats,
        "the background image is of floats and the photographs are not, or the reverse; save both in one format.",
    )
    top = float(stack.max()) if floats else float(np.iinfo(stack.dtype).max)
    require(top > 0, "the photographs are black: not one value is above zero.")
    below = float(np.mean(stack < -_NEGATIVE * top)) if floats else 0.0
    require(below < _NEGATIVE, f"{100 * below:.0f} % of the photographs' values are negative: subtract less from them.")
    require(0.0 <= black < top, f"the background must lie between 0 and {top:g}, but it is {black:g}.")
    if not floats:
        return stack, ambient, black
    factor = 65535.0 * _BRIGHTEST / top

    def scaled(values: NDArray[Any]) -> NDArray[np.uint16]:
        return np.clip(np.rint(values * factor), 0, 65535).astype(np.uint16)

    return np.stack(list(map(scaled, stack))), None if ambient is None else scaled(ambient), black * factor
