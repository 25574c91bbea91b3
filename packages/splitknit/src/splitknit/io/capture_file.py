"""The document ``capture.json``: its content, before any image is opened."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput, check_lights, naming, require
from splitknit.io.fields import Fields, inside, read_json
from splitknit.io.rig import rig_from_json
from splitknit.model import Band, Capture, Rig, spectral_band

CAPTURE_FORMAT, CAPTURE_VERSION = "splitknit-capture", 1
BANDS = ("white", "white_crossed", "nir")
POLARISATIONS = ("", "parallel", "crossed")
ENCODINGS = ("linear", "srgb")
MATERIALS = ("skin", "opaque")
_MAX_IMAGES = 1000
_AS_NEAR = 0.01  # difference of cosines below which a light is equally near to two others


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


@dataclass(frozen=True, slots=True)
class _Entry:
    """An image: its file, and how it was exposed where the document states it."""

    file: Path
    name: str
    exposure: float | None
    black_level: float | None


def read_plan(document_file: Path) -> CapturePlan:
    """Read ``capture.json`` and its rig file. Raises BadInput naming the file and the field."""
    folder, name = document_file.parent, str(document_file)
    document, data = read_json(document_file)
    fields = Fields(document, name)
    fields.format(CAPTURE_FORMAT, CAPTURE_VERSION)
    gel = "names a calibrated shading, by which this version reads no heights."
    fields.require(not fields.has("shading"), "shading", gel)
    rig_file = inside(folder, fields.get("rig"), name, "rig")
    rig_document, rig_data = read_json(rig_file)
    rig = rig_from_json(rig_document, str(rig_file))
    truth = fields.file("truth", folder)
    there = truth is None or truth.is_file()
    require(there, f"{truth}, the truth that {name} names, does not exist; add it or remove the field.")
    turned = fields.has("tip_direction_deg")
    bands = _bands(fields, folder, rig)
    capture = Capture(
        rig,
        bands={},
        encoding=fields.choice("encoding", ENCODINGS),
        material=fields.choice("material", MATERIALS),
        tip_direction_deg=fields.number("tip_direction_deg", -360.0, 360.0) if turned else None,
        subject=fields.mapping("subject"),
        captured_at=fields.text("captured_at") if fields.has("captured_at") else None,
        truth=truth,
    )
    documents = {document_file: data, rig_file: rig_data}
    return CapturePlan(capture, rig_file, bands, fields.file("mask", folder), documents)


def _bands(fields: Fields, folder: Path, rig: Rig) -> dict[str, BandPlan]:
    bands = fields.child("bands")
    for key in bands.keys():  # noqa: SIM118 - not a dict
        known = ", ".join(BANDS)
        require(key in BANDS, f"{fields.name}: bands has '{ascii(key)[1:-1]}'; the bands are named {known}.")
    require(bands.has("white"), f"{fields.name}: bands.white is missing; every capture has images under white light.")
    plans = {key: _band(bands.child(key), folder, rig, key) for key in BANDS if bands.has(key)}
    if "white_crossed" in plans:
        check_pair(plans["white"].band, plans["white_crossed"].band, fields.name, rig)
        same = plans["white"].exposed == plans["white_crossed"].exposed
        stated = "and bands.white_crossed must state exposure_s for every image, both or neither (then it is the same)."
        bands.require(same, "white", stated)
    seen: set[Path] = set()
    for key, plan in plans.items():  # a file takes memory each time that it is named, by whatever spelling
        for name, file in zip(plan.band.files, plan.files, strict=True):
            place = file.resolve()
            require(place not in seen, f"{fields.name}: {bands.path(key)}.images names {name!a} twice.")
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


def _band(fields: Fields, folder: Path, rig: Rig, key: str) -> BandPlan:
    images, band = fields.items("images"), spectral_band(key)
    count = len(images)
    enough = count >= 3 or (count > 0 and any(led.colour for led in rig.leds if led.band == band))
    fields.require(enough, "images", f"names {count} images, but at least three are needed.")
    fields.require(count <= _MAX_IMAGES, "images", f"names {count} images, but at most {_MAX_IMAGES} are read.")
    leds = tuple(_group(fields, item, k) for k, item in enumerate(fields.items("leds")))
    other = f"has {count} images but {len(leds)} entries in leds; name the LEDs of every image."
    fields.require(len(leds) == count, "", other)
    _check_light_list(rig, band, leds, f"{fields.name}: {fields.path('leds')}")
    entries = [_entry(fields, item, folder, f"{fields.path('images')}[{k}]") for k, item in enumerate(images)]
    lit = fields.has("ambient")
    ambient = _entry(fields, fields.get("ambient"), folder, fields.path("ambient")) if lit else None
    flat = fields.items("flat") if fields.has("flat") else []
    each = f"names {len(flat)} images; it needs one for each of the {count}."
    fields.require(len(flat) in (0, count), "flat", each)
    own, own_level = (ambient.exposure, ambient.black_level) if ambient else (None, None)
    exposures, levels = [entry.exposure for entry in entries], [entry.black_level for entry in entries]
    described = Band(
        key,
        np.empty((0, 0, 0, 0), np.uint8),
        leds,
        exposure=np.array([1.0 if value is None else value for value in exposures]),
        black_level=np.array([0.0 if value is None else value for value in levels]),
        ambient_exposure=_ambient_value(fields, own, exposures, "exposure_s", 1.0),
        ambient_black_level=_ambient_value(fields, own_level, levels, "black_level", 0.0),
        files=tuple(entry.name for entry in entries),
        polarisation=fields.choice("polarisation", POLARISATIONS),
    )
    flats = tuple(inside(folder, item, fields.name, f"{fields.path('flat')}[{k}]") for k, item in enumerate(flat))
    files, dark = tuple(entry.file for entry in entries), ambient.file if ambient else None
    return BandPlan(described, files, dark, flats, exposed=None not in exposures)


def _ambient_value(fields: Fields, own: float | None, images: list[float | None], key: str, default: float) -> float:
    """The ambient image's `own`, else what all images of the band have, else unknown; the default if not stated."""
    if own is not None or None in images or not fields.has("ambient"):
        return default if own is None else own
    fault = f'needs its own {key}, as the images of the band differ in theirs; write {{"file": ..., "{key}": ...}}.'
    fields.require(len(set(images)) == 1, "ambient", fault)
    return images[0] or 0.0


