"""Capture folders, format ``splitknit-capture`` version 1: read with every check, written whole or
not at all."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import shutil
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from splitknit.capture import Ambient, Band, Capture, spectral_band
from splitknit.checks import check_lights, check_mask
from splitknit.errors import BadInput, naming, require
from splitknit.imaging.pixels import coarse_grid
from splitknit.io.atomic import atomic_folder
from splitknit.io.content import check_contents, image_name, mask_from_image
from splitknit.io.fields import Version1, inside, read_document
from splitknit.io.images import cores, encode_image, read_image, read_stacks
from splitknit.io.npz import write_npz
from splitknit.io.provenance import JsonValue, file_hash, plain_json
from splitknit.io.rig import read_rig, rig_to_json
from splitknit.model import PixelArray, Rig

CAPTURE_FORMAT, CAPTURE_VERSION = "splitknit-capture", 1
BANDS = ("white", "white_crossed", "nir")
_Index = Annotated[int, Meta(ge=0, lt=1 << 31)]


class _Image(Struct):
    """An image: its file, and how it was exposed where the document states it."""

    file: str
    exposure_s: Annotated[float, Meta(ge=1e-9, le=1e6)] | None = None
    gain: Annotated[float, Meta(ge=1e-6, le=1e6)] | None = None
    black_level: Annotated[float, Meta(ge=0, le=65535)] | None = None

    @property
    def exposure(self) -> float | None:
        """Exposure time times gain, None where neither is stated."""
        if self.exposure_s is None and self.gain is None:
            return None
        return (1.0 if self.exposure_s is None else self.exposure_s) * (
            1.0 if self.gain is None else self.gain
        )


class _BandFields(Struct):
    images: Annotated[list[str | _Image], Meta(min_length=1, max_length=1000)]
    leds: list[_Index | Annotated[tuple[_Index, ...], Meta(min_length=1, max_length=10_000)]]
    ambient: str | _Image | None = None
    flat: list[str] | None = None
    polarisation: Annotated[str, Meta(pattern="^(parallel|crossed|)$")] = ""

    @property
    def dark(self) -> _Image | None:
        """The ambient image."""
        return _Image(self.ambient) if isinstance(self.ambient, str) else self.ambient


class _BandsFields(Struct, forbid_unknown_fields=True):
    white: _BandFields
    white_crossed: _BandFields | None = None
    nir: _BandFields | None = None


class _CaptureFields(Struct):
    format: Annotated[str, Meta(pattern="^(splitknit-capture)$")]
    version: Version1
    rig: str
    bands: _BandsFields
    encoding: Annotated[str, Meta(pattern="^(linear|srgb)$")] = "linear"
    material: Annotated[str, Meta(pattern="^(skin|opaque)$")] = "skin"
    tip_direction_deg: Annotated[float, Meta(ge=-360, le=360)] | None = None
    mask: str | None = None
    truth: str | None = None
    subject: dict[str, Any] | None = None
    captured_at: str | None = None
    sha256: dict[str, str] = {}


def _stated_bands(bands: _BandsFields, folder: Path, rig: Rig, name: str) -> dict[str, Band]:
    """The bands as the document describes them, without pixels; their files are relative to the
    folder, and lie inside it."""
    stated: dict[str, Band] = {}
    places: set[Path] = set()
    for key in BANDS:
        fields = getattr(bands, key)
        if fields is None:
            continue
        stated[key] = _stated_band(fields, folder, rig, key, name)
        for image in stated[key].files:
            # a file takes memory each time that it is named, by whatever spelling
            place = (folder / image).resolve()
            require(place not in places, f"{name}: bands.{key}.images names {image!a} twice.")
            places.add(place)
    if bands.white_crossed is not None:
        _check_pair(stated["white"], stated["white_crossed"], name, rig)
        require(
            _exposed(bands.white) == _exposed(bands.white_crossed),
            f"{name}: bands.white and bands.white_crossed must state exposure_s for every image,"
            " both or neither (then it is the same).",
        )
    return stated


def _exposed(band: _BandFields) -> bool:
    """Whether the document states all exposures."""
    return all(isinstance(image, _Image) and image.exposure is not None for image in band.images)


def _check_pair(parallel: Band, crossed: Band, name: str, rig: Rig) -> None:
    """Refuse two polarised series that are not the same photographs through another film."""
    require(
        (parallel.polarisation, crossed.polarisation) == ("parallel", "crossed"),
        f"{name}: beside bands.white_crossed, "
        'bands.white must say "polarisation": "parallel" and bands.white_crossed "crossed".',
    )
    require(
        len(parallel.leds) == len(crossed.leds),
        f"{name}: bands.white has {len(parallel.leds)} images but bands.white_crossed"
        f" {len(crossed.leds)}; both series need one image a light, in the same order.",
    )
    white = not any(rig.colours_of(band.leds) for band in (parallel, crossed))
    require(white, f"{name}: polarised series are lit by white LEDs, but the rig's are coloured.")
    own, others = (rig.select(band.leds).light_vectors() for band in (parallel, crossed))
    near = others @ (own / np.linalg.norm(own, axis=1, keepdims=True)).T
    near /= np.linalg.norm(others, axis=1, keepdims=True)
    # difference of cosines below which a light is equally near to two others
    same = np.diag(near) >= near.max(axis=1) - 0.01
    require(
        same.all(),
        f"{name}: image {np.argmin(same)} of bands.white_crossed is lit from another side than that"
        " of bands.white; list both series in the same order of lights.",
    )


def _stated_band(fields: _BandFields, folder: Path, rig: Rig, key: str, name: str) -> Band:
    where = f"{name}: bands.{key}"
    images = [_Image(image) if isinstance(image, str) else image for image in fields.images]
    count = len(images)
    own = [led for led in rig.leds if led.band == spectral_band(key)]
    enough = count >= 3 or any(led.colour for led in own)
    require(enough, f"{where}.images names {count} images, but at least three are needed.")
    leds = tuple((group,) if isinstance(group, int) else group for group in fields.leds)
    require(
        len(leds) == count,
        f"{where} has {count} images but {len(leds)} entries in leds; name the LEDs of every"
        " image.",
    )
    _check_leds(rig, spectral_band(key), leds, f"{where}.leds")
    flat = fields.flat or []
    require(
        len(flat) in (0, count),
        f"{where}.flat names {len(flat)} images; it needs one for each of the {count}.",
    )
    for list_name, files in (("images", [image.file for image in images]), ("flat", flat)):
        for k, file in enumerate(files):
            inside(folder, file, name, f"bands.{key}.{list_name}[{k}]")
    exposures = [image.exposure for image in images]
    levels = [image.black_level for image in images]
    dark, ambient = fields.dark, None
    nothing = np.empty((0, 0, 0, 0), np.uint8)
    if dark is not None:
        inside(folder, dark.file, name, f"bands.{key}.ambient")
        exposure = _of_ambient(dark.exposure, exposures, f"{where}.ambient", "exposure_s")
        level = _of_ambient(dark.black_level, levels, f"{where}.ambient", "black_level")
        ambient = Ambient(nothing, 1.0 if exposure is None else exposure, level or 0.0)
    return Band(
        key,
        nothing,
        leds,
        exposure=np.array([1.0 if value is None else value for value in exposures]),
        black_level=np.array([0.0 if value is None else value for value in levels]),
        ambient=ambient,
        files=tuple(image.file for image in images),
        polarisation=fields.polarisation,
    )


def _of_ambient(
    own: float | None, images: Sequence[float | None], where: str, key: str
) -> float | None:
    """The ambient image's `own`, else what all images of the band have."""
    if own is not None or None in images:
        return own
    require(
        len(set(images)) == 1,
        f'{where} needs its own {key}, as the images of the band differ in theirs: {{"file": ...,'
        f' "{key}": ...}}.',
    )
    return images[0]


