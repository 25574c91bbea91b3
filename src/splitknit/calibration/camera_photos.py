"""What ``splitknit calibrate camera`` does: photographs of a checkerboard in, the camera of a rig file out."""

from __future__ import annotations

import fnmatch
import hashlib
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.camera import CameraCalibration, fit_camera
from splitknit.calibration.plane import (
    DepthOfField,
    PlanePose,
    PlaneScale,
    depth_of_field,
    mean_pose,
    plane_pose,
    plane_scale,
)
from splitknit.calibration.targets import Board, find_board, find_disc, size_in_view
from splitknit.errors import BadInput, naming, read_bytes, require
from splitknit.io.images import MAX_BYTES, decode_image
from splitknit.io.provenance import file_hash, provenance
from splitknit.io.rig import read_rig, write_rig
from splitknit.io.targets import check_rig_file
from splitknit.model import Camera, PixelArray, Progress, Rig, default_rig, no_progress
from splitknit.plausible import CAMERA_HEIGHT

_SENSOR_COLUMNS = 3280
_UNBINNED_COLUMNS = 1920


@dataclass(frozen=True, slots=True)
class CameraJob:
    """What is asked for; see ``splitknit calibrate camera --help``."""

    out: Path
    folder: Path | None = None
    board: str = "9x6"
    square_mm: float = 3.0
    pattern: str | None = None
    rig: Path | None = None
    plane: tuple[Path, ...] = ()
    disc: Path | None = None
    dot_mm: float = 10.0
    sensor_pixel_um: float = 1.12
    binning: float | None = None
    f_number: float = 2.0
    finger_depth_mm: float = 8.0
    calibrated_at: str | None = None
    """ISO 8601."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCamera:
    """A camera as photographs of targets show it, None for what they do not."""

    job: CameraJob
    """What was asked for."""
    camera: Camera
    """As it is in the rig file."""
    fit: CameraCalibration | None
    """Of lens and photographs of a checkerboard."""
    poses: Mapping[str, PlanePose]
    """Pose of the finger plane by the image that shows it."""
    pose: PlanePose | None
    """Their mean."""
    scale: PlaneScale | None
    """Of an orthographic camera."""
    sharpness: DepthOfField | None
    binning: float
    """Sensor pixels along a pixel of the image."""
    warnings: tuple[str, ...]
    leds_nominal: bool = False
    """Whether the rig file's LEDs are the drawing's, as no rig was given."""
    boardless: tuple[str, ...] = ()
    """Photographs in which no board is in full view."""
    hashes: Mapping[str, str] = field(default_factory=dict)


def calibrate_to_rig(job: CameraJob, progress: Progress = no_progress) -> MeasuredCamera:
    """Calibrate, and write the rig file; BadInput names the file or option at fault, and nothing is written then."""
    require(
        job.folder is not None or len(job.plane) > 0 or job.disc is not None,
        "give a FOLDER of photographs of a checkerboard, `plane` or `disc`: there is nothing to calibrate from.",
    )
    check_rig_file(job.out)
    base = read_rig(job.rig) if job.rig is not None else None
    found = _find_camera(job, base, progress)
    progress("writing", 0.97)
    start = base or Rig(found.camera, default_rig().leds, {"source": "nominal: the thesis's drawing"})
    found = replace(found, leds_nominal=base is None, warnings=(*found.warnings, *_warnings(found)))
    facts = camera_facts(found)
    kept = {name: facts[name] for name in ("calibrated_at", "measured", "nominal", "warnings")}
    residuals = {"fit": facts["fit"], "plane": facts["plane"]}
    origin = {**kept, "residuals": residuals, **provenance({"board": facts["board"]}, found.hashes)}
    write_rig(replace(start, camera=found.camera, provenance={**start.provenance, "camera": origin}), job.out)
    return found


def _find_camera(job: CameraJob, base: Rig | None, progress: Progress) -> MeasuredCamera:
    """Everything but the file."""
    board = Board.named(job.board, job.square_mm)
    fit: CameraCalibration | None = None
    boardless: tuple[str, ...] = ()
    hashes: dict[str, str] = {}
    expected: _Expected | None
    expected = None if base is None else (base.camera.image_size, str(job.rig))
    if job.folder is not None:
        files = _image_files(job.folder, job.pattern)
        size, corners, boardless, hashes = _board_photos(
            job.folder, files, board, expected, lambda fraction: progress("finding corners", 0.85 * fraction)
        )
        expected = size, files[0].name
        progress("fitting", 0.86)
        fit = naming(job.folder, partial(fit_camera, list(corners.values()), board, size, list(corners)))
    marks = {}
    for file in job.plane:
        *marks[file.name], size = _plane_marks(file, board, expected)
        expected = expected or (size, file.name)
    if job.disc is not None:
        pixels, _ = _read_photo(job.disc, expected)
        marks[job.disc.name] = [*naming(job.disc, partial(find_disc, pixels, job.dot_mm))]
        expected = expected or ((pixels.shape[0], pixels.shape[1]), job.disc.name)
    for file in (*job.plane, *([job.disc] if job.disc is not None else [])):
        hashes[file.name] = file_hash(file)
    assert expected is not None
    progress("measuring the plane", 0.95)
    found = _assembled(job, base, expected[0], fit, marks)
    return replace(found, boardless=boardless, hashes=hashes)


def _assembled(
    job: CameraJob, base: Rig | None, size: tuple[int, int], fit: CameraCalibration | None, marks: dict[str, Any]
) -> MeasuredCamera:
    """Camera, plane, depth of field."""
    old = base.camera if base is not None else Camera(75.7, size)
    warnings = list(fit.warnings) if fit is not None else []
    poses: dict[str, PlanePose] = {}
    pose, scale, sharpness = None, None, None
    if fit is None and old.model == "orthographic":
        scale = _mean_scale([plane_scale(*one) for one in marks.values()])
        camera = replace(old, px_per_mm=scale.px_per_mm, image_size=size)
    else:
        camera = replace(
            old,
            model="perspective",
            image_size=size,
            matrix=fit.lens.matrix if fit is not None else old.matrix,
            distortion=fit.lens.distortion if fit is not None else old.distortion,
        )
        assert camera.matrix is not None
        focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        for name, (places_mm, places_px) in marks.items():
            poses[name] = plane_pose(places_mm, places_px, camera.matrix, camera.distortion)
        pose = mean_pose(list(poses.values()), focal) if poses else None
        height = pose.height_mm if pose is not None else old.height_mm
        if pose is not None:
            given = "check the side of the board's squares (--square-mm)" if job.plane else "check --dot-mm"
            warnings += CAMERA_HEIGHT.notes(height, given)
            if base is not None and not 0.6 < height / old.height_mm < 1.6:
                warnings.append(f"the camera is {height:.0f} mm high, by {job.rig} {old.height_mm:.0f} mm: {given}.")
        camera = replace(camera, height_mm=height, px_per_mm=focal / height)
        pixel_um = job.sensor_pixel_um * _binning(job, size[1])
        require(0.1 <= job.sensor_pixel_um <= 100, "`sensor_pixel_um` must be from 0.1 to 100 micrometres.")
        require(0.3 <= job.f_number <= 128, "`f_number` must be an f-number from 0.3 to 128.")
        require(0 < job.finger_depth_mm < height, "`finger_depth_mm` must be positive and below the camera's height.")
        sharpness = depth_of_field(focal, pixel_um, job.f_number, height, finger_depth_mm=job.finger_depth_mm)
    return MeasuredCamera(job, camera, fit, poses, pose, scale, sharpness, _binning(job, size[1]), tuple(warnings))


def _mean_scale(scales: list[PlaneScale]) -> PlaneScale:
    weight = np.array([1 / max(one.deviation, 1e-12) ** 2 for one in scales])
    mean = float(np.sum(weight * [one.px_per_mm for one in scales]) / weight.sum())
    return PlaneScale(
        mean,
        float(np.sqrt(np.mean([one.rms_px**2 for one in scales]))),
        float(1 / np.sqrt(weight.sum())),
        max(one.anisotropy for one in scales),
    )


def _binning(job: CameraJob, columns: int) -> float:
    """Sensor pixels along a pixel of the image: the IMX219 bins below 1920 columns, and crops above."""
    if job.binning is not None:
        require(1 <= job.binning <= 64, "`binning` must be from 1 to 64.")
        return job.binning
    return 1.0 if columns >= _UNBINNED_COLUMNS else max(1.0, float(round(_SENSOR_COLUMNS / columns)))


# Photographs of checkerboard and disc: reading them, and finding what they show.

Points = NDArray[np.float64]
_Expected = tuple[tuple[int, int], str]
"""Rows and columns that all images must have, and what has them."""
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
LEAST = 5
_LOOKED_AT = 6
"""Photographs in which a board of another size is sought."""


def _image_files(folder: Path, pattern: str | None = None) -> list[Path]:
    """Images in `folder`, in the order that people count, only those whose name fits the glob `pattern` if given. A
    pattern such as ``board_*/white_0.png`` takes images of capture folders inside `folder`.
    """
    require(folder.is_dir(), f"'{folder}' is not a folder; name the folder of checkerboard photographs.")
    levels = "/".join("*" * (1 if pattern is None else 1 + pattern.count("/")))
    files = [file for file in folder.glob(levels) if file.is_file() and file.suffix.lower() in SUFFIXES]
    files = [file for file in files if not file.name.startswith(".")]
    count = len(files)
    if pattern is not None:
        files = [file for file in files if fnmatch.fnmatchcase(_label(file, folder), pattern)]
        require(
            bool(files),
            f"no image in '{folder}' fits the pattern '{pattern}' ({count} images are there); "
            "quote the pattern and compare it with the files' names.",
        )
    require(bool(files), f"'{folder}' holds no images (PNG, JPEG or TIFF); put the checkerboard photographs there.")
    return sorted(files, key=lambda file: [(len(p), p) for p in re.findall(r"\d+|\D+", _label(file, folder))])


def _label(file: Path, folder: Path) -> str:
    """How a photograph is called: its path in the folder."""
    return file.relative_to(folder).as_posix()


def _read_photo(path: Path, expected: _Expected | None) -> tuple[PixelArray, str]:
    """Pixels and SHA-256 of an image."""
    data = read_bytes(path, MAX_BYTES)
    pixels = decode_image(data, str(path))
    if expected is not None:
        require(
            pixels.shape[:2] == expected[0],
            f"{path} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but {expected[1]} has "
            f"{expected[0][0]} x {expected[0][1]}; photograph everything with the camera's one setting.",
        )
    return pixels, hashlib.sha256(data).hexdigest()


def _board_photos(
    folder: Path,
    files: Sequence[Path],
    board: Board,
    expected: _Expected | None,
    progress: Callable[[float], None],
) -> tuple[tuple[int, int], dict[str, Points], tuple[str, ...], dict[str, str]]:
    """The photographs' size, corners by name, files without a board of the size in full view, and hashes. Where too few
    show it, BadInput names the size that they do show.
    """
    corners: dict[str, Points] = {}
    hashes: dict[str, str] = {}
    without: list[Path] = []
    for k, file in enumerate(files):
        progress(k / len(files))
        pixels, hashes[_label(file, folder)] = _read_photo(file, expected)
        expected = expected or ((pixels.shape[0], pixels.shape[1]), _label(file, folder))
        found = naming(file, partial(find_board, pixels, board))
        if found is None:
            without.append(file)
        else:
            corners[_label(file, folder)] = found
        if not corners and len(without) == _LOOKED_AT:
            _refuse_other_size(without, board)
    assert expected is not None
    if len(corners) < LEAST:
        _refuse_other_size(without, board)
        named = ", ".join(_label(file, folder) for file in without[:4]) + (" and more" if len(without) > 4 else "")
        missing = f" (not in {named})" if without else ""
        raise BadInput(
            f"{folder}: a checkerboard of {board.columns} x {board.rows} inner corners is in full view in "
            f"{len(corners)} of {len(files)} photographs{missing}, but {LEAST} are needed and 15 are advised; "
            "take more, the board tilted differently in each."
        )
    return expected[0], corners, tuple(_label(file, folder) for file in without), hashes


def _plane_marks(file: Path, board: Board, expected: _Expected | None) -> tuple[Points, Points, tuple[int, int]]:
    """Places of the board's corners in mm and in the image, and the image's size."""
    pixels, _ = _read_photo(file, expected)
    corners = naming(file, partial(find_board, pixels, board))
    if corners is None:
        _refuse_other_size([file], board)
        raise BadInput(
            f"{file} shows no checkerboard of {board.columns} x {board.rows} inner corners in full view; "
            "lay the board flat on the finger plane, evenly lit, and photograph it again."
        )
    return board.points_mm, corners, (pixels.shape[0], pixels.shape[1])


def _refuse_other_size(files: Sequence[Path], board: Board) -> None:
    """Refuse the board's size if photographs show a board of another."""
    sizes: Counter[tuple[int, int]] = Counter()
    for file in files[:_LOOKED_AT]:
        try:
            seen = size_in_view(_read_photo(file, None)[0])
        except BadInput:
            continue
        if seen is not None:
            sizes[seen] += 1
    if not sizes:
        return
    (size, count), *_ = sizes.most_common(1)
    asked = max(board.size), min(board.size)
    if size != asked and (count > 1 or len(files) == 1):
        squares = asked == (size[0] + 1, size[1] + 1)
        raise BadInput(
            f"{files[0]} shows a checkerboard of {size[0]} x {size[1]} inner corners, not of {board.columns} x "
            f"{board.rows}; give `board` {size[0]}x{size[1]}"
            + (" (corners where four squares meet, not squares)." if squares else ", or photograph the whole board.")
        )


