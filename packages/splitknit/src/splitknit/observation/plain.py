"""Other people's data: photographs and a list of light directions become a capture."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Ambient, Band, Capture
from splitknit.checks import check_lights, check_mask
from splitknit.errors import naming, refusing, require
from splitknit.files import AnyPath
from splitknit.findings import Finding
from splitknit.imaging.pixels import pick_channel
from splitknit.io.content import check_contents, mask_of_photo
from splitknit.io.images import STACK_BYTES, SizeCheck, size_check
from splitknit.io.light_list import read_intensities, read_light_list
from splitknit.io.paging import chosen, new_stack
from splitknit.io.photograph_files import (
    INTENSITIES,
    LIGHT_LISTS,
    home_of,
    photographs_in,
    some_of,
)
from splitknit.io.photographs import SCALES, GivenPhotographs
from splitknit.io.photos import (
    FORMATS,
    RAW_SUFFIXES,
    Photo,
    encoding_of,
    read_photo,
    stated_encoding,
)
from splitknit.io.provenance import file_hash
from splitknit.io.rig import read_rig
from splitknit.model import (
    Array,
    BoolArray,
    Camera,
    FloatArray,
    Led,
    PixelArray,
    Point,
    Rig,
    camera_without_scale,
)
from splitknit.observation.films import NOT_SPECULAR
from splitknit.observation.stored import coarse_flat, linear_image, stored_values
from splitknit.settings import check_value

_NO_CAMERA = Camera(1.0, (1, 1))
"""Stands for a camera that is not known. Source: definition."""
_MASK_ALL = "all"  # in place of a mask: the object fills the photographs


@dataclass(frozen=True, slots=True, eq=False)
class _Lights:
    """What is known of the lights."""

    source: Path  # their file, or a word for messages
    rig: Rig
    names: tuple[str, ...] = ()  # of photographs, in their file
    colours: Array | None = None  # (L, 3) relative brightness of red, green and blue
    camera_mm: Point | None = None  # the camera's centre, as a list of places states it


def capture_from_photographs(photographs: GivenPhotographs) -> tuple[Capture, list[Finding]]:
    """Make a capture of a folder of photographs, one for each light; and what was assumed of them.

    Photographs of floats are brought to 16 bits by one factor. Raises BadInput if files are
    missing, damaged, of different sizes or turned differently by their EXIF data, their number is
    not that of the lights, the lights do not determine a normal or their file names a photograph
    that is not there, an image is black or overexposed.
    """
    root = Path(photographs.images or "")
    home = home_of(root)
    require(home.is_dir(), f"{home} is not a folder; name the folder of the photographs.")
    known = _lights_of(home, photographs.lights)
    source = known.source
    if photographs.brightness is not None:
        known = _with_brightness(known, photographs.brightness)
    named = (photographs.mask, photographs.background_image, source)
    used = [Path(os.path.realpath(file)) for file in named if file is not None]
    find_mask = photographs.mask is None
    files, masks, skipped = photographs_in(root, source, known.names, used, find_mask=find_mask)
    notes = []
    if masks:
        photographs = replace(photographs, mask=masks[0])
        words = f"the mask is {masks[0].name}, which lies beside the photographs."
        notes.append(Finding("assumed-mask", words))
    left_out = f"; skipped: {some_of(skipped)}" if skipped else ""
    if skipped:
        notes.append(Finding("skipped-files", f"skipped in {root}: {some_of(skipped)}."))
    require(len(files) > 0, f"{root} holds no photographs ({FORMATS}){left_out}.")
    count = len(known.rig.leds)
    if len(files) == 1 and count == 3:  # three coloured lights at once: one channel for each
        files = files * 3
    require(
        len(files) == count,
        f"{root} holds {len(files)} photographs ({files[0].name} to {files[-1].name}), but"
        f" {source} has {count} lights{left_out}; let each of its lines begin with the name of a"
        " photograph.",
    )
    crossed: list[Path] = []
    if photographs.crossed is not None:
        second = Path(photographs.crossed)
        require(
            second.is_dir(),
            f"{second} is not a folder; name the folder of the crossed photographs with `crossed`.",
        )
        crossed = photographs_in(second, source, known.names, used).photographs
        require(
            len(crossed) == count,
            f"{root} holds {count} photographs, but {second} {len(crossed)}; both series need one"
            " photograph a light, in the same order.",
        )
    capture, assumed = _assembled(files, crossed, known, photographs)
    if source.is_file():
        capture = replace(capture, hashes={**capture.hashes, source.name: file_hash(source)})
    notes = [*assumed, *notes]
    if photographs.nir is None:
        return capture, notes
    capture, of_nir = _with_nir(capture, photographs)
    notes += [note.of_band("nir") for note in of_nir if note not in notes]
    return capture, notes


def _with_nir(capture: Capture, photographs: GivenPhotographs) -> tuple[Capture, list[Finding]]:
    """The white capture with the near-infrared band, and what was assumed of that; the mask is that
    of the white photographs."""
    folder = Path(photographs.nir or "")
    home = home_of(Path(photographs.images or ""))
    rig: Any = photographs.lights
    if not isinstance(rig, Rig) and str(rig).lower().endswith(".json"):
        rig = read_rig(rig)
    has_rig = isinstance(rig, Rig)
    require(
        has_rig or home_of(folder) != home,
        f"white and near-infrared photographs lie in one folder, {home}, but have lights of their"
        " own: give them by a rig file, or put each series into a folder with its list.",
    )
    lights = _of_band(rig, "nir", "the rig") if has_rig else None
    encoding: Any = capture.encoding if photographs.encoding is None else photographs.encoding
    near = replace(
        photographs, images=folder, lights=lights, nir=None, crossed=None, flat=None, mask=None
    )
    infrared, notes = capture_from_photographs(replace(near, encoding=encoding))
    kinds = [
        f"{each.shape[0]} x {each.shape[1]} pixels, {each.encoding}" for each in (infrared, capture)
    ]
    require(
        kinds[0] == kinds[1],
        f"the photographs of {folder} are of {kinds[0]}, and the white ones of {kinds[1]}"
        "; both must agree (`encoding`).",
    )
    count = len(capture.rig.leds)
    leds = [replace(led, band="nir") for led in infrared.rig.leds]
    both = replace(capture.rig, leds=(*capture.rig.leds, *leds))
    groups = tuple((count + k,) for k in range(len(leds)))
    band = replace(infrared.bands["white"], name="nir", leds=groups)
    hashes = {f"nir/{name}": value for name, value in infrared.hashes.items()}
    capture = replace(
        capture,
        rig=both,
        bands={**capture.bands, "nir": band},
        hashes={**capture.hashes, **hashes},
    )
    return capture, notes


def _lights_of(folder: Path, lights: Any) -> _Lights:
    """The white lights of a rig, of directions (L, 3), or of a file, by default one in `folder`."""
    if isinstance(lights, Rig):
        return _Lights(Path("the rig"), _of_band(lights, "white", "the rig"))
    if lights is not None and not isinstance(lights, str | os.PathLike):
        return _Lights(Path("lights"), _distant_rig(check_lights(lights)))
    if lights is not None:
        table = Path(lights)
    else:
        usual = [folder / name for name in LIGHT_LISTS if (folder / name).is_file()]
        of_rti = list(folder.glob("*.lp"))
        if len(of_rti) == 1 and folder / "lights.txt" not in usual:
            usual = of_rti
        require(
            len(usual) > 0,
            f"{folder} holds no lights.txt; give `lights`, a list of directions or places, or a rig"
            " file: a ball in the pictures shows them (`splitknit calibrate lights`, option"
            " `sphere`).",
        )
        table = usual[0]
    if table.suffix.lower() == ".json":
        return _Lights(table, _of_band(read_rig(table), "white", os.fspath(table)))
    listed = read_light_list(table)
    vectors = check_lights(listed.lights)
    camera = listed.camera_mm
    if camera is not None:  # the rig's origin lies below it
        vectors = vectors - (*camera[:2], 0.0)
    rig = _near_rig(vectors, table) if listed.places else _distant_rig(vectors)
    brightness = listed.intensities
    for beside in (table.parent / INTENSITIES, folder / INTENSITIES):
        if brightness is None and beside.is_file():
            brightness = read_intensities(beside, len(rig.leds))
    known = _Lights(table, rig, listed.names, camera_mm=camera)
    if brightness is None:
        return known
    return replace(known, rig=_as_bright(rig, brightness), colours=_colours_of(brightness))


def _with_brightness(lights: _Lights, brightness: str) -> _Lights:
    """The lights with a brightness that is equal, or to be estimated."""
    leds = tuple(replace(led, intensity=1.0) for led in lights.rig.leds)
    require(
        brightness == "equal" or len(leds) >= 5,
        f"brightness is estimated of five lights or more, but there are {len(leds)}: state it in"
        " the list.",
    )
    origin = {**lights.rig.provenance, "intensities": brightness}
    return replace(lights, rig=replace(lights.rig, leds=leds, provenance=origin), colours=None)


def _as_bright(rig: Rig, brightness: Array) -> Rig:
    """The rig with the brightness (L, 1 or 3) of its lights, one on average."""
    means = (brightness / brightness.mean()).mean(axis=1).tolist()
    pairs = zip(rig.leds, means, strict=True)
    leds = tuple(replace(led, intensity=mean) for led, mean in pairs)
    return replace(rig, leds=leds, provenance={**rig.provenance, "intensities": "stated"})


def _colours_of(brightness: Array) -> Array | None:
    """(L, 3) brightness of red, green and blue over their mean; None where it is one number."""
    return brightness / brightness.mean(axis=1, keepdims=True) if brightness.shape[1] == 3 else None


def _of_band(rig: Rig, band: str, name: str) -> Rig:
    """The rig with the LEDs of one band alone, as white ones."""
    leds = tuple(replace(led, band="white") for led in rig.leds if led.band == band)
    require(len(leds) > 0, f"{name} has no LED of the band '{band}'.")
    return replace(rig, leds=leds)


def _rig_of(leds: Sequence[Led], kind: str) -> Rig:
    """A rig without a camera."""
    source = f"plain images, {kind} lights"
    return Rig(_NO_CAMERA, tuple(leds), {"source": source, "intensities": "assumed equal"})


def _distant_rig(vectors: Array) -> Rig:
    """A rig of lights in directions (L, 3)."""
    lowest = int(np.argmin(vectors[:, 2]))
    require(
        vectors[lowest, 2] > 0,
        f"light {lowest} points away from the camera (z <= 0); lights point towards the light.",
    )
    unit = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return _rig_of([Led("white", direction=(x, y, z)) for x, y, z in unit.tolist()], "distant")


def _near_rig(places: Array, table: Path) -> Rig:
    """A rig of lights at places (L, 3) in mm."""
    require(
        (places[:, 2] >= 1.0).all(),
        f"{table}: places of lights are in mm above the object (the third number at least 1).",
    )
    return _rig_of([Led("white", position_mm=(x, y, z)) for x, y, z in places.tolist()], "near")


def capture_of_arrays(
    images: Any,
    lights: Any,
    mask: Any = None,
    px_per_mm: float | None = None,
    intensities: Any = None,
) -> tuple[Capture, list[Finding]]:
    """Make a capture of arrays, and notes on it; as :func:`splitknit.pipeline.reconstruct_images`
    takes them.
    """
    with refusing("`images` must be one array, or arrays of one shape."):
        stack = np.asarray(images)
    shape = stack.shape
    kind = stack.dtype
    require(
        stack.size > 0 and (stack.ndim == 3 or (stack.ndim == 4 and shape[3] == 3)),
        f"`images` must have the shape (L, H, W) or (L, H, W, 3), but it has {shape}.",
    )
    sound = kind in (np.uint8, np.uint16) or kind.kind == "f"
    require(sound, f"`images` must be of uint8, uint16 or floats, but they are of {kind}.")
    finite = kind.kind != "f" or bool(np.isfinite(stack).all())
    require(finite, "`images` contains NaN or infinite values.")
    count = len(stack)
    stack = stack.reshape(*shape[:3], -1)
    brightness = None
    with refusing(
        "`lights` must be numbers of the shape (L, 3), `intensities` of (L,) or (L, 3), `px_per_mm`"
        " one."
    ):
        scale = None if px_per_mm is None else float(px_per_mm)
        if intensities is not None:
            brightness = np.asarray(intensities, dtype=np.float64).reshape(count, -1)
        vectors = np.asarray(lights, dtype=np.float64)
    check_value("`px_per_mm`", SCALES, scale)
    check_lights(vectors, count)
    rig = _distant_rig(vectors)
    colours = None
    if brightness is not None:
        positive = bool(np.isfinite(brightness).all()) and float(brightness.min()) > 0
        require(
            positive and brightness.shape[1] in (1, 3),
            "`intensities` must be positive, one for each light, or three (red, green, blue).",
        )
        rig = _as_bright(rig, brightness)
        colours = _colours_of(brightness) if stack.shape[3] == 3 else None
    notes: list[Finding] = []
    encoding = "linear"
    if kind == np.uint8:
        encoding = "srgb"
        rig = _of_assumed_encoding(rig)
        words = (
            "the encoding srgb was assumed of images of 8 bits; linear light is given as floats."
        )
        notes.append(Finding("assumed-encoding", words))
    if colours is not None:
        gains = _gains(colours)
        stack = np.stack([_evened(*each, encoding) for each in zip(stack, gains, strict=True)])
        encoding = "linear"
    if stack.dtype.kind == "f":
        stack, _, _ = _as_integers(stack, None, 0.0)
    band = _white_band(stack)
    check_contents([band])
    camera = camera_without_scale(shape[1:3]) if scale is None else Camera(scale, shape[1:3])
    inside = None if mask is None else check_mask(mask, shape[1:3])
    rig = replace(rig, camera=camera)
    return Capture(rig, {"white": band}, encoding, "opaque", mask=inside), notes


def _white_band(pixels: PixelArray, black: float = 0.0) -> Band:
    """The band of photographs (L, H, W, C) of one exposure, one for each light."""
    count = len(pixels)
    return Band(
        name="white",
        pixels=pixels,
        leds=tuple((k,) for k in range(count)),
        exposure=np.ones(count),
        black_level=np.full(count, black),
    )


def _assembled(
    files: Sequence[Path], crossed: Sequence[Path], lights: _Lights, photographs: GivenPhotographs
) -> tuple[Capture, list[Finding]]:
    """The capture, and notes on it."""
    rig = lights.rig
    count = len(files)
    require(count >= 3, f"at least three images are needed, but there are {count}.")
    different = _each_once([*files, *crossed])
    check_lights(rig.light_vectors())
    rig, encoding, notes = _encoding(different, rig, photographs)
    first = read_photo(different[0])
    rows, columns, channels = first.pixels.shape
    gains = None
    if lights.colours is not None and len(different) > 1 and channels == 3:
        gains = _gains(lights.colours)
        others = (photographs.background, photographs.crossed, photographs.flat)
        require(
            all(value is None for value in others),
            "lights with a brightness for each colour go without `background`, `crossed`, `flat`.",
        )
    camera = _camera_of(rig.camera, (rows, columns), photographs.px_per_mm, lights.camera_mm)
    require(
        camera.scale_known or all(led.position_mm is None for led in rig.leds),
        "lights at places in mm need the scale of the photographs; give `px_per_mm`, or directions"
        " of the lights.",
    )
    pixels, inside, hashes = _read_stack(different, first, encoding, gains)
    if gains is not None and first.pixels.dtype.kind == "u":
        encoding = "linear"
    if len(pixels) == 1:  # three coloured lights at once: one channel for each
        require(
            channels == 3,
            f"{different[0]} is grey; one photograph under three lights at once must be in colour.",
        )
        pixels = np.ascontiguousarray(np.moveaxis(pixels[0], -1, 0)[..., None])
    check = partial(size_check, (rows, columns), str(different[0]))
    ambient, black = _without_light(photographs, first, check, hashes)
    if pixels.dtype.kind == "f":
        pixels, ambient, black = _as_integers(pixels, ambient, black)
    inside, of_mask = _mask_of(photographs.mask, inside, (rows, columns), check, hashes)
    notes += of_mask
    series = [pixels]
    if crossed:
        series = [chosen(pixels, range(count)), chosen(pixels, range(count, 2 * count))]
    band = replace(
        _white_band(series[0], black),
        ambient=None if ambient is None else Ambient(ambient),
        files=tuple(map(str, files)),
    )
    if photographs.flat is not None:
        light, of_flat = read_flat(Path(photographs.flat), count, encoding)
        hashes |= of_flat
        band = replace(band, flat=stored_values(light, encoding))
    bands = {"white": band}
    if crossed:
        second = replace(band, pixels=series[1], files=tuple(map(str, crossed)))
        bands = {
            "white": replace(band, polarisation="parallel"),
            "white_crossed": replace(second, name="white_crossed", polarisation="crossed"),
        }
        notes += _findings_on_brightness(*series)
    check_contents(bands.values())
    if first.orientation != 1:
        words = (
            f"photographs are turned as their EXIF data say (orientation {first.orientation});"
            " lights are for them upright."
        )
        notes.append(Finding("turned-photographs", words))
    material = "opaque" if photographs.nir is None else "skin"  # by near-infrared light a finger
    capture = Capture(
        rig=replace(rig, camera=camera),
        bands=bands,
        encoding=encoding,
        material=photographs.material or material,
        tip_direction_deg=photographs.tip_direction_deg,
        mask=inside,
        hashes=hashes,
    )
    return capture, notes


def _findings_on_brightness(parallel: PixelArray, crossed: PixelArray) -> list[Finding]:
    """A note where the crossed series is as bright as the parallel one."""
    means = [
        np.mean([image[::8, ::8].mean(dtype=np.float64) for image in series])
        for series in (parallel, crossed)
    ]
    return [Finding("not-specular", NOT_SPECULAR)] if means[1] >= means[0] else []


def _mask_of(
    mask: AnyPath | None,
    opaque: BoolArray | None,
    size: tuple[int, int],
    check: Callable[[str], SizeCheck],
    hashes: dict[str, str],
) -> tuple[BoolArray | None, list[Finding]]:
    """Mask (H, W) of a file, whose SHA-256 joins the others, of the word ``all``, or what is
    `opaque` in the photographs; and a note where it was found in a picture's transparency."""
    if mask is not None and os.fspath(mask) == _MASK_ALL:
        return np.ones(size, dtype=np.bool_), []
    name = "the photographs"
    transparent = opaque is not None
    if mask is not None:
        name = os.fspath(mask)
        photo = read_photo(mask, check(name))
        hashes[Path(mask).name] = photo.sha256
        opaque = mask_of_photo(photo, name)
        transparent = photo.opaque is not None
    require(opaque is None or opaque.any(), f"{name} are transparent everywhere; give a `mask`.")
    words = f"the mask is what is not transparent in {name}."
    return opaque, [Finding("assumed-mask", words)] if transparent else []


