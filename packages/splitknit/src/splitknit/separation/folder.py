"""What ``splitknit separate`` does: one photograph of skin in, direct and global light out.

Into the result's folder go ``direct.tiff`` and ``global.tiff`` (float32, linear light, 1 = full
scale of the file, NaN outside the mask), 8-bit previews of both, and ``report.json``.

Of two folders of photographs through polarising films go ``specular_K.png`` and ``diffuse_K.png``
(16 bits, linear) of light K, ``specular.png`` of all lights, and ``report.json``.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import naming, require
from splitknit.findings import Finding
from splitknit.imaging.pixels import pick_channel, srgb_code
from splitknit.io.atomic import atomic_folder
from splitknit.io.images import write_float_tiff, write_image
from splitknit.io.normal_maps import read_mask
from splitknit.io.photograph_files import home_of, photographs_in
from splitknit.io.photos import encoding_of, read_photo
from splitknit.io.provenance import json_text, provenance
from splitknit.io.targets import check_target
from splitknit.model import BoolArray, FloatArray, Progress
from splitknit.observation.films import (
    NOT_SPECULAR,
    picture_bytes,
    separate_polarised,
    specular_picture,
)
from splitknit.observation.stored import linear_image
from splitknit.separation.direct import direct_light

MARKER = "direct.tiff"
POLARISED_MARKER = "specular.png"
LINEAR = "linear light, 1 = full scale of the images"


def separate_photograph(
    source: Path, out: Path, *, encoding: str | None, progress: Progress
) -> dict[str, Any]:
    """Separate one photograph of skin, a file or the only one in a folder, by the network of the
    thesis; write all results into `out`, return the facts of ``report.json`` and more.

    A mask beside it in the folder shows where a result is wanted. Raises BadInput naming the file
    or the folder at fault; nothing is left half-written.
    """
    check_target(out, MARKER, "an earlier separation", keep=home_of(source))
    photographs, masks, _ = photographs_in(source, source / "lights.txt")
    require(
        len(photographs) == 1,
        f"{source} holds {len(photographs)} photographs; name a folder of one, or its file.",
    )
    file = photographs[0]
    progress("reading", 0.0)
    if encoding is None:
        encoding, _ = encoding_of(photographs, lambda: None)
    photo = read_photo(file)
    require(photo.pixels.dtype.kind == "u", f"{file} holds floats; save it as 16-bit PNG or TIFF.")
    white = linear_image(photo.pixels, encoding)
    hashes = {file.name: photo.sha256}
    inside = np.ones(white.shape[:2], np.bool_) if photo.opaque is None else photo.opaque
    if masks:
        inside, of_mask = read_mask(masks[0], inside.shape)
        hashes |= of_mask
    progress("separating", 0.3)
    direct = naming(file, partial(_direct_of, white, inside))
    global_ = white - direct
    progress("writing", 0.8)
    grey = white.mean(axis=-1)[inside]
    lit = grey > _REPORTED_LEVEL * np.quantile(grey, 0.999)
    require(lit.any(), f"{file} is black; expose it more.")
    share = np.median(direct[inside][lit] / np.maximum(white[inside][lit], 1e-9))
    origin = provenance({"separate": {"method": "network", "encoding": encoding}}, hashes)
    facts = {
        **origin,
        "method": "network",
        "images": [file.name],
        "image_size": list(inside.shape),
        "direct_share": float(share),
        "findings": [],
        "files": ["direct.tiff", "global.tiff", "direct.png", "global.png", "report.json"],
    }
    with atomic_folder(out) as target:
        for name, part in (("direct", direct), ("global", global_)):
            light = part if part.shape[2] == 3 else part[..., 0]
            write_float_tiff(target / f"{name}.tiff", light, LINEAR, origin)
            write_image(target / f"{name}.png", light_picture(light))
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _direct_of(white: FloatArray, inside: BoolArray) -> FloatArray:
    """Direct light (H, W, C) of linear light, NaN outside."""
    images = np.moveaxis(np.where(inside[..., None], white, 0.0), -1, 0)
    direct = direct_light(images if len(images) == 1 else images[None])
    direct = np.moveaxis(direct.reshape(images.shape), 0, -1)
    return np.where(inside[..., None], direct, np.nan)


_REPORTED_LEVEL = 0.1
"""Figures of the report are over pixels brighter than this fraction of the brightest."""


def _check_agrees(
    kinds: set[tuple[tuple[int, ...], np.dtype[Any]]], words: str, rows: int, columns: int
) -> None:
    """Refuse with `words` a photograph of another size than those before."""
    require(all(shape[:2] == (rows, columns) for shape, _ in kinds), words)


def separate_polarised_folders(
    parallel: Path, crossed: Path, out: Path, *, encoding: str | None, progress: Progress
) -> dict[str, Any]:
    """Separate photographs through parallel and crossed films, light by light; return the facts of
    ``report.json``. Raises BadInput if the folders do not hold the same number of photographs of
    one kind, or are not to be read.
    """
    series = []
    for folder in (parallel, crossed):
        require(
            folder.is_dir(),
            f"{folder} is not a folder; name the folders of the parallel and crossed photographs.",
        )
        series.append(photographs_in(folder, folder / "lights.txt")[0])
        check_target(out, POLARISED_MARKER, "an earlier separation", keep=folder)
    count = len(series[0])
    require(
        0 < count == len(series[1]),
        f"{parallel} holds {count} photographs and {crossed} {len(series[1])}; both series need one"
        " photograph a light, in the same order.",
    )
    if encoding is None:
        encoding, _ = encoding_of(series[0], lambda: False)
    hashes = {}
    kinds: set[tuple[tuple[int, ...], np.dtype[Any]]] = set()
    specular: NDArray[np.floating] = np.zeros(1, np.float32)
    diffuse = specular
    with atomic_folder(out) as target:
        for k in range(count):
            progress("separating", k / count)
            light = []
            for folder, files in zip((parallel, crossed), series, strict=True):
                words = (
                    f"{files[k]} is not of the size and kind of {series[0][0]}; all must agree, in"
                    " integers."
                )
                photo = read_photo(files[k], partial(_check_agrees, kinds, words))
                kinds.add((photo.pixels.shape, photo.pixels.dtype))
                require(len(kinds) == 1 and photo.pixels.dtype.kind == "u", words)
                light.append(linear_image(photo.pixels, encoding))
                hashes[f"{folder.name}/{files[k].name}"] = photo.sha256
            parts = separate_polarised(*light)
            specular = specular + pick_channel(parts[0], "grey")
            diffuse = diffuse + pick_channel(light[1], "grey")
            for name, part in zip(("specular", "diffuse"), parts, strict=True):
                write_image(target / f"{name}_{k}.png", np.round(part * 65535).astype(np.uint16))
        specular /= count
        diffuse /= count
        lit = diffuse > _REPORTED_LEVEL * float(np.quantile(diffuse, 0.999))
        require(lit.any(), "nothing is lit; the crossed images are black.")
        # periods of ridges that a picture of a finger is about long
        picture = specular_picture(specular[None], lit, max(lit.shape) / 45)
        write_image(target / POLARISED_MARKER, picture_bytes(picture))
        share = float(np.median(specular[lit] / (specular + diffuse)[lit]))
        names = [f"{name}_{k}.png" for name in ("specular", "diffuse") for k in range(count)]
        facts = {
            **provenance({"separate": {"method": "polarised", "encoding": encoding}}, hashes),
            "method": "polarised",
            "images": count,
            "image_size": list(lit.shape),
            "specular_share": share,
            "findings": [Finding("not-specular", NOT_SPECULAR).facts] if share <= 0 else [],
            "files": [*names, POLARISED_MARKER, "report.json"],
        }
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


# Previews of separated light for people.


def light_picture(light: FloatArray) -> NDArray[np.uint8]:
    """8 bits for people: black to the 99.9th percentile, sRGB curve; black where nothing is
    known."""
    top = max(float(np.nanquantile(light, 0.999)), 1e-12)
    scaled = np.clip(np.nan_to_num(light) / top, 0.0, 1.0)
    return np.asarray(np.round(255 * srgb_code(scaled)), dtype=np.uint8)
