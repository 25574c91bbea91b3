"""From folders of photographs of balls to the file of a sensor's shading."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.calibration.shading import ShadingFit, calibrate_shading, fall_off_terms
from splitknit.calibration.sphere import ball_of_mask
from splitknit.errors import BadInput, naming, read_bytes, require
from splitknit.imaging.band import linear_image, pick_channel
from splitknit.io.photos import encoding_of, read_photo
from splitknit.io.plain import photographs_in, read_flat
from splitknit.io.provenance import file_hash, provenance
from splitknit.io.targets import check_file
from splitknit.model import FloatArray, Progress, no_progress
from splitknit.photometric.shading import Array, Shading, write_shading


@dataclass(frozen=True, slots=True)
class ShadingJob:
    """What is asked for; see ``splitknit calibrate shading --help``."""

    images: tuple[Path, ...]
    """Folders of photographs of balls, or of one ball pressed in other places or lying free."""
    out: Path
    flat: Path | None = None
    ball_radius: float | None = None
    pitch: float | None = None
    """Distance of neighbouring balls in mm."""
    centres: Path | None = None
    encoding: str | None = None


def shading_to_file(job: ShadingJob, progress: Progress = no_progress) -> ShadingFit:
    """Calibrate, and write the file. Raises BadInput naming the option or file at fault."""
    require(len(job.images) > 0 or job.flat is not None, "name photographs of balls (`images`), or of a card (`flat`).")
    check_file(job.out, "a calibration of shading", lambda data: b"height_mm_per_slope.npy" in data)
    require(not job.images or job.ball_radius is not None, "photographs of balls need their radius, `ball_radius` MM.")
    progress("reading", 0.0)
    hashes: dict[str, str] = {}
    stacks, outlines = [], []
    for folder in job.images:
        stack, circle = _read_folder(folder, job.encoding, hashes)
        stacks.append(stack)
        outlines.append(circle)
    encoding = _encoding(job.flat if not job.images else job.images[0], job.encoding)
    flat = None
    if job.flat is not None:
        count = len(stacks[0]) if stacks else len(_photographs(job.flat)[0])
        flat, found = read_flat(job.flat, count, encoding)
        hashes |= found
    if not stacks:
        assert flat is not None and job.flat is not None
        fit = _of_card(flat, job.flat)
    else:
        assert job.ball_radius is not None
        centres: list[Array] | None = None
        if job.centres is not None:
            require(len(stacks) == 1, "`centres` goes with one folder of photographs.")
            centres = [read_centres(job.centres)]
            hashes[job.centres.name] = file_hash(job.centres)
        elif all(one is not None for one in outlines):
            centres = [one for one in outlines if one is not None]
        progress("fitting", 0.2)
        fit = naming(
            ", ".join(map(str, job.images)),
            lambda: calibrate_shading(stacks, flat, job.ball_radius or 0.0, job.pitch, centres),
        )
    facts = {**fit.shading.facts, "provenance": provenance(None, hashes)}
    fit = replace(fit, shading=replace(fit.shading, facts=facts))
    write_shading(job.out, fit.shading)
    progress("done", 1.0)
    return fit


def _photographs(folder: Path) -> tuple[list[Path], list[Path]]:
    """Photographs of a folder in the order of their names, and a mask beside them."""
    require(folder.is_dir(), f"{folder} is not a folder; name the folder of the photographs.")
    files, masks, skipped = photographs_in(folder, folder / "lights.txt")
    for name in [one for one in skipped if "(a mask?" in one]:
        masks.append(folder / name.partition(" (")[0])
    require(len(files) > 0, f"{folder} holds no photographs.")
    return files, masks


def _encoding(folder: Path | None, given: str | None) -> str:
    assert folder is not None
    if given is not None:
        return given
    return encoding_of(_photographs(folder)[0], lambda: False)[0]


def _read_folder(folder: Path, encoding: str | None, hashes: dict[str, str]) -> tuple[FloatArray, Array | None]:
    """Linear light (L, H, W) of a folder's photographs or of its only one's colours; the ball's outline by a mask."""
    files, masks = _photographs(folder)
    how = _encoding(folder, encoding)
    images: list[FloatArray] = []
    for file in files:
        photo = read_photo(file)
        require(photo.pixels.dtype.kind == "u", f"{file} holds floats; save it as 16-bit PNG or TIFF.")
        light = linear_image(photo.pixels, how)
        colours = len(files) == 1 and light.shape[2] == 3
        images += [np.ascontiguousarray(light[..., k]) for k in range(3)] if colours else [pick_channel(light, "grey")]
        require(images[-1].shape == images[0].shape, f"{file} has another size than {files[0].name}; all must agree.")
        hashes[f"{folder.name}/{file.name}"] = photo.sha256
    require(
        len(images) > 2, f"{folder} holds {len(files)} photographs; three lights or one colour photograph are needed."
    )
    outline = None
    if masks:
        ball = naming(masks[0], lambda: ball_of_mask(read_photo(masks[0]).pixels.max(axis=2) > 127))
        outline = np.array([[ball.column, ball.row, ball.radius_px]])
    return np.stack(images), outline


def read_centres(path: Path) -> Array:
    """Centres of balls (N, 2), with radii (N, 3), in pixels: lines ``column row [radius]``; BadInput names the line."""
    rows: list[list[float]] = []
    for number, line in enumerate(read_bytes(path, 1_000_000).decode("utf-8", "replace").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = [float("nan")]
        if words:
            sound = (
                len(values) in (2, 3) and bool(np.isfinite(values).all()) and len(values) == len((rows or [values])[0])
            )
            require(sound, f"{path}, line {number}: expected 'column row' or 'column row radius' in pixels.")
            rows.append(values)
    if not rows:
        raise BadInput(f"{path} holds no centres.")
    return np.array(rows)


def _of_card(flat: FloatArray, folder: Path) -> ShadingFit:
    """A file of the fall-off alone, from a flat card."""
    lights = len(flat)
    first = read_photo(_photographs(folder)[0][0]).pixels
    empty = np.zeros((0, 2))
    facts: dict[str, Any] = {"balls": 0, "balls_used": 0}
    shading = Shading(
        pitch_mm=1.0,
        image_size=(first.shape[0], first.shape[1]),
        direction=np.tile([0.0, 0.0, 1.0], (lights, 1)),
        nearness=np.zeros(lights),
        ambient=np.zeros(lights),
        fall_off=fall_off_terms(flat),
        relative=False,
        degree=1,
        weights=empty,
        covariance=np.zeros((0, 0)),
        deviation=np.zeros(0),
        max_slope=0.0,
        height_mm_per_slope=0.0,
        facts=facts,
    )
    none = np.zeros(0)
    return ShadingFit(shading, np.zeros((0, 4)), none > 0, none, none, (), np.zeros((0, 3)), ())
