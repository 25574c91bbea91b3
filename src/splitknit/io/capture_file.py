"""The document ``capture.json``: its content, before any image is opened."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_lights, naming, require
from splitknit.io.fields import Fields, inside, read_json
from splitknit.io.rig import rig_from_json
from splitknit.model import Band, Rig, spectral_band

CAPTURE_FORMAT, CAPTURE_VERSION = "splitknit-capture", 1
BANDS = ("white", "white_crossed", "nir")
POLARISATIONS = ("", "parallel", "crossed")
ENCODINGS = ("linear", "srgb")
MATERIALS = ("skin", "opaque")
_MAX_IMAGES = 1000
_AS_NEAR = 0.01
"""Of cosines: a light halfway between two is as near to either."""


@dataclass(frozen=True, slots=True)
class BandPlan:
    """One band as the document describes it."""

    files: tuple[Path, ...]
    names: tuple[str, ...]
    """The same relative to the folder."""
    leds: tuple[tuple[int, ...], ...]
    exposure: NDArray[np.float64]
    black_level: NDArray[np.float64]
    ambient: Path | None
    ambient_exposure: float
    ambient_black_level: float
    flat: tuple[Path, ...]
    polarisation: str
    exposed: bool
    """Whether the document states the exposures."""


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """A whole capture as the document describes it; all paths lie inside the folder."""

    rig: Rig
    rig_file: Path
    bands: dict[str, BandPlan]
    encoding: str
    material: str
    tip_direction_deg: float | None
    mask: Path | None
    subject: dict[str, Any]
    captured_at: str | None
    truth: Path | None
    shading: Path | None
    documents: dict[Path, bytes]
    """The JSON files and what was read from them."""


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
    rig_file = inside(folder, fields.get("rig"), name, "rig")
    rig_document, rig_data = read_json(rig_file)
    rig = rig_from_json(rig_document, str(rig_file))
    truth = inside(folder, fields.get("truth"), name, "truth") if fields.has("truth") else None
    require(
        truth is None or truth.is_file(),
        f"{truth}, the truth that {name} names, does not exist; add it or remove the field.",
    )
    return CapturePlan(
        rig=rig,
        rig_file=rig_file,
        bands=_bands(fields, folder, rig),
        encoding=_choice(fields, "encoding", ENCODINGS),
        material=_choice(fields, "material", MATERIALS),
        tip_direction_deg=(
            fields.number("tip_direction_deg", -360.0, 360.0) if fields.has("tip_direction_deg") else None
        ),
        mask=inside(folder, fields.get("mask"), name, "mask") if fields.has("mask") else None,
        subject=fields.mapping("subject"),
        captured_at=fields.text("captured_at") if fields.has("captured_at") else None,
        truth=truth,
        shading=inside(folder, fields.get("shading"), name, "shading") if fields.has("shading") else None,
        documents={document_file: data, rig_file: rig_data},
    )


def _choice(fields: Fields, key: str, choices: tuple[str, ...]) -> str:
    """Return one of `choices`; the first where the field is absent."""
    value = fields.text(key, choices[0])
    if value not in choices:
        fields.refuse(key, " or ".join(f'"{choice}"' for choice in choices))
    return value


def _bands(fields: Fields, folder: Path, rig: Rig) -> dict[str, BandPlan]:
    bands = fields.child("bands")
    for key in bands.keys():  # noqa: SIM118 - not a dict
        known = ", ".join(BANDS)
        require(key in BANDS, f"{fields.name}: bands has '{ascii(key)[1:-1]}'; the bands are named {known}.")
    require(bands.has("white"), f"{fields.name}: bands.white is missing; every capture has images under white light.")
    plans = {key: _band(bands.child(key), folder, rig, spectral_band(key)) for key in BANDS if bands.has(key)}
    if "white_crossed" in plans:
        check_pair(plans["white"], plans["white_crossed"], fields.name, rig)
        require(
            plans["white"].exposed == plans["white_crossed"].exposed,
            f"{fields.name}: bands.white and bands.white_crossed must state exposure_s for every image, both or "
            "neither (then it is the same).",
        )
    seen: set[Path] = set()
    for key, plan in plans.items():  # a file takes memory each time that it is named, by whatever spelling
        for name, file in zip(plan.names, plan.files, strict=True):
            place = file.resolve()
            require(place not in seen, f"{fields.name}: {bands.path(key)}.images names {name!a} twice.")
            seen.add(place)
    return plans


def check_pair(parallel: BandPlan | Band, crossed: BandPlan | Band, name: str, rig: Rig) -> None:
    """Refuse two polarised series that are not the same photographs through another film."""
    require(
        (parallel.polarisation, crossed.polarisation) == ("parallel", "crossed"),
        f'{name}: beside bands.white_crossed, bands.white must say "polarisation": "parallel" and bands.white_crossed '
        f'"crossed".',
    )
    require(
        len(parallel.leds) == len(crossed.leds),
        f"{name}: bands.white has {len(parallel.leds)} images but bands.white_crossed {len(crossed.leds)}; both "
        "series need one image a light, in the same order.",
    )
    require(
        not any(any(names) for plan in (parallel, crossed) for names in rig.colours_of(plan.leds)),
        f"{name}: polarised series are lit by white LEDs, but the rig's are coloured.",
    )
    own, others = (rig.select(plan.leds).light_vectors() for plan in (parallel, crossed))
    near = others @ (own / np.linalg.norm(own, axis=1, keepdims=True)).T
    near /= np.linalg.norm(others, axis=1, keepdims=True)
    away = np.flatnonzero(np.diag(near) < near.max(axis=1) - _AS_NEAR)
    require(
        away.size == 0,
        f"{name}: image {away[0] if away.size else 0} of bands.white_crossed is lit from another side than that of "
        "bands.white; list both series in the same order of lights.",
    )


def _band(fields: Fields, folder: Path, rig: Rig, band: str) -> BandPlan:
    images = fields.items("images")
    require(
        len(images) >= 3 or (len(images) > 0 and any(led.colour for led in rig.leds if led.band == band)),
        f"{fields.name}: {fields.path('images')} names {len(images)} images, but at least three are needed.",
    )
    require(
        len(images) <= _MAX_IMAGES,
        f"{fields.name}: {fields.path('images')} names {len(images)} images, but at most {_MAX_IMAGES} are read.",
    )
    leds = tuple(_group(fields, item, k) for k, item in enumerate(fields.items("leds")))
    require(
        len(leds) == len(images),
        f"{fields.name}: {fields.where} has {len(images)} images but {len(leds)} entries in leds; "
        f"name the LEDs of every image.",
    )
    _check_light_list(rig, band, leds, f"{fields.name}: {fields.path('leds')}")
    entries = [_entry(fields, item, folder, f"{fields.path('images')}[{k}]") for k, item in enumerate(images)]
    ambient = None
    if fields.has("ambient"):
        ambient = _entry(fields, fields.get("ambient"), folder, fields.path("ambient"))
    flat = fields.items("flat") if fields.has("flat") else []
    require(
        len(flat) in (0, len(images)),
        f"{fields.name}: {fields.path('flat')} names {len(flat)} images; it needs one for each of the {len(images)}.",
    )
    return BandPlan(
        files=tuple(entry.file for entry in entries),
        names=tuple(entry.name for entry in entries),
        leds=leds,
        exposure=np.array([1.0 if entry.exposure is None else entry.exposure for entry in entries]),
        black_level=np.array([0.0 if entry.black_level is None else entry.black_level for entry in entries]),
        ambient=None if ambient is None else ambient.file,
        ambient_exposure=_ambient_value(fields, ambient, [entry.exposure for entry in entries], "exposure_s", 1.0),
        ambient_black_level=_ambient_value(
            fields, ambient, [entry.black_level for entry in entries], "black_level", 0.0
        ),
        flat=tuple(inside(folder, item, fields.name, f"{fields.path('flat')}[{k}]") for k, item in enumerate(flat)),
        polarisation=_choice(fields, "polarisation", POLARISATIONS),
        exposed=all(entry.exposure is not None for entry in entries),
    )


def _ambient_value(
    fields: Fields, ambient: _Entry | None, images: list[float | None], key: str, default: float
) -> float:
    """Exposure or black level of the ambient image: by default that of the band's images, if all have the same, or the
    default if the document leaves it out for some of the images too; else unknown.
    """
    if ambient is None:
        return default
    own = ambient.exposure if key == "exposure_s" else ambient.black_level
    if own is not None:
        return own
    if None in images:
        return default
    common = {value for value in images if value is not None}
    require(
        len(common) == 1,
        f"{fields.name}: {fields.path('ambient')} needs its own {key}, as the images of the band differ in theirs; "
        f'write {{"file": ..., "{key}": ...}}.',
    )
    return common.pop()


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
    require(
        good and len(set(group)) == len(group),
        f"{fields.name}: {fields.path('leds')}[{k}] must be the number of an LED in the rig (from 0), "
        f"or a list of different ones.",
    )
    return tuple(group)


def _check_light_list(rig: Rig, band: str, leds: tuple[tuple[int, ...], ...], where: str) -> None:
    """Refuse LEDs (of every image) that are not in the rig, are of another band, or do not determine a normal."""
    for k, group in enumerate(leds):
        for index in group:
            require(
                0 <= index < len(rig.leds),
                f"{where}[{k}] names LED {index}, but the rig has {len(rig.leds)} LEDs (0 to {len(rig.leds) - 1}).",
            )
            require(
                rig.leds[index].band == band,
                f"{where}[{k}] names LED {index}, which is a '{rig.leds[index].band}' LED in the rig, not '{band}'; "
                f"correct the list or the rig.",
            )
    for k, names in enumerate(rig.colours_of(leds)):
        require(
            all(names) or not any(names),
            f"{where}[{k}] names coloured and white LEDs for one exposure, which cannot be separated; use one kind.",
        )
    lights = rig.lights_of(leds)
    naming(where, lambda: check_lights(rig.select(lights).light_vectors(), len(lights)))