# What a camera's calibration found: as facts for programs and as provenance for the rig file, with its warnings.

_TILT_LIMIT_DEG = 1.0
_POSES_HEIGHT, _POSES_TILT_DEG = 0.003, 0.3
"""Photographs of one plane that differ by more are warned about."""


def camera_facts(found: MeasuredCamera) -> dict[str, Any]:
    """Return what ``--json`` prints: all that was measured, as plain JSON."""
    camera, job = found.camera, found.job
    measured, nominal = _origins(found)
    return {
        "out": str(job.out),
        "calibrated_at": job.calibrated_at,
        "model": camera.model,
        "image_size": list(camera.image_size),
        "matrix": None if camera.matrix is None else np.asarray(camera.matrix).tolist(),
        "distortion": None if camera.distortion is None else list(camera.distortion),
        "height_mm": camera.height_mm,
        "px_per_mm": camera.px_per_mm,
        "board": {"inner_corners": job.board, "square_mm": job.square_mm},
        "fit": _fit(found),
        "plane": _plane(found),
        "depth_of_field": _sharpness(found),
        "measured": measured,
        "nominal": nominal,
        "warnings": list(found.warnings),
    }


def _fit(found: MeasuredCamera) -> dict[str, Any] | None:
    if found.fit is None:
        return None
    fit, lens = found.fit, found.fit.lens
    return {
        "rms_px": lens.rms_px,
        "images": len(fit.used),
        "per_image_px": dict(zip(fit.used, lens.view_rms_px.tolist(), strict=True)),
        "rejected_px": fit.rejected,
        "repeated": fit.repeated,
        "without_board": list(found.boardless),
        "focal_length_px": [float(lens.matrix[0, 0]), float(lens.matrix[1, 1])],
        "principal_point_px": lens.matrix[:2, 2].tolist(),
        "deviations": dict(lens.deviations),
        "fitted": list(lens.fitted),
        "held": dict(lens.fixed),
        "tilts_deg": [round(float(tilt), 2) for tilt in fit.tilts_deg],
        "variety_deg": fit.variety_deg,
        "coverage": fit.coverage,
    }


