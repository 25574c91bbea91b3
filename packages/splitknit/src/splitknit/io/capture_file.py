"""The document ``capture.json``: its content, before any image is opened."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from splitknit.errors import BadInput, check_lights, naming, require
from splitknit.io.fields import Version1, inside, read_document, read_json
from splitknit.io.rig import rig_from_json
from splitknit.model import Band, Capture, Rig, spectral_band

CAPTURE_FORMAT, CAPTURE_VERSION = "splitknit-capture", 1
BANDS = ("white", "white_crossed", "nir")
_AS_NEAR = 0.01  # difference of cosines below which a light is equally near to two others
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
        return (1.0 if self.exposure_s is None else self.exposure_s) * (1.0 if self.gain is None else self.gain)


class _BandFields(Struct):
    images: Annotated[list[str | _Image], Meta(min_length=1, max_length=1000)]
    leds: list[_Index | Annotated[tuple[_Index, ...], Meta(min_length=1, max_length=10_000)]]
    ambient: str | _Image | None = None
    flat: list[str] | None = None
    polarisation: Annotated[str, Meta(pattern="^(parallel|crossed|)$")] = ""


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
    shading: Any = None


@dataclass(frozen=True, slots=True)
class BandPlan:
    """One band as the document describes it."""

    band: Band  # without pixels; its files are relative to the folder
    files: tuple[Path, ...]
    ambient: Path | None
    flat: tuple[Path, ...]
    exposed: bool  # whether the document states the exposures


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """A whole capture as the document describes it; all paths lie inside the folder."""

    capture: Capture  # without images
    rig_file: Path
    bands: dict[str, BandPlan]
    mask: Path | None
    documents: dict[Path, bytes]  # the JSON files and what was read from them


def read_plan(document_file: Path) -> CapturePlan:
    """Read ``capture.json`` and its rig file. Raises BadInput naming the file and the field."""
    folder, name = document_file.parent, str(document_file)
    fields, data = read_document(document_file, _CaptureFields)
    require(fields.shading is None, f"{name} names a calibrated shading, by which this version reads no heights.")
    rig_file = inside(folder, fields.rig, name, "rig")
    rig_document, rig_data = read_json(rig_file)
    rig = rig_from_json(rig_document, str(rig_file))
    truth = None if fields.truth is None else inside(folder, fields.truth, name, "truth")
    there = truth is None or truth.is_file()
    require(there, f"{truth}, the truth that {name} names, does not exist; add it or remove the field.")
    mask = None if fields.mask is None else inside(folder, fields.mask, name, "mask")
    bands = _bands(fields.bands, folder, rig, name)
    capture = Capture(
        rig,
        bands={},
        encoding=fields.encoding,
        material=fields.material,
        tip_direction_deg=fields.tip_direction_deg,
        subject=fields.subject or {},
        captured_at=fields.captured_at,
        truth=truth,
    )
    return CapturePlan(capture, rig_file, bands, mask, {document_file: data, rig_file: rig_data})


def _bands(bands: _BandsFields, folder: Path, rig: Rig, name: str) -> dict[str, BandPlan]:
    plans = {key: _band(band, folder, rig, key, name) for key in BANDS if (band := getattr(bands, key)) is not None}
    if "white_crossed" in plans:
        check_pair(plans["white"].band, plans["white_crossed"].band, name, rig)
        same = plans["white"].exposed == plans["white_crossed"].exposed
        stated = "must state exposure_s for every image, both or neither (then it is the same)."
        require(same, f"{name}: bands.white and bands.white_crossed {stated}")
    seen: set[Path] = set()
    for key, plan in plans.items():  # a file takes memory each time that it is named, by whatever spelling
        for image, file in zip(plan.band.files, plan.files, strict=True):
            place = file.resolve()
            require(place not in seen, f"{name}: bands.{key}.images names {image!a} twice.")
            seen.add(place)
    return plans


def check_pair(parallel: Band, crossed: Band, name: str, rig: Rig) -> None:
    """Refuse two polarised series that are not the same photographs through another film."""
    stated = (parallel.polarisation, crossed.polarisation) == ("parallel", "crossed")
    wanted = 'bands.white must say "polarisation": "parallel" and bands.white_crossed "crossed".'
    require(stated, f"{name}: beside bands.white_crossed, {wanted}")
    differ = f"bands.white has {len(parallel.leds)} images but bands.white_crossed {len(crossed.leds)}"
    alike = len(parallel.leds) == len(crossed.leds)
    require(alike, f"{name}: {differ}; both series need one image a light, in the same order.")
    white = not any(any(names) for plan in (parallel, crossed) for names in rig.colours_of(plan.leds))
    require(white, f"{name}: polarised series are lit by white LEDs, but the rig's are coloured.")
    own, others = (rig.select(plan.leds).light_vectors() for plan in (parallel, crossed))
    near = others @ (own / np.linalg.norm(own, axis=1, keepdims=True)).T
    near /= np.linalg.norm(others, axis=1, keepdims=True)
    for k in np.flatnonzero(np.diag(near) < near.max(axis=1) - _AS_NEAR):
        away = f"image {k} of bands.white_crossed is lit from another side than that of bands.white"
        raise BadInput(f"{name}: {away}; list both series in the same order of lights.")


def _band(fields: _BandFields, folder: Path, rig: Rig, key: str, name: str) -> BandPlan:
    where, band = f"{name}: bands.{key}", spectral_band(key)
    images = [_Image(image) if isinstance(image, str) else image for image in fields.images]
    count = len(images)
    enough = count >= 3 or any(led.colour for led in rig.leds if led.band == band)
    require(enough, f"{where}.images names {count} images, but at least three are needed.")
    leds = tuple((group,) if isinstance(group, int) else group for group in fields.leds)
    differ = f"{where} has {count} images but {len(leds)} entries in leds; name the LEDs of every image."
    require(len(leds) == count, differ)
    _check_light_list(rig, band, leds, f"{where}.leds")
    ambient = _Image(fields.ambient) if isinstance(fields.ambient, str) else fields.ambient
    flat = fields.flat or []
    each = f"{where}.flat names {len(flat)} images; it needs one for each of the {count}."
    require(len(flat) in (0, count), each)
    exposures, levels = [image.exposure for image in images], [image.black_level for image in images]
    dark_exposure, dark_level = 1.0, 0.0
    if ambient is not None:
        dark_exposure = _ambient_value(ambient.exposure, exposures, 1.0, f"{where}.ambient", "exposure_s")
        dark_level = _ambient_value(ambient.black_level, levels, 0.0, f"{where}.ambient", "black_level")
    described = Band(
        key,
        np.empty((0, 0, 0, 0), np.uint8),
        leds,
        exposure=np.array([1.0 if value is None else value for value in exposures]),
        black_level=np.array([0.0 if value is None else value for value in levels]),
        ambient_exposure=dark_exposure,
        ambient_black_level=dark_level,
        files=tuple(image.file for image in images),
        polarisation=fields.polarisation,
    )
    files = tuple(inside(folder, image.file, name, f"bands.{key}.images[{k}]") for k, image in enumerate(images))
    dark = None if ambient is None else inside(folder, ambient.file, name, f"bands.{key}.ambient")
    flats = tuple(inside(folder, file, name, f"bands.{key}.flat[{k}]") for k, file in enumerate(flat))
    return BandPlan(described, files, dark, flats, exposed=None not in exposures)


def _ambient_value(own: float | None, images: list[float | None], default: float, where: str, key: str) -> float:
    """The ambient image's `own`, else what all images of the band have, else the default."""
    if own is not None or None in images:
        return default if own is None else own
    fault = f'{where} needs its own {key}, as the images of the band differ in theirs: {{"file": ..., "{key}": ...}}.'
    require(len(set(images)) == 1, fault)
    return images[0] or 0.0


def _check_light_list(rig: Rig, band: str, leds: tuple[tuple[int, ...], ...], where: str) -> None:
    """Refuse LEDs (of every image) that are not in the rig, are of another band, or do not determine a normal."""
    for k, group in enumerate(leds):
        require(len(set(group)) == len(group), f"{where}[{k}] names an LED twice.")
        for index in group:
            known, named = len(rig.leds), f"{where}[{k}] names LED {index}"
            require(index < known, f"{named}, but the rig has {known} LEDs (0 to {known - 1}).")
            own = rig.leds[index].band
            wrong = f"{named}, which is a '{own}' LED in the rig, not '{band}'; correct the list or the rig."
            require(own == band, wrong)
    for k, names in enumerate(rig.colours_of(leds)):
        mixed = f"{where}[{k}] names coloured and white LEDs for one exposure, which cannot be separated; use one kind."
        require(all(names) or not any(names), mixed)
    lights = rig.lights_of(leds)
    naming(where, lambda: check_lights(rig.select(lights).light_vectors(), len(lights)))