def _without_light(
    photographs: GivenPhotographs,
    first: Photo,
    check: Callable[[str], SizeCheck],
    hashes: dict[str, str],
) -> tuple[NDArray[Any] | None, float]:
    """The background's photograph, whose SHA-256 joins the others, or its value."""
    if photographs.background is None:
        return None, 0.0
    kind = first.pixels.dtype
    if photographs.background_image is None:
        value = float(photographs.background)  # type: ignore[arg-type]
        if kind.kind == "u":
            top = int(np.iinfo(kind).max)
            require(
                0 <= value < top,
                f"the background must lie between 0 and {top}, but it is {value:g}.",
            )
        return None, value
    file = os.fspath(photographs.background_image)
    photo = read_photo(file, check(file))
    require(
        photo.pixels.dtype.kind == kind.kind,
        "the background image is of floats and the photographs are not, or the reverse; save both"
        " in one format.",
    )
    hashes[Path(file).name] = photo.sha256
    return photo.pixels, 0.0


def _each_once(files: Sequence[Path]) -> Sequence[Path]:
    """The files; the one file of three coloured lights once. BadInput if others are named twice."""
    if len(set(files)) == 1:
        return files[:1]
    places: set[str] = set()
    for file in files:
        place = os.path.realpath(file)  # unlike resolve(), which raises where links form a circle
        require(place not in places, f"{file} is named twice; name each photograph once.")
        places.add(place)
    return files