def _check_leds(rig: Rig, band: str, leds: tuple[tuple[int, ...], ...], where: str) -> None:
    """Refuse LEDs (of every image) that are not in the rig, are of another band, or do not
    determine a normal."""
    naming(where, lambda: rig.select(leds))
    for k, group in enumerate(leds):
        require(len(set(group)) == len(group), f"{where}[{k}] names an LED twice.")
        for index in group:
            own = rig.leds[index].band
            require(
                own == band,
                f"{where}[{k}] names LED {index}, which is a '{own}' LED in the rig, not '{band}'"
                "; correct the list or the rig.",
            )
    for k, names in enumerate(rig.colours_of(leds)):
        require(
            all(names) or not any(names),
            f"{where}[{k}] names coloured and white LEDs for one exposure, which cannot be"
            " separated; use one kind.",
        )
    lights = rig.lights_of(leds)
    naming(where, lambda: check_lights(rig.select(lights).light_vectors(), len(lights)))


def read_capture(
    path: str | os.PathLike[str], *, may_be_dark: bool = False, threads: int = 0
) -> Capture:
    """Read a capture folder.

    Parameters
    ----------
    path : the folder, or the ``capture.json`` in it
    may_be_dark : take images that are nearly black, such as those of a black ball
    threads : that decode images; 0: one for each core, at most eight

    Returns
    -------
    Capture
        Pixels as stored, (L, H, W, C) integers per band; what takes much memory is read photograph
        by photograph (:class:`splitknit.io.paging.PagedStack`).

    Raises
    ------
    BadInput
        With one sentence that names the file and the remedy: missing, truncated or damaged files,
        images that differ in size from each other or from the rig's camera, black or overexposed
        images, too few images, LEDs that are missing, of the wrong band, coplanar or duplicate,
        broken JSON, and paths that leave the folder.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.read_capture("demo/capture").rig.camera.px_per_mm  # doctest: +SKIP
    """
    document = _document(path)
    folder = document.parent
    name = str(document)
    fields, _ = read_document(document, _CaptureFields)
    rig_file = inside(folder, fields.rig, name, "rig")
    rig = read_rig(rig_file)
    truth = None if fields.truth is None else inside(folder, fields.truth, name, "truth")
    require(
        truth is None or truth.is_file(),
        f"{truth}, the truth that {name} names, does not exist; add it or remove the field.",
    )
    mask_file = None if fields.mask is None else inside(folder, fields.mask, name, "mask")
    stated = _stated_bands(fields.bands, folder, rig, name)
    size = rig.camera.image_size
    rig_name = f"{rig_file} (is the rig for another camera?)"
    groups: dict[str, Sequence[Path]] = {}
    for key, band in stated.items():
        groups[key] = [folder / file for file in band.files]
        dark = getattr(fields.bands, key).dark
        if dark is not None:
            groups[f"dark {key}"] = [folder / dark.file]
    if mask_file is not None:
        groups["mask"] = [mask_file]
    stacks, hashes = read_stacks(groups, size, rig_name, threads)
    bands: dict[str, Band] = {}
    others = [document, rig_file]
    for key, band in stated.items():
        full = int(np.iinfo(stacks[key].dtype).max)
        for image, black in zip(band.files, band.black_level, strict=True):
            require(
                black < full,
                f"{image} has the black level {black:g}, but its full scale is {full}.",
            )
        read = replace(band, pixels=stacks[key])
        if band.ambient is not None:
            pixels = stacks[f"dark {key}"][0]
            read = replace(read, ambient=replace(band.ambient, pixels=pixels))
        flat = [folder / file for file in getattr(fields.bands, key).flat or []]
        if flat:
            read = replace(read, flat=np.stack(list(map(_flat_image, flat))))
            others += flat
        _check_colours(rig, read)
        bands[key] = read
    if not may_be_dark:
        check_contents(bands.values())
    hashes |= {str(file): file_hash(file) for file in others}
    for file, stated_hash in fields.sha256.items():
        require(
            hashes.get(str(folder / file)) == stated_hash,
            f"{folder / file} is damaged or was changed: it is not the file that {name} states;"
            " copy it again, or take its hash out there.",
        )
    return Capture(
        rig,
        bands,
        encoding=fields.encoding,
        material=fields.material,
        tip_direction_deg=fields.tip_direction_deg,
        mask=None if mask_file is None else mask_from_image(stacks["mask"][0], str(mask_file)),
        subject=fields.subject or {},
        captured_at=fields.captured_at,
        truth=truth,
        hashes={Path(file).relative_to(folder).as_posix(): hashes[file] for file in sorted(hashes)},
    )