def _plane(found: MeasuredCamera) -> dict[str, Any] | None:
    if found.scale is not None:
        scale = found.scale
        return {
            "px_per_mm": scale.px_per_mm,
            "px_per_mm_deviation": scale.deviation,
            "rms_px": scale.rms_px,
            "anisotropy": scale.anisotropy,
        }
    if found.pose is None:
        return None
    pose = found.pose
    return {
        "height_mm": pose.height_mm,
        "height_mm_deviation": pose.deviations["height_mm"],
        "px_per_mm": pose.px_per_mm,
        "tilt_deg": pose.tilt_deg,
        "tilt_deg_deviation": _tilt_deviation(found, pose),
        "tilt_xy_deg": list(pose.tilt_xy_deg),
        "nearer_at": pose.nearer_side,
        "normal": pose.normal.tolist(),
        "rms_px": pose.rms_px,
        "per_image": {
            name: {"height_mm": one.height_mm, "tilt_deg": one.tilt_deg, "rms_px": one.rms_px}
            for name, one in found.poses.items()
        },
    }


_SHARPNESS = (
    "focal_length_mm", "f_number", "focus_mm", "confusion_um", "binning", "near_mm", "far_mm", "depth_mm",
    "finger_depth_mm", "fits", "blur_px", "needed_f_number", "diffraction_px", "best_f_number",
)  # fmt: skip


