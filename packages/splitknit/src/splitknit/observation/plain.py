"""Other people's data: photographs and a list of light directions become a capture."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
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
from splitknit.imaging.pixels import block_means, pick_channel
from splitknit.io.content import check_contents, mask_from_image
from splitknit.io.images import STACK_BYTES, SizeCheck
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
from splitknit.observation.films import NOT_SPECULAR, split_mosaic
from splitknit.observation.stored import coarse_flat, decode_table, linear_image, stored_values
from splitknit.reconstruction import UNKNOWN_SCALE
from splitknit.settings import check_value

_NO_CAMERA = Camera(1.0, (1, 1))
"""Stands for a camera that is not known. Source: definition."""
_MASK_ALL = "all"  # in place of a mask: the object fills the photographs


@dataclass(frozen=True, slots=True, eq=False)
class Photographs:
    """Photographs as a capture, and what is to be known about how they became one."""

    capture: Capture
    notes: tuple[Finding, ...]
    """What was assumed or done."""


@dataclass(frozen=True, slots=True, eq=False)
class _Lights:
    """What is known of the lights."""

    source: Path  # their file, or a word for messages
    rig: Rig
    names: tuple[str, ...] = ()  # of photographs, in their file
    colours: Array | None = None  # (L, 3) relative brightness of red, green and blue
    camera_mm: Point | None = None  # the camera's centre, as a list of places states it


def capture_from_photographs(photographs: GivenPhotographs) -> Photographs:
    """Make a capture of a folder of photographs, one for each light.

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
    white = Photographs(capture, (*assumed, *notes))
    return white if photographs.nir is None else _with_nir(white, photographs)


def _with_nir(white: Photographs, photographs: GivenPhotographs) -> Photographs:
    """One capture of both bands; the mask is that of the white photographs."""
    capture = white.capture
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
    encoding: Any = photographs.encoding
    if encoding is None and photographs.max_megapixels is None:
        encoding = capture.encoding
    lights = _of_band(rig, "nir", "the rig") if has_rig else None
    near = replace(
        photographs, images=folder, lights=lights, nir=None, crossed=None, flat=None, mask=None
    )
    infrared = capture_from_photographs(replace(near, encoding=encoding))
    kinds = [
        f"{each.shape[0]} x {each.shape[1]} pixels, {each.encoding}"
        for each in (infrared.capture, capture)
    ]
    require(
        kinds[0] == kinds[1],
        f"the photographs of {folder} are of {kinds[0]}, and the white ones of {kinds[1]}"
        "; both must agree (`encoding`).",
    )
    count = len(capture.rig.leds)
    leds = [replace(led, band="nir") for led in infrared.capture.rig.leds]
    both = replace(capture.rig, leds=(*capture.rig.leds, *leds))
    groups = tuple((count + k,) for k in range(len(leds)))
    band = replace(infrared.capture.bands["white"], name="nir", leds=groups)
    hashes = {f"nir/{name}": value for name, value in infrared.capture.hashes.items()}
    capture = replace(
        capture,
        rig=both,
        bands={**capture.bands, "nir": band},
        hashes={**capture.hashes, **hashes},
    )
    notes = [note if note in white.notes else note.of_band("nir") for note in infrared.notes]
    return Photographs(capture, tuple(dict.fromkeys([*white.notes, *notes])))


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
    different = _each_once([*files, *crossed], photographs)
    raw = next((file.name for file in different if file.suffix.lower() in RAW_SUFFIXES), None)
    linear = raw is None or photographs.encoding != "srgb"
    require(linear, f"{raw} is camera RAW, whose light is linear.")
    check_lights(rig.light_vectors())
    rig, encoding, notes = _encoding(files, rig, photographs)
    first = _series_of(different[0], photographs)
    form = _form_of(different[0], first[0], encoding, photographs.max_megapixels)
    if lights.colours is not None and len(different) > 1 and form.shape[2] == 3:
        form = replace(form, gains=_gains(lights.colours))
        others = (photographs.background, photographs.crossed, photographs.mosaic, photographs.flat)
        require(
            all(value is None for value in others),
            "lights with a brightness for each colour go without `background`, `crossed`,"
            " `mosaic`, `flat`.",
        )
    camera = _camera_of(rig.camera, form, photographs.px_per_mm, lights.camera_mm)
    require(
        camera.scale_known or all(led.position_mm is None for led in rig.leds),
        "lights at places in mm need the scale of the photographs; give `px_per_mm`, or directions"
        " of the lights.",
    )
    read = _read_stack(different, form, first, photographs)
    hashes = read.hashes
    pixels = read.pixels
    if len(pixels) == 1:  # three coloured lights at once: one channel for each
        require(
            pixels.shape[3] == 3,
            f"{form.name} is grey; one photograph under three lights at once must be in colour.",
        )
        pixels = np.ascontiguousarray(np.moveaxis(pixels[0], -1, 0)[..., None])
    ambient, black = _without_light(photographs, form, hashes)
    if form.dtype.kind == "f":
        pixels, ambient, black = _as_integers(pixels, ambient, black)
    inside, note = _mask_of(photographs.mask, form, read)
    notes += note
    flat = None
    if photographs.flat is not None:
        light, flat_hashes = read_flat(Path(photographs.flat), count, encoding)
        hashes |= flat_hashes
        flat = stored_values(light, form.encoding_after)
    band = replace(
        _white_band(chosen(pixels, range(count)), black),
        ambient=None if ambient is None else Ambient(ambient),
        flat=flat,
        files=tuple(map(str, files)),
    )
    bands = {"white": band}
    if len(pixels) > count:
        names = tuple(map(str, crossed or files))
        bands = _polarised(
            band, replace(band, pixels=chosen(pixels, range(count, 2 * count)), files=names)
        )
        means = [
            np.mean([image[::8, ::8].mean(dtype=np.float64) for image in each.pixels])
            for each in bands.values()
        ]
        notes += [Finding("not-specular", NOT_SPECULAR)] if means[1] >= means[0] else []
    check_contents(bands.values())
    notes += _notes_on(form, camera, first[0].orientation)
    material = "opaque" if photographs.nir is None else "skin"  # by near-infrared light a finger
    capture = Capture(
        rig=replace(rig, camera=camera),
        bands=bands,
        encoding=form.encoding_after,
        material=photographs.material or material,
        tip_direction_deg=photographs.tip_direction_deg,
        mask=inside,
        hashes=hashes,
    )
    return capture, notes