def _flat_image(file: Path) -> NDArray[np.uint16]:
    """A photograph of a flat surface on the coarse grid, as stored."""
    pixels = read_image(file)
    scale = 65535.0 / float(np.iinfo(pixels.dtype).max)
    return np.asarray(
        np.rint(scale * coarse_grid(pixels.mean(axis=2, dtype=np.float32))), dtype=np.uint16
    )


def with_rig(capture: Capture, path: str | os.PathLike[str]) -> Capture:
    """The capture as taken by another file's rig, such as a later calibration of it. Raises
    BadInput if the file is not a rig's, its camera has another image size, or it lacks LEDs or has
    other bands.
    """
    rig = read_rig(path)
    name = os.fspath(path)
    rows, columns = capture.shape
    own = rig.camera.image_size
    require(
        own == capture.shape,
        f"{name} is the rig of another camera: its images have {own[0]} x {own[1]} pixels (rows x"
        f" columns), the capture's have {rows} x {columns}.",
    )
    for band in capture.bands.values():
        _check_leds(rig, band.spectral, band.leds, f"{name}: the capture's bands.{band.name}.leds")
        _check_colours(rig, band)
    if "white_crossed" in capture.bands:
        _check_pair(capture.bands["white"], capture.bands["white_crossed"], name, rig)
    hashes = {**capture.hashes, f"replaced rig: {Path(path).name}": file_hash(path)}
    return replace(capture, rig=rig, hashes=hashes)