def _sharpness(found: MeasuredCamera) -> dict[str, Any] | None:
    field = found.sharpness
    if field is None:
        return None
    endless = {} if math.isfinite(field.far_mm) else {"far_mm": None, "depth_mm": None}
    return {name: getattr(field, name, found.binning) for name in _SHARPNESS} | endless


def _tilt_deviation(found: MeasuredCamera, pose: PlanePose) -> float:
    """With what the principal point's uncertainty adds: an axis that is off by one pixel is off by 1 / f."""
    lens = found.fit.lens if found.fit is not None else None
    if lens is None:
        return pose.deviations["tilt_deg"]
    axis = max(lens.deviations.get("cx", 0.0), lens.deviations.get("cy", 0.0)) / float(lens.matrix[0, 0])
    return float(np.hypot(pose.deviations["tilt_deg"], np.degrees(axis)))


def _origins(found: MeasuredCamera) -> tuple[list[str], list[str]]:
    """What is measured, and what is taken over."""
    measured = ["camera.matrix", "camera.distortion", "camera.image_size"] if found.fit is not None else []
    nominal = ["leds"] if found.leds_nominal else []
    plane = {"camera.px_per_mm": found.pose or found.scale, "camera.height_mm": found.pose}
    measured += [name for name, one in plane.items() if one is not None]
    return measured, [name for name, one in plane.items() if one is None] + nominal