def _without_light(
    photographs: GivenPhotographs, form: _Form, hashes: dict[str, str]
) -> tuple[NDArray[Any] | None, float]:
    """The background's photograph, whose SHA-256 joins the others, or its value; once reduced."""
    if photographs.background is None:
        return None, 0.0
    if photographs.background_image is None:
        return None, form.level(float(photographs.background))  # type: ignore[arg-type]
    file = Path(photographs.background_image)
    photo = read_photo(file, form.check(file))
    require(
        photo.pixels.dtype.kind == form.dtype.kind,
        "the background image is of floats and the photographs are not, or the reverse; save both"
        " in one format.",
    )
    hashes[file.name] = photo.sha256
    return form.reduced(photo.pixels, file), 0.0


def _notes_on(form: _Form, camera: Camera, orientation: int) -> Iterator[Finding]:
    """What was done to the photographs."""
    if form.factor > 1:
        rows, columns = form.small
        yield Finding(
            "reduced-photographs",
            f"the photographs of {form.megapixels:.3g} megapixels were reduced to"
            f" {rows * columns / 1e6:.3g} (`max_megapixels`), by means over {form.factor:g} x"
            f" {form.factor:g} pixels.",
        )
    if not camera.scale_known:
        yield Finding("scale-unknown", UNKNOWN_SCALE)
    if orientation != 1:
        yield Finding(
            "turned-photographs",
            f"photographs are turned as their EXIF data say (orientation {orientation}); lights are"
            " for them upright.",
        )


def _polarised(parallel: Band, crossed: Band) -> dict[str, Band]:
    return {
        "white": replace(parallel, polarisation="parallel"),
        "white_crossed": replace(crossed, name="white_crossed", polarisation="crossed"),
    }


def _each_once(files: Sequence[Path], photographs: GivenPhotographs) -> Sequence[Path]:
    """The files; the one file of three coloured lights once. BadInput if others are named twice."""
    if len(set(files)) == 1:
        require(
            photographs.mosaic is None,
            f"{files[0]}, one photograph under three lights, goes without `mosaic`.",
        )
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
    if photographs.mosaic is not None:
        return rig, "linear", []
    if photographs.encoding is not None:
        return rig, photographs.encoding, []
    encoding, note = encoding_of(files, "srgb" if photographs.flat is None else "linear")
    if encoding == "srgb" and not stated_encoding(files[0]):
        rig = _of_assumed_encoding(rig)
    return rig, encoding, [Finding("assumed-encoding", note)]


def _of_assumed_encoding(rig: Rig) -> Rig:
    """The rig, marked so that the photographs' shading may decide how they are stored."""
    return replace(rig, provenance={**rig.provenance, "encoding": "assumed"})


def _check_like(
    shape: tuple[int, ...], like: Path, file: str | os.PathLike[str], rows: int, columns: int
) -> None:
    """Refuse a file of another size than `shape`, that of `like`."""
    require(
        (rows, columns) == shape[:2],
        f"{file} has {rows} x {columns} pixels (rows x columns), but {shape[0]} x {shape[1]} are"
        f" expected by {like}.",
    )