def _encoding(
    files: Sequence[Path], rig: Rig, photographs: GivenPhotographs
) -> tuple[Rig, str, list[Finding]]:
    """The encoding that is stated, or by :func:`splitknit.io.photos.encoding_of`; and notes. What
    is calibrated by `flat` is an industrial camera's, and linear."""
    stated = photographs.encoding
    raw = next((file.name for file in files if file.suffix.lower() in RAW_SUFFIXES), None)
    require(raw is None or stated != "srgb", f"{raw} is camera RAW, whose light is linear.")
    if stated is not None:
        return rig, stated, []
    encoding, note = encoding_of(files, "srgb" if photographs.flat is None else "linear")
    if encoding == "srgb" and not stated_encoding(files[0]):
        rig = _of_assumed_encoding(rig)
    return rig, encoding, [Finding("assumed-encoding", note)]


def _of_assumed_encoding(rig: Rig) -> Rig:
    """The rig, marked so that the photographs' shading may decide how they are stored."""
    return replace(rig, provenance={**rig.provenance, "encoding": "assumed"})


def _gains(colours: Array) -> FloatArray:
    """Factors that bring lights with these `colours` (L, 3) to one, 1 at most."""
    return np.asarray(colours.min() / colours, dtype=np.float32)


def _evened(image: NDArray[Any], gains: FloatArray, encoding: str) -> NDArray[Any]:
    """A photograph (H, W, C) times `gains`: integers as 16 bits of linear light, clipping kept;
    floats as they are."""
    if image.dtype.kind == "f":
        return image * gains
    light = linear_image(image, encoding)
    clipped = light > 1 - 1e-5
    return np.where(clipped, 65535, np.rint(65535.0 * light * gains)).astype(np.uint16)


