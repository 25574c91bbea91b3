"""From folders of photographs of balls to the file of a sensor's shading, and the page that shows its residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import (
    Array,
    Axis,
    Curve,
    FloatArray,
    Progress,
    Shading,
    check_file,
    colour,
    data_uri,
    encoding_of,
    file_hash,
    line_chart,
    linear_image,
    naming,
    no_progress,
    path,
    photographs_in,
    pick_channel,
    place_terms,
    provenance,
    read_bytes,
    read_flat,
    read_photo,
    require,
    round_marks,
    template,
    write_file,
    write_shading,
)
from splitknit_rig.calibration.jobs import ShadingJob
from splitknit_rig.calibration.shading import ShadingFit, calibrate_shading, fall_off_terms
from splitknit_rig.calibration.sphere import ball_of_mask


def shading_to_file(job: ShadingJob, progress: Progress = no_progress) -> ShadingFit:
    """Calibrate, and write the file. Raises BadInput naming the argument or file at fault."""
    require(len(job.images) > 0 or job.flat is not None, "name photographs of balls (`images`), or of a card (`flat`).")
    folders, flat_folder, out = [path(one) for one in job.images], path(job.flat), path(job.out)
    check_file(out, "a calibration of shading", lambda data: b"height_mm_per_slope.npy" in data)
    require(not folders or job.radius_mm is not None, "photographs of balls need their radius, `radius_mm`.")
    progress("reading", 0.0)
    hashes: dict[str, str] = {}
    stacks, outlines = [], []
    for folder in folders:
        stack, circle = _read_folder(folder, job.encoding, hashes)
        stacks.append(stack)
        outlines.append(circle)
    encoding = _encoding(folders[0] if folders else flat_folder, job.encoding)
    flat = None
    if flat_folder is not None:
        count = len(stacks[0]) if stacks else len(_photographs(flat_folder)[0])
        flat, found = read_flat(flat_folder, count, encoding)
        hashes |= found
    if not stacks:
        assert flat is not None and flat_folder is not None
        fit = _of_card(flat, flat_folder)
    else:
        centres: list[Array] | None = None
        if job.centres is not None:
            require(len(stacks) == 1, "`centres` goes with one folder of photographs.")
            centres = [read_centres(path(job.centres))]
            hashes[path(job.centres).name] = file_hash(job.centres)
        elif all(one is not None for one in outlines):
            centres = [one for one in outlines if one is not None]
        progress("fitting", 0.2)
        fit = naming(
            ", ".join(map(str, folders)),
            lambda: calibrate_shading(stacks, flat, job.radius_mm or 0.0, job.spacing_mm, centres),
        )
    facts = {**fit.shading.facts, "provenance": provenance(None, hashes)}
    fit = replace(fit, shading=replace(fit.shading, facts=facts))
    write_shading(out, fit.shading)
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


def read_centres(file: Path) -> Array:
    """Centres of balls (N, 2), with radii (N, 3), in pixels: lines ``column row [radius]``; BadInput names the line."""
    rows: list[list[float]] = []
    for number, line in enumerate(read_bytes(file, 1_000_000).decode("utf-8", "replace").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = [float("nan")]
        if words:
            sound = (
                len(values) in (2, 3) and bool(np.isfinite(values).all()) and len(values) == len((rows or [values])[0])
            )
            require(sound, f"{file}, line {number}: expected 'column row' or 'column row radius' in pixels.")
            rows.append(values)
    require(bool(rows), f"{file} holds no centres.")
    return np.array(rows)


def _of_card(flat: FloatArray, folder: Path) -> ShadingFit:
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


# The page: residuals on balls that were left out, and what physics says of the lights.

_MAP_PX = 900
_TITLE = "Calibration of shading"


def check_page(page: Path) -> None:
    """Refuse to replace a file that is not a page of this kind. Raises BadInput."""
    check_file(page, "a page of a calibration of shading", lambda data: f"<title>{_TITLE}</title>".encode() in data)


def write_page(page: Path, fit: ShadingFit) -> None:
    """Write the page, which needs nothing else. Raises BadInput if it cannot be written."""
    shading, facts = fit.shading, fit.shading.facts
    azimuth = np.rad2deg(np.arctan2(shading.direction[:, 1], shading.direction[:, 0])) % 360.0
    elevation = np.rad2deg(np.arcsin(np.clip(shading.direction[:, 2], -1.0, 1.0)))
    residual = facts.get("physics_residual", [0.0] * len(azimuth))
    lights = list(zip(azimuth, elevation, shading.nearness, shading.ambient, residual, strict=True))
    rows, columns = shading.image_size
    left, bottom = [0, 0, columns - 1, columns - 1], [rows - 1, 0, rows - 1, 0]
    terms = place_terms(shading.image_size, left, bottom, shading.fall_off.shape[1])
    edges = np.exp((shading.fall_off @ terms) - shading.fall_off[:, :1])
    chart = _slope_chart(fit) if len(fit.error_by_slope) else ""
    picture, limit = _residual_map(fit) if fit.cap_errors else ("", 0.0)
    html = template(Path(__file__).with_name("shading.html")).render(
        title=_TITLE, facts=facts, shading=shading, notes=fit.notes, lights=lights, chart=chart, map=picture,
        limit=limit, tried=facts.get("tried", ()), places=sum(fit.used), balls=[
            (f"{one[1]:.1f}", f"{one[2]:.1f}", "yes" if used else "no", f"{rms:.2f}", f"{gain:.3f}")
            for one, used, rms, gain in zip(fit.balls, fit.used, fit.cap_rms_um, fit.cap_gain, strict=True)
        ],
        fall_off=[(k, ", ".join(f"{value:.2f}" for value in row)) for k, row in enumerate(edges)],
    )  # fmt: skip
    write_file(page, html.encode("utf-8"))


def _slope_chart(fit: ShadingFit) -> str:
    slope, mean, rms = fit.error_by_slope.T
    top = 1.15 * float(np.max(rms))
    low = min(1.15 * float(np.min(mean)), -0.1 * top)
    x = Axis("slope of the ball", 0.0, float(slope[-1]), tuple((v, f"{v:g}") for v in round_marks(0.0, slope[-1], 6)))
    y = Axis("error of the slope", low, top, tuple((v, f"{v:g}") for v in round_marks(low, top, 6)))
    curves = [Curve("rms, a pixel", slope, rms), Curve("mean, along the slope", slope, mean)]
    return str(line_chart(curves, x, y))


def _residual_map(fit: ShadingFit) -> tuple[str, float]:
    """Errors of the heights of all caps where they lie in the image, and the limit of the colours in um."""
    rows, columns = fit.shading.image_size
    scale = min(1.0, _MAP_PX / max(rows, columns))
    picture = np.full((max(1, int(rows * scale)), max(1, int(columns * scale)), 3), 245, dtype=np.uint8)
    limit = float(np.percentile(np.abs(np.concatenate([one[:, 2] for one in fit.cap_errors])), 98)) or 1.0
    for cap in fit.cap_errors:
        step = max(1.0, np.sqrt(np.ptp(cap[:, 0]) * np.ptp(cap[:, 1]) * 0.785 / len(cap)) * scale)
        half = int(np.ceil(0.5 * step))
        paint = colour(cap[:, 2].astype(np.float32), -limit, limit, diverging=True)
        for (x, y, _), one in zip(cap, paint, strict=True):
            column, row = int(x * scale), int(y * scale)
            picture[max(row - half + 1, 0) : row + half, max(column - half + 1, 0) : column + half] = one
    return data_uri(picture), limit