@dataclass(frozen=True, slots=True)
class _Form:
    """What photographs must agree in, and how they are reduced."""

    name: Path  # of the first
    shape: tuple[int, ...]  # (H, W, C)
    dtype: np.dtype[Any]
    encoding: str
    factor: float  # pixels a side that become one
    gains: FloatArray | None = None  # (L, 3) of colours that lights have more of than others

    @property
    def small(self) -> tuple[int, int]:
        """Rows, columns once reduced."""
        return int(self.shape[0] // self.factor), int(self.shape[1] // self.factor)

    @property
    def megapixels(self) -> float:
        return self.shape[0] * self.shape[1] / 1e6

    @property
    def as_stored(self) -> bool:
        """Whether photographs are kept as they are."""
        return self.factor == 1 and self.gains is None

    @property
    def encoding_after(self) -> str:
        means = self.dtype.kind == "f" and self.gains is None
        return self.encoding if self.as_stored or means else "linear"

    def level(self, stored: float) -> float:
        """A stored value once reduced."""
        if self.dtype.kind == "f":
            return stored
        table = decode_table(self.dtype, self.encoding)
        top = table.size - 1
        require(
            0 <= stored < top,
            f"the background must lie between 0 and {top}, but it is {stored:g}.",
        )
        if self.as_stored:
            return stored
        return 65535.0 * float(np.interp(stored, np.arange(table.size), table))

    def check(self, file: str | os.PathLike[str]) -> SizeCheck:
        """What raises BadInput for another size of the photograph, or of a mask."""
        return partial(_check_like, self.shape, self.name, file)

    def reduced(self, pixels: NDArray[Any], file: Path, k: int | None = None) -> NDArray[Any]:
        """Pixels (H, W, C) of photograph `k`, or of a mask or background, once reduced."""
        self.check(file)(*pixels.shape[:2])
        if self.as_stored:
            return pixels
        gains = 1.0 if k is None or self.gains is None else self.gains[k]
        return _evened(pixels, gains, self.encoding, self.factor)


def _gains(colours: Array) -> FloatArray:
    """Factors that bring lights with these `colours` (L, 3) to one, 1 at most."""
    return np.asarray(colours.min() / colours, dtype=np.float32)


def _evened(
    image: NDArray[Any], gains: FloatArray | float, encoding: str, factor: float = 1.0
) -> NDArray[Any]:
    """Means of a photograph (H, W, C) over blocks, times `gains`: integers as 16 bits of linear
    light, clipping kept; floats as they are."""
    if image.dtype.kind == "f":
        shape = int(image.shape[0] // factor), int(image.shape[1] // factor)
        return np.asarray(block_means(image, shape, factor).reshape(*shape, -1) * gains)
    light = linear_image(image, encoding, binning=factor)
    clipped = light > 1 - 1e-5
    return np.where(clipped, 65535, np.rint(65535.0 * light * gains)).astype(np.uint16)


def _form_of(file: Path, photo: Photo, encoding: str, max_megapixels: float | None) -> _Form:
    """The form of the first photograph; sides become smaller by eighths, as
    :func:`splitknit.observation.stored.linear_image` takes them.
    """
    form = _Form(file, photo.pixels.shape, photo.pixels.dtype, encoding, 1.0)
    if max_megapixels is None:
        return form
    factor = math.ceil(8.0 * math.sqrt(form.megapixels / max_megapixels)) / 8.0
    form = replace(form, factor=max(1.0, factor))
    large = form.factor == 1 or min(form.small) >= 16
    require(large, "`max_megapixels` leaves less than 16 pixels a side; give more.")
    return form


def _series_of(
    file: Path, photographs: GivenPhotographs, check: SizeCheck | None = None
) -> list[Photo]:
    """The photograph of a file; of a mosaic the parallel and the crossed one, with half the pixels
    a side."""
    if photographs.mosaic is None:
        return [read_photo(file, check)]
    photo = read_photo(file)
    colour = photographs.mosaic == "colour"
    split = partial(split_mosaic, photo.pixels, photographs.film_deg, colour=colour)
    return [replace(photo, pixels=half, opaque=None) for half in naming(file, split)]


@dataclass(frozen=True, slots=True, eq=False)
class _Stack:
    """Photographs as they were read."""

    pixels: NDArray[Any]  # (L, h, w, C); of mosaics the crossed ones behind the parallel ones
    first: Photo
    opaque: BoolArray | None  # (H, W) what is transparent in none; None where all is opaque
    hashes: dict[str, str]


def _read_stack(
    files: Sequence[Path], form: _Form, first: list[Photo], photographs: GivenPhotographs
) -> _Stack:
    """Read all photographs; `first`: those of the first file."""
    like = form.reduced(first[0].pixels, files[0], 0)
    shape = (len(first) * len(files), *like.shape)
    require(
        math.prod(shape) * like.itemsize <= STACK_BYTES,
        f"{files[0]} and the photographs with it take more than {STACK_BYTES / 1e9:g} GB"
        "; name fewer, or reduce them by `max_megapixels`.",
    )
    stack = new_stack(shape, like.dtype)
    opaque = None
    hashes: dict[str, str] = {}
    turn = first[0].orientation
    for k, file in enumerate(files):
        series = _series_of(file, photographs, form.check(file)) if k else first
        photo = series[0]
        require(
            photo.orientation == turn,
            f"{file} is turned differently by its EXIF data (orientation {photo.orientation}) than "
            f"{files[0].name} ({turn}), as a telephone that looks straight down guesses it; give "
            "all one orientation.",
        )
        for part, each in enumerate(series):
            pixels = form.reduced(each.pixels, file, k)
            kinds = [_kind(each.pixels), _kind(first[0].pixels)]
            words = f"{file} is {kinds[0]}, but {files[0]} is {kinds[1]}; all must agree."
            require(kinds[0] == kinds[1], words)
            stack[k + part * len(files)] = pixels
        if photo.opaque is not None:
            opaque = photo.opaque if opaque is None else opaque & photo.opaque
        name = file.name if file.name not in hashes else f"{file.parent.name}/{file.name}"
        hashes[name] = photo.sha256
    return _Stack(stack, first[0], opaque, hashes)


def _kind(pixels: NDArray[Any]) -> str:
    return f"{'RGB' if pixels.shape[2] == 3 else 'grey'} of {pixels.dtype}"


def _mask_of(
    mask: AnyPath | None, form: _Form, read: _Stack
) -> tuple[BoolArray | None, list[Finding]]:
    """Mask (h, w) of a file, of the word ``all``, or of the photographs' own transparency, None
    without any; and a note where it was found in a picture. The file's SHA-256 joins the others.
    """
    if mask is not None and os.fspath(mask) == _MASK_ALL:
        return np.ones(form.small, dtype=np.bool_), []
    if mask is None:
        if read.opaque is None:
            return None, []
        name = "the photographs"
        photo = replace(read.first, opaque=read.opaque)
    else:
        name = os.fspath(mask)
        photo = read_photo(mask, form.check(mask))
        read.hashes[Path(mask).name] = photo.sha256
    pixels = photo.pixels
    notes = []
    if photo.opaque is not None:
        pixels = _black_and_white(photo.opaque)
        words = f"the mask is what is not transparent in {name}."
        notes = [Finding("assumed-mask", words)]
    elif pixels.dtype.kind == "f":
        pixels = np.rint(255.0 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8)
    white = _black_and_white(mask_from_image(pixels, name))
    return mask_from_image(form.reduced(white, Path(name)), name), notes


def _black_and_white(mask: BoolArray) -> NDArray[np.uint8]:
    """A mask as an image (H, W, 1)."""
    return mask[..., None].astype(np.uint8) * np.uint8(255)


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
    camera: Camera, form: _Form, px_per_mm: float | None, centre_mm: Point | None
) -> Camera:
    """The rig's camera, or one of the stated scale, with parallel rays or with rays through a
    `centre_mm`, for the photographs once reduced."""
    factor = form.factor
    stated = None if px_per_mm is None else float(px_per_mm)
    if camera is _NO_CAMERA:
        if stated is None:
            return camera_without_scale(form.small)
        parallel = Camera(stated / factor, form.small)
        return parallel if centre_mm is None else _looking_down(parallel, centre_mm)
    rows, columns = camera.image_size
    require(
        (rows, columns) == form.shape[:2],
        f"the rig's camera takes images of {rows} x {columns} pixels (rows x columns), but the "
        f"photographs have {form.shape[0]} x {form.shape[1]}; give `lights` a list of lights "
        "instead.",
    )
    require(
        stated is None or not camera.scale_known,
        f"`px_per_mm` and the rig file ({camera.px_per_mm:g} px/mm) both give the scale; leave out"
        " the first.",
    )
    if stated is None and not camera.scale_known:
        return camera_without_scale(form.small)
    matrix = camera.matrix
    if matrix is not None and factor > 1:
        middle = 0.5 - factor / 2  # the middle of the first pixel is 0
        matrix = np.array([[1, 0, middle], [0, 1, middle], [0, 0, factor]]) @ matrix / factor
    scale = (camera.px_per_mm if stated is None else stated) / factor
    return replace(camera, image_size=form.small, px_per_mm=scale, scale_known=True, matrix=matrix)


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