def _read_stack(
    files: Sequence[Path], first: Photo, encoding: str, gains: FloatArray | None
) -> tuple[NDArray[Any], BoolArray | None, dict[str, str]]:
    """Read all photographs (L, H, W, C), times the `gains` of their colours; what is transparent in
    none (H, W), None where all is opaque; and their SHA-256. `first`: that of the first file."""
    size = (first.pixels.shape[0], first.pixels.shape[1])
    shape = (len(files), *first.pixels.shape)
    dtype = first.pixels.dtype
    if gains is not None and dtype.kind == "u":
        dtype = np.dtype(np.uint16)
    require(
        math.prod(shape) * dtype.itemsize <= STACK_BYTES,
        f"{files[0]} and the photographs with it take more than {STACK_BYTES / 1e9:g} GB"
        "; name fewer, or make them smaller.",
    )
    stack = new_stack(shape, dtype)
    opaque = None
    hashes: dict[str, str] = {}
    for k, file in enumerate(files):
        photo = first
        if k > 0:
            photo = read_photo(file, size_check(size, str(files[0]), str(file)))
        require(
            photo.orientation == first.orientation,
            f"{file} is turned differently by its EXIF data (orientation {photo.orientation}) than "
            f"{files[0].name} ({first.orientation}), as a telephone that looks straight down"
            " guesses it; give all one orientation.",
        )
        kinds = [_kind(photo.pixels), _kind(first.pixels)]
        words = f"{file} is {kinds[0]}, but {files[0]} is {kinds[1]}; all must agree."
        require(kinds[0] == kinds[1], words)
        stack[k] = photo.pixels if gains is None else _evened(photo.pixels, gains[k], encoding)
        if photo.opaque is not None:
            opaque = photo.opaque if opaque is None else opaque & photo.opaque
        name = file.name if file.name not in hashes else f"{file.parent.name}/{file.name}"
        hashes[name] = photo.sha256
    return stack, opaque, hashes