def write_capture(
    capture: Capture,
    folder: str | os.PathLike[str],
    truth: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    images: Literal["png", "tiff"] = "png",
) -> None:
    """Write `capture` as a folder that :func:`read_capture` reads back, pixel for pixel.

    Files are named ``white_0.png``, ``ambient_white.png``, ``mask.png``, ``rig.json``,
    ``truth.npz``, whatever the capture's own files were called. The folder appears when it is
    complete.

    Parameters
    ----------
    truth : arrays for ``truth.npz``; where None, a truth file that the capture names is copied
    overwrite : replace an earlier capture that splitknit wrote
        Any other folder that is not empty is refused.
    images : kind of the files of images
        ``tiff``: compressed by Zstandard, read in a third of the time, but written in twice the
        time and not known to every program; ``capture.json`` states their SHA-256, as they have no
        checksums.

    Raises
    ------
    BadInput
        If the capture's parts do not fit each other or the folder cannot be written.

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1)
    >>> splitknit.write_capture(capture, "finger", truth)  # doctest: +SKIP
    """
    _check_parts(capture)
    plain = {key: _is_plain(band) for key, band in capture.bands.items()}
    if "white_crossed" in plain:  # two series state their exposures both or neither
        plain["white"] = plain["white_crossed"] = plain["white"] and plain["white_crossed"]
    written = capture.truth is not None or truth is not None
    with atomic_folder(folder, overwrite=overwrite) as target:
        files: list[tuple[str, PixelArray]] = []
        suffix = f".{images}"
        listed = [key for key in BANDS if key in capture.bands]
        document: dict[str, JsonValue] = {
            "format": CAPTURE_FORMAT,
            "version": CAPTURE_VERSION,
            "rig": "rig.json",
            "bands": {
                key: _band_json(capture.bands[key], files, suffix, plain=plain[key])
                for key in listed
            },
            "encoding": capture.encoding,
            "material": capture.material,
        }
        if capture.tip_direction_deg is not None:
            document["tip_direction_deg"] = float(capture.tip_direction_deg)
        if capture.mask is not None:
            name = document["mask"] = f"mask{suffix}"
            files.append((name, np.asarray(capture.mask, dtype=np.uint8) * np.uint8(255)))
        if capture.subject:
            document["subject"] = plain_json(capture.subject, "subject")
        if capture.captured_at is not None:
            document["captured_at"] = capture.captured_at
        if truth is not None:
            write_npz(target / "truth.npz", truth)
        elif capture.truth is not None:
            require(
                capture.truth.is_file(),
                f"{capture.truth}, the truth of the capture, does not exist.",
            )
            shutil.copyfile(capture.truth, target / "truth.npz")
        if written:
            document["truth"] = "truth.npz"

        def write(image: tuple[str, PixelArray]) -> str:
            data = encode_image(image[1], suffix, compress=True)
            (target / image[0]).write_bytes(data)
            return hashlib.sha256(data).hexdigest() if images == "tiff" else ""

        with ThreadPoolExecutor(cores()) as pool:
            hashes = list(pool.map(write, files))
        if images == "tiff":
            document["sha256"] = {name: code for (name, _), code in zip(files, hashes, strict=True)}
        for name, content in (("rig.json", rig_to_json(capture.rig)), ("capture.json", document)):
            text = json.dumps(content, indent=2, allow_nan=False) + "\n"
            (target / name).write_text(text, encoding="ascii")


