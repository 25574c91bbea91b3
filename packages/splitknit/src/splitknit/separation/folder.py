"""What ``splitknit separate`` does: a folder of images under patterns in, direct and global light
out.

Into the result's folder go ``direct.tiff`` and ``global.tiff`` (float32, linear light, 1 = full
scale of the files, NaN outside the mask), 8-bit previews of both, and ``report.json``.

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
from splitknit.io.photograph_files import photographs_in
from splitknit.io.photos import encoding_of, read_photo
from splitknit.io.provenance import json_text, provenance
from splitknit.io.targets import check_target
from splitknit.model import FloatArray, Progress
from splitknit.observation.films import (
    NOT_SPECULAR,
    picture_bytes,
    separate_polarised,
    specular_picture,
)
from splitknit.observation.patterns import ESTIMATE, PatternLight, lit_images, read_light
from splitknit.observation.stored import linear_image
from splitknit.separation.binary import checkerboard
from splitknit.separation.direct import direct_light
from splitknit.separation.stacks import Separation, estimate_patterns

MARKER = "direct.tiff"
POLARISED_MARKER = "specular.png"
LINEAR = "linear light, 1 = full scale of the images"
NO_CHECK_PX = Finding(
    "no-check-size",
    "global light was taken to be the same under all shifts; on skin it is not, and direct light "
    "comes out a quarter too low: give check_px for skin.",
)


def separate_to_folder(
    folder: Path,
    out: Path,
    *,
    method: str,
    alpha: float,
    dark: float,
    patterns: str | None,
    encoding: str | None,
    check_px: float | None,
    progress: Progress,
) -> dict[str, Any]:
    """Separate the images in `folder`, write all results into `out`, return the facts of
    ``report.json`` and more.

    `method`: ``checkerboard`` or ``network``; `alpha`, `dark`, `check_px`: of
    :func:`checkerboard`; `patterns`: a folder of state images, or ``estimate``. Raises BadInput
    naming the file or the folder at fault; nothing is left half-written.
    """
    if patterns is None and check_px is not None:  # of use only with states
        patterns = ESTIMATE
    require(
        patterns != ESTIMATE or (check_px or 5) >= 5,
        f"{folder}: states can be found in the images where checks have 5 pixels or more, but "
        f"check_px is {check_px}; give the states as patterns.",
    )
    states_folder = None if patterns in (None, ESTIMATE) else Path(str(patterns))
    check_target(out, MARKER, "an earlier separation", keep=folder)
    with atomic_folder(out) as target:
        progress("reading", 0.0)
        if encoding is None:
            photographs = lit_images(folder) if method == "network" and folder.is_dir() else []
            encoding = encoding_of(photographs, lambda: None)[0] if photographs else "linear"
        light = read_light(folder, states_folder, encoding)
        progress("separating", 0.5)
        common: dict[str, Any] = {
            "mask": light.mask,
            "clip_level": light.clip_level,
            "files": light.names,
        }
        model: dict[str, Any] = {"alpha": alpha, "dark": dark, "check_px": check_px}

        def separated() -> Separation:
            if method == "network":
                return _by_network(light)
            states = light.patterns
            if patterns == ESTIMATE:
                states = estimate_patterns(light.stack, **common)
            return checkerboard(light.stack, patterns=states, **model, **common)

        parts = naming(folder, separated)
        progress("writing", 0.8)
        choices: dict[str, Any] = {"encoding": encoding}
        if method == "network":
            choices["method"] = method
        else:
            choices |= {**model, "patterns": "given" if states_folder else patterns}
        origin = provenance({"separate": choices}, light.hashes)
        for name, part in (("direct", parts.direct), ("global", parts.global_)):
            write_float_tiff(target / f"{name}.tiff", part, LINEAR, origin)
            write_image(target / f"{name}.png", _light_picture(part))
        files = ["direct.tiff", "global.tiff", "direct.png", "global.png", "report.json"]
        facts = {**origin, **_figures(parts, light, method), "files": files}
        if patterns is not None and check_px is None:
            facts["findings"].append(NO_CHECK_PX.facts)
        (target / "report.json").write_text(json_text(facts), encoding="utf-8")
    progress("done", 1.0)
    return {**facts, "out": str(out)}


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


def _by_network(light: PatternLight) -> Separation:
    """The one photograph of a folder, separated by the network of the thesis."""
    names = ", ".join(light.names[:3])
    count = len(light.names)
    require(count == 1, f"`method` network takes one photograph, but there are {count} ({names}).")
    white = light.stack[0]
    inside = np.ones(white.shape[:2], np.bool_) if light.mask is None else light.mask
    colours = np.atleast_3d(white)
    images = np.moveaxis(np.where(inside[..., None], colours, 0.0), -1, 0)
    if len(images) == 3:
        images = images[None]
    direct = np.moveaxis(direct_light(images).reshape(-1, *inside.shape), 0, -1)
    direct = np.where(inside[..., None], direct, np.nan).reshape(white.shape)
    return Separation(direct, white - direct)


def _figures(parts: Separation, light: PatternLight, method: str) -> dict[str, Any]:
    total = parts.white
    grey = total if total.ndim == 2 else total.mean(axis=-1)
    lit = grey > _REPORTED_LEVEL * np.nanquantile(grey, 0.999)  # NaN is not
    require(lit.any(), "nothing is lit; the images are black.")
    negative = float((parts.global_[lit] < 0).mean())
    finding = Finding(
        "negative-light",
        f"global light is negative in {100 * negative:.0f} % of the lit pixels: check alpha, dark"
        " and the black image.",
    )
    return {
        "method": method,
        "images": list(light.names),
        "image_size": list(light.stack.shape[1:3]),
        "direct_share": float(np.median(parts.direct[lit] / np.maximum(total[lit], 1e-9))),
        "negative_global_share": negative,
        "findings": [finding.facts] if negative > 0.05 else [],
    }


# Previews of separated light for people.


def _light_picture(light: FloatArray) -> NDArray[np.uint8]:
    """8 bits for people: black to the 99.9th percentile, sRGB curve; black where nothing is
    known."""
    top = max(float(np.nanquantile(light, 0.999)), 1e-12)
    scaled = np.clip(np.nan_to_num(light) / top, 0.0, 1.0)
    return np.asarray(np.round(255 * srgb_code(scaled)), dtype=np.uint8)