def _kind(pixels: NDArray[Any]) -> str:
    return f"{'RGB' if pixels.shape[2] == 3 else 'grey'} of {pixels.dtype}"


def read_flat(folder: Path, count: int, encoding: str) -> tuple[FloatArray, dict[str, str]]:
    """Photographs of a flat surface (L, h, w) on the coarse grid, linear light with its black
    level; and SHA-256s. One colour photograph serves three lights. Raises BadInput if they are
    missing, not `count`, or black in places.
    """
    require(
        folder.is_dir(),
        f"{folder} is not a folder; name the folder of the flat photographs with `flat`.",
    )
    files = photographs_in(folder, folder / "lights.txt").photographs
    light = []
    hashes = {}
    for file in files:
        photo = read_photo(file)
        integers = photo.pixels.dtype.kind == "u"
        require(integers, f"{file} holds floats; save it as 16-bit PNG or TIFF.")
        image = linear_image(photo.pixels, encoding)
        coloured = len(files) == 1 < count and image.shape[2] == 3
        channels = np.moveaxis(image, 2, 0) if coloured else [pick_channel(image, "grey")]
        for channel in channels:
            light.append(naming(file, partial(coarse_flat, np.ascontiguousarray(channel))))
        hashes[f"{folder.name}/{file.name}"] = photo.sha256
    require(
        len(light) == count,
        f"{folder} holds {len(files)} flat photographs, but there are {count} lights"
        "; give one for each, in the order of their names.",
    )
    require(
        len({image.shape for image in light}) == 1,
        f"the flat photographs in {folder} differ in size; take all with the camera as it stands.",
    )
    return np.stack(light), hashes