def photographs_hint(folder: Path) -> str:
    """A hint, in brackets, for a folder of photographs that was given in place of a capture."""
    return (
        f"(photographs: splitknit reconstruct --images {shlex.quote(str(folder))} --lights FILE"
        " --out RESULT, or splitknit import)"
    )


def _document(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    document = file / "capture.json"
    try:
        is_folder = file.is_dir()
        exists = (document if is_folder else file).is_file()
    except (OSError, ValueError) as error:
        raise BadInput(f"{os.fspath(path)!r} is not a usable path: {error}.") from error
    if is_folder:
        hint = photographs_hint(file)
        require(exists, f"{file} is not a capture folder: it holds no capture.json {hint}.")
        return document
    require(exists, f"{file} does not exist; name a capture folder.")
    require(
        file.suffix == ".json",
        f"{file} is not a capture; name its folder or the capture.json in it.",
    )
    return file


def _check_colours(rig: Rig, band: Band) -> None:
    """Refuse grey images that LEDs of several colours light."""
    for k, names in enumerate(rig.colours_of(band.leds)):
        count = len(set(names))
        require(
            band.pixels.shape[3] == 3 or count == 1,
            f"{image_name(band, k)} is grey, but LEDs of {count} colours lit it; their light can be"
            " separated in colour images only.",
        )


def _check_parts(capture: Capture) -> None:
    size = capture.rig.camera.image_size
    require("white" in capture.bands, "a capture needs a band 'white'.")
    for key, band in capture.bands.items():
        require(
            key in BANDS, f"a capture's bands are 'white', 'white_crossed' and 'nir', not '{key}'."
        )
        count, *image_size, channels = shape = band.pixels.shape
        require(
            tuple(image_size) == size
            and channels in (1, 3)
            and count >= (1 if any(led.colour for led in capture.rig.leds) else 3),
            f"the pixels of the band '{key}' have the shape {shape}; "
            f"(L, {size[0]}, {size[1]}, 1 or 3) with three images at least is expected.",
        )
        fits = band.ambient is None or band.ambient.pixels.shape[:2] == size
        require(
            fits, f"the ambient image of the band '{key}' has another size than the rig's camera."
        )
        counts = [len(band.leds), len(band.exposure), len(band.black_level)]
        words = "{} LEDs, {} exposures and {} black levels".format(*counts)
        require(counts == [count] * 3, f"the band '{key}' has {count} images but {words}.")
    if "white_crossed" in capture.bands:
        _check_pair(
            capture.bands["white"], capture.bands["white_crossed"], "the capture", capture.rig
        )
    if capture.mask is not None:
        check_mask(capture.mask, size)


def _is_plain(band: Band) -> bool:
    """Whether names alone describe the images: every exposure is 1 and every black level 0."""
    plain = bool((band.exposure == 1.0).all() and (band.black_level == 0.0).all())
    dark = band.ambient
    return plain and (dark is None or (dark.exposure, dark.black_level) == (1.0, 0.0))


def _band_json(
    band: Band, files: list[tuple[str, PixelArray]], suffix: str, *, plain: bool
) -> JsonValue:
    """Return the band's entry in the document, and add its images to `files`."""

    def entry(name: str, pixels: PixelArray, exposure: float, black_level: float) -> JsonValue:
        files.append((name, pixels))
        return name if plain else {"file": name, "exposure_s": exposure, "black_level": black_level}

    names = [f"{band.name}_{k}{suffix}" for k in range(len(band.leds))]
    rows = zip(names, band.pixels, band.exposure.tolist(), band.black_level.tolist(), strict=True)
    result: dict[str, Any] = {
        "images": [entry(*row) for row in rows],
        "leds": [group[0] if len(group) == 1 else list(group) for group in band.leds],
    }
    if band.polarisation:
        result["polarisation"] = band.polarisation
    if band.ambient is not None:
        dark = band.ambient
        name = f"ambient_{band.name}{suffix}"
        result["ambient"] = entry(name, dark.pixels, dark.exposure, dark.black_level)
    if band.flat is not None:
        result["flat"] = [f"flat_{name}" for name in names]
        files += zip(result["flat"], band.flat[..., None], strict=True)
    return result