def _warnings(found: MeasuredCamera) -> list[str]:
    words = []
    fit, camera = found.fit, found.camera
    if fit is not None and found.pose is None:
        words.append(
            f"px_per_mm rests on a height of {camera.height_mm:g} mm that was not measured; photograph the board flat "
            "on the finger plane (--plane) or the calibration disc (--disc)."
        )
    if found.pose is not None:
        words += _plane_warnings(found, found.pose)
    if found.scale is not None and found.scale.anisotropy > 0.01:
        words.append(
            f"the scale differs by {100 * found.scale.anisotropy:.1f} % between two directions, so the camera looks on "
            "obliquely; calibrate its matrix from a FOLDER of photographs of a checkerboard."
        )
    return words


def _plane_warnings(found: MeasuredCamera, pose: PlanePose) -> list[str]:
    words = []
    camera = found.camera
    if pose.tilt_deg > _TILT_LIMIT_DEG:
        slope = math.tan(math.radians(pose.tilt_deg))
        reach = math.hypot(*camera.image_size) / 2 / camera.px_per_mm
        depth = found.sharpness.finger_depth_mm if found.sharpness is not None else 8.0
        words.append(
            f"the camera looks on the base obliquely by {pose.tilt_deg:.2f} deg: the picture's corners lie up to "
            f"{reach * slope:.2f} mm nearer or farther than its middle, which displaces them by "
            f"{reach**2 * slope / pose.height_mm:.2f} mm, and what stands {depth:g} mm high leans by "
            f"{depth * slope:.2f} mm; straighten the camera, or put something thin under the base."
        )
    heights = [one.height_mm for one in found.poses.values()]
    apart = max(
        (float(np.degrees(np.arccos(min(1.0, float(one.normal @ pose.normal))))) for one in found.poses.values()),
        default=0.0,
    )
    if max(heights) - min(heights) > _POSES_HEIGHT * pose.height_mm or apart > _POSES_TILT_DEG:
        each = ", ".join(f"{name} {one.height_mm:.2f} mm, {one.tilt_deg:.2f} deg" for name, one in found.poses.items())
        words.append(
            f"the photographs of the finger plane disagree ({each}); the print lay uneven, or its scale is off."
        )
    if pose.rms_px > max(1.0, 0.01 * camera.px_per_mm):
        words.append(
            f"the marks on the finger plane miss their places by {pose.rms_px:.2f} px: the print is not flat, or its "
            "marks are not where they should be."
        )
    return words