def _camera_of(
    camera: Camera, size: tuple[int, int], px_per_mm: float | None, centre_mm: Point | None
) -> Camera:
    """The rig's camera, or one of the stated scale, with parallel rays or with rays through a
    `centre_mm`, for photographs of `size`."""
    stated = None if px_per_mm is None else float(px_per_mm)
    if camera is _NO_CAMERA:
        if stated is None:
            return camera_without_scale(size)
        parallel = Camera(stated, size)
        return parallel if centre_mm is None else _looking_down(parallel, centre_mm)
    rows, columns = camera.image_size
    require(
        (rows, columns) == size,
        f"the rig's camera takes images of {rows} x {columns} pixels (rows x columns), but the "
        f"photographs have {size[0]} x {size[1]}; give `lights` a list of lights instead.",
    )
    require(
        stated is None or not camera.scale_known,
        f"`px_per_mm` and the rig file ({camera.px_per_mm:g} px/mm) both give the scale; leave out"
        " the first.",
    )
    return camera if stated is None else replace(camera, px_per_mm=stated, scale_known=True)


def _looking_down(camera: Camera, centre_mm: Point) -> Camera:
    """The camera with rays through a centre, x and y of which are from the picture's middle."""
    x, y, height = centre_mm
    rows, columns = camera.image_size
    scale = camera.px_per_mm
    column, row = (columns - 1) / 2 + scale * x, (rows - 1) / 2 - scale * y
    matrix = np.array([[scale * height, 0, column], [0, scale * height, row], [0, 0, 1]])
    return replace(camera, model="perspective", height_mm=height, matrix=matrix)


def _as_integers(
    stack: NDArray[Any], ambient: NDArray[Any] | None, black: float
) -> tuple[PixelArray, PixelArray | None, float]:
    """Photographs of floats as 16-bit integers, with their ambient image and black level."""
    top = float(max(map(np.max, stack)))
    require(top > 0, "the photographs are black: not one value is above zero.")
    require(
        0.0 <= black < top,
        f"the background must lie between 0 and {top:g}, but it is {black:g}.",
    )
    # more than noise
    below = float(np.mean([np.mean(image < -0.02 * top) for image in stack]))
    require(
        below < 0.02,
        f"{100 * below:.0f} % of the photographs' values are negative: subtract less from them.",
    )
    factor = 0.9 * 65535.0 / top

    def scaled(values: NDArray[Any]) -> NDArray[np.uint16]:
        return np.clip(np.rint(values * factor), 0, 65535).astype(np.uint16)

    dark = None if ambient is None else scaled(ambient)
    return np.stack([scaled(image) for image in stack]), dark, black * factor