def _entry(fields: Fields, item: Any, folder: Path, where: str) -> _Entry:
    if not isinstance(item, dict):
        return _Entry(inside(folder, item, fields.name, where), str(item), None, None)
    entry = Fields(item, fields.name, where)
    file = inside(folder, entry.get("file"), fields.name, entry.path("file"))
    exposure = None
    if entry.has("exposure_s") or entry.has("gain"):
        exposure = entry.number("exposure_s", 1e-9, 1e6, 1.0) * entry.number("gain", 1e-6, 1e6, 1.0)
    black_level = entry.number("black_level", 0.0, 65535.0) if entry.has("black_level") else None
    return _Entry(file, str(item["file"]), exposure, black_level)


def _group(fields: Fields, item: Any, k: int) -> tuple[int, ...]:
    group = item if isinstance(item, list) else [item]
    good = 0 < len(group) <= 10_000 and all(type(index) is int and 0 <= index < 1 << 31 for index in group)
    fault = "must be the number of an LED in the rig (from 0), or a list of different ones."
    fields.require(good and len(set(group)) == len(group), f"leds[{k}]", fault)
    return tuple(group)


def _check_light_list(rig: Rig, band: str, leds: tuple[tuple[int, ...], ...], where: str) -> None:
    """Refuse LEDs (of every image) that are not in the rig, are of another band, or do not determine a normal."""
    for k, group in enumerate(leds):
        for index in group:
            known, named = len(rig.leds), f"{where}[{k}] names LED {index}"
            require(0 <= index < known, f"{named}, but the rig has {known} LEDs (0 to {known - 1}).")
            own = rig.leds[index].band
            wrong = f"{named}, which is a '{own}' LED in the rig, not '{band}'; correct the list or the rig."
            require(own == band, wrong)
    for k, names in enumerate(rig.colours_of(leds)):
        mixed = f"{where}[{k}] names coloured and white LEDs for one exposure, which cannot be separated; use one kind."
        require(all(names) or not any(names), mixed)
    lights = rig.lights_of(leds)
    naming(where, lambda: check_lights(rig.select(lights).light_vectors(), len(lights)))
